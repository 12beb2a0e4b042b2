"""Rigid bodies and wrong input: what is refused leaves everything as it was."""

import copy
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import substep
from substep import InputError, NonFiniteError, rigid

NAN, INF = math.nan, math.inf
BOX = rigid.Box((1, 1, 1))
FLAT = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
BALL = rigid.Sphere(0.25)
TETRAHEDRON = (
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],
    [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
)


def mesh(vertices=TETRAHEDRON[0], faces=TETRAHEDRON[1]):
    return substep.geometry.TriangleMesh(vertices, faces)


def bodies(n=4, **options):
    """Boxes that have fallen a little above the ground, and a hinge."""
    made = substep.RigidBodies(**options)
    made.add(rigid.Plane(), (0, 0, 0), motion="static", material="ice")
    x = [[1.1 * k, 0, 0.6] for k in range(n)]
    made.add(BOX, x, angular_velocities=(0.1, 0, 0), material="wood")
    made.hinge(1, 2, (0.5, 0, 0.6), (0, 1, 0))
    made.advance(0.3)
    return made


def state_hash(simulation):
    return substep.state_hash(*simulation.state().values())


def refused(simulation, error, message, call):
    """The call raises, and the simulation is as it was."""
    before = state_hash(simulation)
    with pytest.raises(error, match=message) as caught:
        call(simulation)
    assert state_hash(simulation) == before
    return caught.value


def is_finite(simulation):
    names = ("positions", "rotations", "momenta", "angular_momenta")
    return all(np.isfinite(getattr(simulation, name)).all() for name in names)


# Shapes, fixtures, motors.
@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: rigid.Plane((0, 0, 0)), InputError, "normal: expected a vector that is not 0"),
        (lambda: rigid.Plane((0, NAN, 1)), InputError, r"normal\[1\]: expected finite"),
        (lambda: rigid.Plane((0, 1)), InputError, "normal: expected shape"),
        (lambda: rigid.Plane(point=(0, 0, INF)), InputError, r"point\[2\]: expected finite"),
        (lambda: rigid.Fixture("box"), TypeError, "shape: expected a shape"),
        (lambda: rigid.Box((1, 1, 1), (0, 0)), InputError, "center: expected shape"),
        (lambda: rigid.Capsule(1, 1, rotation=4 * [0]), InputError, "rotation: expected a qu"),
        (lambda: rigid.Fixture(BOX, density=0), InputError, "density: expected a number above 0"),
        (lambda: rigid.Fixture(BOX, friction=-1), InputError, "friction: expected a number of at"),
        (lambda: rigid.Fixture(BOX, restitution=2), InputError, "restitution: .* from 0 to 1"),
        (lambda: rigid.Fixture(BOX, group=-1), InputError, "group: expected an integer from 0"),
        (lambda: rigid.Fixture(BOX, mask=2**32), InputError, "mask: expected an integer from 0"),
        (lambda: rigid.Fixture(BOX, mask=1.0), InputError, "mask: expected an integer"),
        (lambda: rigid.Fixture(BOX, static_friction=-1), InputError, "static_friction: expected a"),
        (lambda: rigid.Fixture(BOX, static_friction=INF), InputError, "static_friction: expected"),
        (
            lambda: rigid.Fixture(BOX, friction=0.5, static_friction=0.4),
            InputError,
            "static_friction: expected at least the friction, 0.5, got 0.4",
        ),
        (lambda: rigid.Fixture(BOX, material=1), TypeError, "material: expected the name of a"),
        (lambda: rigid.Fixture(BOX, material=""), InputError, "material: expected a name"),
        (lambda: rigid.Fixture(BOX, material="a\0"), InputError, "material: expected a name"),
        (lambda: rigid.Fixture(BOX, material="\ud800"), InputError, "material: expected a name"),
        (lambda: rigid.SpeedMotor(NAN), InputError, "speed: expected a finite"),
        (lambda: rigid.SpeedMotor(1, -1), InputError, "strength: expected a number of at least"),
        (lambda: rigid.SpeedMotor(1, NAN), InputError, "strength: expected a finite"),
        (lambda: rigid.SpringMotor(1, -1), InputError, "stiffness: expected a number of at"),
        (lambda: rigid.SpringMotor(1, 1, INF), InputError, "damping: expected a finite"),
    ],
)
def test_parts(make, error, message):
    with pytest.raises(error, match=message):
        make()


def test_plane_normals_of_any_length():
    assert rigid.Plane((0, 3e300, 4e300)).normal == pytest.approx((0, 0.6, 0.8))
    assert rigid.Plane((0, 3e-320, 0)).normal == (0, 1, 0)


