"""Viscous liquids on a grid against closed forms and published values."""

import math

import numpy as np
import pytest
import substep
from scipy import integrate, special

from .test_liquid import G, half_cells, lattice, periods, pool

NU, HEIGHT, PULL = 0.1, 0.1, 0.5 * G  # of films


def film(n, *, floor=0.0, **options):
    """A film of n cells on a slope, in a box without ends, at its steady speed, and this."""
    cell = HEIGHT / n
    x = lattice(half_cells(0, 4 * cell, cell), floor + half_cells(0, HEIGHT, cell))
    v = np.zeros(x.shape)
    v[:, 0] = steady(x[:, 1] - floor)
    bounds = ((0, 0), (4 * cell, cell * math.ceil(1.5 * n)))
    return substep.GridLiquid(
        x,
        cell=cell,
        bounds=bounds,
        velocities=v,
        gravity=(PULL, -G),
        sides=("periodic", "wall"),
        viscosity=NU,
        **options,
    )


def steady(y):
    """Nusselt's film."""
    return PULL / NU * (HEIGHT * y - y**2 / 2)


@pytest.mark.parametrize("transfer", ["apic", "flip"])
def test_a_film_has_the_speed_of_nusselt(transfer):
    """u = g sin(a) (h y - y^2 / 2) / nu, at faces; the surface is right within 0.03 cells."""
    wrong = []
    for n in (5, 10, 20):
        liquid = film(n, transfer=transfer)
        for _ in range(20):
            liquid.step(0.02)
        y = HEIGHT / n * (np.arange(n) + 0.5)
        u = liquid.cell_velocities[0, :n, 0]
        wrong.append(np.abs(u - steady(y)).max() / steady(HEIGHT))
    assert np.all(wrong < np.array([0.018, 0.007, 0.003]))


def test_a_flow_between_plates_is_of_second_order():
    """Poiseuille: u = g y (H - y) / (2 nu)."""
    wrong = []
    for n in (5, 10, 20):
        cell = HEIGHT / n
        x = lattice(half_cells(0, 4 * cell, cell), half_cells(0, HEIGHT, cell))
        liquid = substep.GridLiquid(
            x,
            cell=cell,
            bounds=((0, 0), (4 * cell, HEIGHT)),
            sides=("periodic", "wall"),
            gravity=(PULL, 0),
            viscosity=NU,
        )
        for _ in range(20):
            liquid.step(0.01)
        y = cell * (np.arange(n) + 0.5)
        exact = PULL / (2 * NU) * y * (HEIGHT - y)
        wrong.append(np.abs(liquid.cell_velocities[0, :, 0] - exact).max() / exact.max())
    assert wrong[0] < 0.06
    assert wrong[0] > 3.2 * wrong[1] > 10 * wrong[2]


def test_steps_of_any_size_find_the_same_film():
    speeds = []
    for dt in (0.0025, 0.01, 0.04):
        liquid = film(10, step=dt)
        liquid.set_velocities(np.zeros((len(liquid), 2)))
        liquid.advance(0.4)
        speeds.append(liquid.velocities[:, 0].max() / steady(HEIGHT))
    assert speeds == pytest.approx([1] * 3, rel=0.01)


def test_the_floor_of_a_film_bears_its_weight():
    """A floor that cuts cells; its drag is the weight along the slope."""
    floor = substep.Collider(substep.Box((9, 1, 9), center=(0, 0.013 - 0.5, 0)))
    liquid = film(10, floor=0.013, colliders=[floor])
    for _ in range(40):
        liquid.step(0.01)
    weight = 1000 * HEIGHT * 0.04 * np.array([PULL, -G])
    assert floor.impulse[:2] / floor.duration == pytest.approx(weight, rel=0.02)
    assert liquid.velocities[:, 0].max() == pytest.approx(steady(HEIGHT), rel=0.03)


