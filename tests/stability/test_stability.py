"""Stability functions against closed forms, exact rational arithmetic and the integrators."""

import math
import sys
from fractions import Fraction

import numpy as np
import pytest
import substep
from hypothesis import given, settings, strategies as st
from substep import stability
from substep.errors import InputError
from substep.stability.analysis import _factor

ONE_STEP = stability.one_step_methods()
FAMILY = {name: substep._core.ode_method(name)["family"] for name in ONE_STEP}
EXPLICIT = tuple(name for name in ONE_STEP if FAMILY[name] == "explicit")
IMPLICIT = tuple(name for name in ONE_STEP if FAMILY[name] == "implicit")
SECOND_ORDER = stability.second_order_methods()

# Coefficients c_j of R(z), from the literature and not from the tableaux: c_j = 1 / j! up to the
# order; Dormand-Prince 5's c_6 = 1/600 (Hairer & Wanner II, IV.2, (2.9)).
EXACT = {
    "euler": [1, 1],
    "midpoint": [1, 1, Fraction(1, 2)],
    "heun": [1, 1, Fraction(1, 2)],
    "rk4": [Fraction(1, math.factorial(j)) for j in range(5)],
    "RK45": [*(Fraction(1, math.factorial(j)) for j in range(6)), Fraction(1, 600)],
}


def exceeds(coefficients, direction, r):
    """Whether |R(r u)| > 1, exactly: rational coefficients, u = -1 or i, rational r."""
    real, imag = Fraction(0), Fraction(0)
    power = (Fraction(1), Fraction(0))
    u = (Fraction(int(direction.real)), Fraction(int(direction.imag)))
    for c in coefficients:
        real, imag = real + c * power[0], imag + c * power[1]
        power = (
            r * (power[0] * u[0] - power[1] * u[1]),
            r * (power[0] * u[1] + power[1] * u[0]),
        )
    return real * real + imag * imag > 1


def first_crossing(coefficients, direction):
    """The smallest r beyond which |R(r u)| > 1, by exact scan and bisection to 60 bits."""
    grid = Fraction(1, 64)
    count = 1
    while not exceeds(coefficients, direction, count * grid):
        count += 1
        assert count < 64 * 40
    low, high = (count - 1) * grid, count * grid
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if exceeds(coefficients, direction, middle) else (middle, high)
    return float(low)


def resolvent(table, z):
    """R(z) = 1 + z b^T (I - z A)^-1 1, solved as written."""
    b = table["b"]
    a = table["a"][: len(b), : len(b)]
    return 1 + z * b @ np.linalg.solve(np.eye(len(b)) - z * a, np.ones(len(b)))


# Amplification factor


@pytest.mark.parametrize("method", [*EXPLICIT, *IMPLICIT])
def test_amplification_is_the_formula_of_the_tableau(method):
    rng = np.random.default_rng(1)
    z = rng.uniform(-4, 2, (5, 7)) + 1j * rng.uniform(-4, 4, (5, 7))
    got = stability.amplification(method, z)
    table = substep._core.tableau(method)
    want = np.array([[resolvent(table, value) for value in row] for row in z])
    assert got.shape == z.shape
    np.testing.assert_allclose(got, want, rtol=1e-11, atol=1e-11 * abs(want).max())


@pytest.mark.parametrize("method", EXPLICIT)
def test_polynomial_is_the_exponential_up_to_the_order(method):
    table = substep._core.tableau(method)
    polynomial = stability.amplification_polynomial(method)
    order, stages = table["order"], table["stages"]
    assert polynomial.shape == (stages + 1,)
    scaled = polynomial * [math.factorial(j) for j in range(stages + 1)]
    np.testing.assert_allclose(scaled[: order + 1], 1, rtol=1e-13)
    assert not np.any(np.isclose(scaled[order + 1 :], 1, rtol=1e-3))
    if method in EXACT:
        np.testing.assert_allclose(polynomial, [float(c) for c in EXACT[method]], rtol=1e-14)


