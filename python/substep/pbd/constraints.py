"""Constraints of position-based dynamics on hinges, triangles, tetrahedra, pairs and points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array, check_array, check_real, describe
from ..base.rows import read_only
from ..errors import InputError
from ..geometry.topology import Array
from . import rest
from .group import Constraint, Formula, check_each


class Distance(Constraint):
    """Pairs of particles that keep their distance: C = |x_0 - x_1| - r.

    Parameters
    ----------
    pairs : array_like of int, shape (m, 2)
        The particles of each constraint.
    rest_lengths : float or array_like, shape (m,), optional
        r [m], at least 0; the distances at the start of the simulation unless given.
    compliance : float or array_like, shape (m,)
        alpha [m/N], the inverse of a spring's stiffness, at least 0: XPBD. 0 is inextensible.
    damping : float or array_like, shape (m,)
        beta [N s/m], at least 0: of a damper beside the spring.
    stiffness : float or array_like, shape (m,), optional
        k from 0 to 1, instead of a compliance: the part of the error that a step takes away in
        plain PBD. Its value in N/m depends on the step, the masses and the mesh.

    Raises
    ------
    InputError
        If an argument is wrong, with its name.

    References
    ----------
    Mueller et al., "Position based dynamics", 2007, section 3.3; Macklin, Mueller, Chentanez,
    "XPBD", 2016, eq. 18 and 26.

    Examples
    --------
    >>> import substep
    >>> rope = substep.Distance([[0, 1], [1, 2]])
    >>> len(rope)
    2
    """

    _kind = "distance"

    def __init__(
        self,
        pairs: ArrayLike,
        rest_lengths: ArrayLike | None = None,
        *,
        compliance: ArrayLike = 0.0,
        damping: ArrayLike = 0.0,
        stiffness: ArrayLike | None = None,
    ) -> None:
        self._set_up("pairs", pairs, compliance, damping, stiffness)
        self.rest_lengths = (
            None if rest_lengths is None else check_each("rest_lengths", rest_lengths, len(self))
        )

    def _parameters(self, positions: Array) -> Array:
        if self.rest_lengths is not None:
            return np.broadcast_to(self.rest_lengths, (len(self),))[:, None]
        ends = positions[self.particles]
        return np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)[:, None]


class Bending(Constraint):
    """Keeps the angle of each pair of triangles about their common edge.

    C = theta - theta_0, with theta = 0 for a flat pair and above 0 where the outer corners rise to
    the side of the normals. A pair without an edge, or with a triangle without area, is skipped.

    Parameters
    ----------
    hinges : array_like of int, shape (m, 4)
        The edge (a, b), then the corners c and d of the triangles (a, b, c) and (b, a, d):
        `TriangleMesh.hinges`.
    rest_angles : float or array_like, shape (m,), optional
        theta_0 [rad]; the initial angles unless given.
    compliance : float or array_like, shape (m,)
        alpha [rad^2/J], at least 0; 1 / alpha is the stiffness [J/rad^2].
    damping : float or array_like, shape (m,)
        beta [J s/rad^2], at least 0; acts where the compliance is above 0.
    stiffness : float or array_like, shape (m,), optional
        k in [0, 1] of plain PBD in place of compliance: what part of the error a step takes away.

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index.

    See Also
    --------
    cloth : Bending of a whole mesh by its flexural rigidity.

    References
    ----------
    Mueller, Heidelberger, Hennix and Ratcliff, "Position based dynamics", J. Vis. Commun. Image
    Represent. 18 (2007), section 4.2; Bridson, Marino and Fedkiw, "Simulation of clothing with
    folds and wrinkles", SCA 2003, section 4 (the gradient).

    Examples
    --------
    A fold by a right angle opens again.

    >>> import numpy as np, substep
    >>> x = np.array([[0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    >>> fold = substep.pbd.Bending([[0, 1, 2, 3]], rest_angles=0.0)
    >>> fold.evaluate(x)[0].round(4).tolist()
    [1.5708]
    >>> sheet = substep.PositionBasedDynamics(x, 1.0, [fold], gravity=(0, 0, 0))
    >>> sheet.step(0.01)
    >>> bool(abs(fold.evaluate(sheet.positions)[0][0]) < 1e-3)
    True
    """

    _kind = "dihedral_bending"

    def __init__(
        self,
        hinges: ArrayLike,
        rest_angles: ArrayLike | None = None,
        *,
        compliance: ArrayLike = 0.0,
        damping: ArrayLike = 0.0,
        stiffness: ArrayLike | None = None,
    ) -> None:
        self._set_up("hinges", hinges, compliance, damping, stiffness)
        self.rest_angles = _given("rest_angles", rest_angles, len(self), low=-np.inf)

    def _parameters(self, positions: Array) -> Array:
        return _column(self.rest_angles, lambda: rest.dihedral_angles(positions, self.particles))


class IsometricBending(Constraint):
    """Keeps the mean curvature of each pair of triangles of a surface that hardly stretches.

    C = |L| - L_0, with L a weighted sum of the four positions, by cotangents of the rest shape: of
    length |e| theta / sqrt(A_1 + A_2) for small angles theta about the edge e. With
    compliance, C^2 / (2 alpha) is a third of the quadratic bending energy of Bergou et al., and
    1 / alpha the flexural rigidity of a bend into a cylinder. Cheaper than `Bending`, and linear;
    both senses of a bend are the same to it.

    Parameters
    ----------
    hinges : array_like of int, shape (m, 4)
        The edge (a, b), then the corners c and d of the triangles (a, b, c) and (b, a, d):
        `TriangleMesh.hinges`.
    rest_positions : array_like, shape (n, 3), optional
        All particles in the shape at rest [m]; the initial positions unless given.
    compliance : float or array_like, shape (m,)
        alpha [1/J], at least 0: one over the flexural rigidity.
    damping : float or array_like, shape (m,)
        beta [J s], at least 0; acts where the compliance is above 0.
    stiffness : float or array_like, shape (m,), optional
        k in [0, 1] of plain PBD in place of compliance: what part of the error a step takes away.

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index.

    References
    ----------
    Bergou, Wardetzky, Harmon, Zorin and Grinspun, "A quadratic bending model for inextensible
    surfaces", SGP 2006, eq. 2-4; Bender, Mueller and Macklin, "A survey on position based
    dynamics", Eurographics tutorials 2017, section 5 (with C = x^T Q x / 2 instead).

    Examples
    --------
    >>> import numpy as np, substep
    >>> x = np.array([[0, 0, 0], [0, 1, 0], [-1, 0.5, 0], [1, 0.5, 0]])
    >>> bend = substep.pbd.IsometricBending([[0, 1, 2, 3]], rest_positions=x)
    >>> bend.evaluate(x)[0].tolist()
    [0.0]
    >>> x[3] = np.cos(0.01), 0.5, np.sin(0.01)
    >>> float(bend.evaluate(x)[0][0].round(6))
    0.01
    """

    _kind = "isometric_bending"

    def __init__(
        self,
        hinges: ArrayLike,
        rest_positions: ArrayLike | None = None,
        *,
        compliance: ArrayLike = 0.0,
        damping: ArrayLike = 0.0,
        stiffness: ArrayLike | None = None,
    ) -> None:
        self._set_up("hinges", hinges, compliance, damping, stiffness)
        self.rest_positions = _check_rest(rest_positions, self)

    def _parameters(self, positions: Array) -> Array:
        return rest.isometric_weights(_rest(self.rest_positions, positions), self.particles)


class TriangleArea(Constraint):
    """Keeps the area of each triangle.

    C = A - A_0. A triangle without area has no direction to grow in, and is skipped.

    Parameters
    ----------
    triangles : array_like of int, shape (m, 3)
        Corners.
    rest_areas : float or array_like, shape (m,), optional
        A_0 [m^2], at least 0; the initial areas unless given.
    compliance : float or array_like, shape (m,)
        alpha [m^4/J], at least 0.
    damping : float or array_like, shape (m,)
        beta [J s/m^4], at least 0; acts where the compliance is above 0.
    stiffness : float or array_like, shape (m,), optional
        k in [0, 1] of plain PBD in place of compliance: what part of the error a step takes away.

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index.

    References
    ----------
    Bender, Mueller and Macklin, "Position-based simulation methods in computer graphics",
    Eurographics tutorials 2015, section 5.

    Examples
    --------
    >>> import numpy as np, substep
    >>> x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    >>> area = substep.pbd.TriangleArea([[0, 1, 2]], rest_areas=1.0)
    >>> sheet = substep.PositionBasedDynamics(x, 1.0, [area], gravity=(0, 0, 0))
    >>> sheet.step(0.01)
    >>> bool(abs(area.evaluate(sheet.positions)[0][0]) < 1e-3)
    True
    """

    _kind = "triangle_area"

    def __init__(
        self,
        triangles: ArrayLike,
        rest_areas: ArrayLike | None = None,
        *,
        compliance: ArrayLike = 0.0,
        damping: ArrayLike = 0.0,
        stiffness: ArrayLike | None = None,
    ) -> None:
        self._set_up("triangles", triangles, compliance, damping, stiffness)
        self.rest_areas = _given("rest_areas", rest_areas, len(self))

    def _parameters(self, positions: Array) -> Array:
        return _column(self.rest_areas, lambda: rest.triangle_areas(positions, self.particles))


class TetrahedronVolume(Constraint):
    """Keeps the volume of each tetrahedron.

    C = V - V_0, where V is negative for an inverted tetrahedron, so that it is turned back. Points
    on a line have no direction to grow in, and are skipped.

    Parameters
    ----------
    tetrahedra : array_like of int, shape (m, 4)
        Corners.
    rest_volumes : float or array_like, shape (m,), optional
        V_0 [m^3], of any sign; the initial volumes unless given.
    compliance : float or array_like, shape (m,)
        alpha [m^6/J], at least 0.
    damping : float or array_like, shape (m,)
        beta [J s/m^6], at least 0; acts where the compliance is above 0.
    stiffness : float or array_like, shape (m,), optional
        k in [0, 1] of plain PBD in place of compliance: what part of the error a step takes away.

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index.

    References
    ----------
    Mueller, Heidelberger, Hennix and Ratcliff, "Position based dynamics", J. Vis. Commun. Image
    Represent. 18 (2007), section 4.4.

    Examples
    --------
    An inverted tetrahedron turns back.

    >>> import numpy as np, substep
    >>> x = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1.0]])
    >>> volume = substep.pbd.TetrahedronVolume([[0, 1, 2, 3]], rest_volumes=1 / 6)
    >>> solid = substep.PositionBasedDynamics(x, 1.0, [volume], gravity=(0, 0, 0))
    >>> solid.step(0.01)
    >>> bool(abs(volume.evaluate(solid.positions)[0][0]) < 1e-3)
    True
    """

    _kind = "tetrahedron_volume"

    def __init__(
        self,
        tetrahedra: ArrayLike,
        rest_volumes: ArrayLike | None = None,
        *,
        compliance: ArrayLike = 0.0,
        damping: ArrayLike = 0.0,
        stiffness: ArrayLike | None = None,
    ) -> None:
        self._set_up("tetrahedra", tetrahedra, compliance, damping, stiffness)
        self.rest_volumes = _given("rest_volumes", rest_volumes, len(self), low=-np.inf)

    def _parameters(self, positions: Array) -> Array:
        return _column(
            self.rest_volumes, lambda: rest.tetrahedron_volumes(positions, self.particles)
        )


class Tether(Constraint):
    """Lets no pair of particles be further apart than a length (long-range attachment).

    C = l - d >= 0: nothing while slack. From each particle of a hanging cloth to its nearest pin,
    they carry the pin's hold through the whole cloth in one sweep (`tethers` finds them).

    Parameters
    ----------
    pairs : array_like of int, shape (m, 2)
        Particles; commonly the first of them pinned.
    lengths : float or array_like, shape (m,), optional
        l [m], at least 0; the initial distances unless given.
    compliance : float or array_like, shape (m,)
        alpha [m/N], at least 0.
    damping : float or array_like, shape (m,)
        beta [N s/m], at least 0; acts where the compliance is above 0.
    stiffness : float or array_like, shape (m,), optional
        k in [0, 1] of plain PBD in place of compliance: what part of the error a step takes away.

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index.

    References
    ----------
    Kim, Chentanez and Mueller, "Long range attachments", SCA 2012.

    Examples
    --------
    A ball on a string of 1 m falls until the string is taut.

    >>> import substep
    >>> string = substep.pbd.Tether([[0, 1]], lengths=1.0)
    >>> ball = substep.PositionBasedDynamics([[0.0, 0, 0], [0, 0, -0.5]], 1.0, [string], pinned=[0])
    >>> ball.advance(1.0)
    >>> bool(abs(ball.positions[1, 2] + 1) < 1e-3)
    True
    """

    _kind = "tether"

    def __init__(
        self,
        pairs: ArrayLike,
        lengths: ArrayLike | None = None,
        *,
        compliance: ArrayLike = 0.0,
        damping: ArrayLike = 0.0,
        stiffness: ArrayLike | None = None,
    ) -> None:
        self._set_up("pairs", pairs, compliance, damping, stiffness)
        self.lengths = _given("lengths", lengths, len(self))

    def _parameters(self, positions: Array) -> Array:
        ends = positions[self.particles]
        return _column(self.lengths, lambda: np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1))


class Attachment(Constraint):
    """Holds particles at targets, softly with compliance.

    C = |x - t|, so that with compliance each is tied to its target by a spring of stiffness
    1 / alpha and no length. (A particle that is to be somewhere exactly is better pinned.)

    Parameters
    ----------
    particles : array_like of int, shape (m,)
        Which are held.
    targets : array_like, shape (m, 3), optional
        t [m]; the initial positions unless given. `PositionBasedDynamics.set_targets` moves them.
    compliance : float or array_like, shape (m,)
        alpha [m/N], at least 0.
    damping : float or array_like, shape (m,)
        beta [N s/m], at least 0; acts where the compliance is above 0.
    stiffness : float or array_like, shape (m,), optional
        k in [0, 1] of plain PBD in place of compliance: what part of the error a step takes away.

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index.

    References
    ----------
    Macklin, Mueller and Chentanez, "XPBD: position-based simulation of compliant constrained
    dynamics", MIG 2016, eq. 18.

    Examples
    --------
    A mass of 1 kg comes to rest where a spring of 981 N/m carries its weight.

    >>> import substep
    >>> spring = substep.pbd.Attachment([0], compliance=1 / 981, damping=50.0)
    >>> ball = substep.PositionBasedDynamics([[0, 0, 0]], 1.0, [spring])
    >>> ball.advance(3.0)
    >>> ball.positions.round(4).tolist()
    [[0.0, 0.0, -0.01]]
    """

    _kind = "attachment"

    def __init__(
        self,
        particles: ArrayLike,
        targets: ArrayLike | None = None,
        *,
        compliance: ArrayLike = 0.0,
        damping: ArrayLike = 0.0,
        stiffness: ArrayLike | None = None,
    ) -> None:
        flat = as_array("particles", particles)
        if flat.ndim != 1:
            raise InputError(f"particles: expected a list of indices, got {describe(particles)}")
        self._set_up("particles", flat[:, None], compliance, damping, stiffness)
        self.targets = None
        if targets is not None:
            self.targets = read_only(check_array("targets", targets, (len(self), 3)))

    def _parameters(self, positions: Array) -> Array:
        targets = positions[self.particles[:, 0]] if self.targets is None else self.targets
        return targets - origin_of(positions)


class NeoHookean(Constraint):
    """Elastic tetrahedra of Young's modulus and Poisson's ratio.

    Two constraints each, of |F| and det F, whose energies add up to the stable neo-Hookean one,
    the same as that of `SoftBody`. It obeys Hooke's law at small strains and stays finite at large
    ones, and inverted tetrahedra turn back. Iterations or substeps must be enough for the two to
    find their balance: docs/pbd_constraints.md has the remaining error by their number.

    Parameters
    ----------
    tetrahedra : array_like of int, shape (m, 4)
        Corners.
    young_modulus : float or array_like, shape (m,)
        E [Pa], above 0.
    poisson_ratio : float or array_like, shape (m,)
        nu, above -1 and below 0.5.
    rest_positions : array_like, shape (n, 3), optional
        All particles in the shape at rest [m]; the initial positions unless given. Tetrahedra
        without volume at rest are skipped, those of negative volume are at rest as they are.
    damping_time : float
        Damping time tau [s], at least 0: the force of tau times the rate of each constraint.

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index.

    References
    ----------
    Smith, de Goes and Kim, "Stable neo-Hookean flesh simulation", ACM Trans. Graph. 37 (2018) 12,
    eq. 14; Macklin and Mueller, "A constraint-based formulation of stable neo-Hookean materials",
    MIG 2021 (the two constraints, of an energy without the logarithm).

    Examples
    --------
    A jelly that hangs from its top is longest at the end.

    >>> import substep
    >>> cube = substep.geometry.box_tetrahedra((0.1, 0.1, 0.1), (3, 3, 3))
    >>> flesh = substep.pbd.NeoHookean(cube.tetrahedra, 2e4, 0.3, damping_time=0.02)
    >>> jelly = substep.PositionBasedDynamics(
    ...     cube.vertices, 1000 * cube.vertex_volumes, [flesh], substeps=100,
    ...     pinned=cube.vertices[:, 2] > 0.04, dtype="float64")
    >>> jelly.advance(0.5)
    >>> bool(-0.056 < jelly.positions[:, 2].min() < -0.052)
    True
    """

    _kind = "neo_hookean_deviatoric"

    def __init__(
        self,
        tetrahedra: ArrayLike,
        young_modulus: ArrayLike,
        poisson_ratio: ArrayLike,
        *,
        rest_positions: ArrayLike | None = None,
        damping_time: float = 0.0,
    ) -> None:
        self._set_up("tetrahedra", tetrahedra, 0.0, 0.0, None)
        m = len(self)
        self.young_modulus = check_each("young_modulus", young_modulus, m)
        self.poisson_ratio = check_each("poisson_ratio", poisson_ratio, m, low=-np.inf)
        _refuse("young_modulus", self.young_modulus, self.young_modulus <= 0, "above 0")
        wrong = (self.poisson_ratio <= -1) | (self.poisson_ratio >= 0.5)
        _refuse("poisson_ratio", self.poisson_ratio, wrong, "above -1 and below 0.5")
        self.damping_time = check_real("damping_time", damping_time, nonnegative=True)
        self.rest_positions = _check_rest(rest_positions, self)

    def _formulas(self, positions: Array) -> list[Formula]:
        """The deviatoric and the hydrostatic constraint of each tetrahedron."""
        x = _rest(self.rest_positions, positions)
        volumes = rest.tetrahedron_volumes(x, self.particles)
        inverse = rest.inverse_edges(x, self.particles)
        solid = inverse.any(axis=1)
        size = np.where(solid, np.abs(volumes), 1)
        per_volume = np.where(solid, 1 / np.where(solid, volumes, 1), 0)
        e, nu, tau = self.young_modulus, self.poisson_ratio, self.damping_time
        # m, l and a of neo_hookean.h.
        shear = 4 / 3 * e / (2 * (1 + nu))
        bulk = e * nu / ((1 + nu) * (1 - 2 * nu)) + 5 / 8 * shear
        balance = np.broadcast_to(1 + 0.75 * shear / bulk, len(self))
        of_volume = np.stack([per_volume, balance], axis=1)
        stiff = shear * size, bulk * size
        return [
            Formula("neo_hookean_deviatoric", inverse, 1 / stiff[0], tau * stiff[0]),
            Formula("neo_hookean_hydrostatic", of_volume, 1 / stiff[1], tau * stiff[1]),
        ]


def origin_of(positions: Array) -> Array:
    """What native positions are relative to: the middle of the initial ones."""
    if len(positions) == 0:
        return np.zeros(3)
    return 0.5 * positions.min(axis=0) + 0.5 * positions.max(axis=0)


def _given(name: str, value: ArrayLike | None, count: int, low: float = 0.0) -> Array | None:
    return None if value is None else check_each(name, value, count, low=low)


def _column(given: Array | None, measure: Callable[[], Array]) -> Array:
    """What was given, for all or for each, or else measured, as parameters of one number each."""
    measured = measure()
    return np.broadcast_to(measured if given is None else given, measured.shape)[:, None]


def _check_rest(positions: ArrayLike | None, constraint: Constraint) -> Array | None:
    if positions is None:
        return None
    x = check_array("rest_positions", positions, (None, 3))
    constraint._check_count(len(x))
    return read_only(x)


def _rest(given: Array | None, positions: Array) -> Array:
    return positions if given is None else given


def _refuse(name: str, values: Array, wrong: NDArray[np.bool_], wanted: str) -> None:
    if wrong.any():
        j = int(np.argmax(wrong))
        raise InputError(f"{name}[{j}]: expected a number {wanted}, got {values[j]}")
