"""Velocities by a pressure: what it takes away, what slow liquids then do, and its books."""

import itertools
import math

import numpy as np
import pytest
import substep
from substep.errors import InputError


def block(counts, spacing, low=(0.0, 0.0, 0.0)):
    axes = [at + spacing * (np.arange(n) + 0.5) for n, at in zip(counts, low, strict=False)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def liquid_of(x, d, **options):
    return substep.PositionBasedFluid(x, d, **({"divergence_free": True} | options))


def kernel_slope(r, h, dimension):
    """W' of Monaghan's cubic spline."""
    q = r / h
    scale = 8 / math.pi / h**4 if dimension == 3 else 40 / (7 * math.pi) / h**3
    return scale * np.where(
        q <= 0.5, 6 * (3 * q * q - 2 * q), np.where(q <= 1, -6 * (1 - q) ** 2, 0)
    )


def compression(x, v, d):
    """sum_j (L_i g_ij) . (v_i - v_j) of all pairs, with L_i of Bonet and Lok (1999); no walls."""
    dimension, h = x.shape[1], 2 * d
    away = x[:, None] - x
    r = np.linalg.norm(away, axis=2)
    np.fill_diagonal(r, 1)
    slope = kernel_slope(r, h, dimension)
    np.fill_diagonal(slope, 0)
    axis = d * np.arange(-2, 3)
    points = np.stack(np.meshgrid(*[axis] * dimension, indexing="ij"), -1).reshape(-1, dimension)
    q = np.linalg.norm(points, axis=1) / h
    scale = 8 / math.pi / h**3 if dimension == 3 else 40 / (7 * math.pi) / h**2
    spline = np.where(q <= 0.5, 6 * (q**3 - q**2) + 1, np.where(q <= 1, 2 * (1 - q) ** 3, 0))
    volume = 1 / (scale * spline.sum())
    g = volume * (slope / r)[..., None] * away
    moments = -np.einsum("ija,ijb->iab", g, away)
    inner = np.linalg.solve(moments, np.einsum("ija,ijb->iab", g, v[:, None] - v))
    return np.trace(inner, axis1=1, axis2=2)


@pytest.mark.parametrize("dimension", [2, 3])
def test_inside_nothing_is_compressed(dimension):
    """The kernel sums of the projection, by the formula, where a drop is full."""
    d, n = 0.1, 20 if dimension == 2 else 11
    x = block((n,) * dimension, d)
    rng = np.random.default_rng(0)
    v = rng.uniform(-0.2, 0.2, x.shape)
    liquid = liquid_of(
        x,
        d,
        velocities=v,
        gravity=np.zeros(dimension),
        dtype="float64",
        divergence_tolerance=1e-9,
        divergence_iterations=1000,
    )
    liquid.step(1e-3)
    assert liquid.report.divergence_converged
    inside = np.abs(liquid.positions - n * d / 2).max(axis=1) < (n / 2 - 1) * d
    before = compression(x, v, d)[inside]
    after = compression(liquid.positions, liquid.velocities, d)[inside]
    assert np.abs(before).max() > 1
    assert after.max() < 1e-4  # nothing comes closer; negative ones are free to part


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_momentum_is_kept_without_walls(dtype):
    v = np.random.default_rng(2).uniform(-1, 1, (343, 3))
    liquid = liquid_of(
        block((7, 7, 7), 0.1),
        0.1,
        velocities=v,
        density=[1000, 300],
        kinds=np.arange(343) % 2,
        gravity=(0, 0, 0),
        dtype=dtype,
    )
    momentum = liquid.masses @ liquid.velocities
    for _ in range(20):
        liquid.step(2e-3)
    scale = liquid.masses @ np.linalg.norm(liquid.velocities, axis=1)
    assert np.abs(liquid.masses @ liquid.velocities - momentum).max() < scale * (
        1e-5 if dtype == "float32" else 1e-12
    )


def test_a_tank_at_rest_weighs_what_it_holds():
    d, n = 0.05, 8
    x = block((n, n, n), d)
    side = n * d
    tank = substep.Collider(substep.Box((side, side, 2), (side / 2, side / 2, 1)), hollow=True)
    liquid = liquid_of(x, d, colliders=[tank])
    liquid.advance(1.0)
    liquid.advance(1.0)
    weight = -tank.impulse[2] / tank.duration / (9.81 * liquid.masses.sum())
    assert weight == pytest.approx(1, abs=0.01)
    assert np.sqrt((liquid.velocities**2).sum(axis=1).mean()) < 0.4 * math.sqrt(9.81 * d)
    assert 2 * liquid.positions[:, 2].mean() == pytest.approx(side, rel=0.03)


def u_tube(width, seed=None, **options):
    """Period and half-swings of a liquid in a U of arms `width` spacings wide, in two dimensions.

    From where the centre of mass is; arms 0.1 m wide and 0.3 m high, 0.2 m apart, 0.04 m off.
    """
    w, gap, arm, swing = 0.1, 0.2, 0.3, 0.04
    d = w / width
    wide = 2 * w + gap
    tank = substep.Collider(substep.Box((wide, 1, 1), (wide / 2, 0.5, 0)), hollow=True)
    wall = substep.Box((gap, 1, 1), (wide / 2, w + 0.5, 0))
    counts = [(width, w + arm + swing), (2 * width, w), (width, w + arm - swing)]
    lows = [(0, 0), (w, 0), (w + gap, 0)]
    x = np.concatenate(
        [block((n, round(h / d)), d, low) for (n, h), low in zip(counts, lows, strict=True)]
    )
    if seed is not None:
        x += np.random.default_rng(seed).normal(0, 1e-4 * d, x.shape)
    # Too small for two threads.
    liquid = substep.PositionBasedFluid(x, d, colliders=[tank, wall], threads=1, **options)
    times, levels = [], []
    while liquid.time < 2.8:
        liquid.advance(0.01)
        times.append(liquid.time)
        levels.append((wide / 2 - liquid.positions[:, 0].mean()) * len(x) * d * d / w / (w + gap))
    times, levels = np.array(times), np.array(levels)
    zeros = np.flatnonzero(levels[1:] * levels[:-1] < 0)
    zeros = zeros[np.insert(np.diff(zeros) > 8, 0, True)]
    at = times[zeros] - levels[zeros] * 0.01 / (levels[zeros + 1] - levels[zeros])
    swings = [
        np.abs(levels[(times > a) & (times < b)]).max() / swing for a, b in itertools.pairwise(at)
    ]
    return 2 * np.diff(at).mean(), swings


# A potential flow makes its way through a square corner as through 0.559 of its width (Hall,
# "Resistance calculations for thin film patterns", Thin Solid Films 1, 1968, 277).
CENTRELINE, POTENTIAL = 1.0, 0.6 + 0.2 + 2 * 0.559 * 0.1  # [m]


def test_a_u_tube_swings():
    """2 pi sqrt(L / 2 g); position-based velocities leave 0.05 of the third half-swing."""
    found = [u_tube(10, seed, divergence_free=True) for seed in range(3)]  # bits set them apart
    for period, _ in found:
        assert period == pytest.approx(2 * math.pi * math.sqrt(CENTRELINE / 2 / 9.81), rel=0.03)
    assert np.mean([swings[2] for _, swings in found]) > 0.5


@pytest.mark.slow
def test_a_fine_u_tube_comes_near_to_a_potential_flow():
    period, swings = u_tube(20, divergence_free=True)
    # The limit is that of the potential flow, 4.5 % below that of the centre line.
    assert period == pytest.approx(2 * math.pi * math.sqrt(POTENTIAL / 2 / 9.81), rel=0.03)
    assert swings[2] > 0.5


def test_levels_of_two_liquids_come_to_where_they_balance():
    """0.2 m of a light liquid on one side of a U-tube lift 0.1 m of one twice as heavy."""
    d, w, gap = 0.02, 0.1, 0.2
    wide = 2 * w + gap
    for start in (0.0, 0.1):  # above and below
        sides = [(w, 0.2 - start), (gap, 0.0), (w, 0.2 + start)]
        heavy, left = [], 0.0
        for width, height in sides:
            heavy.append(block((round(width / d), round((w + height) / d)), d, (left, 0)))
            left += width
        light = block((5, 10), d, (0, w + 0.2 - start))
        x = np.concatenate([*heavy, light])
        kinds = np.repeat([0, 1], [len(x) - len(light), len(light)])
        tank = substep.Collider(substep.Box((wide, 1, 1), (wide / 2, 0.5, 0)), hollow=True)
        wall = substep.Box((gap, 1, 1), (wide / 2, w + 0.5, 0))
        liquid = liquid_of(
            x, d, density=[2000, 1000], kinds=kinds, colliders=[tank, wall], viscosity=0.02
        )
        liquid.advance(6.0)
        of = liquid.positions[liquid.kinds == 0, 0]
        difference = ((of > w + gap).sum() - (of < w).sum()) * d * d / w
        assert difference == pytest.approx(0.1, abs=0.5 * d)


def test_a_small_blob_rises():
    """Light liquid of three spacings, ratio 2; by positions alone it hardly moves."""
    d = 0.01
    x = block((40, 60), d)
    kinds = (np.linalg.norm(x - (0.2, 0.15), axis=1) < 1.5 * d).astype(int)
    tank = substep.Collider(substep.Box((0.4, 2, 1), (0.2, 1, 0)), hollow=True)
    liquid = liquid_of(x, d, density=[1000, 500], kinds=kinds, colliders=[tank], threads=1)
    liquid.advance(1.5)
    assert liquid.positions[liquid.kinds == 1, 1].mean() > 0.3


def test_a_heavy_liquid_sinks_below_a_light_one():
    d = 0.02
    x = np.concatenate([block((20, 10), d), block((20, 10), d, (0, 0.2))])
    x += np.random.default_rng(0).normal(0, 0.02 * d, x.shape)
    tank = substep.Collider(substep.Box((0.4, 1, 1), (0.2, 0.5, 0)), hollow=True)
    liquid = liquid_of(x, d, density=[1000, 2000], kinds=np.repeat([0, 1], 200), colliders=[tank])
    liquid.advance(20.0)

    def wrong(of):
        kinds, height = liquid.kinds[of], liquid.positions[of, 1]
        return (kinds[np.argsort(height)[: np.count_nonzero(kinds)]] == 0).mean()

    away = tank.distance(np.pad(liquid.positions, ((0, 0), (0, 1)))) > d
    assert wrong(away) < 0.02  # what stays below has the wall beside it
    assert wrong(slice(None)) < 0.08


def discharge(d):
    """Coefficient of discharge of a square hole B = 0.1 m in the wall of a tank, and the speed of
    the jet over that of a fall from the surface.

    From how the level falls: d sqrt(h) / dt = -C B^2 sqrt(2 g) / (2 A), h above the middle.
    """
    g, hole, wide, thick, middle = 9.81, 0.1, 0.4, 0.04, 0.15
    beside = (wide - hole) / 2
    lengths_and_centers = [
        ((wide + 2 * thick, 2 * wide, 0.2), (wide / 2, wide / 2, -0.1)),
        ((thick, wide, middle - hole / 2), (wide, wide / 2, (middle - hole / 2) / 2)),
        ((thick, wide, 1.0), (wide, wide / 2, middle + hole / 2 + 0.5)),
        ((thick, beside, hole), (wide, beside / 2, middle)),
        ((thick, beside, hole), (wide, wide - beside / 2, middle)),
    ]
    boxes = [
        substep.Box(lengths, (x + (thick / 2 if x == wide else 0), y, z))
        for lengths, (x, y, z) in lengths_and_centers
    ]
    planes = [
        substep.Plane((1, 0, 0)),
        substep.Plane((0, 1, 0)),
        substep.Plane((0, -1, 0), (0, wide, 0)),
    ]
    liquid = substep.PositionBasedFluid(
        substep.fill_box((0, 0, 0), (wide, wide, wide), spacing=d),
        d,
        colliders=[*boxes, *planes],
        sinks=[substep.Sink(substep.Plane(point=(0, 0, -0.3)))],
        divergence_free=True,
    )
    times, levels, speeds = [], [], []
    while not levels or levels[-1] > 0.26:
        liquid.advance(0.02)
        x = liquid.positions
        times.append(liquid.time)
        levels.append(np.count_nonzero(x[:, 0] < wide) * d**3 / wide**2)
        jet = (np.abs(x[:, 0] - wide - 0.11) < 0.05) & (x[:, 2] > -0.2)
        if levels[-1] < 0.38:
            fall = np.sqrt(2 * g * (levels[-1] - x[jet, 2]))
            speeds.append((np.linalg.norm(liquid.velocities[jet], axis=1) / fall).mean())
    times, levels = np.array(times), np.array(levels)
    steady = levels < 0.38
    rate = np.polyfit(times[steady], np.sqrt(levels[steady] - middle), 1)[0]
    return -2 * rate * wide**2 / hole**2 / math.sqrt(2 * g), float(np.mean(speeds))


@pytest.mark.slow
def test_a_hole_in_a_tank_converges_to_torricelli():
    """C = 0.61 and 0.98 of the speed for a sharp edge (Lienhard and Lienhard, "Velocity
    coefficients for free jets from sharp-edged orifices", J. Fluids Eng. 106, 1984): half a spacing
    of the hole is lost to the first layers beside its walls, so C falls short by d / B."""
    (coarse, speed), (fine, fine_speed) = discharge(0.025), discharge(0.4 / 24)
    assert coarse < fine < 0.65
    limit = 3 * fine - 2 * coarse  # B / d = 4 and 6
    assert limit == pytest.approx(0.61, abs=0.05)
    assert speed > 0.92 and fine_speed > 0.94


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"divergence_tolerance": -1.0}, "divergence_tolerance"),
        ({"divergence_tolerance": np.nan}, "divergence_tolerance"),
        ({"divergence_iterations": 0}, "divergence_iterations"),
        ({"warm_start": 0.5}, "warm_start: expected 0 with divergence_free"),
    ],
)
def test_wrong_arguments(wrong, message):
    with pytest.raises(InputError, match=message):
        liquid_of(np.zeros((1, 3)), 0.1, **wrong)
    with pytest.raises(TypeError, match="divergence_free: expected a bool"):
        liquid_of(np.zeros((1, 3)), 0.1, divergence_free=np.ones(3), **wrong)


def test_no_particles_and_one():
    assert len(liquid_of(np.zeros((0, 3)), 0.1).positions) == 0
    for n in (0, 1):
        liquid = liquid_of(np.zeros((n, 3)), 0.1)
        liquid.advance(0.5)
        assert liquid.velocities == pytest.approx(np.full((n, 3), (0, 0, -4.905)))


def test_particles_that_lost_their_neighbours_fall():
    """Their pressure ends with the last neighbour, and no iteration waits for it."""
    d = 0.05
    tank = substep.Collider(substep.Box((1, 4, 1), (0.5, 2, 0)), hollow=True)
    liquid = liquid_of(block((20, 20), d), d, colliders=[tank])
    for _ in range(20):
        liquid.step(4e-3)
    row, column = np.arange(400) // 20, np.arange(400) % 20
    kept = liquid.ids[(row % 4 == 1) & (column % 4 == 1) & (column > 2)]
    liquid.remove(np.setdiff1d(liquid.ids, kept))
    before = liquid.velocities
    liquid.step(4e-3)
    assert liquid.report.divergence_converged and liquid.report.divergence_iterations == 0
    assert liquid.velocities - before == pytest.approx(np.tile([0, -9.81 * 4e-3], (len(kept), 1)))
