"""Particles of the material point method that fill boxes, spheres and meshes."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import substep
from scipy.spatial import cKDTree
from substep import InputError
from substep.mpm import sample_box, sample_mesh, sample_sphere

MESHES = Path(__file__).parents[3] / "shared/data/meshes"
PATTERNS = ("jittered", "poisson")
CLOSEST = {2: 0.6133 ** (1 / 2), 3: 0.6037 ** (1 / 3)}  # spacings, of Poisson-disk samples


@pytest.mark.parametrize("jitter", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("dimension", [2, 3])
def test_jittered_particles_have_one_cell_each(dimension, jitter):
    """The sides are no multiples of the spacing: the cells are stretched to fill the box."""
    low, high = np.array([0.1, -2.0, 3.0])[:dimension], np.array([1.13, -1.2, 3.52])[:dimension]
    x, volumes = sample_box(low, high, 0.1, jitter=jitter)
    counts = np.array([10, 8, 5])[:dimension]
    sides = (high - low) / counts
    cells = np.floor((x - low) / sides).astype(int)
    assert len(x) == counts.prod() == len(np.unique(cells, axis=0))
    assert ((cells >= 0) & (cells < counts)).all()
    away = np.abs((x - low) / sides - cells - 0.5)
    assert away.max() <= 0.5 * jitter + 1e-9
    assert away.max() >= 0.45 * jitter
    assert (volumes == volumes[0]).all()
    assert volumes.sum() == pytest.approx(np.prod(high - low))


@pytest.mark.parametrize("seed", [0, 7, 2**64 - 1])
@pytest.mark.parametrize("dimension", [2, 3])
def test_poisson_disk_samples_keep_apart_and_leave_no_gaps(dimension, seed):
    h, side = 0.05, {2: 2.0, 3: 0.8}[dimension]
    low = -0.3 * np.ones(dimension)
    x, volumes = sample_box(low, low + side, h, pattern="poisson", seed=seed)
    assert ((x >= low) & (x <= low + side)).all()
    apart = cKDTree(x).query(x, 2)[0][:, 1].min()
    assert CLOSEST[dimension] * h <= apart < 1.01 * CLOSEST[dimension] * h
    # As many as the spacing says, also along the walls; none could be put into any gap.
    assert volumes[0] == pytest.approx(h**dimension, rel=0.03)
    along = ((x < low + h) | (x > low + side - h)).any(axis=1).sum()
    shell = side**dimension - (side - 2 * h) ** dimension
    assert along * h**dimension == pytest.approx(shell, rel=0.08)
    inner = np.random.default_rng(0).uniform(low + h, low + side - h, (20000, dimension))
    assert cKDTree(x).query(inner)[0].max() < 1.2 * h


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_poisson_disk_samples_have_no_lattice(axis):
    """Their cells are sampled in groups of every third: that must not be seen."""
    x, _ = sample_box((0, 0, 0), (1.2, 1.2, 1.2), 0.05, pattern="poisson", seed=3)
    period = 3 * CLOSEST[3] * 0.05 / np.sqrt(3)
    assert abs(np.exp(2j * np.pi * x[:, axis] / period).mean()) < 0.04


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("dimension", [2, 3])
def test_spheres(dimension, pattern):
    center, radius, h = np.array([1.0, 2.0, -3.0])[:dimension], 0.5, 0.04
    x, volumes = sample_sphere(center, radius, h, pattern=pattern)
    assert np.linalg.norm(x - center, axis=1).max() <= radius
    volume = np.pi * radius**2 if dimension == 2 else 4 / 3 * np.pi * radius**3
    assert volumes.sum() == pytest.approx(volume, rel=1e-12)
    assert volumes[0] == pytest.approx(h**dimension, rel=0.04)
    assert np.abs(x.mean(axis=0) - center).max() < 0.02 * radius
    second = ((x - center) ** 2).mean()  # of inertia: d/(d + 2) R^2 / d per axis
    assert second == pytest.approx(radius**2 / (dimension + 2), rel=0.02)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_meshes(pattern):
    cube = substep.geometry.box_mesh((0.6, 0.4, 0.5))
    middle = (cube.vertices.min(axis=0) + cube.vertices.max(axis=0)) / 2
    x, volumes = sample_mesh(cube, 0.03, pattern=pattern)
    assert np.abs((x - middle) / [0.3, 0.2, 0.25]).max() <= 1
    assert volumes.sum() == pytest.approx(0.12, rel=1e-12)
    assert volumes[0] == pytest.approx(0.03**3, rel=0.06)
    # Without its lid it has no volume of its own; inside stays inside.
    open_cube = substep.geometry.TriangleMesh(cube.vertices, cube.faces[:-1])
    y, volumes = sample_mesh(open_cube, 0.03, pattern=pattern)
    assert (volumes == 0.03**3).all()
    assert len(y) == pytest.approx(len(x), rel=0.15)


def test_a_bunny_with_holes_is_filled():
    path = MESHES / "stanford-bunny.obj"
    if not path.exists():
        pytest.skip("shared/data/meshes is not here")
    mesh = substep.geometry.read_mesh(path)
    h = np.ptp(mesh.vertices, axis=0).max() / 20
    x, volumes = sample_mesh(mesh, h, pattern="poisson")
    assert (mesh.signed_distance(x) < 0).all()
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    drawn = np.random.default_rng(4).uniform(low, high, (15000, 3))
    volume = (mesh.signed_distance(drawn) < 0).mean() * np.prod(high - low)
    assert volumes.sum() == pytest.approx(volume, rel=0.04)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_the_same_seed_gives_the_same_particles(pattern):
    def hashes(seed, threads):
        ball = substep.geometry.sphere_mesh(subdivisions=2)
        options = {"pattern": pattern, "seed": seed, "threads": threads}
        return substep.state_hash(
            *sample_box((0, 0), (1, 1), 0.05, **options),
            *sample_sphere((0, 0, 0), 0.5, 0.05, **options),
            *sample_mesh(ball, 0.2, **options),
        )

    assert len({hashes(1, threads) for threads in (1, 2, 3)}) == 1
    assert len({hashes(seed, 2) for seed in range(3)}) == 3


BOX = {"low": (0, 0, 0), "high": (1, 1, 1), "spacing": 0.25}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"high": (1, 1)}, "high: expected shape"),
        ({"high": (1, 0, 1)}, "high: expected numbers above those of low"),
        ({"low": (0, np.nan, 0)}, r"low\[1\]: expected finite"),
        ({"spacing": 0.0}, "spacing: expected a number above 0"),
        ({"spacing": -1.0}, "spacing: expected a number above 0"),
        ({"spacing": np.nan}, "spacing: expected a finite number"),
        ({"spacing": 1e-5}, "spacing: it gives a lattice of 1.0e.15 points"),
        ({"spacing": 1e-5, "pattern": "poisson"}, "spacing: 1e-05 gives more than"),
        ({"pattern": "halton"}, "pattern: expected one of jittered, poisson"),
        ({"jitter": -0.1}, "jitter: expected a number of at least 0"),
        ({"jitter": 1.5}, "jitter: expected a number from 0 to 1"),
        ({"seed": -1}, "seed: expected an integer"),
        ({"seed": 0.5, "pattern": "poisson"}, "seed: expected an integer"),
        ({"threads": 0, "pattern": "poisson"}, "threads: expected an integer from 1 to 1024"),
    ],
)
def test_boxes_refuse(wrong, message):
    with pytest.raises(InputError, match=message):
        sample_box(**(BOX | wrong))


def test_nothing_inside_is_refused():
    with pytest.raises(InputError, match="radius: no point lies inside"):
        sample_sphere((0.01, 0, 0), 1e-3, 0.5, jitter=1.0)
    with pytest.raises(InputError, match="radius: expected a number above 0"):
        sample_sphere((0, 0), 0.0, 0.1)
    flat = substep.geometry.grid_mesh(4, 4)
    with pytest.raises(InputError, match="mesh: no point lies inside"):
        sample_mesh(flat, 0.1)
    with pytest.raises(TypeError, match="mesh: expected a TriangleMesh"):
        sample_mesh(np.zeros((3, 3)), 0.1)


def test_a_step_whose_outflow_is_refused_changes_nothing():
    """A step that the spacing of a late clock parts in two was left half done."""
    tap = substep.Emitter((0, 0, 0), (0, 0, 1), 2.0, size=(1e-320, 0.3))
    points = np.random.default_rng(0).random((9, 3))
    material = substep.mpm.Fluid(1000.0, 1e5)
    simulation = substep.MaterialPointMethod(
        points, material, cell=0.1, volume=1e-4, emitters=[tap], emitter_spacing=0.05
    )
    simulation.restore({**simulation.state(), "time": 1e9})
    for take in (simulation.step, lambda: simulation.step(1e-3)):
        before = pickle.dumps(simulation.state())
        with pytest.raises(substep.SolverError, match="beyond the bounds"):
            take()
        assert pickle.dumps(simulation.state()) == before
