"""Meshes of simple forms."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.checks import MOST_INT, check_array, check_integer, check_real, check_sequence
from ..errors import InputError
from .tet_mesh import TetMesh
from .topology import Indices
from .triangle_mesh import TriangleMesh

_MOST_SEGMENTS = 20_000  # 400 million triangles of a sphere


def _counts(name: str, value: Any, length: int) -> list[int]:
    given = check_sequence(name, value, "integers")
    counts = [check_integer(f"{name}[{i}]", n, minimum=1) for i, n in enumerate(given)]
    if len(counts) != length:
        raise InputError(f"{name}: expected {length} numbers, got {len(counts)}")
    return counts


def _lengths(name: str, value: ArrayLike, length: int) -> list[float]:
    sides = check_array(name, value, (length,))
    if not (sides > 0).all():
        raise InputError(f"{name}: expected numbers above 0, got {sides.tolist()}")
    return [float(side) for side in sides]


def grid_mesh(n: int, m: int, size: ArrayLike = (1.0, 1.0)) -> TriangleMesh:
    """A flat sheet of n x m vertices in the plane z = 0, centred about the origin.

    Vertex i * m + j lies at (x_i, y_j). The squares are cut by diagonals that alternate as on a
    chess board, so that the sheet has no preferred direction.

    Parameters
    ----------
    n, m : int
        Vertices along x and y, at least 2 each.
    size : array_like, shape (2,)
        Lengths along x and y [m].

    Returns
    -------
    TriangleMesh
        2 (n - 1) (m - 1) faces that look along +z.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> import substep
    >>> substep.geometry.grid_mesh(64, 64)
    TriangleMesh(4096 vertices, 7938 faces)
    """
    n = check_integer("n", n, minimum=2, maximum=MOST_INT)
    m = check_integer("m", m, minimum=2, maximum=MOST_INT)
    width, depth = _lengths("size", size, 2)
    x = np.linspace(-0.5 * width, 0.5 * width, n)
    y = np.linspace(-0.5 * depth, 0.5 * depth, m)
    vertices = np.zeros((n, m, 3))
    vertices[..., 0], vertices[..., 1] = x[:, None], y
    number = np.arange(n * m).reshape(n, m)
    a, b = number[:-1, :-1], number[1:, :-1]
    d, c = number[:-1, 1:], number[1:, 1:]
    even = ((np.arange(n - 1)[:, None] + np.arange(m - 1)) % 2 == 0)[..., None]
    one = np.where(even, np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    two = np.where(even, np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    return TriangleMesh(vertices.reshape(-1, 3), np.stack([one, two], -2).reshape(-1, 3))


def box_mesh(lengths: ArrayLike = (1.0, 1.0, 1.0)) -> TriangleMesh:
    """A box of 12 triangles, centred about the origin.

    Parameters
    ----------
    lengths : array_like, shape (3,)
        Lengths of the edges [m].

    Returns
    -------
    TriangleMesh
        A closed mesh.

    Raises
    ------
    InputError
        If a length is not above 0.

    Examples
    --------
    >>> import substep
    >>> substep.geometry.box_mesh((2, 1, 1)).volume
    2.0
    """
    tets = box_tetrahedra(_lengths("lengths", lengths, 3), (1, 1, 1))
    return tets.surface()[0]


def sphere_mesh(
    radius: float = 1.0, center: ArrayLike = (0.0, 0.0, 0.0), subdivisions: int = 3
) -> TriangleMesh:
    """A sphere: an icosahedron whose triangles are cut in four again and again.

    Parameters
    ----------
    radius : float
        Radius [m]; the vertices lie on it, the faces inside.
    center : array_like, shape (3,)
        Centre [m].
    subdivisions : int
        s gives 20 * 4**s faces.

    Returns
    -------
    TriangleMesh
        A closed mesh.

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> import substep
    >>> substep.geometry.sphere_mesh(0.5, subdivisions=2)
    TriangleMesh(162 vertices, 320 faces)
    """
    radius = check_real("radius", radius, positive=True)
    middle = check_array("center", center, (3,))
    golden = (1 + 5**0.5) / 2
    corner = [[s, t * golden, 0.0] for t in (1, -1) for s in (-1, 1)]
    points = np.array([np.roll(c, k) for k in (0, 1, 2) for c in corner])
    distance = np.linalg.norm(points[:, None] - points, axis=2)
    near = np.isclose(distance, 2.0)
    faces = np.array(
        [
            (i, j, k)
            for i in range(12)
            for j in range(i + 1, 12)
            for k in range(j + 1, 12)
            if near[i, j] and near[j, k] and near[i, k]
        ]
    )
    inward = np.linalg.det(points[faces]) < 0
    faces[inward] = faces[inward][:, [0, 2, 1]]
    for _ in range(check_integer("subdivisions", subdivisions, minimum=0, maximum=9)):
        points, faces = _quarter(points, faces)
    points /= np.linalg.norm(points, axis=1)[:, None]
    return TriangleMesh(middle + radius * points, faces)


def _quarter(points: Any, faces: Indices) -> tuple[Any, Indices]:
    """Cut each triangle at the middles of its edges, which are moved onto the sphere."""
    mesh = TriangleMesh(points, faces)
    middles = points[mesh.edges].sum(axis=1)
    middles *= np.linalg.norm(points[0]) / np.linalg.norm(middles, axis=1)[:, None]
    ab, bc, ca = (len(points) + mesh._sides[0].reshape(-1, 3)).T
    a, b, c = faces.T
    parts = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    cut = np.stack([np.stack(part, axis=1) for part in parts], axis=1)
    return np.concatenate([points, middles]), cut.reshape(-1, 3)


def box_tetrahedra(lengths: ArrayLike, divisions: Any) -> TetMesh:
    """A box of tetrahedra, centred about the origin: each of its cells is cut in six.

    The six tetrahedra of a cell share its long diagonal (Kuhn's cut), the same in all cells.

    Parameters
    ----------
    lengths : array_like, shape (3,)
        Lengths of the edges [m].
    divisions : sequence of int, length 3
        Cells along x, y and z.

    Returns
    -------
    TetMesh
        6 n_x n_y n_z tetrahedra; vertex (i, j, k) is number (i (n_y + 1) + j) (n_z + 1) + k.

    Raises
    ------
    InputError
        If a number is out of range.

    References
    ----------
    Kuhn (1960), "Some combinatorial lemmas in topology", IBM J. Res. Dev. 4, 518.

    Examples
    --------
    >>> import substep
    >>> substep.geometry.box_tetrahedra((2, 1, 1), (8, 4, 4))
    TetMesh(225 vertices, 768 tetrahedra)
    """
    sides, cells = _lengths("lengths", lengths, 3), _counts("divisions", divisions, 3)
    axes = [np.linspace(-0.5 * a, 0.5 * a, n + 1) for a, n in zip(sides, cells, strict=True)]
    vertices = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(vertices)).reshape([n + 1 for n in cells])
    first = number[:-1, :-1, :-1].ravel()
    step = number[1, 0, 0], number[0, 1, 0], number[0, 0, 1]
    tets = []
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0), (1, 0, 2)):
        path = [first, first + step[i], first + step[i] + step[j], first + sum(step)]
        even = (i, j, k) in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
        tets.append(np.stack(path if even else [path[0], path[1], path[3], path[2]], axis=-1))
    return TetMesh(vertices, np.stack(tets, axis=1).reshape(-1, 4))


def revolved(radii: ArrayLike, heights: ArrayLike, segments: int) -> TriangleMesh:
    """Turn a profile, from the bottom to the top of the z axis, about that axis.

    Its ends are on the axis, and are one vertex each; any other point is a ring of `segments`.
    """
    n = check_integer("segments", segments, minimum=3, maximum=_MOST_SEGMENTS)
    r, z = np.asarray(radii, float)[1:-1], np.asarray(heights, float)
    angle = 2 * np.pi * np.arange(n) / n
    around = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rings = np.zeros((len(r), n, 3))
    rings[..., :2] = r[:, None, None] * around
    rings[..., 2] = z[1:-1, None]
    vertices = np.vstack([[[0, 0, z[0]]], rings.reshape(-1, 3), [[0, 0, z[-1]]]])
    here = 1 + np.arange(len(r) * n).reshape(-1, n)
    next_ = np.roll(here, -1, axis=1)
    bottom = np.stack([np.zeros(n, int), next_[0], here[0]], axis=-1)
    top = np.stack([np.full(n, len(vertices) - 1), here[-1], next_[-1]], axis=-1)
    a, b, c, d = here[:-1], next_[:-1], next_[1:], here[1:]
    sides = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    return TriangleMesh(vertices, np.vstack([bottom, *sides, top]))


def capsule_mesh(radius: float, length: float, segments: int) -> TriangleMesh:
    """Of a capsule, or of a sphere if it has no length."""
    rings = max(
        1, check_integer("segments", segments, minimum=3, maximum=_MOST_SEGMENTS) // 4
    )  # of half a sphere
    angle = np.linspace(0, np.pi / 2, rings + 1)
    r, z = radius * np.sin(angle), length / 2 + radius * np.cos(angle)
    r[0] = 0.0
    below = slice(None) if length > 0 else slice(None, -1)  # a sphere has one equator
    return revolved(
        np.concatenate([r[below], r[::-1]]), np.concatenate([-z[below], z[::-1]]), segments
    )


def cylinder_mesh(radius: float, length: float, segments: int) -> TriangleMesh:
    """Of a cylinder."""
    h = length / 2
    return revolved([0, radius, radius, 0], [-h, -h, h, h], segments)
