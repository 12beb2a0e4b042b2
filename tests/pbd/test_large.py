"""Position-based dynamics of large cloth: the solver on several levels."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
import substep
from substep.errors import InputError
from substep.pbd import Distance, PositionBasedDynamics


def square(n, *, jitter=0.0, seed=0):
    """Positions of n x n particles on a square of 1 m, and pairs: stretch, shear, then bending."""
    index = np.arange(n * n, dtype=np.int32).reshape(n, n)
    near = [
        (index[:, :-1], index[:, 1:]),
        (index[:-1], index[1:]),
        (index[:-1, :-1], index[1:, 1:]),
        (index[:-1, 1:], index[1:, :-1]),
    ]
    far = [(index[:, :-2], index[:, 2:]), (index[:-2], index[2:])]
    pairs = [np.stack([a.ravel(), b.ravel()], axis=1) for a, b in near + far]
    u = np.linspace(0, 1, n)
    x = np.stack([np.tile(u, n), np.repeat(u, n), np.zeros(n * n)], axis=1)
    move = np.random.default_rng(seed).uniform(-0.5, 0.5, (n * n, 2)) * jitter / (n - 1)
    move[[0, n - 1]] = 0
    x[:, :2] += move
    return x, np.concatenate(pairs), sum(len(p) for p in pairs[:4])


def cloth(n, solver="multilevel", *, masses=None, jitter=0.0, pins=True, **options):
    """A cloth of 0.3 kg that hangs by two corners from flat, and its rms strain as a function."""
    x, pairs, near = square(n, jitter=jitter)
    rest = np.linalg.norm(x[pairs[:, 0]] - x[pairs[:, 1]], axis=1)
    sim = PositionBasedDynamics(
        x,
        0.3 / n**2 if masses is None else masses,
        [Distance(pairs, rest)],
        pinned=[0, n - 1] if pins else [],
        solver=solver,
        substeps=options.pop("substeps", 5 if solver == "multilevel" else 10),
        **options,
    )

    def strain():
        ends = sim.positions[pairs[:near]]
        lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        return float(np.sqrt(np.mean((lengths / rest[:near] - 1) ** 2)))

    return sim, strain


def run(sim, frames=30):
    for _ in range(frames):
        sim.step(1 / 60)


def digest(sim):
    return hashlib.sha256(sim.positions.tobytes() + sim.velocities.tobytes()).hexdigest()


def test_strain_of_a_large_hanging_cloth_is_far_below_that_of_sweeps():
    # No more work than ten sweeps a frame: four, each with levels that cost as much again.
    sweeps, strain_of_sweeps = cloth(300, "gauss_seidel")
    levels, strain = cloth(300, substeps=4)
    run(sweeps)
    run(levels)
    assert strain_of_sweeps() > 0.5
    assert strain() < 0.02  # measured: 0.008
    assert strain_of_sweeps() > 30 * strain()


def test_strain_does_not_grow_with_the_number_of_particles():
    left = []
    for n in (60, 120, 240):
        sim, strain = cloth(n)
        run(sim)
        left.append(strain())
    assert max(left) < 0.01
    assert max(left) < 2 * min(left)


def test_irregular_cloth_of_unequal_masses():
    masses = 0.3e-4 * np.random.default_rng(1).uniform(1, 10, 10_000)
    sweeps, strain_of_sweeps = cloth(100, "gauss_seidel", masses=masses, jitter=0.7)
    levels, strain = cloth(100, masses=masses, jitter=0.7)
    run(sweeps)
    run(levels)
    assert strain_of_sweeps() > 8 * strain()


def test_goes_to_the_solution_that_sweeps_go_to():
    # The levels change how fast it is found, not which it is, but for the folds that stay open.
    sweeps, strain_of_sweeps = cloth(
        24, "gauss_seidel", substeps=5, iterations=400, dtype="float64"
    )
    levels, strain = cloth(24, iterations=40, dtype="float64")
    run(sweeps, 15)
    run(levels, 15)
    assert strain() < 1e-3
    assert strain_of_sweeps() < 1e-3
    np.testing.assert_allclose(levels.positions, sweeps.positions, atol=0.03)  # of 1.2 m


def test_one_pass_takes_more_away_than_many_sweeps():
    # Once around the loop, from the same predicted positions.
    _, left_by_levels = (pair := cloth(150, substeps=1, dtype="float64"))
    sweeps, left_by_sweeps = cloth(150, "gauss_seidel", substeps=1, iterations=30, dtype="float64")
    x = pair[0].positions.copy()
    x[:, 2] -= 0.3 * x[:, 1]
    for sim in (pair[0], sweeps):
        sim.set_positions(np.where(sim.pinned[:, None], sim.positions, x))
        run(sim, 1)
    assert left_by_levels() < left_by_sweeps()


def test_free_fall_is_exact():
    # Where no constraint is violated the levels do nothing.
    sim, strain = cloth(40, pins=False, dtype="float64")
    start = sim.positions
    run(sim, 30)
    h, k = 1 / 300, 150
    fall = -9.81 * h**2 * k * (k + 1) / 2  # symplectic Euler
    np.testing.assert_allclose(
        sim.positions - start, np.broadcast_to([0, 0, fall], start.shape), atol=1e-9
    )
    assert strain() < 1e-9


def turning(solver):
    masses = 3e-5 * np.random.default_rng(2).uniform(1, 3, 2500)
    sim, _ = cloth(
        50, solver, masses=masses, pins=False, gravity=(0, 0, 0), substeps=5, dtype="float64"
    )
    x = sim.positions
    v = np.stack([0.5 - x[:, 1], x[:, 0] - 0.5, np.sin(9 * x[:, 1]) * np.cos(7 * x[:, 0])], axis=1)
    v[:, :2] *= 2
    v[:, 0] += 0.3 * np.sin(20 * x[:, 0])
    sim.set_velocities(v)
    return sim


def angular_momentum(sim):
    return np.sum(sim.masses[:, None] * np.cross(sim.positions, sim.velocities), axis=0)


def test_momentum_is_kept():
    sim = turning("multilevel")
    before = sim.masses @ sim.velocities
    run(sim)
    np.testing.assert_allclose(sim.masses @ sim.velocities, before, atol=1e-13)


def test_turning_is_damped_no_more_than_by_sweeps():
    # What is lost of it comes from the step, h/2 times the forces at the end of each.
    kept = {}
    for solver in ("gauss_seidel", "multilevel"):
        sim = turning(solver)
        before = angular_momentum(sim)[2]
        run(sim)
        kept[solver] = angular_momentum(sim)[2] / before
    assert kept["multilevel"] == pytest.approx(kept["gauss_seidel"], abs=2e-3)
    assert kept["multilevel"] > 0.98


def test_swing_keeps_its_energy_as_converged_sweeps_do():
    # 400 sweeps a substep leave -0.005 J of 0 at this frame, of 1.4 J that went into motion.
    def energy(sim):
        d = sim.diagnostics()
        return d["kinetic_energy"] + d["gravitational_energy"]

    converged, _ = cloth(40, "gauss_seidel", substeps=5, iterations=300)
    levels, _ = cloth(40)
    run(converged, 25)
    run(levels, 25)
    moving = converged.diagnostics()["kinetic_energy"]
    assert abs(energy(levels) - energy(converged)) < 0.05 * moving


def test_rope_hangs_in_a_catenary_from_a_folded_start():
    # Span 1 m, length 1.5 m: sag 0.50263326 m (2 a sinh(1 / (2 a)) = 1.5).
    n = 151
    s = np.linspace(0, 1.5, n)
    straight = np.stack([s, 0 * s, 0 * s], axis=1)
    fold = np.where(s < 1.25, s, 2.5 - s)  # the end goes back over the last quarter
    start = np.stack([fold, 0 * s, 0 * s], axis=1)
    sim = PositionBasedDynamics(
        start,
        0.01,
        [Distance(np.stack([np.arange(n - 1), np.arange(1, n)], axis=1))],
        pinned=[0, n - 1],
        solver="multilevel",
        rest_positions=straight,
        drag=3.0,
        substeps=10,
        dtype="float64",
    )
    run(sim, 300)
    assert -sim.positions[:, 2].min() == pytest.approx(0.50263326, rel=5e-3)


def test_pins_that_come_together_fold_the_cloth():
    # Coarse constraints do not hold apart what may fold: the edge between the pins sags as far as
    # converged sweeps let it, which is not far after half a second.
    sag = {}
    for solver, iterations in (("gauss_seidel", 200), ("multilevel", 1)):
        sim, strain = cloth(40, solver, iterations=iterations, substeps=5)
        for frame in range(30):
            shift = 0.2 * (frame + 1) / 30
            sim.set_targets([[shift, 0, 0], [1 - shift, 0, 0]], ids=[0, 39])
            sim.step(1 / 60)
        assert strain() < 0.02
        sag[solver] = -sim.positions[:40, 2].mean()
    assert sag["multilevel"] == pytest.approx(sag["gauss_seidel"], rel=0.15)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_same_bits_for_any_number_of_threads(dtype):
    digests = set()
    for threads in (1, 2, 3, 4):
        sim, _ = cloth(120, dtype=dtype, threads=threads)
        run(sim, 4)
        digests.add(digest(sim))
    assert len(digests) == 1


def test_same_bits_through_a_checkpoint_and_a_copy(tmp_path):
    sim, _ = cloth(50)
    run(sim, 5)
    sim.pinned = [0]
    run(sim, 5)
    sim.save(tmp_path / "half.h5")
    twin = sim.copy()
    other, _ = cloth(50)
    run(other, 2)
    other.load(tmp_path / "half.h5")
    for each in (sim, twin, other):
        run(each, 5)
    assert digest(sim) == digest(twin) == digest(other)


def test_let_go_of_pins_falls():
    sim, _ = cloth(50, dtype="float64")
    run(sim, 5)
    sim.pinned = []
    before = sim.masses @ sim.velocities
    run(sim, 6)
    after = sim.masses @ sim.velocities
    np.testing.assert_allclose(after - before, [0, 0, -9.81 * 0.1 * 0.3], atol=1e-12)


def test_moved_by_a_kilometre():
    # 33 particles on a metre and 1024 m: all numbers are exact, so are the differences.
    x, pairs, _ = square(33)
    results = []
    for shift in (0.0, 1024.0):
        sim = PositionBasedDynamics(
            x + shift,
            0.3 / len(x),
            [Distance(pairs)],
            pinned=[0, 32],
            solver="multilevel",
            substeps=5,
        )
        run(sim, 100)
        results.append(sim.positions - shift)
    np.testing.assert_allclose(results[1], results[0], atol=1e-3 / 32)


def test_levels_shrink():
    sim, _ = cloth(200)
    run(sim, 1)
    sizes = np.array(sim._native.level_sizes)
    assert sizes[0] == 40_000
    assert np.all(sizes[1:] < 0.5 * sizes[:-1])
    assert sizes[-1] < 20


def test_mesh_of_triangles_with_bending_on_a_ball():
    # Other groups and colliders act after the levels as after sweeps.
    sheet = substep.geometry.grid_mesh(100, 100)
    x = sheet.vertices - sheet.vertices.mean(axis=0) + [0, 0, 0.31]
    left = {}
    for solver, substeps in (("gauss_seidel", 10), ("multilevel", 5)):
        sim = PositionBasedDynamics(
            x,
            0.3 * sheet.vertex_areas,
            substep.pbd.cloth(sheet, rigidity=1e-6),
            colliders=[substep.Collider(substep.Sphere(0.3), friction=0.5)],
            solver=solver,
            substeps=substeps,
        )
        run(sim, 25)
        ends = sim.positions[sheet.edges]
        rest = x[sheet.edges]
        strain = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        strain = strain / np.linalg.norm(rest[:, 0] - rest[:, 1], axis=1) - 1
        left[solver] = float(np.sqrt(np.mean(strain**2)))
        assert np.linalg.norm(sim.positions, axis=1).min() > 0.2999
    assert left["multilevel"] < 0.4 * left["gauss_seidel"]


def test_in_the_plane():
    n = 200
    x = np.stack([np.linspace(0, 1, n), np.zeros(n)], axis=1)
    rope = Distance(np.stack([np.arange(n - 1), np.arange(1, n)], axis=1))
    left = {}
    for solver, substeps in (("gauss_seidel", 10), ("multilevel", 5)):
        sim = PositionBasedDynamics(x, 1e-3, [rope], pinned=[0], solver=solver, substeps=substeps)
        run(sim, 20)
        lengths = np.linalg.norm(np.diff(sim.positions, axis=0), axis=1)
        left[solver] = np.abs(lengths * (n - 1) - 1).max()
    assert left["multilevel"] < 0.1 * left["gauss_seidel"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"solver": "multilevel", "compliance": 1e-6}, "solver: 'multilevel' needs Distance"),
        ({"solver": "multilevel", "stiffness": 0.5}, "solver: 'multilevel' needs Distance"),
        ({"solver": "gauss_seidel", "rest_positions": np.zeros((3, 3))}, "rest_positions: only"),
        ({"solver": "multilevel", "rest_positions": np.zeros((2, 3))}, "rest_positions: "),
        ({"solver": "multilevel", "rest_positions": np.full((3, 3), np.nan)}, "rest_positions"),
        ({"solver": "multigrid"}, "solver: "),
    ],
)
def test_bad_input(options, message):
    hard = {k: options.pop(k) for k in ("compliance", "stiffness") if k in options}
    rope = Distance([[0, 1], [1, 2]], 1.0, **hard)
    with pytest.raises(InputError, match=message):
        PositionBasedDynamics(np.eye(3), 1.0, [rope], **options)


def test_few_particles_and_degenerate_ones():
    # Nothing to coarsen, particles without constraints, particles in one place: as Gauss-Seidel.
    x = np.zeros((6, 3))
    x[1, 0] = 1
    for solver in ("gauss_seidel", "multilevel"):
        sim = PositionBasedDynamics(
            x,
            1.0,
            [Distance([[0, 1], [0, 2]], [1.0, 0.0])],
            pinned=[0],
            solver=solver,
            dtype="float64",
        )
        run(sim, 3)
        if solver == "gauss_seidel":
            expected = sim.positions
    np.testing.assert_array_equal(sim.positions, expected)
