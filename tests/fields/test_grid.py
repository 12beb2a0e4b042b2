"""Gridded fields: exactness, time levels, geographic coordinates, land, escape, files."""

import math
import os
import pickle
import struct
import threading
from pathlib import Path

import h5py
import numpy as np
import pytest
import substep
from scipy.io import netcdf_file
from substep import (
    Advection,
    CorruptError,
    FormatError,
    GridField,
    InputError,
    SolverError,
    TruncatedError,
    advect,
    open_field,
    state_hash,
)
from substep.fields import ACTIVE, EARTH_RADIUS, ESCAPED, LANDED

OCEAN = Path(__file__).parents[3] / "shared" / "data" / "globcurrent"
needs_ocean = pytest.mark.skipif(not OCEAN.is_dir(), reason=f"no ocean currents at {OCEAN}")
TAU = 2 * np.pi
rng = np.random.default_rng


def axes_of(dimension, unequal):
    axes = [np.linspace(-1, 2, 9), np.linspace(0, 1, 7), np.linspace(3, 4, 6)][:dimension]
    return [a + 0.02 * np.sin(17 * a) for a in axes] if unequal else axes


def on_nodes(axes, function):
    return function(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(axes))).reshape(
        *map(len, axes), len(axes)
    )


def inside(axes, n=500, seed=3):
    low, high = ([a[i] for a in axes] for i in (0, -1))
    return rng(seed).uniform(low, high, (n, len(axes)))


def multilinear(x):
    return np.stack([(1 + i) * np.prod(x - 0.3 * i, axis=1) + i for i in range(x.shape[1])], 1)


def quadratic(x):
    return np.stack([np.prod(x**2 - 0.4 * x + i, axis=1) for i in range(x.shape[1])], 1)


def wave(x):
    return np.stack([np.sin(3 * x[:, 0]) * np.cos(2 * x[:, i]) for i in range(x.shape[1])], 1)


class TestInterpolation:
    @pytest.mark.parametrize("unequal", [False, True])
    @pytest.mark.parametrize("dimension", [2, 3])
    def test_linear_is_exact_on_multilinear_data(self, dimension, unequal):
        axes = axes_of(dimension, unequal)
        field = GridField(axes, on_nodes(axes, multilinear))
        x = inside(axes)
        assert np.abs(field(0, x) - multilinear(x)).max() < 1e-12

    @pytest.mark.parametrize("unequal", [False, True])
    @pytest.mark.parametrize("dimension", [2, 3])
    def test_cubic_is_exact_on_quadratic_data_up_to_the_edge(self, dimension, unequal):
        axes = axes_of(dimension, unequal)
        field = GridField(axes, on_nodes(axes, quadratic), interpolation="cubic")
        x = inside(axes)
        assert np.abs(field(0, x) - quadratic(x)).max() < 1e-11 * np.abs(quadratic(x)).max()

    @pytest.mark.parametrize("interpolation, order", [("linear", 2), ("cubic", 3)])
    @pytest.mark.parametrize("dimension", [2, 3])
    def test_order_of_the_interpolation(self, dimension, interpolation, order):
        errors = []
        for n in (20, 40):
            axes = [np.linspace(0, 2, n + 1)] * dimension
            field = GridField(axes, on_nodes(axes, wave), interpolation=interpolation)
            x = inside(axes, 4000)
            errors.append(np.sqrt(np.mean((field(0, x) - wave(x)) ** 2)))
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.4)

    def test_keys_weights(self):
        # Keys (1981), eq. (15), at s = 1/4 of a unit impulse.
        axis = np.arange(9.0)
        for node, weight in ((3, -0.0703125), (4, 0.8671875), (5, 0.2265625), (6, -0.0234375)):
            values = np.zeros((9, 9, 2))
            values[node, :, 0] = 1
            field = GridField((axis, axis), values, interpolation="cubic")
            assert field(0, [[4.25, 4.5]])[0] == pytest.approx([weight, 0], abs=1e-15)

    @pytest.mark.parametrize("interpolation", ["linear", "cubic"])
    def test_single_precision(self, interpolation):
        axes = axes_of(3, False)
        field = GridField(axes, on_nodes(axes, wave), interpolation=interpolation)
        x = inside(axes)
        one, two = (advect(field, x, (0, 0.3), 0.1, dtype=d) for d in (np.float64, np.float32))
        same = one.status == two.status
        assert same.mean() > 0.99
        assert np.abs(one.final - two.final)[same].max() < 1e-5

    @pytest.mark.parametrize("interpolation", ["linear", "cubic"])
    def test_periodic_axes_close_and_a_repeated_end_is_dropped(self, interpolation):
        n = 16
        short = [np.arange(n) * TAU / n] * 2
        long = [np.arange(n + 1) * TAU / n] * 2
        options = {"interpolation": interpolation}
        one = GridField(short, on_nodes(short, wave), periodic=(True, True), **options)
        two = GridField(long, on_nodes(long, wave), periodic=(TAU, TAU), **options)
        x = rng(0).uniform(-20, 20, (1000, 2))
        assert np.abs(one(0, x) - two(0, x)).max() < 1e-13
        assert np.abs(one(0, x) - one(0, one.wrap(x))).max() < 1e-12
        assert np.isfinite(one(0, x)).all()
        assert one.periods == pytest.approx((TAU, TAU)) and two.periods == (TAU, TAU)
        assert advect(one, x, (0, 5), 0.1).status.max() == ACTIVE

    def test_unequal_periodic_axis(self):
        axis = np.array([0.0, 0.1, 0.35, 0.6, 0.9])
        values = np.zeros((5, 5, 2))
        values[..., 0] = axis[:, None]
        field = GridField((axis, axis), values, periodic=(1.0, 1.0))
        assert field(0, [[0.95, 0.5], [-0.05, 2.5]])[:, 0] == pytest.approx([0.45, 0.45])

    def test_falling_axes(self):
        axes = axes_of(2, True)
        values = on_nodes(axes, multilinear)
        x = inside(axes)
        turned = GridField((axes[0][::-1], axes[1][::-1]), values[::-1, ::-1])
        assert state_hash(turned(0, x)) == state_hash(GridField(axes, values)(0, x))

    def test_the_last_node_is_inside(self):
        axis = np.linspace(0, 0.7, 8)
        field = GridField((axis, axis), np.ones((8, 8, 2)))
        assert np.isfinite(field(0, [[0.7, 0.7], [0, 0]])).all()
        assert np.isnan(field(0, [[0.7 + 1e-9, 0.5], [0.5, -1e-9]])).all()


