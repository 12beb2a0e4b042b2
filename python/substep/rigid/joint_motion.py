"""How joints move: their axes in the world, and the rates of their coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.quaternions import rotate

Array = NDArray[np.float64]

_X = np.array([1.0, 0.0, 0.0])


def axes(world: Any, row: int) -> Array:
    """The vectors n_a and n_b of a joint, in the world, shape (2, 3)."""
    told, numbers = world._native.joint(row), world._native.state()["joints"][row]
    found = []
    for side, first in (("a", 3), ("b", 10)):  # anchor and axes (x, y, z, w) of either frame
        x, y, z, w = numbers[first : first + 4]
        n, body = rotate(np.array([w, x, y, z]), _X), told[side]
        found.append(n if body < 0 else rotate(world._native.rotations[body], n))
    return np.array(found)


def axis(world: Any, row: int) -> Array:
    """Unit vector of the coordinate."""
    told = world._native.joint(row)
    if told["kind"] != 4:
        n: Array = axes(world, row)[1]
        return n
    d: Array = np.subtract(*told["anchors"])
    return d / max(float(np.linalg.norm(d)), 1e-300)


def speed(world: Any, row: int, kind: str) -> float:
    """Rate of the coordinate: G of docs/rigid_joints.md times the velocities of the bodies."""
    if kind == "fixed":
        return 0.0
    told = world._native.joint(row)
    sides, point = (told["a"], told["b"]), np.array(told["anchors"][0])
    if kind in ("slider", "distance"):
        v_a, v_b = (_velocity(world, body, point) for body in sides)
        return float(axis(world, row) @ (v_a - v_b))
    w_a, w_b = (_spin(world, body) for body in sides)
    n_a, n_b = axes(world, row)
    m = n_b if kind == "hinge" else (n_a + n_b) / max(1 + float(n_a @ n_b), 1e-12)
    return float(m @ (w_a - w_b))


def _spin(world: Any, body: int) -> Array:
    spin: Array = np.zeros(3) if body < 0 else world._native.angular_velocities()[body]
    return spin


def _velocity(world: Any, body: int, point: Array) -> Array:
    """Of what of the body, were it that large, is at a point of the world; 0 of the world."""
    if body < 0:
        return np.zeros(3)
    arm = point - world._native.positions[body]
    v: Array = world._native.velocities()[body] + np.cross(_spin(world, body), arm)
    return v
