"""Mass-spring systems (cloth, nets, chains and ropes) and soft bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import (
    MOST_INT,
    as_array,
    check_array,
    check_integer,
    check_positive,
    check_real,
    in_range,
)
from ..geometry import Collider, Shape, TriangleMesh
from ..geometry.topology import check_indices
from ..geometry.triangle_mesh import check_mesh
from .deformable import Array, Deformable


@dataclass(frozen=True)
class SpringInfo:
    """What is out of the ordinary in a mass-spring system.

    Attributes
    ----------
    degenerate : ndarray of int64, shape (k,)
        Springs whose ends coincide, so that they have no direction and pull nowhere.
    """

    degenerate: NDArray[np.int64]


class MassSpring(Deformable):
    """Vertices with masses, connected by springs.

    A spring pulls with k (l - r) along itself, l its length and r that at rest, and its damper with
    c times the rate at which l changes. A spring whose ends coincide pulls nowhere.

    Parameters
    ----------
    positions : array_like, shape (n, 3)
        Initial positions [m]; copied.
    edges : array_like of int, shape (m, 2)
        The two vertices of each spring.
    stiffness : float or array_like, shape (m,)
        k [N/m], at least 0.
    masses : float or array_like, shape (n,)
        [kg], above 0.
    damping : float or array_like, shape (m,)
        c [N s/m], at least 0.
    rest_lengths : array_like, shape (m,), optional
        r [m], at least 0; the initial lengths unless given.
    faces : array_like of int, shape (k, 3), optional
        Triangles, for pictures and recordings; without them the springs are drawn.
    velocities : array_like, shape (n, 3), optional
        Initial ones [m/s]; 0 unless given.
    pinned : array_like of int or bool
        Indices of vertices, or one boolean each; see `targets`.
    drag : float
        a [1/s]: a force -a m v on each vertex.
    gravity : array_like, shape (3,)
        [m/s^2].
    colliders : sequence of Collider
        Obstacles; they belong to this object from now on.
    integrator : str
        'implicit_euler' (default), 'symplectic_euler', 'velocity_verlet', 'rk4' or
        'euler'.
    step : float, optional
        Size of the steps of `advance` [s], which explicit integrators shorten to equal ones that
        fill its duration; unless given 1/60, or half of `step_limit()` where that is less.
    solver : {'newton', 'projective'}
        How implicit Euler finds its minimum: 'newton', to the tolerance, or 'projective': a
        fixed number of cheap iterations, which do not reach it; for springs without colliders.
    tolerance : float, optional
        Largest component of the gradient that is left, a force [N]; unless given a thousandth
        of the weight of a mean vertex.
    max_iterations : int, optional
        Of one minimisation: 100 for 'newton'; exactly so many, 10, for 'projective'.
    on_fail : {'substep', 'raise'}
        'substep': a step that does not converge is done again in halves, up to 2^8; or
        'raise'.
    contact_margin, contact_stiffness, sticking_speed : float
        For implicit Euler: the distance below which colliders push [m], the stiffness of that
        [N/m] (m / h^2 for each vertex unless given), and the sliding speed below which
        contact counts as sticking [m/s].
    time : float
        Initial time [s].
    threads : int, optional
        Of the native loops; results do not depend on it.

    Raises
    ------
    InputError
        If an argument is wrong, with its name.

    References
    ----------
    Baraff and Witkin, "Large steps in cloth simulation", SIGGRAPH 1998; Martin et al.,
    "Example-based elastic materials", SIGGRAPH 2011, eq. 2; Li et al., "Incremental potential
    contact", SIGGRAPH 2020.

    Examples
    --------
    A mass of 1 kg comes to rest on a spring where its weight stretches it by m g / k.

    >>> import substep
    >>> net = substep.MassSpring(
    ...     [[0, 0, 0], [0, 0, -1]], [[0, 1]], stiffness=981.0, masses=1.0, damping=50.0, pinned=[0]
    ... )
    >>> net.advance(3.0)
    >>> net.positions[1].round(4).tolist()
    [0.0, 0.0, -1.01]
    """

    edges: NDArray[np.int64]
    faces: NDArray[np.int64] | None
    stiffness: Array
    damping: Array
    rest_lengths: Array

    def __init__(
        self,
        positions: ArrayLike,
        edges: ArrayLike,
        stiffness: ArrayLike,
        masses: ArrayLike,
        *,
        damping: ArrayLike = 0.0,
        rest_lengths: ArrayLike | None = None,
        faces: ArrayLike | None = None,
        velocities: ArrayLike | None = None,
        pinned: ArrayLike = (),
        drag: float = 0.0,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        colliders: Sequence[Collider | Shape] = (),
        integrator: str = "implicit_euler",
        step: float | None = None,
        solver: str = "newton",
        tolerance: float | None = None,
        max_iterations: int | None = None,
        on_fail: str = "substep",
        contact_margin: float = 1e-3,
        contact_stiffness: float | None = None,
        sticking_speed: float = 1e-3,
        time: float = 0.0,
        threads: int | None = None,
    ) -> None:
        x = check_array("positions", positions, (None, 3))
        empty = as_array("edges", edges).size == 0
        pairs = np.zeros((0, 2), np.int64) if empty else check_indices("edges", edges, 2, len(x))
        self.edges = pairs
        self.faces = None if faces is None else check_indices("faces", faces, 3, len(x))
        m = len(pairs)
        self.stiffness = check_positive("stiffness", stiffness, m, zero=True)
        self.damping = check_positive("damping", damping, m, zero=True)
        with in_range("positions"):
            lengths = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
        if rest_lengths is not None:
            lengths = check_positive("rest_lengths", rest_lengths, m, zero=True)
        self.rest_lengths = lengths
        for constant in (self.edges, self.stiffness, self.damping, self.rest_lengths):
            constant.flags.writeable = False
        self._set_up(
            x,
            check_positive("masses", masses, len(x)),
            velocities=velocities,
            pinned=pinned,
            drag=drag,
            gravity=gravity,
            colliders=colliders,
            integrator=integrator,
            step=step,
            solver=solver,
            tolerance=tolerance,
            max_iterations=max_iterations,
            on_fail=on_fail,
            contact_margin=contact_margin,
            contact_stiffness=contact_stiffness,
            sticking_speed=sticking_speed,
            time=time,
            threads=threads,
        )

    def _terms(self) -> list[Any]:
        terms: list[Any] = _core.spring_terms(
            self.edges.astype(np.int32),
            self.stiffness,
            self.rest_lengths,
            self.damping if self.damping.any() else np.zeros(0),
        )
        return terms

    @classmethod
    def from_mesh(
        cls,
        mesh: TriangleMesh,
        *,
        density: float,
        stiffness: float,
        bending: float = 0.05,
        damping_time: float = 0.0,
        velocities: ArrayLike | None = None,
        pinned: ArrayLike = (),
        drag: float = 0.0,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        colliders: Sequence[Collider | Shape] = (),
        integrator: str = "implicit_euler",
        step: float | None = None,
        solver: str = "newton",
        tolerance: float | None = None,
        max_iterations: int | None = None,
        on_fail: str = "substep",
        contact_margin: float = 1e-3,
        contact_stiffness: float | None = None,
        sticking_speed: float = 1e-3,
        time: float = 0.0,
        threads: int | None = None,
    ) -> MassSpring:
        """Make a cloth of any triangle mesh.

        Every edge is a spring; across every edge between two triangles another joins the two
        opposite corners, which resists bending (and shear).

        Parameters
        ----------
        mesh : TriangleMesh
            The surface at rest.
        density : float
            Mass per area [kg/m^2]; a vertex has a third of that of its triangles, or, where these
            are flat, what a mean vertex has.
        stiffness : float
            Of the springs along edges [N/m].
        bending : float
            Stiffness of the springs across edges, as a part of `stiffness`.
        damping_time : float
            Of all springs [s]: c = damping_time times k.
        velocities, pinned, drag, gravity, colliders, integrator, step, solver, tolerance,
        max_iterations, on_fail, contact_margin, contact_stiffness, sticking_speed, time, threads
            As for `MassSpring`.

        Returns
        -------
        MassSpring
            The cloth.

        Examples
        --------
        >>> import substep
        >>> mesh = substep.geometry.grid_mesh(5, 5)
        >>> cloth = substep.MassSpring.from_mesh(mesh, density=0.3, stiffness=1e3, pinned=[0, 4])
        >>> cloth.advance(0.5)
        >>> len(cloth.edges), bool(cloth.positions[:, 2].min() < -0.5)
        (96, True)
        """
        pairs = np.concatenate([check_mesh(mesh).edges, mesh.hinges[:, 2:]])
        k = np.full(len(pairs), check_real("stiffness", stiffness, nonnegative=True))
        with in_range("stiffness, bending"):
            k[len(mesh.edges) :] *= check_real("bending", bending, nonnegative=True)
        keep = pairs[:, 0] != pairs[:, 1]
        pairs, k = pairs[keep], k[keep]
        areas = mesh.vertex_areas.copy()
        areas[areas == 0] = areas[areas > 0].mean() if areas.any() else 1.0
        with in_range("density, damping_time"):
            masses = check_real("density", density, positive=True) * areas
            lagging = check_real("damping_time", damping_time, nonnegative=True) * k
        return cls(
            mesh.vertices,
            pairs,
            k,
            masses,
            damping=lagging,
            faces=mesh.faces,
            velocities=velocities,
            pinned=pinned,
            drag=drag,
            gravity=gravity,
            colliders=colliders,
            integrator=integrator,
            step=step,
            solver=solver,
            tolerance=tolerance,
            max_iterations=max_iterations,
            on_fail=on_fail,
            contact_margin=contact_margin,
            contact_stiffness=contact_stiffness,
            sticking_speed=sticking_speed,
            time=time,
            threads=threads,
        )

    @property
    def info(self) -> SpringInfo:
        """What is out of the ordinary at the present positions."""
        ends = self.positions[self.edges]
        return SpringInfo(np.flatnonzero((ends[:, 0] == ends[:, 1]).all(axis=1)))


def grid_springs(
    n: int, m: int, *, stiffness: float = 1.0, shear: float = 0.5, bending: float = 0.05
) -> tuple[NDArray[np.int64], Array]:
    """Springs of a rectangular cloth of n by m vertices, the order of `geometry.grid_mesh`.

    Parameters
    ----------
    n, m : int
        Vertices in each direction.
    stiffness : float
        Of the springs between neighbours in a row or column [N/m].
    shear, bending : float
        Stiffness of the diagonals, and of springs between every second vertex of a row or column,
        as parts of `stiffness`.

    Returns
    -------
    edges : ndarray of int64, shape (k, 2)
        Vertices of the springs.
    stiffness : ndarray, shape (k,)
        Theirs [N/m].

    Raises
    ------
    InputError
        If a number is wrong.

    References
    ----------
    Provot, "Deformation constraints in a mass-spring model", Graphics Interface 1995.

    Examples
    --------
    >>> import substep
    >>> edges, stiffness = substep.springs.grid_springs(3, 3, stiffness=10.0)
    >>> len(edges), float(stiffness.min())
    (26, 0.5)
    """
    rows = check_integer("n", n, minimum=1, maximum=MOST_INT)
    columns = check_integer("m", m, minimum=1, maximum=MOST_INT)
    k = check_real("stiffness", stiffness, nonnegative=True)
    across, second = (
        check_real(name, k * check_real(name, part, nonnegative=True))
        for name, part in (("shear", shear), ("bending", bending))
    )
    ids = np.arange(rows * columns).reshape(rows, columns)
    parts = [
        (ids[:-1], ids[1:], k),
        (ids[:, :-1], ids[:, 1:], k),
        (ids[:-1, :-1], ids[1:, 1:], across),
        (ids[1:, :-1], ids[:-1, 1:], across),
        (ids[:-2], ids[2:], second),
        (ids[:, :-2], ids[:, 2:], second),
    ]
    edges = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b, _ in parts])
    return edges, np.concatenate([np.full(a.size, own) for a, _, own in parts])
