"""Meshes that are scaled, turned and moved."""

from __future__ import annotations

from typing import TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from ..base.checks import check_array, check_choice, check_real, describe
from ..base.quaternions import IDENTITY, rotate, unit_quaternions
from .tet_mesh import TetMesh
from .triangle_mesh import TriangleMesh

Mesh = TypeVar("Mesh", TriangleMesh, TetMesh)


def transform_mesh(
    mesh: Mesh,
    *,
    up: str = "z",
    scale: float = 1.0,
    rotation: ArrayLike = IDENTITY,
    translation: ArrayLike = (0.0, 0.0, 0.0),
) -> Mesh:
    """Make a mesh z-up, then scale, turn and move it, in this order.

    Parameters
    ----------
    mesh : TriangleMesh or TetMesh
        Of a file, say, whose author had another unit and another axis that points upwards.
    up : {'z', 'y', 'x'}
        Axis of `mesh` that points upwards; it becomes z, and the other two follow in turn.
    scale : float
        Factor of all lengths, above 0: 0.001 for a mesh in millimetres [1].
    rotation : array_like, shape (4,)
        Unit quaternion (w, x, y, z), about the origin.
    translation : array_like, shape (3,)
        By how much it is moved then [m].

    Returns
    -------
    TriangleMesh or TetMesh
        A new mesh of the same kind.

    Raises
    ------
    TypeError
        If `mesh` is no mesh.
    InputError
        If an argument is not finite or out of range.

    Examples
    --------
    >>> import substep
    >>> tower = substep.geometry.box_mesh((1, 3, 1))  # in millimetres, y up
    >>> placed = substep.geometry.transform_mesh(tower, up="y", scale=1e-3, translation=(0, 0, 1))
    >>> float(placed.vertices[:, 2].max().round(6))
    1.0015
    """
    if not isinstance(mesh, (TriangleMesh, TetMesh)):
        raise TypeError(f"mesh: expected a TriangleMesh or a TetMesh, got {describe(mesh)}")
    axis = "xyz".index(check_choice("up", up, ("x", "y", "z")))
    factor = check_real("scale", scale, positive=True)
    q = unit_quaternions("rotation", rotation, (4,))
    move = check_array("translation", translation, (3,))
    x = np.roll(mesh.vertices, 2 - axis, axis=1) * factor
    x = rotate(np.broadcast_to(q, (len(x), 4)), x) + move
    placed: TriangleMesh | TetMesh
    if isinstance(mesh, TriangleMesh):
        placed = TriangleMesh(x, mesh.faces)
    else:
        placed = TetMesh(x, mesh.tetrahedra)
    return cast(Mesh, placed)
