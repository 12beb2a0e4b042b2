"""What simulations of particles share: ids, arrays in their order, emitters, sinks, copies."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import as_integers, check_array, check_within
from ..base.rows import Points, read_only
from ..base.schema import Entry, Rows
from ..errors import InputError
from ..geometry import Collider
from ..geometry.colliders import collider_states, colliders_entry, restore_colliders
from .emitters import Emitter, Sink, check_all

Array = NDArray[np.float64]

ON_ESCAPE = ("raise", "remove", "clamp")


class Particles(Points):
    """Particles whose arrays are copies in the order of their ids; a subclass makes `_native`.

    `_native` has the methods of `Simulation`'s, `state`, `ids`, `positions`, `velocities`,
    `forces`, `remove`, `set_positions`, `set_velocities` and `set_forces`. It is made with `_flow`:
    its steps end with what comes out of emitters and goes into sinks, `layers` and `absorbed`.
    """

    dtype: np.dtype[Any]
    colliders: tuple[Collider, ...]
    emitters: tuple[Emitter, ...]
    sinks: tuple[Sink, ...]
    _emitter_spacing: float

    def _set_flow(self, emitters: Any, sinks: Any, kinds: int, spacing: float, what: str) -> None:
        """Emitters of one of so many kinds of particles, and sinks."""
        self.emitters = check_all("emitters", emitters, Emitter)
        for k, emitter in enumerate(self.emitters):
            if emitter.dimension != self._dimension:
                raise InputError(f"emitters[{k}]: expected one in {self._dimension}D")
            if emitter.kind >= kinds:
                raise InputError(f"emitters[{k}]: there is no {what} {emitter.kind}")
        self.sinks = check_all("sinks", sinks, Sink)
        self._emitter_spacing = spacing

    def _flow(self) -> _core.ParticleFlow:
        """The native emitters and sinks."""
        taps = [emitter._options(self._emitter_spacing) for emitter in self.emitters]
        return _core.ParticleFlow(taps, [sink.shape._native for sink in self.sinks])

    def __len__(self) -> int:
        return len(self._native)

    @property
    def ids(self) -> NDArray[np.int64]:
        """Numbers of the particles, ascending, shape (n,): the order of all arrays; read-only."""
        ids: NDArray[np.int64] = read_only(self._native.ids())
        return ids

    @property
    def positions(self) -> Array:
        """Positions [m], shape (n, 3) or (n, 2), in the order of `ids`; read-only."""
        rows: Array = read_only(self._native.positions())
        return rows

    @property
    def velocities(self) -> Array:
        """Velocities [m/s], shape of positions, in the order of `ids`; read-only."""
        rows: Array = read_only(self._native.velocities())
        return rows

    @property
    def forces(self) -> Array:
        """External forces of the next step [N], shape of positions; read-only."""
        return read_only(self._forces())

    def _vectors(self, name: str, values: ArrayLike, count: int | None) -> Array:
        vectors = check_array(name, values, (count, self._dimension))
        return check_within(name, vectors, self.dtype)

    def _forces(self) -> Array:
        """In the order of the ids, a copy."""
        raise NotImplementedError

    def remove(self, ids: ArrayLike) -> None:
        """Take out particles.

        Parameters
        ----------
        ids : array_like of int, shape (m,)
            Their ids.

        Raises
        ------
        IndexError
            If there is no such particle.
        """
        self._native.remove(self._places(ids))

    @property
    def emitted(self) -> NDArray[np.int64]:
        """Particles that each emitter has let out, shape (emitters,); read-only."""
        points = [len(emitter._layer(self._emitter_spacing)[0]) for emitter in self.emitters]
        return read_only(self._native.layers * np.array(points, np.int64))

    @property
    def absorbed(self) -> NDArray[np.int64]:
        """Particles that each sink has swallowed, shape (sinks,); read-only."""
        absorbed: NDArray[np.int64] = read_only(self._native.absorbed)
        return absorbed

    def _flow_schema(self) -> list[Entry]:
        """What every state of particles holds beside the native one."""
        return [
            colliders_entry(self.colliders),
            Rows("layers", np.int64, (len(self.emitters),), low=0),
            Rows("absorbed", np.int64, (len(self.sinks),), low=0),
        ]

    def _fit(self, state: dict[str, Any]) -> None:
        for k, emitter in enumerate(self.emitters):
            thickness = emitter._layer(self._emitter_spacing)[1]
            most = max(0.0, (state["time"] - emitter.start) * emitter.speed / thickness) + 2
            if state["layers"][k] > most:
                raise InputError(f"state['layers'][{k}]: expected those until state['time']")

    def _state(self) -> dict[str, Any]:
        state: dict[str, Any] = self._native.state()
        return state | {
            "colliders": collider_states(self.colliders),
            "layers": self._native.layers,
            "absorbed": self._native.absorbed,
        }

    def _put_state(self, state: dict[str, Any]) -> None:
        restore_colliders(self.colliders, state["colliders"])  # the native part moves with them
        self._restore_native(state)

    def _restore_native(self, state: dict[str, Any]) -> None:
        """Take over the native part of a state, `layers` and `absorbed` too."""
        raise NotImplementedError


def check_kinds(name: str, kinds: Any, m: int, count: int) -> NDArray[np.int32]:
    """Which of `count` kinds each of m particles is, from one number for all or one each."""
    array = as_integers(name, kinds)
    if array.dtype.kind not in "iu" or array.shape not in ((), (m,)):
        raise InputError(f"{name}: expected integers, shape ({m},)")
    array = np.broadcast_to(array, (m,))
    wrong = (array < 0) | (array >= count)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InputError(f"{name}[{k}]: expected a number from 0 to {count - 1}, got {array[k]}")
    return np.ascontiguousarray(array, np.int32)


def check_bounds(bounds: ArrayLike | None, d: int) -> list[list[float]] | None:
    """Lowest and highest corner, with a third coordinate."""
    if bounds is None:
        return None
    corners = check_array("bounds", bounds, (2, d), finite=False)
    if not (corners[0] < corners[1]).all():
        raise InputError("bounds: expected the lowest corner, then the highest")
    whole = np.array([[-math.inf] * 3, [math.inf] * 3])
    whole[:, :d] = corners
    rows: list[list[float]] = whole.tolist()
    return rows
