"""What there is to see of a simulation, or of a frame of a recording: a list of `Drawable`s.

Every picture that needs no scene is made of these: in the browser, in a page, in a notebook.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.quaternions import multiply, rotate
from ..coupling import World
from ..geometry import Plane, Shape, SignedDistanceField, TetMesh, TriangleMesh
from ..geometry.facets import SurfaceCollider
from ..recording import Part, Recording
from ..recording.contents import particle_frame, particle_parts
from ..rigid import RigidBatch, RigidBodies
from ..rigid.colliders import BodyCollider
from .extent import is_flat, lies_flat, radius_of
from .surfaces import in_space, magnitude

Array = NDArray[Any]

PALETTE = ("#c65d47", "#3f7ea6", "#d9a441", "#5d9e6e", "#8a6fb0", "#4fa3a5")
FIXED = "#b4bac2"  # what never moves
SEEN_THROUGH = 0.15  # tanks, from within
_BOX_EDGES = np.array(
    [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]]
)


@dataclass(frozen=True, eq=False)
class Drawable:
    """One thing to see, at one time.

    Attributes
    ----------
    name : str
        Of the part, or of the obstacle.
    kind : {'points', 'surface', 'lines', 'cells'}
        Balls about points, triangles, edges, or the fields of a grid.
    points : ndarray of float32, shape (n, 3)
        Centres or vertices [m]; those of a plane have z = 0. Of cells the corners of their box.
    rows : ndarray of int64, shape (m, 3) or (m, 2)
        Vertices of triangles or edges; none of the others.
    radius : float
        Of the balls [m].
    fields : dict of str to ndarray
        A number for each point, or for each cell: of vectors the norm.
    color : str
        Without a field.
    opacity : float
        1 is opaque.
    still : bool
        Whether it looks the same at all times.
    """

    name: str
    kind: str
    points: NDArray[np.float32]
    rows: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    radius: float = 0.0
    fields: dict[str, Array] = field(default_factory=dict)
    color: str = FIXED
    opacity: float = 1.0
    still: bool = False


class Scenery:
    """A simulation or a recording, as drawables.

    Parameters
    ----------
    source : Simulation or Recording
        What is looked at; a recording stays open.

    Attributes
    ----------
    parts : dict of str to Part
        What it consists of, obstacles left out.
    flat : bool
        Whether all of it lies in the plane z = 0.
    """

    def __init__(self, source: Any) -> None:
        self.source = source
        self.recorded = isinstance(source, Recording)
        self.parts: dict[str, Part] = source.parts if self.recorded else particle_parts(source)
        self._radii: dict[str, float] = {}
        self._faces: dict[str, NDArray[np.int64]] = {}  # that bound tetrahedra
        self._bodies: dict[str, tuple[Any, _Surfaces]] = {}
        if self.recorded:
            self.flat = len(source) > 0 and is_flat(source)
        else:
            self.flat = _is_flat(self.parts, particle_frame(source))

    @property
    def fields(self) -> dict[str, str]:
        """Units of the fields that colour something, by name."""
        units = {k: unit for part in self.parts.values() for k, unit in part.fields.items()}
        return {name: unit for name, unit in units.items() if name != "orientation"}

    @property
    def smoky(self) -> bool:
        """Whether there is smoke in space, which is best seen as a volume."""
        return any(len(p.cells) == 3 and "smoke" in p.fields for p in self.parts.values())

    def at(self, frame: int = -1) -> list[Drawable]:
        """What there is to see.

        Parameters
        ----------
        frame : int
            Of a recording; a simulation is seen as it is now.

        Returns
        -------
        list of Drawable
            Obstacles last.
        """
        if self.recorded:
            if not len(self.source):
                return []
            return self._seen(self._of_frame(self.parts, self.source.frame(frame)))
        drawn = self._of_frame(self.parts, particle_frame(self.source))
        members = dict(members_of(self.source))
        for name, member in members.items():
            bodies = list(_worlds_of(member))
            if bodies:
                drawn = [d for d in drawn if d.name != (name or "particles")]
                drawn += self._of_bodies(name or "bodies", member, bodies)
        low, high = reach(drawn)
        for name, member in members.items():
            drawn += _tank(member, name)
            for k, collider in enumerate(member.colliders):
                if isinstance(collider, SurfaceCollider) or (
                    isinstance(collider, BodyCollider) and isinstance(self.source, World)
                ):
                    continue  # what it stands for is drawn
                drawn += _obstacle(f"{name or 'obstacle'}-{k}", collider, low, high)
        return self._seen(drawn)

    def _seen(self, drawn: list[Drawable]) -> list[Drawable]:
        return [_section(d) for d in drawn] if self.flat else drawn

    def _of_frame(self, parts: Mapping[str, Part], frame: Mapping[str, Any]) -> list[Drawable]:
        drawn = []
        for k, (name, part) in enumerate(parts.items()):
            arrays, color = frame[name], PALETTE[k % len(PALETTE)]
            if part.cells:
                corners, d = in_space(np.asarray(part.bounds)), len(part.cells)
                values = {key: _by_cell(a, d) for key, a in arrays.items()}
                drawn.append(Drawable(name, "cells", corners, fields=values, color=color))
                continue
            points = in_space(arrays["points"])
            fields = {
                key: magnitude(a)
                for key, a in arrays.items()
                if key not in ("points", "orientation")
            }
            if part.shape_vertices is not None:
                who = np.asarray(part.shape_bodies)[:, 0]
                turned = rotate(
                    arrays["orientation"][who].astype(float), np.asarray(part.shape_vertices)
                )
                points = in_space(arrays["points"][who] + turned)
                fields = {key: values[who] for key, values in fields.items()}
                faces = np.asarray(part.shape_faces)
                if len(points):  # planes have no vertices
                    drawn.append(Drawable(name, "surface", points, faces, 0, fields, color))
                continue
            one = Drawable(name, "points", points, fields=fields, color=color)
            if part.points is not None:
                one = replace(one, color=FIXED, still=True)
            drawn.append(self._with_rows(one, part))
        return drawn

    def _with_rows(self, one: Drawable, part: Part) -> Drawable:
        if part.tetrahedra is not None:
            if one.name not in self._faces:
                self._faces[one.name] = TetMesh(one.points, part.tetrahedra).surface_faces
            return replace(one, kind="surface", rows=self._faces[one.name])
        if part.triangles is not None and len(part.triangles):  # type: ignore[arg-type]
            return replace(one, kind="surface", rows=np.asarray(part.triangles))
        if part.edges is not None:
            return replace(one, kind="lines", rows=np.asarray(part.edges))
        if one.name not in self._radii and len(one.points):
            self._radii[one.name] = radius_of(one.points, one.fields.get("world"))
        return replace(one, radius=self._radii.get(one.name, 0.05))

    def _of_bodies(self, name: str, member: Any, worlds: list[RigidBodies]) -> list[Drawable]:
        key = tuple(map(id, worlds)), tuple(len(one) for one in worlds), _ids_of(member)
        if name not in self._bodies or self._bodies[name][0] != key:
            self._bodies[name] = key, _Surfaces(worlds)
        fields = member.fields()
        return self._bodies[name][1].drawables(name, fields)


def members_of(simulation: Any) -> Iterator[tuple[str, Any]]:
    """The simulations of a world by name, or the one without."""
    yield from getattr(simulation, "members", {"": simulation}).items()


def reach(drawn: list[Drawable]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest corner of what is drawn [m]; of nothing those of a cube of 2 m.

    Parameters
    ----------
    drawn : list of Drawable
        What is drawn.

    Returns
    -------
    low, high : ndarray, shape (3,)
        The corners.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for one in drawn:
        points = one.points[np.isfinite(one.points).all(axis=1)]
        low = np.minimum(low, points.min(axis=0, initial=np.inf) - one.radius)
        high = np.maximum(high, points.max(axis=0, initial=-np.inf) + one.radius)
    if not np.all(low <= high):
        return np.full(3, -1.0), np.full(3, 1.0)
    return low, high


def _is_flat(parts: Mapping[str, Part], frame: Mapping[str, Any]) -> bool:
    """Whether something has two dimensions, and all is in its plane."""
    dimensions = [len(p.cells) or frame[name]["points"].shape[1] for name, p in parts.items()]
    return 2 in dimensions and lies_flat(parts, frame)


def _by_cell(values: Array, dimension: int) -> Array:
    rest = values.reshape(*values.shape[:dimension], -1).astype(float)
    return rest[..., 0] if rest.shape[-1] == 1 else np.linalg.norm(rest, axis=-1)


def _section(one: Drawable) -> Drawable:
    """A surface cut at z = 0, where obstacles of a plane are cut; the rest as it is."""
    if one.kind != "surface" or not one.points[:, 2].any():
        return one
    corners = one.points[one.rows].astype(float)
    above = corners[:, :, 2] > 0
    corners = corners[above.any(axis=1) & ~above.all(axis=1)]
    # Turned so that the first corner is alone on its side: the edges from it are cut.
    above = corners[:, :, 2] > 0
    alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
    order = (alone[:, None] + np.arange(3)) % 3
    a, *others = np.moveaxis(np.take_along_axis(corners, order[:, :, None], axis=1), 1, 0)
    ends = [a + (b - a) * (a[:, 2:] / (a[:, 2:] - b[:, 2:])) for b in others]
    points = in_space(np.stack(ends, axis=1).reshape(-1, 3)[:, :2])
    return replace(one, kind="lines", points=points, rows=np.arange(len(points)).reshape(-1, 2))


def _worlds_of(member: Any) -> Iterator[RigidBodies]:
    if isinstance(member, RigidBodies):
        yield member
    elif isinstance(member, RigidBatch):
        yield from member._made


def _ids_of(member: Any) -> bytes:
    return np.ascontiguousarray(member.ids if isinstance(member, RigidBodies) else 0).tobytes()


class _Surfaces:
    """Surfaces of bodies in the frames of these: those that move as one, and the ground."""

    def __init__(self, worlds: list[RigidBodies]) -> None:
        vertices, faces = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)]
        owned = [np.zeros(0, np.int64)]
        grounds: list[tuple[int, Shape]] = []
        body = count = 0
        meshes: dict[int, TriangleMesh | None] = {}
        for world in worlds:
            for row, motion in enumerate(world.motions):
                for fixture in world.fixtures(int(world.ids[row])):
                    shape = fixture.shape
                    if id(shape) not in meshes:
                        meshes[id(shape)] = mesh_of(shape)
                    mesh = meshes[id(shape)]
                    if motion == "static" or mesh is None:
                        grounds.append((body, shape))
                    else:
                        vertices.append(mesh.vertices)
                        faces.append(mesh.faces + count)
                        owned.append(np.full(len(mesh.vertices), body))
                        count += len(mesh.vertices)
                body += 1
        self._vertices = np.concatenate(vertices)
        self._faces = np.concatenate(faces)
        self._owners = np.concatenate(owned)
        self._grounds = grounds

    def drawables(self, name: str, fields: Mapping[str, tuple[Array, str]]) -> list[Drawable]:
        x, q = fields["position"][0], fields["orientation"][0]
        who = self._owners
        points = in_space(x[who] + rotate(q[who], self._vertices))
        values = {
            key: magnitude(array)[who]
            for key, (array, _) in fields.items()
            if key not in ("position", "orientation")
        }
        drawn = []
        if len(points):
            drawn.append(Drawable(name, "surface", points, self._faces, 0, values, PALETTE[0]))
        low, high = reach(drawn or [Drawable(name, "points", in_space(x))])
        for k, (body, shape) in enumerate(self._grounds):
            one = _placed(f"{name}-ground-{k}", shape, x[body], q[body], low, high)
            drawn += [replace(d, still=True) for d in one]
        return drawn


def mesh_of(shape: Shape) -> TriangleMesh | None:
    """The surface of a shape in its frame; None of a plane and of a field of distances.

    Parameters
    ----------
    shape : Shape
        Any.

    Returns
    -------
    TriangleMesh or None
        With the centre and the rotation of the shape.
    """
    if isinstance(shape, TriangleMesh):
        return shape
    if isinstance(shape, (Plane, SignedDistanceField)) or not hasattr(shape, "mesh"):
        return None
    made: TriangleMesh = shape.mesh()
    return made


def _placed(
    name: str, shape: Shape, x: Array, q: Array, low: Array, high: Array, opacity: float = 1.0
) -> list[Drawable]:
    """A shape whose frame lies at x, turned by q; planes as large as what else is seen."""
    mesh = mesh_of(shape)
    if mesh is not None:
        points, faces = mesh.vertices, mesh.faces
    elif isinstance(shape, Plane):
        points, faces = square_of(shape, q, x, low, high)
    elif isinstance(shape, SignedDistanceField):
        return [
            Drawable(
                name,
                "points",
                in_space(x + rotate(q, _near_surface(shape))),
                radius=shape.spacing / 2,
                opacity=opacity,
            )
        ]
    else:
        return []
    return [Drawable(name, "surface", in_space(x + rotate(q, points)), faces, opacity=opacity)]


def square_of(
    plane: Plane, q: Array, x: Array, low: Array, high: Array, half: float = 0.75
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A square of a plane below what is seen, in the frame of its body.

    Parameters
    ----------
    plane : Plane
        In that frame.
    q, x : ndarray, shape (4,) and (3,)
        Rotation and place [m] of the body.
    low, high : ndarray, shape (3,)
        Corners of the box of what is seen [m].
    half : float
        Half a side of the square, over the diagonal of that box.

    Returns
    -------
    corners : ndarray, shape (4, 3)
        [m]
    faces : ndarray of int64, shape (2, 3)
        Two triangles, whose normals are that of the plane.
    """
    n, p = np.array(plane.normal), np.array(plane.point)
    back = q * (1, -1, -1, -1)
    middle = rotate(back, (low + high) / 2 - x)
    middle = middle - n * ((middle - p) @ n)
    side = half * max(float(np.linalg.norm(high - low)), 1e-3)
    a = np.cross(n, [1.0, 0, 0] if abs(n[0]) < 0.6 else [0, 1.0, 0])
    a = a / np.linalg.norm(a)
    b = np.cross(n, a)
    corners = middle + side * np.array([-a - b, a - b, a + b, b - a])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def _near_surface(field: SignedDistanceField) -> NDArray[np.float64]:
    """Nodes within half a spacing of the surface."""
    values = np.asarray(field.values)
    nodes = np.argwhere(np.abs(values) < 0.6 * field.spacing)
    points: NDArray[np.float64] = np.asarray(field.origin) + field.spacing * nodes
    return rotate(np.array(field.rotation), points) + field.center


def _obstacle(name: str, collider: Any, low: Array, high: Array) -> list[Drawable]:
    """A collider where it is now."""
    shape = collider.shape
    # The collider turns about the centre of its shape, which is at its position.
    center = np.array(shape.point if isinstance(shape, Plane) else shape.center)
    own = np.array(shape.rotation) * (1, -1, -1, -1)
    turn = multiply(collider.rotation, own)
    x = collider.position - rotate(turn, center)
    seen = SEEN_THROUGH if collider.hollow else 1.0
    return _placed(name, shape, x, turn, low, high, seen)


def _tank(member: Any, name: str) -> list[Drawable]:
    """The edges of the box that a simulation is bounded by."""
    bounds = getattr(member, "bounds", None)
    if bounds is None or not np.isfinite(np.asarray(bounds, float)).all():
        return []
    low, high = in_space(np.asarray(bounds))
    corners = np.array(
        [
            [x, y, z]
            for x in (low[0], high[0])
            for y in (low[1], high[1])
            for z in (low[2], high[2])
        ],
        np.float32,
    )
    named = f"{name}-bounds" if name else "bounds"
    return [Drawable(named, "lines", corners, _BOX_EDGES, still=True)]
