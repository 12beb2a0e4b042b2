"""What is attacked: one maker for everything that holds native state, and good calls of it.

The small simulation of each class is that of `tests/<package>/examples.py`; others here have what
those lack: emitters, joints, contacts of cloth. `FUNCTIONS` has good arguments for every public
function and class. All tortures take their calls from here.
"""

import copy
import dataclasses
import functools
import inspect
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "base"))
import substep
from substep import geometry, linalg, mpm, pbd, rigid, systems
from substep.base.attributes import settable
from substep.base.simulation import Simulation
from test_conformance import classes, content, example  # the classes, and a small one of each

# ---------------------------------------------------------------------------- calls


@dataclass(frozen=True)
class Call:
    """A method or function by its name, or an assignment (`name=`), with good arguments.

    `arguments(owner)` gives new ones each time. `parts(owner)` yields after each whole part of the
    call, where it has parts: the steps of `advance`.
    """

    name: str
    arguments: Callable[[Any], dict[str, Any]] = lambda owner: {}
    parts: Callable[[Any], Any] | None = None

    def __call__(self, owner, **given):
        """Do it; other arguments replace the good ones."""
        return self.on(owner, self.arguments(owner) | given)

    def on(self, owner, arguments):
        """Do it with these arguments alone."""
        *path, name = self.name.split(".")
        for part in path:
            owner = getattr(owner, part)
        if name.endswith("="):
            return setattr(owner, name[:-1], arguments["value"])
        positional = arguments.get("*", ())
        named = {k: v for k, v in arguments.items() if k != "*"}
        return getattr(owner, name)(*positional, **named)


def call(name, parts=None, /, **arguments):
    """A call whose arguments are values, or functions of the owner."""
    return Call(name, functools.partial(_arguments, arguments), parts)


def _arguments(arguments, owner):
    return {
        name: value(owner) if inspect.isfunction(value) else copy.deepcopy(value)
        for name, value in arguments.items()
    }


@dataclass(frozen=True)
class Subject:
    """Something with state: how it is made, and what can be done with it."""

    name: str
    make: Callable[[], Any]
    calls: tuple[Call, ...] = field(default=())

    def made(self, steps=0):
        """A new one, after some steps."""
        one = self.make()
        for _ in range(steps):
            go_on(one)
        return one


def go_on(one):
    """What shows whether an object still works."""
    if isinstance(one, Simulation):
        one.step()
    elif isinstance(one, rigid.Joint):
        one._world.step()
    elif isinstance(one, substep.Collider):
        one.advance(0.125)
    elif hasattr(one, "t_bound") and one.status == "running":
        one.step()


# ---------------------------------------------------------------------------- one hash of a state


def digest(value):
    """A hash of everything that can be seen of a value, bit by bit."""
    return substep.state_hash(np.frombuffer("\n".join(_told(value, 0)).encode(), np.uint8))


def look(value):
    """Its digest, or why there is none."""
    try:
        return digest(value)
    except Exception as error:
        return f"cannot be read: {error!r}"


def _told(value, depth):
    if depth > 6:
        yield type(value).__name__
    elif isinstance(value, np.ndarray) and value.dtype != object:
        yield f"{value.dtype}{value.shape}{substep.state_hash(value) if value.size else ''}"
    elif isinstance(value, Simulation):
        yield content(value)
        for name in (*settable(type(value)), "ids"):
            yield from _told(getattr(value, name, None), depth + 1)
    elif isinstance(value, substep.Collider):
        for name in (*settable(type(value)), "impulse", "angular_impulse", "duration"):
            yield from _told(getattr(value, name), depth + 1)
    elif isinstance(value, rigid.Joint):
        yield from _told(value._world, depth + 1)
    elif isinstance(value, (linalg.Cholesky, linalg.LU)):
        yield repr(value.report)
        yield from _told(value.solve(np.arange(1.0, len(_chain()) + 1)), depth + 1)
    elif isinstance(value, (substep.Recorder, substep.Recording)):
        yield from _told(value.times, depth + 1)
    elif hasattr(value, "t_bound"):  # solvers
        for name in ("t", "y", "status", "t_old", "step_size"):  # evaluations stay counted
            yield from _told(getattr(value, name, None), depth + 1)
    elif isinstance(value, float):
        yield value.hex()
    elif isinstance(value, Mapping):
        for name, part in value.items():
            yield str(name)
            yield from _told(part, depth + 1)
    elif isinstance(value, (list, tuple, SimpleNamespace)):
        yield type(value).__name__
        for part in vars(value).values() if isinstance(value, SimpleNamespace) else value:
            yield from _told(part, depth + 1)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for part in dataclasses.fields(value):
            if not part.name.startswith("_"):
                yield from _told(getattr(value, part.name, None), depth + 1)
    elif isinstance(value, geometry.TriangleMesh | geometry.TetMesh):
        for name in ("vertices", "faces", "tetrahedra"):
            yield from _told(getattr(value, name, None), depth + 1)
    elif isinstance(value, (bool, int, str, bytes, np.generic, type(None))):
        yield repr(value)
    else:
        yield type(value).__name__


# ---------------------------------------------------------------------------- what a call may leave


class Twin:
    """An undisturbed object: the states that a call may leave, and where each goes on to.

    Those before and after the call, and those between its whole steps.
    """

    def __init__(self, subject, wanted, steps=0):
        self.subject, self.call, self.steps = subject, wanted, steps
        self.next = {}
        one = self.make()
        self.before = digest(one)
        self._note(one)
        for part in wanted.parts(self.make()) if wanted.parts is not None else ():
            self._note(part)
        one = self.make()
        self.result = digest(wanted(one))
        self.after = digest(one)
        self._note(one)

    def make(self):
        """A new object, in the state before the call."""
        return self.subject.made(self.steps)

    def _note(self, one):
        """That this is a whole state, and where it goes on to."""
        state = digest(one)
        go_on(one)
        self.next[state] = digest(one)

    def complaint(self, one):
        """What is wrong with an object in which the call was broken off, or None."""
        state = look(one)
        if state not in self.next:
            return state if "cannot" in state else "is in no state that whole calls have"
        try:
            go_on(one)
        except Exception as error:
            return f"cannot go on: {error!r}"
        if digest(one) != self.next[state]:
            return "goes on with other bits"
        return None


# ---------------------------------------------------------------------------- simulations

UP = np.array([0.0, 0.0, 1.0])


