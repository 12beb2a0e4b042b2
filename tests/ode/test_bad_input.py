"""What solve_ivp refuses, and how: one test for each kind of wrong input."""

import threading
import time
import traceback

import numpy as np
import pytest
import substep
from substep import ConvergenceError, InputError, NonFiniteError, SolverError, _core

METHODS = substep.ode.methods()
FIRST_ORDER = [name for name in METHODS if _core.ode_method(name)["order"] == 1]


def decay(t, y):
    return -y


def solve(fun=decay, t_span=(0.0, 1.0), y0=(1.0, 2.0), *args, **settings):
    return substep.solve_ivp(fun, t_span, y0, *args, **settings)


@pytest.mark.parametrize("method", ["RK45", "DOP853", "Radau", "implicit_euler", "RKC2"])
def test_local_extrapolation_of_other_methods(method):
    with pytest.raises(InputError, match=f"local_extrapolation: .* the method is {method}"):
        solve(method=method, local_extrapolation=False)
    with pytest.raises(TypeError, match="local_extrapolation: expected a bool"):
        solve(method="rk4", local_extrapolation=1)


# The initial state.


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_y0_not_finite(bad):
    with pytest.raises(InputError, match=r"y0\[1\]: expected finite numbers"):
        solve(y0=[1.0, bad])


@pytest.mark.parametrize("y0", [1.0, [[1.0, 2.0]], np.ones((2, 1)), np.ones((2, 2, 2))])
def test_y0_shape(y0):
    with pytest.raises(InputError, match="y0: expected shape"):
        solve(y0=y0)


@pytest.mark.parametrize("dtype", [np.float32, np.int8, np.int64, np.uint16, bool, ">f8", "<f8"])
def test_y0_widened(dtype):
    result = solve(y0=np.array([1, 0], dtype=dtype))
    assert result.y.dtype == np.float64
    assert result.y[0, -1] == pytest.approx(np.exp(-1), rel=1e-3)


@pytest.mark.parametrize(
    "y0",
    [
        np.array(["1", "2"]),
        np.array([1.0, None], dtype=object),
        np.array([(1.0, 2.0)], dtype=[("a", float), ("b", float)]),
        np.array(["2020-01-01"], dtype="datetime64[D]"),
    ],
)
def test_y0_of_another_kind(y0):
    with pytest.raises(TypeError, match="y0"):
        solve(y0=y0)


def test_y0_ragged_or_masked():
    with pytest.raises(InputError, match="y0: expected rows of equal length"):
        solve(y0=[[1.0], [1.0, 2.0]])
    with pytest.raises(InputError, match="masked"):
        solve(y0=np.ma.masked_array([1.0, 2.0], [False, True]))


@pytest.mark.parametrize(
    "y0",
    [
        np.arange(8.0)[::4] + 1,
        np.array([9.0, 5.0, 1.0])[::-2] * 1.0,
        np.asfortranarray(np.array([[1.0, 5.0], [3.0, 4.0]]))[0],
        np.broadcast_to(np.float64(1.0), 2),
        [1.0, 5.0],
        (1, 5),
    ],
)
def test_y0_layouts(y0):
    result = solve(y0=y0)
    np.testing.assert_array_equal(result.y[:, 0], np.asarray(y0, dtype=float))


def test_y0_is_not_written_to_nor_kept():
    y0 = np.array([1.0, 2.0])
    y0.flags.writeable = False
    result = solve(y0=y0)
    assert not np.shares_memory(result.y, y0)
    np.testing.assert_array_equal(y0, [1.0, 2.0])


def test_y0_whose_array_raises():
    class Duck:
        def __array__(self, dtype=None, copy=None):
            raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        solve(y0=Duck())


def test_empty_and_one_component():
    assert solve(y0=[]).y.shape == (0, 2)
    assert solve(lambda t, y: -y[0], y0=[1.0]).y[0, -1] == pytest.approx(np.exp(-1), rel=1e-3)


# Time.


@pytest.mark.parametrize(
    "t_span", [(0, np.nan), (np.nan, 1), (0, np.inf), (-np.inf, 0), (-1e308, 1e308)]
)
def test_t_span_not_finite(t_span):
    with pytest.raises(InputError, match="t_span"):
        solve(t_span=t_span)


