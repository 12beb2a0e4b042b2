"""Measured for `substep validate`: liquids of particles."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..geometry import Box, Collider, Plane
from ..pbf import PositionBasedFluid, fill_box
from .measuring import MARTIN_MOYCE, front_error, period

G = 9.81


def puddle(friction: float) -> float:
    """Acceleration by a floor that slides beneath a puddle, over gravity."""
    floor = Collider(Plane(), friction=friction, velocity=(2, 0, 0))
    d = 0.02
    liquid = PositionBasedFluid(
        fill_box((0, 0, 0), (12 * d, 12 * d, 4 * d), d), d, colliders=[floor], divergence_free=True
    )
    speeds = []
    for _ in range(2):
        for _ in range(100):
            liquid.step(2e-3)
        speeds.append(liquid.velocities[:, 0].mean())
    return float(speeds[1] - speeds[0]) / (0.2 * G)


def shear_wave(viscosity: float, told: float | None = None) -> float:
    """Viscosity by which u_x = cos(pi z) decays [m^2/s]; `told` is what the liquid is given."""
    d = 1 / 32
    x = fill_box((0, 0), (3, 1), d)
    v = np.zeros_like(x)
    v[:, 0] = np.cos(np.pi * x[:, 1])
    fluid = PositionBasedFluid(
        x, d, velocities=v, gravity=(0, 0), viscosity=viscosity if told is None else told
    )
    times, amplitudes = [0.0], [1.0]
    for _ in range(48):
        fluid.step(0.2 * d)
        y, u = fluid.positions, fluid.velocities
        middle = np.abs(y[:, 0] - 1.5) < 0.2
        wave = np.cos(np.pi * (y[middle, 1] - y[:, 1].mean() + 0.5))
        times.append(fluid.time)
        amplitudes.append((wave @ u[middle, 0]) / (wave @ wave))
    return float(-np.polyfit(times, np.log(amplitudes), 1)[0] / np.pi**2)


def weight_on_a_tank() -> float:
    """What the floor of a tank bears over the weight of what it holds."""
    d, n = 0.05, 8
    side = n * d
    tank = Collider(Box((side, side, 2), (side / 2, side / 2, 1)), hollow=True)
    liquid = PositionBasedFluid(
        fill_box((0, 0, 0), (side, side, side), d), d, colliders=[tank], divergence_free=True
    )
    liquid.advance(1.0)
    liquid.advance(1.0)
    return float(-tank.impulse[2] / tank.duration / (G * liquid.masses.sum()))


def sloshing_period(n: int = 40, **options: Any) -> float:
    """Period of the first linear wave in a tank 1 m long and 0.5 m deep [s]."""
    k, depth, amplitude = math.pi, 0.5, 0.01
    omega = math.sqrt(G * k * math.tanh(k * depth))
    x = fill_box((0, 0), (1, depth), 1 / n)
    speed = amplitude * omega / math.sinh(k * depth)
    across, up = k * x[:, 0], k * x[:, 1]
    start = speed * np.stack([np.sin(across) * np.cosh(up), -np.cos(across) * np.sinh(up)], axis=1)
    tank = Collider(Box((1, 3, 1), (0.5, 1.5, 0)), hollow=True)
    liquid = PositionBasedFluid(
        x, 1 / n, velocities=start, colliders=[tank], divergence_free=True, **options
    )
    times, centres = [], []
    while liquid.time < 3.6:
        liquid.step()
        times.append(liquid.time)
        centres.append(liquid.positions[:, 0].mean() - 0.5)
    return period(times, centres)


def dam_break(cells: int) -> float:
    """Largest relative error of the front of a dam break against Martin and Moyce."""
    d = 1 / cells
    wide = round(0.5 / d)
    tank = Collider(Box((4, wide * d, 8), (2, wide * d / 2, 4)), hollow=True)
    liquid = PositionBasedFluid(
        fill_box((0, 0, 0), (1, wide * d, 2), d),
        d,
        colliders=[tank],
        max_iterations=5,
        step=0.4 * d / math.sqrt(2 * G * 2),
        divergence_free=True,
    )
    times, front = [0.0], [1.0]
    while times[-1] < 3.5:
        for _ in range(4):
            liquid.step()
        times.append(liquid.time * math.sqrt(2 * G))
        front.append(np.quantile(liquid.positions[:, 0], 0.999) + d / 2)
    return front_error(times, front, MARTIN_MOYCE)
