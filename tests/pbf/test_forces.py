"""Viscosity, XSPH, vorticity confinement and surface tension of position-based fluids."""

from __future__ import annotations

import numpy as np
import pytest
import substep
from substep import InputError, PositionBasedFluid

D = 0.001


def ball(radius: float, d: float = D) -> np.ndarray:
    x = substep.fill_box([-radius] * 3, [radius] * 3, d)
    return x[np.linalg.norm(x, axis=1) < radius]


def axes(x: np.ndarray) -> np.ndarray:
    """Half axes of the ellipsoid of the same second moments, ascending."""
    y = x - x.mean(axis=0)
    return np.sqrt(5 * np.linalg.eigvalsh(y.T @ y / len(y)))


def momenta(fluid: PositionBasedFluid) -> tuple[np.ndarray, np.ndarray]:
    values = fluid.diagnostics()
    return tuple(np.array([values[f"{name}_{a}"] for a in "xyz"]) for name in NAMES)  # type: ignore


NAMES = ("momentum", "angular_momentum")


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("xsph", -0.1),
        ("xsph", 1.5),
        ("xsph", np.nan),
        ("viscosity", -1.0),
        ("viscosity", np.inf),
        ("viscosity", [0.1, 0.2]),
        ("vorticity_confinement", -1.0),
        ("vorticity_confinement", np.inf),
        ("surface_tension", -0.01),
        ("surface_tension", np.nan),
    ],
)
def test_bad_coefficients_are_refused(argument, value):
    with pytest.raises(InputError, match=argument):
        PositionBasedFluid(np.zeros((1, 3)), D, **{argument: value})


@pytest.mark.parametrize(
    "terms",
    [
        {"xsph": 0.3},
        {"viscosity": 1e-3},
        {"viscosity": [1e-2, 0.0]},
        {"vorticity_confinement": 1.0},
        {"surface_tension": 0.07},
    ],
    ids=lambda terms: next(iter(terms)),
)
def test_each_term_conserves_momentum(terms):
    """Two fluids of unlike mass in free flight; to the rounding of float64."""
    x = ball(6 * D)
    rng = np.random.default_rng(3)
    v = rng.normal(0, 0.02, x.shape) + np.array([0.3, -0.1, 0.2])
    fluid = PositionBasedFluid(
        x,
        D,
        velocities=v,
        density=[1000.0, 300.0],
        kinds=(x[:, 0] > 0).astype(int),
        gravity=(0, 0, 0),
        dtype="float64",
        **terms,
    )
    before = momenta(fluid)[0]
    for _ in range(10):
        fluid.step(2e-4)
    np.testing.assert_allclose(momenta(fluid)[0], before, rtol=0, atol=1e-10 * abs(before).max())


@pytest.mark.figure
def test_a_cube_under_surface_tension_becomes_a_sphere():
    side = 0.012
    cube = substep.fill_box([0] * 3, [side] * 3, D)
    drop = PositionBasedFluid(
        cube, D, gravity=(0, 0, 0), surface_tension=0.0728, viscosity=1e-4, max_tolerance=0.05
    )
    drop.advance(0.25)
    length = axes(drop.positions)
    assert length[2] / length[0] < 1.03
    assert np.linalg.norm(momenta(drop)[0]) < 1e-6 * drop.masses.sum()
    radius = (3 * side**3 / (4 * np.pi)) ** (1 / 3)
    assert length.mean() == pytest.approx(radius, rel=0.03)


