"""What comes in from outside, of every class: copied, refused by name, or taken as said."""

import math
import os
import resource
import threading

import numpy as np
import pytest
import substep
from substep.base.rows import Numbered
from test_conformance import classes, content, example

InputError = substep.InputError
NUMBERED = [kind for kind in classes() if issubclass(kind, Numbered)]  # what has rows with ids
KINDS = pytest.mark.parametrize("kind", NUMBERED, ids=lambda kind: kind.__name__)
P = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def fluid(**options):
    return substep.PositionBasedFluid(**({"positions": 0.1 * P, "spacing": 0.1} | options))


def jelly(**options):
    solid = substep.mpm.FixedCorotated(1000, 1.0, 0.3)
    given = {"positions": 0.1 * P, "materials": solid, "cell": 0.1, "volume": 1e-4}
    return substep.MaterialPointMethod(**(given | options))


def points(**options):
    return substep.PositionBasedDynamics(**({"positions": P, "masses": 1.0} | options))


def net(**options):
    given = {"positions": P, "edges": [[0, 1]], "stiffness": 1.0, "masses": 1.0}
    return substep.MassSpring(**(given | options))


def balls():
    bodies = substep.RigidBodies()
    bodies.add(substep.Sphere(0.1), P)
    return bodies


# ---------------------------------------------------------------------------- arrays are copied

QUAD, PAIR, TRIPLE = (np.arange(n, dtype=np.int32)[None] for n in (4, 2, 3))
HELD = [
    (PAIR, lambda a: substep.Distance(a, [1.0])),
    (PAIR, lambda a: substep.pbd.Tether(a)),
    (QUAD, lambda a: substep.pbd.Bending(a)),
    (QUAD, lambda a: substep.pbd.IsometricBending(a)),
    (TRIPLE, lambda a: substep.pbd.TriangleArea(a)),
    (QUAD, lambda a: substep.pbd.TetrahedronVolume(a)),
    (QUAD, lambda a: substep.pbd.NeoHookean(a, 1.0, 0.3)),
    (TRIPLE[0], lambda a: substep.pbd.Attachment(a)),
    (QUAD, lambda a: substep.pbd.ShapeMatching(a)),
    (TRIPLE, lambda a: substep.pbd.SelfCollision(a, thickness=0.1)),
    (PAIR, lambda a: substep.pbd.CustomConstraint(a, lambda x: (x[:, 0, 0], 0 * x))),
    (np.ones(4), lambda a: substep.pbd.ParticleCollision(a)),
    (np.ones(1), lambda a: substep.Distance(PAIR, a)),
    (np.ones(1), lambda a: substep.Distance(PAIR, compliance=a)),
    (np.ones((1, 3)), lambda a: substep.pbd.Attachment([0], a)),
    (P, lambda a: substep.pbd.ShapeMatching(QUAD, rest_positions=a)),
]


@pytest.mark.parametrize(("given", "make"), HELD)
def test_constraints_copy_what_they_are_given(given, make):
    given = given.copy()
    constraint = make(given)
    held = [value for value in vars(constraint).values() if isinstance(value, np.ndarray)]
    before = substep.state_hash(*held)
    given[:] = -2_000_000_000
    assert substep.state_hash(*held) == before
    assert not any(value.flags.writeable for value in held)
    points(constraints=[constraint]).step(0.01)


class Spoiler:
    """Numbers that write into the array of another argument while they are read."""

    def __init__(self, numbers, other):
        self.numbers, self.other = numbers, other

    def __array__(self, dtype=None, copy=None):
        self.other[...] = math.nan if self.other.dtype.kind == "f" else 10**6
        return np.array(self.numbers, dtype or float)


def added(x, spoil):
    bodies = substep.RigidBodies()
    bodies.add(substep.Sphere(0.1), x, velocities=spoil(0 * P))
    return bodies


