"""Compiled stiff systems, public in substep.systems."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ... import _core
from ...base.checks import check_integer, check_real
from .system import ClassicalSystem


class Robertson(ClassicalSystem):
    r"""Robertson's chemical reaction of three species, with rates nine decades apart.

    .. math::
        y_1' = -k_1 y_1 + k_3 y_2 y_3, \quad
        y_2' = k_1 y_1 - k_3 y_2 y_3 - k_2 y_2^2, \quad
        y_3' = k_2 y_2^2

    The sum of the three is kept. `t_end` is that of the test set; the state then still changes.

    Parameters
    ----------
    k1, k2, k3 : float
        Rates of A -> B, B + B -> C + B and B + C -> A + C.

    References
    ----------
    .. [1] E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II", 2nd ed., 1996,
       section IV.1, equation (1.4).

    Examples
    --------
    >>> import substep
    >>> system = substep.systems.Robertson()
    >>> system.jacobian(0.0, [1.0, 1e-5, 0.0])
    array([[-4.e-02,  0.e+00,  1.e-01],
           [ 4.e-02, -6.e+02, -1.e-01],
           [ 0.e+00,  6.e+02,  0.e+00]])
    """

    def __init__(self, k1: float = 0.04, k2: float = 3e7, k3: float = 1e4) -> None:
        self.k1 = check_real("k1", k1)
        self.k2 = check_real("k2", k2)
        self.k3 = check_real("k3", k3)
        super().__init__(
            _core.make_system("robertson", [self.k1, self.k2, self.k3]),
            y0=[1.0, 0.0, 0.0],
            t_end=1e11,
        )


class Hires(ClassicalSystem):
    r"""High irradiance responses of photomorphogenesis: eight species.

    .. math::
        y_1' &= -1.71 y_1 + 0.43 y_2 + 8.32 y_3 + 0.0007 \\
        y_2' &= 1.71 y_1 - 8.75 y_2 \\
        y_3' &= -10.03 y_3 + 0.43 y_4 + 0.035 y_5 \\
        y_4' &= 8.32 y_2 + 1.71 y_3 - 1.12 y_4 \\
        y_5' &= -1.745 y_5 + 0.43 y_6 + 0.43 y_7 \\
        y_6' &= -280 y_6 y_8 + 0.69 y_4 + 1.71 y_5 - 0.43 y_6 + 0.69 y_7 \\
        y_7' &= 280 y_6 y_8 - 1.81 y_7 \\
        y_8' &= -280 y_6 y_8 + 1.81 y_7

    References
    ----------
    .. [1] E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II", 2nd ed., 1996,
       section IV.10, problem HIRES; F. Mazzia, C. Magherini, "Test Set for Initial Value Problem
       Solvers", University of Bari.

    Examples
    --------
    >>> import substep
    >>> system = substep.systems.Hires()
    >>> float(system(0.0, system.y0)[0].round(4)), system.t_end
    (-1.7093, 321.8122)
    """

    def __init__(self) -> None:
        super().__init__(
            _core.make_system("hires", []), y0=[1.0, 0, 0, 0, 0, 0, 0, 0.0057], t_end=321.8122
        )


class Orego(ClassicalSystem):
    r"""The Oregonator: Belousov and Zhabotinskii's reaction, an oscillator with sharp transitions.

    .. math::
        y_1' = s (y_2 + y_1 (1 - q y_1 - y_2)), \quad
        y_2' = \frac{y_3 - (1 + y_1) y_2}{s}, \quad
        y_3' = w (y_1 - y_3)

    Parameters
    ----------
    s, q, w : float
        Field and Noyes' constants; s is above 0.

    References
    ----------
    .. [1] E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II", 2nd ed., 1996,
       section IV.10, problem OREGO.

    Examples
    --------
    >>> import substep
    >>> substep.systems.Orego()(0.0, [1.0, 1.0, 1.0]).round(6)
    array([ 7.7269353e+01, -1.2942000e-02,  0.0000000e+00])
    """

    def __init__(self, s: float = 77.27, q: float = 8.375e-6, w: float = 0.161) -> None:
        self.s = check_real("s", s, positive=True)
        self.q = check_real("q", q)
        self.w = check_real("w", w)
        super().__init__(
            _core.make_system("orego", [self.s, self.q, self.w]), y0=[1.0, 2.0, 3.0], t_end=360.0
        )


class Brusselator1D(ClassicalSystem):
    r"""The Brusselator with diffusion on a line, by second differences.

    .. math::
        u_t = a + u^2 v - (b + 1) u + \alpha u_{xx}, \quad v_t = b u - u^2 v + \alpha v_{xx}

    at x_i = i / (n + 1), i = 1 .. n, with u = a and v = b / a at both ends. The state is
    (u_1, .., u_n, v_1, .., v_n); ``y.reshape(2, n)`` has u and v as its rows. The Jacobian is
    sparse.

    Parameters
    ----------
    n : int
        Inner points.
    alpha : float
        Diffusion constant.
    a, b : float
        Constants of the reaction; a is not 0.

    References
    ----------
    .. [1] E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II", 2nd ed., 1996,
       section IV.1, equations (1.6'); problem BRUSS of IV.10 with n = 500.

    Examples
    --------
    >>> import substep
    >>> system = substep.systems.Brusselator1D(100)
    >>> result = substep.solve_ivp(system, (0, 10), system.y0, "RKC2", rtol=1e-5, atol=1e-5)
    >>> u, v = result.y[:, -1].reshape(2, 100)
    >>> float(u[49].round(3))
    0.43
    """

    def __init__(self, n: int = 500, alpha: float = 0.02, a: float = 1.0, b: float = 3.0) -> None:
        self.n = check_integer("n", n, minimum=1, maximum=10**8)
        self.alpha = check_real("alpha", alpha, nonnegative=True)
        self.a = check_real("a", a, positive=True)
        self.b = check_real("b", b)
        u = self.a + np.sin(2 * np.pi * self.x)
        super().__init__(
            _core.make_system("brusselator_1d", [self.n, self.alpha, self.a, self.b]),
            y0=np.concatenate([u, np.full(self.n, self.b / self.a)]),
            t_end=10.0,
        )

    @property
    def x(self) -> NDArray[np.float64]:
        """Coordinates of the points, shape (n,)."""
        return np.arange(1, self.n + 1) / (self.n + 1)


class Brusselator2D(ClassicalSystem):
    r"""The Brusselator with diffusion on a periodic square and a source that is switched on.

    .. math::
        u_t = a + u^2 v - (b + 1) u + \alpha \Delta u + f(x, y, t), \quad
        v_t = b u - u^2 v + \alpha \Delta v

    by second differences at x_i = i / n, y_j = j / n, i, j = 0 .. n-1. f is `source` on the disc
    (x - 0.3)^2 + (y - 0.6)^2 <= 0.1^2 from `source_time` on, and 0 before and elsewhere. The state
    is all u, then all v, row by row: ``y.reshape(2, n, n)[0, j, i]`` is u(x_i, y_j).

    f jumps at `source_time`: a solver that steps across finds out by its error estimate. To begin a
    new integration there, solve with ``source_time=inf`` up to it and with ``source_time=-inf``
    from it on.

    The Jacobian is sparse, and its product with a vector needs no matrix. With "RKC2" the
    right-hand side and the sum of a stage are one pass over the grid, on several threads.

    Parameters
    ----------
    n : int
        Points along each side, at least 3.
    alpha : float
        Diffusion constant.
    a, b : float
        Constants of the reaction.
    source : float
        Strength of the source.
    source_time : float
        When it is switched on; may be infinite.

    References
    ----------
    .. [1] E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II", 2nd ed., 1996,
       section IV.10, problem BRUSS-2D, equations (10.14) and (10.15).

    Examples
    --------
    >>> import substep
    >>> system = substep.systems.Brusselator2D(32)
    >>> result = substep.solve_ivp(system, (0, 1.1), system.y0, "RKC2", t_eval=[1.1], rtol=1e-4,
    ...                            atol=1e-4)
    >>> u, v = result.y[:, 0].reshape(2, 32, 32)
    >>> bool(u.min() > 0.3)
    True
    """

    def __init__(
        self,
        n: int = 128,
        alpha: float = 0.1,
        a: float = 1.0,
        b: float = 3.4,
        source: float = 5.0,
        source_time: float = 1.1,
    ) -> None:
        self.n = check_integer("n", n, minimum=3, maximum=10_000)
        self.alpha = check_real("alpha", alpha, nonnegative=True)
        self.a = check_real("a", a)
        self.b = check_real("b", b)
        self.source = check_real("source", source)
        self.source_time = check_real("source_time", source_time, finite=False)
        x = np.arange(self.n) / self.n
        u = np.repeat(22.0 * x * (1.0 - x) ** 1.5, self.n)  # of y, the same in a row
        v = np.tile(27.0 * x * (1.0 - x) ** 1.5, self.n)
        super().__init__(
            _core.make_system(
                "brusselator_2d",
                [self.n, self.alpha, self.a, self.b, self.source, self.source_time],
            ),
            y0=np.concatenate([u, v]),
            t_end=1.5,
        )
