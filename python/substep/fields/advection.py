"""Particles that drift in a velocity field, step by step."""

from __future__ import annotations

import contextlib
import math
import os
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .. import _core
from ..base.checkpoint import restore_checkpoint, write_checkpoint
from ..base.checks import check_array, check_choice, check_integer, check_real
from ..errors import InputError, NonFiniteError, SolverError
from .flows import CallableField, Field, Moved, Particles, Steps

ACTIVE, LANDED, ESCAPED = 0, 1, 2
_CHUNK = 2048  # particles of a native task: between two of them Ctrl-C is seen
_CHUNK_STEPS = 1 << 17  # particle-steps of such a task at most
_BLOCK_STEPS = 1 << 24  # particle-steps after which the state moves on
_POLICIES = ("stop", "raise")
_KIND = "Advection"


def _count_steps(duration: float, step: float) -> tuple[int, float, float]:
    """Full steps, their size, and the shortened last one (0: none); `step` has duration's sign."""
    ratio = duration / step
    whole = round(ratio)
    if whole >= 1 and abs(ratio - whole) <= 1e-9 * max(1.0, ratio):
        return whole, duration / whole, 0.0
    full = math.floor(ratio)
    return full, step, duration - full * step


class Advection:
    """Particles that drift in a velocity field: dx/dt = u(t, x), by steps of fixed size.

    Parameters
    ----------
    field : Field or callable
        A field of substep, or `velocity(t, x)` on arrays x of shape (n, d) that returns the
        velocities in the same shape.
    positions : array_like, shape (n, 2) or (n, 3)
        Initial positions [m, or degrees of longitude and latitude]; copied.
    time : float
        Initial time [s].
    step : float
        Size of the steps of `advance` [s].
    method : str
        An explicit Runge-Kutta method of fixed step: 'euler', 'midpoint', 'heun' or 'rk4'.
    on_land, on_escape : {'stop', 'raise'}
        What happens to a particle one of whose stages, or the end of whose step, is on land (its
        nearest node is missing) or outside the grid: it rests where the step began, with its
        status and time kept, or SolverError is raised before that step.
    threads : int, optional
        Threads of the native loops; the default of `set_num_threads` unless given. Results do not
        depend on it.
    dtype : {numpy.float64, numpy.float32}
        Precision of positions and arithmetic; times are float64.

    Raises
    ------
    InputError
        If an argument is wrong; with 'raise' also if a particle begins on land or outside.
    SolverError
        With 'raise', if a particle lands or leaves; the state is then the last good step.
    NonFiniteError
        If a position overflows, or the callable returns NaN; likewise.

    References
    ----------
    Hairer, Norsett and Wanner (1993), "Solving Ordinary Differential Equations I", section II.1.

    Examples
    --------
    >>> import substep
    >>> drift = substep.Advection(substep.Shear(0.5), [[0.0, 2.0]], step=0.1)
    >>> drift.advance(3.0)
    >>> round(drift.time, 9), drift.positions.round(9).tolist()
    (3.0, [[3.0, 2.0]])
    """

    def __init__(
        self,
        field: Field | Callable[[float, NDArray[Any]], ArrayLike],
        positions: ArrayLike,
        *,
        time: float = 0.0,
        step: float,
        method: str = "rk4",
        on_land: str = "stop",
        on_escape: str = "stop",
        threads: int | None = None,
        dtype: DTypeLike = np.float64,
    ) -> None:
        if np.dtype(dtype) not in (np.dtype(np.float64), np.dtype(np.float32)):
            raise InputError(f"dtype: expected float64 or float32, got {np.dtype(dtype)}")
        x = check_array("positions", positions, dtype=dtype)
        wanted = field.dimension if isinstance(field, Field) else 2 if x.shape[1:] == (2,) else 3
        x = check_array("positions", x, (None, wanted), dtype=dtype).copy()
        self.field: Field = field if isinstance(field, Field) else CallableField(field, wanted)
        self._time = check_real("time", time)
        self.step_size = check_real("step", step, positive=True)
        self.method = check_choice("method", method, _core.advection_methods)
        self.on_land = check_choice("on_land", on_land, _POLICIES)
        self.on_escape = check_choice("on_escape", on_escape, _POLICIES)
        self.threads = threads
        self.steps = 0
        self._memo: dict[str, Any] = {}
        self._busy = threading.Lock()
        self.field._check_time("time", self._time)
        status, stop_time = np.zeros(len(x), np.int8), np.zeros(len(x))
        self._particles = Particles(x, status, stop_time)
        moved = self._move(self._particles, Steps(self._time, self.step_size, 0, 0))
        for policy, what, (_, index) in self._policies(moved):
            if policy == "raise" and index >= 0:
                raise InputError(f"positions[{index}]: {what} at the time {self._time}")
        self._particles = moved.particles

    @property
    def threads(self) -> int | None:
        """Threads of the native loops, None for the default."""
        return self._threads or None

    @threads.setter
    def threads(self, threads: int | None) -> None:
        value = 0 if threads is None else check_integer("threads", threads, minimum=1, maximum=1024)
        self._threads = value

    @property
    def time(self) -> float:
        """Time of the state [s]."""
        return self._time

    @property
    def positions(self) -> NDArray[Any]:
        """Positions, shape (n, d), a copy in the order they were given."""
        return self._particles.x.copy()

    @property
    def status(self) -> NDArray[np.int8]:
        """What became of each particle, a copy: 0 active, 1 landed, 2 escaped."""
        return self._particles.status.copy()

    @property
    def stop_time(self) -> NDArray[np.float64]:
        """Time at which each particle stopped [s], a copy; the present time where it did not."""
        stopped = self._particles.status != ACTIVE
        return np.where(stopped, self._particles.stop_time, self._time)

    def __len__(self) -> int:
        return len(self._particles.x)

    def step(self, dt: float | None = None) -> None:
        """Take one step.

        Parameters
        ----------
        dt : float, optional
            Its size [s], above 0; `step_size` unless given.

        Raises
        ------
        InputError, SolverError
            As the class says; the state is then unchanged.
        """
        dt = self.step_size if dt is None else check_real("dt", dt, positive=True)
        self._check_end("dt", dt)
        with self._own():
            self._take(1, dt)

    def advance(self, duration: float) -> None:
        """Take steps of `step_size` over a duration; the last is shortened to end there.

        Parameters
        ----------
        duration : float
            How long [s], at least 0.

        Raises
        ------
        InputError, SolverError
            As the class says; the state is then the last good step. Ctrl-C leaves the particles
            at the end of a step that all have taken.
        """
        duration = check_real("duration", duration, nonnegative=True)
        self._check_end("duration", duration)
        with self._own():
            self._go(duration, self.step_size)

    def _go(self, duration: float, step: float, after: Callable[[], None] | None = None) -> None:
        if duration == 0:
            return
        end = self._time + duration
        if abs(step) < 4 * math.ulp(max(abs(self._time), abs(end))):
            raise SolverError(
                f"step {step} is below the spacing of the time {self._time}", time=self._time
            )
        full, h, rest = _count_steps(duration, step)
        self._take(full, h, after)
        if rest:
            self._take(1, rest, after)
        self._time = end

    def _take(self, count: int, h: float, after: Callable[[], None] | None = None) -> None:
        """Steps in blocks; after each block the state is whole."""
        origin, first = self._time, 0
        n = max(1, len(self))
        block = min(_CHUNK_STEPS // min(n, _CHUNK), max(1, _BLOCK_STEPS // n))
        block = min(block, self.field.block_steps or block)
        while first < count:
            steps = Steps(origin, h, first, 1 if after else min(block, count - first))
            try:
                moved = self._move(self._particles, steps)
            except NonFiniteError as error:
                raise self._stopped(error, steps, error.step or 0) from error
            for policy, what, (step, index) in self._policies(moved):
                if policy == "raise" and step >= 0:
                    time = steps.time(step)
                    message = f"particle {index} is {what} after the time {time}"
                    failed = SolverError(message, time=time, index=index)
                    raise self._stopped(failed, steps, step)
            self._commit(moved, steps)
            first += steps.number
            if after:
                after()

    def _stopped(self, error: SolverError, steps: Steps, good: int) -> SolverError:
        """Take the steps before the one that failed, and say which it was."""
        if good > 0:
            before = steps._replace(number=good)
            self._commit(self._move(self._particles, before), before)
        error.step = self.steps
        return error

    def _move(self, particles: Particles, steps: Steps) -> Moved:
        return self.field._move(particles, steps, self.method, self._threads, self._memo)

    def _commit(self, moved: Moved, steps: Steps) -> None:
        self._particles = moved.particles
        self._time = steps.time(steps.number)
        self.steps += steps.number

    def _policies(self, moved: Moved) -> list[tuple[str, str, tuple[int, int]]]:
        events = [
            (self.on_land, "on land", moved.landed),
            (self.on_escape, "outside the grid", moved.escaped),
        ]
        return sorted(events, key=lambda event: event[2])

    def _check_end(self, name: str, duration: float) -> None:
        if not math.isfinite(self._time + duration):
            raise InputError(f"{name}: the time {self._time} + {duration} is not finite")
        self.field._check_time(f"{name}: end time", self._time + duration)

    @contextlib.contextmanager
    def _own(self) -> Iterator[None]:
        if not self._busy.acquire(blocking=False):
            raise InputError("this Advection is in use: by another thread, or by its own callback")
        try:
            yield
        finally:
            self._busy.release()

    def step_limit(self) -> tuple[float, str]:
        """Largest step that `advance` takes [s], and why."""
        return self.step_size, "the step that was given"

    def diagnostics(self) -> dict[str, float]:
        """Count the particles by what became of them.

        Returns
        -------
        dict of str to float
            `active`, `landed`, `escaped` and `steps`.
        """
        counts = np.bincount(self._particles.status, minlength=3)
        names = ("active", "landed", "escaped")
        return {**dict(zip(names, map(float, counts), strict=True)), "steps": float(self.steps)}

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays for recording, with their units.

        Returns
        -------
        dict of str to (ndarray, str)
            `position` (n, d), `status` (n,) and `stop_time` (n,), copies in the order given.
        """
        units = self.field.position_units[: self.field.dimension]
        unit = units[0] if len(set(units)) == 1 else ", ".join(units)
        return {
            "position": (self.positions, unit),
            "status": (self.status, ""),
            "stop_time": (self.stop_time, "s"),
        }

    def state(self) -> dict[str, Any]:
        """Copy the whole state.

        Returns
        -------
        dict
            `time`, `steps`, `positions`, `status`, `stop_time`; for `restore`.
        """
        return {
            "time": self._time,
            "steps": self.steps,
            "positions": self.positions,
            "status": self.status,
            "stop_time": self._particles.stop_time.copy(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a state, bit for bit.

        Parameters
        ----------
        state : dict
            From `state()` of an object with the same field dimension and dtype.

        Raises
        ------
        InputError
            If it is not such a state; nothing is changed then.
        """
        missing = {"time", "steps", "positions", "status", "stop_time"} - set(state)
        if missing:
            raise InputError(f"state: {', '.join(sorted(missing))} missing")
        time = check_real("state['time']", state["time"])
        self.field._check_time("state['time']", time)
        steps = check_integer("state['steps']", state["steps"], minimum=0)
        dtype, shape = self._particles.x.dtype, (None, self.field.dimension)
        if np.asarray(state["positions"]).dtype != dtype:
            raise InputError(f"state['positions']: expected dtype {dtype}")
        x = check_array("state['positions']", state["positions"], shape, dtype=dtype).copy()
        status = check_array("state['status']", state["status"], (len(x),), dtype=np.int8).copy()
        if ((status < ACTIVE) | (status > ESCAPED)).any():
            raise InputError("state['status']: expected 0, 1 or 2")
        stop_time = check_array("state['stop_time']", state["stop_time"], (len(x),)).copy()
        with self._own():
            self._particles = Particles(x, status, stop_time)
            self._time, self.steps = time, steps
            self._memo.clear()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the state to a file, atomically; the field and the settings are not in it.

        Parameters
        ----------
        path : path-like
            Where to; an existing file is replaced.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        write_checkpoint(path, _KIND, self.state())

    def load(self, path: str | os.PathLike[str]) -> None:
        """Go back to the state in a file, bit for bit, also in another process.

        Parameters
        ----------
        path : path-like
            A file written by `save`.

        Raises
        ------
        FormatError
            If the file is cut off (TruncatedError), spoiled (CorruptError) or of another version
            (VersionError); nothing is changed then.
        OSError
            If it cannot be read.
        """
        restore_checkpoint(path, _KIND, self.restore)

    def copy(self) -> Advection:
        """Copy exactly, with the same field."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        other._particles, other._memo = self._particles.copy(), {}
        other._busy = threading.Lock()
        return other

    __copy__ = copy

    def __deepcopy__(self, memo: dict[int, Any]) -> Advection:
        return self.copy()
