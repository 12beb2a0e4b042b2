"""Fields, methods and advection: closed forms, orders, invariants, protocol, bad input."""

import copy
import math
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import substep
from scipy.integrate import solve_ivp
from substep import (
    ABC,
    Advection,
    DoubleGyre,
    InputError,
    NonFiniteError,
    RigidRotation,
    Shear,
    TaylorGreen,
    _core,
    advect,
    state_hash,
)
from substep.errors import CorruptError, FormatError, TruncatedError, VersionError

METHODS = list(_core.advection_methods)
ORDER = {name: _core.tableau(name)["order"] for name in METHODS}
FLOWS = {
    "rotation2": RigidRotation(1.3, (0.2, -0.4)),
    "rotation3": RigidRotation((0.3, -0.5, 0.7), (0.1, 0.2, 0.3)),
    "shear2": Shear(0.7),
    "shear3": Shear(0.7, 3, 2, 0),
    "taylor-green": TaylorGreen(1.2, 0.8, 0.05),
    "abc": ABC(),
    "double-gyre": DoubleGyre(),
}


def formula(field, t, x):
    """The published velocity, written out again in NumPy."""
    if isinstance(field, RigidRotation):
        r = x - field.center
        if field.dimension == 2:
            return field.omega * np.stack([-r[:, 1], r[:, 0]], 1)
        return np.cross(field.omega, r)
    u = np.zeros_like(x)
    if isinstance(field, Shear):
        u[:, field.flow_axis] = field.rate * x[:, field.gradient_axis]
    elif isinstance(field, TaylorGreen):
        k = field.wavenumber
        f = field.amplitude * math.exp(-2 * field.viscosity * k**2 * t)
        u[:, 0] = f * np.sin(k * x[:, 0]) * np.cos(k * x[:, 1])
        u[:, 1] = -f * np.cos(k * x[:, 0]) * np.sin(k * x[:, 1])
    elif isinstance(field, ABC):
        sine, cosine = np.sin(x), np.cos(x)
        u[:, 0] = field.a * sine[:, 2] + field.c * cosine[:, 1]
        u[:, 1] = field.b * sine[:, 0] + field.a * cosine[:, 2]
        u[:, 2] = field.c * sine[:, 1] + field.b * cosine[:, 0]
    else:
        e = field.epsilon * math.sin(field.omega * t)
        f = e * x[:, 0] ** 2 + (1 - 2 * e) * x[:, 0]
        slope = 2 * e * x[:, 0] + 1 - 2 * e
        a, pi = field.amplitude, math.pi
        u[:, 0] = -pi * a * np.sin(pi * f) * np.cos(pi * x[:, 1])
        u[:, 1] = pi * a * np.cos(pi * f) * np.sin(pi * x[:, 1]) * slope
    return u


def points(n, dimension, seed=1, low=0.0, high=2.0):
    return np.random.default_rng(seed).uniform(low, high, (n, dimension))


def test_methods_are_those_of_solve_ivp_without_an_estimate():
    explicit = [m for m in substep.ode.methods() if _core.ode_method(m)["family"] == "explicit"]
    assert METHODS == [m for m in explicit if "error_order" not in _core.tableau(m)]
    for name, (a, b, c, divisor) in _core.advection_methods.items():
        table = _core.tableau(name)
        np.testing.assert_array_equal(np.array(b) / divisor, table["b"])
        np.testing.assert_array_equal(c, table["c"])
        assert all(b_i == round(b_i) for b_i in b)
        for i, row in enumerate(a):
            np.testing.assert_array_equal(row, table["a"][i, :i])


@pytest.mark.parametrize("name", FLOWS)
def test_velocity_is_the_published_formula(name):
    field = FLOWS[name]
    x = points(1000, field.dimension, low=-20, high=20)
    assert np.abs(field(0.7, x) - formula(field, 0.7, x)).max() < 2e-14 * 20


