"""Balls and capsules fall into a cloth whose rim is held."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Capsule, Sphere, grid_mesh
from ...springs import MassSpring, grid_springs
from ...view import Camera, Look, View
from ..declaration import Parameter, Scene
from ..rigid.rigid_bodies import Solid, Solids
from .coupled import Coupled

if TYPE_CHECKING:
    from ...recording import Part, Recording

Array = NDArray[np.float64]

LENGTH, WIDTH, HEIGHT = 2.4, 1.5, 1.3  # of the frame that holds it, and where that is [m]
SAG = 0.4  # of the cloth [m]
THICKNESS = 0.02  # of contact [m]


class Cloth(MassSpring):
    """A cloth that hangs in a frame.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    bodies : Solids
        What falls on it.
    """

    def __init__(self, parameters: dict[str, Any], bodies: Solids) -> None:
        n = parameters["vertices"]
        m = max(2, round(n * WIDTH / LENGTH))
        grid = grid_mesh(n, m, (LENGTH, WIDTH))
        x = grid.vertices - grid.vertices.mean(axis=0)
        along, across = 2 * x[:, 0] / LENGTH, 2 * x[:, 1] / WIDTH
        x[:, 2] = HEIGHT - SAG * (1 - along**2) * (1 - across**2)
        rim = np.maximum(np.abs(along), np.abs(across)) > 1 - 1e-9
        edges, stiffness = grid_springs(
            n, m, stiffness=parameters["stiffness"], shear=0.3, bending=0.02
        )
        mass = parameters["density"] * LENGTH * WIDTH / len(x)
        super().__init__(
            x,
            edges,
            stiffness,
            mass,
            damping=parameters["damping_time"] * stiffness,
            faces=grid.faces,
            pinned=rim,
            drag=parameters["drag"],
            colliders=bodies.make_colliders(np.flatnonzero(bodies.motions == "dynamic")),
            step=parameters["step"],
            contact_margin=THICKNESS,
        )

    def parts(self) -> dict[str, Part]:
        """The cloth as a mesh with its velocity."""
        from ...recording import Part

        return {"cloth": Part("mesh", {"velocity": "m/s"}, triangles=self.faces)}

    def frame(self) -> dict[str, dict[str, Any]]:
        """Positions as float64, velocities as float32."""
        velocity = self.velocities.astype(np.float32)
        return {"cloth": {"points": self.positions.copy(), "velocity": velocity}}


class Hammock(Coupled):
    """What falls, and the cloth.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    seed : int
        Of the places and turns of what falls.
    """

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        bodies = Solids({**parameters, "substeps": 8})
        random = np.random.default_rng(seed)
        n = parameters["bodies"]
        shapes: list[Solid] = [Sphere(0.12), Capsule(0.09, 0.22), Sphere(0.16)]
        for k in range(n):
            x = [*random.uniform(-0.25, 0.25, 2), HEIGHT + 0.15 + 0.35 * k]
            shape, turn = shapes[k % len(shapes)], random.normal(size=4)
            density = parameters["heavy"] if k % 2 == 0 else parameters["light"]
            bodies.put("solids", shape, [x], [turn], dye=[k / n], density=density, segments=48)
        super().__init__({"bodies": bodies, "cloth": Cloth(parameters, bodies)})

    def words(self) -> str:
        """Who lies in it, and how far it sags."""
        cloth, bodies = self["cloth"], self["bodies"]
        z = bodies.positions[bodies.motions == "dynamic", 2]
        lowest = float(cloth.positions[:, 2].min())
        return (
            f"{int((z > lowest).sum())} of {len(z)} bodies are in it, its lowest vertex "
            f"{HEIGHT - lowest:.2f} m below its rim"
        )


def _box(recording: Recording) -> Array:
    return np.array([[-LENGTH / 2, -WIDTH / 2, 0.5], [LENGTH / 2, WIDTH / 2, HEIGHT + 0.1]])


SCENE = Scene(
    name="hammock",
    doc="Balls and capsules fall into a cloth whose rim is held.",
    parameters={
        "duration": Parameter("time simulated", 4.0, unit="s", above=0),
        "vertices": Parameter("vertices along the cloth", 40, minimum=8, maximum=1000),
        "bodies": Parameter("number of bodies that fall", 7, minimum=1, maximum=100),
        "heavy": Parameter("density of every other one", 700.0, unit="kg/m^3", above=0),
        "light": Parameter("density of the others", 60.0, unit="kg/m^3", above=0),
        "density": Parameter("mass of the cloth per area", 0.5, unit="kg/m^2", above=0),
        "stiffness": Parameter(
            "stiffness of the springs between neighbours", 4000.0, unit="N/m", above=0
        ),
        "damping_time": Parameter(
            "damping time of the springs, over their stiffness", 5e-3, unit="s", minimum=0
        ),
        "drag": Parameter("drag of the cloth", 2.0, unit="1/s", minimum=0),
        "friction": Parameter("coefficient of friction", 0.4, minimum=0),
        "step": Parameter("time step", 1 / 120, unit="s", above=0),
    },
    quick={"duration": 0.05, "vertices": 8, "bodies": 2},
    build=Hammock,
    parts=Coupled.parts,
    frame=Coupled.frame,
    notes=Coupled.notes,
    summary=Hammock.words,
    picture=View(
        Camera(-65.0, 40.0),
        {"bodies": Look(hidden=True), "cloth": Look("#3f7ea6")},
        color="dye",
        palette="Spectral",
        limits=(0, 255),
        bar=False,
        box=_box,
        ground=lambda recording: 0.0,
        nooks=lambda recording: 0.2,
    ),
    frames=121,
)
