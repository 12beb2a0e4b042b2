"""solve_second_order: orders, discrete closed forms, limits, energy, outputs and bad input."""

import ctypes
import threading

import numpy as np
import pytest
import substep
from substep import _core, solve_second_order

METHODS = {entry["name"]: entry for entry in _core.second_order_methods()}
VERLETS = ("position_verlet", "velocity_verlet")
CUBE_ROOT_2 = np.cbrt(np.longdouble(2))


def end(acceleration, t_end, x0, v0, method, step, **options):
    result = solve_second_order(
        acceleration, (0, t_end), x0, v0, method, step=step, t_eval=[t_end], **options
    )
    return result.x[..., -1], result.v[..., -1]


def pendulum(t, x, v):
    return -np.sin(x)


def observed_order(acceleration, exact, method, steps, t_end, x0, v0):
    errors = []
    for n in steps:
        x, v = end(acceleration, t_end, x0, v0, method, t_end / n)
        errors.append(max(abs(x - exact[0]).max(), abs(v - exact[1]).max()))
    return np.log2(errors[0] / errors[1])


@pytest.mark.parametrize("method", METHODS)
def test_order_of_convergence(method):
    reference = substep.solve_ivp(
        lambda t, y: [y[1], -np.sin(y[0])], (0, 4), [2.0, 0.3], "DOP853", rtol=1e-13, atol=1e-13
    ).y[:, -1]
    order = METHODS[method]["order"]
    steps = (200, 400) if order == 4 else (2000, 4000)
    observed = observed_order(pendulum, reference, method, steps, 4, [2.0], [0.3])
    assert observed == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_order_with_a_force_that_depends_on_time(method):
    # x'' = -x + 2 cos t, x(0) = 0, v(0) = 1: x = sin t + t sin t
    exact = (np.sin(3) + 3 * np.sin(3), np.cos(3) + np.sin(3) + 3 * np.cos(3))
    order = METHODS[method]["order"]
    steps = (100, 200) if order == 4 else (2000, 4000)
    observed = observed_order(
        lambda t, x, v: -x + 2 * np.cos(t), exact, method, steps, 3, [0.0], [1.0]
    )
    assert observed == pytest.approx(order, abs=0.1)


def damped(omega, c, t):
    """Closed form of x'' = -omega^2 x - c v, x(0) = 1, v(0) = 0, underdamped."""
    wd = np.sqrt(omega**2 - c**2 / 4)
    decay = np.exp(-c * t / 2)
    x = decay * (np.cos(wd * t) + c / (2 * wd) * np.sin(wd * t))
    return x, -decay * omega**2 / wd * np.sin(wd * t)


@pytest.mark.parametrize("method", METHODS)
def test_damping_against_the_closed_form(method):
    """Forces that depend on the velocity: order 2 for the Verlets, Yoshida's too, as documented."""
    omega, c, t = 2.0, 0.5, 5.0
    exact = damped(omega, c, t)
    observed = observed_order(
        lambda t, x, v: -(omega**2) * x - c * v, exact, method, (2000, 4000), t, [1.0], [0.0]
    )
    assert observed == pytest.approx(min(METHODS[method]["order"], 2), abs=0.1)
    x, v = end(substep.systems.HarmonicOscillator(omega, c), t, [1.0], [0.0], method, t / 100_000)
    assert max(abs(x - exact[0]), abs(v - exact[1])) < (1e-8 if "euler" not in method else 1e-3)


def verlet_map(z):
    """One step of either Verlet on x'' = -x with step z."""
    z = np.longdouble(z)
    half = 1 - z * z / 2
    return np.array([[half, z], [-z * (1 - z * z / 4), half]])


def discrete_map(method, z):
    z = np.longdouble(z)
    if method == "symplectic_euler":
        return np.array([[1 - z * z, z], [-z, np.longdouble(1)]])
    if method == "yoshida4":
        w1 = 1 / (2 - CUBE_ROOT_2)
        outer = verlet_map(w1 * z)
        return outer @ verlet_map((1 - 2 * w1) * z) @ outer
    return verlet_map(z)


