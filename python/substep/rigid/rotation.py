"""The rotation of rigid bodies on which nothing acts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import (
    check_array,
    check_choice,
    check_integer,
    check_real,
    check_threads,
    first_bad_index,
    in_range,
)
from ..base.quaternions import unit_quaternions
from ..errors import InputError, NonFiniteError

Array = NDArray[np.float64]


def free_rotation(
    rotations: ArrayLike,
    angular_momenta: ArrayLike,
    inertia: ArrayLike,
    duration: float,
    *,
    method: str = "exact",
    steps: int = 1,
    threads: int | None = None,
) -> Array:
    """Rotations of bodies on which no torque acts, after a time.

    Parameters
    ----------
    rotations : array_like, shape (n, 4)
        Quaternions (w, x, y, z) that take the principal axes of each body into the world; are
        normalised.
    angular_momenta : array_like, shape (n, 3)
        Angular momenta in the world [kg m^2/s]. They do not change.
    inertia : array_like, shape (n, 3)
        Principal moments of inertia [kg m^2].
    duration : float
        Time, forward or backward [s].
    method : {"exact", "splitting", "quaternion", "matrix"}, optional
        "exact" is the solution by Jacobi's elliptic functions: one step is enough. "splitting" is
        symplectic and of second order; its energy does not drift. "quaternion" and "matrix" are the
        first-order updates of textbooks, for comparison: their energy drifts.
    steps : int, optional
        Number of equal steps.
    threads : int, optional
        Threads to use.

    Returns
    -------
    ndarray, shape (n, 4)
        Unit quaternions after `duration`.

    Raises
    ------
    InputError
        If a quaternion is 0, a moment is not above 0 or greater than the sum of the other two, or
        the numbers of rows differ.
    NonFiniteError
        If a rotation is beyond the range of float64.

    References
    ----------
    van Zon and Schofield (2007), J. Comput. Phys. 225, 145 ("exact"); Touma and Wisdom (1994),
    Astron. J. 107, 1189, and Dullweber, Leimkuhler and McLachlan (1997), J. Chem. Phys. 107, 5840
    ("splitting").

    Examples
    --------
    A box that spins about its middle axis turns over, within 4.5 s:

    >>> import numpy as np
    >>> import substep
    >>> inertia = np.array([[0.0241666667, 0.0866666667, 0.1041666667]])
    >>> momentum = inertia * [0.01, 5.0, 0.0]
    >>> q = substep.rigid.free_rotation([[1, 0, 0, 0]], momentum, inertia, 4.538872)
    >>> w, x, y, z = q[0]
    >>> round(float(1 - 2 * (x * x + z * z)), 3)  # the y axis of the body along that of the world
    -1.0
    """
    q = unit_quaternions("rotations", rotations, (None, 4))
    L = check_array("angular_momenta", angular_momenta, (len(q), 3))
    moments = check_array("inertia", inertia, (len(q), 3))
    wrong = ~(moments > 0)
    if wrong.any():
        raise InputError(
            f"inertia{first_bad_index(wrong)}: expected a number above 0, got {moments[wrong][0]}"
        )
    with in_range("inertia"):
        wrong = 2 * moments.max(axis=1, initial=0) > moments.sum(axis=1) * (1 + 1e-9)
    if wrong.any():
        raise InputError(
            f"inertia{first_bad_index(wrong)}: expected moments none of which is greater than the "
            f"sum of the other two, got {moments[wrong][0].tolist()}"
        )
    count = check_integer("steps", steps, minimum=1, maximum=2**62)
    dt = check_real("duration", duration) / count
    name = check_choice("method", method, ("exact", "splitting", "quaternion", "matrix"))
    turned: Array = _core.rotate_freely(name, q, L, moments, dt, count, check_threads(threads))
    finite = np.isfinite(turned).all(axis=1)
    if not finite.all():
        i = int(np.argmin(finite))
        raise NonFiniteError(
            f"rotations[{i}] is not finite after {duration} s: the angle is beyond float64", index=i
        )
    return turned
