"""The implicit methods: damping, stiff accuracy, Jacobians in every form, mass matrices, Krylov."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
import scipy.sparse
import substep
from substep import _core, solve_ivp, systems

IMPLICIT = [
    name for name in substep.ode.methods() if _core.ode_method(name)["family"] == "implicit"
]
ORDER = {name: _core.ode_method(name)["order"] for name in IMPLICIT}
REFERENCE = Path(__file__).parents[3] / "shared/reference/ode.json"
each_method = pytest.mark.parametrize("method", IMPLICIT)


def test_the_list():
    assert IMPLICIT == ["implicit_euler", "Radau"]


# Damping and stability.


@each_method
@pytest.mark.parametrize("h_omega", [0.01, 0.3, 1.0, 20.0])
def test_numerical_damping_of_the_oscillator(method, h_omega):
    """A step multiplies the amplitude by |R(i h omega)|, for Euler (1 + (h omega)^2)^-1/2."""
    steps, omega = 40, 3.0
    h = h_omega / omega
    system = systems.HarmonicOscillator(omega)
    result = solve_ivp(system, (0, steps * h), [1.0, 0.0], method, step=h)
    amplitude = np.hypot(result.y[0], result.y[1] / omega)
    factor = abs(substep.stability.amplification(method, 1j * h_omega))
    if method == "implicit_euler":
        assert factor == pytest.approx((1 + h_omega**2) ** -0.5, rel=1e-14)
    expected = factor ** np.arange(steps + 1)
    np.testing.assert_allclose(amplitude, expected, rtol=1e-9, atol=1e-15)


@each_method
def test_any_step_is_stable(method):
    """Decays of 1 to 1e12 per second, a step of 1 s; and the fast ones are gone at once."""
    rates = np.geomspace(1, 1e12, 13)
    jac = np.diag(-rates)
    result = solve_ivp(lambda t, y: -rates * y, (0, 20), np.ones(13), method, step=1.0, jac=jac)
    assert (np.abs(np.diff(np.abs(result.y), axis=1)) <= 1).all()
    assert (np.abs(result.y[rates > 1e6, 1:]) < 2e-6).all()
    assert (np.abs(result.y[:, -1]) < 1e-5).all()


@each_method
@pytest.mark.parametrize("stiffness", [1e2, 1e6, 1e10])
def test_prothero_and_robinson(method, stiffness):
    """y' = -s (y - cos t) - sin t, y = cos t: the error does not grow with s."""

    def fun(t, y):
        return -stiffness * (y - np.cos(t)) - np.sin(t)

    errors = []
    counts = np.array([20, 40, 80])
    for count in counts:
        result = solve_ivp(fun, (0, 3), [1.0], method, step=3 / count, jac=[[-stiffness]])
        errors.append(np.abs(result.y[0] - np.cos(result.t)).max())
    limits = {"implicit_euler": 3 / counts, "Radau": 0.01 * (3 / counts) ** 3}[method]
    assert np.all(np.array(errors) < limits * min(1.0, 100 / stiffness) + 1e-13)


@each_method
def test_few_steps_for_a_stiff_problem(method):
    def fun(t, y):
        return -1e6 * (y - np.cos(t))

    explicit_steps = 3 * 1e6 / 3.3
    result = solve_ivp(fun, (0, 3), [0.0], method, rtol=1e-4, atol=1e-6)
    assert result.t.size < explicit_steps / 1000
    assert result.y[0, -1] == pytest.approx(math.cos(3), abs=2e-4)


# Stiff problems, beside SciPy's Radau.


@pytest.fixture(scope="module")
def reference():
    if not REFERENCE.exists():
        pytest.skip("the reference values of ../shared are not here")
    return json.loads(REFERENCE.read_text())


def van_der_pol():
    return systems.VanDerPol(1000.0, scaled=True), "vdpol_mu1000_scaled_T2", 1e-2


def robertson():
    return systems.Robertson(), "robertson_T1e11", 1e-10


def end_errors(method, problem, exponents, reference, **settings):
    system, name, ratio = problem()
    y_end = np.array(reference[name]["y_end"], dtype=float)
    ours, theirs = [], []
    for exponent in exponents:
        tolerance = {"rtol": 10.0**-exponent, "atol": ratio * 10.0**-exponent}
        result = solve_ivp(system, (0, system.t_end), system.y0, method, **tolerance, **settings)
        ours.append(np.abs(result.y[:, -1] / y_end - 1).max())
        result = scipy.integrate.solve_ivp(
            system, (0, system.t_end), system.y0, "Radau", jac=system.jacobian, **tolerance
        )
        theirs.append(np.abs(result.y[:, -1] / y_end - 1).max())
    return np.array(ours), np.array(theirs)


