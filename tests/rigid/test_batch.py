"""Batches of worlds: the same bits as single worlds, errors that name the world, states."""

import threading
import time

import numpy as np
import pytest
import substep
from substep import rigid
from substep.errors import CorruptError, InputError, NonFiniteError

H = 1 / 60
ROWS = ("centers_of_mass", "principal_rotations", "momenta", "angular_momenta")


def pile(boxes=4, **options):
    world = substep.RigidBodies(**options)
    world.add(rigid.Plane(), (0, 0, 0), motion="static")
    for k in range(boxes):
        world.add(
            rigid.Box((1, 0.8, 0.6)), (0.05 * k, 0, 0.35 + 0.7 * k), restitution=0.1, mass=2.0
        )
    return world


def thrown(worlds, bodies, seed=3):
    v = np.random.default_rng(seed).normal(size=(worlds, bodies, 3))
    v[:, 0] = 0  # the ground
    return v


def singles(worlds, steps, **options):
    """Each world of the batch below, stepped alone."""
    alone = []
    for v in thrown(worlds, 5):
        world = pile(**options)
        world.set_velocities(v)
        world.set_angular_velocities(v)
        for _ in range(steps):
            world.step(H)
        alone.append(world)
    return alone


def batch_of(worlds, threads=None, **options):
    v = thrown(worlds, 5)
    return substep.RigidBatch(
        pile(**options), worlds, velocities=v, angular_velocities=v, threads=threads
    )


def same(batch, other):
    return all(np.array_equal(getattr(batch, name), getattr(other, name)) for name in ROWS)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_each_world_has_the_bits_of_the_same_world_alone(threads):
    alone = singles(6, 40)
    batch = batch_of(6, threads)
    batch.step(H, 40)
    for name in ROWS:
        expected = [getattr(world, name) for world in alone]
        np.testing.assert_array_equal(getattr(batch, name), expected)
    np.testing.assert_array_equal(batch.velocities, [world.velocities for world in alone])
    np.testing.assert_array_equal(batch.times, [world.time for world in alone])
    assert batch.contact_counts.min() > 0


def test_single_steps_and_many_at_once_agree():
    one, many = batch_of(3), batch_of(3)
    for _ in range(37):
        one.step(H)
    many.step(H, 37)
    assert same(one, many)
    assert one.time == many.time


@pytest.mark.parametrize("duration", [0.0, 0.3, 0.505])
def test_advance_is_that_of_a_world(duration):
    batch, world = substep.RigidBatch(pile(), 2), pile()
    batch.advance(duration)
    world.advance(duration)
    for name in ROWS:
        np.testing.assert_array_equal(getattr(batch, name)[1], getattr(world, name))
    assert batch.time == world.time == batch.times[1]


def test_worlds_of_any_contents():
    small, large = pile(1), pile(4, gravity=(0, 0, -1.62))
    batch = substep.RigidBatch([large, small, large])
    assert batch.counts.tolist() == [5, 2, 5]
    batch.step(H, 30)
    for world in (small, large):
        for _ in range(30):
            world.step(H)
    np.testing.assert_array_equal(batch.positions[1, :2], small.positions)
    np.testing.assert_array_equal(batch.positions[2], large.positions)
    assert np.isnan(batch.positions[1, 2:]).all()
    assert np.isnan(batch.velocities[1, 2:]).all()
    x = batch.positions.copy()
    x[:, 1:, 2] += 1  # NaN rows are no bodies
    batch.set_positions(x)
    np.testing.assert_allclose(batch.positions, x, atol=1e-15)
    assert len(batch.fields()["position"][0]) == 12


def test_rollout_is_what_steps_go_through():
    batch, other = batch_of(4), batch_of(4)
    frames = batch.rollout(35, every=7, velocities=True)
    assert frames.shape == (4, 5, 5, 13)
    for k in range(5):
        other.step(H, 7)
        np.testing.assert_array_equal(frames[:, k, :, :3], other.positions)
        np.testing.assert_array_equal(frames[:, k, :, 3:7], other.rotations)
        np.testing.assert_array_equal(frames[:, k, :, 7:10], other.velocities)
        np.testing.assert_array_equal(frames[:, k, :, 10:], other.angular_velocities)
    assert same(batch, other)
    assert batch.rollout(0).shape == (4, 0, 5, 7)


def free(**options):
    """A ball of 2 kg in empty space."""
    world = substep.RigidBodies(gravity=(0, 0, 0), **options)
    world.add(rigid.Sphere(0.5), (0, 0, 0), mass=2.0)
    return world