def _rows(owner, name):
    """Good values of an array: those that it has."""
    return np.array(getattr(owner, name))


def _steps(owner):
    """The simulation after each step of `advance`."""
    seen = []
    owner.advance(_duration(owner), lambda given: seen.append(given.copy()))
    return seen


def _duration(owner):
    return 2.5 * (owner.step_size or min(owner.step_limit()[0], 0.01))


def _batch_steps(owner):
    for _ in range(3):
        owner.step()
        yield owner.copy()


def _path(owner):
    return Path(tempfile.gettempdir()) / f"{type(owner).__name__}-{os.getpid()}"


def _saved(owner):
    owner.save(_path(owner))
    return _path(owner)


def protocol(kind):
    """Good calls of what every simulation has."""
    calls = [
        call("step"),
        call("step", dt=1e-3),
        call("advance", _steps, duration=_duration),
        call("state"),
        call("copy"),
        call("restore", state=lambda owner: owner.state()),
        call("restore", state=_earlier),
        call("save", path=_path),
        call("load", path=_saved),
        call("diagnostics"),
        call("fields"),
        call("step_limit"),
    ]
    if hasattr(kind, "rows"):
        calls.append(call("rows", ids=[1]))
    for name in dir(kind):
        others = ("set_motion", "set_motor_targets", "set_material_pair")
        if name.startswith("set_") and name not in others:
            array = functools.partial(_perturbed, name=name[4:])
            calls.append(Call(name, lambda owner, array=array: {"values": array(owner)}))
    for name in settable(kind):
        value = functools.partial(_other_value, name=name)
        calls.append(Call(f"{name}=", lambda owner, value=value: {"value": value(owner)}))
    return calls


def _earlier(owner):
    """A state that is not the present one."""
    other = owner.copy()
    go_on(other)
    return other.state()


def _perturbed(owner, name):
    values = _rows(owner, name)
    return values if name == "rotations" else values + (values.size > 0) * 2.0**-10


def _other_value(owner, name):
    value = getattr(owner, name)
    if name == "threads":
        return 2 if value is None else None
    if name == "pinned":
        return np.arange(len(owner)) == len(owner) - 1
    if name == "step_size":
        return (value or min(owner.step_limit()[0], 0.01)) / 2
    if name == "skin":
        return None
    return 2 * np.array(value)


def simulations():
    """Makers by name: the small one of each class, and richer ones."""
    return {kind.__name__: example(kind) for kind in classes()} | {
        "PositionBasedDynamics (cloth)": cloth,
        "PositionBasedDynamics (multilevel)": levels,
        "PositionBasedDynamics (soft)": soft,
        "PositionBasedFluid (flowing)": flowing_liquid,
        "PositionBasedFluid (divergence-free)": divergence_free_liquid,
        "GridLiquid (flowing)": flowing_water,
        "GridLiquid (viscous)": running_honey,
        "GridFlow (two fluids)": oil_and_water,
        "MaterialPointMethod (flowing)": flowing_grains,
        "MaterialPointMethod (implicit)": implicit_jelly,
        "RigidBodies (joints)": machine,
        "MassSpring (contact)": net,
        "MassSpring (explicit)": explicit_net,
        "MassSpring (projective)": projective_net,
        "SoftBody (contact)": lying_jelly,
        "Advection (grid)": drift,
    }


def cloth():
    """A small sheet that falls on a ball, with all that holds it together."""
    mesh = geometry.grid_mesh(4, 4)
    return substep.PositionBasedDynamics(
        mesh.vertices + UP * 0.3,
        0.1,
        [*pbd.cloth(mesh), pbd.SelfCollision(mesh.faces, thickness=0.05, friction=0.2)],
        pinned=[0],
        colliders=[substep.Collider(substep.Sphere(0.2), velocity=(0.1, 0, 0), friction=0.3)],
        substeps=2,
    )


def levels():
    mesh = geometry.grid_mesh(12, 12)
    return substep.PositionBasedDynamics(
        mesh.vertices, 0.1, [substep.Distance(mesh.edges)], pinned=[0], solver="multilevel"
    )


def soft():
    """A block with volumes, shapes, a spring and a function of Python."""
    cube = geometry.box_tetrahedra((0.2, 0.2, 0.2), (1, 1, 1))
    return substep.PositionBasedDynamics(
        cube.vertices,
        0.1,
        [
            pbd.NeoHookean(cube.tetrahedra, 1e4, 0.3),
            pbd.ShapeMatching([range(len(cube.vertices))], compliance=1e-3),
            pbd.Attachment([0], compliance=1e-3),
            pbd.ParticleCollision(0.02),
            pbd.CustomConstraint([[1]], _above, inequality=True),
        ],
        substeps=2,
        dtype="float64",
    )


def _above(x):
    gradient = np.zeros(x.shape)
    gradient[..., 2] = 1
    return x[:, 0, 2] + 0.2, gradient


def flowing_water():
    """Water in 2D by FLIP, between a nozzle, a sink and an open side, and a ball that moves."""
    tap = substep.Emitter((0.5, 0.9), (0, -1), 2.0, radius=0.1)
    ball = substep.Collider(substep.Sphere(0.1, (0.7, 0.1, 0)), velocity=(-0.5, 0, 0))
    return substep.GridLiquid(
        substep.fill_box((0, 0), (0.5, 0.25), 0.0625),
        cell=0.125,
        bounds=((0, 0), (1, 1)),
        sides=(("wall", "open"), "wall"),
        transfer="flip",
        colliders=[ball],
        emitters=[tap],
        sinks=[substep.Sink(substep.Sphere(0.1, (0.1, 0.0, 0)))],
        dtype="float64",
    )


def running_honey():
    """A viscous liquid with surface tension, in 2D, from a nozzle onto a ball that moves."""
    tap = substep.Emitter((0.5, 0.9), (0, -1), 1.0, radius=0.1)
    ball = substep.Collider(substep.Sphere(0.2, (0.5, 0.1, 0)), velocity=(0.1, 0, 0))
    return substep.GridLiquid(
        substep.fill_box((0, 0), (1, 0.25), 0.0625),
        cell=0.125,
        bounds=((0, 0), (1, 1)),
        viscosity=0.1,
        surface_tension=0.1,
        colliders=[ball],
        emitters=[tap],
    )


