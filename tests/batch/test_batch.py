"""Batches of particles and springs: the bits of single worlds, failures, states, bad input."""

import threading
import time
import warnings

import numpy as np
import pytest
import substep
from substep import mpm, pbd
from substep.errors import CorruptError, InputError, NonFiniteError, SolverError
from substep.geometry import box_mesh, box_tetrahedra, grid_mesh
from substep.view.drawables import Scenery
from substep.view.extent import box_of, radius_in
from substep.view.look import Look

GROUND = (0, 0, -0.6)


def net(v, **options):
    mesh = grid_mesh(4, 4)
    plane = [substep.Collider(substep.Plane((0, 0, 1), GROUND), friction=0.3)]
    net = substep.MassSpring.from_mesh(
        mesh, density=0.2, stiffness=200.0, pinned=[0], colliders=plane, **options
    )
    net.set_velocities(np.full((len(net), 3), v))
    return net


def explicit_net(v):
    return net(v, integrator="symplectic_euler", step=1e-3)


def jelly(v):
    body = substep.SoftBody.from_mesh(
        box_tetrahedra((0.4, 0.4, 0.4), (1, 1, 1)),
        density=1000.0,
        young_modulus=1e4,
        poisson_ratio=0.3,
        colliders=[substep.Plane((0, 0, 1), (0, 0, -0.3))],
    )
    body.set_velocities(np.full((len(body), 3), v))
    return body


def cloth(v, **options):
    mesh = grid_mesh(4, 4)
    return substep.PositionBasedDynamics(
        mesh.vertices + np.array([0, 0, 0.2]),
        0.1,
        [*pbd.cloth(mesh), pbd.SelfCollision(mesh.faces, thickness=0.05)],
        velocities=np.full(mesh.vertices.shape, v),
        colliders=[substep.Collider(substep.Sphere(0.2), velocity=(0.1, 0, 0), friction=0.3)],
        **options,
    )


def flat_rope(v):
    x = np.stack([np.arange(6) * 0.1, np.zeros(6)], axis=1)
    constraint = substep.Distance([[k, k + 1] for k in range(5)], compliance=1e-4)
    return substep.PositionBasedDynamics(
        x, 0.1, [constraint], velocities=np.full((6, 2), v), pinned=[0], dtype="float64"
    )


def liquid(v, **options):
    x = substep.fill_box((0, 0, 0), (0.3, 0.2, 0.3), 0.05)
    return substep.PositionBasedFluid(
        x,
        spacing=0.05,
        velocities=np.full(x.shape, v),
        colliders=[substep.Plane((0, 0, 1), (0, 0, -0.1))],
        **options,
    )


def fountain(v):
    tap = substep.Emitter((0, 0, 1), (0, 0, -1), 1.0 + v, radius=0.1)
    return liquid(v, step=0.01, emitters=[tap])


def water(v, **options):
    x = substep.fill_box((0, 0), (0.5, 0.5), 0.05)
    return substep.GridLiquid(
        x, cell=0.1, bounds=((0, 0), (1, 1)), velocities=np.full(x.shape, v), **options
    )


def sand(v, **options):
    x, volume = mpm.sample_box((0, 0, 0), (0.3, 0.3, 0.3), 0.05)
    return substep.MaterialPointMethod(
        x,
        mpm.Sand(1500.0),
        cell=0.1,
        volume=volume,
        velocities=np.full(x.shape, v),
        colliders=[substep.Plane((0, 0, 1), (0, 0, -0.05))],
        **options,
    )


def wet_sand(v):
    tap = substep.Emitter((0.1, 0.1, 1.0), (0, 0, -1), 1.0 + v, radius=0.1)
    return sand(v, step=1e-3, emitters=[tap])


MAKERS = (net, explicit_net, jelly, cloth, flat_rope, liquid, fountain, water, sand, wet_sand)
EACH = pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__)
SPEEDS = (0.0, 0.3, -0.2, 0.5)


def assert_same(one, other):
    """Bit by bit, what obstacles do included."""
    there = other.state()
    for name, value in one.state().items():
        np.testing.assert_array_equal(value, there[name], err_msg=name)


def assert_same_worlds(batch, worlds):
    for w, world in enumerate(worlds):
        assert_same(batch.copy_world(w), world)
        count = len(world)
        np.testing.assert_array_equal(batch.positions[w, :count], world.positions)
        np.testing.assert_array_equal(batch.velocities[w, :count], world.velocities)
        assert np.isnan(batch.positions[w, count:]).all()
        assert batch.times[w] == world.time


