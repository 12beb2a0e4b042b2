"""The material point method: steps, their limits, what is conserved, determinism, failures."""

import math
import signal

import numpy as np
import pytest
import substep
from substep import InputError, NonFiniteError, SolverError, mpm

JELLY = mpm.NeoHookean(density=1000.0, young_modulus=1e4, poisson_ratio=0.3)
DTYPES = ("float32", "float64")


def lattice(counts, spacing, low=(0.0, 0.0, 0.0)):
    axes = [at + spacing * (np.arange(n) + 0.5) for n, at in zip(counts, low, strict=False)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def body(dimension=3, n=8, low=0.3, **options):
    """A cube (a square) of jelly with 2 particles a cell and axis."""
    x = lattice((n,) * dimension, 0.05, (low,) * 3)
    x += np.random.default_rng(3).uniform(-0.01, 0.01, x.shape)
    options = {"materials": JELLY, "cell": 0.1, "volume": 0.05**dimension} | options
    return substep.MaterialPointMethod(x, **options)


def mixture(dimension=3, **options):
    """Snow, sand and jelly thrown against a slope, a ball and each other."""
    x = lattice((12,) * dimension, 0.05, (0.1,) * 3)
    x += np.random.default_rng(5).uniform(-0.02, 0.02, x.shape)
    v = 0.8 * np.sin(7 * x[:, ::-1]) - 0.5
    up = np.eye(dimension)[-1]
    slope = substep.Collider(substep.Plane([*(0.2 * np.roll(up, 1) + up), 0.0][:3]), friction=0.4)
    ball = substep.Collider(substep.Sphere(0.15, (0.2, 0.1, 0.2 * (dimension - 2))))
    options = {
        "materials": [
            mpm.Snow(young_modulus=2e4),
            mpm.Sand(young_modulus=2e4),
            JELLY,
        ],
        "kinds": np.arange(len(x)) % 3,
        "cell": 0.1,
        "volume": 0.05**dimension,
        "velocities": v,
        "colliders": [slope, ball],
        "transfer": "apic",
    } | options
    return substep.MaterialPointMethod(x, **options)


def state_hash(simulation):
    return substep.state_hash(*simulation.state().values())


def vector(diagnostics, name):
    return np.array([diagnostics[f"{name}_{axis}"] for axis in "xyz"])


# What is conserved.
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("dimension", [2, 3])
def test_free_fall(dimension, dtype):
    """Mass is that of the volumes, momentum m g t, and the shape stays."""
    simulation = body(dimension, dtype=dtype)
    x = simulation.positions
    simulation.advance(0.25)
    values = simulation.diagnostics()
    mass = 1000 * 0.4**dimension
    exact = 1e-12 if dtype == "float64" else 1e-5
    assert values["mass"] == pytest.approx(mass, rel=max(exact, 1e-7))
    momentum = np.zeros(3)
    momentum[dimension - 1] = -9.81 * 0.25 * mass
    assert vector(values, "momentum") == pytest.approx(momentum, abs=exact * mass)
    moved = simulation.positions - x
    assert np.ptp(moved, axis=0) == pytest.approx(0, abs=1e-9 if dtype == "float64" else 1e-4)
    # Symplectic Euler falls g t dt / 2 further, so more the longer the steps are.
    drop = 9.81 * 0.25**2 / 2
    assert -moved[:, -1].mean() == pytest.approx(drop + 9.81 * 0.25 * 5e-3 / 2, abs=9.81 * 1e-3)


@pytest.mark.parametrize("dimension", [2, 3])
def test_motion_without_forces_conserves_momenta(dimension):
    """A spinning, deforming body: linear and angular momentum, the affine part with it."""
    simulation = body(dimension, gravity=np.zeros(dimension), dtype="float64")
    x = simulation.positions - simulation.positions.mean(axis=0)
    v = np.zeros_like(x)
    v[:, 0], v[:, 1] = -2 * x[:, 1] + 0.5, 2 * x[:, 0] + 0.3 * x[:, 1]
    simulation.set_velocities(v)
    before = simulation.diagnostics()
    simulation.advance(0.5)
    after = simulation.diagnostics()
    assert simulation.report.steps >= 50
    scale = np.abs(vector(before, "angular_momentum")).max()
    for name in ("momentum", "angular_momentum"):
        assert vector(after, name) == pytest.approx(vector(before, name), abs=1e-12 * scale)


def test_energies_add_up():
    """A released compression oscillates: what is not kinetic or elastic counts as dissipated."""
    simulation = body(2, n=16, gravity=(0, 0), dtype="float64", cfl=0.1)
    simulation.set_deformation_gradients(np.tile(np.diag([0.99, 1.0]), (256, 1, 1)))
    first = simulation.diagnostics()
    # The longitudinal modulus lambda + 2 mu stretches a body held at its sides.
    modulus = JELLY.wave_speed**2 * 1000
    assert first["elastic_energy"] == pytest.approx(0.8**2 * modulus * 0.01**2 / 2, rel=0.02)
    assert first["dissipated_energy"] == pytest.approx(0, abs=1e-9)
    simulation.advance(0.05)
    later = simulation.diagnostics()
    parts = [later[f"{k}_energy"] for k in ("kinetic", "elastic", "gravitational", "dissipated")]
    assert parts[0] > 0.1 * first["elastic_energy"]
    assert sum(parts) == pytest.approx(first["elastic_energy"], rel=1e-9)
    assert 0 < parts[3] < 0.4 * first["elastic_energy"]


def test_forces_push_for_one_step():
    simulation = body(gravity=(0, 0, 0), dtype="float64")
    forces = np.tile([0.5, 0.0, -0.25], (len(simulation), 1))
    forces[:9] = 0
    simulation.set_forces(forces)
    simulation.step(2e-3)
    impulse = 2e-3 * forces.sum(axis=0)
    assert vector(simulation.diagnostics(), "momentum") == pytest.approx(impulse, abs=1e-12)
    simulation.step(2e-3)
    assert vector(simulation.diagnostics(), "momentum") == pytest.approx(impulse, abs=1e-12)


@pytest.mark.parametrize("dtype", DTYPES)
def test_colliders_get_what_the_body_loses(dtype):
    """Impulse on the ground over a call = weight times time - what stays as momentum."""
    ground = substep.Collider(substep.Plane(), friction=0.3)
    simulation = body(low=0.05, colliders=[ground], dtype=dtype)
    before = vector(simulation.diagnostics(), "momentum")
    simulation.advance(0.3)
    weight = np.array([0, 0, -9.81 * 0.3 * simulation.masses.sum()])
    lost = before + weight - vector(simulation.diagnostics(), "momentum")
    assert ground.impulse[2] < -100
    tolerance = 1e-9 if dtype == "float64" else 1e-2
    assert ground.impulse == pytest.approx(lost, abs=tolerance)
    assert ground.distance(simulation.positions).min() > 0


def test_a_moving_obstacle_does_work():
    """A wall that drives into resting jelly brings in energy: little of it is lost."""
    wall = substep.Collider(substep.Plane((1, 0, 0)))
    wall.velocity = (0.5, 0, 0)
    simulation = body(gravity=(0, 0, 0), low=0.01, colliders=[wall], dtype="float64", cfl=0.1)
    simulation.advance(0.1)
    values = simulation.diagnostics()
    held = values["kinetic_energy"] + values["elastic_energy"]
    assert held > 1.0
    assert 0 < values["dissipated_energy"] < 0.5 * held


# Determinism.
@pytest.mark.parametrize("transfer", ["apic", "aflip"])
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("dimension", [2, 3])
def test_the_same_bits_for_any_number_of_threads_and_through_a_checkpoint(
    dimension, dtype, transfer, tmp_path
):
    hashes, sorts = set(), 0
    for threads in (1, 2, 3, 4):
        options = {"dtype": dtype, "threads": threads, "step": 5e-4, "transfer": transfer}
        simulation = mixture(dimension, **options)
        simulation.advance(0.1 if transfer == "apic" else 0.2)
        sorts += simulation.report.sorts
        if threads == 2:
            simulation.save(tmp_path / "checkpoint")
        if threads == 3:
            simulation = mixture(dimension, **options)
            simulation.load(tmp_path / "checkpoint")
        if threads == 4:
            simulation = simulation.copy()
        simulation.advance(0.05)
        assert simulation.report.steps == 100
        hashes.add(state_hash(simulation))
    assert len(hashes) == 1
    assert sorts >= 8


@pytest.mark.parametrize("transfer", ["apic", "aflip"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_fused_steps_are_the_steps_one_by_one(dtype, transfer):
    """A run that fuses the end of a step with the start of the next, bit for bit."""
    options = {"dtype": dtype, "transfer": transfer}
    together, single = mixture(step=5e-4, **options), mixture(**options)
    together.advance(60 * 5e-4)
    assert together.report.steps == 60
    for _ in range(60):
        single.step(5e-4)
    assert single.time == pytest.approx(together.time, rel=1e-12)
    assert np.array_equal(single.positions, together.positions)
    assert np.array_equal(single.velocities, together.velocities)
    assert np.array_equal(single.deformation_gradients, together.deformation_gradients)


@pytest.mark.parametrize("integrator", ["symplectic_euler", "implicit_euler"])
@pytest.mark.parametrize("dtype", DTYPES)
def test_a_callback_that_does_nothing_changes_no_bits(dtype, integrator):
    """Nor do steps by hand, whose size is chosen: what is chosen is never too large."""

    def falling(**flow):
        x = lattice((8, 8, 8), 0.0125, (-0.1, -0.1, 0.02))
        soft = mpm.NeoHookean(density=1000, young_modulus=3e4, poisson_ratio=0.3)
        options = {"cell": 0.025, "volume": 0.0125**3, "dtype": dtype, "integrator": integrator}
        ground = substep.Collider(substep.Plane(point=(0, 0, -0.05)), velocity=(0, 0, 0.1))
        return substep.MaterialPointMethod(x, soft, colliders=[ground], **options, **flow)

    flow = {
        "emitters": [substep.Emitter((0, 0, 0.4), (0, 0, -1), 2.0, radius=0.05)],
        "sinks": [substep.Sink(substep.Box((0.1, 0.1, 0.1)))],
    }
    for parts in {}, flow:
        one, watched = falling(**parts), falling(**parts)
        one.advance(0.2)
        calls = []
        watched.advance(0.2, lambda body, calls=calls: calls.append(body.time))
        assert len(calls) == one.report.steps == watched.report.steps
        state, other = one.state(), watched.state()
        assert [name for name in state if not np.array_equal(state[name], other[name])] == []
        ours, theirs = one.colliders[0], watched.colliders[0]
        assert ours.duration == pytest.approx(theirs.duration, rel=1e-12)
        np.testing.assert_allclose(ours.impulse, theirs.impulse, rtol=1e-9, atol=1e-12)
    by_hand = falling()
    while by_hand.time < 0.2:
        by_hand.step()
    assert by_hand.time < 0.2 + by_hand.report.dt


@pytest.mark.parametrize("sinks", [[], [substep.Sink(substep.Sphere(0.15, (0.1, 0.4, 0)))]])
def test_an_interrupt_at_every_poll_in_turn_leaves_a_whole_step(sinks):
    """With what came out of emitters and went into sinks."""

    def poured(polls, callback=None):
        """What is left, and how many polls were not come to."""
        jet = substep.Emitter((0.1, 0.6), (0, -1), 20.0, radius=0.1)
        liquid = body(2, 2, emitters=[jet], sinks=sinks, step=2.0**-10, threads=1)
        states.append(state_hash(liquid))
        substep._core.interrupt_after(polls)
        try:
            liquid.advance(0.008, callback)
        except KeyboardInterrupt:
            pass
        return state_hash(liquid), substep._core.interrupt_after(0)

    states, many = [], 10**6
    whole, left = poured(many)
    polls = many - left
    poured(many, lambda liquid: states.append(state_hash(liquid)))
    stopped = [poured(1 + poll) for poll in range(polls)]
    assert {left for _, left in stopped} == {0}
    assert {state for state, _ in stopped} <= set(states)
    assert whole in states
    assert len({state for state, _ in stopped}) > 5


def test_a_callback_may_make_the_material_stiff():
    """What the last step knew of the next one is forgotten then."""
    stiff = mpm.NeoHookean(density=1000.0, young_modulus=1e8, poisson_ratio=0.3)
    jelly = body(materials=[JELLY, stiff], gravity=(0, 0, 0))

    def throw(it):
        if len(it) == 512:
            it.add(lattice((2, 2, 2), 0.05, (1.0, 0.3, 0.3)), 0.05**3, kinds=1)

    jelly.advance(0.06, throw)
    assert jelly.report.dt < 2e-4
    assert np.isfinite(jelly.positions).all() and jelly.diagnostics()["kinetic_energy"] < 1e-6


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_scene_moved_by_a_kilometre(dtype):
    """The same to 1e-3 cells: positions are kept from nodes nearby."""
    near, far = (body(low=low, gravity=(0, 0, -9.81), dtype=dtype) for low in (0.3, 1000.3))
    kick = np.sin(9 * near.positions[:, ::-1])
    for simulation in (near, far):
        simulation.set_velocities(kick)
        for _ in range(100):
            simulation.step(2e-3)
    assert far.positions - 1000 == pytest.approx(near.positions, abs=1e-3 * 0.1)


def test_an_emitter_that_is_far_behind_is_refused():
    nozzle = substep.Emitter((0, 0.6), (0, -1), 1.0, radius=0.1)
    late = body(2, emitters=[nozzle], time=1e9)
    before = state_hash(late)
    for call in (lambda: late.step(1e-3), late.step, lambda: late.advance(1e-3)):
        with pytest.raises(InputError, match=r"emitters\[0\]: .* are due at 1e\+09 s.*start="):
            call()
        assert state_hash(late) == before
        assert late.report.steps == 0


# Steps and their limits.
def test_what_limits_a_step():
    still = {"gravity": (0, 0, 0), "largest_step": 1.0}
    dt, reason = body(**still).step_limit()
    assert reason == "elastic wave"
    assert dt == pytest.approx(0.5 * 0.1 / JELLY.wave_speed, rel=1e-5)
    assert body(cfl=0.25, **still).step_limit()[0] == pytest.approx(dt / 2, rel=1e-5)
    fast = body(**still)
    fast.set_velocities(np.tile([0, -200.0, 0], (len(fast), 1)))
    assert fast.step_limit() == (pytest.approx(0.5 * 0.1 / 200), "particle speed")
    honey = mpm.Fluid(density=1000.0, bulk_modulus=1e3, viscosity=1e3)
    dt, reason = body(materials=honey, **still).step_limit()
    assert reason == "viscosity" and dt == pytest.approx(0.5 * 0.1**2 / 6)
    assert body(materials=honey, n=0, **still).step_limit() == (1.0, "nothing moves")


def test_steps_that_are_too_large_are_refused_or_subdivided():
    simulation = body(largest_step=1.0)
    before = state_hash(simulation)
    limit = simulation.step_limit()[0]
    with pytest.raises(SolverError, match=r"too large: .* the limit of the elastic wave") as caught:
        simulation.step(3 * limit)
    assert caught.value.step == 0 and caught.value.time == 0
    assert state_hash(simulation) == before
    simulation.step(0.99 * limit)
    willing = body(on_large_step="subdivide", largest_step=1.0)
    willing.step(3 * limit)
    assert willing.time == 3 * limit
    assert 3 <= willing.report.steps <= 5 and willing.report.subdivided >= 2


def test_a_run_that_fails_leaves_the_last_good_step():
    """Free fall until a step of this size moves particles by more than a cell."""
    dt = 0.01
    options = {"step": dt, "cfl": 1.0}
    simulation = body(materials=mpm.NeoHookean(1000.0, 1e3, 0.2), **options)
    with pytest.raises(SolverError, match=r"would move by 0\.97\d cells") as caught:
        simulation.advance(5.0)
    good = caught.value.step
    assert good == round(simulation.time / dt) and good > 90
    assert caught.value.time == simulation.time
    again = body(materials=mpm.NeoHookean(1000.0, 1e3, 0.2), **options)
    for _ in range(good):
        again.step(dt)
    assert np.array_equal(again.positions, simulation.positions)
    assert np.array_equal(again.velocities, simulation.velocities)
    with pytest.raises(SolverError, match="would move by"):
        again.step(dt)
    # Shorter steps go on.
    simulation.step(dt / 2)


def test_a_particle_that_is_spoiled_is_named():
    simulation = body()
    F = simulation.deformation_gradients.copy()
    F[100] = np.diag([1.0, -1.0, 1.0])
    simulation.set_deformation_gradients(F)
    before = state_hash(simulation)
    with pytest.raises(NonFiniteError, match="particle 100 is not finite") as caught:
        simulation.advance(0.1)
    assert (caught.value.index, caught.value.step, caught.value.time) == (100, 0, 0.0)
    assert state_hash(simulation) == before


class Alarm(Exception):
    pass


def test_interrupted_runs_end_with_a_complete_step():
    def ring(*_):
        raise Alarm

    simulation = body(n=24, step=2e-4)
    old = signal.signal(signal.SIGALRM, ring)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        with pytest.raises(Alarm):
            simulation.advance(1e6)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, old)
    steps = round(simulation.time / 2e-4)
    assert steps > 0 and simulation.time == pytest.approx(steps * 2e-4, rel=1e-9)
    again = body(n=24, step=2e-4)
    for _ in range(steps):
        again.step(2e-4)
    assert np.array_equal(again.positions, simulation.positions)


# Few particles, and where they may be.
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("dimension", [2, 3])
def test_few_particles(dimension, dtype):
    empty = substep.MaterialPointMethod(
        np.zeros((0, dimension)), JELLY, cell=0.1, volume=np.zeros(0), dtype=dtype
    )
    empty.advance(0.1)
    assert empty.time == 0.1 and empty.positions.shape == (0, dimension)
    assert empty.diagnostics()["mass"] == 0
    one = substep.MaterialPointMethod(
        np.full((1, dimension), 0.123), JELLY, cell=0.1, volume=1e-3, dtype=dtype, cfl=0.01
    )
    one.advance(0.5)
    fall = 0.123 - 9.81 * 0.5**2 / 2
    assert one.positions[0, -1] == pytest.approx(fall, abs=5e-3)
    assert one.positions[0, 0] == pytest.approx(0.123, abs=1e-5)
    many = substep.MaterialPointMethod(
        np.full((40, dimension), 0.2), JELLY, cell=0.1, volume=1e-3, dtype=dtype
    )
    many.advance(0.1)
    assert np.ptp(many.positions, axis=0) == pytest.approx(0, abs=1e-6)


def test_a_particle_thrown_far_away():
    simulation = body(gravity=(0, 0, 0))
    v = np.zeros((len(simulation), 3))
    v[7] = (2e5, -1e5, 3e4)
    simulation.set_velocities(v, simulation.ids)
    others = np.arange(len(simulation)) != 7
    simulation.advance(1e-3)
    assert np.isfinite(simulation.positions).all()
    assert np.abs(simulation.positions[others]).max() < 50
    # Three cells away nothing holds it any more.
    free = body(gravity=(0, 0, 0))
    x = free.positions[7] + (3.0, 0, 0)
    free.set_positions([x], [7])
    free.set_velocities([v[7]], [7])
    free.advance(1e-3)
    assert free.positions[7] == pytest.approx(x + 1e-3 * v[7], rel=3e-5)
    with pytest.raises(InputError, match=r"values\[0\]: expected a point within"):
        free.set_positions([(1e9, 0, 0)], [3])


@pytest.mark.parametrize("policy", ["raise", "remove", "clamp"])
def test_particles_that_leave_the_bounds(policy):
    options = {"bounds": [[0, 0, 0.2], [1, 1, 1]], "on_escape": policy, "step": 2e-3}
    simulation = body(gravity=(0, 0, 0), **options)
    v = np.zeros((len(simulation), 3))
    v[:, 2] = -1.0
    simulation.set_velocities(v)
    lowest = simulation.positions[:, 2].min() - 0.2
    if policy == "raise":
        with pytest.raises(SolverError, match="leaves the bounds") as caught:
            simulation.advance(0.5)
        assert caught.value.step == math.ceil(lowest / 2e-3) - 1
        assert simulation.time == pytest.approx(2e-3 * caught.value.step)
        assert simulation.positions[:, 2].min() >= 0.2
        return
    simulation.advance(0.2)
    assert simulation.positions[:, 2].min() >= 0.2
    if policy == "remove":
        assert simulation.report.removed == 512 - len(simulation) > 50
    else:
        assert len(simulation) == 512 and simulation.report.clamped > 50


# Putting in and taking out.
def test_ids_stay():
    simulation = body(2)
    x = simulation.positions
    simulation.remove([3, 17, 40])
    added = simulation.add([[2.0, 2.0], [2.1, 2.0]], 1e-3, velocities=[[1.0, 0], [0, 1.0]])
    assert added.tolist() == [64, 65]
    kept = np.setdiff1d(np.arange(64), [3, 17, 40])
    assert simulation.ids.tolist() == [*kept, 64, 65]
    assert simulation.positions[:-2] == pytest.approx(x[kept], abs=1e-7)
    assert simulation.velocities[-2:].tolist() == [[1, 0], [0, 1]]
    assert simulation.volumes[-1] == pytest.approx(1e-3)
    assert simulation.diagnostics()["mass"] == pytest.approx(1000 * (61 * 0.05**2 + 2e-3))
    simulation.advance(0.05)
    simulation.set_velocities([[5.0, 6.0]], [65])
    assert simulation.velocities[-1].tolist() == [5, 6]
    assert simulation.ids.tolist() == [*kept, 64, 65]


def test_what_comes_and_goes_is_no_dissipation():
    simulation = body(gravity=(0, 0, 0), dtype="float64")
    simulation.advance(0.02)
    simulation.set_velocities(np.tile([1.0, 2.0, 3.0], (512, 1)))
    simulation.add([[5.0, 5.0, 5.0]], 1e-3, velocities=[[9.0, 0, 0]])
    simulation.remove(np.arange(40))
    values = simulation.diagnostics()
    assert values["kinetic_energy"] > 100
    assert values["dissipated_energy"] == pytest.approx(0, abs=1e-9 * values["kinetic_energy"])
