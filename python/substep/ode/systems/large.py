"""Compiled systems of many components, public in substep.systems."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ... import _core
from ...base.checks import check_array, check_flag, check_integer, check_real
from ...errors import InputError
from .system import System


class Oscillators(System):
    r"""Independent harmonic oscillators.

    .. math:: x_i'' = -\omega_i^2 x_i

    The state is (x_0, .., x_{n-1}, v_0, .., v_{n-1}). With a fixed `step` and few output times, the
    stages of a step stay in registers, and many steps are done while a part of the state is in the
    cache.

    Parameters
    ----------
    omega : array_like, shape (n,)
        Angular frequencies [1/s].

    Examples
    --------
    >>> import numpy as np
    >>> import substep
    >>> system = substep.systems.Oscillators([1.0, 2.0])
    >>> result = substep.solve_second_order(system, (0, np.pi), [1.0, 1.0], [0.0, 0.0], "yoshida4",
    ...                                     step=np.pi / 500, t_eval=[np.pi])
    >>> result.x.ravel().round(6)
    array([-1.,  1.])
    """

    def __init__(self, omega: ArrayLike) -> None:
        self.omega: NDArray[np.float64] = check_array("omega", omega, (None,))
        super().__init__(_core.oscillators(self.omega))

    @np.errstate(all="ignore")  # infinite where it is, as the right-hand side
    def energy(self, y: ArrayLike) -> NDArray[np.float64]:
        """Energy of all oscillators, of unit mass, in states y of shape (2 n,) or (2 n, m) [J]."""
        x, v = np.split(self._states(y), 2)
        omega = self.omega.reshape(-1, *[1] * (x.ndim - 1))
        return np.asarray(0.5 * (v**2 + (omega * x) ** 2).sum(axis=0))


class SpringChain(System):
    r"""Masses on a line, joined by springs.

    .. math:: m_i x_i'' = k_{i+1} (x_{i+1} - x_i) - k_i (x_i - x_{i-1}), \quad i = 0 .. n-1

    x_i are displacements from rest; the state is (x_0, .., x_{n-1}, v_0, .., v_{n-1}). With fixed
    ends, :math:`x_{-1} = x_n = 0`; with free ends the outer springs are absent. With a fixed
    `step` and few output times, several steps are done in one sweep through memory.

    Parameters
    ----------
    n : int
        Number of masses, at least 1.
    k : float or array_like, shape (n + 1,)
        Stiffnesses [N/m], at least 0. The outer two are those of the fixed ends.
    m : float or array_like, shape (n,)
        Masses [kg], above 0.
    fixed_ends : bool
        Springs to walls at both ends, or free ends.

    Examples
    --------
    The lowest mode of 99 masses has the frequency 2 sin(pi / 200):

    >>> import numpy as np
    >>> import substep
    >>> chain = substep.systems.SpringChain(99)
    >>> mode = np.sin(np.pi * np.arange(1, 100) / 100)
    >>> period = 2 * np.pi / (2 * np.sin(np.pi / 200))
    >>> result = substep.solve_second_order(chain, (0, period), mode, np.zeros(99), "yoshida4",
    ...                                     step=0.1, t_eval=[period])
    >>> bool(abs(result.x[:, 0] - mode).max() < 1e-6)
    True
    """

    def __init__(
        self, n: int, k: ArrayLike = 1.0, m: ArrayLike = 1.0, fixed_ends: bool = True
    ) -> None:
        self.n = check_integer("n", n, minimum=1)
        self.k = _one_or_many("k", k, self.n + 1)
        self.m = _one_or_many("m", m, self.n)
        if (self.k < 0).any():
            raise InputError(f"k: expected numbers of at least 0, got {self.k.min()}")
        if (self.m <= 0).any():
            raise InputError(f"m: expected numbers above 0, got {self.m.min()}")
        self.fixed_ends = check_flag("fixed_ends", fixed_ends)
        super().__init__(
            _core.spring_chain(
                self.n, np.atleast_1d(self.k), np.atleast_1d(self.m), self.fixed_ends
            )
        )

    @np.errstate(all="ignore")  # infinite where it is, as the right-hand side
    def energy(self, y: ArrayLike) -> NDArray[np.float64]:
        """Energy of states y of shape (2 n,) or (2 n, m) [J]."""
        x, v = np.split(self._states(y), 2)
        wall = np.zeros((1, *x.shape[1:]))
        left, right = (wall, wall) if self.fixed_ends else (x[:1], x[-1:])
        stretch = np.diff(np.concatenate([left, x, right]), axis=0)
        column = (-1, *[1] * (x.ndim - 1))
        k, m = np.reshape(self.k, column), np.reshape(self.m, column)
        return np.asarray(0.5 * (m * v**2).sum(axis=0) + 0.5 * (k * stretch**2).sum(axis=0))


class NBody(System):
    r"""Bodies that attract each other by gravity, summed over all pairs.

    .. math::
        x_i'' = G \sum_{j \ne i} m_j \frac{x_j - x_i}{(|x_j - x_i|^2 + \epsilon^2)^{3/2}}

    The state is the positions, one row of `dimension` numbers per body, then the velocities.
    `solve_second_order` takes them as arrays of shape (n, dimension).

    Parameters
    ----------
    masses : array_like, shape (n,)
        Masses, at least 0 [kg].
    G : float
        Constant of gravity; the default is for units in which it is 1 [m^3/(kg s^2)].
    softening : float
        Plummer's length epsilon [m]. At 0, bodies that meet give `NonFiniteError`.
    dimension : int
        2 or 3.

    References
    ----------
    .. [1] S. J. Aarseth, "Gravitational N-Body Simulations", Cambridge University Press, 2003,
       equations 1.1 and 2.7.

    Examples
    --------
    Two equal masses on a circle, for one turn:

    >>> import numpy as np
    >>> import substep
    >>> system = substep.systems.NBody([1.0, 1.0], dimension=2)
    >>> x, v = np.array([[0.5, 0.0], [-0.5, 0.0]]), np.array([[0.0, 1.0], [0.0, -1.0]]) / 2**0.5
    >>> turn = 2 * np.pi / 2**0.5
    >>> result = substep.solve_second_order(system, (0, turn), x, v, "yoshida4", step=turn / 1000,
    ...                                     t_eval=[turn])
    >>> bool(abs(result.x[..., 0] - x).max() < 1e-8)
    True
    """

    def __init__(
        self, masses: ArrayLike, G: float = 1.0, softening: float = 0.0, dimension: int = 3
    ) -> None:
        self.masses: NDArray[np.float64] = check_array("masses", masses, (None,))
        if (self.masses < 0).any():
            raise InputError(f"masses: expected numbers of at least 0, got {self.masses.min()}")
        self.G = check_real("G", G)
        self.softening = check_real("softening", softening, nonnegative=True)
        self.dimension = check_integer("dimension", dimension, minimum=2, maximum=3)
        super().__init__(_core.n_body(self.masses, self.G, self.softening, self.dimension))

    @np.errstate(all="ignore")  # infinite where it is, as the right-hand side
    def energy(self, y: ArrayLike) -> float:
        """Energy of one state y of shape (2 n dimension,) [J]."""
        x, v = check_array("y", y, (self.size,), finite=False).reshape(2, -1, self.dimension)
        i, j = np.triu_indices(self.masses.size, 1)
        distance = np.sqrt(((x[i] - x[j]) ** 2).sum(axis=1) + self.softening**2)
        potential = -self.G * (self.masses[i] * self.masses[j] / distance).sum()
        return float(0.5 * (self.masses[:, None] * v**2).sum() + potential)


def _one_or_many(name: str, value: ArrayLike, count: int) -> NDArray[np.float64]:
    array = check_array(name, value)
    if array.ndim and array.shape != (count,):
        raise InputError(f"{name}: expected a number or shape ({count},), got {array.shape}")
    return array.copy()
