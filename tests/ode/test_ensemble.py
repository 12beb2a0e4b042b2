"""solve_ensemble: members against single solves, threads, failures and bad input."""

import ctypes
import signal
import time

import numpy as np
import pytest
import substep
from substep import solve_ensemble, solve_ivp
from substep.systems import HarmonicOscillator, Kepler, Lorenz, Oscillators

POINTER = ctypes.POINTER(ctypes.c_double)
SIGNATURE = ctypes.CFUNCTYPE(None, ctypes.c_double, POINTER, POINTER, POINTER)


@SIGNATURE
def logistic(t, y, dydt, p):
    """y' = p_0 y (1 - y / p_1)"""
    dydt[0] = p[0] * y[0] * (1 - y[0] / p[1])


@SIGNATURE
def blow_up(t, y, dydt, p):
    """y' = p_0 y^2: a pole at t = 1 / (p_0 y(0))"""
    dydt[0] = p[0] * y[0] * y[0]


@SIGNATURE
def not_a_number(t, y, dydt, p):
    """y' = -y, NaN from t = p_0 on"""
    dydt[0] = -y[0] if t < p[0] else float("nan")


RATES = np.linspace(0.5, 2.0, 13)
PARAMS = np.stack([RATES, np.full(13, 2.0)], axis=1)


@pytest.mark.parametrize("method", substep.ode.methods())
def test_members_have_the_bits_of_single_solves(method):
    options = {"step": 0.01} if method == "euler" else {"rtol": 1e-7, "atol": 1e-9}
    Y0 = np.linspace(0.1, 0.5, 13)[:, None]
    result = solve_ensemble(logistic, (0, 3), Y0, PARAMS, method, **options)
    for i in range(13):
        single = solve_ivp(logistic, (0, 3), Y0[i], method, args=PARAMS[i], t_eval=[3.0], **options)
        assert np.array_equal(result.y[i], single.y[:, -1])
    assert result.success and not result.status.any() and result.messages == [""] * 13
    assert (result.t_end == 3).all() and (result.nfev > 0).all() and (result.nsteps > 0).all()


def test_closed_form_at_given_times():
    times = np.array([0.0, 0.5, 1.3, 3.0])
    result = solve_ensemble(
        logistic, (0, 3), [0.3], PARAMS, "DOP853", t_eval=times, rtol=1e-11, atol=1e-12
    )
    assert result.y.shape == (13, 1, 4) and np.array_equal(result.t, times)
    exact = 2 / (1 + (2 / 0.3 - 1) * np.exp(-RATES[:, None] * times))
    assert abs(result.y[:, 0] - exact).max() < 1e-9


def test_one_parameter_per_member():
    result = solve_ensemble(blow_up, (0, 1), [0.5], RATES / 2, rtol=1e-9, atol=1e-9)
    assert result.y[:, 0] == pytest.approx(1 / (2 - RATES / 2), rel=1e-6)


def test_backwards_in_time():
    forth = solve_ensemble(logistic, (0, 1), [0.3], PARAMS, rtol=1e-10, atol=1e-10)
    back = solve_ensemble(logistic, (1, 0), forth.y, PARAMS, rtol=1e-10, atol=1e-10)
    assert abs(back.y - 0.3).max() < 1e-8


def test_compiled_systems():
    Y0 = np.array([1.0, 1.0, 1.0]) + np.linspace(0, 0.1, 20)[:, None]
    one = solve_ensemble(Lorenz(), (0, 2), Y0, rtol=1e-8, atol=1e-8)
    assert one.y.shape == (20, 3)
    single = solve_ivp(Lorenz(), (0, 2), Y0[7], rtol=1e-8, atol=1e-8, t_eval=[2.0])
    assert np.array_equal(one.y[7], single.y[:, -1])
    several = solve_ensemble(
        [HarmonicOscillator(w) for w in RATES], (0, 1), [1.0, 0.0], method="rk4", step=1e-3
    )
    assert several.y[:, 0] == pytest.approx(np.cos(RATES), abs=1e-12)


@pytest.mark.parametrize("members", [1, 2, 3, 100, 1001])
@pytest.mark.parametrize("options", [{"method": "rk4", "step": 0.01}, {"rtol": 1e-9}])
def test_the_same_bits_for_any_number_of_threads(members, options):
    rng = np.random.default_rng(members)
    Y0 = np.array([0.4, 0.0, 0.0, 2.0]) + 0.01 * rng.standard_normal((members, 4))
    hashes = set()
    for threads in (1, 2, 3, 4):
        result = solve_ensemble(Kepler(), (0, 3), Y0, t_eval=[1.0, 3.0], threads=threads, **options)
        hashes.add(substep.state_hash(result.y, result.nfev, result.nsteps))
    assert len(hashes) == 1


