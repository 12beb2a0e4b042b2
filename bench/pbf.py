"""Position-based fluids: a dam break of five iterations a step, against the number of particles.

A column of 1 m x 0.5 m x 2 m at the end of a tank of 4 m, cubic spline, support 2 spacings,
step = 0.4 spacing / sqrt(4 g), float32. Times are the least of the steps after the first three. An
iteration is the difference between steps of five and of one iteration from the same state, by four;
"step" includes the sort, the lists of neighbours, the warm start and the walls. "memory" is what
the process has grown by. "simulated_second" is the mean time of the first 150 steps (20 of 500,000
particles, and with --quick) with divergence-free velocities and at most three sweeps a step, whose
density error is about that of the peer, over the step; "density_error" the mean of what the density
is above that of rest meanwhile, and "divergence_iterations" those of a step. Prints JSON lines
{workload, peer, metric, value, unit, threads, isa}. The peers pbf_reach.cpp (one file for AVX-512),
bench_taichi_pbf.py (a kernel of five iterations without walls) and bench_splishsplash.py (DFSPH,
the same steps) are run where they are at hand: SUBSTEP_PEERS_FLUID, or ../shared/peers/fluid, the
last two by the Python of SUBSTEP_PEER_PYTHON, with SUBSTEP_PEER_PRELOAD for LD_PRELOAD.
python bench/pbf.py [--quick]
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import substep
from substep import _core

SOURCES = Path(__file__).resolve().parents[2] / "shared/peers/fluid"
REACH = {"step_ms": "step", "ns_per_particle_iter": "particle_iteration"}


def emit(n: int, peer: str, metric: str, value: float, unit: str, threads: int) -> None:
    record = dict(workload=f"dam break {n}", peer=peer, metric=metric, value=float(f"{value:.4g}"))
    isa = _core.level if peer == "substep" else "native"
    print(json.dumps({**record, "unit": unit, "threads": threads, "isa": isa}), flush=True)


def dam(n: int, threads: int, **options: Any) -> substep.PositionBasedFluid:
    d = 1 / round(n ** (1 / 3))
    counts = (round(1 / d), round(0.5 / d), round(2 / d))
    axes = [d * (np.arange(count) + 0.5) for count in counts]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    tank = substep.Collider(
        substep.Box((4, counts[1] * d, 8), (2, counts[1] * d / 2, 4)), hollow=True
    )
    return substep.PositionBasedFluid(
        x,
        d,
        colliders=[tank],
        step=0.4 * d / math.sqrt(4 * 9.81),
        threads=threads,
        **options,
    )


def resident() -> int:
    """Bytes of memory that the process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def least_ms(liquid: substep.PositionBasedFluid, steps: int) -> float:
    times = []
    for _ in range(steps):
        start = time.perf_counter()
        liquid.step()
        times.append(time.perf_counter() - start)
    return 1e3 * min(times)


def measure(n: int, threads: int, steps: int, dtype: str = "float32") -> None:
    before = resident()
    five = dam(n, threads, max_iterations=5, tolerance=0, dtype=dtype)
    for _ in range(3):
        five.step()
    count = len(five)
    memory = (resident() - before) / count
    one = dam(n, threads, max_iterations=1, tolerance=0, dtype=dtype)
    one.restore(five.state())
    whole, short = least_ms(five, steps), least_ms(one, steps)
    suffix = "" if dtype == "float32" else f"_{dtype}"
    emit(count, "substep", "step" + suffix, whole, "ms", threads)
    iteration = (whole - short) / 4 / count * 1e6
    emit(count, "substep", "particle_iteration" + suffix, iteration, "ns", threads)
    emit(count, "substep", "memory" + suffix, memory, "B", threads)


def divergence_free(n: int, threads: int, steps: int) -> None:
    liquid = dam(n, threads, divergence_free=True, max_iterations=3)
    seconds, errors, iterations = 0.0, [], []
    for _ in range(steps):
        start = time.perf_counter()
        liquid.step()
        seconds += time.perf_counter() - start
        errors.append(np.maximum(liquid.densities - 1, 0).mean())
        iterations.append(liquid.report.divergence_iterations)
    count = len(liquid)
    emit(count, "substep", "simulated_second", seconds / liquid.time, "s", threads)
    emit(count, "substep", "density_error", 100 * float(np.mean(errors)), "%", threads)
    emit(count, "substep", "divergence_iterations", float(np.mean(iterations)), "1", threads)


