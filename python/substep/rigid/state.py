"""The state of rigid bodies: as arrays, restored and copied."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .. import _core
from ..base.schema import MOST, TIME, Entry, Number, Rows
from ..errors import InputError
from .fixtures import native_rows
from .joints import Joints

_VECTORS = (
    "positions",
    "momenta",
    "angular_momenta",
    "forces",
    "torques",
    "inertia",
    "rest_positions",
    "placed_positions",
)
SCHEMA: list[Entry] = [
    TIME,
    Number("next_id", int, low=0, high=MOST),
    Rows("ids", np.int64, ("bodies",), low=0, below="next_id", rising=True),
    Number("steps", int, low=0, high=MOST),
    Rows("island", np.int32, ("bodies",)),
    Rows("motions", np.uint8, ("bodies",), high=2),
    *(Rows(name, np.float64, ("bodies", 3)) for name in _VECTORS),
    Rows("rotations", np.float64, ("bodies", 4), unit=True),
    Rows("rest_rotations", np.float64, ("bodies", 4)),
    Rows("placed_rotations", np.float64, ("bodies", 4), unit=True),
    Rows("masses", np.float64, ("bodies",)),
    Rows("slow_time", np.float64, ("bodies",), low=0),
    Rows("material_names", np.uint8, (None,)),
    Rows("material_pairs", np.float64, (None, 5), finite="any"),  # NaN follows the rule
    Rows("contacts", np.float64, ("contacts", None)),
    Rows("contact_pairs", np.int32, ("contacts", None)),
    Number("next_joint", int, low=0, high=MOST),
    Rows("joint_ids", np.int64, ("joints",), low=0, below="next_joint", rising=True),
    Rows("joints", np.float64, ("joints", None), finite="no NaN"),  # limits may be infinite
    Rows("joint_pairs", np.int32, ("joints", None)),
    Rows("excluded", np.int32, (None, None)),
]


def rename(values: dict[str, float]) -> dict[str, float]:
    """Diagnostics of the native core under the words of the dictionary."""
    return {{"potential_energy": "gravitational_energy"}.get(k, k): v for k, v in values.items()}


_AT_ORIGIN = (np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.zeros((1, 3)), np.zeros((1, 3)))


class States(Joints):
    """A world of rigid bodies that can be saved and copied; make `RigidBodies`."""

    _options: dict[str, Any]
    _next_id: int

    def _schema(self) -> tuple[list[Entry], dict[str, int], Any]:
        return SCHEMA, {"bodies": len(self._ids)}, np.float64

    def _state(self) -> dict[str, Any]:
        state: dict[str, Any] = self._native.state()
        own = {name: np.array(getattr(self, f"_{name}")) for name in ("ids", "joint_ids")}
        return {**state, **own, "next_id": self._next_id, "next_joint": self._next_joint}

    def _checked(self, state: dict[str, Any]) -> dict[str, Any]:
        """As of other simulations, once it is of as many bodies."""
        ids = state.get("ids") if isinstance(state, Mapping) else None
        if isinstance(ids, np.ndarray) and ids.ndim == 1 and len(ids) != len(self._ids):
            raise InputError(f"state['ids']: expected {len(self._ids)} bodies, got {len(ids)}")
        return super()._checked(state)

    def _fit(self, state: dict[str, Any]) -> None:
        if not np.array_equal(state["ids"], self._ids):
            raise InputError("state['ids']: expected that of the same bodies")
        try:
            state["material_names"].tobytes().decode()
        except UnicodeDecodeError:
            raise InputError("state['material_names']: expected letters in UTF-8") from None
        dynamic = (state["motions"] == 0)[:, None]
        own = np.where(dynamic, self._weights, 1.0)
        if not np.array_equal(own, np.column_stack([state["masses"], state["inertia"]])):
            raise InputError("state['masses'], ['inertia']: expected those of the same bodies")
        moving = (*_VECTORS[:5], "placed_positions")
        with np.errstate(over="ignore"):
            squares = np.array([(state[name] ** 2).sum(axis=1) for name in moving])
            wrong = ~np.isfinite(squares.sum(axis=0))
        if wrong.any():
            row = int(np.argmax(wrong))
            name = moving[int(np.argmax(squares[:, row]))]
            raise InputError(f"state['{name}'][{row}]: the numbers of this body are too large")

    def _put_state(self, state: dict[str, Any]) -> None:
        mine = ("ids", "joint_ids", "next_id", "next_joint")
        self._native.restore({k: v for k, v in state.items() if k not in mine})
        self._next_id, self._next_joint = state["next_id"], state["next_joint"]
        self._joint_ids = state["joint_ids"]

    def _make(self, state: Mapping[str, Any]) -> Any:
        native = _core.RigidWorld(self._options)
        shapes: dict[int, Any] = {}
        for body in self._made:
            native.add(*native_rows(shapes, body, *_AT_ORIGIN))
        return native