@pytest.mark.parametrize("t_span", [(0,), (0, 1, 2), 1.0, [[0, 1]]])
def test_t_span_shape(t_span):
    with pytest.raises(InputError, match="t_span: expected shape"):
        solve(t_span=t_span)


def test_t_span_reversed_or_empty():
    assert solve(t_span=(1, 0)).y[0, -1] == pytest.approx(np.e, rel=1e-3)
    nothing = solve(t_span=(1, 1))
    np.testing.assert_array_equal(nothing.y[:, -1], [1, 2])


@pytest.mark.parametrize("t_eval", [[-0.1], [1.1], [0.5, 0.4], [0.5, 0.5], [np.nan], [[0.5]], 0.5])
def test_t_eval(t_eval):
    with pytest.raises(InputError, match="t_eval"):
        solve(t_eval=t_eval)


# Numbers that control the steps.


@pytest.mark.parametrize("name", ["step", "first_step", "max_step"])
@pytest.mark.parametrize("value", [0, -1, np.nan, -np.inf])
def test_steps_must_be_positive(name, value):
    with pytest.raises(InputError, match=name):
        solve(**{name: value})


@pytest.mark.parametrize("name", ["step", "first_step"])
@pytest.mark.parametrize("value", ["1", True, [0.1, 0.2]])
def test_steps_must_be_numbers(name, value):
    with pytest.raises(TypeError, match=name):
        solve(**{name: value})


def test_steps_beyond_sense():
    with pytest.raises(InputError, match="step: expected a step above the spacing of t"):
        solve(step=1e-320)
    with pytest.raises(InputError, match="step: expected a step above the spacing of t"):
        solve(t_span=(1e10, 1e10 + 1), step=1e-9)
    assert solve(step=1e300).t.size == 2
    with pytest.raises(InputError, match="first_step"):
        solve(first_step=2.0)
    with pytest.raises(InputError, match="step: fixes the step"):
        solve(step=0.1, max_step=0.2)
    with pytest.raises(SolverError, match="step below spacing of t"):
        solve(t_span=(1, 2), max_step=1e-30)


def test_huge_step_gives_finite_numbers_or_raises():
    with np.errstate(over="ignore"), pytest.raises(NonFiniteError, match="component 0"):
        solve(lambda t, y: -(y**3), t_span=(0, 1e300), y0=[1e3], method="rk4", step=1e290)


@pytest.mark.parametrize("name", ["rtol", "atol"])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf, [1e-3, -1e-3], [1e-3, np.nan]])
def test_tolerances(name, value):
    with pytest.raises(InputError, match=name):
        solve(**{name: value})


def test_rtol_zero_or_below_rounding():
    for rtol in (0, 0.0, 1e-16, [1e-3, 0.0]):
        with pytest.raises(
            InputError, match=r"rtol: expected finite numbers of at least 2\.22e-14"
        ):
            solve(rtol=rtol)
    with pytest.raises(InputError, match=r"atol: expected a number or shape \(2,\), got \(3,\)"):
        solve(atol=[1e-3] * 3)
    assert solve(atol=0.0).success
    assert solve(y0=[0.0, 0.0], atol=0.0).success


@pytest.mark.parametrize("steps", [-1, 0, 1.5, True, "1", None])
def test_max_steps(steps):
    with pytest.raises(InputError, match="max_steps"):
        solve(max_steps=steps)


@pytest.mark.parametrize("method", METHODS)
def test_max_steps_are_kept(method):
    with pytest.raises(SolverError, match="max_steps: 3 steps were not enough") as info:
        solve(method=method, max_step=0.01, max_steps=3)
    assert info.value.result.t.size == 4
    assert info.value.result.status == -1 and not info.value.result.success
    assert info.value.time == info.value.result.t[-1]


def test_two_to_the_forty_steps_can_be_interrupted():
    # tests/test_ode.py interrupts it; here it is accepted.
    assert solve(max_steps=2**40).success


@pytest.mark.parametrize("method", ["rk5", "", "RK23", None, 3, "LSODA"])
def test_unknown_methods_name_ours(method):
    with pytest.raises(InputError, match="expected one of " + ", ".join(METHODS)):
        solve(method=method)


