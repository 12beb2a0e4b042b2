"""Particles that drift in a velocity field, step by step."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .. import _core
from ..base.checks import check_array, check_choice, check_dtype, check_real
from ..base.rows import Numbered, find_rows_or_all, read_only, rows_of
from ..base.schema import MOST, OWN, TIME, Entry, Number, Rows
from ..base.simulation import StepReport
from ..errors import InputError, NonFiniteError, SolverError
from .flows import CallableField, Field, Moved, Particles, Steps

if TYPE_CHECKING:
    from typing_extensions import Self

ACTIVE, LANDED, ESCAPED = 0, 1, 2
_CHUNK = 2048  # particles of a native task: between two of them Ctrl-C is seen
_CHUNK_STEPS = 1 << 17  # particle-steps of such a task at most
_BLOCK_STEPS = 1 << 24  # particle-steps after which the state moves on
_POLICIES = ("stop", "raise")


def _count_steps(duration: float, step: float) -> tuple[int, float, float]:
    """Full steps, their size, and the shortened last one (0: none); `step` has duration's sign."""
    ratio = duration / step
    whole = round(ratio)
    if whole >= 1 and abs(ratio - whole) <= 1e-9 * max(1.0, ratio):
        return whole, duration / whole, 0.0
    full = math.floor(ratio)
    return full, step, duration - full * step


class _Clock:
    """What other simulations have in the native core."""

    time: float
    threads: int


@dataclass
class DriftReport(StepReport):
    """What the last call of `step` or `advance` took and met.

    Attributes
    ----------
    landed, escaped : int
        Particles that have stopped, of all.
    """

    landed: int = 0
    escaped: int = 0


