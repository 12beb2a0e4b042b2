"""RKC2: its formulas, its stability, its number of stages, its accuracy, its failures."""

import json
import math
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import substep
from hypothesis import given, settings, strategies as st
from substep import InputError, SolverError, _core, solve_ivp, stability
from substep.systems import Brusselator1D, Brusselator2D, Robertson

REFERENCE = Path(__file__).parents[3] / "shared/reference/ode.json"
EPSILON = 2 / 13
STAGES = [2, 3, 4, 5, 8, 13, 30, 100, 333]


@pytest.fixture(scope="module")
def reference():
    if not REFERENCE.exists():
        pytest.skip("the reference values of ../shared are not here")
    return json.loads(REFERENCE.read_text())


def heat(n):
    """u_t = u_xx on n points between walls at 0; the matrix and its eigenvalues."""
    c = (n + 1) ** 2
    matrix = c * (np.eye(n, k=1) - 2 * np.eye(n) + np.eye(n, k=-1))
    return matrix, -4 * c * np.sin(np.arange(1, n + 1) * np.pi / (2 * (n + 1))) ** 2


# The stability function: Sommeijer, Shampine and Verwer 1998, section 2.


def reach(stages):
    """beta(s) = (w_0 + 1) T_s''(w_0) / T_s'(w_0), by NumPy's Chebyshev series."""
    series = np.polynomial.Chebyshev.basis(stages)
    w0 = 1 + EPSILON / stages**2
    return (w0 + 1) * series.deriv(2)(w0) / series.deriv(1)(w0)


@pytest.mark.parametrize("stages", STAGES)
def test_damped_on_the_interval_and_unstable_beyond(stages):
    name, beta = f"RKC2({stages})", reach(stages)
    if stages > 2:  # two stages leave nothing to choose: R = 1 + z + z^2 / 2
        assert beta == pytest.approx(2 / 3 * (stages**2 - 1) * (1 - 2 / 15 * EPSILON), rel=3e-3)
    inside = abs(stability.amplification(name, -beta * np.linspace(0, 1, 100_001)))
    assert inside.max() <= 1 + 1e-12
    # Damped where R has begun to oscillate; near 0 it is exp(z), which begins at 1.
    far = abs(stability.amplification(name, -beta * np.linspace(4 / stages**2, 1, 100_001)))
    assert far.max() <= 1 - EPSILON / 3 + (0.1 + 4 / stages**2) * EPSILON**2
    limit = stability.real_limit(name)
    assert beta <= limit <= beta + 1.2
    assert abs(stability.amplification(name, -limit * (1 - 1e-9))) <= 1
    assert abs(stability.amplification(name, -limit * (1 + 1e-6))) > 1


@pytest.mark.parametrize("stages", [2, 3, 5, 10, 16])
def test_polynomial(stages):
    """1 + z + z^2/2 + ..., and the same function as the closed form."""
    polynomial = stability.amplification_polynomial(f"RKC2({stages})")
    assert polynomial.shape == (stages + 1,)
    np.testing.assert_allclose(polynomial[:3], [1, 1, 0.5], rtol=1e-12)
    assert stages < 3 or 0 < polynomial[3] < 1 / 8
    z = np.random.default_rng(1).normal(size=(50, 2)) @ [1, 1j]
    got = stability.amplification(f"rkc2({stages})", z)
    np.testing.assert_allclose(got, np.polyval(polynomial[::-1], z), rtol=1e-10)


@settings(deadline=None, max_examples=30)
@given(st.integers(2, 60), st.floats(0.02, 1.0), st.floats(0.1, 5.0))
def test_largest_stable_step(stages, real, imaginary):
    name, spectrum = f"RKC2({stages})", np.array([-real + 1j * imaginary, -0.3 * real])
    h = stability.max_stable_step(name, spectrum)
    below = h * np.linspace(1e-4, 1 - 1e-9, 3000)[:, None]
    assert abs(stability.amplification(name, below * spectrum)).max() <= 1 + 1e-9
    assert abs(stability.amplification(name, 1.0001 * h * spectrum)).max() > 1