@pytest.mark.parametrize("gap", [0.1, 0.093])
def test_a_lid_drags_what_is_below_it(gap):
    """Couette: a linear profile, and mu U / h of drag, where the lid cuts cells too."""
    x = lattice(half_cells(0, 0.04, 0.01), half_cells(0, 0.1, 0.01))
    lid = substep.Collider(substep.Box((9, 1, 9), center=(0, gap + 0.5, 0)), velocity=(0.1, 0, 0))
    liquid = substep.GridLiquid(
        x[x[:, 1] < gap],
        cell=0.01,
        bounds=((0, 0), (0.04, 0.12)),
        sides=("periodic", "wall"),
        gravity=(0, 0),
        viscosity=NU,
        colliders=[lid],
    )
    for _ in range(40):
        liquid.step(0.01)
    y = 0.01 * (np.arange(9) + 0.5)
    assert liquid.cell_velocities[0, :9, 0] == pytest.approx(0.1 * y / gap, abs=1e-4)
    assert lid.impulse[0] / lid.duration == pytest.approx(-1000 * NU * 0.1 / gap * 0.04, rel=2e-3)


@pytest.mark.parametrize("viscosity", [1e-3, 1.0])
def test_a_viscous_pool_in_a_cup_stays_at_rest(viscosity):
    liquid = pool(32, viscosity=viscosity)
    for _ in range(30):
        liquid.step(0.01)
    assert np.abs(liquid.velocities).max() < 1e-5 * math.sqrt(G * 0.5)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("viscosity", [0.01, 100.0])
def test_viscosity_leaves_what_turns_alone(dimension, viscosity):
    """A drop that turns by two radians keeps its angular momentum; iterations stay few."""
    cell = 1 / (32 if dimension == 2 else 16)
    x = lattice(*[half_cells(0, 1, cell)] * dimension)
    x = x[np.sum((x - 0.5) ** 2, axis=1) < 0.09]
    v = np.zeros(x.shape)
    v[:, 0], v[:, 1] = 0.5 - x[:, 1], x[:, 0] - 0.5
    v[:, 0] += 0.05
    liquid = substep.GridLiquid(
        x,
        cell=cell,
        bounds=((0,) * dimension, (1,) * dimension),
        velocities=v,
        gravity=(0,) * dimension,
        viscosity=viscosity,
    )

    def spin():
        arm = liquid.positions - liquid.positions.mean(axis=0)
        u = liquid.velocities
        return np.sum(arm[:, 0] * u[:, 1] - arm[:, 1] * u[:, 0])

    before, most = spin(), 0
    for _ in range(60):
        liquid.step(1 / 30)
        most = max(most, liquid.report.viscosity_iterations)
        assert liquid.report.viscosity_converged
    assert 0.93 < spin() / before < 1.01
    assert liquid.velocities[:, 0].mean() == pytest.approx(0.05, rel=0.05)
    assert most <= 20


@pytest.mark.figure
@pytest.mark.parametrize("n", [6, 12])
def test_a_viscous_current_spreads_as_that_of_huppert(n):
    """x_N = 1.411 (g q^3 / (3 nu))^(1/5) t^(1/5) in a plane, from his profile on; n cells high.

    Huppert, "The propagation of two-dimensional and axisymmetric viscous gravity currents over a
    rigid horizontal surface", J. Fluid Mech. 121, 1982, eq. 2.23 to 2.27.
    """
    q, start = 0.15, 0.15 / 0.84131  # volume; height where the length is 1
    cell = start / n
    x = lattice(half_cells(0, 1 + cell, cell), half_cells(0, start + cell, cell))
    x = x[x[:, 1] < start * np.clip(1 - x[:, 0] ** 2, 0, None) ** (1 / 3)]
    q = len(x) * (cell / 2) ** 2
    bounds = ((0, 0), (cell * math.ceil(1.6 / cell), cell * math.ceil(1.3 * n)))
    liquid = substep.GridLiquid(x, cell=cell, bounds=bounds, viscosity=NU)
    first = 3 * NU / (G * 0.15**3) / 1.411**5
    for factor in (2, 5):
        liquid.advance(factor * first - first - liquid.time)
        front = 1.411 * (G * q**3 / (3 * NU) * factor * first) ** 0.2
        assert np.quantile(liquid.positions[:, 0], 0.999) == pytest.approx(front, rel=0.015)


