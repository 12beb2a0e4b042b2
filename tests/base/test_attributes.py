"""What can be assigned to, deleted and written, also in classes that users derive and in copies."""

import abc
import copy
import dataclasses
import inspect
import pickle

import numpy as np
import pytest
import substep
from substep.base.attributes import _WORDS

MESH = substep.geometry.box_mesh()
SOLID = substep.geometry.box_tetrahedra((1, 1, 1), (1, 1, 1))


def refused(match=None):
    return pytest.raises(substep.errors.AttributeInputError, match=match)


class Mix:
    def __init__(self, *args, **keywords):
        self.mixed = 1
        super().__init__(*args, **keywords)


class Mixed(Mix, substep.Box):
    color = None


class Painted(substep.Box):
    """Another signature, and attributes of its own."""

    color = None

    def __init__(self, color):
        super().__init__((1, 2, 3))
        self.color, self.names = color, ["a"]


@dataclasses.dataclass(eq=False)
class Data(substep.RigidBodies):
    limit: int = 3

    def __post_init__(self):
        super().__init__()


class Early(substep.PositionBasedDynamics):
    def __init__(self):
        self.colliders = ()  # what substep sets too
        self.seen = []
        super().__init__(np.zeros((1, 3)), 1.0)

    def _make(self, state):
        self.made = getattr(self, "made", 0) + 1  # called by the __init__ of substep
        return super()._make(state)


class Abstract(substep.RigidBodies, abc.ABC):
    pass


def dynamics(**options):
    return substep.PositionBasedDynamics(np.eye(3), 1.0, [substep.Distance([[0, 1]])], **options)


def springs():
    return substep.MassSpring(np.eye(3), [[0, 1]], masses=1.0, stiffness=10.0)


def body():
    return substep.SoftBody(
        SOLID.vertices, SOLID.tetrahedra, density=1.0, young_modulus=8.0, poisson_ratio=0.25
    )


def fluid():
    return substep.PositionBasedFluid(np.eye(3), 0.5)


def test_what_is_an_argument_of_a_method_is_told():
    bodies = substep.RigidBodies()
    told = r"friction.*it is an argument of add\(\) and set_material_pair\(\)"
    with refused(told):
        bodies.friction = 0.3
    with pytest.raises(AttributeError, match=told):
        bodies.friction  # noqa: B018
    with pytest.raises(AttributeError, match=r"no attribute 'colour'$"):
        bodies.colour  # noqa: B018
    assert not hasattr(bodies, "friction") and getattr(bodies, "_own", 1) == 1


@pytest.mark.parametrize(
    ("make", "fixed", "own"),
    [
        (lambda: Mixed((1, 1, 1)), ("lengths", "center", "frobnicate"), ("color", "mixed")),
        (Data, ("colliders", "report", "frobnicate"), ("limit",)),
        (Early, ("colliders", "masses", "solver", "frobnicate"), ("seen", "made")),
        (lambda: Painted("red"), ("lengths", "volume", "mesh"), ("color", "names")),
        (Abstract, ("frobnicate", "joints"), ()),
    ],
)
def test_derived_classes_change_only_what_is_their_own(make, fixed, own):
    one = make()
    for name in fixed:
        kept = getattr(one, name, None)
        with refused(f"^{name}: "):
            setattr(one, name, (5, 5, 5))
        assert getattr(one, name, None) == kept
    for name in own:
        setattr(one, name, 7)
        assert getattr(one, name) == 7


def test_a_body_cannot_free_what_substep_sets():
    class Loose(substep.Box):
        lengths = (2, 2, 2)

    box = Loose((1, 1, 1))
    with refused("^lengths: .*nothing; make another"):
        box.lengths = (5, 5, 5)


def test_classes_tell_the_signature_of_their_init():
    assert list(inspect.signature(substep.Box).parameters) == ["lengths", "center", "rotation"]
    assert list(inspect.signature(Painted).parameters) == ["color"]
    assert list(inspect.signature(Data).parameters) == ["limit"]


def test_attributes_cannot_be_deleted():
    tap = substep.Emitter((0, 0, 1), (0, 0, -1), 1.0, radius=0.1)
    ball = substep.Collider(substep.Sphere(1.0))
    for one, name in [
        (dynamics(), "colliders"),
        (dynamics(), "gravity"),
        (fluid(), "frobnicate"),
        (substep.Box((1, 1, 1)), "center"),
        (tap, "speed"),
        (ball, "friction"),
    ]:
        with refused(f"^{name}: .*cannot be deleted"):
            delattr(one, name)
    mixed = Mixed((1, 1, 1))
    del mixed.mixed
    assert not hasattr(mixed, "mixed")


@pytest.mark.parametrize(
    ("make", "name", "hint"),
    [
        (dynamics, "dt", "step_size"),
        (dynamics, "step", "step_size"),
        (dynamics, "g", "gravity"),
        (dynamics, "gravty", "gravity"),
        (dynamics, "x", "set_positions()"),
        (dynamics, "velocity", "set_velocities()"),
        (substep.RigidBodies, "n_threads", "threads"),
        (lambda: substep.Collider(substep.Sphere(1.0)), "center", "position"),
        (lambda: substep.Collider(substep.Sphere(1.0)), "bounciness", "restitution"),
        # What cannot be set is no hint:
        (substep.RigidBodies, "friction", None),
        (dynamics, "integrator", None),
        (dynamics, "iteration", None),
        (dynamics, "mu", None),
        (lambda: substep.Sphere(1.0), "radii", None),
    ],
)
def test_hints_are_what_can_be_set(make, name, hint):
    with refused(f"^{name}: ") as caught:
        setattr(make(), name, 1.0)
    assert (f"did you mean {hint}?" in str(caught.value)) is (hint is not None)
    assert ("did you mean" in str(caught.value)) is (hint is not None)


