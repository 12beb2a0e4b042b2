"""The base of the compiled systems."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import _core
from ._checks import check_array


class System:
    """A compiled system y' = f(t, y).

    Parameters
    ----------
    native : _core.System
        The compiled part.
    y0 : array_like, shape (n,), optional
        The classical initial state.
    t_end : float, optional
        The classical end, for a start at 0.

    Attributes
    ----------
    size : int
        Number n of components.
    y0 : ndarray, shape (n,), or None
        The classical initial state.
    t_end : float or None
        The classical end, for a start at 0.

    Examples
    --------
    >>> import substep
    >>> substep.systems.Kepler().size
    4
    """

    def __init__(
        self, native: _core.System, y0: ArrayLike | None = None, t_end: float | None = None
    ) -> None:
        self.native_system = native
        self.y0 = None if y0 is None else np.array(y0, dtype=float)
        self.t_end = t_end

    @property
    def size(self) -> int:
        """Number of components."""
        return self.native_system.size

    def __call__(self, t: float, y: ArrayLike) -> np.ndarray[Any, Any]:
        """Evaluate f(t, y).

        Parameters
        ----------
        t : float
            Time.
        y : array_like, shape (n,)
            State.

        Returns
        -------
        ndarray, shape (n,)
            Derivative.
        """
        return self.native_system.rhs(t, check_array("y", y, (self.size,), finite=False))