@pytest.mark.figure
def test_a_round_current_spreads_as_that_of_huppert():
    """r_N = 0.894 (g Q^3 / (3 nu))^(1/8) t^(1/8) from his profile on (1982), 5 cells high."""
    start, high, cell = 0.5, 0.15, 0.03
    n = 2 * math.ceil(1.4 * start / cell)
    x = lattice(*[half_cells(0, n * cell, cell)] * 2, half_cells(0, high + cell, cell))
    x = np.abs(x + np.random.default_rng(0).uniform(-0.1, 0.1, x.shape) * cell)
    middle = n * cell / 2

    def radii(x):
        return np.hypot(x[:, 0] - middle, x[:, 1] - middle)

    x = x[x[:, 2] < high * np.clip(1 - (radii(x) / start) ** 2, 0, None) ** (1 / 3)]
    bounds = ((0, 0, 0), (n * cell, n * cell, 7 * cell))
    liquid = substep.GridLiquid(x, cell=cell, bounds=bounds, viscosity=NU)
    scale = 0.894 * (G * (len(x) * (cell / 2) ** 3) ** 3 / (3 * NU)) ** (1 / 8)
    first = (start / scale) ** 8
    liquid.advance(2 * first)
    front = scale * (3 * first) ** (1 / 8)
    assert np.quantile(radii(liquid.positions), 0.999) == pytest.approx(front, rel=0.025)


def test_a_cup_that_turns_takes_the_liquid_along():
    """From rest: u / W = r + sum_k 2 R J1(q_k r / R) / (q_k J0(q_k)) exp(-q_k^2 nu t / R^2), by
    separation of variables, with the zeros q_k of J1.
    """
    radius, cell, t = 0.4, 1 / 32, 0.32
    x = lattice(*[half_cells(0, 1, cell)] * 2)
    x = x[np.hypot(*(x - 0.5).T) < radius]
    round_wall = substep.Cylinder(radius, 2, (0.5, 0.5, 0))
    cup = substep.Collider(round_wall, hollow=True, angular_velocity=(0, 0, 1))
    liquid = substep.GridLiquid(
        x,
        cell=cell,
        bounds=((0, 0), (1, 1)),
        gravity=(0, 0),
        viscosity=NU,
        colliders=[cup],
        step=t / 40,
    )
    liquid.advance(t)
    arm, v = liquid.positions - 0.5, liquid.velocities
    r = np.hypot(*arm.T)
    found = (arm[:, 0] * v[:, 1] - arm[:, 1] * v[:, 0]) / r
    q = special.jn_zeros(1, 20)
    parts = special.j1(np.outer(r, q / radius)) / (q * special.j0(q))
    exact = r + 2 * radius * parts @ np.exp(-(q**2) * NU * t / radius**2)
    assert np.abs(found - exact)[r < radius - cell].max() < 0.01 * radius
    assert np.abs(found - exact).max() < 0.05 * radius
    given = np.sum(found * r) * 1000 * cell**2 / 4
    assert -cup.angular_impulse[2] == pytest.approx(given, rel=0.08)


@pytest.mark.figure
def test_the_drag_of_balls_in_creeping_flow_is_that_of_hasimoto():
    """A force on the liquid of a cell of a cubic lattice: F = 6 pi mu a U K.

    Hasimoto, "On the periodic fundamental solutions of the Stokes equations", J. Fluid Mech. 5,
    1959. Of steps in which viscosity acts over a part of the radius, the drag is too small.
    """
    a, cell, pull = 0.25, 1 / 16, 0.01
    c = 4 / 3 * math.pi * a**3
    k = 1 / (1 - 1.7601 * c ** (1 / 3) + c - 1.5593 * c**2)
    speed = pull / (6 * math.pi * NU * a * k)
    x = lattice(*[half_cells(0, 1, cell)] * 3)
    x = x[np.linalg.norm(x - 0.5, axis=1) > a]
    wrong = []
    for dt, steps in ((0.1, 8), (1 / 60, 30)):
        ball = substep.Collider(substep.Sphere(a, (0.5, 0.5, 0.5)))
        liquid = substep.GridLiquid(
            x,
            cell=cell,
            bounds=((0, 0, 0), (1, 1, 1)),
            velocities=np.tile([speed / (1 - c), 0, 0], (len(x), 1)),
            sides="periodic",
            gravity=(pull, 0, 0),
            viscosity=NU,
            colliders=[ball],
        )
        for _ in range(steps):
            liquid.step(dt)
        flow = liquid.velocities[:, 0].sum() * (cell / 2) ** 3
        force = ball.impulse[0] / ball.duration / (1000 * pull * (1 - c))
        wrong.append(1 - force * speed / flow)
    assert 0 < wrong[1] < wrong[0] < 0.08