def oil_and_water():
    """Oil on water in a channel, with an inflow, a ball that moves and a source of oil."""
    ball = substep.Collider(substep.Sphere(0.2, (0.5, 0.4, 0)), velocity=(0, 0.1, 0))
    region = substep.Sphere(0.1, (0.8, 0.2, 0))
    into = substep.gridfluid.Inflow((0.5, 0), smoke=0.5)
    return substep.GridFlow(
        ((0, 0), (1, 1)),
        0.125,
        density=1000.0,
        smoke=lambda x: (x[:, 1] > 0.5).astype(float),
        smoke_density=800.0,
        viscosity=0.01,
        sides=((into, "open"), "wall"),
        slip=True,
        colliders=[ball],
        emitters=[substep.gridfluid.FlowEmitter(region, smoke=1.0, velocity=(0, 0.5))],
        temperature=1.0,
        vorticity_confinement=0.1,
        dtype="float64",
    )


def flowing_liquid(**options):
    """Two liquids between a nozzle and a sink, with all forces."""
    tap = substep.Emitter((0, 0, 0.5), (0, 0, -1), 2.0, radius=0.06)
    ball = substep.Collider(substep.Sphere(0.1, (0.3, 0, 0.1)), velocity=(-0.5, 0, 0))
    x = substep.fill_box((-0.1, -0.1, 0), (0.1, 0.1, 0.1), 0.05)
    return substep.PositionBasedFluid(
        x,
        0.05,
        kinds=np.arange(len(x)) % 2,
        density=(1000.0, 800.0),
        colliders=[substep.Plane(), ball],
        emitters=[tap],
        sinks=[substep.Sink(substep.Sphere(0.08, (0.1, 0.1, 0)))],
        viscosity=0.1,
        vorticity_confinement=0.1,
        surface_tension=0.05,
        xsph=0.01,
        **({"warm_start": 0.5} | options),
    )


def divergence_free_liquid():
    return flowing_liquid(warm_start=0.0, divergence_free=True)


def flowing_grains():
    """Sand and jelly between a nozzle and a sink."""
    tap = substep.Emitter((0, 0, 0.6), (0, 0, -1), 2.0, radius=0.06, kind=1)
    x, volume = mpm.sample_box((-0.1, -0.1, 0.05), (0.1, 0.1, 0.15), 0.05)
    return substep.MaterialPointMethod(
        x,
        [mpm.Sand(young_modulus=1e5), mpm.NeoHookean(1000, 2e4, 0.3)],
        kinds=np.arange(len(x)) % 2,
        cell=0.1,
        volume=volume,
        colliders=[substep.Collider(substep.Plane(), friction=0.5)],
        emitters=[tap],
        sinks=[substep.Sink(substep.Sphere(0.1, (0.1, 0.1, 0.1)))],
        emitter_spacing=0.05,
        step=2.0**-8,
    )


def implicit_jelly():
    x, volume = mpm.sample_box((0, 0, 0.05), (0.1, 0.1, 0.15), 0.05)
    jelly = mpm.FixedCorotated(1000, 1e5, 0.3)
    return substep.MaterialPointMethod(
        x, jelly, cell=0.1, volume=volume, integrator="implicit_euler", colliders=[substep.Plane()]
    )


TURN = rigid.TurnSpring(10.0, 5.0, 0.1)


def machine():
    """Bodies of all shapes on the ground, with all joints."""
    bodies = substep.RigidBodies(substeps=2)
    bodies.add(substep.Plane(), (0, 0, 0), motion="static")
    boxes = bodies.add(substep.Box((0.2, 0.2, 0.2)), [[0, 0, 0.1], [0, 0, 0.3], [0, 0, 0.5]])
    ball = bodies.add(substep.Sphere(0.1), (0.5, 0, 0.1))
    rod = bodies.add(substep.Capsule(0.05, 0.2), (1, 0, 0.5))
    can = bodies.add(substep.Cylinder(0.1, 0.2), (1.5, 0, 0.1), restitution=0.5)
    hull = bodies.add(substep.ConvexHull(0.2 * np.eye(4, 3)), (2, 0, 0.2))
    bodies.hinge(rod, None, (1, 0, 0.6), (0, 1, 0), motor=rigid.SpeedMotor(1.0, 5.0))
    bodies.slider(ball, None, (0.5, 0, 0.1), (1, 0, 0), limits=(-1, 1))
    bodies.ball(can, hull, (1.75, 0, 0.2))
    bodies.distance(boxes[2], rod, (0, 0, 0.5), (1, 0, 0.5), limits=(0.5, 2))
    bodies.elastic(hull, None, (2, 0, 0.3), (1, 0, 0), TURN)
    bodies.universal(boxes[0], boxes[1], (0, 0, 0.2), (1, 0, 0), (0, 1, 0), limits=(-1, 1))
    return bodies


def net():
    """A net that lies on a ball."""
    mesh = geometry.grid_mesh(4, 4)
    ball = substep.Collider(substep.Sphere(0.3), velocity=(0.1, 0, 0), friction=0.3)
    return substep.MassSpring(
        mesh.vertices + UP * 0.302,
        mesh.edges,
        stiffness=200.0,
        masses=0.05,
        faces=mesh.faces,
        pinned=[0],
        colliders=[ball],
    )


def explicit_net():
    mesh = geometry.grid_mesh(3, 3)
    return substep.MassSpring(
        mesh.vertices, mesh.edges, 50.0, 0.1, integrator="velocity_verlet", step=1e-3, damping=0.1
    )


def lying_jelly():
    """A jelly on the ground."""
    cube = geometry.box_tetrahedra((0.1, 0.1, 0.1), (1, 1, 1))
    return substep.SoftBody(
        cube.vertices + UP * 0.051,
        cube.tetrahedra,
        density=1000,
        young_modulus=2e4,
        poisson_ratio=0.3,
        model="st_venant_kirchhoff",
        colliders=[substep.Plane()],
    )


def projective_net():
    mesh = geometry.grid_mesh(3, 3)
    return substep.MassSpring(mesh.vertices, mesh.edges, 50.0, 0.1, pinned=[0], solver="projective")


def current():
    """A field on a grid in space and time."""
    x = np.linspace(0, 2, 5)
    values = np.ones((3, 5, 5, 2)) * 0.1
    return substep.GridField((x, x), values, times=[0.0, 1.0, 2.0])


ROW = np.arange(3.0)


