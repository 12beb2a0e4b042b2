"""What a state holds, declared once for each class; `check` holds a state to it.

An entry says name, type, shape and bounds. Sizes in shapes are numbers, or names: of sizes that the
object gives, or of lengths that the first array with that name in its shape settles.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .checks import check_integer, check_real, check_within, describe, first_bad_index

MOST = 2**62  # of what is counted
OWN = "own"  # the dtype that the object computes with


@dataclass(frozen=True)
class Number:
    """A real number, an integer, a flag or a text, by its Python type."""

    name: str
    kind: type = float
    low: float | None = None
    high: float | None = None

    def check(self, state: Mapping[str, Any], sizes: dict[str, int], own: Any) -> Any:
        """The number, or InputError."""
        label, value = f"state[{self.name!r}]", state[self.name]
        if self.kind is float:
            return check_real(label, value, nonnegative=self.low == 0)
        if self.kind is int:
            low = None if self.low is None else int(self.low)
            return check_integer(
                label, value, minimum=low, maximum=None if self.high is None else int(self.high)
            )
        if not isinstance(value, self.kind):
            raise InputError(f"{label}: expected {self.kind.__name__}, got {describe(value)}")
        return value


@dataclass(frozen=True)
class Rows:
    """An array. `below` is another entry that all numbers are below.

    `optional`: it may have no rows instead. `finite`: what of NaN and infinity it may hold.
    """

    name: str
    dtype: Any
    shape: tuple[int | str | None, ...]
    low: float | None = None
    high: float | None = None
    below: str | None = None
    rising: bool = False
    distinct: bool = False
    optional: bool = False
    unit: bool = False  # rows of length 1
    flat: bool = False  # the third number of each row is 0: in the plane
    narrow: bool = False  # what the dtype that the object computes with can hold
    finite: str = "finite"  # or "no NaN" or "any"

    def check(self, state: Mapping[str, Any], sizes: dict[str, int], own: Any) -> NDArray[Any]:
        """A new array, or InputError."""
        label = f"state[{self.name!r}]"
        try:
            array = np.array(state[self.name], order="C")
        except ValueError as error:
            raise InputError(f"{label}: expected an array; {error}") from None
        wanted = np.dtype(own if self.dtype is OWN else self.dtype)
        if array.dtype != wanted:
            raise InputError(f"{label}: expected dtype {wanted}, got {array.dtype}")
        self._check_shape(label, array, sizes)
        self._check_values(label, array, state)
        if self.narrow:
            check_within(label, array, np.dtype(own))
        return array

    def _check_shape(self, label: str, array: NDArray[Any], sizes: dict[str, int]) -> None:
        shape = [sizes.get(part, part) if isinstance(part, str) else part for part in self.shape]
        fits = array.ndim == len(shape) and all(
            not isinstance(want, int) or want == got
            for want, got in zip(shape, array.shape, strict=True)
        )
        if self.optional and array.ndim == len(shape) and len(array) == 0:
            return
        if not fits:
            told = ", ".join("any" if part is None else str(part) for part in shape)
            told += "," if len(shape) == 1 else ""
            raise InputError(f"{label}: expected shape ({told}), got {array.shape}")
        for want, got in zip(shape, array.shape, strict=True):
            if isinstance(want, str):
                sizes[want] = got

    def _check_values(self, label: str, array: NDArray[Any], state: Mapping[str, Any]) -> None:
        if array.dtype.kind == "f" and self.finite != "any":
            wrong = np.isnan(array) if self.finite == "no NaN" else ~np.isfinite(array)
            self._refuse(label, array, wrong, "a finite number")
        if self.low is not None:
            self._refuse(label, array, array < self.low, f"at least {self.low}")
        if self.high is not None:
            self._refuse(label, array, array > self.high, f"at most {self.high}")
        if self.below is not None:
            end = state[self.below]
            self._refuse(label, array, array >= end, f"a number below {self.below}, {end}")
        if self.rising and (np.diff(array) <= 0).any():
            raise InputError(f"{label}: expected ascending numbers")
        if self.distinct and len(np.unique(array)) != array.size:
            raise InputError(f"{label}: expected different numbers")
        if self.unit:
            with np.errstate(over="ignore"):
                length = np.linalg.norm(array, axis=1)
            self._refuse(label, length, ~(np.abs(length - 1) <= 1e-9), "a row of length 1")
        if self.flat and len(array):
            across = array[:, 2]
            self._refuse(label, across, across != 0, "0 across the plane")

    def _refuse(self, label: str, array: NDArray[Any], wrong: Any, wanted: str) -> None:
        if wrong.any():
            where = first_bad_index(wrong) if wrong.ndim else ""
            raise InputError(f"{label}{where}: expected {wanted}, got {array[wrong].flat[0]}")


@dataclass(frozen=True)
class Texts:
    """A list of texts, as JSON."""

    name: str
    size: str

    def check(self, state: Mapping[str, Any], sizes: dict[str, int], own: Any) -> list[str]:
        """The texts, or InputError."""
        count = sizes[self.size]
        wrong = InputError(f"state[{self.name!r}]: expected {count} texts as JSON")
        try:
            texts = json.loads(state[self.name])
            if isinstance(texts, list) and len(texts) == count:
                "".join(texts).encode()
                return texts
        except (TypeError, ValueError, RecursionError):
            pass
        raise wrong


Entry = Number | Rows | Texts
TIME = Number("time")


def check(
    schema: Iterable[Entry], state: Any, sizes: Mapping[str, int], own: Any = np.float64
) -> dict[str, Any]:
    """What a state holds under the names of a schema, as new objects.

    Raises InputError, which names the entry, before anything is changed.
    """
    if not isinstance(state, Mapping):
        raise InputError(f"state: expected a dict of state(), got {describe(state)}")
    entries = list(schema)
    missing = [entry.name for entry in entries if entry.name not in state]
    if missing:
        raise InputError(f"state: {', '.join(sorted(missing))} missing")
    known = dict(sizes)
    return {entry.name: entry.check(state, known, own) for entry in entries}
