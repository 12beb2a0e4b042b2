"""Integrators beside their peers: fixed RK4 on Lorenz, calls of Python, adaptive orbits.

Prints one JSON line per figure; --quick ends within a minute. The C++ peer is odeint, where
_peers.py finds it.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import substep
from _peers import c_function, peer_module, peer_program
from substep import _core, systems

REFERENCE = Path(__file__).resolve().parents[2] / "shared/reference/ode.json"
H = 1e-5
numba, numbalsoda = peer_module("numba"), peer_module("numbalsoda")
scipy = peer_module("scipy.integrate")


def emit(workload: str, peer: str, metric: str, value: float, unit: str) -> None:
    record = {
        "workload": workload,
        "peer": peer,
        "metric": metric,
        "value": float(f"{value:.5g}"),
        "unit": unit,
        "threads": 1,
        "isa": _core.level,
    }
    print(json.dumps(record), flush=True)


def best(call: Callable[[], Any], seconds: float) -> tuple[float, Any]:
    """Shortest time of a call, repeated for so many seconds (twice at least)."""
    result, shortest, start, runs = call(), np.inf, time.perf_counter(), 0
    while runs < 2 or time.perf_counter() - start < seconds:
        before = time.perf_counter()
        result = call()
        shortest = min(shortest, time.perf_counter() - before)
        runs += 1
    return shortest, result


# Lorenz, RK4 with h = 1e-5.


def lorenz(t, y):
    return np.array([10 * (y[1] - y[0]), y[0] * (28 - y[2]) - y[1], y[0] * y[1] - 8 / 3 * y[2]])


def lorenz_list(t, y):
    a, b, c = y.tolist()
    return [10 * (b - a), a * (28 - c) - b, a * b - 8 / 3 * c]


@c_function
def lorenz_compiled(t, y, d, p):
    d[0] = 10 * (y[1] - y[0])
    d[1] = y[0] * (28 - y[2]) - y[1]
    d[2] = y[0] * y[1] - 8 / 3 * y[2]


def lorenz_numba(x, y, z):
    return 10 * (y - x), x * (28 - z) - y, x * y - 8 / 3 * z


if numba:
    lorenz_numba = numba.njit(lorenz_numba)


def rk4_numba(steps):
    x, y, z = 1.0, 1.0, 1.0
    for _ in range(steps):
        a1, b1, c1 = lorenz_numba(x, y, z)
        a2, b2, c2 = lorenz_numba(x + H / 2 * a1, y + H / 2 * b1, z + H / 2 * c1)
        a3, b3, c3 = lorenz_numba(x + H / 2 * a2, y + H / 2 * b2, z + H / 2 * c2)
        a4, b4, c4 = lorenz_numba(x + H * a3, y + H * b3, z + H * c3)
        x += H / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
        y += H / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
        z += H / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
    return x, y, z


if numba:
    rk4_numba = numba.njit(rk4_numba)


def rk4_python(f, y, steps):
    for i in range(steps):
        t = i * H
        k1 = f(t, y)
        k2 = f(t + H / 2, y + H / 2 * k1)
        k3 = f(t + H / 2, y + H / 2 * k2)
        k4 = f(t + H, y + H * k3)
        y = y + H / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return y


def bench_lorenz(quick: bool) -> None:
    seconds = 0.3 if quick else 3.0
    y0 = np.ones(3)

    def ours(fun, steps):
        end = steps * H
        return substep.solve_ivp(fun, (0, end), y0, "rk4", t_eval=[end], step=H).y[:, 0]

    few, many = 20_000, 1_000_000
    runs = {
        "substep system": (many, lambda: ours(systems.Lorenz(), many)),
        "substep C pointer": (many, lambda: ours(lorenz_compiled, many)),
        "substep Python list": (few, lambda: ours(lorenz_list, few)),
        "substep Python array": (few, lambda: ours(lorenz, few)),
        "numba loop": (many, lambda: rk4_numba(many)),
        "Python loop, arrays": (few, lambda: rk4_python(lorenz, y0, few)),
    }
    if numba is None:
        del runs["substep C pointer"], runs["numba loop"]
    reference = None
    if REFERENCE.exists():
        reference = np.array(json.loads(REFERENCE.read_text())["lorenz63"]["y_end"], dtype=float)
    for peer, (steps, call) in runs.items():
        shortest, y = best(call, seconds)
        emit("lorenz_rk4", peer, "steps_per_s", steps / shortest, "1/s")
        if steps == many and reference is not None:
            emit("lorenz_rk4", peer, "max_error", np.abs(np.array(y) - reference).max(), "1")
    program = peer_program("odeint_bench")
    if program:
        for line in first_lines(program, 4):
            record = json.loads(line)
            if record["metric"] == "steps_per_s":
                emit("lorenz_rk4", record["peer"], "steps_per_s", record["value"], "1/s")


def first_lines(program: Path, count: int) -> list[str]:
    """The first lines of a program that goes on for minutes."""
    with subprocess.Popen([program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(count)]
        process.terminate()
    return [line for line in lines if line.startswith("{")]


# What a call of a Python function costs beyond the function's own time.


def bench_calls(quick: bool) -> None:
    seconds = 0.3 if quick else 3.0
    value, point = np.ones(3), np.ones(3)
    functions = {
        "array": lambda t, y: value,
        "new array": lambda t, y: y * 2.0,
        "list": lambda t, y: [1.0, 2.0, 3.0],
    }
    calls = 40_000
    repeat = range(calls)

    def loop(fun):
        for _ in repeat:
            fun(0.5, point)

    def empty():
        for _ in repeat:
            pass

    nothing, _ = best(empty, 0.1)
    for kind, fun in functions.items():
        own = (best(lambda fun=fun: loop(fun), seconds)[0] - nothing) / calls
        solvers = [("substep", substep, {"method": "rk4", "step": 1e-4, "t_eval": [1.0]})]
        if scipy:
            solvers.append(("scipy", scipy, {"method": "RK45", "max_step": 2e-3}))
        for peer, module, settings in solvers:
            shortest, result = best(
                lambda module=module, fun=fun, settings=settings: module.solve_ivp(
                    fun, (0.0, 1.0), np.ones(3), **settings
                ),
                seconds,
            )
            cost = shortest / result.nfev - own
            emit(f"python_call_{kind}", peer, "own_cost_per_call", 1e6 * cost, "us")


# Adaptive orbits.


@c_function
def arenstorf_compiled(t, u, du, p):
    mu = 0.012277471
    rest = 1 - mu
    a, b = u[0] + mu, u[0] - rest
    r, q = a * a + u[1] * u[1], b * b + u[1] * u[1]
    d1, d2 = r * np.sqrt(r), q * np.sqrt(q)
    du[0] = u[2]
    du[1] = u[3]
    du[2] = u[0] + 2 * u[3] - rest * a / d1 - mu * b / d2
    du[3] = u[1] - 2 * u[2] - rest * u[1] / d1 - mu * u[1] / d2


@c_function
def pleiades_compiled(t, u, du, p):
    for i in range(14):
        du[i] = u[14 + i]
    for i in range(7):
        ax, ay = 0.0, 0.0
        for j in range(7):
            if j != i:
                x, y = u[j] - u[i], u[7 + j] - u[7 + i]
                r2 = x * x + y * y
                r3 = 1 / (r2 * np.sqrt(r2))
                ax += (j + 1) * x * r3
                ay += (j + 1) * y * r3
        du[14 + i] = ax
        du[21 + i] = ay


@c_function
def kepler_compiled(t, u, du, p):
    r2 = u[0] * u[0] + u[1] * u[1]
    q = 1 / (r2 * np.sqrt(r2))
    du[0] = u[2]
    du[1] = u[3]
    du[2] = -u[0] * q
    du[3] = -u[1] * q


def bench_orbits(quick: bool) -> None:
    seconds = 0.2 if quick else 2.0
    arenstorf, pleiades = systems.Arenstorf(), systems.Pleiades()
    kepler = systems.Kepler(eccentricity=0.9)
    pleiades_end = None
    if REFERENCE.exists():
        values = json.loads(REFERENCE.read_text())["pleiades"]["y_end"]
        pleiades_end = np.array(values, dtype=float)[:14]
    problems = {
        "arenstorf": (arenstorf, arenstorf_compiled, arenstorf.t_end, arenstorf.y0[:2]),
        "pleiades": (pleiades, pleiades_compiled, 3.0, pleiades_end),
        "kepler_e0.9_100_periods": (kepler, kepler_compiled, 200 * np.pi, kepler.y0[:2]),
    }
    for name, (system, compiled, t_end, end) in problems.items():
        for exponent in (8, 12):
            runs = orbit_runs(system, compiled, t_end, 10.0**-exponent)
            if quick and name.startswith("kepler"):
                runs.pop("scipy DOP853", None)
            for peer, call in runs.items():
                shortest, y = best(call, seconds)
                emit(f"{name}_rtol1e-{exponent}", peer, "time", 1e3 * shortest, "ms")
                if end is not None:
                    error = np.abs(y[: len(end)] - end).max()
                    emit(f"{name}_rtol1e-{exponent}", peer, "max_error", error, "1")


def orbit_runs(system, compiled, t_end, tolerance):
    """Each peer's call that gives the state at the end."""

    def run(solve, fun, method):
        return lambda: solve(
            fun, (0.0, t_end), system.y0, method, rtol=tolerance, atol=tolerance
        ).y[:, -1]

    def numbalsoda_dop853():
        times, nothing = np.array([0.0, t_end]), np.zeros(1)
        settings = {"rtol": tolerance, "atol": tolerance, "mxstep": 10**6}
        states, _ = numbalsoda.dop853(compiled.address, system.y0, times, nothing, **settings)
        return states[-1]

    runs = {
        "substep RK45": run(substep.solve_ivp, system, "RK45"),
        "substep DOP853": run(substep.solve_ivp, system, "DOP853"),
    }
    if compiled:
        runs["substep DOP853, C pointer"] = run(substep.solve_ivp, compiled, "DOP853")
    if compiled and numbalsoda:
        runs["numbalsoda dop853"] = numbalsoda_dop853
    if scipy:
        runs["scipy DOP853"] = run(scipy.solve_ivp, system, "DOP853")
    return runs


def main() -> None:
    """Run all of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="end within a minute")
    quick = parser.parse_args().quick
    bench_lorenz(quick)
    bench_calls(quick)
    bench_orbits(quick)


if __name__ == "__main__":
    sys.exit(main())