@pytest.mark.parametrize("name", ["event_samples", "threads"])
@pytest.mark.parametrize("value", [0, -1, 1.5, True])
def test_counts(name, value):
    settings = {name: value, "events": lambda t, y: y[0]}
    with pytest.raises(InputError, match=name):
        solve(**settings)


def test_unknown_option():
    with pytest.raises(TypeError, match="tolerance"):
        solve(tolerance=1e-3)


# What fun returns.


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("value", "got"),
    [
        ([1.0, 2.0, 3.0], r"\(3,\)"),
        ([1.0], r"\(1,\)"),
        (np.ones((2, 1)), r"\(2, 1\)"),
        (np.ones((1, 2)), r"\(1, 2\)"),
        (1.0, r"\(\)"),
        (np.float64(1.0), r"\(\)"),
        ([], r"\(0,\)"),
    ],
)
def test_shape_of_the_derivative(method, value, got):
    with pytest.raises(InputError, match=rf"fun: expected shape \(2,\), got {got}"):
        solve(lambda t, y: value, method=method)


@pytest.mark.parametrize(
    "value",
    [
        [1j, 0.0],
        np.array([1j, 2.0]),
        ["a", "b"],
        None,
        [None, 1.0],
        np.array([1.0, 2.0], dtype=object),
        [[1.0], [2.0, 3.0]],
        np.ma.masked_array([1.0, 2.0], [True, False]),
    ],
)
def test_kind_of_the_derivative(value):
    with pytest.raises(InputError, match="fun: "):
        solve(lambda t, y: value)


@pytest.mark.parametrize(
    "convert",
    [
        lambda d: list(d),
        lambda d: tuple(d.tolist()),
        lambda d: d.astype(np.float32),
        lambda d: np.repeat(d, 2)[::2],
        lambda d: d.astype(">f8"),
        lambda d: [np.array(d[0]), d[1]],
        lambda d: np.ma.masked_array(d),
    ],
)
def test_forms_of_the_derivative(convert):
    expected = solve(decay).y[:, -1]
    np.testing.assert_allclose(solve(lambda t, y: convert(-y)).y[:, -1], expected, rtol=1e-5)


def test_integers_and_real_values_for_complex():
    assert solve(lambda t, y: [1, 2]).y[:, -1] == pytest.approx([2, 4])
    assert solve(lambda t, y: [1, 2], y0=[0j, 0j]).y[:, -1] == pytest.approx([1, 2])


@pytest.mark.parametrize("settings", [{}, {"events": lambda t, y: y[0] - 5.0}])
def test_derivatives_beyond_float64(settings):
    with pytest.raises(InputError, match="fun: expected numbers that float64 can hold"):
        solve(lambda t, y: [10**400 if t > 0.3 else 0, 0], **settings)

    def fails(t, y):
        return [float(10**400), 0.0]

    with pytest.raises(OverflowError):  # of fun itself
        solve(fails, **settings)


@pytest.mark.parametrize("method", METHODS)
def test_fun_may_not_write_to_y(method):
    def fun(t, y):
        y[0] = 0.0
        return -y

    with pytest.raises(ValueError, match="read-only"):
        solve(fun, method=method)


@pytest.mark.parametrize("method", METHODS)
def test_the_same_buffer_each_time_gives_the_same_bits(method):
    buffer = np.empty(2)

    def fun(t, y):
        np.negative(y, out=buffer)
        return buffer

    settings = dict(method=method, rtol=1e-8, atol=1e-10, t_span=(0, 0.1))
    fresh, reused = solve(**settings), solve(fun, **settings)
    np.testing.assert_array_equal(fresh.t, reused.t)
    np.testing.assert_array_equal(fresh.y, reused.y)


@pytest.mark.parametrize("keep", [lambda y: y, lambda y: y[:1], lambda y: memoryview(y)])
def test_y_that_fun_keeps_stays_as_it_was(keep):
    kept, copies = [], []

    def fun(t, y):
        kept.append(keep(y))
        copies.append(np.array(y)[: len(kept[-1])])
        return -y

    solve(fun)
    for a, b in zip(kept, copies, strict=True):
        np.testing.assert_array_equal(a, b)
    assert len({c.tobytes() for c in copies}) > 5


def test_fun_may_return_y_itself():
    result = solve(lambda t, y: y, rtol=1e-8)
    assert result.y[0, -1] == pytest.approx(np.e, rel=1e-6)


