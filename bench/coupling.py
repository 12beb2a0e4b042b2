"""Worlds: what coupling costs beside the members alone with obstacles that stand still.

"fixed" is the time of the members on their own over an interval, one after the other, over the
number of steps that the medium took: the medium with the bodies' obstacles at rest, and the bodies
without it. "coupled" is that of the world, and "ratio" the one over the other; both start from the
same state, and the least of six intervals counts, taken in turns. The ball in a cloth is in contact
with it for 24 intervals, from the impact on; there the obstacle moves as the ball does, each
interval starts from the same state, and means count, as the work differs from one to the next. The
cases: 12 bodies in a grid
liquid, in a position-based fluid and on sand, a ball in a cloth; sand on a cloth of 200 triangles,
a soft body on one of 128; then 1 to 1000 balls in 200,000 particles. Prints JSON lines {workload,
peer, metric, value, unit, threads, isa}.
python bench/coupling.py [--quick]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import substep
from substep import _core
from substep.mpm import Sand

Made = tuple[Any, Any]


def emit(workload: str, metric: str, value: float, unit: str, threads: int) -> None:
    record = dict(workload=workload, peer="substep", metric=metric, value=float(f"{value:.4g}"))
    print(json.dumps({**record, "unit": unit, "threads": threads, "isa": _core.level}), flush=True)


def balls(count: int, radius: float, low: Any, high: Any, density: float) -> substep.RigidBodies:
    """Some balls on a lattice in a box."""
    low, high = np.array(low), np.array(high)
    spacing = (np.prod(high - low) / count) ** (1 / 3)
    n = np.maximum(1, np.round((high - low) / spacing)).astype(int)
    while n.prod() < count:
        n[np.argmax((high - low) / n)] += 1
    axes = [
        lo + (hi - lo) * (np.arange(k) + 0.5) / k for lo, hi, k in zip(low, high, n, strict=True)
    ]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)[:count]
    bodies = substep.RigidBodies(gravity=(0, 0, -9.81))
    bodies.add(substep.Sphere(radius), x, density=density)
    return bodies


def grid_liquid(size: int, count: int = 12, radius: float = 0.06) -> Made:
    cell = 1 / size
    bodies = balls(count, radius, (0.05, 0.05, 0.1), (0.95, 0.95, 0.5), 600.0)
    colliders = bodies.make_colliders()
    water = substep.fill_box((0, 0, 0), (1, 1, 0.5), cell / 2)
    water = water[np.min([c.distance(water) for c in colliders], axis=0) > 0]
    bounds = ((0, 0, 0), (1, 1, 1))
    return bodies, substep.GridLiquid(water, cell=cell, bounds=bounds, colliders=colliders)


def position_based(size: int) -> Made:
    spacing = 0.5 / size
    bodies = balls(12, 0.06, (0.05, 0.05, 0.1), (0.95, 0.95, 0.5), 600.0)
    tank = substep.Collider(substep.Box((1, 1, 2), (0.5, 0.5, 1)), hollow=True)
    colliders = [tank, *bodies.make_colliders()]
    water = substep.fill_box((0, 0, 0), (1, 1, 0.5), spacing)
    water = water[np.min([c.distance(water) for c in colliders[1:]], axis=0) > spacing / 2]
    return bodies, substep.PositionBasedFluid(water, spacing, colliders=colliders)


def sand(size: int) -> Made:
    spacing = 0.5 / size
    bodies = balls(12, 0.06, (0.05, 0.05, 0.3), (0.95, 0.95, 0.37), 600.0)
    box = substep.Collider(substep.Box((1, 1, 2), (0.5, 0.5, 1)), hollow=True, friction=0.5)
    x = substep.fill_box((0, 0, 0), (1, 1, 0.3), spacing)
    grains = substep.MaterialPointMethod(
        x,
        Sand(young_modulus=5e5),
        cell=2 * spacing,
        volume=spacing**3,
        colliders=[box, *bodies.make_colliders()],
    )
    return bodies, grains


def cloth(size: int) -> Made:
    bodies = balls(1, 0.2, (-0.3, -0.3, 0.2), (0.3, 0.3, 0.25), 200.0)
    grid = substep.geometry.grid_mesh(size, size, (1, 1))
    edges, stiffness = substep.springs.grid_springs(
        size, size, stiffness=1000.0, shear=0.3, bending=0.02
    )
    rim = np.abs(grid.vertices[:, :2]).max(axis=1) > 0.5 - 1e-9
    return bodies, substep.MassSpring(
        grid.vertices,
        edges,
        stiffness,
        0.5 / len(grid.vertices),
        pinned=rim,
        colliders=bodies.make_colliders(),
        contact_margin=0.01,
        step=1 / 60,
    )


def sand_on_cloth(size: int) -> Made:
    grid = substep.geometry.grid_mesh(11, 11, (1, 1))
    rim = np.abs(grid.vertices[:, :2]).max(axis=1) > 0.5 - 1e-9
    sheet = substep.MassSpring.from_mesh(
        grid, density=2.0, stiffness=2e3, damping_time=0.05, pinned=rim, step=1 / 240
    )
    spacing = 0.9 / size
    low = 2.1 * spacing
    return sheet, substep.MaterialPointMethod(
        substep.fill_box((-0.4, -0.4, low), (0.4, 0.4, low + 0.15), spacing),
        Sand(young_modulus=5e5),
        cell=2 * spacing,
        volume=spacing**3,
        colliders=sheet.make_colliders(4 * spacing, friction=0.4),
    )


def soft_body_on_cloth(size: int) -> Made:
    grid = substep.geometry.grid_mesh(9, 9, (0.8, 0.8))
    rim = np.abs(grid.vertices[:, :2]).max(axis=1) > 0.4 - 1e-9
    sheet = substep.MassSpring.from_mesh(
        grid, density=2.0, stiffness=2e3, damping_time=0.05, pinned=rim, step=1 / 240
    )
    mesh = substep.geometry.box_tetrahedra((0.2, 0.2, 0.2), (size, size, size))
    return sheet, substep.SoftBody(
        mesh.vertices + np.array([0, 0, 0.155]),
        mesh.tetrahedra,
        density=500.0,
        young_modulus=5e4,
        poisson_ratio=0.3,
        step=1 / 240,
        colliders=sheet.make_colliders(0.1, friction=0.3),
    )


def measure(workload: str, make: Callable[[], Made], threads: int, repeats: int) -> None:
    interval = 1 / 60
    bodies, medium = make()
    world = substep.World({"bodies": bodies, "medium": medium}, threads=threads)
    world.advance(6 * interval)  # until they meet
    free, fixed = bodies.copy(), medium.copy()
    for collider in fixed.colliders:
        collider.velocity = collider.angular_velocity = (0, 0, 0)
    times: dict[str, list[float]] = {"fixed": [], "coupled": []}
    for _ in range(repeats):
        start = time.perf_counter()
        fixed.advance(interval)
        free.advance(interval)
        times["fixed"].append((time.perf_counter() - start) / fixed.report.steps)
        start = time.perf_counter()
        world.advance(interval)
        times["coupled"].append((time.perf_counter() - start) / medium.report.steps)
    for name, taken in times.items():
        emit(workload, name, 1e3 * min(taken), "ms", threads)
    emit(workload, "ratio", min(times["coupled"]) / min(times["fixed"]), "1", threads)


def measure_in_contact(workload: str, make: Callable[[], Made], threads: int) -> None:
    """The same of a world with one body, beside an obstacle that moves as that body does."""
    interval = 1 / 60
    bodies, medium = make()
    world = substep.World({"bodies": bodies, "medium": medium}, threads=threads)
    free, fixed = bodies.copy(), medium.copy()
    fixed.advance(interval)  # makes what is made once
    world.advance(8 * interval)
    times = {"fixed": 0.0, "coupled": 0.0}
    for _ in range(24):
        fixed.restore(medium.state())
        before = bodies.centers_of_mass.copy()
        start = time.perf_counter()
        world.advance(interval)
        times["coupled"] += (time.perf_counter() - start) / medium.report.steps
        for collider in fixed.colliders:
            collider.velocity = (bodies.centers_of_mass - before)[0] / interval
            collider.angular_velocity = bodies.angular_velocities[0]
        start = time.perf_counter()
        fixed.advance(interval)
        free.advance(interval)
        times["fixed"] += (time.perf_counter() - start) / fixed.report.steps
    for name, taken in times.items():
        emit(workload, name, 1e3 * taken / 24, "ms", threads)
    emit(workload, "ratio", times["coupled"] / times["fixed"], "1", threads)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small ones, one thread")
    quick = parser.parse_args().quick
    size, repeats = (12, 2) if quick else (36, 6)
    cases: dict[str, Callable[[], Made]] = {
        "12 balls, grid liquid": lambda: grid_liquid(size),
        "12 balls, position-based fluid": lambda: position_based(size // 2),
        "12 balls, sand": lambda: sand(size),
        "sand on cloth": lambda: sand_on_cloth(2 * size),
        "soft body on cloth": lambda: soft_body_on_cloth(size // 7),
    }
    for count in (1, 10) if quick else (1, 10, 100, 1000):
        radius = 0.25 * (0.4 / count) ** (1 / 3)
        cases[f"{count} balls, grid liquid"] = lambda count=count, radius=radius: grid_liquid(
            size, count, radius
        )
    for threads in (1,) if quick else (1, 2):
        for name, make in cases.items():
            measure(name, make, threads, repeats)
        measure_in_contact("a ball, cloth", lambda: cloth(4 * size // 3), threads)


if __name__ == "__main__":
    main()