def test_forces_act_in_one_step_or_are_held():
    F = np.array([[[2.0, 0, 0]], [[0, 4.0, 0]], [[0, 0, 0]]])
    for steps, hold, acted in ((10, False, 1), (10, True, 10), (40, True, 40)):
        batch = substep.RigidBatch(free(), 3)
        batch.set_forces(F)
        batch.step(H, steps, hold_forces=hold)
        np.testing.assert_allclose(batch.momenta, acted * H * F, atol=1e-14)
        assert not batch.forces.any()
    batch = substep.RigidBatch(free(), 3)
    batch.set_forces(F)
    batch.set_torques([[0, 0, 3.0]], worlds=[1])
    batch.advance(0.31, hold_forces=True)
    np.testing.assert_allclose(batch.momenta, 0.31 * F, atol=1e-14)
    np.testing.assert_allclose(batch.angular_momenta[:, 0, 2], [0, 0.93, 0], atol=1e-14)


def test_what_is_set_in_some_worlds_and_bodies_leaves_the_others():
    batch = batch_of(3)
    before = {name: getattr(batch, name) for name in ROWS}
    batch.set_velocities([[1.0, 2, 3]], 4, worlds=[2, 0])
    batch.set_positions([[[0, 0, 9.0]], [[0, 0, 8.0]]], [4], worlds=[2, 0])
    np.testing.assert_allclose(batch.velocities[[0, 2], 4], [[1, 2, 3]] * 2)
    np.testing.assert_array_equal(batch.positions[[2, 0], 4, 2], [9, 8])
    for name in ROWS:
        now = getattr(batch, name)
        np.testing.assert_array_equal(now[1], before[name][1])
        np.testing.assert_array_equal(now[:, :4], before[name][:, :4])


def test_poses_are_those_of_the_shapes():
    world = free()
    tool = world.add(
        [rigid.Box((0.6, 0.2, 0.2)), rigid.Sphere(0.2, center=(0.4, 0.1, 0))], (0, 0, 2)
    )
    batch = substep.RigidBatch(world, 2)
    batch.set_positions([[5.0, 0, 1]], [tool], worlds=[1])
    batch.set_rotations([[1.0, 1, 0, 0]], [tool], worlds=[1])
    world.set_positions([5.0, 0, 1], tool)
    world.set_rotations([1.0, 1, 0, 0], tool)
    for name in (*ROWS, "positions", "rotations"):
        np.testing.assert_allclose(getattr(batch, name)[1], getattr(world, name), atol=1e-15)
    np.testing.assert_allclose(batch.positions[1, tool], [5, 0, 1], atol=1e-15)
    np.testing.assert_allclose(
        batch.rotations[1, tool], np.array([1, 1, 0, 0]) / 2**0.5, atol=1e-15
    )
    frames = batch.rollout(4, every=2)
    world.step(H)
    world.step(H)
    np.testing.assert_allclose(frames[1, 0, :, :3], world.positions, atol=1e-15)
    np.testing.assert_allclose(frames[1, 0, :, 3:], world.rotations, atol=1e-15)


def test_bodies_are_named_by_their_ids():
    first, other = pile(3), pile(4)
    first.remove(1)
    other.remove([0, 2])
    alike = substep.RigidBatch(first, 2)
    assert alike.ids.tolist() == [[0, 2, 3]] * 2
    assert alike.rows([3, 2]).tolist() == [2, 1] and alike.rows(3) == 2
    alike.set_forces([[1.0, 0, 0]], 3, worlds=[1])
    assert alike.forces[:, :, 0].tolist() == [[0, 0, 0], [0, 0, 1]]
    mixed = substep.RigidBatch([first, other, first])
    assert mixed.ids.tolist() == [[0, 2, 3], [1, 3, 4], [0, 2, 3]]
    mixed.set_forces(np.arange(9.0).reshape(3, 1, 3), 3)
    np.testing.assert_array_equal(mixed.forces[0, 2], [0, 1, 2])
    np.testing.assert_array_equal(mixed.forces[1, 1], [3, 4, 5])
    np.testing.assert_array_equal(mixed.forces[2, 2], [6, 7, 8])
    assert np.count_nonzero(mixed.forces) == 8
    with pytest.raises(InputError, match="ids: the worlds have these bodies in different rows"):
        mixed.rows(3)
    with pytest.raises(IndexError, match="world 1: ids: there is no body 2"):
        mixed.set_forces(np.zeros((1, 3)), 2)


