"""Tetrahedral meshes."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..base.attributes import Frozen
from ..base.checks import check_array
from ..base.rows import read_only
from ..errors import InputError
from .tet_locate import barycentric, locate
from .topology import Array, Indices, check_indices, check_vertices, equal_rows
from .triangle_mesh import TriangleMesh

_SIDES = [(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)]  # of a tetrahedron, looking outward
_EDGES = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


class TetMesh(Frozen):
    """A solid of tetrahedra.

    Parameters
    ----------
    vertices : array_like, shape (n, 3)
        Positions [m].
    tetrahedra : array_like of int, shape (m, 4)
        Vertices of the tetrahedra; at least one. Those of negative volume have their last two
        vertices swapped.

    Attributes
    ----------
    vertices : ndarray, shape (n, 3)
        Positions [m], read-only.
    tetrahedra : ndarray of int64, shape (m, 4)
        Tetrahedra of positive volume (b - a, c - a, d - a right-handed), read-only.
    flipped : int
        How many were of negative volume.
    lacks : list of str
        What `tetrahedralize` lost of the surface that it filled, in plain words.

    Raises
    ------
    InputError
        If a position is not finite, an index is out of range, a tetrahedron has a vertex twice or
        no volume.

    Examples
    --------
    >>> import substep
    >>> beam = substep.geometry.box_tetrahedra((3, 1, 1), (3, 1, 1))
    >>> len(beam.tetrahedra), round(beam.volume, 12)
    (18, 3.0)
    """

    def __init__(self, vertices: ArrayLike, tetrahedra: ArrayLike) -> None:
        self.vertices: Array = read_only(check_vertices("vertices", vertices))
        tets = check_indices("tetrahedra", tetrahedra, 4, len(self.vertices))
        volumes = self._signed_volumes(tets)
        bad = volumes == 0
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(f"tetrahedra[{row}]: no volume, vertices {tets[row].tolist()}")
        inverted = volumes < 0
        tets[inverted] = tets[inverted][:, [0, 1, 3, 2]]
        self.flipped = int(inverted.sum())
        self.lacks: list[str] = []
        self.tetrahedra: Indices = read_only(tets)

    def __repr__(self) -> str:
        return f"TetMesh({len(self.vertices)} vertices, {len(self.tetrahedra)} tetrahedra)"

    def _signed_volumes(self, tets: Indices) -> Array:
        a, b, c, d = (self.vertices[tets[:, i]] for i in range(4))
        volumes: Array = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6
        return volumes

    @cached_property
    def volumes(self) -> Array:
        """Volumes [m^3], shape (m,)."""
        return read_only(self._signed_volumes(self.tetrahedra))

    @cached_property
    def dihedral_angles(self) -> Array:
        """Angles between the faces of each tetrahedron [rad], shape (m, 6).

        Slivers have angles near 0 or pi; the best there is has all at arccos(1/3) = 1.23.
        """
        x = self.vertices[self.tetrahedra]
        normals = np.stack(
            [np.cross(x[:, b] - x[:, a], x[:, c] - x[:, a]) for a, b, c in _SIDES], axis=1
        )
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        cosines = [-np.einsum("ij,ij->i", normals[:, a], normals[:, b]) for a, b in _EDGES]
        return read_only(np.arccos(np.clip(np.stack(cosines, axis=1), -1, 1)))

    @property
    def volume(self) -> float:
        """Sum of the volumes [m^3]."""
        return float(self.volumes.sum())

    @cached_property
    def vertex_volumes(self) -> Array:
        """A quarter of the volumes of the tetrahedra at each vertex [m^3], shape (n,)."""
        quarters = np.repeat(self.volumes / 4, 4)
        return read_only(np.bincount(self.tetrahedra.ravel(), quarters, len(self.vertices)))

    @cached_property
    def edges(self) -> Indices:
        """Each edge once, (lower, higher vertex), sorted; shape (k, 2)."""
        ends = np.sort(self.tetrahedra[:, _EDGES].reshape(-1, 2), axis=1)
        keys = np.unique(ends[:, 0] * len(self.vertices) + ends[:, 1])
        return read_only(np.stack(np.divmod(keys, len(self.vertices)), axis=1))

    @cached_property
    def surface_faces(self) -> Indices:
        """Faces of one tetrahedron only, looking outward, as vertex numbers; shape (k, 3)."""
        faces = self.tetrahedra[:, _SIDES].reshape(-1, 3)
        first, count, _ = equal_rows(np.sort(faces, axis=1))
        return read_only(faces[np.sort(first[count == 1])])

    def embed(self, points: ArrayLike) -> tuple[Indices, Array]:
        """Tie points to tetrahedra, so that they follow when these are deformed.

        The points of deformed vertices x are ``(weights[..., None] * x[cells]).sum(axis=1)``: so a
        fine surface follows a coarse solid.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            Points [m]; those outside are tied to the tetrahedron of the nearest surface point.

        Returns
        -------
        cells : ndarray of int64, shape (n, 4)
            Vertices of the tetrahedron of each point.
        weights : ndarray, shape (n, 4)
            Barycentric coordinates: they sum to 1 and are above 0 inside.
        """
        x = check_array("points", points, (None, 3))
        cell = locate(self.vertices, self.tetrahedra, x)
        lost = cell < 0
        if lost.any():
            sides = np.sort(self.tetrahedra[:, _SIDES], axis=2)
            shell = TriangleMesh(self.vertices, self.surface_faces)
            faces = np.sort(shell.faces[shell.nearest(x[lost])[2]], axis=1)
            first, _, number = equal_rows(np.concatenate([sides.reshape(-1, 3), faces]))
            owner = np.empty(len(first), np.int64)
            owner[number[: 4 * len(self.tetrahedra)]] = np.repeat(
                np.arange(len(self.tetrahedra)), 4
            )
            cell[lost] = owner[number[4 * len(self.tetrahedra) :]]
        cells = self.tetrahedra[cell]
        return cells, barycentric(self.vertices, cells, x)

    def surface(self) -> tuple[TriangleMesh, Indices]:
        """The surface as a mesh of its own, and the number of each of its vertices in this one."""
        used, faces = np.unique(self.surface_faces, return_inverse=True)
        return TriangleMesh(self.vertices[used], faces.reshape(-1, 3)), used