@pytest.mark.parametrize("dtype, bound", [(np.float64, 1e-12), (np.float32, 2e-5)])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", FLOWS)
def test_native_steps_equal_the_same_method_on_a_callable(name, method, dtype, bound):
    field = FLOWS[name]
    x = points(300, field.dimension)
    native = advect(field, x, (0.5, 2.55), 0.1, method, dtype=dtype)
    by_callable = advect(lambda t, y: formula(field, t, y), x, (0.5, 2.55), 0.1, method)
    assert native.final.dtype == dtype
    assert np.abs(native.final - by_callable.final).max() < bound


@pytest.mark.parametrize("method", METHODS)
def test_order_of_convergence_on_the_closed_form_of_rotation(method):
    x = points(20, 2)
    angle = 1.0
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    errors = [
        np.abs(advect(RigidRotation(1.0), x, (0, 1), h, method).final - x @ turn).max()
        for h in (0.02, 0.01)
    ]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(ORDER[method], abs=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_order_of_convergence_in_a_field_that_depends_on_time(method):
    x = points(20, 2, low=0.1, high=0.9)
    field = DoubleGyre(0.25, 0.3, 2.0)
    reference = advect(field, x, (0, 3), 0.001).final
    errors = [
        np.abs(advect(field, x, (0, 3), h, method).final - reference).max() for h in (0.04, 0.02)
    ]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(ORDER[method], abs=0.15)


def test_discrete_closed_form_of_rk4_on_rotation():
    # R(z) = 1 + z + z^2/2 + z^3/6 + z^4/24 at z = i h per step.
    h, n = 0.1, 50
    z = 1j * h
    factor = (1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24) ** n
    end = advect(RigidRotation(1.0), [[1.0, 0.0]], (0, h * n), h).final[0]
    assert end == pytest.approx([factor.real, factor.imag], abs=1e-13)


def test_stream_function_is_kept_by_taylor_green():
    field = TaylorGreen()
    x = points(500, 2, low=0.2, high=6.0)
    end = advect(field, x, (0, 20), 0.01).final
    change = field.stream_function(0, end) - field.stream_function(0, x)
    assert np.abs(change).max() < 1e-9


def test_stream_functions_give_the_velocities():
    x, h = points(100, 2), 1e-6
    for field, sign in ((TaylorGreen(1.1, 0.7, 0.02), 1), (DoubleGyre(), -1)):
        psi = [
            (field.stream_function(0.3, x + d) - field.stream_function(0.3, x - d)) / (2 * h)
            for d in np.eye(2) * h
        ]
        expected = sign * np.stack([psi[1], -psi[0]], 1)
        assert np.abs(field(0.3, x) - expected).max() < 1e-8


def test_abc_agrees_with_dop853_at_tight_tolerance():
    field = ABC()
    x = points(20, 3, high=2 * math.pi)
    solution = solve_ivp(
        lambda t, y: formula(field, t, y.reshape(-1, 3)).ravel(),
        (0, 4), x.ravel(), method="DOP853", rtol=1e-13, atol=1e-13,
    )  # fmt: skip
    end = advect(field, x, (0, 4), 0.002).final
    assert np.abs(end.ravel() - solution.y[:, -1]).max() < 1e-9


def test_backwards_and_forwards_again():
    x = points(100, 3)
    there = advect(ABC(), x, (3.0, 1.0), 0.01)
    back = advect(ABC(), there.final, (1.0, 3.0), 0.01)
    assert np.abs(there.final - x).max() > 0.5
    assert np.abs(back.final - x).max() < 1e-7


def test_last_step_is_shortened_and_outputs_are_hit_exactly():
    seen = []
    result = advect(
        Shear(1.0), [[0.0, 1.0]], (0, 1), 0.3, t_eval=[0, 0.5, 1],
        callback=lambda t, x: seen.append((t, float(x[0, 0]))),
    )  # fmt: skip
    assert [t for t, _ in seen] == pytest.approx([0.3, 0.5, 0.8, 1.0])
    assert [x for _, x in seen] == pytest.approx([0.3, 0.5, 0.8, 1.0])
    assert result.t.tolist() == [0, 0.5, 1]
    assert result.positions[:, 0, 0] == pytest.approx([0, 0.5, 1])
    assert result.stop_time.tolist() == [1.0]


def test_periodic_fields_wrap_only_on_request():
    field = ABC()
    far = [[7.0, -1.0, 3.0]]
    assert field.wrap(far) == pytest.approx(np.mod(far, 2 * math.pi))
    assert field(0, far) == pytest.approx(field(0, field.wrap(far)), abs=1e-14)


@pytest.mark.parametrize("n", [0, 1, 2049])
@pytest.mark.parametrize("dimension", [2, 3])
def test_few_particles(n, dimension):
    field = RigidRotation(1.0) if dimension == 2 else ABC()
    result = advect(field, points(n, dimension), (0, 1), 0.1)
    assert result.final.shape == (n, dimension)
    assert np.isfinite(result.final).all()
    result = advect(lambda t, x: -x, np.ones((n, dimension)), (0, 1), 0.1)
    assert result.final == pytest.approx(np.full((n, dimension), math.exp(-1)), abs=1e-6)


@pytest.mark.parametrize("name", FLOWS)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_same_bits_for_any_number_of_threads(name, dtype):
    field = FLOWS[name]
    x = points(10_007, field.dimension)
    hashes = {
        state_hash(advect(field, x, (0, 1), 0.01, threads=threads, dtype=dtype).final)
        for threads in (1, 2, 3, 4)
    }
    assert len(hashes) == 1


def test_same_bits_alone_and_in_company():
    x = points(5000, 3)
    together = advect(ABC(), x, (0, 1), 0.01).final
    alone = np.concatenate(
        [advect(ABC(), x[i : i + 1], (0, 1), 0.01).final for i in range(0, 5000, 97)]
    )
    assert state_hash(together[::97]) == state_hash(alone)


class TestProtocol:
    def test_step_and_advance_agree(self):
        x = points(50, 2)
        one, two = (Advection(TaylorGreen(), x, step=0.1) for _ in range(2))
        for _ in range(10):
            one.step()
        two.advance(1.0)
        assert one.time == pytest.approx(1.0)
        assert two.time == 1.0
        assert np.abs(one.positions - two.positions).max() < 1e-14
        assert one.steps == two.steps == 10
        two.step(0.05)
        assert two.time == 1.05

    def test_fields_diagnostics_and_limit(self):
        drift = Advection(ABC(), points(7, 3), step=0.1)
        fields = drift.fields()
        assert {name: (a.shape, unit) for name, (a, unit) in fields.items()} == {
            "position": ((7, 3), "m"), "status": ((7,), ""), "stop_time": ((7,), "s"),
        }  # fmt: skip
        assert drift.diagnostics() == {"active": 7, "landed": 0, "escaped": 0, "steps": 0}
        assert drift.step_limit()[0] == 0.1
        assert len(drift) == 7

    def test_copies_are_exact_and_independent(self):
        drift = Advection(ABC(), points(100, 3), step=0.1)
        drift.advance(1.0)
        for twin in (drift.copy(), copy.copy(drift), copy.deepcopy(drift)):
            before = state_hash(drift.positions)
            assert state_hash(twin.positions) == before
            twin.advance(1.0)
            assert state_hash(drift.positions) == before
        with pytest.raises(ValueError, match="read-only"):
            drift.positions[:] = 7.0
        assert state_hash(drift.positions) == before

    def test_checkpoint_is_bit_exact_also_in_a_new_process(self, tmp_path):
        drift = Advection(DoubleGyre(), points(300, 2), step=0.07, time=0.3)
        drift.advance(1.0)
        path = tmp_path / "state.sub"
        drift.save(path)
        kept = drift.state()
        drift.advance(2.0)
        after = state_hash(drift.positions, drift.status, drift.stop_time)
        drift.load(path)
        drift.advance(2.0)
        assert state_hash(drift.positions, drift.status, drift.stop_time) == after
        drift.restore(kept)
        drift.advance(2.0)
        assert state_hash(drift.positions, drift.status, drift.stop_time) == after
        code = (
            "import substep, sys\n"
            "d = substep.Advection(substep.DoubleGyre(), [[0.0, 0.0]], step=0.07)\n"
            "d.load(sys.argv[1]); d.advance(2.0)\n"
            "print(substep.state_hash(d.positions, d.status, d.stop_time))"
        )
        run = subprocess.run(
            [sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True
        )
        assert run.stdout.strip() == after

    def test_spoiled_checkpoints_are_refused(self, tmp_path):
        drift = Advection(ABC(), points(20, 3), step=0.1)
        path = tmp_path / "state.sub"
        drift.save(path)
        good = path.read_bytes()
        before = state_hash(drift.positions)

        def refused(data, kind):
            path.write_bytes(data)
            with pytest.raises(kind):
                drift.load(path)
            assert state_hash(drift.positions) == before

        for length in (9, 31, 40, len(good) - 1):
            refused(good[:length], TruncatedError)
        rng = np.random.default_rng(0)
        for _ in range(200):
            spoiled = bytearray(good)
            spoiled[rng.integers(12, len(good))] ^= 1 << rng.integers(8)
            refused(bytes(spoiled), FormatError)
        refused(good + b"x", CorruptError)
        refused(good[:8] + b"\2" + good[9:], VersionError)
        refused(b"PK\3\4" + good[4:], FormatError)
        path.write_bytes(good)
        with pytest.raises(CorruptError):  # another dimension
            Advection(DoubleGyre(), points(20, 2), step=0.1).load(path)
        with pytest.raises(FileNotFoundError):
            drift.load(tmp_path / "none")

    def test_restore_refuses_what_is_no_state(self):
        drift = Advection(ABC(), points(20, 3), step=0.1)
        state = drift.state()
        for name, value in (
            ("positions", state["positions"][:, :2]),
            ("positions", state["positions"].astype(np.float32)),
            ("status", state["status"][:5]),
            ("status", np.full(20, 9, np.int8)),
            ("time", math.nan),
        ):
            with pytest.raises(InputError, match=name):
                drift.restore({**state, name: value})
        with pytest.raises(InputError, match="missing"):
            drift.restore({})

    def test_use_by_two_threads_or_by_its_own_callback_is_refused(self):
        drift = None

        def velocity(t, x):
            if drift is not None:
                drift.step()
            return x

        drift = Advection(velocity, [[1.0, 0.0]], step=0.1)
        with pytest.raises(InputError, match=r"in use|in the middle of a step"):
            drift.step()
        started, release = threading.Event(), threading.Event()

        def slow(t, x):
            started.set()
            release.wait(10)
            return x

        other = Advection(slow, [[1.0, 0.0]], step=0.1)
        thread = threading.Thread(target=other.step)
        thread.start()
        started.wait(10)
        with pytest.raises(InputError, match=r"in use|in the middle of a step"):
            other.advance(1.0)
        release.set()
        thread.join()
        assert other.steps == 1


class TestFailures:
    def test_overflow_stops_at_the_last_good_step(self):
        x = np.array([[0.0, 1.0], [0.0, 1e300]])
        drift = Advection(Shear(1e6), x, step=100.0)  # row 1 overflows in its second step
        with pytest.raises(NonFiniteError) as info:
            drift.advance(1000.0)
        assert (info.value.index, info.value.step) == (1, 1)
        assert drift.steps == 1
        assert drift.time == info.value.time == 100.0
        assert drift.positions[:, 0] == pytest.approx([1e8, 1e308])
        before = state_hash(drift.positions)
        with pytest.raises(NonFiniteError):
            drift.step()
        assert state_hash(drift.positions) == before
        with pytest.raises(NonFiniteError) as info:
            advect(Shear(1e6), x, (0, 1000), 100.0, t_eval=[100, 1000])
        assert info.value.result.t.tolist() == [100.0, 100.0]

    def test_overflow_with_a_callable(self):
        with pytest.raises(NonFiniteError, match="smaller step"):
            advect(lambda t, x: np.full_like(x, 1e300), [[1.0, 1.0]], (0, 1e10), 1e9)

    def test_callables_that_misbehave(self):
        x = np.array([[1.0, 2.0]])
        for bad, error in (
            (lambda t, y: y[:, 0], InputError),
            (lambda t, y: np.zeros((2, 2)), InputError),
            (lambda t, y: 1.0, InputError),
            (lambda t, y: y * 1j, TypeError),
            (lambda t, y: [["a", "b"]], TypeError),
            (lambda t, y: y * np.nan, NonFiniteError),
        ):
            with pytest.raises(error):
                advect(bad, x, (0, 1), 0.1)

        def writes(t, y):
            y[:] = 0
            return y

        with pytest.raises(ValueError, match="read-only"):
            advect(writes, x, (0, 1), 0.1)

        class Own(Exception):
            pass

        def raises(t, y):
            raise Own

        with pytest.raises(Own):
            advect(raises, x, (0, 1), 0.1)

    def test_nan_of_a_callable_tells_when_and_where(self):
        def velocity(t, x):
            u = np.ones_like(x)
            u[2] = np.nan if t > 0.5 else 1.0
            return u

        drift = Advection(velocity, np.zeros((4, 2)), step=0.2)
        with pytest.raises(NonFiniteError) as info:
            drift.advance(2.0)
        assert info.value.index == 2
        assert 0.5 < info.value.time < 0.61
        assert drift.steps == 2 and drift.time == pytest.approx(0.4)

    def test_same_buffer_each_time_gives_the_same_bits(self):
        buffer = np.empty((3, 2))

        def reuses(t, x):
            np.multiply(x, -1.0, out=buffer)
            return buffer

        x = points(3, 2)
        assert state_hash(advect(reuses, x, (0, 1), 0.1).final) == state_hash(
            advect(lambda t, y: -y, x, (0, 1), 0.1).final
        )

    def test_step_below_the_spacing_of_time(self):
        with pytest.raises(substep.SolverError, match="spacing"):
            advect(Shear(), [[0.0, 1.0]], (1e20, 2e20), 1.0)


BAD_NUMBERS = [math.nan, math.inf, 0.0, -0.1]
GOOD = {"positions": [[0.0, 1.0]], "t_span": (0, 1), "step": 0.1}
X = np.zeros((3, 2))


class TestBadInput:
    @pytest.mark.parametrize(
        "name, value, error",
        [
            ("positions", [[0.0, math.nan]], InputError),
            ("positions", [[0.0, math.inf]], InputError),
            ("positions", [0.0, 1.0], InputError),
            ("positions", np.zeros((2, 3)), InputError),
            ("positions", np.zeros((3, 2, 1)), InputError),
            ("positions", 1.0, InputError),
            ("positions", [[1.0], [1.0, 2.0]], (InputError, ValueError)),
            ("positions", X * 1j, TypeError),
            ("positions", X.astype(object), TypeError),
            ("positions", X.astype(str), TypeError),
            ("positions", np.ma.masked_less(X, 1.0), InputError),
            ("t_span", (0, math.nan), InputError),
            ("t_span", (0, math.inf), InputError),
            ("t_span", (0, 1, 2), InputError),
            *[("step", value, InputError) for value in BAD_NUMBERS],
            ("step", True, TypeError),
            ("step", "0.1", TypeError),
            ("method", "rk5", InputError),
            ("method", None, InputError),
            ("t_eval", [0.5, 0.2], InputError),
            ("t_eval", [2.0], InputError),
            ("t_eval", [-1.0, 0.0], InputError),
            ("on_land", "ignore", InputError),
            ("on_escape", "vanish", InputError),
            ("threads", 0, InputError),
            ("threads", 1.5, InputError),
            ("dtype", np.float16, InputError),
            ("callback", 3, TypeError),
            ("field", 3, TypeError),
        ],
    )
    def test_is_refused_by_name(self, name, value, error):
        arguments = {"field": Shear(), **GOOD, name: value}
        with pytest.raises(error, match="number of axes|" + name):
            advect(**arguments)

    @pytest.mark.parametrize("value", [*BAD_NUMBERS, 1e308 * 10])
    def test_dt(self, value):
        drift = Advection(Shear(), X, step=0.1)
        before = state_hash(drift.positions)
        with pytest.raises(InputError, match="dt"):
            drift.step(value)
        if value != 0:
            with pytest.raises(InputError, match="duration"):
                drift.advance(value)
        else:
            drift.advance(value)
        assert (drift.steps, drift.time, state_hash(drift.positions)) == (0, 0.0, before)

    def test_huge_and_tiny_steps(self):
        assert np.isfinite(advect(Shear(), [[0.0, 1.0]], (0, 1e300), 1e300).final).all()
        with pytest.raises(NonFiniteError):
            advect(Shear(), [[0.0, 1e300]], (0, 1e300), 1e300)
        assert advect(Shear(), [[0.0, 1.0]], (0, 1e-320), 1e-320).final[0, 0] == pytest.approx(
            0, abs=2e-320
        )

    @pytest.mark.parametrize(
        "make",
        [
            lambda x: x.tolist(),
            lambda x: np.asfortranarray(x),
            lambda x: np.repeat(x, 2, axis=0)[::2],
            lambda x: x[::-1][::-1],
            lambda x: x.astype(">f8"),
            lambda x: np.ma.masked_array(x),
        ],
    )
    def test_other_layouts_are_copied(self, make):
        x = points(30, 2)
        expected = state_hash(advect(TaylorGreen(), x, (0, 1), 0.1).final)
        given = make(x)
        before = state_hash(np.asarray(given))
        assert state_hash(advect(TaylorGreen(), given, (0, 1), 0.1).final) == expected
        assert state_hash(np.asarray(given)) == before

    def test_integers_booleans_and_broadcast_views_are_widened(self):
        expected = advect(Shear(), [[0.0, 1.0]], (0, 1), 0.5).final.tolist()
        for x in (np.array([[0, 1]]), np.array([[False, True]]), np.float32([[0, 1]])):
            assert advect(Shear(), x, (0, 1), 0.5).final.tolist() == expected
        view = np.broadcast_to(np.array([0.0, 1.0]), (5, 2))
        assert advect(Shear(), view, (0, 1), 0.5).final.tolist() == expected * 5

    def test_zero_length_span_gives_the_positions(self):
        assert advect(Shear(), [[1.0, 2.0]], (3, 3), 0.1).final.tolist() == [[1.0, 2.0]]

    @pytest.mark.parametrize(
        "make",
        [
            lambda: RigidRotation([1.0, 2.0]),
            lambda: RigidRotation(1.0, (0, 0, 0)),
            lambda: RigidRotation(math.nan),
            lambda: Shear(dimension=4),
            lambda: Shear(flow_axis=2),
            lambda: Shear(flow_axis=1),
            lambda: TaylorGreen(wavenumber=0),
            lambda: TaylorGreen(viscosity=-1),
            lambda: ABC(a=math.inf),
            lambda: DoubleGyre(epsilon=math.nan),
        ],
    )
    def test_parameters_of_flows(self, make):
        with pytest.raises(InputError):
            make()


def seconds_to_stop(drift):
    """Advances a long way, sends Ctrl-C after 0.2 s, and tells how long it took to come back."""
    sent = []

    def interrupt():
        sent.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(0.2, interrupt)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        drift.advance(1e4)
    late = time.perf_counter() - sent[0]
    timer.join()
    return late


@pytest.mark.parametrize("field", [ABC(), DoubleGyre()])
def test_ctrl_c_stops_a_million_particles_within_a_tenth_of_a_second(field):
    x = points(1_000_000, field.dimension, high=1.0)
    drift = Advection(field, x, step=1e-3)
    assert min(seconds_to_stop(drift) for _ in range(4)) < 0.1  # the best: others may use the CPU
    assert drift.time == pytest.approx(drift.steps * 1e-3)
    again = advect(field, x[:100], (0, drift.time), 1e-3)
    assert np.abs(again.final - drift.positions[:100]).max() < 1e-12