def failing(worlds=20, bad=(13,), **options):
    """Where a force acts, squares are beyond the range of float64 after a few steps."""
    batch = substep.RigidBatch(free(), worlds, **options)
    F = np.zeros((worlds, 1, 3))
    for k, w in enumerate(bad):
        F[w, 0, 0] = 0.6e153 * (1 + 3 * k)
    batch.set_velocities(np.ones((worlds, 1, 3)))
    batch.set_forces(F)
    return batch


def run_to_failure(batch, steps=4000):
    with pytest.raises(NonFiniteError, match=r"world 13: .*body 0") as caught:
        batch.step(1.0, steps, hold_forces=True)
    return caught.value


@pytest.mark.parametrize("threads", [1, 2])
def test_a_failing_world_is_named_and_all_are_at_the_last_good_step(threads):
    batch = failing(threads=threads)
    error = run_to_failure(batch)
    assert error.index == 13
    assert error.step >= 4
    assert batch.time == error.step
    good = np.delete(np.arange(20), 13)
    np.testing.assert_allclose(batch.positions[good, 0], error.step)
    assert np.isfinite(batch.positions).all()
    assert (batch.times == batch.time).all()
    assert batch.failures == [""] * 20
    again = failing()
    again.step(1.0, error.step, hold_forces=True)
    assert same(batch, again)


def test_the_first_failure_counts():
    error = run_to_failure(failing(bad=(2, 13)))  # 13 has the greater force
    assert error.index == 13


def test_a_failing_step_changes_nothing():
    batch = failing()
    error = run_to_failure(batch)
    F = np.zeros((20, 1, 3))
    F[13, 0, 0] = 1e153
    batch.set_forces(F)
    before = {name: getattr(batch, name) for name in (*ROWS, "forces")}
    with pytest.raises(NonFiniteError) as caught:
        batch.step(100.0)
    assert caught.value.step == 0
    assert batch.time == error.step
    for name, rows in before.items():
        np.testing.assert_array_equal(getattr(batch, name), rows)


