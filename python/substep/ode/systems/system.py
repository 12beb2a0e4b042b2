"""The base of the compiled systems."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ... import _core
from ...base.attributes import Frozen
from ...base.checks import check_array
from ...base.imports import needs
from ...errors import InputError


class System(Frozen):
    """A compiled system y' = f(t, y).

    Parameters
    ----------
    native : _core.System
        The compiled part.

    Attributes
    ----------
    size : int
        Number n of components.
    y0 : ndarray, shape (n,), or None
        The classical initial state, where there is one.
    t_end : float or None
        The classical end, for a start at 0, where there is one.

    Examples
    --------
    >>> import substep
    >>> substep.systems.Kepler().size
    4
    """

    y0: NDArray[np.float64] | None = None
    t_end: float | None = None

    def __init__(self, native: _core.System) -> None:
        self.native_system = native

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

    def jacobian(self, t: float, y: ArrayLike) -> Any:
        """Evaluate df/dy, where the system has it.

        Parameters
        ----------
        t : float
            Time.
        y : array_like, shape (n,)
            State.

        Returns
        -------
        ndarray or scipy.sparse.csc_array, shape (n, n)
            Entry [i, j] is df_i/dy_j; sparse for systems with diffusion on a grid.

        Raises
        ------
        InputError
            The system has no Jacobian of its own.
        """
        state = check_array("y", y, (self.size,), finite=False)
        found = self.native_system.jacobian(t, state)
        if isinstance(found, np.ndarray):
            return found
        with needs("scipy", "a sparse Jacobian needs SciPy: pip install scipy"):
            from scipy.sparse import csc_array
        start, row, values = found
        return csc_array((values, row, start), shape=(self.size, self.size))

    @np.errstate(all="ignore")  # as in `__call__`, what is too large becomes infinite
    def jacobian_product(self, t: float, y: ArrayLike, v: ArrayLike) -> np.ndarray[Any, Any]:
        """Evaluate df/dy v; on grids without the matrix.

        Parameters
        ----------
        t : float
            Time.
        y, v : array_like, shape (n,)
            State and vector.

        Returns
        -------
        ndarray, shape (n,)
            Product of the Jacobian and v.

        Raises
        ------
        InputError
            The system has no Jacobian of its own.
        """
        state, vector = (
            check_array(name, value, (self.size,), finite=False)
            for name, value in (("y", y), ("v", v))
        )
        if self.native_system.has_jacobian_product:
            return np.asarray(self.native_system.jacobian_product(t, state, vector))
        return np.asarray(self.jacobian(t, state) @ vector)

    def _states(self, y: ArrayLike) -> NDArray[np.float64]:
        """One state, or several in columns; checked."""
        states: NDArray[np.float64] = check_array("y", y, finite=False)
        if states.shape[:1] != (self.size,) or states.ndim > 2:
            wanted = f"({self.size},) or ({self.size}, m)"
            raise InputError(f"y: expected shape {wanted}, got {states.shape}")
        return states


class ClassicalSystem(System):
    """A compiled system with a classical start `y0` and end `t_end`."""

    y0: NDArray[np.float64]
    t_end: float

    def __init__(self, native: _core.System, y0: ArrayLike, t_end: float) -> None:
        super().__init__(native)
        self.y0 = np.array(y0, dtype=float)
        self.t_end = t_end
