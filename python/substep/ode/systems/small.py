"""Compiled right-hand sides: classical systems that run without the interpreter.

A system goes where `fun` goes: ``substep.solve_ivp(substep.systems.Lorenz(), ...)``. It can also be
called as ``system(t, y)``, so every other solver takes it too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ... import _core
from ...base.checks import check_array, check_flag, check_real
from ...errors import InputError
from .system import ClassicalSystem


class Lorenz(ClassicalSystem):
    r"""The Lorenz system of convection, chaotic at the default parameters.

    .. math:: x' = \sigma (y - x), \quad y' = x (\rho - z) - y, \quad z' = x y - \beta z

    Parameters
    ----------
    sigma, rho, beta : float
        Prandtl number, scaled Rayleigh number, geometric factor.

    References
    ----------
    .. [1] E. N. Lorenz, "Deterministic nonperiodic flow", J. Atmos. Sci. 20 (1963), 130-141,
       equations (25)-(27).

    Examples
    --------
    >>> import substep
    >>> substep.systems.Lorenz()(0.0, [1.0, 2.0, 3.0])
    array([10., 23., -6.])
    """

    def __init__(self, sigma: float = 10.0, rho: float = 28.0, beta: float = 8.0 / 3.0) -> None:
        self.sigma = check_real("sigma", sigma)
        self.rho = check_real("rho", rho)
        self.beta = check_real("beta", beta)
        super().__init__(
            _core.make_system("lorenz", [self.sigma, self.rho, self.beta]),
            y0=[1.0, 1.0, 1.0],
            t_end=10.0,
        )


class Arenstorf(ClassicalSystem):
    r"""The restricted three-body problem in the plane, in the frame that turns with earth and moon.

    .. math::
        x'' = x + 2 y' - \bar\mu \frac{x + \mu}{D_1} - \mu \frac{x - \bar\mu}{D_2}, \quad
        y'' = y - 2 x' - \bar\mu \frac{y}{D_1} - \mu \frac{y}{D_2}

    with :math:`\bar\mu = 1 - \mu`, :math:`D_1 = ((x + \mu)^2 + y^2)^{3/2}`,
    :math:`D_2 = ((x - \bar\mu)^2 + y^2)^{3/2}`; the state is (x, y, x', y'). From `y0` the
    satellite runs through Arenstorf's orbit and is back at `t_end`.

    Parameters
    ----------
    mu : float
        Mass of the moon in units of both masses.

    References
    ----------
    .. [1] E. Hairer, S. P. Norsett, G. Wanner, "Solving Ordinary Differential Equations I", 2nd
       ed., 1993, section II.0, equations (0.1) and (0.2).

    Examples
    --------
    >>> import substep
    >>> system = substep.systems.Arenstorf()
    >>> result = substep.solve_ivp(system, (0, system.t_end), system.y0, "DOP853", rtol=1e-10,
    ...                            atol=1e-10)
    >>> bool(abs(result.y[:2, -1] - system.y0[:2]).max() < 1e-7)
    True
    """

    def __init__(self, mu: float = 0.012277471) -> None:
        self.mu = check_real("mu", mu)
        super().__init__(
            _core.make_system("arenstorf", [self.mu]),
            y0=[0.994, 0.0, 0.0, -2.00158510637908252240537862224],
            t_end=17.0652165601579625588917206249,
        )


class Pleiades(ClassicalSystem):
    r"""Seven stars in the plane that attract each other.

    .. math:: x_i'' = \sum_{j \ne i} m_j \frac{x_j - x_i}{r_{ij}^3}, \quad
              y_i'' = \sum_{j \ne i} m_j \frac{y_j - y_i}{r_{ij}^3}

    The state is (x_1..x_7, y_1..y_7, x'_1..x'_7, y'_1..y'_7).

    Parameters
    ----------
    masses : sequence of 7 floats
        Masses, with the constant of gravity 1.

    References
    ----------
    .. [1] E. Hairer, S. P. Norsett, G. Wanner, "Solving Ordinary Differential Equations I", 2nd
       ed., 1993, section II.10, problem PLEI.

    Examples
    --------
    >>> import substep
    >>> system = substep.systems.Pleiades()
    >>> substep.solve_ivp(system, (0, system.t_end), system.y0, "DOP853", rtol=1e-10,
    ...                   atol=1e-10).y[:2, -1].round(6)
    array([0.370614, 3.237284])
    """

    def __init__(self, masses: Sequence[float] = (1, 2, 3, 4, 5, 6, 7)) -> None:
        self.masses = check_array("masses", masses, (7,))
        x = [3, 3, -1, -3, 2, -2, 2]
        y = [3, -3, 2, 0, 0, -4, 4]
        velocity = [0, 0, 0, 0, 0, 1.75, -1.5, 0, 0, 0, -1.25, 1, 0, 0]
        super().__init__(
            _core.make_system("pleiades", self.masses.tolist()), y0=[*x, *y, *velocity], t_end=3.0
        )


class Kepler(ClassicalSystem):
    r"""A body round a fixed centre of attraction, in the plane.

    .. math:: x'' = -\mu x / r^3, \quad y'' = -\mu y / r^3

    The state is (x, y, x', y'). `y0` is the nearest point of an ellipse of semi-major axis 1.

    Parameters
    ----------
    mu : float
        Constant of gravity times the mass of the centre [m^3/s^2].
    eccentricity : float
        Of the orbit that `y0` starts, from 0 to below 1.

    References
    ----------
    .. [1] E. Hairer, C. Lubich, G. Wanner, "Geometric Numerical Integration", 2nd ed., 2006,
       section I.2, equations (2.2) and (2.10).

    Examples
    --------
    >>> import substep
    >>> substep.systems.Kepler(eccentricity=0.6).y0
    array([0.4, 0. , 0. , 2. ])
    """

    def __init__(self, mu: float = 1.0, eccentricity: float = 0.6) -> None:
        self.mu = check_real("mu", mu, positive=True)
        self.eccentricity = e = check_real("eccentricity", eccentricity, nonnegative=True)
        if e >= 1.0:
            raise InputError(f"eccentricity: expected a number below 1, got {e}")
        super().__init__(
            _core.make_system("kepler", [self.mu]),
            y0=[1.0 - e, 0.0, 0.0, float(np.sqrt(self.mu * (1.0 + e) / (1.0 - e)))],
            t_end=float(2.0 * np.pi / np.sqrt(self.mu)),
        )

    @np.errstate(all="ignore")  # infinite where it is, as the right-hand side
    def energy(self, y: ArrayLike) -> np.ndarray[Any, Any]:
        """Energy per mass.

        Parameters
        ----------
        y : array_like, shape (4,) or (4, m)
            States.

        Returns
        -------
        ndarray, shape () or (m,)
            Energy per mass [m^2/s^2].
        """
        x1, x2, v1, v2 = self._states(y)
        return 0.5 * (v1**2 + v2**2) - self.mu / np.sqrt(x1**2 + x2**2)


class HenonHeiles(ClassicalSystem):
    r"""A star in the meridian plane of a galaxy, regular or chaotic by its energy.

    .. math:: x'' = -x - 2 \lambda x y, \quad y'' = -y - \lambda (x^2 - y^2)

    The state is (x, y, x', y'); `y0` has the energy 1/8.

    Parameters
    ----------
    lambda_ : float
        Strength of the coupling.

    References
    ----------
    .. [1] M. Henon, C. Heiles, "The applicability of the third integral of motion", Astron. J. 69
       (1964), 73-79.

    Examples
    --------
    >>> import substep
    >>> system = substep.systems.HenonHeiles()
    >>> float(system.energy(system.y0))
    0.125
    """

    def __init__(self, lambda_: float = 1.0) -> None:
        self.lambda_ = check_real("lambda_", lambda_)
        super().__init__(
            _core.make_system("henon_heiles", [self.lambda_]), y0=[0.0, 0.0, 0.5, 0.0], t_end=100.0
        )

    @np.errstate(all="ignore")  # infinite where it is, as the right-hand side
    def energy(self, y: ArrayLike) -> np.ndarray[Any, Any]:
        """Energy.

        Parameters
        ----------
        y : array_like, shape (4,) or (4, m)
            States.

        Returns
        -------
        ndarray, shape () or (m,)
            Energy.
        """
        x1, x2, v1, v2 = self._states(y)
        potential = 0.5 * (x1**2 + x2**2) + self.lambda_ * (x1**2 * x2 - x2**3 / 3.0)
        return 0.5 * (v1**2 + v2**2) + potential


class VanDerPol(ClassicalSystem):
    r"""The oscillator of van der Pol; stiff for great :math:`\mu`.

    .. math:: x'' = \mu (1 - x^2) x' - x

    or, `scaled` to time in units of :math:`\mu`, so that a period stays near 1.6 for great
    :math:`\mu`:

    .. math:: \frac{1}{\mu^2} x'' = (1 - x^2) x' - x

    The state is (x, x').

    Parameters
    ----------
    mu : float
        Strength of the nonlinear damping.
    scaled : bool
        Whether time is in units of mu.

    References
    ----------
    .. [1] E. Hairer, S. P. Norsett, G. Wanner, "Solving Ordinary Differential Equations I", 2nd
       ed., 1993, section I.16, equation (16.2).
    .. [2] E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II", 2nd ed., 1996,
       section IV.1, equation (1.5'), with epsilon = 1 / mu^2.

    Examples
    --------
    >>> import substep
    >>> substep.systems.VanDerPol(2.0)(0.0, [2.0, 1.0])
    array([ 1., -8.])
    >>> substep.systems.VanDerPol(2.0, scaled=True).jacobian(0.0, [2.0, 1.0])
    array([[  0.,   1.],
           [-20., -12.]])
    """

    def __init__(self, mu: float = 1.0, scaled: bool = False) -> None:
        self.mu = check_real("mu", mu)
        self.scaled = check_flag("scaled", scaled)
        damping, stiffness = (self.mu**2, self.mu**2) if self.scaled else (self.mu, 1.0)
        super().__init__(
            _core.make_system("van_der_pol", [damping, stiffness]),
            y0=[2.0, 0.0],
            t_end=2.0 if self.scaled else 20.0,
        )


class Pendulum(ClassicalSystem):
    r"""A mass on a rigid rod.

    .. math:: \theta'' = -(g / l) \sin\theta - \gamma \theta'

    The state is (theta, theta'), theta from the lowest point.

    Parameters
    ----------
    length : float
        Length l of the rod [m].
    gravity : float
        Acceleration g [m/s^2].
    damping : float
        Damping rate gamma [1/s].

    References
    ----------
    .. [1] E. Hairer, C. Lubich, G. Wanner, "Geometric Numerical Integration", 2nd ed., 2006,
       section I.1, equation (1.12).

    Examples
    --------
    >>> import substep
    >>> substep.systems.Pendulum(length=9.81)(0.0, [0.0, 2.0])
    array([ 2., -0.])
    """

    def __init__(self, length: float = 1.0, gravity: float = 9.81, damping: float = 0.0) -> None:
        self.length = check_real("length", length, positive=True)
        self.gravity = check_real("gravity", gravity)
        self.damping = check_real("damping", damping)
        super().__init__(
            _core.make_system("pendulum", [self.length, self.gravity, self.damping]),
            y0=[1.0, 0.0],
            t_end=10.0,
        )


class HarmonicOscillator(ClassicalSystem):
    r"""A mass on a linear spring, with damping.

    .. math:: x'' = -\omega^2 x - \gamma x'

    The state is (x, x').

    Parameters
    ----------
    omega : float
        Angular frequency without damping [1/s].
    damping : float
        Damping rate gamma [1/s].

    References
    ----------
    .. [1] L. D. Landau, E. M. Lifshitz, "Mechanics", 3rd ed., 1976, section 25, equation (25.1),
       with gamma for their 2 lambda.

    Examples
    --------
    >>> import substep
    >>> substep.systems.HarmonicOscillator(2.0)(0.0, [1.0, 0.0])
    array([ 0., -4.])
    """

    def __init__(self, omega: float = 1.0, damping: float = 0.0) -> None:
        self.omega = check_real("omega", omega)
        self.damping = check_real("damping", damping)
        super().__init__(
            _core.make_system("harmonic_oscillator", [self.omega, self.damping]),
            y0=[1.0, 0.0],
            t_end=float(2.0 * np.pi),
        )
