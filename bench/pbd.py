"""Position-based dynamics of a cloth of n x n vertices: whole frames, beside peers in the same run.

1 m x 1 m, 0.3 kg, held at two corners, 6 n^2 inextensible distances (stretch, shear, bend), frames
of 1/60 s with 10 substeps of one Gauss-Seidel sweep. What is counted is the shortest whole frame
through the Python API, over all projections; of one thread its processor time, which other work on
the machine disturbs less. Prints JSON lines {workload, peer, metric, value,
unit, threads, isa}. The C++ peer xpbd_ref.cpp is compiled where its source is at hand
(SUBSTEP_PEERS_SOLIDS, or ../shared/peers/solids); pyPBD and Taichi run where the Python named by
SUBSTEP_PEER_PYTHON has them. python bench/pbd.py [--quick]
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import substep
from substep import _core
from substep.pbd import Distance

HERE = Path(__file__).resolve().parent
SOURCES = Path(os.environ.get("SUBSTEP_PEERS_SOLIDS", HERE.parents[1] / "shared/peers/solids"))
SUBSTEPS = 10


def emit(
    workload: str, peer: str, metric: str, value: float, unit: str, threads: int, **more: object
) -> None:
    isa = _core.level if peer == "substep" else "native"
    record = dict(workload=workload, peer=peer, metric=metric, value=float(f"{value:.4g}"))
    print(json.dumps({**record, "unit": unit, "threads": threads, "isa": isa, **more}), flush=True)


def pairs_of_cloth(n: int) -> np.ndarray:
    ids = np.arange(n * n, dtype=np.int32).reshape(n, n)
    ends = (
        (ids[:, :-1], ids[:, 1:]),
        (ids[:-1], ids[1:]),
        (ids[:-1, :-1], ids[1:, 1:]),
        (ids[:-1, 1:], ids[1:, :-1]),
        (ids[:, :-2], ids[:, 2:]),
        (ids[:-2], ids[2:]),
    )
    return np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ends])


def cloth(n: int, **options: object) -> substep.PositionBasedDynamics:
    axis = np.linspace(0, 1, n)
    x = np.stack([np.tile(axis, n), np.zeros(n * n), np.repeat(axis, n)], axis=1)
    distances = Distance(pairs_of_cloth(n))
    return substep.PositionBasedDynamics(
        x, 0.3 / n**2, [distances], pinned=[0, n - 1], gravity=(0, -9.81, 0), **options
    )


def best_frame(sim: substep.PositionBasedDynamics, seconds: float) -> float:
    """Shortest time of a frame [s]."""
    clock = time.process_time if sim.threads == 1 else time.perf_counter
    sim.step()
    times = []
    while sum(times) < seconds or len(times) < 3:
        start = clock()
        sim.step()
        times.append(clock() - start)
    return min(times)


def frames(n: int, dtype: str, threads: int, seconds: float, **options: object) -> None:
    sim = cloth(n, dtype=dtype, threads=threads, **options)
    took = best_frame(sim, seconds)
    work = len(sim.constraints[0]) * sim.substeps * sim.iterations
    name = f"xpbd cloth {n}^2 {dtype} {sim.substeps}x{sim.iterations} {sim.solver}"
    emit(name, "substep", "ns_per_projection", took / work * 1e9, "ns", threads)
    emit(name, "substep", "ms_per_frame", took * 1e3, "ms", threads)


def memory(n: int, dtype: str) -> None:
    """What a simulation adds to the resident set, in a process of its own."""
    code = f"""if 1:
        import sys; sys.path.insert(0, {str(HERE)!r})
        import pbd
        def rss(): return int(open("/proc/self/statm").read().split()[1]) * 4096
        pbd.cloth(10).step()
        before = rss()
        sim = pbd.cloth({n}, dtype={dtype!r})
        sim.step()
        print((rss() - before) / {n * n})
    """
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    name = f"xpbd cloth {n}^2 {dtype}"
    emit(name, "substep", "bytes_per_particle", float(out.stdout), "B", 1)


def reference(n: int, threads: int, count: int, folder: str) -> None:
    """The kernel written by hand for this cloth, for the best level of this machine."""
    source, program = SOURCES / "xpbd_ref.cpp", Path(folder) / "xpbd_ref"
    command = ["g++", "-O3", "-march=native", "-fopenmp", str(source), "-o", str(program)]
    if not program.exists():
        if not source.exists() or subprocess.run(command).returncode != 0:
            print("# xpbd_ref is left out: no source, or it does not compile")
            return
    arguments = [str(n), str(SUBSTEPS), "1", str(count), str(threads), "2"]
    out = subprocess.run([str(program), *arguments], capture_output=True, text=True, check=True)
    record = json.loads(out.stdout)
    name, projections = f"xpbd cloth {n}^2 float32 10x1", record["constraints"] * SUBSTEPS
    whole = record["ms_per_frame"] * 1e6 / projections
    emit(name, "xpbd_ref", "ns_per_projection", whole, "ns", threads)
    emit(name, "xpbd_ref", "ns_of_projections_alone", record["value"], "ns", threads)


def pypbd(n: int, threads: int, count: int) -> None:
    """The same cloth by pyPBD's constraints."""
    python, script = os.environ.get("SUBSTEP_PEER_PYTHON"), SOURCES / "pypbd_bench.py"
    if not python or not script.exists():
        print("# pyPBD is left out: name a Python that has it in SUBSTEP_PEER_PYTHON")
        return
    environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
    arguments = [python, str(script), "cloth", str(n), str(SUBSTEPS), "1", str(count)]
    out = subprocess.run(arguments, capture_output=True, text=True, env=environment)
    lines = [line for line in out.stdout.splitlines() if line.startswith("{")]
    if not lines:
        print("# pyPBD is left out: it failed")
        return
    record = json.loads(lines[-1])
    name = f"xpbd cloth {n}^2 float32 10x1"
    emit(name, "pyPBD", "ns_per_projection", record["value"], "ns", threads)
    emit(name, "pyPBD", "ms_per_frame", record["ms_per_frame"], "ms", threads)