EDGES = np.array([[0, 1], [1, 2]])
SPOILED = [
    (EDGES, lambda e, spoil: net(edges=e, masses=spoil(np.ones(4))).edges),
    (P, lambda x, spoil: net(positions=x, masses=spoil(np.ones(4))).positions),
    (P, lambda x, spoil: jelly(positions=x, velocities=spoil(0 * P)).positions),
    (P, lambda x, spoil: fluid(positions=x, velocities=spoil(0 * P)).positions),
    (P, lambda x, spoil: points(positions=x, masses=spoil(np.ones(4))).positions),
    (P, lambda x, spoil: added(x, spoil).positions),
    (P, lambda x, spoil: substep.solve_second_order(
        lambda t, x, v: -x, (0.0, 1.0), x, spoil(0 * P), step=0.5).x),
    (np.ones(3), lambda y, spoil: substep.solve_ivp(
        lambda t, y: -y, (0.0, 1.0), y, t_eval=spoil([0.0, 1.0])).y),
]  # fmt: skip


@pytest.mark.parametrize(("given", "use"), SPOILED)
def test_arguments_that_are_written_while_others_are_read(given, use):
    mine = given.copy()
    got = use(mine, lambda numbers: Spoiler(numbers, mine))
    assert not np.array_equal(mine, given), "nothing was spoiled"
    assert np.array_equal(got, use(given, lambda numbers: numbers))


def test_indices_that_another_thread_writes():
    mesh = substep.geometry.grid_mesh(200, 200)
    given, done = mesh.faces.copy(), threading.Event()

    def spoil():
        while not done.is_set():
            given[-1000:] = 10**8
            given[-1000:] = mesh.faces[-1000:]

    other = threading.Thread(target=spoil)
    other.start()
    try:
        for _ in range(40):
            try:
                faces = substep.geometry.TriangleMesh(mesh.vertices, given).faces
            except InputError as error:
                assert "expected an index from 0 to 39999" in str(error)
            else:
                assert faces.max() < 200 * 200
    finally:
        done.set()
        other.join()


@KINDS
def test_what_is_handed_out_may_be_given_back(kind):
    """Also the other way round, where it is a view of what is written."""
    simulation = example(kind)()
    twin = simulation.copy()
    backwards = simulation.positions[..., ::-1, :]
    twin.set_positions(backwards.copy())
    simulation.set_positions(backwards)
    assert content(simulation) == content(twin)


# ---------------------------------------------------------------------------- ids


@KINDS
def test_no_ids_are_refused_where_ids_are_required(kind):
    simulation = example(kind)()
    with pytest.raises(InputError, match="ids"):
        simulation.rows(None)
    before = content(simulation)
    if hasattr(simulation, "remove"):
        with pytest.raises(InputError, match="ids"):
            simulation.remove(None)
    assert content(simulation) == before


def test_no_bodies_are_refused():
    bodies = balls()
    for call in (
        lambda: bodies.set_motion("static", None),
        lambda: bodies.apply_force(None, (0, 0, 1)),
        lambda: bodies.apply_impulse(None, (0, 0, 1)),
    ):
        with pytest.raises(InputError, match="ids"):
            call()
    bodies.wake(None)  # all, as it says
    with pytest.raises(IndexError, match=r"^a: there is no body -1"):
        bodies.hinge(-1, None, (0, 0, 0), (0, 0, 1))
    with pytest.raises(IndexError, match=r"^ids: there is no body 9"):
        bodies.remove(9)
    with pytest.raises(InputError, match=r"^b:"):
        bodies.fixed(0, [1, [2]], (0, 0, 0))
    batch = substep.RigidBatch(bodies, 2)
    for wrong in (None, [0, 1], [], 0.5):
        with pytest.raises(InputError, match="world"):
            batch.copy_world(wrong)
    with pytest.raises(IndexError, match=r"^world: expected a number below 2"):
        batch.copy_world(2)


