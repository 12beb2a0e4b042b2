"""A square cloth, held at two corners, swings down and hangs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import grid_mesh
from ...springs import MassSpring, grid_springs
from ...view import Camera, Look, View
from ..declaration import Parameter, Scene
from ..deformables import GRAVITY, Watched, solver_parameters

if TYPE_CHECKING:
    from ...recording import Recording


class HangingCloth(Watched, MassSpring):
    """A square cloth with two pinned corners."""

    part = "cloth"

    def __init__(self, parameters: dict[str, Any]) -> None:
        n, size = parameters["vertices"], parameters["size"]
        mesh = grid_mesh(n, n, (size, size))
        start = mesh.vertices.copy()
        start[:, ::2] = sagging(mesh.vertices[::n, 0], parameters["apart"]).repeat(n, axis=0)
        edges, stiffness = grid_springs(
            n,
            n,
            stiffness=parameters["stiffness"],
            shear=parameters["shear"],
            bending=parameters["bending"],
        )
        mass = parameters["density"] * size**2 / n**2
        ends = mesh.vertices[edges]
        super().__init__(
            start,
            edges,
            stiffness,
            mass,
            rest_lengths=np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1),
            damping=parameters["damping_time"] * stiffness,
            faces=mesh.faces,
            pinned=[0, n * (n - 1)],
            drag=parameters["drag"],
            integrator=parameters["integrator"],
            step=parameters["step"],
            tolerance=parameters["tolerance"] * mass * GRAVITY,
        )
        self.obstacles, self.lacks = {}, {}
        self.watch(room=size)

    def stretch(self) -> float:
        """Largest length of a spring over that at rest."""
        ends = self.positions[self.edges]
        return float((np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / self.rest_lengths).max())


def sagging(x: NDArray[np.float64], apart: float) -> NDArray[np.float64]:
    """(x, z) of points x of a line whose ends come nearer, without a change of its length.

    It becomes half a wave, z = -a cos(pi x / d), over the new distance d of the ends.
    """
    length = x[-1] - x[0]
    d = apart * length
    s = np.linspace(-d / 2, d / 2, 2001)

    def arc(a: float) -> NDArray[np.float64]:
        z = -a * np.cos(np.pi * s / d)
        return np.append(0.0, np.cumsum(np.hypot(np.diff(s), np.diff(z))))

    low, high = 0.0, length
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if arc(middle)[-1] < length else (low, middle)
    along = np.interp(x - x[0], arc(low) * length / arc(low)[-1], s)
    return np.column_stack([along, -low * np.cos(np.pi * along / d)])


def _summary(cloth: HangingCloth) -> str:
    return (
        f"{len(cloth)} vertices, {cloth.still()}; longest spring {cloth.stretch():.3f} times its "
        f"rest length; {cloth.work()}"
    )


def _box(recording: Recording) -> NDArray[np.float64]:
    size, apart = recording.parameters["size"], recording.parameters["apart"]
    return size * np.array([[-0.55 * apart, -0.7, -1.12], [0.55 * apart, 0.3, 0.03]])


SCENE = Scene(
    name="cloth-hang",
    doc="A square cloth, held at two corners, swings down and hangs.",
    parameters={
        "duration": Parameter("time simulated", 4.0, unit="s", above=0),
        "vertices": Parameter("vertices along a side", 40, minimum=2, maximum=2000),
        "size": Parameter("length of a side", 1.0, unit="m", above=0),
        "apart": Parameter("distance of the corners, over that", 0.8, above=0.3, maximum=1),
        "density": Parameter("mass per area", 0.3, unit="kg/m^2", above=0),
        "stiffness": Parameter(
            "stiffness of the springs between neighbours", 1e3, unit="N/m", above=0
        ),
        "shear": Parameter("stiffness of the diagonals, as a part of that", 0.5, minimum=0),
        "bending": Parameter("stiffness across every second vertex, likewise", 0.05, minimum=0),
        "damping_time": Parameter(
            "damping time of the springs, over their stiffness", 1e-3, unit="s", minimum=0
        ),
        **solver_parameters(0.02, 1.5),
    },
    quick={"duration": 0.2, "vertices": 8},
    build=lambda parameters, seed: HangingCloth(parameters),
    parts=Watched.parts,
    frame=Watched.frame,
    notes=Watched.notes,
    summary=_summary,
    picture=View(Camera(112.0, 14.0), looks={"cloth": Look("#c65d47")}, box=_box),
)
