"""What the scenes of ropes, cloth and soft bodies by position-based dynamics share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ...geometry import Collider, TriangleMesh
from ...pbd import PositionBasedDynamics
from ...pbd.group import Constraint
from ..declaration import Parameter

if TYPE_CHECKING:
    from ...recording import Part


def pbd_parameters(substeps: int) -> dict[str, Parameter]:
    """Parameters of every such scene.

    Parameters
    ----------
    substeps : int
        Their default.

    Returns
    -------
    dict of str to Parameter
        By key.
    """
    return {
        "friction": Parameter("coefficient of friction of the obstacles", 0.4, minimum=0),
        "drag": Parameter("rate at which velocities decay", 0.1, unit="1/s", minimum=0),
        "substeps": Parameter("substeps of a step", substeps, minimum=1, maximum=10_000),
        "iterations": Parameter("projections in a substep", 1, minimum=1, maximum=10_000),
        "step": Parameter("time step", 1 / 60, unit="s", above=0),
    }


class Body(PositionBasedDynamics):
    """Particles that constraints hold together, above a ground and obstacles.

    Parameters
    ----------
    positions, masses, constraints
        As for `PositionBasedDynamics`.
    parameters : dict
        Of the scene, with those of `pbd_parameters`.
    part : str
        Name of what is recorded.
    topology : dict
        Its `edges`, `triangles` or `tetrahedra`.
    colliders : sequence of Collider
        Obstacles.
    drawn : mapping of str to TriangleMesh
        What is drawn of them.
    turning : mapping of str to Collider
        Those of them that turn about the origin, with the collider that tells how far.
    lacks : mapping of str to str
        What is wrong with meshes that were read.
    options
        Others of `PositionBasedDynamics`.
    """

    def __init__(
        self,
        positions: ArrayLike,
        masses: ArrayLike,
        constraints: Sequence[Constraint],
        parameters: Mapping[str, Any],
        *,
        part: str,
        topology: Mapping[str, Any],
        colliders: Sequence[Collider],
        drawn: Mapping[str, TriangleMesh],
        turning: Mapping[str, Collider] | None = None,
        lacks: Mapping[str, str] | None = None,
        **options: Any,
    ) -> None:
        self.part, self.topology = part, dict(topology)
        self.obstacles, self.lacks = dict(drawn), dict(lacks or {})
        self.turning = dict(turning or {})
        super().__init__(
            positions,
            masses,
            constraints,
            colliders=colliders,
            drag=parameters["drag"],
            substeps=parameters["substeps"],
            iterations=parameters["iterations"],
            step=parameters["step"],
            **options,
        )

    def clearance(self) -> float:
        """Smallest distance of a particle to an obstacle [m]."""
        x = self.positions
        return min((float(c.distance(x).min()) for c in self.colliders), default=np.inf)

    def strain(self, edges: ArrayLike, lengths: ArrayLike) -> float:
        """Root mean square of the edges' strain."""
        ends = self.positions[np.asarray(edges)]
        now = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        return float(np.sqrt(np.mean((now / np.asarray(lengths) - 1) ** 2)))

    def words(self) -> str:
        """How the run ended."""
        speed = self.diagnostics()["speed"]
        still = f"at rest ({speed:.2g} m/s)" if speed < 0.02 else f"moving, up to {speed:.2g} m/s"
        return f"{still}, smallest distance to an obstacle {1e3 * self.clearance():.2g} mm"

    def parts(self) -> dict[str, Part]:
        """The body with its velocity, and the obstacles."""
        from ...recording import Part

        parts = {self.part: Part("mesh", {"velocity": "m/s"}, **self.topology)}
        for name, mesh in self.obstacles.items():
            moves = name in self.turning
            points = None if moves else mesh.vertices
            parts[name] = Part("mesh", triangles=mesh.faces, points=points)
        return parts

    def frame(self) -> dict[str, dict[str, Any]]:
        """Positions and velocities as float32, which they are computed in."""
        points, velocity = self.positions, self.velocities
        frame = {
            self.part: {
                "points": points.astype(np.float32),
                "velocity": velocity.astype(np.float32),
            }
        }
        for name, collider in self.turning.items():
            w, *u = collider.rotation
            x = self.obstacles[name].vertices
            turned = x + 2 * np.cross(u, np.cross(u, x) + w * x)  # about the origin
            frame[name] = {"points": turned.astype(np.float32)}
        return frame

    def notes(self) -> dict[str, str]:
        """What meshes lack, for the recording."""
        return dict(self.lacks)
