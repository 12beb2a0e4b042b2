"""Obstacles of other methods that represent the shapes of rigid bodies."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.quaternions import multiply, rotate
from ..geometry import Plane
from ..geometry.colliders import StandIn

Array = NDArray[np.float64]


class BodyCollider(StandIn):
    """An obstacle that represents a shape of a rigid body; `RigidBodies.make_colliders` makes it.

    Give it to one simulation, and that together with the bodies to a `World`, which moves it with
    its body and gives to the body what pushes it. Without a world it is an obstacle like others.

    Attributes
    ----------
    body : int
        Id of the body.
    """

    body: int
    _bodies: Any  # the `RigidBodies`
    _of: ClassVar = ("_user", "_bodies")

    def __repr__(self) -> str:
        return f"BodyCollider({self.shape!r}, body={self.body})"

    def _place(self) -> tuple[Array, Array]:
        """Where the shape is in the frame of its body, and how it is turned there."""
        shape = self.shape
        center = shape.point if isinstance(shape, Plane) else shape.center
        return np.array(center), np.array(shape.rotation)


def colliders_of(bodies: Any, ids: ArrayLike | None) -> list[BodyCollider]:
    """One for each shape of the bodies, where these are now."""
    made = []
    positions, rotations = bodies.positions, bodies.rotations
    for row in bodies._rows_or_all(ids):
        for fixture in bodies._made[row][0]:
            collider = BodyCollider(
                fixture.shape,
                friction=fixture.friction or 0.0,
                restitution=fixture.restitution or 0.0,
            )
            x, q = collider._place()
            collider.position = positions[row] + rotate(rotations[row], x)
            collider.rotation = multiply(rotations[row], q)
            collider.__dict__.update(body=int(bodies._ids[row]), _bodies=bodies)
            made.append(collider)
    return made
