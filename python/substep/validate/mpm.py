"""Measured for `substep validate`: elastic bodies, sand and liquids of material points."""

from __future__ import annotations

import math

import numpy as np

from ..geometry import Box, Collider, Plane
from ..mpm import Fluid, MaterialPointMethod, NeoHookean, Sand
from .measuring import lattice, period

G = 9.81


def bar_period(cells: int, kernel: str, modulus: float = 100.0) -> float:
    """Period of the first mode of a bar of 25 m that is fixed at one end [s]."""
    length, cell = 25.0, 25.0 / cells
    x = lattice((0, 0), (length, 2 * cell), cell / 2)
    v = np.zeros_like(x)
    v[:, 0] = 0.1 * np.sin(np.pi * x[:, 0] / (2 * length))
    bar = MaterialPointMethod(
        x,
        NeoHookean(density=1.0, young_modulus=modulus, poisson_ratio=0.0),
        cell=cell,
        volume=(cell / 2) ** 2,
        velocities=v,
        gravity=(0, 0),
        colliders=[Plane((1, 0, 0))],
        boundary="sticky",
        kernel=kernel,
        form="mls" if kernel == "quadratic" else "textbook",
        transfer="flip",
        dtype="float64",
        step=0.01 * cell,
        largest_step=1.0,
    )
    times, u = [], []
    while bar.time < 18:
        bar.advance(0.1)
        times.append(bar.time)
        u.append(bar.velocities[:, 0].mean())
    return period(times, u)


def slope_angle(friction_degrees: float) -> float:
    """Angle of friction of a layer of sand that slides down rough ground [degrees]."""
    cell, cells, length = 0.05, 8, 300
    tilt = math.atan(math.sin(math.radians(friction_degrees))) + math.radians(1)
    weight = 1600 * G * cells * cell
    x = lattice((0, 0), (length * cell, cells * cell), cell / 2)
    sand = MaterialPointMethod(
        x,
        Sand(young_modulus=100 * weight, friction_angle=math.radians(friction_degrees)),
        cell=cell,
        volume=(cell / 2) ** 2,
        gravity=(G * math.sin(tilt), -G * math.cos(tilt)),
        colliders=[Plane((0, 1, 0))],
        boundary="sticky",
    )
    middle = np.abs(x[:, 0] - x[:, 0].mean()) < 0.15 * length * cell
    speeds = []
    for duration in (0.5, 1.0):
        sand.advance(duration)
        speeds.append(sand.velocities[middle, 0].mean())
    return math.degrees(math.atan(math.tan(tilt) - (speeds[1] - speeds[0]) / (G * math.cos(tilt))))


def run_out(aspect: float, cells: int, degrees: float = 30.0) -> float:
    """How far a column of sand collapses, over its half width."""
    h = 0.5 / cells
    sand = Sand(
        density=1600.0,
        young_modulus=1e6,
        poisson_ratio=0.3,
        friction_angle=math.radians(degrees),
        match="plane_strain",
    )
    column = MaterialPointMethod(
        lattice((0, 0), (1, aspect), h),
        sand,
        cell=1 / cells,
        volume=h**2,
        cfl=0.4,
        colliders=[
            Collider(Plane((0, 1, 0)), friction=math.tan(math.radians(30))),
            Collider(Plane((1, 0, 0))),
        ],
        boundary=["separate", "slip"],
    )
    column.advance(8 * math.sqrt(aspect / G))
    return float(np.quantile(column.positions[:, 0], 0.99)) - 1


def pool_depth() -> float:
    """Depth of a pool of liquid at rest in a tank over the one that its volume gives."""
    d = 0.025
    tank = Collider(Box((1, 2, 1), (0.5, 1, 0)), hollow=True, friction=0)
    pool = MaterialPointMethod(
        lattice((0, 0), (1, 0.5), d),
        Fluid(bulk_modulus=4e6),
        cell=2 * d,
        volume=d * d,
        colliders=[tank],
    )
    pool.advance(2.0)
    return float(2 * pool.positions[:, 1].mean() / 0.5)


def floor_load() -> float:
    """Force of a block of jelly at rest on the floor over its weight."""
    d, floor = 0.025, Collider(Plane((0, 1, 0)))
    block = MaterialPointMethod(
        lattice((0, 0), (0.4, 0.2), d),
        NeoHookean(density=1000.0, young_modulus=1e5, poisson_ratio=0.3),
        cell=2 * d,
        volume=d * d,
        colliders=[floor],
    )
    block.advance(2.0)
    block.advance(1.0)
    return float(-floor.impulse[1] / floor.duration / (G * block.masses.sum()))
