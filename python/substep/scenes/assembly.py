"""The simulation that a scene in a TOML file describes, and what is recorded of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..base.quaternions import rotate
from ..coupling import World
from ..errors import InputError
from ..geometry import (
    AnimatedMesh,
    Box,
    Capsule,
    Collider,
    Cylinder,
    Keyframes,
    Plane,
    Sphere,
    TriangleMesh,
    follow_keyframes,
)
from ..gridfluid import GridLiquid
from ..mpm import MaterialPointMethod
from ..pbf import PositionBasedFluid, fill_box, fill_mesh
from ..rigid import RigidBodies
from .declaration import Parameter, Scene, particle_frame, particle_parts
from .toml_deforming import (
    make_deforming,
    put_on_skin,
    quaternion,
    read_animation,
    read_surface,
)
from .toml_file import Layout, read_layout
from .toml_rules import DEFORMING, MATERIALS

if TYPE_CHECKING:
    from ..recording import Part

Array = NDArray[np.float64]


class Assembly:
    """A simulation with its obstacles, which may move along keyframes, and its bodies.

    Attributes
    ----------
    simulation : simulation or World
        What is advanced.
    """

    def __init__(
        self,
        simulation: Any,
        obstacles: list[tuple[Collider, TriangleMesh | None]],
        paths: list[tuple[Collider, Keyframes]],
        surfaces: list[TriangleMesh],
        faces: NDArray[np.int64] | None = None,
    ) -> None:
        self.simulation = simulation
        self._obstacles, self._paths, self._surfaces = obstacles, paths, surfaces
        self._faces = faces  # of the particles, where they do not know them
        self._obstacles = self._with_planes()

    @property
    def time(self) -> float:
        """Time of the state [s]."""
        return float(self.simulation.time)

    def advance(self, duration: float) -> None:
        """Go on by `duration` [s]."""
        follow_keyframes(self.simulation, duration, self._paths)

    def fields(self) -> Any:
        """Those of the simulation."""
        return self.simulation.fields()

    def diagnostics(self) -> dict[str, float]:
        """Those of the simulation."""
        return dict(self.simulation.diagnostics())

    def state(self) -> Any:
        """A copy of the whole state."""
        return self.simulation.state()

    def restore(self, state: Any) -> None:
        """Go back to a state, bit for bit."""
        self.simulation.restore(state)

    def save(self, path: Any) -> None:
        """Write the whole state to a file."""
        self.simulation.save(path)

    def load(self, path: Any) -> None:
        """Read the whole state from a file."""
        self.simulation.load(path)

    @property
    def _members(self) -> dict[str, Any]:
        return dict(getattr(self.simulation, "members", {"particles": self.simulation}))

    @property
    def _bodies(self) -> RigidBodies | None:
        found = [m for m in self._members.values() if isinstance(m, RigidBodies)]
        return found[0] if found else None

    @property
    def _particles(self) -> Any:
        return self._members.get("particles")

    @property
    def _animations(self) -> dict[str, AnimatedMesh]:
        return {k: m for k, m in self._members.items() if isinstance(m, AnimatedMesh)}

    def parts(self) -> dict[str, Part]:
        """Particles with all fields, surfaces of the bodies, and of the obstacles that have one."""
        from ..recording import Part

        parts = {} if self._particles is None else particle_parts(self._particles)
        if self._faces is not None and parts["particles"].kind == "particles":
            parts["particles"] = Part("mesh", parts["particles"].fields, triangles=self._faces)
        if self._surfaces:
            parts["bodies"] = Part("mesh", triangles=_stacked(self._surfaces))
        for name, animation in self._animations.items():
            parts[name] = particle_parts(animation)["particles"]
        for k, (collider, mesh) in enumerate(self._obstacles):
            if mesh is not None:
                still = None if self._moves(collider) else _placed(collider, mesh)
                parts[f"obstacle-{k}"] = Part("mesh", triangles=mesh.faces, points=still)
        return parts

    def frame(self) -> dict[str, dict[str, Any]]:
        """One frame of `parts`."""
        frame = {} if self._particles is None else particle_frame(self._particles)
        bodies = self._bodies
        if bodies is not None:
            turned = [
                rotate(np.broadcast_to(q, (len(mesh.vertices), 4)), mesh.vertices) + x
                for x, q, mesh in zip(
                    bodies.positions, bodies.rotations, self._surfaces, strict=False
                )
            ]
            frame["bodies"] = {"points": np.concatenate(turned)}
        for name, animation in self._animations.items():
            frame[name] = particle_frame(animation)["particles"]
        for k, (collider, mesh) in enumerate(self._obstacles):
            if mesh is not None and self._moves(collider):
                frame[f"obstacle-{k}"] = {"points": _placed(collider, mesh)}
        return frame

    def _with_planes(self) -> list[tuple[Collider, TriangleMesh | None]]:
        """The obstacles; of a plane, which has no end, a square below what there is at first."""
        if not any(isinstance(collider.shape, Plane) for collider, _ in self._obstacles):
            return self._obstacles
        from ..view.drawables import square_of

        seen = [arrays["points"] for arrays in self.frame().values()]
        seen += [part.points for part in self.parts().values() if part.points is not None]
        x = np.concatenate(seen)
        whole = []
        for collider, mesh in self._obstacles:
            if isinstance(collider.shape, Plane) and not collider.hollow:
                place = collider.rotation, collider.position
                half = 0.5  # so that it does not become the most of a picture
                square = square_of(collider.shape, *place, x.min(axis=0), x.max(axis=0), half)
                mesh = TriangleMesh(*square)
            whole.append((collider, mesh))
        return whole

    def _moves(self, collider: Collider) -> bool:
        guided = any(collider is one for one, _ in self._paths)
        return guided or bool(collider.velocity.any() or collider.angular_velocity.any())


def _placed(collider: Collider, mesh: TriangleMesh) -> Array:
    q = np.broadcast_to(collider.rotation, (len(mesh.vertices), 4))
    return rotate(q, mesh.vertices) + collider.position


def _stacked(meshes: list[TriangleMesh]) -> NDArray[np.int64]:
    first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return np.concatenate([mesh.faces + n for mesh, n in zip(meshes, first, strict=True)])


def read_scene(path: Path) -> Scene:
    """The scene that a TOML file declares.

    Raises
    ------
    FormatError, InputError, OSError
        As `read_layout` does.
    """
    layout = read_layout(path)
    scene = layout.scene
    parameters = {"duration": Parameter("time simulated", scene["duration"], unit="s", above=0)}
    if "spacing" in scene:
        parameters["spacing"] = Parameter("of the particles", scene["spacing"], unit="m", above=0)
    try:
        return Scene(
            name=scene.get("name", path.stem),
            doc=scene.get("doc", f"The scene of {path.name}."),
            parameters=parameters,
            build=lambda values, seed: assemble(layout, values),
            parts=Assembly.parts,
            frame=Assembly.frame,
            frames=scene.get("frames", 101),
        )
    except InputError as error:
        raise InputError(f"{layout.where('name', 'scene')}: {error}") from None


def assemble(layout: Layout, values: dict[str, Any]) -> Assembly:
    """Build what a file says, with the scene's parameters.

    Raises
    ------
    InputError
        If the parts do not fit together; the message begins with the file.
    """
    try:
        return _assemble(layout, values)
    except InputError as error:
        if str(error).startswith(str(layout.path)):
            raise
        raise InputError(f"{layout.path}: {error}") from error


def _assemble(layout: Layout, values: dict[str, Any]) -> Assembly:
    scene = layout.scene
    gravity = scene.get("gravity", (0.0, 0.0, -9.81))
    obstacles, paths = [], []
    animations: dict[str, AnimatedMesh] = {}
    facets: list[Collider] = []
    for i, row in enumerate(layout.obstacle):
        with layout.told("obstacle", row, i):
            if row["shape"] == "animation":
                one = animations[f"animation_{i}"] = read_animation(layout, row, i)
                options = {"friction": row["friction"]} if "friction" in row else {}
                facets += one.make_colliders(row["thickness"], **options)
                continue
            obstacles.append(_obstacle(layout, row, i))
            if "keyframes" in row:
                paths.append((obstacles[-1][0], _path(row["keyframes"])))
    bodies, surfaces, standing = None, [], []
    if layout.body:
        options = layout.options if scene["method"] == "rigid" else {}
        bodies = RigidBodies(gravity=gravity, step=1 / 120, **options)
        added = []
        for i, row in enumerate(layout.body):
            with layout.told("body", row, i):
                shape, mesh = _shape(layout, row, "body", i)
            keys = ("velocity", "angular_velocity")
            motion = {f"{k[:-1]}ies": row[k] for k in keys if k in row}
            options = {k: row[k] for k in ("friction", "restitution", "density") if k in row}
            place = row.get("position", (0.0, 0.0, 0.0))
            turn = quaternion(row.get("rotation_deg", (0.0, 0.0, 0.0)))
            assert mesh is not None
            with layout.told("body", row, i):
                added.append(int(bodies.add(shape, place, turn, **motion, **options)))
            surfaces.append(mesh)
        for row, (collider, _) in zip(layout.obstacle, obstacles, strict=True):
            _stand(bodies, row, collider)
        standing = bodies.make_colliders(added)
    if scene["method"] == "rigid":
        assert bodies is not None
        return Assembly(World({"bodies": bodies}), obstacles, paths, surfaces)
    colliders = [*(collider for collider, _ in obstacles), *standing, *facets]
    with layout.told("scene", scene), layout.told("options", layout.options):
        given = layout, values["spacing"], gravity, colliders
        if scene["method"] in DEFORMING:
            particles, faces = make_deforming(*given)
        else:
            particles, faces = _particles(*given), None
    if layout.skin:
        with layout.told("skin", layout.skin):
            put_on_skin(layout, particles)
    simulation: Any = particles
    if bodies is not None or animations:
        first = {} if bodies is None else {"bodies": bodies}
        simulation = World({**first, "particles": particles, **animations})
    return Assembly(simulation, obstacles, paths, surfaces, faces)


def _path(frames: list[dict[str, Any]]) -> Keyframes:
    turns = [quaternion(frame.get("rotation_deg", (0.0, 0.0, 0.0))) for frame in frames]
    return Keyframes([f["time"] for f in frames], [f["position"] for f in frames], turns)


def _obstacle(
    layout: Layout, row: dict[str, Any], number: int
) -> tuple[Collider, TriangleMesh | None]:
    """An obstacle in its first place, and its surface in its own frame, if it is to be drawn."""
    shape, mesh = _shape(layout, row, "obstacle", number)
    options = {
        key: row[key]
        for key in ("friction", "restitution", "velocity", "angular_velocity", "hollow")
        if key in row
    }
    collider = Collider(shape, **options)
    first = row["keyframes"][0] if "keyframes" in row else row
    collider.position = first.get("position", (0.0, 0.0, 0.0))
    turn = quaternion(first.get("rotation_deg", (0.0, 0.0, 0.0)))
    if row["shape"] != "plane":
        collider.rotation = turn
    return collider, None if row.get("hollow") else mesh


def _shape(
    layout: Layout, row: dict[str, Any], table: str, number: int
) -> tuple[Any, TriangleMesh | None]:
    """A shape about the origin, and its surface."""
    kind = row["shape"]
    if kind == "plane":
        return Plane(row["normal"]), None
    if kind == "mesh":
        mesh = read_surface(layout, row, table, number)
        return mesh, mesh
    shape: Sphere | Box | Capsule | Cylinder
    if kind == "sphere":
        shape = Sphere(row["radius"])
    elif kind == "box":
        shape = Box(row["lengths"])
    else:
        shape = (Capsule if kind == "capsule" else Cylinder)(row["radius"], row["length"])
    return shape, shape.mesh()


def _stand(bodies: RigidBodies, row: dict[str, Any], collider: Collider) -> None:
    """The obstacle as a static body; a hollow box as six planes that look inward."""
    surface = {key: row[key] for key in ("friction", "restitution") if key in row}
    x, q = collider.position, collider.rotation
    if not row.get("hollow"):
        bodies.add(collider.shape, x, q, motion="static", **surface)
        return
    for axis, length in enumerate(row["lengths"]):
        for side in (-1.0, 1.0):
            normal = np.zeros(3)
            normal[axis] = -side
            inward = rotate(q, normal)
            wall = Plane(inward, x - length / 2 * inward)
            bodies.add(wall, (0, 0, 0), motion="static", **surface)


def _filled(
    layout: Layout, row: dict[str, Any], number: int, spacing: float
) -> tuple[Array, Box | TriangleMesh]:
    """The particles of a block, and its shape."""
    if "file" in row:
        mesh = read_surface(layout, row, "block", number)
        return fill_mesh(mesh, spacing), mesh
    low, high = np.array(row["low"]), np.array(row["high"])
    return fill_box(low, high, spacing), Box(high - low, (low + high) / 2)


def _particles(layout: Layout, spacing: float, gravity: Any, colliders: list[Collider]) -> Any:
    """The particles of all blocks that no obstacle takes the place of."""
    places: list[Array] = []
    insides: list[Collider] = []
    speeds, kinds = [], []
    for i, row in enumerate(layout.block):
        with layout.told("block", row, i):
            x, shape = _filled(layout, row, i, spacing)
            found = len(x)
            for collider in colliders:
                x = x[collider.distance(x) > (0.5 - 1e-6) * spacing]
            where = layout.where("file" if "file" in row else "low", "block", i)
            if not len(x):
                told = "obstacles or bodies fill it" if found else "make spacing smaller"
                raise InputError(f"{where}: no particle fits into the block: {told}")
            inside = Collider(shape)
            for k, (other, x_other) in enumerate(zip(insides, places, strict=True)):
                depth = min(other.distance(x).min(), inside.distance(x_other).min())
                if depth < -1e-6 * spacing:
                    raise InputError(f"{where}: block {i + 1} overlaps block {k + 1}")
        places.append(x)
        insides.append(inside)
        speeds.append(np.broadcast_to(row.get("velocity", (0.0, 0.0, 0.0)), x.shape))
        kinds.append(np.full(len(x), row["kind"]))
    x, v, kind = np.concatenate(places), np.concatenate(speeds), np.concatenate(kinds)
    shared = {"velocities": v, "gravity": gravity, "colliders": colliders, **layout.options}
    method = layout.scene["method"]
    if method == "pbf":
        return PositionBasedFluid(x, spacing, **shared)
    if method == "grid-liquid":
        return GridLiquid(x, cell=2 * spacing, bounds=layout.scene["bounds"], **shared)
    materials = [
        MATERIALS[row["class"]](**{k: u for k, u in row.items() if k not in ("name", "class")})
        for row in layout.material
    ]
    return MaterialPointMethod(
        x, materials, cell=2 * spacing, volume=spacing**3, kinds=kind, **shared
    )
