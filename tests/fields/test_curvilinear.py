"""Curvilinear grids: cells, velocities at corners and on faces, the sphere, land, bad input."""

import pickle

import numpy as np
import pytest
from substep import CurvilinearField, GridField, InputError, advect, state_hash
from substep.fields import ACTIVE, EARTH_RADIUS, ESCAPED, LANDED

rng = np.random.default_rng


def distorted(n, twist=0.08):
    """Corners of n x n cells of the unit square, bent inside."""
    x, y = np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij")
    bend = twist * np.sin(np.pi * x) * np.sin(np.pi * y)
    return x + bend * np.cos(2 * np.pi * y), y + bend * np.sin(2 * np.pi * x)


def annulus(n):
    r, angle = np.meshgrid(np.linspace(1, 2, n + 1), np.linspace(0, 3, 3 * n + 1), indexing="ij")
    return r * np.cos(angle), r * np.sin(angle)


def on_faces(x, y, psi, **options):
    """The C grid field whose flow has the stream function psi at the corners: u = dpsi/dy."""
    values = np.full((*x.shape, 2), np.nan)
    along_j, along_i = (np.hypot(np.diff(x, axis=a), np.diff(y, axis=a)) for a in (1, 0))
    values[:, :-1, 0] = np.diff(psi, axis=1) / along_j
    values[:-1, :, 1] = -np.diff(psi, axis=0) / along_i
    return CurvilinearField(x, y, values, arakawa="C", **options)


class TestCorners:
    def test_linear_velocities_are_exact_on_parallelograms(self):
        i, j = np.meshgrid(np.arange(6.0), np.arange(5.0), indexing="ij")
        x, y = 2 * i + 0.7 * j, -0.4 * i + 1.5 * j
        field = CurvilinearField(x, y, np.stack([3 * x - y, x + 2 * y + 1], axis=-1))
        p = rng(0).uniform([2, 0], [9, 3], (200, 2))
        u = field(0, p)
        inside = np.isfinite(u[:, 0])
        exact = np.stack([3 * p[:, 0] - p[:, 1], p[:, 0] + 2 * p[:, 1] + 1], axis=1)
        assert inside.sum() > 150
        assert np.abs(u - exact)[inside].max() < 1e-12

    def test_error_is_of_second_order(self):
        errors = []
        p = rng(1).uniform(0.2, 2.8, 500)
        p = np.stack([1.5 * np.cos(p), 1.5 * np.sin(p)], axis=1)
        for n in (10, 20, 40):
            x, y = annulus(n)
            u = CurvilinearField(x, y, np.stack([np.sin(x + y), np.cos(2 * x)], axis=-1))(0, p)
            exact = np.stack([np.sin(p.sum(axis=1)), np.cos(2 * p[:, 0])], axis=1)
            errors.append(np.abs(u - exact).max())
        orders = np.log2(np.array(errors[:-1]) / errors[1:])
        assert (orders > 1.8).all() and errors[-1] < 1e-3

    def test_as_a_rectilinear_grid(self):
        axes = np.linspace(0, 1, 7), np.linspace(-1, 1, 9)
        values = rng(2).normal(size=(3, 7, 9, 2))
        values[:, 2:4, 5] = np.nan
        x, y = np.meshgrid(*axes, indexing="ij")
        times = [0.0, 1.0, 2.5]
        ours = CurvilinearField(x, y, values, times)
        theirs = GridField(axes, values, times)
        p = rng(3).uniform([-0.1, -1.1], [1.1, 1.1], (2000, 2))
        for t in (0.0, 0.7, 2.5):
            assert ours(t, p) == pytest.approx(theirs(t, p), abs=1e-12, nan_ok=True)
        one, two = (advect(f, p, (0, 2.5), step=0.05, t_eval=[0, 1, 2.5]) for f in (ours, theirs))
        assert np.array_equal(one.status, two.status)
        assert {ACTIVE, LANDED, ESCAPED} == set(one.status.tolist())
        assert one.positions == pytest.approx(two.positions, abs=1e-9)

    def test_in_space(self):
        x, y = distorted(6)
        z = np.array([0.0, 1.0, 3.0])
        values = np.stack(np.broadcast_arrays(x[..., None] + z, y[..., None] * z, z), axis=-1)
        field = CurvilinearField(x, y, values, z=z)
        p = np.array([[0.3, 0.4, 0.5], [0.6, 0.7, 2.0]])
        u = field(0, p)
        assert u[:, 0] == pytest.approx(p[:, 0] + p[:, 2], abs=1e-12)
        assert u[:, 1] == pytest.approx(p[:, 1] * p[:, 2], abs=1e-12)
        assert u[:, 2] == pytest.approx(p[:, 2], abs=1e-12)
        assert np.isnan(field(0, [[0.3, 0.4, 3.1]])).all()

    def test_cells_without_all_their_corners_are_none(self):
        x, y = distorted(8)
        x[3, 3] = np.nan
        field = CurvilinearField(x, y, np.ones((9, 9, 2)))
        u = field(0, [[3 / 8, 3 / 8], [0.8, 0.8]])
        assert u[:, 0] == pytest.approx([np.nan, 1.0], nan_ok=True)