def bent_current():
    """A field on the faces of a curvilinear grid."""
    x, y = np.meshgrid(np.linspace(0, 2, 5), np.linspace(0, 2, 5), indexing="ij")
    return substep.CurvilinearField(x + 0.1 * y, y, np.full((5, 5, 2), 0.1), arakawa="C")


class Told:
    """A source of levels that gives what it is told, also another shape than it says."""

    def velocity(self, level, shape, x):
        """Of a field that reads that level, and claims that shape."""
        axis = np.linspace(0, 2, 5)
        self.level, self.shape = level, shape
        field = substep.GridField((axis, axis), self, times=[0.0, 1.0, 2.0])
        substep.Advection(field, x, step=0.25).advance(0.5)
        return field(0.5, x)

    def __getitem__(self, number):
        return self.level


def drift():
    return substep.Advection(current(), [[0.5, 0.5], [1.0, 1.5]], step=0.05, method="heun")


_PARTICLES = (call("remove", ids=lambda owner: owner.ids[:2]),)
_ONE = [[0.3, 0.3, 0.7]]
_ONE_IN = {2: [[0.3, 0.7]], 3: _ONE}
_SURFACE = (call("make_colliders", thickness=0.05, faces=[[0, 1, 2]], friction=0.3),)
OWN_CALLS = {
    substep.PositionBasedDynamics: (
        *_SURFACE,
        call("set_positions", values=_ONE, ids=[1]),
        call("values", constraint=0),
        call("multipliers", constraint=0),
    ),
    substep.PositionBasedFluid: (
        *_PARTICLES,
        call("add", positions=_ONE),
        call("add", positions=np.tile(_ONE, (9, 1)) + 0.1 * np.arange(9)[:, None], velocities=None),
    ),
    substep.GridLiquid: (
        *_PARTICLES,
        call("add", positions=lambda owner: _ONE_IN[owner.gravity.size]),
        call("add", positions=lambda owner: _ONE_IN[owner.gravity.size], velocities=None),
        call("depth", points=lambda owner: [_ONE_IN[owner.gravity.size][0][:-1]]),
        call("sample_pressure", points=lambda owner: _ONE_IN[owner.gravity.size]),
    ),
    substep.MaterialPointMethod: (
        *_PARTICLES,
        call("add", positions=_ONE, volume=1e-4),
        call("add", positions=np.tile(_ONE, (9, 1)) + 0.1 * np.arange(9)[:, None], volume=1e-4),
    ),
    substep.MassSpring: (
        *_SURFACE,
        call("set_positions", values=_ONE, ids=[1]),
        call("pin_forces"),
    ),
    substep.GridFlow: (
        call("sample", points=[[0.5, 0.5], [0.25, 0.75]]),
        call("positions_of", faces_of=1),
        call("set_smoke", values=0.5),
    ),
    substep.SoftBody: (
        *_SURFACE,
        call("set_forces", values=_ONE, ids=[1]),
        call("pin_forces"),
    ),
    substep.Advection: (call("set_positions", values=[[0.25, 0.25]], ids=[1]),),
    geometry.AnimatedMesh: (*_SURFACE, call("at", time=0.05)),
    substep.World: (call("exchanged"),),
    substep.RigidBodies: (
        call(
            "add",
            shape=lambda owner: substep.Box((0.1, 0.2, 0.3)),
            positions=[[3, 0, 1], [4, 0, 1]],
        ),
        call(
            "add",
            shape=lambda owner: [
                rigid.Fixture(substep.Sphere(0.1)),
                rigid.Fixture(substep.Box((0.1, 0.1, 0.1), (0.2, 0, 0)), density=10.0),
            ],
            positions=(3, 0, 1),
        ),
        call("remove", ids=[1, 0]),
        call("exclude", a=0, b=1),
        call("set_material_pair", a="wood", b="ice", friction=0.1, static_friction=0.2),
        call("apply_force", ids=[1], force=(0, 0, 5.0), point=(0, 0, 1.0)),
        call("apply_impulse", ids=[1, 2], impulse=(0, 0, 0.5)),
        call("set_motion", motion="kinematic", ids=[1]),
        call("wake"),
        call("ball", a=1, b=2, anchor=(0, 0, 0)),
        call("hinge", a=1, b=2, anchor=(0, 0, 0), axis=(0, 0, 1), limits=(-1, 1)),
        call("slider", a=1, b=2, anchor=(0, 0, 0), axis=(0, 0, 1)),
        call("fixed", a=1, b=None, anchor=(0, 0, 0)),
        call("distance", a=1, b=2, point_a=(0, 0, 0), point_b=(1, 0, 0)),
        call("universal", a=1, b=2, anchor=(0, 0, 0), axis_a=(0, 0, 1), axis_b=(1, 0, 0)),
        call("elastic", a=1, b=2, anchor=(0, 0, 0), axis=(0, 0, 1), spring=TURN),
        call("contacts"),
        call("contact_force", body=0, other=1),
        call("ray_cast", origins=[[0, 0, 5.0]], directions=[[0, 0, -1.0]]),
        call("ray_cast_all", origin=[0, 0, 5.0], direction=[0, 0, -1.0]),
        call(
            "shape_cast",
            shape=lambda owner: substep.Sphere(0.1),
            position=(0, 0, 5),
            direction=(0, 0, -1),
            length=10.0,
        ),
        call("overlapping", shape=lambda owner: substep.Sphere(5.0), position=(0, 0, 0)),
        call("fixtures", body=1),
        call("make_colliders", ids=[1]),
        call("body", name="trunk"),
        call("joint", name="knee"),
    ),
    substep.Batch: (
        call("step", _batch_steps, steps=3),
        call("reset", worlds=[1]),
        call("copy_world", world=1),
        call("world_diagnostics"),
        call("set_positions", values=[[0, 0, 0], [0.6, 0, 0], [1.1, 0, 0]], worlds=[0, 2]),
    ),
    substep.RigidBatch: (
        call("step", _batch_steps, steps=3),
        call("rollout", _batch_steps, steps=3),
        call("reset", worlds=[1]),
        call("copy_world", world=1),
        call("set_positions", values=[[0, 0, 2.0]], ids=[1], worlds=[0, 2]),
    ),
}


def _simulation(name, make):
    kind = type(make())
    own = next((calls for base, calls in OWN_CALLS.items() if issubclass(kind, base)), ())
    return Subject(name, make, (*protocol(kind), *own))


# ---------------------------------------------------------------------------- other subjects


