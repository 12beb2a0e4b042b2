"""Bodies of several shapes are poured into a bin of glass."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Box, Capsule, ConvexHull, Cylinder, Plane, Sphere, TriangleMesh
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from .rigid_bodies import Solid, Solids, rigid_parameters, solids_view

if TYPE_CHECKING:
    from ...recording import Recording

Array = NDArray[np.float64]

FILLED, RIM = 0.45, 0.75  # height of the heap and of the walls as drawn, in widths of the bin
SHARE = 0.7  # of its volume that the heap fills
COLUMN = 0.85  # width of the column that is poured, in that of the bin
SEGMENTS = 16  # around round shapes, as they are recorded
SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1))


def _stone(random: np.random.Generator, size: float) -> ConvexHull:
    """Points on an ellipsoid, seldom near each other."""
    n = int(random.integers(10, 17))
    z = 1 - (2 * np.arange(n) + 1) / n  # Fibonacci's lattice on a sphere, shaken
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(n)
    r = np.sqrt(1 - z**2)
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1)
    points += random.normal(scale=0.12, size=points.shape)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return ConvexHull(size * random.uniform(0.75, 1.25, 3) * points)


def _shapes(kind: str, size: float, random: np.random.Generator) -> list[Solid]:
    """What bodies are made of by turns, about as large as a box of half the edge `size`."""
    if kind == "boxes":
        return [Box((2 * size,) * 3)]
    if kind == "hulls":
        return [_stone(random, 1.25 * size) for _ in range(24)]
    return [
        Box((2 * size,) * 3),
        Sphere(1.1 * size),
        Capsule(0.75 * size, 1.7 * size),
        Cylinder(0.9 * size, 1.8 * size),
        Box((2.6 * size, 1.8 * size, 1.2 * size)),
        _stone(random, 1.25 * size),
    ]


def _pane(width: float, side: tuple[int, int]) -> TriangleMesh:
    """What is drawn of a wall, whose plane goes on above the rim."""
    normal = np.array([*side, 0])
    across = np.array([-side[1], side[0], 0])
    corners = [width * ((normal + s * across) / 2 + [0, 0, z]) for z in (0, RIM) for s in (-1, 1)]
    return TriangleMesh(np.array(corners), [[0, 1, 3], [0, 3, 2]])


def width_of(parameters: dict[str, Any]) -> float:
    """Of the bin, which the heap fills to its share [m]."""
    solid = parameters["bodies"] * (2 * parameters["size"]) ** 3
    return float((solid / (SHARE * FILLED)) ** (1 / 3))


class Pile(Solids):
    """Bodies above a bin.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    seed : int
        Of orientations and stones.
    """

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        super().__init__(parameters)
        random = np.random.default_rng(seed)
        n, size = parameters["bodies"], parameters["size"]
        width = width_of(parameters)
        for k, side in enumerate(SIDES):
            wall = Plane((-side[0], -side[1], 0), width / 2 * np.array([*side, 0]))
            self.add(wall, (0, 0, 0), motion="static", friction=self.friction)
            self.obstacles[f"wall{k}"] = _pane(width, side)
        apart = 3.5 * size  # the diagonal of a box
        across = max(1, int(COLUMN * width / apart))
        number = np.arange(n)
        place = np.stack([number % across, number // across % across, number // across**2], axis=-1)
        x = apart * (place - [(across - 1) / 2, (across - 1) / 2, -0.6])
        x[:, :2] += random.uniform(-0.1, 0.1, (n, 2)) * size
        q = random.normal(size=(n, 4))  # each rotation as likely
        dye = random.uniform(size=n)
        shapes = _shapes(parameters["shapes"], size, random)
        levers = dict.fromkeys(("rolling_friction", "spinning_friction"), parameters["rolling"])
        for j, shape in enumerate(shapes):
            own = slice(j, n, len(shapes))
            if len(x[own]):
                self.put("pile", shape, x[own], q[own], dye=dye[own], segments=SEGMENTS, **levers)

    def words(self) -> str:
        """How deep they are in each other, and how many sleep."""
        values = self.diagnostics()
        n = int((self.motions == "dynamic").sum())
        asleep = n - values["awake"]
        speed = float(np.linalg.norm(self.velocities, axis=1).max())
        return (
            f"{n} bodies, {asleep:.0f} of them asleep, the fastest at {speed:.2g} m/s, "
            f"deepest penetration {1e3 * values['penetration']:.2g} mm"
        )


def _box(recording: Recording) -> Array:
    width = width_of(recording.parameters)
    return width * np.array([[-0.5, -0.5, 0], [0.5, 0.5, 0.85]])


SCENE = Scene(
    name="pile",
    doc="Bodies of several shapes are poured into a bin.",
    parameters={
        "duration": Parameter("time simulated", 5.0, unit="s", above=0),
        "bodies": Parameter("number of bodies", 1000, minimum=1, maximum=1_000_000),
        "shapes": Parameter("shapes of the bodies", "mixed", choices=("mixed", "boxes", "hulls")),
        "size": Parameter("half the edge of a box", 0.1, unit="m", above=0),
        "rolling": Parameter("lever of rolling friction", 1e-3, unit="m", minimum=0),
        **rigid_parameters(),
    },
    quick={"duration": 0.2, "bodies": 30},
    build=Pile,
    parts=Solids.parts,
    frame=Solids.frame,
    summary=Pile.words,
    picture=solids_view(
        Camera(-60.0, 24.0),
        "Spectral",
        lambda recording: 2 * recording.parameters["size"],
        _box,
        {f"wall{k}": Look("#8fa3b0", opacity=0.18) for k in range(4)},
    ),
    frames=151,
)
