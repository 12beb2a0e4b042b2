"""Stiff problems beside their peers: time and error over a range of tolerances.

Van der Pol and Robertson (dense), the Brusselator on a line and on a square (sparse), by our
implicit methods and RKC2, SciPy's BDF and Radau with the same right-hand side and Jacobian,
numbalsoda's LSODA, and CVODE and a hand-written RKC2 in C++ where _peers.py finds them. Prints one
JSON line per figure; --quick ends within a minute or two.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import substep
from _peers import c_function, peer_module, peer_program
from substep import _core, systems

REFERENCE = Path(__file__).resolve().parents[2] / "shared/reference/ode.json"
numba, numbalsoda = peer_module("numba"), peer_module("numbalsoda")
scipy = peer_module("scipy.integrate")


def emit(
    workload: str, peer: str, metric: str, value: float, unit: str = "1", threads: int = 1
) -> None:
    record = {
        "workload": workload,
        "peer": peer,
        "metric": metric,
        "value": float(f"{value:.5g}"),
        "unit": unit,
        "threads": threads,
        "isa": _core.level,
    }
    print(json.dumps(record), flush=True)


def measure(
    workload: str,
    peer: str,
    call: Callable[[], Any],
    error: Callable[[Any], float],
    seconds: float,
    threads: int = 1,
) -> None:
    """Shortest time of a call, repeated for so many seconds, and the error it makes.

    What takes a second is called once, the rest twice at least: the first call may compile. Of one
    thread the processor's time counts where it is less than the clock's: other programs do not.
    """
    start, shortest, runs = time.perf_counter(), np.inf, 0
    try:
        while runs == 0 or (runs == 1 and shortest < 1) or time.perf_counter() - start < seconds:
            wall, processor = time.perf_counter(), time.process_time()
            y = call()
            wall, processor = time.perf_counter() - wall, time.process_time() - processor
            shortest = min(shortest, wall if threads > 1 else min(wall, processor))
            runs += 1
    except (substep.SolverError, RuntimeError) as failure:
        print(f"# {workload}, {peer}: {failure}", flush=True)
        return
    emit(workload, peer, "time", 1e3 * shortest, "ms", threads)
    emit(workload, peer, "max_error", error(y), "1", threads)


def ours(system: Any, t_end: float, method: str, rtol: float, atol: float, **settings: Any) -> Any:
    return substep.solve_ivp(
        system, (0, t_end), system.y0, method, rtol=rtol, atol=atol, t_eval=[t_end], **settings
    ).y[:, -1]


def scipys(system: Any, t_end: float, method: str, rtol: float, atol: float) -> Any:
    native = system.native_system
    jacobian = native.jacobian if isinstance(native.jacobian(0.0, system.y0), np.ndarray) else None
    result = scipy.solve_ivp(
        native.rhs, (0, t_end), system.y0, method, jac=jacobian or system.jacobian,
        rtol=rtol, atol=atol,
    )  # fmt: skip
    if not result.success:
        raise RuntimeError(result.message)
    return result.y[:, -1]


# Two and three components.


@c_function
def van_der_pol_compiled(t, y, d, p):
    d[0] = y[1]
    d[1] = ((1 - y[0] ** 2) * y[1] - y[0]) * 1e6


@c_function
def robertson_compiled(t, y, d, p):
    slow, back, fast = 0.04 * y[0], 1e4 * y[1] * y[2], 3e7 * y[1] * y[1]
    d[0] = back - slow
    d[1] = slow - back - fast
    d[2] = fast


# System, compiled form, end, atol / rtol, name of the end values.
SMALL = {
    "vdpol": (
        systems.VanDerPol(1000.0, scaled=True),
        van_der_pol_compiled,
        2.0,
        1e-2,
        "vdpol_mu1000_scaled_T2",
    ),
    "robertson": (systems.Robertson(), robertson_compiled, 1e11, 1e-10, "robertson_T1e11"),
}


def bench_small(quick: bool) -> None:
    reference = json.loads(REFERENCE.read_text())
    for name, (*problem, key) in SMALL.items():
        end = np.array(reference[key]["y_end"], dtype=float)

        def error(y, end=end):
            return np.max(np.abs(y - end) / np.abs(end))

        for exponent in (2, 3, 4, 5, 6, 8, 10):
            for peer, call in small_runs(name, *problem, exponent).items():
                workload = f"{name}_rtol1e-{exponent}"
                measure(workload, peer, call, error, 0.1 if quick else 1.0)
    from_peer("cvode_bench", "small", r"d_(vdpol|robertson)_\w*?_rtol1e-\d+")


def small_runs(name, system, compiled, t_end, ratio, exponent):
    """Each peer's call that gives the state at the end."""
    rtol = 10.0**-exponent
    atol = rtol * ratio

    def native(method):
        return lambda: ours(system, t_end, method, rtol, atol)

    def pointer():
        return substep.solve_ivp(
            compiled, (0, t_end), system.y0, "Radau", rtol=rtol, atol=atol, t_eval=[t_end]
        ).y[:, -1]

    def lsoda():
        times, nothing = np.array([0.0, t_end]), np.zeros(1)
        settings = {"rtol": rtol, "atol": atol, "mxstep": 10**6}
        return numbalsoda.lsoda(compiled.address, system.y0, times, nothing, **settings)[0][-1]

    runs = {"substep Radau": native("Radau")}
    if exponent <= 5:
        runs["substep implicit_euler"] = native("implicit_euler")
    if name == "vdpol" and exponent <= 6:
        runs["substep RKC2"] = native("RKC2")
    if exponent in (4, 6, 8, 10):
        if compiled:
            runs["substep Radau, C pointer"] = pointer
        if compiled and numbalsoda:
            runs["numbalsoda lsoda"] = lsoda
        for method in ("BDF", "Radau", "LSODA") if scipy else ():
            runs[f"scipy {method}"] = lambda m=method: scipys(system, t_end, m, rtol, atol)
    return runs


