"""Wrong input to mass-spring systems: named, refused, nothing changed."""

import pickle

import numpy as np
import pytest
import substep

X = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]
EDGES = [[0, 1], [1, 2]]


def net(**changes):
    arguments = {"positions": X, "edges": EDGES, "stiffness": 10.0, "masses": 1.0, **changes}
    return substep.MassSpring(
        arguments.pop("positions"),
        arguments.pop("edges"),
        arguments.pop("stiffness"),
        arguments.pop("masses"),
        **arguments,
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"positions": [[0, 0], [1, 1]]}, r"\(n, 3\), got \(2, 2\); of two dimensions give z = 0"),
        ({"positions": [[0, 0, np.nan]] * 3}, r"positions\[0, 2\]"),
        ({"edges": [[0, 3]]}, r"edges\[0, 1\]: expected an index from 0 to 2, got 3"),
        ({"edges": [[0, -1]]}, "got -1"),
        ({"edges": [[0, 2**40]]}, "expected an index"),
        ({"edges": [[0, 1], [1, 1]]}, r"edges\[1\]: expected different indices"),
        ({"edges": [[0.0, 1.0]]}, "edges: expected integers"),
        ({"edges": [[0, 1, 2]]}, "edges: expected"),
        ({"stiffness": -1.0}, r"stiffness\[0\]: expected a number at least 0"),
        ({"stiffness": [1.0, np.nan]}, r"stiffness\[1\]"),
        ({"stiffness": [1.0]}, "stiffness: expected shape"),
        ({"rest_lengths": [1.0, -1.0]}, r"rest_lengths\[1\]"),
        ({"rest_lengths": [1.0, np.inf]}, r"rest_lengths\[1\]"),
        ({"damping": -0.1}, r"damping\[0\]"),
        ({"masses": 0.0}, r"masses\[0\]: expected a number above 0"),
        ({"masses": [1.0, 1.0, -1.0]}, r"masses\[2\]"),
        ({"masses": [1.0, np.nan, 1.0]}, r"masses\[1\]"),
        ({"pinned": [3]}, r"pinned\[0\]: expected an index from 0 to 2, got 3"),
        ({"pinned": [-1]}, "got -1"),
        ({"pinned": [0.5]}, "pinned: expected indices"),
        ({"pinned": [True, False]}, "pinned: expected shape"),
        ({"drag": -1.0}, "drag"),
        ({"gravity": (0, 0)}, "gravity: expected shape"),
        ({"gravity": (0, 0, np.inf)}, "gravity"),
        ({"integrator": "leapfrog"}, r"integrator: expected .* euler \(or explicit_euler"),
        ({"solver": "magic"}, "solver: expected one of"),
        ({"step": 0.0}, "step: expected a number above 0"),
        ({"tolerance": -1.0}, "tolerance"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"max_iterations": 1.5}, "max_iterations"),
        ({"on_fail": "ignore"}, "on_fail: expected one of"),
        ({"contact_margin": 0.0}, "contact_margin"),
        ({"contact_stiffness": np.nan}, "contact_stiffness"),
        ({"sticking_speed": -1e-3}, "sticking_speed"),
        ({"velocities": [[0, 0, 0]]}, "velocities: expected shape"),
        ({"time": np.nan}, "time"),
        ({"threads": 0}, "threads"),
        ({"faces": [[0, 1, 7]]}, r"faces\[0, 2\]"),
    ],
)
def test_refused_by_name(changes, message):
    with pytest.raises(substep.InputError, match=message):
        net(**changes)


def test_refused_types():
    with pytest.raises(TypeError, match=r"colliders\[0\]: expected a Collider"):
        net(colliders=["floor"])
    with pytest.raises(TypeError, match="positions"):
        net(positions=np.zeros((3, 3), complex))
    with pytest.raises(TypeError, match="unexpected keyword"):
        net(dampign=1.0)


@pytest.mark.parametrize("dt", [0.0, -0.01, np.nan, np.inf])
def test_wrong_steps_change_nothing(dt):
    body = net()
    before = body.positions.copy()
    with pytest.raises(substep.InputError, match="dt"):
        body.step(dt)
    assert (body.positions == before).all()
    assert body.time == 0.0