# Worlds.
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"gravity": (0, -9.81)}, "gravity: expected shape"),
        ({"gravity": (0, 0, INF)}, r"gravity\[2\]: expected finite"),
        ({"step": 0.0}, "step: expected a number above 0"),
        ({"step": NAN}, "step: expected a finite number"),
        ({"substeps": 0}, "substeps: expected an integer from 1"),
        ({"substeps": 2.0}, "substeps: expected an integer"),
        ({"substeps": True}, "substeps: expected an integer"),
        ({"rotation": "euler"}, "rotation: expected one of"),
        ({"contact_margin": 0.0}, "contact_margin: expected a number above 0"),
        ({"time": NAN}, "time: expected a finite number"),
        ({"threads": 0}, "threads: expected an integer from 1 to 1024"),
    ],
)
def test_options(wrong, message):
    with pytest.raises(InputError, match=message):
        substep.RigidBodies(**wrong)


def test_options_of_wrong_types():
    for name in ("sleeping", "continuous"):
        with pytest.raises(TypeError, match=f"{name}: expected a bool"):
            substep.RigidBodies(**{name: 1})
    with pytest.raises(TypeError, match="step: expected a real number"):
        substep.RigidBodies(step="1")


# Bodies.
ROW = (0.0, 0.0, 5.0)
X = (1.0, 0.0, 0.0)
TURN = rigid.TurnSpring(1.0, 1.0)
INSIDE_OUT = [[a, c, b] for a, b, c in TETRAHEDRON[1]]


@pytest.mark.parametrize(
    ("wrong", "error", "message"),
    [
        # quaternions
        ({"rotations": (0, 0, 0, 0)}, InputError, "rotations: expected a quaternion that is not 0"),
        ({"rotations": (1, 0, NAN, 0)}, InputError, r"rotations\[2\]: expected finite"),
        ({"rotations": (1, 0, 0)}, InputError, "rotations: expected shape"),
        # positions, velocities
        ({"positions": (0, 0, NAN)}, InputError, r"positions\[2\]: expected finite"),
        ({"positions": [[0, 0, 0], [0, INF, 0]]}, InputError, r"positions\[1, 1\]: expected fin"),
        ({"positions": (0, 0, 1e200)}, InputError, "position: expected .* below 1e154"),
        ({"positions": [[0, 0]]}, InputError, "positions: expected shape.* give z = 0"),
        ({"positions": [[[0], [0], [0]]]}, InputError, "positions: expected shape"),
        ({"positions": 1.0}, InputError, "positions: expected shape"),
        ({"positions": ["a", "b", "c"]}, TypeError, "positions: expected real"),
        ({"velocities": (0, NAN, 0)}, InputError, r"velocities\[1\]: expected finite"),
        ({"velocities": [[0, 0, 0]] * 2}, InputError, "velocities: expected shape"),
        ({"angular_velocities": (0, 0)}, InputError, "angular_velocities: expected shape"),
        # mass
        ({"density": 0.0}, InputError, "density: expected a number above 0"),
        ({"density": -1.0}, InputError, "density: expected a number above 0"),
        ({"density": NAN}, InputError, "density: expected a finite"),
        ({"density": 1e300}, InputError, "mass: .* is out of range"),
        ({"mass": 0.0}, InputError, "mass: expected a number above 0"),
        ({"mass": -1.0}, InputError, "mass: expected a number above 0"),
        ({"mass": NAN}, InputError, "mass: expected a finite"),
        ({"mass": 5e-324}, InputError, "out of range"),
        ({"mass": "1"}, TypeError, "mass: expected a real number"),
        ({"mass": 1.0, "motion": "static"}, InputError, "a static body has none"),
        ({"inertia": [0, 1, 1]}, InputError, "inertia: "),
        ({"inertia": [-1, 1, 1]}, InputError, "inertia: "),
        ({"inertia": [1, 1, 2.5]}, InputError, "inertia: .*sum of the other two"),
        ({"inertia": [[1, 2, 0], [2, 1, 0], [0, 0, 1]]}, InputError, "inertia: "),
        ({"inertia": [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]}, InputError, "inertia: .*symmetric"),
        ({"inertia": [[1, 0, 0], [0, 1, 0], [0, 0, 0]]}, InputError, "inertia: "),
        ({"inertia": [NAN, 1, 1]}, InputError, r"inertia\[0\]: expected finite"),
        ({"inertia": [1, 1]}, InputError, "inertia: expected shape"),
        # surfaces
        ({"friction": -0.1}, InputError, "friction: expected a number of at least 0"),
        ({"friction": NAN}, InputError, "friction: expected a finite"),
        ({"friction": None}, TypeError, "friction: expected a real"),
        ({"static_friction": NAN}, InputError, "static_friction: expected a finite"),
        ({"static_friction": 0.4}, InputError, "static_friction: expected at least the friction"),
        ({"static_friction": "1"}, TypeError, "static_friction: expected a real"),
        ({"material": b"wood"}, TypeError, "material: expected the name of a material"),
        ({"material": ""}, InputError, "material: expected a name"),
        ({"restitution": 1.1}, InputError, "restitution: expected a number from 0 to 1"),
        ({"restitution": -0.1}, InputError, "restitution: expected a number of at least 0"),
        ({"rolling_friction": -1}, InputError, "rolling_friction: expected a number of at least"),
        ({"spinning_friction": INF}, InputError, "spinning_friction: expected a finite"),
        ({"group": -1}, InputError, "group: expected an integer from 0"),
        ({"mask": 2**32}, InputError, "mask: expected an integer from 0"),
        # shapes
        ({"shape": []}, InputError, "shape: expected at least one"),
        ({"shape": "box"}, TypeError, "shape: expected a shape"),
        ({"shape": [BOX, 1]}, TypeError, r"shape\[1\]: expected a shape"),
        ({"shape": rigid.Plane()}, InputError, "shape: a Plane is ground"),
        ({"shape": mesh()}, InputError, "shape: a TriangleMesh is ground"),
        ({"shape": mesh(), "motion": "kinematic"}, InputError, "shape: a TriangleMesh is ground"),
        ({"shape": rigid.ConvexHull(FLAT)}, InputError, "plane|points"),
        ({"shape": rigid.Sphere(1e-200)}, InputError, "mass"),
        ({"motion": "moving"}, InputError, "motion: expected one of"),
        ({"motion": "static", "velocities": (1, 0, 0)}, InputError, "velocities: a static body"),
    ],
)
def test_bodies(wrong, error, message):
    simulation = bodies()
    arguments = {"shape": BOX, "positions": ROW} | wrong
    refused(simulation, error, message, lambda s: s.add(**arguments))
    simulation.step()
    assert is_finite(simulation)


