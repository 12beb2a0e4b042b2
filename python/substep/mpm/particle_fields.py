"""What is read of particles of the material point method, and of their states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.checks import MOST_INT, check_within
from ..base.schema import OWN, TIME, Entry, Number, Rows
from .materials import Material

Array = NDArray[np.float64]

_PLANE = {2: [0, 1, 2, 3], 3: list(range(9))}  # of the stored entries: 2D is xx xy yx yy zz
_ENTRIES = {2: 5, 3: 9}
_FULL = [0, 3, 4, 3, 1, 5, 4, 5, 2]  # of xx yy zz xy xz yz

# What the native simulation saves; it checks that the numbers of particles agree.
STATE: list[Entry] = [
    TIME,
    Number("supplied"),
    Number("drift"),
    Number("before", low=0),
    Number("next_id", int, low=0, high=MOST_INT),
    Number("trial", bool),
    Rows("counts", np.int64, ("materials",), low=0),
    Rows("ids", np.int32, ("n",), low=0, below="next_id", distinct=True),
    Rows("blocks", np.int32, ("n", None)),
    Rows("values", OWN, (None,)),
    Rows("motion", OWN, ("n", None)),
    Rows("volumes", OWN, ("n",)),
    Rows("forces", np.float64, ("n", 3), optional=True, narrow=True),
]


def state_fields(material: Material) -> tuple[bool, list[tuple[str, str, float]]]:
    """Whether a material has an F, and name, unit and initial value of its other numbers."""
    has_f, others = _core.material_state_fields()[material._kind]
    return bool(has_f), others


def gradients(
    native: Any, kinds: NDArray[np.int32], materials: Sequence[Material], d: int
) -> Array:
    """F of each particle; J^(1/d) I, with the sign of J, where a material keeps J alone."""
    out = np.empty((len(kinds), d, d))
    for k, material in enumerate(materials):
        rows = native.material_fields(k)
        if state_fields(material)[0]:
            out[kinds == k] = rows[:, _PLANE[d]].reshape(-1, d, d)
        else:
            J = rows[:, 0, None, None]
            out[kinds == k] = np.sign(J) * np.abs(J) ** (1 / d) * np.eye(d)
    return out


def set_gradients(
    native: Any,
    values: Array,
    places: NDArray[np.int64],
    kinds: NDArray[np.int32],
    materials: Sequence[Material],
    dtype: np.dtype[Any],
) -> None:
    """Deform particles; those that keep J alone take the determinant. `kinds` are of all."""
    d, writes = values.shape[-1], []
    for k, material in enumerate(materials):
        chosen = kinds[places] == k
        if not chosen.any():
            continue
        among = (np.cumsum(kinds == k) - 1)[places[chosen]].astype(np.int64)
        before = native.material_fields(k)[among]
        rows = before.copy()
        if state_fields(material)[0]:
            rows[:, _PLANE[d]] = values[chosen].reshape(-1, d * d)
        else:
            with np.errstate(all="ignore"):
                J = np.linalg.det(values[chosen])
            rows[:, 0] = check_within("determinants of values", J, dtype)
        writes.append((k, before, rows, among))
    try:
        for k, _, rows, among in writes:
            native.set_material_fields(k, rows, among)
    except BaseException:  # between two materials
        for k, before, _, among in writes:
            native.set_material_fields(k, before, among)
        raise


def ratios(native: Any, kinds: NDArray[np.int32], materials: Sequence[Material], d: int) -> Array:
    """Determinant of F of each particle, or its J."""
    out = np.empty(len(kinds))
    for k, material in enumerate(materials):
        rows = native.material_fields(k)
        if state_fields(material)[0]:
            out[kinds == k] = np.linalg.det(rows[:, _PLANE[d]].reshape(-1, d, d))
            if d == 2:
                out[kinds == k] *= rows[:, 4]
        else:
            out[kinds == k] = rows[:, 0]
    return out


def cauchy(native: Any, ratio: Array) -> Array:
    """Cauchy stress tau / J of the admissible state, (n, 3, 3)."""
    tau: Array = native.stresses()[:, _FULL].reshape(-1, 3, 3)
    stress: Array = tau / ratio[:, None, None]
    return stress


def own_fields(
    native: Any, kinds: NDArray[np.int32], materials: Sequence[Material], d: int
) -> dict[str, tuple[Array, str]]:
    """What materials keep besides F, by name; particles of others have it as at rest."""
    found: dict[str, tuple[Array, str]] = {}
    for k, material in enumerate(materials):
        has_f, others = state_fields(material)
        first = _ENTRIES[d] if has_f else 0
        rows = native.material_fields(k)
        for j, (name, unit, initial) in enumerate(others):
            column = found.setdefault(name, (np.full(len(kinds), float(initial)), unit))[0]
            column[kinds == k] = rows[:, first + j]
    return found