def test_rollout_gives_what_it_had_before_a_failure():
    batch = failing()
    with pytest.raises(NonFiniteError) as caught:
        batch.rollout(4000, every=2, dt=1.0, hold_forces=True)
    frames = caught.value.result
    assert frames.shape == (20, caught.value.step // 2, 1, 7)
    assert np.isfinite(frames).all()
    np.testing.assert_allclose(frames[0, :, 0, 0], 2.0 + 2 * np.arange(frames.shape[1]))


def test_masked_worlds_stop_alone_until_they_are_reset():
    batch = failing(bad=(2, 13), on_fail="mask")
    frames = batch.rollout(100, every=5, dt=1.0, hold_forces=True)
    assert [w for w, reason in enumerate(batch.failures) if reason] == [2, 13]
    assert "body 0" in batch.failures[2]
    assert batch.diagnostics()["failed"] == 2
    assert batch.times[13] < batch.times[2] < 100
    assert np.delete(batch.times, [2, 13]).tolist() == [100.0] * 18
    for w in (2, 13):
        done = int(batch.times[w]) // 5
        assert np.isfinite(frames[w, :done]).all()
        assert np.isnan(frames[w, done:]).all()
    assert np.isfinite(np.delete(frames, [2, 13], axis=0)).all()
    assert batch.step_limit()[1].endswith("; 2 of 20 worlds have stopped")
    assert repr(batch).endswith("20 worlds of RigidBodies, 2 stopped)")
    stopped = batch.positions[13]
    batch.step(1.0, 3)
    np.testing.assert_array_equal(batch.positions[13], stopped)
    batch.reset([13])
    batch.set_velocities(np.ones((1, 1, 3)), worlds=[13])
    batch.step(1.0)
    np.testing.assert_allclose(batch.positions[13], 1)
    assert [w for w, reason in enumerate(batch.failures) if reason] == [2]


def test_reset_is_where_the_batch_began():
    batch = batch_of(4)
    first = batch.state()
    batch.step(H, 20)
    late = {name: getattr(batch, name) for name in ROWS}
    batch.reset([0, 3])
    for name in ROWS:
        now = getattr(batch, name)
        np.testing.assert_array_equal(now[[1, 2]], late[name][[1, 2]])
    assert batch.times.tolist()[::3] == [0, 0]
    batch.reset()
    np.testing.assert_array_equal(batch.state()["all_positions"], first["all_positions"])
    batch.step(H, 20)
    for name in ROWS:
        np.testing.assert_array_equal(getattr(batch, name), late[name])


def test_worlds_come_out_and_go_in():
    batch = batch_of(3)
    batch.step(H, 25)
    alone = batch.copy_world(1)
    np.testing.assert_array_equal(alone.positions, batch.positions[1])
    assert alone.time == batch.times[1]
    for _ in range(5):
        alone.step(H)
    batch.step(H, 5)
    np.testing.assert_array_equal(alone.momenta, batch.momenta[1])
    batch.reset([0, 2], alone)
    batch.step(H, 5)
    np.testing.assert_array_equal(batch.momenta[0], batch.momenta[1])
    np.testing.assert_array_equal(batch.momenta[2], batch.momenta[1])
    with pytest.raises(InputError, match=r"to\[0\]: expected 5 bodies, got 1"):
        batch.reset([0], free())
    with pytest.raises(InputError, match="to: expected 2"):
        batch.reset([0, 1], [alone])
    with pytest.raises(TypeError, match=r"to\[0\]"):
        batch.reset([0], [3])


def test_motors_have_targets_of_their_own():
    world = free()
    wheel = world.hinge(0, None, (0, 0, 0), (0, 0, 1), motor=rigid.SpeedMotor(0.0, strength=100.0))
    still = world.add(rigid.Sphere(0.5), (3, 0, 0))
    ball = world.ball(still, None, (3, 0, 0))
    batch = substep.RigidBatch(world, 3)
    batch.set_motor_targets(wheel, [1.0, 2.0, 3.0])
    batch.step(H, 60)
    np.testing.assert_allclose(batch.angular_velocities[:, 0, 2], [1, 2, 3], rtol=1e-6)
    assert (np.diff(batch.joint_coordinates[:, 0]) > 0.9).all()
    batch.set_motor_targets(wheel, -1.0, worlds=[0])
    batch.step(H, 60)
    np.testing.assert_allclose(batch.angular_velocities[:, 0, 2], [-1, 2, 3], rtol=1e-6)
    with pytest.raises(InputError, match="joint: expected one with a motor"):
        batch.set_motor_targets(ball, 1.0)
    with pytest.raises(InputError, match="targets: expected shape"):
        batch.set_motor_targets(wheel, [1.0, 2.0])


def test_state_is_exact_and_checked(tmp_path):
    batch = batch_of(3)
    batch.step(H, 25)
    state = batch.state()
    path = tmp_path / "batch"
    batch.save(path)
    batch.step(H, 15)
    late = {name: getattr(batch, name) for name in ROWS}
    batch.restore(state)
    assert batch.time == state["time"]
    batch.step(H, 15)
    for name in ROWS:
        np.testing.assert_array_equal(getattr(batch, name), late[name])
    other = batch_of(3, threads=2)
    other.load(path)
    other.step(H, 15)
    assert same(batch, other)
    told = "expected one of 2 worlds of RigidBodies, got one of 3 worlds of RigidBodies"
    with pytest.raises(CorruptError, match=f"does not fit .*{told}"):
        batch_of(2).load(path)
    before = batch.positions
    broken = {**state, "all_rotations": np.zeros_like(state["all_rotations"])}
    wrong_texts = ('["", "", "\\ud800"]', "[" * 10**5, '["", ""]', "[1, 2, 3]")
    wrong_texts = [{**state, "failures": text} for text in wrong_texts]
    for wrong in (broken, {**state, "all_momenta": state["all_momenta"][1:]}, {}, *wrong_texts):
        with pytest.raises(InputError):
            batch.restore(wrong)
        np.testing.assert_array_equal(batch.positions, before)


def test_failed_worlds_are_part_of_the_state():
    batch = failing(on_fail="mask")
    batch.step(1.0, 100, hold_forces=True)
    state = batch.state()
    batch.reset()
    assert not any(batch.failures)
    batch.restore(state)
    assert batch.failures[13]
    with pytest.raises(InputError, match=r"state\['failures'\]: .*'raise', got world 13"):
        failing().restore(state)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda b: substep.RigidBatch(pile()), "worlds: expected how many"),
        (lambda b: substep.RigidBatch(pile(), -1), "worlds"),
        (lambda b: substep.RigidBatch([pile()], 2), "worlds: is for a single"),
        (lambda b: substep.RigidBatch([pile(step=0.1), pile()]), "template: expected one step"),
        (lambda b: substep.RigidBatch(pile(), 2, on_fail="stop"), "on_fail"),
        (lambda b: b.step(0), "dt"),
        (lambda b: b.step(np.nan), "dt"),
        (lambda b: b.step(H, -1), "steps"),
        (lambda b: b.step(H, 1.5), "steps"),
        (lambda b: b.rollout(5, every=2), "steps: expected a multiple"),
        (lambda b: b.rollout(5, every=0), "every"),
        (lambda b: b.advance(-1), "duration"),
        (lambda b: b.set_positions(np.zeros((2, 4, 3))), "values: expected shape"),
        (lambda b: b.set_rotations(np.zeros((2, 5, 4))), "values"),
        (lambda b: b.set_velocities(np.full((2, 5, 3), np.nan)), "values"),
        (lambda b: b.set_velocities(np.zeros((2, 3)), [1, 1]), "ids: .* once"),
        (lambda b: b.set_velocities(np.zeros((5, 3)), worlds=[0, 0]), "worlds: .* once"),
        (lambda b: b.set_forces(np.full((2, 5, 3), np.inf)), "values"),
        (lambda b: b.set_torques(np.zeros(3)), "values: expected shape"),
        (lambda b: b.set_forces(np.zeros((1, 5, 3)), worlds=1.5), "worlds: expected integers"),
    ],
)
def test_bad_arguments_are_refused_and_change_nothing(call, message):
    batch = batch_of(2)
    before = {name: getattr(batch, name) for name in (*ROWS, "forces", "torques")}
    with pytest.raises(InputError, match=message):
        call(batch)
    for name, rows in before.items():
        np.testing.assert_array_equal(getattr(batch, name), rows)