def test_meshes_that_bound_no_solid_give_no_mass():
    v, f = TETRAHEDRON
    shifted = np.add(v, [0.1, 0.1, -0.2])
    two = mesh(np.vstack([v, shifted]), np.vstack([f, np.add(f, 4)]))
    for bad in (mesh(v, f[:3]), mesh(v, INSIDE_OUT), two):
        with pytest.raises(InputError):
            bodies().add(BOX, ROW, mass=rigid.mass_properties(bad))
    simulation = bodies()
    weight = rigid.mass_properties(mesh())
    simulation.add(BOX, ROW, mass=weight)
    assert simulation.masses[-1] == weight.mass


def test_meshes_with_flat_triangles_are_refused():
    flat = mesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    refused(bodies(), InputError, "area", lambda s: s.add(flat, (0, 0, 0), motion="static"))


def test_quaternions_of_any_length_are_normalised():
    simulation = bodies()
    for q in ((3e200, 4e200, 0, 0), (3e-310, 4e-310, 0, 0), (3, 4, 0, 0)):
        k = simulation.add(BALL, (9, 9, 9), q)
        assert simulation.rotations[-1] == pytest.approx([0.6, 0.8, 0, 0])
        simulation.remove(k)


# Methods.
def test_a_pair_where_no_shape_has_a_material():
    world = substep.RigidBodies()
    world.add(BOX, (0, 0, 0))
    with pytest.raises(InputError, match=r"^a: no shape has a material, got 'rubber'$"):
        world.set_material_pair("rubber", "ice", friction=0.1)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda s: s.remove([0, 99]), IndexError, r"ids\[1\]: there is no body 99"),
        (lambda s: s.remove(-1), IndexError, "ids: there is no body -1"),
        (lambda s: s.remove([2**31]), IndexError, r"ids\[0\]"),
        (lambda s: s.remove([2**63]), IndexError, r"ids\[0\]"),
        (lambda s: s.remove([0.5]), InputError, "ids: expected integers"),
        (lambda s: s.remove([[0]]), InputError, "ids: expected integers, shape"),
        (lambda s: s.remove(True), InputError, "ids: expected integers"),
        (lambda s: s.exclude(0, 0), InputError, "b: expected another body"),
        (lambda s: s.exclude(0, 99), IndexError, "there is no body 99"),
        (lambda s: s.exclude(0, [1]), InputError, "b: expected the id of a body"),
        *(
            (lambda s, a=a, b=b: s.set_material_pair(a, b, friction=0.1), InputError, message)
            for a, b, message in [
                ("wood", "steel", "b: expected a material of a shape, 'ice', 'wood', got 'steel'"),
                ("wodo", "ice", "a: expected a material of a shape, 'ice', 'wood', got 'wodo'"),
                ("Wood", "ice", "a: expected a material"),
                ("", "ice", "a: expected a name"),
            ]
        ),
        (lambda s: s.set_material_pair(1, "ice"), TypeError, "a: expected the name of a material"),
        (lambda s: s.set_material_pair("ice", None), TypeError, "b: expected the name of a mat"),
        *(
            (lambda s, told=told: s.set_material_pair("ice", "wood", **told), error, message)
            for told, error, message in [
                ({"friction": -0.1}, InputError, "friction: expected a number of at least 0"),
                ({"friction": NAN}, InputError, "friction: expected a finite"),
                ({"friction": "0.1"}, TypeError, "friction: expected a real number"),
                ({"static_friction": 0.5}, InputError, "static_friction: expected friction with"),
                ({"friction": 0.5, "static_friction": 0.4}, InputError, "at least the friction"),
                ({"restitution": 1.1}, InputError, "restitution: expected a number from 0 to 1"),
                ({"rolling_friction": INF}, InputError, "rolling_friction: expected a finite"),
                ({"spinning_friction": -1}, InputError, "spinning_friction: expected a number"),
            ]
        ),
        (lambda s: s.fixtures(99), IndexError, "there is no body 99"),
        (lambda s: s.wake(99), IndexError, "there is no body 99"),
        (lambda s: s.rows([0, 99]), IndexError, r"ids\[1\]: there is no body 99"),
        (lambda s: s.rows(0.5), InputError, "ids: expected integers"),
        (lambda s: s.set_positions([[0, 0, 0]]), InputError, "values: expected shape"),
        (lambda s: s.set_positions((0, 0, INF), ids=1), InputError, r"values\[2\]"),
        (lambda s: s.set_positions(ROW, ids=[0, 99]), IndexError, r"ids\[1\]"),
        (lambda s: s.set_rotations((0, 0, 0, 0)), InputError, "values: expected a quaternion"),
        (lambda s: s.set_rotations((1, 0, 0)), InputError, "values: expected shape"),
        (lambda s: s.set_velocities((0, NAN, 0), ids=1), InputError, r"values\[1\]"),
        (lambda s: s.set_velocities((0, 1, 0), ids=[1, 0]), InputError, r"ids\[1\]: a static body"),
        (lambda s: s.set_velocities((0, 1), ids=[1]), InputError, "values: expected shape"),
        (lambda s: s.set_angular_velocities((1, 0, 0), 0), InputError, "a static body"),
        (lambda s: s.set_angular_velocities(None), TypeError, "values: expected"),
        (lambda s: s.set_forces((0, NAN, 0)), InputError, r"values\[1\]"),
        (lambda s: s.set_torques([(0, 0, 1)] * 2), InputError, "values: expected shape"),
        (lambda s: s.apply_force(1, (0, NAN, 0)), InputError, r"force\[1\]"),
        (lambda s: s.apply_force(1, (0, 0, 1), (0, 0)), InputError, "point: expected shape"),
        (lambda s: s.apply_force([1, 99], (0, 0, 1)), IndexError, r"ids\[1\]"),
        (lambda s: s.apply_force(1, None), TypeError, "force"),
        (lambda s: s.apply_impulse(1, (0, 0, INF)), InputError, r"impulse\[2\]"),
        (lambda s: s.ray_cast((0, 0), (0, 0, 1)), InputError, "origins: expected shape"),
        (lambda s: s.ray_cast((0, 0, 0), (0, 0, 0)), InputError, "directions: expected vectors"),
        (lambda s: s.ray_cast((0, 0, 0), [(0, 0, 1)] * 2), InputError, "directions: expected sh"),
        (lambda s: s.ray_cast((0, 0, 0), (0, 0, 1), -1), InputError, "length: expected"),
        (lambda s: s.ray_cast((0, 0, 0), (0, 0, 1), NAN), InputError, "length: expected"),
        (lambda s: s.ray_cast((0, NAN, 0), (0, 0, 1)), InputError, r"origins\[1\]"),
        (lambda s: s.ray_cast((0, 0, 0), (0, 0, 1), mask=-1), InputError, "mask: expected"),
        (lambda s: s.ray_cast_all((0, 0, 0), (0, 0, NAN)), InputError, r"direction\[2\]"),
        (lambda s: s.shape_cast(BOX, ROW, (1, 0, 0), INF), InputError, "length: expected a fin"),
        (lambda s: s.shape_cast(rigid.Plane(), ROW, (1, 0, 0), 1), InputError, "convex shape"),
        (lambda s: s.shape_cast("box", ROW, (1, 0, 0), 1), TypeError, "shape: expected a shape"),
        (lambda s: s.overlapping(mesh(), ROW), InputError, "shape: expected a convex shape"),
        (lambda s: s.overlapping(BOX, ROW, rotation=(0, 0, 0, 0)), InputError, "rotation"),
        (lambda s: s.ball(1, 1, ROW), InputError, "bod"),
        (lambda s: s.ball(0, None, ROW), InputError, "dynamic"),
        (lambda s: s.ball(1, 99, ROW), IndexError, "there is no body 99"),
        (lambda s: s.ball(1, 2, (0, 0)), InputError, "anchor: expected shape"),
        (lambda s: s.ball(1, 2, ROW, cone=4), InputError, "cone: expected an angle"),
        (lambda s: s.ball(1, 2, ROW, cone=0), InputError, "cone: expected"),
        (lambda s: s.hinge(1, 2, ROW, (0, 0, 0)), InputError, "axis: expected a vector"),
        (lambda s: s.hinge(1, 2, ROW, (0, 0, 1), limits=(1, -1)), InputError, "limits: expected"),
        (lambda s: s.hinge(1, 2, ROW, (0, 0, 1), limits=(NAN, 1)), InputError, "limits: expected"),
        (lambda s: s.hinge(1, 2, ROW, (0, 0, 1), motor=3), TypeError, "motor: expected"),
        (lambda s: s.hinge(1, 2, ROW, (0, 0, 1), collide=1), TypeError, "collide: expected"),
        (lambda s: s.slider(1, 2, ROW, (NAN, 0, 1)), InputError, r"axis\[0\]"),
        (lambda s: s.universal(1, 2, ROW, X, (0, 0, 0)), InputError, "axis_b: expected a vector"),
        (lambda s: s.universal(1, 2, ROW, (0, INF, 0), X), InputError, r"axis_a\[1\]"),
        (lambda s: s.universal(1, 2, ROW, X, (1, 1, 0)), InputError, "expected axes at right ang"),
        (lambda s: s.universal(1, 2, ROW, X, X[:2]), InputError, "axis_b: expected shape"),
        (lambda s: s.elastic(1, 2, ROW, X, 5.0), TypeError, "spring: expected a TurnSpring"),
        (lambda s: s.elastic(1, 2, ROW, (0, 0, 0), TURN), InputError, "axis: expected a vector"),
        (lambda s: s.elastic(1, 2, (0, NAN, 0), X, TURN), InputError, r"anchor\[1\]"),
        (lambda s: rigid.TurnSpring(-1, 0), InputError, "swing: expected"),
        (lambda s: rigid.TurnSpring(1, INF), InputError, "twist: expected"),
        (lambda s: rigid.TurnSpring(1, 1, NAN), InputError, "swing_damping: expected"),
        (lambda s: rigid.TurnSpring(1, 1, 0, "a"), TypeError, "twist_damping: expected"),
        (lambda s: rigid.TurnSpring(1, 1, rest=(0, 4, 0)), InputError, "rest: expected a rot"),
        (lambda s: rigid.TurnSpring(1, 1, rest=(0, 1)), InputError, "rest: expected shape"),
        (lambda s: s.joints[0].__setattr__("spring", TURN), InputError, "only elastic"),
        (lambda s: s.joints[0].__setattr__("spring", None), TypeError, "expected a TurnSpring"),
        (lambda s: s.distance(1, 2, ROW, ROW, limits=(-2, -1)), InputError, "distance|lower|limit"),
        (
            lambda s: s.distance(1, 2, ROW, (0, 0, 9), motor=rigid.SpringMotor(1, 9)),
            InputError,
            r"limits: expected the distances between which the motor acts, such as \(0, inf\)",
        ),
        (lambda s: s.distance(1, 2, ROW, (0, 0, 9), motor=1), TypeError, "motor: expected"),
        (lambda s: rigid.Joint(None, 0), TypeError, "world: expected RigidBodies, got None"),
        (lambda s: rigid.Joint(s, "a"), InputError, "number: expected an integer, got 'a'"),
        (
            lambda s: rigid.Joint(s, -1),
            InputError,
            "number: expected an integer at least 0, got -1",
        ),
        (lambda s: s.body("x"), InputError, "name: .* of the bodies of a file, .* got 'x'"),
        (lambda s: s.joint("x"), InputError, "name: .* of the joints of a file, .* got 'x'"),
        (lambda s: s.joints[0].__setattr__("limits", (2, 1)), InputError, "limits: expected"),
        (lambda s: s.joints[0].__setattr__("motor", 1), TypeError, "motor: expected"),
        *(
            (lambda s, dt=dt: s.step(dt), InputError, "dt: expected a")
            for dt in (0, -1e-3, NAN, INF)
        ),
        (lambda s: s.step("1"), TypeError, "dt: expected a real number"),
        *(
            (lambda s, t=t: s.advance(t), InputError, "duration: expected a")
            for t in (-1, NAN, INF)
        ),
        (lambda s: s.advance(1.7e308 * 10), InputError, "duration"),
        (lambda s: s.advance(1, 3), TypeError, "callback: expected a callable"),
    ],
)
def test_wrong_calls(call, error, message):
    simulation = bodies()
    refused(simulation, error, message, call)
    simulation.step()
    assert is_finite(simulation)