@pytest.mark.figure
def test_a_rotating_drop_keeps_its_angular_momentum():
    """For 1 s, within 0.1 %; a step loses about (omega dt)^2 / 2 of it, 2.5e-4 in all."""
    d, omega = 0.05 / 6, 0.7
    x = ball(0.05, d)
    drop = PositionBasedFluid(
        x,
        d,
        velocities=np.cross([0, 0, omega], x),
        gravity=(0, 0, 0),
        surface_tension=0.05,
        viscosity=1e-4,
        tolerance=5e-5,
        max_tolerance=2.5e-3,
        max_iterations=30,
    )
    before = momenta(drop)[1]
    for _ in range(1000):
        drop.step(1e-3)
        error = np.linalg.norm(momenta(drop)[1] - before)
        assert error < 1e-3 * np.linalg.norm(before)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_force_in_a_bar_is_that_of_the_tension(dimension):
    """2 sigma in a strip, pi a sigma in a round bar: half a bar gains momentum at that rate."""
    a, sigma = 5 * D, 0.0728
    corner = np.array([a] * (dimension - 1) + [6 * a])
    x = substep.fill_box(-corner, corner, D)
    force = 2 * sigma
    if dimension == 3:
        x = x[np.hypot(x[:, 0], x[:, 1]) < a]
        force = np.pi * np.sqrt(len(x) * D**3 / (np.pi * 12 * a)) * sigma
    bar = PositionBasedFluid(
        x,
        D,
        gravity=np.zeros(dimension),
        surface_tension=sigma,
        viscosity=1e-5,
        tolerance=1e-4,
        max_iterations=30,
    )
    unit = np.sqrt(1000 * a**3 / sigma)  # [s]
    half, time, momentum = x[:, -1] > 0, [], []
    while bar.time < 0.4 * unit:
        bar.step(5e-4)
        time.append(bar.time)
        momentum.append(-1000 * D**dimension * bar.velocities[half, -1].sum())
    late = np.array(time) > 0.05 * unit
    rate = np.polyfit(np.array(time)[late], np.array(momentum)[late], 1)[0]
    assert rate == pytest.approx(force, rel=0.15)


def shear_wave(nu: float, speed: float, **options: float) -> float:
    """Viscosity [m^2/s] that u_x = speed cos(pi z) decays with, in the middle of 3 m x 1 m.

    No traction acts on z = 0 and 1 m, so the mode is exact there: u ~ exp(-nu pi^2 t).
    """
    d = 1 / 32
    x = substep.fill_box((0, 0), (3, 1), d)
    v = np.zeros_like(x)
    v[:, 0] = speed * np.cos(np.pi * x[:, 1])
    fluid = PositionBasedFluid(x, d, velocities=v, gravity=(0, 0), viscosity=nu, **options)
    time, amplitude = [0.0], [1.0]
    for _ in range(48):
        fluid.step(0.2 * d / speed)
        y, u = fluid.positions, fluid.velocities
        middle = np.abs(y[:, 0] - 1.5) < 0.2
        wave = np.cos(np.pi * (y[middle, 1] - y[:, 1].mean() + 0.5))
        time.append(fluid.time)
        amplitude.append((wave @ u[middle, 0]) / (wave @ wave) / speed)
    return float(-np.polyfit(time, np.log(amplitude), 1)[0] / np.pi**2)


def test_a_shear_wave_decays_with_the_viscosity():
    """The wave moves by ten spacings; what the method has of its own is measured at nu = 0."""
    own = shear_wave(0.0, 1.0)
    assert abs(own) < 1e-4
    for nu in (0.005, 0.1):
        assert shear_wave(nu, 1.0) - own == pytest.approx(nu, rel=0.05)


def test_viscosity_without_bounds_is_stable_and_leaves_rigid_motion():
    x = ball(6 * D)
    v = np.cross([0, 0, 3.0], x) + np.random.default_rng(1).normal(0, 0.01, x.shape)
    drop = PositionBasedFluid(x, D, velocities=v, gravity=(0, 0, 0), viscosity=100.0)
    drop.step(1e-3)
    assert drop.report.viscosity_converged
    u, y = drop.velocities, drop.positions
    r = y - y.mean(axis=0)
    inertia = (r**2).sum() * np.eye(3) - r.T @ r
    spin = np.linalg.solve(inertia, np.cross(r, u).sum(axis=0))
    rest = u - u.mean(axis=0) - np.cross(spin, r)
    assert np.sqrt((rest**2).mean()) < 1e-4
    assert spin[2] == pytest.approx(3.0, rel=0.02)