class TestFaces:
    def test_paths_follow_the_stream_function(self):
        # Its interpolant is bilinear, as that of a field of values at the corners; that is kept
        # exactly in a cell, and by a step across a side, where the velocity jumps, to first order.
        x, y = distorted(16)
        psi = np.sin(np.pi * x) * np.sin(np.pi * y)
        psi[[0, -1]] = psi[:, [0, -1]] = 0
        field = on_faces(x, y, psi)
        of_psi = CurvilinearField(x, y, np.stack([psi, psi], axis=-1))
        start = rng(0).uniform(0.02, 0.98, (500, 2))
        drift = []
        for step in (0.008, 0.002):
            path = advect(field, start, (0, 3), step=step)
            assert (path.status == ACTIVE).all()
            drift.append(np.abs(of_psi(0, path.final) - of_psi(0, start)).max())
        assert drift[1] < 0.02 and drift[1] < 0.4 * drift[0]
        moved = advect(field, start, (0, 1e-4), step=1e-4).final
        error = np.median(np.abs(of_psi(0, moved) - of_psi(0, start)))
        assert error < 1e-13  # most are still in their cells

    def test_none_goes_through_a_coast(self):
        # Uniform flow past an island, whose faces are closed: it takes the flow's own psi.
        x, y = distorted(20)
        psi = y.copy()
        island = (slice(8, 13), slice(8, 13))
        psi[island] = psi[10, 10]
        field = on_faces(x, y, psi)
        start = np.stack([np.full(300, 0.05), np.linspace(0.1, 0.9, 300)], axis=1)
        path = advect(field, start, (0, 0.8), step=0.002)
        assert not (path.status == LANDED).any() and path.final[:, 0].min() > 0.3

    def test_a_cell_without_any_face_is_land(self):
        x, y = distorted(10)
        values = np.ones((11, 11, 2))
        values[4:6, 4] = values[4, 4:6] = np.nan
        values[5, 4, 0] = values[4, 5, 1] = np.nan
        field = CurvilinearField(x, y, values, arakawa="C")
        middle = [[x[4:6, 4:6].mean(), y[4:6, 4:6].mean()], [0.2, 0.2]]
        assert np.isnan(field(0, middle)).all(axis=1).tolist() == [True, False]

    def test_uniform_flow_is_exact(self):
        # On parallelograms the flows through opposite faces are the same.
        i, j = np.meshgrid(np.arange(6.0), np.arange(5.0), indexing="ij")
        x, y = 2 * i + 0.7 * j, 0.3 * i + 1.5 * j
        field = on_faces(x, y, 2 * y + x)  # u = 2, v = -1
        assert field(0, [[5.0, 3.0], [7.0, 4.0]]) == pytest.approx(
            np.array([[2.0, -1.0]] * 2), abs=1e-12
        )

    def test_layers_in_space(self):
        # u and v of a layer, w linear between its faces.
        x, y = distorted(4, twist=0)
        z = np.array([0.0, 1.0, 3.0])
        values = np.zeros((5, 5, 3, 3))
        values[:, :, 0, 0], values[:, :, 1, 0] = 2.0, 5.0
        values[..., 2] = z
        field = CurvilinearField(x, y, values, z=z, arakawa="C")
        u = field(0, [[0.3, 0.3, 0.25], [0.3, 0.3, 2.5]])
        assert u == pytest.approx(np.array([[2.0, 0, 0.25], [5.0, 0, 2.5]]), abs=1e-12)