@pytest.mark.parametrize("dt", [1e-320, 1e-30, 1e3, 1e300])
def test_steps_of_any_size_are_finite_or_refused(dt):
    simulation = bodies()
    before = state_hash(simulation)
    try:
        simulation.step(dt)
    except substep.SolverError:
        assert state_hash(simulation) == before
    assert is_finite(simulation)
    simulation.step()


def test_removed_joints_are_gone():
    simulation = bodies()
    joint = simulation.joints[0]
    joint.remove()
    for use in (joint.remove, lambda: joint.coordinate, lambda: joint.force):
        with pytest.raises(IndexError, match="there is no joint 0: it was removed"):
            use()
    with pytest.raises(IndexError):
        joint.limits = (0, 1)
    assert simulation.joints == ()
    other = simulation.hinge(1, 2, (0, 0, 0), (0, 0, 1))
    simulation.remove(2)  # its joints go with it
    assert simulation.joints == ()
    with pytest.raises(IndexError):
        _ = other.coordinate


# What is written through views.
@pytest.mark.parametrize(
    ("write", "index"),
    [
        (lambda s: s.centers_of_mass.__setitem__((3, 0), NAN), 3),
        (lambda s: s.centers_of_mass.__setitem__((0, 0), NAN), 0),
        (lambda s: s.principal_rotations.__setitem__((2, 1), INF), 2),
        (lambda s: s.principal_rotations.__setitem__(2, 0.0), 2),
        (lambda s: s.momenta.__setitem__((1, 2), NAN), 1),
        (lambda s: s.momenta.__setitem__((1, 2), 1e200), 1),
        (lambda s: s.angular_momenta.__setitem__((1, 2), NAN), 1),
        (lambda s: s.forces.__setitem__((4, 2), NAN), 4),
        (lambda s: s.torques.__setitem__((4, 2), -INF), 4),
    ],
)
def test_what_is_written_is_refused_by_the_next_step(write, index):
    simulation = bodies()
    good = simulation.state()
    write(simulation)
    arrays = [getattr(simulation, name) for name in ("centers_of_mass", "principal_rotations",
              "momenta", "angular_momenta", "forces", "torques")]  # fmt: skip
    before = [array.tobytes() for array in arrays]
    for act in (simulation.step, lambda: simulation.advance(1.0)):
        with pytest.raises(NonFiniteError, match=f"body {index}") as caught:
            act()
        assert caught.value.index == index
        assert [array.tobytes() for array in arrays] == before
    simulation.restore(good)
    simulation.step()
    assert is_finite(simulation)