class TestLevels:
    axes = (np.linspace(0, 1, 5), np.linspace(0, 1, 6))
    times = np.array([0.0, 1.0, 3.0])

    def field(self, **options):
        levels = [np.full((5, 6, 2), value) for value in ((0.1, 0.0), (0.2, 0.0), (0.0, 0.1))]
        return GridField(self.axes, np.stack(levels), self.times, **options)

    def test_linear_in_time(self):
        field = self.field()
        x = [[0.5, 0.5]]
        assert field(0.5, x)[0] == pytest.approx([0.15, 0])
        assert field(2.5, x)[0] == pytest.approx([0.05, 0.075])
        assert field(3.0, x)[0] == pytest.approx([0, 0.1])

    @pytest.mark.parametrize("step", [0.05, 0.3, 3.0])
    def test_steps_through_levels_integrate_the_broken_line(self, step):
        # RK4 is exact within a level; a step across levels is not, but converges.
        end = advect(self.field(), [[0.1, 0.1]], (0, 3), step).final[0]
        exact = np.array([0.1 + 0.15 + 0.2, 0.1 + 0.1])
        assert end == pytest.approx(exact, abs=1e-12 if step == 0.05 else 0.2)
        back = advect(self.field(), [end], (3, 0), step).final[0]
        assert back == pytest.approx([0.1, 0.1], abs=1e-12)

    def test_little_memory_gives_the_same_bits(self):
        values = rng(0).normal(size=(40, 5, 6, 2)) * 0.01
        times = np.arange(40.0)
        x = rng(1).uniform(0.3, 0.7, (50, 2))
        reads = []

        class Source:
            shape = values.shape

            def __getitem__(self, level):
                reads.append(level)
                return values[level]

        whole = advect(GridField(self.axes, values, times), x, (0, 39), 0.25)
        small = GridField(self.axes, Source(), times, memory_limit=6 * 8 * 9 * 32)
        part = advect(small, x, (0, 39), 0.25)
        assert state_hash(whole.final, whole.status) == state_hash(part.final, part.status)
        assert len(reads) < 60 and set(reads) == set(range(40))
        assert len(small._levels) <= 6

    def test_a_source_may_ask_the_field(self):
        values, asked = np.ones((2, 5, 6, 2)), []

        class Source:
            shape = values.shape

            def __getitem__(self, level):
                if level == 1 and not asked:
                    asked.append(field(0.0, [[0.5, 0.5]]))
                return values[level]

        field = GridField(self.axes, Source(), [0.0, 1.0])
        ask = threading.Thread(target=lambda: asked.append(field(0.5, [[0.5, 0.5]])), daemon=True)
        ask.start()  # which would wait for itself
        ask.join(10)
        assert len(asked) == 2 and np.array_equal(*asked)

    def test_times_outside_are_refused(self):
        field = self.field()
        for call in (
            lambda: field(-0.1, [[0.5, 0.5]]),
            lambda: advect(field, [[0.5, 0.5]], (0, 3.1), 0.1),
            lambda: advect(field, [[0.5, 0.5]], (3.1, 0), 0.1),
            lambda: Advection(field, [[0.5, 0.5]], time=2.9, step=0.2).step(),
        ):
            with pytest.raises(InputError, match=r"from 0\.0 to 3\.0"):
                call()

    def test_pickled_fields_give_the_same(self):
        field = self.field()
        again = pickle.loads(pickle.dumps(field))
        x = [[0.5, 0.25]]
        assert state_hash(again(1.3, x)) == state_hash(field(1.3, x))


def zonal(speed=1.0, step=1.0, lon=None, lat=None):
    """Solid-body rotation about the Earth's axis: u = speed cos(lat)."""
    lon = np.arange(-180.0, 180.0, step) if lon is None else lon
    lat = np.arange(-89.0, 89.1, step) if lat is None else lat
    values = np.zeros((len(lon), len(lat), 2))
    values[..., 0] = speed * np.cos(np.radians(lat))
    return GridField((lon, lat), values, geographic=True, interpolation="cubic")