# Wu, Eatock Taylor, Greaves 2001, linear: extrema of the height at a wall over that at the start,
# k h = pi, nu = h sqrt(g h) / 200, walls that slip; times over sqrt(h / g), after the first.
EXTREMA = np.array([[1.79, 0.862], [8.94, 0.458], [16.1, 0.2465]])


@pytest.mark.figure
def test_a_standing_wave_decays_as_between_walls_that_slip():
    liquid = pool(32, 1.0, amplitude=1 / 32, viscosity=math.sqrt(G) / 200, slip=True)
    period = 2 * np.pi / math.sqrt(np.pi * math.tanh(np.pi))
    found, peaks = periods(liquid, 1.0, 4.6 * period / math.sqrt(G))
    rate = -math.log(peaks[-1] / peaks[0]) / ((len(peaks) - 1) * period / 2)
    (begin, first), _, (end, last) = EXTREMA
    assert rate == pytest.approx(math.log(first / last) / (end - begin), rel=0.04)
    assert rate < 2 * np.pi**2 / 200
    assert found.mean() * math.sqrt(G) == pytest.approx(period, rel=0.015)
    held = pool(32, 1.0, amplitude=1 / 32, viscosity=math.sqrt(G) / 200)
    _, theirs = periods(held, 1.0, 4.6 * period / math.sqrt(G))
    assert theirs[-1] < 0.4 * peaks[-1]


def stretched(speed, length, resistance):
    """Speeds of a hanging thread or sheet at half and three quarters of its length.

    resistance u (u' / u)' = u u' - g, from the nozzle to an end that is free: Trouton, "On the
    coefficient of viscous traction and its relation to that of viscosity", 1906.
    """
    s = np.linspace(0, length, 100)
    exact = integrate.solve_bvp(
        lambda _, y: [y[1], y[1] ** 2 / y[0] + (y[0] * y[1] - G) / resistance],
        lambda a, b: np.array([a[0] - speed, b[1]]),
        s,
        np.array([speed + 2 * s, 2 + 0 * s]),
    )
    return exact.sol(np.array([0.5, 0.75]) * length)[0]


def test_a_nozzle_holds_a_hanging_thread():
    """In 2D: it leaves at the nozzle's speed, without a gap, while gravity pulls on it below."""
    tap = substep.Emitter((0.05, 0.19), (0, -1), 0.2, radius=0.01)
    liquid = substep.GridLiquid(
        np.zeros((0, 2)),
        cell=0.005,
        bounds=((0, 0), (0.1, 0.2)),
        sides=("open", ("open", "wall")),
        viscosity=0.2,
        emitters=[tap],
    )
    liquid.advance(0.7)
    y, v = liquid.positions[:, 1], -liquid.velocities[:, 1]
    assert v[y > 0.185].mean() == pytest.approx(0.2, rel=0.06)
    found = [v[np.abs(y - part * 0.19) < 0.01].mean() for part in (0.5, 0.25)]
    assert found == pytest.approx(stretched(0.2, 0.19, 4 * 0.2), rel=0.03)
    assert np.diff(np.sort(y[y > 0.05])).max() < 0.005


@pytest.mark.figure
@pytest.mark.parametrize("dimension", [2, 3])
def test_what_hangs_resists_stretching_as_trouton_says(dimension):
    """By 4 times its viscosity a sheet in the plane, by 3 a thread, 8 cells across."""
    nu, speed, width, high = 0.3, 0.2, 0.02, 0.2
    cell, ratio = width / 8, 4 if dimension == 2 else 3
    side, length = 24 * cell, high - cell
    across = (side / 2,) * (dimension - 1)
    down = (0,) * (dimension - 1) + (-1,)
    tap = substep.Emitter((*across, high - cell), down, speed, radius=width / 2)
    liquid = substep.GridLiquid(
        np.zeros((0, dimension)),
        cell=cell,
        bounds=((0,) * dimension, (side,) * (dimension - 1) + (high,)),
        sides=("open",) * (dimension - 1) + (("open", "wall"),),
        viscosity=nu,
        emitters=[tap],
        threads=1,
    )
    liquid.advance(1.5 if dimension == 2 else 0.9)
    depth, v = length - liquid.positions[:, -1], -liquid.velocities[:, -1]
    found = [v[np.abs(depth - part * length) < 2 * cell].mean() for part in (0.5, 0.75)]
    weaker, right, stronger = (
        stretched(speed, length, part * ratio * nu) for part in (0.88, 1.0, 1.05)
    )
    assert np.all(stronger < found)
    assert np.all(found < weaker)
    assert found == pytest.approx(right, rel=0.05)


