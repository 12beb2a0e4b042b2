"""What every simulation of the native core shares: steps in time, threads, checkpoints, locks."""

from __future__ import annotations

import contextlib
import math
import os
import threading
from collections.abc import Iterator
from typing import Any

from ..errors import InputError, SolverError
from .checkpoint import restore_checkpoint, write_checkpoint
from .checks import check_real, check_threads


class Simulation:
    """State in time; a subclass makes `_native`, `state`, `restore`, and the rest of the protocol.

    `_native` has `time`, `threads` and `step(dt)`, which takes one step or leaves all as it was.
    """

    _native: Any

    def __init__(self, native: Any, time: float, threads: int | None) -> None:
        self._native = native
        self._native.time = check_real("time", time)
        self._native.threads = check_threads(threads)
        self._busy = threading.Lock()

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

    def _next_step(self) -> float:
        """Size of the step that `advance` takes now [s]."""
        raise NotImplementedError

    def _take_step(self, dt: float) -> None:
        self._native.step(dt)

    def state(self) -> dict[str, Any]:
        """Copy the whole state, for `restore`."""
        raise NotImplementedError

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a state, bit for bit."""
        raise NotImplementedError

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
        with self._own():
            self._take_step(
                self._next_step() if dt is None else check_real("dt", dt, positive=True)
            )

    def advance(self, duration: float) -> None:
        """Take as many steps as a duration needs; the last two are shortened to end there.

        Parameters
        ----------
        duration : float
            How long [s], at least 0.

        Raises
        ------
        InputError
            If `duration` is wrong.
        SolverError
            As `step`; the state is then the last good step.
        """
        duration = check_real("duration", duration, nonnegative=True)
        start = self.time
        end = start + duration
        if not math.isfinite(end):
            raise InputError(f"duration: the time {start} + {duration} is not finite")
        with self._own():
            while self.time < end:
                h, left = self._next_step(), end - self.time
                if left <= h * (1 + 1e-9):
                    self._take_step(left)
                    self._native.time = end
                elif self.time + h > self.time:
                    # Two equal steps at the end: a very short one would make large velocities of
                    # what is left to correct.
                    self._take_step(left / 2 if left < 2 * h * (1 - 1e-9) else h)
                else:
                    raise SolverError(
                        f"the step, {h:.3g} s, is below the spacing of the time {self.time} s: "
                        "the speeds have grown without bound",
                        time=self.time,
                    )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the state to a file, atomically; what the object was made of is not in it.

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
            If the file is cut off (TruncatedError), spoiled (CorruptError) or of another version
            (VersionError); nothing is changed then.
        OSError
            If it cannot be read.
        """
        restore_checkpoint(path, type(self).__name__, self.restore)

    @contextlib.contextmanager
    def _own(self) -> Iterator[None]:
        if not self._busy.acquire(blocking=False):
            raise InputError(f"this {type(self).__name__} is in use by another thread")
        try:
            yield
        finally:
            self._busy.release()
