"""What holds for every solid of which rigid bodies and obstacles are made, whichever there are.

They are found by their base class, and made by the words of their constructors: a length is a
number, lengths are three, points are many. A shape with other words says here what these are.
"""

import copy
import inspect
import pickle

import numpy as np
import pytest
import substep
from substep import InputError, rigid
from substep.base.quaternions import rotate
from substep.geometry.shapes import Solid

VALUES = {
    "lengths": (0.8, 0.5, 0.6),
    "points": np.random.default_rng(0).normal(size=(30, 3)) / 3,
    "center": (0.3, -0.2, 0.1),
    "rotation": (0.8, 0.1, -0.5, 0.3),
}
LENGTHS = (0.35, 0.6, 0.5, 0.45)  # of what is one number, in the order of the arguments
PLACE = {"center", "rotation"}


def solids():
    found = [Solid]
    for kind in found:
        found += [k for k in kind.__subclasses__() if k.__module__.startswith("substep.")]
    return sorted({k for k in found if k is not Solid}, key=lambda kind: kind.__name__)


SOLIDS = pytest.mark.parametrize("kind", solids(), ids=lambda kind: kind.__name__)


def words(kind):
    """The arguments, and values for them; numbers are lengths."""
    numbers = iter(LENGTHS)
    given = {}
    for name, word in inspect.signature(kind).parameters.items():
        if name not in VALUES:
            assert word.annotation == "float", f"{kind.__name__}: VALUES has no {name}"
        given[name] = VALUES[name] if name in VALUES else next(numbers)
    return given


def make(kind, placed=True):
    return kind(**{k: v for k, v in words(kind).items() if placed or k not in PLACE})


def fine_mesh(shape):
    """Its surface, and by how much it may be off, of its size."""
    if "segments" in inspect.signature(shape.mesh).parameters:
        return shape.mesh(segments=256), 3e-4
    return shape.mesh(), 1e-12


@SOLIDS
def test_is_public_everywhere(kind):
    for package in (substep, substep.geometry, substep.rigid):
        assert getattr(package, kind.__name__) is kind
        assert kind.__name__ in dir(package)


@SOLIDS
def test_is_a_value_of_its_arguments(kind):
    shape, given = make(kind), words(kind)
    assert shape._fields == tuple(given)
    for name, value in given.items():
        assert getattr(shape, name) == pytest.approx(
            np.asarray(value) / (np.linalg.norm(value) if name == "rotation" else 1)
        )
        with pytest.raises(AttributeError, match="make another"):
            setattr(shape, name, value)
    again = pickle.loads(pickle.dumps(shape))
    assert again == shape and hash(again) == hash(shape) and copy.deepcopy(shape) is shape
    there = make(kind, placed=False)
    assert shape != there
    if not any(isinstance(value, np.ndarray) for value in given.values()):
        assert eval(repr(there), {kind.__name__: kind}) == there


@SOLIDS
@pytest.mark.parametrize("wrong", [np.nan, np.inf, 0.0, -1.0])
def test_refuses_by_the_name_of_the_argument(kind, wrong):
    given = words(kind)
    for name, value in given.items():
        if np.isfinite(wrong) and name in ("points", "center", "rotation"):
            continue  # any number will do
        bad = np.array(value, float)
        bad.flat[-1] = wrong
        with pytest.raises(InputError, match=rf"^{name}\b"):
            kind(**{**given, name: bad if bad.ndim else float(bad)})


@SOLIDS
def test_weighs_what_its_mesh_weighs(kind):
    shape = make(kind)
    mesh, off = fine_mesh(shape)
    assert mesh.report().closed
    own, of_mesh = (rigid.mass_properties(s, 700.0) for s in (shape, mesh))
    size = np.ptp(mesh.vertices, axis=0).max()
    assert own.mass == pytest.approx(of_mesh.mass, rel=3 * off)
    np.testing.assert_allclose(own.center_of_mass, of_mesh.center_of_mass, atol=size * off)
    most = own.inertia.max()
    np.testing.assert_allclose(own.inertia, of_mesh.inertia, atol=max(6 * off, 1e-10) * most)


