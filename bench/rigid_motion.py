"""Free rotation of rigid bodies: the time of a step, and the largest error of the energy in 100 s.

Prints JSON lines {workload, peer, metric, value, unit, threads, isa} of the methods of
substep.rigid.free_rotation at h = 1/240 s, and of SciPy's DOP853 at rtol 1e-9.
python bench/rigid_motion.py [--quick]
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
from _peers import peer_module
from substep import _core
from substep.rigid import free_rotation

METHODS = ("exact", "splitting", "matrix", "quaternion")
H, STEPS = 1 / 240, 24000
# A box of half extents 0.5, 0.25, 0.1 and mass 1 that spins about its middle axis.
INERTIA = np.array([0.29, 1.04, 1.25]) / 12
MOMENTUM = INERTIA * [0.01, 5.0, 0.0]


def emit(peer: str, metric: str, value: float, unit: str, threads: int = 1) -> None:
    record = {"workload": "free_rotation", "peer": peer, "metric": metric}
    measured = {"value": float(f"{value:.4g}"), "unit": unit, "threads": threads}
    print(json.dumps({**record, **measured, "isa": _core.level}), flush=True)


def body_momentum(q: Any) -> Any:
    """R^T L."""
    w, v = q[0], -q[1:]
    t = 2 * np.cross(v, MOMENTUM)
    return MOMENTUM + w * t + np.cross(v, t)


def energy_error(q: Any) -> float:
    return abs((body_momentum(q) ** 2 / INERTIA).sum() / (MOMENTUM**2 / INERTIA).sum() - 1)


def speed(n: int, repeats: int) -> None:
    rng = np.random.default_rng(1)
    q, L = rng.normal(size=(n, 4)), rng.normal(size=(n, 3))
    inertia = rng.uniform(0.6, 1.0, (n, 3))
    for method in METHODS:
        for threads in (1, 2):
            times = []
            for _ in range(repeats):
                start = time.perf_counter()
                free_rotation(q, L, inertia, 50 * H, method=method, steps=50, threads=threads)
                times.append(time.perf_counter() - start)
            emit(
                f"substep {method}",
                "time_per_body_step",
                min(times) / (50 * n) * 1e9,
                "ns",
                threads,
            )


def accuracy() -> None:
    for method in METHODS:
        q, worst = np.array([[1.0, 0, 0, 0]]), 0.0
        for _ in range(STEPS // 40):
            q = free_rotation(q, [MOMENTUM], [INERTIA], 40 * H, method=method, steps=40)
            worst = max(worst, energy_error(q[0]))
        emit(f"substep {method}", "energy_error_100s", worst, "1")


def scipy_peer() -> None:
    scipy = peer_module("scipy.integrate")
    if scipy is None:
        return

    def motion(t: float, q: Any) -> Any:
        m = body_momentum(q)
        wx, wy, wz = m / INERTIA  # in the body
        w, x, y, z = 0.5 * q
        return np.array(
            [
                -x * wx - y * wy - z * wz,
                w * wx + y * wz - z * wy,
                w * wy + z * wx - x * wz,
                w * wz + x * wy - y * wx,
            ]
        )

    start = time.perf_counter()
    tolerances = {"rtol": 1e-9, "atol": 1e-9}
    solved = scipy.solve_ivp(motion, (0, H * STEPS), [1.0, 0, 0, 0], "DOP853", **tolerances)
    seconds = time.perf_counter() - start
    worst = max(energy_error(q / np.linalg.norm(q)) for q in solved.y.T)
    emit("scipy DOP853", "energy_error_100s", worst, "1")
    emit("scipy DOP853", "time_100s", seconds * 1e3, "ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    speed(2048, 5 if quick else 40)
    accuracy()
    scipy_peer()


if __name__ == "__main__":
    main()