@KINDS
def test_one_row_stands_alone_for_one_id_that_does(kind):
    simulation = example(kind)()
    one = int(np.ravel(simulation.ids)[-1])
    row = np.array(simulation.positions)[..., simulation.rows(one), :] + 0.001
    row = row if row.ndim == 1 else row[0]
    simulation.set_positions(row, one)
    after = content(simulation)
    simulation.set_positions(row[None], [one])
    assert content(simulation) == after
    if kind is not substep.RigidBodies:  # there one row is for all
        with pytest.raises(InputError, match="values"):
            simulation.set_positions(row, [one])


# ---------------------------------------------------------------------------- numbers


@pytest.mark.parametrize("make", [fluid, jelly, points])
def test_numbers_beyond_float32_are_refused(make):
    far, name = np.where(P == 0, 0, 1e39), "beyond float32"
    for argument in ("positions", "velocities"):
        with pytest.raises(InputError, match=f"{argument}.*{name}"):
            make(**{argument: far})
    simulation = make()
    for setter in ("positions", "velocities"):
        with pytest.raises(InputError, match=f"values.*{name}"):
            getattr(simulation, f"set_{setter}")([[0, 1e39, 0]], ids=[0])
    if make is not points:
        more = [1e-4] if make is jelly else []
        with pytest.raises(InputError, match=f"velocities.*{name}"):
            simulation.add(P[:1], *more, velocities=[[0, 1e39, 0]])
    make(dtype="float64").set_velocities([[0, 1e39, 0]], ids=[0])


@KINDS
def test_threads_are_1_to_1024(kind):
    simulation = example(kind)()
    for wrong in (0, 1025, 2**31, 10**20):
        with pytest.raises(InputError, match="threads: expected an integer from 1 to 1024"):
            simulation.threads = wrong


@pytest.mark.parametrize("dt", [1e-320, 1e-30, 1e30, 1e300])
@KINDS
def test_steps_of_any_size_end_well(kind, dt):
    simulation = example(kind)()
    before = content(simulation)
    try:
        simulation.step(dt)
    except substep.SubstepError:
        assert content(simulation) == before
    arrays = [value for value in simulation.state().values() if isinstance(value, np.ndarray)]
    assert not any(np.isnan(array).any() for array in arrays)