def test_no_stable_step_without_damping():
    assert stability.imaginary_limit("RKC2") == 0.0
    assert stability.max_stable_step("RKC2(20)", [2j, -2j]) == 0.0
    assert stability.max_stable_step("RKC2(20)", [5.0]) == math.inf


@pytest.mark.parametrize("stages", [2, 5, 12])
def test_region(stages):
    area = stability.region(f"RKC2({stages})", resolution=101)
    assert area.method == f"RKC2({stages})" and len(area.boundary) == 1
    curve = area.boundary[0]
    np.testing.assert_allclose(abs(stability.amplification(area.method, curve)), 1, atol=1e-7)
    assert -curve.real.min() == pytest.approx(stability.real_limit(area.method), rel=1e-9)
    assert len(curve) - 1 == stages * 256 or (len(curve) - 1) % stages == 0
    assert area.stable.any() and not area.stable.all()


@pytest.mark.parametrize("name", ["RKC2(1)", "RKC2(1001)", "RKC2()", "RKC2(x)", "RKC3", "RKC2(-3)"])
def test_bad_names(name):
    with pytest.raises(InputError, match="method"):
        stability.real_limit(name)


# The steps.


def stages_for(x):
    return 1 + math.floor(math.sqrt(1 + 1.54 * x))


@pytest.mark.parametrize("z", [-0.3 + 0.2j, 1j, -2.5 + 0.5j, 0.4 - 0.9j, -6.0, -70 + 3j, -5000.0])
def test_a_step_is_the_stability_function(z):
    h = 0.25
    growth = z / h
    out = solve_ivp(
        lambda t, y: growth * y, (0, h), [1 + 2j], "RKC2", step=h, spectral_radius=abs(growth)
    )
    stages = stages_for(abs(z))
    want = (1 + 2j) * stability.amplification(f"RKC2({stages})", z)
    assert out.y[0, -1] == pytest.approx(want, rel=1e-10, abs=1e-12)
    assert out.nfev == stages + 1  # f at both ends


def test_nodes():
    """c_j = (j^2 - 1) / (s^2 - 1) but for the damping."""
    c, s = _core.rkc_formula(20)["c"], 20
    assert c[0] == 0 and c[1] == pytest.approx(c[2] / 4, rel=0.01)
    np.testing.assert_allclose(c[2:], (np.arange(2, s) ** 2 - 1) / (s**2 - 1), rtol=0.025)
    assert np.all(np.diff(c) > 0) and c[-1] < 1


@pytest.mark.parametrize("radius", [10.0, 1e3, 1e5])
def test_order_two_with_any_number_of_stages(radius):
    """Prothero and Robinson's equation, not stiff, with the stages of a stiff one."""
    counts, errors = (40, 80, 160), []
    for count in counts:
        result = solve_ivp(
            lambda t, y: [-3 * (y[0] - math.cos(t)) - math.sin(t) + 0.3 * y[0] * y[1], -y[1] ** 2],
            (0, 2), [1.0, 1.0], "RKC2", step=2 / count, spectral_radius=radius, t_eval=[2.0],
        )  # fmt: skip
        errors.append(result.y[:, 0])
    exact = solve_ivp(
        lambda t, y: [-3 * (y[0] - math.cos(t)) - math.sin(t) + 0.3 * y[0] * y[1], -y[1] ** 2],
        (0, 2), [1.0, 1.0], "DOP853", rtol=1e-12, atol=1e-13,
    ).y[:, -1]  # fmt: skip
    errors = [np.linalg.norm(y - exact) for y in errors]
    slope = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope == pytest.approx(2, abs=0.15)


def test_order_two_on_the_heat_equation():
    """h lambda of -1600 at the longest step: the order does not fall."""
    matrix, _ = heat(39)
    x = np.arange(1, 40) / 40
    y0 = np.sin(np.pi * x) + 0.2 * np.sin(3 * np.pi * x)
    values, vectors = np.linalg.eigh(matrix)
    exact = vectors @ (np.exp(0.2 * values) * (vectors.T @ y0))
    counts = np.array([8, 16, 32, 64])
    errors = []
    for count in counts:
        y = solve_ivp(lambda t, y: matrix @ y, (0, 0.2), y0, "RKC2", step=0.2 / count).y[:, -1]
        errors.append(abs(y - exact).max())
    assert np.log2(np.divide(errors[:-1], errors[1:])) == pytest.approx([2, 2, 2], abs=0.25)