def test_implicit_euler():
    z = np.array([-3 + 2j, 0.5j, -1e9, 0])
    np.testing.assert_allclose(
        stability.amplification("implicit_euler", z), 1 / (1 - z), rtol=1e-15
    )
    assert stability.amplification("Implicit_Euler", 1.0) == complex(np.inf)
    grid = stability.region("implicit_euler", bounds=(-1, 3, -2.1, 2), resolution=81)
    points = grid.real + 1j * grid.imag[:, None]
    np.testing.assert_array_equal(grid.stable, abs(1 - points) >= 1)
    np.testing.assert_allclose(abs(grid.boundary[0] - 1), 1, rtol=1e-13)


def test_radau():
    """The Pade approximation with degrees 2 and 3, Hairer & Wanner II, IV.3, table 3.1."""
    z = np.array([-3 + 2j, 0.5j, -40.0, 0, 7.0 - 1j])
    want = (1 + 2 * z / 5 + z**2 / 20) / (1 - 3 * z / 5 + 3 * z**2 / 20 - z**3 / 60)
    np.testing.assert_allclose(stability.amplification("radau", z), want, rtol=1e-12)
    h = np.array([0.02, 0.04])
    error = abs(stability.amplification("Radau", 1j * h) - np.exp(1j * h))
    assert np.log2(error[1] / error[0]) == pytest.approx(6, abs=0.1)  # order 5


@pytest.mark.parametrize("method", IMPLICIT)
def test_implicit_methods_are_a_and_l_stable(method):
    """|R| <= 1 on the left half plane, up to the axis, and R = 0 at infinity."""
    radius = np.geomspace(1e-3, 1e12, 301)[:, None]
    z = radius * np.exp(1j * np.linspace(0.5, 1.5, 181) * np.pi)
    z.real[:, [0, -1]] = 0.0
    assert abs(stability.amplification(method, z)).max() <= 1 + 1e-15
    assert abs(stability.amplification(method, -1e13)) < 1e-12
    assert stability.real_limit(method) == stability.imaginary_limit(method) == math.inf
    assert stability.max_stable_step(method, [-1e9, -1 + 1e6j, 3j]) == math.inf


@settings(deadline=None)
@given(st.floats(0, 1e6))
def test_explicit_euler_spirals_outwards(h_omega):
    got = abs(stability.amplification("euler", 1j * h_omega))
    assert got == pytest.approx(math.sqrt(1 + h_omega**2), rel=1e-15)


def test_scalars_stay_scalars():
    value = stability.amplification("RK4", -0.5)
    assert isinstance(value, complex)
    assert value == pytest.approx(1 - 0.5 + 0.125 - 0.125 / 6 + 0.0625 / 24, rel=1e-15)
    assert stability.amplification("rk4", [-0.5]).shape == (1,)


# Limits


@pytest.mark.parametrize(
    ("method", "real", "imaginary"),
    [
        ("euler", 2, 0),
        ("heun", 2, 0),
        ("midpoint", 2, 0),
        ("rk4", 2.785293563405282, 2.828427124746190),  # the latter 2 sqrt(2)
    ],
)
def test_published_limits(method, real, imaginary):
    assert stability.real_limit(method) == pytest.approx(real, rel=1e-14)
    assert stability.imaginary_limit(method) == pytest.approx(imaginary, rel=1e-14, abs=0)


@pytest.mark.parametrize("method", ["rk4", "RK45", "DOP853"])
def test_limits_by_exact_bisection(method):
    coefficients = EXACT.get(method)
    if coefficients is None:  # order 8 exactly, the rest from the tableau
        tail = stability.amplification_polynomial(method)[9:]
        coefficients = [Fraction(1, math.factorial(j)) for j in range(9)]
        coefficients += [Fraction(float(c)) for c in tail]
    want = first_crossing(coefficients, -1 + 0j)
    assert stability.real_limit(method) == pytest.approx(want, rel=1e-12)
    want = first_crossing(coefficients, 1j)
    assert stability.imaginary_limit(method) == pytest.approx(want, rel=1e-12)


