"""Position-based dynamics: the solver, and distances."""

import copy
import math
import os
import signal
import threading
import time

import numpy as np
import pytest
import substep
from substep.pbd import Distance

DTYPES = ("float32", "float64")


def spring(alpha, beta=0.0, **options):
    """A mass of 2 kg that hangs on a spring of 1 m, at rest length, moving down."""
    return substep.PositionBasedDynamics(
        [[0, 0, 0], [0, 0, -1]],
        2.0,
        [Distance([[0, 1]], compliance=alpha, damping=beta)],
        velocities=[[0, 0, 0], [0, 0, -0.3]],
        pinned=[0],
        **{"dtype": "float64", **options},
    )


def cloth_pairs(n):
    """Neighbours along rows, columns and diagonals, and every second vertex."""
    ids = np.arange(n * n).reshape(n, n)
    ends = (
        (ids[:, :-1], ids[:, 1:]),
        (ids[:-1], ids[1:]),
        (ids[:-1, :-1], ids[1:, 1:]),
        (ids[:-1, 1:], ids[1:, :-1]),
        (ids[:, :-2], ids[:, 2:]),
        (ids[:-2], ids[2:]),
    )
    return np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ends])


def cloth(n, shift=0.0, **options):
    """A square metre of cloth that hangs by two corners."""
    compliance = options.pop("compliance", 0.0)
    x = np.linspace(0, 1, n)
    positions = np.stack([np.tile(x, n), np.repeat(x, n), np.zeros(n * n)], axis=1) + shift
    constraint = Distance(cloth_pairs(n), compliance=compliance)
    options = {"pinned": [0, n - 1], **options}
    return substep.PositionBasedDynamics(positions, 0.3 / n**2, [constraint], **options)


def net(particles=3000, pairs=30000, **options):
    """Random pairs of random particles: most are in different patches, and colours are many."""
    random = np.random.default_rng(5)
    x = random.uniform(-1, 1, (particles, 3))
    ends = random.integers(0, particles, (pairs, 2))
    ends = ends[ends[:, 0] != ends[:, 1]]
    return substep.PositionBasedDynamics(
        x,
        random.uniform(0.5, 2, particles),
        [Distance(ends, compliance=1e-3, damping=10.0)],
        velocities=random.uniform(-1, 1, (particles, 3)),
        gravity=(0, 0, 0),
        **options,
    )


def hash_of(sim):
    return substep.state_hash(sim.positions, sim.velocities)


def momentum(sim):
    return sim.masses @ sim.velocities


# Physics


@pytest.mark.parametrize("beta", [0.0, 30.0])
def test_spring_is_implicit_euler(beta):
    """XPBD of one linear constraint is implicit Euler (Macklin et al. 2016, section 4).

    m v' = m v + h (m g - k (x' - l) - c v') with x' = x + h v', in closed form.
    """
    alpha, m, h = 1 / 500, 2.0, 1 / 120
    sim = spring(alpha, beta, substeps=1, iterations=1)
    stretch, v = 0.0, 0.3
    for _ in range(200):
        v = (m * v + h * (m * 9.81 - stretch / alpha)) / (m + h * beta + h * h / alpha)
        stretch += h * v
        sim.step(h)
        assert -sim.positions[1, 2] - 1 == pytest.approx(stretch, abs=1e-12)
        assert -sim.velocities[1, 2] == pytest.approx(v, abs=1e-10)
        assert sim.multipliers()[0] == pytest.approx(-(stretch / alpha + beta * v), rel=1e-9)


def test_iterations_do_not_change_a_spring():
    """Once solved, an equation stays solved: unlike the stiffness of plain PBD."""
    results = []
    for iterations in (1, 7, 40):
        sim = spring(1e-3, 5.0, iterations=iterations)
        sim.advance(0.5)
        results.append(sim.positions[1, 2])
    assert np.ptp(results) < 1e-12


def test_step_does_not_change_the_rest_of_a_spring():
    for step, substeps in ((1 / 30, 1), (1 / 60, 10), (1 / 240, 3)):
        sim = spring(1e-3, 60.0, step=step, substeps=substeps)
        sim.advance(6.0)
        assert -sim.positions[1, 2] - 1 == pytest.approx(2.0 * 9.81 * 1e-3, rel=1e-6)