def _in_use():
    """An obstacle of a simulation that has touched it."""
    simulation = net()
    simulation.step()
    collider = simulation.colliders[0]
    collider._kept = simulation
    return collider


_MOVES = (
    call("position=", value=(0.0, 0.0, -0.5)),
    call("rotation=", value=(0.0, 1.0, 0.0, 0.0)),
    call("velocity=", value=(0.5, 0, 0)),
    call("angular_velocity=", value=(0.5, 0, 0)),
    call("friction=", value=0.75),
    call("restitution=", value=0.75),
    call("advance", dt=0.5),
    call("copy"),
    call("distance", x=_ONE),
    call("gradient", x=_ONE),
    call("hessian", x=_ONE),
    call("surface_velocity", x=_ONE),
)


def _chain(n=6):
    return 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)


def _decay(t, y):
    return -y


def _solvers():
    for name in ("Euler", "Midpoint", "Heun", "RK4", "RK45", "DOP853", "ImplicitEuler", "Radau"):
        kind = getattr(substep, name)
        step = {} if name in ("RK45", "DOP853", "Radau") else {"step": 0.1}
        make = functools.partial(_begun, kind, step)
        yield Subject(name, make, (call("step"), call("dense_output")))


def _begun(kind, options):
    solver = kind(_decay, 0.0, [1.0, 2.0], 1e6, **options)
    solver.step()
    return solver


def _recorder(name="run"):
    path = f"{_path(None)}-{name}.vtkhdf"
    return substep.Recorder(path, parts={"p": substep.Part()}, overwrite=True)


def _logger():
    log = substep.Logger({"height": lambda one: X[0], "time_squared": lambda one: one.time**2})
    log(SimpleNamespace(time=0.0))
    return log


@functools.cache
def _recorded():
    """A packed recording: written once, by another process."""
    recorder = _recorder("kept")
    recorder.append(0.0, {"p": {"points": X}})
    recorder.close()
    return f"{_path(None)}-kept.vtkhdf"


def _recording():
    return substep.Recording(_recorded())


def _sampled():
    return substep.Collider(geometry.SignedDistanceField(np.ones((4, 4, 4)), 0.1))


def _holding(name, make, *calls):
    """An object that does not change: its methods, and assignments to what it shows."""
    one = make()
    shown = [n for n in dir(one) if n[:1] != "_" and not callable(getattr(one, n))]
    assignments = (call(f"{n}=", value=lambda owner, n=n: getattr(owner, n)) for n in shown)
    return Subject(name, make, (*calls, *assignments))


def _others():
    x3 = [[0.1, 0.2, 0.3], [0.5, 0.5, 0.5]]
    flow = (call("__call__", t=0.0, x=[[0.5, 0.25]]),)
    stream = call("stream_function", t=0.0, x=[[0.5, 0.5]])
    return [
        Subject("Collider", _in_use, _MOVES),
        Subject("Collider (sampled)", _sampled, _MOVES),
        Subject(
            "Joint",
            lambda: machine().joints[0],
            (
                call("limits=", value=(-0.5, 0.5)),
                call("motor=", value=rigid.SpringMotor(0.5, 10.0)),
                call("remove"),
            ),
        ),
        Subject(
            "Cholesky",
            lambda: linalg.Cholesky(_chain()),
            (call("factor", A=4 * _chain()), call("solve", b=np.ones(6))),
        ),
        Subject(
            "LU",
            lambda: linalg.LU(_chain()),
            (call("factor", A=4 * _chain()), call("solve", b=np.ones(6), transpose=True)),
        ),
        *_solvers(),
        _holding(
            "TriangleMesh",
            geometry.box_mesh,
            call("nearest", x=x3),
            call("winding_number", x=x3),
            call("signed_distance", x=x3),
            call("cleaned"),
            call("report"),
        ),
        _holding(
            "TetMesh",
            lambda: geometry.box_tetrahedra((1, 1, 1), (1, 1, 1)),
            call("embed", points=[[0.1, 0.1, 0.1]]),
            call("surface"),
        ),
        _holding("GridField", current, *flow),
        _holding("CurvilinearField", bent_current, *flow),
        Subject(
            "GridField (source)",
            Told,
            (call("velocity", level=np.ones((5, 5, 2)), shape=(3, 5, 5, 2), x=[[0.5, 0.25]]),),
        ),
        _holding(
            "DoubleGyre", substep.DoubleGyre, *flow, call("stream_function", t=0.0, x=[[0.5, 0.5]])
        ),
        _holding(
            "TaylorGreen",
            substep.TaylorGreen,
            *flow,
            stream,
        ),
        _holding("ABC", substep.ABC, call("__call__", t=0.0, x=x3)),
        _holding("Shear", substep.Shear, *flow),
        _holding("RigidRotation", substep.RigidRotation, *flow),
        _holding("Sphere", lambda: substep.Sphere(1.0), call("mesh", segments=8)),
        _holding("Capsule", lambda: substep.Capsule(1.0, 2.0), call("mesh", segments=8)),
        _holding("Cylinder", lambda: substep.Cylinder(1.0, 2.0), call("mesh", segments=8)),
        _holding("ConvexHull", lambda: substep.ConvexHull(np.eye(4, 3)), call("mesh")),
        _holding("Box", lambda: substep.Box((1, 1, 1)), call("mesh")),
        _holding("Distance", lambda: substep.Distance([[0, 1]]), call("evaluate", positions=x3)),
        _holding(
            "NeoHookean",
            lambda: pbd.NeoHookean([[0, 1, 2, 3]], 1e3, 0.3),
            call("evaluate", positions=np.eye(4, 3)),
        ),
        _holding(
            "MassProperties",
            lambda: rigid.MassProperties(1.0, (0, 0, 0), np.eye(3)),
            call("moved", position=(1, 0, 0), rotation=(0, 1, 0, 0)),
        ),
        _holding(
            "Kepler",
            systems.Kepler,
            call("__call__", t=0.0, y=[1.0, 0, 0, 1]),
            call("energy", y=[1.0, 0, 0, 1]),
        ),
        _holding(
            "Robertson",
            systems.Robertson,
            call("jacobian", t=0.0, y=[1.0, 0, 0]),
            call("jacobian_product", t=0.0, y=[1.0, 0, 0], v=[1.0, 0, 1]),
        ),
        Subject(
            "Logger",
            _logger,
            (
                Call("__call__", lambda o: {"simulation": SimpleNamespace(time=1.0)}),
                *(call(name) for name in ("arrays", "columns", "clear")),
            ),
        ),
        Subject("Recorder", _recorder, (call("append", time=1.0, frame={"p": {"points": X}}),)),
        _holding("Recording", _recording, call("frame", index=0)),
        _holding(
            "NBody",
            lambda: systems.NBody([1.0, 2.0]),
            call("__call__", t=0.0, y=np.arange(12.0)),
            call("energy", y=np.arange(12.0)),
        ),
        _holding(
            "OdeSolution",
            lambda: substep.solve_ivp(_decay, (0, 1), [1.0], "DOP853", dense_output=True).sol,
            call("__call__", t=[0.25, 0.5]),
        ),
        Subject("functions", lambda: substep, tuple(functions())),
    ]


