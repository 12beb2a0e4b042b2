"""Logs of quantities: when samples are taken, what is refused, and what files hold."""

import copy
import errno
import os
import pickle
import sys

import numpy as np
import pytest
import substep
from substep import InputError, Logger


def height(bodies):
    return bodies.positions[0, 2]


def falling(**options):
    bodies = substep.RigidBodies(**{"step": 0.01, **options})
    bodies.add(substep.Sphere(0.1), (0, 0, 10), velocities=(1, 0, 0))
    return bodies


def logged(quantities, duration=0.05, **options):
    log, bodies = Logger(quantities, **options), falling()
    log(bodies)
    bodies.advance(duration, log)
    return log


class TestSamples:
    def test_every_step_and_the_start(self):
        log = logged({"height": height, "x": lambda bodies: bodies.positions[0]})
        assert len(log) == 6 and log.names == ("height", "x")
        np.testing.assert_allclose(log.times, 0.01 * np.arange(6), atol=1e-15)
        assert log["height"].shape == (6,) and log["x"].shape == (6, 3)
        np.testing.assert_array_equal(log["x"][:, 2], log["height"])
        np.testing.assert_allclose(log["height"], 10 - 9.81 / 2 * log.times**2, atol=2e-4)
        arrays = log.arrays()
        assert list(arrays) == ["time", "height", "x"]
        np.testing.assert_array_equal(arrays["time"], log.times)

    @pytest.mark.parametrize("every", [0.1, 0.25, 0.3])
    def test_intervals_do_not_drift(self, every):
        log, bodies = Logger({"height": height}, every=every), falling(step=1 / 60)
        log(bodies)
        for _ in range(30):
            bodies.advance(1.0, log)
        expected = np.ceil(every * np.arange(round(30 / every) + 1) * 60 - 1e-6) / 60
        np.testing.assert_allclose(log.times, expected[: len(log)], atol=1e-9)
        assert len(log) == int(30 / every + 1e-9) + 1

    def test_steps_longer_than_the_interval(self):
        assert len(logged({"height": height}, 0.05, every=0.004)) == 6
        assert len(logged({"height": height}, 0.05, every=1e-320)) == 6

    def test_one_time_is_one_sample(self):
        log, bodies = Logger({"height": height}), falling()
        bodies.advance(0.02, log)
        log(bodies)
        assert len(log) == 2

    def test_any_simulation(self):
        drift = substep.Advection(substep.RigidRotation(1.0), [[1.0, 0.0]], step=0.01)
        log = Logger({"radius": lambda one: np.linalg.norm(one.positions)}, every=0.1)
        drift.advance(1.0, log)
        np.testing.assert_allclose(log["radius"], 1.0, atol=1e-9)
        assert len(log) == 10

    def test_what_is_no_array_yet(self):
        log = Logger({"a": height, "b": height})
        assert len(log) == 0 and log["a"].shape == (0,)
        assert {k: v.shape for k, v in log.columns().items()} == dict.fromkeys("ab", (0,)) | {
            "time": (0,)
        }

    def test_copies(self):
        log = logged({"height": height})
        log["height"][:] = 0
        log.times[:] = 0
        assert log["height"][0] == 10 and log.times[-1] > 0
        for other in (copy.copy(log), copy.deepcopy(log), pickle.loads(pickle.dumps(log))):
            bodies = falling()
            bodies.advance(0.1)
            other(bodies)
            assert len(other) == 7 and len(log) == 6
            other.clear()
            assert len(other) == 0 and len(log) == 6

    def test_what_a_quantity_reuses_is_copied(self):
        buffer = np.zeros(2)

        def quantity(bodies):
            buffer[:] = bodies.time
            return buffer

        np.testing.assert_array_equal(
            (log := logged({"b": quantity}))["b"], np.stack([log.times] * 2, axis=-1)
        )