@pytest.mark.parametrize(
    "integrator",
    ["implicit_euler", "velocity_verlet", "rk4", "symplectic_euler", "euler"],
)
@pytest.mark.parametrize("view", ["positions", "velocities", "forces", "targets"])
def test_nan_written_through_a_view_is_found(integrator, view):
    floor = substep.Collider(substep.Plane(point=(0, 0, -0.1)), velocity=(0, 0, 0.01))
    body = net(integrator=integrator, pinned=[2], colliders=[floor], step=0.01)
    body.step()
    getattr(body, view)[2 if view == "targets" else 1, 1] = np.nan
    arrays = ("positions", "velocities", "forces", "targets")
    before = [getattr(body, name).copy() for name in arrays]
    where, impulse, time = floor.position.copy(), floor.impulse.copy(), body.time
    with pytest.raises(substep.NonFiniteError) as caught:
        body.step()
    assert caught.value.time == time == body.time
    assert caught.value.index in (0, 1, 2)
    for name, values in zip(arrays, before, strict=True):
        assert np.array_equal(getattr(body, name), values, equal_nan=True)
    assert (floor.position == where).all()
    assert (floor.impulse == impulse).all()
    good = net(integrator=integrator, pinned=[2], step=0.01)
    if view != "targets":
        getattr(body, view)[1] = getattr(good, view)[1]
    else:
        body.targets[2] = X[2]
    body.step()
    assert np.isfinite(body.positions).all()


def test_degenerate_springs_pull_nowhere():
    body = net(positions=[[0, 0, 0], [0, 0, 0], [1, 0, 0]], rest_lengths=[0.5, 1.0])
    body.advance(0.1)
    assert np.isfinite(body.positions).all()
    assert body.info.degenerate.tolist() == [0]
    assert net().info.degenerate.size == 0
    short = net(rest_lengths=[0.0, 0.0], gravity=(0, 0, 0), drag=5.0, tolerance=1e-8)
    short.advance(5.0)
    assert np.ptp(short.positions, axis=0).max() < 1e-3


def test_a_vertex_pinned_twice_is_pinned():
    body = net(pinned=[0, 2, 0])
    assert body.pinned.tolist() == [True, False, True]
    body.advance(0.1)
    assert body.positions[[0, 2]].tolist() == [X[0], X[2]]


@pytest.mark.parametrize("stiffness", [0.0, 1e-300, 1e300])
def test_extreme_stiffness_gives_finite_positions_or_an_error(stiffness):
    body = net(stiffness=stiffness, pinned=[0])
    try:
        body.advance(0.1)
    except substep.SolverError:
        pass
    assert np.isfinite(body.positions).all()


def test_empty_single_disconnected_and_all_pinned_are_legal():
    none = np.zeros((0, 2), int)
    empty = substep.MassSpring(np.zeros((0, 3)), none, 1.0, 1.0)
    empty.advance(0.1)
    assert empty.positions.shape == (0, 3)
    one = substep.MassSpring([[0, 0, 0]], none, 1.0, 1.0)
    one.advance(1.0)
    assert one.velocities[0, 2] == pytest.approx(-9.81)
    held = net(pinned=[0, 1, 2])
    held.advance(1.0)
    assert (held.positions == X).all()


def test_no_convergence_says_what_it_saw_and_changes_nothing():
    options = {"positions": np.multiply(X, 3.0), "rest_lengths": [1.0, 1.0], "stiffness": 1e7}
    body = net(max_iterations=1, on_fail="raise", **options)
    before = substep.state_hash(*(v for v in body.state().values() if isinstance(v, np.ndarray)))
    with pytest.raises(substep.ConvergenceError, match="smaller step") as caught:
        body.step(0.1)
    assert len(caught.value.residuals) == 2
    assert caught.value.time == 0.0
    after = substep.state_hash(*(v for v in body.state().values() if isinstance(v, np.ndarray)))
    assert before == after
    retried = net(max_iterations=4, **options)
    retried.step(0.1)
    assert retried.report.subdivided > 0
    assert retried.time == pytest.approx(0.1)


def test_a_vertex_without_a_place_between_obstacles_is_named():
    ball = substep.Collider(substep.Sphere(0.3, (5, 0, 0)))
    shell = substep.Collider(substep.Sphere(0.25, (1, 0, 0)), hollow=True)
    simulation = substep.MassSpring([[1, 0, 0]], [], 0.0, 1.0, colliders=[ball, shell])
    simulation.step()
    ball.position = shell.position
    before = simulation.state()
    with pytest.raises(substep.SolverError, match="vertex 0 has no place") as caught:
        simulation.step()
    assert caught.value.index == 0 and caught.value.time == simulation.time
    after = simulation.state()
    assert all(np.array_equal(after[name], before[name]) for name in before)
    ball.position = (3, 0, 0)
    simulation.step()


