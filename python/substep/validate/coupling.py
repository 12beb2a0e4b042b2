"""Measured for `substep validate`: rigid bodies in liquids, on cloth and against soft bodies."""

from __future__ import annotations

import math

import numpy as np

from ..coupling import World
from ..geometry import Box, Collider, Plane, Sphere, box_tetrahedra
from ..gridfluid import GridLiquid
from ..mpm import MaterialPointMethod, Sand
from ..pbf import PositionBasedFluid, fill_box
from ..rigid import RigidBodies
from ..springs import MassSpring, SoftBody
from .measuring import lattice

G = 9.81


def draft(start: float, ratio: float, n: int) -> float:
    """How deep a ball of 1 m floats that was set into water as deep as `start` [m]."""
    depth = 1.5
    bodies = RigidBodies(sleeping=False)
    ball = bodies.add(Sphere(0.5), (1, 1, depth - start + 0.5), density=1000 * ratio)
    obstacles = bodies.make_colliders(ball)
    x = lattice((0, 0, 0), (2, 2, depth), 0.5 / n)
    x = x[obstacles[0].distance(x) > 0]
    water = GridLiquid(x, cell=1 / n, bounds=((0, 0, 0), (2, 2, depth + 1)), colliders=obstacles)
    heights: list[float] = []
    World({"bodies": bodies, "water": water}).advance(
        2.0, lambda world: heights.append(float(bodies.positions[ball, 2]))
    )
    return depth + 0.5 - float(np.mean(heights[len(heights) // 2 :]))


def added_mass(ratio: float) -> float:
    """Acceleration of a ball that is released under water over gravity."""
    n = 8
    bodies = RigidBodies(step=1e-3)
    ball = bodies.add(Sphere(0.5), (2, 2, 2), density=1000 * ratio)
    obstacles = bodies.make_colliders(ball)
    x = lattice((0, 0, 0), (4, 4, 4), 0.5 / n)
    x = x[obstacles[0].distance(x) > 0]
    water = GridLiquid(x, cell=1 / n, bounds=((0, 0, 0), (4, 4, 4.5)), colliders=obstacles)
    world = World({"bodies": bodies, "water": water})
    world.step()
    return float(bodies.velocities[ball, 2] / world.time / G)


def ball_on_springs() -> float:
    """How deep a ball of 1 kg lies between two springs of 100 N/m, stretched from 0.9 m [m]."""
    bodies = RigidBodies(step=0.02, sleeping=False)
    ball = bodies.add(Sphere(0.1), (0, 0, 0.1005), mass=1.0)
    springs = MassSpring(
        [(-1.0, 0, 0), (0, 0, 0), (1, 0, 0)],
        [(0, 1), (1, 2)],
        100.0,
        [0.01] * 3,
        rest_lengths=[0.9, 0.9],
        pinned=[0, 2],
        gravity=(0, 0, 0),
        colliders=bodies.make_colliders(ball),
        damping=20.0,
        tolerance=1e-4,
    )
    World({"bodies": bodies, "springs": springs}).advance(12.0)
    return float(-springs.positions[1, 2])


def momentum_lost() -> float:
    """Change of the momentum of a ball and of the free jelly that it hits [kg m/s]."""
    bodies = RigidBodies(gravity=(0, 0, 0))
    ball = bodies.add(Sphere(0.2), (-0.25, 0.05, 0.1), mass=1.0, velocities=(1, 0, 0.3))
    mesh = box_tetrahedra((0.4, 0.6, 0.6), (3, 5, 5))
    block = SoftBody(
        mesh.vertices + np.array([0.2, 0, 0]),
        mesh.tetrahedra,
        density=1000.0,
        young_modulus=1e4,
        poisson_ratio=0.3,
        gravity=(0, 0, 0),
        colliders=bodies.make_colliders(ball),
    )
    World({"bodies": bodies, "block": block}).advance(0.5)
    after = bodies.velocities[ball] + block.masses @ block.velocities
    assert np.abs(block.velocities).max() > 1e-3
    return float(np.linalg.norm(after - [1, 0, 0.3]))


def raft(ratio: float) -> float:
    """How deep a raft lies in a liquid of particles in the plane, over its height."""
    d, width, height, side, depth = 0.025, 0.6, 0.3, 2.0, 0.6
    bodies = RigidBodies(sleeping=False, gravity=(0, -G, 0))
    raft = bodies.add(
        Box((width, height, 1)), (0, depth + height * (0.5 - ratio), 0), density=1000 * ratio
    )
    obstacles = bodies.make_colliders(raft)
    x = fill_box((-side / 2, 0), (side / 2, depth), d)
    x = x[obstacles[0].distance(np.pad(x, ((0, 0), (0, 1)))) > d / 2 - 1e-9]
    tank = Collider(Box((side, 4, 2), (0, 2, 0)), hollow=True)
    liquid = PositionBasedFluid(x, d, colliders=[*obstacles, tank], divergence_free=True)
    world = World({"bodies": bodies, "liquid": liquid})
    drafts = []
    for k in range(20):
        world.advance(0.1)
        bottom = float(bodies.positions[raft, 1]) - height / 2
        level = (len(liquid) * d * d - width * bottom) / (side - width)
        if k >= 10:
            drafts.append((level - bottom) / height)
    return float(np.mean(drafts))


def pressure_at_rest(degrees: float, poisson_ratio: float) -> float:
    """Thrust of sand at rest on a smooth wall over half its weight per height squared."""
    height, length, cells, density = 0.4, 1.0, 16, 1600.0
    d = height / cells / 2
    bodies = RigidBodies(step=1 / 240, gravity=(0, 0, 0))
    wall = bodies.add(
        Box((0.2, 3 * height, 1)), (-0.1, 1.2 * height, 0), motion="kinematic", friction=0.0
    )
    colliders = bodies.make_colliders(wall)
    sand = Sand(
        density=density,
        young_modulus=600 * density * G * height,
        poisson_ratio=poisson_ratio,
        friction_angle=math.radians(degrees),
    )
    heap = MaterialPointMethod(
        lattice((0, 0), (length, height), d),
        sand,
        cell=2 * d,
        volume=d**2,
        gravity=(0, 0),
        colliders=[
            *colliders,
            Collider(Plane((0, 1, 0)), friction=0.6),
            Collider(Plane((-1, 0, 0), (length, 0, 0))),
        ],
    )
    world = World({"bodies": bodies, "sand": heap})
    for k in range(80):
        heap.gravity = (0, -G * min(1.0, (k + 1) / 40))
        world.step()
        if k % 2:
            heap.set_velocities(0.5 * heap.velocities)
    world.advance(24 / 240)
    wall_force = -colliders[0].impulse[0] / colliders[0].duration
    return float(wall_force / (0.5 * density * G * height**2))


def sag_of_two_springs() -> float:
    """The sag that `ball_on_springs` should find, by bisection [m]."""
    low, high = 0.0, 1.0
    for _ in range(60):
        w = (low + high) / 2
        length = math.hypot(1, w)
        low, high = (low, w) if 200 * (length - 0.9) * w / length > G else (w, high)
    return low