@pytest.mark.parametrize(
    ("dt", "message"),
    [
        (1e300, r"body 2: its way is not finite in a step of 1e\+300 s; take a smaller step$"),
        (
            1e120,
            r"body 7: its motion is not finite after a step of 1e\+120 s; take a smaller step,",
        ),
        (5e-324, r"body 7: its motion is .* after a step of 4.94066e-324 s; take a longer step$"),
    ],
)
def test_steps_beyond_floating_point_name_the_body_and_the_remedy(dt, message):
    made = substep.RigidBodies(gravity=(0, 0, 0))
    made.add(rigid.Plane(), (0, 0, 0), motion="static")
    ends = [rigid.Sphere(0.1, (x, 0, 0)) for x in (-0.3, 0.3)]
    made.add(ends, [[3 * k, 9, 5] for k in range(6)])  # with more shapes than bodies
    made.remove([1, 3])  # ids are no rows
    ball = made.add(rigid.Sphere(0.1), (0, 0, 0.05), velocities=(0, 0, -1))
    before = state_hash(made)
    with pytest.raises(NonFiniteError, match=message) as caught:
        made.step(dt)
    assert ball == 7 and caught.value.time == 0.0
    assert f"body {caught.value.index}:" in message
    assert state_hash(made) == before


# Numbers that fail.
def test_motion_beyond_float64_names_the_body_and_leaves_the_last_good_step():
    simulation = bodies()
    simulation.momenta[3] = (1e305, 0, 0)
    view = simulation.centers_of_mass
    before = state_hash(simulation)
    with pytest.raises(NonFiniteError) as caught:
        simulation.step(1e10)
    assert caught.value.index == 3
    assert caught.value.time == pytest.approx(simulation.time)
    assert state_hash(simulation) == before
    assert view.ctypes.data == simulation.centers_of_mass.ctypes.data