def test_hints_name_properties_that_exist():
    kinds = (substep.PositionBasedDynamics, substep.RigidBodies, substep.Collider)
    for word, right in _WORDS.items():
        assert any(hasattr(kind, right) for kind in kinds), word


def pickled(value):
    return pickle.loads(pickle.dumps(value))


@pytest.mark.parametrize("copied", [pickled, copy.deepcopy, copy.copy])
@pytest.mark.parametrize(
    ("make", "names"),
    [
        (dynamics, ["gravity", "masses"]),
        (fluid, ["gravity", "density"]),
        (springs, ["gravity", "masses", "stiffness", "damping", "rest_lengths", "edges"]),
        (body, ["gravity", "masses", "young_modulus", "poisson_ratio", "density", "faces"]),
        (lambda: dynamics().constraints[0], ["particles", "compliance", "damping"]),
        (
            lambda: substep.Emitter((0, 0, 1), (0, 0, -1), 1.0, size=(1, 1)),
            ["position", "direction", "size"],
        ),
        (lambda: substep.ConvexHull(np.vstack([np.zeros(3), np.eye(3)])), ["points"]),
        (lambda: MESH, ["vertices", "faces"]),
        (lambda: SOLID, ["vertices", "tetrahedra"]),
    ],
)
def test_copies_keep_what_is_read_only(make, names, copied):
    other = copied(make())
    for name in names:
        with pytest.raises(ValueError, match="read-only"):
            getattr(other, name)[...] = 5
    with refused():
        setattr(other, names[-1] if names[-1] != "gravity" else "masses", 5)


def test_constraints_in_a_pickle_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        pickled(dynamics()).constraints[0].particles[0] = 1


def test_arrays_that_a_simulation_writes_stay_writable():
    tap = substep.Emitter((0, 0, 1), (0, 0, -1), 1.0, radius=0.2)
    liquid = substep.PositionBasedFluid(np.zeros((0, 3)), 0.1, emitters=[tap])
    liquid.advance(0.1)
    twin = pickled(liquid)
    for one in (liquid, twin):
        one.advance(0.2)
    assert twin.emitted[0] == liquid.emitted[0] > 0


def test_joints_meshes_and_systems_are_checked():
    bodies = substep.RigidBodies()
    bob = bodies.add(substep.Sphere(0.1), (1, 0, 0))
    joint = bodies.hinge(bob, None, (0, 0, 0), (0, 1, 0))
    joint.limits = (-1.0, 1.0)
    assert joint.limits == (-1.0, 1.0)
    with refused(r"did you mean motor\?"):
        joint.motors = 5
    MESH.hinges.sum(), MESH.face_areas.sum(), SOLID.volumes.sum()  # are kept from now on
    for one, names in [
        (joint, ("number", "kind", "frobnicate")),
        (SOLID, ("vertices", "lacks", "flipped", "volumes", "edges", "frobnicate")),
        (MESH, ("vertices", "dropped", "face_areas", "hinges", "edges", "frobnicate")),
        (substep.systems.Lorenz(), ("sigma", "y0", "size", "native_system", "frobnicate")),
    ]:
        for name in names:
            with refused(f"^{name}: "):
                setattr(one, name, 5)


def test_arrays_of_meshes_and_fields_are_read_only():
    field = substep.SignedDistanceField.from_mesh(MESH, 0.1)
    sheet = substep.geometry.grid_mesh(3, 3)
    for array in (MESH.edge_uses, field.values, field.origin, sheet.boundary_loops[0]):
        assert not array.flags.writeable


@pytest.mark.parametrize("copied", [pickled, copy.deepcopy])
def test_copies_keep_who_is_who(copied):
    ball = substep.Collider(substep.Sphere(1.0, (0, 0, -3)))
    simulation = dynamics(colliders=[ball])
    both = copied({"sim": simulation, "ball": ball})
    assert both["ball"] is both["sim"].colliders[0] is not ball
    both["ball"].friction = 0.75
    assert both["sim"].colliders[0].friction == 0.75 != ball.friction
    assert simulation.copy().colliders[0] is not ball


def test_a_deep_copy_shares_nothing_of_a_derived_class():
    one = Early()
    one.seen.append(one)  # a circle
    other = copy.deepcopy(one)
    assert other.seen is not one.seen and other.seen[0] is other
    other.advance(0.1)
    assert one.time == 0.0 < other.time


@pytest.mark.parametrize("copied", [pickled, copy.deepcopy])
def test_shapes_of_derived_classes_keep_their_attributes(copied):
    one = Painted("red")
    one.color = "blue"
    other = copied(one)
    assert type(other) is Painted and other == one and hash(other) == hash(one)
    assert (other.color, other.names, other.lengths) == ("blue", ["a"], (1.0, 2.0, 3.0))
    with refused("^lengths: "):
        other.lengths = (5, 5, 5)


def test_what_meshes_compute_is_not_pickled():
    mesh = substep.geometry.sphere_mesh(subdivisions=2)
    small = len(pickle.dumps(mesh))
    mesh.nearest([[0, 0, 0]]), mesh.hinges.sum(), mesh.face_areas.sum()
    assert len(pickle.dumps(mesh)) == small
    np.testing.assert_array_equal(pickled(mesh).hinges, mesh.hinges)
