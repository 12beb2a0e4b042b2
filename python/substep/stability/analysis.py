"""Linear stability: how a method multiplies the solution of a linear equation in one step.

One-step methods on y' = lambda y give y_{n+1} = R(z) y_n, z = h lambda. R of the stabilised method
depends on its stages: "RKC2(s)" has s of them, "RKC2" alone ten. Methods for x'' = a give
(x, v / omega)_{n+1} = M (x, v / omega)_n on x'' = -omega^2 x - 2 zeta omega v. Where |R(z)|, or the
largest |eigenvalue| of M, exceeds 1, the numbers grow although the solution does not.

References
----------
[HW] E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II", 2nd ed., Springer 1996.
[HLW] E. Hairer, C. Lubich, G. Wanner, "Geometric Numerical Integration", 2nd ed., Springer 2006.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_array, check_choice, check_integer, in_range
from ..base.pictured import Pictured, outline
from ..errors import InputError
from . import oscillator, rational
from .chebyshev import ChebyshevFactor
from .oscillator import (
    second_order_methods,
)
from .rational import RationalFactor

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_SAME = 1e-7  # spectra are told apart to this fraction of their largest modulus


def one_step_methods() -> tuple[str, ...]:
    """Names of the methods that have an amplification factor R(z).

    Returns
    -------
    tuple of str
        The methods of `solve_ivp`. "RKC2" means ten stages; any number s from 2 to 1000 may be
        asked for by "RKC2(s)".

    Examples
    --------
    >>> import substep
    >>> "rk4" in substep.stability.one_step_methods()
    True
    """
    return tuple(_core.ode_methods())


def _check_method(method: Any, others: tuple[str, ...] = ()) -> str:
    """The name as listed, with the number of stages in brackets where one was given."""
    given = (
        re.fullmatch(r"rkc2\((\d+)\)", method, re.IGNORECASE) if isinstance(method, str) else None
    )
    if given:
        stages = check_integer("method: stages of RKC2", int(given[1]), minimum=2, maximum=1000)
        return f"RKC2({stages})"
    return check_choice("method", method, (*one_step_methods(), *others))


@functools.cache
def _factor(name: str) -> RationalFactor | ChebyshevFactor:
    """R of a method by its checked name."""
    if name.startswith("RKC2"):
        return ChebyshevFactor(int(name[5:-1] or 10))
    return RationalFactor(*_quotient(name))


def _quotient(name: str) -> tuple[Real, Real]:
    """Ascending coefficients of P and Q with R = P / Q, from the tableau.

    [HW] proposition IV.3.2: R(z) = det(I - z A + z 1 b^T) / det(I - z A). Explicit: Q = 1 and
    P = 1 + sum_j z^j b^T A^(j-1) 1 ([HW] IV.2, (2.8)).
    """
    table = _core.tableau(name)
    b = table["b"]
    a = table["a"][: len(b), : len(b)]
    if np.all(np.triu(a) == 0):
        powers = [np.ones(len(b))]
        for _ in range(len(b) - 1):
            powers.append(a @ powers[-1])
        return np.array([1.0, *(float(b @ power) for power in powers)]), np.ones(1)
    return _without_rounding(np.poly(a - b)), _without_rounding(np.poly(a))


def _without_rounding(coefficients: NDArray[Any]) -> Real:
    """Zeros that rounding blurred are zeros: at infinity they would count."""
    exact = np.where(np.abs(coefficients) < 1e-14, 0.0, coefficients)
    return np.trim_zeros(np.asarray(exact, np.float64), "b")


def _one_step(method: str) -> RationalFactor | ChebyshevFactor:
    return _factor(_check_method(method))


def amplification(method: str, z: ArrayLike) -> Any:
    """Amplification factor R(z) of a one-step method on y' = lambda y, z = h lambda.

    R(z) = 1 + z b^T (I - z A)^-1 1, with A and b of the method's tableau. An adaptive step that
    step doubling accepts is two half steps: R(z / 2)**2.

    Parameters
    ----------
    method : str
        One of `one_step_methods()`, in upper or lower case, or "RKC2(s)" for s stages.
    z : array_like of complex, any shape
        Step times eigenvalue [1].

    Returns
    -------
    complex or ndarray of complex128
        R(z), of z's shape; infinite at a pole.

    Raises
    ------
    InputError
        If the method is unknown or z is not finite.

    References
    ----------
    Hairer and Wanner, "Solving Ordinary Differential Equations II", IV.2 and (3.2) of IV.3.

    Examples
    --------
    Explicit Euler multiplies an undamped oscillation by sqrt(1 + (h omega)^2):

    >>> import substep
    >>> abs(substep.stability.amplification("euler", 0.75j))
    1.25
    """
    factor = _one_step(method)
    points = check_array("z", z, complex_ok=True).astype(complex)
    with in_range("z"):
        values = factor.evaluate(points)
    return values if points.ndim else complex(values[()])


def amplification_polynomial(method: str) -> Real:
    """Coefficients of R(z) of an explicit method, the constant first.

    Parameters
    ----------
    method : str
        One of `one_step_methods()` that is explicit.

    Returns
    -------
    ndarray, shape (stages + 1,), float64
        c_j of R(z) = sum c_j z^j; c_j = 1 / j! up to the order of the method.

    Raises
    ------
    InputError
        If the method is unknown or implicit (its R is a rational function).

    References
    ----------
    Hairer and Wanner, "Solving Ordinary Differential Equations II", theorem IV.2.2.

    Examples
    --------
    >>> import substep
    >>> substep.stability.amplification_polynomial("heun")
    array([1. , 1. , 0.5])
    """
    factor = _one_step(method)
    if isinstance(factor, ChebyshevFactor):
        return factor.polynomial()
    if len(factor.denominator) > 1:
        raise InputError(
            f"method: {method} is implicit, its R(z) is no polynomial; see amplification"
        )
    return factor.numerator.copy()


def real_limit(method: str) -> float:
    """Largest x with |R(-s)| <= 1 for every s in [0, x]: the reach along the negative real axis.

    Parameters
    ----------
    method : str
        One of `one_step_methods()`.

    Returns
    -------
    float
        The bound of h |lambda| for decay, y' = -|lambda| y [1]; infinite for an A-stable method.

    Raises
    ------
    InputError
        If the method is unknown.

    References
    ----------
    Hairer and Wanner, "Solving Ordinary Differential Equations II", IV.2.

    Examples
    --------
    >>> import substep
    >>> round(substep.stability.real_limit("rk4"), 10)
    2.7852935634
    """
    return _one_step(method).ray_limit(-1.0)


def imaginary_limit(method: str) -> float:
    """Largest y with |R(i s)| <= 1 for every s in [0, y]: the reach along the imaginary axis.

    Parameters
    ----------
    method : str
        One of `one_step_methods()`.

    Returns
    -------
    float
        The bound of h omega for an undamped oscillation [1]: 0 where every step makes it grow.

    Raises
    ------
    InputError
        If the method is unknown.

    References
    ----------
    Hairer and Wanner, "Solving Ordinary Differential Equations II", IV.2.

    Examples
    --------
    >>> import substep
    >>> round(substep.stability.imaginary_limit("rk4"), 10)
    2.8284271247
    >>> substep.stability.imaginary_limit("euler")
    0.0
    """
    return _one_step(method).ray_limit(1j)


@dataclass(frozen=True, eq=False)
class Region(Pictured):
    """Where |R(z)| <= 1: on a grid, and its outline.

    Attributes
    ----------
    method : str
        The method.
    real, imag : ndarray, shape (nx,) and (ny,), float64
        Coordinates of the grid [1].
    modulus : ndarray, shape (ny, nx), float64
        |R(real + i imag)|.
    stable : ndarray, shape (ny, nx), bool
        Where the modulus is at most 1.
    boundary : list of ndarray, complex128
        Closed curves |R(z)| = 1, first and last point equal; the first one passes through 0,
        others bound islands. They do not depend on the grid.
    """

    method: str
    real: Real
    imag: Real
    modulus: Real
    stable: NDArray[np.bool_]
    boundary: list[Complex]

    __repr__ = outline


def region(
    method: str, bounds: tuple[float, float, float, float] | None = None, resolution: int = 201
) -> Region:
    """Region of absolute stability of a one-step method.

    Parameters
    ----------
    method : str
        One of `one_step_methods()`.
    bounds : (float, float, float, float), optional
        Smallest and largest real part, smallest and largest imaginary part of the grid [1];
        default: what the outline through 0 spans, and a tenth more.
    resolution : int
        Grid points along each axis, from 2 to 10000.

    Returns
    -------
    Region
        The grid, |R| on it, the stable part and the outline.

    Raises
    ------
    InputError
        If the method is unknown, or the bounds are not finite and rising.

    References
    ----------
    Hairer and Wanner, "Solving Ordinary Differential Equations II", IV.2 (root locus curves).

    Examples
    --------
    >>> import substep
    >>> grid = substep.stability.region("euler", bounds=(-3, 1, -2, 2), resolution=5)
    >>> grid.stable.astype(int)
    array([[0, 0, 0, 0, 0],
           [0, 0, 1, 0, 0],
           [0, 1, 1, 1, 0],
           [0, 0, 1, 0, 0],
           [0, 0, 0, 0, 0]])
    """
    name = _check_method(method)
    count = check_integer("resolution", resolution, minimum=2, maximum=10_000)
    curves = _outline(name)
    if bounds is None:
        x, y = curves[0].real, curves[0].imag
        margin = 0.1 * max(np.ptp(x), np.ptp(y))
        box = np.array([x.min(), x.max(), y.min(), y.max()]) + margin * np.array([-1, 1, -1, 1])
    else:
        box = check_array("bounds", bounds, (4,))
        if not (box[0] < box[1] and box[2] < box[3]):
            raise InputError(
                f"bounds: expected real from < real to and imaginary from < to, got {box.tolist()}"
            )
    with in_range("bounds"):
        real, imag = np.linspace(box[0], box[1], count), np.linspace(box[2], box[3], count)
        modulus = np.abs(_factor(name).evaluate(real + 1j * imag[:, None]))
    stable = modulus <= 1
    return Region(name, real, imag, modulus, stable, [curve.copy() for curve in curves])


@functools.cache
def _outline(name: str) -> tuple[Complex, ...]:
    curves = rational.outline(_factor(name).roots)
    return tuple(sorted(curves, key=lambda curve: float(np.min(abs(curve)))))


def spectrum_of(eigenvalues: ArrayLike) -> Complex:
    """The given eigenvalues, or those of the given square matrix."""
    array = check_array("eigenvalues", eigenvalues, complex_ok=True)
    if array.ndim == 2 and array.shape[0] == array.shape[1]:
        return np.asarray(np.linalg.eigvals(array), complex)
    if array.ndim != 1:
        raise InputError(
            f"eigenvalues: expected shape (n,), or (n, n) for a Jacobian, got {array.shape}"
        )
    return array.astype(complex)


def max_stable_step(method: str, eigenvalues: ArrayLike) -> float:
    """Largest step h for which no decaying or oscillating mode grows, at any step up to h.

    Modes with positive real part grow in the exact solution too and set no limit. Rounding in a
    computed spectrum is allowed for: moduli and positive or negative real parts below 1e-7 of the
    largest modulus count as 0. The bound is that of y' = J y; for a Jacobian far from normal the
    numbers may grow for a while before they decay.

    Parameters
    ----------
    method : str
        One of `one_step_methods()` or `second_order_methods()`.
    eigenvalues : array_like, shape (n,) or (n, n), float64 or complex128
        Eigenvalues of the Jacobian, or the Jacobian itself [1/s]. For `second_order_methods()`,
        of the system written at first order, (x, v)' = (v, a): then lambda = -zeta omega +- i omega
        sqrt(1 - zeta^2), and overdamped modes (real lambda) are refused, since the spectrum does
        not say which two belong together; see `stability_limit`.

    Returns
    -------
    float
        The step [s]: infinite if nothing limits it (an A-stable method), 0 if every step lets a
        mode grow (explicit Euler, midpoint and Heun on an undamped oscillation).

    Raises
    ------
    InputError
        If the method is unknown, or the eigenvalues are not finite or of another shape.

    References
    ----------
    Hairer and Wanner, "Solving Ordinary Differential Equations II", IV.2.

    Examples
    --------
    >>> import substep
    >>> round(substep.stability.max_stable_step("rk4", [-1000.0, -1.0]), 9)
    0.002785294
    >>> substep.stability.max_stable_step("velocity_verlet", [[0.0, 1.0], [-25.0, 0.0]])
    0.4
    """
    name = _check_method(method, second_order_methods())
    spectrum = spectrum_of(eigenvalues)
    size = float(np.max(np.abs(spectrum), initial=0.0))
    spectrum = spectrum[np.abs(spectrum) > _SAME * size]
    spectrum.real[np.abs(spectrum.real) <= _SAME * size] = 0.0
    spectrum = spectrum[spectrum.real <= 0]
    # The spectrum of a real Jacobian is symmetric and R(conj z) = conj R(z): half of it is enough.
    modes = np.unique(spectrum.real + 1j * np.abs(spectrum.imag))
    moduli = np.abs(modes)
    units = np.round(modes.real / moduli + 1j * (modes.imag / moduli), 12)
    directions, which = np.unique(units, return_inverse=True)
    fastest = np.zeros(len(directions))
    np.maximum.at(fastest, which, moduli)
    if name not in second_order_methods():
        limits = np.array([_factor(name).ray_limit(complex(u)) for u in directions])
    elif np.any(directions.imag == 0):
        raise InputError(
            "eigenvalues: a real one belongs to an overdamped mode, whose partner the spectrum "
            f"does not tell; use stability_limit({name!r}, damping_ratio) / omega"
        )
    else:
        limits = oscillator.limits(name, np.asarray(-directions.real, float))
    with np.errstate(over="ignore"):
        return float(np.min(limits / fastest, initial=np.inf))


def stiffness_ratio(eigenvalues: ArrayLike) -> float:
    """Ratio of the fastest to the slowest decay: max |Re lambda| / min |Re lambda|, Re lambda < 0.

    Parameters
    ----------
    eigenvalues : array_like, shape (n,) or (n, n), float64 or complex128
        Eigenvalues of the Jacobian, or the Jacobian itself [1/s]. Real parts within the rounding
        of the largest modulus (10 n 2^-52 of it) count as 0 and are left out.

    Returns
    -------
    float
        At least 1.

    Raises
    ------
    InputError
        If no eigenvalue has a negative real part, or they are not finite.

    References
    ----------
    J. D. Lambert, "Numerical Methods for Ordinary Differential Systems", Wiley 1991, section 6.2.

    Examples
    --------
    >>> import substep
    >>> substep.stability.stiffness_ratio([-1000.0, -2 + 5j, -2 - 5j, 0.0])
    500.0
    """
    spectrum = spectrum_of(eigenvalues)
    rounding = 10 * len(spectrum) * 2.0**-52 * np.max(np.abs(spectrum), initial=0.0)
    decay = -spectrum.real[spectrum.real < -rounding]
    if decay.size == 0:
        raise InputError("eigenvalues: expected at least one with a negative real part")
    return float(decay.max() / decay.min())
