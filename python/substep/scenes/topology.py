"""What holds the points of a simulation together, so that it is drawn as lines or as a surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import TetMesh
from ..pbd import PositionBasedDynamics, SelfCollision
from ..springs import MassSpring, SoftBody

Indices = NDArray[np.int64]


def topology_of(simulation: Any) -> dict[str, Indices]:
    """Arguments of a `Part` of kind mesh, or none where a particle would be left out."""
    if isinstance(simulation, SoftBody):
        return {"tetrahedra": simulation.mesh.tetrahedra}
    found: dict[str, Indices] = {}
    if isinstance(simulation, MassSpring):
        has_faces = simulation.faces is not None and len(simulation.faces) > 0
        found = {"triangles": simulation.faces} if has_faces else {"edges": simulation.edges}
    elif isinstance(simulation, PositionBasedDynamics) and simulation.dimension == 3:
        found = {"triangles": _triangles(simulation)}
    held = np.unique(np.concatenate([rows.ravel() for rows in found.values()] or [[]]))
    return found if len(held) == len(simulation) > 0 else {}


def _triangles(simulation: PositionBasedDynamics) -> Indices:
    """Those whose bending or collision is constrained, and the surfaces of tetrahedra that are."""
    faces: list[Indices] = [np.zeros((0, 3), np.int64)]
    for constraint in simulation.constraints:
        name = getattr(constraint, "_name", None)  # of what the particles are
        if isinstance(constraint, SelfCollision):
            faces.append(constraint.faces)
        elif name == "triangles":
            faces.append(constraint.particles)
        elif name == "hinges":  # (a, b, c) and (b, a, d)
            faces += [constraint.particles[:, [0, 1, 2]], constraint.particles[:, [1, 0, 3]]]
        elif name == "tetrahedra":
            solid = TetMesh(simulation.positions, constraint.particles)
            faces.append(solid.surface_faces)
    found = np.concatenate(faces).astype(np.int64)
    _, first = np.unique(np.sort(found, axis=1), axis=0, return_index=True)
    return found[np.sort(first)]