@pytest.mark.parametrize("method", EXPLICIT)
@pytest.mark.parametrize("degrees", [91, 100, 120, 135, 150, 170, 180])
def test_limit_along_any_ray(method, degrees):
    direction = np.exp(1j * np.deg2rad(degrees))
    limit = stability.max_stable_step(method, [direction])
    r = limit * np.linspace(1e-3, 1 - 1e-9, 2000)
    assert np.all(abs(stability.amplification(method, r * direction)) <= 1)
    assert abs(stability.amplification(method, limit * (1 + 1e-7) * direction)) > 1


# Region


@pytest.mark.parametrize("method", ONE_STEP)
def test_outline_is_the_level_curve_and_closes(method):
    area = stability.region(method, resolution=51)
    assert np.min(abs(area.boundary[0])) < 1e-12  # R(0) = 1
    for curve in area.boundary:
        np.testing.assert_allclose(abs(stability.amplification(method, curve)), 1, atol=1e-7)
        assert abs(curve[0] - curve[-1]) <= 1e-9 * abs(curve[0]) + 1e-12
    total = sum(len(curve) - 1 for curve in area.boundary)
    sheets = len(_factor(method).roots(1.0))
    assert total % sheets == 0  # every root of R(z) = exp(i phi) is on one of the curves, once


@pytest.mark.parametrize("method", ["euler", "heun", "rk4", "RK45", "DOP853"])
def test_grid_and_outline_agree(method):
    area = stability.region(method, resolution=61)
    points = area.real + 1j * area.imag[:, None]
    np.testing.assert_allclose(area.modulus, abs(stability.amplification(method, points)))
    np.testing.assert_array_equal(area.stable, area.modulus <= 1)
    points += 1e-9j  # off the outline's own points
    winding = np.zeros(points.shape)
    for curve in area.boundary:
        ahead = (curve[1:, None, None] - points) / (curve[:-1, None, None] - points)
        winding += np.angle(ahead).sum(axis=0) / (2 * np.pi)
    distance = np.min([abs(points[..., None] - c).min(axis=-1) for c in area.boundary], axis=0)
    away = distance > 0.06  # the outline is a polygon
    assert away.mean() > 0.6
    np.testing.assert_array_equal(area.stable[away], np.rint(winding[away]) != 0)


def test_region_reaches_the_limits():
    area = stability.region("RK45", resolution=11)
    main = area.boundary[0]
    assert -main.real.min() == pytest.approx(stability.real_limit("RK45"), abs=1e-6)
    assert len(area.boundary) == 3  # two islands in the right half plane
    assert area.real[0] < main.real.min() and area.imag[-1] > main.imag.max()


# Second-order methods


@settings(deadline=None)
@given(st.floats(0, 4), st.sampled_from(SECOND_ORDER))
def test_undamped_maps_keep_the_area(h_omega, method):
    matrix = stability.amplification_matrix(method, h_omega)
    assert np.linalg.det(matrix) == pytest.approx(1, abs=1e-9 * (1 + h_omega) ** 6)
    if method != "yoshida4":
        assert np.trace(matrix) == pytest.approx(2 - h_omega**2, abs=1e-13)


def test_symplectic_euler_matrix_is_the_textbook_one():
    s = np.array([0.1, 1.0, 2.5])
    got = stability.amplification_matrix("Symplectic_Euler", s)
    want = np.array([[[1 - x * x, x], [-x, 1]] for x in s])
    np.testing.assert_allclose(got, want, rtol=1e-15)


