"""Grid fluids: a dam break of a million particles, smoke, projections, and their growth.

A column of a quarter of the box collapses; float32, 8 particles to a cell, even steps, tolerance
1e-4. "step" is the least of eight steps after 0.1 s, "particle" that over the number of
particles, "iterations" those of the pressure in the last of them, "memory" what the process has
grown by, over the cells. Of a closed box without obstacles "projection" takes the divergence from
velocities (float32), beside SciPy's cosine transform and back (float64), least of eight, and "cpu"
is the processor time of both. Below an open top, with and without a ball in the box, it is solved
for to 1e-6 (that with the ball includes what it cuts); the least of four, beside pyamg's cycles
(Ruge and Stueben's, with conjugate gradients, float64, one thread; "setup" finds its levels). Smoke
is hot and rises in a closed box whose air turns already; float32, tolerance 1e-3, in steps of at
most 0.7 cells for central fluxes and 1.5 along paths; "step" is the least of six. Prints JSON lines
{workload, peer, metric, value, unit, threads, isa}. python bench/gridfluid.py [--quick]
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import substep
from _peers import peer_module
from substep import _core


def emit(
    workload: str, metric: str, value: float, unit: str, threads: int, peer: str = "substep"
) -> None:
    record = dict(workload=workload, peer=peer, metric=metric, value=float(f"{value:.4g}"))
    print(json.dumps({**record, "unit": unit, "threads": threads, "isa": _core.level}), flush=True)


def dam(n: int, threads: int, **options: Any) -> substep.GridLiquid:
    """A box of 2 n x n x n cells, a quarter of it liquid."""
    cell = 1 / n
    water = substep.fill_box((0, 0, 0), (0.5, 1, 1 - cell), cell / 2)
    bounds = ((0, 0, 0), (2, 1, 1))
    return substep.GridLiquid(water, cell=cell, bounds=bounds, threads=threads, **options)


def resident() -> int:
    """Bytes of memory that the process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def measure(n: int, threads: int, transfer: str) -> None:
    before = resident()
    liquid = dam(n, threads, transfer=transfer)
    liquid.advance(0.1)
    grown = resident() - before
    step = 0.25 * liquid.cell
    times = []
    for _ in range(8):
        start = time.perf_counter()
        liquid.step(step)
        times.append(time.perf_counter() - start)
    workload = f"dam break {transfer} {2 * n} x {n} x {n}"
    cells = liquid.shape[0] * liquid.shape[1] * liquid.shape[2]
    emit(workload, "step", 1e3 * min(times), "ms", threads)
    emit(workload, "particle", 1e9 * min(times) / len(liquid), "ns", threads)
    emit(workload, "iterations", liquid.report.iterations, "1", threads)
    emit(workload, "memory", grown / cells, "B", threads)


def least(call: Callable[[], object]) -> tuple[float, float]:
    """Milliseconds of the clock and of the processor."""
    times = []
    for _ in range(8):
        start = time.perf_counter(), time.process_time()
        call()
        times.append((time.perf_counter() - start[0], time.process_time() - start[1]))
    clock, processor = zip(*times, strict=True)
    return 1e3 * min(clock), 1e3 * min(processor)


def measure_projection(cells: tuple[int, ...], threads: int) -> None:
    d, random = len(cells), np.random.default_rng(0)
    bounds = ((0,) * d, [n / cells[0] for n in cells])
    velocity = random.uniform(-1, 1, (*cells, d))
    flow = substep.GridFlow(bounds, 1 / cells[0], velocity=velocity, threads=threads)
    values = random.uniform(-1, 1, cells)
    workload = f"closed box {' x '.join(map(str, cells))}"
    calls: dict[str, Callable[[], object]] = {"substep": flow._native.project}
    fft = peer_module("scipy.fft")
    if fft is not None:
        calls["scipy.fft"] = lambda: fft.idctn(fft.dctn(values, workers=threads), workers=threads)
    for peer, call in calls.items():
        clock, processor = least(call)
        emit(workload, "projection", clock, "ms", threads, peer)
        emit(workload, "cpu", processor, "ms", threads, peer)
    emit(workload, "residual", flow.report.residual, "1", threads)