class TestRefused:
    @pytest.mark.parametrize(
        ("quantities", "options", "error", "words"),
        [
            ([height], {}, TypeError, "quantities: expected a mapping"),
            ({}, {}, InputError, "quantities: expected at least one"),
            ({"a,b": height}, {}, InputError, "quantities"),
            ({1: height}, {}, TypeError, "quantities"),
            ({"time": height}, {}, InputError, "'time'"),
            ({"a": 3.0}, {}, TypeError, r"quantities\['a'\]: expected a callable, got 3.0"),
            ({"a": height}, {"every": 0}, InputError, "every"),
            ({"a": height}, {"every": "1"}, TypeError, "every"),
        ],
    )
    def test_arguments(self, quantities, options, error, words):
        with pytest.raises(error, match=words):
            Logger(quantities, **options)

    @pytest.mark.parametrize(
        ("value", "error"),
        [
            ("fast", TypeError),
            (None, TypeError),
            (1j, TypeError),
            ([[1.0], [1.0, 2.0]], InputError),
            (np.ma.masked_array([1.0], [True]), InputError),
            ([1.0, 2.0], InputError),  # a number before
        ],
    )
    def test_values(self, value, error):
        given = [1.0, 2.0, value]
        log, bodies = Logger({"good": height, "bad": lambda bodies: given.pop(0)}), falling()
        with pytest.raises(error, match=r"quantities\['bad'\]: expected|quantities\['bad'\]: mask"):
            bodies.advance(1.0, log)
        assert len(log) == 2 and log["bad"].tolist() == [1.0, 2.0]
        assert log["good"].shape == (2,)
        assert bodies.time == pytest.approx(0.03)

    def test_nan_is_what_is_missing(self):
        assert np.isnan(logged({"a": lambda bodies: np.nan})["a"]).all()

    def test_what_a_quantity_raises_passes_with_its_name(self):
        own = ZeroDivisionError("mine")

        def bad(bodies):
            if bodies.time > 0.025:
                raise own
            return 1

        log, bodies = Logger({"bad": bad}), falling()
        with pytest.raises(ZeroDivisionError) as caught:
            bodies.advance(1.0, log)
        assert caught.value is own and len(log) == 2
        if sys.version_info >= (3, 11):
            assert own.__notes__[0].startswith("raised by quantities['bad'] at 0.03")

    def test_quantities_do_not_step_and_do_not_sample(self):
        with pytest.raises(InputError, match="which may do all but step"):
            falling().advance(0.1, Logger({"a": lambda bodies: bodies.step()}))
        log = Logger({"a": lambda bodies: log(bodies)})
        with pytest.raises(InputError, match="in the middle of a sample"):
            log(falling())
        log = Logger({"a": lambda bodies: log.clear()})
        with pytest.raises(InputError, match="in the middle of a sample"):
            log(falling())

    def test_back_in_time(self):
        log, bodies = Logger({"height": height}), falling()
        start = bodies.state()
        bodies.advance(0.02, log)
        bodies.restore(start)
        with pytest.raises(InputError, match=r"time: expected one after 0.02, the last sample"):
            log(bodies)
        assert len(log) == 2
        log.clear()
        log(bodies)
        assert log.times.tolist() == [0.0]

    def test_names(self):
        with pytest.raises(KeyError, match="'depth'; the logger has height"):
            Logger({"height": height})["depth"]
        with pytest.raises(InputError, match="every: cannot be changed"):
            Logger({"height": height}).every = 1.0


