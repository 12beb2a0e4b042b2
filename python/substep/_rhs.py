"""Right-hand sides: what may be passed as `fun`, and the native system that is made of it."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import numpy as np

from . import _core
from ._checks import check_array, describe
from .errors import InputError

_FUNCTION_POINTER: Any = type(ctypes.pythonapi.Py_IncRef).__mro__[1]  # of all ctypes functions
_SIGNATURE = "void(double t, double* y, double* dydt, double* p)"


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
    address, user_data = _find_address(fun)
    if address is not None:
        _refuse_complex(complex_y)
        parameters = _parameters(args) if args is not None else user_data
        return _core.PointerSystem(address, components, parameters)
    if not callable(fun):
        raise TypeError(
            "fun: expected a callable fun(t, y), a compiled function "
            f"{_SIGNATURE} or a system of substep.systems, got {describe(fun)}"
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
    except TypeError:
        raise TypeError(f"args: expected a tuple, as in args=({args!r},)") from None


def _refuse_complex(complex_y: bool) -> None:
    if complex_y:
        raise TypeError("y0: compiled systems have real states, got complex numbers")


def _parameters(args: Any) -> np.ndarray[Any, Any]:
    if isinstance(args, tuple) and len(args) == 1 and np.ndim(args[0]) == 1:
        args = args[0]
    return check_array("args", args, (None,), finite=False)


def _find_address(fun: Any) -> tuple[int | None, Any]:
    """Address of a compiled function and its default parameters, or None."""
    nothing = np.zeros(0)
    if type(fun).__name__ == "LowLevelCallable" and isinstance(fun, tuple):
        return _low_level_callable(fun)
    if isinstance(fun, _FUNCTION_POINTER):
        _check_ctypes(fun)
        return ctypes.cast(fun, ctypes.c_void_p).value, nothing
    if isinstance(getattr(fun, "address", None), int) and hasattr(fun, "ctypes"):  # numba.cfunc
        signature = getattr(fun, "_sig", None)
        if signature is not None:
            given = [str(a) for a in signature.args]
            wanted = ["float64", "float64*", "float64*", "float64*"]
            if given != wanted or str(signature.return_type) not in ("void", "none"):
                raise InputError(f"fun: expected a cfunc {_SIGNATURE}, got {signature}")
        return fun.address, nothing
    return None, nothing


def _check_ctypes(fun: Any) -> None:
    types = fun.argtypes
    pointers = (ctypes.c_void_p, ctypes.POINTER(ctypes.c_double))
    if types is not None and not (
        len(types) == 4 and types[0] is ctypes.c_double and all(t in pointers for t in types[1:])
    ):
        names = ", ".join(t.__name__ for t in types)
        raise InputError(f"fun: expected a ctypes function {_SIGNATURE}, got ({names})")


def _low_level_callable(fun: Any) -> tuple[int, Any]:
    """Address of a scipy.LowLevelCallable; its user_data is the parameters p."""
    signature = fun.signature.replace(" ", "")
    if not signature.startswith("void(double,double*,double*,"):
        raise InputError(f"fun: expected a LowLevelCallable {_SIGNATURE}, got {fun.signature!r}")
    api = ctypes.pythonapi
    for function in (api.PyCapsule_GetName, api.PyCapsule_GetContext):
        function.argtypes = [ctypes.py_object]
    api.PyCapsule_GetName.restype = ctypes.c_char_p
    api.PyCapsule_GetContext.restype = api.PyCapsule_GetPointer.restype = ctypes.c_void_p
    api.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    capsule = tuple.__getitem__(fun, 0)
    address: int = api.PyCapsule_GetPointer(capsule, api.PyCapsule_GetName(capsule))
    user_data = api.PyCapsule_GetContext(capsule)
    if user_data is None:
        return address, np.zeros(0)
    # Its length is the function's business; only the address is used.
    return address, np.ctypeslib.as_array((ctypes.c_double * 1).from_address(user_data))


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
        return np.array(array, dtype=dtype, order="C", subok=False)

    return convert