def test_a_failure_within_advance_says_which_step():
    simulation = bodies()

    def callback(s):
        if s.time > 0.3 + 4.5 / 60:
            s.forces[3] = (1e308, 0, 0)

    with pytest.raises(NonFiniteError) as caught:
        simulation.advance(1.0, callback)
    assert caught.value.step == 5
    assert is_finite(simulation)
    simulation.forces[:] = 0
    simulation.momenta[3] = 0
    simulation.step()


def test_fast_rotation():
    simulation = bodies()
    for joint in simulation.joints:  # which would be torn, see test_joints.py
        joint.remove()
    k = simulation.add(BOX, (0, 0, 2.5), angular_velocities=(1e6, 2e5, 0))
    told = simulation.diagnostics()
    energy = told["energy"]
    for _ in range(30):
        simulation.step()
        told = simulation.diagnostics()
        assert told["energy"] <= energy * (1 + 1e-3)
    assert is_finite(simulation)
    lengths = np.linalg.norm(simulation.principal_rotations, axis=1)
    assert lengths == pytest.approx(1, abs=1e-12) and k == 5


def test_a_hundred_coincident_boxes_are_parted_gently():
    simulation = substep.RigidBodies()
    simulation.add(rigid.Plane(), (0, 0, 0), motion="static")
    simulation.add(rigid.Box((0.2, 0.2, 0.2)), np.tile([0, 0, 0.2], (100, 1)))
    begin = time.perf_counter()
    for _ in range(10):
        simulation.advance(0.1)
        assert np.linalg.norm(simulation.velocities, axis=1).max() < 20
    assert time.perf_counter() - begin < 60
    assert is_finite(simulation)
    assert np.abs(simulation.positions).max() < 35
    assert len(simulation.contacts()) > 50  # none was dropped


def test_mass_ratios():
    simulation = substep.RigidBodies()
    simulation.add(rigid.Plane(), (0, 0, 0), motion="static")
    simulation.add(BOX, (0, 0, 0.5), mass=1e-6)
    simulation.add(BOX, (0, 0, 1.5), mass=1e6)
    simulation.advance(0.5)
    assert is_finite(simulation)


