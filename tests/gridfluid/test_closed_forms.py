"""Grid fluids against closed forms of flows that their other tests do not have."""

import math

import numpy as np
import pytest
import substep
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, curve_fit
from scipy.special import erfc, iv
from substep.gridfluid import Wall
from substep.validate.grid_flow import growth

from .test_surface_tension import liquid_of, radius_of
from .test_two_fluids import SLIP, layers

# Liquids have density 1 and surface tension 1.


def test_a_thread_breaks_up_at_the_rate_of_rayleigh():
    """Per radius of 1: s^2 = k (1 - k^2) I1(k) / I0(k), here in the fastest wave of 9 radii."""
    cells, half, a = 4, 4.5, 0.03
    k = math.pi / half

    def inside(x):
        return np.hypot(x[:, 0], x[:, 1]) < 1 + a * np.cos(k * x[:, 2])

    sides = ("wall", "wall", "periodic")
    liquid = liquid_of(inside, (2.0, 2.0, half), 1 / cells, sides=sides, threads=1)
    radius = math.sqrt(len(liquid) / (2 * cells) ** 3 / (2 * half * math.pi))
    kr = k * radius
    rate = math.sqrt(kr * (1 - kr**2) * iv(1, kr) / iv(0, kr) / radius**3)
    times, waves = [], []
    for _ in range(20):
        liquid.advance(2 / rate / 20)
        times.append(liquid.time)
        waves.append(np.cos(k * liquid.positions[:, 2]).mean())
    (_, found), _ = curve_fit(lambda t, c, s: c * np.cosh(s * t), times, waves, [waves[0], rate])
    assert found == pytest.approx(rate, rel=0.06)


@pytest.mark.parametrize("mode", [2, 3])
def test_viscosity_damps_a_drop_in_the_plane(mode):
    """By 2 n (n - 1) nu / R^2, small waves (Lamb, art. 355, for a sphere)."""
    nu, cells = 0.03, 16

    def inside(x):
        return np.hypot(*x.T) < 1 + 0.05 * np.cos(mode * np.arctan2(x[:, 1], x[:, 0]))

    liquid = liquid_of(inside, (1.3, 1.3), 1 / cells, viscosity=nu, threads=1)
    radius = radius_of(liquid)
    omega = math.sqrt(mode * (mode**2 - 1) / radius**3)
    damping = 2 * mode * (mode - 1) * nu / radius**2

    def wave(t, c, b, w, f, mean):
        return mean + c * np.exp(-b * t) * np.cos(w * t + f)

    times, values = [], []
    for _ in range(50):
        liquid.advance(3 * math.pi / omega / 50)
        z = liquid.positions @ [1, 1j]
        times.append(liquid.time)
        values.append(((z - z.mean()) ** mode).real.mean())
    start = (values[0], damping, omega, 0.0, 0.0)
    (_, b, w, *_), _ = curve_fit(wave, np.array(times), values, start)
    assert b == pytest.approx(damping, rel=0.15)
    assert w == pytest.approx(math.sqrt(omega**2 - damping**2), rel=0.05)


def sessile(area):
    """Half the width and the height of a puddle in the plane that meets its floor at 90 degrees.

    d phi / ds = kappa + z below its apex (Young and Laplace); the capillary length is 1.
    """

    def grow(_, y):
        x, z, phi, _ = y
        return [math.cos(phi), math.sin(phi), apex + z, 2 * x * math.sin(phi)]

    def upright(_, y):
        return y[2] - math.pi / 2

    def profile(curvature):
        nonlocal apex
        apex = curvature
        got = solve_ivp(grow, [0, 80], np.zeros(4), events=upright, rtol=1e-8, atol=1e-10)
        return got.y_events[0][0]

    apex = 0.0
    upright.terminal = True
    end = profile(brentq(lambda c: profile(c)[3] - area, 1e-6, 50))
    return end[0], end[1]