PARTS = {"p": substep.Part()}
VIEW = memoryview(P)  # no list, although it can be iterated over in one dimension
SHEET = substep.geometry.box_mesh()
CUBE = substep.geometry.box_tetrahedra((1, 1, 1), (1, 1, 1))
SOFT = {"density": 1000.0, "young_modulus": 1e4, "poisson_ratio": 0.3}
ROTATION = [[1.0, 0, 0, 0]]
REFUSED = [
    (lambda: fluid(min_iterations=2**31), InputError, "min_iterations"),
    (lambda: fluid(max_iterations=2**31), InputError, "max_iterations"),
    (lambda: net(max_iterations=2**31), InputError, "max_iterations"),
    (lambda: fluid(spacing=1e300), InputError, "spacing"),
    (lambda: jelly(cell=1e300), InputError, "cell"),
    (lambda: fluid(density=[]), InputError, "density"),
    (lambda: fluid(one_sided="no"), TypeError, "one_sided"),
    (lambda: net(masses=[1, [2]]), InputError, "masses"),
    (lambda: net(stiffness=[1, [2]]), InputError, "stiffness"),
    (lambda: net(edges=[1, [2]]), InputError, "edges"),
    (lambda: net(pinned=[1, [2]]), InputError, "pinned"),
    (lambda: fluid(density=[1, [2]]), InputError, "density"),
    (lambda: fluid(kinds=[1, [2]]), InputError, "kinds"),
    (lambda: substep.Distance([1, [2]]), InputError, "pairs"),
    (lambda: substep.Distance(PAIR, [1, [2]]), InputError, "rest_lengths"),
    (lambda: points(colliders=5), TypeError, "colliders: expected a list of Collider or shapes"),
    (lambda: points(colliders=substep.Capsule(1, 1)), TypeError, r"colliders: .* got Capsule\("),
    (lambda: points(constraints=None), TypeError, "constraints: expected a list"),
    (lambda: fluid(emitters=5), TypeError, "emitters: expected a list of Emitter"),
    (lambda: fluid(sinks=5), TypeError, "sinks: expected a list of Sink"),
    (lambda: jelly(materials=5), TypeError, "materials: expected a list of Material"),
    (lambda: jelly(boundary=5), TypeError, "boundary: expected a list"),
    (lambda: substep.geometry.grid_mesh(10**20, 3), InputError, "n: expected an integer from 2"),
    (lambda: substep.geometry.box_tetrahedra((1, 1, 1), 5), TypeError, "divisions: expected a"),
    (lambda: substep.RigidBatch(balls(), 1).reset(to=5), TypeError, "to: expected a list"),
    (lambda: substep.RigidBatch(balls(), 1).reset([0, [1]]), InputError, "worlds"),
    (lambda: substep.RigidBatch(balls(), 1).step(hold_forces="no"), TypeError, "hold_forces"),
    (lambda: substep.RigidBatch(balls(), 1).rollout(1, velocities="no"), TypeError, "velocities"),
    (lambda: substep.RigidBatch(balls(), 1).rollout(2**60), MemoryError, "steps"),
    (lambda: points().step(np.array(True)), TypeError, "dt"),
    (lambda: points().step(np.array("5")), TypeError, "dt"),
    (lambda: points().step(bytearray(b"5")), TypeError, "dt"),
    (lambda: setattr(points(), "step_size", None), TypeError, "step_size"),
    (lambda: points().advance(np.ma.masked_all(())), InputError, "duration: .* masked"),
    (lambda: substep.RigidBatch(balls(), 1).advance(1e308), InputError, "duration: 1e.308 s"),
    (lambda: substep.Sphere(1.0).mesh(2**62), InputError, "segments"),
    (lambda: substep.geometry.tetrahedralize(np.eye(3), 1.0), TypeError, "mesh: expected a Tri"),
    (lambda: substep.MassSpring.from_mesh("x", density=1, stiffness=1), TypeError, "mesh"),
    (lambda: substep.SignedDistanceField.from_mesh([], 1.0), TypeError, "mesh"),
    (lambda: substep.SignedDistanceField.from_mesh(SHEET, 1e-5), InputError, "spacing: .* 1e8"),
    (lambda: substep.geometry.tetrahedralize(SHEET, 1e-5), InputError, "spacing: .* more than 2e7"),
    (
        lambda: substep.GridField(([0, 2, 1], [0, 1]), np.ones((3, 2, 2))),
        InputError,
        r"axes\[0\]: .* got \[0\. 2\. 1\.\]",
    ),
    (lambda: substep.linalg.LU(np.eye(2)).solve([1, 2], transpose=[1, 1]), TypeError, "transpose"),
    (lambda: substep.pack("nothing", overwrite=np.ones(2)), TypeError, "overwrite"),
    (lambda: substep.systems.Kepler().energy(np.ones(3)), InputError, r"y: .* \(4,\) or \(4, m\)"),
    (lambda: substep.systems.NBody([1, 2]).energy(7.0), InputError, "y"),
    (lambda: substep.solve_ivp(abs, (0, 1), [], dense_output=True).sol("x"), TypeError, "t: "),
    (lambda: substep.systems.VanDerPol(1.0, [1, 2]), TypeError, "scaled"),
    (lambda: substep.pbd.rope(2**64), InputError, "count"),
    (lambda: substep.DoubleGyre().stream_function(math.inf, [[0, 0]]), InputError, "t: "),
    (
        lambda: substep.Recorder("x", parts={"p": substep.Part()}, overwrite=[1]),
        TypeError,
        "overwrite",
    ),
    (lambda: substep.RK45(abs, 0.0, 1.0, 1.0), InputError, "`y0`"),
    (lambda: substep.RK45(abs, 0.0, [[1.0], 2], 1.0), InputError, "y0"),
    (lambda: substep.RK45(abs, 0.0, [1.0], [1.0, 2.0]), TypeError, "t_bound"),
    (lambda: substep.RK45(abs, 0.0, [1.0], 1.0, atol=-1.0), InputError, "atol"),
    (lambda: substep.RK45(abs, 0.0, [1.0], 1.0, rtol=[0.0]), InputError, "rtol"),
    (lambda: substep.RK45(abs, 0.0, [10**400], 1.0), TypeError, "y0"),
    (lambda: substep.Radau(abs, 0.0, [1.0], 1.0, step=VIEW), TypeError, "step"),
    (lambda: substep.Heun(abs, 0.0, [1.0], 1.0, step="x"), TypeError, "step"),
    (lambda: substep.Heun(abs, 0.0, [1.0], 1.0, first_step=10**400), InputError, "first_step"),
    (lambda: substep.Heun(abs, 0.0, [1.0], 1.0, vectorized=P), TypeError, "vectorized"),
    (lambda: solve(step=0.1, max_step=P), TypeError, "max_step"),
    (lambda: solve(dense_output=P), TypeError, "dense_output"),
    (lambda: solve(vectorized=P), TypeError, "vectorized"),
    (lambda: solve(check_jacobian=P), TypeError, "check_jacobian"),
    (lambda: solve(events=VIEW), TypeError, "events"),
    (lambda: solve(args=VIEW), TypeError, "args"),
    (lambda: solve(method="Radau", mass=[1, [2]]), InputError, "mass"),
    (lambda: substep.solve_ensemble(VIEW, (0, 1), P), TypeError, "fun"),
    (lambda: substep.systems.SpringChain(3, fixed_ends=P), TypeError, "fixed_ends"),
    (lambda: substep.springs.grid_springs(3, 3, stiffness=[1, 2]), TypeError, "stiffness"),
    (lambda: substep.springs.grid_springs(3, 3, shear=P), TypeError, "shear"),
    (lambda: substep.springs.grid_springs(2**63, 3), InputError, "n"),
    (lambda: substep.pbd.rope(3, closed=P), TypeError, "closed"),
    (lambda: substep.pbd.rope(3, first=2**64), InputError, "first"),
    (lambda: substep.pbd.cloth(SHEET, compliance=[1, 2]), TypeError, "compliance"),
    (lambda: substep.pbd.soft_body(CUBE, compliance=P), TypeError, "compliance"),
    (lambda: substep.pbd.tethers(P, EDGES, [1, [2]]), InputError, "pins"),
    (lambda: substep.pbd.ShapeMatching(VIEW), TypeError, "clusters"),
    (lambda: substep.pbd.ShapeMatching(QUAD).evaluate(P), InputError, "evaluate"),
    (lambda: substep.pbd.ParticleCollision(0.1).evaluate(P), InputError, "evaluate"),
    (lambda: substep.rigid.compound(VIEW), TypeError, "parts"),
    (lambda: fluid(colliders=VIEW), TypeError, "colliders"),
    (lambda: points(dtype="\ud800"), InputError, "dtype"),
    (lambda: substep.GridField(VIEW, P), TypeError, "axes"),
    (lambda: substep.SoftBody.from_mesh(VIEW, **SOFT), TypeError, "mesh"),
    (lambda: substep.Part("mesh", tetrahedra=[[1, 2], [1]]), InputError, "tetrahedra"),
    (lambda: substep.Recorder("x", parts=PARTS, fsync=P), TypeError, "fsync"),
    (lambda: substep.open_field("\0"), InputError, "path"),
    (lambda: substep.geometry.read_mesh("\ud800"), InputError, "path"),
]