def test_bodies_far_away():
    simulation = bodies()
    far = simulation.add(BALL, [[1e15, 0, 0.2], [1e150, 0, 5]])
    for _ in range(5):
        try:
            simulation.step()
        except NonFiniteError as error:
            assert error.index == 6  # a box around it has no end
            simulation.remove(far[1])
    assert is_finite(simulation)


# States.
def test_states_that_do_not_fit():
    simulation = bodies()
    good = simulation.state()
    for name in good:
        less = {key: value for key, value in good.items() if key != name}
        refused(simulation, InputError, f"{name} missing", lambda s, less=less: s.restore(less))
    rotations = good["rotations"].copy()
    rotations[2] = 0
    wrong_pairs = good["contact_pairs"].copy()
    wrong_pairs[0, 0] = 10**6
    wrong_joints = good["joint_pairs"].copy()
    wrong_joints[0, 1] = -7

    def at(name, column, value):
        rows = good[name].copy()
        rows[0, column] = value
        return {name: rows}

    for change, message in [
        ({"time": NAN}, "time"),
        ({"steps": -1}, "steps"),
        ({"positions": good["positions"][1:]}, "positions"),
        ({"positions": np.full_like(good["positions"], NAN)}, "positions"),
        ({"rotations": rotations}, r"rotations.*\[2\]"),
        ({"masses": good["masses"] * 2}, "mass"),
        ({"ids": good["ids"] + 1, "next_id": 9}, "ids"),
        ({"ids": good["ids"][::-1].copy()}, "ids"),
        ({"next_id": 1}, "next_id"),
        ({"joint_ids": good["joint_ids"][:0]}, "joint"),
        ({"contacts": good["contacts"][:, :5]}, "contacts"),
        ({"contacts": good["contacts"][:-1]}, "contact"),
        ({"contact_pairs": wrong_pairs}, "."),
        ({"joint_pairs": wrong_joints}, "."),
        ({"island": good["island"] + 50}, "."),
        ({"excluded": np.array([[0, 99]], np.int32)}, "."),
        (at("contacts", 0, 5.0), "length 1"),
        (at("contacts", -16, -1.0), "friction"),  # then static friction, restitution
        (at("contacts", -15, -1.0), "static friction"),
        (at("contacts", -14, 2.0), "restitution"),
        (at("contacts", -1, -1.0), "load"),
        ({"material_names": np.array([255, 0, 98, 0], np.uint8)}, "material_names"),
        ({"material_names": np.array([97, 0], np.uint8)}, "material_names"),
        ({"material_names": np.array([97, 0, 98], np.uint8)}, "material_names"),
        ({"material_pairs": np.zeros((0, 4))}, "material_pairs"),
        ({n: good[n][::-1].copy() for n in ("contacts", "contact_pairs")}, "order"),
        (at("joint_pairs", 0, 9), "no such joint"),
        (at("joint_pairs", 3, 9), "no such kind|only hinges"),
        (at("joints", -1, np.inf), "errors"),
        ({"positions": good["positions"] + 1e160}, r"\['positions'\]\[0\]: .* too large"),
        ({"placed_positions": good["placed_positions"] + 1e160}, r"placed_positions.* too large"),
        ({"slow_time": good["slow_time"] - 1}, "slow_time"),
    ]:
        refused(simulation, InputError, message, lambda s, change=change: s.restore(good | change))
    simulation.restore(good)
    other = bodies(n=3)
    refused(other, InputError, "ids", lambda s: s.restore(good))


def test_checkpoints_that_are_spoiled(tmp_path):
    simulation = bodies()
    path, bad = tmp_path / "good", tmp_path / "bad"
    simulation.save(path)
    whole = path.read_bytes()
    for cut in (0, 7, 20, 100, len(whole) - 1):
        bad.write_bytes(whole[:cut])
        refused(simulation, substep.FormatError, ".", lambda s: s.load(bad))
    rng = np.random.default_rng(0)
    for at in rng.integers(0, len(whole), 40):
        flipped = bytearray(whole)
        flipped[at] ^= 1 << int(rng.integers(8))
        bad.write_bytes(flipped)
        refused(simulation, substep.FormatError, ".", lambda s: s.load(bad))
    refused(bodies(n=3), substep.CorruptError, "does not fit", lambda s: s.load(path))
    with pytest.raises(OSError):
        simulation.load(tmp_path / "absent")
    with pytest.raises(OSError):
        simulation.save(tmp_path / "absent" / "file")
    simulation.load(path)


@pytest.mark.parametrize("copied", [lambda s: s.copy(), copy.copy, copy.deepcopy,
                                    lambda s: pickle.loads(pickle.dumps(s))])  # fmt: skip
def test_copies_share_nothing(copied):
    simulation = bodies(threads=2)
    twin = copied(simulation)
    before = state_hash(simulation)
    assert state_hash(twin) == before and twin.threads == 2
    twin.add(BALL, (0, 0, 9))
    twin.joints[0].motor = rigid.SpeedMotor(1.0)
    twin.momenta[1] += 1
    twin.advance(0.1)
    assert state_hash(simulation) == before
    assert simulation.joints[0].motor is None