@pytest.mark.parametrize("z", [0.01, 0.3, 0.8])
@pytest.mark.parametrize("method", METHODS)
def test_discrete_closed_form_on_the_oscillator(method, z):
    """100 steps give the 100th power of the method's own matrix."""
    y = np.array([0.7, -0.4], dtype=np.longdouble)
    for _ in range(100):
        y = discrete_map(method, z) @ y
    x, v = end(substep.systems.HarmonicOscillator(), 100 * z, [0.7], [-0.4], method, z)
    bound = 4e-14 if method == "yoshida4" else 5e-15  # its weights are rounded
    assert abs(np.array([x[0], v[0]]) - y).max() < bound


@pytest.mark.parametrize("method", [m for m in METHODS if METHODS[m]["order"] < 4])
def test_symplectic_limit(method):
    """h omega < 2: bounded; at 2: growth is linear, exactly; above: exponential."""
    oscillator = substep.systems.HarmonicOscillator()
    n = 1000

    def amplitudes(h):
        return abs(solve_second_order(oscillator, (0, n * h), [1.0], [0.5], method, step=h).x[0])

    assert amplitudes(1.99).max() < 20
    slope = 1.0 if method in VERLETS else 2 * (1 - 0.5)  # x_k = (-1)^k (x_0 -+ k slope)
    sign = -1 if method in VERLETS else 1
    k = np.arange(n + 1)
    assert np.array_equal(amplitudes(2.0), abs(1 + sign * slope * k))
    growth = amplitudes(2.01)
    rate = np.arccosh(2.01**2 / 2 - 1)  # e^rate is the greater root of the characteristic equation
    assert np.log(growth[n] / growth[n - 100]) / 100 == pytest.approx(rate, rel=1e-3)


def test_yoshida_limit():
    """Stable where the trace of its matrix is within 2 in modulus: h omega < 1.5734."""
    assert abs(np.trace(discrete_map("yoshida4", 1.5733))) < 2
    assert abs(np.trace(discrete_map("yoshida4", 1.5735))) > 2
    oscillator = substep.systems.HarmonicOscillator()
    inside = solve_second_order(oscillator, (0, 1573), [1.0], [0.0], "yoshida4", step=1.573)
    outside = solve_second_order(oscillator, (0, 1580), [1.0], [0.0], "yoshida4", step=1.58)
    assert abs(inside.x).max() < 100 and abs(outside.x).max() > 1e6


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "system",
    [
        substep.systems.Kepler(),
        substep.systems.HenonHeiles(),
        substep.systems.Arenstorf(),
        substep.systems.Pendulum(damping=0.3),
        substep.systems.HarmonicOscillator(2.0, 0.1),
        substep.systems.Pleiades(),
    ],
    ids=lambda system: type(system).__name__,
)
def test_inlined_steps_give_the_bits_of_single_steps(system, method):
    x0, v0 = np.split(system.y0, 2)
    problem = dict(x0=x0, v0=v0, method=method, step=0.001, t_eval=[0.5, 0.7003, 1.0001])
    inlined = solve_second_order(system, (0, 1.0001), **problem)
    single = solve_second_order(system, (0, 1.0001), **problem, callback=lambda t, x, v: None)
    assert np.array_equal(inlined.x, single.x) and np.array_equal(inlined.v, single.v)
    assert inlined.nfev == single.nfev


@pytest.mark.parametrize("method", METHODS)
def test_reversing_time_returns_to_the_start(method):
    kepler = substep.systems.Kepler()
    x0, v0 = kepler.y0[:2], kepler.y0[2:]
    x, v = end(kepler, 20, x0, v0, method, 0.01)
    back = solve_second_order(kepler, (20, 0), x, v, method, step=0.01)
    error = max(abs(back.x[:, -1] - x0).max(), abs(back.v[:, -1] - v0).max())
    assert (error < 1e-11) if METHODS[method]["symmetric"] else (error > 1e-3)
    assert back.t[0] == 20 and back.t[-1] == 0


def test_start_up_step_and_central_difference_of_position_verlet():
    h = 0.1
    result = solve_second_order(pendulum, (0, 1), [1.0], [0.5], "position_verlet", step=h)
    x, v, a = result.x[0], result.v[0], -np.sin(result.x[0])
    assert x[1] == pytest.approx(1 + h * 0.5 + h * h / 2 * -np.sin(1), abs=1e-15)
    assert x[2:] == pytest.approx(2 * x[1:-1] - x[:-2] + h * h * a[1:-1], abs=1e-14)
    assert v[1:-1] == pytest.approx((x[2:] - x[:-2]) / (2 * h), abs=1e-13)


