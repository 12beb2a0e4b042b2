"""What `mujoco` compiles of an MJCF or URDF file, in the words of rigid bodies."""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from ..base.checks import check_array, check_choice, check_flag, check_path, check_real, describe
from ..base.imports import needs
from ..base.quaternions import multiply, rotate
from ..errors import FormatError, InputError
from ..geometry import Box, Capsule, ConvexHull, Cylinder, Plane, Shape, Sphere
from .fixtures import Fixture, check_range
from .joint import Motor, SpeedMotor, SpringMotor, check_limits
from .mass import MassProperties, compound

Array = NDArray[np.float64]
Pose = tuple[Array, Array]  # of a frame in the world: where it is, and its quaternion

LIGHT = 1e-5  # mass and inertia of links between joints of a body, over its mass and least inertia
_ORIGIN: Pose = (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
_SURFACE: dict[str, Any] = {  # where the file says nothing
    "density": 1000.0,
    "friction": 0.5,
    "restitution": 0.0,
    "rolling_friction": 0.0,
    "spinning_friction": 0.0,
}
_SOFTNESS = {  # of contacts, and what says nothing
    "geom_solref": (0.02, 1.0),
    "geom_solimp": (0.9, 0.95, 0.001, 0.5, 2.0),
    "geom_margin": 0.0,
    "geom_gap": 0.0,
    "geom_priority": 0,
    "geom_adhesion": 0.0,
    "geom_surfacevel": 0.0,
}


@dataclass
class Body:
    """A body to be added, at the pose in which its joints have the coordinate 0."""

    name: str  # for messages
    pose: Pose
    motion: str
    mass: MassProperties | None = None
    fixtures: list[Fixture] = field(default_factory=list)
    start: Pose = _ORIGIN


@dataclass
class Link:
    """A joint between two of these bodies; b None is the world."""

    name: str  # for messages
    kind: str
    a: int
    b: int | None
    anchor: Array
    axis: Array
    limits: tuple[float, float] | None = None
    motor: Motor | None = None
    collide: bool = False
    start: float = 0.0  # coordinate


@dataclass
class Plan:
    """What a file makes: bodies and joints by number, and their names."""

    file: str
    gravity: list[float]
    bodies: list[Body] = field(default_factory=list)
    links: list[Link] = field(default_factory=list)
    excluded: list[tuple[int, int]] = field(default_factory=list)
    pairs: list[tuple[str, str, dict[str, float]]] = field(default_factory=list)  # of materials
    body_names: dict[str, int] = field(default_factory=dict)
    link_names: dict[str, int] = field(default_factory=dict)
    strengths: dict[str, float] = field(default_factory=dict)
    ignored: tuple[str, ...] = ()


def read_plan(
    path: str | os.PathLike[str],
    root: str,
    *,
    free_base: bool = False,
    keyframe: str | None = None,
    coordinates: Mapping[str, float] | None = None,
) -> Plan:
    """What to make of a file whose outermost element is `root`."""
    file = check_path(path)
    free = check_flag("free_base", free_base)
    if coordinates is not None and not isinstance(coordinates, Mapping):
        raise TypeError(f"coordinates: expected a dict, got {describe(coordinates)}")
    text = Path(file).read_bytes().decode("utf-8", "replace")
    found = re.search(r"<([A-Za-z_][\w.-]*)", re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL))
    if found is None or found[1] != root:
        raise FormatError(f"{file}: expected an XML file of an element <{root}>")
    told = 'mujoco is missing: pip install "substep[robots]" to read MJCF and URDF'
    with needs("mujoco", told):
        import mujoco
    try:
        with _warnings_of(mujoco) as warned:
            spec = mujoco.MjSpec.from_file(file)
            if root == "robot":
                spec.compiler.fusestatic = False  # links that are fixed keep their names
            if free:
                _free_base(spec)
            model = spec.compile()
    except InputError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        raise FormatError(f"{file}: {' '.join(str(error).split())}") from None
    reader = _Reader(mujoco, model, file)
    if root == "robot":
        for name in _check_limits(file, text):
            reader.leave("limits of the velocity of joints", name)
    for warning in warned:
        reader.leave("what MuJoCo warns of", " ".join(warning.split()))
    return reader.plan(keyframe, coordinates or {})


