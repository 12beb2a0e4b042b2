"""The shapes of rigid bodies as a recording keeps them: triangles in the frames of the bodies."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry import Plane, TriangleMesh
from ..rigid import RigidBodies


def body_shapes(bodies: RigidBodies, ids: ArrayLike | None = None) -> dict[str, Any]:
    """Arguments of a `Part` of bodies that keep their shapes.

    Parameters
    ----------
    bodies : RigidBodies
        With the bodies that are recorded.
    ids : array_like of int, shape (n,), optional
        Which of them, in the order in which frames have them; all of them unless given.

    Returns
    -------
    dict of str to ndarray
        `shape_vertices`, shape (m, 3) [m], `shape_faces`, shape (k, 3), and `shape_bodies`, shape
        (m, 1). Planes have no end, so that they are left out.

    Raises
    ------
    IndexError
        If there is no such body.

    Examples
    --------
    >>> import substep
    >>> bodies = substep.RigidBodies()
    >>> boxes = bodies.add(substep.Box((1, 1, 1)), [(0, 0, 1), (0, 0, 3)])
    >>> shapes = substep.recording.body_shapes(bodies)
    >>> part = substep.Part("bodies", {"orientation": "1"}, **shapes)
    >>> shapes["shape_faces"].shape
    (24, 3)
    """
    rows = range(len(bodies)) if ids is None else bodies.rows(ids)
    vertices: list[NDArray[Any]] = [np.zeros((0, 3))]
    faces: list[NDArray[Any]] = [np.zeros((0, 3), np.int64)]
    owners: list[NDArray[Any]] = [np.zeros((0, 1), np.int64)]
    meshes: dict[int, TriangleMesh] = {}
    first = 0
    for k, row in enumerate(np.atleast_1d(rows)):
        for fixture in bodies._made[row][0]:
            shape: Any = fixture.shape
            if isinstance(shape, Plane):
                continue
            if id(shape) not in meshes:
                meshes[id(shape)] = shape if isinstance(shape, TriangleMesh) else shape.mesh()
            mesh = meshes[id(shape)]
            vertices.append(mesh.vertices)
            faces.append(mesh.faces + first)
            owners.append(np.full((len(mesh.vertices), 1), k))
            first += len(mesh.vertices)
    arrays = (np.concatenate(rows) for rows in (vertices, faces, owners))
    return dict(zip(("shape_vertices", "shape_faces", "shape_bodies"), arrays, strict=True))