@pytest.mark.parametrize(("substeps", "iterations"), [(1, 80), (10, 10), (100, 1)])
def test_chain_carries_its_weight(substeps, iterations):
    """Link j stretches by alpha times the weight below it, once the residual is below 1e-4."""
    links, alpha, mass = 10, 1e-4, 0.5
    x = np.zeros((links + 1, 3))
    x[:, 2] = -0.1 * np.arange(links + 1)
    chain = [[k, k + 1] for k in range(links)]
    sim = substep.PositionBasedDynamics(
        x,
        mass,
        [Distance(chain, compliance=alpha)],
        pinned=[0],
        drag=4.0,
        substeps=substeps,
        iterations=iterations,
        dtype="float64",
    )
    sim.advance(5.0)
    assert sim.diagnostics()["residual"] < 1e-4
    below = mass * 9.81 * (links - np.arange(links))
    np.testing.assert_allclose(sim.values(), alpha * below, rtol=0.01)


def test_pins_carry_the_weight_of_cloth():
    n = 12
    sim = cloth(n, dtype="float64", compliance=1e-5, drag=3.0, iterations=4)
    sim.advance(12.0)
    x, pairs, pulls = sim.positions, cloth_pairs(n), sim.multipliers()
    along = x[pairs[:, 0]] - x[pairs[:, 1]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    force = np.zeros_like(x)  # lambda / h^2 grad C
    np.add.at(force, pairs[:, 0], pulls[:, None] * along)
    np.add.at(force, pairs[:, 1], -pulls[:, None] * along)
    weight = 9.81 * sim.masses[~sim.pinned].sum()
    reaction = -force[sim.pinned].sum(axis=0)
    np.testing.assert_allclose(reaction, [0, 0, weight], atol=2e-3 * weight)
    resting = force[~sim.pinned, 2] - 9.81 * sim.masses[~sim.pinned]
    assert np.abs(resting).max() < 0.02 * weight


@pytest.mark.parametrize("solver", ["gauss_seidel", "jacobi"])
def test_momentum_is_kept(solver):
    sim = net(300, 900, solver=solver, dtype="float64")
    start = momentum(sim)
    sim.advance(0.5)
    np.testing.assert_allclose(momentum(sim), start, atol=1e-9)
    assert np.abs(sim.velocities - start / sim.masses.sum()).max() > 0.1


def test_energy_of_a_spring_is_in_the_diagnostics():
    sim = spring(1 / 500, gravity=(0, 0, 0))
    sim.set_positions([[0, 0, -1.2]], ids=[1])
    values = sim.diagnostics()
    assert values["elastic_energy"] == pytest.approx(0.5 * 500 * 0.2**2)
    assert values["kinetic_energy"] == pytest.approx(0.5 * 2 * 0.3**2)
    assert values["strain"] == pytest.approx(0.2)
    assert values["momentum_z"] == pytest.approx(-0.6)


def test_pendulum_keeps_its_length_and_energy():
    sim = substep.PositionBasedDynamics(
        [[0, 0, 0], [1, 0, 0]], 1.0, [Distance([[0, 1]])], pinned=[0], substeps=100, dtype="float64"
    )
    for _ in range(60):
        sim.step(1 / 60)
        assert np.linalg.norm(sim.positions[1]) == pytest.approx(1.0, abs=1e-9)
    energy = sim.diagnostics()
    # From the height 0 at rest; the error is of the first order of the substep.
    assert energy["kinetic_energy"] + energy["gravitational_energy"] == pytest.approx(0, abs=0.15)


def test_substeps_leave_less_strain_than_iterations():
    """Macklin et al. 2019: the same number of projections is better spent on small steps."""
    strain = {}
    for substeps, iterations in ((10, 1), (1, 10)):
        sim = cloth(40, substeps=substeps, iterations=iterations)
        sim.advance(0.5)
        strain[substeps] = sim.diagnostics()["strain"]
    assert strain[10] < 0.5 * strain[1]


@pytest.mark.parametrize("iterations", [1, 4, 16])
def test_plain_stiffness_does_not_depend_on_iterations(iterations):
    """A part 1 - k of the error is left after a step (Mueller et al. 2007, section 3.3)."""
    sim = substep.PositionBasedDynamics(
        [[0, 0, 0], [0, 0, -1.5]],
        1.0,
        [Distance([[0, 1]], 1.0, stiffness=0.7)],
        gravity=(0, 0, 0),
        substeps=1,
        iterations=iterations,
        dtype="float64",
    )
    sim.step(0.01)
    assert sim.values()[0] == pytest.approx(0.3 * 0.5, rel=1e-12)


def test_jacobi_finds_what_gauss_seidel_finds():
    ends = {}
    for solver, relaxation, iterations in (
        ("gauss_seidel", 1.0, 60),
        ("jacobi", 1.0, 900),
        ("jacobi", 1.8, 500),
    ):
        sim = cloth(
            6,
            dtype="float64",
            compliance=1e-3,
            solver=solver,
            relaxation=relaxation,
            iterations=iterations,
            substeps=2,
        )
        sim.advance(0.2)
        assert sim.diagnostics()["residual"] < 3e-5
        ends[solver, relaxation] = sim.positions
    want = ends["gauss_seidel", 1.0]
    np.testing.assert_allclose(ends["jacobi", 1.0], want, atol=1e-4)
    np.testing.assert_allclose(ends["jacobi", 1.8], want, atol=1e-4)


def test_a_compliance_for_each():
    """Two springs side by side, of different stiffness, stretch each as it must."""
    sim = substep.PositionBasedDynamics(
        [[0, 0, 0], [0, 0, -1], [1, 0, 0], [1, 0, -1]],
        [1.0, 1.0, 1.0, 3.0],
        [Distance([[0, 1], [2, 3]], compliance=[1e-3, 2e-3], damping=[40.0, 60.0])],
        pinned=[True, False, True, False],
        dtype="float64",
    )
    sim.advance(5.0)
    np.testing.assert_allclose(sim.values(), [9.81e-3, 3 * 9.81 * 2e-3], rtol=1e-5)


# Particles


def test_free_particles_fall():
    for dtype in DTYPES:
        sim = substep.PositionBasedDynamics(
            np.zeros((5, 3)), 1.0, velocities=np.full((5, 3), 2.0), dtype=dtype
        )
        sim.advance(1.0)
        # Symplectic Euler with 600 substeps: (1 + 1/600) g / 2.
        want = [2.0, 2.0, 2.0 - 9.81 / 2 * (1 + 1 / 600)]
        np.testing.assert_allclose(sim.positions, np.tile(want, (5, 1)), rtol=1e-5)
        assert sim.time == 1.0


def test_pinned_particles_go_to_their_targets():
    sim = cloth(5)
    corner = sim.positions[0] + [0.1, 0.0, 0.2]
    sim.set_targets([corner], ids=[0])
    sim.step(0.1)
    np.testing.assert_allclose(sim.positions[0], corner, atol=1e-7)
    np.testing.assert_allclose(sim.velocities[0], [1, 0, 2], atol=1e-5)
    sim.step(0.1)
    np.testing.assert_allclose(sim.positions[0], corner, atol=1e-7)
    np.testing.assert_allclose(sim.velocities[0], 0, atol=1e-5)
    sim.pinned = [4]
    assert sim.pinned.nonzero()[0].tolist() == [4]
    still = sim.positions[4]
    sim.advance(0.5)
    assert (sim.positions[4] == still).all()
    assert sim.positions[0, 2] < corner[2] - 0.1


def test_forces_act_for_one_step():
    sim = substep.PositionBasedDynamics([[0.0, 0, 0], [1, 0, 0]], 2.0, gravity=(0, 0, 0))
    sim.set_forces([[4, 0, 0]], ids=[1])
    assert sim.forces.tolist() == [[0, 0, 0], [4, 0, 0]]
    sim.step(0.5)
    np.testing.assert_allclose(sim.velocities, [[0, 0, 0], [1, 0, 0]], rtol=1e-6)
    assert not sim.forces.any()
    sim.step(0.5)
    np.testing.assert_allclose(sim.velocities, [[0, 0, 0], [1, 0, 0]], rtol=1e-6)


def test_damping_is_a_rate():
    sim = substep.PositionBasedDynamics(
        [[0.0, 0, 0]], 1.0, velocities=[[1, 0, 0]], gravity=(0, 0, 0), drag=2.0
    )
    sim.advance(1.0)
    assert sim.velocities[0, 0] == pytest.approx(math.exp(-2), rel=1e-4)


def test_two_dimensions():
    sim = substep.PositionBasedDynamics(
        [[0, 0], [1, 0]], 1.0, [Distance([[0, 1]])], pinned=[0], dtype="float64"
    )
    sim.advance(0.7)
    assert sim.positions.shape == sim.velocities.shape == (2, 2)
    assert np.linalg.norm(sim.positions[1]) == pytest.approx(1, abs=1e-9)
    assert sim.positions[1, 1] < -0.5
    assert sim.gravity.tolist() == [0, -9.81]


def test_none_and_one():
    empty = substep.PositionBasedDynamics(np.zeros((0, 3)), 1.0, [Distance(np.zeros((0, 2), int))])
    empty.advance(0.1)
    assert empty.positions.shape == (0, 3)
    assert empty.diagnostics()["speed"] == 0
    one = substep.PositionBasedDynamics([[0, 0, 0]], 1.0)
    one.step(0.1)
    assert one.positions[0, 2] < 0
    assert one.step_limit()[0] == math.inf


# Determinism


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("solver", ["gauss_seidel", "jacobi"])
def test_threads_do_not_change_bits(solver, dtype):
    hashes = set()
    for threads in (1, 2, 3, 4):
        sims = (
            cloth(90, threads=threads, solver=solver, dtype=dtype),
            net(9000, 40000, threads=threads, solver=solver, dtype=dtype, iterations=2),
        )
        for sim in sims:
            for _ in range(3):
                sim.step()
        hashes.add(tuple(hash_of(sim) for sim in sims))
    assert len(hashes) == 1


@pytest.mark.parametrize("dtype", DTYPES)
def test_checkpoint_and_copy_go_on_with_the_same_bits(dtype, tmp_path):
    def fresh():
        return cloth(20, dtype=dtype, compliance=1e-4, iterations=2)

    sim = fresh()
    sim.set_targets([[0.1, 0.2, 0.3]], ids=[0])
    sim.advance(0.1)
    sim.set_forces([[0, 0.1, 0]], ids=[77])
    sim.save(tmp_path / "a")
    twin, deep = sim.copy(), copy.deepcopy(sim)
    other = fresh()
    other.load(tmp_path / "a")
    assert other.time == twin.time == sim.time
    for each in (sim, twin, deep, other):
        each.advance(0.1)
    assert len({hash_of(each) for each in (sim, twin, deep, other)}) == 1
    twin.advance(0.1)
    assert hash_of(twin) != hash_of(sim)


def test_restore_refuses_other_states():
    sim = cloth(4)
    state = sim.state()
    before = hash_of(sim)
    for wrong in ({"time": math.nan}, {"positions": np.zeros((3, 3))}, {"origin": np.ones(3)}):
        with pytest.raises(substep.InputError, match="state"):
            sim.restore({**state, **wrong})
    with pytest.raises(substep.InputError, match="missing"):
        sim.restore({"time": 0.0})
    with pytest.raises(substep.InputError, match=r"forces.*beyond float32"):
        sim.restore({**state, "forces": np.full_like(state["forces"], 1e300)})
    assert hash_of(sim) == before
    flat = substep.PositionBasedDynamics([[0.0, 0], [1, 0]], 1.0)
    good = flat.state()
    for name in ("positions", "velocities", "forces"):
        wrong = good[name].copy()
        wrong[1, 2] = 1
        with pytest.raises(substep.InputError, match=rf"{name}.*\[1\]: expected 0 across"):
            flat.restore({**good, name: wrong})
    flat.restore({**good, "pinned": np.ones(2, np.uint8)})  # they rest where they are
    flat.step()
    assert np.array_equal(flat.positions, [[0, 0], [1, 0]])


def test_far_from_the_origin_is_the_same():
    """1000 m away, 100 steps: float32 positions are relative to an origin."""
    near, far = cloth(20), cloth(20, shift=np.array([1000.0, -1000.0, 1000.0]))
    for _ in range(100):
        near.step()
        far.step()
    moved = far.positions - [1000.0, -1000.0, 1000.0]
    assert np.abs(moved - near.positions).max() < 1e-3 / 19


# Wrong and degenerate input

X = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]


