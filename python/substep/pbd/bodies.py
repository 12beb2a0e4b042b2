"""Constraints of whole bodies: ropes, cloth, soft solids."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..base.checks import (
    MOST_INT,
    as_array,
    check_array,
    check_choice,
    check_flag,
    check_integer,
    check_real,
    in_range,
)
from ..errors import InputError
from ..geometry import TetMesh, TriangleMesh
from ..geometry.topology import Indices, check_indices
from . import rest
from .constraints import Bending, Distance, IsometricBending, NeoHookean, Tether, TetrahedronVolume
from .group import Constraint


def rope(
    count: int,
    *,
    first: int = 0,
    closed: bool = False,
    compliance: float = 0.0,
    bending_compliance: float | None = None,
    damping: float = 0.0,
) -> list[Constraint]:
    """Constraints of a rope: particles `first`, `first` + 1, ... one after the other.

    Parameters
    ----------
    count : int
        Number of particles, at least 2 (3 if closed).
    first : int
        The first particle.
    closed : bool
        Join the last to the first.
    compliance : float
        Of each segment [m/N], at least 0; 0 is inextensible.
    bending_compliance : float, optional
        Of the distance between particles two segments apart [m/N]: bends more easily the larger it
        is. Without it the rope bends freely.
    damping : float
        Of both [N s/m], at least 0; acts where the compliance is above 0.

    Returns
    -------
    list of Constraint
        For `PositionBasedDynamics`.

    Raises
    ------
    InputError
        If an argument is wrong.

    Examples
    --------
    >>> import numpy as np, substep
    >>> x = np.zeros((21, 3))
    >>> x[:, 0] = np.linspace(0, 1, 21)
    >>> line = substep.PositionBasedDynamics(
    ...     x, 0.01, substep.pbd.rope(21), pinned=[0, 20], substeps=40)
    >>> line.advance(1.0)
    >>> bool(np.linalg.norm(np.diff(line.positions, axis=0), axis=1).max() < 0.0505)
    True
    """
    closed = check_flag("closed", closed)
    n = check_integer("count", count, minimum=3 if closed else 2, maximum=MOST_INT)
    start = check_integer("first", first, minimum=0, maximum=MOST_INT)
    number = np.arange(n)

    def segments(step: int, compliance: float) -> Distance:
        ends = np.stack([number, (number + step) % n], axis=1)
        if not closed:
            ends = ends[: n - step]
        return Distance(start + ends, compliance=compliance, damping=damping if compliance else 0)

    constraints: list[Constraint] = [segments(1, check_real("compliance", compliance))]
    if bending_compliance is not None and n > 2 + 2 * closed:
        constraints.append(segments(2, check_real("bending_compliance", bending_compliance)))
    return constraints


def cloth(
    mesh: TriangleMesh,
    *,
    first: int = 0,
    compliance: float = 0.0,
    rigidity: float | None = None,
    bending: str = "isometric",
    damping: float = 0.0,
) -> list[Constraint]:
    """Constraints of a cloth: the lengths of the edges of a mesh, and bending about them.

    Parameters
    ----------
    mesh : TriangleMesh
        The cloth at rest.
    first : int
        The particle that is vertex 0.
    compliance : float
        Of each edge [m/N], at least 0; 0 is inextensible.
    rigidity : float, optional
        Flexural rigidity D [J], above 0: E t^3 / (12 (1 - nu^2)) of a plate of thickness t. Without
        it the cloth bends freely.
    bending : {'isometric', 'dihedral'}
        Which constraint bends: `IsometricBending`, or `Bending` with the compliance of each hinge
        that gives the same rigidity, which distinguishes the two senses of a bend.
    damping : float
        Of the edges [N s/m], at least 0; acts where the compliance is above 0.

    Returns
    -------
    list of Constraint
        `Distance` and bending, for `PositionBasedDynamics`.

    Raises
    ------
    InputError
        If an argument is wrong.

    References
    ----------
    Grinspun, Hirani, Desbrun and Schroeder, "Discrete shells", SCA 2003, eq. 3 (3 |e|^2 / (A_1 +
    A_2), the stiffness of a hinge); Bergou et al., "A quadratic bending model for inextensible
    surfaces", SGP 2006.

    Examples
    --------
    >>> import substep
    >>> sheet = substep.geometry.grid_mesh(21, 21)
    >>> flag = substep.PositionBasedDynamics(
    ...     sheet.vertices, 0.2 * sheet.vertex_areas, substep.pbd.cloth(sheet, rigidity=1e-5),
    ...     pinned=[0, 20])
    >>> flag.advance(0.1)
    >>> [len(c) for c in flag.constraints]
    [1240, 1160]
    """
    if not isinstance(mesh, TriangleMesh):
        raise InputError(f"mesh: expected a TriangleMesh, got {type(mesh).__name__}")
    start = check_integer("first", first, minimum=0, maximum=MOST_INT)
    x, hinges = mesh.vertices, mesh.hinges
    compliance = check_real("compliance", compliance, nonnegative=True)
    stretch = Distance(
        start + mesh.edges,
        np.linalg.norm(x[mesh.edges[:, 0]] - x[mesh.edges[:, 1]], axis=1),
        compliance=compliance,
        damping=damping if compliance else 0,
    )
    if rigidity is None or len(hinges) == 0:
        return [stretch]
    stiffness = check_real("rigidity", rigidity, positive=True)
    if check_choice("bending", bending, ("isometric", "dihedral")) == "isometric":
        padded = np.concatenate([np.zeros((start, 3)), x])
        bend: Constraint = IsometricBending(
            start + hinges, rest_positions=padded, compliance=1 / stiffness
        )
    else:
        areas, squares = rest.hinge_areas(x, hinges)
        soft = areas / np.where(squares > 0, stiffness * squares, np.inf)
        bend = Bending(start + hinges, rest_angles=rest.dihedral_angles(x, hinges), compliance=soft)
    return [stretch, bend]


def soft_body(
    mesh: TetMesh,
    *,
    young_modulus: ArrayLike | None = None,
    poisson_ratio: ArrayLike = 0.4,
    first: int = 0,
    compliance: float = 0.0,
    damping: float = 0.0,
    damping_time: float = 0.0,
) -> list[Constraint]:
    """Constraints of a soft solid: elastic tetrahedra, or their edges and volumes.

    Parameters
    ----------
    mesh : TetMesh
        The solid at rest.
    young_modulus : float or array_like, shape (m,), optional
        E of the tetrahedra [Pa], above 0: then they are `NeoHookean`. Without it, edges and volumes
        are kept by `Distance` and `TetrahedronVolume`: cheaper, but how stiff the solid is then
        depends on the mesh.
    poisson_ratio : float or array_like, shape (m,)
        nu, above -1 and below 0.5; only with `young_modulus`.
    first : int
        The particle that is vertex 0.
    compliance : float
        Of each edge [m/N], at least 0; only without `young_modulus`. Volumes have none.
    damping : float
        Of the edges [N s/m], at least 0; only without `young_modulus`.
    damping_time : float
        Damping time [s], at least 0; only with `young_modulus`.

    Returns
    -------
    list of Constraint
        For `PositionBasedDynamics`.

    Raises
    ------
    InputError
        If an argument is wrong.

    Examples
    --------
    >>> import substep
    >>> ball = substep.geometry.tetrahedralize(substep.geometry.sphere_mesh(0.1), 0.04)
    >>> body = substep.PositionBasedDynamics(
    ...     ball.vertices, 1000 * ball.vertex_volumes,
    ...     substep.pbd.soft_body(ball, young_modulus=1e5),
    ...     colliders=[substep.Plane(point=(0, 0, -0.2))])
    >>> body.advance(0.2)
    >>> bool(body.positions[:, 2].min() > -0.2)
    True
    """
    if not isinstance(mesh, TetMesh):
        raise InputError(f"mesh: expected a TetMesh, got {type(mesh).__name__}")
    start = check_integer("first", first, minimum=0, maximum=MOST_INT)
    x, tets = mesh.vertices, mesh.tetrahedra
    compliance = check_real("compliance", compliance, nonnegative=True)
    damping = check_real("damping", damping, nonnegative=True)
    damping_time = check_real("damping_time", damping_time, nonnegative=True)
    if young_modulus is not None:
        if compliance:
            raise InputError("compliance: it follows from young_modulus where that is given")
        if damping:
            raise InputError("damping: with a young_modulus it is damping_time [s]")
        padded = np.concatenate([np.zeros((start, 3)), x])
        return [
            NeoHookean(
                start + tets,
                young_modulus,
                poisson_ratio,
                rest_positions=padded,
                damping_time=damping_time,
            )
        ]
    if damping_time:
        raise InputError("damping_time: expected a young_modulus with it")
    lengths = np.linalg.norm(x[mesh.edges[:, 0]] - x[mesh.edges[:, 1]], axis=1)
    return [
        Distance(
            start + mesh.edges,
            lengths,
            compliance=compliance,
            damping=damping if compliance else 0,
        ),
        TetrahedronVolume(start + tets, rest_volumes=mesh.volumes),
    ]


def tethers(
    positions: ArrayLike,
    edges: ArrayLike,
    pins: ArrayLike,
    *,
    slack: float = 1.0,
    compliance: ArrayLike = 0.0,
) -> Tether:
    """Tethers from each particle to its nearest pin, as long as the way there along edges.

    Parameters
    ----------
    positions : array_like, shape (n, 3)
        The shape at rest [m].
    edges : array_like of int, shape (k, 2)
        Pairs of particles, as `TriangleMesh.edges`.
    pins : array_like of int
        Particles that hold the others; those they are not connected with get no tether.
    slack : float
        Length of a tether over that of the way, above 0.
    compliance : float
        Of each tether [m/N], at least 0.

    Returns
    -------
    Tether
        Pairs (pin, particle).

    Raises
    ------
    InputError
        If an argument is wrong, or nothing is connected with a pin.

    References
    ----------
    Kim, Chentanez and Mueller, "Long range attachments", SCA 2012, section 3.2 (the geodesic
    variant, with ways along edges).

    Examples
    --------
    >>> import substep
    >>> held = substep.pbd.tethers([[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 1], [1, 2]], [0])
    >>> held.particles.tolist(), held.lengths
    ([[0, 1], [0, 2]], array([1., 2.]))
    """
    x = check_array("positions", positions, (None, 3))
    pairs = check_indices("edges", edges, 2, len(x))
    sources = check_indices("pins", as_array("pins", pins).reshape(-1, 1), 1, len(x))[:, 0]
    factor = check_real("slack", slack, positive=True)
    lengths, nearest = rest.path_lengths(x, pairs, sources)
    held: Indices = np.flatnonzero((nearest >= 0) & (lengths > 0))
    if len(held) == 0:
        raise InputError("pins: no particle is connected with a pin")
    with in_range("slack, positions"):
        longest = factor * lengths[held]
    return Tether(
        np.stack([nearest[held], held], axis=1),
        lengths=longest,
        compliance=compliance,
    )
