"""What is left of the strain of a large hanging cloth, and what a frame costs.

n x n vertices, 6 n^2 rigid distances (stretch, shear, bending), held at two corners of a square of
1 m that starts flat; h = 1/60 s, 30 frames. "strain" is the rms over stretch and shear after the
last, "largest strain" the worst, "frame" the least time of a frame after the first (of one thread:
its processor time), "first frame" has the making of the levels in it. Prints JSON lines {workload,
peer, metric, value, unit, threads, isa}. The peer xpbd_ref.cpp (sweeps by hand) is compiled where
its source is at hand: SUBSTEP_PEERS_SOLIDS, or ../shared/peers/solids.
python bench/pbd_large.py [--quick]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from substep import Distance, PositionBasedDynamics, _core

SOURCES = Path(__file__).resolve().parents[2] / "shared/peers/solids"
FRAMES = 30
# Solver, substeps, iterations.
COMPARED = [("gauss_seidel", 10, 1), ("gauss_seidel", 1, 10), ("multilevel", 4, 1)]
CURVES = [("gauss_seidel", k, 1) for k in (5, 20, 40, 80)]
CURVES += [("multilevel", k, 1) for k in (2, 3, 5, 10, 20)]
CURVES += [("multilevel", 5, k) for k in (2, 4)]


def emit(name: str, peer: str, metric: str, value: float, unit: str, threads: int) -> None:
    record = dict(workload=name, peer=peer, metric=metric, value=float(f"{value:.4g}"))
    isa = _core.level if peer == "substep" else "native"
    print(json.dumps({**record, "unit": unit, "threads": threads, "isa": isa}), flush=True)


def distances(n: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Positions, pairs, and how many of them are stretch or shear."""
    i = np.arange(n * n, dtype=np.int32).reshape(n, n)
    near = [
        (i[:, :-1], i[:, 1:]),
        (i[:-1], i[1:]),
        (i[:-1, :-1], i[1:, 1:]),
        (i[:-1, 1:], i[1:, :-1]),
    ]
    far = [(i[:, :-2], i[:, 2:]), (i[:-2], i[2:])]
    pairs = [np.stack([a.ravel(), b.ravel()], axis=1) for a, b in near + far]
    u = np.linspace(0, 1, n)
    x = np.stack([np.tile(u, n), np.repeat(u, n), np.zeros(n * n)], axis=1)
    return x, np.concatenate(pairs), sum(len(p) for p in pairs[:4])


def measure(n: int, solver: str, substeps: int, iterations: int, threads: int) -> None:
    x, pairs, near = distances(n)
    rest = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    cloth = PositionBasedDynamics(
        x,
        0.3 / n**2,
        [Distance(pairs, rest)],
        pinned=[0, n - 1],
        solver=solver,
        substeps=substeps,
        iterations=iterations,
        threads=threads,
    )
    clock = time.thread_time if threads == 1 else time.perf_counter
    seconds = []
    for _ in range(FRAMES):
        start = clock()
        cloth.step(1 / 60)
        seconds.append(clock() - start)
    ends = cloth.positions[pairs[:near]]
    strain = np.abs(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / rest[:near] - 1)
    name = f"cloth {n}^2 {solver} {substeps}x{iterations}"
    emit(name, "substep", "frame", 1e3 * min(seconds[1:]), "ms", threads)
    emit(name, "substep", "first frame", 1e3 * seconds[0], "ms", threads)
    emit(name, "substep", "strain", float(np.sqrt(np.mean(strain**2))), "1", threads)
    emit(name, "substep", "largest strain", float(strain.max()), "1", threads)


def build(folder: str) -> Path | None:
    source = Path(os.environ.get("SUBSTEP_PEERS_SOLIDS", SOURCES)) / "xpbd_ref.cpp"
    program = Path(folder) / "xpbd_ref"
    command = ["g++", "-O3", "-march=native", "-fopenmp", "-w", str(source), "-o", str(program)]
    if source.exists() and subprocess.run(command).returncode == 0:
        return program
    print("# xpbd_ref is left out: no source, or it does not compile")
    return None


def by_hand(program: Path, n: int) -> None:
    mode = "2" if _core.level == "v4" else "1"  # 16 constraints at once need AVX-512
    command = [str(program), str(n), "10", "1", str(FRAMES), "2", mode]
    out = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    name, peer = f"cloth {n}^2 gauss_seidel 10x1", "xpbd_ref"
    emit(name, peer, "frame", out["ms_per_frame"], "ms", 2)
    emit(name, peer, "strain", out["rms_strain"], "1", 2)
    emit(name, peer, "largest strain", out["max_strain"], "1", 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="end within a minute")
    quick = parser.parse_args().quick
    with tempfile.TemporaryDirectory() as folder:
        program = build(folder)
        for n in (100, 300) if quick else (50, 100, 200, 300, 500, 1000):
            if program:
                by_hand(program, n)
            for how in COMPARED:
                for threads in (1, 2):
                    measure(n, *how, threads)
        for how in CURVES:
            measure(100 if quick else 300, *how, 1)


if __name__ == "__main__":
    main()
