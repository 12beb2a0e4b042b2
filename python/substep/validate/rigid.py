"""Measured for `substep validate`: motion, contact, friction and joints of rigid bodies."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from ..geometry import Box, Cylinder, Plane, Sphere
from ..rigid import RigidBodies, free_rotation

G = 9.81


def flat(friction: float = 0.5, **options: Any) -> RigidBodies:
    """A world with a floor at 0."""
    bodies = RigidBodies(**options)
    bodies.add(Plane(), (0, 0, 0), motion="static", friction=friction)
    return bodies


def turns_over() -> float:
    """Time in which a plate that spins about its middle axis turns over [s]."""
    inertia = np.array([[0.29 / 12, 1.04 / 12, 1.25 / 12]])
    momentum = inertia * [[0.01, 5.0, 0.0]]
    q, t, before = np.array([[1.0, 0, 0, 0]]), 0.0, 1.0
    passages: list[float] = []
    while len(passages) < 3:
        q = free_rotation(q, momentum, inertia, 1e-3)
        t += 1e-3
        w, x, y, z = q[0]
        row = np.array([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])
        # The second axis of the body, against the fixed momentum.
        along = float(row @ momentum[0]) / float(np.linalg.norm(momentum))
        if along * before < 0:
            passages.append(t - 1e-3 * along / (along - before))
        before = along
    return (passages[2] - passages[0]) / 2


def precession() -> float:
    """Rate at which the axis of a symmetric top goes round, over L / I_1."""
    i1, i3, spin = 0.3, 0.5, np.array([[0.3, -0.4, 1.2]])
    rate = float(np.linalg.norm(spin)) / i1
    inertia, start = np.array([[i1, i1, i3]]), np.array([[1.0, 0, 0, 0]])

    def axis(t: float) -> np.ndarray:
        w, x, y, z = free_rotation(start, spin, inertia, t)[0]
        return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])

    up = spin[0] / np.linalg.norm(spin)
    first = np.cross(up, axis(0.0))
    turned = np.cross(up, axis(0.5 / rate))
    angle = math.atan2(float(np.cross(first, turned) @ up), float(first @ turned))
    return angle / 0.5


def pendulum(degrees: float) -> float:
    """Period over that of small swings of a ball on a hinge 1 m above its centre."""
    radius, angle = 0.05, math.radians(degrees)
    bodies = RigidBodies(step=1 / 240, sleeping=False)
    bob = bodies.add(Sphere(radius), (math.sin(angle), 0, -math.cos(angle)), mass=1.0)
    bodies.hinge(bob, None, (0, 0, 0), (0, 1, 0))
    seen: list[tuple[float, float]] = []
    bodies.advance(9.0, lambda b: seen.append((b.time, b.positions[bob, 0])))
    t, x = np.array(seen).T
    k = np.flatnonzero((x[:-1] < 0) & (x[1:] >= 0))
    period = np.diff(t[k] - x[k] * (t[k + 1] - t[k]) / (x[k + 1] - x[k])).mean()
    return float(period / (2 * math.pi * math.sqrt((1 + 0.4 * radius**2) / G)))


def fall() -> float:
    """How far a box falls in 2 s [m]."""
    bodies = RigidBodies()
    k = bodies.add(Box((0.3, 0.2, 0.1)), (0, 0, 100))
    bodies.advance(2.0)
    return float(100 - bodies.positions[k, 2])


def down_a_slope(shape: str, degrees: float, friction: float) -> float:
    """Acceleration of a box or a ball on a slope [m/s^2]."""
    angle = math.radians(degrees)
    normal = np.array([math.sin(angle), 0, math.cos(angle)])
    down = np.array([math.cos(angle), 0, -math.sin(angle)])
    bodies = RigidBodies(sleeping=False)
    bodies.add(Plane(normal), (0, 0, 0), motion="static", friction=friction)
    solid = Box((0.4, 0.4, 0.4)) if shape == "box" else Sphere(0.2)
    turn = (math.cos(angle / 2), 0, math.sin(angle / 2), 0)
    k = bodies.add(solid, 0.2 * normal, turn, friction=friction)
    bodies.advance(0.25)
    first = bodies.velocities[k] @ down
    bodies.advance(1.0)
    return float(bodies.velocities[k] @ down - first)


def rolling_speed() -> float:
    """Part of its speed that is left to a ball that was thrown without spin, once it rolls."""
    bodies = flat(0.3, sleeping=False)
    ball = bodies.add(Sphere(0.1), (0, 0, 0.1), velocities=(2, 0, 0), friction=0.3)
    bodies.advance(1.0)
    return float(bodies.velocities[ball, 0] / 2)


def rebound(restitution: float) -> float:
    """Height to which a ball that fell by 1 m comes back [m]."""
    bodies = flat()
    ball = bodies.add(Sphere(0.25), (0, 0, 1.25), restitution=restitution)
    heights: list[tuple[float, float, float]] = []
    bodies.advance(
        0.7, lambda b: heights.append((b.positions[ball, 2], b.velocities[ball, 2], b.time))
    )
    z = np.array(heights)
    z = z[z[:, 2] > math.sqrt(2 / G) + 0.05]
    return float((z[:, 0] - 0.25 + z[:, 1] ** 2 / (2 * G)).mean())


def cradle() -> float:
    """Speed of the last of five touching balls that the first hits with 1 m/s [m/s]."""
    bodies = RigidBodies(gravity=(0, 0, 0))
    x = np.zeros((5, 3))
    x[:, 0] = 0.2 * np.arange(5)
    x[0, 0] -= 0.05
    v = np.zeros((5, 3))
    v[0, 0] = 1.0
    bodies.add(Sphere(0.1), x, velocities=v, restitution=1.0, friction=0.0)
    bodies.advance(0.5)
    return float(bodies.velocities[-1, 0])


def turntable() -> float:
    """Rate at which a ball circles on a table that turns with 6 rad/s, over that of the table."""
    rate, r, v = 6.0, 0.05, np.array([0.3, 0, 0])
    bodies = RigidBodies(sleeping=False)
    table = Cylinder(3.0, 0.2)
    bodies.add(
        table, (0, 0, -0.1), motion="kinematic", angular_velocities=(0, 0, rate), friction=1.0
    )
    slip = np.cross([0, 0, 1.0], v - np.array([0, rate * 0.5, 0])) / r
    k = bodies.add(
        Sphere(r), (0.5, 0, r), mass=1.0, friction=1.0, velocities=v, angular_velocities=slip
    )
    turned: list[float] = []
    bodies.advance(5.0, lambda b: turned.append(math.atan2(*b.velocities[k, 1::-1])))
    angles = np.unwrap(turned)
    return float((angles[-1] - angles[0]) / (bodies.time - 1 / 60) / rate)


def chain_load() -> float:
    """Force in the first joint of a hanging chain of ten balls over its weight."""
    bodies = RigidBodies(sleeping=False)
    x = np.zeros((10, 3))
    x[:, 2] = -0.3 * np.arange(1, 11)
    links = bodies.add(Sphere(0.1), x, mass=1.0)
    first = bodies.ball(int(links[0]), None, (0, 0, -0.15))
    for a, b in itertools.pairwise(links):
        bodies.ball(int(a), int(b), (bodies.positions[a] + bodies.positions[b]) / 2)
    bodies.advance(1.0)
    return float(np.linalg.norm(first.force) / (10 * G))


def stack_load() -> float:
    """Force on the floor below ten boxes at rest over their weight."""
    bodies = flat(sleeping=False)
    x = np.zeros((10, 3))
    x[:, 2] = 0.1 + 0.2 * np.arange(10)
    boxes = bodies.add(Box((0.2, 0.2, 0.2)), x, mass=1.0)
    bodies.advance(2.0)
    start = bodies.velocities[boxes].sum(axis=0)
    bodies.step()
    change = bodies.velocities[boxes].sum(axis=0) - start
    return float(1 + change[2] * 60 / (10 * G))