@EACH
@pytest.mark.parametrize("threads", [1, 2, 3])
def test_each_world_has_the_bits_of_the_same_simulation_alone(make, threads):
    alone = [make(v) for v in SPEEDS]
    alone[1].step(2.0**-9)  # so not all are at one time
    batch = substep.Batch(alone, threads=threads)
    batch.step(2.0**-9, 20)
    batch.step(steps=2)
    batch.advance(0.07)
    for world in alone:
        for _ in range(20):
            world.step(2.0**-9)
        world.step()
        world.step()
        world.advance(0.07)
    assert_same_worlds(batch, alone)


@EACH
def test_a_callback_changes_no_bits(make):
    seen, unseen = (substep.Batch([make(v) for v in SPEEDS]) for _ in range(2))
    times = []
    seen.advance(0.05, lambda batch: times.append(batch.times.max()))
    unseen.advance(0.05)
    assert len(times) == seen.report.steps == unseen.report.steps
    assert_same(seen, unseen)


@EACH
def test_a_callback_may_set_the_step_that_is_set(make):
    batch, twin = (substep.Batch([make(v) for v in SPEEDS]) for _ in range(2))

    def again(batch):
        assert batch.report.steps < 200
        batch.step_size = batch.step_size

    batch.advance(0.05, again)
    twin.advance(0.05)
    assert batch.report.steps == twin.report.steps
    assert_same(batch, twin)


def test_worlds_may_differ_in_all_but_their_class():
    worlds = [cloth(0.1), flat_copy(3), flat_copy(5)]
    batch = substep.Batch(worlds)
    assert batch.counts.tolist() == [16, 3, 5]
    batch.advance(0.1)
    for world in worlds:
        world.advance(0.1)
    assert_same_worlds(batch, worlds)
    x = batch.positions + 1.0  # NaN rows are no particles
    batch.set_positions(x)
    np.testing.assert_allclose(batch.positions, x, atol=1e-6)
    assert len(batch.fields()["position"][0]) == 24
    assert np.isnan(batch.world_diagnostics()["speed"]).sum() == 0


def flat_copy(n):
    return substep.PositionBasedDynamics(np.arange(3.0 * n).reshape(n, 3), 1.0)


def test_the_template_stays_as_it_is():
    template = net(0.2)
    before = template.state()
    batch = substep.Batch(template, 3)
    batch.advance(0.1)
    batch.set_positions(np.zeros((16, 3)), worlds=[1])
    for name, value in template.state().items():
        np.testing.assert_array_equal(value, before[name])
    assert repr(batch).endswith("3 worlds of MassSpring)")


def test_sums_and_numbers_of_worlds():
    alone = [net(v) for v in SPEEDS]
    batch = substep.Batch(alone)
    told, each = batch.diagnostics(), batch.world_diagnostics()
    for name in ("kinetic_energy", "energy", "momentum_x"):
        values = [world.diagnostics()[name] for world in alone]
        np.testing.assert_array_equal(each[name], values)
        assert told[name] == pytest.approx(sum(values), rel=1e-12)
    assert told["worlds"] == 4
    assert told["failed"] == 0


# ---------------------------------------------------------------------------- failures


def failing(**options):
    """Twenty springs of which the 13th, and later the third, leave the range of numbers."""
    springs = substep.MassSpring(
        [[0, 0, 0], [1.0, 0, 0]],
        [[0, 1]],
        0.0,
        1.0,
        gravity=(0, 0, 0),
        integrator="euler",
        step=1.0,
    )
    batch = substep.Batch(springs, 20, **options)
    v = np.ones((20, 2, 3))
    v[13] = 0.6e307
    v[2] = 0.4e307
    batch.set_velocities(v)
    return batch


@pytest.mark.parametrize("threads", [1, 2])
def test_a_failing_world_is_named_and_all_are_at_the_last_good_step(threads):
    batch = failing(threads=threads)
    with pytest.raises(NonFiniteError, match="world 13: ") as caught:
        batch.step(1.0, 100)
    assert caught.value.index == 13
    assert caught.value.step == 29
    assert (batch.times == 29.0).all()
    again = failing()
    again.step(1.0, 29)
    assert_same(batch, again)
    with pytest.raises(NonFiniteError, match="world 13") as caught:
        batch.advance(5.0)
    assert caught.value.step == 0
    assert_same(batch, again)