def test_verlet_limit_is_two_and_defective():
    for method in SECOND_ORDER[:3]:
        assert stability.stability_limit(method) == 2.0
        below, at, above = np.sort(
            abs(stability.amplification_eigenvalues(method, [1.999, 2.0, 2.001])), axis=-1
        )
        np.testing.assert_allclose(below, 1, rtol=1e-10)
        np.testing.assert_allclose(at, 1, atol=1e-7)
        assert above[1] > 1.06
        jordan = stability.amplification_matrix(method, 2.0) + np.eye(2)
        assert np.linalg.matrix_rank(jordan) == 1  # one eigenvector: linear growth


def test_yoshida_limit():
    w1 = 1 / (2 - 2 ** (1 / 3))

    def trace(s):
        matrix = np.eye(2)
        for w in (w1, 1 - 2 * w1, w1):
            kick, drift = np.array([[1, 0], [-w * s / 2, 1]]), np.array([[1, w * s], [0, 1]])
            matrix = kick @ drift @ kick @ matrix
        return np.trace(matrix)

    limit = stability.stability_limit("yoshida4")
    assert trace(limit) == pytest.approx(2, abs=1e-13)  # two eigenvalues meet at 1
    assert all(abs(trace(s)) < 2 for s in np.linspace(0.01, limit - 1e-6, 1000))


@pytest.mark.parametrize("zeta", [1e-9, 1e-4, 0.01, 0.2, 0.5, 1.0, 3.0, 1e3, 1e6, 1e100])
def test_damped_limits_in_closed_form(zeta):
    # Both follow from p(-1) = 0 of the characteristic polynomial.
    want = 2 / (math.sqrt(1 + zeta**2) + zeta)
    assert stability.stability_limit("symplectic_euler", zeta) == pytest.approx(want, rel=1e-9)
    want = 2 / (math.sqrt(1 + 4 * zeta**2) + 2 * zeta)
    for method in ("position_verlet", "velocity_verlet"):
        assert stability.stability_limit(method, zeta) == pytest.approx(want, rel=1e-9)


@pytest.mark.parametrize("method", SECOND_ORDER)
@pytest.mark.parametrize("zeta", [0.0, 0.05, 0.3, 0.7, 1.5, 8.0])
def test_limit_separates_bounded_from_growing(method, zeta):
    limit = stability.stability_limit(method, zeta)
    inside = stability.amplification_eigenvalues(
        method, limit * np.linspace(0.01, 0.999, 400), zeta
    )
    assert abs(inside).max() <= 1 + 1e-12
    assert abs(stability.amplification_eigenvalues(method, limit * 1.001, zeta)).max() > 1 + 1e-5


@pytest.mark.parametrize("method", SECOND_ORDER)
def test_damped_map_follows_the_solution(method):
    zeta, s = 0.2, 1e-3
    matrix = stability.amplification_matrix(method, s, zeta)
    state = np.array([1.0, 0.0, -1.0])[: len(matrix)]
    for _ in range(1000):
        state = matrix @ state
    damped = math.sqrt(1 - zeta**2)
    exact = math.exp(-zeta) * (math.cos(damped) + zeta / damped * math.sin(damped))
    assert state[0] == pytest.approx(exact, abs=1e-3 if method == "symplectic_euler" else 2e-7)


# Spectra


def spring_chain(masses, stiffness=400.0, damping=0.0):
    """Jacobian of (x, v)' for a chain fixed at both ends; its frequencies are known."""
    laplace = 2 * np.eye(masses) - np.eye(masses, k=1) - np.eye(masses, k=-1)
    zero, one = np.zeros((masses, masses)), np.eye(masses)
    jacobian = np.block([[zero, one], [-stiffness * laplace, -damping * laplace]])
    omega = 2 * math.sqrt(stiffness) * np.sin(np.arange(1, masses + 1) * np.pi / (2 * (masses + 1)))
    return jacobian, omega