@pytest.mark.parametrize("slip", [False, True])
def test_a_puddle_has_the_shape_of_young_and_laplace(slip):
    cells, floor = 8, -1.5
    width, height = sessile(3.0)

    def inside(x):
        return (np.abs(x[:, 0]) < 1.5 / height) & (x[:, 1] < floor + height)

    liquid = liquid_of(
        inside, (3, 1.5), 1 / cells, gravity=(0, -1), viscosity=0.1, slip=slip, threads=1
    )
    liquid.advance(12.0)
    width, height = sessile(len(liquid) / (2 * cells) ** 2)
    depth, widest = [], []
    for _ in range(4):  # the mean over what is left of its swinging
        liquid.advance(1.0)
        depth.append(liquid.depth([[0.0]])[0])
        low = liquid.positions[liquid.positions[:, 1] < floor + liquid.cell, 0]
        widest.append((low.max() - low.min()) / 2)
    assert np.mean(depth) == pytest.approx(height, rel=0.03)
    assert np.mean(widest) == pytest.approx(width, rel=0.05)


@pytest.mark.parametrize("heavy", [1.2, 2.0, 10.0])
def test_the_light_fluid_of_a_lock_runs_out_as_benjamin_says(heavy):
    """At 1/2 sqrt((1 - 1 / ratio) g H), without viscosity (Benjamin, J. Fluid Mech. 31, 1968)."""
    n, length = 32, 6.0
    speed = math.sqrt(1 - 1 / heavy)

    def smoke(x):
        return (x[:, 0] < length / 2) * 1.0

    flow = substep.GridFlow(
        [(0, 0), (length, 1)],
        1 / n,
        smoke=smoke,
        smoke_density=heavy,
        gravity=(0, -1),
        sides=SLIP,
        threads=1,
    )
    energy = flow.diagnostics()["energy"]
    x = flow.positions_of()[:, 0, 0]
    times, fronts = [], []
    flow.advance(1.2 / speed)
    for _ in range(8):
        flow.advance(0.3 / speed)
        times.append(flow.time)
        fronts.append(x[flow.smoke[:, -2:].mean(axis=1) < 0.5].min())
    found = -np.polyfit(times, fronts, 1)[0]
    assert found / speed == pytest.approx(0.5, abs=0.04)
    assert 0.95 * energy < flow.diagnostics()["energy"] < energy


@pytest.mark.parametrize("ratio", [1.1, 1000.0, 1e-3])
def test_a_body_between_two_fluids_is_lifted_by_what_it_displaces(ratio):
    ball = substep.Collider(substep.Sphere(0.2, (0.5, 0.5, 0.0)))
    flow = layers(32, ratio, 1.0, lambda x: 0.5 + 0 * x, colliders=[ball])
    flow.advance(0.1)
    force = ball.impulse / ball.duration / ((ratio - 1) * math.pi * 0.2**2 / 2)
    assert force[1] == pytest.approx(1.0, rel=0.01)
    assert abs(force[0]) < 1e-3


def test_a_falling_blob_stays_symmetric():
    def smoke(x):
        return np.clip(0.5 - (np.hypot(x[:, 0] - 0.5, x[:, 1] - 0.7) - 0.15) * 32, 0, 1)

    flow = substep.GridFlow(
        [(0, 0), (1, 1)],
        1 / 32,
        smoke=smoke,
        smoke_density=3.0,
        viscosity=1e-3,
        gravity=(0, -1),
        sides=SLIP,
        threads=1,
    )
    flow.advance(1.5)
    assert np.abs(flow.smoke - flow.smoke[::-1]).max() < 1e-3
    assert abs(flow.diagnostics()["momentum_x"]) < 1e-5


def test_a_plate_that_sets_off_drags_along_what_erfc_says():
    """u = erfc(y / 2 sqrt(nu t)) (Stokes 1851)."""
    errors = []
    for n in (16, 32):
        flow = substep.GridFlow(
            [(0, 0), (0.25, 1)],
            1 / n,
            viscosity=0.01,
            sides=["periodic", (Wall(velocity=(1.0, 0.0)), "wall")],
            threads=1,
        )
        flow.advance(2.0)
        should = erfc(flow.positions_of()[0, :, 1] / 2 / math.sqrt(0.02))
        errors.append(np.abs(flow.velocity[0, :, 0] - should).max())
    assert errors[1] < 0.003 and errors[1] < errors[0] / 3


def test_rolls_set_in_at_the_critical_rayleigh_number():
    """1707.8 between plates that hold the flow (Chandrasekhar 1961)."""
    below, above = growth(16, 1600), growth(16, 1800)
    assert below < 0 < above
    assert 1600 - 200 * below / (above - below) == pytest.approx(1707.8, rel=0.025)
