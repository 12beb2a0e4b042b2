"""Many worlds of rigid bodies in one call."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_flag, check_integer, check_real, check_sequence, describe
from ..base.rows import read_only
from ..base.schema import MOST, TIME, Entry, Texts
from ..base.simulation import Simulation, whole_steps, with_energy
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
from .batch_rows import BatchRows
from .bodies import RigidBodies
from .rows import BodyRows, check_squares
from .state import SCHEMA, rename

if TYPE_CHECKING:
    from typing_extensions import Self

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


class RigidBatch(BatchRows):
    """Many worlds of rigid bodies that know nothing of each other, stepped in one call.

    For data, for learning, for what depends on chance: each world has the bits of the same
    `RigidBodies` alone, whatever the number of worlds and threads. Arrays are read-only copies, one
    row for each world and, in it, for each body in the order of `RigidBodies.ids`; rows that a
    world with fewer bodies does not have are NaN. They mean what those of `RigidBodies` do, and are
    written by `set_positions`, `set_rotations`, `set_velocities`, `set_angular_velocities`,
    `set_forces` and `set_torques`.

    Parameters
    ----------
    template : RigidBodies or sequence of RigidBodies
        What the worlds are copies of, in its present state: one for all, or one each, with any
        contents. It is not changed, and may be used on.
    worlds : int, optional
        How many worlds; only for a single template.
    positions, rotations, velocities, angular_velocities : array_like, optional
        Where the bodies are and how they move, instead of as in the template: as of
        `set_positions` and the others.
    on_fail : {'raise', 'mask'}, optional
        Where a world fails: all worlds stop at the last step that all have done and NonFiniteError
        names world and body; or that world alone stops, at its last good step, see `failures`.
    threads : int, optional
        Threads, which share out the worlds; results do not depend on it.

    Raises
    ------
    InputError
        If an argument is wrong, with its name.

    See Also
    --------
    RigidBodies : One world.

    Examples
    --------
    A hundred balls thrown at different speeds, each in a world of its own; ten frames of each:

    >>> import numpy as np
    >>> import substep
    >>> world = substep.RigidBodies()
    >>> ground = world.add(substep.Plane(), (0, 0, 0), motion="static")
    >>> ball = world.add(substep.Sphere(0.1), (0, 0, 0.1), restitution=0.5)
    >>> batch = substep.RigidBatch(world, 100)
    >>> throw = np.zeros((100, 1, 3))
    >>> throw[:, 0, 2] = np.linspace(1, 5, 100)
    >>> batch.set_velocities(throw, ids=[ball])
    >>> frames = batch.rollout(60, every=6)
    >>> frames.shape
    (100, 10, 2, 7)
    >>> height = frames[:, :, ball, 2].max(axis=1)
    >>> bool(height[0] < 0.2), bool(height[-1] > 1.3)
    (True, True)
    """

    _step_size: float
    _fixed_step = True

    def __init__(
        self,
        template: RigidBodies | Sequence[RigidBodies],
        worlds: int | None = None,
        *,
        positions: ArrayLike | None = None,
        rotations: ArrayLike | None = None,
        velocities: ArrayLike | None = None,
        angular_velocities: ArrayLike | None = None,
        on_fail: str = "raise",
        threads: int | None = None,
    ) -> None:
        given = check_templates(template, worlds, BodyRows, "RigidBodies", least=0)
        copies: dict[int, RigidBodies] = {}
        for k, one in enumerate(given):
            if id(one) not in copies:
                _check_bodies(f"template[{k}]", one)
                copies[id(one)] = one.copy()
        self._made = [copies[id(one)] for one in given]
        self._step_size = self._made[0]._step_size if self._made else 1 / 60
        if any(one._step_size != self._step_size for one in self._made):
            raise InputError("template: expected one step for all worlds")
        super().__init__(_core.RigidBatch([one._native for one in self._made]), 0.0, threads)
        self._mask = check_masks(on_fail)
        self._native.mask = self._mask
        self._remember_frames()
        everywhere = self._where(None, None)
        if positions is not None or rotations is not None:
            x, q = self._poses()
            if positions is not None:
                x = check_squares("positions", self._values("positions", positions, everywhere, 3))
            if rotations is not None:
                q = self._values("rotations", rotations, everywhere, 4)
            self._set_frames(everywhere, x, q)
        if velocities is not None or angular_velocities is not None:
            v, w = self._native.velocities(), self._native.angular_velocities()
            if velocities is not None:
                v = self._velocities("velocities", velocities, everywhere)
            if angular_velocities is not None:
                w = self._velocities("angular_velocities", angular_velocities, everywhere)
            self._write("set_velocities", everywhere, v, w)
        self._first = list(self._made)
        self._native.keep_initial()

    def step(self, dt: float | None = None, steps: int = 1, *, hold_forces: bool = False) -> None:
        """Take steps in all worlds that have not failed.

        Parameters
        ----------
        dt : float, optional
            The size of each [s], above 0; `step_size` unless given.
        steps : int, optional
            How many, at least 0.
        hold_forces : bool, optional
            Whether forces and torques act in all of the steps, or in the first only.

        Raises
        ------
        InputError
            If an argument is wrong.
        NonFiniteError
            With the time, `index` (the world) and `step` (how many steps of this call all worlds
            have done); the message names the body.
        SolverError
            The same, where a step would tear a joint apart; the message names the joint.
        """
        dt = self._step_size if dt is None else check_real("dt", dt, positive=True)
        steps = check_integer("steps", steps, minimum=0, maximum=MOST)
        hold = check_flag("hold_forces", hold_forces)
        self._owner.begin("step")
        self._native.step(dt, steps, hold)
        self._last.steps, self._last.dt = steps, dt

    def advance(
        self,
        duration: float,
        callback: Callable[[Self], object] | None = None,
        *,
        hold_forces: bool = False,
    ) -> None:
        """Take steps of `step_size` over a duration; the last is shortened to end there.

        Parameters
        ----------
        duration : float
            How long [s], at least 0.
        callback : callable, optional
            Called with this object after every step. It may read and write everything; it must not
            step. Its exceptions end the run, and are passed on.
        hold_forces : bool, optional
            As of `step`.

        Raises
        ------
        InputError
            If `duration` is wrong.
        NonFiniteError
            As `step`.
        """
        hold = check_flag("hold_forces", hold_forces)
        self._held = (self._native.forces(), self._native.torques()) if hold else None
        super().advance(duration, callback)

    def _run(self, duration: float, end: float, callback: Callable[[Self], object] | None) -> None:
        held, starts = self._held, self.times
        count, whole = whole_steps(duration, self._step_size)
        runs = [(self._step_size, count)] if callback is None else [(self._step_size, 1)] * count
        if not whole:
            runs.append((0.0, 1))  # what is left then
        for k, (dt, steps) in enumerate(runs):
            if held and self._last.steps > 0:
                everywhere = self._where(None, None)
                self._write("set_forces", everywhere, held[0])
                self._write("set_torques", everywhere, held[1])
            dt = dt or end - self.time
            self._native.step(dt, steps, held is not None)
            self._last.steps += steps
            self._last.dt = dt
            if k + 1 == len(runs):
                going = np.array([not reason for reason in self.failures], bool)
                self._native.times = np.where(going, starts + duration, self.times)
                self._native.time = end
            if callback is not None:
                callback(self)

    def rollout(
        self,
        steps: int,
        every: int = 1,
        *,
        dt: float | None = None,
        velocities: bool = False,
        hold_forces: bool = False,
    ) -> Array:
        """Take steps and record poses in one native call.

        Parameters
        ----------
        steps : int
            How many, a multiple of `every`.
        every : int, optional
            Steps from frame to frame; the first frame is after so many.
        dt : float, optional
            The size of a step [s], above 0; `step_size` unless given.
        velocities : bool, optional
            Whether to record them too.
        hold_forces : bool, optional
            As of `step`.

        Returns
        -------
        ndarray, shape (w, t, n, 7) or (w, t, n, 13)
            Of each world, frame and body `positions` and `rotations`, then with `velocities` also
            `velocities` and `angular_velocities`. NaN where a world has no such body, or has failed
            before (`on_fail` 'mask').

        Raises
        ------
        InputError
            If an argument is wrong.
        NonFiniteError
            As `step`; `result` has the frames up to there.
        """
        every = check_integer("every", every, minimum=1, maximum=MOST)
        steps = check_integer("steps", steps, minimum=0, maximum=MOST)
        if steps % every != 0:
            raise InputError(f"steps: expected a multiple of every ({every}), got {steps}")
        dt = self._step_size if dt is None else check_real("dt", dt, positive=True)
        columns = 13 if check_flag("velocities", velocities) else 7
        hold = check_flag("hold_forces", hold_forces)
        shape = (len(self), steps // every, int(self.counts.max(initial=0)), columns)
        self._owner.begin("rollout")
        try:
            frames = np.full(shape, np.nan)
        except (MemoryError, ValueError):  # of which the second is of sizes beyond all memory
            raise MemoryError(f"steps: no memory for frames of shape {shape}") from None
        try:
            self._native.rollout(dt, every, hold, frames)
        except SolverError as error:
            error.result = self._as_put_in(frames[:, : (error.step or 0) // every].copy())
            raise
        return self._as_put_in(frames)

    def _as_put_in(self, frames: Array) -> Array:
        """Frames of a rollout, changed to the poses of the frames of bodies."""
        x, q = frames[..., :3], frames[..., 3:7]
        x[:], q[:] = self._to_frames(x, q, self._centres[:, None], self._axes[:, None])
        return frames

    def reset(
        self,
        worlds: ArrayLike | None = None,
        to: RigidBodies | Sequence[RigidBodies] | None = None,
    ) -> None:
        """Put worlds into another state; those that had failed take part again.

        Parameters
        ----------
        worlds : int or array_like of int, shape (k,), optional
            Which; all unless given.
        to : RigidBodies or sequence of k RigidBodies, optional
            The state that they take over, with as many bodies as the world; that at the start of
            the batch unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.

        Examples
        --------
        >>> import substep
        >>> world = substep.RigidBodies()
        >>> ball = world.add(substep.Sphere(0.1), (0, 0, 1))
        >>> batch = substep.RigidBatch(world, 3)
        >>> batch.step(steps=5)
        >>> batch.reset([1])
        >>> batch.positions[:, ball, 2].round(3).tolist()
        [0.966, 1.0, 0.966]
        """
        chosen = find_worlds("worlds", worlds, len(self))
        if to is None:
            self._native.reset(chosen)
            self._remember(chosen, [self._first[w] for w in chosen])
            return
        single = isinstance(to, BodyRows)
        sources: list[Any] = (
            [to] * len(chosen) if single else check_sequence("to", to, "RigidBodies")
        )
        if len(sources) != len(chosen):
            raise InputError(f"to: expected {len(chosen)}, one for each world")
        counts = self.counts
        for k, (w, source) in enumerate(zip(chosen, sources, strict=True)):
            _check_bodies(f"to[{k}]", source)
            if len(source) != counts[w]:
                raise InputError(f"to[{k}]: expected {counts[w]} bodies, got {len(source)}")
        copies = {id(source): source.copy() for source in sources}
        self._native.put(chosen, [copies[id(source)]._native for source in sources])
        self._remember(chosen, [copies[id(source)] for source in sources])

    def copy_world(self, world: int) -> RigidBodies:
        """Copy one world out: for queries, contacts, joints, pictures, or to go on alone.

        Parameters
        ----------
        world : int
            Its number.

        Returns
        -------
        RigidBodies
            In the state of that world; `reset` puts it back.

        Raises
        ------
        IndexError
            If there is no such world.
        """
        w = int(find_worlds("world", check_integer("world", world), len(self))[0])
        bodies = self._made[w].copy()
        self._native.copy_out(w, bodies._native)
        return bodies

    def diagnostics(self) -> dict[str, float]:
        """Sums over all worlds.

        Returns
        -------
        dict of str to float
            `worlds`; `failed`, how many of them; of all together `kinetic_energy`,
            `gravitational_energy`, `energy`, their sum [J], and `contacts`.
        """
        values: dict[str, float] = self._native.diagnostics()
        return with_energy(rename(values))

    def step_limit(self) -> tuple[float, str]:
        """Longest step that keeps contacts and joints accurate in all worlds, and why.

        Returns
        -------
        float
            The shortest of the worlds that have not failed [s], infinity if there is none; see
            `RigidBodies.step_limit`.
        str
            The reason, with the number of the world, and how many have stopped.
        """
        return self._shortest(lambda w: self.copy_world(w).step_limit())

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays for recording, with their units: the bodies of all worlds, one after the other.

        Returns
        -------
        dict of str to (ndarray, str)
            `position` and `orientation`, which are `positions` and `rotations`; `velocity`,
            `angular_velocity` and `world`.
        """
        present = self._ids >= 0
        return {
            "position": (self.positions[present], "m"),
            "orientation": (self.rotations[present], "1"),
            "velocity": (self.velocities[present], "m/s"),
            "angular_velocity": (self.angular_velocities[present], "rad/s"),
            "world": (np.nonzero(present)[0], "1"),
        }

    @property
    def gravity(self) -> Array:
        """Acceleration of each world [m/s^2], shape (w, 3), read-only."""
        return read_only(np.array([made.gravity for made in self._first]).reshape(-1, 3))

    def _schema(self) -> tuple[list[Entry], dict[str, int], Any]:
        sizes = {"worlds": len(self)}
        entries: list[Entry] = [TIME, Texts("failures", "worlds")]
        if len(self):
            entries += [entry for one in SCHEMA for entry in joined_entries(one)]
        return entries, sizes, np.float64

    def _state(self) -> dict[str, Any]:
        return self._joined(self._made, self._native.state, self.failures)

    def _joined(
        self,
        made: list[RigidBodies],
        native: Callable[[int], dict[str, Any]],
        failures: Sequence[str],
    ) -> dict[str, Any]:
        states = [{**one.state(), **native(w)} for w, one in enumerate(made)]
        return {"time": self.time, "failures": json.dumps(failures), **join_states(states)}

    def _fit(self, state: dict[str, Any]) -> None:
        check_failures(state["failures"], self._mask)
        copies = []
        for w, made in enumerate(self._made):
            copies.append(made.copy())
            try:
                copies[-1].restore(state_of_world(state, w))
            except InputError as error:
                raise InputError(f"world {w}: {error}") from None
        state["copies"] = copies

    def _kept(self) -> dict[str, Any]:
        copies = [self.copy_world(w) for w in range(len(self))]
        return {"time": self.time, "failures": self._native.failures, "copies": copies}

    def _put_state(self, state: dict[str, Any]) -> None:
        self._native.put(np.arange(len(self)), [one._native for one in state["copies"]])
        self._native.time, self._native.failures = state["time"], state["failures"]

    def _parts(self) -> dict[str, Any]:
        first = self._joined(self._first, self._native.initial_state, [""] * len(self))
        return super()._parts() | {"_made": list(self._made), "_first_state": first}

    def __setstate__(self, given: tuple[dict[str, Any], int | None, dict[str, Any]]) -> None:
        parts, threads, state = given
        self.__dict__.update(parts)
        first, made = self.__dict__.pop("_first_state"), self._made
        self._made = list(self._first)
        Simulation.__init__(self, _core.RigidBatch([one._native for one in made]), 0.0, threads)
        self._native.mask = self._mask
        self.restore(first)
        self._native.keep_initial()
        self._made, self._last = made, parts["_last"]
        self.restore(state)

    def _remember(self, worlds: Ids, made: list[RigidBodies]) -> None:
        if all(self._made[w] is one for w, one in zip(worlds, made, strict=True)):
            return
        for w, one in zip(worlds, made, strict=True):
            self._made[w] = one
        self._remember_frames()


def _check_bodies(name: str, value: Any) -> None:
    if not isinstance(value, BodyRows):
        raise TypeError(f"{name}: expected RigidBodies, got {describe(value)}")