# Arrays of other people.
def test_arrays_are_copied_and_never_written():
    x = np.array([[0.0, 0, 5], [3, 0, 5]])
    q = np.tile([2.0, 0, 0, 0], (2, 1))
    for array in (x, q):
        array.flags.writeable = False
    simulation = substep.RigidBodies()
    simulation.add(BOX, x, q)
    simulation.step()
    assert x.tolist() == [[0, 0, 5], [3, 0, 5]] and q[0, 0] == 2
    fortran = np.asfortranarray(np.tile(x, (1, 2)))[:, ::2]
    simulation.add(BOX, fortran[::-1], velocities=np.broadcast_to([0.0, 0, 1], (2, 3)))
    assert simulation.positions[2:].tolist() == fortran[::-1].tolist()
    masked = np.ma.masked_array(x, mask=x == 5)
    refused(simulation, InputError, "positions: masked", lambda s: s.add(BOX, masked))


# Threads and processes.
def running(threads=1):
    simulation = substep.RigidBodies(threads=threads, sleeping=False)
    simulation.add(rigid.Plane(), (0, 0, 0), motion="static")
    rng = np.random.default_rng(0)
    x = np.stack(np.meshgrid(*[np.arange(8.0)] * 3), -1).reshape(-1, 3) * 0.25 + [0, 0, 0.2]
    simulation.add(rigid.Box((0.2, 0.2, 0.2)), x + rng.uniform(0, 0.02, x.shape))
    return simulation


def test_one_object_from_two_threads_is_refused():
    simulation = running()
    outcomes = []
    barrier = threading.Barrier(2)

    def work():
        barrier.wait()
        try:
            simulation.advance(0.5)
            outcomes.append("done")
        except InputError as error:
            outcomes.append(str(error))

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert sorted(outcome == "done" for outcome in outcomes) == [False, True]
    assert any("in use" in outcome for outcome in outcomes)
    assert simulation.time == 0.5


def test_another_thread_is_refused_during_a_callback():
    simulation = bodies()
    outcomes = []

    def other():
        try:
            simulation.apply_impulse(1, (0, 0, 1))
        except InputError as error:
            outcomes.append(str(error))

    def callback(s):
        thread = threading.Thread(target=other)
        thread.start()
        thread.join()
        s.apply_impulse(2, (0, 0, 0.1))

    simulation.advance(1 / 60, callback)
    assert len(outcomes) == 1 and "in use by another thread" in outcomes[0]


class Alarm(Exception):
    pass


@pytest.mark.parametrize("threads", [1, 2])
def test_signals_stop_a_long_run_after_a_whole_step(threads):
    simulation = running(threads)
    twin = running()

    def ring(*_):
        raise Alarm

    before = signal.signal(signal.SIGALRM, ring)
    try:
        begin = time.perf_counter()
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        with pytest.raises(Alarm):
            simulation.advance(1e6)
        waited = time.perf_counter() - begin - 0.3
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert waited < 1.0
    steps = round(simulation.time * 60)
    for _ in range(steps):
        twin.step()
    assert steps > 0 and simulation.positions.tolist() == twin.positions.tolist()
    simulation.step()


@pytest.mark.skipif("libasan" in os.environ.get("LD_PRELOAD", ""), reason="ASan reserves terabytes")
def test_memory_that_runs_out_leaves_everything_as_it_was():
    code = """
import resource
import numpy as np
import substep
from substep import rigid

def used():
    return int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()

def limit(bytes):
    resource.setrlimit(resource.RLIMIT_AS, (bytes, resource.RLIM_INFINITY))

def state_hash(bodies):
    return substep.state_hash(*bodies.state().values())

x = np.stack(np.meshgrid(*[np.arange(14.0)] * 3), -1).reshape(-1, 3) * 0.19 + [0, 0, 0.1]
failed = {"step": 0, "add": 0}
for extra in range(0, 12):
    bodies = substep.RigidBodies(threads=1)
    bodies.add(rigid.Plane(), (0, 0, 0), motion="static")
    bodies.add(rigid.Box((0.1, 0.1, 0.1)), x[: len(x) // 2])
    view = bodies.centers_of_mass
    before = state_hash(bodies)
    for name, act in (("step", bodies.step), ("add", lambda: bodies.add(rigid.Sphere(0.1), x))):
        limit(used() + extra * 400_000)
        try:
            act()
        except MemoryError:
            failed[name] += 1
            limit(resource.RLIM_INFINITY)
            assert state_hash(bodies) == before
            assert view.ctypes.data == bodies.centers_of_mass.ctypes.data
        limit(resource.RLIM_INFINITY)
        before = state_hash(bodies)
    bodies.advance(0.1)
    assert np.isfinite(bodies.positions).all()
print(failed["step"] > 0, failed["add"] > 0)
"""
    environment = {**os.environ, "MALLOC_MMAP_THRESHOLD_": "65536", "MALLOC_ARENA_MAX": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout == "True True\n", done.stderr