# The Brusselator.


def bench_line(quick: bool) -> None:
    system = systems.Brusselator1D(500)
    exact = ours(system, 10.0, "rk4", 1.0, 1.0, step=1e-4)
    for exponent in (3, 4, 6) if quick else (3, 4, 5, 6, 8):
        for peer, call in line_runs(system, exponent).items():
            workload, seconds = f"bruss1d_N500_rtol1e-{exponent}", 0.1 if quick else 1.0
            measure(workload, peer, call, lambda y: np.abs(y - exact).max(), seconds)
    from_peer("cvode_bench", "bruss1", r"d_bruss1d_N500_rtol1e-\d+")


def line_runs(system, exponent):
    """Each peer's call that gives the state at the end."""
    rtol = 10.0**-exponent
    runs = {
        f"substep {method}": lambda m=method: ours(system, 10.0, m, rtol, rtol, threads=1)
        for method in ("RKC2", "Radau", "implicit_euler")
        if exponent <= 4 or method != "implicit_euler"
    }
    for method in ("BDF", "Radau") if scipy else ():
        runs[f"scipy {method}"] = lambda m=method: scipys(system, 10.0, m, rtol, rtol)
    return runs


class Square:
    """The Brusselator on n x n points to 1.5, begun anew at 1.1, when the source is switched on."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.before = systems.Brusselator2D(n, source_time=np.inf)
        self.after = systems.Brusselator2D(n, source_time=-np.inf)
        # The limit of rk4 is 2.78 / (0.8 n^2).
        self.exact = self.ours("rk4", step=0.1 / round(0.1 * 0.4 * n * n))()

    def error(self, y: Any) -> float:
        return float(np.abs(y - self.exact).max())

    def ours(self, method: str, **settings: Any) -> Callable[[], Any]:
        def solve(system, t0, t1, y0):
            return substep.solve_ivp(system, (t0, t1), y0, method, t_eval=[t1], **settings).y[:, -1]

        return lambda: self.in_two(solve)

    def scipys(self, method: str, tolerance: float) -> Callable[[], Any]:
        def solve(system, t0, t1, y0):
            settings = {"jac": system.jacobian, "rtol": tolerance, "atol": tolerance}
            rhs = system.native_system.rhs
            return scipy.solve_ivp(rhs, (t0, t1), y0, method, **settings).y[:, -1]

        return lambda: self.in_two(solve)

    def in_two(self, solve: Callable[[Any, float, float, Any], Any]) -> Any:
        return solve(self.after, 1.1, 1.5, solve(self.before, 0.0, 1.1, self.before.y0))


def bench_square(quick: bool) -> None:
    for n in (64, 128):
        square = Square(n)
        for text in ("1e-3", "5e-4", "1e-4", "1e-5", "1e-6"):
            workload, tolerance = f"bruss2d_N{n}_rtol{text}", float(text)
            both = {"rtol": tolerance, "atol": tolerance}
            for threads in (1, 2):
                call = square.ours("RKC2", threads=threads, **both)
                seconds = 0.3 if quick else 2.0
                measure(workload, "substep RKC2", call, square.error, seconds, threads)
            if text == "5e-4":
                continue
            # A decomposition of the larger matrix takes long; how long, one tolerance tells.
            solvers = ("krylov", "direct") if n == 64 or text == "1e-3" else ("krylov",)
            for solver in solvers:
                call = square.ours("Radau", linear_solver=solver, **both)
                measure(workload, f"substep Radau, {solver}", call, square.error, 0.0)
            if scipy and n == 64 and (text == "1e-3" or not quick):
                for method in ("BDF",) if quick else ("BDF", "Radau"):
                    call = square.scipys(method, tolerance)
                    measure(workload, f"scipy {method}", call, square.error, 0.0)
        last = "rtol1e-3" if quick and n == 128 else "rtol1e-6"
        pattern = rf"d_bruss2d_N{n}_T1\.5_rtol1e-\d+"
        from_peer("cvode_bench", f"bruss2_{n}", pattern, last)
    from_peer("rkc", "", r"d_bruss2d_N128_T1\.5_rtol1e-\d+", "N128_T1.5_rtol1e-6:cpp_rkc2_2t")


# The programs in C++.


def processor_ms(pid: int) -> float:
    """Time of the processor that a running program has used."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return 1e3 * (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def lines_of(program: Path, argument: str, last: str) -> Iterator[tuple[dict[str, Any], float]]:
    """What a program prints, up to the error of `last`, and its processor's time for each line."""
    command = [program, argument] if argument else [program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        before = 0.0
        for line in process.stdout:
            if not line.startswith("{"):
                continue
            now = processor_ms(process.pid)
            record = json.loads(line)
            yield record, now - before
            before = now
            name = f"{record['workload']}:{record['peer']}"
            if last and last in name and record["metric"] == "max_abs_err":
                process.terminate()
                return


def from_peer(name: str, argument: str, pattern: str, last: str = "") -> None:
    """Time and error that a C++ peer prints for the workloads of a pattern, under our names."""
    program = peer_program(name)
    if program is None:
        return
    metrics = {"ms": ("time", "ms"), "max_rel_err": ("max_error", "1")}
    metrics["max_abs_err"] = metrics["max_rel_err"]
    for record, processor in lines_of(program, argument, last):
        if not re.fullmatch(pattern, record["workload"]) or record["metric"] not in metrics:
            continue
        workload = re.sub(r"^d_|_mu1000_T2scaled|_T1e11|_T1\.5", "", record["workload"])
        peer, _, count = re.fullmatch(r"(.*?)(_(\d)t)?", record["peer"]).groups()
        metric, unit = metrics[record["metric"]]
        value = record["value"]
        if metric == "time" and value > 500 and name == "cvode_bench":  # once, one thread
            value = min(value, processor)
        emit(workload, peer, metric, value, unit, int(count or 1))


def main() -> None:
    """Run all of them, or the named ones."""
    parts = {"small": bench_small, "line": bench_line, "square": bench_square}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="end within a minute or two")
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(parts))
    options = parser.parse_args()
    for name in options.parts or parts:
        parts[name](options.quick)


if __name__ == "__main__":
    sys.exit(main())
