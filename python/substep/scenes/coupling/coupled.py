"""What the scenes of several methods share: one recording of all members, and their pictures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ...coupling import World
from ...geometry import Plane
from ...rigid import RigidBodies
from ..measured import Measured

if TYPE_CHECKING:
    from ...recording import Part


class Coupled(Measured, World):
    """A world whose members are what scenes of one method are made of.

    Parameters
    ----------
    members : dict
        Simulations with `parts`, `frame` and perhaps `notes`, by name.
    options
        Others of `World`.
    """

    def __init__(self, members: dict[str, Any], **options: Any) -> None:
        super().__init__(members, **options)
        self.measured = {}

    def parts(self) -> dict[str, Part]:
        """Those of all members."""
        return {name: part for m in self.members.values() for name, part in m.parts().items()}

    def frame(self) -> dict[str, dict[str, Any]]:
        """One frame of `parts`."""
        return {name: rows for m in self.members.values() for name, rows in m.frame().items()}

    def notes(self) -> dict[str, str]:
        """Those of the members that have any."""
        told: dict[str, str] = {}
        for member in self.members.values():
            told |= member.notes() if hasattr(member, "notes") else {}
        return told


def add_walls(bodies: RigidBodies, length: float, width: float) -> None:
    """The smooth sides of a tank from 0 to `length` and to `width` [m]."""
    for normal, x in (((1, 0), 0.0), ((-1, 0), length), ((0, 1), 0.0), ((0, -1), width)):
        wall = Plane((*normal, 0), (x * abs(normal[0]), x * abs(normal[1]), 0))
        bodies.add(wall, (0, 0, 0), motion="static", friction=0.0)