class TestGeographic:
    def test_solid_body_rotation_drifts_all_longitudes_alike(self):
        day = 86400.0
        x = np.array([[0.0, 0.0], [10.0, 45.0], [-30.0, -60.0], [179.9, 80.0]])
        result = advect(zonal(10.0, 0.5), x, (0, 5 * day), 3600.0)
        expected = np.degrees(10.0 / EARTH_RADIUS) * 5 * day
        assert result.final[:, 0] - x[:, 0] == pytest.approx(expected, rel=2e-6)
        assert result.final[:, 1] == pytest.approx(x[:, 1], abs=1e-12)
        assert (result.status == ACTIVE).all()

    def test_the_radius_is_a_parameter(self):
        lon, lat = np.linspace(0, 10, 11), np.linspace(-5, 5, 11)
        values = np.ones((11, 11, 2))
        moved = [
            advect(
                GridField((lon, lat), values, geographic=True, radius=r), [[5.0, 0.0]], (0, 60), 10
            )
            for r in (1e4, 2e4)
        ]
        one, two = (m.final[0] - [5.0, 0.0] for m in moved)
        assert one[1] == pytest.approx(np.degrees(60 / 1e4), rel=1e-12)
        assert one == pytest.approx(2 * two, rel=1e-3)

    def test_great_circle(self):
        # Solid-body rotation about an axis tilted by 30 degrees: paths are circles about that axis.
        tilt, omega = np.radians(30.0), 1e-5
        axis = np.array([np.sin(tilt), 0, np.cos(tilt)])
        lon, lat = np.arange(0, 360, 1.0), np.arange(-89, 89.5, 1.0)
        a, b = np.meshgrid(np.radians(lon), np.radians(lat), indexing="ij")
        r = np.stack([np.cos(b) * np.cos(a), np.cos(b) * np.sin(a), np.sin(b)], -1)
        velocity = omega * EARTH_RADIUS * np.cross(axis, r)
        east = np.stack([-np.sin(a), np.cos(a), 0 * a], -1)
        north = np.stack([-np.sin(b) * np.cos(a), -np.sin(b) * np.sin(a), np.cos(b)], -1)
        values = np.stack([(velocity * e).sum(-1) for e in (east, north)], -1)
        field = GridField((lon, lat), values, geographic=True, interpolation="cubic")
        start = np.array([[90.0, 0.0], [200.0, 20.0]])
        turn = TAU / omega
        result = advect(field, start, (0, turn), turn / 800, t_eval=np.linspace(0, turn, 9))
        p, q = np.radians(result.positions[..., 0]), np.radians(result.positions[..., 1])
        r = np.stack([np.cos(q) * np.cos(p), np.cos(q) * np.sin(p), np.sin(q)], -1)
        height = r @ axis
        assert np.abs(height - height[0]).max() < 2e-5
        assert result.final[:, 1] == pytest.approx(start[:, 1], abs=2e-3)
        assert np.mod(result.final[:, 0] - start[:, 0] + 180, 360) == pytest.approx(180, abs=2e-3)

    @pytest.mark.parametrize("lon", [np.arange(-180.0, 180.0), np.arange(0.0, 361.0)])
    def test_dateline(self, lon):
        # Continuous longitudes across the dateline, whatever the grid's own origin.
        field = zonal(lon=lon)
        x = np.array([[179.95, 10.0], [-180.05, 10.0], [539.95, 10.0]])
        result = advect(field, x, (0, 86400.0), 3600.0)
        drift = result.final - x
        assert (drift[:, 0] > 0.7).all()
        assert drift == pytest.approx(np.broadcast_to(drift[0], (3, 2)), abs=1e-9)
        assert np.ptp(field.wrap(result.final)[:, 0]) < 1e-9

    def test_regional_grids_take_longitudes_modulo_360(self):
        lon, lat = np.linspace(170, 190, 21), np.linspace(-5, 5, 11)
        field = GridField((lon, lat), np.ones((21, 11, 2)), geographic=True)
        x = [[175.0, 0.0], [-175.0, 0.0], [185.0, 0.0], [165.0, 0.0], [0.0, 0.0]]
        assert np.isfinite(field(0, x)).all(axis=1).tolist() == [True, True, True, False, False]

    def test_the_pole_is_an_edge(self):
        lon, lat = np.arange(0, 360, 10.0), np.linspace(80, 90, 11)
        values = np.zeros((36, 11, 2))
        values[..., 1] = 100.0
        result = advect(GridField((lon, lat), values, geographic=True), [[5.0, 89.0]], (0, 1e4), 60)
        assert result.status.tolist() == [ESCAPED]
        assert 89.9 < result.final[0, 1] <= 90

    def test_latitudes_and_longitudes_are_checked(self):
        good = np.arange(4.0)
        for lon, lat in ((good, good + 88), (np.linspace(0, 400, 4), good)):
            with pytest.raises(InputError, match="itude"):
                GridField((lon, lat), np.zeros((4, 4, 2)), geographic=True)


def channel(**options):
    """Flow to the east at 1 m/s; nodes from x = 5 on are land."""
    x, y = np.arange(11.0), np.arange(6.0)
    values = np.zeros((11, 6, 2))
    values[..., 0] = 1.0
    values[5:] = np.nan
    return GridField((x, y), values, **options)


