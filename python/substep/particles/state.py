"""What simulations of particles share: ids, arrays in their order, emitters, sinks, copies."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from ..base.checks import check_array
from ..base.simulation import Simulation
from ..errors import InputError
from ..geometry import Collider
from ..geometry.colliders import collider_states
from .emitters import Emitter, Sink, check_all

if TYPE_CHECKING:
    from typing_extensions import Self

Array = NDArray[np.float64]

ON_ESCAPE = ("raise", "remove", "clamp")


class Particles(Simulation):
    """Particles whose arrays are copies in the order of their ids; a subclass makes `_native`.

    `_native` has the methods of `Simulation`'s, `state`, `ids`, `positions`, `velocities`,
    `remove`, `absorb`, `set_positions`, `set_velocities` and `set_forces`.
    """

    colliders: tuple[Collider, ...]
    emitters: tuple[Emitter, ...]
    sinks: tuple[Sink, ...]
    _dimension: int
    _emitter_spacing: float
    _layers: NDArray[np.int64]
    _absorbed: NDArray[np.int64]

    def _make(self) -> Any:
        """A native simulation without particles."""
        raise NotImplementedError

    def _set_flow(self, emitters: Any, sinks: Any, kinds: int, spacing: float, what: str) -> None:
        """Emitters of one of so many kinds of particles, and sinks."""
        self.emitters = check_all("emitters", emitters, Emitter)
        for k, emitter in enumerate(self.emitters):
            if emitter.dimension != self._dimension:
                raise InputError(f"emitters[{k}]: expected one in {self._dimension}D")
            if emitter.fluid >= kinds:
                raise InputError(f"emitters[{k}]: there is no {what} {emitter.fluid}")
        self.sinks = check_all("sinks", sinks, Sink)
        self._emitter_spacing = spacing
        self._layers = np.zeros(len(self.emitters), np.int64)
        self._absorbed = np.zeros(len(self.sinks), np.int64)

    def __len__(self) -> int:
        return len(self._native)

    @property
    def ids(self) -> NDArray[np.int64]:
        """Numbers of the particles, ascending, shape (n,): the order of all arrays; a copy."""
        ids: NDArray[np.int64] = self._native.ids()
        return ids

    def rows(self, ids: ArrayLike) -> Any:
        """Where particles are in all arrays.

        Parameters
        ----------
        ids : int or array_like of int, shape (m,)
            Which.

        Returns
        -------
        int or ndarray of int64, shape (m,)
            Their rows, as of now.

        Raises
        ------
        InputError, IndexError
            If there is no such particle.
        """
        if isinstance(ids, (int, np.integer)):
            return int(self._places([int(ids)])[0])
        return self._places(ids)

    @property
    def positions(self) -> Array:
        """Positions [m], shape (n, 3) or (n, 2), in the order of `ids`; a copy."""
        rows: Array = self._native.positions()
        return rows

    @property
    def velocities(self) -> Array:
        """Velocities [m/s], shape of positions, in the order of `ids`; a copy."""
        rows: Array = self._native.velocities()
        return rows

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
        with self._own():
            self._native.remove(self._places(ids))

    def set_positions(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Move particles.

        Parameters
        ----------
        values : array_like, shape (m, 3) or (m, 2)
            Their positions [m].
        ids : array_like of int, shape (m,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        self._set("set_positions", values, ids)

    def set_velocities(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Give particles velocities.

        Parameters
        ----------
        values : array_like, shape (m, 3) or (m, 2)
            Their velocities [m/s].
        ids : array_like of int, shape (m,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        self._set("set_velocities", values, ids)

    def set_forces(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Push particles during the next step, which uses the forces up.

        Parameters
        ----------
        values : array_like, shape (m, 3) or (m, 2)
            External forces [N].
        ids : array_like of int, shape (m,), optional
            On which; on all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        self._set("set_forces", values, ids)

    def _set(self, method: str, values: ArrayLike, ids: ArrayLike | None) -> None:
        with self._own():
            places = np.arange(len(self)) if ids is None else self._places(ids)
            rows = check_array("values", values, (len(places), self._dimension))
            getattr(self._native, method)(rows, places)

    def _places(self, ids: ArrayLike) -> NDArray[np.int64]:
        """Places of particles in the order of all arrays."""
        wanted = np.asarray(ids)
        if wanted.size == 0:
            wanted = wanted.astype(np.int64)
        if wanted.ndim != 1 or wanted.dtype.kind not in "iu":
            raise InputError("ids: expected integers, shape (m,)")
        own = self.ids
        places = np.searchsorted(own, wanted.astype(np.int64))
        wrong = places >= len(own)
        wrong[~wrong] = own[places[~wrong]] != wanted[~wrong]
        if wrong.any():
            k = int(np.argmax(wrong))
            raise IndexError(f"ids[{k}]: there is no particle {wanted[k]}")
        return places.astype(np.int64)

    @property
    def emitted(self) -> NDArray[np.int64]:
        """Particles that each emitter has let out, shape (emitters,); a copy."""
        points = [len(emitter._layer(self._emitter_spacing)[0]) for emitter in self.emitters]
        return self._layers * np.array(points, np.int64)

    @property
    def absorbed(self) -> NDArray[np.int64]:
        """Particles that each sink has swallowed, shape (sinks,); a copy."""
        return self._absorbed.copy()

    def _put_in(self, x: Array, v: Array, kind: NDArray[np.int32]) -> None:
        """Particles that come out of an emitter."""
        raise NotImplementedError

    def _flow(self) -> None:
        """Let out what came since the last time; take out what lies in a sink."""
        for k, emitter in enumerate(self.emitters):
            x, layers = emitter._emit(self._emitter_spacing, int(self._layers[k]), self.time)
            v = np.broadcast_to(emitter.speed * emitter.direction, x.shape)
            self._put_in(x, np.ascontiguousarray(v), np.full(len(x), emitter.fluid, np.int32))
            self._layers[k] = layers
        for k, sink in enumerate(self.sinks):
            self._absorbed[k] += self._native.absorb(sink.shape._native)

    def state(self) -> dict[str, Any]:
        """Copy the whole state, that of the colliders too.

        Returns
        -------
        dict
            For `restore`; the particles are in the order of storage, of which bits depend.
        """
        state: dict[str, Any] = self._native.state()
        return state | {
            "colliders": collider_states(self.colliders),
            "layers": self._layers.copy(),
            "absorbed": self._absorbed.copy(),
        }

    def _check_flow_state(self, state: dict[str, Any]) -> tuple[Array, Any, Any]:
        moving = check_array(
            "state['colliders']",
            state["colliders"],
            (len(self.colliders), 21) if self.colliders else (0, 0),
        )
        counts = []
        for name, m in (("layers", len(self.emitters)), ("absorbed", len(self.sinks))):
            counts.append(np.array(state[name]))
            if counts[-1].shape != (m,) or counts[-1].dtype != np.int64:
                raise InputError(f"state[{name!r}]: expected int64 numbers of shape ({m},)")
            if (counts[-1] < 0).any():
                raise InputError(f"state[{name!r}]: expected numbers of at least 0")
        return moving, counts[0], counts[1]

    def _restore_flow(self, checked: tuple[Array, Any, Any]) -> None:
        moving, self._layers, self._absorbed = checked
        for collider, values in zip(self.colliders, moving, strict=True):
            collider._native.state = values.tolist()

    def copy(self) -> Self:
        """Copy exactly, with copies of the colliders.

        Returns
        -------
        Particles
            A simulation of the same class that takes the same steps.
        """
        other = object.__new__(type(self))
        made, state = self.__getstate__()
        made["colliders"] = tuple(collider.copy() for collider in self.colliders)
        other.__setstate__((made, state))
        return other

    def __getstate__(self) -> tuple[dict[str, Any], dict[str, Any]]:
        with self._own():
            made = {k: v for k, v in self.__dict__.items() if k not in ("_native", "_busy")}
            return {**made, "_threads": self.threads}, self.state()

    def __setstate__(self, given: tuple[dict[str, Any], dict[str, Any]]) -> None:
        made, state = given
        self.__dict__.update({k: v for k, v in made.items() if k != "_threads"})
        Simulation.__init__(self, self._make(), state["time"], made["_threads"])
        self.restore(state)

    __copy__ = copy

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self.copy()


def check_dtype(dtype: DTypeLike) -> np.dtype[Any]:
    """Of the numbers that a simulation computes with."""
    found = np.dtype(dtype)
    if found not in (np.float32, np.float64):
        raise InputError(f"dtype: expected float32 or float64, got {found}")
    return found


def check_kinds(name: str, kinds: Any, m: int, count: int) -> NDArray[np.int32]:
    """Which of `count` kinds each of m particles is, from one number for all or one each."""
    array = np.asarray(kinds)
    if array.size == 0:
        array = array.astype(np.int64)
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
