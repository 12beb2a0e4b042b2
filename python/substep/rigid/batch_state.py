"""The state of many worlds as arrays: those of all worlds, one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..base.schema import Entry, Number, Rows
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


def joined_entries(entry: Entry) -> list[Entry]:
    """What a state of all worlds has of an entry of one."""
    name = entry.name
    if isinstance(entry, Rows):
        shape = (None,) * len(entry.shape)
        counts = Rows(f"count_{name}", np.int64, ("worlds",), low=0)
        return [counts, Rows(f"all_{name}", entry.dtype, shape, finite="any")]
    kind = np.int64 if isinstance(entry, Number) and entry.kind is int else np.float64
    return [Rows(f"each_{name}", kind, ("worlds",))]


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