# The number of stages.


def count_stages(**settings):
    """Evaluations in one step of the heat equation on 99 points, h rho = 40000 h."""
    matrix, _ = heat(99)
    y0 = np.sin(np.pi * np.arange(1, 100) / 100)
    result = solve_ivp(lambda t, y: matrix @ y, (0, 0.01), y0, "RKC2", step=0.01, **settings)
    return result.nfev - 1


def test_stages_from_the_spectral_radius():
    _, spectrum = heat(99)
    radius = -spectrum.min()
    assert count_stages(spectral_radius=radius) == stages_for(0.01 * radius)
    assert count_stages(spectral_radius=4 * radius) == stages_for(0.04 * radius)
    assert count_stages(spectral_radius=lambda t, y: radius) == stages_for(0.01 * radius)
    assert count_stages(spectral_radius=0) == 2
    estimated = count_stages()
    assert estimated > 1.05 * stages_for(0.01 * radius)  # the power method, and a factor 1.2


def test_the_estimate_is_a_bound_but_not_a_loose_one():
    """The number of stages of the first step tells the estimate."""
    cube = np.linspace(1, 2, 20)
    problems = {
        "diffusion": heat(20)[0],
        "not normal": np.diag(-np.linspace(1, 3000, 20)) + 200 * np.eye(20, k=1),
        "oscillators": np.kron(np.eye(10), [[0, 1], [-2500.0, 0]]),
        "nonlinear": np.diag(-3 * cube**2),
        "nothing": np.zeros((20, 20)),
    }
    for kind, matrix in problems.items():
        radius = abs(np.linalg.eigvals(matrix)).max()
        h = 1e4 / radius if radius and kind != "nonlinear" else 1.0
        times = set()

        def fun(t, y, matrix=matrix, kind=kind, times=times):
            times.add(t)
            return -(y**3) if kind == "nonlinear" else matrix @ y

        with np.errstate(over="ignore", invalid="ignore"):
            try:
                solve_ivp(fun, (0, h), cube, "RKC2", step=h)
            except substep.NonFiniteError:
                assert kind == "oscillators"  # a million periods in a step
        stages = len([t for t in times if 0 < t < h]) + 1
        # Where complex eigenvalues lead the norm swings, here by omega = 50.
        loose = 1.45 if kind != "oscillators" else 1.2 * 50
        assert stages_for(0.99 * h * radius) <= stages <= stages_for(loose * h * radius), kind


def test_the_estimate_is_renewed():
    """Stiffness that grows a hundredfold: 25 steps at the most are made with the old estimate."""
    calls = []

    def fun(t, y):
        calls.append(t)
        return -(100.0 + 1e4 * (t > 1)) * (y - math.cos(t))

    result = solve_ivp(fun, (0, 3), [1.0], "RKC2", rtol=1e-3, atol=1e-3)
    assert abs(result.y[0, -1] - math.cos(3)) < 5e-3
    assert len(calls) < 4000
    fixed = solve_ivp(fun, (0, 3), [1.0], "RKC2", step=0.02)
    assert abs(fixed.y[0, -1] - math.cos(3)) < 5e-3


@pytest.mark.parametrize("backward", [False, True])
def test_the_callable_sees_states(backward):
    seen = []

    def radius(t, y):
        seen.append((t, y.copy()))
        return 200.0

    sign = -1.0 if backward else 1.0
    result = solve_ivp(
        lambda t, y: -sign * 100 * (y - 1), (0, sign), [0.0, 3.0], "RKC2", spectral_radius=radius
    )
    assert [t for t, _ in seen] == result.t[:-1].tolist()
    np.testing.assert_array_equal(np.array([y for _, y in seen]).T, result.y[:, :-1])
    complex_states = []

    def radius_of_complex(t, y):
        complex_states.append(y.dtype)
        return 100.0

    solve_ivp(lambda t, y: -100 * y, (0, 1), [1j], "RKC2", spectral_radius=radius_of_complex)
    assert set(complex_states) == {np.dtype(complex)}
    native = solve_ivp(
        Robertson(), (0, 1e-2), Robertson().y0, "RKC2", spectral_radius=lambda t, y: 3000.0
    )
    assert native.success


