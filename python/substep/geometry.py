"""Obstacles and meshes that every method shares.

- Obstacles (`Plane`, `Sphere`, `Box`, `SignedDistanceField`): a signed distance, a motion, friction
  and restitution, and the impulse and torque that a step exerted on them.
"""

from __future__ import annotations

from ._colliders import Box, Collider, Plane, SignedDistanceField, Sphere

__all__ = ["Box", "Collider", "Plane", "SignedDistanceField", "Sphere"]
