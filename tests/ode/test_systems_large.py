"""Oscillators, spring chains and gravity: formulas, and fused steps against single ones."""

import numpy as np
import pytest
import substep
from substep import _core, solve_second_order
from substep.systems import NBody, Oscillators, SpringChain

SECOND_ORDER = [entry["name"] for entry in _core.second_order_methods()]
FUSED_TABLEAUX = list(_core.advection_methods)  # those without an estimate of the error
# Around the tiles of 512 cells and the chunks of 64 tiles.
SIZES = [1, 2, 3, 47, 511, 512, 513, 1024, 32767, 32768, 32769, 33000, 70001]


def random_state(n, seed=0):
    return np.random.default_rng(seed).standard_normal((2, n))


def make(kind, n):
    rng = np.random.default_rng(n)
    if kind == "oscillators":
        return Oscillators(rng.uniform(0.5, 1.5, n))
    if kind == "uniform chain":
        return SpringChain(n, 0.7, 1.3)
    if kind == "free chain":
        return SpringChain(n, fixed_ends=False)
    k, m = rng.uniform(0.5, 1.0, n + 1), rng.uniform(1.0, 2.0, n)
    return SpringChain(n, k, m, fixed_ends=kind == "varied chain")


KINDS = ["oscillators", "uniform chain", "free chain", "varied chain", "varied free chain"]


def direct_acceleration(system, x):
    """The formula of the docstring, by NumPy."""
    if isinstance(system, Oscillators):
        return -(system.omega**2) * x
    wall = np.zeros(1)
    ends = (wall, wall) if system.fixed_ends else (x[:1], x[-1:])
    stretch = np.diff(np.concatenate([ends[0], x, ends[1]]))
    return np.diff(np.broadcast_to(system.k, x.size + 1) * stretch) / system.m


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("kind", KINDS)
def test_right_hand_side(kind, n):
    system = make(kind, n)
    x, v = random_state(n)
    dydt = system(0.0, np.concatenate([x, v]))
    assert np.array_equal(dydt[:n], v)
    assert dydt[n:] == pytest.approx(direct_acceleration(system, x), abs=1e-13)


@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("kind", KINDS)
def test_fused_steps_give_the_bits_of_single_steps(kind, n):
    """Also for any number of threads; 131 steps fill several sweeps and leave a rest."""
    system = make(kind, n)
    x, v = random_state(n)
    for method in SECOND_ORDER:
        problem = dict(t_span=(0, 13.1), x0=x, v0=v, method=method, step=0.1, t_eval=[13.1])
        fused = [solve_second_order(system, **problem, threads=k) for k in (1, 2, 3, 4)]
        single = solve_second_order(system, **problem, callback=lambda t, x, v: None)
        expected = substep.state_hash(single.x, single.v)
        assert {substep.state_hash(r.x, r.v) for r in fused} == {expected}, method
        assert fused[0].nfev == single.nfev and fused[0].nsteps == single.nsteps == 131


@pytest.mark.parametrize("n", [1, 513, 33000])
@pytest.mark.parametrize("kind", KINDS)
def test_fused_tableaux_give_the_bits_of_single_steps(kind, n):
    system = make(kind, n)
    y = random_state(n).ravel()
    for method in FUSED_TABLEAUX:
        problem = dict(t_span=(0, 3.7), y0=y, method=method, step=0.1, t_eval=[3.7])
        fused = [substep.solve_ivp(system, **problem, threads=k).y for k in (1, 2, 3, 4)]
        single = substep.solve_ivp(lambda t, y, f=system: f(t, y), **problem).y
        assert {substep.state_hash(f) for f in fused} == {substep.state_hash(single)}, method


@pytest.mark.parametrize("method", SECOND_ORDER)
def test_outputs_inside_a_fused_run(method):
    """Runs between the outputs, and a last step that is cut."""
    chain = SpringChain(2000, 2.0, 1.0)
    x, v = random_state(2000)
    times = [0.0, 0.1, 0.25, 1.0, 1.01, 1.02, 2.0, 2.07]
    problem = dict(t_span=(0, 2.07), x0=x, v0=v, method=method, step=0.1, t_eval=times)
    fused = solve_second_order(chain, **problem)
    single = solve_second_order(chain, **problem, callback=lambda t, x, v: None)
    assert np.array_equal(fused.t, times)
    assert substep.state_hash(fused.x, fused.v) == substep.state_hash(single.x, single.v)


@pytest.mark.parametrize("method", ["velocity_verlet", "rk4"])
def test_standing_wave_on_a_long_chain(method):
    """Mode m of n masses with fixed ends turns with omega = 2 sin(pi m / 2 (n + 1))."""
    n, mode, step, t = 100_000, 100, 0.2, 200.0
    shape = np.sin(np.pi * mode * np.arange(1, n + 1) / (n + 1))
    omega = 2 * np.sin(np.pi * mode / (2 * (n + 1)))
    if method == "rk4":
        y0 = np.concatenate([shape, 0 * shape])
        x = substep.solve_ivp(SpringChain(n), (0, t), y0, "rk4", step=step, t_eval=[t]).y[:n, 0]
        factor = np.cos(omega * t)
    else:
        result = solve_second_order(SpringChain(n), (0, t), shape, 0 * shape, step=step, t_eval=[t])
        x = result.x[:, 0]
        factor = np.cos(t / step * 2 * np.arcsin(omega * step / 2))  # the discrete frequency
    assert abs(x - factor * shape).max() < 1e-12


