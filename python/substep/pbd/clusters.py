"""Shape matching: clusters of particles that keep their shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import _core
from ..base.checks import as_array, check_array, check_integer, check_real, check_sequence
from ..base.rows import read_only
from ..errors import InputError
from ..geometry.topology import Array, Indices, check_indices
from .group import Constraint

_MOST = np.iinfo(np.int32).max


class ShapeMatching(Constraint):
    """Keeps clusters of any number of particles in shape, without edges or elements.

    Each cluster is moved to the goals g_i = T q_i + c that are nearest to its particles: the shape
    at rest q_i, turned by the rotation R that fits best about the centre of mass c, so that
    C = sqrt(sum m_i |x_i - g_i|^2). With compliance, C^2 / (2 alpha) is the energy of springs of
    stiffness m_i / alpha to the goals. Flat, crushed and inverted clusters turn back.

    Parameters
    ----------
    clusters : sequence of array_like of int
        The particles of each cluster; those of one cluster are different. Clusters may overlap:
        then the body bends (`vertex_clusters` makes them of a mesh).
    rest_positions : array_like, shape (n, 3), optional
        All particles in the shape at rest [m]; the initial positions unless given.
    linear : float
        beta in [0, 1]: how far the goals follow a linear deformation of constant volume, T =
        (1 - beta) R + beta B / det(B)^(1/3), rather than a rotation.
    compliance : float or array_like, shape (m,)
        alpha [s^2], at least 0.
    damping : float or array_like, shape (m,)
        beta of XPBD [1/s], at least 0; acts where the compliance is above 0.
    stiffness : float or array_like, shape (m,), optional
        k in [0, 1] of plain PBD in place of compliance: what part of the error a step takes away.

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index.

    References
    ----------
    Mueller, Heidelberger, Teschner and Gross, "Meshless deformations based on shape matching",
    ACM Trans. Graph. 24 (2005), eq. 3-9.

    Examples
    --------
    A scrambled cube is a cube again.

    >>> import numpy as np, substep
    >>> cube = np.array(np.meshgrid([0, 1], [0, 1], [0, 1.0])).reshape(3, -1).T
    >>> rigid = substep.pbd.ShapeMatching([range(8)], rest_positions=cube)
    >>> x = np.random.default_rng(0).uniform(size=(8, 3))
    >>> body = substep.PositionBasedDynamics(x, 1.0, [rigid], gravity=(0, 0, 0))
    >>> body.step(0.01)
    >>> sides = np.linalg.norm(body.positions[:, None] - body.positions, axis=2)
    >>> bool(np.allclose(sides, np.linalg.norm(cube[:, None] - cube, axis=2), atol=1e-5))
    True
    """

    def __init__(
        self,
        clusters: Sequence[ArrayLike],
        *,
        rest_positions: ArrayLike | None = None,
        linear: float = 0.0,
        compliance: ArrayLike = 0.0,
        damping: ArrayLike = 0.0,
        stiffness: ArrayLike | None = None,
    ) -> None:
        given = check_sequence("clusters", clusters, "lists of particles")
        if not given:
            raise InputError("clusters: expected at least one list of particles, got none")
        rows = [as_array(f"clusters[{k}]", cluster) for k, cluster in enumerate(given)]
        members = [
            check_indices(f"clusters[{k}]", row[None], row.size, _MOST)[0]
            for k, row in enumerate(rows)
        ]
        self.starts: Indices = read_only(np.cumsum([0, *map(len, members)]))
        self.members: Indices = read_only(np.concatenate(members))
        self._set_softness(len(members), compliance, damping, stiffness)
        self.linear = check_real("linear", linear, nonnegative=True)
        if self.linear > 1:
            raise InputError(f"linear: expected a number from 0 to 1, got {self.linear}")
        self.rest_positions: Array | None = None
        if rest_positions is not None:
            x = check_array("rest_positions", rest_positions, (None, 3))
            self.rest_positions = read_only(x)
            self._check_count(len(self.rest_positions))

    def __len__(self) -> int:
        return len(self.starts) - 1

    def _groups(self, positions: Array) -> list[Any]:
        self._check_count(len(positions))
        x = positions if self.rest_positions is None else self.rest_positions
        m = len(self)
        return [
            _core.shape_matching(
                self.starts,
                self.members.astype(np.int32),
                np.ascontiguousarray(x[self.members]),
                np.array(np.broadcast_to(self.compliance, m)),
                np.array(np.broadcast_to(self.damping, m)),
                np.array(np.broadcast_to(1.0 if self.stiffness is None else self.stiffness, m)),
                self.linear,
            )
        ]

    def _check_count(self, count: int) -> None:
        wrong = (self.members < 0) | (self.members >= count)
        if wrong.any():
            at = int(np.argmax(wrong))
            cluster = int(np.searchsorted(self.starts, at, side="right")) - 1
            raise InputError(
                f"clusters[{cluster}]: expected indices from 0 to {count - 1}, "
                f"got {self.members[at]}"
            )


def vertex_clusters(edges: ArrayLike, count: int, rings: int = 1) -> list[Indices]:
    """One cluster about each vertex: it and all vertices at most `rings` edges away.

    Parameters
    ----------
    edges : array_like of int, shape (k, 2)
        Pairs of vertices, as `TriangleMesh.edges` or `TetMesh.edges`.
    count : int
        Number of vertices.
    rings : int
        How many edges far, at least 1: more make the body stiffer.

    Returns
    -------
    list of ndarray of int64
        Vertices of each cluster, in rising order, for `ShapeMatching`.

    Raises
    ------
    InputError
        If an argument is wrong.

    References
    ----------
    Rivers and James, "FastLSM: fast lattice shape matching for robust real-time deformation",
    ACM Trans. Graph. 26 (2007), section 3 (the regions).

    Examples
    --------
    >>> import substep
    >>> [c.tolist() for c in substep.pbd.vertex_clusters([[0, 1], [1, 2]], 3)]
    [[0, 1], [0, 1, 2], [1, 2]]
    """
    number = check_integer("count", count, minimum=1)
    pairs = check_indices("edges", edges, 2, number)
    next_to: list[list[int]] = [[k] for k in range(number)]
    for a, b in pairs.tolist():
        next_to[a].append(b)
        next_to[b].append(a)
    clusters = [set(near) for near in next_to]
    for _ in range(1, check_integer("rings", rings, minimum=1)):
        clusters = [set().union(*(next_to[k] for k in cluster)) for cluster in clusters]
    return [np.array(sorted(cluster), np.int64) for cluster in clusters]