class TestLandAndEscape:
    @pytest.mark.parametrize("interpolation", ["linear", "cubic"])
    def test_particles_stop_at_the_last_sea_position(self, interpolation):
        field = channel(interpolation=interpolation)
        result = advect(field, [[0.0, 2.5], [4.2, 3.0]], (0, 10), 0.25)
        assert result.status.tolist() == [LANDED, LANDED]
        # Land begins at 4.5, half way to the first land node; currents along it are not damped.
        assert result.final[:, 0] == pytest.approx([4.25, 4.45])
        assert result.stop_time == pytest.approx([4.25, 0.25])
        assert np.isfinite(field(0, result.final)).all()

    def test_the_definition_of_land(self):
        field = channel()
        x = np.array([[4.49, 1.0], [4.51, 1.0], [7.0, 2.0], [-0.1, 1.0]])
        assert field(0, x)[:, 0] == pytest.approx([1.0, np.nan, np.nan, np.nan], nan_ok=True)

    def test_the_weights_of_the_sea_nodes_are_scaled(self):
        values = np.zeros((2, 2, 2))
        values[..., 0] = [[1.0, 2.0], [3.0, np.nan]]
        field = GridField(([0.0, 1.0], [0.0, 1.0]), values)
        a, b = 0.4, 0.3
        w = np.array([(1 - a) * (1 - b), (1 - a) * b, a * (1 - b)])
        assert field(0, [[a, b]])[0, 0] == pytest.approx(w @ [1.0, 2.0, 3.0] / w.sum())

    def test_a_particle_can_begin_on_land_or_outside(self):
        result = advect(channel(), [[8.0, 1.0], [-3.0, 1.0], [0.0, 1.0]], (0, 1), 0.5)
        assert result.status.tolist() == [LANDED, ESCAPED, ACTIVE]
        assert result.stop_time.tolist() == [0, 0, 1]
        assert result.final[:, 0] == pytest.approx([8.0, -3.0, 1.0])

    def test_escape_backwards(self):
        result = advect(channel(), [[1.0, 2.5]], (0, -10), 0.3)
        assert result.status.tolist() == [ESCAPED]
        assert result.final[0, 0] == pytest.approx(0.1)
        assert result.stop_time[0] == pytest.approx(-0.9)

    @pytest.mark.parametrize(
        "policy, start, span, words",
        [("on_land", 0.6, (0, 9), "on land"), ("on_escape", 0.6, (9, 0), "outside")],
    )
    def test_raise_leaves_the_last_good_step(self, policy, start, span, words):
        field = channel()
        x = [[0.0, 2.0], [start, 2.0]] if span[1] else [[4.0, 2.0], [start, 2.0]]
        with pytest.raises(SolverError, match=words) as info:
            advect(field, x, span, 0.25, **{policy: "raise"})
        error = info.value
        assert error.index == 1
        assert error.time == pytest.approx(error.result.t[-1])
        assert np.isfinite(field(0, error.result.final)).all()
        steps = abs(error.time - span[0]) / 0.25
        assert error.step == pytest.approx(steps)
        with pytest.raises(InputError, match=r"positions\[0\]"):
            advect(
                field, [[8.0, 1.0]] if span[1] else [[-1.0, 1.0]], span, 0.25, **{policy: "raise"}
            )

    def test_a_step_that_raises_changes_nothing(self):
        drift = Advection(channel(), [[4.2, 2.0]], step=1.0, on_land="raise")
        before = state_hash(drift.positions, drift.status)
        with pytest.raises(SolverError):
            drift.step()
        assert (drift.time, drift.steps) == (0.0, 0)
        assert state_hash(drift.positions, drift.status) == before

    def test_values_missing_at_one_level_only(self):
        values = np.ones((2, 3, 3, 2))
        values[1, 1, 1] = np.nan
        field = GridField((np.arange(3.0), np.arange(3.0)), values, times=[0.0, 1.0])
        x = [[1.0, 1.0], [0.2, 0.2]]
        assert field(0.4, x)[:, 0] == pytest.approx([1, 1])
        assert field(0.6, x)[:, 0] == pytest.approx([np.nan, 1], nan_ok=True)

    def test_huge_steps_escape_or_raise_but_never_give_nan(self):
        result = advect(channel(), [[1.0, 2.0]], (0, 1e300), 1e300)
        assert result.status.tolist() == [ESCAPED]
        assert result.final.tolist() == [[1.0, 2.0]]
        axis = np.arange(4.0)
        field = GridField((axis, axis), np.full((4, 4, 2), 1e300), periodic=(True, True))
        with pytest.raises(substep.NonFiniteError) as info:
            advect(field, [[1.0, 1.0]] * 3, (0, 1e10), 1e9)
        assert info.value.index == 0