def test_advance_ends_at_the_last_step_that_all_have_done():
    batch = failing()
    with pytest.raises(NonFiniteError) as caught:
        batch.advance(31.5)  # by 32 equal steps
    assert caught.value.step == 30
    np.testing.assert_allclose(batch.times, 30 * 31.5 / 32, rtol=1e-12)


def test_masked_worlds_stop_alone_until_they_are_reset():
    batch = failing(on_fail="mask")
    batch.step(1.0, 100)
    assert [w for w, reason in enumerate(batch.failures) if reason] == [2, 13]
    assert batch.times[13] == 29.0
    assert batch.times[2] == 44.0
    assert np.delete(batch.times, [2, 13]).tolist() == [100.0] * 18
    assert batch.time == 100.0
    assert batch.diagnostics()["failed"] == 2
    stopped = batch.positions[13]
    batch.advance(2.0)
    np.testing.assert_array_equal(batch.positions[13], stopped)
    state = batch.state()
    batch.reset([13])
    assert not batch.failures[13]
    batch.set_velocities(np.ones((2, 3)), worlds=[13])
    batch.step(1.0)
    np.testing.assert_array_equal(batch.positions[13, 0], [1, 1, 1])
    batch.restore(state)
    assert batch.failures[13]
    np.testing.assert_array_equal(batch.positions[13], stopped)


def broken(**options):
    """Three nets of which the second is not finite, as a view of it was written."""
    nets = [net(0.1), net(0.2), net(0.3)]
    nets[1].positions[3] = np.nan
    return substep.Batch(nets, on_fail="mask", **options)


def test_a_world_that_has_stopped_with_nan_is_told_and_left_out():
    batch = broken()
    batch.step(1e-3)
    assert [bool(reason) for reason in batch.failures] == [False, True, False]
    limit, reason = batch.step_limit()
    assert limit == min(batch.copy_world(w).step_limit()[0] for w in (0, 2))
    assert reason.startswith(("world 0: ", "world 2: "))
    assert reason.endswith("; 1 of 3 worlds have stopped")
    assert repr(batch).endswith("3 worlds of MassSpring, 1 stopped)")
    fields = batch.fields()
    assert all(np.isfinite(values).all() for values, _ in fields.values())
    assert np.bincount(fields["world"][0]).tolist() == [16, 0, 16]
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    assert batch._repr_png_()
    alone = substep.Batch([batch._worlds[1]], on_fail="mask")
    alone.step(1e-3)
    assert alone.step_limit() == (np.inf, "all worlds have stopped")
    assert alone._repr_png_()


def test_a_world_that_has_stopped_far_away_is_left_out(tmp_path):
    batch = failing(on_fail="mask")
    batch.step(1.0, 50)
    assert np.abs(batch.positions[13]).max() > 1e300  # finite, but not in float32
    fields = batch.fields()
    assert np.bincount(fields["world"][0], minlength=20).tolist() == [
        0 if w in (2, 13) else 2 for w in range(20)
    ]
    told = batch.diagnostics()
    assert (told["worlds"], told["failed"]) == (20, 2)
    assert told["kinetic_energy"] == pytest.approx(36 * 0.5 * 3)
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert batch._repr_png_()
        recording = substep.scenes.record(batch, tmp_path / "run.vtkhdf", 2.0, fps=1)
        with substep.Recording(recording) as read:
            assert np.abs(box_of(read, {})).max() < 100


def test_the_radius_of_particles_is_that_of_one_world(tmp_path):
    rows = [substep.PositionBasedDynamics([[k, 0, 0] for k in range(5)], 1.0) for _ in range(8)]
    batch = substep.Batch(rows)
    pushes = np.zeros((8, 5, 3))
    pushes[:, :, 0] = np.linspace(0, 0.01, 8)[:, None]
    batch.set_velocities(pushes)
    batch.advance(0.1)
    drawn = [one for one in Scenery(batch).at() if one.kind == "points"]
    assert [one.radius for one in drawn] == [pytest.approx(0.5, rel=0.01)]
    recording = substep.scenes.record(batch, tmp_path / "run.vtkhdf", 0.1, fps=20)
    with substep.Recording(recording) as read:
        assert radius_in(read, "particles", Look()) == pytest.approx(0.5, rel=0.01)