def small(**changes):
    arguments = {"positions": X, "masses": 1.0, "constraints": [Distance([[0, 1], [1, 2]])]}
    arguments |= changes
    return substep.PositionBasedDynamics(
        arguments.pop("positions"), arguments.pop("masses"), **arguments
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"positions": [[0.0, 0, 0], [0, np.nan, 0], [0, 0, 0]]}, r"positions\[1, 1\]"),
        ({"positions": [[0.0, 0, 0, 0]]}, "positions: expected shape"),
        ({"positions": [[0.0, 0, 1e39]] * 3}, "positions.*beyond float32"),
        ({"velocities": [[0, 0, 0]]}, "velocities: expected shape"),
        ({"velocities": [[0, 0, np.inf]] * 3}, r"velocities\[0, 2\]"),
        ({"masses": 0.0}, r"masses\[0\]: expected a number above 0"),
        ({"masses": [1.0, -1.0, 1.0]}, r"masses\[1\]"),
        ({"masses": [1.0, 1.0, np.nan]}, r"masses\[2\]"),
        ({"masses": [1.0, 1.0]}, "masses: expected shape"),
        ({"pinned": [3]}, r"pinned\[0\]"),
        ({"constraints": [Distance([[0, 3]])]}, r"pairs\[0, 1\]: expected an index from 0 to 2"),
        ({"gravity": (0, 0)}, "gravity: expected shape"),
        ({"substeps": 0}, "substeps"),
        ({"substeps": 1.5}, "substeps"),
        ({"iterations": 0}, "iterations"),
        ({"iterations": True}, "iterations"),
        ({"solver": "magic"}, "solver: expected one of"),
        ({"relaxation": 0.0}, "relaxation"),
        ({"relaxation": 2.0}, "relaxation"),
        ({"drag": -1.0}, "drag"),
        ({"contact_margin": 0.0}, "contact_margin"),
        ({"step": 0.0}, "step"),
        ({"dtype": "float16"}, "dtype: expected float32 or float64"),
        ({"dtype": "no"}, "dtype: expected float32 or float64"),
        ({"time": np.nan}, "time"),
        ({"threads": 0}, "threads"),
    ],
)
def test_refused_by_name(changes, message):
    with pytest.raises(substep.InputError, match=message):
        small(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"pairs": [[0, 0]]}, r"pairs\[0\]: expected different indices"),
        ({"pairs": [[0, -1]]}, r"pairs\[0, 1\]"),
        ({"pairs": np.array([[0, 2**63]], np.uint64)}, r"pairs\[0, 1\]"),
        ({"pairs": [[0, 2**31]]}, r"pairs\[0, 1\]"),
        ({"pairs": [[0.0, 1.0]]}, "pairs: expected integers"),
        ({"pairs": [[0, 1, 2]]}, r"pairs: expected shape \(n, 2\)"),
        ({"compliance": -1e-9}, "compliance"),
        ({"compliance": np.nan}, "compliance"),
        ({"compliance": np.inf}, "compliance"),
        ({"compliance": [0.0, 0.0]}, "compliance: expected shape"),
        ({"compliance": 1.0, "damping": -1.0}, "damping"),
        ({"damping": 1.0}, "damping: expected a compliance above 0"),
        ({"stiffness": 1.5}, "stiffness: expected a number from 0 to 1"),
        ({"stiffness": -0.5}, "stiffness"),
        ({"stiffness": 0.5, "compliance": 1.0}, "stiffness: plain PBD has neither"),
        ({"rest_lengths": -1.0}, "rest_lengths"),
        ({"rest_lengths": [np.nan]}, r"rest_lengths\[0\]"),
    ],
)
def test_refused_distances(changes, message):
    with pytest.raises(substep.InputError, match=message):
        Distance(changes.pop("pairs", [[0, 1]]), **changes)


