"""Surfaces that deform as obstacles of other methods: one for each triangle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_real
from ..base.simulation import Simulation
from ..errors import InputError
from .colliders import StandIn
from .shape import Shape
from .topology import check_indices

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sheet:
    """The triangles of a surface, and how thick they are.

    Attributes
    ----------
    faces : ndarray of int64, shape (m, 3)
        Vertices of the triangles.
    radius : float
        Half of the thickness [m].
    closed : bool
        Whether the surface encloses something: the thickness is then behind it, else half of it is
        on each side.
    """

    faces: NDArray[np.int64]
    radius: float
    closed: bool

    def corners(self, x: Array) -> Array:
        """Of the middle planes of all triangles, shape (m, 3, 3), for vertices x."""
        if not self.closed:
            return x[self.faces]
        # A vertex goes inward so far that it is `radius` behind the planes of all its triangles,
        # or as nearly as it can: min_o sum A ((n.o + r)^2 + weight |o|^2).
        weight = 1e-3
        p = x[self.faces]
        area = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        size = np.linalg.norm(area, axis=1)
        n = area / np.where(size > 0, size, 1.0)[:, None]
        sums, pull = np.zeros((len(x), 3, 3)), np.zeros((len(x), 3))
        outer = size[:, None, None] * (n[:, :, None] * n[:, None, :] + weight * np.eye(3))
        for k in range(3):
            np.add.at(sums, self.faces[:, k], outer)
            np.add.at(pull, self.faces[:, k], area)
        sums[np.trace(sums, axis1=1, axis2=2) <= 0] = np.eye(3)
        inward = np.linalg.solve(sums, pull[:, :, None])[:, :, 0]
        return (x - self.radius * inward)[self.faces]


class SurfaceCollider(StandIn):
    """An obstacle that represents a triangle of a surface that deforms; `make_colliders` makes it.

    Give it to one simulation, and that together with the one whose surface it is to a `World`,
    which moves it with its corners and gives to these what pushes it.

    Attributes
    ----------
    face : int
        Which triangle it is.
    """

    face: int
    _deforms = True
    _sheet: Sheet
    _source: Any  # the simulation whose surface it is
    _of: ClassVar = ("_user", "_source")

    def __repr__(self) -> str:
        return f"SurfaceCollider(face={self.face})"


class _Facet(Shape):
    corners: Array
    radius: float
    _fields = ("corners", "radius")

    def __init__(self, corners: Array, radius: float) -> None:
        self._set(corners=corners, radius=radius)
        self._place(corners.mean(axis=0))

    def _obstacle(self, hollow: bool) -> Any:
        a, b, c = self.corners.tolist()
        return _core.Collider.triangle(a, b, c, self.radius)


class Deforming(Simulation):
    """Vertices, the triangles between which can be obstacles of other simulations."""

    positions: Any
    _dimension: int

    def make_colliders(
        self, thickness: float, *, faces: ArrayLike | None = None, friction: float = 0.0
    ) -> list[SurfaceCollider]:
        """Make obstacles of another simulation that represent the surface, one for each triangle.

        Parameters
        ----------
        thickness : float
            Of the obstacles [m], above 0: behind a closed surface, else half on each side. What
            meets it should resolve it (docs/coupling.md).
        faces : array_like of int, shape (m, 3), optional
            Vertices of the triangles, which look outward if the surface is closed; the `faces` of
            this object unless given.
        friction : float
            Coefficient of Coulomb friction, at least 0.

        Returns
        -------
        list of SurfaceCollider
            Where the triangles are now. Give them to one simulation, among its `colliders`, and put
            both into a `World`; call this again for another simulation.

        Raises
        ------
        InputError
            If an argument is wrong, there are no faces, or motion is in the plane.

        Examples
        --------
        >>> import substep
        >>> mesh = substep.geometry.grid_mesh(3, 3)
        >>> cloth = substep.MassSpring.from_mesh(mesh, density=0.2, stiffness=100.0)
        >>> len(cloth.make_colliders(0.05))
        8
        """
        if self._dimension != 3:
            raise InputError("make_colliders: motion in the plane has no surface")
        given = getattr(self, "faces", None) if faces is None else faces
        if given is None:
            raise InputError("faces: expected those of the surface, as this object has none")
        x = np.array(self.positions, np.float64)
        triangles = check_indices("faces", given, 3, len(x))
        radius = 0.5 * check_real("thickness", thickness, positive=True)
        sheet = Sheet(triangles, radius, _is_closed(triangles))
        made = []
        for k, corners in enumerate(sheet.corners(x)):
            collider = SurfaceCollider(_Facet(corners, radius), friction=friction)
            collider.__dict__.update(face=k, _sheet=sheet, _source=self)
            made.append(collider)
        return made


def _is_closed(faces: NDArray[np.int64]) -> bool:
    """Whether each edge is that of two triangles, which turn it opposite ways."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there = {(int(a), int(b)) for a, b in edges}
    return len(there) == len(edges) > 0 and all((b, a) in there for a, b in there)
