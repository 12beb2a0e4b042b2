"""What the implicit methods refuse, and how they fail."""

import numpy as np
import pytest
import scipy.sparse
import substep
from substep import ConvergenceError, InputError, NonFiniteError, SingularMatrixError, _core

IMPLICIT = [
    name for name in substep.ode.methods() if _core.ode_method(name)["family"] == "implicit"
]
OTHERS = [name for name in substep.ode.methods() if name not in IMPLICIT]
each_method = pytest.mark.parametrize("method", IMPLICIT)


def decay(t, y):
    return -y


def solve(fun=decay, t_span=(0.0, 1.0), y0=(1.0, 2.0), method="Radau", **settings):
    return substep.solve_ivp(fun, t_span, y0, method, **settings)


# Arguments.


@pytest.mark.parametrize("method", OTHERS)
@pytest.mark.parametrize(
    "option",
    [
        {"jac": decay},
        {"jac_sparsity": np.eye(2)},
        {"mass": np.eye(2)},
        {"linear_solver": "krylov"},
        {"check_jacobian": True},
    ],
    ids=lambda option: next(iter(option)),
)
def test_explicit_methods_refuse_the_options(method, option):
    with pytest.raises(InputError, match=f"{next(iter(option))}: has no meaning for"):
        solve(method=method, **option)


@pytest.mark.parametrize("convert", [np.asarray, scipy.sparse.csr_matrix])
@pytest.mark.parametrize("name", ["jac", "jac_sparsity", "mass"])
@pytest.mark.parametrize("shape", [(2, 3), (3, 3), (1, 2), (1, 1)])
def test_matrix_of_another_shape(name, shape, convert):
    with pytest.raises(InputError, match=rf"{name}: expected shape \(2, 2\), got \({shape[0]}, "):
        solve(**{name: convert(np.ones(shape))})
    if name == "jac":
        with pytest.raises(InputError, match=r"jac: expected shape \(2, 2\), got"):
            solve(jac=lambda t, y: convert(np.ones(shape)))


@pytest.mark.parametrize("value", [np.ones(2), 1.0, np.ones((2, 2, 1)), []])
def test_jacobian_that_is_no_matrix(value):
    for jac in (value, lambda t, y: value):
        with pytest.raises(InputError, match=r"jac: expected shape \(2, 2\)"):
            solve(jac=jac)
    with pytest.raises(InputError, match=r"mass: expected shape"):
        solve(mass=np.ones(3))


@pytest.mark.parametrize("name", ["jac", "jac_sparsity", "mass"])
@pytest.mark.parametrize("value", ["matrix", np.array([["a", "b"], ["c", "d"]]), np.eye(2) * 1j])
def test_matrix_of_another_kind(name, value):
    with pytest.raises(TypeError, match=name):
        solve(**{name: value})
    with pytest.raises(TypeError, match="jac: "):
        solve(jac=lambda t, y: value)


def test_jacobian_that_returns_nothing():
    with pytest.raises(TypeError, match="jac: expected a matrix, got None"):
        solve(jac=lambda t, y: None)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("convert", [np.asarray, scipy.sparse.csc_matrix])
def test_matrix_that_is_not_finite(bad, convert):
    matrix = np.array([[1.0, 2.0], [bad, 1.0]])
    for name in ("jac", "mass"):
        with pytest.raises(InputError, match=rf"{name}.*: expected finite numbers, got {bad}"):
            solve(**{name: convert(matrix)})
    with pytest.raises(InputError, match=f"jac.*: expected finite numbers, got {bad}"):
        solve(jac=lambda t, y: convert(matrix))


@each_method
@pytest.mark.parametrize("convert", [np.asarray, scipy.sparse.csc_matrix])
def test_jacobian_that_ceases_to_be_finite(method, convert):
    """The row is told and the last good step kept."""

    def fun(t, y):
        return [-(y[0] ** 2), -30 * y[1] ** 3]

    def jac(t, y):
        return convert(np.array([[-2 * y[0], 0.0], [np.nan if t > 0.5 else 1e-9, -90 * y[1] ** 2]]))

    with pytest.raises(NonFiniteError, match=r"the Jacobian is NaN.*row 1, column 0") as info:
        solve(fun, t_span=(0, 50), method=method, jac=jac, rtol=1e-5)
    assert info.value.index == 1
    result = info.value.result
    assert result.t[-1] > 0.4 and np.isfinite(result.y).all()
    assert result.y[0, -1] == pytest.approx(1 / (1 + result.t[-1]), rel=1e-2)


def test_jacobian_beyond_its_pattern():
    for jac in (np.ones((2, 2)), scipy.sparse.csr_matrix(np.ones((2, 2)))):
        with pytest.raises(InputError, match=r"jac: the entry \[1, 0\] lies outside jac_sparsity"):
            solve(jac=lambda t, y, jac=jac: jac, jac_sparsity=[[1, 1], [0, 1]])


