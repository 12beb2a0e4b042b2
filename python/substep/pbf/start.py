"""Starts that cannot be meant: liquid that overlaps, lies apart, or is where an obstacle is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..base.start_warning import warn_at_user
from ..geometry import Collider

# Of the density at rest, and the share of particles above it that is no chance: some that fall
# together are no mistake, nor are points that are shaken. A lattice on a wall has the first in its
# first layer, one of 0.95 spacings the second.
_TOO_DENSE = ((1.5, 0.01), (1.1, 0.25))
_HOLLOW = "; is it meant as a tank? Collider(shape, hollow=True)"
_FEW = 8  # particles that may be drops without neighbours


def warn_of_start(
    x: NDArray[np.float64],
    densities: NDArray[np.float64],
    lone: float,
    spacing: float,
    colliders: Sequence[Collider],
) -> None:
    """Warns of densities, `lone` being that of a particle alone, and of depths in obstacles."""
    n = len(x)
    if n == 0:
        return
    if n > _FEW and np.median(densities) < 1.001 * lone:
        warn_at_user(
            "positions: most particles have no other within their support, that of spacing = "
            f"{spacing} m; is the spacing that of the positions?"
        )
    at = np.pad(x, ((0, 0), (0, 3 - x.shape[1])))  # a plane is cut at z = 0
    free = np.ones(n, bool)
    for k, collider in enumerate(colliders):
        distance = np.asarray(collider.distance(at))
        free &= distance >= 0
        inside = np.flatnonzero(distance < -spacing)
        if len(inside):
            where, hint = "outside of", "; is the tank too small?"
            if not collider.hollow:
                all_inside = bool((distance < 0).all())
                where, hint = "inside", _HOLLOW if all_inside else ""
            warn_at_user(
                f"positions: {len(inside)} of {n} particles are {where} colliders[{k}] by more "
                f"than a spacing, positions[{inside[0]}] by {-distance[inside[0]]:.3g} m, and will "
                f"be put on its surface{hint}"
            )
    for most, share in _TOO_DENSE:
        dense = np.flatnonzero(free & (densities > most))
        if len(dense) > max(1, share * n):
            warn_at_user(
                f"positions: {len(dense)} of {n} particles are too close to others or to a wall, "
                f"positions[{dense[0]}] at {densities[dense[0]]:.3g} times the density at rest, "
                f"and will burst apart; do they overlap, is spacing = {spacing} m theirs, and "
                "are they half of it from walls? relax() moves them apart"
            )
            return
