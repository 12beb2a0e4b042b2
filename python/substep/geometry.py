"""Obstacles and meshes that every method shares.

- Obstacles (`Plane`, `Sphere`, `Box`, `SignedDistanceField`): a signed distance, a motion, friction
  and restitution, and the impulse and torque that a step exerted on them.
- `tetrahedralize` fills a surface and `SignedDistanceField.from_mesh` makes an obstacle of it,
  whatever it lacks.
- `liquid_surface` wraps the particles of a liquid in triangles.
- Meshes (`TriangleMesh`, `TetMesh`), read by `read_mesh` or made by `grid_mesh`, `box_mesh`,
  `sphere_mesh` and `box_tetrahedra`; `TriangleMesh.report` says plainly what a mesh lacks.
- `neighbour_lists`: which points are closer to each other than a radius.
"""

from __future__ import annotations

from ._colliders import Box, Collider, Plane, SignedDistanceField, Sphere
from ._filling import tetrahedralize
from ._liquid_surface import LiquidSurface, liquid_surface
from ._mesh import TetMesh
from ._mesh_io import read_mesh
from ._mesh_report import MeshReport
from ._neighbours import neighbour_lists
from ._primitives import box_mesh, box_tetrahedra, grid_mesh, sphere_mesh
from ._triangle_mesh import TriangleMesh

__all__ = [
    "Box",
    "Collider",
    "LiquidSurface",
    "MeshReport",
    "Plane",
    "SignedDistanceField",
    "Sphere",
    "TetMesh",
    "TriangleMesh",
    "box_mesh",
    "box_tetrahedra",
    "grid_mesh",
    "liquid_surface",
    "neighbour_lists",
    "read_mesh",
    "sphere_mesh",
    "tetrahedralize",
]
