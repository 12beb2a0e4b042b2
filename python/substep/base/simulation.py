"""The protocol of every simulation: steps in time, callbacks, states, copies, checkpoints.

A subclass makes `_native` and says what is its own: `_next_step`, `_take_step`, `_schema`,
`_state`, `_put_state`, `_make`. What users call is here, once.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ..errors import InputError, SolverError
from .checkpoint import restore_checkpoint, write_checkpoint
from .checks import check_callable, check_real, check_threads
from .owned import Owned, takes_by_itself
from .pictured import Pictured
from .schema import Entry, check

if TYPE_CHECKING:
    from typing_extensions import Self

_TRANSIENT = ("_native", "_owner", "_world")  # what no copy takes over


@dataclass
class StepReport:
    """What the last call of `step` or `advance` took; each class adds what its steps meet.

    Attributes
    ----------
    steps : int
        Steps that were taken.
    dt : float
        The last of them [s].
    iterations : int
        Of the last step, where it iterates.
    converged : bool
        Whether the last step met its tolerance; True where it has none.
    """

    steps: int = 0
    dt: float = 0.0
    iterations: int = 0
    converged: bool = True


class _OtherSteps(Exception):
    """A callback has restored another time or set another step: what is left is counted anew."""


class Simulation(Owned, Pictured):
    """State in time; a subclass makes `_native`, and the rest of the protocol.

    `_native` has `time`, `threads` and `step(dt)`, which takes one step or leaves all as it was.
    """

    colliders: tuple[Any, ...] = ()
    _native: Any
    _last: StepReport
    _step_size: float | None
    _fixed_step: ClassVar[bool] = False  # whether `advance` counts steps of `step_size`
    _pushes_bodies: ClassVar[bool] = True  # whether obstacles that stand for bodies yield
    _fewest_cells: ClassVar[float] = 0  # across bodies that it carries; 0: it has no cells
    _rows_are: ClassVar[str] = "particles"
    _fuses_steps: ClassVar[bool] = False  # whether the native `advance` takes them, of its sizes
    _thinnest: float | None = None  # surface that it can have as obstacles [m]; None: it has none

    def __init__(self, native: Any, time: float, threads: int | None) -> None:
        for k, collider in enumerate(self.colliders):
            collider._join(f"colliders[{k}]", self)
        self._native = native
        native.time = check_real("time", time)
        native.threads = check_threads(threads)
        self._last = StepReport()
        for collider in self.colliders:
            self._owner.join(collider._owner)

    def __repr__(self) -> str:
        try:
            told = [f"t={self.time:.6g} s", *self._contents()]
        except (AttributeError, InputError):  # not made yet, or another thread steps it
            return f"<{type(self).__name__}>"
        return f"{type(self).__name__}({', '.join(told)})"

    def _contents(self) -> list[str]:
        """What is in it, in words."""
        one: Any = self
        if hasattr(one, "__len__"):
            told = [f"{len(one)} {self._rows_are}"]
        else:
            told = [f"{' x '.join(map(str, one.shape))} cells"]
        count = len(self.colliders)
        return told + ([f"{count} obstacle{'s' * (count > 1)}"] if count else [])

    @property
    def time(self) -> float:
        """Time of the state [s]."""
        return float(self._native.time)

    @property
    def threads(self) -> int | None:
        """Threads of the native loops, None for the default; results do not depend on it."""
        return self._native.threads or None

    @threads.setter
    def threads(self, threads: int | None) -> None:
        self._native.threads = check_threads(threads)

    @property
    def step_size(self) -> float | None:
        """Step of `step` and `advance` [s]; None where `step_limit` gives it."""
        return self._step_size

    @step_size.setter
    def step_size(self, step: float | None) -> None:
        if step is not None or self._fixed_step:
            step = check_real("step_size", step, positive=True)
        self._set_step_size(step)

    @property
    def report(self) -> Any:
        """What the last call of `step` or `advance` took and met."""
        return copy.copy(self._last)

    def _set_step_size(self, step: float | None) -> None:
        self._step_size = step

    def _next_step(self) -> float:
        """Size of the step that `advance` takes now [s]."""
        step = self._step_size
        assert step is not None
        return step

    def _take_step(self, dt: float) -> None:
        try:
            self._native.step(dt)
        except SolverError as error:
            self._date(error)
            raise

    def _date(self, error: SolverError) -> None:
        """Say when, where what failed knows no time, as an obstacle."""
        if error.time is None:
            error.time = self._native.time

    def _step_once(self, dt: float | None) -> float:
        """Take a step, one of `advance` unless its size is given; returns the size."""
        dt = self._next_step() if dt is None else dt
        self._take_step(dt)
        return dt

    def step(self, dt: float | None = None) -> None:
        """Take one step.

        Parameters
        ----------
        dt : float, optional
            Its size [s], above 0; what `advance` would take unless given.

        Raises
        ------
        InputError
            If `dt` is wrong.
        SolverError
            With the time and the index of what went wrong; the state is then unchanged.
        """
        if dt is not None:
            dt = check_real("dt", dt, positive=True)
        self._begin("step")
        self._count(self._step_once(dt))

    def advance(self, duration: float, callback: Callable[[Self], object] | None = None) -> None:
        """Take as many steps as a duration needs; the last are shortened to end there.

        Parameters
        ----------
        duration : float
            How long [s], at least 0.
        callback : callable, optional
            Called with this object after every step. It may read and write everything; it must not
            step. Its exceptions end the run, and are passed on.

        Raises
        ------
        InputError
            If an argument is wrong.
        SolverError
            As `step`; the state is then the last good step, and the exception's `step` its number.
        """
        duration = check_real("duration", duration, nonnegative=True)
        if callback is not None:
            check_callable("callback", callback)
        end = self._end("duration", duration)
        self._begin("advance")
        if callback is None or not self._fixed_step:
            self._run(duration, end, callback)
            return

        def watched(simulation: Self) -> None:
            known = self._native.time, self._step_size
            callback(simulation)
            if known != (self._native.time, self._step_size):
                raise _OtherSteps

        while True:
            try:
                self._run(duration, end, watched)
                return
            except _OtherSteps:
                duration = max(end - self._native.time, 0.0)

    def _begin(self, method: str) -> None:
        """Prepare for a call of `step` or `advance`."""
        if self.__dict__.get("_world", lambda: None)() is not None:
            raise InputError(f"{method}: this is a member of a World, which alone steps it")
        self._owner.begin(method)
        self._begin_within()

    def _begin_within(self) -> None:
        """The same within a call of another simulation."""
        for collider in self.colliders:
            collider._native.begin_call()
        self._last.steps = 0

    def _count(self, dt: float) -> None:
        """Note a step in the report, and what it gave to the obstacles."""
        self._sum_impulses(dt)
        last = self._last
        last.steps += 1
        last.dt = dt

    def _sum_impulses(self, dt: float) -> None:
        """Add what obstacles were given in the last native call, over a time."""
        for collider in self.colliders:
            collider._native.end_step(dt)

    def _end(self, name: str, duration: float) -> float:
        """The time after a duration, checked."""
        start = self._native.time
        if not math.isfinite(start + duration):
            raise InputError(f"{name}: the time {start} + {duration} is not finite")
        return start + duration

    def _run(self, duration: float, end: float, callback: Callable[[Self], object] | None) -> None:
        """The steps of `advance`."""
        sizes = self._even_sizes(duration, end) if self._fixed_step else self._sizes(end)
        for dt, is_last in sizes:
            try:
                self._take_step(dt)
            except SolverError as error:
                error.step = self._last.steps
                raise
            if is_last:
                self._native.time = end
            self._count(dt)
            if callback is not None:
                callback(self)

    def _sizes(self, end: float) -> Iterator[tuple[float, bool]]:
        """Steps of `_next_step`, and whether one is the last: the last two are shortened."""
        while self._native.time < end:
            h, left = self._next_step(), end - self._native.time
            if left <= h * (1 + 1e-9):
                yield left, True
            elif self._native.time + h > self._native.time:
                # Two equal steps at the end: a very short one would make large velocities of
                # what is left to correct.
                yield (left / 2 if left < 2 * h * (1 - 1e-9) else h), False
            else:
                raise SolverError(
                    f"the step, {h:.3g} s, is below the spacing of the time {self._native.time} s: "
                    "the speeds have grown without bound",
                    time=self._native.time,
                )

    def _even_step(self, duration: float) -> float:
        """Size of the steps of a duration [s]."""
        return self._next_step()

    def _even_sizes(self, duration: float, end: float) -> Iterator[tuple[float, bool]]:
        """Steps of one size, and whether one is the last: where they do not fit, it is shorter."""
        h = self._even_step(duration)
        count, whole = whole_steps(duration, h)
        for number in range(count):
            yield h, whole and number + 1 == count
        if not whole:
            yield end - self._native.time, True

    def _make(self, state: Mapping[str, Any]) -> Any:
        """A native simulation made as this one was, into which a state is restored."""
        raise NotImplementedError

    def _schema(self) -> tuple[list[Entry], dict[str, int], Any]:
        """What a state holds, the sizes in it, and the dtype of the numbers."""
        raise NotImplementedError

    def _state(self) -> dict[str, Any]:
        """Copy the whole state."""
        raise NotImplementedError

    def _fit(self, state: dict[str, Any]) -> None:
        """Refuse what the schema cannot tell, with InputError."""

    def _refuse(self, given: dict[str, Any]) -> None:
        """Refuse, with InputError, what a copy may have and nobody may give, as NaN in views."""

    def _put_state(self, state: dict[str, Any]) -> None:
        """Take over a state that has been checked."""
        raise NotImplementedError

    def _kept(self) -> dict[str, Any]:
        """The present state for `_put_state`, whatever users have written into it."""
        return self._state()

    def _way_back(self) -> Callable[[], None]:
        """What goes back from steps to the present state, once, unless asked for again before."""
        before = self._kept()
        return lambda: self._put_state(before)

    def state(self) -> dict[str, Any]:
        """Copy the whole state, that of the colliders too.

        Returns
        -------
        dict
            For `restore`: arrays and numbers by name.
        """
        return self._state()

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a state, bit for bit.

        Parameters
        ----------
        state : dict
            From `state()` of an object made in the same way.

        Raises
        ------
        InputError
            If it is not such a state, with the name of what does not fit; nothing is changed then.
        """
        given, before = self._checked(state), self._kept()
        self._refuse(given)
        try:
            self._put_state(given)
        except BaseException:  # an interrupt, or no memory
            self._put_state(before)
            raise

    def _checked(self, state: dict[str, Any]) -> dict[str, Any]:
        schema, sizes, own = self._schema()
        checked = check(schema, state, sizes, own)
        self._fit(checked)
        return checked

    def copy(self) -> Self:
        """Copy exactly, colliders too.

        Returns
        -------
        Simulation
            Of the same class: it goes on as this one does, bit for bit, and shares nothing that
            changes.
        """
        other = type(self).__new__(type(self))
        made, threads, state = self.__getstate__()
        if self.colliders:
            made["colliders"] = tuple(collider.copy() for collider in self.colliders)
        other.__setstate__((made, threads, state))
        return other

    def __copy__(self) -> Self:
        return self.copy()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        other = memo[id(self)] = type(self).__new__(type(self))
        made, threads, state = self.__getstate__()
        other.__setstate__((copy.deepcopy(made, memo), threads, state))
        return other

    def _parts(self) -> dict[str, Any]:
        """What the object is made of, without its state."""
        made = {k: v for k, v in self.__dict__.items() if k not in _TRANSIENT}
        return made | {"_last": copy.copy(self._last)}

    def __getstate__(self) -> tuple[dict[str, Any], int | None, dict[str, Any]]:
        return self._parts(), self.threads, self._state()

    def __setstate__(self, given: tuple[dict[str, Any], int | None, dict[str, Any]]) -> None:
        made, threads, state = given
        self.__dict__.update(made)
        self._freeze()
        Simulation.__init__(self, self._make(state), state["time"], threads)
        self._last = made["_last"]
        self._put_state(self._checked(state))

    @takes_by_itself
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the state to a file, atomically; it does not contain what the object was made of.

        Parameters
        ----------
        path : path-like
            Where to; an existing file is replaced.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        write_checkpoint(path, type(self).__name__, self.state())

    def load(self, path: str | os.PathLike[str]) -> None:
        """Go back to the state in a file, bit for bit, also in another process.

        Parameters
        ----------
        path : path-like
            A file written by `save`.

        Raises
        ------
        FormatError
            If the file is cut off (TruncatedError), spoiled or of an object that was made otherwise
            (CorruptError), or of another version (VersionError); nothing is changed then.
        OSError
            If it cannot be read.
        """
        restore_checkpoint(path, type(self).__name__, self.restore)


def with_energy(values: dict[str, float]) -> dict[str, float]:
    """Diagnostics with `energy`, the sum of those kinds that can change into each other."""
    kinds = ("kinetic_energy", "gravitational_energy", "elastic_energy")
    return values | {"energy": sum(values[kind] for kind in kinds if kind in values)}


def momenta(sums: Any) -> dict[str, float]:
    """Diagnostics of the native sums `momentum` and `angular_momentum`."""
    return {
        f"{name}_{axis}": getattr(sums, name)[k]
        for name in ("momentum", "angular_momentum")
        for k, axis in enumerate("xyz")
    }


def whole_steps(duration: float, step: float) -> tuple[int, bool]:
    """Steps of that size that fit into a duration, and whether they fill it."""
    ratio = duration / step
    if not math.isfinite(ratio):
        raise InputError(f"duration: {duration} s are more steps of {step} s than can be counted")
    whole = abs(ratio - round(ratio)) <= 1e-9 * max(1.0, ratio)
    return (round(ratio) if whole else math.floor(ratio)), whole
