"""Fine surfaces that follow coarse bodies: the skin of particles and of tetrahedra."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.attributes import Frozen
from ..base.checks import check_array, check_integer, describe
from ..base.rows import Points, read_only
from ..errors import InputError
from .tet_mesh import TetMesh
from .topology import Array, Indices
from .triangle_mesh import TriangleMesh, check_mesh

_MOST_WEIGHT = 30.0  # sum of |weights|: what noise of the points is multiplied by
_FLAT = 1e-10  # of moments: points that lie in a plane, but for rounding
_OFF = 1e-4  # of the radius: vertices off such a plane
_PAIRS = 2_000_000  # of vertices and points that are compared at once
_MORE = 4  # neighbours at a time, for vertices off the plane of theirs
_ROWS = 4096  # of vertices that are computed at once, in the cache


class Skin(Frozen):
    """A surface that follows the particles or the tetrahedra of a simulated body.

    The vertices of the skin are weighted sums of the points of the body,

        x_v = sum_i a_vi p_i,

    with weights that belong to the places at rest, so that a frame costs one sum. In a `TetMesh`
    they are the barycentric coordinates of the tetrahedron that holds the vertex. Of particles they
    are those of moving least squares: the vertex goes by the affine map that fits best how the
    nearest particles went from their rest, weighted by (1 - q^2)^2, with q the distance over 1.05
    times that of the farthest of them. Both reproduce every affine map, rigid motions among them,
    to rounding.

    Parameters
    ----------
    mesh : TriangleMesh
        The surface where the body is at rest.
    rest : TetMesh or array_like, shape (n, 3)
        The body at rest: such as `mesh` of a `SoftBody`, or positions of particles [m].
    neighbours : int
        Particles that each vertex follows, at least 8; up to twice as many where the nearest lie in
        a plane that the vertex is not in. A `TetMesh` has 4.

    Attributes
    ----------
    mesh : TriangleMesh
        The surface at rest.
    faces : ndarray of int64, shape (m, 3)
        Its triangles.
    points : int
        How many points the body has.
    cells : ndarray of int64, shape (k, j)
        The points that each vertex follows; where others follow more, the last again.
    weights : ndarray, shape (k, j)
        a_vi; the sum of each row is 1, and what is there again has 0.

    Raises
    ------
    InputError
        If an argument is wrong, or a vertex is so far from the points, or so far off the plane in
        which twice as many of the nearest lie, that they do not say where it goes.

    References
    ----------
    Levin, "The approximation power of moving least-squares", 1998; Mueller et al., "Point based
    animation of elastic, plastic and melting objects", 2004, section 3.

    Examples
    --------
    A quarter of a turn about z, of particles and so of their skin:

    >>> import numpy as np, substep
    >>> ball = substep.geometry.sphere_mesh(0.95)
    >>> x = substep.fill_box((-1, -1, -1), (1, 1, 1), 0.25)
    >>> skin = substep.geometry.Skin(ball, x)
    >>> turned = skin(x[:, [1, 0, 2]] * [-1, 1, 1])
    >>> bool(np.abs(turned - ball.vertices[:, [1, 0, 2]] * [-1, 1, 1]).max() < 1e-12)
    True
    """

    mesh: TriangleMesh
    points: int
    cells: Indices
    weights: Array

    def __init__(
        self, mesh: TriangleMesh, rest: TetMesh | ArrayLike, *, neighbours: int = 12
    ) -> None:
        self.mesh = check_mesh(mesh)
        count = check_integer("neighbours", neighbours, minimum=8, maximum=256)
        solid = rest if isinstance(rest, TetMesh) else None
        x = check_array("rest", rest, (None, 3)) if solid is None else solid.vertices
        self.points = len(x)
        if solid is None and self.points <= count:
            raise InputError(
                f"rest: expected more points than neighbours, {count}, got {self.points}"
            )
        _check_near(mesh.vertices, x)
        if solid is not None:
            cells, weights = solid.embed(mesh.vertices)
        else:
            cells, weights = _tie(mesh.vertices, x, count)
        self.cells, self.weights = read_only(cells), read_only(weights)

    def __repr__(self) -> str:
        return f"Skin({len(self.cells)} vertices on {self.points} points)"

    @property
    def faces(self) -> Indices:
        """Triangles of the surface, shape (m, 3)."""
        return self.mesh.faces

    def __call__(self, values: ArrayLike) -> Array:
        """Give the vertices of the skin where the points of the body are.

        Parameters
        ----------
        values : array_like, shape (n, 3)
            Positions of the points [m], in the order of `rest`, or their velocities [m/s].

        Returns
        -------
        ndarray, shape (k, 3)
            Positions or velocities of the vertices.

        Raises
        ------
        InputError
            If there are more or fewer points than at rest, or one is not finite.
        """
        x = check_array("values", values, (self.points, 3))
        skin = np.empty((len(self.cells), 3))
        for k in range(0, len(skin), _ROWS):
            rows = slice(k, k + _ROWS)
            np.einsum("vi,vid->vd", self.weights[rows], x[self.cells[rows]], out=skin[rows])
        return skin


class Skinned(Points):
    """Points that may have a skin."""

    _skin: Skin | None = None

    @property
    def skin(self) -> Skin | None:
        """The surface that recordings and pictures show instead; assign a `Skin`, or None."""
        return self._skin

    @skin.setter
    def skin(self, skin: Skin | None) -> None:
        if skin is not None:
            if not isinstance(skin, Skin):
                raise TypeError(f"skin: expected a Skin or None, got {describe(skin)}")
            if self._dimension != 3 or skin.points != len(self):
                raise InputError(
                    f"skin: expected one of {len(self)} points in {self._dimension}D, "
                    f"got one of {skin.points} in 3D"
                )
        self.__dict__["_skin"] = skin


def _nearest(vertices: Array, x: Array, count: int) -> tuple[Indices, Array]:
    """The nearest points of each vertex, and their distances, ascending.

    Points are sorted into cells, and each vertex looks at those in the 27 cells about it. Where the
    last of its nearest is farther than a cell is wide, another might be nearer: then again with
    cells of twice the width.
    """
    found = np.empty((len(vertices), count), np.int64)
    distances = np.empty((len(vertices), count))
    left = np.arange(len(vertices))
    low = x.min(axis=0)
    size = float((x.max(axis=0) - low).max()) / np.ceil(len(x) ** (1 / 3))
    while len(left):
        done = []
        for rows, pairs, starts in _candidates(vertices, left, x, low, size):
            many = np.diff(starts)
            d = np.linalg.norm(x[pairs] - np.repeat(vertices[rows], many, axis=0), axis=1)
            table = np.full((len(rows), max(int(many.max()), count)), np.inf)
            number = np.full(table.shape, -1)
            inside = np.arange(table.shape[1]) < many[:, None]
            table[inside], number[inside] = d, pairs
            near = np.argpartition(table, count - 1, axis=1)[:, :count]
            table, number = (np.take_along_axis(a, near, 1) for a in (table, number))
            order = np.lexsort((number, table), axis=1)  # ties by their numbers
            table, number = (np.take_along_axis(a, order, 1) for a in (table, number))
            whole = table[:, -1] <= size
            found[rows[whole]], distances[rows[whole]] = number[whole], table[whole]
            done.append(rows[whole])
        left = np.setdiff1d(left, np.concatenate(done), assume_unique=True)
        size *= 2
    return found, distances


def _candidates(vertices: Array, left: Indices, x: Array, low: Array, size: float) -> Any:
    """Rows of some vertices, the points in the cells about them, and where those of each start."""
    cell = np.floor((x - low) / size).astype(np.int64)
    shape = cell.max(axis=0) + 5  # two empty cells at both ends
    keys = ((cell[:, 0] + 2) * shape[1] + cell[:, 1] + 2) * shape[2] + cell[:, 2] + 2
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    about = np.clip(np.floor((vertices[left] - low) / size).astype(np.int64) + 2, 1, shape - 2)
    step = np.array([-1, 0, 1])
    i, j = (a.ravel() for a in np.meshgrid(step, step, indexing="ij"))
    row = ((about[:, :1] + i) * shape[1] + about[:, 1:2] + j) * shape[2] + about[:, 2:]
    start, stop = np.searchsorted(keys, row - 1, "left"), np.searchsorted(keys, row + 1, "right")
    many = (stop - start).sum(axis=1)
    first = 0
    ends = np.cumsum(many)
    while first < len(left):
        base = ends[first - 1] if first else 0
        last = max(int(np.searchsorted(ends, base + _PAIRS, "right")), first + 1)
        of, to = start[first:last].ravel(), stop[first:last].ravel()
        n = to - of
        at = np.repeat(of - (np.cumsum(n) - n), n) + np.arange(n.sum())
        yield left[first:last], order[at], np.concatenate([[0], ends[first:last] - base])
        first = last


def _tie(vertices: Array, x: Array, count: int) -> tuple[Indices, Array]:
    """The nearest points of each vertex, and their weights."""
    cells, distances = _nearest(vertices, x, count)
    if not distances[:, -1].min() ** 2 > 0:
        v = int(np.argmin(distances[:, -1]))
        raise InputError(
            f"rest: expected points at different places, got {count} at that of vertex {v}"
        )
    weights, lost = _least_squares(vertices, x, cells, distances)
    most = min(2 * count, len(x) - 1)
    while lost.any() and count < most:
        more = min(_MORE, most - count)
        count += more
        cells = np.pad(cells, ((0, 0), (0, more)), mode="edge")
        weights = np.pad(weights, ((0, 0), (0, more)))
        rows = np.flatnonzero(lost)
        cells[rows], distances = _nearest(vertices[rows], x, count)
        weights[rows], lost[rows] = _least_squares(vertices[rows], x, cells[rows], distances)
    _refuse(lost, "whose nearest points lie in no plane (more neighbours may help)")
    return cells, weights


def _least_squares(
    vertices: Array, x: Array, cells: Indices, distances: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """The weights a_vi, and which vertices have none that give affine maps.

    a_vi = w_i b_i . G^+ (1, 0, 0, 0), with b_i = (1, (p_i - x_v) / R) and G = sum w_i b_i b_i^T.

    So sum a_vi b_i = (1, 0, 0, 0) wherever G has that in its range, which is what reproduces affine
    maps; a second pass takes off what rounding left.
    """
    R = 1.05 * distances[:, -1:, None]  # where many are equally far, all of them count
    q = distances / R[..., 0]
    w = (1 - q**2) ** 2
    b = np.concatenate([np.ones((*cells.shape, 1)), (x[cells] - vertices[:, None]) / R], axis=2)
    weighted = w[..., None] * b
    inverse = np.linalg.pinv(np.einsum("via,vib->vab", weighted, b), _FLAT, hermitian=True)
    a, wanted = np.zeros(cells.shape), np.array([1.0, 0.0, 0.0, 0.0])
    for _ in range(2):
        rest = wanted - np.einsum("vi,vib->vb", a, b)
        a += np.einsum("vib,vb->vi", weighted, np.einsum("vab,vb->va", inverse, rest))
    off = np.abs(wanted - np.einsum("vi,vib->vb", a, b)).max(axis=1)
    sums = np.abs(a).sum(axis=1)
    return a, (off > _OFF) | ~(sums < _MOST_WEIGHT)


def _check_near(vertices: Array, x: Array) -> None:
    """Refuse a surface that is another size, or elsewhere."""
    low, high = x.min(axis=0), x.max(axis=0)
    reach = float((high - low).max()) / 2
    if not reach > 0:
        raise InputError("rest: expected points at different places, got all at one")
    far = ((vertices < low - reach) | (vertices > high + reach)).any(axis=1)
    _refuse(far, f"within {reach:.3g} m of the box of the points")


def _refuse(bad: NDArray[np.bool_], wanted: str) -> None:
    if bad.any():
        raise InputError(
            f"mesh: expected vertices {wanted}, got vertex {int(np.argmax(bad))} elsewhere "
            f"({int(bad.sum())} such)"
        )