class TestDeterminism:
    @pytest.mark.parametrize("interpolation", ["linear", "cubic"])
    @pytest.mark.parametrize("dtype", [np.float64, np.float32])
    @pytest.mark.parametrize("levels", [1, 3])
    def test_same_bits_for_any_number_of_threads_and_any_order(self, levels, dtype, interpolation):
        n = 32
        axis = np.arange(n) * TAU / n
        values = rng(0).normal(size=(levels, n, n, n, 3))
        values[:, 3:6, 3:6, 3:6] = np.nan
        options = {"periodic": [True] * 3, "interpolation": interpolation}
        if levels == 1:
            field = GridField([axis] * 3, values[0], **options)
        else:
            field = GridField([axis] * 3, values, np.arange(levels) * 0.5, **options)
        x = rng(1).uniform(0, TAU, (30_000, 3))
        end = 0.5
        results = [advect(field, x, (0, end), 0.02, threads=t, dtype=dtype) for t in (1, 2, 3, 4)]
        hashes = {state_hash(r.final, r.status, r.stop_time) for r in results}
        assert len(hashes) == 1
        assert field._sorted(Advection(field, x, step=1.0, dtype=dtype)._particles)
        some = advect(field, x[::500], (0, end), 0.02, dtype=dtype)  # too few to be sorted
        assert state_hash(some.final, some.status) == state_hash(
            results[0].final[::500], results[0].status[::500]
        )
        assert {ACTIVE, LANDED} == set(results[0].status)

    def test_checkpoint_with_stopped_particles(self, tmp_path):
        x = rng(2).uniform([0, 0], [4, 5], (500, 2))
        drift = Advection(channel(), x, step=0.13)
        drift.advance(2.0)
        drift.save(tmp_path / "a")
        drift.advance(2.0)
        after = state_hash(drift.positions, drift.status, drift.stop_time)
        other = Advection(channel(), x[:3], step=0.13)
        other.load(tmp_path / "a")
        other.advance(2.0)
        assert state_hash(other.positions, other.status, other.stop_time) == after
        assert 0 < other.diagnostics()["landed"] < 500


AXIS = np.arange(4.0)
FLAT = np.zeros((4, 4, 2))


@pytest.mark.parametrize(
    "axes, values, options",
    [
        ((AXIS,), FLAT, {}),
        ((AXIS, AXIS, AXIS), FLAT, {}),
        ((AXIS, AXIS[:3]), FLAT, {}),
        ((AXIS, AXIS[:1]), FLAT[:, :1], {}),
        ((AXIS, AXIS * 0), FLAT, {}),
        ((AXIS, [0, 1, np.nan, 3]), FLAT, {}),
        ((AXIS, [0, 2, 1, 3]), FLAT, {}),
        ((AXIS, AXIS), np.full((4, 4, 2), np.inf), {}),
        ((AXIS, AXIS), np.zeros((4, 4, 3)), {}),
        ((AXIS, AXIS), FLAT[None], {"times": [0.0, 1.0]}),
        ((AXIS, AXIS), np.zeros((2, 4, 4, 2)), {"times": [1.0, 1.0]}),
        ((AXIS, AXIS), np.zeros((2, 4, 4, 2)), {"times": [0.0, np.nan]}),
        ((AXIS, AXIS), FLAT, {"interpolation": "quintic"}),
        ((AXIS, AXIS), FLAT, {"periodic": (True,)}),
        ((AXIS, AXIS), FLAT, {"periodic": (2.0, False)}),
        ((AXIS, AXIS**2), FLAT, {"periodic": (False, True)}),
        ((AXIS, AXIS), FLAT, {"radius": 0.0}),
        ((AXIS, AXIS), FLAT, {"memory_limit": 0}),
        ((AXIS, AXIS), FLAT, {"memory_limit": -(10**5000)}),
        ((AXIS, AXIS), FLAT, {"periodic": (10**5000, False), "geographic": True}),
        ((AXIS, [-1e308, 0, 1, 1e308]), FLAT, {}),
        ((AXIS, [-1e308, 1e308]), FLAT[:, :2], {}),
        (([1e308, 1.5e308], AXIS), FLAT[:2], {"periodic": (1e308, False)}),
    ],
)
def test_bad_grids_are_refused(axes, values, options):
    with pytest.raises(InputError):
        GridField(axes, values, **options)


def test_periods_of_longitudes_are_numbers():
    with pytest.raises(TypeError, match=r"periodic\[0\]"):
        GridField((AXIS, AXIS), FLAT, periodic=[np.ones(3), False], geographic=True)


def test_positions_are_wrapped_however_far_away():
    field = GridField((AXIS, AXIS), FLAT, periodic=(3.3, False))
    assert field.wrap([[1e300, 0.0]])[0, 0] == math.fmod(1e300, 3.3)
    field = GridField(([0, 5e-324], AXIS), FLAT[:2], periodic=(True, False))
    assert field.wrap([[1e308, 0.0], [-1e308, 1.0]]).tolist() == [[0.0, 0.0], [0.0, 1.0]]
    field = GridField(([-1e308, 0], AXIS), FLAT[:2], periodic=(1.5e308, False))
    with pytest.raises(InputError, match=r"^x: expected numbers of a size"):
        field.wrap([[1e308, 0.0]])


@pytest.mark.parametrize("names", [np.array(["v", "u"]), ("v", "u")])
def test_names_of_velocities_may_be_an_array(tmp_path, names):
    write_netcdf4(tmp_path / "a.nc")
    chosen = open_field(tmp_path / "a.nc", variables=names, depth=0)
    assert chosen(0.0, [[21.5, 10.5]]) == pytest.approx(np.array([[0.02, 0.01]]))
    for wrong in ("uv", [1, 2], [10**5000, "v"], ["u"]):
        with pytest.raises(InputError, match="variables: expected two or three names"):
            open_field(tmp_path / "a.nc", variables=wrong)


def test_complex_and_text_values_are_refused():
    for values in (FLAT * 1j, FLAT.astype(str), FLAT.astype(object)):
        with pytest.raises(TypeError, match="values"):
            GridField((AXIS, AXIS), values)