class TestFiles:
    def test_csv_is_read_back(self, tmp_path):
        log = logged(
            {
                "height": height,
                "x": lambda bodies: bodies.positions[0] / 3,
                "m": lambda bodies: np.eye(2) * np.nan,
            }
        )
        log.to_csv(tmp_path / "log.csv")
        names = (tmp_path / "log.csv").read_text().splitlines()[0].split(",")
        assert names == ["time", "height", *(f"x[{i}]" for i in range(3))] + [
            f"m[{i}][{j}]" for i in range(2) for j in range(2)
        ]
        table = np.loadtxt(tmp_path / "log.csv", delimiter=",", skiprows=1)
        np.testing.assert_array_equal(table, np.stack(list(log.columns().values()), axis=-1))

    def test_pandas(self, tmp_path):
        pandas = pytest.importorskip("pandas")
        log = logged({"height": height, "x": lambda bodies: bodies.positions[0]})
        table = log.to_pandas()
        assert table.index.name == "time" and list(table) == ["height", "x[0]", "x[1]", "x[2]"]
        np.testing.assert_array_equal(table["x[0]"], log["x"][:, 0])
        log.to_csv(tmp_path / "log.csv")
        read = pandas.read_csv(tmp_path / "log.csv", index_col="time")
        pandas.testing.assert_frame_equal(read, table, rtol=1e-15)

    def test_pictures(self, tmp_path):
        pytest.importorskip("matplotlib")
        log = logged({"height": height, "x": lambda bodies: bodies.positions[0]})
        log.plot(tmp_path / "log.png")
        assert (tmp_path / "log.png").read_bytes()[:4] == b"\x89PNG"
        with pytest.raises(InputError, match=r"path: .*spam"):
            log.plot(tmp_path / "log.spam")

    def test_pictures_tell_units_and_components(self, tmp_path):
        matplotlib = pytest.importorskip("matplotlib")
        bodies = falling()
        hinge = bodies.hinge(0, None, anchor=(0, 0, 11), axis=(0, 1, 0))
        told = substep.recording.diagnostics("energy", "momentum_x")
        floor = substep.Collider(substep.Plane())
        told |= substep.recording.forces({"floor": floor}) | hinge.quantities("pivot")
        log = Logger(told | {"x": lambda bodies: bodies.positions[0]})
        bodies.advance(0.02, log)
        with matplotlib.rc_context({"svg.fonttype": "none"}):
            log.plot(tmp_path / "log.svg")
        text = (tmp_path / "log.svg").read_text(encoding="utf-8")
        for label in (
            "energy [J]",
            "momentum_x [N s]",
            "floor_force [N]",
            "floor_torque [N m]",
            "pivot_coordinate [rad]",
            "pivot_speed [rad/s]",
            "pivot_torque [N m]",
            "x",
            "y",
            "z",
            "[0]",
        ):
            assert f">{label}</text>" in text
        assert ">[3]</text>" not in text and ">x []" not in text

    @pytest.mark.parametrize("count", [4, 5, 18])
    def test_pictures_of_many_quantities(self, count, tmp_path):
        pytest.importorskip("matplotlib")
        from matplotlib.image import imread

        logged({f"q{k}": height for k in range(count)}).plot(tmp_path / "log.png")
        high, wide = imread(tmp_path / "log.png").shape[:2]
        assert 0.5 * wide < high < 1.5 * wide

    def test_pictures_of_nothing_and_of_gaps(self, tmp_path):
        pytest.importorskip("matplotlib")
        with pytest.raises(InputError, match="the logger has no samples to plot"):
            Logger({"height": height}).plot(tmp_path / "log.png")
        assert not (tmp_path / "log.png").exists()
        gaps = {"none": lambda bodies: [], "gap": lambda bodies: [np.nan, np.inf, 1.0]}
        logged(gaps).plot(tmp_path / "log.png")

    def test_pictures_of_what_is_too_large(self, tmp_path):
        pytest.importorskip("matplotlib")
        log = logged({"x": lambda bodies: [0, 1e308 if bodies.time < 0.025 else -1e308]})
        with pytest.raises(
            InputError, match=r"^quantities\['x'\]\[0, 1\]: expected numbers within"
        ):
            log.plot(tmp_path / "log.png")
        assert not (tmp_path / "log.png").exists()

    def test_a_table_that_cannot_be_written_leaves_the_one_before(self, tmp_path, monkeypatch):
        path, log = tmp_path / "log.csv", logged({"height": height})
        log.to_csv(path)
        before = path.read_bytes()

        def full(fd):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        monkeypatch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match=r"No space left.*log\.csv"):
            logged({"height": height}, 0.1).to_csv(path)
        assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]

    @pytest.mark.parametrize(
        ("module", "call"),
        [("pandas", lambda log: log.to_pandas()), ("matplotlib.figure", lambda log: log.plot("a"))],
    )
    def test_missing_packages(self, module, call, monkeypatch):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(ImportError, match=f"{module.split('.')[0]} is missing: pip install"):
            call(logged({"height": height}))

    @pytest.mark.parametrize(
        ("module", "call"),
        [("pandas", lambda log: log.to_pandas()), ("matplotlib.figure", lambda log: log.plot("a"))],
    )
    @pytest.mark.parametrize(
        "error",
        [
            ImportError("libopenblas.so: failed to map segment from shared object"),
            ModuleNotFoundError("No module named 'pytz'", name="pytz"),
            MemoryError(),
        ],
        ids=["library", "another", "memory"],
    )
    def test_packages_that_are_there_and_fail(self, module, call, error, monkeypatch):
        class Failing:
            def find_spec(self, name, path=None, target=None):
                if name == module:
                    raise error

        pytest.importorskip(module)
        monkeypatch.delitem(sys.modules, module)
        monkeypatch.setattr(sys, "meta_path", [Failing(), *sys.meta_path])
        with pytest.raises(type(error)) as caught:
            call(logged({"height": height}))
        assert caught.value is error


def test_what_has_no_time_is_refused():
    log = substep.Logger({"one": lambda simulation: 1.0})
    with pytest.raises(TypeError, match="simulation: expected one, got -1e"):
        log(-1e308)
    assert len(log.times) == 0
