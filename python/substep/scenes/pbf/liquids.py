"""What the scenes of liquids share: the tank, columns, recording and picture."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...geometry import Box, Collider, TriangleMesh
from ...pbf import PositionBasedFluid, fill_box
from ...view import Camera, Look, View
from ..declaration import Parameter

if TYPE_CHECKING:
    from ...recording import Part, Recording

Array = NDArray[np.float64]

EDGES = "#56616c"  # of the tank
_CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))
_SIDES = [(i, j) for i, j in itertools.combinations(range(8), 2) if i ^ j in (1, 2, 4)]


def liquid_parameters() -> dict[str, Parameter]:
    """Parameters of every such scene.

    Returns
    -------
    dict of str to Parameter
        By key.
    """
    return {
        "friction": Parameter("coefficient of friction of the walls", 0.0, minimum=0),
        "viscosity": Parameter("kinematic viscosity", 0.0, unit="m^2/s", minimum=0),
        "xsph": Parameter("smoothing of the velocities in a step", 0.1, minimum=0, maximum=1),
        "divergence_free": Parameter("velocities by a pressure, for slow flow", False),
        "tolerance": Parameter("mean density error at which a step is done", 1e-3, above=0),
        "iterations": Parameter("at most, of a step", 8, minimum=1),
        "cfl": Parameter("spacings that the fastest particle may move in a step", 0.4, above=0),
    }


class Liquid(PositionBasedFluid):
    """A liquid in an open tank that stands on the ground, with obstacles.

    Parameters
    ----------
    positions : array_like, shape (n, 3)
        Of the particles [m].
    spacing : float
        Their distance at rest [m].
    parameters : dict
        Of the scene, with those of `liquid_parameters`.
    tank : array_like, shape (3,)
        Length, width and height of the tank [m], whose lowest corner is at 0. Its walls go on above
        its rim, so that nothing leaves it.
    obstacles : mapping of str to (Collider, TriangleMesh)
        By name, with what is drawn of them.
    lacks : mapping of str to str
        What is wrong with meshes that were read.
    names : sequence of str
        Of the parts, one for each fluid.
    options
        Others of `PositionBasedFluid`.
    """

    def __init__(
        self,
        positions: ArrayLike,
        spacing: float,
        parameters: Mapping[str, Any],
        tank: ArrayLike,
        *,
        obstacles: Mapping[str, tuple[Collider, TriangleMesh]] | None = None,
        lacks: Mapping[str, str] | None = None,
        names: Sequence[str] = ("liquid",),
        **options: Any,
    ) -> None:
        self.tank = np.asarray(tank, float)
        self.names = tuple(names)
        self.lacks = dict(lacks or {})
        self.obstacles = {name: mesh for name, (_, mesh) in (obstacles or {}).items()}
        high = self.tank * [1, 1, 50]
        self.walls = Collider(Box(high, high / 2), hollow=True, friction=parameters["friction"])
        super().__init__(
            positions,
            spacing,
            colliders=[self.walls, *(collider for collider, _ in (obstacles or {}).values())],
            tolerance=parameters["tolerance"],
            max_iterations=parameters["iterations"],
            cfl=parameters["cfl"],
            viscosity=parameters["viscosity"],
            xsph=parameters["xsph"],
            divergence_free=parameters["divergence_free"],
            **options,
        )

    def outside(self) -> int:
        """How many particles are behind a wall or in an obstacle."""
        x = self.positions
        return int(sum(np.sum(collider.distance(x) < 0) for collider in self.colliders))

    def words(self) -> str:
        """How the run ended."""
        values = self.diagnostics()
        error = 100 * values["mean_density_error"]
        return (
            f"{len(self)} particles of {1e3 * self.spacing:.3g} mm, {self.outside()} of them "
            f"outside; last step {values['iterations']:.0f} iterations, density error "
            f"{error:.2g} % in the mean"
        )

    def parts(self) -> dict[str, Part]:
        """Particles with velocities and ids, by fluid; tank and obstacles, which never move."""
        from ...recording import Part

        fields = {"velocity": "m/s", "id": "1"}
        parts = {name: Part("particles", fields) for name in self.names}
        parts["tank"] = Part("mesh", edges=_SIDES, points=_CORNERS * self.tank)
        for name, mesh in self.obstacles.items():
            parts[name] = Part("mesh", triangles=mesh.faces, points=mesh.vertices)
        return parts

    def frame(self) -> dict[str, dict[str, Any]]:
        """Positions and velocities as float32, which they are computed in; ids as int32."""
        points = self.positions.astype(np.float32)
        velocity = self.velocities.astype(np.float32)
        ids, fluid = self.ids.astype(np.int32), self.kinds
        return {
            name: {"points": points[own], "velocity": velocity[own], "id": ids[own]}
            for k, name in enumerate(self.names)
            for own in [fluid == k]
        }

    def notes(self) -> dict[str, str]:
        """Spacing of the particles, and what meshes lack, for the recording."""
        return {"spacing": repr(self.spacing), **self.lacks}


def column(low: ArrayLike, high: ArrayLike, spacing: float) -> Array:
    """Particles that fill a box, whose sides are rounded to whole particles.

    Parameters
    ----------
    low, high : array_like, shape (3,)
        Corners [m].
    spacing : float
        Distance of neighbours [m].

    Returns
    -------
    ndarray, shape (n, 3)
        Positions [m].
    """
    low = np.asarray(low, float)
    counts = np.maximum(1, np.rint((np.asarray(high, float) - low) / spacing))
    return fill_box(low, low + counts * spacing, spacing)


def radius(recording: Recording) -> float:
    """Half the spacing of the particles [m]."""
    return float(recording.parameters["notes"]["spacing"]) / 2


def liquid_view(
    camera: Camera,
    colors: Mapping[str, str | None],
    looks: Mapping[str, Look] | None = None,
    box: Callable[[Recording], Array] | None = None,
) -> View:
    """A clear liquid in a tank of glass.

    Parameters
    ----------
    camera : Camera
        Where from.
    colors : mapping of str to (str or None)
        Of the liquids, by part.
    looks : mapping of str to Look, optional
        Of the obstacles.
    box : callable, optional
        Region shown; the tank unless given.

    Returns
    -------
    View
        The picture.
    """
    liquids = {name: Look(color, liquid=True, radius=radius) for name, color in colors.items()}
    return View(
        camera,
        {**liquids, "tank": Look(EDGES), **(looks or {})},
        box=box or tank_box,
        ground=lambda recording: 0.0,
    )


def tank_box(recording: Recording) -> Array:
    """Lowest and highest corner of the tank [m]."""
    points = np.asarray(recording.parts["tank"].points)
    return np.array([points.min(axis=0), points.max(axis=0)])
