"""Obstacles and meshes that every method shares.

- Shapes (`Box`, `Sphere`, `Capsule`, `Cylinder`, `Plane`, `ConvexHull`, `TriangleMesh`,
  `HeightField` and `SignedDistanceField`), of which obstacles and rigid bodies are made.
- `Collider`, the obstacle of every method: a shape with a motion, friction and restitution, and the
  impulse that was exerted on it.
- `tetrahedralize` fills a surface and `SignedDistanceField.from_mesh` makes an obstacle of it,
  whatever it lacks.
- `convex_decomposition` cuts a solid into the convex hulls that bodies which move are made of.
- `liquid_surface` wraps the particles of a liquid in triangles.
- Meshes (`TriangleMesh`, `TetMesh`), read by `read_mesh` or made by `grid_mesh`, `box_mesh`,
  `sphere_mesh` and `box_tetrahedra`; `TriangleMesh.report` describes the defects of a mesh.
- `transform_mesh` scales, turns and moves a mesh; `follow_keyframes` moves obstacles along
  `Keyframes`, and `AnimatedMesh` is an obstacle that deforms as frames say.
- `Skin` is a fine surface that follows simulated particles or tetrahedra.
- `neighbour_lists`: which points are closer to each other than a radius.
"""

from .animated_mesh import AnimatedMesh
from .colliders import Collider
from .decomposition import convex_decomposition
from .filling import tetrahedralize
from .height_field import HeightField
from .isosurface import LiquidSurface, liquid_surface
from .keyframes import Keyframes, follow_keyframes
from .mesh_io import read_mesh
from .mesh_report import MeshReport
from .neighbours import neighbour_lists
from .primitives import box_mesh, box_tetrahedra, grid_mesh, sphere_mesh
from .sampled_distance import SignedDistanceField
from .shape import Shape
from .shapes import Box, Capsule, ConvexHull, Cylinder, Plane, Sphere
from .skin import Skin
from .tet_mesh import TetMesh
from .transform import transform_mesh
from .triangle_mesh import TriangleMesh

__all__ = [
    "AnimatedMesh",
    "Box",
    "Capsule",
    "Collider",
    "ConvexHull",
    "Cylinder",
    "HeightField",
    "Keyframes",
    "LiquidSurface",
    "MeshReport",
    "Plane",
    "Shape",
    "SignedDistanceField",
    "Skin",
    "Sphere",
    "TetMesh",
    "TriangleMesh",
    "box_mesh",
    "box_tetrahedra",
    "convex_decomposition",
    "follow_keyframes",
    "grid_mesh",
    "liquid_surface",
    "neighbour_lists",
    "read_mesh",
    "sphere_mesh",
    "tetrahedralize",
    "transform_mesh",
]


def __dir__() -> list[str]:
    return __all__
