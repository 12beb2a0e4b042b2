"""Advection of 1e6 particles by RK4, h = 0.02: the ABC flow and a 64^3 grid of it.

Prints JSON lines {workload, peer, metric, value, unit, threads, isa}: particle-steps per second of
substep and of NumPy, scipy.ndimage.map_coordinates, numba and a hand-written C++ program
(where _peers.py finds it), and whether 1 to 4 threads give equal bits.
python bench/fields.py [--quick]
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import time
from typing import Any

import numpy as np
import substep
from _peers import peer_module, peer_program
from substep import _core

N, H, STEPS, PERIOD = 64, 0.02, 20, 2 * math.pi
A, B, C = math.sqrt(3.0), math.sqrt(2.0), 1.0


def emit(workload: str, peer: str, metric: str, value: float, unit: str, threads: int) -> None:
    record = {"workload": workload, "peer": peer, "metric": metric, "value": float(f"{value:.4g}")}
    print(json.dumps({**record, "unit": unit, "threads": threads, "isa": _core.level}), flush=True)


def speed(workload: str, peer: str, work: float, seconds: float, threads: int) -> None:
    emit(workload, peer, "particle_steps_per_s", work / seconds, "1/s", threads)


def best(run: Any, repeats: int) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return min(times)


def abc(p: Any) -> Any:
    x, y, z = p.T
    return np.stack(
        [
            A * np.sin(z) + C * np.cos(y),
            B * np.sin(x) + A * np.cos(z),
            C * np.sin(y) + B * np.cos(x),
        ],
        1,
    )


def rk4(velocity: Any, p: Any, h: float) -> Any:
    k1 = velocity(p)
    k2 = velocity(p + h / 2 * k1)
    k3 = velocity(p + h / 2 * k2)
    k4 = velocity(p + h * k3)
    return p + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def grids() -> dict[str, Any]:
    axis = np.arange(N) * PERIOD / N
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    values = abc(nodes).reshape(N, N, N, 3)
    periodic = [PERIOD] * 3
    levels = np.stack([values, values * 0.9])
    return {
        "grid64": substep.GridField([axis] * 3, values, periodic=periodic),
        "grid64_levels": substep.GridField([axis] * 3, levels, [0.0, 10.0], periodic=periodic),
        "grid64_cubic": substep.GridField(
            [axis] * 3, values, periodic=periodic, interpolation="cubic"
        ),
    }


def own(x: Any, repeats: int) -> None:
    fields = {"abc": substep.ABC(A, B, C), **grids()}
    for name, field in fields.items():
        for dtype in (np.float64, np.float32):
            workload = f"advect_{name}_rk4_{np.dtype(dtype).name}_{len(x):.0e}"
            for threads in (1, 2):
                drift = substep.Advection(field, x, step=H, threads=threads, dtype=dtype)
                drift.advance(H)
                seconds = best(lambda d=drift: d.advance(STEPS * H), repeats)
                speed(workload, "substep", len(x) * STEPS, seconds, threads)
            hashes = {
                substep.state_hash(
                    substep.advect(field, x, (0, 0.1), H, threads=t, dtype=dtype).final
                )
                for t in (1, 2, 3, 4)
            }
            emit(workload, "substep", "hashes_over_1_to_4_threads", len(hashes), "", 4)
    end = substep.advect(fields["abc"], x[:1000], (0, STEPS * H), H).final
    p = x[:1000]
    for _ in range(STEPS * 10):
        p = rk4(abc, p, H / 10)
    emit("advect_abc_rk4", "substep", "max_error_at_0.4", float(np.abs(end - p).max()), "m", 2)


def numpy_and_scipy(x: Any, repeats: int) -> None:
    workload = f"rk4_float64_{len(x):.0e}"
    seconds = best(lambda: rk4(abc, x, H), repeats)
    speed(f"advect_abc_{workload}", "numpy", len(x), seconds, 1)
    ndimage = peer_module("scipy.ndimage")
    if ndimage is None:
        return
    axis = np.arange(N + 1) * PERIOD / N
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    values = abc(nodes).reshape(N + 1, N + 1, N + 1, 3)

    def velocity(p: Any) -> Any:
        c = (p % PERIOD).T * (N / PERIOD)
        return np.stack(
            [ndimage.map_coordinates(values[..., d], c, order=1, mode="nearest") for d in range(3)],
            1,
        )

    seconds = best(lambda: rk4(velocity, x, H), 1)
    speed(f"advect_grid64_{workload}", "scipy_map_coordinates", len(x), seconds, 1)


def numba_loops(x: Any, repeats: int) -> None:
    nb = peer_module("numba")
    if nb is None:
        return

    @nb.njit(inline="always")
    def velocity(x: float, y: float, z: float) -> Any:
        return (
            A * np.sin(z) + C * np.cos(y),
            B * np.sin(x) + A * np.cos(z),
            C * np.sin(y) + B * np.cos(x),
        )

    @nb.njit(parallel=True, fastmath=True)
    def advance(p: Any, h: float, steps: int) -> None:
        for i in nb.prange(p.shape[0]):
            x, y, z = p[i, 0], p[i, 1], p[i, 2]
            for _ in range(steps):
                a1, b1, c1 = velocity(x, y, z)
                a2, b2, c2 = velocity(x + h / 2 * a1, y + h / 2 * b1, z + h / 2 * c1)
                a3, b3, c3 = velocity(x + h / 2 * a2, y + h / 2 * b2, z + h / 2 * c2)
                a4, b4, c4 = velocity(x + h * a3, y + h * b3, z + h * c3)
                x += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
                y += h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
                z += h / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
            p[i, 0], p[i, 1], p[i, 2] = x, y, z

    advance(x[:10].copy(), H, 1)
    for threads in (1, 2):
        nb.set_num_threads(min(threads, nb.config.NUMBA_NUM_THREADS))
        p = x.copy()
        seconds = best(lambda p=p: advance(p, H, 5), repeats)
        speed(f"advect_abc_rk4_float64_{len(x):.0e}", "numba", len(x) * 5, seconds, threads)


def hand_written() -> None:
    program = peer_program("native")
    if program is None:
        return
    for kind, name in (("abc", "abc"), ("grid", "grid64")):
        done = subprocess.run([str(program), kind], capture_output=True, text=True, check=True)
        for line in done.stdout.splitlines():
            record = json.loads(line)
            match = re.fullmatch(r"cpp_f(64|32)_([12])t(_sorted)?", record["peer"])
            if match and record["metric"] == "particle_steps_per_s":
                workload = f"advect_{name}_rk4_float{match[1]}_1e+06"
                peer = "cpp_fast_math" + (match[3] or "")
                emit(workload, peer, record["metric"], record["value"], "1/s", int(match[2]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="end within a minute")
    quick = parser.parse_args().quick
    x = np.random.default_rng(1).uniform(0, PERIOD, (1_000_000, 3))
    own(x, 2 if quick else 7)
    numpy_and_scipy(x[:200_000] if quick else x, 1 if quick else 3)
    numba_loops(x, 1 if quick else 3)
    hand_written()


if __name__ == "__main__":
    main()
