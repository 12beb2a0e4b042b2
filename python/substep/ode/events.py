"""Events of solve_ivp: zeros of functions of t and y, found on the dense output of each step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from ..base.checks import check_sequence, describe
from ..errors import InputError

EPS = float(np.finfo(float).eps)


def find_root(
    function: Callable[[float], float], a: float, b: float, fa: float, fb: float
) -> float:
    """Zero of `function` between a and b, where it changes sign.

    The method of Brent, "Algorithms for Minimization without Derivatives", 1973, chapter 4 (inverse
    quadratic interpolation, secant, bisection as the safeguard), to 4 units of rounding.
    """
    if fa == 0.0 or fb == 0.0:
        return a if fa == 0.0 else b
    c, fc, last, before_last = a, fa, b - a, b - a
    for _ in range(200):
        if (fb > 0.0) == (fc > 0.0):
            c, fc = a, fa
            last = before_last = b - a
        if abs(fc) < abs(fb):
            a, b, c = b, c, b
            fa, fb, fc = fb, fc, fb
        tolerance = 2.0 * EPS * abs(b) + 0.5 * 4.0 * EPS
        middle = 0.5 * (c - b)
        if abs(middle) <= tolerance or fb == 0.0:
            break
        if abs(before_last) >= tolerance and abs(fa) > abs(fb):
            s = fb / fa
            if a == c:
                p, q = 2.0 * middle * s, 1.0 - s
            else:
                q, r = fa / fc, fb / fc
                p = s * (2.0 * middle * q * (q - r) - (b - a) * (r - 1.0))
                q = (q - 1.0) * (r - 1.0) * (s - 1.0)
            p, q = abs(p), (-q if p > 0.0 else q)
            if 2.0 * p < min(3.0 * middle * q - abs(tolerance * q), abs(before_last * q)):
                before_last, last = last, p / q
            else:
                last = before_last = middle
        else:
            last = before_last = middle
        a, fa = b, fb
        b += last if abs(last) > tolerance else (tolerance if middle > 0.0 else -tolerance)
        fb = function(b)
    return b


class Event:
    """One event function with its options and what was found of it."""

    def __init__(self, function: Callable[..., Any], index: int, args: tuple[Any, ...]) -> None:
        if not callable(function):
            raise TypeError(f"events[{index}]: expected a callable, got {describe(function)}")
        self.function = function
        self.args = args
        self.index = index
        terminal = getattr(function, "terminal", None)
        if terminal is None or terminal == 0:
            self.limit = np.inf
        elif 0 < terminal < np.inf and int(terminal) == terminal:
            self.limit = int(terminal)
        else:
            raise InputError(
                f"events[{index}].terminal: expected a boolean or a positive integer, "
                f"got {describe(terminal)}"
            )
        self.direction = float(getattr(function, "direction", 0.0))
        self.times: list[float] = []
        self.states: list[np.ndarray[Any, Any]] = []
        self.value = 0.0
        self.first = True

    def __call__(self, t: float, y: Any) -> float:
        """Value of the event function."""
        value = self.function(t, y, *self.args)
        try:
            return float(value)
        except (TypeError, ValueError, OverflowError):
            pass
        array = np.asarray(value)
        if array.size != 1 or array.dtype.kind not in "fiub":
            raise InputError(f"events[{self.index}]: expected a real number, got {describe(value)}")
        return float(array.reshape(()))

    def along(self, at: Callable[[Any], Any], t: float) -> float:
        """Value at time t of the states that `at` gives."""
        return self(t, at(t))

    def crosses(self, before: float, after: float) -> bool:
        """Whether there is a zero in (start, end] that counts; at the very start it counts too."""
        up = before < 0.0 <= after
        down = before > 0.0 >= after
        if self.first and before == 0.0:
            up, down = after >= 0.0, after <= 0.0
        return (up and self.direction >= 0) or (down and self.direction <= 0)


class EventLog:
    """All events of one integration."""

    def __init__(self, events: Any, args: tuple[Any, ...], samples: int) -> None:
        functions = [events] if callable(events) else check_sequence("events", events, "callables")
        self.events = [Event(function, i, args) for i, function in enumerate(functions)]
        self.samples = samples

    def start(self, t: float, y: Any) -> None:
        """Values at the start."""
        for event in self.events:
            event.value = event(t, y)

    def step(
        self, t_old: float, t: float, y: Any, at: Callable[[Any], Any]
    ) -> tuple[float, Any] | None:
        """Find the zeros in a step; time and state of the terminal one, or None."""
        fractions = np.arange(1, self.samples) / self.samples
        inner = t_old + fractions * (t - t_old)
        states = at(inner) if self.samples > 1 else np.empty((len(y), 0))
        points = [*zip(inner.tolist(), states.T, strict=True), (t, y)]
        found: list[tuple[float, Event]] = []
        for event in self.events:
            start, before = t_old, event.value
            for end, state in points:
                after = event(end, state)
                if event.crosses(before, after):
                    root = find_root(partial(event.along, at), start, end, before, after)
                    found.append((root, event))
                event.first = False
                start, before = end, after
            event.value = before
        forward = t > t_old
        for root, event in sorted(found, key=lambda pair: pair[0] if forward else -pair[0]):
            state = y if root == t else at(root)
            event.times.append(root)
            event.states.append(np.array(state))
            if len(event.times) >= event.limit:
                return root, event.states[-1]
        return None

    def results(self) -> tuple[list[Any], list[Any]]:
        """t_events and y_events."""
        return (
            [np.asarray(event.times, dtype=float) for event in self.events],
            [np.asarray(event.states) for event in self.events],
        )
