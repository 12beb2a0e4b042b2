"""Measured for `substep validate`: springs, chains, membranes and cloth."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..errors import SolverError
from ..geometry import Collider, Plane, grid_mesh
from ..springs import MassSpring, grid_springs

G = 9.81


def settle(body: MassSpring, step: float = 0.05, speed: float = 1e-7) -> None:
    """Go on until nothing moves."""
    for _ in range(2000):
        body.step(step)
        if np.abs(body.velocities).max() < speed:
            return
    raise SolverError(f"still moves at {np.abs(body.velocities).max():.3g} m/s")


def catenary(links: int) -> float:
    """Sag of a chain of 1.5 m between two nails that are 1 m apart [m]."""
    x = np.zeros((links + 1, 3))
    x[:, 0] = np.linspace(0, 1, links + 1)
    x[1:-1, 2] = -0.1
    chain = MassSpring(
        x,
        np.stack([np.arange(links), np.arange(1, links + 1)], axis=1),
        1e7,
        np.full(links + 1, 1.5 / links),
        rest_lengths=np.full(links, 1.5 / links),
        pinned=[0, links],
        drag=5.0,
        tolerance=1e-6,
    )
    settle(chain)
    return float(-chain.positions[:, 2].min())


def rod() -> float:
    """How far a rod of 2 m, 3 kg and E A = 5000 N is longer where it hangs [m]."""
    n, length, mass, modulus = 16, 2.0, 3.0, 5000.0
    masses = np.full(n + 1, mass / n)
    masses[[0, n]] /= 2
    x = np.zeros((n + 1, 3))
    x[:, 2] = -np.linspace(0.0, length, n + 1)
    edges = np.stack([np.arange(n), np.arange(1, n + 1)], axis=1)
    body = MassSpring(x, edges, n * modulus / length, masses, pinned=[0], drag=8.0, tolerance=1e-8)
    settle(body)
    return float(-body.positions[n, 2] - length)


def membrane(n: int) -> float:
    """Sag of a square net under its weight over (weight per area) (side)^2 / tension."""
    stiffness, density, d = 50.0, 2.0, 1 / (n - 1)
    mesh = grid_mesh(n, n)
    edges, k = grid_springs(n, n, stiffness=stiffness, shear=0.0, bending=0.0)
    ids, keep = np.arange(n * n).reshape(n, n), k > 0
    body = MassSpring(
        mesh.vertices,
        edges[keep],
        k[keep],
        density * d * d,
        rest_lengths=np.zeros(keep.sum()),
        pinned=np.unique(np.concatenate([ids[0], ids[-1], ids[:, 0], ids[:, -1]])),
        drag=10.0,
        tolerance=1e-9,
    )
    settle(body, step=0.5)
    return float(-body.positions[ids[n // 2, n // 2], 2] * stiffness / (density * G))


def oscillator(integrator: str, step: float, **options: Any) -> MassSpring:
    """A mass of 1 kg on a spring of 100 N/m, 0.1 m from its rest."""
    return MassSpring(
        [[0.0, 0.0, 0.0], [0.0, 0.0, 1.1]],
        [[0, 1]],
        100.0,
        1.0,
        rest_lengths=[1.0],
        pinned=[0],
        gravity=(0, 0, 0),
        integrator=integrator,
        step=step,
        tolerance=1e-10,
        **options,
    )


def period(integrator: str, step: float) -> float:
    """Period of that oscillator, from its passages [s]."""
    body = oscillator(integrator, step)
    passages: list[float] = []
    while len(passages) < 9:
        before = body.positions[1, 2] - 1.0
        body.step()
        after = body.positions[1, 2] - 1.0
        if before * after <= 0:
            passages.append(body.time - step * after / (after - before))
    return float(passages[-1] - passages[0]) / 4


def amplitude_left(integrator: str, step: float) -> float:
    """Factor by which a step changes the amplitude of that oscillator."""
    body = oscillator(integrator, step)

    def amplitude() -> float:
        return math.hypot(body.positions[1, 2] - 1.0, body.velocities[1, 2] / 10.0)

    start = amplitude()
    for _ in range(8):
        body.step()
    return (amplitude() / start) ** (1 / 8)


def decay() -> float:
    """Displacement of the oscillator with a damper of 2 N s/m after 2 s [m]."""
    body = oscillator("velocity_verlet", 1e-3, damping=2.0)
    body.advance(2.0)
    return float(body.positions[1, 2] - 1.0)


def sliding_speed(degrees: float, friction: float) -> float:
    """Speed of cloth on a slope after 2 s [m/s]."""
    angle = math.radians(degrees)
    normal = np.array([math.sin(angle), 0, math.cos(angle)])
    down = np.array([math.cos(angle), 0, -math.sin(angle)])
    mesh = grid_mesh(5, 5, (0.4, 0.4))
    edges, k = grid_springs(5, 5, stiffness=500.0)
    x = mesh.vertices @ np.array([down, [0, 1, 0], normal]) + 5e-4 * normal
    slope = Collider(Plane(normal), friction=friction)
    body = MassSpring(x, edges, k, 0.01, colliders=[slope], tolerance=1e-6)
    for _ in range(120):
        body.step(1 / 60)
    return float((body.velocities @ down).mean())
