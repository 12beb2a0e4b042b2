"""The integrators: order, exactness, end values, dense output, results, right-hand sides."""

import ctypes
import json
import math
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
import substep
from substep import _core

METHODS = substep.ode.methods()
ORDER = {name: _core.ode_method(name)["order"] for name in METHODS}
TABLES = [name for name in METHODS if _core.ode_method(name)["family"] == "explicit"]
DOUBLING = [name for name in TABLES if _core.ode_method(name)["doubling"]]
PAIRS = [name for name in TABLES if "error_order" in _core.tableau(name)]
REFERENCE = Path(__file__).parents[3] / "shared/reference/ode.json"


@pytest.fixture(scope="module")
def reference():
    if not REFERENCE.exists():
        pytest.skip("the reference values of ../shared are not here")
    return json.loads(REFERENCE.read_text())


def logistic(t, y):
    """y' = y (1 - y) cos t, with u = ln(y / (1 - y)) = u0 + sin t."""
    return y * (1 - y) * np.cos(t)


def logistic_exact(t):
    return 1 / (1 + np.exp(-np.sin(np.asarray(t))))


# Tables: the conditions on the constants and the observed order.


@pytest.mark.parametrize("name", TABLES)
def test_row_sums_are_the_nodes(name):
    table = _core.tableau(name)
    np.testing.assert_allclose(table["a"].sum(axis=1), table["c"], atol=2e-14)
    assert table["b"].sum() == pytest.approx(1, abs=1e-14)
    for estimate in ("e", "e3", "e5"):
        if estimate in table:
            assert table[estimate].sum() == pytest.approx(0, abs=1e-14)


def forced_pendulum(t, y):
    return np.array([y[1], -np.sin(y[0]) + 0.5 * np.cos(1.3 * t) - 0.1 * y[1] * y[0]])


@pytest.fixture(scope="module")
def pendulum_end():
    """State at t = 3 from (1, 0.2), good to some 1e-15."""
    ours = substep.solve_ivp(
        forced_pendulum, (0, 3), [1.0, 0.2], "DOP853", step=1 / 128, t_eval=[3.0]
    ).y[:, 0]
    theirs = scipy.integrate.solve_ivp(
        forced_pendulum, (0, 3), [1.0, 0.2], "DOP853", rtol=1e-13, atol=1e-15
    ).y[:, -1]
    np.testing.assert_allclose(ours, theirs, atol=1e-13)
    return ours


@pytest.mark.parametrize("name", METHODS)
def test_observed_order(name, pendulum_end):
    order = ORDER[name]
    counts = {
        1: (800, 1600),
        2: (100, 200, 400),
        3: (60, 120, 240),
        4: (40, 80, 160),
        5: (96, 144, 192),
    }.get(order, (6, 8, 10, 12))
    if name == "Radau":
        counts = (24, 36, 48)  # less error than RK45: further out it meets the rounding
    errors = []
    for count in counts:
        result = substep.solve_ivp(
            forced_pendulum, (0, 3), [1.0, 0.2], name, step=3 / count, t_eval=[3.0]
        )
        errors.append(np.linalg.norm(result.y[:, 0] - pendulum_end))
    assert min(errors) > 1e-13, "at the rounding floor"
    slope = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.1 if order <= 5 else 0.4)


@pytest.mark.parametrize("name", METHODS)
def test_exact_on_polynomials(name):
    """Quadrature of degree order - 1 is exact whatever the step, and no higher one is."""

    def error(degree):
        result = substep.solve_ivp(
            lambda t, y: [(degree + 1) * t**degree], (0, 1), [0.0], name, step=1 / 3, t_eval=[1.0]
        )
        return abs(result.y[0, 0] - 1)

    for degree in range(ORDER[name]):
        assert error(degree) < 4e-15
    assert any(error(degree) > 1e-13 for degree in (ORDER[name], ORDER[name] + 1))


@pytest.mark.parametrize("name", TABLES)
def test_linear_step_is_the_stability_polynomial(name):
    """One step of y' = i y is R(i h), R(z) = sum_k b A^(k-1) 1 z^k, complex y included."""
    table = _core.tableau(name)
    stages = table["stages"]
    a, b, h = table["a"][:stages, :stages], table["b"], 0.7
    z, power, value = 1j * h, np.ones(stages), 1.0 + 0j
    for _ in range(stages):
        value += z * (b @ power)
        power = z * (a @ power)
    result = substep.solve_ivp(lambda t, y: 1j * y, (0, h), [1 + 0j], name, step=h)
    assert result.y[0, -1] == pytest.approx(value, abs=1e-15)
    real = substep.solve_ivp(lambda t, y: [y[1], -y[0]], (0, h), [1, 0], name, step=h)
    assert real.y[:, -1] == pytest.approx([value.real, -value.imag], abs=1e-15)


