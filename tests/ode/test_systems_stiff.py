"""The stiff systems: equations, Jacobians, end values."""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
import substep
from substep import InputError, systems

REFERENCE = Path(__file__).parents[3] / "shared/reference/ode.json"


@pytest.fixture(scope="module")
def reference():
    if not REFERENCE.exists():
        pytest.skip("the reference values of ../shared are not here")
    return json.loads(REFERENCE.read_text())


def robertson(s):
    def fun(t, y):
        rates = s.k1 * y[0], s.k2 * y[1] ** 2, s.k3 * y[1] * y[2]
        return np.array([-rates[0] + rates[2], rates[0] - rates[2] - rates[1], rates[1]])

    return fun


def orego(s):
    return lambda t, y: np.array(
        [
            s.s * (y[1] + y[0] * (1 - s.q * y[0] - y[1])),
            (y[2] - (1 + y[0]) * y[1]) / s.s,
            s.w * (y[0] - y[2]),
        ]
    )


def hires(s):
    matrix = np.zeros((8, 8))
    matrix[0, :3] = -1.71, 0.43, 8.32
    matrix[1, :2] = 1.71, -8.75
    matrix[2, 2:5] = -10.03, 0.43, 0.035
    matrix[3, 1:4] = 8.32, 1.71, -1.12
    matrix[4, 4:7] = -1.745, 0.43, 0.43
    matrix[5, 3:7] = 0.69, 1.71, -0.43, 0.69
    matrix[6, 6] = -1.81
    matrix[7, 6] = 1.81
    product = np.array([0, 0, 0, 0, 0, -280, 280, -280])
    return lambda t, y: matrix @ y + product * (y[5] * y[7]) + 0.0007 * np.eye(8)[0]


def van_der_pol(s):
    factor = s.mu**2 if s.scaled else 1
    damping = factor if s.scaled else s.mu
    return lambda t, y: np.array([y[1], damping * (1 - y[0] ** 2) * y[1] - factor * y[0]])


def brusselator_1d(s):
    def fun(t, y):
        u, v = y.reshape(2, s.n)
        c = s.alpha * (s.n + 1) ** 2
        lap = [
            np.diff(np.concatenate([[end], w, [end]]), 2) for w, end in ((u, s.a), (v, s.b / s.a))
        ]
        return np.concatenate(
            [s.a + u * u * v - (s.b + 1) * u + c * lap[0], s.b * u - u * u * v + c * lap[1]]
        )

    return fun


def brusselator_2d(s):
    def fun(t, y):
        u, v = y.reshape(2, s.n, s.n)

        def laplace(w):
            shifts = [np.roll(w, k, axis) for k in (1, -1) for axis in (0, 1)]
            return s.alpha * s.n**2 * (sum(shifts) - 4 * w)

        x, z = np.meshgrid(np.arange(s.n) / s.n, np.arange(s.n) / s.n)
        inside = (x - 0.3) ** 2 + (z - 0.6) ** 2 <= 0.01 + 1e-12
        source = s.source * inside * (t >= s.source_time)
        du = s.a + u * u * v - (s.b + 1) * u + laplace(u) + source
        dv = s.b * u - u * u * v + laplace(v)
        return np.concatenate([du.ravel(), dv.ravel()])

    return fun


CASES = {
    "Robertson": (systems.Robertson(0.05, 2e7, 3e4), robertson),
    "Orego": (systems.Orego(70.0, 9e-6, 0.2), orego),
    "Hires": (systems.Hires(), hires),
    "VanDerPol": (systems.VanDerPol(3.0), van_der_pol),
    "VanDerPol scaled": (systems.VanDerPol(300.0, scaled=True), van_der_pol),
    "Brusselator1D": (systems.Brusselator1D(37, 0.03, 1.2, 2.5), brusselator_1d),
    "Brusselator1D of 1": (systems.Brusselator1D(1), brusselator_1d),
    "Brusselator1D of 2": (systems.Brusselator1D(2), brusselator_1d),
    "Brusselator2D": (systems.Brusselator2D(12, 0.2, 1.1, 3.0, 4.0, 0.7), brusselator_2d),
    "Brusselator2D of 3": (systems.Brusselator2D(3), brusselator_2d),
    "Brusselator2D of 65": (systems.Brusselator2D(65), brusselator_2d),
}


def states(system, count=5):
    rng = np.random.default_rng(7)
    return [(0.3 + t, rng.uniform(0.1, 2.0, system.size)) for t in range(count)]


@pytest.mark.parametrize("case", CASES)
def test_equations(case):
    system, form = CASES[case]
    fun = form(system)
    for t, y in states(system):
        want = fun(t, y)
        np.testing.assert_allclose(system(t, y), want, rtol=1e-11, atol=1e-13 * abs(want).max())


def dense(jacobian):
    return jacobian if isinstance(jacobian, np.ndarray) else jacobian.toarray()


@pytest.mark.parametrize("case", [c for c in CASES if c != "Brusselator2D of 65"])
def test_jacobian_is_the_derivative(case):
    """Central differences of polynomials of degree 3 at two widths, extrapolated: no error left."""
    system, _ = CASES[case]
    for t, y in states(system, 2):

        def slope(h, t=t, y=y):
            step = h * np.eye(y.size)
            return np.array([(system(t, y + s) - system(t, y - s)) / (2 * h) for s in step]).T

        want = (4 * slope(0.05) - slope(0.1)) / 3
        got = dense(system.jacobian(t, y))
        scale = abs(want).max(axis=1, keepdims=True)
        np.testing.assert_allclose(got / scale, want / scale, atol=1e-9)