def solve(method="rk4", **options):
    return substep.solve_ivp(lambda t, y: -y, (0, 1), [1.0], method, **options)


@pytest.mark.parametrize(("call", "error", "message"), REFUSED)
def test_what_is_wrong_is_refused_by_name(call, error, message):
    with pytest.raises(error, match=f"^{message}"):
        call()


HUGE, TINY = np.where(P == 1, 1e308, 0.0), 1e-320
NOZZLE = substep.Emitter((0, 0, 0), (0, 0, 1), 1.0, radius=1.0)
OVERFLOWING = [
    (lambda: net(positions=HUGE), "positions"),
    (lambda: net(masses=1e308), "masses"),
    (lambda: points(positions=HUGE, dtype="f8", constraints=[substep.Distance(PAIR)]), "positions"),
    (lambda: substep.SoftBody(HUGE, QUAD, **SOFT), "positions"),
    (lambda: substep.geometry.TetMesh(HUGE, QUAD), "vertices"),
    (lambda: substep.geometry.TriangleMesh(HUGE, TRIPLE), "vertices"),
    (lambda: substep.Distance(PAIR).evaluate(HUGE), "positions"),
    (lambda: substep.pbd.NeoHookean(QUAD, 1.0, 0.3).evaluate(P * [TINY, 1, 1]), "positions"),
    (lambda: substep.pbd.TriangleArea(TRIPLE).evaluate(1e-200 * HUGE), "positions"),
    (lambda: substep.pbd.tethers(P, EDGES, [0], slack=1e308), "slack"),
    (lambda: substep.relax(P, 1.0, gravity=HUGE[1]), "gravity"),
    (lambda: substep.Emitter((0, 0, 0), (0, 0, 1), 1.0, radius=1e308), "radius"),
    (lambda: fluid(emitters=[NOZZLE], spacing=1e-5), "emitters"),
    (lambda: jelly(emitters=[NOZZLE], emitter_spacing=1e308), "emitter_spacing"),
    (lambda: balls().distance(0, None, HUGE[1], (0, 0, 0)), "point_a, point_b"),
    (lambda: substep.rigid.free_rotation(ROTATION, P[:1], np.full((1, 3), 1e308), 1.0), "inertia"),
    (lambda: substep.DoubleGyre().stream_function(0.0, HUGE[:, 1:]), "x"),
    (lambda: substep.DoubleGyre(omega=1e308).stream_function(1e308, P[:, 1:]), "t"),
    (lambda: substep.TaylorGreen(viscosity=1.0).stream_function(-1e308, P[:, 1:]), "t"),
    (lambda: substep.fill_box((0, 0, 0), (1, 1, 1), TINY), "low, high, spacing"),
    (lambda: substep.fill_mesh(SHEET, TINY), "spacing"),
    (lambda: substep.mpm.sample_box((0, 0, 0), (1, 1, 1), TINY), "low, high, spacing"),
    (lambda: substep.mpm.sample_sphere((0, 0, 1e308), 1e308, 1.0), "center, radius"),
    (lambda: substep.mpm.sample_mesh(SHEET, TINY), "spacing"),
    (lambda: substep.geometry.tetrahedralize(SHEET, TINY), "spacing"),
    (lambda: substep.SignedDistanceField.from_mesh(SHEET, TINY), "spacing"),
    (lambda: substep.stability.amplification("rk4", 1e308), "z"),
    (lambda: substep.stability.amplification_matrix("velocity_verlet", 1e308), "h_omega"),
    (lambda: substep.stability.region("rk4", (-1e308, 1, -1, 1), 5), "bounds"),
    (lambda: substep.stability.stability_limit("velocity_verlet", 1e308), "damping_ratio"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "message"), OVERFLOWING)
