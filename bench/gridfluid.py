"""Grid fluids: a dam break of a million particles on 128 x 64 x 64 cells, and its growth.

A column of a quarter of the box collapses; float32, 8 particles to a cell, even steps, tolerance
1e-4. "step" is the least of eight steps after 0.1 s, "particle" that over the number of
particles, "iterations" those of the pressure in the last of them, "memory" what the process has
grown by, over the cells. Prints JSON lines
{workload, peer, metric, value, unit, threads, isa}. python bench/gridfluid.py [--quick]
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import substep
from substep import _core


def emit(workload: str, metric: str, value: float, unit: str, threads: int) -> None:
    record = dict(workload=workload, peer="substep", metric=metric, value=float(f"{value:.4g}"))
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


def main() -> None:
    """Measure, with one thread and two."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--quick", action="store_true")
    sizes = (16, 32) if parser.parse_args().quick else (16, 32, 64, 96)
    for threads in (1, 2):
        for n in sizes:
            for transfer in ("apic", "flip"):
                measure(n, threads, transfer)


if __name__ == "__main__":
    main()