@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_bad_spectral_radius(value):
    with pytest.raises(InputError, match="spectral_radius"):
        solve_ivp(lambda t, y: -y, (0, 1), [1.0], "RKC2", spectral_radius=value)
    with pytest.raises(InputError, match="spectral_radius"):
        solve_ivp(lambda t, y: -y, (0, 1), [1.0], "RKC2", spectral_radius=lambda t, y: value)


def test_spectral_radius_of_another_kind():
    for value in ("large", [1.0, 2.0], 1j):
        with pytest.raises(TypeError, match="spectral_radius"):
            solve_ivp(lambda t, y: -y, (0, 1), [1.0], "RKC2", spectral_radius=value)
    with pytest.raises(InputError, match="only RKC2 uses it"):
        solve_ivp(lambda t, y: -y, (0, 1), [1.0], "rk4", spectral_radius=1.0)

    def broken(t, y):
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        solve_ivp(Robertson(), (0, 1), [1.0, 0, 0], "RKC2", spectral_radius=broken)


def test_too_stiff():
    system = Robertson()
    with pytest.raises(SolverError, match="too stiff for RKC2; take an implicit method") as info:
        solve_ivp(system, (0, 1e11), system.y0, "RKC2")
    assert info.value.result.status == -1
    with pytest.raises(SolverError, match=r"stages.*take steps below 649\.") as info:
        solve_ivp(lambda t, y: -y, (0, 1e6), [1.0], "RKC2", step=1e6, spectral_radius=1000.0)
    assert info.value.result.t.tolist() == [0.0]


def test_the_cap_shortens_steps():
    """1000 stages reach h rho = 6.5e5; rounding allows fewer at a tight tolerance."""
    for rtol, most in ((1e-3, 1000), (1e-10, 212)):
        result = solve_ivp(
            lambda t, y: -1e6 * (y - 1), (0, 3), [1.0], "RKC2", rtol=rtol, atol=1e-3,
            spectral_radius=1e6,
        )  # fmt: skip
        longest = np.diff(result.t).max() * 1e6
        assert 0.9 * (most**2 - 1) / 1.54 < longest <= (most**2 - 1) / 1.54 * (1 + 1e-9)
        assert abs(result.y[0, -1] - 1) < 1e-9


# Accuracy on stiff problems.


def test_error_falls_with_the_tolerance_on_the_line(reference):
    values = {k: float(v) for k, v in reference["brusselator_1d_N500_T10"]["values"].items()}
    system = Brusselator1D(500)
    errors, tolerances = [], np.array([1e-3, 1e-4, 1e-5, 1e-6])
    for tolerance in tolerances:
        result = solve_ivp(
            system, (0, 10), system.y0, "RKC2", rtol=tolerance, atol=tolerance, t_eval=[10.0]
        )
        u, v = result.y[:, 0].reshape(2, 500)
        found = {"u_125": u[124], "v_125": v[124], "u_250": u[249], "v_250": v[249]}
        errors.append(max(abs(found[key] - values[key]) for key in found))
    assert abs(u.sum() - values["sum_u"]) < 500 * errors[-1]
    assert abs(v.sum() - values["sum_v"]) < 500 * errors[-1]
    assert np.all(np.array(errors) < 4 * tolerances ** (2 / 3))
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert slope == pytest.approx(2 / 3, abs=0.2)


def solve_in_two(n, tolerance, threads=None, method="RKC2", **settings):
    """The 2D Brusselator to 1.5, begun anew when the source is switched on."""
    before, after = Brusselator2D(n, source_time=math.inf), Brusselator2D(n, source_time=-math.inf)
    settings = dict(method=method, rtol=tolerance, atol=tolerance, threads=threads, **settings)
    middle = solve_ivp(before, (0, 1.1), before.y0, t_eval=[1.1], **settings).y[:, 0]
    return solve_ivp(after, (1.1, 1.5), middle, t_eval=[1.5], **settings).y[:, 0]