def hasten(batch):
    """Give the second world a speed whose steps are below the spacing of times."""
    batch.set_velocities(np.full((batch.counts[1], 3), 1e15), worlds=[1])


def late_liquids(**options):
    return substep.Batch(liquid(0.0, time=1.0), 3, **options)


def test_a_world_of_which_the_step_becomes_too_small_fails_alone():
    batch = late_liquids()
    with pytest.raises(SolverError, match=r"world 1: the step, .* is below") as caught:
        batch.advance(0.05, hasten)
    assert (caught.value.index, caught.value.step) == (1, 1)
    assert (batch.times == caught.value.time).all()
    batch, alone = late_liquids(on_fail="mask"), liquid(0.0, time=1.0)
    batch.advance(0.05, hasten)
    alone.advance(0.05)
    assert "is below the spacing" in batch.failures[1]
    assert_same(batch.copy_world(0), alone)
    assert_same(batch.copy_world(2), alone)


def test_a_world_that_a_callback_resets_takes_part_again():
    batch, alone = late_liquids(on_fail="mask"), liquid(0.0, time=1.0)
    hasten(batch)
    batch.advance(0.05, lambda batch: batch.failures[1] and batch.reset([1]))
    alone.advance(0.05)
    assert_same_worlds(batch, [alone] * 3)


def test_a_world_that_has_no_next_step_fails_alone(monkeypatch):
    usual = substep.PositionBasedFluid._next_step

    def next_step(one):
        if one.velocities.max() > 1e14:
            raise SolverError("too fast")
        return usual(one)

    monkeypatch.setattr(substep.PositionBasedFluid, "_next_step", next_step)
    batch = late_liquids()
    hasten(batch)
    with pytest.raises(SolverError, match="world 1: too fast") as caught:
        batch.step(steps=2)
    assert (caught.value.index, caught.value.step, caught.value.time) == (1, 0, 1.0)
    batch = late_liquids(on_fail="mask")
    hasten(batch)
    batch.step(steps=2)
    assert batch.failures == ["", "too fast", ""]
    assert batch.times[1] == 1.0 < batch.times[0] == batch.times[2]


def test_a_batch_without_failures_takes_over_none(tmp_path):
    masked = failing(on_fail="mask")
    masked.step(1.0, 40)
    masked.save(tmp_path / "masked")
    batch = failing()
    with pytest.raises(InputError, match=r"state\['failures'\]: .*'raise', got world 13"):
        batch.restore(masked.state())
    with pytest.raises(CorruptError, match="got world 13"):
        batch.load(tmp_path / "masked")
    assert not any(batch.failures)
    masked.reset([13])
    batch.restore(masked.state())


def escaping(v, **options):
    """Grains of which those of a high speed leave the bounds."""
    x, volume = mpm.sample_box((0, 0, 0), (0.2, 0.2, 0.2), 0.05)
    bounds = [[-1, -1, -1], [1, 1, 1]]
    return substep.MaterialPointMethod(
        x,
        mpm.NeoHookean(1000.0, 1e4, 0.3),
        cell=0.1,
        volume=volume,
        velocities=np.full(x.shape, v),
        gravity=(0, 0, 0),
        bounds=bounds,
        **options,
    )


def test_worlds_that_choose_their_steps_go_back_to_where_the_call_began():
    batch = substep.Batch([escaping(v) for v in (0.0, 8.0, 0.5)])
    batch.advance(0.01)
    before = batch.state()
    with pytest.raises(SolverError, match=r"world 1: .*bounds"):
        batch.advance(0.2)
    after = batch.state()
    for name, value in before.items():
        np.testing.assert_array_equal(after[name], value, err_msg=name)
    alone = [escaping(v) for v in (0.0, 8.0, 0.5)]
    masked = substep.Batch(alone, on_fail="mask")
    masked.advance(0.2)
    with pytest.raises(SolverError):
        alone[1].advance(0.2)
    for w in (0, 2):
        alone[w].advance(0.2)
    assert_same_worlds(masked, alone)
    assert masked.failures[1]


