"""Argument checks at the boundary: they name the argument, what was required and what came."""

from __future__ import annotations

import contextlib
import operator
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from ..errors import InputError

MOST_THREADS = 1024
MOST_INT = 2**31 - 1  # of an int of the native core


def describe(value: Any) -> str:
    """What came, short enough for one line."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and dtype {value.dtype}"
    try:
        text = repr(value)
    except ValueError:  # Python writes no integers beyond 4300 digits
        text = f"a value of type {type(value).__name__}, too long to be written"
    return text if len(text) <= 60 else f"{text[:57]}..."


def first_bad_index(bad: NDArray[np.bool_]) -> str:
    """Index of the first True, as `[i, j]`."""
    return str([int(i) for i in np.unravel_index(int(np.argmax(bad)), bad.shape)])


def as_array(name: str, value: Any) -> NDArray[Any]:
    """A C-contiguous copy; rows of unequal length and masked values raise InputError.

    What is checked is then what is used, whatever another thread, or the conversion of the next
    argument, writes into the caller's array. Exceptions of its own `__array__` pass.
    """
    if isinstance(value, np.ma.MaskedArray) and np.ma.getmaskarray(value).any():
        raise InputError(f"{name}: masked values are not accepted; fill or drop them")
    try:
        array = np.asarray(value)  # of lists and numbers a new one
        return array if type(value) in (list, tuple) else np.array(array, order="C")
    except ValueError as error:
        if is_callers(error):
            raise
        wanted = "rows of equal length" if isinstance(value, (list, tuple)) else "an array"
        raise InputError(f"{name}: expected {wanted}; {error}") from None


def is_callers(error: Exception) -> bool:
    """Whether code of the caller raised it, as an object's own `__array__`, and no conversion."""
    return error.__traceback__ is not None and error.__traceback__.tb_next is not None


def as_integers(name: str, value: Any) -> NDArray[Any]:
    """As `as_array`, where nothing, of whatever dtype, is no integers; others are not checked."""
    array = as_array(name, value)
    return array if array.size else np.zeros(array.shape, np.int64)


def check_array(
    name: str,
    value: Any,
    shape: tuple[int | None, ...] | None = None,
    *,
    dtype: DTypeLike = np.float64,
    complex_ok: bool = False,
    finite: bool = True,
) -> NDArray[Any]:
    """Convert to a new C-contiguous, aligned array; None in `shape` is any length.

    Integers below 2**53, booleans and narrower floats are widened. Complex numbers (unless
    `complex_ok`), objects, strings and records raise TypeError; masked values, other shapes and, if
    `finite`, NaN or infinity raise InputError. Exceptions of its own `__array__` pass.
    """
    array = as_array(name, value)
    if array.dtype.kind not in ("fiubc" if complex_ok else "fiub"):
        wanted = "real or complex numbers" if complex_ok else "real numbers"
        raise TypeError(f"{name}: expected {wanted}, got dtype {array.dtype}")
    if shape is not None and (
        array.ndim != len(shape)
        or any(
            want is not None and want != got for want, got in zip(shape, array.shape, strict=True)
        )
    ):
        wanted = "(" + ", ".join("n" if n is None else str(n) for n in shape)
        wanted += ",)" if len(shape) == 1 else ")"
        in_plane = array.ndim == len(shape) > 0 and (shape[-1], array.shape[-1]) == (3, 2)
        hint = "; of two dimensions give z = 0 as the third number" if in_plane else ""
        raise InputError(f"{name}: expected shape {wanted}, got {array.shape}{hint}")
    target = np.complex128 if array.dtype.kind == "c" else dtype
    with np.errstate(over="ignore", invalid="ignore"):  # invalid: a signaling NaN
        result = array.astype(target, copy=False)
    if array.dtype.kind in "iu" and array.dtype.itemsize == 8 and result.dtype.kind == "f":
        inexact = np.abs(result) >= 2.0**53
        if inexact.any():
            where = first_bad_index(inexact) if result.ndim else ""
            raise InputError(
                f"{name}{where}: expected integers below 2**53, got {array[inexact].flat[0]}"
            )
    if finite and result.dtype.kind in "fc":
        bad = ~np.isfinite(result)
        if bad.any():
            where = first_bad_index(bad) if result.ndim else ""
            raise InputError(f"{name}{where}: expected finite numbers, got {result[bad].flat[0]}")
    return result


