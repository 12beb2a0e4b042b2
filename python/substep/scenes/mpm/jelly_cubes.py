"""Cubes of jelly, each stiffer than the last, fall into a pen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Collider, Plane, TriangleMesh
from ...mpm import NeoHookean, sample_box
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from .material_points import Points, mpm_parameters, points_view

if TYPE_CHECKING:
    from ...recording import Recording

PEN, RIM = 2.6, 1.8  # width of the pen, and height of its walls as drawn, in sides of a cube


def _rotation(random: np.random.Generator) -> NDArray[np.float64]:
    """One of all rotations, each as likely (Shoemake, Graphics Gems III, 1992)."""
    q, r = np.linalg.qr(random.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    q[:, 0] *= np.linalg.det(q)
    rotation: NDArray[np.float64] = q
    return rotation


def _pane(side: float, normal: NDArray[np.int64]) -> TriangleMesh:
    """What is drawn of a wall that stands about the pen, and whose plane goes on above its rim."""
    across = np.array([-normal[1], normal[0], 0])
    ends = [-normal - across, -normal + across]
    corners = [PEN / 2 * end + [0, 0, z] for z in (0.0, RIM) for end in ends]
    return TriangleMesh(side * np.array(corners), [[0, 1, 3], [0, 3, 2]])


def _build(parameters: dict[str, Any], seed: int) -> Points:
    side, cubes = parameters["side"], parameters["cubes"]
    spacing = side / max(1, round((parameters["particles"] / cubes) ** (1 / 3)))
    random = np.random.default_rng(seed)
    x, volumes = sample_box((-side / 2,) * 3, (side / 2,) * 3, spacing, jitter=0.0)
    placed, materials = [], []
    for k in range(cubes):
        # Up a winding stair, so that none is in another: a cube turned is sqrt(3) sides wide.
        turn, rise = 2.4 * k, (1.0 + 1.15 * k) * side
        center = np.array([0.45 * side * np.cos(turn), 0.45 * side * np.sin(turn), rise])
        if k == 0 or not parameters["turned"]:
            center[2] = (0.6 + 1.3 * k) * side
        placed.append(x @ (_rotation(random) if parameters["turned"] else np.eye(3)).T + center)
        stiffness = parameters["young"] * parameters["ratio"] ** (k / max(1, cubes - 1))
        materials.append(NeoHookean(parameters["density"], stiffness, parameters["poisson"]))
    walls = {}
    for k, normal in enumerate(((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))):
        plane = Plane(normal, -PEN / 2 * side * np.array(normal))
        wall = Collider(plane, friction=parameters["friction"])
        walls[f"wall{k}"] = (wall, _pane(side, np.array(normal)))
    which = np.repeat(np.arange(cubes), len(x))
    return Points(
        np.vstack(placed),
        np.tile(volumes, cubes),
        materials,
        parameters,
        spacing=spacing,
        part="cubes",
        dye=which,
        kinds=which,
        obstacles=walls,
    )


def _summary(points: Points) -> str:
    energy = points.diagnostics()["elastic_energy"]
    return f"elastic energy {energy:.2g} J; {points.words()}"


def _box(recording: Recording) -> NDArray[np.float64]:
    side = recording.parameters["side"]
    return side * np.array([[-PEN / 2, -PEN / 2, 0], [PEN / 2, PEN / 2, 2.8]])


SCENE = Scene(
    name="jelly-cubes",
    doc="Cubes of jelly, each stiffer than the last, fall into a pen.",
    parameters={
        "duration": Parameter("time simulated", 1.5, unit="s", above=0),
        "particles": Parameter(
            "approximate number of particles", 120_000, minimum=1, maximum=50_000_000
        ),
        "cubes": Parameter("number of cubes", 7, minimum=1, maximum=100),
        "side": Parameter("side of a cube", 0.1, unit="m", above=0),
        "turned": Parameter("whether each is turned at random", True),
        "density": Parameter("mass per volume", 1000.0, unit="kg/m^3", above=0),
        "young": Parameter("Young's modulus of the softest", 1e4, unit="Pa", above=0),
        "ratio": Parameter("that of the stiffest over it", 20.0, minimum=1),
        "poisson": Parameter("Poisson's ratio", 0.4, minimum=0, maximum=0.49),
        **mpm_parameters(0.4),
    },
    quick={"duration": 0.1, "particles": 1000, "cubes": 3},
    build=_build,
    parts=Points.parts,
    frame=Points.frame,
    notes=Points.notes,
    summary=_summary,
    picture=points_view(
        Camera(-60.0, 24.0),
        "cubes",
        "rainbow",
        looks={f"wall{k}": Look("#8fa3b0", opacity=0.18) for k in range(4)},
        box=_box,
    ),
    frames=76,
)