def test_refused_types():
    with pytest.raises(TypeError, match=r"constraints\[0\]"):
        small(constraints=["bend"])
    with pytest.raises(TypeError, match=r"colliders\[0\]"):
        small(colliders=["floor"])


@pytest.mark.parametrize("dt", [0.0, -0.01, np.nan, np.inf])
def test_wrong_steps(dt):
    sim = small()
    before = hash_of(sim)
    with pytest.raises(substep.InputError, match="dt"):
        sim.step(dt)
    with pytest.raises(substep.InputError, match="duration"):
        sim.advance(-1.0)
    assert hash_of(sim) == before
    assert sim.time == 0


@pytest.mark.parametrize("dt", [1e-320, 1e-30, 1e300])
def test_extreme_steps_end_well(dt):
    for dtype in DTYPES:
        sim = small(dtype=dtype)
        before = hash_of(sim)
        try:
            sim.step(dt)
            assert np.isfinite(sim.positions).all()
            assert np.isfinite(sim.velocities).all()
        except substep.SubstepError:
            assert hash_of(sim) == before


def test_setters_refuse_and_change_nothing():
    sim = small()
    before = hash_of(sim)
    for call in (sim.set_positions, sim.set_velocities, sim.set_forces, sim.set_targets):
        with pytest.raises(substep.InputError, match=r"values\[0, 2\]"):
            call([[0, 0, np.nan]], ids=[0])
        with pytest.raises(IndexError, match=r"ids\[1\]"):
            call([[0, 0, 0]] * 2, ids=[0, 3])
        with pytest.raises(substep.InputError, match="values: expected shape"):
            call([[0, 0, 0]])
    with pytest.raises(substep.InputError, match="constraint"):
        sim.values(1)
    with pytest.raises(substep.InputError, match="constraint"):
        sim.multipliers(-1)
    assert hash_of(sim) == before


