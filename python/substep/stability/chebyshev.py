"""The stability function of RKC2, R(z) = a_s + b_s T_s(w_0 + w_1 z), in closed form.

The power series of T_s cancels to nothing for more than about 20 stages; cosh(s arcosh x) does not.
The constants are those that the integrator steps with.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .. import _core

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


class ChebyshevFactor:
    """R(z) of so many stages: the same three methods as `rational.RationalFactor`."""

    def __init__(self, stages: int) -> None:
        self.stages = stages
        constants = _core.rkc_formula(stages)
        self._w0, self._w1 = constants["w0"], constants["w1"]
        self._a, self._b = constants["a"], constants["b"]
        # |R| reaches 1 for good where |T_s| = (1 +- a) / b.
        level = (1.0 - self._a if stages % 2 == 0 else 1.0 + self._a) / self._b
        self._real_limit = (math.cosh(math.acosh(level) / stages) + self._w0) / self._w1

    def evaluate(self, z: Complex) -> Complex:
        """R(z) elementwise."""
        x = np.asarray(self._w0 + self._w1 * z, complex)
        return np.asarray(self._a + self._b * np.cosh(self.stages * np.arccosh(x)), complex)

    def polynomial(self) -> Real:
        """Ascending coefficients of R: b_s w_1^j T_s^(j)(w_0) / j!, sums of positive terms."""
        before, last = np.zeros(self.stages + 1), np.zeros(self.stages + 1)
        before[0], last[0], last[1] = 1.0, self._w0, 1.0  # Taylor coefficients of T_0, T_1 at w_0
        for _ in range(self.stages - 1):
            shifted = np.concatenate([[0.0], last[:-1]])
            before, last = last, 2.0 * (self._w0 * last + shifted) - before
        powers = np.cumprod([1.0, *[self._w1] * self.stages])
        coefficients = self._b * last * powers
        coefficients[0] += self._a
        return np.asarray(coefficients)

    def ray_limit(self, direction: complex) -> float:
        """Largest r with |R(s u)| <= 1 for all s in [0, r]; u = direction has modulus 1."""
        if direction.real > -1e-15:
            # |R(i y)|^2 = 1 + (1/4 - 2 c_3) y^4 + ..., c_3 < 1/8: it exceeds 1 at once.
            return 0.0
        if direction.imag == 0:
            return self._real_limit
        return self._first_crossing(direction)

    def _excess(self, z: Complex) -> Real:
        """|R(z)|^2 - 1, less what rounding may make of 0."""
        noise = 1e-14 + 1e-17 * self.stages**2
        return np.asarray(np.abs(self.evaluate(z)) ** 2 - 1.0 - noise)

    def _first_crossing(self, direction: complex) -> float:
        """By search: |R|^2 has at most s bumps along a ray, wider apart the farther from 0."""
        r = 2.0 * self._real_limit * np.linspace(0.0, 1.0, 200 * self.stages + 1)[1:] ** 2
        for _ in range(3):
            value = self._excess(r * direction)
            end = int(np.argmax(value > 0))
            peaks = np.array(
                [k for k in range(1, end) if value[k - 1] <= value[k] >= value[k + 1]], int
            )
            closer = [np.linspace(r[k - 1], r[k + 1], 64) for k in peaks[value[peaks] > -1e-2]]
            r = np.unique(np.concatenate([r[: end + 1], *closer]))
        first = int(np.argmax(self._excess(r * direction) > 0))
        low, high = float(r[first - 1]) if first else 0.0, float(r[first])
        while low < (middle := 0.5 * (low + high)) < high:
            above = self._excess(np.array([middle * direction]))[0] > 0
            low, high = (low, middle) if above else (middle, high)
        return low

    def roots(self, phi: float) -> Complex:
        """All z with R(z) = exp(i phi): T_s(cosh q) = cosh(s q)."""
        level = complex((np.exp(1j * phi) - self._a) / self._b)
        turns = 2j * np.pi * np.arange(self.stages) / self.stages
        x = np.cosh(np.arccosh(level) / self.stages + turns)
        return np.asarray((x - self._w0) / self._w1, complex)
