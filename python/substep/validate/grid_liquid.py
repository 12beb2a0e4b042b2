"""Measured for `substep validate`: liquids with a free surface on a grid."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..geometry import Collider, Sphere
from ..gridfluid import GridLiquid
from .measuring import MARTIN_MOYCE, front_error, lattice, period

G = 9.81


def pool(n: int, depth: float = 0.5, amplitude: float = 0.0, **options: Any) -> GridLiquid:
    """Water 1 m long, with the velocities of the first standing wave when its surface is flat."""
    cell, k = 1 / n, np.pi
    x = lattice((0, 0), (1, depth), cell / 2)
    rise = amplitude * math.sqrt(G * k * math.tanh(k * depth)) / math.sinh(k * depth)
    across, up = k * x[:, 0], k * x[:, 1]
    v = rise * np.stack([-np.cosh(up) * np.sin(across), np.sinh(up) * np.cos(across)], axis=1)
    bounds = ((0, 0), (1, cell * math.ceil(1.5 * depth / cell)))
    return GridLiquid(x, cell=cell, bounds=bounds, velocities=v, **options)


def pressure() -> float:
    """Pressure 0.25 m below the surface of water at rest [Pa]."""
    water = pool(32)
    for _ in range(40):
        water.step(0.005)
    return float(water.sample_pressure([[0.5, 0.25]])[0])


def sloshing_period(n: int, depth: float, gravity: float = G) -> float:
    """Period of the first linear wave in a tank 1 m long [s]."""
    water = pool(n, depth, amplitude=1 / n, gravity=(0, -gravity))
    times, values = [], []

    def note(water: GridLiquid) -> None:
        times.append(water.time)
        values.append(np.cos(np.pi * water.positions[:, 0]).mean())

    water.advance(4.0, note)
    return period(times, values)


def dam_break(n: int) -> float:
    """Largest relative error of the front of a dam break against Martin and Moyce."""
    a = 0.05715
    water = GridLiquid(
        lattice((0, 0), (a, 2 * a), a / n / 2), cell=a / n, bounds=((0, 0), (12 * a, 2.5 * a))
    )
    times, front = [], []

    def note(water: GridLiquid) -> None:
        times.append(water.time * math.sqrt(2 * G / a))
        front.append(np.quantile(water.positions[:, 0], 0.999) / a)

    water.advance(3.4 / math.sqrt(2 * G / a), note)
    return front_error(times, front, MARTIN_MOYCE)


def film(cells: int, viscosity: float = 0.1) -> float:
    """Speed of the surface of a viscous film of 0.1 m on a slope of 30 degrees [m/s]."""
    height, pull = 0.1, 0.5 * G
    cell = height / cells
    x = lattice((0, 0), (4 * cell, height), cell / 2)
    v = np.zeros(x.shape)
    v[:, 0] = pull / viscosity * (height * x[:, 1] - x[:, 1] ** 2 / 2)
    liquid = GridLiquid(
        x,
        cell=cell,
        bounds=((0, 0), (4 * cell, cell * math.ceil(1.5 * cells))),
        velocities=v,
        gravity=(pull, -G),
        sides=("periodic", "wall"),
        viscosity=viscosity,
    )
    for _ in range(20):
        liquid.step(0.02)
    y = cell * (np.arange(cells) + 0.5)
    u = liquid.cell_velocities[0, :cells, 0]
    fit = np.linalg.lstsq(np.stack([y, y**2], axis=1), u, rcond=None)[0]
    return float(fit @ [height, height**2])


def drop(
    inside: Callable[[np.ndarray], np.ndarray], half: Any, cell: float, **options: Any
) -> GridLiquid:
    """What of a box about 0 is inside, of density 1 and surface tension 1."""
    half = cell * np.ceil(np.asarray(half) / cell)
    x = lattice(-half, half, cell / 2)
    x += np.random.default_rng(0).uniform(-0.2, 0.2, x.shape) * cell / 2
    settings = {"density": 1.0, "surface_tension": 1.0, "gravity": np.zeros(len(half)), **options}
    return GridLiquid(x[inside(x)], cell=cell, bounds=(-half, half), **settings)


def laplace(dimension: int, cells: int) -> float:
    """Pressure in a drop at rest times its radius over the surface tension."""
    liquid = drop(
        lambda x: np.linalg.norm(x, axis=1) < 1, np.full(dimension, 1 + 4 / cells), 1 / cells
    )
    liquid.advance(0.2)
    found = []
    for _ in range(10):
        liquid.step(liquid.step_limit()[0])
        found.append(liquid.pressure[liquid.level_set < -liquid.cell].mean())
    volume = len(liquid) * (liquid.cell / 2) ** dimension
    radius = math.sqrt(volume / math.pi) if dimension == 2 else (0.75 * volume / math.pi) ** (1 / 3)
    return float(np.mean(found) * radius)


def capillary_wave(cells: int, tension: float = 1.0) -> float:
    """Frequency of waves of length 2 on a liquid 0.5 deep [1/s]."""
    a, k = 0.03, math.pi
    liquid = drop(
        lambda x: x[:, 1] < a * np.cos(k * (x[:, 0] + 0.5)),
        (0.5, 0.5),
        1 / cells,
        surface_tension=tension,
    )
    times, heights = [], []
    while liquid.time < 1.5 * 2 * math.pi / math.sqrt(k**3):
        liquid.advance(0.025)
        left, right = liquid.depth([[-0.5], [0.5]])
        times.append(liquid.time)
        heights.append(left - right)
    return 2 * math.pi / period(times, heights)


def lift(n: int) -> float:
    """Force on a ball under water over the weight of the water that it displaces."""
    radius = 0.2
    ball = Collider(Sphere(radius, (0.5, 0.5, 0.4)))
    x = lattice((0, 0, 0), (1, 1, 0.75), 0.5 / n)
    water = GridLiquid(
        x[ball.distance(x) > 0], cell=1 / n, bounds=((0, 0, 0), (1, 1, 1)), colliders=[ball]
    )
    for _ in range(3):
        water.step(0.01)
    weight = 1000 * G * 4 / 3 * math.pi * radius**3
    return float(ball.impulse[2] / ball.duration / weight)