@EACH
def test_steps_that_are_taken_back_and_again_have_the_same_bits(make):
    """Where the last world fails in a block, the others go back, and to the step before it."""
    worlds = [make(v) for v in SPEEDS]
    batch, twin = substep.Batch(worlds), substep.Batch(worlds)
    kept = [batch._worlds[w]._native for w in range(4)]
    batch.step(2.0**-9, 3)
    bad = batch._worlds[3]
    rows = np.full((len(bad), bad._dimension), np.nan)
    bad._write("velocities", rows, np.arange(len(bad)))
    for _ in range(2):
        with pytest.raises(SolverError, match="world 3"):
            batch.step(2.0**-9, 20)
    twin.step(2.0**-9, 3)
    for w in range(3):
        assert batch._worlds[w]._native is kept[w]
        assert_same(batch.copy_world(w), twin.copy_world(w))


# ---------------------------------------------------------------------------- states


@EACH
def test_states_and_files_are_exact(make, tmp_path):
    worlds = [make(v) for v in SPEEDS]
    batch = substep.Batch(worlds)
    batch.advance(0.05)
    state = batch.state()
    batch.save(tmp_path / "batch")
    batch.advance(0.05)
    late = batch.state()
    other = substep.Batch(worlds, threads=2)
    other.load(tmp_path / "batch")
    batch.restore(state)
    for one in (batch, other, other.copy()):
        one.advance(0.05)
        for name, value in late.items():
            np.testing.assert_array_equal(one.state()[name], value, err_msg=name)
    batch.reset([0, 2])
    for w in (0, 2):
        assert_same(batch.copy_world(w), worlds[w])
    assert batch.times[1] > 0


def test_a_state_of_other_worlds_says_of_which_it_is(tmp_path):
    saved = substep.Batch([net(v) for v in SPEEDS[:3]])
    saved.save(tmp_path / "nets")
    told = r"expected one of {} worlds of {}, got one of 3 worlds of MassSpring"
    for batch in (substep.Batch(net(0), 4), substep.Batch(jelly(0), 3), substep.Batch(jelly(0), 5)):
        why = told.format(len(batch), type(batch._worlds[0]).__name__)
        with pytest.raises(CorruptError, match=f"nets: does not fit .*: state: {why}$"):
            batch.load(tmp_path / "nets")
        with pytest.raises(InputError, match=f"^state: {why}$"):
            batch.restore(saved.state())
        assert batch.time == 0
    with pytest.raises(InputError, match="state: class missing"):
        saved.restore({k: v for k, v in saved.state().items() if k != "class"})


def test_worlds_come_out_and_go_in():
    batch = substep.Batch([net(v) for v in SPEEDS])
    batch.advance(0.1)
    one = batch.copy_world(2)
    assert one.threads is None
    one.advance(0.1)
    batch.reset([0, 2], one)
    assert_same(batch.copy_world(0), one)
    assert_same(batch.copy_world(2), one)
    batch.reset([0, 1], [net(0.0), net(0.1)])
    assert batch.times[0] == batch.times[1] == 0
    small = substep.MassSpring([[0, 0, 0], [0, 0, 1]], [[0, 1]], 1.0, 1.0)
    before = batch.state()
    with pytest.raises(InputError, match="world 0: state"):
        batch.reset([0], small)
    with pytest.raises(InputError, match="to: expected 2"):
        batch.reset([0, 1], [one])
    with pytest.raises(TypeError, match=r"to\[0\]: expected a simulation"):
        batch.reset([0], [3])
    for name, value in before.items():
        np.testing.assert_array_equal(batch.state()[name], value)


def test_what_is_set_in_some_worlds_leaves_the_others():
    batch = substep.Batch(liquid(0.0, step=0.01), 3)
    n = batch.counts[0]
    before = batch.velocities
    v = np.random.default_rng(0).normal(size=(2, n, 3)).astype(np.float32).astype(float)
    batch.set_velocities(v, worlds=[2, 0])
    np.testing.assert_array_equal(batch.velocities[[2, 0]], v)
    np.testing.assert_array_equal(batch.velocities[1], before[1])
    state = batch.state()
    far = np.zeros((3, n, 3))
    far[1, 5, 0] = 1e30  # beyond the cells of world 1
    with pytest.raises(InputError):
        batch.set_positions(far)
    for name, value in state.items():
        np.testing.assert_array_equal(batch.state()[name], value, err_msg=name)