# Step control.


@pytest.mark.parametrize(
    ("name", "plain"),
    [*((name, False) for name in METHODS), *((name, True) for name in DOUBLING)],
)
def test_error_follows_the_tolerance(name, plain, pendulum_end):
    """An estimate of order q is kept, so the error goes with tolerance^(p / (q + 1))."""
    p, q = ORDER[name], _core.ode_method(name)["error_order"]
    if name in DOUBLING and not plain:
        p += 1  # by local extrapolation
    options = {"local_extrapolation": False} if plain else {}
    tolerances = np.array([1e-3, 1e-4, 1e-5, 1e-6] if p < 4 else [1e-5, 1e-7, 1e-9, 1e-11])
    errors = []
    for tolerance in tolerances:
        result = substep.solve_ivp(
            forced_pendulum, (0, 3), [1.0, 0.2], name, rtol=tolerance, atol=tolerance, **options
        )
        errors.append(np.linalg.norm(result.y[:, -1] - pendulum_end))
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert slope == pytest.approx(p / (q + 1), abs=0.2)
    assert np.all(errors < 100 * tolerances ** (p / (q + 1)))


@pytest.mark.parametrize("name", DOUBLING)
def test_step_doubling_is_proportional_to_the_tolerance(name, pendulum_end):
    """Without extrapolation error over tolerance grows as tolerance^(-1/(p+1)): heun's 22-fold."""
    ratios = []
    for tolerance in (1e-4, 1e-6, 1e-8):
        result = substep.solve_ivp(
            forced_pendulum, (0, 3), [1.0, 0.2], name, rtol=tolerance, atol=tolerance
        )
        ratios.append(np.abs(result.y[:, -1] - pendulum_end).max() / tolerance)
    assert max(ratios) < min(4, 2 * min(ratios))


def _scipy_error(system, name, tolerance, y_end, t_end, components):
    result = scipy.integrate.solve_ivp(
        system, (0, t_end), system.y0, name, rtol=tolerance, atol=tolerance
    )
    return np.abs(result.y[:components, -1] - y_end[:components]).max()


@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize("problem", ["arenstorf", "pleiades", "lorenz63"])
def test_end_values_beside_scipy(name, problem, reference):
    system = {
        "arenstorf": substep.systems.Arenstorf,
        "pleiades": substep.systems.Pleiades,
        "lorenz63": substep.systems.Lorenz,
    }[problem]()
    t_end = float(reference[problem]["t_end"])
    y_end = np.array(reference[problem]["y_end"], dtype=float)
    positions = {"arenstorf": 2, "pleiades": 14, "lorenz63": 3}[problem]
    tolerances = [1e-4, 1e-6, 1e-8, 1e-10]
    errors = []
    for tolerance in tolerances:
        result = substep.solve_ivp(
            system, (0, t_end), system.y0, name, rtol=tolerance, atol=tolerance
        )
        errors.append(np.abs(result.y[:positions, -1] - y_end[:positions]).max())
        theirs = _scipy_error(system, name, tolerance, y_end, t_end, positions)
        assert errors[-1] <= 2 * theirs
    # In proportion to the tolerance: at least half a digit less than it over the six decades (the
    # first point may lie where the orbit is lost).
    slope = np.polyfit(np.log10(tolerances[1:]), np.log10(errors[1:]), 1)[0]
    assert slope > 0.75


def test_arrays_of_tolerances():
    rtol, atol = [1e-4, 1e-9], [1e-5, 1e-10]
    loose = substep.solve_ivp(lambda t, y: -y, (0, 3), [1, 1], rtol=1e-4, atol=1e-5)
    both = substep.solve_ivp(lambda t, y: -y, (0, 3), [1, 1], rtol=rtol, atol=atol)
    assert loose.t.size < both.t.size
    assert abs(both.y[0, -1] - math.exp(-3)) < 1e-8