HENON_HEILES = (0.0, 0.1, np.sqrt(2 * (1 / 8 - 0.5 * 0.01 + 0.001 / 3)), 0.0)
ENERGY = [  # system, initial state, step, {method: max relative error over 1e6 steps}
    (
        substep.systems.Kepler(eccentricity=0.6),
        None,
        0.01,
        {"velocity_verlet": 7.4e-4, "yoshida4": 1.0e-6, "symplectic_euler": 2.9e-2},
    ),
    (
        substep.systems.Kepler(eccentricity=0.9),
        None,
        0.001,
        {"velocity_verlet": 2.5e-3, "yoshida4": 1.6e-6, "symplectic_euler": 0.11},
    ),
    (
        substep.systems.HenonHeiles(),
        HENON_HEILES,
        0.05,
        {"velocity_verlet": 7.2e-4, "yoshida4": 5.1e-7, "symplectic_euler": 2.4e-2},
    ),
]
ENERGY_CASES = [
    pytest.param(system, y0, step, method, bound, id=f"{type(system).__name__}-{step}-{method}")
    for system, y0, step, bounds in ENERGY
    for method, bound in {**bounds, "position_verlet": bounds["velocity_verlet"]}.items()
]


def energy_errors(system, states):
    energy = system.energy(states)
    return np.maximum.accumulate(abs(energy / energy[0] - 1))[[10**4, 10**5, 10**6]]


@pytest.mark.slow
@pytest.mark.parametrize("system, y0, step, method, bound", ENERGY_CASES)
def test_energy_stays_flat_over_a_million_steps(system, y0, step, method, bound):
    y0 = system.y0 if y0 is None else np.array(y0)
    result = solve_second_order(system, (0, 1e6 * step), y0[:2], y0[2:], method, step=step)
    errors = energy_errors(system, np.concatenate([result.x, result.v]))
    assert errors[2] == pytest.approx(bound, rel=0.06)
    # No growth; the chaotic orbit explores its energy surface a little longer.
    chaotic = isinstance(system, substep.systems.HenonHeiles)
    assert errors[2] < errors[0] * (1.1 if chaotic else 1.001)


@pytest.mark.slow
@pytest.mark.parametrize(
    "system, y0, step, bounds",
    [
        (substep.systems.Kepler(eccentricity=0.6), None, 0.01, (4.0e-7, 3.5e-6, 3.5e-5)),
        (substep.systems.HenonHeiles(), HENON_HEILES, 0.05, (6.5e-6, 6.5e-5, 6.5e-4)),
    ],
    ids=["Kepler", "HenonHeiles"],
)
def test_energy_error_of_rk4_grows_linearly(system, y0, step, bounds):
    y0 = system.y0 if y0 is None else y0
    result = substep.solve_ivp(system, (0, 1e6 * step), y0, "rk4", step=step)
    assert energy_errors(system, result.y) == pytest.approx(np.array(bounds), rel=0.1)


# Outputs ---------------------------------------------------------------------------------------


def test_every_step_by_default_and_shapes_follow_x0():
    x0 = np.arange(6.0).reshape(2, 3)
    result = solve_second_order(lambda t, x, v: -x, (0, 1), x0, 0 * x0, step=0.25)
    assert result.success and result.status == 0 and "end" in result.message
    assert np.array_equal(result.t, [0, 0.25, 0.5, 0.75, 1])
    assert result.x.shape == result.v.shape == (2, 3, 5)
    assert np.array_equal(result.x[..., 0], x0)
    assert result.nfev == 5 and result.nsteps == 4


def test_last_step_is_shortened():
    result = solve_second_order(lambda t, x, v: -x, (0, 1), [1.0], [0.0], step=0.3)
    assert result.t == pytest.approx([0, 0.3, 0.6, 0.9, 1.0], abs=1e-15) and result.t[-1] == 1
    for method in METHODS:
        x, _ = end(lambda t, x, v: -x, 1, [1.0], [0.0], method, 0.0003)
        assert x[0] == pytest.approx(np.cos(1), abs=1e-3)


def test_no_step_is_added_by_rounding():
    result = solve_second_order(lambda t, x, v: -x, (0, 0.3), [1.0], [0.0], step=0.1)
    assert result.t.size == 4 and result.t[-1] == 0.3