@pytest.mark.parametrize(
    "dtype, bits", [(np.float32, 0x7F800001), (np.float64, 0x7FF0000000000001)]
)
@pytest.mark.parametrize("lazy", [False, True])
def test_a_signaling_nan_is_missing_like_any_other(tmp_path, dtype, bits, lazy):
    values = np.ones((3, 3, 2), dtype)
    values[1, 1, 0] = np.array(bits, f"u{values.itemsize}").view(dtype)
    if lazy:
        values.tofile(tmp_path / "values")
        values = np.memmap(tmp_path / "values", dtype, "r", shape=(3, 3, 2))
    x = [[0.2, 0.2], [1.0, 1.0]]
    field = GridField(([0, 1, 2], [0, 1, 2]), values)
    assert field(0, x)[:, 0] == pytest.approx([1.0, np.nan], nan_ok=True)
    with pytest.raises(InputError, match=r"x\[0, 0\]: expected finite"):
        field(0, np.array([[bits, 0]], f"u{values.itemsize}").view(dtype))


def test_the_field_does_not_see_later_changes_of_its_arrays():
    values = np.ones((4, 4, 2))
    field = GridField((AXIS, AXIS), values)
    values[:] = 7.0
    assert field(0, [[1.0, 1.0]]).tolist() == [[1.0, 1.0]]


# ---------------------------------------------------------------------------------------- files


def write_classic(
    path, *, version=1, day=0.0, units="days since 2000-01-01", shift=0.0, scale=None
):
    """A small NetCDF classic file by SciPy's writer: time, lat, lon; a land node at (0, 0)."""
    with netcdf_file(path, "w", version=version) as file:
        file.createDimension("time", None)
        file.createDimension("lat", 3)
        file.createDimension("lon", 4)
        for name, values, unit in (
            ("lat", [10.0, 11.0, 12.0], "degrees_north"),
            ("lon", [20.0 + shift, 21.0 + shift, 22.0 + shift, 23.0 + shift], "degrees_east"),
        ):
            variable = file.createVariable(name, "d", (name,))
            variable[:] = values
            variable.units = unit
        time = file.createVariable("time", "d", ("time",))
        time.units = units
        time[:] = np.atleast_1d(day)
        for name, standard in (
            ("uo", "eastward_sea_water_velocity"),
            ("vo", "northward_sea_water_velocity"),
        ):
            kind = "f" if scale is None else "h"
            variable = file.createVariable(name, kind, ("time", "lat", "lon"))
            variable.standard_name = standard
            variable.units = "m s-1"
            variable._FillValue = np.float32(-99.0) if scale is None else np.int16(-99)
            if scale is not None:
                variable.scale_factor, variable.add_offset = scale
            for k in range(len(np.atleast_1d(day))):
                data = np.arange(12.0).reshape(3, 4) + (100 if name == "vo" else 0) + 1000 * k
                data[0, 0] = -99
                variable[k] = data
    return path


def write_netcdf4(path):
    with h5py.File(path, "w") as file:
        for name, values, units in (
            ("time", [0.0, 6.0], "hours since 1990-06-01 12:00:00"),
            ("depth", [0.0, 10.0], "m"),
            ("lat", [10.0, 11.0, 12.0], "degrees_north"),
            ("lon", [20.0, 21.0, 22.0, 23.0], "degrees_east"),
        ):
            file[name] = np.array(values)
            file[name].attrs["units"] = units
            file[name].make_scale(name)
        file["depth"].attrs["positive"] = "down"
        for i, name in enumerate(("eastward", "northward", "upward")):
            shape = (2, 2, 3, 4)
            data = file.create_dataset("uvw"[i], data=np.full(shape, 1.0 + i), compression="gzip")
            data.attrs["standard_name"] = f"{name}_sea_water_velocity"
            data.attrs["units"] = "cm/s"
            for d, dimension in enumerate(("time", "depth", "lat", "lon")):
                data.dims[d].attach_scale(file[dimension])
    return path


