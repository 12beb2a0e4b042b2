"""Events: zeros of functions of the solution, between and at the ends of steps."""

import math

import numpy as np
import pytest
import scipy.integrate
import substep
from substep import _core
from substep.ode.events import find_root


def oscillator(t, y):
    return [y[1], -y[0]]


def event(function, **attributes):
    for name, value in attributes.items():
        setattr(function, name, value)
    return function


def solve(events, span=(0.0, 10.0), method="DOP853", **settings):
    settings = {"rtol": 1e-9, "atol": 1e-9, **settings}
    return substep.solve_ivp(oscillator, span, [0.0, 1.0], method, events=events, **settings)


@pytest.mark.parametrize("method", substep.ode.methods())
def test_zeros_of_a_sine(method):
    usual = 1e-4 if _core.ode_method(method)["order"] == 2 else 1e-6
    loose = {"euler": 3e-2, "RKC2": 1e-5}.get(method, usual)
    settings = {"rtol": 1e-4, "atol": 1e-6} if method == "euler" else {"rtol": 1e-8, "atol": 1e-8}
    result = solve([lambda t, y: y[0], lambda t, y: y[1]], method=method, **settings)
    np.testing.assert_allclose(result.t_events[0], np.arange(4) * math.pi, atol=10 * loose)
    np.testing.assert_allclose(result.t_events[1], (np.arange(3) + 0.5) * math.pi, atol=10 * loose)
    assert result.y_events[0].shape == (4, 2)
    assert np.abs(result.y_events[0][:, 0]).max() < 1e-12
    assert result.status == 0


def test_direction():
    up = solve(event(lambda t, y: y[0], direction=1))
    down = solve(event(lambda t, y: y[0], direction=-1))
    np.testing.assert_allclose(up.t_events[0], [0, 2 * math.pi], atol=1e-7)
    np.testing.assert_allclose(down.t_events[0], [math.pi, 3 * math.pi], atol=1e-7)


@pytest.mark.parametrize(("terminal", "zeros"), [(True, 1), (1, 1), (2, 2), (3, 3), (False, 3)])
def test_terminal(terminal, zeros):
    result = solve(event(lambda t, y: y[1], terminal=terminal), dense_output=True)
    expected = (np.arange(zeros) + 0.5) * math.pi
    np.testing.assert_allclose(result.t_events[0], expected, atol=1e-8)
    if terminal:
        assert result.status == 1 and result.success
        assert result.message == "A termination event occurred."
        assert result.t[-1] == result.t_events[0][-1] == result.sol.t_max
        np.testing.assert_array_equal(result.y[:, -1], result.y_events[0][-1])
    else:
        assert result.status == 0 and result.t[-1] == 10


@pytest.mark.parametrize("backward", [False, True])
def test_terminal_with_t_eval_and_reversed_time(backward):
    span = (0.0, -10.0) if backward else (0.0, 10.0)
    sign = -1 if backward else 1
    t_eval = sign * np.arange(0.0, 10.1, 0.25)
    result = solve(event(lambda t, y: y[1], terminal=True), span=span, t_eval=t_eval)
    np.testing.assert_allclose(result.t, sign * np.arange(0, math.pi / 2, 0.25))
    assert result.t_events[0][0] == pytest.approx(sign * math.pi / 2, abs=1e-8)
    np.testing.assert_allclose(result.y[0], np.sin(result.t), atol=1e-8)


def test_double_crossing_within_a_step():
    """A dip of the event function below zero for a fifth of a step; SciPy does not see it."""

    def dip(t, y):
        return (t - 0.6) ** 2 - 0.01

    settings = dict(events=dip, first_step=1.0, rtol=1e-3, max_step=1.0)
    ours = substep.solve_ivp(lambda t, y: [0.0], (0, 1), [1.0], event_samples=10, **settings)
    np.testing.assert_allclose(ours.t_events[0], [0.5, 0.7], atol=1e-12)
    theirs = scipy.integrate.solve_ivp(lambda t, y: [0.0], (0, 1), [1.0], **settings)
    assert theirs.t_events[0].size == 0
    once = substep.solve_ivp(lambda t, y: [0.0], (0, 1), [1.0], event_samples=1, **settings)
    assert once.t_events[0].size == 0
    wide = event(lambda t, y: (t - 0.6) ** 2 - 0.03)
    four = substep.solve_ivp(lambda t, y: [0.0], (0, 1), [1.0], events=wide, first_step=1.0)
    assert four.t_events[0].size == 2  # the default, 4 samples