@pytest.mark.parametrize("problem", [van_der_pol, robertson])
def test_radau_beside_scipys(problem, reference):
    exponents = np.array([3, 4, 5, 6, 7])
    ours, theirs = end_errors("Radau", problem, exponents, reference)
    assert np.all(ours <= 2 * theirs)
    # Local errors of order 4 give a global error of tolerance^(5/4).
    slope = -np.polyfit(exponents, np.log10(ours), 1)[0]
    assert slope > 0.95


@pytest.mark.parametrize("problem", [van_der_pol, robertson])
def test_implicit_euler_falls_with_the_root_of_the_tolerance(problem, reference):
    system, name, ratio = problem()
    y_end = np.array(reference[name]["y_end"], dtype=float)
    exponents = np.array([3, 4, 5])
    errors = []
    for exponent in exponents:
        result = solve_ivp(
            system,
            (0, system.t_end),
            system.y0,
            "implicit_euler",
            rtol=10.0**-exponent,
            atol=ratio * 10.0**-exponent,
        )
        errors.append(np.abs(result.y[:, -1] / y_end - 1).max())
    slope = -np.polyfit(exponents, np.log10(errors), 1)[0]
    assert slope == pytest.approx(0.5, abs=0.1)
    assert errors[0] < 0.15


def brusselator_1d_error(y, reference):
    values = reference["brusselator_1d_N500_T10"]["values"]
    u, v = np.split(y, 2)
    return max(
        abs(u[124] - float(values["u_125"])),
        abs(v[124] - float(values["v_125"])),
        abs(u[249] - float(values["u_250"])),
        abs(v[249] - float(values["v_250"])),
    )


@pytest.mark.parametrize("solver", ["direct", "krylov"])
def test_brusselator_on_a_line(solver, reference):
    system = systems.Brusselator1D(500)
    errors = []
    for exponent in (3, 5, 7):
        tolerance = {"rtol": 10.0**-exponent, "atol": 10.0**-exponent}
        result = solve_ivp(
            system, (0, 10), system.y0, "Radau", t_eval=[10.0], linear_solver=solver, **tolerance
        )
        errors.append(brusselator_1d_error(result.y[:, 0], reference))
        theirs = scipy.integrate.solve_ivp(
            system, (0, 10), system.y0, "Radau", jac=system.jacobian, **tolerance
        )
        assert errors[-1] <= 2 * brusselator_1d_error(theirs.y[:, -1], reference)
    assert errors[2] < 1e-3 * errors[0]
    assert result.nlu == (0 if solver == "krylov" else result.nlu)


def laplacian(n):
    """Second differences on (0, 1) with 0 at both ends."""
    return (n + 1) ** 2 * scipy.sparse.diags([1.0, -2.0, 1.0], [-1, 0, 1], shape=(n, n))


def solve_linear(A, solver):
    y0 = np.random.default_rng(0).uniform(size=A.shape[0])
    return solve_ivp(
        lambda t, y: A @ y, (0, 0.1), y0, "Radau", jac=A, rtol=1e-4, atol=1e-4, linear_solver=solver
    )


def test_the_linear_solver_is_chosen_by_the_pattern():
    """Factors of a line cost little; of a square much, where iterations converge."""
    line = laplacian(500).tocsc()
    direct, chosen = (solve_linear(line, solver) for solver in ("direct", "auto"))
    assert chosen.nlu == direct.nlu and (chosen.y == direct.y).all()
    one = scipy.sparse.identity(32)
    square = (scipy.sparse.kron(laplacian(32), one) + scipy.sparse.kron(one, laplacian(32))).tocsc()
    krylov, chosen = (solve_linear(square, solver) for solver in ("krylov", "auto"))
    assert chosen.nlu == 0 and (chosen.y == krylov.y).all()