def test_a_failed_member_is_told_after_the_others_are_done():
    rates = np.array([0.1, 0.2, 5.0, 0.3, 6.0])
    with pytest.raises(substep.SolverError, match="2 of 5 members") as caught:
        solve_ensemble(blow_up, (0, 1), [1.0], rates, t_eval=[0.1, 1.0], rtol=1e-9, atol=1e-9)
    error = caught.value
    assert error.index == 2 and error.time == pytest.approx(0.2, abs=1e-3)
    result = error.result
    assert not result.success and result.status.tolist() == [0, 0, -1, 0, -1]
    assert "spacing" in result.messages[2] or "infinite" in result.messages[2]
    good = [0, 1, 3]
    assert result.y[good, 0, 1] == pytest.approx(1 / (1 - rates[good]), rel=1e-6)
    assert result.y[2, 0, 0] == pytest.approx(2.0, rel=1e-6) and np.isnan(result.y[2, 0, 1])


def test_nan_in_a_member():
    with pytest.raises(substep.NonFiniteError) as caught:
        solve_ensemble(not_a_number, (0, 1), [1.0], [2.0, 0.5, 2.0], "rk4", step=0.01)
    assert caught.value.index == 1
    assert caught.value.result.y[[0, 2], 0] == pytest.approx(np.exp(-1), rel=1e-8)
    assert np.isfinite(caught.value.result.y).all()  # the last good state of member 1


def test_max_steps():
    with pytest.raises(substep.SolverError, match="max_steps") as caught:
        solve_ensemble(logistic, (0, 1), [0.3], PARAMS, "rk4", step=0.01, max_steps=50)
    assert caught.value.index == 0 and (caught.value.result.nsteps == 50).all()
    assert caught.value.result.t_end == pytest.approx(np.full(13, 0.5))


def test_no_time_no_members_no_components():
    same = solve_ensemble(logistic, (1, 1), [0.3], PARAMS)
    assert (same.y == 0.3).all() and same.success
    assert solve_ensemble(Lorenz(), (0, 1), np.zeros((0, 3))).y.shape == (0, 3)
    assert solve_ensemble(Oscillators([]), (0, 1), np.zeros((4, 0))).y.shape == (4, 0)


def test_numba_cfunc():
    numba = pytest.importorskip("numba")
    pointer = numba.types.CPointer(numba.float64)

    @numba.cfunc(numba.void(numba.float64, pointer, pointer, pointer))
    def compiled(t, y, dydt, p):
        dydt[0] = p[0] * y[0] * (1 - y[0] / p[1])

    found = solve_ensemble(compiled, (0, 3), [0.3], PARAMS, rtol=1e-8)
    assert found.y == pytest.approx(solve_ensemble(logistic, (0, 3), [0.3], PARAMS, rtol=1e-8).y)


@pytest.mark.parametrize(
    "change, error, message",
    [
        ({"fun": lambda t, y: -y}, TypeError, "numba.cfunc"),
        ({"fun": 3}, TypeError, "compiled function"),
        ({"fun": []}, TypeError, "compiled function"),
        ({"fun": [Lorenz(), 3]}, TypeError, "compiled function"),
        ({"fun": Lorenz()}, substep.InputError, "takes its parameters"),
        ({"fun": Lorenz(), "params": None}, substep.InputError, "3 components"),
        ({"fun": [Lorenz()] * 4, "params": None, "Y0": np.ones((3, 3))}, ValueError, "4 rows"),
        ({"Y0": np.ones((4, 1))}, substep.InputError, "13 rows"),
        ({"Y0": np.ones((2, 2, 2))}, substep.InputError, "Y0"),
        ({"Y0": [[np.nan]]}, substep.InputError, "Y0"),
        ({"Y0": [["a"]]}, TypeError, "Y0"),
        ({"params": np.ones((2, 2, 2))}, substep.InputError, "params"),
        ({"params": 1.0}, substep.InputError, "params"),
        ({"t_span": (0, np.nan)}, substep.InputError, "t_span"),
        ({"t_eval": []}, substep.InputError, "t_eval"),
        ({"t_eval": [4.0]}, substep.InputError, "t_eval"),
        ({"method": "velocity"}, substep.InputError, "method"),
        ({"step": -1.0}, substep.InputError, "step"),
        ({"rtol": -1.0}, substep.InputError, "rtol"),
        ({"max_steps": 0}, substep.InputError, "max_steps"),
        ({"threads": 0}, substep.InputError, "threads"),
    ],
)
def test_bad_arguments(change, error, message):
    arguments = {"fun": logistic, "t_span": (0, 3), "Y0": [0.3], "params": PARAMS}
    arguments.update(change)
    with pytest.raises(error, match=message):
        solve_ensemble(**arguments)


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_interrupt_of_long_members(share):
    """Members of a second each on two threads: one looks for Ctrl-C, the other must end with it."""
    far = np.full((2, 3), 2.0**40)  # steps as short as can be

    def seconds(alarm=None):
        begin = time.perf_counter()
        if alarm is not None:
            signal.setitimer(signal.ITIMER_REAL, alarm)
        solve_ensemble(Lorenz(), (0.0, 0.5), far, threads=2)
        return time.perf_counter() - begin

    took = seconds()
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    begin = time.perf_counter()
    try:
        with pytest.raises(KeyboardInterrupt):
            seconds(share * took)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert time.perf_counter() - begin - share * took < (1 - share) * took / 2
