"""Implicit Euler on a cloth of n x n vertices: the parts of a step, and whole steps.

0.3 kg, 1 m x 1 m, structural, shear (0.5 k) and bending (0.05 k) springs, k = 1e4 N/m, held at two
corners, h = 1/60 s, from the flat state at rest, gravity across it. Newton to |g|_inf < 1e-3 m g;
projective dynamics with ten iterations. Prints JSON lines {workload, peer, metric, value, unit,
threads, isa}. The peers implicit_ref.cpp and pd_ref.cpp (CHOLMOD called directly) are compiled
where their source is at hand: SUBSTEP_PEERS_SOLIDS, or ../shared/peers/solids.
python bench/springs.py [--quick]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import substep
from substep import _core, springs

SOURCES = Path(__file__).resolve().parents[2] / "shared/peers/solids"
H = 1 / 60


def emit(n: int, peer: str, metric: str, value: float, threads: int, unit: str = "ms") -> None:
    record = dict(workload=f"cloth {n}^2", peer=peer, metric=metric, value=float(f"{value:.4g}"))
    isa = _core.level if peer == "substep" else "native"
    print(json.dumps({**record, "unit": unit, "threads": threads, "isa": isa}), flush=True)


def best_ms(work: Callable[[], Any], repeats: int) -> float:
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


def cloth(n: int, threads: int, solver: str = "newton") -> substep.MassSpring:
    axis = np.linspace(0, 1, n)
    x = np.array([(b, 0.0, a) for a in axis for b in axis])
    edges, stiffness = springs.grid_springs(n, n, stiffness=1e4)
    return substep.MassSpring(
        x,
        edges,
        stiffness,
        0.3 / n**2,
        pinned=[0, n - 1],
        gravity=(0, -9.81, 0),
        step=H,
        solver=solver,
        threads=threads,
    )


def parts(n: int, threads: int, repeats: int) -> None:
    """Assembly, factorization and solve."""
    native = cloth(n, threads)._native
    start, row = native.pattern()
    values = np.zeros(len(row))
    repeats = 3 if n > 128 else repeats
    emit(n, "substep", "assembly", best_ms(lambda: native.assemble(H, values), repeats), threads)
    # In float64, and in float32 as steps of Newton's method begin.
    factor(n, threads, repeats, _core.SupernodalCholesky(start, row, 3), values, "")
    factor(n, threads, repeats, _core.SingleSupernodalCholesky(start, row, 3), values, "single_")


def factor(n: int, threads: int, repeats: int, matrix: Any, values: np.ndarray, name: str) -> None:
    assert matrix.factorize(values, threads) == -1
    numeric = best_ms(lambda: matrix.factorize(values, threads), repeats)
    emit(n, "substep", f"{name}factorization", numeric, threads)
    rate = matrix.flops / numeric / 1e6
    emit(n, "substep", f"{name}factorization_rate", rate, threads, "GFlop/s")
    x = np.ones(3 * n * n)
    emit(n, "substep", f"{name}solve", best_ms(lambda: matrix.solve(x, threads), repeats), threads)


def steps(n: int, threads: int, solver: str, frames: int) -> None:
    """Mean time of the first frames."""
    net, counts, residuals = cloth(n, threads, solver), [], []
    factorizations, refinements, seconds = [], [], []
    for _ in range(frames):
        start = time.perf_counter()
        net.step()
        seconds.append(time.perf_counter() - start)
        counts.append(net.report.iterations)
        factorizations.append(net.report.factorizations)
        refinements.append(net.report.refinements)
        residuals.append(net.report.residuals[-1])
    emit(n, "substep", f"{solver}_step", 1e3 * float(np.mean(seconds)), threads)
    emit(n, "substep", f"{solver}_iterations", float(np.mean(counts)), threads, "1")
    if solver == "newton":
        emit(n, "substep", "newton_factorizations", float(np.mean(factorizations)), threads, "1")
        emit(n, "substep", "newton_refinements", float(np.mean(refinements)), threads, "1")
    worst = max(residuals) / (9.81 * 0.3 / n**2)
    emit(n, "substep", f"{solver}_worst_residual", worst, threads, "m g")


def build(name: str, folder: str) -> Path | None:
    source = Path(os.environ.get("SUBSTEP_PEERS_SOLIDS", SOURCES)) / f"{name}.cpp"
    program = Path(folder) / name
    command = ["g++", "-O3", "-march=native", "-fopenmp", "-w", "-I/usr/include/eigen3"]
    command += ["-I/usr/include/suitesparse", str(source), "-o", str(program), "-lcholmod"]
    if source.exists() and subprocess.run(command).returncode == 0:
        return program
    print(f"# {name} is left out: no source, or it does not compile")
    return None


def peers(sizes: list[int], folder: str) -> None:
    newton, projective = build("implicit_ref", folder), build("pd_ref", folder)
    for n in sizes:
        if newton:  # 34 and more factorizations a step; no more than 40
            command = [str(newton), str(n), "cu", str(2 if n > 64 else 4), "40", "2"]
            out = json.loads(subprocess.run(command, capture_output=True, text=True).stdout)
            for key in ("assembly_ms", "factor_ms", "solve_ms", "ms_per_step"):
                emit(n, "CHOLMOD called directly", key, out[key], 2)
            iterations = out["newton_iters_mean"]
            emit(n, "CHOLMOD called directly", "newton_iterations", iterations, 2, "1")
        if projective:
            command = [str(projective), str(n), "5", "10"]
            out = json.loads(subprocess.run(command, capture_output=True, text=True).stdout)
            value = 10 * out["value"]
            emit(n, "CHOLMOD called directly", "ten_local_global_iterations", value, 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="end within a minute")
    quick = parser.parse_args().quick
    sizes = [32, 64] if quick else [32, 64, 128, 256]
    frames = 5 if quick else 20
    for n in sizes:
        for threads in (1, 2):
            parts(n, threads, 5)
            steps(n, threads, "projective", frames)
        steps(n, 2, "newton", {128: 6, 256: 2}.get(n, frames))
    with tempfile.TemporaryDirectory() as folder:
        peers(sizes, folder)


if __name__ == "__main__":
    main()