# ---------------------------------------------------------------------------- input, threads


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda b: substep.Batch(net(0)), InputError, "worlds: expected how many"),
        (lambda b: substep.Batch(net(0), 0), InputError, "worlds"),
        (lambda b: substep.Batch([net(0)], 2), InputError, "worlds: is for a single"),
        (lambda b: substep.Batch([]), InputError, "template: expected at least one"),
        (lambda b: substep.Batch(3), TypeError, "template: expected a list"),
        (lambda b: substep.Batch([net(0), 3]), TypeError, r"template\[1\]: expected a sim"),
        (lambda b: substep.Batch([substep.RigidBodies()]), TypeError, "RigidBatch"),
        (lambda b: substep.Batch([net(0), jelly(0)]), InputError, r"template\[1\]: .*class"),
        (lambda b: substep.Batch([net(0), net(0, step=0.1)]), InputError, "step_size"),
        (lambda b: substep.Batch([cloth(0), cloth(0, dtype="float64")]), InputError, "dtype"),
        (lambda b: substep.Batch([cloth(0), flat_rope(0)]), InputError, "dimension"),
        (lambda b: substep.Batch(custom(), 2), InputError, "template: .*CustomConstraint"),
        (lambda b: substep.Batch(net(0), 2, on_fail="stop"), InputError, "on_fail"),
        (lambda b: b.step(0), InputError, "dt"),
        (lambda b: b.step(np.nan), InputError, "dt"),
        (lambda b: b.step(0.1, -1), InputError, "steps"),
        (lambda b: b.step(0.1, 1.5), InputError, "steps"),
        (lambda b: b.advance(-1), InputError, "duration"),
        (lambda b: b.set_positions(np.zeros((2, 4, 3))), InputError, "values: expected shape"),
        (
            lambda b: b.set_velocities(np.full((2, 16, 3), np.nan)),
            InputError,
            r"values\[0, 0, 0\]: expected fin",
        ),
        (lambda b: b.set_forces(np.zeros((16, 3)), worlds=[0, 0]), InputError, "worlds: .* once"),
        (lambda b: b.set_forces(np.zeros((16, 3)), worlds=[2]), IndexError, r"worlds\[0\]"),
        (lambda b: b.copy_world(2), IndexError, "world: expected a number below 2"),
        (lambda b: b.reset([5]), IndexError, r"worlds\[0\]"),
        (lambda b: setattr(b, "step_size", 0.0), InputError, "step_size"),
        (lambda b: substep.World({"a": b}), TypeError, r"members\['a'\]"),
    ],
)
def test_bad_arguments_are_refused_and_change_nothing(call, error, message):
    batch = substep.Batch([net(0.1), net(0.2)])
    before = batch.state()
    with pytest.raises(error, match=message):
        call(batch)
    for name, value in before.items():
        np.testing.assert_array_equal(batch.state()[name], value)


def custom():
    constraint = pbd.CustomConstraint([[0]], lambda t, x: (x[:, 0, 2], np.ones((1, 1, 3))))
    return substep.PositionBasedDynamics([[0, 0, 1.0]], 1.0, [constraint])


def test_ctrl_c_leaves_all_worlds_at_one_step():
    batch = substep.Batch(net(0.1, step=1e-3), 50)
    started = time.perf_counter()

    def press():
        time.sleep(0.2)
        pressed.append(time.perf_counter())
        signal_main()

    import _thread

    signal_main = _thread.interrupt_main
    pressed = []
    threading.Thread(target=press).start()
    with pytest.raises(KeyboardInterrupt):
        batch.step(1e-3, 10**9)
    assert time.perf_counter() - pressed[0] < 2
    assert time.perf_counter() - started > 0.2
    assert (batch.times == batch.time).all()
    again = substep.Batch(net(0.1, step=1e-3), 50)
    again.step(1e-3, round(batch.time / 1e-3))
    assert_same(batch, again)


def test_shapes_of_templates_are_shared_and_their_obstacles_are_not():
    ball = substep.Collider(
        substep.geometry.SignedDistanceField.from_mesh(box_mesh((1, 1, 1)), 0.2)
    )
    ball.velocity = (0.5, 0, 0)
    template = substep.PositionBasedDynamics([[0, 0, 2.0]], 1.0, colliders=[ball])
    batch = substep.Batch(template, 2)
    batch.step(0.1)
    assert ball.position[0] == 0
    np.testing.assert_allclose(batch.copy_world(1).colliders[0].position[0], 0.05)