def test_a_body_inside_an_obstacle_can_be_copied_and_restored(tmp_path):
    ball = substep.Collider(substep.Sphere(0.1, (5, 0, 0)))
    body = net(integrator="implicit_euler", colliders=[ball])
    body.positions[2] = (5, 0, 0)
    body.save(tmp_path / "inside")
    twin = body.copy()
    twin.load(tmp_path / "inside")
    put = body.positions.copy()
    for one in (twin, pickle.loads(pickle.dumps(body)), body):
        assert np.array_equal(one.positions, put)
        one.step()
        assert one.colliders[0].distance(one.positions).min() > 0
    assert np.array_equal(twin.positions, body.positions)


def test_states_that_do_not_fit():
    body = net()
    state = body.state()
    with pytest.raises(substep.InputError, match="velocities missing"):
        body.restore({k: v for k, v in state.items() if k != "velocities"})
    with pytest.raises(substep.InputError, match="positions"):
        body.restore({**state, "positions": np.zeros((2, 3))})
    assert (body.positions == X).all()


@pytest.mark.parametrize("name", ["positions", "velocities", "forces", "targets"])
@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_states_that_are_given_are_finite(name, value, tmp_path):
    """Copies have what views wrote, so that what has failed can be looked at."""
    body = net()
    body.advance(0.1)
    before, spoiled = body.state(), body.copy()
    getattr(spoiled, name)[1, 2] = value
    told = rf"state\['{name}'\]\[1, 2\]: expected finite numbers"
    spoiled.save(tmp_path / "saved")
    with pytest.raises(substep.InputError, match=told):
        body.restore(spoiled.state())
    with pytest.raises(substep.CorruptError, match=told):
        body.load(tmp_path / "saved")
    after = body.state()
    assert all(np.array_equal(after[key], before[key]) for key in before)
    for twin in (spoiled.copy(), pickle.loads(pickle.dumps(spoiled))):
        assert np.array_equal(getattr(twin, name)[1, 2], value, equal_nan=True)
    world, other = substep.World({"net": body.copy()}), substep.World({"net": spoiled.copy()})
    with pytest.raises(substep.InputError, match=told.replace(name, f"net.{name}")):
        world.restore(other.copy().state())
    batch, spoiled_batch = substep.Batch(body, 2), substep.Batch([body, spoiled])
    with pytest.raises(substep.InputError, match=f"world 1: {told}"):
        batch.restore(spoiled_batch.copy().state())


def test_checkpoint_of_another_body(tmp_path):
    net().save(tmp_path / "net")
    other = substep.MassSpring([[0, 0, 0]], np.zeros((0, 2), int), 1.0, 1.0)
    with pytest.raises(substep.CorruptError, match="does not fit"):
        other.load(tmp_path / "net")


def test_meshes_with_every_fault_make_a_cloth():
    # Five triangles on one edge, one of them twice, one flipped, one flat.
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, -1], [2, 0, 0]]
    faces = [[0, 1, 2], [0, 1, 3], [1, 0, 4], [0, 1, 5], [0, 1, 2], [0, 1, 6]]
    mesh = substep.geometry.TriangleMesh(vertices, faces)
    cloth = substep.MassSpring.from_mesh(mesh, density=1.0, stiffness=100.0, pinned=[0])
    cloth.advance(0.2)
    assert np.isfinite(cloth.positions).all()
    with pytest.raises(substep.InputError, match="density"):
        substep.MassSpring.from_mesh(mesh, density=-1.0, stiffness=100.0)
    with pytest.raises(substep.InputError, match="bending"):
        substep.MassSpring.from_mesh(mesh, density=1.0, stiffness=100.0, bending=np.nan)


def test_one_body_is_not_stepped_by_two_threads():
    import threading

    mesh = substep.geometry.grid_mesh(20, 20)
    body = substep.MassSpring.from_mesh(mesh, density=0.3, stiffness=1e3, pinned=[0])
    refused = []

    def run():
        try:
            body.advance(0.2)
        except substep.InputError as error:
            refused.append(error)

    threads = [threading.Thread(target=run) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(refused) >= 1
    assert all("in use by another thread" in str(error) for error in refused)