@pytest.mark.parametrize("dtype", DTYPES)
def test_coincident_points_are_skipped_and_counted(dtype):
    sim = substep.PositionBasedDynamics(
        [[0, 0, 0], [0, 0, 0], [1, 0, 0], [2, 0, 0]],
        1.0,
        [Distance([[0, 1], [2, 3]], [0.5, 1.0])],
        gravity=(0, 0, 0),
        dtype=dtype,
    )
    sim.step(0.01)
    assert np.isfinite(sim.positions).all()
    assert sim.diagnostics()["skipped"] == 10
    sim.set_positions([[0.1, 0, 0]], ids=[0])
    sim.step(0.01)
    assert sim.diagnostics()["skipped"] == 0
    assert abs(sim.values()[0]) < 0.4


@pytest.mark.parametrize("compliance", [0.0, 1e-3])
def test_all_pinned_stay(compliance):
    sim = small(
        pinned=[0, 1, 2], constraints=[Distance([[0, 1], [1, 2]], 5.0, compliance=compliance)]
    )
    before = sim.positions
    sim.advance(0.1)
    assert (sim.positions == before).all()
    assert sim.diagnostics()["skipped"] == 0


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("compliance", [0.0, 1e-6])
def test_stretched_a_million_times(dtype, compliance):
    sim = substep.PositionBasedDynamics(
        [[0, 0, 0], [1e6, 0, 0], [0, 1e6, 0]],
        1.0,
        [Distance([[0, 1], [1, 2], [2, 0]], 1.0, compliance=compliance)],
        dtype=dtype,
    )
    sim.advance(0.5)
    assert np.isfinite(sim.positions).all()
    sim = small(masses=[1e-6, 1.0, 1e6], dtype=dtype)  # 1e12 apart
    sim.advance(0.5)
    assert np.isfinite(sim.positions).all()