@pytest.mark.parametrize("case", CASES)
def test_product_with_the_jacobian(case):
    system, _ = CASES[case]
    v = np.random.default_rng(3).normal(size=system.size)
    for t, y in states(system, 2):
        want = system.jacobian(t, y) @ v
        got = system.jacobian_product(t, y, v)
        np.testing.assert_allclose(got, want, rtol=1e-11, atol=1e-12 * abs(want).max())


@pytest.mark.parametrize("case", ["Brusselator1D", "Brusselator2D"])
def test_sparse_jacobian(case):
    system, _ = CASES[case]
    t, y = states(system, 1)[0]
    jacobian = system.jacobian(t, y)
    assert jacobian.format == "csc" and jacobian.has_canonical_format
    neighbours = {"Brusselator1D": 3, "Brusselator2D": 5}[case]
    edges = 4 if case == "Brusselator1D" else 0
    assert jacobian.nnz == system.size * (neighbours + 1) - edges


def test_no_jacobian():
    with pytest.raises(InputError, match="no Jacobian"):
        systems.Lorenz().jacobian(0.0, [1.0, 1.0, 1.0])


@pytest.mark.parametrize("case", ["Brusselator1D", "Brusselator2D", "Brusselator2D of 65"])
def test_spectral_radius_is_a_bound(case):
    """As the number of stages of a step tells it, against the eigenvalue of greatest modulus."""
    from scipy.sparse.linalg import eigs

    system, _ = CASES[case]
    t, y = states(system, 1)[0]
    h = 0.5
    result = substep.solve_ivp(system, (t, t + h), y, "RKC2", step=h)
    stages = result.nfev - 1
    radius = abs(eigs(system.jacobian(t, y), k=1, which="LM", return_eigenvectors=False)[0])
    needed = 1 + np.floor(np.sqrt(1 + 1.54 * h * radius))
    assert needed <= stages <= 1.1 * needed + 1


@pytest.mark.parametrize("name", ["Hires", "Orego", "Robertson"])
def test_end_values(name, reference):
    """Published end values (Mazzia and Magherini's test set), reached by SciPy's Radau at 1e-11."""
    published = {
        "Hires": [
            0.7371312573325668e-3, 0.1442485726316185e-3, 0.5888729740967575e-4,
            0.1175651343283149e-2, 0.2386356198831331e-2, 0.6238968252742796e-2,
            0.2849998395185769e-2, 0.2850001604814231e-2,
        ],
        "Orego": [0.1000814870318523e1, 0.1228178521549917e4, 0.1320554942846706e3],
        "Robertson": [float(v) for v in reference["robertson_T1e11"]["y_end"]],
    }[name]  # fmt: skip
    system = getattr(systems, name)()
    result = scipy.integrate.solve_ivp(
        system, (0, system.t_end), system.y0, "Radau", jac=system.jacobian, rtol=1e-11, atol=1e-16
    )
    np.testing.assert_allclose(result.y[:, -1], published, rtol=1e-8)


def test_scaled_van_der_pol(reference):
    """mu = 1000: in units of mu, time and velocity are those of the other form."""
    entry = reference["vdpol_mu1000_scaled_T2"]
    end = np.array(entry["y_end"], dtype=float)
    for system, t_end, factor in (
        (systems.VanDerPol(1000.0, scaled=True), 2.0, 1.0),
        (systems.VanDerPol(1000.0), 2000.0, 1e-3),
    ):
        result = scipy.integrate.solve_ivp(
            system, (0, t_end), system.y0, "Radau", jac=system.jacobian, rtol=1e-9, atol=1e-12
        )
        np.testing.assert_allclose(result.y[:, -1], end * [1, factor], rtol=1e-6)


@pytest.mark.parametrize(
    ("create", "message"),
    [
        (lambda: systems.Orego(s=0.0), "s: expected a number above 0"),
        (lambda: systems.Robertson(k2=np.nan), "k2"),
        (lambda: systems.Brusselator1D(0), "n: expected an integer"),
        (lambda: systems.Brusselator1D(10, alpha=-1.0), "alpha"),
        (lambda: systems.Brusselator1D(10, a=0.0), "a: expected a number above 0"),
        (lambda: systems.Brusselator2D(2), "n: expected an integer from 3"),
        (lambda: systems.Brusselator2D(10, source_time=np.nan), "source_time"),
        (lambda: systems.Brusselator2D(10, b=np.inf), "b"),
        (lambda: systems.Brusselator2D(2.5), "n: expected an integer"),
    ],
)
def test_bad_parameters(create, message):
    with pytest.raises(InputError, match=message):
        create()


@pytest.mark.parametrize("call", ["jacobian", "jacobian_product"])
def test_bad_states(call):
    system = systems.Robertson()
    arguments = [[1.0, 2.0]] * (1 if call == "jacobian" else 2)
    with pytest.raises(InputError, match=r"y: expected shape \(3,\)"):
        getattr(system, call)(0.0, *arguments)