def honey(**options):
    """A block that falls onto a ball that moves, between walls and a periodic axis of odd cells."""
    ball = substep.Collider(substep.Sphere(0.15, (0.3, 0.2, 0.1)), velocity=(0.1, 0, 0))
    x = substep.fill_box((0.2, 0, 0.2), (0.6, 0.7, 0.6), 0.05)
    return substep.GridLiquid(
        x,
        cell=0.1,
        bounds=((0, 0, 0), (0.9, 0.7, 0.9)),
        sides=("wall", "periodic", ("wall", "open")),
        colliders=[ball],
        viscosity=0.2,
        **options,
    )


@pytest.mark.parametrize("slip", [False, True])
def test_bits_do_not_depend_on_threads_or_checkpoints(slip):
    states = []
    for threads in (1, 2, 3):
        liquid = honey(threads=threads, slip=slip)
        for step in range(8):
            liquid.step(0.02)
            if step == 3 and threads == 2:
                state, liquid = liquid.state(), honey(threads=2, slip=slip)
                liquid.restore(state)
        states.append(np.concatenate([liquid.positions, liquid.velocities]).tobytes())
        states.append(liquid.colliders[0].impulse.tobytes())
    assert states[:2] * 3 == states


def test_viscosity_that_is_none_is_refused():
    for wrong in (-1.0, np.nan, np.inf, "thick"):
        with pytest.raises((substep.InputError, TypeError), match="viscosity"):
            pool(8, viscosity=wrong)
    with pytest.raises((substep.InputError, TypeError), match="slip"):
        pool(8, viscosity=1.0, slip=2)
    liquid = pool(8, amplitude=0.1, viscosity=1e300)
    before = liquid.velocities
    with pytest.raises(substep.NonFiniteError):
        liquid.step(0.01)
    assert np.array_equal(liquid.velocities, before)


@pytest.mark.parametrize(("degrees", "viscosity"), [(20, 10.0), (45, 0.1)])
def test_a_block_slides_down_a_plane_that_slips(degrees, viscosity):
    angle, cell = math.radians(degrees), 1 / 20
    along = np.array([math.cos(angle), -math.sin(angle)])
    up = np.array([math.sin(angle), math.cos(angle)])
    foot = np.array([0, 4 * math.tan(angle) + cell])
    s = lattice(half_cells(0.3, 1.3, cell), half_cells(0, 0.2, cell))
    liquid = substep.GridLiquid(
        foot + s[:, :1] * along + s[:, 1:] * up,
        cell=cell,
        bounds=((0, 0), (4, cell * math.ceil((foot[1] + 0.6) / cell))),
        viscosity=viscosity,
        slip=True,
        colliders=[substep.Plane((*up, 0), (*foot, 0))],
    )
    liquid.advance(0.4)
    assert (liquid.velocities @ along).mean() == pytest.approx(G * math.sin(angle) * 0.4, rel=0.05)


def test_a_round_cup_that_slips_takes_nothing_along():
    cell = 1 / 32
    x = lattice(*[half_cells(0, 1, cell)] * 2)
    x = x[np.hypot(*(x - 0.5).T) < 0.4]
    cup = substep.Collider(
        substep.Cylinder(0.4, 2, (0.5, 0.5, 0)), hollow=True, angular_velocity=(0, 0, 1)
    )
    liquid = substep.GridLiquid(
        x,
        cell=cell,
        bounds=((0, 0), (1, 1)),
        gravity=(0, 0),
        viscosity=0.01,
        slip=True,
        colliders=[cup],
    )
    liquid.advance(2.0)
    arm, v = liquid.positions - 0.5, liquid.velocities
    spin = np.sum(arm[:, 0] * v[:, 1] - arm[:, 1] * v[:, 0]) / np.sum(arm**2)
    assert abs(spin) < 0.05  # 1 is that of the cup