@pytest.mark.parametrize("method", METHODS)
def test_output_between_steps_is_the_cubic_through_them(method):
    interpolate = pytest.importorskip("scipy.interpolate")
    times = np.linspace(0, 5, 73)
    every = solve_second_order(pendulum, (0, 5), [1.0], [0.5], method, step=0.1)
    some = solve_second_order(pendulum, (0, 5), [1.0], [0.5], method, step=0.1, t_eval=times)
    assert np.array_equal(some.t, times)
    x = interpolate.CubicHermiteSpline(every.t, every.x[0], every.v[0])
    v = interpolate.CubicHermiteSpline(every.t, every.v[0], -np.sin(every.x[0]))
    assert abs(some.x[0] - x(times)).max() < 1e-14
    assert abs(some.v[0] - v(times)).max() < 1e-14


def test_interpolated_velocity():
    h, times = 0.02, np.linspace(0, 3, 101)
    result = solve_second_order(
        lambda t, x, v: -x, (0, 3), [1.0], [0.0], "yoshida4", step=h, t_eval=times
    )
    assert abs(result.x[0] - np.cos(times)).max() < 5e-8
    assert abs(result.v[0] + np.sin(times)).max() < 5e-8


def test_zero_length_and_empty_systems():
    result = solve_second_order(pendulum, (2, 2), [1.0], [0.5], step=0.1)
    assert result.t.tolist() == [2] and result.x.tolist() == [[1.0]]
    empty = solve_second_order(pendulum, (0, 1), np.zeros((0, 3)), np.zeros((0, 3)), step=0.5)
    assert empty.x.shape == (0, 3, 3)


def test_callback_and_args():
    seen = []
    result = solve_second_order(
        lambda t, x, v, k, c: -k * x - c * v,
        (0, 1),
        [1.0, 2.0],
        [0.0, 0.0],
        step=0.5,
        args=(4.0, 0.1),
        callback=lambda t, x, v: seen.append((t, x, v)),
    )
    assert [t for t, _, _ in seen] == [0.5, 1.0]
    assert np.array_equal(seen[1][1], result.x[:, -1])
    assert np.array_equal(seen[0][2], result.v[:, 1])


# Native functions --------------------------------------------------------------------------------

POINTER = ctypes.POINTER(ctypes.c_double)
SIGNATURE = ctypes.CFUNCTYPE(None, ctypes.c_double, POINTER, POINTER, POINTER, POINTER)


@SIGNATURE
def native_oscillator(t, x, v, a, p):
    a[0] = -p[0] * x[0] - p[1] * v[0]


@pytest.mark.parametrize("method", METHODS)
def test_ctypes_function_gives_the_bits_of_python(method):
    native = end(native_oscillator, 3, [1.0], [0.5], method, 0.01, args=[2.0, 0.1])
    python = end(lambda t, x, v: -2.0 * x - 0.1 * v, 3, [1.0], [0.5], method, 0.01)
    assert np.array_equal(native, python)


def test_low_level_callable():
    scipy = pytest.importorskip("scipy")
    wrapped = scipy.LowLevelCallable(
        native_oscillator, signature="void (double, double *, double *, double *, double *)"
    )
    expected = end(native_oscillator, 3, [1.0], [0.5], "yoshida4", 0.01, args=[2.0, 0.1])
    assert np.array_equal(
        end(wrapped, 3, [1.0], [0.5], "yoshida4", 0.01, args=[2.0, 0.1]), expected
    )


def test_numba_cfunc():
    numba = pytest.importorskip("numba")
    pointer = numba.types.CPointer(numba.float64)

    @numba.cfunc(numba.void(numba.float64, pointer, pointer, pointer, pointer))
    def oscillator(t, x, v, a, p):
        a[0] = -p[0] * x[0] - p[1] * v[0]

    expected = end(native_oscillator, 3, [1.0], [0.5], "velocity_verlet", 0.01, args=[2.0, 0.1])
    found = end(oscillator, 3, [1.0], [0.5], "velocity_verlet", 0.01, args=[2.0, 0.1])
    assert np.array_equal(found, expected)

    @numba.cfunc(numba.void(numba.float64, pointer, pointer, pointer))
    def first_order(t, y, dydt, p):
        dydt[0] = y[0]

    with pytest.raises(substep.InputError, match="acceleration: expected a cfunc void"):
        end(first_order, 1, [1.0], [0.0], "velocity_verlet", 0.1)


def test_threads_of_python_share_a_system():
    kepler = substep.systems.Kepler()
    results = [None] * 4

    def work(i):
        results[i] = end(kepler, 50, kepler.y0[:2], kepler.y0[2:], "yoshida4", 0.001)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({substep.state_hash(*r) for r in results}) == 1


