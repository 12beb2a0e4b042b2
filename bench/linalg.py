"""Factorization of a cloth's Hessian, beside CHOLMOD called directly; CG on a mesh.

The peer is `implicit_ref.cpp` (CHOLMOD supernodal with AMD): compiled here where its source is at
hand (SUBSTEP_PEERS, or ../shared/peers/solids), and run with the BLAS that this process holds and,
where SUBSTEP_THREADED_BLAS names a folder with a threaded libblas.so.3, with that one.
"""

from __future__ import annotations

import argparse
import functools
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
from substep import _core

SOURCE = Path(__file__).resolve().parents[2] / "shared/peers/solids/implicit_ref.cpp"


def emit(workload: str, peer: str, metric: str, value: float, threads: int, unit: str) -> None:
    record = dict(workload=workload, peer=peer, metric=metric, value=value, unit=unit)
    isa = substep._core.level if peer.startswith("substep") else "native"
    print(json.dumps({**record, "threads": threads, "isa": isa}), flush=True)


def best_ms(work: Callable[[], Any], repeats: int) -> float:
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


def cloth(n: int) -> tuple[Any, Any, Any]:
    """Compressed columns, SPD, with the pattern of the Hessian: 3 x 3 blocks along springs."""
    i = np.arange(n * n)
    a, b = np.divmod(i, n)
    pairs = [
        (i[(a + da < n) & (b + db >= 0) & (b + db < n)], da * n + db)
        for da, db in ((0, 1), (1, 0), (1, 1), (1, -1), (0, 2), (2, 0))
    ]
    tail = np.concatenate([p for p, _ in pairs])
    head = np.concatenate([p + shift for p, shift in pairs])
    rows, cols = np.concatenate([i, tail, head]), np.concatenate([i, head, tail])
    block = np.where(rows == cols, 30.0, -1.0)[:, None, None] * np.eye(3) - 0.2
    rows = (3 * rows[:, None, None] + np.arange(3)[:, None] + np.zeros((3, 3), int)).ravel()
    cols = (3 * cols[:, None, None] + np.arange(3)[None, :] + np.zeros((3, 3), int)).ravel()
    order = np.lexsort((rows, cols))
    start = np.searchsorted(cols[order], np.arange(3 * n * n + 1))
    return block.ravel()[order], rows[order].astype(np.int32), start.astype(np.int32)


def ours(n: int, repeats: int) -> None:
    values, row, start = cloth(n)
    lower = row >= np.repeat(np.arange(3 * n * n), np.diff(start))

    def make() -> Any:
        return _core.CholeskyFactor(start, row, "automatic", "automatic", 3)

    factor = make()
    held = np.ascontiguousarray(values[lower])
    assert factor.factor(held)
    name, right = f"cloth {n}^2", np.ones(3 * n * n)
    emit(name, "substep", "analysis", best_ms(make, 1), 1, "ms")
    emit(name, "substep", "factorization", best_ms(lambda: factor.factor(held), repeats), 1, "ms")
    emit(name, "substep", "solve", best_ms(lambda: factor.solve(right), repeats), 1, "ms")


def direct(program: Path, n: int, folder: str | None, name: str) -> None:
    """The peer in a frame or two: it prints the mean over its Newton iterations."""
    env = {**os.environ, **({"LD_LIBRARY_PATH": folder} if folder else {})}
    command = [str(program), str(n), "cu", "3", "4", "2"]
    runs = [
        json.loads(subprocess.run(command, env=env, capture_output=True, text=True).stdout)
        for _ in range(2)
    ]
    for metric in ("factor", "solve"):
        value = min(run[f"{metric}_ms"] for run in runs)
        label = "factorization" if metric == "factor" else metric
        emit(f"cloth {n}^2", name, label, value, 2, "ms")


def blas_folder() -> str:
    """Where this process found its BLAS."""
    for line in Path("/proc/self/maps").read_text().splitlines():
        if "/libblas" in line:
            return str(Path(line.split()[-1]).parent)
    return ""


def krylov(n: int, repeats: int) -> None:
    """The 5-point Laplacian: conjugate gradients on one and two threads."""
    i = np.arange(n * n)
    right, down = i[i % n < n - 1], i[i < n * (n - 1)]
    rows = np.concatenate([i, right, right + 1, down, down + n])
    cols = np.concatenate([i, right + 1, right, down + n, down])
    values = np.where(rows == cols, 4.01, -1.0)
    order = np.lexsort((rows, cols))
    A = (values[order], rows[order], np.searchsorted(cols[order], np.arange(n * n + 1)))
    b = np.random.default_rng(0).standard_normal(n * n)
    for threads in (1, 2):
        solve = functools.partial(substep.linalg.cg, A, b, rtol=1e-10, threads=threads)
        emit(f"mesh {n}^2, CG to 1e-10", "substep", "solve", best_ms(solve, repeats), threads, "ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="within a minute")
    quick = parser.parse_args().quick
    sizes = (64, 128) if quick else (64, 128, 256)
    source = Path(os.environ.get("SUBSTEP_PEERS", SOURCE.parent)) / SOURCE.name
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "implicit_ref"
        build = ["g++", "-O3", "-march=native", "-fopenmp", "-w", "-I/usr/include/eigen3"]
        build += ["-I/usr/include/suitesparse", str(source), "-o", str(program), "-lcholmod"]
        built = source.exists() and subprocess.run(build).returncode == 0
        for n in sizes:
            ours(n, 5 if n < 256 else 3)
            if built:
                direct(program, n, blas_folder(), "CHOLMOD called directly, same BLAS")
                if threaded := os.environ.get("SUBSTEP_THREADED_BLAS"):
                    direct(program, n, threaded, "CHOLMOD called directly, threaded BLAS")
    krylov(512, 3)


if __name__ == "__main__":
    main()