@contextmanager
def _warnings_of(mujoco: Any) -> Iterator[list[str]]:
    """What MuJoCo warns of, which else it prints and writes to MUJOCO_LOG.TXT."""
    told: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(told.append)
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            yield told
    finally:
        mujoco.set_mju_user_warning(before)
        told += [str(warning.message) for warning in warned]


@contextmanager
def element(file: str, name: str) -> Iterator[None]:
    """Say of which element of a file a number is refused."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # what comes of it is refused
            yield
    except InputError as error:
        raise InputError(f"{file}: {name}: {error}") from None


def _check_limits(file: str, text: str) -> list[str]:
    """Refuse limits of a URDF file that MuJoCo takes for none, without a word.

    Which joints have a limit of their velocity, of which MuJoCo knows nothing.
    """
    joint = {"name": "", "type": ""}
    limited: list[str] = []

    def start(tag: str, has: dict[str, str]) -> None:
        if tag == "joint":
            joint.update({"name": "", "type": "", **has})
        elif tag == "limit" and joint["type"] in ("revolute", "prismatic", "continuous"):
            try:
                given = {name: float(has.get(name, 0)) for name in ("lower", "upper", "effort")}
            except ValueError as error:
                raise FormatError(f"{file}: joint '{joint['name']}': limit: {error}") from None
            with element(file, f"joint '{joint['name']}'"):
                check_real("effort", given["effort"], nonnegative=True, finite=False)
                if joint["type"] != "continuous":
                    check_limits("lower, upper", [given["lower"], given["upper"]])
            if "velocity" in has:
                limited.append(joint["name"])

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise FormatError(f"{file}: {error}") from None
    return limited


def _free_base(spec: Any) -> None:
    """Let the root link go, which URDF leaves open and MuJoCo fixes to the world."""
    roots = list(spec.worldbody.bodies)
    if len(roots) != 1 or len(roots[0].joints):
        raise InputError("free_base: expected a file with one root link, not named 'world'")
    roots[0].add_freejoint()


def compose(a: Pose, b: Pose) -> Pose:
    """The pose of a frame that is at b in a frame that is at a."""
    return a[0] + rotate(a[1], b[0]), multiply(a[1], b[1])


def inverse(a: Pose) -> Pose:
    """The pose of the world in a frame that is at a."""
    back = a[1] * (1.0, -1.0, -1.0, -1.0)
    return -rotate(back, a[0]), back


class _Reader:
    """Goes through a compiled model (https://mujoco.readthedocs.io: Modeling, MjModel)."""

    def __init__(self, mujoco: Any, model: Any, file: str) -> None:
        self.mj, self.m, self.file = mujoco, model, file
        self.left: dict[str, list[str]] = {}
        self.names: dict[str, list[str]] = {}
        self.number: dict[int, int] = {}  # of ours, of bodies of MuJoCo
        self.between: dict[int, int] = {}  # of ours, of joints of MuJoCo after which a link stands
        self.link_of: dict[int, int] = {}  # of ours, of joints of MuJoCo

    def plan(self, keyframe: str | None, coordinates: Mapping[str, float]) -> Plan:
        m = self.m
        if m.nflex:
            raise FormatError(f"{self.file}: {m.nflex} deformable bodies (flex) are not supported")
        with self.element("option"):
            check_array("gravity", m.opt.gravity)
        self.made = Plan(self.file, m.opt.gravity.tolist())
        self.rest, self.rest_links = self.kinematics(m.qpos0)
        with np.errstate(over="ignore", invalid="ignore"):  # weight() looks at each
            axes = rotate(m.body_iquat[:, None], np.eye(3))  # rows: the principal axes
            self.inertia = np.swapaxes(axes, 1, 2) @ (m.body_inertia[:, :, None] * axes)
        self.welded: dict[int, list[int]] = {}
        for i, root in enumerate(m.body_weldid.tolist()):
            self.welded.setdefault(root, []).append(i)
        self.read_bodies()
        self.read_geometries()
        self.read_pairs()
        qpos, ctrl = self.read_start(keyframe, coordinates)
        for joint in range(m.njnt):
            with self.element("joint", joint):
                self.read_joint(joint, qpos)
        self.read_actuators(qpos, ctrl)
        self.read_equalities()
        for signature in m.exclude_signature:
            self.exclude(int(signature) >> 16, int(signature) & 0xFFFF)
        self.read_rest()
        self.place(qpos)
        told = (f"{what}: {', '.join(names)}" for what, names in self.left.items())
        self.made.ignored = tuple(told)
        return self.made

    def name(self, kind: str, number: int) -> str:
        """As in the file; what has none is called by its number, by none that is in the file."""
        if kind not in self.names:
            given = self.given_names(kind)
            taken = set(given)
            if kind in ("joint", "equality"):  # both are joints of ours
                taken |= {*self.given_names("joint"), *self.given_names("equality")}
            self.names[kind] = [
                name or _other(f"{kind}_{k}", taken) for k, name in enumerate(given)
            ]
        return self.names[kind][number]

    def given_names(self, kind: str) -> list[str | None]:
        m = self.m
        what = getattr(self.mj.mjtObj, f"mjOBJ_{kind.upper()}")
        counts = {"body": m.nbody, "joint": m.njnt, "geom": m.ngeom, "equality": m.neq}
        counts |= {"actuator": len(m.actuator_trntype), "key": m.nkey, "pair": m.npair}
        return [self.mj.mj_id2name(m, what, k) for k in range(counts[kind])]

    def element(self, kind: str, number: int | None = None) -> Any:
        """Name the element in what is raised within."""
        return element(self.file, kind if number is None else self.called(kind, number))

    def called(self, kind: str, number: int) -> str:
        """For messages."""
        word = {"geom": "geometry", "key": "keyframe"}.get(kind, kind)
        return f"{word} '{self.name(kind, number)}'"

    def place_in(self, root: int, body: int) -> Pose:
        """Of a body in the frame of the one that it is welded to."""
        return compose(inverse(self.rest[root]), self.rest[body])

    def leave(self, what: str, name: str) -> None:
        """Note something that is not taken over."""
        names = self.left.setdefault(what, [])
        if name not in names:
            names.append(name)

    def kinematics(self, qpos: Array) -> tuple[list[Pose], dict[int, Pose]]:
        """Poses of all bodies, and of what stands between several joints of one, by the joint."""
        m, types = self.m, self.mj.mjtJoint
        poses, between = [_ORIGIN], {}
        for i in range(1, m.nbody):
            own = m.body_pos[i].copy(), m.body_quat[i].copy()
            self.check_pose("body", i, own)
            pose = compose(poses[m.body_parentid[i]], own)
            self.check_pose("body", i, pose)
            for j in self.joints_of(i):
                at = m.jnt_qposadr[j]
                y = float(qpos[at]) - float(m.qpos0[at])
                if m.jnt_type[j] == types.mjJNT_FREE:
                    pose = (qpos[at : at + 3].copy(), qpos[at + 3 : at + 7].copy())
                elif m.jnt_type[j] == types.mjJNT_SLIDE:
                    pose = compose(pose, (y * m.jnt_axis[j], _ORIGIN[1]))
                else:
                    turn = qpos[at : at + 4].copy()
                    if m.jnt_type[j] == types.mjJNT_HINGE:
                        y = y if math.isfinite(y) else math.nan
                        turn = np.append(math.cos(y / 2), math.sin(y / 2) * m.jnt_axis[j])
                    anchor = m.jnt_pos[j]
                    pose = compose(pose, (anchor - rotate(turn, anchor), turn))
                self.check_pose("joint", j, pose)
                between[j] = pose
            poses.append(pose)
        return poses, between

    def check_pose(self, kind: str, number: int, pose: Pose) -> None:
        """Refuse numbers of an element by which bodies are nowhere."""
        far, length = math.hypot(*pose[0].tolist()), math.hypot(*pose[1].tolist())
        if not (far < 1e150 and abs(length - 1) < 1e-6):
            with self.element(kind, number):
                x, q = pose[0].tolist(), pose[1].tolist()
                raise InputError(f"expected a finite place and a rotation, got {x} and {q}")

    def joints_of(self, body: int) -> range:
        first = int(self.m.body_jntadr[body])
        return range(first, first + int(self.m.body_jntnum[body]))

    def read_bodies(self) -> None:
        """What MuJoCo welds is one body of ours; what is welded to the world is several."""
        m, bodies = self.m, self.made.bodies
        for i in range(m.nbody):
            root = int(m.body_weldid[i])
            if root == i and i:
                self.number[i] = len(bodies)
                moved = m.body_mocapid[i] >= 0  # by the user
                weight = None if moved else self.weight(i)
                motion = "kinematic" if moved else "dynamic"
                bodies.append(Body(self.called("body", i), self.rest[i], motion, weight))
                for j in self.joints_of(i)[:-1]:
                    self.between[j] = len(bodies)
                    bodies.append(self.light(i, j))
            elif root == 0 and m.body_geomnum[i]:
                self.number[i] = len(bodies)
                bodies.append(Body(self.called("body", i), self.rest[i], "static"))
            elif root:
                self.number[i] = self.number[root]
            if i in self.number:
                self.made.body_names[self.name("body", i)] = self.number[i]
            if m.body_gravcomp[i]:
                self.leave("gravity compensation of bodies", self.name("body", i))

    def weight(self, root: int) -> MassProperties:
        """Of a body and of all that is welded to it, in its frame."""
        m, parts = self.m, []
        for i in self.welded[root]:
            if m.body_mass[i] == 0:
                continue
            with self.element("body", i):
                inertia = self.inertia[i]
                part = MassProperties(
                    float(m.body_mass[i]), m.body_ipos[i], (inertia + inertia.T) / 2
                )
                check_range(part.mass, part.inertia)
                parts.append(part if i == root else part.moved(*self.place_in(root, i)))
        if not parts:
            raise FormatError(f"{self.file}: body '{self.name('body', root)}' moves without a mass")
        with self.element("body", root):
            return parts[0] if len(parts) == 1 else compound(parts)

    def light(self, body: int, joint: int) -> Body:
        """What stands between two joints of a body: a point at the anchor, next to no mass."""
        weight = self.weight(body)
        inertia = LIGHT * weight.principal_inertia.min() * np.eye(3)
        own = MassProperties(LIGHT * weight.mass, self.m.jnt_pos[joint], inertia)
        return Body(self.called("joint", joint), self.rest_links[joint], "dynamic", own)

    def read_geometries(self) -> None:
        m, bodies = self.m, self.made.bodies
        types = list(zip(m.geom_contype.tolist(), m.geom_conaffinity.tolist(), strict=True))
        kinds = [(1, 1), *sorted(set(types) - {(1, 1), (0, 0)})]  # of a group each
        if len(kinds) > 32:
            raise FormatError(f"{self.file}: more than 32 pairs of contype and conaffinity")
        disabled = m.opt.disableflags & self.mj.mjtDisableBit.mjDSBL_CONTACT
        paired = {*m.pair_geom1.tolist(), *m.pair_geom2.tolist()}
        hidden: dict[int, list[Fixture]] = {}  # what touches nothing, by body
        for g in range(m.ngeom):
            i = int(m.geom_bodyid[g])
            number = self.number[i]
            root = int(m.body_weldid[i]) or i
            pose = m.geom_pos[g].copy(), m.geom_quat[g].copy()
            with self.element("geom", g):
                shape = self.shape(g, pose if i == root else compose(self.place_in(root, i), pose))
            if types[g] == (0, 0) or disabled:
                hidden.setdefault(number, []).append(_hidden(shape))
                continue
            contype, conaffinity = types[g]
            touching = [k for k, (c, a) in enumerate(kinds) if contype & a or c & conaffinity]
            surface = _surface(m.geom_condim[g], *m.geom_friction[g].tolist())
            group, mask = 1 << kinds.index(types[g]), sum(1 << k for k in touching)
            material = self.name("geom", g) if g in paired else None
            with self.element("geom", g):
                fixture = Fixture(
                    shape, group=group, mask=mask, material=material, **{**_SURFACE, **surface}
                )
            bodies[number].fixtures.append(fixture)
        for number, body in enumerate(bodies):
            if not body.fixtures:
                body.fixtures = hidden.pop(number, []) or [_point(body.mass)]
        if hidden:
            count = sum(map(len, hidden.values()))
            self.leave("geometries that touch nothing", str(count))

    def read_pairs(self) -> None:
        """Friction of two shapes that touch anyway."""
        m = self.m
        disabled = m.opt.disableflags & self.mj.mjtDisableBit.mjDSBL_CONTACT
        excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in m.exclude_signature}
        for p in range(m.npair):
            g, h = int(m.pair_geom1[p]), int(m.pair_geom2[p])
            i, j = int(m.geom_bodyid[g]), int(m.geom_bodyid[h])
            x, y = (int(m.body_weldid[k]) for k in (i, j))
            parents = [int(m.body_weldid[m.body_parentid[k]]) for k in (x, y)]
            joined = parents[0] == y > 0 or parents[1] == x > 0 or {(i, j), (j, i)} & excluded
            bits = m.geom_contype[g] & m.geom_conaffinity[h]
            bits |= m.geom_contype[h] & m.geom_conaffinity[g]
            slide, other, spin, roll, _ = m.pair_friction[p].tolist()
            turned = slide != other and m.pair_dim[p] > 1  # a coefficient in each direction
            if disabled or not bits or joined or x == y or turned:
                self.leave("contact pairs", self.name("pair", p))
                continue
            surface = _surface(m.pair_dim[p], slide, spin, roll)
            names = (self.name("geom", g), self.name("geom", h))
            self.made.pairs.append((*names, surface))

    def shape(self, g: int, pose: Pose) -> Shape:
        m, types = self.m, self.mj.mjtGeom
        size, kind = m.geom_size[g], types(m.geom_type[g])
        if kind == types.mjGEOM_SPHERE:
            return Sphere(size[0], pose[0])
        if kind == types.mjGEOM_BOX:
            return Box(2 * size, *pose)
        if kind == types.mjGEOM_CAPSULE:
            return Capsule(size[0], 2 * size[1], *pose)
        if kind == types.mjGEOM_CYLINDER:
            return Cylinder(size[0], 2 * size[1], *pose)
        if kind == types.mjGEOM_PLANE:
            return Plane(rotate(pose[1], np.array([0.0, 0.0, 1.0])), pose[0])
        if kind == types.mjGEOM_MESH:
            mesh = m.geom_dataid[g]
            first = m.mesh_vertadr[mesh]
            return ConvexHull(m.mesh_vert[first : first + m.mesh_vertnum[mesh]], *pose)
        if kind == types.mjGEOM_ELLIPSOID:
            self.leave("ellipsoids, which are hulls of 482 points", self.name("geom", g))
            return ConvexHull(Sphere(1.0).mesh().vertices * size, *pose)
        word = {types.mjGEOM_HFIELD: "height field", types.mjGEOM_SDF: "signed distance field"}
        raise FormatError(
            f"{self.file}: geometry '{self.name('geom', g)}' is a "
            f"{word.get(kind, kind.name)}, which is not supported"
        )

    def read_start(
        self, keyframe: str | None, coordinates: Mapping[str, float]
    ) -> tuple[Array, Array | None]:
        """Where the joints are at first, and the controls, if a keyframe gives them."""
        m = self.m
        qpos, ctrl = m.qpos0.copy(), None
        if keyframe is not None:
            names = [self.name("key", k) for k in range(m.nkey)]
            k = names.index(check_choice("keyframe", keyframe, names))
            qpos, ctrl = m.key_qpos[k].copy(), m.key_ctrl[k].copy()
            with self.element("key", k):
                check_array("qpos", qpos)
            if m.key_qvel[k].any():
                self.leave("velocities of the keyframe", keyframe)
        single = (self.mj.mjtJoint.mjJNT_HINGE, self.mj.mjtJoint.mjJNT_SLIDE)
        joints = {self.name("joint", j): j for j in range(m.njnt) if int(m.jnt_type[j]) in single}
        for name, value in coordinates.items():
            at = m.jnt_qposadr[joints[check_choice("coordinates", name, joints)]]
            qpos[at] = m.qpos0[at] + check_real(f"coordinates[{name!r}]", value)
        return qpos, ctrl

    def read_joint(self, j: int, qpos: Array) -> None:
        m, types, name = self.m, self.mj.mjtJoint, self.name("joint", j)
        kind, i = types(m.jnt_type[j]), int(m.jnt_bodyid[j])
        at, dof = m.jnt_qposadr[j], m.jnt_dofadr[j]
        width = {types.mjJNT_FREE: 6, types.mjJNT_BALL: 3}.get(kind, 1)
        dofs = slice(dof, dof + width)
        if m.dof_armature[dofs].any():
            self.leave("armature of joints", name)
        polynomials = (("jnt_stiffnesspoly", j), ("dof_dampingpoly", dofs))  # of newer versions
        if any(hasattr(m, what) and np.any(getattr(m, what)[at]) for what, at in polynomials):
            self.leave("stiffness and damping that are not linear, of joints", name)
        stiffness, damping = float(m.jnt_stiffness[j]), float(m.dof_damping[dof])
        loss = float(m.dof_frictionloss[dof])
        if width > 1:
            for what, has in (
                ("springs", stiffness),
                ("damping", damping),
                ("friction", loss),
                ("limits", m.jnt_limited[j]),
            ):
                if has:
                    self.leave(f"{what} of free and ball joints", name)
            if kind == types.mjJNT_FREE:
                return
        joints = self.joints_of(i)
        a = self.between.get(j, self.number[i])
        if j > joints[0]:
            b: int | None = self.between[j - 1]
        else:
            b = self.number.get(int(m.body_parentid[i])) if m.body_parentid[i] else None
        frame = self.rest[i]
        link = Link(
            self.called("joint", j),
            {types.mjJNT_BALL: "ball", types.mjJNT_SLIDE: "slider"}.get(kind, "hinge"),
            a,
            b,
            frame[0] + rotate(frame[1], m.jnt_pos[j]),
            rotate(frame[1], m.jnt_axis[j]),
        )
        if j == joints[-1] and len(joints) > 1 and m.body_parentid[i]:
            self.exclude(i, int(m.body_parentid[i]))
        if width == 1:
            ref = float(m.qpos0[at])
            link.start = float(qpos[at]) - ref
            if ref:
                self.leave("ref, from which coordinates of joints count", f"{name} ({ref:g})")
            bounds = _numbers("range", m.jnt_range[j])
            if m.jnt_limited[j]:
                lower, upper = link.limits = check_limits("range", bounds - ref)
                if not lower - 1e-9 <= link.start <= upper + 1e-9:
                    self.leave("a start beyond their limits, of joints", name)
            if stiffness or damping:
                link.motor = SpringMotor(float(m.qpos_spring[at]) - ref, stiffness, damping)
                if loss:
                    self.leave("friction of joints with a spring or a damper", name)
            elif loss:
                link.motor = SpeedMotor(0.0, loss)
            self.made.strengths[name] = (
                _least(m.jnt_actfrcrange[j]) if m.jnt_actfrclimited[j] else math.inf
            )
        self.link_of[j] = self.made.link_names[name] = len(self.made.links)
        self.made.links.append(link)

    def read_actuators(self, qpos: Array, ctrl: Array | None) -> None:
        """Servos of positions are springs of joints; of motors the strength is kept."""
        m, mj = self.m, self.mj
        driven: set[int] = set()
        on_joints = (mj.mjtTrn.mjTRN_JOINT, mj.mjtTrn.mjTRN_JOINTINPARENT)
        plain = (mj.mjtBias.mjBIAS_NONE, mj.mjtBias.mjBIAS_AFFINE)
        for k in range(len(m.actuator_trntype)):
            name, j = self.name("actuator", k), int(m.actuator_trnid[k, 0])
            gear = float(m.actuator_gear[k, 0])
            gain, bias = m.actuator_gainprm[k], m.actuator_biasprm[k]
            if (
                int(m.actuator_trntype[k]) not in on_joints
                or int(m.jnt_type[j]) not in (mj.mjtJoint.mjJNT_HINGE, mj.mjtJoint.mjJNT_SLIDE)
                or m.actuator_dyntype[k] != mj.mjtDyn.mjDYN_NONE
                or m.actuator_gaintype[k] != mj.mjtGain.mjGAIN_FIXED
                or int(m.actuator_biastype[k]) not in plain
                or not gear
            ):
                self.leave("actuators", name)
                continue
            strength = self.made.strengths[self.name("joint", j)]
            is_motor = m.actuator_biastype[k] == mj.mjtBias.mjBIAS_NONE
            with self.element("actuator", k):
                forces = _numbers("forcerange", m.actuator_forcerange[k])
                controls = _numbers("ctrlrange", m.actuator_ctrlrange[k])
                if m.actuator_forcelimited[k]:
                    strength = min(abs(gear) * _least(forces), strength)
                if is_motor and m.actuator_ctrllimited[k]:
                    strength = min(abs(gear * float(gain[0])) * _least(controls), strength)
                check_real("strength", strength, nonnegative=True, finite=False)
            self.made.strengths[self.name("joint", j)] = strength
            if is_motor:
                self.leave("controls of actuators that give a force, of which strengths has", name)
            elif bias[0] or gain[0] <= 0 or bias[1] != -gain[0] or bias[2] > 0 or j in driven:
                self.leave("actuators", name)
            else:
                driven.add(j)
                link, at = self.made.links[self.link_of[j]], m.jnt_qposadr[j]
                start = float(qpos[at]) if ctrl is None else float(ctrl[k]) / gear
                damping = -float(bias[2]) * gear * gear
                passive = link.motor
                if isinstance(passive, SpringMotor):
                    damping += passive.damping
                if isinstance(passive, SpeedMotor) or (passive and passive.stiffness):
                    self.leave("springs and friction of joints with a servo", name)
                with self.element("actuator", k):
                    stiffness = float(gain[0]) * gear * gear
                    target = start - float(m.qpos0[at])
                    link.motor = SpringMotor(target, stiffness, damping, strength)

    def read_equalities(self) -> None:
        """Connections are balls, welds are fixed, where they hold at the coordinates 0."""
        m, types = self.m, self.mj.mjtEq
        for e in range(m.neq):
            name, data = self.name("equality", e), m.eq_data[e]
            of_bodies = m.eq_objtype[e] == self.mj.mjtObj.mjOBJ_BODY and m.eq_active0[e]
            first, second = int(m.eq_obj1id[e]), int(m.eq_obj2id[e])
            if not of_bodies or int(m.eq_type[e]) not in (types.mjEQ_CONNECT, types.mjEQ_WELD):
                self.leave("equalities", name)
                continue
            a, b = self.number.get(first), self.number.get(second)
            x, y = self.rest[first], self.rest[second]
            if m.eq_type[e] == types.mjEQ_CONNECT:
                kind = "ball"
                anchor = compose(x, (data[:3], _ORIGIN[1]))[0]
                off = float(np.abs(anchor - compose(y, (data[3:6], _ORIGIN[1]))[0]).max())
            else:
                kind = "fixed"
                anchor = compose(y, (data[:3], _ORIGIN[1]))[0]
                given = compose(x, (data[3:6], data[6:10]))
                turned = 1 - abs(float(given[1] @ y[1]))
                off = max(float(np.abs(given[0] - y[0]).max()), turned)
            moves = [n is not None and self.made.bodies[n].motion == "dynamic" for n in (a, b)]
            if off > 1e-6 or not any(moves) or a == b:
                self.leave("equalities", name)
                continue
            if not moves[0]:
                a, b = b, a
            assert a is not None
            while name in self.made.link_names:
                name += "_"
            self.made.link_names[name] = len(self.made.links)
            axis = np.array([1.0, 0.0, 0.0])
            told = self.called("equality", e)
            self.made.links.append(Link(told, kind, a, b, anchor, axis, collide=True))

    def exclude(self, i: int, j: int) -> None:
        a, b = self.number.get(i), self.number.get(j)
        if a is not None and b is not None and a != b:
            self.made.excluded.append((a, b))

    def read_rest(self) -> None:
        """What counts for the whole model."""
        m, bits = self.m, self.mj.mjtDisableBit
        for what in ("tendon", "sensor", "plugin"):
            if count := getattr(m, f"n{what}"):
                self.leave(f"{what}s", str(count))
        for name, usual in _SOFTNESS.items():
            given = getattr(m, name, None)
            if given is not None and np.any(given != np.array(usual, given.dtype)):
                self.leave("how soft contacts are, and from where on", name.removeprefix("geom_"))
        for name in ("density", "viscosity", "wind"):
            if np.any(getattr(m.opt, name)):
                self.leave("forces of a medium", name)
        if m.opt.disableflags & bits.mjDSBL_GRAVITY:
            self.made.gravity = [0.0, 0.0, 0.0]
        for name in ("CONSTRAINT", "EQUALITY", "LIMIT", "SPRING", "DAMPER", "FRICTIONLOSS"):
            if m.opt.disableflags & getattr(bits, f"mjDSBL_{name}", 0):
                self.leave("flags that switch parts off", name.lower())

    def place(self, qpos: Array) -> None:
        """Where bodies are at first."""
        poses, between = self.rest, self.rest_links
        if not np.array_equal(qpos, self.m.qpos0):
            poses, between = self.kinematics(qpos)
        for i in range(1, self.m.nbody):
            if self.m.body_weldid[i] in (i, 0) and i in self.number:
                self.made.bodies[self.number[i]].start = poses[i]
        for j, number in self.between.items():
            self.made.bodies[number].start = between[j]