def test_step_is_kept_and_the_last_one_cut():
    result = substep.solve_ivp(lambda t, y: -y, (0, 1), [1.0], "rk4", step=0.3)
    np.testing.assert_allclose(result.t, [0, 0.3, 0.6, 0.9, 1.0], atol=1e-15)
    assert result.t[-1] == 1.0
    ten = substep.solve_ivp(lambda t, y: -y, (0, 1), [1.0], "euler", step=0.1)
    assert ten.t.size == 11
    assert ten.y[0, -1] == pytest.approx(0.9**10, rel=1e-14)
    assert ten.nfev == 10


def test_first_and_greatest_step():
    result = substep.solve_ivp(lambda t, y: -y, (0, 10), [1.0], first_step=0.01, max_step=0.1)
    lengths = np.diff(result.t)
    assert lengths[0] == pytest.approx(0.01)
    assert lengths.max() <= 0.1 + 1e-15


@pytest.mark.parametrize("name", METHODS)
def test_backward_in_time(name):
    there = substep.solve_ivp(logistic, (3, 0), [logistic_exact(3.0)], name, rtol=1e-5, atol=1e-7)
    assert there.t[0] == 3 and there.t[-1] == 0 and np.all(np.diff(there.t) < 0)
    assert abs(there.y[0, -1] - 0.5) < (1e-2 if ORDER[name] == 1 else 2e-4)
    fixed = substep.solve_ivp(logistic, (3, 0), [0.7], name, step=0.25)
    np.testing.assert_allclose(fixed.t, np.arange(3, -0.1, -0.25))


def test_recorded_fixed_steps_and_leaps_have_the_same_bits():
    system = substep.systems.Lorenz()
    for name in METHODS:
        every = substep.solve_ivp(system, (0, 2), system.y0, name, step=1e-3)
        last = substep.solve_ivp(system, (0, 2), system.y0, name, step=1e-3, t_eval=[1.0, 2.0])
        python = substep.solve_ivp(
            lambda t, y: system(t, y), (0, 2), system.y0, name, step=1e-3, t_eval=[1.0, 2.0]
        )
        assert np.array_equal(every.y[:, [1000, 2000]], last.y)
        assert np.array_equal(python.y, last.y)


# Dense output and times to evaluate at.


@pytest.mark.parametrize("name", METHODS)
def test_dense_output_order(name):
    """The error between steps falls with min(order of the polynomial + 1, order)."""
    order = min(ORDER[name], {"RK45": 4, "DOP853": 7}.get(name, 3))
    counts = np.array([30, 60, 120]) if order < 7 else np.array([6, 9, 12])
    errors = []
    for count in counts:
        result = substep.solve_ivp(logistic, (0, 3), [0.5], name, step=3 / count, dense_output=True)
        t = np.linspace(0, 3, 997)
        errors.append(np.abs(result.sol(t)[0] - logistic_exact(t)).max())
    slope = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope > order - 0.15
    assert min(errors) > 1e-14


@pytest.mark.parametrize("name", METHODS)
def test_dense_output_agrees_with_steps_and_t_eval(name):
    t_eval = np.linspace(0, 3, 50)
    dense = substep.solve_ivp(logistic, (0, 3), [0.5], name, rtol=1e-4, dense_output=True)
    only = substep.solve_ivp(logistic, (0, 3), [0.5], name, rtol=1e-4, t_eval=t_eval)
    np.testing.assert_allclose(dense.sol(dense.t), dense.y, atol=1e-15)
    np.testing.assert_allclose(dense.sol(t_eval), only.y, atol=1e-15)
    np.testing.assert_array_equal(only.t, t_eval)
    assert dense.sol(0.3).shape == (1,)
    assert (dense.sol.t_min, dense.sol.t_max) == (0.0, 3.0)
    np.testing.assert_array_equal(dense.sol.ts, dense.t)


@pytest.mark.parametrize("name", PAIRS)
def test_dense_output_is_scipys(name):
    settings = dict(rtol=1e-4, atol=1e-4, dense_output=True, first_step=0.01)
    ours = substep.solve_ivp(logistic, (0, 3), [0.5], name, **settings)
    theirs = scipy.integrate.solve_ivp(logistic, (0, 3), [0.5], name, **settings)
    t = np.linspace(0, 3, 100)
    # The estimate is a small difference of great terms: steps agree less well than their result.
    np.testing.assert_allclose(ours.t, theirs.t, rtol=1e-6)
    np.testing.assert_allclose(ours.sol(t), theirs.sol(t), rtol=1e-8)


