"""The material point method: explicit steps of a cube that lands on the ground.

8 particles a cell at random (in 2D 4), E = 1e5 Pa, nu = 0.2, at 0.5 m/s, steps of 0.3 cells (snow
0.1) of the elastic wave, float32: as the peers do it (common_mpm.py). "substep_ns" is the time per
particle and step of the best of several calls of advance(), sorts included; "memory" what the
process has grown by, per particle; "sorts" how many sorts there were in all calls. The split of the
time into passes is bench/cpp/mpm.cpp's, a program of the C++ build. Prints JSON lines {workload,
peer, metric, value, unit, threads, isa}.

Peers run where they are at hand: ref_mls_mpm3d.cpp, a hand-written kernel on a dense grid, and
bench_taichi.py, the usual kernel (atomic) and the best one (colour: sorted, eight colours), from
SUBSTEP_PEERS_MPM or ../shared/peers/mpm, the second by the Python of SUBSTEP_PEER_PYTHON.
python bench/mpm.py [--quick]
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import multiprocessing
import os
import resource
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
import substep
from substep import _core

SOURCES = Path(__file__).resolve().parents[2] / "shared/peers/mpm"
CELL = 1 / 128
E, NU = 1e5, 0.2
MATERIALS = {
    "elastic": substep.mpm.NeoHookean(density=1000, young_modulus=E, poisson_ratio=NU),
    "sand": substep.mpm.Sand(density=1000, young_modulus=E, poisson_ratio=NU),
    "snow": substep.mpm.Snow(density=400, young_modulus=E, poisson_ratio=NU),
}


def emit(workload: str, peer: str, metric: str, value: float, unit: str, threads: int) -> None:
    record = dict(workload=workload, peer=peer, metric=metric, value=float(f"{value:.4g}"))
    isa = _core.level if peer == "substep" else "native"
    print(json.dumps({**record, "unit": unit, "threads": threads, "isa": isa}), flush=True)


def name_of(material: str, n: int, dimension: int = 3) -> str:
    return f"{dimension}D {material} {n}"


def resident() -> int:
    """Bytes of memory that the process holds."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def cube(n: int, material: str, threads: int, dimension: int = 3) -> substep.MaterialPointMethod:
    """n particles just above the ground."""
    per_cell = 8 if dimension == 3 else 4
    side = math.ceil((n / per_cell) ** (1 / dimension)) * CELL
    x = side * np.random.default_rng(1).random((n, dimension))
    x[:, -1] += CELL
    v = np.zeros((n, dimension))
    v[:, -1] = -0.5
    lame = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    wave = math.sqrt((lame[0] + 2 * lame[1]) / MATERIALS[material].density)
    return substep.MaterialPointMethod(
        x,
        MATERIALS[material],
        cell=CELL,
        volume=CELL**dimension / per_cell,
        velocities=v,
        colliders=[substep.Plane((0, dimension == 2, dimension == 3))],
        boundary="sticky",
        transfer="apic",  # the peers', for sand too
        step=(0.1 if material == "snow" else 0.3) * CELL / wave,
        threads=threads,
    )


def measure(
    n: int, material: str, threads: int, steps: int, calls: int = 3, dimension: int = 3
) -> None:
    before = resident()
    body = cube(n, material, threads, dimension)
    step = body.step_size
    assert step is not None
    body.advance(3 * step)
    times, sorts = [], 0
    for _ in range(calls):
        start = time.perf_counter()
        body.advance(steps * step)
        times.append((time.perf_counter() - start) / body.report.steps)
        sorts += body.report.sorts
    workload = name_of(material, n, dimension)
    emit(workload, "substep", "substep_ns", 1e9 * min(times) / n, "ns", threads)
    emit(workload, "substep", "sorts", sorts, "1", threads)
    emit(workload, "substep", "memory", (resident() - before) / n, "B", threads)
    peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    emit(workload, "substep", "peak", (peak - before) / n, "B", threads)