def taichi(n: int, threads: int, count: int) -> None:
    """The same colours as Taichi kernels."""
    python = os.environ.get("SUBSTEP_PEER_PYTHON")
    if not python:
        print("# Taichi is left out: name a Python that has it in SUBSTEP_PEER_PYTHON")
        return
    script = HERE / "_taichi_cloth.py"
    arguments = [python, str(script), str(n), str(SUBSTEPS), str(count), str(threads)]
    out = subprocess.run(arguments, capture_output=True, text=True)
    lines = [line for line in out.stdout.splitlines() if line.startswith("{")]
    if not lines:
        print("# Taichi is left out: it failed")
        return
    seconds = json.loads(lines[-1])["seconds"]
    name, work = f"xpbd cloth {n}^2 float32 10x1", len(pairs_of_cloth(n)) * SUBSTEPS
    emit(name, "Taichi", "ns_per_projection", seconds / work * 1e9, "ns", threads)
    emit(name, "Taichi", "ms_per_frame", seconds * 1e3, "ms", threads)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="end within a minute")
    quick = parser.parse_args().quick
    seconds = 0.5 if quick else 3.0
    with tempfile.TemporaryDirectory() as folder:
        for n in (100, 300) if quick else (100, 300, 1000):
            count = max(4, int((1e5 if quick else 6e5) / n**2))
            for threads in (1, 2):
                frames(n, "float32", threads, seconds)
                reference(n, threads, count, folder)
            frames(n, "float64", 2, seconds)
            if n <= 300:
                pypbd(n, 2, max(3, count // 10))
            taichi(n, 2, max(3, count // 4))
    frames(100, "float32", 2, seconds, solver="jacobi")
    memory(300, "float32")
    if quick:
        return
    memory(1000, "float32")
    memory(1000, "float64")
    for n in (100, 178, 316, 562, 1000, 2000):  # 10k to 4M vertices
        for threads in (1, 2):
            frames(n, "float32", threads, seconds)
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"# at most {used:.1f} GB")


if __name__ == "__main__":
    main()