@pytest.mark.parametrize("n", [64, 128])
def test_error_falls_with_the_tolerance_on_the_square(n, reference):
    values = {k: float(v) for k, v in reference[f"brusselator_2d_N{n}_T1.5"]["values"].items()}
    errors, tolerances = [], np.array([1e-3, 1e-4, 1e-5])
    for tolerance in tolerances:
        u, v = solve_in_two(n, tolerance).reshape(2, n, n)
        found = {
            "u(0,0)": u[0, 0],
            "v(0,0)": v[0, 0],
            "u(N/2,N/2)": u[n // 2, n // 2],
            "v(N/2,N/2)": v[n // 2, n // 2],
            "mean_u": u.mean(),
            "mean_v": v.mean(),
        }
        errors.append(max(abs(found[key] - values[key]) for key in values))
    assert errors[0] < 2.5e-3
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert slope == pytest.approx(2 / 3, abs=0.15)


def test_across_the_jump_of_the_source():
    """Without a new beginning: the step control finds the jump, and the error stays."""
    n = 32
    exact = solve_in_two(n, 1e-8, method="DOP853")
    system = Brusselator2D(n)
    for tolerance in (1e-3, 1e-5):
        through = solve_ivp(
            system, (0, 1.5), system.y0, "RKC2", rtol=tolerance, atol=tolerance, t_eval=[1.5]
        ).y[:, 0]
        assert abs(through - exact).max() < 4 * tolerance ** (2 / 3)


# Bits and threads.


@pytest.mark.parametrize("n", [3, 4, 31, 64, 65, 200])
def test_the_fused_stage_has_the_bits_of_separate_passes(n):
    """A callable that calls the system's f does stage by stage what the kernel does in one pass."""
    system = Brusselator2D(n, source_time=0.01)
    radius = 2e5
    settings = dict(method="RKC2", rtol=1e-4, atol=1e-4, t_eval=[0.02], spectral_radius=radius)
    plain = solve_ivp(lambda t, y: system(t, y), (0, 0.02), system.y0, **settings)
    hashes = {
        substep.state_hash(solve_ivp(system, (0, 0.02), system.y0, threads=k, **settings).y)
        for k in (1, 2, 3, 4)
    }
    assert hashes == {substep.state_hash(plain.y)}


@pytest.mark.parametrize("n", [1, 2, 3, 4096, 4097, 10_001])
def test_the_fused_stage_on_the_line(n):
    system = Brusselator1D(n, alpha=1.0 / (n + 1) ** 2)
    settings = dict(method="RKC2", rtol=1e-5, atol=1e-5, t_eval=[2.0], spectral_radius=60.0)
    plain = solve_ivp(lambda t, y: system(t, y), (0, 2), system.y0, **settings)
    for threads in (1, 2, 3):
        fused = solve_ivp(system, (0, 2), system.y0, threads=threads, **settings)
        np.testing.assert_array_equal(plain.y, fused.y)


def test_fixed_steps_have_the_same_bits_however_they_are_recorded():
    system = Brusselator1D(60)
    every = solve_ivp(system, (0, 2), system.y0, "RKC2", step=0.02)
    last = solve_ivp(system, (0, 2), system.y0, "RKC2", step=0.02, t_eval=[1.0, 2.0])
    np.testing.assert_array_equal(every.y[:, [50, 100]], last.y)
    assert every.nfev == last.nfev


def test_interrupt_in_a_long_step():
    """One step of 700 stages on a million cells takes seconds; Ctrl-C is heard within 0.2 s."""
    import signal

    system = Brusselator2D(1000)
    sent = []

    def send():
        time.sleep(0.3)
        sent.append(time.perf_counter())
        signal.raise_signal(signal.SIGINT)

    thread = threading.Thread(target=send)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        solve_ivp(system, (0, 100), system.y0, "RKC2", step=0.4, t_eval=[100.0])
    delay = time.perf_counter() - sent[0]
    thread.join()
    assert delay < 0.2
