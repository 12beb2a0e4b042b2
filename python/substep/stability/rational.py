"""Where a rational function R = P / Q has modulus at most 1: along rays, and the outline.

Coefficients are real and ascending, with P(0) = Q(0) = 1; a polynomial has Q = [1].
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_CANCELLED = 1e-13  # a sum this small beside its terms is a zero that rounding blurred


class RationalFactor:
    """R = P / Q of a method with a tableau."""

    def __init__(self, numerator: Real, denominator: Real) -> None:
        self.numerator = numerator
        self.denominator = denominator

    def evaluate(self, z: Complex) -> Complex:
        """R(z) elementwise; infinite at a pole."""
        return evaluate(self.numerator, self.denominator, z)

    def ray_limit(self, direction: complex) -> float:
        """Largest r with |R(s u)| <= 1 for all s in [0, r]; u = direction has modulus 1."""
        return ray_limit(self.numerator, self.denominator, direction)

    def roots(self, phi: float) -> Complex:
        """All z with R(z) = exp(i phi)."""
        size = max(len(self.numerator), len(self.denominator))
        top = np.pad(self.numerator, (0, size - len(self.numerator)))[::-1]
        bottom = np.pad(self.denominator, (0, size - len(self.denominator)))[::-1]
        return np.asarray(np.roots(top - np.exp(1j * phi) * bottom), complex)


def evaluate(numerator: Real, denominator: Real, z: Complex) -> Complex:
    """R(z) elementwise; infinite at a pole."""
    top = np.polynomial.polynomial.polyval(z, numerator.astype(complex))
    bottom = np.polynomial.polynomial.polyval(z, denominator.astype(complex))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(bottom == 0, complex(np.inf), np.divide(top, bottom))


def _excess(numerator: Real, denominator: Real, direction: complex) -> Real:
    """Ascending coefficients in r of |P(r u)|^2 - |Q(r u)|^2 for the unit direction u.

    Up to the order of the method the coefficient of r^m is (2 Re u)^m / m!: on the imaginary axis
    terms of order 1 cancel to zero, which rounding must not turn into a spurious root near 0.
    """
    total = np.zeros(2 * max(len(numerator), len(denominator)) - 1)
    scale = total.copy()
    for coefficients, sign in ((numerator, 1.0), (denominator, -1.0)):
        along = coefficients * np.cumprod([1.0, *[direction] * (len(coefficients) - 1)])
        total[: 2 * len(along) - 1] += sign * np.convolve(along, along.conj()).real
        scale[: 2 * len(along) - 1] += np.convolve(np.abs(along), np.abs(along))
    return np.where(np.abs(total) <= _CANCELLED * scale, 0.0, total)


def ray_limit(numerator: Real, denominator: Real, direction: complex) -> float:
    """Largest r with |R(s u)| <= 1 for all s in [0, r]; u = direction has modulus 1."""
    excess = _excess(numerator, denominator, direction)
    nonzero = np.flatnonzero(excess)
    if nonzero.size == 0:
        return np.inf
    return first_rise(excess[nonzero[0] : nonzero[-1] + 1])


def first_rise(coefficients: Real) -> float:
    """Smallest r > 0 beyond which the polynomial (first and last coefficient not 0) is positive."""
    if coefficients[0] > 0:
        return 0.0
    polynomial = np.polynomial.Polynomial(coefficients)
    roots = np.asarray(polynomial.roots(), complex)
    candidates = np.sort(roots.real[(roots.real > 0) & (abs(roots.imag) < 1e-6 * abs(roots))])
    between = (candidates + np.append(candidates[1:], 2 * candidates[-1:])) / 2
    rising = np.flatnonzero(polynomial(between) > 0)
    if rising.size == 0:
        return np.inf
    return _newton(polynomial, float(candidates[rising[0]]))


def _newton(polynomial: np.polynomial.Polynomial, r: float) -> float:
    """The root nearest to r, to the last bits."""
    slope = polynomial.deriv()
    for _ in range(3):
        at = float(slope(r))
        if at == 0:
            break
        r -= float(polynomial(r)) / at
    return r


def outline(roots: Callable[[float], Complex], points: int = 256) -> list[Complex]:
    """The closed curves |R(z)| = 1, by root locus: R(z) = exp(i phi) for phi from 0 to 2 pi.

    The roots at phi are followed; after 2 pi they return permuted, and each cycle of the
    permutation is one closed curve (Hairer & Wanner II, section IV.2).
    """
    tracks = [roots(0.0)]
    angles = np.linspace(0, 2 * np.pi, points + 1)
    for start, end in itertools.pairwise(angles):
        _follow(tracks, roots, float(start), float(end), 24)
    paths = np.array(tracks)  # (angle, root)
    end_of = np.argmin(abs(paths[-1][:, None] - paths[0][None, :]), axis=1)
    curves, left = [], set(range(paths.shape[1]))
    while left:
        first = track = min(left)
        pieces = []
        while track in left:
            left.remove(track)
            pieces.append(paths[:-1, track])
            track = int(end_of[track])
        curves.append(np.concatenate([*pieces, paths[:1, first]]))
    return curves


def _follow(
    tracks: list[Complex], roots: Callable[[float], Complex], start: float, end: float, depth: int
) -> None:
    """Append the roots at `end`, each beside its predecessor; halve the step if that is unclear."""
    old, new = tracks[-1], roots(end)
    distance = abs(old[:, None] - new[None, :])
    nearest = np.argmin(distance, axis=1)
    apart = np.min(abs(new[:, None] - new[None, :]) + np.diag(np.full(len(new), np.inf)))
    clear = len(set(nearest)) == len(new) and np.max(np.min(distance, axis=1)) < 0.3 * apart
    if clear or depth == 0:
        tracks.append(new[nearest])
        return
    middle = (start + end) / 2
    _follow(tracks, roots, start, middle, depth - 1)
    _follow(tracks, roots, middle, end, depth - 1)
