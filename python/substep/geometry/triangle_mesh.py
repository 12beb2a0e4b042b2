"""Triangle meshes: what is next to what, measures, distances."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import _core
from ..base.checks import check_array, check_real, check_threads, describe, in_range
from ..base.rows import read_only
from ..errors import InputError
from .mesh_report import MeshReport
from .shape import Shape
from .topology import Array, Indices, check_indices, check_vertices, components, equal_rows


class TriangleMesh(Shape):
    """A surface of triangles.

    Any set of triangles is accepted: open, not manifold, with duplicated or flat faces. `report`
    says which of that a mesh is.

    A mesh is a shape too: as an obstacle its signed distance is sampled with the spacing that
    `SignedDistanceField.from_mesh` chooses; as a rigid body it is ground.

    Parameters
    ----------
    vertices : array_like, shape (n, 3)
        Positions [m].
    faces : array_like of int, shape (m, 3)
        Vertices of the triangles, counter-clockwise seen from outside; at least one triangle.

    Attributes
    ----------
    vertices : ndarray, shape (n, 3)
        Positions [m], read-only.
    faces : ndarray of int64, shape (m, 3)
        Triangles, read-only.
    dropped : int
        Faces with a corner twice that were left out when the mesh was read or cleaned.

    Raises
    ------
    InputError
        If a position is not finite, an index is out of range, or a triangle has a vertex twice.

    Examples
    --------
    >>> import substep
    >>> mesh = substep.geometry.TriangleMesh(
    ...     [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]
    ... )
    >>> mesh.edges.tolist()
    [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]
    >>> mesh.hinges.tolist()
    [[0, 2, 3, 1]]
    >>> float(mesh.area)
    1.0
    """

    vertices: Array
    faces: Indices
    dropped: int
    _fields = ("vertices", "faces")

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        points = read_only(check_vertices("vertices", vertices))
        self._set(
            vertices=points,
            faces=read_only(check_indices("faces", faces, 3, len(points))),
            dropped=0,
        )

    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def __repr__(self) -> str:
        return f"TriangleMesh({len(self.vertices)} vertices, {len(self.faces)} faces)"

    @cached_property
    def _sides(self) -> tuple[Indices, Indices, Indices]:
        """Sides of the faces, three per face: edge numbers; and edges; and faces per edge."""
        start, end = self.faces.ravel(), np.roll(self.faces, -1, axis=1).ravel()
        low, high = np.minimum(start, end), np.maximum(start, end)
        keys, edge, uses = np.unique(
            low * len(self.vertices) + high, return_inverse=True, return_counts=True
        )
        edges = np.stack(np.divmod(keys, len(self.vertices)), axis=1)
        return edge, read_only(edges), read_only(uses)

    @property
    def edges(self) -> Indices:
        """Each edge once, (lower, higher vertex), sorted; shape (k, 2)."""
        return self._sides[1]

    @property
    def edge_uses(self) -> Indices:
        """Number of faces at each edge: 1 on the border, 2 inside, more where not manifold."""
        return self._sides[2]

    @cached_property
    def hinges(self) -> Indices:
        """Pairs of faces about an edge, shape (h, 4): the edge (a, b), then the two other corners.

        The first of the two faces runs from a to b: with consistent orientation they are
        (a, b, c) and (b, a, d). An edge with n > 2 faces gives n - 1 hinges, each face with the
        next in the order of `faces`.
        """
        order = np.argsort(self._sides[0], kind="stable")
        edge = self._sides[0][order]
        first = np.flatnonzero(edge[1:] == edge[:-1])
        corners = np.stack([self.faces, *(np.roll(self.faces, -k, axis=1) for k in (1, 2))], -1)
        corners = corners.reshape(-1, 3)[order]  # start, end, opposite of each side
        one, two = corners[first], corners[first + 1]
        low_first = (one[:, 0] < one[:, 1]) | (two[:, 0] < two[:, 1]) & (one[:, 0] == two[:, 0])
        swap = ~low_first[:, None]
        return read_only(
            np.hstack(
                [
                    np.sort(one[:, :2], axis=1),
                    np.where(swap, two[:, 2:], one[:, 2:]),
                    np.where(swap, one[:, 2:], two[:, 2:]),
                ]
            )
        )

    @cached_property
    def face_normals(self) -> Array:
        """Unit normals, shape (m, 3); zero for faces without area."""
        cross = self._crosses
        length = np.linalg.norm(cross, axis=1, keepdims=True)
        return read_only(np.divide(cross, length, out=np.zeros_like(cross), where=length > 0))

    @cached_property
    def _crosses(self) -> Array:
        a, b, c = (self.vertices[self.faces[:, i]] for i in range(3))
        return np.cross(b - a, c - a)

    @cached_property
    def face_areas(self) -> Array:
        """Areas [m^2], shape (m,)."""
        return read_only(0.5 * np.linalg.norm(self._crosses, axis=1))

    @cached_property
    def vertex_areas(self) -> Array:
        """A third of the areas of the faces at each vertex [m^2], shape (n,)."""
        thirds = np.repeat(self.face_areas / 3, 3)
        return read_only(np.bincount(self.faces.ravel(), thirds, len(self.vertices)))

    @property
    def area(self) -> float:
        """Sum of the areas [m^2]."""
        return float(self.face_areas.sum())

    @property
    def volume(self) -> float:
        """Enclosed volume [m^3], negative if the faces look inward; of closed meshes only.

        An open mesh gets the volume of the cones from the middle of its bounding box.
        """
        middle = 0.5 * (self.vertices.min(axis=0) + self.vertices.max(axis=0))
        return float(
            np.einsum("ij,ij->", self.vertices[self.faces[:, 0]] - middle, self._crosses) / 6
        )

    @cached_property
    def boundary_loops(self) -> list[Indices]:
        """Vertices along each border, in the direction of the faces."""
        edge, _, uses = self._sides
        border = uses[edge] == 1
        start = self.faces.ravel()[border]
        end = np.roll(self.faces, -1, axis=1).ravel()[border]
        following: dict[int, list[int]] = {}
        for a, b in zip(start[::-1].tolist(), end[::-1].tolist(), strict=True):
            following.setdefault(a, []).append(b)
        loops = []
        for first in sorted(following):
            while following.get(first):
                loop, vertex = [first], following[first].pop()
                while vertex != first and following.get(vertex):
                    loop.append(vertex)
                    vertex = following[vertex].pop()
                loops.append(read_only(np.array(loop)))
        return loops

    @cached_property
    def _tree(self) -> Any:
        return _core.TriangleTree(self.vertices, self.faces)

    def nearest(self, x: ArrayLike, threads: int | None = None) -> tuple[Array, Array, Indices]:
        """Nearest points of the surface.

        Parameters
        ----------
        x : array_like, shape (n, 3)
            Points [m].
        threads : int, optional
            Threads to use.

        Returns
        -------
        distance : ndarray, shape (n,)
            Distances, never below 0 [m].
        points : ndarray, shape (n, 3)
            The nearest points [m].
        faces : ndarray of int64, shape (n,)
            The faces they lie on.
        """
        found = self._tree.nearest(check_array("x", x, (None, 3)), check_threads(threads))
        return found[:, 0].copy(), found[:, 1:4].copy(), found[:, 4].astype(np.int64)

    def winding_number(self, x: ArrayLike, threads: int | None = None) -> Array:
        """Generalized winding number: 1 inside of a closed mesh, 0 outside, between near holes.

        It also separates inside from outside where a mesh is open, non-manifold or cuts itself. Far
        triangles are taken together: the error is below about 0.04.

        Parameters
        ----------
        x : array_like, shape (n, 3)
            Points [m].
        threads : int, optional
            Threads to use.

        Returns
        -------
        ndarray, shape (n,)
            Winding numbers.

        References
        ----------
        Jacobson, Kavan, Sorkine-Hornung (2013), ACM Trans. Graph. 32, 33, eq. (5); Barill et al.
        (2018), ACM Trans. Graph. 37, 43, section 3.2.
        """
        points = check_array("x", x, (None, 3))
        return np.asarray(self._tree.winding_number(points, check_threads(threads)))

    def signed_distance(self, x: ArrayLike, threads: int | None = None) -> Array:
        """Distance to the surface, below 0 where the winding number is above 1/2.

        A mesh whose faces look inward as a whole is turned for this.

        Parameters
        ----------
        x : array_like, shape (n, 3)
            Points [m].
        threads : int, optional
            Threads to use.

        Returns
        -------
        ndarray, shape (n,)
            Signed distances [m].
        """
        points = check_array("x", x, (None, 3))
        return np.asarray(self._tree.signed_distance(points, check_threads(threads)))

    def cleaned(self) -> TriangleMesh:
        """The mesh with vertices at the same place joined, and without superfluous parts.

        Left out are unused vertices, faces that have a corner twice after the joining, and faces
        that have the corners of an earlier one.
        """
        place, _, joined = equal_rows(self.vertices)
        faces = joined[self.faces]
        kept = faces[(faces != np.roll(faces, -1, axis=1)).all(axis=1)]
        if len(kept) == 0:
            raise InputError("faces: every face has a corner twice once the vertices are joined")
        first = equal_rows(np.sort(kept, axis=1))[0]
        used, faces = np.unique(kept[np.sort(first)], return_inverse=True)
        mesh = TriangleMesh(self.vertices[place[used]], faces.reshape(-1, 3))
        mesh._set(dropped=self.dropped + len(self.faces) - len(mesh.faces))
        return mesh

    def report(self) -> MeshReport:
        """What the mesh lacks, as a `MeshReport`; `print` it for plain words."""
        edge, edges, uses = self._sides
        forward = self.faces.ravel() < np.roll(self.faces, -1, axis=1).ravel()
        balance = np.bincount(edge, np.where(forward, 1, -1), len(edges))
        used = np.zeros(len(self.vertices), bool)
        used[self.faces] = True
        corners = self.vertices[self.faces]
        longest = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
        label = components(len(self.vertices), edges)
        return MeshReport(
            vertices=len(self.vertices),
            faces=len(self.faces),
            components=len(np.unique(label[used])),
            area=self.area,
            volume=self.volume,
            boundary_edges=int((uses == 1).sum()),
            holes=len(self.boundary_loops),
            non_manifold_edges=int((uses > 2).sum()),
            flipped_edges=int(((uses == 2) & (balance != 0)).sum()),
            duplicate_faces=len(self.faces) - len(equal_rows(np.sort(self.faces, axis=1))[0]),
            flat_faces=int((2 * self.face_areas <= 1e-10 * longest**2).sum()),
            duplicate_vertices=len(self.vertices) - len(equal_rows(self.vertices)[0]),
            unused_vertices=int((~used).sum()),
            pierced=self._tree.count_pierced(self.vertices, self.faces, edges, 0),
            dropped_faces=self.dropped,
        )

    def _fine_spacing(self) -> float:
        """1/64 of the longest side, or 1/4 of the mean thickness 2 V / A of what is thin."""
        longest = float(np.ptp(self.vertices[self.faces], axis=(0, 1)).max())
        thickness = 2 * abs(self.volume) / self.face_areas.sum()
        is_thin = not len(self.boundary_loops) and thickness > 0
        return float(min(longest / 64, thickness / 4 if is_thin else longest))

    def _sampled(
        self, spacing: float | None, offset: float, threads: int | None
    ) -> tuple[Array, float, Array]:
        """The signed distance at the nodes of a grid, less an offset; its spacing and origin."""
        low, high = self.vertices[self.faces].min((0, 1)), self.vertices[self.faces].max((0, 1))
        h = self._fine_spacing() if spacing is None else spacing
        h = check_real("spacing", h, positive=True)
        grown = check_real("offset", offset, nonnegative=True)
        pad = grown + 3 * h
        with in_range("spacing, offset"):
            cells = np.ceil((high - low + 2 * pad) / h)
            nodes = np.prod(cells + 1)
        if not nodes <= 1e8:
            raise InputError(f"spacing: {h} gives a grid of {nodes:.1e} nodes, more than 1e8")
        origin = 0.5 * (low + high - cells * h)
        shape = [int(n) + 1 for n in cells]
        values = self._tree.sample(shape, origin.tolist(), h, check_threads(threads)) - grown
        if not (values < 0).any():
            lacks = "; ".join(self.report().lacks) or "parts thinner than the spacing"
            raise InputError(
                f"mesh: no node lies inside ({lacks}); make spacing smaller than {h} or offset "
                f"larger than {grown}"
            )
        return values, h, origin

    @cached_property
    def _field(self) -> Any:
        try:
            values, h, origin = self._sampled(None, 0.0, None)
        except InputError as error:
            raise InputError(
                f"shape: cannot be sampled as an obstacle ({error}); give "
                "SignedDistanceField.from_mesh(mesh, spacing)"
            ) from None
        return _core.SampledDistance(values, origin.tolist(), h, check_threads(None))

    def _obstacle(self, hollow: bool) -> Any:
        return _core.Collider.sampled(self._field, list(self.center), hollow)

    def _rigid_shape(self) -> Any:
        if len(self.vertices) > 2**31 - 1:
            raise InputError("shape: a mesh has at most 2**31 - 1 vertices")
        return _core.RigidShape.mesh(self.vertices, self.faces.astype(np.int32))

    def _moments(self, density: float) -> Any:
        moments = _core.mesh_moments(self.vertices, self.faces, density)
        pierced = self.report().pierced
        if pierced:
            raise InputError(f"shape: the mesh cuts itself: {pierced} edges pass through a face")
        return moments


def check_mesh(mesh: Any) -> TriangleMesh:
    """An argument `mesh` that is a surface."""
    if not isinstance(mesh, TriangleMesh):
        raise TypeError(f"mesh: expected a TriangleMesh, got {describe(mesh)}")
    return mesh