@pytest.mark.parametrize("method", ["euler", "heun", "midpoint"])
def test_undamped_chain_is_impossible_for_low_orders(method):
    jacobian, _ = spring_chain(20)
    assert stability.max_stable_step(method, jacobian) == 0.0


def test_undamped_chain():
    jacobian, omega = spring_chain(20)
    top = omega.max()
    assert stability.max_stable_step("RK4", jacobian) == pytest.approx(8**0.5 / top, rel=1e-12)
    for method in SECOND_ORDER[:3]:
        assert stability.max_stable_step(method, jacobian) == pytest.approx(2 / top, rel=1e-12)
    assert stability.max_stable_step("implicit_euler", jacobian) == math.inf


def test_relative_damping_of_the_chain():
    jacobian, omega = spring_chain(20, damping=0.4)  # zeta = 0.0005 omega
    zeta = 0.4 / (2 * 400.0) * omega.max()
    for method in SECOND_ORDER:
        want = min(stability.stability_limit(method, 0.4 / 800.0 * w) / w for w in omega)
        assert stability.max_stable_step(method, jacobian) == pytest.approx(want, rel=1e-9)
    want = min(2 * 0.4 / 800.0 * w / w for w in omega)  # explicit Euler: 2 zeta / omega
    assert stability.max_stable_step("euler", jacobian) == pytest.approx(want, rel=1e-9)
    assert zeta < 1


def test_modes_that_set_no_limit():
    assert stability.max_stable_step("rk4", []) == math.inf
    assert stability.max_stable_step("rk4", [0.0, 0.0]) == math.inf
    assert stability.max_stable_step("rk4", [5.0, 2 + 3j]) == math.inf  # the solution grows too
    assert stability.max_stable_step("euler", [5.0, -10.0]) == 0.2
    # A free pair of masses: the double eigenvalue 0 is defective and comes out as +-1e-8.
    jacobian = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [np.array([[-9.0, 9.0], [9.0, -9.0]]), np.zeros((2, 2))]]
    )
    want = 2 / math.sqrt(18)
    assert stability.max_stable_step("velocity_verlet", jacobian) == pytest.approx(want, rel=1e-12)


def test_rounding_of_a_spectrum_is_forgiven():
    blurred = [1e-12 + 10j, 1e-12 - 10j, -1e-13]
    assert stability.max_stable_step("rk4", blurred) == pytest.approx(8**0.5 / 10, rel=1e-12)
    assert stability.max_stable_step("symplectic_euler", blurred) == pytest.approx(0.2, rel=1e-12)


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.tuples(st.floats(-10, -0.1), st.floats(-10, 10)), min_size=1, max_size=5),
    st.sampled_from(EXPLICIT),
)
def test_max_stable_step_is_the_largest(pairs, method):
    spectrum = np.array([complex(*pair) for pair in pairs])
    h = stability.max_stable_step(method, spectrum)
    assert abs(stability.amplification(method, h * (1 - 1e-7) * spectrum)).max() <= 1
    assert abs(stability.amplification(method, h * (1 + 1e-4) * spectrum)).max() > 1


def test_stiffness_ratio():
    assert stability.stiffness_ratio([-1000, -2 + 5j, -2 - 5j, 0]) == 500
    assert stability.stiffness_ratio(np.diag([-3.0, -12.0, 4.0])) == 4
    # 1D heat equation, second differences: 1 / tan(pi / (2 (n + 1)))^2.
    n = 50
    laplace = -2 * np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1)
    want = 1 / math.tan(math.pi / (2 * (n + 1))) ** 2
    assert stability.stiffness_ratio(laplace) == pytest.approx(want, rel=1e-9)