def measure_open_projection(cells: tuple[int, ...], threads: int, ball: bool) -> None:
    d, random = len(cells), np.random.default_rng(0)
    flow = substep.GridFlow(
        ((0,) * d, [n / cells[0] for n in cells]),
        1 / cells[0],
        sides=["wall"] * (d - 1) + [("wall", "open")],
        colliders=[substep.Sphere(0.21, (0.5, 0.5, 0.35) if d == 3 else (0.5, 0.35, 0))] * ball,
        velocity=random.uniform(-1, 1, (*cells, d)),
        tolerance=1e-6,
        threads=threads,
    )
    times = []
    for _ in range(4):
        again = flow.copy()
        start = time.perf_counter()
        again._native.project()
        times.append(time.perf_counter() - start)
    workload = f"open top {' x '.join(map(str, cells))}" + ", ball" * ball
    emit(workload, "projection", 1e3 * min(times), "ms", threads)
    emit(workload, "iterations", again.report.iterations, "1", threads)


def measure_pyamg(cells: tuple[int, ...]) -> None:
    """The same pressure by pyamg."""
    pyamg, sparse = peer_module("pyamg"), peer_module("scipy.sparse")
    if pyamg is None or sparse is None:
        return

    def second_difference(n: int, open_top: bool) -> Any:
        middle = np.full(n, 2.0)
        middle[0], middle[-1] = 1, 3 if open_top else 1
        return sparse.diags([middle, -np.ones(n - 1), -np.ones(n - 1)], [0, 1, -1])

    axes = [second_difference(n, a == len(cells) - 1) for a, n in enumerate(cells)]
    matrix = axes[0]
    for axis in axes[1:]:
        matrix = sparse.kronsum(axis, matrix)
    matrix = matrix.tocsr()
    b = np.random.default_rng(0).uniform(-1, 1, matrix.shape[0])
    start = time.perf_counter()
    levels = pyamg.ruge_stuben_solver(matrix, max_coarse=500)
    built = time.perf_counter()
    residuals: list[float] = []
    levels.solve(b, tol=1e-6, accel="cg", residuals=residuals)
    workload = f"open top {' x '.join(map(str, cells))}"
    emit(workload, "setup", 1e3 * (built - start), "ms", 1, "pyamg")
    emit(workload, "projection", 1e3 * (time.perf_counter() - built), "ms", 1, "pyamg")
    emit(workload, "iterations", len(residuals) - 1, "1", 1, "pyamg")


def smoke(n: int, threads: int, advection: str) -> None:
    """Steps of hot smoke in a box of n^3 cells."""

    def turning(x: Any) -> Any:
        s, c = np.sin(6 * x), np.cos(6 * x)
        return 0.5 * np.roll(s, -1, axis=1) * np.roll(c, -2, axis=1)

    ball = substep.Sphere(0.1, (0.5, 0.5, 0.15))
    flow = substep.GridFlow(
        [(0, 0, 0), (1, 1, 1)],
        1 / n,
        velocity=turning,
        smoke=0.0,
        temperature=0.0,
        thermal_expansion=1 / 300,
        emitters=[substep.gridfluid.FlowEmitter(ball, smoke=1.0, temperature=300.0)],
        advection=advection,
        tolerance=1e-3,
        threads=threads,
    )
    step = (0.7 if advection == "central" else 1.5) / n
    times = []
    for _ in range(6):
        start = time.perf_counter()
        flow.step(step)
        times.append(time.perf_counter() - start)
    workload = f"smoke {advection} {n}^3"
    emit(workload, "step", 1e3 * min(times), "ms", threads)
    emit(workload, "cell", 1e9 * min(times) / n**3, "ns", threads)
    emit(workload, "iterations", flow.report.iterations, "1", threads)


def main() -> None:
    """Measure, with one thread and two."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true")
    quick = parser.parse_args().quick
    sizes = (16, 32) if quick else (16, 32, 64, 96)
    boxes = [(64,) * 3, (1024,) * 2] if quick else [(64,) * 3, (128,) * 3, (1024,) * 2]
    for cells in boxes:
        measure_pyamg(cells)
    for threads in (1, 2):
        for cells in boxes:
            measure_projection(cells, threads)
            for ball in (False, True):
                measure_open_projection(cells, threads, ball)
        for n in sizes:
            for transfer in ("apic", "flip"):
                measure(n, threads, transfer)
        for n in (32, 64) if quick else (32, 64, 128, 256):
            for advection in ("central", "maccormack", "semi_lagrangian"):
                smoke(n, threads, advection)


if __name__ == "__main__":
    main()