def test_what_overflows_is_refused_by_name(call, message):
    """By an error: a warning is none."""
    with pytest.raises(InputError, match=f"^{message}"):
        call()


@KINDS
def test_no_ids_are_no_numbers(kind):
    """Of whatever dtype nothing is."""
    simulation = example(kind)()
    for nothing in ([], np.zeros(0, complex), np.zeros(0, "S1")):
        assert simulation.rows(nothing).shape == (0,)


def test_directions_have_any_length():
    for size in (1e308, 1e-320):
        emitter = substep.Emitter((0, 0, 0), (size, size, 0), 1.0, radius=1.0)
        assert emitter.direction == pytest.approx([0.5**0.5, 0.5**0.5, 0])
    bodies = balls()
    bodies.add(substep.Plane(), (0, 0, -1), motion="static")
    assert bodies.ray_cast([[0, 0, 5.0]], [[1e308, 0, -1]]).bodies.tolist() == [-1]


@pytest.mark.parametrize("make", [points, net])
def test_energies_that_overflow_are_infinite(make):
    simulation = make(**({"dtype": "float64"} if make is points else {}))
    simulation.set_velocities(HUGE)
    assert simulation.diagnostics()["energy"] == math.inf


def test_fields_that_overflow_give_no_nan():
    with pytest.raises(substep.NonFiniteError, match=r"velocity\(t, x\)\[1, 0\] = nan"):
        substep.DoubleGyre()(0.0, HUGE[:, :2])


