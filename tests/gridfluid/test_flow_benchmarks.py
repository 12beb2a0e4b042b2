"""Flows that others have computed or measured: cavities, convection, a cylinder, a step.

Reference values are those of the papers named; where a test says so, errors are relative to them.
"""

import math

import numpy as np
import pytest
import substep
from substep.gridfluid import Inflow
from substep.validate.grid_flow import channel, driven, extreme, nusselt


def cavity(reynolds, n, duration, start=None):
    """A lid drives a square: u_min on the vertical, v_max and v_min on the horizontal."""
    flow = driven(reynolds, n, duration, start)
    u, v = flow.velocity_faces[0][n // 2], flow.velocity_faces[1][:, n // 2]
    return flow, np.array([extreme(u, -1), extreme(v, 1), extreme(v, -1)])


def check_cavity(reynolds, reference, grids):
    flow, errors = None, []
    for n, duration in grids:
        flow, found = cavity(reynolds, n, duration, flow)
        errors.append(np.abs(found / reference - 1))
    assert (errors[-1] < 0.01).all(), errors
    assert (errors[1] < 0.6 * errors[0]).all() and (errors[2] < 0.6 * errors[1]).all(), errors


def test_cavity_re_100():
    """Marchi, Suero and Araki (2009), 1024^2 and extrapolated."""
    check_cavity(100, [-0.2140417, 0.1795728, -0.253803], [(16, 12), (32, 8), (64, 6)])


@pytest.mark.slow
def test_cavity_re_1000():
    """Botella and Peyret (1998), Chebyshev collocation."""
    reference = [-0.3885698, 0.3769447, -0.5270771]
    check_cavity(1000, reference, [(64, 50), (128, 35), (256, 10)])


# Later spectral values beside de Vahl Davis (1983).
@pytest.mark.parametrize(
    ("rayleigh", "reference", "n", "duration"),
    [
        (1e3, 1.1178, 24, 0.5),
        (1e4, 2.2448, 40, 0.4),
        pytest.param(1e5, 4.5216, 64, 0.25, marks=pytest.mark.slow),
        pytest.param(1e6, 8.8252, 96, 0.08, marks=pytest.mark.slow),
    ],
)
def test_natural_convection(rayleigh, reference, n, duration):
    assert nusselt(rayleigh, n, duration) == pytest.approx(reference, rel=0.02)


def coefficients(cylinder, mean):
    return 2 * cylinder.impulse[:2] / cylinder.duration / (mean**2 * 0.1)


@pytest.mark.slow
@pytest.mark.figure
def test_cylinder_2d_1():
    """Re 20: drag, lift and pressure drop (FeatFlow, finest; docs/grid_flow.md)."""
    reference = np.array([5.57953523, 0.01061895, 0.11752017])
    errors = []
    for n in (41, 123):
        flow, cylinder = channel(n, 0.3)
        flow.advance(6.0)
        flow.advance(0.1)
        drop = np.subtract(*flow.sample([(0.15, 0.2), (0.25, 0.2)])["pressure"])
        found = np.append(coefficients(cylinder, 0.2), drop)
        errors.append(np.abs(found / reference - 1))
    assert (errors[0] < [0.01, 0.12, 0.06]).all() and (errors[1] < [0.01, 0.02, 0.02]).all(), errors


def test_a_cylinder_in_the_middle_has_no_lift():
    """Nor has one where faces lie on its surface, which rounding must not tell from one side."""
    flow, cylinder = channel(41, 0.3, middle=0.205)
    flow.advance(1.0)
    drag, lift = coefficients(cylinder, 0.2)
    assert abs(lift) < 1e-5 * drag


@pytest.mark.slow
def test_cylinder_2d_2_sheds_vortices():
    """Re 100: the Strouhal number of 0.30188 (FeatFlow, finest)."""
    flow, cylinder = channel(62, 1.5)
    flow.advance(3.0)
    lifts, times = [], []

    def look(given):
        lifts.append(coefficients(cylinder, 1.0)[1])
        times.append(given.time)

    for _ in range(400):
        flow.step(0.0025)
        look(flow)
    lift, time = np.array(lifts), np.array(times)
    up = np.flatnonzero((lift[:-1] < 0) & (lift[1:] >= 0))
    zero = time[up] - lift[up] * (time[up + 1] - time[up]) / (lift[up + 1] - lift[up])
    period = (zero[-1] - zero[0]) / (len(zero) - 1)
    assert 0.1 / period == pytest.approx(0.30188, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reynolds", "reference", "n", "duration"), [(100, 2.922, 20, 50), (200, 4.982, 10, 60)]
)
def test_backward_facing_step(reynolds, reference, n, duration):
    """Where the flow comes back behind a step of half the channel (Erturk 2008), in heights."""

    def start(x):
        u = np.where(x[:, 1] > 1, 6 * (x[:, 1] - 1) * (2 - x[:, 1]), 0.0)
        return np.stack([u, 0 * u], axis=1)

    y = (np.arange(2 * n) + 0.5) / n
    flow = substep.GridFlow(
        [(-3, 0), (12, 2)],
        1 / n,
        viscosity=2 / reynolds,
        velocity=start,
        colliders=[substep.Box((6, 2, 2), (-3, 0, 0))],
        sides=[(Inflow(start(np.stack([0 * y, y], axis=1))), "open"), "wall"],
        threads=1,
    )
    flow.advance(duration)
    wall = flow.velocity_faces[0][3 * n + 1 :, 0]
    k = int(np.flatnonzero((wall[:-1] < 0) & (wall[1:] >= 0))[-1])
    length = (k + 1 + wall[k] / (wall[k] - wall[k + 1])) / n
    assert length == pytest.approx(reference, rel=0.03)
    assert math.isfinite(flow.diagnostics()["kinetic_energy"])


# SPHERIC test 6, finite differences of Colicchio: time, speed and drag of a square of side 1.
SQUARE_SPEED = np.array([
    [0, 0], [0.1, 0.0012], [0.15, 0.0039], [0.2, 0.0106], [0.25, 0.0256], [0.3, 0.0553],
    [0.35, 0.1071], [0.4, 0.1872], [0.45, 0.2963], [0.5, 0.428], [0.55, 0.5682], [0.6, 0.7003],
    [0.65, 0.8102], [0.7, 0.891], [0.75, 0.9435], [0.8, 0.9737], [0.85, 0.989], [0.9, 0.9958],
    [0.95, 0.9985], [1, 0.9995], [1.1, 0.9999], [8, 0.9999],
])  # fmt: skip
SQUARE_DRAG = np.array([
    [0.3, 2.096], [0.35, 3.549], [0.4, 5.252], [0.45, 7.061], [0.5, 8.327], [0.55, 8.818],
    [0.6, 8.326], [0.65, 7.449], [0.7, 6.020], [0.8, 3.974], [0.9, 2.885], [1, 2.528],
    [1.2, 2.277], [1.6, 2.043], [2, 1.975], [3, 1.924], [4, 1.890], [5, 1.873], [6, 1.867],
])  # fmt: skip


def test_a_square_sets_off_in_a_box():
    """Re 100: the drag while it gathers speed, and the level that it comes to."""
    n, dt = 20, 0.025
    square = substep.Collider(substep.Box((1, 1, 4)))
    square.position = (1.5, 2.5, 0)
    flow = substep.GridFlow(
        [(0, 0), (10, 5)], 1 / n, viscosity=0.01, density=1.0, colliders=[square], threads=1
    )
    times, drag = [], []
    while flow.time < 6.2:
        square.velocity = (np.interp(flow.time + dt, *SQUARE_SPEED.T), 0, 0)
        flow.step(dt)
        times.append(flow.time - dt / 2)
        drag.append(-2 * square.impulse[0] / square.duration)
    mean = np.convolve(drag, np.full(5, 0.2), "same")  # it swings with the cells that it enters
    error = np.interp(SQUARE_DRAG[:, 0], times, mean) - SQUARE_DRAG[:, 1]
    settled = SQUARE_DRAG[:, 0] >= 1.2
    assert np.abs(error[settled] / SQUARE_DRAG[settled, 1]).max() < 0.04
    assert np.abs(error).max() < 0.12 * SQUARE_DRAG[:, 1].max()
    assert max(mean) == pytest.approx(SQUARE_DRAG[:, 1].max(), rel=0.1)