@pytest.mark.parametrize("kind", KINDS)
def test_energy_is_kept_by_yoshida(kind):
    system = make(kind, 500)
    x, v = random_state(500)
    result = solve_second_order(system, (0, 10), x, v, "yoshida4", step=0.01)
    energy = system.energy(np.concatenate([result.x, result.v]))
    assert abs(energy / energy[0] - 1).max() < 1e-7


def test_an_unstable_fused_run_ends_at_the_last_finite_step():
    system = Oscillators(np.linspace(1, 300, 1000))
    with pytest.raises(substep.NonFiniteError) as caught:
        solve_second_order(system, (0, 1e4), np.ones(1000), np.zeros(1000), step=1.0, t_eval=[1e4])
    error = caught.value
    assert error.index >= 900 and np.isfinite(error.result.x).all()
    assert error.result.t[-1] == error.step and abs(error.result.x).max() > 1e290


# Gravity ------------------------------------------------------------------------------------------


def direct_gravity(system, x):
    difference = x[None, :, :] - x[:, None, :]
    r2 = (difference**2).sum(axis=2) + system.softening**2
    np.fill_diagonal(r2, 1.0)
    weights = system.G * system.masses[None, :] / r2**1.5
    return (weights[:, :, None] * difference).sum(axis=1)


@pytest.mark.parametrize("softening", [0.0, 0.3])
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("n", [1, 2, 7, 8, 9, 100, 1500])
def test_gravity_is_the_sum_over_pairs(n, dimension, softening):
    rng = np.random.default_rng(n)
    system = NBody(rng.uniform(0.5, 2, n), 1.7, softening, dimension)
    x, v = rng.standard_normal((2, n, dimension))
    dydt = system(0.0, np.concatenate([x.ravel(), v.ravel()]))
    expected = direct_gravity(system, x).ravel()
    assert np.array_equal(dydt[: x.size], v.ravel())
    assert dydt[x.size :] == pytest.approx(expected, rel=1e-11, abs=1e-11 * abs(expected).max())


def test_gravity_agrees_with_the_pleiades():
    pleiades = substep.systems.Pleiades()
    y = pleiades.y0
    swap = np.arange(14).reshape(2, 7).T.ravel()  # x and y of each body side by side
    found = NBody(pleiades.masses, dimension=2)(0.0, np.concatenate([y[:14][swap], y[14:][swap]]))
    assert found[14:] == pytest.approx(pleiades(0.0, y)[14:][swap], rel=1e-13)


def test_momentum_and_angular_momentum_of_gravity():
    rng = np.random.default_rng(1)
    m = rng.uniform(0.5, 2, 50)
    x0, v0 = rng.standard_normal((2, 50, 3))
    system = NBody(m, softening=0.2)
    result = solve_second_order(system, (0, 2), x0, v0, step=0.001)
    x, v = np.moveaxis(result.x, -1, 0), np.moveaxis(result.v, -1, 0)
    momentum = (m[:, None] * v).sum(axis=1)
    angular = (m[:, None] * np.cross(x, v)).sum(axis=1)
    assert abs(momentum - momentum[0]).max() < 1e-12
    assert abs(angular - angular[0]).max() < 1e-11
    energy = [system.energy(np.concatenate([x[k].ravel(), v[k].ravel()])) for k in (0, -1)]
    assert energy[1] == pytest.approx(energy[0], rel=1e-5)


def test_gravity_has_the_same_bits_for_any_number_of_threads():
    rng = np.random.default_rng(2)
    x0, v0 = rng.standard_normal((2, 1000, 3))
    system = NBody(np.ones(1000), softening=0.1)
    before, hashes = substep.num_threads(), set()
    try:
        for threads in (1, 2, 3, 4):
            substep.set_num_threads(threads)
            result = solve_second_order(system, (0, 0.05), x0, v0, step=0.01, t_eval=[0.05])
            hashes.add(substep.state_hash(result.x, result.v))
    finally:
        substep.set_num_threads(before)
    assert len(hashes) == 1


def test_bodies_that_meet_without_softening():
    x0 = np.zeros((2, 2))
    with pytest.raises(substep.NonFiniteError, match="acceleration"):
        solve_second_order(NBody([1.0, 1.0], dimension=2), (0, 1), x0, x0, step=0.1)
    softened = NBody([1.0, 1.0], softening=0.1, dimension=2)
    result = solve_second_order(softened, (0, 1), x0, x0, step=0.1)
    assert np.array_equal(result.x[..., -1], x0)


@pytest.mark.parametrize(
    "create, message",
    [
        (lambda: Oscillators([1.0, np.nan]), r"omega\[1\]"),
        (lambda: Oscillators([[1.0]]), "omega"),
        (lambda: SpringChain(0), "n:"),
        (lambda: SpringChain(2.5), "n:"),
        (lambda: SpringChain(3, k=[1.0, 1.0]), r"k: expected a number or shape \(4,\)"),
        (lambda: SpringChain(3, k=-1.0), "k:"),
        (lambda: SpringChain(3, m=0.0), "m:"),
        (lambda: SpringChain(3, m=[1.0, -1.0, 1.0]), "m:"),
        (lambda: SpringChain(3, m=np.inf), "m:"),
        (lambda: NBody([1.0, -1.0]), "masses"),
        (lambda: NBody([1.0], dimension=4), "dimension"),
        (lambda: NBody([1.0], softening=-0.1), "softening"),
        (lambda: NBody([1.0], G=np.nan), "G:"),
    ],
)
def test_bad_parameters(create, message):
    with pytest.raises(substep.InputError, match=message):
        create()


def test_empty_systems():
    assert Oscillators([]).size == 0 and NBody([]).size == 0
    result = solve_second_order(Oscillators([]), (0, 1), [], [], step=0.5, t_eval=[1.0])
    assert result.x.shape == (0, 1)
