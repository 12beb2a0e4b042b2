"""What `solver='multilevel'` of position-based dynamics stands on: distances that are rigid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .group import Array, Constraint


def rigid_distances(
    constraints: Sequence[Constraint], positions: Array
) -> tuple[NDArray[np.int32], Array]:
    """Pairs of particles that keep their distance without compliance, and that distance [m]."""
    pairs, lengths = [np.zeros((0, 2), np.int32)], [np.zeros(0)]
    for constraint in constraints:
        if getattr(constraint, "_kind", None) != "distance":
            continue
        soft = constraint.compliance if constraint.stiffness is None else 1 - constraint.stiffness
        rest = constraint._parameters(positions)[:, 0]
        rigid = np.broadcast_to(soft == 0, len(constraint)) & (rest > 0)
        pairs.append(constraint.particles[rigid])
        lengths.append(rest[rigid])
    return np.concatenate(pairs), np.concatenate(lengths)


def use_multilevel(
    native: Any, constraints: Sequence[Constraint], positions: Array, rest_positions: Array
) -> None:
    """Let a native simulation project on several levels."""
    pairs, lengths = rigid_distances(constraints, positions)
    if len(pairs) == 0:
        raise InputError(
            "solver: 'multilevel' needs Distance constraints without compliance; without any, "
            "use 'gauss_seidel'"
        )
    native.use_multilevel(
        np.ascontiguousarray(pairs), np.ascontiguousarray(lengths), rest_positions
    )