class TestSphere:
    def rotated(self, n, tilt=30.0):
        """Corners of a grid whose pole is not the Earth's: longitudes from -180 to 180."""
        lon, lat = np.meshgrid(
            np.radians(np.linspace(-180, 180, 2 * n + 1)),
            np.radians(np.linspace(-50, 50, n + 1)),
            indexing="ij",
        )
        p = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
        c, s = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
        p = p @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        return np.degrees(np.arctan2(p[..., 1], p[..., 0])), np.degrees(np.arcsin(p[..., 2]))

    @pytest.mark.parametrize("arakawa", ["A", "C"])
    def test_zonal_flow_keeps_the_latitude(self, arakawa):
        # The test of Delandmeter and van Sebille (2019), section 4.1, on a grid of our own: on the
        # C grid the flow between the corners is that of a stream function, so exact up to the
        # bilinear interpolation of the latter.
        drift = []
        for n in (40, 80):
            lon, lat = self.rotated(n)
            speed, radius = 1.0, EARTH_RADIUS
            if arakawa == "A":
                u = speed * np.cos(np.radians(lat))
                values = np.stack([u, 0 * u], axis=-1)
                field = CurvilinearField(lon, lat, values, geographic=True)
            else:
                values = np.full((*lon.shape, 2), np.nan)
                psi = radius * speed * np.sin(np.radians(lat)) ** 1
                for axis, d in ((1, 0), (0, 1)):
                    dx = (np.diff(lon, axis=axis) + 180) % 360 - 180
                    a = [slice(None)] * 2
                    b = [slice(None)] * 2
                    a[axis], b[axis] = slice(1, None), slice(None, -1)
                    middle = np.radians(0.5 * (lat[tuple(a)] + lat[tuple(b)]))
                    length = np.radians(np.hypot(dx * np.cos(middle), np.diff(lat, axis=axis)))
                    flow = np.diff(psi, axis=axis) / (radius * length)
                    values[(*b, d)] = flow if d == 0 else -flow
                field = CurvilinearField(lon, lat, values, arakawa="C", geographic=True)
            start = np.stack([np.linspace(-175, 175, 60), np.linspace(-15, 15, 60)], axis=1)
            days = 30
            path = advect(field, start, (0, days * 86400), step=3 * 3600)
            assert (path.status == ACTIVE).all()
            drift.append(np.abs(path.final[:, 1] - start[:, 1]).max())
            # The angular velocity is the same everywhere: speed / radius.
            turned = np.degrees(speed * days * 86400 / radius)
            assert path.final[:, 0] - start[:, 0] == pytest.approx(turned, rel=0.02)
        assert drift[-1] < (1e-9 if arakawa == "A" else 0.05) and drift[-1] <= 0.5 * drift[0] + 1e-9

    def test_across_the_date_line_and_in_any_period(self):
        lon, lat = np.meshgrid(np.arange(170.0, 191), np.arange(-5.0, 6), indexing="ij")
        lon = (lon + 180) % 360 - 180
        field = CurvilinearField(lon, lat, np.ones((*lon.shape, 2)), geographic=True)
        p = [[179.5, 0.3], [-179.5, 0.3], [180.5, 0.3], [540.5, 0.3], [169.0, 0.0]]
        assert np.isfinite(field(0, p)[:, 0]).tolist() == [True, True, True, True, False]

    def test_the_cell_with_the_pole_is_none(self):
        lon, lat = np.meshgrid(np.arange(0.0, 361, 90), [60.0, 80.0], indexing="ij")
        a, b = np.meshgrid([-1.0, 0.0, 1.0, 2.0], [-1.0, 0.0, 1.0, 2.0], indexing="ij")
        a, b = a - 0.4, b - 0.4
        lon, lat = np.degrees(np.arctan2(b, a)), 90 - np.hypot(a, b)
        field = CurvilinearField(lon, lat, np.ones((4, 4, 2)), geographic=True)
        assert np.isnan(field(0, [[10.0, 89.9], [100.0, 89.9]])).all()
        assert np.isfinite(
            field(0, [[np.degrees(np.arctan2(1.1, 1.1)), 90 - np.hypot(1.1, 1.1)]])
        ).all()