def splishsplash(n: int, threads: int, steps: int) -> None:
    """DFSPH by the peer's script, the same tank and steps."""
    script = Path(os.environ.get("SUBSTEP_PEERS_FLUID", SOURCES)) / "bench_splishsplash.py"
    python = os.environ.get("SUBSTEP_PEER_PYTHON")
    environment = os.environ | {"OMP_NUM_THREADS": str(threads)}
    if preload := os.environ.get("SUBSTEP_PEER_PRELOAD"):
        environment["LD_PRELOAD"] = preload
    if not python or not script.exists():
        print("# SPlisHSPlasH is left out: name its Python in SUBSTEP_PEER_PYTHON")
        return
    command = [python, str(script), "DFSPH", str(n), "--warm", "0", "--steps", str(steps)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    found = {}
    for line in done.stdout.splitlines():
        if line.startswith("{"):
            record = json.loads(line)
            found[record["metric"]] = record["value"]
    if not found:
        print("# SPlisHSPlasH is left out: it failed")
        return
    second = found["wall_s"] / ((steps - 1) * 1e-3 * found["dt_ms"])  # the first is not timed
    emit(n, "SPlisHSPlasH DFSPH", "simulated_second", second, "s", threads)
    emit(n, "SPlisHSPlasH DFSPH", "density_error", found["avg_err_pct"], "%", threads)


def peers(sizes: list[int], threads: list[int], folder: str) -> None:
    sources = Path(os.environ.get("SUBSTEP_PEERS_FLUID", SOURCES))
    program = Path(folder) / "pbf_reach"
    command = ["g++", "-O3", "-march=native", "-ffast-math", "-fopenmp", "-w"]
    source = sources / "pbf_reach.cpp"
    python, script = os.environ.get("SUBSTEP_PEER_PYTHON"), sources / "bench_taichi_pbf.py"
    runs: list[tuple[str, list[str]]] = []
    if source.exists() and subprocess.run([*command, source, "-o", program]).returncode == 0:
        runs.append(("pbf_reach", [str(program)]))
    else:
        print("# pbf_reach is left out: no source, or it does not compile")
    if python and script.exists():
        runs.append(("taichi", [python, str(script)]))
    else:
        print("# taichi is left out: name its Python in SUBSTEP_PEER_PYTHON")
    for name, start in runs:
        for n in sizes:
            for count in threads if name == "pbf_reach" else [2]:
                environment = os.environ | {"OMP_NUM_THREADS": str(count)}
                done = subprocess.run(
                    [*start, str(n), "5", "15"], capture_output=True, text=True, env=environment
                )
                if done.returncode != 0:
                    print(f"# {name} is left out: it failed")
                    return
                for line in done.stdout.splitlines():
                    if not line.startswith("{"):
                        continue
                    record = json.loads(line)
                    if record["metric"] in REACH:
                        size = int(record["workload"].split("_")[1])
                        metric, unit = REACH[record["metric"]], record["unit"]
                        emit(size, name, metric, record["value"], unit, count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="end within a minute")
    quick = parser.parse_args().quick
    sizes = [10_000, 98_000] if quick else [10_000, 30_000, 98_000, 300_000, 500_000, 1_000_000]
    for n in sizes:
        for threads in (1, 2):
            measure(n, threads, 10 if n < 200_000 else 4)
    for n in [98_000] if quick else [98_000, 500_000]:
        for threads in (1, 2):
            steps = 20 if quick or n > 200_000 else 150
            divergence_free(n, threads, steps)
            splishsplash(round(n ** (1 / 3)) ** 3, threads, steps)
    if not quick:
        measure(4_000_000, 2, 2)
        measure(98_000, 2, 10, "float64")
    with tempfile.TemporaryDirectory() as folder:
        peers([98_000] if quick else [10_000, 98_000, 500_000], [1, 2], folder)


if __name__ == "__main__":
    main()