def test_t_eval_between_fixed_steps():
    t_eval = [0.0, 0.05, 0.3, 0.31, 1.0]
    result = substep.solve_ivp(lambda t, y: -y, (0, 1), [1.0], "rk4", step=0.1, t_eval=t_eval)
    np.testing.assert_allclose(result.y[0], np.exp(-np.array(t_eval)), atol=2e-6)
    np.testing.assert_array_equal(result.t, t_eval)
    back = substep.solve_ivp(lambda t, y: -y, (1, 0), [1.0], "rk4", step=0.1, t_eval=[0.95, 0.0])
    np.testing.assert_allclose(back.y[0], np.exp([0.05, 1.0]), atol=2e-6)


# The result.


def test_result_has_scipys_fields():
    settings = dict(t_eval=[0.5, 1.0], dense_output=True, events=lambda t, y: y[0] - 0.5)
    ours = substep.solve_ivp(lambda t, y: -y, (0, 1), [1.0], **settings)
    theirs = scipy.integrate.solve_ivp(lambda t, y: -y, (0, 1), [1.0], **settings)
    assert set(ours) == set(theirs)
    for name in ("t", "y", "nfev", "njev", "nlu", "status", "message", "success"):
        assert np.shape(ours[name]) == np.shape(theirs[name]), name
        assert getattr(ours, name) is ours[name]
    assert ours.y.shape == (1, 2)
    assert ours.message == theirs.message
    assert ours.t_events[0] == pytest.approx(theirs.t_events[0], abs=1e-12)
    assert ours.y_events[0].shape == theirs.y_events[0].shape
    assert "success: True" in repr(ours)
    with pytest.raises(AttributeError):
        _ = ours.nothing


def test_nothing_to_do():
    result = substep.solve_ivp(lambda t, y: -y, (4, 4), [2.0, 3.0], dense_output=True)
    np.testing.assert_array_equal(result.y, [[2], [3]])
    np.testing.assert_array_equal(result.sol([4, 5]), [[2, 2], [3, 3]])
    empty = substep.solve_ivp(lambda t, y: y, (0, 1), [])
    assert empty.y.shape == (0, 2) and empty.success


def test_complex_state_is_the_real_one():
    """y' = i w y against its real form, with the modulus in the norm."""
    w = np.array([1.0, 2.0])
    for name in METHODS:
        result = substep.solve_ivp(
            lambda t, y: 1j * w * y,
            (0, 2),
            [1 + 0j, 1j],
            name,
            rtol=1e-6,
            atol=1e-8,
            dense_output=True,
        )
        assert result.y.dtype == np.complex128
        tolerance = 3e-2 if ORDER[name] == 1 else 1e-3
        np.testing.assert_allclose(
            result.y[:, -1], np.array([1, 1j]) * np.exp(2j * w), atol=tolerance
        )
        assert result.sol(1.0).dtype == np.complex128
        if name == "DOP853":
            theirs = scipy.integrate.solve_ivp(
                lambda t, y: 1j * w * y, (0, 2), [1 + 0j, 1j], name, rtol=1e-6, atol=1e-8
            )
            np.testing.assert_allclose(result.t, theirs.t, rtol=1e-6)


def test_callback_sees_every_step():
    seen = []
    result = substep.solve_ivp(
        lambda t, y: -y, (0, 1), [1.0], callback=lambda t, y: seen.append((t, y[0]))
    )
    np.testing.assert_array_equal([t for t, _ in seen], result.t[1:])
    np.testing.assert_array_equal([y for _, y in seen], result.y[0, 1:])


def test_args():
    def fun(t, y, a, b):
        return [a * y[0] + b]

    def event(t, y, a, b):
        return y[0] - b

    result = substep.solve_ivp(fun, (0, 1), [1.0], args=(1.0, 2.0), events=event, rtol=1e-8)
    assert result.y[0, -1] == pytest.approx(3 * math.e - 2, rel=1e-6)
    assert result.t_events[0][0] == pytest.approx(math.log(4 / 3), rel=1e-6)


def test_vectorized():
    def fun(t, y):
        assert y.ndim == 2
        return -y

    result = substep.solve_ivp(fun, (0, 1), [1.0, 2.0], vectorized=True)
    np.testing.assert_allclose(result.y[:, -1], np.exp(-1) * np.array([1, 2]), rtol=1e-3)


