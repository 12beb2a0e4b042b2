"""A million oscillators and a chain of a million masses: milliseconds per step beside peers."""

from __future__ import annotations

import argparse
import json
import subprocess
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import substep
from _peers import peer_module, peer_program

N = 1_000_000
OSCILLATOR_STEP, CHAIN_STEP, MODE = 0.01, 0.2, 1000
OMEGA = 0.5 + np.arange(N) / N
WAVE = np.sin(np.pi * MODE * np.arange(1, N + 1) / (N + 1))
WAVE_OMEGA = 2 * np.sin(np.pi * MODE / (2 * (N + 1)))


def emit(workload: str, peer: str, metric: str, value: Any, unit: str, threads: int) -> None:
    record = dict(workload=workload, peer=peer, metric=metric, value=value, unit=unit)
    isa = substep._core.level if peer == "substep" else "native"
    print(json.dumps({**record, "threads": threads, "isa": isa}), flush=True)


def best_ms(work: Callable[[], Any], repeats: int) -> float:
    """Milliseconds of the quickest of some runs, after one to warm up."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


class Workload:
    """One system with one method, from the same start as the peers'."""

    def __init__(self, name: str, kind: str, method: str) -> None:
        self.name, self.kind, self.method = name, kind, method
        oscillators = kind == "oscillators"
        self.system = (
            substep.systems.Oscillators(OMEGA) if oscillators else substep.systems.SpringChain(N)
        )
        self.step = OSCILLATOR_STEP if oscillators else CHAIN_STEP
        self.x0 = np.ones(N) if oscillators else WAVE
        self.v0 = np.zeros(N)

    def solve(self, steps: int, threads: int) -> tuple[np.ndarray, np.ndarray]:
        end = steps * self.step
        options: dict[str, Any] = dict(step=self.step, t_eval=[end], threads=threads)
        if self.method == "rk4":
            y0 = np.concatenate([self.x0, self.v0])
            y = substep.solve_ivp(self.system, (0, end), y0, "rk4", **options).y[:, 0]
            return y[:N], y[N:]
        r = substep.solve_second_order(
            self.system, (0, end), self.x0, self.v0, self.method, **options
        )
        return r.x[:, 0], r.v[:, 0]

    def exact(self, t: float) -> np.ndarray:
        if self.kind == "oscillators":
            return np.cos(OMEGA * t)
        return np.cos(WAVE_OMEGA * t) * WAVE


WORKLOADS = [
    Workload("oscillators_1e6_rk4", "oscillators", "rk4"),
    Workload("oscillators_1e6_verlet", "oscillators", "velocity_verlet"),
    Workload("chain_1e6_rk4", "chain", "rk4"),
    Workload("chain_1e6_verlet", "chain", "velocity_verlet"),
]


def bench_substep(workload: Workload, steps: int, repeats: int) -> None:
    for threads in (1, 2):
        # A whole solve, with what it costs to begin and to hand over the result.
        whole = best_ms(lambda k=threads: workload.solve(steps, k), repeats)
        emit(workload.name, "substep", "ms_per_step", whole / steps, "ms", threads)
    x, _ = workload.solve(40, 2)
    error = float(abs(x - workload.exact(40 * workload.step)).max())
    emit(workload.name, "substep", "max_error_after_40_steps", error, "1", 2)
    for threads in (1, 2, 3, 4):
        state = substep.state_hash(*workload.solve(40, threads))
        emit(workload.name, "substep", "state_hash", state, "", threads)


def oscillator_rhs(y: np.ndarray) -> np.ndarray:
    d = np.empty_like(y)
    d[:N] = y[N:]
    d[N:] = -(OMEGA**2) * y[:N]
    return d


def chain_rhs(y: np.ndarray) -> np.ndarray:
    d = np.empty_like(y)
    d[:N] = y[N:]
    x, a = y[:N], d[N:]
    a[:] = -2 * x
    a[1:] += x[:-1]
    a[:-1] += x[1:]
    return d