def test_systems_overflow_quietly():
    """As their right-hand sides do."""
    systems = substep.systems
    far = [1e308, 0.0, 0.0, 1.0]
    assert systems.Kepler().energy(far) == 0.5
    assert systems.Kepler().energy([0.0, 0.0, 0.0, 1.0]) == -math.inf
    assert systems.NBody([1, 2], dimension=2).energy(np.repeat(far[::-1], 2)) == math.inf
    assert systems.Oscillators([1.0, 1.0]).energy(far) == math.inf
    assert systems.SpringChain(2).energy(far) == math.inf
    assert not np.isfinite(systems.HenonHeiles().energy(far))
    assert not np.isfinite(
        systems.Robertson().jacobian_product(0.0, far[:3], [math.inf, 0, 1])
    ).all()


@pytest.mark.parametrize("name", ["force", "impulse"])
def test_pushes_add_up_within_bounds(name):
    simulation = balls()
    push = getattr(simulation, f"apply_{name}")
    push(0, (2e153, 0, 0))
    before = content(simulation)
    for ids, given, point in (
        (0, (1e306, 0, 0), None),
        (0, (2e153, 0, 0), None),
        ([1, 1], (2e153, 0, 0), None),
        (1, (1e100, 0, 0), (0, 1e100, 0)),
    ):
        with pytest.raises(InputError, match=f"{name}: expected numbers of a size"):
            push(ids, given, point)
        assert content(simulation) == before
    simulation.restore(simulation.state())


@pytest.mark.parametrize("batch", [False, True])
def test_bodies_have_bounds(batch):
    """What is set can be squared: kept, restored and stepped."""

    def world():
        return substep.RigidBatch(balls(), 2) if batch else balls()

    for name in ("positions", "velocities", "angular_velocities", "forces", "torques"):
        simulation = world()
        before = content(simulation)
        for wrong in (1e308, 1e155):
            with pytest.raises(InputError, match="values"):
                getattr(simulation, f"set_{name}")(np.where(P, wrong, 0))
        assert content(simulation) == before
        getattr(simulation, f"set_{name}")(np.where(P, 1e150, 0))
        simulation.restore(simulation.state())
    simulation = world()
    for name in ("positions", "velocities", "angular_velocities", "forces", "torques"):
        getattr(simulation, f"set_{name}")(np.where(P == 1, 7e152, 0))  # all of them together
    simulation.restore(simulation.state())
    with pytest.raises(InputError, match="velocities"):
        if batch:
            substep.RigidBatch(balls(), 2, velocities=HUGE)
        else:
            substep.RigidBodies().add(substep.Sphere(0.1), P, velocities=HUGE)


@pytest.mark.parametrize("make", [fluid, jelly, points, net])
def test_a_collider_stands_once_in_a_list(make):
    ground = substep.Collider(substep.Plane(point=(0, 0, -1)))
    with pytest.raises(InputError, match=r"colliders\[1\]"):
        make(colliders=[ground, ground])
    make(colliders=[ground.shape, ground.shape])


@pytest.mark.parametrize("motion", ["dynamic", "kinematic", "static"])
def test_sampled_distances_are_no_bodies(motion):
    field = substep.SignedDistanceField(np.ones((4, 4, 4)), 0.1)
    with pytest.raises(InputError, match="cannot be a rigid body"):
        substep.RigidBodies().add(field, (0, 0, 0), motion=motion)