def test_what_jac_raises_passes():
    def jac(t, y):
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        solve(jac=jac)

    def later(t, y):
        if t > 0.1:
            raise ZeroDivisionError("later")
        return [[-2 * y[0]]]

    with pytest.raises(ZeroDivisionError, match="later"):
        solve(lambda t, y: -(y**2), t_span=(0, 100), y0=[1.0], jac=later, rtol=1e-6)


def test_jac_may_not_write_to_y():
    def jac(t, y):
        y[0] = 0.0
        return -np.eye(2)

    with pytest.raises(ValueError, match="read-only"):
        solve(jac=jac)


@pytest.mark.parametrize("value", ["lu", None, 3, ""])
def test_linear_solver(value):
    with pytest.raises(InputError, match="linear_solver: expected one of auto, direct, krylov"):
        solve(linear_solver=value)


def test_check_jacobian():
    def fun(t, y):
        return [-(y[0] ** 2) * y[1], np.sin(y[1]) * 1e6]

    def jac(t, y, wrong=0.0):
        return np.array([[-2 * y[0] * y[1], -(y[0] ** 2)], [wrong, np.cos(y[1]) * 1e6]])

    settings = dict(t_span=(0, 1e-6), check_jacobian=True)
    assert solve(fun, jac=jac, **settings).success
    assert solve(fun, jac=lambda t, y: scipy.sparse.csc_matrix(jac(t, y)), **settings).success
    with pytest.raises(InputError, match=r"jac\[1, 0\]: expected about 0 .*got 300000"):
        solve(fun, jac=lambda t, y: jac(t, y, 3e5), **settings)
    with pytest.raises(InputError, match=r"jac\[0, 1\]: expected about -1 .*got 1"):
        solve(fun, jac=lambda t, y: jac(t, y) * [[1, -1], [1, 1]], **settings)
    with pytest.raises(InputError, match="check_jacobian: there is no Jacobian to check"):
        solve(fun, **settings)
    assert substep.solve_ivp(
        substep.systems.Robertson(), (0, 1), [1, 0, 0], "Radau", check_jacobian=True
    ).success


# What the numbers do.


@each_method
@pytest.mark.parametrize("convert", [np.asarray, scipy.sparse.csc_matrix])
@pytest.mark.parametrize("size", [2, 40])
def test_singular_newton_matrix(method, convert, size):
    """An algebraic equation that holds no unknown: no step has a solution that is determined."""
    mass = np.eye(size)
    mass[1, 1] = 0.0

    def fun(t, y):
        f = -np.asarray(y)
        f[1] = 0.0
        return f

    jac = -np.eye(size)
    jac[1, 1] = 0.0
    for settings in ({}, {"step": 0.1}):
        with pytest.raises(SingularMatrixError, match="singular whatever the step") as info:
            solve(
                fun,
                y0=np.ones(size),
                method=method,
                mass=convert(mass),
                jac=convert(jac),
                **settings,
            )
        assert info.value.index == 1
        assert info.value.result.t.tolist() == [0.0]


@each_method
@pytest.mark.parametrize("settings", [{}, {"step": 0.05}])
def test_no_convergence(method, settings):
    """Noise from t = 1.5 on: what failed is told; the steps before are kept."""
    rng = np.random.default_rng(0)

    def fun(t, y):
        return [-y[0], -y[1] + (1e13 * rng.normal() if t > 1.5 else 0.0)]

    with pytest.raises(ConvergenceError) as info:
        solve(fun, t_span=(1, 2), y0=[1.0, 2.0], method=method, jac=-np.eye(2), **settings)
    error = info.value
    assert "increments in units of the tolerance: " in str(error)
    assert "check_jacobian=True" in str(error)
    assert error.time == pytest.approx(1.5, abs=0.06)
    assert error.result.t[-1] == error.time
    assert np.isfinite(error.result.y).all() and error.result.nfev < 20000
    assert error.result.y[0, -1] == pytest.approx(np.exp(1 - error.time), rel=0.03)


def test_a_fixed_step_that_fails_is_halved():
    """A kick too strong for one step of Newton's iteration; the times stay those of the steps."""

    def fun(t, y):
        return [300 * np.tanh(2 * (1.0 - y[0])) * (1 if t > 1 else 0)]

    result = solve(fun, t_span=(0, 2), y0=[-20.0], method="implicit_euler", step=0.25)
    np.testing.assert_allclose(result.t, np.arange(0, 2.1, 0.25))
    assert result.y[0, 4] == -20.0
    assert result.y[0, -1] == pytest.approx(1.0, abs=1e-3)


@each_method
def test_steps_beyond_the_domain_are_taken_back(method):
    """y' = -sqrt(y) is defined for y >= 0 only."""
    with np.errstate(invalid="ignore"):
        result = solve(lambda t, y: -np.sqrt(y), (0, 1.9), [1.0], method, first_step=1.9)
    assert result.y[0, -1] == pytest.approx(0.05**2, abs=2e-3)
