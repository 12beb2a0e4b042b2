"""Many simulations of particles or springs that know nothing of each other, in one call."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import (
    check_integer,
    check_real,
    check_sequence,
    check_threads,
    describe,
)
from ..base.rows import Points
from ..base.schema import MOST, TIME, Entry, Number, Texts
from ..base.simulation import Simulation, StepReport, whole_steps
from ..base.worlds import (
    check_failures,
    check_masks,
    check_templates,
    find_worlds,
    join_states,
    joined_entries,
    state_of_world,
)
from ..errors import InputError, SolverError
from ..pbd import CustomConstraint
from .rows import BatchRows

if TYPE_CHECKING:
    from typing_extensions import Self

Array = NDArray[np.float64]

_FAR = float(np.sqrt(np.finfo(np.float32).max))  # whose square pictures, in float32, can hold
_LAST = 3  # steps of a duration whose sizes may differ from that of the others
_SUMS = (
    *("count", "mass", "kinetic_energy", "gravitational_energy", "elastic_energy", "energy"),
    *(f"{name}_{axis}" for name in ("momentum", "angular_momentum") for axis in "xyz"),
)


class Batch(BatchRows):
    """Many worlds of particles or springs that know nothing of each other, stepped in one call.

    For data, for learning, for what depends on chance: each world has the bits of the same
    simulation alone, whatever the number of worlds and threads. A world runs on one thread. Arrays
    are read-only copies, one row for each world and, in it, for each particle in the order of its
    simulation; rows that a world with fewer particles does not have are NaN. `time` is the earliest
    of the worlds that go on.

    Parameters
    ----------
    template : simulation or sequence of simulations
        What the worlds are copies of, in its present state: one for all, or one each. They are of
        one class, of `MassSpring`, `SoftBody`, `PositionBasedDynamics`, `PositionBasedFluid`,
        `GridLiquid` and `MaterialPointMethod`, with one `step_size`, but may differ in all else.
        They are not changed, and may be used on. Rigid bodies have `RigidBatch`.
    worlds : int, optional
        How many worlds; only for a single template.
    on_fail : {'raise', 'mask'}, optional
        Where a world fails: all worlds stop at the last step that all have done and SolverError
        names the world; or that world alone stops, at its last good step, see `failures`.
    threads : int, optional
        Threads, which share out the worlds; results do not depend on it.

    Raises
    ------
    InputError
        If an argument is wrong, with its name.

    See Also
    --------
    RigidBatch : The same of rigid bodies.

    Examples
    --------
    A hundred pendulums, let go with different speeds:

    >>> import numpy as np
    >>> import substep
    >>> pendulum = substep.MassSpring([[0, 0, 0], [0, 0, -1]], [[0, 1]], 1e4, 1.0, pinned=[0])
    >>> batch = substep.Batch(pendulum, 100)
    >>> push = np.zeros((100, 2, 3))
    >>> push[:, 1, 0] = np.linspace(0, 2, 100)
    >>> batch.set_velocities(push)
    >>> batch.advance(0.5)
    >>> batch.positions.shape
    (100, 2, 3)
    >>> bool((np.diff(batch.positions[:, 1, 0]) > 0).all())
    True
    """

    _first: list[dict[str, Any]]  # states at the start

    def __init__(
        self,
        template: Any,
        worlds: int | None = None,
        *,
        on_fail: str = "raise",
        threads: int | None = None,
    ) -> None:
        given = check_templates(template, worlds, Simulation, "simulations", least=1)
        if not given:
            raise InputError("template: expected at least one simulation")
        if given[0] is template:
            _check_world("template", template, template)
        else:
            for k, one in enumerate(given):
                _check_world(f"template[{k}]", one, given[0])
        self._mask = check_masks(on_fail)
        self._last = StepReport()
        self._take_in([one.copy() for one in given], [""] * len(given), check_threads(threads))
        self._first = [one._kept() for one in self._worlds]

    def _take_in(self, worlds: list[Any], failures: list[str], threads: int) -> None:
        """Step these worlds from now on: all, or none."""
        for one in worlds:
            one.threads = 1
        native = _core.Batch([one._native for one in worlds])
        native.mask, native.failures, native.threads = self._mask, failures, threads
        self.__dict__.update(_worlds=worlds, _native=native)

    @property
    def _step_size(self) -> float | None:  # type: ignore[override]
        step: float | None = self._worlds[0]._step_size
        return step

    def _set_step_size(self, step: float | None) -> None:
        if step == self._step_size:
            return
        worlds = [one.copy() for one in self._worlds]
        for one in worlds:
            one.step_size = step
        self._take_in(worlds, self.failures, self._native.threads)

    def step(self, dt: float | None = None, steps: int = 1) -> None:
        """Take steps in all worlds that have not failed.

        Parameters
        ----------
        dt : float, optional
            The size of each [s], above 0; unless given `step_size`, or what each world would take.
        steps : int, optional
            How many, at least 0.

        Raises
        ------
        InputError
            If an argument is wrong.
        SolverError
            With the time, `index` (the world) and `step` (how many steps of this call all worlds
            have done); the message names the world.
        """
        if dt is not None:
            dt = check_real("dt", dt, positive=True)
        steps = check_integer("steps", steps, minimum=0, maximum=MOST)
        self._begin("step")
        dt = self._step_size if dt is None else dt
        if dt is not None or self._worlds[0]._fuses_steps:
            self._take(np.full(len(self), np.nan if dt is None else dt), steps)
            return
        for _ in range(steps):
            sizes, failures = np.zeros(len(self)), self.failures
            asks = {w: one._next_step for w, one in enumerate(self._worlds) if not failures[w]}
            for w, dt in self._ask(asks).items():
                sizes[w] = dt
            self._take(sizes)

    def _take(self, sizes: Array, steps: int = 1, times: Array | None = None) -> None:
        """Steps of these sizes, after which the worlds are at these times, unless they are NaN."""
        times = np.full(len(self), np.nan) if times is None else times
        self._call(steps, self._native.step, sizes, times, steps)
        self._last.dt = float(sizes.max()) if steps else self._last.dt

    def _call(self, steps: int, call: Callable[..., Any], *arguments: Any) -> None:
        try:
            call(*arguments)
        except SolverError as error:
            error.step = self._last.steps + (error.step or 0)
            raise
        self._last.steps += steps

    def _run(self, duration: float, end: float, callback: Callable[[Self], object] | None) -> None:
        ends = self._native.times + duration
        if self._worlds[0]._fuses_steps:
            return self._run_fused(ends, callback)
        whole, h = self._whole_steps(duration, ends) if callback is None else (0, 0.0)
        if whole:
            self._take(np.full(len(self), h), whole)
        paces = self._paces(duration, ends, whole)
        while steps := self._ask(paces):
            sizes, times = np.zeros(len(self)), np.full(len(self), np.nan)
            for w, (dt, is_last) in steps.items():
                sizes[w] = dt
                times[w] = ends[w] if is_last else np.nan
            self._take(sizes, 1, times)
            if callback is not None:
                known = self._known()
                callback(self)
                if known != self._known():
                    paces = self._paces(None, ends, 0)
            if self._mask:
                failures = self.failures
                paces = {w: pace for w, pace in paces.items() if not failures[w]}

    def _known(self) -> tuple[Any, ...]:
        """What the paces were made for; `_native` is another one after `step_size` is set."""
        return self._native, self._native.times.tolist(), self.failures, self._step_size

    def _ask(self, asks: Mapping[int, Callable[[], Any]]) -> dict[int, Any]:
        """The next step of each world that has one; a world whose step is too small fails."""
        steps: dict[int, Any] = {}
        for w, ask in asks.items():
            try:
                step = ask()
            except SolverError as error:
                self._fail(w, error)
                continue
            if step is not None:
                steps[w] = step
        return steps

    def _fail(self, w: int, error: SolverError) -> None:
        """Stop a world alone, or all, as the native steps do."""
        if not self._mask:
            error.args = (f"world {w}: {error}",)
            error.time, error.index = float(self._native.times[w]), w
            error.step = self._last.steps
            raise error
        failures = self.failures
        failures[w] = str(error)
        self._native.failures = failures

    def _run_fused(self, ends: Array, callback: Callable[[Self], object] | None) -> None:
        """The same of worlds that choose and fuse their steps themselves."""
        if callback is None:
            self._call(0, self._native.advance, ends)
            reports = [one._native.report for one in self._worlds]
            self._last.steps = max(report["steps"] for report in reports)
            self._last.dt = max(report["dt"] for report in reports)
            return
        first = True
        while any(
            time < end and not failure
            for time, end, failure in zip(self._native.times, ends, self.failures, strict=True)
        ):
            self._call(1, self._native.advance_once, ends, first)
            self._last.dt = max(one._native.report["dt"] for one in self._worlds)
            first = False
            callback(self)

    def _whole_steps(self, duration: float, ends: Array) -> tuple[int, float]:
        """Steps of a duration that are of one size in all worlds, and that size."""
        one, h = self._worlds[0], self._step_size
        if h is not None and one._fixed_step:
            h = one._even_step(duration)
        if h is None or not (ends + h > ends).all():  # of which some is below the spacing of times
            return 0, 0.0
        return min(max(0, whole_steps(duration, h)[0] - _LAST), MOST), h

    def _paces(
        self, duration: float | None, ends: Array, begin: int
    ) -> dict[int, Callable[[], tuple[float, bool] | None]]:
        """Of each world that goes on what gives the steps that it takes alone, after so many."""
        paces: dict[int, Callable[[], tuple[float, bool] | None]] = {}
        failures, times = self.failures, self._native.times
        for w, one in enumerate(self._worlds):
            if failures[w]:
                continue
            if one._fixed_step:
                left = max(float(ends[w] - times[w]), 0.0) if duration is None else duration
                sizes = itertools.islice(one._even_sizes(left, float(ends[w])), begin, None)
            else:
                sizes = one._sizes(float(ends[w]))
            paces[w] = partial(next, sizes, None)
        return paces

    def reset(self, worlds: ArrayLike | None = None, to: Any = None) -> None:
        """Put worlds into another state; those that had failed take part again.

        Parameters
        ----------
        worlds : int or array_like of int, shape (k,), optional
            Which; all unless given.
        to : simulation or sequence of k simulations, optional
            The state that they take over, of one that is made as the world is; that at the start of
            the batch unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.

        Examples
        --------
        >>> import substep
        >>> ball = substep.PositionBasedDynamics([[0, 0, 1.0]], 1.0)
        >>> batch = substep.Batch(ball, 3)
        >>> batch.step(steps=6)
        >>> batch.reset([1])
        >>> batch.positions[:, 0, 2].round(3).tolist()
        [0.95, 1.0, 0.95]
        """
        chosen = find_worlds("worlds", worlds, len(self))
        states = [self._first[w] for w in chosen]
        if to is not None:
            single = isinstance(to, Simulation)
            given = [to] * len(chosen) if single else check_sequence("to", to, "simulations")
            if len(given) != len(chosen):
                raise InputError(f"to: expected {len(chosen)}, one for each world")
            for k, (w, one) in enumerate(zip(chosen, given, strict=True)):
                _check_world(f"to[{k}]", one, self._worlds[w])
                states[k] = self._state_for(int(w), one.state())
        here = [self._worlds[w] for w in chosen]
        before, failures = [one._kept() for one in here], self.failures
        for w in chosen:
            failures[w] = ""
        try:
            self._go_back(here, states)
            self._native.failures = failures
        except BaseException:
            self._go_back(here, before)
            raise

    def _state_for(self, w: int, state: dict[str, Any]) -> dict[str, Any]:
        try:
            checked: dict[str, Any] = self._worlds[w]._checked(state)
            return checked
        except InputError as error:
            raise InputError(f"world {w}: {error}") from None

    def copy_world(self, world: int) -> Any:
        """Copy one world out: for all that its class tells, pictures, or to go on alone.

        Parameters
        ----------
        world : int
            Its number.

        Returns
        -------
        Simulation
            Of the class of the template, in the state of that world; `reset` puts it back.

        Raises
        ------
        IndexError
            If there is no such world.
        """
        w = int(find_worlds("world", check_integer("world", world), len(self))[0])
        one = self._worlds[w].copy()
        one.threads = None
        return one

    def diagnostics(self) -> dict[str, float]:
        """Sums over all worlds that have not failed.

        Returns
        -------
        dict of str to float
            `worlds`, how many there are; `failed`, how many of them have stopped; of the others
            together those of `count`, `mass`, energies and momenta that the class has.
        """
        each = self.world_diagnostics()
        going = ~np.array([bool(reason) for reason in self.failures])
        sums = {name: float(np.nansum(each[name][going])) for name in _SUMS if name in each}
        failed = len(self) - np.count_nonzero(going)
        return {"worlds": float(len(self)), "failed": float(failed), **sums}

    def world_diagnostics(self) -> dict[str, Array]:
        """What `diagnostics` of each world tells.

        Returns
        -------
        dict of str to ndarray, shape (w,)
            Of each world the number, or NaN where it has no such.
        """
        each = [one.diagnostics() for one in self._worlds]
        names = dict.fromkeys(name for one in each for name in one)
        return {name: np.array([one.get(name, np.nan) for one in each]) for name in names}

    def step_limit(self) -> tuple[float, str]:
        """Longest step that suits all worlds that have not failed, and why.

        Returns
        -------
        float
            The shortest of theirs [s], infinity if there is none; see `step_limit` of the class.
        str
            The reason, with the number of the world, and how many have stopped.
        """
        return self._shortest(lambda w: self._worlds[w].step_limit())  # type: ignore[no-any-return]

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays for recording, with their units: all worlds, one after the other.

        Returns
        -------
        dict of str to (ndarray, str)
            `position`, `velocity` and `world`. A world that has stopped with numbers that are not
            finite, or too large for a picture (above 1.8e19), is left out.
        """
        present = np.arange(self.counts.max()) < self.counts[:, None]
        x, v = self.positions, self.velocities
        for w in np.flatnonzero([bool(reason) for reason in self.failures]):
            rows = np.abs([x[w, present[w]], v[w, present[w]]])
            present[w] &= bool((rows <= _FAR).all())  # false of NaN
        return {
            "position": (x[present], "m"),
            "velocity": (v[present], "m/s"),
            "world": (np.nonzero(present)[0], "1"),
        }

    def _schema(self) -> tuple[list[Entry], dict[str, int], Any]:
        own, _, dtype = self._worlds[0]._schema()
        entries = [entry for one in own for entry in joined_entries(one)]
        entries = [TIME, Number("class", str), Texts("failures", "worlds"), *entries]
        return entries, {"worlds": len(self)}, dtype

    def _state(self) -> dict[str, Any]:
        states = join_states([one._state() for one in self._worlds])
        told = {"time": self.time, "class": self._class, "failures": json.dumps(self.failures)}
        return {**told, **states}

    def _fit(self, state: dict[str, Any]) -> None:
        failures, times = state["failures"], state["each_time"]
        check_failures(failures, self._mask)
        going = [time for time, failure in zip(times, failures, strict=True) if not failure]
        if state["time"] != min(going or times):
            raise InputError(f"state['time']: expected {min(going or times)}, the earliest")
        state["worlds"] = [
            self._state_for(w, state_of_world(state, w)) for w in range(len(self._worlds))
        ]

    def _refuse(self, given: dict[str, Any]) -> None:
        for w, failure in enumerate(given["failures"]):
            if failure:  # what has stopped stays as it is
                continue
            try:
                self._worlds[w]._refuse(given["worlds"][w])
            except InputError as error:
                raise InputError(f"world {w}: {error}") from None

    def _kept(self) -> dict[str, Any]:
        return {"worlds": [one._kept() for one in self._worlds], "failures": self.failures}

    def _put_state(self, state: dict[str, Any]) -> None:
        self._go_back(self._worlds, state["worlds"])
        self._native.failures = state["failures"]

    def _parts(self) -> dict[str, Any]:
        return super()._parts() | {"_worlds": [one.copy() for one in self._worlds]}

    def __getstate__(self) -> tuple[dict[str, Any], int | None, dict[str, Any]]:
        return self._parts(), self.threads, {"failures": self.failures}

    def __setstate__(self, given: tuple[dict[str, Any], int | None, dict[str, Any]]) -> None:
        parts, threads, state = given
        self.__dict__.update(parts)
        self._take_in(parts["_worlds"], state["failures"], threads or 0)


def _check_world(name: str, one: Any, first: Any) -> None:
    if not (isinstance(one, Points) and isinstance(one._native, _core.Simulation)):
        hint = "; rigid bodies have RigidBatch" if isinstance(one, Simulation) else ""
        raise TypeError(
            f"{name}: expected a simulation of particles or springs, got {describe(one)}{hint}"
        )
    if any(isinstance(part, CustomConstraint) for part in getattr(one, "constraints", ())):
        raise InputError(f"{name}: expected one without CustomConstraint, which calls Python")
    for what, of in (
        ("class", lambda it: type(it).__name__),
        ("dimension", lambda it: it._dimension),
        ("dtype", lambda it: getattr(it, "dtype", None)),
        ("step_size", lambda it: it._step_size),
    ):
        if of(one) != of(first):
            raise InputError(f"{name}: expected {what} {of(first)} as of the others, got {of(one)}")
