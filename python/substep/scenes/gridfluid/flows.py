"""What the scenes of flows on a grid share: how they are recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ...geometry import TriangleMesh

if TYPE_CHECKING:
    from ...recording import Part


class InBox:
    """A flow that is recorded as cells of its box, with the obstacles in it.

    Subclasses put it before `GridFlow`.

    Attributes
    ----------
    recorded : tuple of str
        Names of the fields.
    obstacles : dict of str to TriangleMesh
        What is drawn of them.
    """

    recorded: tuple[str, ...] = ("velocity", "vorticity")
    obstacles: Mapping[str, TriangleMesh] = {}

    def parts(self: Any) -> dict[str, Part]:
        """The cells as `flow`; obstacles, which never move."""
        from ...recording import Part

        units = {name: unit for name, (_, unit) in self.fields(self.recorded).items()}
        parts = {"flow": Part("grid", units, bounds=self.bounds, cell=self.cell)}
        for name, mesh in self.obstacles.items():
            parts[name] = Part("mesh", triangles=mesh.faces, points=mesh.vertices)
        return parts

    def frame(self: Any) -> dict[str, dict[str, Any]]:
        """One frame of `parts`, as float32."""
        fields = self.fields(self.recorded)
        return {"flow": {name: values.astype(np.float32) for name, (values, _) in fields.items()}}