@pytest.mark.parametrize("fun", [None, 3, "f", [1.0]])
def test_fun_must_be_callable(fun):
    with pytest.raises(TypeError, match="fun"):
        solve(fun)


# What the numbers do.


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("control", [{}, {"step": 0.01}])
def test_derivative_not_finite(method, bad, control):
    calls = []

    def fun(t, y):
        calls.append(t)
        return [-y[0], bad if t > 0.5 else -y[1]]

    with pytest.raises(NonFiniteError, match="component 1, stage") as info:
        solve(fun, method=method, **control)
    error = info.value
    assert error.index == 1
    assert error.time == pytest.approx(0.5, abs=0.011)
    result = error.result
    assert np.isfinite(result.y).all()
    assert 0.48 < result.t[-1] <= 0.511
    tolerance = 0.02 if method in FIRST_ORDER else 2e-3
    assert result.y[0, -1] == pytest.approx(np.exp(-result.t[-1]), rel=tolerance)
    assert result.status == -1 and result.message == str(error)
    assert len(calls) < 5000


def test_derivative_not_finite_at_the_start():
    with pytest.raises(NonFiniteError, match=r"component 0, stage 1.*last good t = 0") as info:
        solve(lambda t, y: [np.nan, 0.0])
    assert info.value.result.t.tolist() == [0.0]


def test_trial_steps_outside_the_domain_are_taken_back():
    """y' = -sqrt(y) is defined for y >= 0 only; a stage beyond is no failure."""
    with np.errstate(invalid="ignore"):
        result = solve(lambda t, y: -np.sqrt(y), t_span=(0, 1.9), y0=[1.0], first_step=1.9)
    assert result.y[0, -1] == pytest.approx(0.05**2, abs=1e-3)


@pytest.mark.parametrize("method", ["rk4", "RK45", "DOP853"])
def test_blow_up_in_finite_time(method):
    with pytest.raises(SolverError, match="t = ") as info:
        solve(lambda t, y: y**2, t_span=(0, 2), y0=[1.0], method=method, dense_output=True)
    error = info.value
    assert error.time == pytest.approx(1, abs=2e-2)
    assert error.result.t[-1] == pytest.approx(error.time, abs=1e-9)
    assert error.result.nfev < 3000
    assert error.result.sol(0.5)[0] == pytest.approx(2, rel=1e-2)


@pytest.mark.parametrize("method", METHODS)
def test_fixed_steps_that_blow_up(method):
    # The equation of an implicit step has no solution before it has an infinite one.
    # A stabilised one would take more stages than it has.
    family = _core.ode_method(method)["family"]
    expected = {"implicit": ConvergenceError, "stabilized": SolverError}.get(family, NonFiniteError)
    with np.errstate(all="ignore"), pytest.raises(expected) as info:
        solve(lambda t, y: y**2, t_span=(0, 3), y0=[1.0], method=method, step=0.05)
    assert np.isfinite(info.value.result.y).all()


def test_native_system_that_blows_up_keeps_the_last_good_step():
    """Runs of many fixed steps at once are taken back and replayed to the step that failed."""
    system = substep.systems.HarmonicOscillator(omega=100.0)
    settings = dict(t_span=(0, 100), y0=[1.0, 0.0], method="rk4", step=0.1)
    with pytest.raises(NonFiniteError, match="step") as last:
        solve(system, t_eval=[100.0], **settings)
    with pytest.raises(NonFiniteError) as every:
        solve(system, **settings)
    assert last.value.time == every.value.time
    assert last.value.step == every.value.step == every.value.result.t.size - 1
    assert np.isfinite(every.value.result.y).all()


def test_tolerance_out_of_reach():
    rng = np.random.default_rng(0)
    with pytest.raises(SolverError, match="step below spacing of t") as info:
        solve(lambda t, y: 1e6 * rng.normal(size=2), t_span=(1, 2), rtol=1e-12, atol=1e-12)
    assert info.value.result.nfev < 20000


# Exceptions, threads, re-entry.


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("error", [KeyError("mine"), KeyboardInterrupt(), SystemExit(3)])
@pytest.mark.parametrize("control", [{}, {"step": 0.1}])
def test_exceptions_of_fun_pass(method, error, control):
    def fun(t, y):
        if t > 0.3:
            raise error
        return -y

    with pytest.raises(type(error)) as info:
        solve(fun, method=method, **control)
    assert info.value is error
    assert any(frame.name == "fun" for frame in traceback.extract_tb(info.tb))


