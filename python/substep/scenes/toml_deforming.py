"""Cloth, solids, skins and animated obstacles of scenes in TOML files."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry import (
    AnimatedMesh,
    Collider,
    Skin,
    TetMesh,
    TriangleMesh,
    box_tetrahedra,
    grid_mesh,
    read_mesh,
    tetrahedralize,
    transform_mesh,
)
from ..pbd import PositionBasedDynamics, cloth, soft_body
from ..springs import MassSpring, SoftBody
from .run_config import confine
from .toml_file import Layout
from .toml_rules import CLOTH, SOLID

Array = NDArray[np.float64]
_MOST = 2e7  # cells of a sheet or a block


def quaternion(rotation_deg: Any) -> Array:
    """Unit quaternion of an axis times an angle in degrees.

    Parameters
    ----------
    rotation_deg : array_like, shape (3,)
        The axis times the angle [degrees].

    Returns
    -------
    ndarray, shape (4,)
        (w, x, y, z).
    """
    turn = np.radians(np.asarray(rotation_deg, float))
    angle = float(np.linalg.norm(turn))
    axis = turn / angle if angle > 0 else turn
    return np.array([math.cos(angle / 2), *(math.sin(angle / 2) * axis)])


def read_surface(layout: Layout, row: dict[str, Any], table: str, number: int = 0) -> TriangleMesh:
    """A surface from a file beside the scene's, or below, in its place; obstacles are moved there.

    Raises
    ------
    InputError, FormatError, OSError
        If there is none.
    """
    where = layout.where("file", table, number)
    confine(where, row["file"], layout.path.parent)
    path = Path(layout.path.parent, row["file"])
    if path.exists() and not path.is_file():  # to open a pipe would wait for ever
        raise InputError(f"{where}: expected a file, got a folder, a pipe or a device")
    mesh = read_mesh(path)
    if not isinstance(mesh, TriangleMesh):
        mesh = mesh.surface()[0]
    placed = transform_mesh(mesh, up=row.get("up", "z"), scale=row.get("scale", 1.0))
    return placed if "shape" in row else _put(placed, row)


def read_animation(layout: Layout, row: dict[str, Any], number: int) -> AnimatedMesh:
    """The frames of an obstacle, from a folder beside the scene's file, or below.

    Raises
    ------
    InputError, FormatError, OSError
        If there are none.
    """
    confine(layout.where("folder", "obstacle", number), row["folder"], layout.path.parent)
    options = {key: row[key] for key in ("up", "scale") if key in row}
    path = Path(layout.path.parent, row["folder"])
    return AnimatedMesh.from_files(path, fps=row["fps"], **options)


def make_deforming(
    layout: Layout, spacing: float, gravity: Any, colliders: list[Collider]
) -> tuple[MassSpring | SoftBody | PositionBasedDynamics, NDArray[np.int64] | None]:
    """The cloth or the solid of a file, among obstacles, and the triangles that it forgets.

    Raises
    ------
    InputError
        If something of it is wrong.
    """
    table = "cloth" if layout.cloth else "solid"
    row, method = getattr(layout, table), layout.scene["method"]
    with layout.told(table, row):
        mesh: Any = _sheet(layout, row, spacing) if layout.cloth else _solid(layout, row, spacing)
        x = mesh.vertices
        low, high = row.get("pinned", ((1.0,), (0.0,)))
        shared = {
            "velocities": np.broadcast_to(row.get("velocity", (0.0, 0.0, 0.0)), x.shape),
            "pinned": ((np.array(low) <= x) & (x <= np.array(high))).all(axis=1),
            "gravity": gravity,
            "colliders": colliders,
            **layout.options,
        }
        if "pinned" in row and not shared["pinned"].any():
            raise InputError("pinned: expected a box with vertices in it, got one without")
        keys = {"density", *SOLID, *CLOTH["mass-spring"], *CLOTH["pbd"]}
        own = {key: row[key] for key in row if key in keys}
        if method == "mass-spring":
            return MassSpring.from_mesh(mesh, **own, **shared), None
        if method == "soft-body":
            return SoftBody.from_mesh(mesh, **own, **shared), None
        density = own.pop("density")
        faces = None
        if isinstance(mesh, TetMesh):
            masses, constraints = density * mesh.vertex_volumes, soft_body(mesh, **own)
        else:
            masses, constraints = density * mesh.vertex_areas, cloth(mesh, **own)
            faces = mesh.faces
        return PositionBasedDynamics(x, masses, constraints, **shared), faces


def put_on_skin(layout: Layout, simulation: Any) -> None:
    """Give a simulation the skin of a file.

    Raises
    ------
    InputError
        If it does not fit.
    """
    mesh = read_surface(layout, layout.skin, "skin")
    solid = layout.solid and getattr(simulation, "mesh", None)
    options = {key: layout.skin[key] for key in ("neighbours",) if key in layout.skin}
    simulation.skin = Skin(mesh, solid or simulation.positions, **options)


def _sheet(layout: Layout, row: dict[str, Any], spacing: float) -> TriangleMesh:
    if "file" in row:
        return read_surface(layout, row, "cloth")
    n, m = _divisions(layout, row["size"], spacing)
    return _put(grid_mesh(n + 1, m + 1, row["size"]), row)


def _divisions(layout: Layout, lengths: Any, spacing: float) -> list[int]:
    """How many spacings the lengths have."""
    counts = [max(length / spacing, 1.0) for length in lengths]
    if not math.prod(counts) <= _MOST:
        where = layout.where("spacing", "scene")
        raise InputError(f"{where}: {math.prod(counts):.1e} cells are more than {_MOST:.0e}")
    return [round(count) for count in counts]


def _put(mesh: TriangleMesh, row: dict[str, Any]) -> TriangleMesh:
    """The mesh turned and moved as a table says."""
    return transform_mesh(
        mesh,
        rotation=quaternion(row.get("rotation_deg", (0.0, 0.0, 0.0))),
        translation=row.get("position", (0.0, 0.0, 0.0)),
    )


def _solid(layout: Layout, row: dict[str, Any], spacing: float) -> TetMesh:
    if "file" in row:
        solid = tetrahedralize(read_surface(layout, row, "solid"), spacing)
        used, corners = np.unique(solid.tetrahedra, return_inverse=True)
        return TetMesh(solid.vertices[used], corners.reshape(-1, 4))
    low, high = np.array(row["low"]), np.array(row["high"])
    if not (low < high).all():
        raise InputError(f"high: expected numbers above those of low, got {high.tolist()}")
    count = _divisions(layout, (high - low).tolist(), spacing)
    mesh = box_tetrahedra(tuple(high - low), tuple(count))
    return transform_mesh(mesh, translation=(low + high) / 2 - mesh.vertices.mean(axis=0))