def test_method_names_in_any_case():
    runs = [
        substep.solve_ivp(lambda t, y: -y, (0, 1), [1.0], m).y
        for m in ("dop853", "DOP853", "Dop853", substep.DOP853)
    ]
    for other in runs[1:]:
        np.testing.assert_array_equal(runs[0], other)


# Compiled right-hand sides.


def damped(t, y, p):
    return [y[1], -p[0] * y[0] - p[1] * y[1]]


@pytest.fixture(scope="module")
def compiled():
    numba = pytest.importorskip("numba")
    types = numba.types
    pointer = types.CPointer(types.double)

    @numba.cfunc(types.void(types.double, pointer, pointer, pointer))
    def fun(t, y, dydt, p):
        dydt[0] = y[1]
        dydt[1] = -p[0] * y[0] - p[1] * y[1]

    return fun


@pytest.mark.parametrize("kind", ["cfunc", "ctypes", "low_level"])
@pytest.mark.parametrize("name", METHODS)
def test_compiled_function(name, kind, compiled):
    fun = compiled
    if kind == "ctypes":
        fun = compiled.ctypes
    elif kind == "low_level":
        double = ctypes.POINTER(ctypes.c_double)
        kind = ctypes.CFUNCTYPE(None, ctypes.c_double, double, double, double)
        fun = scipy.LowLevelCallable(kind(compiled.address))
    p = np.array([2.0, 0.1])
    for settings in ({"step": 0.01}, {"rtol": 1e-6, "atol": 1e-6}):
        ours = substep.solve_ivp(fun, (0, 2), [1, 0], name, args=p, **settings)
        tuple_ = substep.solve_ivp(fun, (0, 2), [1, 0], name, args=(2.0, 0.1), **settings)
        python = substep.solve_ivp(damped, (0, 2), [1, 0], name, args=(p,), **settings)
        np.testing.assert_allclose(ours.y, python.y, atol=1e-13)
        np.testing.assert_array_equal(ours.y, tuple_.y)


def test_ctypes_function_written_in_python_runs_without_the_gil_held():
    double = ctypes.POINTER(ctypes.c_double)

    @ctypes.CFUNCTYPE(None, ctypes.c_double, double, double, double)
    def fun(t, y, dydt, p):
        dydt[0] = -y[0]

    result = substep.solve_ivp(fun, (0, 1), [1.0])
    assert result.y[0, -1] == pytest.approx(math.exp(-1), rel=1e-3)


SYSTEMS = [
    getattr(substep.systems, name)
    for name in (
        "Lorenz",
        "Arenstorf",
        "Pleiades",
        "Kepler",
        "HenonHeiles",
        "VanDerPol",
        "Pendulum",
        "HarmonicOscillator",
    )
]


def python_form(system):
    """The equations again, in Python, from the docstrings."""
    s, name = system, type(system).__name__
    if name == "Lorenz":
        return lambda t, y: [
            s.sigma * (y[1] - y[0]),
            y[0] * (s.rho - y[2]) - y[1],
            y[0] * y[1] - s.beta * y[2],
        ]
    if name == "Arenstorf":

        def arenstorf(t, y):
            r = 1 - s.mu
            d1 = ((y[0] + s.mu) ** 2 + y[1] ** 2) ** 1.5
            d2 = ((y[0] - r) ** 2 + y[1] ** 2) ** 1.5
            return [
                y[2],
                y[3],
                y[0] + 2 * y[3] - r * (y[0] + s.mu) / d1 - s.mu * (y[0] - r) / d2,
                y[1] - 2 * y[2] - r * y[1] / d1 - s.mu * y[1] / d2,
            ]

        return arenstorf
    if name == "Pleiades":

        def pleiades(t, y):
            x = y[:14].reshape(2, 7)
            d = x[:, None, :] - x[:, :, None]
            r3 = (d**2).sum(axis=0) ** 1.5 + np.eye(7)
            return np.concatenate([y[14:], (d / r3 @ s.masses).ravel()])

        return pleiades
    if name == "Kepler":
        return lambda t, y: [y[2], y[3], *(-s.mu * y[:2] / np.hypot(*y[:2]) ** 3)]
    if name == "HenonHeiles":
        return lambda t, y: [
            y[2],
            y[3],
            -y[0] - 2 * s.lambda_ * y[0] * y[1],
            -y[1] - s.lambda_ * (y[0] ** 2 - y[1] ** 2),
        ]
    if name == "VanDerPol":
        return lambda t, y: [y[1], s.mu * (1 - y[0] ** 2) * y[1] - y[0]]
    if name == "Pendulum":
        return lambda t, y: [y[1], -s.gravity / s.length * math.sin(y[0]) - s.damping * y[1]]
    return lambda t, y: [y[1], -(s.omega**2) * y[0] - s.damping * y[1]]