@functools.cache
def subjects():
    """Everything that is attacked."""
    return tuple([*(_simulation(n, make) for n, make in simulations().items()), *_others()])


def of_simulations():
    """Those that step in time."""
    return tuple(s for s in subjects() if s.name.split(" ")[0] in {k.__name__ for k in classes()})


# ---------------------------------------------------------------------------- functions

X = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
TETRAHEDRON = [[0, 1, 2, 3]]
PAIRS = [[0, 1], [1, 2]]


def functions():
    """A good call of each public function and class of the package."""
    t, y0 = (0.0, 0.5), [1.0, 2.0]

    def jelly(owner=None):
        return mpm.NeoHookean(1000, 2e4, 0.3)

    def box(owner=None):
        return geometry.box_mesh()

    def cube(owner=None):
        return geometry.box_tetrahedra((1, 1, 1), (1, 1, 1))

    def ball(owner=None):
        return substep.Sphere(0.5)

    def tap(owner=None):
        return [substep.Emitter((0, 0, 5), (0, 0, -1), 1.0, radius=0.1)]

    def bodies(owner=None):
        return example(substep.RigidBodies)()

    def plane(owner=None):
        return [substep.Plane((0, 0, 1), (0, 0, -1))]

    def gyre(owner=None):
        return substep.DoubleGyre()

    def decay(owner=None):
        return _decay

    def acceleration(owner=None):
        return lambda t, x, v: -x

    def custom(owner=None):
        return _above

    def part(owner=None):
        return {"p": substep.Part()}

    soft = {"density": 1000.0, "young_modulus": 1e4, "poisson_ratio": 0.3}
    yield from [
        # geometry
        call("Sphere", radius=0.5, center=(0, 0, 1)),
        call("Box", lengths=(1, 2, 3), center=(0, 0, 1), rotation=(1, 0, 0, 1)),
        call("Capsule", radius=0.5, length=1.0, center=(0, 0, 1), rotation=(1, 0, 0, 1)),
        call("Cylinder", radius=0.5, length=1.0, center=(0, 0, 1), rotation=(1, 0, 0, 1)),
        call("Plane", normal=(0, 0, 1), point=(0, 0, 1)),
        call("ConvexHull", points=X, center=(0, 0, 1), rotation=(1, 0, 0, 1)),
        call("TriangleMesh", vertices=X, faces=[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
        call("HeightField", heights=np.zeros((4, 5)), spacing=0.1, origin=(0, 0, 0)),
        call("SignedDistanceField", values=np.ones((4, 5, 6)), spacing=0.1, origin=(0, 0, 0)),
        call("SignedDistanceField.from_mesh", mesh=box, spacing=0.25, offset=0.0),
        call(
            "Collider", shape=ball, friction=0.5, restitution=0.5, velocity=(1, 0, 0), hollow=False
        ),
        call("Emitter", position=(0, 0, 1), direction=(0, 0, -1), speed=1.0, radius=0.1),
        call("Sink", shape=ball),
        call("geometry.TetMesh", vertices=X, tetrahedra=TETRAHEDRON),
        call("geometry.Skin", mesh=box, rest=cube, neighbours=8),
        call("geometry.box_mesh", lengths=(1, 2, 3)),
        call("geometry.box_tetrahedra", lengths=(1, 2, 3), divisions=(1, 2, 1)),
        call("geometry.grid_mesh", n=3, m=4, size=(1, 2)),
        call("geometry.sphere_mesh", radius=1.0, center=(0, 0, 0), subdivisions=1),
        call("geometry.neighbour_lists", points=X, radius=1.1, pairs="full"),
        call("geometry.tetrahedralize", mesh=box, spacing=0.5),
        call("geometry.convex_decomposition", mesh=box, concavity=0.5, max_hulls=2, seed=1),
        call("geometry.read_mesh", path="nothing.obj"),
        call("recording.diagnostics", **{"*": ("kinetic_energy", "energy")}),
        call("recording.forces", colliders=lambda o: {"a": substep.Collider(ball())}),
        call("recording.gauges", places={"a": (0.0, 1.0)}, radius=0.1),
        call("geometry.transform_mesh", mesh=box, up="y", scale=2.0, translation=(1, 2, 3)),
        call("geometry.Keyframes", times=[0.0, 1.0], positions=[(0, 0, 0), (1, 0, 0)]),
        call("liquid_surface", positions=0.1 * X, radius=0.1, cell=1.0, smoothing=2),
        # particles
        call("fill_box", low=(0, 0, 0), high=(1, 1, 1), spacing=0.25),
        call("fill_mesh", mesh=box, spacing=0.25, margin=0.5),
        call("relax", positions=0.1 * X, spacing=0.1, max_iterations=3),
        call("mpm.sample_box", low=(0, 0, 0), high=(1, 1, 1), spacing=0.25, pattern="poisson"),
        call("mpm.sample_sphere", center=(0, 0, 0), radius=1.0, spacing=0.5, jitter=0.5),
        call("mpm.sample_mesh", mesh=box, spacing=0.25, seed=3),
        call("PositionBasedFluid", positions=0.1 * X, spacing=0.1, velocities=X, colliders=plane),
        call("PositionBasedFluid", positions=X, spacing=0.1, emitters=tap, viscosity=0.1, xsph=0.1),
        call("GridLiquid", positions=0.5 * X, cell=0.5, bounds=((-1, -1, -1), (1, 1, 1))),
        call(
            "GridLiquid",
            positions=0.5 * X,
            cell=0.5,
            bounds=((-1, -1, -1), (1, 1, 1)),
            viscosity=0.1,
            surface_tension=0.1,
            slip=True,
        ),
        call("GridFlow", bounds=[(0, 0), (1, 1)], cell=0.25, velocity=(1.0, 0), sides="periodic"),
        call("gridfluid.Wall", velocity=(1.0, 0.0), temperature=1.0),
        call("gridfluid.Inflow", velocity=(1.0, 0.0), temperature=1.0, smoke=0.5),
        call("gridfluid.FlowEmitter", region=lambda owner: substep.Sphere(0.1), smoke=1.0),
        call("MaterialPointMethod", positions=X, materials=jelly, cell=0.1, volume=1e-3, kinds=0),
        call(
            "MaterialPointMethod",
            positions=X,
            materials=jelly,
            cell=0.1,
            volume=1e-3,
            emitters=tap,
            emitter_spacing=0.05,
            colliders=plane,
        ),
        call("mpm.NeoHookean", density=1000.0, young_modulus=1e4, poisson_ratio=0.3),
        call("mpm.FixedCorotated", density=1000.0, young_modulus=1e4, poisson_ratio=0.3),
        call("mpm.Fluid", density=1000.0, bulk_modulus=1e5, exponent=7.0, viscosity=0.1),
        call("mpm.Snow", young_modulus=1e5, hardening=10.0),
        call("mpm.Sand", friction_angle=0.5, hardening_slope=0.1, hardening_rate=0.1),
        call("mpm.VonMises", density=1800, young_modulus=1e6, poisson_ratio=0.4, yield_stress=5e3),
        call(
            "mpm.HerschelBulkley",
            density=1500,
            young_modulus=1e5,
            poisson_ratio=0.4,
            yield_stress=100.0,
            consistency=20.0,
        ),
        # position-based dynamics
        call(
            "PositionBasedDynamics", positions=X, masses=1.0, velocities=X, pinned=[0], gravity=None
        ),
        call("PositionBasedDynamics", positions=X, masses=1.0, colliders=plane, solver="jacobi"),
        call("Distance", pairs=PAIRS, rest_lengths=None, compliance=1e-3, damping=0.1),
        call("pbd.Tether", pairs=PAIRS, lengths=1.0, compliance=1e-3),
        call("pbd.Bending", hinges=TETRAHEDRON, rest_angles=0.0, compliance=1e-3),
        call("pbd.IsometricBending", hinges=TETRAHEDRON, rest_positions=X, compliance=1e-3),
        call("pbd.TriangleArea", triangles=[[0, 1, 2]], rest_areas=1.0, compliance=1e-3),
        call("pbd.TetrahedronVolume", tetrahedra=TETRAHEDRON, rest_volumes=0.1, compliance=1e-3),
        call("pbd.NeoHookean", tetrahedra=TETRAHEDRON, young_modulus=1e4, poisson_ratio=0.3),
        call("pbd.Attachment", particles=[0, 1], targets=X[:2], compliance=1e-3),
        call("pbd.ShapeMatching", clusters=[[0, 1, 2, 3]], rest_positions=X, linear=0.1),
        call("pbd.ParticleCollision", radii=0.1, friction=0.1),
        call("pbd.SelfCollision", faces=[[0, 1, 2]], thickness=0.1, friction=0.1),
        call("pbd.CustomConstraint", particles=[[0], [1]], fun=custom, inequality=True),
        call("pbd.rope", count=5, closed=False, compliance=1e-3, bending_compliance=1e-3),
        call("pbd.cloth", mesh=box, compliance=1e-3, rigidity=0.1, bending="isometric"),
        call("pbd.soft_body", mesh=cube, young_modulus=1e4, poisson_ratio=0.3),
        call("pbd.tethers", positions=X, edges=PAIRS, pins=[0], slack=1.1),
        call("pbd.vertex_clusters", edges=PAIRS, count=4, rings=1),
        # springs
        call("MassSpring", positions=X, edges=PAIRS, stiffness=10.0, masses=1.0, pinned=[0]),
        call("MassSpring", positions=X, edges=PAIRS, stiffness=10.0, masses=1.0, colliders=plane),
        call("MassSpring.from_mesh", mesh=box, density=1.0, stiffness=10.0, bending=0.1),
        call("SoftBody", positions=X, tetrahedra=TETRAHEDRON, colliders=plane, **soft),
        call("SoftBody.from_mesh", mesh=cube, **soft),
        call("springs.grid_springs", n=3, m=3, stiffness=10.0),
        # rigid bodies
        call("RigidBodies", gravity=(0, 0, -1), step=0.01, substeps=2, sleeping=True),
        call("RigidBatch", template=bodies, worlds=2, threads=1),
        call("Batch", template=lambda o: example(substep.MassSpring)(), worlds=2, threads=1),
        call("rigid.Fixture", shape=ball, density=5.0, friction=0.5, group=1, material="wood"),
        call("rigid.MassProperties", mass=1.0, center_of_mass=(0, 0, 0), inertia=np.eye(3)),
        call("rigid.SpeedMotor", speed=1.0, strength=5.0),
        call("rigid.SpringMotor", target=1.0, stiffness=5.0, damping=1.0, strength=5.0),
        call("rigid.TurnSpring", swing=1.0, twist=5.0, swing_damping=1.0, rest=(0.1, 0, 0)),
        call("rigid.mass_properties", shape=ball, density=10.0),
        call("rigid.compound", parts=lambda o: [rigid.mass_properties(ball())]),
        call(
            "rigid.free_rotation",
            rotations=[[1.0, 0, 0, 0]],
            angular_momenta=[[0, 0, 1.0]],
            inertia=[[1.0, 2, 2.5]],
            duration=1.0,
            steps=2,
        ),
        # fields
        call("Advection", field=gyre, positions=[[0.5, 0.5]], step=0.1, method="rk4"),
        call(
            "advect", field=gyre, positions=[[0.5, 0.5]], t_span=(0, 1), step=0.1, t_eval=[0.5, 1]
        ),
        call("ABC", a=1.0, b=1.0, c=1.0),
        call("DoubleGyre", amplitude=0.1, epsilon=0.25, omega=0.5),
        call("RigidRotation", omega=1.0, center=(0, 0)),
        call("Shear", rate=1.0, dimension=2, flow_axis=0, gradient_axis=1),
        call("TaylorGreen", amplitude=1.0, wavenumber=1.0, viscosity=0.1),
        call("GridField", axes=([0.0, 1], [0.0, 1, 2]), values=np.ones((2, 3, 2)), periodic=None),
        call(
            "CurvilinearField",
            x=np.add.outer(ROW, ROW / 3),
            y=np.add.outer(0 * ROW, ROW),
            values=np.ones((3, 3, 2)),
            z=None,
        ),
        call("open_field", path="nothing.nc"),
        # differential equations
        call("solve_ivp", fun=decay, t_span=t, y0=y0, method="RK45", t_eval=[0.25], rtol=1e-3),
        call("solve_ivp", fun=decay, t_span=t, y0=y0, method="Radau", jac=None, first_step=0.1),
        call("solve_ivp", fun=decay, t_span=t, y0=y0, method="rk4", step=0.1, dense_output=True),
        call("solve_ensemble", fun=lambda o: systems.Lorenz(), t_span=t, Y0=np.ones((2, 3))),
        call(
            "solve_second_order",
            acceleration=acceleration,
            t_span=t,
            x0=y0,
            v0=y0,
            method="velocity_verlet",
            step=0.1,
        ),
        call("ode.methods"),
        *(
            call(name, fun=decay, t0=0.0, y0=y0, t_bound=1.0, rtol=1e-3, atol=1e-6)
            for name in ("RK45", "DOP853", "Radau")
        ),
        *(
            call(name, fun=decay, t0=0.0, y0=y0, t_bound=1.0, step=0.1)
            for name in ("Euler", "Midpoint", "Heun", "RK4", "ImplicitEuler")
        ),
        call("systems.Arenstorf", mu=0.01),
        call("systems.Brusselator1D", n=5, alpha=0.1, a=1.0, b=3.0),
        call("systems.Brusselator2D", n=4, alpha=0.1, source=5.0),
        call("systems.HarmonicOscillator", omega=1.0, damping=0.1),
        call("systems.HenonHeiles", lambda_=1.0),
        call("systems.Hires"),
        call("systems.Kepler", mu=1.0, eccentricity=0.5),
        call("systems.Lorenz", sigma=10.0, rho=28.0, beta=2.0),
        call("systems.NBody", masses=[1.0, 2.0], G=1.0, softening=0.1, dimension=3),
        call("systems.Orego", s=77.0, q=8e-6, w=0.2),
        call("systems.Oscillators", omega=[1.0, 2.0]),
        call("systems.Pendulum", length=1.0, gravity=9.81, damping=0.1),
        call("systems.Pleiades", masses=(1, 2, 3, 4, 5, 6, 7)),
        call("systems.Robertson", k1=0.04, k2=3e7, k3=1e4),
        call("systems.SpringChain", n=5, k=1.0, m=1.0, fixed_ends=True),
        call("systems.VanDerPol", mu=1.0, scaled=False),
        # linear algebra
        call("linalg.Cholesky", A=_chain(), ordering="automatic", kind="automatic", block=1),
        call("linalg.LU", A=_chain(), kind="automatic"),
        call("linalg.cg", A=_chain(), b=np.ones(6), x0=None, rtol=1e-8, max_iterations=50),
        call("linalg.bicgstab", A=_chain(), b=np.ones(6), x0=None, rtol=1e-8, max_iterations=50),
        # stability
        call("stability.amplification", method="rk4", z=[0.5j, -1.0]),
        call("stability.amplification_eigenvalues", method="velocity_verlet", h_omega=[0.5]),
        call("stability.amplification_matrix", method="velocity_verlet", h_omega=0.5),
        call("stability.amplification_polynomial", method="rk4"),
        call("stability.imaginary_limit", method="rk4"),
        call("stability.real_limit", method="rk4"),
        call("stability.max_stable_step", method="rk4", eigenvalues=[-1.0, -2 + 1j]),
        call("stability.region", method="rk4", bounds=(-1, 1, -1, 1), resolution=5),
        call("stability.stability_limit", method="velocity_verlet", damping_ratio=0.1),
        call("stability.stiffness_ratio", eigenvalues=[-1.0, -2 + 1j]),
        call("stability.one_step_methods"),
        call("stability.second_order_methods"),
        # recordings and the rest
        call("Part", kind="particles", fields={"speed": "m/s"}),
        call("Logger", quantities={"a": lambda one: 1.0}, every=0.1),
        call("Recorder", path="run.vtkhdf", parts=part, overwrite=True),
        call("Recording", path="nothing.vtkhdf"),
        call("recording.body_shapes", bodies=machine(), ids=None),
        call("pack", path="nothing.vtkhdf"),
        call("export.save", recording="nothing.vtkhdf", out="nothing.npz"),
        Call("state_hash", lambda o: {"*": (np.arange(3.0),)}),
        call("num_threads"),
        call("set_num_threads", threads=1),
        call("show_config"),
    ]


# Modules of what only looks or draws, or starts processes.
_LOOKS = ("cli", "errors", "render", "scenes", "sweeps")
# Exceptions, results that calls return, abstract bases, and a drawing.
NOT_CALLED = {
    *(name for name in substep.errors.__all__ if name in substep.__all__),
    *("AdvectionResult", "EnsembleResult", "OdeResult", "SecondOrderResult"),
    *("fields.Field", "geometry.LiquidSurface", "geometry.MeshReport", "geometry.Shape"),
    *(
        "RunCollection",
        "show",
        "sweep",
        "linalg.CholeskyReport",
        "linalg.KrylovResult",
        "linalg.LUReport",
        "mpm.StepReport",
    ),
    *("recording.RecordedPart", "rigid.Contacts", "rigid.Hits", "springs.SpringInfo"),
    *("stability.Region", "stability.plot", "systems.System"),
    "geometry.follow_keyframes",  # calls advance
    *("validate.Case", "validate.Outcome", "validate.cases", "validate.run", "validate.write_page"),
}


def public_callables():
    """Names of every public function and class, by the modules that list them."""
    seen, names = {}, []
    for prefix, module in [("", substep), *((f"{m}.", getattr(substep, m)) for m in _modules())]:
        for name in getattr(module, "__all__", ()):
            value = getattr(module, name)
            if callable(value) and not isinstance(value, ModuleType) and id(value) not in seen:
                seen[id(value)] = value
                names.append(prefix + name)
    return names


def _modules():
    return [
        n
        for n in substep.__all__
        if isinstance(getattr(substep, n), ModuleType) and n not in _LOOKS
    ]