def test_same_bits_for_any_number_of_threads_and_through_a_pickle():
    x, y = distorted(12)
    psi = np.sin(np.pi * x) * np.sin(np.pi * y)
    field = on_faces(x, y, psi)
    start = rng(5).uniform(0.1, 0.9, (5000, 2))
    again = pickle.loads(pickle.dumps(field))
    hashes = {
        state_hash(advect(f, start, (0, 0.5), step=0.05, threads=n).final)
        for f, n in ((field, 1), (field, 2), (field, 3), (again, 2))
    }
    # Nor does it matter into how many calls the steps are grouped.
    parts = advect(field, start, (0, 0.5), step=0.05, t_eval=[0, 0.25, 0.5])
    assert len(hashes | {state_hash(parts.final)}) == 1


def test_single_precision():
    x, y = distorted(12)
    field = on_faces(x, y, np.sin(np.pi * x) * np.sin(np.pi * y))
    start = rng(6).uniform(0.1, 0.9, (100, 2))
    wide = advect(field, start, (0, 1), step=0.02)
    narrow = advect(field, start.astype(np.float32), (0, 1), step=0.02)
    assert narrow.final == pytest.approx(wide.final, abs=2e-4)


X, Y = distorted(3)
FLAT = np.zeros((4, 4, 2))


@pytest.mark.parametrize(
    "arguments, options, match",
    [
        ((X[:1], Y[:1], FLAT[:1]), {}, "2 x 2"),
        ((X, Y[:3], FLAT), {}, r"y: expected shape \(4, 4\)"),
        ((X, Y, FLAT[:3]), {}, r"values: expected shape \(4, 4, 2\)"),
        ((X, Y, FLAT[None]), {"times": [0.0, 1.0]}, "values"),
        ((np.where(X == 0, np.inf, X), Y, FLAT), {}, r"x\[0, 0\]"),
        ((X * 0, Y, FLAT), {}, "turn one way"),
        ((X * np.nan, Y, FLAT), {}, "turn one way"),
        ((X, 100 + Y, FLAT), {"geographic": True}, "latitude"),
        ((X, Y, FLAT + np.inf), {}, "infinity"),
        ((X, Y, FLAT), {"arakawa": "B"}, "arakawa"),
        ((X, Y, np.zeros((4, 4, 2, 3))), {"z": [1.0, 0.0]}, "z: expected"),
        ((X, Y, np.zeros((4, 4, 1, 3))), {"z": [1.0]}, "z: expected"),
    ],
)
def test_bad_grids_are_refused(arguments, options, match):
    with pytest.raises(InputError, match=match):
        CurvilinearField(*arguments, **options)
