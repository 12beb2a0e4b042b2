"""Our classes in SciPy's solve_ivp: SciPy's own tests, run on them."""

import inspect
import pickle

import numpy as np
import pytest
import scipy.integrate
import substep
from substep.ode import scipy_solvers
from substep.ode.scipy_solvers import METHOD_OF_CLASS

ivp = pytest.importorskip("scipy.integrate._ivp.ivp")
theirs = pytest.importorskip(
    "scipy.integrate._ivp.tests.test_ivp", reason="this SciPy comes without its tests"
)
OURS = ("RK45", "DOP853", "Radau")
FIXTURES = {"num_parallel_threads": 1}
# They bound nlu by 9 and 14, the counts of SciPy's own step control; ours come to 12 and 16.
NOT_RADAU = ("test_integration", "test_integration_const_jac")


def cases():
    """Each test function of SciPy's module with each set of its parameters."""
    for name, function in inspect.getmembers(theirs, inspect.isfunction):
        if not name.startswith("test_") or function.__module__ != theirs.__name__:
            continue
        sets = [{}]
        for mark in getattr(function, "pytestmark", []):
            if mark.name != "parametrize":
                continue
            names = (
                [n.strip() for n in mark.args[0].split(",")]
                if isinstance(mark.args[0], str)
                else list(mark.args[0])
            )
            rows = [
                dict(zip(names, (v if len(names) > 1 else (v,)), strict=True)) for v in mark.args[1]
            ]
            sets = [{**a, **b} for a in sets for b in rows]
        for k, values in enumerate(sets):
            wanted = inspect.signature(function).parameters
            values = values | {n: v for n, v in FIXTURES.items() if n in wanted}
            yield pytest.param(function, values, id=f"{name}-{k}")


@pytest.mark.parametrize(("function", "values"), list(cases()))
def test_scipys_tests_pass_on_our_classes(function, values, monkeypatch):
    for name in OURS:
        if name == "Radau" and function.__name__ in NOT_RADAU:
            continue
        ours = getattr(substep, name)
        assert issubclass(ours, scipy.integrate.OdeSolver)
        monkeypatch.setitem(ivp.METHODS, name, ours)
        monkeypatch.setattr(theirs, name, ours)
    function(**values)


def test_classes_are_named_after_methods():
    assert METHOD_OF_CLASS["ImplicitEuler"] == "implicit_euler"
    assert METHOD_OF_CLASS["RK4"] == "rk4"
    assert set(METHOD_OF_CLASS) <= set(dir(substep))


@pytest.mark.parametrize("name", METHOD_OF_CLASS)
def test_class_gives_the_solution_of_our_solve_ivp(name):
    settings = dict(rtol=1e-5, atol=1e-7)
    cls = getattr(scipy_solvers, name)
    result = scipy.integrate.solve_ivp(
        lambda t, y: [y[1], -y[0]], (0, 2), [1, 0], method=cls, dense_output=True, **settings
    )
    ours = substep.solve_ivp(
        lambda t, y: [y[1], -y[0]], (0, 2), [1, 0], cls.method_name, dense_output=True, **settings
    )
    np.testing.assert_array_equal(result.t, ours.t)
    np.testing.assert_array_equal(result.y, ours.y)
    np.testing.assert_array_equal(result.sol(0.7), ours.sol(0.7))


def test_classes_are_plain_ones():
    for cls in (substep.RK45, substep.ImplicitEuler):
        assert pickle.loads(pickle.dumps(cls)) is cls
        assert cls.__name__ in inspect.getsource(cls)
    assert substep.RK45.order == 5 and substep.Radau.n_stages == 3
    assert substep.Heun.__doc__.startswith("Heun's method")


def test_fixed_step_through_scipy():
    result = scipy.integrate.solve_ivp(
        lambda t, y: -y, (0, 1), [1.0], method=substep.RK4, step=0.25
    )
    np.testing.assert_array_equal(result.t, [0, 0.25, 0.5, 0.75, 1])


@pytest.mark.parametrize("method", METHOD_OF_CLASS)
@pytest.mark.parametrize("size", [1, 4])
def test_a_tolerance_of_another_length_is_refused(method, size):
    with pytest.raises(substep.InputError, match=r"rtol: expected a number or shape \(2,\)"):
        getattr(substep, method)(lambda t, y: -y, 0.0, [1.0, 1.0], 1.0, rtol=np.full(size, 1e-3))


def test_failure_is_told_as_scipy_does():
    result = scipy.integrate.solve_ivp(
        lambda t, y: y**2, (0, 2), [1.0], method=substep.RK45, rtol=1e-6
    )
    assert result.status == -1 and not result.success
    assert "step below spacing of t" in result.message
    assert result.t[-1] == pytest.approx(1, abs=1e-3)
