"""What viscosity, XSPH, vorticity confinement and surface tension cost beside the density solver.

A block of particles (float32, h = 2 spacings) with noise in its velocities. A term's cost is that
of a step with it less that of a step without, the smaller of several; "passes" is that over one
iteration of the density constraint. Prints JSON lines {workload, peer, metric, value, unit,
threads, isa}. python bench/pbf_forces.py [--quick]
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
import substep
from substep import _core

TERMS: dict[str, dict[str, float]] = {
    "xsph": {"xsph": 0.1},
    "vorticity_confinement": {"vorticity_confinement": 0.1},
    "surface_tension": {"surface_tension": 0.07},
    "viscosity": {"viscosity": 1e-3},
}


def emit(n: int, metric: str, value: float, unit: str, threads: int) -> None:
    record = dict(workload=f"block of {n}", peer="substep", metric=metric)
    record |= dict(value=float(f"{value:.3g}"), unit=unit, threads=threads, isa=_core.level)
    print(json.dumps(record), flush=True)


def fluid(side: int, threads: int, **options: Any) -> substep.PositionBasedFluid:
    d = 1 / side
    x = substep.fill_box((0, 0, 0), (1, 1, 1), d)
    v = np.random.default_rng(0).normal(0, 0.1, x.shape)
    settings = {"tolerance": 1.0, "max_tolerance": 1e9} | options
    return substep.PositionBasedFluid(
        x, d, velocities=v, gravity=(0, 0, 0), threads=threads, **settings
    )


def best_step(liquids: list[substep.PositionBasedFluid], repeats: int) -> list[float]:
    """Shortest step of each [s], taken by turns; each step begins with the same state."""
    states = [liquid.state() for liquid in liquids]
    best = [np.inf] * len(liquids)
    for _ in range(repeats):
        for k, (liquid, state) in enumerate(zip(liquids, states, strict=True)):
            liquid.restore(state)
            start = time.perf_counter()
            liquid.step(1e-3)
            best[k] = min(best[k], time.perf_counter() - start)
    return best


def run(side: int, threads: int, repeats: int) -> None:
    liquids = [
        fluid(side, threads),
        fluid(side, threads, tolerance=0.0, max_tolerance=0.0, max_iterations=10),
        *(fluid(side, threads, **options) for options in TERMS.values()),
    ]
    n = len(liquids[0])
    base, dense, *terms = best_step(liquids, repeats)
    density = (dense - base) / (liquids[1].report.iterations - liquids[0].report.iterations)
    emit(n, "density_iteration", 1e9 * density / n, "ns/particle", threads)
    for name, seconds, liquid in zip(TERMS, terms, liquids[2:], strict=True):
        cost = seconds - base
        if name == "viscosity":
            passes = liquid.report.viscosity_iterations + 1
            emit(n, "viscosity_iterations", passes - 1, "1", threads)
            cost, name = cost / passes, "viscosity_iteration"
        emit(n, name, 1e9 * cost / n, "ns/particle", threads)
        emit(n, f"{name}_passes", cost / density, "1", threads)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one size, two threads")
    quick = parser.parse_args().quick
    for side in (46,) if quick else (46, 80):
        for threads in (2,) if quick else (1, 2):
            run(side, threads, 3 if quick else 7)


if __name__ == "__main__":
    main()