# Bad input


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: stability.amplification("rk5", 0.0), r"method: expected one of euler, .*rk4.*rk5"),
        (lambda: stability.amplification("verlet", 0.0), "method: expected one of"),
        (lambda: stability.amplification(4, 0.0), "method: expected one of"),
        (lambda: stability.amplification("rk4", [1.0, np.nan]), r"z\[1\]: expected finite"),
        (lambda: stability.amplification_polynomial("implicit_euler"), "implicit"),
        (lambda: stability.amplification_matrix("rk4", 0.1), "method: expected one of symplectic"),
        (lambda: stability.amplification_matrix("yoshida4", 0.1, -0.5), "damping_ratio"),
        (lambda: stability.amplification_matrix("yoshida4", np.inf), "h_omega"),
        (lambda: stability.stability_limit("yoshida4", np.nan), "damping_ratio"),
        (lambda: stability.real_limit("velocity_verlet"), "method: expected one of euler"),
        (lambda: stability.region("rk4", bounds=(1, 0, 0, 1)), "bounds"),
        (lambda: stability.region("rk4", bounds=(0, 1, 0)), "bounds"),
        (lambda: stability.region("rk4", resolution=1), "resolution"),
        (lambda: stability.max_stable_step("rk4", [np.nan]), "eigenvalues"),
        (lambda: stability.max_stable_step("rk4", np.zeros((2, 3))), r"got \(2, 3\)"),
        (lambda: stability.max_stable_step("rk4", -1.0), r"expected shape \(n,\)"),
        (lambda: stability.max_stable_step("velocity_verlet", [-1.0]), "overdamped"),
        (lambda: stability.stiffness_ratio([1.0, 0.0]), "negative real part"),
        (lambda: stability.stiffness_ratio([]), "negative real part"),
        (lambda: stability.plot([]), "methods"),
        (lambda: stability.plot("rk4", eigenvalues=[-1.0]), "eigenvalues and step"),
        (lambda: stability.plot("rk4", step=0.1), "eigenvalues and step"),
        (lambda: stability.plot("rk4", eigenvalues=[-1.0], step=0), "step"),
        (lambda: stability.plot("rk9"), "method"),
    ],
)
def test_bad_input(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_bad_types():
    with pytest.raises(TypeError, match="z: expected real or complex numbers"):
        stability.amplification("rk4", np.array(["a"]))
    with pytest.raises(TypeError, match="h_omega: expected real numbers"):
        stability.amplification_matrix("yoshida4", 1j)


# Picture


def test_plot(tmp_path):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    ax = stability.plot(["euler", "RK45"], eigenvalues=[-10.0, 3j], step=0.5)
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["euler", "RK45", r"$h\lambda$ of the spectrum"]
    np.testing.assert_allclose(ax.lines[-1].get_xdata(), [-5.0, 0.0])
    np.testing.assert_allclose(ax.lines[-1].get_ydata(), [0.0, 1.5])
    assert ax.get_xlim()[0] < -5
    given_ax = plt.subplots()[1]
    assert stability.plot("rk4", ax=given_ax) is given_ax
    ax.figure.savefig(tmp_path / "regions.png")
    assert (tmp_path / "regions.png").stat().st_size > 5000
    plt.close("all")


def test_plot_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(ImportError, match=r"substep\[plot\]"):
        stability.plot("rk4")


# The integrators do what the functions say


@pytest.mark.parametrize("method", SECOND_ORDER)
@pytest.mark.parametrize("zeta", [0.0, 0.3])
def test_matrix_is_what_the_solver_does(method, zeta):
    omega, steps = 3.0, 5
    for s in (0.1, 0.7, 1.9, 2.6):
        out = substep.solve_second_order(
            lambda t, x, v: -(omega**2) * x - 2 * zeta * omega * v,
            (0.0, steps * s / omega),
            [0.8],
            [-1.3],
            method,
            step=s / omega,
        )
        matrix = stability.amplification_matrix(method, s, zeta)
        state = np.array([0.8, -1.3 / omega, -0.8 - 2 * zeta * -1.3 / omega])[: len(matrix)]
        assert out.x.shape == (1, steps + 1)
        for k in range(1, steps + 1):
            state = matrix @ state
            got = [out.x[0, k], out.v[0, k] / omega]
            np.testing.assert_allclose(got, state[:2], rtol=1e-10, atol=1e-10 * abs(state).max())


def test_every_second_order_method_is_here():
    assert set(SECOND_ORDER) == set(substep.second_order.METHODS)


def test_linear_growth_at_the_symplectic_limit():
    def size(s, steps):
        out = substep.solve_second_order(
            lambda t, x, v: -x, (0, steps * s), [1.0], [0.0], "symplectic_euler", step=s
        )
        return np.hypot(out.x[0], out.v[0])

    assert size(1.999, 10_000).max() < 70
    n = np.arange(1001)
    np.testing.assert_allclose(size(2.0, 1000), np.hypot(1 + 2 * n, 2 * n), rtol=1e-12)
    assert size(2.01, 1000)[-1] > 1e60


@pytest.mark.parametrize("method", [*EXPLICIT, *IMPLICIT])
def test_factor_is_what_the_solver_does(method):
    for z in (-0.3 + 0.2j, 1j, -2.5 + 1.5j, 0.4 - 0.9j, -6.0 + 0j):
        growth, h = z / 0.25, 0.25
        out = substep.solve_ivp(
            lambda t, y, growth=growth: growth * y, (0.0, h), [1.0 + 2.0j], method, step=h
        )
        want = (1.0 + 2.0j) * stability.amplification(method, z)
        assert out.y.shape == (1, 2)
        assert out.y[0, -1] == pytest.approx(want, rel=1e-12)


def chain_size(method, jacobian, h, steps):
    """Largest value at the end, from a start of size 1 that holds every mode."""
    masses = len(jacobian) // 2
    start = np.random.default_rng(3).normal(size=2 * masses)
    end = [h * steps]
    if method in SECOND_ORDER:
        lower = jacobian[masses:]
        out = substep.solve_second_order(
            lambda t, x, v: lower @ np.concatenate([x, v]),
            (0, *end),
            start[:masses],
            start[masses:],
            method,
            step=h,
            t_eval=end,
        )
        return abs(np.concatenate([out.x, out.v])).max()
    out = substep.solve_ivp(lambda t, y: jacobian @ y, (0, *end), start, method, step=h, t_eval=end)
    return abs(out.y).max()


def growth(method, spectrum, h):
    """Factor of the fastest growing mode in one step."""
    if method not in SECOND_ORDER:
        return abs(stability.amplification(method, h * spectrum)).max()
    zeta = -spectrum.real / abs(spectrum)
    return max(
        abs(stability.amplification_eigenvalues(method, h * abs(value), max(0.0, z))).max()
        for value, z in zip(spectrum, zeta, strict=True)
    )


@pytest.mark.parametrize("method", [*EXPLICIT, *SECOND_ORDER])
@pytest.mark.parametrize("damping", [0.0, 0.4, 4.0])
def test_a_spring_chain_explodes_where_predicted(method, damping):
    jacobian, omega = spring_chain(12, damping=damping)
    spectrum = np.linalg.eigvals(jacobian)
    h = stability.max_stable_step(method, jacobian)
    # Just beyond the limit, or where growth is slow there, further out; 0: every step is too long.
    candidates = [1.04 * h, 1.5 * h, 3 * h] if h > 0 else [0.5 / omega.max()]
    factors = [growth(method, spectrum, candidate) for candidate in candidates]
    assert min(factors) > 1
    too_long, factor = next(
        pair for pair in zip(candidates, factors, strict=True) if pair[1] > 1.002
    )
    steps = math.ceil(math.log(1e12) / math.log(factor))
    assert 1e9 < chain_size(method, jacobian, too_long, steps) < 1e17
    if h > 0:
        assert chain_size(method, jacobian, 0.98 * h, steps) < 1e3
