"""The state of many worlds as arrays: those of all worlds, one after the other."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..base.checks import check_real
from ..errors import InputError


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


def check_head(state: dict[str, Any], worlds: int) -> tuple[float, list[str]]:
    """The time and the failures of a state; `worlds` is how many there should be."""
    try:
        time, failures = state["time"], json.loads(state["failures"])
    except (KeyError, TypeError, ValueError):
        raise InputError("state: time or failures missing") from None
    if (
        not isinstance(failures, list)
        or len(failures) != worlds
        or not all(isinstance(reason, str) for reason in failures)
    ):
        raise InputError(f"state['failures']: expected one string for each of {worlds} worlds")
    return check_real("state['time']", time), failures


def state_of_world(state: dict[str, Any], w: int, worlds: int) -> dict[str, Any]:
    """The state of one world, out of that of all."""
    own: dict[str, Any] = {}
    for key, values in state.items():
        kind, _, name = key.partition("_")
        if kind == "each":
            each = np.asarray(values)
            if each.shape != (worlds,):
                raise InputError(f"state[{key!r}]: expected {worlds} numbers")
            own[name] = each[w].item()
        elif kind == "all":
            counts = np.asarray(state.get(f"count_{name}"))
            if counts.shape != (worlds,) or counts.dtype.kind not in "iu" or (counts < 0).any():
                raise InputError(f"state['count_{name}']: expected {worlds} counts")
            rows = np.asarray(values)
            if counts.sum() != len(rows):
                raise InputError(f"state[{key!r}]: expected {counts.sum()} rows")
            begin = int(counts[:w].sum())
            own[name] = rows[begin : begin + int(counts[w])]
    return own
