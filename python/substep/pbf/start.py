"""Starts that cannot be meant: liquid that overlaps, lies apart, or is where an obstacle is."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import StartWarning
from ..geometry import Collider

_DENSE = 1.5  # times the density at rest: points of a lattice that are 0.87 spacings apart
_SHARE = 0.01  # of the particles; some that fall together are no mistake
_FEW = 8  # particles that may be drops without neighbours


def warn_of_start(
    x: NDArray[np.float64],
    densities: NDArray[np.float64],
    lone: float,
    spacing: float,
    colliders: Sequence[Collider],
) -> None:
    """Warns of densities without walls, `lone` that of a particle alone, and of obstacles."""

    def warn(message: str) -> None:
        warnings.warn(f"positions: {message}", StartWarning, stacklevel=5)

    n = len(x)
    if n == 0:
        return
    if n > _FEW and np.median(densities) < 1.001 * lone:
        warn(
            f"most particles have no other within their support, that of spacing = {spacing} m; "
            "is the spacing that of the positions?"
        )
    dense = np.flatnonzero(densities > _DENSE)
    if len(dense) > max(1, _SHARE * n):
        warn(
            f"{len(dense)} of {n} particles are too close for spacing = {spacing} m, "
            f"positions[{dense[0]}] at {densities[dense[0]]:.3g} times the density at rest, and "
            "will burst apart; do they overlap, or have they another spacing? relax() moves them "
            "apart"
        )
    at = np.pad(x, ((0, 0), (0, 3 - x.shape[1])))  # a plane is cut at z = 0
    for k, collider in enumerate(colliders):
        deep = -np.asarray(collider.distance(at))
        inside = np.flatnonzero(deep > spacing)
        if len(inside):
            where = "outside of" if collider.hollow else "inside"
            warn(
                f"{len(inside)} of {n} particles are {where} colliders[{k}] by more than a "
                f"spacing, positions[{inside[0]}] by {deep[inside[0]]:.3g} m; the first step puts "
                "them on its surface"
            )
