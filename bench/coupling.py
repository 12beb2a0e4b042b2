"""Worlds: what coupling costs beside the members alone.

Three take turns from the same state on, over intervals of 1/60 s, and the least of six counts:
"coupled", the world; "fixed", its members alone one after the other, the medium with the bodies'
obstacles at rest and the bodies without it; and "moved", the same with obstacles that are moved by
hand along the path that the world's take, so that the medium moves as it does there. All are times
per step that the medium took; "ratio" is coupled over fixed, "ratio to moved" coupled over moved.
"iterations" are those of the medium in the last step, means over the intervals. Triangles
of surfaces are moved, but not deformed, by hand. The ball in a cloth is in contact with it for 24
intervals, from the impact on; there the obstacle moves as the ball does, each interval starts from
the same state, and means count, as the work differs from one to the next. The cases: 12 bodies in a
grid liquid, in a position-based fluid and on sand, a ball in cloths; sand on a cloth of 200
triangles, a soft body on one of 128; then 1 to 1000 in 200,000 particles of each medium.
Processor time on one thread, else time of the clock. Prints JSON lines {workload, peer, metric,
value, unit, threads, isa}.
python bench/coupling.py [--quick] [WORDS ...]: cases with one of these words in their names, or all
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
from substep.base.quaternions import multiply
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


def position_based(size: int, count: int = 12, radius: float = 0.06) -> Made:
    spacing = 0.5 / size
    bodies = balls(count, radius, (0.05, 0.05, 0.1), (0.95, 0.95, 0.5), 600.0)
    tank = substep.Collider(substep.Box((1, 1, 2), (0.5, 0.5, 1)), hollow=True)
    colliders = [tank, *bodies.make_colliders()]
    water = substep.fill_box((0, 0, 0), (1, 1, 0.5), spacing)
    water = water[np.min([c.distance(water) for c in colliders[1:]], axis=0) > spacing / 2]
    return bodies, substep.PositionBasedFluid(water, spacing, colliders=colliders)


def sand(size: int) -> Made:
    return sand_and(size, balls(12, 0.06, (0.05, 0.05, 0.3), (0.95, 0.95, 0.37), 600.0))


def buried(size: int, count: int) -> Made:
    low, high = (0.05, 0.05, 0.05), (0.95, 0.95, 0.25)
    return sand_and(size, balls(count, 0.25 * (0.162 / count) ** (1 / 3), low, high, 600.0))


def sand_and(size: int, bodies: substep.RigidBodies) -> Made:
    spacing = 0.5 / size
    colliders = bodies.make_colliders()
    box = substep.Collider(substep.Box((1, 1, 2), (0.5, 0.5, 1)), hollow=True, friction=0.5)
    x = substep.fill_box((0, 0, 0), (1, 1, 0.3), spacing)
    x = x[np.min([c.distance(x) for c in colliders], axis=0) > 0]
    grains = substep.MaterialPointMethod(
        x,
        Sand(young_modulus=5e5),
        cell=2 * spacing,
        volume=spacing**3,
        colliders=[box, *colliders],
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


def at_rest(medium: Any) -> Any:
    """A copy whose obstacles do not move."""
    fixed = medium.copy()
    for collider in fixed.colliders:
        collider.velocity = collider.angular_velocity = (0, 0, 0)
    return fixed


def move_alike(medium: Any, other: Any, interval: float) -> None:
    """Let the obstacles of a medium get in an interval to where those of the other are."""
    for collider, to in zip(medium.colliders, other.colliders, strict=True):
        collider.velocity = (np.array(to.position) - collider.position) / interval
        back = np.array(collider.rotation) * (1, -1, -1, -1)
        turn = np.array(multiply(np.array(to.rotation), back))
        turn *= -1 if turn[0] < 0 else 1
        sine = np.linalg.norm(turn[1:])
        angle = 2 * np.arctan2(sine, turn[0]) / sine if sine > 0 else 2.0
        collider.angular_velocity = angle * turn[1:] / interval


def clock_of(threads: int) -> Callable[[], float]:
    return time.process_time if threads == 1 else time.perf_counter


def measure(workload: str, make: Callable[[], Made], threads: int, repeats: int) -> None:
    interval, now = 1 / 60, clock_of(threads)
    bodies, medium = make()
    world = substep.World({"bodies": bodies, "medium": medium}, threads=threads)
    world.advance(6 * interval)  # until they meet
    fixed, moved = at_rest(medium), at_rest(medium)
    fall = bodies.copy()
    times: dict[str, list[float]] = {name: [] for name in ("fixed", "moved", "bodies", "coupled")}
    iterations: dict[str, list[int]] = {name: [] for name in times}

    def take(name: str, of: Any, simulation: Any) -> None:
        start = now()
        simulation.advance(interval)
        times[name].append((now() - start) / of.report.steps)
        if hasattr(of.report, "iterations"):
            iterations[name].append(of.report.iterations)

    for _ in range(repeats):
        take("fixed", fixed, fixed)
        take("coupled", medium, world)
        move_alike(moved, medium, interval)
        take("moved", moved, moved)
        start = now()
        fall.advance(interval)
        times["bodies"].append((now() - start) / medium.report.steps)
    least = {name: min(taken) for name, taken in times.items()}
    for name in ("fixed", "moved"):
        least[name] += least["bodies"]
    for name, value in least.items():
        emit(workload, name, 1e3 * value, "ms", threads)
        if any(iterations[name]):
            emit(workload, f"{name} iterations", float(np.mean(iterations[name])), "1", threads)
    emit(workload, "ratio", least["coupled"] / least["fixed"], "1", threads)
    emit(workload, "ratio to moved", least["coupled"] / least["moved"], "1", threads)


def measure_in_contact(workload: str, make: Callable[[], Made], threads: int) -> None:
    """The same of a world with one body, beside an obstacle that moves as that body does."""
    interval, now = 1 / 60, clock_of(threads)
    bodies, medium = make()
    world = substep.World({"bodies": bodies, "medium": medium}, threads=threads)
    free, fixed = bodies.copy(), medium.copy()
    fixed.advance(interval)  # makes what is made once
    world.advance(8 * interval)
    times = {"moved": 0.0, "coupled": 0.0}
    for _ in range(24):
        fixed.restore(medium.state())
        before = bodies.centers_of_mass.copy()
        start = now()
        world.advance(interval)
        times["coupled"] += (now() - start) / medium.report.steps
        for collider in fixed.colliders:
            collider.velocity = (bodies.centers_of_mass - before)[0] / interval
            collider.angular_velocity = bodies.angular_velocities[0]
        start = now()
        fixed.advance(interval)
        free.advance(interval)
        times["moved"] += (now() - start) / fixed.report.steps
    for name, taken in times.items():
        emit(workload, name, 1e3 * taken / 24, "ms", threads)
    emit(workload, "ratio to moved", times["coupled"] / times["moved"], "1", threads)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small ones, one thread")
    parser.add_argument("words", nargs="*", help="in the names of the cases to run")
    arguments = parser.parse_args()
    quick = arguments.quick
    size, repeats = (12, 2) if quick else (36, 6)
    cases: dict[str, Callable[[], Made]] = {
        "12 balls, grid liquid": lambda: grid_liquid(size),
        "12 balls, position-based fluid": lambda: position_based(size // 2),
        "12 balls, sand": lambda: sand(size),
        "sand on cloth": lambda: sand_on_cloth(2 * size),
        "little sand on cloth": lambda: sand_on_cloth(2 * size // 3),
        "soft body on cloth": lambda: soft_body_on_cloth(size // 7),
    }
    for count in (1, 10) if quick else (1, 10, 100, 1000):
        radius = 0.25 * (0.4 / count) ** (1 / 3)
        more: dict[str, Callable[[], Made]] = {
            "grid liquid": lambda n=count, r=radius: grid_liquid(size, n, r),
            "position-based fluid": lambda n=count, r=radius: position_based(size, n, r),
            "sand": lambda n=count: buried(11 * size // 9, n),
        }
        cases |= {f"{count} balls, 200,000 of {name}": make for name, make in more.items()}
    cloths = {f"a ball, cloth {n} x {n}": n for n in ((16,) if quick else (16, 32, 48))}

    def is_asked(name: str) -> bool:
        return not arguments.words or any(word in name for word in arguments.words)

    for threads in (1,) if quick else (1, 2):
        for name, make in cases.items():
            if is_asked(name):
                measure(name, make, threads, repeats)
        for name, n in cloths.items():
            if is_asked(name):
                measure_in_contact(name, lambda n=n: cloth(n), threads)


if __name__ == "__main__":
    main()