@SOLIDS
def test_rays_meet_its_mesh(kind):
    shape = make(kind)
    mesh, off = fine_mesh(shape)
    worlds = []
    for ground in (shape, mesh):
        bodies = substep.RigidBodies()
        bodies.add(ground, (0, 0, 0), motion="static")
        worlds.append(bodies)
    rng = np.random.default_rng(1)
    x = rng.normal(size=(2000, 3))
    x *= 3 / np.linalg.norm(x, axis=1)[:, None]
    target = np.array(shape.center) + rng.uniform(-0.5, 0.5, x.shape)
    own, of_mesh = (bodies.ray_cast(x, target - x) for bodies in worlds)
    hit, meant = own.bodies >= 0, of_mesh.bodies >= 0
    assert 200 < hit.sum() < 1950
    assert (hit != meant).sum() < (20 if off > 1e-10 else 1)  # past a chord
    both = hit & meant
    # A ray along the surface goes far beneath a chord.
    cosine = -(own.normals * (target - x)).sum(1) / np.linalg.norm(target - x, axis=1)
    steep = both & (cosine > 0.2)
    np.testing.assert_allclose(
        own.distances[steep], of_mesh.distances[steep], atol=max(5 * off, 1e-9)
    )
    assert steep.sum() > 100


@SOLIDS
@pytest.mark.parametrize("hollow", [False, True])
def test_its_distance_as_an_obstacle_is_that_of_its_mesh(kind, hollow):
    shape = make(kind)
    mesh, off = fine_mesh(shape)
    size = np.ptp(mesh.vertices, axis=0).max()
    points = np.array(shape.center) + np.random.default_rng(2).uniform(
        -0.7 * size, 0.7 * size, (3000, 3)
    )
    expected = mesh.signed_distance(points)
    near = expected < 0.04 * size  # further off a sampled distance is a lower bound
    assert near.sum() > 100
    obstacle = substep.Collider(shape, hollow=hollow)
    found = obstacle.distance(points) * (-1 if hollow else 1)
    exact = type(shape)._obstacle is not Solid._obstacle
    atol = max(off, 1e-9) if exact else 0.025 * size
    np.testing.assert_allclose(found[near], expected[near], atol=atol)


def fallen(kind, ground, threads=None):
    """Two bodies, one flat and one askew, that have fallen and lie still."""
    shape = make(kind, placed=False)
    bodies = substep.RigidBodies(threads=threads)
    bodies.add(*ground, motion="static")
    bodies.add(
        shape,
        [[0, 0, 1.0], [2, 0, 1.0]],
        [[1, 0, 0, 0], VALUES["rotation"]],
        rolling_friction=0.02,
        spinning_friction=0.02,
    )
    bodies.advance(4.0)
    return shape, bodies


@SOLIDS
@pytest.mark.parametrize(
    "ground",
    [
        (substep.Plane(), (0, 0, 0)),
        (substep.Box((8, 8, 1)), (0, 0, -0.5)),
        (
            substep.TriangleMesh(
                [[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]]
            ),
            (0, 0, 0),
        ),
    ],
    ids=["plane", "box", "mesh"],
)
def test_falls_and_lies_on_the_ground(kind, ground):
    shape, bodies = fallen(kind, ground)
    mesh, _ = fine_mesh(shape)
    for row in (1, 2):
        position, turn = bodies.positions[row], bodies.rotations[row]
        lowest = rotate(turn, mesh.vertices)[:, 2].min() + position[2]
        assert abs(lowest) < 2e-3, "sinks or floats"
        assert np.abs(bodies.velocities[row]).max() < 5e-3
        assert np.abs(bodies.angular_velocities[row]).max() < 2e-2


@SOLIDS
def test_no_thread_changes_a_bit(kind):
    ground = (substep.Plane(), (0, 0, 0))
    states = [fallen(kind, ground, threads)[1].state() for threads in (1, 3)]
    hashes = [substep.state_hash(*state.values()) for state in states]
    assert hashes[0] == hashes[1]