def test_iterations_that_do_not_converge_are_given_up():
    """Wind 150 times as strong as diffusion between cells; BiCGSTAB takes 50 times as long."""
    n = 32
    one, wind = scipy.sparse.identity(n), scipy.sparse.diags([-1.0, 1.0], [-1, 1], shape=(n, n))
    A = scipy.sparse.kron(laplacian(n), one) + scipy.sparse.kron(one, laplacian(n))
    A = (A + 5000 * (n + 1) * scipy.sparse.kron(wind, one)).tocsc()
    direct, chosen = (solve_linear(A, solver) for solver in ("direct", "auto"))
    assert 0 < chosen.nlu and chosen.nfev < 1.1 * direct.nfev
    np.testing.assert_allclose(chosen.y[:, -1], direct.y[:, -1], atol=1e-4)


def brusselator_2d(n, exponent, **settings):
    y = systems.Brusselator2D(n).y0
    tolerance = {"rtol": 10.0**-exponent, "atol": 10.0**-exponent}
    for start, end, source_time in ((0.0, 1.1, np.inf), (1.1, 1.5, -np.inf)):
        system = systems.Brusselator2D(n, source_time=source_time)
        y = solve_ivp(system, (start, end), y, "Radau", t_eval=[end], **tolerance, **settings).y[
            :, 0
        ]
    return y


def brusselator_2d_error(y, n, reference):
    values = reference[f"brusselator_2d_N{n}_T1.5"]["values"]
    u, v = y.reshape(2, n, n)
    centre = n // 2
    return max(
        abs(u[0, 0] - float(values["u(0,0)"])),
        abs(v[0, 0] - float(values["v(0,0)"])),
        abs(u[centre, centre] - float(values["u(N/2,N/2)"])),
        abs(v[centre, centre] - float(values["v(N/2,N/2)"])),
    )


def test_brusselator_on_a_square(reference):
    errors = [
        brusselator_2d_error(brusselator_2d(64, e, linear_solver="krylov"), 64, reference)
        for e in (2, 3, 4)
    ]
    # SciPy's Radau, which takes 4 s: 5e-5 at 1e-3 and 5e-7 at 1e-5 (greatest error of all cells).
    assert errors[1] < 1e-4
    assert errors[2] < 1e-5
    assert errors[0] < 3e-3


@pytest.mark.slow
def test_brusselator_on_a_square_directly(reference):
    y = brusselator_2d(64, 3, linear_solver="direct")
    assert brusselator_2d_error(y, 64, reference) < 1e-4


# Where the Jacobian comes from.


def reaction(t, y):
    return np.array([-0.5 * y[0] + y[1] * y[2], y[0] - 30 * y[1] ** 2, np.sin(t) * y[2] - y[1]])


def reaction_jacobian(t, y):
    return np.array([[-0.5, y[2], y[1]], [1.0, -60 * y[1], 0.0], [0.0, -1.0, np.sin(t)]])


FORMS = {
    "differences": {},
    "dense": {"jac": reaction_jacobian},
    "list": {"jac": lambda t, y: reaction_jacobian(t, y).tolist()},
    "sparse": {"jac": lambda t, y: scipy.sparse.csr_matrix(reaction_jacobian(t, y))},
    "sparse array": {"jac": lambda t, y: scipy.sparse.coo_array(reaction_jacobian(t, y))},
    "sparse differences": {"jac_sparsity": [[1, 1, 1], [1, 1, 0], [0, 1, 1]]},
    "dense in a pattern": {
        "jac": reaction_jacobian,
        "jac_sparsity": scipy.sparse.csc_matrix([[1, 1, 1], [1, 1, 0], [0, 1, 1]]),
    },
    "krylov": {"linear_solver": "krylov"},
    "krylov, sparse": {"jac_sparsity": np.ones((3, 3)), "linear_solver": "krylov"},
}


@each_method
@pytest.mark.parametrize("form", FORMS)
def test_every_form_of_the_jacobian_gives_the_solution(method, form):
    settings = dict(t_span=(0, 5), y0=[1.0, 0.2, 0.5], method=method)
    tolerance = 1e-7 if method == "Radau" else 1e-5
    expected = solve_ivp(reaction, t_span=(0, 5), y0=[1.0, 0.2, 0.5], rtol=1e-10, atol=1e-12)
    result = solve_ivp(
        reaction, rtol=tolerance, atol=tolerance, check_jacobian="jac" in FORMS[form],
        **FORMS[form], **settings,
    )  # fmt: skip
    allowed = 1e-6 if method == "Radau" else 2e-2
    np.testing.assert_allclose(result.y[:, -1], expected.y[:, -1], atol=allowed)
    assert result.njev > 0
    assert (result.nlu > 0) == ("krylov" not in form)
    fixed = solve_ivp(reaction, step=0.05, **FORMS[form], **settings)
    also = solve_ivp(reaction, step=0.05, jac=reaction_jacobian, **settings)
    np.testing.assert_allclose(fixed.y, also.y, atol=1e-10)