def in_fresh_process(*case: object, **options: object) -> None:
    """measure(), where no memory is left over from a case before."""
    process = multiprocessing.get_context("spawn").Process(
        target=measure, args=case, kwargs=options
    )
    process.start()
    process.join()
    if process.exitcode:
        raise SystemExit(f"{case}: failed")


def reference(sizes: list[int], folder: str, steps: int, sources: Path) -> None:
    """The hand-written kernel: fused, dense grid, 3D."""
    source = sources / "ref_mls_mpm3d.cpp"
    flags = ["-O3", "-march=native", "-ffast-math", "-fno-finite-math-only", "-fopenmp", "-w"]
    for model, material in enumerate(("elastic", "sand", "snow")):
        program = Path(folder) / f"reference_{material}"
        packets = "-DKB=1" if material == "elastic" else "-DKB=2"
        command = ["g++", *flags, "-std=c++17", packets, "-DSWEEPS=3", source, "-o", program]
        if not source.exists() or subprocess.run(command).returncode != 0:
            print("# ref_mls_mpm3d is left out: no source, or it does not compile")
            return
        for n in sizes:
            grid = str(160 if n > 1_000_000 else 128)
            for threads in (1, 2):
                arguments = [program, str(n), grid, str(model), "1", str(steps), "5"]
                environment = os.environ | {"OMP_NUM_THREADS": str(threads)}
                runs = [
                    json.loads(
                        subprocess.run(
                            arguments, capture_output=True, text=True, env=environment, check=True
                        ).stdout
                    )["ns"]
                    for _ in range(3)
                ]
                workload = name_of(material, n)
                emit(workload, "hand-written", "substep_ns", min(runs), "ns", threads)


def taichi(cases: list[tuple[str, int, int]], steps: int, sources: Path) -> None:
    """The usual kernel and the best one, of (material, particles, dimension)."""
    python, script = os.environ.get("SUBSTEP_PEER_PYTHON"), sources / "bench_taichi.py"
    if not python or not script.exists():
        print("# taichi is left out: name its Python in SUBSTEP_PEER_PYTHON")
        return
    for material, n, dimension in cases:
        grid = 256 if dimension == 2 else 160 if n > 1_000_000 else 128 if n > 200_000 else 64
        for scatter in ("atomic", "colour"):
            options = {
                "--np": n,
                "--grid": grid,
                "--dim": dimension,
                "--material": material,
                "--steps": steps,
                "--scatter": scatter,
                "--sorted": int(scatter == "colour"),
            }
            command = [python, str(script), *(str(o) for pair in options.items() for o in pair)]
            done = subprocess.run(command, capture_output=True, text=True, cwd=sources)
            if done.returncode != 0:
                print("# taichi is left out: it failed")
                return
            for line in done.stdout.splitlines():
                record = json.loads(line) if line.startswith("{") else {"metric": ""}
                if record["metric"] == "ns_per_particle_substep":
                    workload = name_of(material, n, dimension)
                    emit(workload, f"taichi {scatter}", "substep_ns", record["value"], "ns", 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="end within a minute")
    quick = parser.parse_args().quick
    sources = Path(os.environ.get("SUBSTEP_PEERS_MPM", SOURCES))
    large = [200_000] if quick else [1_000_000, 4_000_000]
    steps = 20 if quick else 70
    for material in MATERIALS:
        for n in large:
            for threads in (1, 2):
                in_fresh_process(n, material, threads, steps)
    for threads in (1, 2):
        in_fresh_process(100_000, "elastic", threads, 200, dimension=2)
    if not quick:
        for n in (10_000, 100_000, 400_000, 2_000_000, 8_000_000):
            in_fresh_process(n, "elastic", 2, 10_000_000 // n + 20)
        in_fresh_process(10_000_000, "sand", 2, 20, calls=1)
    with tempfile.TemporaryDirectory() as folder:
        reference(large, folder, 20, sources)
    cases = [(material, n, 3) for material in MATERIALS for n in large[:1]]
    taichi(cases[:1] if quick else [*cases, ("elastic", 100_000, 2)], 8, sources)


if __name__ == "__main__":
    main()