def test_exception_of_the_callback_passes():
    def callback(t, y):
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        solve(callback=callback)
    with pytest.raises(TypeError, match="callback"):
        solve(callback=3)


def make_integration(fun):
    system = _core.PythonSystem(fun, 1, False, (), lambda v: np.asarray(v, dtype=float))
    return _core.Integration(
        system=system,
        method="rk4",
        t=0.0,
        t_bound=1.0,
        y0=np.array([1.0]),
        step=0.1,
        rtol=[1e-3],
        atol=[1e-6],
        first_step=0.0,
        max_step=np.inf,
        threads=0,
        every_step=True,
        t_eval=[],
        dense=False,
        interpolate=False,
    )


def test_reentry_is_refused():
    def fun(t, y):
        integration.run(1)
        return -y

    integration = make_integration(fun)
    with pytest.raises(InputError, match="its own function called it again"):
        integration.run(1)
    assert integration.t == 0.0


def test_a_solve_inside_a_solve():
    def fun(t, y):
        inner = solve(decay, y0=[1.0])
        return -y * inner.y[0, -1] / inner.y[0, -1]

    np.testing.assert_allclose(solve(fun).y, solve(decay).y, rtol=1e-12)


def test_use_by_two_threads_at_once_is_refused():
    entered, leave = threading.Event(), threading.Event()

    def fun(t, y):
        entered.set()
        leave.wait(10)
        return -y

    integration = make_integration(fun)
    thread = threading.Thread(target=integration.run, args=(1,))
    thread.start()
    assert entered.wait(10)
    with pytest.raises(InputError, match="in use by another thread"):
        integration.run(1)
    leave.set()
    thread.join()
    assert integration.steps == 1


def test_fun_that_releases_the_gil_runs_beside_others():
    def fun(t, y):
        time.sleep(0.005)
        return -y

    def run():
        solve(fun, method="rk4", step=0.25)

    def seconds():
        threads = [threading.Thread(target=run) for _ in range(4)]
        start = time.perf_counter()
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return time.perf_counter() - start

    # The best: others may use the CPU.
    assert min(seconds() for _ in range(4)) < 3.5 * 16 * 0.005


# Compiled functions.


def test_compiled_signatures_are_checked():
    numba = pytest.importorskip("numba")
    import ctypes

    wrong = numba.cfunc("float64(float64)")(lambda t: t)
    with pytest.raises(InputError, match="fun: expected a cfunc"):
        solve(wrong)
    with pytest.raises(InputError, match="fun: expected a ctypes function"):
        solve(ctypes.CFUNCTYPE(None, ctypes.c_int)(lambda i: None))
    scipy = pytest.importorskip("scipy")
    with pytest.raises(InputError, match="fun: expected a LowLevelCallable"):
        solve(scipy.LowLevelCallable(wrong.ctypes))


def test_systems_check_state_and_arguments():
    lorenz = substep.systems.Lorenz()
    with pytest.raises(InputError, match=r"y0: expected shape \(3,\), got \(2,\)"):
        solve(lorenz)
    with pytest.raises(InputError, match="args"):
        solve(lorenz, y0=[1, 1, 1], args=(1.0,))
    with pytest.raises(TypeError, match="y0: compiled systems have real states"):
        solve(lorenz, y0=[1j, 1, 1])
    with pytest.raises(InputError, match="y: expected shape"):
        lorenz(0.0, [1.0, 2.0])
    for bad in (np.nan, np.inf):
        with pytest.raises(InputError, match="sigma"):
            substep.systems.Lorenz(sigma=bad)
    with pytest.raises(InputError, match="eccentricity"):
        substep.systems.Kepler(eccentricity=1.0)
    with pytest.raises(InputError, match="masses"):
        substep.systems.Pleiades([1.0, 2.0])
    with pytest.raises(InputError, match="length"):
        substep.systems.Pendulum(length=0.0)


def test_args_must_unpack():
    with pytest.raises(TypeError, match="args: expected a tuple"):
        solve(lambda t, y, a: -y, args=3)