@pytest.mark.parametrize("threads", [1, 2])
def test_a_failed_step_changes_nothing(threads):
    sim = cloth(80, threads=threads)
    sim.advance(0.05)
    sim.set_velocities([[1e37, 0, 0]], ids=[4321])
    state = sim.state()
    with pytest.raises(substep.NonFiniteError, match="particle") as caught:
        sim.step(1.0)
    assert caught.value.time > state["time"]
    assert 0 <= caught.value.index < len(sim)
    after = sim.state()
    assert all(np.array_equal(after[name], state[name]) for name in state)
    sim.set_velocities([[0, 0, 0]], ids=[4321])
    sim.step()
    assert np.isfinite(sim.positions).all()


def test_one_object_in_two_threads_is_refused():
    sim = cloth(60, substeps=2000)
    failed = []

    def run():
        try:
            sim.step()
        except substep.InputError as error:
            failed.append(str(error))

    others = [threading.Thread(target=run) for _ in range(3)]
    for other in others:
        other.start()
    for other in others:
        other.join()
    assert len(failed) == 2
    assert "in use by another thread" in failed[0]


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("threads", [1, 2])
def test_interrupt_leaves_the_last_step(threads):
    sim = cloth(60, substeps=10**6, threads=threads)
    before = hash_of(sim)
    timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    start = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        sim.step()
    assert time.perf_counter() - start < 2.0
    timer.join()
    assert hash_of(sim) == before
    assert sim.time == 0