class TestFiles:
    @pytest.mark.parametrize("version", [1, 2])
    def test_classic(self, tmp_path, version):
        path = write_classic(tmp_path / "a.nc", version=version, day=[3.0, 4.5])
        field = open_field(path)
        assert field.geographic and field.times.tolist() == [0, 1.5 * 86400]
        assert field.origin == np.datetime64("2000-01-04T00:00")
        assert [a.tolist() for a in field.axes] == [[20, 21, 22, 23], [10, 11, 12]]
        assert field(0, [[22.0, 11.0]]).tolist() == [[6.0, 106.0]]
        assert field(1.5 * 86400, [[22.0, 11.0]]).tolist() == [[1006.0, 1106.0]]
        assert np.isnan(field(0, [[20.2, 10.2]])).all()

    def test_packed_values(self, tmp_path):
        field = open_field(write_classic(tmp_path / "a.nc", scale=(0.5, 2.0)))
        assert field(0, [[22.0, 11.0]]).tolist() == [[5.0, 55.0]]
        assert np.isnan(field(0, [[20.0, 10.0]])).all()

    def test_netcdf4_in_space_and_at_one_depth(self, tmp_path):
        path = write_netcdf4(tmp_path / "a.nc")
        field = open_field(path)
        assert field.dimension == 3 and field.times.tolist() == [0, 6 * 3600]
        assert field.origin == np.datetime64("1990-06-01T12:00")
        # Upward velocity, but depth grows downwards.
        assert field(0, [[21.5, 11.0, 5.0]])[0] == pytest.approx([0.01, 0.02, -0.03])
        flat = open_field(path, depth=9.0)
        assert flat.dimension == 2
        assert flat(0, [[21.5, 11.0]])[0] == pytest.approx([0.01, 0.02])
        chosen = open_field(path, variables=["v", "u"], depth=0)
        assert chosen(0, [[21.5, 11.0]])[0] == pytest.approx([0.02, 0.01])

    def test_folder_pattern_and_list_are_sorted_by_time(self, tmp_path):
        days = {"a": 2.0, "b": 0.0, "c": 1.0}
        paths = [write_classic(tmp_path / f"{n}.nc", day=d) for n, d in days.items()]
        for given in (tmp_path, str(tmp_path / "*.nc"), paths, paths[::-1]):
            field = open_field(given)
            assert field.times.tolist() == [0, 86400, 2 * 86400]
            assert len(field) == 3

    @pytest.mark.parametrize(
        "units, seconds",
        [
            ("seconds since 1970-01-01T00:00:00Z", 2),
            ("minutes since 1970-1-1 0:0:0", 120),
            ("hours since 1970-01-01 00:00:00.0 +00:00", 7200),
            ("day since 1970-01-01 UTC", 2 * 86400),
            ("days since 1900-01-01", 2 * 86400 - 2208988800),
        ],
    )
    def test_units_of_time(self, tmp_path, units, seconds):
        field = open_field(write_classic(tmp_path / "a.nc", day=2.0, units=units))
        assert field.origin == np.datetime64(seconds, "s")

    @pytest.mark.parametrize("units, seconds", [("", 1.5), ("s", 1.5), ("days", 1.5 * 86400)])
    def test_times_without_a_date(self, tmp_path, units, seconds):
        field = open_field(write_classic(tmp_path / "a.nc", day=[2.0, 3.5], units=units))
        assert field.times.tolist() == [0, seconds] and field.origin is None

    @pytest.mark.parametrize(
        "units", ["fortnights", "fortnights since 2000-01-01", "days since 2000-13-01"]
    )
    def test_bad_units_of_time(self, tmp_path, units):
        with pytest.raises(FormatError):
            open_field(write_classic(tmp_path / "a.nc", units=units))

    def test_files_that_do_not_go_together(self, tmp_path):
        one = write_classic(tmp_path / "a.nc")
        with pytest.raises(FormatError, match="same time"):
            open_field([one, write_classic(tmp_path / "b.nc")])
        with pytest.raises(FormatError, match="grid"):
            open_field([one, write_classic(tmp_path / "c.nc", day=1.0, shift=0.5)])

    def test_names_that_are_not_there(self, tmp_path):
        path = write_classic(tmp_path / "a.nc")
        for variables in (["uo", "wo"], ["uo"], "uo"):
            with pytest.raises(InputError, match="variables"):
                open_field(path, variables)
        with pytest.raises(FormatError, match="no longitude"):
            open_field(path, ["lat", "lat"])
        with pytest.raises(FileNotFoundError):
            open_field(tmp_path / "none.nc")
        (tmp_path / "empty").mkdir()
        with pytest.raises(FileNotFoundError):
            open_field(tmp_path / "empty")

    def test_truncated_at_every_length(self, tmp_path):
        good = write_classic(tmp_path / "a.nc").read_bytes()
        path = tmp_path / "b.nc"
        for length in range(0, len(good) - 4, 7):
            path.write_bytes(good[:length])
            with pytest.raises(FormatError):
                open_field(path)
        path.write_bytes(good[:-12])
        with pytest.raises(TruncatedError):
            open_field(path)

    @pytest.mark.filterwarnings("error")
    def test_spoiled_headers_never_crash(self, tmp_path):
        good = write_classic(tmp_path / "a.nc").read_bytes()
        path = tmp_path / "b.nc"
        outcomes = set()
        for seed in range(400):
            spoiled = bytearray(good)
            spoiled[rng(seed).integers(4, 700)] ^= 1 << rng(seed + 1).integers(8)
            path.write_bytes(spoiled)
            try:
                open_field(path)(0, [[21.5, 11.0]])
                outcomes.add("read")
            except (FormatError, InputError) as error:
                outcomes.add(type(error))
        assert FormatError in outcomes or CorruptError in outcomes

    def test_headers_that_promise_too_much(self, tmp_path):
        # 2^31 - 1 entries of a list, of a name, of a dimension.
        path = tmp_path / "b.nc"
        huge = struct.pack(">I", 2**31 - 1)
        dims = struct.pack(">II", 0x0A, 1)
        for data in (
            b"CDF\1" + bytes(4) + struct.pack(">I", 0x0A) + huge,
            b"CDF\1" + bytes(4) + dims + huge,
            b"CDF\1" + huge,
            b"CDF\3" + bytes(40),
            b"\x89HDF\r\n\x1a\n" + bytes(100),
            b"something else",
            b"",
        ):
            path.write_bytes(data)
            with pytest.raises(FormatError):
                open_field(path)

    def test_links_and_external_storage_are_refused(self, tmp_path):
        other = tmp_path / "other.bin"
        other.write_bytes(bytes(96))
        path = tmp_path / "a.nc"
        with h5py.File(path, "w") as file:
            file["u"] = h5py.ExternalLink("other.h5", "/u")
        with pytest.raises(FormatError, match="link"):
            open_field(path)
        with h5py.File(path, "w") as file:
            file.create_dataset("u", (12,), "f8", external=[(str(other), 0, 96)])
        with pytest.raises(FormatError, match="other files"):
            open_field(path)

    def test_npz(self, tmp_path):
        path = tmp_path / "a.npz"
        values = np.arange(2 * 3 * 4 * 2.0).reshape(2, 3, 4, 2)
        np.savez(path, lon=np.arange(3.0), lat=np.arange(4.0), values=values, times=[0.0, 1.0])
        field = open_field(path)
        assert field.geographic
        assert field(1.0, [[1.0, 2.0]]).tolist() == [values[1, 1, 2].tolist()]
        good = path.read_bytes()
        for bad in (good[:50], good[: len(good) // 2], b""):
            path.write_bytes(bad)
            with pytest.raises(FormatError):
                open_field(path)
        np.savez(path, x=np.arange(3.0), values=values)
        with pytest.raises(FormatError, match="expected"):
            open_field(path)
        np.savez(path, x=np.arange(3.0), y=np.arange(5.0), values=values)
        with pytest.raises(FormatError, match="shape"):
            open_field(path)
        np.savez(path, x=np.array([{}], dtype=object), y=np.arange(5.0), values=values)
        with pytest.raises(FormatError):
            open_field(path)
        np.savez_compressed(path, x=AXIS, y=AXIS, values=np.zeros((4, 4, 2)), more=np.zeros(10**6))
        with pytest.raises(CorruptError, match="memory_limit"):
            open_field(path, memory_limit=10**5)


@pytest.fixture(scope="module")
def ocean():
    return open_field(OCEAN)


@needs_ocean
class TestOcean:
    def test_61_daily_levels(self, ocean):
        assert len(ocean) == 61
        assert np.diff(ocean.times) == pytest.approx(86400.0)
        assert ocean.origin == np.datetime64("2002-01-01")
        assert ocean.geographic

    def test_agulhas_current_is_faster_than_1_m_per_s(self, ocean):
        lon, lat = np.meshgrid(np.linspace(20, 33, 131), np.linspace(-37, -31, 61))
        u = ocean(30 * 86400.0, np.stack([lon.ravel(), lat.ravel()], 1))
        speed = np.hypot(*u.T)
        fastest = np.nanargmax(speed)
        assert 1.0 < speed[fastest] < 3.0
        assert u[fastest, 0] < 0 and u[fastest, 1] < 0  # to the south-west
        assert np.isnan(speed).any()  # Africa

    def test_same_numbers_as_scipy_reads(self, ocean):
        path = sorted(OCEAN.iterdir())[17]
        with netcdf_file(path, mmap=False) as file:
            u = file.variables["eastward_eulerian_current_velocity"][0].T
        lon, lat = np.meshgrid(*ocean.axes, indexing="ij")
        ours = ocean(17 * 86400.0, np.stack([lon.ravel(), lat.ravel()], 1))[:, 0].reshape(u.shape)
        assert np.array_equal(np.isnan(ours), np.isnan(u))
        assert np.nanmax(np.abs(ours - u)) == 0

    def test_drift_of_1000_particles(self, ocean):
        low, high = ocean.bounds
        x = rng(0).uniform(low, high, (3000, 2))
        x = x[np.isfinite(ocean(0.0, x)).all(axis=1)][:1000]
        result = advect(ocean, x, (0, 60 * 86400.0), 3600.0, t_eval=np.arange(1, 61) * 86400.0)
        assert result.positions.shape == (60, 1000, 2)
        assert ((result.positions >= low) & (result.positions <= high)).all()
        counts = np.bincount(result.status, minlength=3)
        assert counts[ACTIVE] > 100 and counts[LANDED] > 5 and counts[ESCAPED] > 100
        finer = advect(ocean, x, (0, 10 * 86400.0), 900.0)
        same = (finer.status == ACTIVE) & (result.stop_time > 10 * 86400.0)
        assert np.median(np.abs(finer.final - result.positions[9])[same]) < 1e-5

    def test_one_file_is_a_steady_field(self):
        field = open_field(sorted(OCEAN.iterdir())[0])
        assert field.steady and len(field) == 1
        assert np.isfinite(field(1e9, [[25.0, -38.0]])).all()


def test_many_threads_may_share_a_field():
    axis = np.linspace(0, 1, 9)
    values = rng(0).normal(size=(20, 9, 9, 2)) * 0.01
    field = GridField((axis, axis), values, np.arange(20.0), memory_limit=3 * 12 * 12 * 32)
    x = rng(1).uniform(0.3, 0.7, (100, 2))
    expected = state_hash(advect(field, x, (0, 19), 0.1).final)
    found = []
    threads = [
        threading.Thread(
            target=lambda: found.append(state_hash(advect(field, x, (0, 19), 0.1).final))
        )
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [expected] * 4


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_advection_after_fork():
    x = rng(1).uniform(0, 1, (20_000, 3))
    expected = state_hash(advect(substep.ABC(), x, (0, 1), 0.1, threads=2).final)
    child = os.fork()
    if child == 0:
        same = state_hash(advect(substep.ABC(), x, (0, 1), 0.1, threads=2).final) == expected
        os._exit(0 if same else 1)
    assert os.waitpid(child, 0)[1] == 0