def _other(name: str, taken: set[str | None]) -> str:
    """A name that is not taken yet; it is then."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _numbers(name: str, bounds: Array) -> Array:
    """The bounds, which may be infinite; with NaN MuJoCo takes them for none."""
    if np.isnan(bounds).any():
        raise InputError(f"{name}: expected numbers, got {bounds.tolist()}")
    return bounds


def _least(bounds: Array) -> float:
    """The strength that both directions have."""
    return float(np.abs(bounds).min())


def _surface(condim: int, slide: float, spin: float, roll: float) -> dict[str, float]:
    """Friction in as many dimensions as MuJoCo's contact has."""
    return {
        "friction": slide if condim > 1 else 0.0,
        "spinning_friction": spin if condim > 3 else 0.0,
        "rolling_friction": roll if condim > 4 else 0.0,
    }


def _point(mass: MassProperties | None) -> Fixture:
    """A ball that touches nothing, of a body without geometries."""
    if mass is None:
        return _hidden(Sphere(0.01))
    radius = math.sqrt(float(mass.principal_inertia.min()) / mass.mass)
    return _hidden(Sphere(radius, mass.center_of_mass))


def _hidden(shape: Shape) -> Fixture:
    """What touches nothing."""
    return Fixture(shape, group=0, mask=0, **_SURFACE)