# ---------------------------------------------------------------------------- states


def test_pins_are_part_of_a_state():
    simulation = net(pinned=[0])
    before = simulation.state()
    simulation.pinned = [1, 2]
    simulation.restore(before)
    assert simulation.pinned.tolist() == [True, False, False, False]


@KINDS
def test_states_hold_what_can_be(kind):
    simulation = example(kind)()
    good = simulation.state()
    for name in {"next_id", "next_joint", "steps"} & set(good):
        for wrong in (2**63 - 1, 2**70, 10**400):
            with pytest.raises(InputError, match=name):
                simulation.restore(good | {name: wrong})
    rows = good.get("colliders", np.zeros((0, 0)))
    wrong_columns = ((13, -1, "friction"), (14, 7, "restitution"), (3, 0, "rotation"))
    for column, number, word in (*wrong_columns, (8, 1e200, "within"), (0, -1e200, "within")):
        if len(rows):
            wrong = rows.copy()
            wrong[0, column] = number
            with pytest.raises(InputError, match=word):
                simulation.restore(good | {"colliders": wrong})
    if "rotations" in good:
        wrong = good["rotations"].copy()
        wrong[0] = (0.5, 0, 0, 0)
        with pytest.raises(InputError, match=r"rotations.*length 1, got 0\.5"):
            simulation.restore(good | {"rotations": wrong})
    assert math.isfinite(simulation.time)


# ---------------------------------------------------------------------------- files


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(tmp_path):
    path, simulation = tmp_path / "a", points()
    simulation.save(path)
    before = path.read_bytes()
    simulation.step()
    kept, limits = content(simulation), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200, limits[1]))  # as a full disk
    try:
        with pytest.raises(OSError):
            simulation.save(path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert os.listdir(tmp_path) == ["a"] and path.read_bytes() == before
    assert content(simulation) == kept
    simulation.save(tmp_path / "b")
    assert (tmp_path / "b").stat().st_size > 200
    with pytest.raises(FileNotFoundError, match="nowhere'"):
        simulation.save(tmp_path / "nowhere" / "c")


def test_checkpoints_replace_files_alone(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path):  # a device, such as /dev/null, would be gone
        with pytest.raises(OSError, match="to replace"):
            points().save(path)
    assert os.listdir(tmp_path) == ["pipe"] and (tmp_path / "pipe").is_fifo()


def test_a_path_that_ends_in_a_slash_replaces_no_file(tmp_path):
    (tmp_path / "file").write_text("of the user")
    (tmp_path / "folder").mkdir()
    recording = recorded(tmp_path / "run")
    logger = substep.Logger({"when": lambda s: s.time})
    logger(points())
    for name in ("file/", "folder/"):
        path = f"{tmp_path}/{name}"
        for write in (
            points().save,
            logger.to_csv,
            logger.plot,
            recording.to_html,
            lambda out: substep.export.save(recording.path, out),
            lambda out: substep.export.pack(recording.path, out),
            lambda out: substep.render.save_picture(recording.path, out),
            lambda out: substep.Recorder(out, parts={"p": substep.Part()}),
        ):
            with pytest.raises(InputError, match=": expected the name of a file, got a folder"):
                write(path)
    recording.close()
    assert (tmp_path / "file").read_text() == "of the user"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "folder", "run"]


def recorded(path):
    with substep.Recorder(path, parts={"p": substep.Part()}) as recorder:
        recorder.append(0.0, {"p": {"points": np.zeros((1, 3))}})
    return substep.Recording(path)


def test_pipes_are_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for read in (substep.Recording, points().load):
        with pytest.raises(substep.FormatError, match="pipe: expected a file, got a pipe"):
            read(tmp_path / "pipe")


@pytest.mark.parametrize("path", ["", "a\0b", 3, None])
def test_paths_of_checkpoints_are_names(path):
    simulation = points()
    for use in (simulation.save, simulation.load):
        with pytest.raises((InputError, TypeError), match="path"):
            use(path)