def test_no_steps_change_nothing():
    batch = batch_of(2)
    before = {name: getattr(batch, name) for name in ROWS}
    batch.step(H, 0)
    assert batch.rollout(0).shape == (2, 0, 5, 7)
    assert batch.time == 0
    for name, rows in before.items():
        np.testing.assert_array_equal(getattr(batch, name), rows)


def test_numbers_out_of_range():
    batch = batch_of(2)
    for call in (
        lambda: batch.set_forces(np.zeros((5, 3)), worlds=[2]),
        lambda: batch.set_forces(np.zeros((1, 3)), ids=[-1]),
        lambda: batch.reset([-1]),
        lambda: batch.copy_world(2),
    ):
        with pytest.raises(IndexError):
            call()
    with pytest.raises(TypeError, match=r"template\[1\]"):
        substep.RigidBatch([pile(), None])


def test_no_worlds_and_no_bodies():
    none = substep.RigidBatch(pile(), 0)
    none.step(H, 5)
    assert none.positions.shape[0] == 0
    assert none.step_limit()[0] == np.inf
    empty = substep.RigidBatch(substep.RigidBodies(), 3)
    assert empty.rollout(4, every=2).shape == (3, 2, 0, 7)
    empty.restore(empty.state())
    none.restore(none.state())


def test_the_template_is_not_changed():
    template = pile()
    before = template.positions
    batch = substep.RigidBatch(template, 2)
    batch.step(H, 10)
    np.testing.assert_array_equal(template.positions, before)
    template.step(H)
    batch.reset()
    np.testing.assert_array_equal(batch.positions[0], before)
    assert len(batch) == 2
    assert batch.step_limit()[1].startswith("world 0: ")
    assert set(batch.diagnostics()) == {
        "worlds", "failed", "kinetic_energy", "gravitational_energy", "contacts", "energy"
    }  # fmt: skip


def test_an_interrupt_leaves_all_worlds_at_one_step():
    import _thread

    batch = batch_of(50, threads=2)

    def interrupt():
        while not batch._owner.taken:
            time.sleep(0.001)
        time.sleep(0.2)
        _thread.interrupt_main()

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        batch.step(H, 10_000_000)
    thread.join()
    assert (batch.times == batch.times[0]).all()
    other = batch_of(50)
    other.step(H, round(batch.times[0] / H))
    assert same(batch, other)


def test_another_thread_is_refused():
    batch = batch_of(50)
    errors = []

    def use():
        try:
            batch.step(H, 100)
        except InputError as error:
            errors.append(error)

    threads = [threading.Thread(target=use) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(errors) <= 1
    assert all("in use by another thread" in str(error) for error in errors)
    assert round(batch.time / H) == 100 * (2 - len(errors))