def test_counts():
    """A constant Jacobian is never evaluated; with a fixed step it is factorized once."""
    jac = np.array([[-1.0, 2.0], [0.0, -1000.0]])
    for given in (jac, scipy.sparse.csc_matrix(jac)):
        result = solve_ivp(lambda t, y: jac @ y, (0, 1), [1.0, 1.0], "Radau", step=0.125, jac=given)
        assert (result.njev, result.nlu) == (0, 2)
    result = solve_ivp(
        lambda t, y: jac @ y, (0, 1), [1.0, 1.0], "implicit_euler", step=0.125, jac=jac
    )
    assert (result.njev, result.nlu) == (0, 1)
    free = solve_ivp(lambda t, y: jac @ y, (0, 1), [1.0, 1.0], "Radau", jac=jac)
    assert free.nlu < 2 * free.t.size


@pytest.mark.parametrize("seed", range(5))
def test_groups_of_columns_share_no_row(seed):
    rng = np.random.default_rng(seed)
    pattern = scipy.sparse.random(60, 60, density=0.05, rng=rng, format="csc")
    group = _core.group_columns((pattern.indptr, pattern.indices))
    full = pattern.toarray() != 0
    for g in range(group.max() + 1):
        assert full[:, group == g].sum(axis=1).max() <= 1
    band = scipy.sparse.diags([1.0] * 5, range(-2, 3), shape=(100, 100), format="csc")
    assert _core.group_columns((band.indptr, band.indices)).max() == 4


def test_grouped_differences_are_the_dense_ones():
    """The same bits, step by step, and fewer evaluations."""
    n = 30

    def diffusion(t, y):
        wide = np.concatenate([[1.0], y, [0.0]])
        return 400 * (wide[2:] - 2 * y + wide[:-2]) + y**2

    sparsity = scipy.sparse.diags([1.0] * 3, [-1, 0, 1], shape=(n, n))
    settings = dict(t_span=(0, 0.1), y0=np.zeros(n), method="Radau", step=0.02)
    dense = solve_ivp(diffusion, **settings)
    sparse = solve_ivp(diffusion, jac_sparsity=sparsity, **settings)
    np.testing.assert_allclose(sparse.y, dense.y, rtol=1e-12, atol=1e-14)
    assert sparse.njev == dense.njev
    assert dense.nfev - sparse.nfev == (n - 3) * dense.njev


def test_a_pattern_that_grows():
    """jac may return fewer entries where they are zero, and others later."""

    def fun(t, y):
        return np.array([-y[0] + max(0.0, t - 1.0) * y[1], -50 * y[1]])

    def jac(t, y):
        full = np.array([[-1.0, max(0.0, t - 1.0)], [0.0, -50.0]])
        return scipy.sparse.csc_matrix(full)

    assert jac(0, None).nnz == 2 and jac(2, None).nnz == 3
    settings = dict(t_span=(0, 3), y0=[1.0, 1.0], method="Radau", max_step=0.1)
    sparse = solve_ivp(fun, jac=jac, **settings)
    dense = solve_ivp(fun, **settings)
    np.testing.assert_allclose(sparse.y[:, -1], dense.y[:, -1], rtol=1e-5)


def test_compiled_jacobian():
    numba = pytest.importorskip("numba")
    pointer = numba.types.CPointer(numba.float64)
    signature = numba.void(numba.float64, pointer, pointer, pointer)

    @numba.cfunc(signature)
    def fun(t, y, dydt, p):
        dydt[0] = y[1]
        dydt[1] = p[0] * ((1 - y[0] * y[0]) * y[1] - y[0])

    @numba.cfunc(signature)
    def jac(t, y, J, p):
        J[0], J[1] = 0.0, 1.0
        J[2], J[3] = p[0] * (-2 * y[0] * y[1] - 1), p[0] * (1 - y[0] * y[0])

    @numba.cfunc(signature)
    def columns(t, y, J, p):
        J[0], J[1] = p[0] * (-2 * y[0] * y[1] - 1), 1.0
        J[2] = p[0] * (1 - y[0] * y[0])

    system = systems.VanDerPol(1000.0, scaled=True)
    settings = dict(t_span=(0, 2), y0=[2.0, 0.0], method="Radau", rtol=1e-6, atol=1e-8)
    expected = solve_ivp(system, **settings)
    options = [
        dict(jac=jac, check_jacobian=True),
        dict(jac=columns, jac_sparsity=[[0, 1], [1, 1]]),
        dict(jac=lambda t, y, p: system.jacobian(t, y)),
        {},
    ]
    for option in options:
        args = ([1e6],) if option.get("jac") is options[2]["jac"] else [1e6]
        if option is options[2]:
            result = solve_ivp(lambda t, y, p: system(t, y), args=args, **option, **settings)
        else:
            result = solve_ivp(fun, args=args, **option, **settings)
        np.testing.assert_allclose(result.y[:, -1], expected.y[:, -1], rtol=1e-6)