# Bad input ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_nan_raises_with_what_was_solved(method):
    def nan_later(t, x, v):
        return np.array([-x[0], np.nan if t > 0.5 else -x[1]])

    with pytest.raises(substep.NonFiniteError, match="stage") as caught:
        solve_second_order(nan_later, (0, 1), [1.0, 2.0], [0.0, 0.0], method, step=0.1)
    error = caught.value
    last = 4 if method == "yoshida4" else 5  # whose first stage ends behind the step
    assert 0.5 < error.time <= 0.6 and error.index == 1 and error.step == last
    assert error.result.t[-1] == last * 0.1 and np.isfinite(error.result.x).all()
    assert not error.result.success and error.result.status == -1
    with pytest.raises(substep.NonFiniteError) as caught:
        end(nan_later, 1, [1.0, 2.0], [0.0, 0.0], method, 0.1)
    assert caught.value.result.t.tolist() == [last * 0.1]


def test_nan_at_the_start():
    with pytest.raises(substep.NonFiniteError) as caught:
        solve_second_order(lambda t, x, v: x * np.nan, (0, 1), [1.0], [0.0], step=0.1)
    assert caught.value.time == 0 and caught.value.result.t.tolist() == [0]


def test_explosion_ends_at_the_last_finite_step():
    with pytest.raises(substep.NonFiniteError) as caught, np.errstate(over="ignore"):
        solve_second_order(lambda t, x, v: x**3, (0, 100), [1.0], [1.0], step=0.01)
    assert np.isfinite(caught.value.result.x).all()
    assert caught.value.result.t[-1] < caught.value.time


@pytest.mark.parametrize(
    "value, message",
    [
        (lambda x: np.zeros(3), r"shape \(2,\), got \(3,\)"),
        (lambda x: np.zeros(1), r"shape \(2,\), got \(1,\)"),
        (lambda x: np.zeros((2, 1)), r"shape \(2,\), got \(2, 1\)"),
        (lambda x: 0.5, r"shape \(2,\), got \(\)"),
    ],
)
def test_wrong_shapes_from_the_acceleration(value, message):
    with pytest.raises(substep.InputError, match=message):
        solve_second_order(lambda t, x, v: value(x), (0, 1), [1.0, 2.0], [0.0, 0.0], step=0.1)


@pytest.mark.parametrize("value", [None, "ab", np.array([1j, 2j]), [None, None], object()])
def test_wrong_types_from_the_acceleration(value):
    with pytest.raises((TypeError, substep.InputError)):
        solve_second_order(lambda t, x, v: value, (0, 1), [1.0, 2.0], [0.0, 0.0], step=0.1)


@pytest.mark.parametrize(
    "convert", [list, tuple, lambda a: a.astype(np.float32), lambda a: a[::-1].copy()[::-1]]
)
def test_what_can_be_converted_is(convert):
    plain = end(lambda t, x, v: -2 * x, 1, [1.0, 2.0], [0.0, 0.0], "velocity_verlet", 0.5)
    other = end(lambda t, x, v: convert(-2 * x), 1, [1.0, 2.0], [0, 0], "velocity_verlet", 0.5)
    assert np.array_equal(plain, other)


@pytest.mark.parametrize("which", [1, 2])
def test_arguments_are_read_only(which):
    def mutate(*arguments):
        arguments[which][0] = 5.0
        return -arguments[1]

    with pytest.raises(ValueError, match="read-only"):
        solve_second_order(mutate, (0, 1), [1.0], [0.0], step=0.1)


def test_kept_arguments_keep_their_values():
    kept = []

    def keep(t, x, v):
        kept.append((x, v[:1]))
        return -x

    result = solve_second_order(keep, (0, 1), [1.0], [0.5], "symplectic_euler", step=0.1)
    assert np.array_equal(np.array([x[0] for x, _ in kept]), result.x[0])
    assert np.array_equal(np.array([v[0] for _, v in kept]), result.v[0])


def test_a_reused_buffer_gives_the_same_bits():
    buffer = np.empty(2)

    def reuse(t, x, v):
        np.negative(x, out=buffer)
        return buffer

    reused = end(reuse, 1, [1.0, 2.0], [0.0, 0.0], "yoshida4", 0.1)
    fresh = end(lambda t, x, v: -x, 1, [1.0, 2.0], [0.0, 0.0], "yoshida4", 0.1)
    assert np.array_equal(reused, fresh)