def check_within(name: str, array: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    """The array, where all of its numbers are finite in the narrower dtype too."""
    wrong = ~(np.abs(array) <= float(np.finfo(dtype).max))
    if wrong.any():
        raise InputError(f"{name}{first_bad_index(wrong)}: {array[wrong][0]} is beyond {dtype}")
    return array


def check_most(name: str, array: NDArray[Any], most: float) -> NDArray[Any]:
    """The array, where no number is larger than that."""
    wrong = np.abs(array) > most
    if wrong.any():
        where = first_bad_index(wrong) if wrong.ndim else ""
        raise InputError(f"{name}{where}: expected numbers within {most}, got {array[wrong][0]}")
    return array


@contextlib.contextmanager
def in_range(name: str) -> Iterator[None]:
    """Refuse arguments, by their names, of which something is computed that float64 cannot hold."""
    try:
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            yield
    except (FloatingPointError, OverflowError) as error:
        wanted = "numbers of a size that can be computed with"
        raise InputError(f"{name}: expected {wanted}; {error}") from None


def check_sparse(name: str, matrix: Any) -> Any:
    """A sparse matrix, whose indices SciPy would trust: with wrong ones it leaves its memory."""
    if hasattr(matrix, "check_format"):
        try:
            matrix.check_format()
        except ValueError as error:
            raise InputError(f"{name}: {error}") from None
    return matrix


def check_real(
    name: str,
    value: Any,
    *,
    positive: bool = False,
    nonnegative: bool = False,
    finite: bool = True,
) -> float:
    """A real number as float; NaN never passes. Exceptions of its own `__float__` pass."""
    kind = getattr(getattr(value, "dtype", None), "kind", "f")
    is_number = hasattr(type(value), "__float__") or hasattr(type(value), "__index__")
    is_number &= not isinstance(value, bool)  # what else float() takes is text, buffers too
    if not is_number or kind not in "fiu" or getattr(value, "ndim", None):
        raise TypeError(f"{name}: expected a real number, got {describe(value)}")
    if np.ma.is_masked(value):
        raise InputError(f"{name}: expected a number, got a masked one")
    try:
        number = (
            float(operator.index(value)) if isinstance(value, (int, np.integer)) else float(value)
        )
    except (OverflowError, TypeError, ValueError) as error:
        if is_callers(error):
            raise
        if isinstance(error, OverflowError):
            wanted = "a finite number, got an integer beyond float64"
            raise InputError(f"{name}: expected {wanted}") from None
        raise TypeError(f"{name}: expected a real number, got {describe(value)}") from None
    if number != number or (finite and abs(number) == float("inf")):
        raise InputError(f"{name}: expected a finite number, got {number}")
    if positive and number <= 0:
        raise InputError(f"{name}: expected a number above 0, got {number}")
    if nonnegative and number < 0:
        raise InputError(f"{name}: expected a number of at least 0, got {number}")
    return number


def check_integer(
    name: str, value: Any, *, minimum: int | None = None, maximum: int | None = None
) -> int:
    """An integer (booleans and 1.5 are none) within its bounds.

    What an object's own `__index__` raises passes.
    """
    try:
        if isinstance(value, (bool, np.bool_)):
            raise TypeError
        number = operator.index(value)
    except TypeError as error:
        if is_callers(error):
            raise
        raise InputError(f"{name}: expected an integer, got {describe(value)}") from None
    if (minimum is not None and number < minimum) or (maximum is not None and number > maximum):
        bounds = f"at least {minimum}" if maximum is None else f"from {minimum} to {maximum}"
        raise InputError(f"{name}: expected an integer {bounds}, got {describe(number)}")
    return number


def check_choice(
    name: str,
    value: Any,
    choices: Iterable[str],
    *,
    aliases: Mapping[str, Sequence[str]] | None = None,
) -> str:
    """One of the names, whatever its case, or of their other names; returned as listed."""
    listed = list(choices)
    others = {} if aliases is None else aliases
    if isinstance(value, str):
        if value in listed:
            return value
        for choice in listed:
            if value.lower() in (choice.lower(), *others.get(choice, ())):
                return choice
    told = [
        choice + (f" (or {', '.join(others[choice])})" if others.get(choice) else "")
        for choice in listed
    ]
    raise InputError(f"{name}: expected one of {', '.join(told)}; got {describe(value)}")


def check_name(name: str, value: Any, known: Iterable[str]) -> str:
    """A name that the caller gave to something, as a part or a field, whose case counts."""
    listed = list(known)
    if not isinstance(value, str) or value not in listed:
        told = f"one of {', '.join(listed)}" if listed else "none, for there are none"
        raise InputError(f"{name}: expected {told}; got {describe(value)}")
    return value


def check_callable(name: str, value: Any) -> Any:
    """Something that can be called."""
    if not callable(value):
        raise TypeError(f"{name}: expected a callable, got {describe(value)}")
    return value


def check_flag(name: str, value: Any) -> bool:
    """A bool, of Python or of NumPy."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{name}: expected a bool, got {describe(value)}")
    return bool(value)


def check_sequence(name: str, value: Any, wanted: str) -> list[Any]:
    """The items of a list or of anything else that gives them one by one."""
    if isinstance(value, (str, bytes, memoryview)) or not isinstance(value, Iterable):
        raise TypeError(f"{name}: expected a list of {wanted}, got {describe(value)}")
    return list(value)


def check_threads(threads: Any) -> int:
    """A number of threads for the native core; None is the default, 0."""
    if threads is None:
        return 0
    return check_integer("threads", threads, minimum=1, maximum=MOST_THREADS)


def check_dtype(dtype: Any) -> np.dtype[Any]:
    """Of the numbers that a simulation computes with."""
    try:
        found = np.dtype(dtype)
    except (TypeError, ValueError):
        found = None
    if found not in (np.float32, np.float64):
        raise InputError(f"dtype: expected float32 or float64, got {describe(dtype)}")
    return found


def check_positive(
    name: str, value: ArrayLike, count: int, *, zero: bool = False
) -> NDArray[np.float64]:
    """One number for all of `count` items or one each: finite, above 0 (or, with `zero`, 0)."""
    given = as_array(name, value)
    array = check_array(name, given if given.ndim else np.repeat(given, count), (count,))
    wrong = array < 0 if zero else array <= 0
    if wrong.any():
        index, wanted = int(np.argmax(wrong)), "at least 0" if zero else "above 0"
        raise InputError(f"{name}[{index}]: expected a number {wanted}, got {array[index]}")
    return array


def check_path(path: Any, name: str = "path") -> str:
    """A file name as a string."""
    if not isinstance(path, (str, bytes, os.PathLike)):
        raise TypeError(f"{name}: expected a file name, got {describe(path)}")
    text = os.fsdecode(path)
    try:
        if not os.fsencode(text) or "\0" in text:
            raise ValueError
    except ValueError:
        raise InputError(f"{name}: expected a file name, got {describe(text)}") from None
    return text


def check_pinned(pinned: ArrayLike, count: int) -> NDArray[np.uint8]:
    """One flag for each of `count` vertices, from their indices or from flags."""
    array = as_array("pinned", pinned)
    flags = np.zeros(count, np.uint8)
    if array.dtype == bool:
        flags[:] = check_array("pinned", array, (count,), dtype=np.uint8)
    elif array.size:
        if array.dtype.kind not in "iu" or array.ndim != 1:
            raise InputError("pinned: expected indices of vertices, or one boolean for each")
        wrong = (array < 0) | (array >= count)
        if wrong.any():
            k = int(np.argmax(wrong))
            raise InputError(
                f"pinned[{k}]: expected an index from 0 to {count - 1}, got {array[k]}"
            )
        flags[array] = 1
    return flags
