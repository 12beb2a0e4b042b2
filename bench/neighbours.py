"""Neighbour lists of jittered points, about 29 neighbours each, against the number of points.

N points of a cubic lattice of spacing d, each moved by up to 0.2 d along each axis, in random
order; the radius is 2 d. "lists" is sort, reorder and full lists with the memory of the search
before, as a simulation has it from step to step; "rows" is `substep.geometry.neighbour_lists`,
which begins with nothing and gives the lists in the order of the points. Prints JSON lines
{workload, peer, metric, value, unit, threads, isa}. The peers: SciPy's cKDTree, and neigh_reach.cpp
(a counting sort and AVX-512 compression by hand), compiled where its source is at hand:
SUBSTEP_PEERS_FLUID, or ../shared/peers/fluid. python bench/neighbours.py [--quick]
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
from _peers import peer_module
from substep import _core
from substep.geometry import neighbour_lists

SOURCES = Path(__file__).resolve().parents[2] / "shared/peers/fluid"


def emit(n: int, peer: str, metric: str, value: float, threads: int, unit: str = "ns") -> None:
    record = dict(workload=f"neighbours {n}", peer=peer, metric=metric, value=float(f"{value:.4g}"))
    isa = _core.level if peer == "substep" else "native"
    print(json.dumps({**record, "unit": unit, "threads": threads, "isa": isa}), flush=True)


def best(work: Callable[[], Any], repeats: int) -> float:
    """Least time of a call [ns], the first apart."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter_ns()
        work()
        times.append(time.perf_counter_ns() - start)
    return min(times)


def jittered(n: int) -> tuple[np.ndarray, float]:
    """Points in the unit cube and twice their spacing."""
    side = round(n ** (1 / 3))
    random = np.random.default_rng(1)
    lattice = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)
    x = (lattice + 0.5 + random.uniform(-0.2, 0.2, lattice.shape)) / side
    return random.permutation(x), 2 / side


def measure(n: int, repeats: int) -> None:
    x, radius = jittered(n)
    for dtype, name in ((np.float32, ""), (np.float64, "_float64")):
        points = x.astype(dtype)
        search = _core.NeighbourSearch(points)
        for threads in (1, 2):
            t = best(lambda s=search, k=threads: s.search(radius, k), repeats)
            emit(len(x), "substep", f"lists{name}", t / len(x), threads)
            t = best(lambda p=points, k=threads: neighbour_lists(p, radius, threads=k), repeats)
            emit(len(x), "substep", f"rows{name}", t / len(x), threads)
        emit(len(x), "substep", f"memory{name}", search.bytes / len(x), 1, "B")
        emit(len(x), "substep", f"neighbours{name}", search.pair_count / len(x), 1, "1")


def kd_tree(n: int) -> None:
    """The tree and all pairs (half lists); one thread, which is all that query_pairs has."""
    spatial = peer_module("scipy.spatial")
    if spatial is None:
        return
    x, radius = jittered(n)
    t = best(lambda: spatial.cKDTree(x).query_pairs(radius, output_type="ndarray"), 1)
    emit(len(x), "SciPy cKDTree", "rows_float64", t / len(x), 1)


def build(folder: str) -> Path | None:
    source = Path(os.environ.get("SUBSTEP_PEERS_FLUID", SOURCES)) / "neigh_reach.cpp"
    program = Path(folder) / "neigh_reach"
    command = ["g++", "-O3", "-march=native", "-ffast-math", "-fopenmp", "-w", str(source)]
    if source.exists() and subprocess.run([*command, "-o", str(program)]).returncode == 0:
        return program
    print("# neigh_reach is left out: no source, or it does not compile")
    return None


def by_hand(program: Path, n: int) -> None:
    for threads in (1, 2):
        environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
        done = subprocess.run([program, str(n)], env=environment, capture_output=True, text=True)
        for line in done.stdout.splitlines():
            out = json.loads(line)
            if out["peer"] in ("grid_sorted_simd", "morton_sorted_simd", "hash_unordered_map"):
                emit(n, f"neigh_reach {out['peer']}", "lists", out["value"], threads)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="end within a minute")
    quick = parser.parse_args().quick
    sizes = [22**3, 46**3, 100**3] if quick else [22**3, 46**3, 100**3, 159**3]
    with tempfile.TemporaryDirectory() as folder:
        program = build(folder)
        for n in sizes:
            measure(n, 5 if quick or n > 2e6 else 20)
            if program and n <= 1e6:
                by_hand(program, n)
            if n <= (1e5 if quick else 1e6):
                kd_tree(n)


if __name__ == "__main__":
    main()
