"""Steps of rigid bodies: runs with callbacks, and how long a step may be."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from ..base.checks import check_callable, check_real
from ..errors import InputError, NonFiniteError
from .joints import Joints
from .queries import Queries

if TYPE_CHECKING:
    from typing import Self

_TURN = 1.0  # rad that a body in contact may turn in a step


class Runs(Queries, Joints):
    """A world of rigid bodies in time; make `RigidBodies`."""

    step_size: float
    _callback_of: int | None = None  # the thread that runs a callback

    def _next_step(self) -> float:
        return self.step_size

    def step(self, dt: float | None = None) -> None:
        """Take one step.

        Parameters
        ----------
        dt : float, optional
            Its size [s], above 0; `step_size` unless given.

        Raises
        ------
        InputError
            If `dt` is wrong.
        NonFiniteError
            With the time and the id of the body, also where what was written through a view is
            not finite; the state is then unchanged.
        """
        self._refuse_callback("step")
        super().step(dt)

    def advance(self, duration: float, callback: Callable[[Self], object] | None = None) -> None:
        """Take steps of `step_size` over a duration; the last is shortened to end there.

        Parameters
        ----------
        duration : float
            How long [s], at least 0.
        callback : callable, optional
            Called with this object after every step. It may read and write everything, add and
            remove bodies and joints; it must not step. What it raises ends the run, and passes.

        Raises
        ------
        InputError
            If `duration` is wrong.
        NonFiniteError
            As `step`; the state is then the last good step, and the exception's `step` its number.

        Examples
        --------
        >>> import substep
        >>> bodies = substep.RigidBodies()
        >>> ball = bodies.add(substep.rigid.Sphere(0.1), (0, 0, 0), mass=2.0)
        >>> bodies.advance(1.0, lambda bodies: bodies.apply_force(ball, (0, 0, 19.62)))
        >>> bodies.velocities[ball].round(4).tolist()  # of the first step, before any force
        [0.0, 0.0, -0.1635]
        """
        duration = check_real("duration", duration, nonnegative=True)
        if callback is not None:
            check_callable("callback", callback)
        self._refuse_callback("advance")
        end = self.time + duration
        if not math.isfinite(end):
            raise InputError(f"duration: the time {self.time} + {duration} is not finite")
        ratio = duration / self.step_size
        whole = abs(ratio - round(ratio)) <= 1e-9 * max(1.0, ratio)
        count = round(ratio) if whole else math.floor(ratio)
        with self._own():
            for number in range(count + (not whole)):
                self._step_of_advance(number, self.step_size if number < count else end - self.time)
                if number + 1 == count + (not whole):
                    self._native.time = end
                if callback is not None:
                    self._call(callback)

    def _step_of_advance(self, number: int, dt: float) -> None:
        try:
            self._take_step(dt)
        except NonFiniteError as error:
            error.step = number
            raise

    def _take_step(self, dt: float) -> None:
        try:
            self._native.step(dt)
        except NonFiniteError as error:
            row = error.index
            if row is None or self._ids[row] == row:
                raise
            number = int(self._ids[row])
            text = str(error).replace(f"body {row}", f"body {number}")
            raise NonFiniteError(text, time=error.time, index=number, step=error.step) from None

    def _call(self, callback: Callable[[Self], object]) -> None:
        self._callback_of = threading.get_ident()
        try:
            callback(self)
        finally:
            self._callback_of = None

    def _refuse_callback(self, method: str) -> None:
        if self._callback_of == threading.get_ident():
            raise InputError(f"{method}: called by the callback of advance")

    @contextlib.contextmanager
    def _own(self) -> Iterator[None]:
        """As of Simulation; a callback is in the thread that owns the object already."""
        if self._callback_of == threading.get_ident():
            yield
        else:
            with super()._own():
                yield

    def step_limit(self) -> tuple[float, str]:
        """Longest step that keeps contacts and joints accurate, and why.

        Every step is stable. But where bodies touch is found once a step.

        Returns
        -------
        float
            In which no body that touches another or has a joint turns by more than a radian [s];
            infinite if none turns.
        str
            The reason, with the id of the body.
        """
        with self._own():
            held = self._native.constrained()
        if not len(held):
            return math.inf, "no body is in contact or has a joint"
        rates = np.linalg.norm(self.angular_velocities[held], axis=1)
        fastest = int(np.argmax(rates))
        if rates[fastest] == 0:
            return math.inf, "no body in contact or with a joint turns"
        limit = float(_TURN / rates[fastest])
        return limit, f"body {self._ids[held[fastest]]} turns by {_TURN:g} rad"
