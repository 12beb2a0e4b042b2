"""What batches share: worlds by their numbers, and the states of all as arrays."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .checks import as_integers, check_choice, check_integer, check_sequence, describe
from .rows import read_only
from .schema import Entry, Number, Rows
from .simulation import Simulation

Ids = NDArray[np.int64]


class Worlds(Simulation):
    """Many worlds of one class in one simulation."""

    _rows_are: ClassVar[str] = "worlds"

    _mask: bool  # whether a world that fails stops alone

    def __len__(self) -> int:
        raise NotImplementedError

    @property
    def _class(self) -> str:
        """What each world is."""
        raise NotImplementedError

    @property
    def times(self) -> NDArray[np.float64]:
        """Time of the state of each world [s], shape (w,); read-only."""
        return read_only(self._native.times)

    @property
    def failures(self) -> list[str]:
        """Why a world takes no part any more, empty if it does; of `on_fail` 'mask'."""
        failures: list[str] = self._native.failures
        return failures

    def _contents(self) -> list[str]:
        stopped = sum(map(bool, self.failures))
        told = [f"{len(self)} worlds of {self._class}"]
        return told + ([f"{stopped} stopped"] if stopped else [])

    def _shortest(self, ask: Callable[[int], tuple[float, str]]) -> tuple[float, str]:
        """The shortest step of the worlds that go on, and why."""
        limits = {w: ask(w) for w, reason in enumerate(self.failures) if not reason}
        stopped = len(self) - len(limits)
        if not limits:
            return math.inf, "all worlds have stopped" if stopped else "there is no world"
        first = min(limits, key=lambda w: limits[w][0])
        told = f"; {stopped} of {len(self)} worlds have stopped" if stopped else ""
        return limits[first][0], f"world {first}: {limits[first][1]}{told}"

    def _checked(self, state: dict[str, Any]) -> dict[str, Any]:
        """As of other simulations, once it is of as many worlds of this class."""
        try:
            found = len(json.loads(state["failures"])), state.get("class", self._class)
        except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
            return super()._checked(state)  # which says what is wrong
        if isinstance(found[1], str) and found != (len(self), self._class):
            raise InputError(
                f"state: expected one of {len(self)} worlds of {self._class}, "
                f"got one of {found[0]} worlds of {found[1][:60]}"
            )
        return super()._checked(state)


def check_templates(template: Any, worlds: Any, one: type, kind: str, *, least: int) -> list[Any]:
    """What each world is a copy of: the same for all, or one each."""
    if isinstance(template, one):
        if worlds is None:
            raise InputError("worlds: expected how many")
        return [template] * check_integer("worlds", worlds, minimum=least, maximum=2**31 - 1)
    if worlds is not None:
        raise InputError("worlds: is for a single template; a list has one for each world")
    return check_sequence("template", template, kind)


def check_masks(on_fail: Any) -> bool:
    """Whether a world that fails stops alone."""
    return check_choice("on_fail", on_fail, ("raise", "mask")) == "mask"


def find_worlds(name: str, given: ArrayLike | None, count: int) -> Ids:
    """Numbers of worlds, each once; all unless given."""
    if given is None:
        return np.arange(count)
    numbers = as_integers(name, given)
    if numbers.ndim > 1 or numbers.dtype.kind not in "iu":
        raise InputError(f"{name}: expected integers, shape (k,), got {describe(given)}")
    several = numbers.ndim == 1
    numbers = np.atleast_1d(numbers)
    wrong = (numbers < 0) | (numbers >= count)
    if wrong.any():
        k = int(np.argmax(wrong))
        where = f"{name}[{k}]" if several else name
        raise IndexError(f"{where}: expected a number below {count}, got {numbers[k]}")
    check_once(name, numbers)
    return numbers.astype(np.int64)


def check_once(name: str, numbers: NDArray[Any]) -> None:
    """Refuse what is given twice."""
    if len(np.unique(numbers)) < len(numbers):
        raise InputError(f"{name}: expected each number once")


def check_failures(failures: Sequence[str], mask: bool) -> None:
    """Refuse a state with failed worlds, which stand still, where all worlds are to go on."""
    failed = [w for w, reason in enumerate(failures) if reason]
    if failed and not mask:
        more = f" and {len(failed) - 1} more" if len(failed) > 1 else ""
        raise InputError(
            "state['failures']: expected none, as on_fail is 'raise', "
            f"got world {failed[0]}{more}: {failures[failed[0]]}"
        )


def join_states(states: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Of numbers one array, of arrays one with all rows, and how many are each world's."""
    told: dict[str, Any] = {}
    for name in states[0] if states else ():
        parts = [np.asarray(state[name]) for state in states]
        if parts[0].ndim == 0:
            told[f"each_{name}"] = np.array(parts)
        else:
            told[f"all_{name}"] = np.concatenate(parts)
            told[f"count_{name}"] = np.array([len(part) for part in parts])
    return told


def joined_entries(entry: Entry) -> list[Entry]:
    """What a state of all worlds has of an entry of one."""
    name = entry.name
    if isinstance(entry, Rows):
        shape = (None,) * len(entry.shape)
        counts = Rows(f"count_{name}", np.int64, ("worlds",), low=0)
        return [counts, Rows(f"all_{name}", entry.dtype, shape, finite="any")]
    kind = entry.kind if isinstance(entry, Number) else float
    return [
        Rows(f"each_{name}", {int: np.int64, bool: np.bool_}.get(kind, np.float64), ("worlds",))
    ]


def state_of_world(state: dict[str, Any], w: int) -> dict[str, Any]:
    """The state of one world, out of that of all."""
    own: dict[str, Any] = {}
    for key, values in state.items():
        kind, _, name = key.partition("_")
        if kind == "each":
            own[name] = values[w].item()
        elif kind == "all":
            counts = state[f"count_{name}"]
            if counts.sum() != len(values):
                raise InputError(f"state[{key!r}]: expected {counts.sum()} rows")
            begin = int(counts[:w].sum())
            own[name] = values[begin : begin + int(counts[w])]
    return own
