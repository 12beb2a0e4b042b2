"""What the scenes of liquids share, by whatever method: recording and picture of a tank."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import TriangleMesh
from ..view import Camera, Look, View

if TYPE_CHECKING:
    from ..recording import Part, Recording

Array = NDArray[np.float64]

EDGES = "#56616c"  # of the tank
_CORNERS = np.array(list(itertools.product((0, 1), repeat=3)))
_SIDES = [(i, j) for i, j in itertools.combinations(range(8), 2) if i ^ j in (1, 2, 4)]


class InTank:
    """Liquids in an open tank that stands on the ground, with obstacles, as they are recorded.

    Subclasses put it before `PositionBasedFluid` or `GridLiquid`.

    Attributes
    ----------
    tank : ndarray, shape (3,)
        Length, width and height of the tank [m], whose lowest corner is at 0.
    spacing : float
        Distance of the particles at rest [m].
    names : tuple of str
        Of the parts, one for each fluid; where there are several, `kinds` says which is which.
    obstacles : dict of str to TriangleMesh
        What is drawn of them.
    lacks : dict of str to str
        What is wrong with the meshes that were read.
    """

    tank: Array
    names: tuple[str, ...] = ("liquid",)
    obstacles: Mapping[str, TriangleMesh]
    lacks: Mapping[str, str]

    def parts(self: Any) -> dict[str, Part]:
        """Particles with velocities and ids, by fluid; tank and obstacles, which never move."""
        from ..recording import Part

        fields = {"velocity": "m/s", "id": "1"}
        parts = {name: Part("particles", fields) for name in self.names}
        parts["tank"] = Part("mesh", edges=_SIDES, points=_CORNERS * self.tank)
        for name, mesh in self.obstacles.items():
            parts[name] = Part("mesh", triangles=mesh.faces, points=mesh.vertices)
        return parts

    def frame(self: Any) -> dict[str, dict[str, Any]]:
        """Positions and velocities as float32, which they are computed in; ids as int32."""
        points = self.positions.astype(np.float32)
        velocity = self.velocities.astype(np.float32)
        ids = self.ids.astype(np.int32)
        fluid = self.kinds if len(self.names) > 1 else np.zeros(len(ids), np.int64)
        return {
            name: {"points": points[own], "velocity": velocity[own], "id": ids[own]}
            for k, name in enumerate(self.names)
            for own in [fluid == k]
        }

    def notes(self: Any) -> dict[str, str]:
        """Spacing of the particles, and what meshes lack, for the recording."""
        return {"spacing": repr(self.spacing), **self.lacks}


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
