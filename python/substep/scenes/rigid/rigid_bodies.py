"""What the scenes of rigid bodies share: bodies with their surfaces, recording and picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.quaternions import rotate
from ...geometry import Box, Capsule, ConvexHull, Cylinder, Plane, Sphere, TriangleMesh
from ...rigid import RigidBodies
from ...view import Camera, Look, View
from ..declaration import Parameter
from ..measured import Measured

if TYPE_CHECKING:
    from ...recording import Part, Recording

Array = NDArray[np.float64]
Solid = Sphere | Box | Capsule | Cylinder | ConvexHull

STEEL = "#4a5058"


def rigid_parameters(step: float = 1 / 60) -> dict[str, Parameter]:
    """Parameters of every such scene.

    Parameters
    ----------
    step : float
        Its default [s].

    Returns
    -------
    dict of str to Parameter
        By key.
    """
    return {
        "friction": Parameter("coefficient of friction", 0.5, minimum=0),
        "substeps": Parameter("substeps of a step", 8, minimum=1, maximum=1000),
        "step": Parameter("time step", step, unit="s", above=0),
    }


class Solids(Measured, RigidBodies):
    """Rigid bodies on the ground, with what is drawn of them.

    Parameters
    ----------
    parameters : mapping
        Of the scene, with those of `rigid_parameters`.
    options
        Others of `RigidBodies`.
    """

    def __init__(self, parameters: Mapping[str, Any], **options: Any) -> None:
        super().__init__(step=parameters["step"], substeps=parameters["substeps"], **options)
        self.friction = parameters["friction"]
        self.surfaces: dict[str, Surfaces] = {}
        self.obstacles: dict[str, TriangleMesh] = {}
        self.measured = {}
        self.add(Plane(), (0, 0, 0), motion="static", friction=self.friction)

    def put(
        self,
        part: str,
        shape: Solid,
        positions: ArrayLike,
        rotations: ArrayLike = (1.0, 0.0, 0.0, 0.0),
        *,
        dye: ArrayLike | None = None,
        segments: int = 32,
        **options: Any,
    ) -> NDArray[np.int64]:
        """Add bodies of one shape.

        Parameters
        ----------
        part : str
            Name of what is recorded of them, together with others.
        shape : Sphere, Box, Capsule, Cylinder or ConvexHull
            Theirs.
        positions, rotations
            As for `RigidBodies.add`.
        dye : array_like, shape (n,), optional
            A number from 0 to 1 for each, which colours it.
        segments : int
            Edges around a round shape, as it is recorded.
        options
            Others of `RigidBodies.add`.

        Returns
        -------
        ndarray of int64, shape (n,)
            Their ids.
        """
        options = {"friction": self.friction, **options}
        ids = np.atleast_1d(self.add(shape, positions, rotations, **options))
        if isinstance(shape, (Box, ConvexHull)):
            mesh = shape.mesh()
        else:
            mesh = shape.mesh(segments)
        self.surfaces.setdefault(part, Surfaces()).add(ids, mesh, dye)
        return ids

    def parts(self) -> dict[str, Part]:
        """The bodies that move, their surfaces, and what never moves."""
        from ...recording import Part

        units = {"orientation": "1", "velocity": "m/s", "angular_velocity": "rad/s"}
        parts = {"bodies": Part("bodies", units)}
        parts |= {name: surfaces.part() for name, surfaces in self.surfaces.items()}
        for name, mesh in self.obstacles.items():
            parts[name] = Part("mesh", triangles=mesh.faces, points=mesh.vertices)
        return parts

    def frame(self) -> dict[str, dict[str, Any]]:
        """Positions and orientations as float64; velocities and surfaces as float32."""
        moves = self.motions != "static"
        bodies = {
            "points": self.positions[moves],
            "orientation": self.rotations[moves],
            "velocity": self.velocities[moves].astype(np.float32),
            "angular_velocity": self.angular_velocities[moves].astype(np.float32),
        }
        surfaces = {name: part.frame(self) for name, part in self.surfaces.items()}
        return {"bodies": bodies, **surfaces}


class Surfaces:
    """The surfaces of bodies as one mesh, in the frames of their shapes."""

    def __init__(self) -> None:
        self._ids: list[NDArray[np.int64]] = []
        self._vertices: list[Array] = []
        self._faces: list[NDArray[np.int64]] = []
        self._dyes: list[NDArray[np.uint8]] = []
        self._count = 0

    def add(self, ids: NDArray[np.int64], mesh: TriangleMesh, dye: ArrayLike | None) -> None:
        """Add one mesh for each of some bodies."""
        n, m = len(ids), len(mesh.vertices)
        first = self._count + m * np.arange(n)
        self._count += n * m
        self._ids.append(np.repeat(ids, m))
        self._vertices.append(np.tile(mesh.vertices, (n, 1)))
        self._faces.append((first[:, None, None] + mesh.faces).reshape(-1, 3))
        if dye is not None:
            levels = np.rint(255 * np.broadcast_to(np.asarray(dye, float), (n,)))
            self._dyes.append(np.repeat(levels.astype(np.uint8), m))

    def part(self) -> Part:
        """For the recording."""
        from ...recording import Part

        fields = {"dye": "1"} if self._dyes else {}
        return Part("mesh", fields, triangles=np.concatenate(self._faces))

    def frame(self, bodies: RigidBodies) -> dict[str, Any]:
        """Where the bodies are now."""
        rows = bodies.rows(np.concatenate(self._ids))
        x, q = bodies.positions[rows], bodies.rotations[rows]
        points = x + rotate(q, np.concatenate(self._vertices))
        dye = {"dye": np.concatenate(self._dyes)} if self._dyes else {}
        return {"points": points.astype(np.float32), **dye}


def joined(meshes: list[TriangleMesh]) -> TriangleMesh:
    """Several meshes as one.

    Parameters
    ----------
    meshes : list of TriangleMesh
        At least one.

    Returns
    -------
    TriangleMesh
        Their vertices and faces, one after the other.
    """
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, first, strict=False)]
    return TriangleMesh(np.vstack([mesh.vertices for mesh in meshes]), np.vstack(faces))


def shifted(mesh: TriangleMesh, x: ArrayLike, q: ArrayLike = (1, 0, 0, 0)) -> TriangleMesh:
    """A mesh that is turned by a unit quaternion and then moved.

    Parameters
    ----------
    mesh : TriangleMesh
        About the origin.
    x : array_like, shape (3,)
        Where the origin comes [m].
    q : array_like, shape (4,)
        Unit quaternion (w, x, y, z).

    Returns
    -------
    TriangleMesh
        Elsewhere.
    """
    turned = rotate(np.asarray(q, float), mesh.vertices)
    return TriangleMesh(turned + np.asarray(x, float), mesh.faces)


def solids_view(
    camera: Camera,
    palette: str,
    nooks: Callable[[Recording], float],
    box: Callable[[Recording], ArrayLike],
    looks: Mapping[str, Look] | None = None,
) -> View:
    """Solids in the colours of their dye, which shade each other.

    Parameters
    ----------
    camera : Camera
        Where from.
    palette : str
        Colours of the dye.
    nooks : callable
        `nooks(recording)` is how near surfaces shade each other [m].
    box : callable
        Region shown.
    looks : mapping of str to Look, optional
        Of other parts.

    Returns
    -------
    View
        The picture.
    """
    return View(
        camera,
        {"bodies": Look(hidden=True), **(looks or {})},
        color="dye",
        palette=palette,
        limits=(0, 255),
        bar=False,
        box=box,
        ground=lambda recording: 0.0,
        nooks=nooks,
    )
