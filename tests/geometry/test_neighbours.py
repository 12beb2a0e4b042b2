"""Neighbour lists: all pairs, SciPy's k-d tree, and what is refused."""

import hashlib
import itertools

import numpy as np
import pytest
from scipy.spatial import cKDTree
from substep import InputError
from substep.geometry import neighbour_lists

random = np.random.default_rng(3)


def rows(points, radius, **options):
    """The neighbours of each point, ascending."""
    offsets, indices = neighbour_lists(points, radius, **options)
    assert offsets.dtype == np.int64 and indices.dtype == np.int32
    assert offsets[0] == 0 and offsets[-1] == len(indices) and len(offsets) == len(points) + 1
    return [sorted(indices[a:b].tolist()) for a, b in itertools.pairwise(offsets)]


def brute(points, radius, half=False):
    x = np.asarray(points, float)
    near = ((x[:, None] - x) ** 2).sum(-1) < radius**2
    np.fill_diagonal(near, False)
    return [np.flatnonzero(row).tolist() for row in (np.triu(near) if half else near)]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("columns", [2, 3])
@pytest.mark.parametrize("n", [0, 1, 2, 17, 700])
def test_all_pairs(n, columns, dtype):
    x = random.uniform(-1, 1, (n, columns)).astype(dtype)
    for radius in (0.01, 0.3, 4.0):
        assert rows(x, radius) == brute(x, radius)
        assert rows(x, radius, pairs="half") == brute(x, radius, half=True)


@pytest.mark.parametrize("columns", [2, 3])
def test_the_pairs_of_a_kd_tree(columns):
    x = random.uniform(0, 1, (20000, columns))
    radius = {2: 0.012, 3: 0.06}[columns]
    offsets, indices = neighbour_lists(x, radius, pairs="half")
    mine = np.column_stack([np.repeat(np.arange(len(x)), np.diff(offsets)), indices])
    theirs = cKDTree(x).query_pairs(radius, output_type="ndarray")
    assert len(mine) > 5 * len(x) / 2
    assert (mine[np.lexsort(mine.T)] == theirs[np.lexsort(theirs.T)]).all()
    offsets, indices = neighbour_lists(x, radius)
    assert len(indices) == 2 * len(mine)


def test_threads_do_not_matter():
    x = random.uniform(0, 1, (50000, 3)).astype(np.float32)

    def digest(threads):
        parts = neighbour_lists(x, 0.04, threads=threads)
        return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()

    assert len({digest(threads) for threads in (1, 2, 3, 4, None)}) == 1


def test_ten_thousand_in_one_cell():
    x = np.concatenate([random.uniform(0, 1e-3, (10000, 3)), random.uniform(0, 50, (1000, 3))])
    offsets, _ = neighbour_lists(x, 1.0)
    assert (np.diff(offsets)[:10000] >= 9999).all()
    assert len(neighbour_lists(np.zeros((3000, 3)), 1e-3, pairs="half")[1]) == 3000 * 2999 // 2


@pytest.mark.parametrize("columns", [2, 3])
def test_without_bounds(columns):
    clouds = [random.uniform(-1, 1, (100, columns)) for _ in range(5)]
    centers = [0.0, 1e9, -1e9, 3e7, 2.0]
    x = np.concatenate([c + center for c, center in zip(clouds, centers, strict=True)])
    x[400:, 0] += 3e5
    assert rows(x, 0.4) == brute(x, 0.4)
    huge = 2.0**24 * 0.25
    corners = np.array([[huge] * columns, [-huge] * columns, [0.0] * columns], np.float32)
    assert rows(corners, 0.25) == [[], [], []]
    assert rows(np.repeat(corners, 2, 0), 0.25) == [[1], [0], [3], [2], [5], [4]]


def test_the_radius_itself_is_not_near():
    x = [[0.0, 0.0], [1.0, 0.0]]
    assert rows(x, 1.0) == [[], []]
    assert rows(x, np.nextafter(1.0, 2.0)) == [[1], [0]]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 2.0**54])
def test_coordinates_that_are_refused(bad):
    x = random.uniform(0, 1, (100, 3))
    x[42, 1] = bad
    with pytest.raises(InputError, match=r"points\[42"):
        neighbour_lists(x, 1.0)


def test_float32_reaches_to_2_to_the_24_radii():
    x = np.zeros((10, 3), np.float32)
    x[7, 2] = 2.0**25
    with pytest.raises(InputError, match=r"points\[7\].*radius"):
        neighbour_lists(x, 1.0)
    assert neighbour_lists(x, 2.0)[0][-1] == 72
    assert neighbour_lists(x.astype(float), 1.0)[0][-1] == 72


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf, 1e-160, 1e160])
def test_radii_that_are_refused(radius):
    with pytest.raises(InputError, match="radius"):
        neighbour_lists(np.zeros((3, 3)), radius)


def test_other_arguments_that_are_refused():
    with pytest.raises(InputError, match="radius"):
        neighbour_lists(np.zeros((3, 3), np.float32), 1e-30)
    for shape in [(3,), (3, 1), (3, 4), (3, 3, 1), ()]:
        with pytest.raises(InputError, match="points"):
            neighbour_lists(np.zeros(shape), 1.0)
    with pytest.raises(InputError, match="pairs"):
        neighbour_lists(np.zeros((3, 3)), 1.0, pairs="both")
    with pytest.raises(InputError, match="threads"):
        neighbour_lists(np.zeros((3, 3)), 1.0, threads=0)
    with pytest.raises(TypeError, match="radius"):
        neighbour_lists(np.zeros((3, 3)), "1")