@pytest.mark.parametrize("samples", [1, 4])
def test_zero_at_the_end_of_a_step_counts_once(samples):
    result = substep.solve_ivp(
        lambda t, y: [1.0],
        (0, 1),
        [0.0],
        "rk4",
        step=0.25,
        events=lambda t, y: t - 0.5,
        event_samples=samples,
    )
    np.testing.assert_array_equal(result.t_events[0], [0.5])
    at_the_end = substep.solve_ivp(
        lambda t, y: [1.0], (0, 1), [0.0], "rk4", step=0.25, events=lambda t, y: t - 1.0
    )
    np.testing.assert_array_equal(at_the_end.t_events[0], [1.0])


def test_event_sees_the_crossing_state_only_once_and_in_order():
    result = solve([lambda t, y: y[0] - 0.5, event(lambda t, y: y[0] - 0.7, terminal=True)])
    assert result.t_events[0] == pytest.approx([math.asin(0.5)], abs=1e-8)
    assert result.t_events[1] == pytest.approx([math.asin(0.7)], abs=1e-8)
    later = solve([lambda t, y: y[0] - 0.71, event(lambda t, y: y[0] - 0.7, terminal=True)])
    assert later.t_events[0].size == 0 and later.y_events[0].size == 0


def test_event_of_a_compiled_system():
    system = substep.systems.HarmonicOscillator()
    result = substep.solve_ivp(
        system, (0, 10), [0, 1], "DOP853", events=lambda t, y: y[0], rtol=1e-9, atol=1e-9
    )
    np.testing.assert_allclose(result.t_events[0], np.arange(4) * math.pi, atol=1e-7)


@pytest.mark.parametrize("terminal", [-1, 1.5, -2, np.inf, pytest.param(-(10**5000), id="huge")])
def test_terminal_must_be_a_count(terminal):
    with pytest.raises(substep.InputError, match=r"events\[0\]\.terminal"):
        solve(event(lambda t, y: y[0], terminal=terminal))


def test_event_exceptions_pass_and_values_are_checked():
    def fails(t, y):
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        solve(fails)
    with pytest.raises(substep.InputError, match=r"events\[0\]: expected a real number"):
        solve(lambda t, y: y)
    for huge in (10**400, 10**5000):
        with pytest.raises(substep.InputError, match=r"events\[0\]: expected a real number"):
            solve(lambda t, y, huge=huge: huge)
    with pytest.raises(TypeError, match=r"events\[1\]"):
        solve([lambda t, y: y[0], 3])


@pytest.mark.parametrize(
    ("function", "a", "b", "root"),
    [
        (lambda x: x**3 - 2 * x - 5, 2.0, 3.0, 2.0945514815423265),
        (lambda x: math.cos(x) - x, 0.0, 1.0, 0.7390851332151607),
        (lambda x: (x - 1) ** 9, 0.3, 2.1, 1.0),
        (lambda x: 1.0 if x > 0.1 else -1.0, -1.0, 3.0, 0.1),
        (lambda x: x - 1e-300, -1.0, 1.0, 0.0),
        (lambda x: math.exp(50 * x) - 2.0, 1.0, -1.0, math.log(2) / 50),
    ],
)
def test_root_finder(function, a, b, root):
    calls = []

    def counted(x):
        calls.append(x)
        return function(x)

    found = find_root(counted, a, b, function(a), function(b))
    assert found == pytest.approx(
        root, rel=1e-14, abs=1e-3 if function(0.9) == (-0.1) ** 9 else 3e-15
    )
    assert len(calls) < 180
