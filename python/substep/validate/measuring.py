"""What several methods are measured by: lattices, periods, the front of a dam break."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Martin and Moyce 1952, Phil. Trans. R. Soc. A 244, Fig. 3: column of a = 2.25 in, 2 a high.
# (t sqrt(2 g / a), front / a)
MARTIN_MOYCE = np.array(
    [[0.832, 1.217], [1.219, 1.474], [1.997, 2.292], [2.547, 2.995], [3.345, 4.134]]
)


def front_error(times: Sequence[float], front: Sequence[float], measured: Array) -> float:
    """Largest relative error, after one shift of time by at most 0.3 for the gate they pulled."""
    return min(
        float(np.abs(np.interp(measured[:, 0] - shift, times, front) / measured[:, 1] - 1).max())
        for shift in np.linspace(0, 0.3, 61)
    )


def period(times: Sequence[float], values: Sequence[float]) -> float:
    """Mean period of what swings about 0, from its first to its last zero.

    Zeros that follow another within a fifth of the longest time between two are its noise.
    """
    t, x = np.array(times), np.array(values)
    k = np.flatnonzero((x[:-1] > 0) != (x[1:] > 0))
    zeros = t[k] - x[k] * (t[k + 1] - t[k]) / (x[k + 1] - x[k])
    zeros = zeros[np.insert(np.diff(zeros) > 0.2 * np.diff(zeros).max(), 0, True)]
    return float(2 * (zeros[-1] - zeros[0]) / (len(zeros) - 1))


def lattice(low: Any, high: Any, spacing: float) -> Array:
    """Points in the middles of the squares or cubes of this side that fill a box."""
    axes = [
        a + spacing * (np.arange(round((b - a) / spacing)) + 0.5)
        for a, b in zip(low, high, strict=True)
    ]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
