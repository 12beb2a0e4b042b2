"""The state of rigid bodies: as arrays, restored and copied."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.checks import check_array, check_integer, check_real, first_bad_index
from ..base.simulation import Simulation
from ..errors import InputError
from .fixtures import add_native
from .joints import Joints

if TYPE_CHECKING:
    from typing_extensions import Self

# Columns of arrays with a row for each body; None: one number for each.
_BODIES = {
    "positions": 3,
    "rotations": 4,
    "momenta": 3,
    "angular_momenta": 3,
    "forces": 3,
    "torques": 3,
    "inertia": 3,
    "masses": None,
    "slow_time": None,
    "rest_positions": 3,
    "rest_rotations": 4,
}
_ROWS = ("contacts", "joints")  # of real numbers
_INTEGERS = ("contact_pairs", "joint_pairs", "excluded")


_IDS = ("ids", "joint_ids")
_AT_ORIGIN = (np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.zeros((1, 3)), np.zeros((1, 3)))


class States(Joints):
    """A world of rigid bodies that can be saved and copied; make `RigidBodies`."""

    _options: dict[str, Any]
    _next_id: int
    _callback_of: int | None

    def state(self) -> dict[str, Any]:
        """Copy the whole state, for `restore`: all but what bodies and joints were made of.

        Returns
        -------
        dict
            Arrays and numbers.
        """
        with self._own():
            return self._whole_state()

    def _whole_state(self) -> dict[str, Any]:
        state: dict[str, Any] = self._native.state()
        own = {name: np.array(getattr(self, f"_{name}")) for name in _IDS}
        return {**state, **own, "next_id": self._next_id, "next_joint": self._next_joint}

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a state, bit for bit.

        Parameters
        ----------
        state : dict
            From `state()` of an object with the same bodies, made in the same way. Its joints need
            not be there: they are part of the state.

        Raises
        ------
        InputError
            If it is not such a state; nothing is changed then.
        """
        missing = {*_IDS, "next_id", "next_joint"} - set(state)
        if missing:
            raise InputError(f"state: {', '.join(sorted(missing))} missing")
        ids, joint_ids = (check_ids(f"state[{name!r}]", state[name]) for name in _IDS)
        next_id, next_joint = (
            check_integer(
                f"state['{name}']", state[name], minimum=int(np.max(last, initial=-1)) + 1
            )
            for name, last in (("next_id", ids), ("next_joint", joint_ids))
        )
        with self._own():
            if not np.array_equal(ids, self._ids):
                raise InputError("state['ids']: expected that of the same bodies")
            self._native.restore(check_state(state, self._weights, len(joint_ids)))
            self._next_id, self._next_joint, self._joint_ids = next_id, next_joint, joint_ids

    def copy(self) -> Self:
        """Copy exactly.

        Returns
        -------
        RigidBodies
            A simulation that takes the same steps, and shares nothing.
        """
        other = object.__new__(type(self))
        other.__setstate__(self.__getstate__())
        return other

    __copy__ = copy

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self.copy()

    def __getstate__(self) -> tuple[dict[str, Any], dict[str, Any]]:
        with self._own():
            made = {
                name: value
                for name, value in self.__dict__.items()
                if name not in ("_native", "_busy", "_callback_of")
            }
            return {**made, "_threads": self.threads}, self._whole_state()

    def __setstate__(self, given: tuple[dict[str, Any], dict[str, Any]]) -> None:
        made, state = given
        self.__dict__.update({k: v for k, v in made.items() if k != "_threads"})
        self._made = list(self._made)
        self._callback_of = None
        Simulation.__init__(self, _core.RigidWorld(self._options), state["time"], made["_threads"])
        shapes: dict[int, Any] = {}
        for body in self._made:
            add_native(self._native, shapes, body, *_AT_ORIGIN)
        self.restore(state)


def check_ids(name: str, value: Any) -> NDArray[np.int64]:
    """Ascending numbers, as a new array."""
    ids = np.array(value)
    if ids.dtype != np.int64 or ids.ndim != 1 or (np.diff(ids) <= 0).any() or (ids < 0).any():
        raise InputError(f"{name}: expected ascending int64 numbers")
    return ids


def check_state(state: dict[str, Any], weights: NDArray[np.float64], joints: int) -> dict[str, Any]:
    """What the native world takes, of bodies of these weights and of so many joints."""
    bodies = len(weights)
    names = {"time", "steps", "island", "motions", *_BODIES, *_ROWS, *_INTEGERS}
    missing = names - set(state)
    if missing:
        raise InputError(f"state: {', '.join(sorted(missing))} missing")
    checked: dict[str, Any] = {
        "time": check_real("state['time']", state["time"]),
        "steps": check_integer("state['steps']", state["steps"], minimum=0, maximum=2**62),
        "island": _integers("island", state["island"], 1, np.int32),
        "motions": _integers("motions", state["motions"], 1, np.uint8),
    }
    for name, columns in _BODIES.items():
        shape = (bodies,) if columns is None else (bodies, columns)
        checked[name] = check_array(f"state[{name!r}]", state[name], shape)
    for name in _ROWS:  # a limit of a joint may be infinite
        rows = check_array(f"state[{name!r}]", state[name], (None, None), finite=False)
        wrong = np.isnan(rows) if name == "joints" else ~np.isfinite(rows)
        if wrong.any():
            raise InputError(f"state[{name!r}]{first_bad_index(wrong)}: expected a number")
        checked[name] = rows
    for name in _INTEGERS:
        checked[name] = _integers(name, state[name], 2, np.int32)
    lengths = np.linalg.norm(checked["rotations"], axis=1)
    if (np.abs(lengths - 1) > 1e-9).any():
        row = int(np.argmax(np.abs(lengths - 1)))
        raise InputError(f"state['rotations'][{row}]: expected a quaternion of length 1")
    for name in ("island", "motions"):
        if len(checked[name]) != bodies:
            raise InputError(f"state[{name!r}]: expected {bodies} numbers")
    if (checked["motions"] > 2).any():
        raise InputError("state['motions']: expected numbers from 0 to 2")
    dynamic = (checked["motions"] == 0)[:, None]
    own = np.where(dynamic, weights, 1.0)
    given = np.column_stack([checked["masses"], checked["inertia"]])
    if not np.array_equal(own, given):
        raise InputError("state['masses'], ['inertia']: expected those of the same bodies")
    pairs = ("contacts", len(checked["contacts"])), ("joints", joints)
    for name, count in pairs:
        for part in (name, f"{name[:-1]}_pairs"):
            if len(checked[part]) != count:
                raise InputError(f"state[{part!r}]: expected {count} rows")
    return checked


def _integers(name: str, value: Any, dimensions: int, dtype: Any) -> NDArray[Any]:
    array = np.array(value, order="C")
    if array.dtype != dtype or array.ndim != dimensions:
        wanted = np.dtype(dtype).name
        raise InputError(f"state[{name!r}]: expected {wanted} numbers in {dimensions} dimensions")
    return array