def bench_numpy_and_scipy(workload: Workload, repeats: int) -> None:
    rhs = oscillator_rhs if workload.kind == "oscillators" else chain_rhs
    h = workload.step
    if workload.method == "rk4":
        y = [np.concatenate([workload.x0, workload.v0])]

        def rk4() -> None:
            k1 = rhs(y[0])
            k2 = rhs(y[0] + h / 2 * k1)
            k3 = rhs(y[0] + h / 2 * k2)
            k4 = rhs(y[0] + h * k3)
            y[0] = y[0] + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

        emit(workload.name, "numpy_textbook", "ms_per_step", best_ms(rk4, repeats), "ms", 1)
        scipy = peer_module("scipy.integrate")
        for solver in (scipy.RK45, scipy.DOP853) if scipy else ():
            s = solver(
                lambda t, y: rhs(y), 0, y[0], 1e9, max_step=h, first_step=h, rtol=1e-3, atol=1e-3
            )
            name = f"scipy_{solver.__name__}_step"
            emit(workload.name, name, "ms_per_step", best_ms(s.step, repeats), "ms", 1)
        return
    x, v = workload.x0.copy(), workload.v0.copy()
    state = [x, v, rhs(np.concatenate([x, v]))[N:]]

    def verlet() -> None:
        x, v, a = state
        v = v + h / 2 * a
        x = x + h * v
        if workload.kind == "oscillators":
            a = -(OMEGA**2) * x
        else:
            a = -2 * x
            a[1:] += x[:-1]
            a[:-1] += x[1:]
        state[:] = [x, v + h / 2 * a, a]

    emit(workload.name, "numpy_textbook", "ms_per_step", best_ms(verlet, repeats), "ms", 1)


def bench_numba(workload: Workload, repeats: int) -> None:
    """Loops as one writes them with numba: everything of a step fused, where that can be."""
    numba = peer_module("numba")
    if numba is None:
        return

    @numba.njit(parallel=True, fastmath=True)
    def oscillators_rk4(x: Any, v: Any, w2: Any, h: float) -> None:
        for i in numba.prange(x.size):
            X, V, w = x[i], v[i], -w2[i]
            a1, b1 = V, w * X
            a2, b2 = V + h / 2 * b1, w * (X + h / 2 * a1)
            a3, b3 = V + h / 2 * b2, w * (X + h / 2 * a2)
            a4, b4 = V + h * b3, w * (X + h * a3)
            x[i] = X + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            v[i] = V + h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)

    @numba.njit(parallel=True, fastmath=True)
    def oscillators_verlet(x: Any, v: Any, w2: Any, h: float) -> None:
        for i in numba.prange(x.size):
            V = v[i] - h / 2 * w2[i] * x[i]
            x[i] += h * V
            v[i] = V - h / 2 * w2[i] * x[i]

    @numba.njit(parallel=True, fastmath=True)
    def chain_verlet(x: Any, v: Any, a: Any, h: float) -> None:
        m = x.size
        for i in numba.prange(m):
            v[i] += h / 2 * a[i]
            x[i] += h * v[i]
        for i in numba.prange(m):
            left = x[i - 1] if i > 0 else 0.0
            right = x[i + 1] if i < m - 1 else 0.0
            a[i] = left - 2 * x[i] + right
            v[i] += h / 2 * a[i]

    kernels = {
        "oscillators_1e6_rk4": (oscillators_rk4, OMEGA**2),
        "oscillators_1e6_verlet": (oscillators_verlet, OMEGA**2),
        "chain_1e6_verlet": (chain_verlet, chain_rhs(np.concatenate([WAVE, 0 * WAVE]))[N:]),
    }
    if workload.name not in kernels:
        return
    kernel, third = kernels[workload.name]
    for threads in (1, 2):
        if threads > numba.config.NUMBA_NUM_THREADS:
            break
        numba.set_num_threads(threads)
        x, v = workload.x0.copy(), workload.v0.copy()
        a = third.copy()
        ms = best_ms(lambda x=x, v=v, a=a: kernel(x, v, a, workload.step), repeats)
        emit(workload.name, "numba_fused", "ms_per_step", ms, "ms", threads)


def bench_peer_binary() -> None:
    """The hand-written C++ limits, where they are built."""
    program = peer_program("native")
    if program is None:
        return
    done = subprocess.run([program, "large"], capture_output=True, text=True, check=True)
    names = {"b_osc1e6": "oscillators_1e6", "b_chain1e6": "chain_1e6"}
    for line in done.stdout.splitlines():
        record = json.loads(line)
        if record["metric"] != "ms_per_step":
            continue
        kind, method = record["workload"].rsplit("_", 1)
        peer, threads = record["peer"].rsplit("_", 1)
        name = f"{names[kind]}_{method}"
        emit(name, peer, "ms_per_step", record["value"], "ms", int(threads.rstrip("t")))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer steps and repeats")
    quick = parser.parse_args().quick
    for workload in WORKLOADS:
        bench_substep(workload, 480 if quick else 1920, 3 if quick else 7)
        bench_numpy_and_scipy(workload, 3 if quick else 9)
        bench_numba(workload, 10 if quick else 40)
    bench_peer_binary()


if __name__ == "__main__":
    main()
