"""Right-hand sides: what may be passed as `fun`, and the native system that is made of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .. import _core
from ..base.checks import as_array, check_array, describe
from ..base.pointers import RHS, find_address
from ..errors import InputError


def make_system(
    fun: Any, components: int, *, complex_y: bool, args: Any, vectorized: bool
) -> _core.System:
    """Make the native system for `fun`: a Python callable, a compiled function or a system."""
    native = getattr(fun, "native_system", fun)
    if isinstance(native, _core.System):
        if args is not None:
            raise InputError("args: a compiled system takes its parameters when it is made")
        _refuse_complex(complex_y)
        if native.size != components:
            raise InputError(f"y0: expected shape ({native.size},), got ({components},)")
        return native
    address, user_data = find_address("fun", fun, RHS)
    if address is not None:
        _refuse_complex(complex_y)
        parameters = pointer_parameters(args) if args is not None else user_data
        return _core.PointerSystem(address, components, parameters)
    if not callable(fun):
        raise TypeError(
            "fun: expected a callable fun(t, y), a compiled function "
            f"{RHS} or a system of substep.systems, got {describe(fun)}"
        )
    if vectorized:
        fun = _column_by_column(fun)
    return _core.PythonSystem(
        fun, components, complex_y, unpack_args(args), _converter(components, complex_y)
    )


def unpack_args(args: Any) -> tuple[Any, ...]:
    """`args` as a tuple, for Python callables."""
    try:
        return () if args is None else tuple(args)
    except (TypeError, NotImplementedError):  # the second is of memoryviews
        raise TypeError(f"args: expected a tuple, as in args=({args!r},)") from None


def _refuse_complex(complex_y: bool) -> None:
    if complex_y:
        raise TypeError("y0: compiled systems have real states, got complex numbers")


def pointer_parameters(args: Any) -> np.ndarray[Any, Any]:
    """The numbers that a compiled function gets, as one array."""
    if isinstance(args, tuple) and len(args) == 1 and as_array("args", args[0]).ndim == 1:
        args = args[0]
    return check_array("args", args, (None,), finite=False)


def _column_by_column(fun: Callable[..., Any]) -> Callable[..., Any]:
    """fun(t, y) of a fun that takes and returns columns (n, k), as SciPy's `vectorized` says."""

    def single(t: float, y: Any, *args: Any) -> Any:
        result = np.asarray(fun(t, y[:, None], *args))
        if result.shape != (y.size, 1):
            raise InputError(f"fun: expected shape ({y.size}, 1), got {result.shape}")
        return result[:, 0]

    return single


def _converter(components: int, complex_y: bool) -> Callable[[Any], np.ndarray[Any, Any]]:
    """What turns the less usual return values of a Python `fun` into the array it should be."""
    dtype = np.complex128 if complex_y else np.float64

    def convert(value: Any) -> np.ndarray[Any, Any]:
        try:
            array = np.asarray(value)
        except ValueError:
            raise InputError(
                f"fun: expected shape ({components},), got {describe(value)}"
            ) from None
        if array.dtype.kind not in ("fiubc" if complex_y else "fiub"):
            wanted = "complex" if complex_y else "real"
            raise InputError(f"fun: expected {wanted} numbers, got {describe(value)}")
        if isinstance(value, np.ma.MaskedArray) and np.ma.getmaskarray(value).any():
            raise InputError("fun: masked values are not accepted")
        if array.ndim == 0 and components == 1:
            array = array.reshape(1)
        if array.shape != (components,):
            raise InputError(f"fun: expected shape ({components},), got {array.shape}")
        with np.errstate(over="ignore", invalid="ignore"):  # invalid: a signaling NaN
            return np.array(array, dtype=dtype, order="C", subok=False)

    return convert