@pytest.mark.figure
def test_own_viscosity_of_an_eddy_in_a_box_is_below_a_spacing_times_its_speed():
    """Taylor-Green eddy between walls that do not rub; docs/pbf_forces.md quotes the figure."""
    n, k = 64, np.pi
    d = 1 / n
    x = substep.fill_box((0, 0), (1, 1), d)

    def eddy(x):
        a, b = k * x.T
        return np.stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)], axis=1)

    tank = substep.Collider(substep.Box((1, 1, 10), (0.5, 0.5, 0)), hollow=True)
    fluid = PositionBasedFluid(x, d, velocities=eddy(x), gravity=(0, 0), colliders=[tank])
    time, amplitude = [], []
    while fluid.time < 1:
        fluid.step(0.2 * d)
        mode = eddy(fluid.positions)
        time.append(fluid.time)
        amplitude.append((mode * fluid.velocities).sum() / (mode * mode).sum())
    own = -np.polyfit(time, np.log(amplitude), 1)[0] / (2 * k * k)
    assert 0 < own < 0.9 * d


def test_xsph_damps_noise_more_than_the_mean_motion():
    x = ball(6 * D)
    noise = np.random.default_rng(0).normal(0, 0.01, x.shape)
    v = noise - noise.mean(axis=0) + [1.0, 0, 0]
    drop = PositionBasedFluid(x, D, velocities=v, gravity=(0, 0, 0), xsph=0.5)
    drop.step(1e-4)
    assert drop.velocities.mean(axis=0) == pytest.approx([1, 0, 0], abs=1e-6)
    assert drop.velocities.std(axis=0).max() < 0.8 * v.std(axis=0).min()


def test_vorticity_confinement_raises_enstrophy():
    """Of an eddy of ten spacings at rest outside; momentum stays, without it enstrophy falls."""
    d = 0.01
    x = substep.fill_box((0, 0), (0.6, 0.6), d)
    r = x - 0.3
    speed = np.exp(-((r**2).sum(axis=1)) / (2 * 0.05**2))
    v = 20 * speed[:, None] * np.stack([-r[:, 1], r[:, 0]], axis=1)

    def enstrophy(fluid):
        y, u = fluid.positions, fluid.velocities
        offsets, indices = substep.geometry.neighbour_lists(y, 2 * d)
        total = np.zeros(len(y))
        for i in range(len(y)):
            j = indices[offsets[i] : offsets[i + 1]]
            if np.linalg.norm(y[i] - 0.3) > 0.2 or len(j) < 5:
                continue
            gradient = np.linalg.lstsq(y[j] - y[i], u[j] - u[i], rcond=None)[0]
            total[i] = gradient[0, 1] - gradient[1, 0]
        return (total**2).sum()

    values = []
    for strength in (0.0, 1.0):
        fluid = PositionBasedFluid(
            x, d, velocities=v, gravity=(0, 0), vorticity_confinement=strength
        )
        before = momenta(fluid)[0]
        for _ in range(30):
            fluid.step(2e-3)
        values.append(enstrophy(fluid))
        scale = fluid.masses @ np.linalg.norm(fluid.velocities, axis=1)
        assert np.linalg.norm(momenta(fluid)[0] - before) < 1e-5 * scale
    assert values[1] > 1.02 * values[0]


def test_same_bits_for_any_number_of_threads_and_through_a_checkpoint(tmp_path):
    x = ball(8 * D)
    v = np.cross([0, 0, 5.0], x)

    def drop(threads):
        return PositionBasedFluid(
            x,
            D,
            velocities=v,
            density=[1000.0, 800.0],
            kinds=(x[:, 2] > 0).astype(int),
            xsph=0.05,
            viscosity=[1e-4, 1e-3],
            vorticity_confinement=0.1,
            surface_tension=0.03,
            threads=threads,
        )

    hashes = set()
    for threads in (1, 2, 3, 4):
        fluid = drop(threads)
        for k in range(12):
            if k == 6 and threads == 4:
                fluid.save(tmp_path / "drop")
                fluid = drop(threads)
                fluid.load(tmp_path / "drop")
            fluid.step(3e-4)
        hashes.add(substep.state_hash(fluid.positions, fluid.velocities))
    assert len(hashes) == 1
