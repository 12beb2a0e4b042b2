"""Measured for `substep validate`: flows that fill their box."""

from __future__ import annotations

import math

import numpy as np

from ..geometry import Collider, Sphere
from ..gridfluid import GridFlow, Inflow, Wall

SQUARE = [(0.0, 0.0), (1.0, 1.0)]


def extreme(values: np.ndarray, sign: int) -> float:
    """The largest of sign times values, by a parabola through three."""
    k = int(np.argmax(sign * values))
    a, b, c = values[k - 1 : k + 2]
    return float(b - (c - a) ** 2 / (8 * (a - 2 * b + c)))


def driven(reynolds: float, n: int, duration: float, start: GridFlow | None = None) -> GridFlow:
    """A lid drives a square of n cells to a side, from the flow of another grid on."""
    flow = GridFlow(
        SQUARE,
        1 / n,
        viscosity=1 / reynolds,
        sides=["wall", ("wall", Wall(velocity=(1.0, 0.0)))],
        velocity=None if start is None else lambda x: start.sample(x)["velocity"],
        cfl=1.2,
        largest_step=1.2 / n,
    )
    flow.advance(duration)
    return flow


def cavity(reynolds: float, *grids: tuple[int, float]) -> float:
    """Least velocity on the vertical line through the middle, over the lid's.

    `grids` are numbers of cells to a side and durations: each flow starts where the one before it
    ended.
    """
    flow = None
    for n, duration in grids:
        flow = driven(reynolds, n, duration, flow)
    assert flow is not None
    return extreme(flow.velocity_faces[0][n // 2], -1)


def nusselt(rayleigh: float, n: int, duration: float) -> float:
    """Nusselt number of the hot wall of a square of air between a hot and a cold one."""
    prandtl = 0.71
    flow = GridFlow(
        SQUARE,
        1 / n,
        viscosity=prandtl,
        sides=[(Wall(temperature=1.0), Wall(temperature=0.0)), "wall"],
        temperature=lambda x: 1 - x[:, 0],
        reference_temperature=0.5,
        thermal_expansion=1.0,
        thermal_diffusivity=1.0,
        gravity=(0, -rayleigh * prandtl),
        largest_step=0.002,
    )
    flow.advance(duration)
    return float((1 - flow.temperature[0]).mean() * 2 * n)


def plates() -> float:
    """Largest velocity between plates over the mean."""
    flow = GridFlow(
        [(0, 0), (4, 1)],
        1 / 16,
        viscosity=0.1,
        velocity=(1.0, 0.0),
        sides=[(Inflow((1.0, 0.0)), "open"), "wall"],
        largest_step=0.05,
    )
    flow.advance(6.0)
    return extreme(flow.velocity_faces[0][48], 1)


def stokes_plate(n: int, viscosity: float = 0.01) -> float:
    """Velocity 0.15 m above a plate, 2 s after it set off with 1 m/s [m/s]."""
    flow = GridFlow(
        [(0, 0), (0.25, 1)],
        1 / n,
        viscosity=viscosity,
        sides=["periodic", (Wall(velocity=(1.0, 0.0)), "wall")],
    )
    flow.advance(2.0)
    return float(np.interp(0.15, flow.positions_of()[0, :, 1], flow.velocity[0, :, 0]))


def eddy_decay(n: int) -> float:
    """Rate at which the energy of a Taylor-Green eddy between slip walls decays [1/s]."""
    k, viscosity = math.pi, 0.01

    def eddy(x: np.ndarray) -> np.ndarray:
        u = np.sin(k * x[:, 0]) * np.cos(k * x[:, 1])
        return np.stack([u, -np.cos(k * x[:, 0]) * np.sin(k * x[:, 1])], axis=1)

    wall = Wall(slip=True)
    flow = GridFlow(
        SQUARE,
        1 / n,
        viscosity=viscosity,
        velocity=eddy,
        sides=[(wall, wall), (wall, wall)],
        dtype="float64",
    )
    before = flow.diagnostics()["kinetic_energy"]
    flow.advance(1.0)
    return math.log(before / flow.diagnostics()["kinetic_energy"])


def growth(n: int, rayleigh: float) -> float:
    """Of rolls of the critical wavelength between plates, in kappa / H^2."""
    nu, cells = math.sqrt(1 / rayleigh), round(2.016 * n)
    k = 2 * math.pi * n / cells
    flow = GridFlow(
        [(0, 0), (cells / n, 1)],
        1 / n,
        viscosity=nu,
        thermal_diffusivity=nu,
        thermal_expansion=1.0,
        gravity=(0, -1),
        temperature=lambda x: (
            0.5 - x[:, 1] + 1e-3 * np.cos(k * x[:, 0]) * np.sin(math.pi * x[:, 1])
        ),
        sides=["periodic", (Wall(temperature=0.5), Wall(temperature=-0.5))],
        dtype="float64",
    )
    flow.advance(20.0)
    before = flow.diagnostics()["kinetic_energy"]
    flow.advance(20.0)
    return math.log(flow.diagnostics()["kinetic_energy"] / before) / 40 / nu


def critical_rayleigh(n: int) -> float:
    """Rayleigh number at which rolls between plates neither grow nor decay."""
    below, above = growth(n, 1600), growth(n, 1800)
    return 1600 - 200 * below / (above - below)


def channel(n: int, top: float, middle: float = 0.2) -> tuple[GridFlow, Collider]:
    """Schaefer and Turek's cylinder in a channel with an inflow whose largest speed is `top`."""
    h = 0.41 / n

    def inflow(x: np.ndarray) -> np.ndarray:
        u = 4 * top * x[:, 1] * (0.41 - x[:, 1]) / 0.41**2
        return np.stack([u, 0 * u], axis=1)

    y = (np.arange(n) + 0.5) * h
    cylinder = Collider(Sphere(0.05, (0.2, middle, 0)))
    flow = GridFlow(
        [(0, 0), (h * round(2.2 / h), 0.41)],
        h,
        viscosity=1e-3,
        velocity=inflow,
        colliders=[cylinder],
        sides=[(Inflow(inflow(np.stack([0 * y, y], axis=1))), "open"), "wall"],
        dtype="float64",
    )
    return flow, cylinder


def drag(n: int) -> float:
    """Drag coefficient of that cylinder at Re 20."""
    flow, cylinder = channel(n, 0.3)
    flow.advance(6.0)
    flow.advance(0.1)
    return float(2 * cylinder.impulse[0] / cylinder.duration / (0.2**2 * 0.1))


def strouhal(n: int) -> float:
    """Strouhal number of that cylinder at Re 100."""
    flow, cylinder = channel(n, 1.5)
    flow.advance(3.0)
    lifts, times = [], []
    for _ in range(400):
        flow.step(0.0025)
        lifts.append(cylinder.impulse[1] / cylinder.duration)
        times.append(flow.time)
    lift, time = np.array(lifts), np.array(times)
    up = np.flatnonzero((lift[:-1] < 0) & (lift[1:] >= 0))
    zero = time[up] - lift[up] * (time[up + 1] - time[up]) / (lift[up + 1] - lift[up])
    return float(0.1 * (len(zero) - 1) / (zero[-1] - zero[0]))


def lock(ratio: float, n: int) -> float:
    """Speed of the light fluid that runs out of a lock over sqrt((1 - 1 / ratio) g H)."""
    length, speed = 6.0, math.sqrt(1 - 1 / ratio)
    slip = Wall(slip=True)
    flow = GridFlow(
        [(0, 0), (length, 1)],
        1 / n,
        smoke=lambda x: (x[:, 0] < length / 2) * 1.0,
        smoke_density=ratio,
        gravity=(0, -1),
        sides=[(slip, slip), (slip, slip)],
    )
    x = flow.positions_of()[:, 0, 0]
    times, fronts = [], []
    flow.advance(1.2 / speed)
    for _ in range(8):
        flow.advance(0.3 / speed)
        times.append(flow.time)
        fronts.append(x[flow.smoke[:, -2:].mean(axis=1) < 0.5].min())
    return float(-np.polyfit(times, fronts, 1)[0] / speed)
