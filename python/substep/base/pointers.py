"""Compiled functions of the user's: numba.cfunc, ctypes and scipy.LowLevelCallable."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from ..errors import InputError

_FUNCTION_POINTER: Any = type(ctypes.pythonapi.Py_IncRef).__mro__[1]  # of all ctypes functions
RHS = "void(double t, double* y, double* dydt, double* p)"
ACCELERATION = "void(double t, const double* x, const double* v, double* a, double* p)"


def find_address(name: str, fun: Any, signature: str) -> tuple[int | None, Any]:
    """Address of a compiled function of that signature and its default parameters, or None."""
    nothing = np.zeros(0)
    pointers = signature.count("*")
    if type(fun).__name__ == "LowLevelCallable" and isinstance(fun, tuple):
        return _low_level_callable(name, fun, signature)
    if isinstance(fun, _FUNCTION_POINTER):
        _check_ctypes(name, fun, signature)
        return ctypes.cast(fun, ctypes.c_void_p).value, nothing
    if isinstance(getattr(fun, "address", None), int) and hasattr(fun, "ctypes"):  # numba.cfunc
        given = getattr(fun, "_sig", None)
        if given is not None:
            wanted = ["float64"] * _numbers(signature) + ["float64*"] * pointers
            if [str(a) for a in given.args] != wanted or str(given.return_type) not in (
                "void",
                "none",
            ):
                raise InputError(f"{name}: expected a cfunc {signature}, got {given}")
        return fun.address, nothing
    return None, nothing


def _numbers(signature: str) -> int:
    """How many of its arguments come before the pointers: the time, or nothing."""
    return int("double t" in signature)


def _check_ctypes(name: str, fun: Any, signature: str) -> None:
    types = fun.argtypes
    pointers = (ctypes.c_void_p, ctypes.POINTER(ctypes.c_double))
    first = _numbers(signature)
    if types is not None and not (
        len(types) == first + signature.count("*")
        and all(t is ctypes.c_double for t in types[:first])
        and all(t in pointers for t in types[first:])
    ):
        names = ", ".join(t.__name__ for t in types)
        raise InputError(f"{name}: expected a ctypes function {signature}, got ({names})")


def _low_level_callable(name: str, fun: Any, signature: str) -> tuple[int, Any]:
    """Address of a scipy.LowLevelCallable; its user_data is the parameters p."""
    given = fun.signature.replace(" ", "").replace("const", "")
    # SciPy hands user_data to a last void *, which may stand for double * p.
    start = "void(" + "double," * _numbers(signature)
    pointers = given.removeprefix(start).removesuffix(")").split(",")
    doubles, last = pointers[:-1], pointers[-1]
    if (
        not given.startswith(start)
        or len(pointers) != signature.count("*")
        or any(p != "double*" for p in doubles)
        or last not in ("double*", "void*")
    ):
        raise InputError(f"{name}: expected a LowLevelCallable {signature}, got {fun.signature!r}")
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