def test_complex_states():
    """y' = A y with complex A and each form of its Jacobian."""
    a = np.array([[-1 + 2j, 0.5], [0.3j, -200 - 1j]])
    values, vectors = np.linalg.eig(a)
    y0 = np.array([1 + 1j, 2.0])
    exact = vectors @ (np.exp(values) * np.linalg.solve(vectors, y0))
    for option in (
        {},
        {"jac": a},
        {"jac": lambda t, y: scipy.sparse.csr_matrix(a)},
        {"jac_sparsity": np.ones((2, 2))},
        {"mass": np.diag([2.0, 1.0j])},
        {"mass": [2.0, 1.0j]},
        {"mass": scipy.sparse.diags([2.0, 1.0j])},
    ):
        mass = np.diag([2.0, 1.0j]) if "mass" in option else np.eye(2)
        result = solve_ivp(
            lambda t, y, m=mass: m @ a @ y, (0, 1), y0, "Radau", rtol=1e-8, atol=1e-8, **option
        )
        assert result.y.dtype == np.complex128
        np.testing.assert_allclose(result.y[:, -1], exact, atol=1e-7)


# M y' = f.


@each_method
@pytest.mark.parametrize("convert", [np.asarray, scipy.sparse.csr_matrix])
@pytest.mark.parametrize("sparse_jacobian", [False, True])
@pytest.mark.parametrize("solver", ["direct", "krylov"])
def test_regular_mass_matrix(method, convert, sparse_jacobian, solver):
    rng = np.random.default_rng(2)
    mass = rng.normal(size=(3, 3)) + 3 * np.eye(3)
    jac = scipy.sparse.csc_matrix if sparse_jacobian else np.asarray
    for settings in ({"step": 0.02}, {"rtol": 1e-5, "atol": 1e-7}):
        expected = solve_ivp(
            reaction, (0, 2), [1.0, 0.2, 0.5], method, jac=reaction_jacobian, **settings
        )
        result = solve_ivp(
            lambda t, y: mass @ reaction(t, y),
            (0, 2),
            [1.0, 0.2, 0.5],
            method,
            mass=convert(mass),
            jac=lambda t, y: jac(mass @ reaction_jacobian(t, y)),
            linear_solver=solver,
            **settings,
        )
        loose = 1e-9 if "step" in settings else (1e-5 if method == "Radau" else 1e-2)
        np.testing.assert_allclose(result.y[:, -1], expected.y[:, -1], atol=loose)


@each_method
@pytest.mark.parametrize("convert", [np.asarray, scipy.sparse.csr_matrix, np.diag])
def test_differential_algebraic_system(method, convert, reference):
    """Robertson's problem with 0 = y1 + y2 + y3 - 1 in place of its third equation."""

    def fun(t, y):
        a, b, c = 0.04 * y[0], 1e4 * y[1] * y[2], 3e7 * y[1] ** 2
        return [-a + b, a - b - c, y.sum() - 1]

    mass = np.diag([1.0, 1.0, 0.0])
    y_end = np.array(reference["robertson_T1e11"]["y_end"], dtype=float)
    result = solve_ivp(
        fun, (0, 1e11), [1.0, 0.0, 0.0], method, mass=convert(mass), rtol=1e-5, atol=1e-15
    )
    allowed = 1e-4 if method == "Radau" else 0.05
    np.testing.assert_allclose(result.y[:, -1], y_end, rtol=allowed)
    assert np.abs(result.y.sum(axis=0) - 1).max() < 1e-5