PARAMETERS = {
    "Lorenz": (9.0, 27.0, 2.5),
    "Arenstorf": (0.1,),
    "Pleiades": ([3, 1, 4, 1, 5, 9, 2],),
    "Kepler": (2.0, 0.3),
    "HenonHeiles": (0.8,),
    "VanDerPol": (3.0,),
    "Pendulum": (2.0, 9.0, 0.4),
    "HarmonicOscillator": (3.0, 0.2),
}


@pytest.mark.parametrize("cls", SYSTEMS, ids=lambda cls: cls.__name__)
def test_system_is_its_equations(cls):
    system = cls(*PARAMETERS[cls.__name__])
    fun = python_form(system)
    rng = np.random.default_rng(1)
    for _ in range(20):
        y = rng.normal(size=system.size)
        np.testing.assert_allclose(system(0.3, y), fun(0.3, y), rtol=1e-11, atol=1e-12)
    t_end = min(cls().t_end, 2.0)
    for name in METHODS:
        # Two of these bodies come so close that an implicit step of that length has no solution.
        end = t_end if name in TABLES else min(t_end, 0.5)
        settings = dict(step=end / 100, t_eval=[end])
        native = substep.solve_ivp(system, (0, end), system.y0, name, **settings)
        python = substep.solve_ivp(fun, (0, end), system.y0, name, **settings)
        np.testing.assert_allclose(native.y, python.y, rtol=1e-6, atol=1e-9)
    t_end = min(t_end, 1.0)
    native = substep.solve_ivp(system, (0, t_end), system.y0, "DOP853", rtol=1e-9, atol=1e-11)
    theirs = scipy.integrate.solve_ivp(fun, (0, t_end), system.y0, "DOP853", rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(native.y[:, -1], theirs.y[:, -1], rtol=1e-6, atol=1e-9)


# The interpreter: signals and threads.


@pytest.mark.parametrize("kind", ["python", "native", "native fixed"])
def test_interrupt_is_quick(kind):
    """KeyboardInterrupt from a handler set off in the middle of a solve, within 0.1 s."""
    import signal

    system = substep.systems.Lorenz()
    fun = (lambda t, y: system(t, y)) if kind == "python" else system
    settings = {"step": 1e-7} if kind == "native fixed" else {"max_step": 1e-7}
    sent = []

    def send():
        time.sleep(0.2)
        sent.append(time.perf_counter())
        signal.raise_signal(signal.SIGINT)

    thread = threading.Thread(target=send)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        substep.solve_ivp(
            fun, (0, 1e4), system.y0, "rk4", t_eval=[1e4], max_steps=10**12, **settings
        )
    delay = time.perf_counter() - sent[0]
    thread.join()
    assert delay < 0.1


def test_solves_run_in_parallel(compiled):
    """Solves from many threads at once give the bits of one after the other."""
    y0 = [[1.0 + i, 0.0] for i in range(16)]

    def solve(i):
        results[i] = substep.solve_ivp(
            compiled if i % 2 else damped,
            (0, 20),
            y0[i],
            "DOP853",
            rtol=1e-9,
            args=np.array([2.0, 0.1]) if i % 2 else (np.array([2.0, 0.1]),),
        ).y

    results = [None] * 16
    for i in range(16):
        solve(i)
    serial = list(results)
    threads = [threading.Thread(target=solve, args=(i,)) for i in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for a, b in zip(serial, results, strict=True):
        np.testing.assert_array_equal(a, b)


def test_scipy_is_not_needed():
    import subprocess
    import sys

    code = (
        "import sys; sys.modules['scipy'] = None; import substep;"
        "print(substep.solve_ivp(lambda t, y: -y, (0, 1), [1.0], events=lambda t, y: y[0] - .5)"
        ".t_events[0].round(3));"
        "substep.RK45"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[0.693]"
    assert "the solver classes need SciPy" in done.stderr
