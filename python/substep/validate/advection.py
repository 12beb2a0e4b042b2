"""Measured for `substep validate`: particles that are carried along by known flows."""

from __future__ import annotations

import numpy as np

from ..fields import RigidRotation, TaylorGreen, advect


def turned(method: str) -> float:
    """Distance of a particle from its start after one turn of a rigid rotation."""
    path = advect(RigidRotation(2 * np.pi), [[1.0, 0.0]], (0, 1), step=1 / 200, method=method)
    return float(np.linalg.norm(path.final[0] - [1.0, 0.0]))


def stream_function(method: str = "rk4", step: float = 0.02) -> float:
    """Largest change of the stream function along paths in a steady vortex."""
    start = np.random.default_rng(1).uniform(0.2, 2.9, (50, 2))
    path = advect(TaylorGreen(), start, (0, 20), step=step, method=method)

    def psi(x: np.ndarray) -> np.ndarray:
        return np.asarray(np.sin(x[..., 0]) * np.sin(x[..., 1]))

    return float(np.abs(psi(path.final) - psi(start)).max())