def test_order_of_a_differential_algebraic_system():
    """x' = -2 x + z, 0 = z - x cos t: both components keep Radau's order 5."""

    def fun(t, y):
        return [-2 * y[0] + y[1], y[1] - y[0] * np.cos(t)]

    errors = []
    counts = np.array([4, 8, 16])
    for count in counts:
        result = solve_ivp(fun, (0, 2), [1.0, 1.0], "Radau", mass=[1.0, 0.0], step=2 / count)
        x = np.exp(-2 * result.t + np.sin(result.t))
        errors.append(np.abs(result.y - [x, x * np.cos(result.t)]).max(axis=1))
    slopes = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    np.testing.assert_allclose(slopes, 5, atol=0.4)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-9, 1e-12])
@pytest.mark.parametrize("own", [True, False])
def test_transistor_amplifier(tolerance, own):
    """Index 1; values of the Test Set for IVP Solvers (Mazzia, Magherini), Bari 2008, problem II-2.

    One rounding of y moves the output by 1e-13: below that no tolerance can be kept.
    """
    C = 1e-6 * np.arange(1, 6)
    mass = np.zeros((8, 8))
    for c, (i, j) in zip(C, [(0, 1), (2, 2), (3, 4), (5, 5), (6, 7)], strict=True):
        mass[i, i] = mass[j, j] = -c
        if i != j:
            mass[i, j] = mass[j, i] = c
    Ub, R0, R, alpha, beta, UF = 6.0, 1e3, 9e3, 0.99, 1e-6, 0.026
    linear = np.array([1 / R0, 2 / R, 1 / R, 1 / R, 2 / R, 1 / R, 1 / R, 1 / R])
    constant = np.array([0, Ub / R, 0, Ub / R, Ub / R, 0, Ub / R, 0])
    # What the current of each transistor adds to the three nodes that it joins.
    gain = np.zeros((8, 2))
    gain[1:4, 0] = gain[4:7, 1] = 1 - alpha, -1, alpha

    def fun(t, y):
        current = beta * (np.exp((y[[1, 4]] - y[[2, 5]]) / UF) - 1)
        result = linear * y - constant + gain @ current
        result[0] -= 0.1 * math.sin(200 * math.pi * t) / R0
        return result

    def jac(t, y):
        slope = gain * (beta / UF * np.exp((y[[1, 4]] - y[[2, 5]]) / UF))
        result = np.diag(linear)
        result[:, [1, 4]] += slope
        result[:, [2, 5]] -= slope
        return result

    result = solve_ivp(
        fun,
        (0, 0.2),
        [0, Ub / 2, Ub / 2, Ub, Ub / 2, Ub / 2, Ub, 0],
        "Radau",
        mass=mass,
        rtol=tolerance,
        atol=0.01 * tolerance,
        t_eval=[0.2],
        jac=jac if own else None,
    )
    end = [-0.5562145012262709e-2, 3.006522471903042, 2.849958788608128, 2.926422536206241]
    end += [2.704617865010554, 2.761837778393145, 4.770927631616772, 1.236995868091548]
    assert np.abs(result.y[:, 0] - end).max() < max(0.2 * tolerance, 2e-12)


@pytest.mark.parametrize("convert", [np.asarray, scipy.sparse.csc_matrix])
def test_inconsistent_start_is_refused(convert):
    def fun(t, y):
        return [-y[0], y[1] - y[0]]

    for mass in (np.diag([1.0, 0.0]), np.array([[1.0, 1.0], [2.0, 2.0]])):
        with pytest.raises(substep.InputError, match=r"y0: not consistent.*residual"):
            solve_ivp(fun, (0, 1), [1.0, 3.0], "Radau", mass=convert(mass))
    result = solve_ivp(fun, (0, 1), [1.0, 1.0], "Radau", mass=convert(np.diag([1.0, 0.0])))
    np.testing.assert_allclose(result.y[:, -1], math.exp(-1), rtol=1e-3)


# Threads.


@pytest.mark.parametrize("settings", [{"linear_solver": "krylov"}, {}])
def test_same_bits_for_any_number_of_threads(settings):
    system = systems.Brusselator2D(48)
    ends = []
    for threads in (1, 2, 3):
        result = solve_ivp(
            system, (0, 0.2), system.y0, "Radau", t_eval=[0.2], threads=threads, **settings
        )
        ends.append(substep.state_hash(result.y))
    assert len(set(ends)) == 1