class Advection(Numbered):
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

    field: Field
    method: str
    on_land: str
    on_escape: str
    _step_size: float
    _fixed_step = True

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
        dtype = check_dtype(dtype)
        x = check_array("positions", positions, dtype=dtype)
        wanted = field.dimension if isinstance(field, Field) else 2 if x.shape[1:] == (2,) else 3
        x = check_array("positions", x, (None, wanted), dtype=dtype)
        self.field = field if isinstance(field, Field) else CallableField(field, wanted)
        self._step_size = check_real("step", step, positive=True)
        self.method = check_choice("method", method, _core.advection_methods)
        self.on_land = check_choice("on_land", on_land, _POLICIES)
        self.on_escape = check_choice("on_escape", on_escape, _POLICIES)
        super().__init__(_Clock(), time, threads)
        self._steps = 0
        self._memo: dict[str, Any] = {}
        self.field._check_time("time", self.time)
        status, stop_time = np.zeros(len(x), np.int8), np.zeros(len(x))
        self._particles = Particles(x, status, stop_time)
        moved = self._move(self._particles, Steps(self.time, self._step_size, 0, 0))
        for policy, what, (_, index) in self._policies(moved):
            if policy == "raise" and index >= 0:
                raise InputError(f"positions[{index}]: {what} at the time {self.time}")
        self._particles = moved.particles

    @property
    def steps(self) -> int:
        """Steps that were taken since the beginning."""
        return self._steps

    @property
    def report(self) -> DriftReport:
        """What the last call of `step` or `advance` took and met."""
        counts = np.bincount(self._particles.status, minlength=3)
        landed, escaped = int(counts[LANDED]), int(counts[ESCAPED])
        return DriftReport(self._last.steps, self._last.dt, landed=landed, escaped=escaped)

    @property
    def positions(self) -> NDArray[Any]:
        """Positions, shape (n, d), in the order they were given; read-only."""
        return read_only(self._particles.x.copy())

    @property
    def status(self) -> NDArray[np.int8]:
        """What became of each particle, read-only: 0 active, 1 landed, 2 escaped."""
        return read_only(self._particles.status.copy())

    @property
    def stop_time(self) -> NDArray[np.float64]:
        """Time at which each particle stopped [s], read-only; the present time where it did not."""
        stopped = self._particles.status != ACTIVE
        return read_only(np.where(stopped, self._particles.stop_time, self.time))

    def __len__(self) -> int:
        return len(self._particles.x)

    def set_positions(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Put particles somewhere; those that had stopped drift again.

        Parameters
        ----------
        values : array_like, shape (m, d)
            Positions [m, or degrees of longitude and latitude]; of one id standing alone also one
            row standing alone.
        ids : int or array_like of int, shape (m,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        rows = find_rows_or_all(ids, self.ids)
        shape, dtype = (len(rows), self.field.dimension), self._particles.x.dtype
        x = check_array("values", rows_of(values, ids), shape, dtype=dtype)
        particles = self._particles.copy()
        particles.x[rows], particles.status[rows] = x, ACTIVE
        self._memo.clear()
        self._particles = particles

    def _take_step(self, dt: float) -> None:
        self._check_end("dt", dt)
        self._take(1, dt)

    def _count(self, dt: float) -> None:
        """`_keep` has counted."""

    def _run(self, duration: float, end: float, callback: Callable[[Self], object] | None) -> None:
        self._check_end("duration", duration)
        after = None if callback is None else lambda: callback(self)
        self._go(duration, self._step_size, after)

    def _go(self, duration: float, step: float, after: Callable[[], object] | None = None) -> None:
        if duration == 0:
            return
        end = self.time + duration
        if abs(step) < 4 * math.ulp(max(abs(self.time), abs(end))):
            raise SolverError(
                f"step {step} is below the spacing of the time {self.time}", time=self.time
            )
        full, h, rest = _count_steps(duration, step)
        self._take(full, h, after)
        if rest:
            self._take(1, rest, after)
        self._native.time = end

    def _take(self, count: int, h: float, after: Callable[[], object] | None = None) -> None:
        """Steps in blocks; after each block the state is whole."""
        origin, first = self.time, 0
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
            self._keep(moved, steps)
            first += steps.number
            if after:
                after()

    def _stopped(self, error: SolverError, steps: Steps, good: int) -> SolverError:
        """Take the steps before the one that failed, and say which it was."""
        if good > 0:
            before = steps._replace(number=good)
            self._keep(self._move(self._particles, before), before)
        error.step = self._steps
        return error

    def _move(self, particles: Particles, steps: Steps) -> Moved:
        return self.field._move(particles, steps, self.method, self._native.threads, self._memo)

    def _keep(self, moved: Moved, steps: Steps) -> None:
        whole = {"_particles": moved.particles, "_steps": min(self._steps + steps.number, MOST)}
        self._commit(whole, setattr, self._native, "time", steps.time(steps.number))
        self._last.steps += steps.number
        self._last.dt = steps.h

    def _policies(self, moved: Moved) -> list[tuple[str, str, tuple[int, int]]]:
        events = [
            (self.on_land, "on land", moved.landed),
            (self.on_escape, "outside the grid", moved.escaped),
        ]
        return sorted(events, key=lambda event: event[2])

    def _check_end(self, name: str, duration: float) -> None:
        if not math.isfinite(self.time + duration):
            raise InputError(f"{name}: the time {self.time} + {duration} is not finite")
        self.field._check_time(f"{name}: end time", self.time + duration)

    def step_limit(self) -> tuple[float, str]:
        """Largest step that `advance` takes [s], and why."""
        return self._step_size, "the step that was given"

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

    def _schema(self) -> tuple[list[Entry], dict[str, int], Any]:
        entries: list[Entry] = [
            TIME,
            Number("steps", int, low=0, high=MOST),
            Rows("positions", OWN, ("n", self.field.dimension)),
            Rows("status", np.int8, ("n",), low=ACTIVE, high=ESCAPED),
            Rows("stop_time", np.float64, ("n",)),
        ]
        return entries, {}, self._particles.x.dtype

    def _fit(self, state: dict[str, Any]) -> None:
        self.field._check_time("state['time']", state["time"])

    def _state(self) -> dict[str, Any]:
        particles = self._particles.copy()
        return {
            "time": self.time,
            "steps": self._steps,
            "positions": particles.x,
            "status": particles.status,
            "stop_time": particles.stop_time,
        }

    def _put_state(self, state: dict[str, Any]) -> None:
        self._particles = Particles(state["positions"], state["status"], state["stop_time"])
        self._native.time, self._steps = state["time"], state["steps"]
        self._memo.clear()

    def _make(self, state: Mapping[str, Any]) -> Any:
        return _Clock()

    def _parts(self) -> dict[str, Any]:
        return super()._parts() | {"_memo": {}}
