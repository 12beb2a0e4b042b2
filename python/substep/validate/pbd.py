"""Measured for `substep validate`: constraints of position-based dynamics."""

from __future__ import annotations

import math

import numpy as np

from ..geometry import Collider, Plane
from ..pbd import Distance, PositionBasedDynamics

G = 9.81


def rest_of_a_spring(step: float, substeps: int, iterations: int = 1) -> float:
    """How far 2 kg stretch a spring of 1000 N/m [m]."""
    body = PositionBasedDynamics(
        [[0, 0, 0], [0, 0, -1]],
        2.0,
        [Distance([[0, 1]], compliance=1e-3, damping=60.0)],
        pinned=[0],
        step=step,
        substeps=substeps,
        iterations=iterations,
        dtype="float64",
    )
    body.advance(6.0)
    return float(-body.positions[1, 2] - 1)


def implicit_euler_error() -> float:
    """Largest distance of a hanging mass from implicit Euler's in closed form, 200 steps [m]."""
    alpha, mass, h = 1 / 500, 2.0, 1 / 120
    body = PositionBasedDynamics(
        [[0, 0, 0], [0, 0, -1]],
        mass,
        [Distance([[0, 1]], compliance=alpha)],
        velocities=[[0.0, 0.0, 0.0], [0.0, 0.0, -0.3]],
        pinned=[0],
        substeps=1,
        iterations=1,
        dtype="float64",
    )
    stretch, v, worst = 0.0, 0.3, 0.0
    for _ in range(200):
        v = (mass * v + h * (mass * G - stretch / alpha)) / (mass + h * h / alpha)
        stretch += h * v
        body.step(h)
        worst = max(worst, abs(-body.positions[1, 2] - 1 - stretch))
    return float(worst)


def top_link(substeps: int, iterations: int) -> float:
    """How far the first of ten links is stretched by the chain below it [m]."""
    links = 10
    x = np.zeros((links + 1, 3))
    x[:, 2] = -0.1 * np.arange(links + 1)
    body = PositionBasedDynamics(
        x,
        0.5,
        [Distance([[k, k + 1] for k in range(links)], compliance=1e-4)],
        pinned=[0],
        drag=4.0,
        substeps=substeps,
        iterations=iterations,
        dtype="float64",
    )
    body.advance(5.0)
    return float(body.positions[0, 2] - body.positions[1, 2] - 0.1)


def pendulum_period() -> float:
    """Period of a pendulum of 1 m that swings by 5 degrees [s]."""
    angle = math.radians(5)
    body = PositionBasedDynamics(
        [[0.0, 0.0, 0.0], [math.sin(angle), 0.0, -math.cos(angle)]],
        1.0,
        [Distance([[0, 1]])],
        pinned=[0],
        step=1 / 200,
        substeps=10,
        dtype="float64",
    )
    times, x = [], []
    while body.time < 9:
        body.step()
        times.append(body.time)
        x.append(body.positions[1, 0])
    t, at = np.array(times), np.array(x)
    k = np.flatnonzero((at[:-1] > 0) & (at[1:] <= 0))
    return float(np.diff(t[k] + at[k] * (t[k + 1] - t[k]) / (at[k] - at[k + 1])).mean())


def sliding_speed(degrees: float, friction: float) -> float:
    """Speed of a block of particles down a slope after 1 s [m/s]."""
    axes = [0.1 * np.arange(4), 0.1 * np.arange(4), 0.02 + 0.1 * np.arange(3)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distances = np.linalg.norm(x[:, None] - x[None], axis=-1)
    angle = math.radians(degrees)
    body = PositionBasedDynamics(
        x,
        0.1,
        [Distance(np.argwhere(np.triu(distances < 0.18, 1)))],
        contact_margin=0.02,
        gravity=(G * math.sin(angle), 0.0, -G * math.cos(angle)),
        colliders=[Collider(Plane(), friction=friction)],
    )
    body.advance(1.0)
    return float(body.velocities[:, 0].mean())


def rebound(restitution: float) -> float:
    """Height to which a particle that fell from 1 m comes back [m]."""
    floor = Collider(Plane(), restitution=restitution)
    ball = PositionBasedDynamics(
        [[0.0, 0.0, 1.01]], 0.1, [], contact_margin=0.01, colliders=[floor], dtype="float64"
    )
    fall, highest = math.sqrt(2 / G), 0.0
    while ball.time < fall * (1 + 2 * restitution) - 0.02:
        ball.step(1e-3)
        if ball.time > fall + 0.01:
            highest = max(highest, float(ball.positions[0, 2]) - 0.01)
    return highest
