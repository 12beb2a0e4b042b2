"""What is read of particles of the material point method, and of their states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.checks import check_array, check_integer, check_real
from ..errors import InputError
from .materials import Material

Array = NDArray[np.float64]

_PLANE = {2: [0, 1, 2, 3], 3: list(range(9))}  # of the stored entries: 2D is xx xy yx yy zz
_ENTRIES = {2: 5, 3: 9}
_FULL = [0, 3, 4, 3, 1, 5, 4, 5, 2]  # of xx yy zz xy xz yz
_NUMBERS = ("time", "supplied", "drift", "before")


def state_fields(material: Material) -> tuple[bool, list[tuple[str, str, float]]]:
    """Whether a material has an F, and name, unit and initial value of its other numbers."""
    has_f, others = _core.material_state_fields()[material._kind]
    return bool(has_f), others


def gradients(
    native: Any, kinds: NDArray[np.int32], materials: Sequence[Material], d: int
) -> Array:
    """F of each particle; J^(1/d) I where a material keeps J alone."""
    out = np.empty((len(kinds), d, d))
    for k, material in enumerate(materials):
        rows = native.material_fields(k)
        if state_fields(material)[0]:
            out[kinds == k] = rows[:, _PLANE[d]].reshape(-1, d, d)
        else:
            out[kinds == k] = rows[:, 0, None, None] ** (1 / d) * np.eye(d)
    return out


def set_gradients(
    native: Any,
    values: Array,
    places: NDArray[np.int64],
    kinds: NDArray[np.int32],
    materials: Sequence[Material],
) -> None:
    """Deform particles; those that keep J alone take the determinant. `kinds` are of all."""
    d = values.shape[-1]
    for k, material in enumerate(materials):
        chosen = kinds[places] == k
        if not chosen.any():
            continue
        among = (np.cumsum(kinds == k) - 1)[places[chosen]].astype(np.int64)
        rows = native.material_fields(k)[among]
        if state_fields(material)[0]:
            rows[:, _PLANE[d]] = values[chosen].reshape(-1, d * d)
        else:
            rows[:, 0] = np.linalg.det(values[chosen])
        native.set_material_fields(k, rows, among)


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


def check_state(state: dict[str, Any], dtype: np.dtype[Any]) -> dict[str, Any]:
    """A state of the native simulation whose numbers have their types and are finite."""
    wanted: dict[str, np.dtype[Any]] = {
        "counts": np.dtype(np.int64),
        "ids": np.dtype(np.int32),
        "blocks": np.dtype(np.int32),
        "values": dtype,
        "motion": dtype,
        "volumes": dtype,
        "forces": np.dtype(np.float64),
    }
    missing = {*wanted, *_NUMBERS, "next_id", "trial", "colliders", "layers", "absorbed"} - set(
        state
    )
    if missing:
        raise InputError(f"state: {', '.join(sorted(missing))} missing")
    checked: dict[str, Any] = {
        name: check_real(f"state[{name!r}]", state[name]) for name in _NUMBERS
    }
    checked["next_id"] = check_integer("state['next_id']", state["next_id"], minimum=0)
    if not isinstance(state["trial"], bool):
        raise InputError(f"state['trial']: expected True or False, got {state['trial']!r}")
    checked["trial"] = state["trial"]
    for name, kind in wanted.items():
        array = np.asarray(state[name])
        if array.dtype != kind:
            raise InputError(f"state[{name!r}]: expected dtype {kind}, got {array.dtype}")
        checked[name] = check_array(f"state[{name!r}]", array, dtype=kind)
    if checked["forces"].ndim != 2 or checked["forces"].shape[1] != 3:
        raise InputError("state['forces']: expected shape (n, 3)")
    return checked
