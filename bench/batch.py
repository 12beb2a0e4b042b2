"""Small worlds: world-steps in a second by `Batch`, beside a loop of Python over the simulations.

Each workload is many copies of one simulation, by its number of particles. The loop steps each in
turn; "step_rate" is of a call of `Batch.step(dt)` for each step, and "gain" that over the loop's;
"steps_rate" is of one call for 32 steps, and "overhead" what a step costs more than there, where it
is called alone. Prints JSON lines
{workload, peer, metric, value, unit, threads, isa}.
python bench/batch.py [--quick]
"""

from __future__ import annotations

import argparse
import functools
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import substep
from substep import _core, mpm, pbd

STEPS = 32


def chain(n: int) -> Any:
    """Positions, level."""
    return np.linspace((0, 0, 0), (0.1 * (n - 1), 0, 0), n)


def links(n: int) -> Any:
    """Pairs of neighbours."""
    return np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)


def springs(n: int) -> Any:
    """A chain of springs, explicit."""
    return substep.MassSpring(
        chain(n), links(n), 100.0, 0.1, pinned=[0], integrator="symplectic_euler", step=1e-3
    )


def net(n: int) -> Any:
    """The same, implicit."""
    return substep.MassSpring(chain(n), links(n), 100.0, 0.1, pinned=[0])


def rope(n: int) -> Any:
    """A rope of position-based dynamics."""
    return substep.PositionBasedDynamics(chain(n), 0.1, pbd.rope(n), pinned=[0])


def liquid(n: int) -> Any:
    """A block of a liquid of about n particles that falls."""
    side = round(n ** (1 / 3))
    x = substep.fill_box((0, 0, 0), [0.1 * side] * 3, 0.1)
    return substep.PositionBasedFluid(x, spacing=0.1, step=1e-2)


def jelly(n: int) -> Any:
    """A block of material points that falls."""
    side = round(n ** (1 / 3))
    x, volume = mpm.sample_box((0, 0, 0), [0.05 * side] * 3, 0.05)
    return substep.MaterialPointMethod(
        x, mpm.NeoHookean(1000.0, 1e4, 0.3), cell=0.1, volume=volume, step=1e-3
    )


def best(call: Callable[[], object], tries: int = 3) -> float:
    """Shortest time of a call [s]."""
    times = []
    for _ in range(tries):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def measure(name: str, template: Any, worlds: int) -> None:
    """World-steps in a second."""
    dt = template.step_size
    total = worlds * STEPS
    alone = [template.copy() for _ in range(worlds)]

    def emit(peer: str, metric: str, value: float, unit: str, threads: int) -> None:
        record = dict(workload=name, peer=peer, metric=metric, value=float(f"{value:.4g}"))
        print(json.dumps({**record, "unit": unit, "threads": threads, "isa": _core.level}))

    def loop() -> None:
        for _ in range(STEPS):
            for simulation in alone:
                simulation.step(dt)

    def step(batch: substep.Batch) -> None:
        for _ in range(STEPS):
            batch.step(dt)

    for threads in (1, 2):
        for simulation in alone:
            simulation.threads = threads
        batch = substep.Batch(template, worlds, threads=threads)
        each = total / best(loop)
        single = total / best(functools.partial(step, batch))
        many = total / best(functools.partial(batch.step, dt, STEPS))
        emit("loop", "rate", each, "1/s", threads)
        emit("substep", "step_rate", single, "1/s", threads)
        emit("substep", "steps_rate", many, "1/s", threads)
        emit("substep", "gain", single / each, "1", threads)
        if threads == 1:
            emit("substep", "overhead", 1e6 * (1 / single - 1 / many), "us", threads)


def main() -> None:
    """Print JSON lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    worlds = 100 if parser.parse_args().quick else 500
    for make in (springs, net, rope, liquid, jelly):
        for n in (8, 27, 100):
            template = make(n)
            measure(f"{make.__name__} {len(template)}", template, worlds)


if __name__ == "__main__":
    main()
