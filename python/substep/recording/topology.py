"""What holds the points of a simulation together, so that it is drawn as lines or as a surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import AnimatedMesh, TetMesh
from ..pbd import PositionBasedDynamics, SelfCollision
from ..rigid import RigidBodies
from ..springs import MassSpring, SoftBody
from .body_shapes import body_shapes


def topology_of(simulation: Any) -> dict[str, Any]:
    """Arguments of a `Part` of kind mesh, or none where a particle would be left out."""
    name, rows = "triangles", np.zeros((0, 3), np.int64)
    if isinstance(simulation, SoftBody):
        name, rows = "tetrahedra", simulation.mesh.tetrahedra
    elif isinstance(simulation, AnimatedMesh):
        rows = simulation.faces
    elif isinstance(simulation, MassSpring):
        if simulation.faces is not None and len(simulation.faces) > 0:
            rows = simulation.faces
        else:
            name, rows = "edges", simulation.edges
    elif isinstance(simulation, PositionBasedDynamics) and simulation.dimension == 3:
        rows, solids = _triangles(simulation), _tetrahedra(simulation)
        if len(np.unique(rows)) < len(simulation) and len(solids):
            name, rows = "tetrahedra", solids
    return {name: rows} if len(rows) and len(np.unique(rows)) == len(simulation) else {}


def shapes_of(simulation: Any) -> dict[str, Any]:
    """Arguments of a `Part` of kind bodies, for the shapes of rigid bodies."""
    if not isinstance(simulation, RigidBodies):
        return {}
    return dict(body_shapes(simulation))


def _tetrahedra(simulation: PositionBasedDynamics) -> NDArray[np.int64]:
    """Those that are constrained, of which the inner particles are no surface."""
    solids = [
        np.asarray(constraint.particles, np.int64)
        for constraint in simulation.constraints
        if getattr(constraint, "_name", None) == "tetrahedra"
    ]
    return np.unique(np.concatenate([np.zeros((0, 4), np.int64), *solids]), axis=0)


def _triangles(simulation: PositionBasedDynamics) -> NDArray[np.int64]:
    """Those whose bending or collision is constrained, and the surfaces of tetrahedra that are."""
    faces: list[NDArray[Any]] = [np.zeros((0, 3), np.int64)]
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