@pytest.mark.parametrize("error", [KeyError("mine"), KeyboardInterrupt(), SystemExit(3)])
def test_exceptions_of_the_user_pass(error):
    x0 = np.array([1.0])
    with pytest.raises(type(error)) as caught:

        def fail(t, x, v):
            raise error

        solve_second_order(fail, (0, 1), x0, [0.0], step=0.1)
    assert caught.value is error and x0[0] == 1

    def fail_later(t, x, v):
        raise error

    with pytest.raises(type(error)) as caught:
        solve_second_order(pendulum, (0, 1), x0, [0.0], step=0.1, callback=fail_later)
    assert caught.value is error


def test_the_solver_may_be_called_inside_an_acceleration():
    def nested(t, x, v):
        inner = solve_second_order(lambda t, x, v: -x, (0, 0.1), x, v, step=0.1)
        assert inner.success
        return -x

    nested_end = end(nested, 1, [1.0], [0.0], "velocity_verlet", 0.1)
    assert np.array_equal(
        nested_end, end(lambda t, x, v: -x, 1, [1.0], [0.0], "velocity_verlet", 0.1)
    )


@pytest.mark.parametrize(
    "change, error, message",
    [
        ({"t_span": (0, np.nan)}, substep.InputError, "t_span"),
        ({"t_span": (0, np.inf)}, substep.InputError, "t_span"),
        ({"t_span": (0, 1, 2)}, substep.InputError, "t_span"),
        ({"step": 0}, substep.InputError, "step"),
        ({"step": -0.1}, substep.InputError, "step"),
        ({"step": np.nan}, substep.InputError, "step"),
        ({"step": np.inf}, substep.InputError, "step"),
        ({"step": "1"}, TypeError, "step"),
        ({"step": 1e-320}, substep.SolverError, "below spacing of t"),
        ({"step": 1e-17}, substep.SolverError, "below spacing of t"),
        ({"x0": [np.nan]}, substep.InputError, r"x0\[0\]"),
        ({"x0": 1.0}, substep.InputError, "x0"),
        ({"x0": [1j]}, TypeError, "x0"),
        ({"v0": [1.0, 2.0]}, substep.InputError, "v0"),
        ({"method": "leapfrog"}, substep.InputError, "velocity_verlet"),
        ({"max_steps": 0}, substep.InputError, "max_steps"),
        ({"max_steps": 1.5}, substep.InputError, "max_steps"),
        ({"max_steps": 5}, substep.SolverError, "max_steps"),
        ({"threads": -1}, substep.InputError, "threads"),
        ({"t_eval": [0.5, 0.4]}, substep.InputError, "t_eval"),
        ({"t_eval": [2.0]}, substep.InputError, "t_eval"),
        ({"callback": 3}, TypeError, "callback"),
        ({"args": 3}, TypeError, "args"),
        ({"acceleration": 3}, TypeError, "acceleration"),
        ({"acceleration": substep.systems.Lorenz()}, substep.InputError, "second order"),
        ({"acceleration": substep.systems.Kepler()}, substep.InputError, "2 components"),
        (
            {"acceleration": substep.systems.HarmonicOscillator(), "args": (1,)},
            substep.InputError,
            "args",
        ),
        (
            {"acceleration": ctypes.CFUNCTYPE(None, ctypes.c_double)(lambda t: None)},
            substep.InputError,
            r"got \(c_double\)",
        ),
    ],
)
def test_bad_arguments(change, error, message):
    arguments = {
        "acceleration": pendulum,
        "t_span": (0, 1),
        "x0": [1.0],
        "v0": [0.0],
        "step": 0.1,
    }
    arguments.update(change)
    with pytest.raises(error, match=message):
        solve_second_order(**arguments)


def test_max_steps_keeps_what_was_solved():
    with pytest.raises(substep.SolverError) as caught:
        solve_second_order(pendulum, (0, 1), [1.0], [0.0], step=0.1, max_steps=5)
    assert caught.value.result.t.size == 6 and caught.value.time == 0.5


def test_a_step_longer_than_the_span_is_cut_to_it():
    result = solve_second_order(pendulum, (0, 0.1), [1.0], [0.0], step=1e300)
    assert result.t.tolist() == [0, 0.1]
