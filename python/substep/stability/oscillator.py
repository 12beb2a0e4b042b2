"""The methods for x'' = a(t, x, v) on the damped oscillator x'' = -omega^2 x - 2 zeta omega v.

Variables x, w = v / omega and a / omega^2, with s = h omega. A step is linear in them; each
function below takes them as rows over the initial values and runs the method's formulas.
[HLW] Hairer, Lubich, Wanner, "Geometric Numerical Integration", 2nd ed., Springer 2006.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_choice, check_real, in_range

Rows = NDArray[np.float64]
State = tuple[Rows, Rows, Rows]  # x, w, a

_W1 = 1 / (2 - 2 ** (1 / 3))  # Yoshida, Phys. Lett. A 150 (1990) 262; [HLW] II (4.4)
_ROUNDING = 1e-14


def _symplectic_euler(s: Rows, zeta: Rows, state: State) -> State:
    """[HLW] I (1.9): v += h a, then x += h v."""
    x, w, a = state
    w = w + s * a
    x = x + s * w
    return x, w, -x - 2 * zeta * w


def _verlet(s: Rows, zeta: Rows, state: State) -> State:
    """[HLW] I (1.17), and (1.15), which is the same map of x and v.

    The new acceleration is evaluated at the velocity predicted with the old one, v + h a (Groot and
    Warren, J. Chem. Phys. 107 (1997) 4423, (22) with lambda = 1), and kept for the next step.
    """
    x, w, a = state
    half = w + s / 2 * a
    x = x + s * half
    a = -x - 2 * zeta * (half + s / 2 * a)
    return x, half + s / 2 * a, a


def _yoshida4(s: Rows, zeta: Rows, state: State) -> State:
    """[HLW] II (4.4): Verlet steps of w1 h, (1 - 2 w1) h, w1 h."""
    for weight in (_W1, 1 - 2 * _W1, _W1):
        state = _verlet(weight * s, zeta, state)
    return state


MAPS: dict[str, Callable[[Rows, Rows, State], State]] = {
    "symplectic_euler": _symplectic_euler,
    "position_verlet": _verlet,
    "velocity_verlet": _verlet,
    "yoshida4": _yoshida4,
}


def _full_matrix(method: str, s: Rows, zeta: Rows) -> NDArray[np.float64]:
    """The 3x3 matrices of one step on (x, w, a), for each s and zeta."""
    s, zeta = np.broadcast_arrays(s, zeta)
    unit = np.broadcast_to(np.eye(3), (*s.shape, 3, 3))
    state = (unit[..., 0, :], unit[..., 1, :], unit[..., 2, :])
    return np.stack(MAPS[method](s[..., None], zeta[..., None], state), axis=-2)


def _matrix(method: str, s: Rows, zeta: float) -> NDArray[np.float64]:
    """The same on (x, w) alone where a is that of x and w: without damping, or symplectic Euler."""
    full = _full_matrix(method, s, np.array(zeta))
    if zeta != 0 and method != "symplectic_euler":
        return full
    return full[..., :2, :2] + full[..., :2, 2:] * np.array([[-1.0, -2 * zeta]])


def _bounded(method: str, s: Rows, zeta: Rows) -> NDArray[np.bool_]:
    """Whether all eigenvalues are within the unit circle, by the criterion of Schur, Cohn and Jury.

    For lambda^3 + c2 lambda^2 + c1 lambda + c0: p(1) >= 0, p(-1) <= 0 and
    1 - c0^2 >= |c1 - c0 c2|. Smooth in s, unlike the eigenvalues where two of them meet.
    """
    m = _full_matrix(method, s, zeta)
    c2 = -np.trace(m, axis1=-2, axis2=-1)
    c1 = (c2**2 - np.trace(m @ m, axis1=-2, axis2=-1)) / 2
    c0 = -np.linalg.det(m)
    inside = 1 - c0**2 - abs(c1 - c0 * c2)
    upper, lower = 1 + c2 + c1 + c0, 1 - c2 + c1 - c0
    return (upper >= -_ROUNDING) & (lower >= 0) & (inside >= -_ROUNDING)


def limits(method: str, zeta: NDArray[np.float64]) -> NDArray[np.float64]:
    """The s at which boundedness first ends, for each zeta: a scan, then bisection to the end."""
    # The limits lie below 2 without damping and fall as 1 / zeta with much of it.
    unit = np.linspace(0, 4, 1025)
    first = np.empty(len(zeta), int)
    for begin in range(0, len(zeta), 64):
        part = zeta[begin : begin + 64, None]
        first[begin : begin + 64] = np.argmin(_bounded(method, unit[1:] / (1 + part), part), axis=1)
    low, high = unit[first] / (1 + zeta), unit[first + 1] / (1 + zeta)
    while True:
        middle = (low + high) / 2
        if not np.any((low < middle) & (middle < high)):
            return low
        stable = _bounded(method, middle, zeta)
        low, high = np.where(stable, middle, low), np.where(stable, high, middle)


def second_order_methods() -> tuple[str, ...]:
    """Names of the methods that have an amplification matrix: those of `solve_second_order`.

    Returns
    -------
    tuple of str
        In rising order of cost.

    Examples
    --------
    >>> import substep
    >>> substep.stability.second_order_methods()
    ('symplectic_euler', 'position_verlet', 'velocity_verlet', 'yoshida4')
    """
    return tuple(MAPS)


def amplification_matrix(
    method: str, h_omega: ArrayLike, damping_ratio: float = 0.0
) -> NDArray[np.float64]:
    """Amplification matrix of one step on x'' = -omega^2 x - 2 zeta omega v.

    It maps (x, v / omega). With damping, both Verlets and Yoshida 4 carry their acceleration, taken
    at the predicted velocity, from step to step: then it maps (x, v / omega, a / omega^2).

    Parameters
    ----------
    method : str
        One of `second_order_methods()`, in upper or lower case.
    h_omega : array_like of float, any shape
        Step times angular frequency [rad].
    damping_ratio : float
        zeta = c / (2 m omega), at least 0; 1 is critical [1].

    Returns
    -------
    ndarray, shape h_omega.shape + (2, 2) or + (3, 3), float64
        (2, 2) without damping and for symplectic Euler.

    Raises
    ------
    InputError
        If the method is unknown, h_omega is not finite or the damping ratio is negative.

    References
    ----------
    Hairer, Lubich and Wanner, "Geometric Numerical Integration", I (1.9), (1.15), (1.17); II (4.4).

    Examples
    --------
    The symplectic map has determinant 1 and trace 2 - (h omega)^2:

    >>> import substep
    >>> substep.stability.amplification_matrix("symplectic_euler", 0.5)
    array([[ 0.75,  0.5 ],
           [-0.5 ,  1.  ]])
    """
    name = check_choice("method", method, second_order_methods())
    steps = check_array("h_omega", h_omega)
    zeta = check_real("damping_ratio", damping_ratio, nonnegative=True)
    with in_range("h_omega, damping_ratio"):
        return _matrix(name, steps, zeta)


def amplification_eigenvalues(
    method: str, h_omega: ArrayLike, damping_ratio: float = 0.0
) -> NDArray[np.complex128]:
    """Eigenvalues of `amplification_matrix`; the solution is bounded where none exceeds modulus 1.

    At stability's end without damping two of them meet at -1 with one eigenvector: there
    the solution grows linearly.

    Parameters
    ----------
    method : str
        One of `second_order_methods()`.
    h_omega : array_like of float, any shape
        Step times angular frequency [rad].
    damping_ratio : float
        zeta, at least 0 [1].

    Returns
    -------
    ndarray, shape h_omega.shape + (2,) or + (3,), complex128
        In no particular order.

    Raises
    ------
    InputError
        As `amplification_matrix`.

    References
    ----------
    Hairer, Lubich and Wanner, "Geometric Numerical Integration", I.5.

    Examples
    --------
    >>> import numpy as np
    >>> import substep
    >>> np.round(np.abs(substep.stability.amplification_eigenvalues("velocity_verlet", 1.9)), 12)
    array([1., 1.])
    """
    matrices = amplification_matrix(method, h_omega, damping_ratio)
    return np.asarray(np.linalg.eigvals(matrices), complex)


def stability_limit(method: str, damping_ratio: float = 0.0) -> float:
    """Largest h omega up to which a method for x'' = a keeps the damped oscillator bounded.

    Damping narrows it: symplectic Euler ends at 2 (sqrt(1 + zeta^2) - zeta), both Verlets at
    2 (sqrt(1 + 4 zeta^2) - 2 zeta).

    Parameters
    ----------
    method : str
        One of `second_order_methods()`.
    damping_ratio : float
        zeta, at least 0 [1].

    Returns
    -------
    float
        The limit of h omega [rad].

    Raises
    ------
    InputError
        If the method is unknown or the damping ratio is negative.

    References
    ----------
    Hairer, Lubich and Wanner, "Geometric Numerical Integration", I.5; the criterion is Jury's.

    Examples
    --------
    >>> import substep
    >>> substep.stability.stability_limit("symplectic_euler")
    2.0
    >>> round(substep.stability.stability_limit("yoshida4"), 6)
    1.573402
    """
    name = check_choice("method", method, second_order_methods())
    zeta = check_real("damping_ratio", damping_ratio, nonnegative=True)
    with in_range("damping_ratio"):
        return float(limits(name, np.array([zeta]))[0])
