"""Liquids on a grid against closed forms and experiments, and what a step keeps."""

import itertools
import math

import numpy as np
import pytest
import substep

G = 9.81


def lattice(*axes):
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def half_cells(low, high, cell):
    """Middles of half cells."""
    return low + cell / 2 * (np.arange(round(2 * (high - low) / cell)) + 0.5)


def pool(n, depth=0.5, length=1.0, amplitude=0.0, **options):
    """Water in 2D with the velocities of the first standing wave when its surface is flat."""
    cell, k = length / n, np.pi / length
    x = lattice(half_cells(0, length, cell), half_cells(0, depth, cell))
    rise = amplitude * math.sqrt(G * k * math.tanh(k * depth)) / math.sinh(k * depth)
    across, up = k * x[:, 0], k * x[:, 1]
    v = rise * np.stack([-np.cosh(up) * np.sin(across), np.sinh(up) * np.cos(across)], axis=1)
    top = cell * math.ceil(1.5 * depth / cell)
    bounds = ((0, 0), (length, top))
    return substep.GridLiquid(x, cell=cell, bounds=bounds, velocities=v, **options)


@pytest.mark.parametrize("transfer", ["apic", "flip", "pic"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_pool_stays_at_rest_under_its_hydrostatic_pressure(transfer, dtype):
    """p = rho g (H - z), exact for the ghost fluid method; velocities by the solver's tolerance."""
    liquid = pool(32, transfer=transfer, dtype=dtype, tolerance=1e-7)
    for _ in range(100):
        liquid.step(0.005)
    assert np.abs(liquid.velocities).max() < 2e-5 * math.sqrt(G * 0.5)
    z = (np.arange(16) + 0.5) / 32
    expected = 1000 * G * (0.5 - z)
    assert np.allclose(liquid.pressure[:, :16], expected, atol=1e-4 * 1000 * G * 0.5)
    assert not liquid.pressure[:, 17:].any()
    assert liquid.depth([[0.5]]) == pytest.approx(0.5, abs=0.05 / 32)
    assert liquid.sample_pressure([[0.5, 0.25]]) == pytest.approx(1000 * G * 0.25, rel=1e-3)


@pytest.mark.parametrize("n", [32, 64])
@pytest.mark.parametrize("obstacle", ["ball", "slope"])
def test_still_water_around_obstacles(obstacle, n):
    """At rest to rounding, but that `keep_volume` sees how rough counts are beside a ball."""
    solid = {
        "ball": substep.Sphere(0.15, (0.5, 0.22, 0)),
        "slope": substep.Plane((-math.sin(0.4), math.cos(0.4), 0), point=(0.5, 0.2, 0)),
    }[obstacle]
    x = lattice(half_cells(0, 1, 1 / n), half_cells(0, 0.5, 1 / n))
    x = x[substep.Collider(solid).distance(np.c_[x, np.zeros(len(x))]) > 0]
    for keep, most in ((False, 1e-7), (True, 3e-4 if obstacle == "ball" else 1e-6)):
        liquid = substep.GridLiquid(
            x,
            cell=1 / n,
            bounds=((0, 0), (1, 1)),
            colliders=[solid],
            keep_volume=keep,
            tolerance=1e-7,
        )
        for _ in range(100):
            liquid.step(0.005)
        assert np.abs(liquid.velocities).max() < most * math.sqrt(G * 0.5)


def test_still_water_rests_in_a_tank_whose_walls_are_off_by_different_parts():
    """No cell in its corners counts as air, and no face in its walls as open."""
    cell, low = 0.1, 0.1 * (2 + np.array((0.1, 0.25, 0.75)))
    wide = {a: [8.0] * 3 for a in range(3)}
    walls = []
    for a, ends in enumerate(((low[0], low[0] + 1), (low[1], low[1] + 1), (low[2],))):
        for k, end in enumerate(ends):
            size, center = list(wide[a]), [0.0] * 3
            size[a], center[a] = 4.0, end + (2 if k else -2)
            walls.append(substep.Collider(substep.Box(size, center=center)))
    x = substep.fill_box((0, 0, 0), (1, 1, 0.8), cell / 2) + low
    bounds = ((0, 0, 0), (1.5, 1.5, 1.6))
    liquid = substep.GridLiquid(x, cell=cell, bounds=bounds, colliders=walls)
    liquid.advance(5.0)
    assert (liquid.positions[:, 2].mean() - low[2]) / 0.4 == pytest.approx(1, abs=0.004)
    assert np.abs(liquid.velocities).max() < 0.1


@pytest.mark.parametrize("keep", [False, True])
@pytest.mark.parametrize("off", [0, 0.25, 0.5, 0.75])
def test_still_water_keeps_its_volume_between_obstacles(off, keep):
    """In a tank ten cells wide, wherever its walls and its floor lie in the cells, for 20 s."""
    low, wide, depth, far = 2 + off, 10, 8, 40
    walls = [
        substep.Box((far, 2 * far, 2 * far), center=center)
        for center in ((low - far / 2, 0, 0), (low + wide + far / 2, 0, 0))
    ]
    walls += [
        substep.Box((2 * far, far, 2 * far), center=center)
        for center in ((0, low - far / 2, 0), (0, low + wide + far / 2, 0))
    ]
    walls.append(substep.Box((2 * far, 2 * far, far), center=(0, 0, low - far / 2)))
    rows = [low + np.arange(0.25, end, 0.5) for end in (wide, wide, depth)]
    liquid = substep.GridLiquid(
        np.stack(np.meshgrid(*rows, indexing="ij"), -1).reshape(-1, 3),
        cell=1.0,
        bounds=((0, 0, 0), (15, 15, 16)),
        colliders=[substep.Collider(wall) for wall in walls],
        keep_volume=keep,
    )
    middle = low + np.stack(np.meshgrid(*[(2.0, 4.0, 5.0, 6.0, 8.0)] * 2), -1).reshape(-1, 2)
    for _ in range(4):
        liquid.advance(5)
        height = (liquid.positions[:, 2].mean() - low) / (depth / 2)
        assert height == pytest.approx(1, abs=0.003)
        assert liquid.depth(middle).mean() == pytest.approx(depth, abs=0.08)
    assert np.abs(liquid.velocities).max() < 0.02 * math.sqrt(G * depth)


@pytest.mark.parametrize("slope", [0.1, 0.4])
def test_still_water_under_a_slanted_pull(slope):
    """What moves are particles at the surface, whose place is known to 0.1 cells (docs)."""
    n, down = 64, np.array([math.sin(slope), -math.cos(slope)])
    x = lattice(half_cells(0, 1, 1 / n), half_cells(0, 1, 1 / n))
    x = x[(x - 0.5) @ down > 0]
    liquid = substep.GridLiquid(x, cell=1 / n, bounds=((0, 0), (1, 1)), gravity=G * down)
    liquid.advance(1.0)
    speed = np.linalg.norm(liquid.velocities, axis=1) / math.sqrt(G * 0.5)
    assert speed.max() < 0.04 and np.sqrt((speed**2).mean()) < 0.004
    deep = (liquid.positions - 0.5) @ down > 0.1
    assert speed[deep].max() < 0.004


@pytest.mark.parametrize("dimension", [2, 3])
def test_what_falls_freely_follows_a_parabola(dimension):
    cell = 0.05
    x = substep.fill_box((0.3,) * dimension, (0.6,) * dimension, cell / 2)
    bounds = ((0,) * dimension, (1,) * (dimension - 1) + (2,))
    v = np.zeros(x.shape)
    v[:, -1] = 1.0
    liquid = substep.GridLiquid(x, cell=cell, bounds=bounds, velocities=v)
    before = liquid.positions[:, -1]
    for _ in range(20):
        liquid.step(0.01)
    assert np.allclose(liquid.velocities[:, -1], 1 - G * 0.2, atol=1e-5)
    # Velocities first, then positions: sum_k h (1 - g h k).
    way = 0.2 - G * 0.01**2 * 20 * 21 / 2
    assert np.allclose(liquid.positions[:, -1] - before, way, atol=1e-5)
    assert np.abs(liquid.pressure).max() < 1e-3 * 1000 * G * 0.3


def periods(liquid, length, count):
    """Of the first mode, from the zeros of the mean of cos(pi x / L), and its largest values."""
    times, values = [], []

    def note(at):
        times.append(at.time)
        values.append(np.cos(np.pi * at.positions[:, 0] / length).mean())

    liquid.advance(count, note)
    t, m = np.array(times), np.array(values)
    k = np.flatnonzero((m[:-1] > 0) != (m[1:] > 0))
    zeros = t[k] - m[k] * (t[k + 1] - t[k]) / (m[k + 1] - m[k])
    peaks = [np.abs(m[a:b]).max() for a, b in itertools.pairwise(k)]
    return 2 * np.diff(zeros), np.array(peaks)


@pytest.mark.figure
@pytest.mark.parametrize("depth", [0.25, 0.375, 0.5, 1.0])
@pytest.mark.parametrize("transfer", ["apic", "flip"])
def test_sloshing_has_the_period_of_linear_waves(depth, transfer):
    """w^2 = g k tanh(k h), k = pi / L (Lamb, Hydrodynamics, art. 228); amplitude: a cell."""
    k = np.pi
    period = 2 * np.pi / math.sqrt(G * k * math.tanh(k * depth))
    liquid = pool(64, depth, amplitude=1 / 64, transfer=transfer)
    found, peaks = periods(liquid, 1.0, 5.3 * period)
    assert found.mean() == pytest.approx(period, rel=5e-3)
    assert peaks[-1] > 0.88 * peaks[0]
    assert peaks.max() < 1.01 * peaks[0]


# Martin and Moyce 1952, Phil. Trans. R. Soc. A 244, Fig. 3: column of a = 2.25 in, 2 a high.
# (t sqrt(2 g / a), front / a)
FRONT = np.array([[0.832, 1.217], [1.219, 1.474], [1.997, 2.292], [2.547, 2.995], [3.345, 4.134]])


@pytest.mark.figure
@pytest.mark.parametrize("transfer", ["apic", "flip"])
def test_the_front_of_a_dam_break_is_that_of_martin_and_moyce(transfer):
    """After one shift of time, by at most 0.3, for the gate that they pulled."""
    a, n = 0.05715, 32
    x = lattice(half_cells(0, a, a / n), half_cells(0, 2 * a, a / n))
    bounds = ((0, 0), (12 * a, 2.5 * a))
    liquid = substep.GridLiquid(x, cell=a / n, bounds=bounds, transfer=transfer)
    energy = liquid.diagnostics()["energy"]
    times, front = [], []

    def note(at):
        times.append(at.time * math.sqrt(2 * G / a))
        front.append(np.quantile(at.positions[:, 0], 0.999) / a)

    liquid.advance(3.4 / math.sqrt(2 * G / a), note)
    wrong = [
        np.abs(np.interp(FRONT[:, 0] - shift, times, front) / FRONT[:, 1] - 1).max()
        for shift in np.linspace(0, 0.3, 61)
    ]
    assert min(wrong) < 0.03
    assert 0.9 < liquid.diagnostics()["energy"] / energy < 1.005


def test_a_ball_under_water_is_lifted_by_what_it_displaces():
    """Archimedes: rho g V."""
    radius = 0.2
    for n in (16, 32):
        cell = 1 / n
        x = lattice(*[half_cells(0, high, cell) for high in (1, 1, 0.75)])
        ball = substep.Collider(substep.Sphere(radius, center=(0.5, 0.5, 0.4)))
        x = x[ball.distance(x) > 0]
        bounds = ((0, 0, 0), (1, 1, 1))
        liquid = substep.GridLiquid(x, cell=cell, bounds=bounds, colliders=[ball])
        for _ in range(3):
            liquid.step(0.01)
        lift = ball.impulse / ball.duration / (1000 * G * 4 / 3 * np.pi * radius**3)
        assert np.abs(lift[:2]).max() < 1e-5
        assert lift[2] == pytest.approx(1, abs=0.004)


def test_pressure_beside_an_obstacle_is_that_of_the_water():
    """The face lies within a cell, whose middle is in the box."""
    cell = 1 / 32
    x = lattice(half_cells(0, 1, cell), half_cells(0, 0.5, cell))
    box = substep.Collider(substep.Box((0.2, 0.5, 1), center=(0.5, 0.25, 0)))
    x = x[box.distance(np.c_[x, np.zeros(len(x))]) > 0]
    liquid = substep.GridLiquid(x, cell=cell, bounds=((0, 0), (1, 1)), colliders=[box])
    liquid.step(0.005)
    found = liquid.sample_pressure([[0.395, 0.1], [0.395, 0.3]])
    assert found == pytest.approx([1000 * G * 0.4, 1000 * G * 0.2], rel=0.02)


def test_depth_does_not_count_what_an_obstacle_takes():
    """Over a floor on a face of the grid, over a slanted one, and beside both."""
    cell = 1 / 20
    slanted = substep.Plane((-math.sin(0.4), math.cos(0.4), 0), point=(0.5, 0.3, 0))
    for floor in (substep.Box((1.2, 0.6, 4), center=(0.5, 0, 0)), slanted):
        obstacle = substep.Collider(floor)
        x = lattice(half_cells(0, 1, cell), half_cells(0, 0.7, cell))
        x = x[obstacle.distance(np.c_[x, np.zeros(len(x))]) > 0]
        bounds = ((0, 0), (1, 1))
        liquid = substep.GridLiquid(x, cell=cell, bounds=bounds, colliders=[obstacle])
        liquid.advance(0.5)
        assert liquid.depth([[0.5]]) == pytest.approx(0.4, abs=0.3 * cell)
    assert liquid.depth(np.zeros((0, 1))).shape == (0,)
    with pytest.raises(substep.InputError, match=r"points\[1\]"):
        liquid.depth([[0.5], [1.5]])


def test_a_piston_gives_its_momentum_to_the_water():
    """But for what the faces in it hold of the momentum: within 3 %."""
    cell = 1 / 32
    x = lattice(half_cells(0.125, 0.625, cell), half_cells(0, 0.5, cell))
    piston = substep.Collider(
        substep.Box((0.25, 4, 1), center=(0, 1, 0)), velocity=(0.5, 0, 0), friction=0.3
    )
    liquid = substep.GridLiquid(
        x, cell=cell, bounds=((0, 0), (2, 1)), colliders=[piston], gravity=(0, 0), tolerance=1e-7
    )
    impulse = 0.0
    for _ in range(20):
        liquid.step(0.01)
        impulse -= piston.impulse[0]
    assert liquid.diagnostics()["momentum_x"] == pytest.approx(impulse, rel=0.03)
    assert liquid.positions[:, 0].min() > piston.position[0] + 0.125 - 0.02 * cell


@pytest.mark.parametrize(
    ("transfer", "least", "most"), [("apic", 0.9, 1.001), ("flip", 0.9, 1.001), ("pic", 0.2, 0.6)]
)
def test_a_blob_goes_on_turning(transfer, least, most):
    """Two radians: APIC and FLIP keep most of the angular momentum, PIC does not (Jiang et al.)."""
    cell = 1 / 32
    x = lattice(half_cells(0, 1, cell), half_cells(0, 1, cell))
    x = x[np.linalg.norm(x - 0.5, axis=1) < 0.25]
    v = 2 * np.stack([0.5 - x[:, 1], x[:, 0] - 0.5], axis=1)
    liquid = substep.GridLiquid(
        x,
        cell=cell,
        bounds=((0, 0), (1, 1)),
        velocities=v,
        gravity=(0, 0),
        transfer=transfer,
        flip_rate=1.0,
    )

    def spin():
        arm, u = liquid.positions - 0.5, liquid.velocities
        return float((arm[:, 0] * u[:, 1] - arm[:, 1] * u[:, 0]).sum())

    start = spin()
    for _ in range(100):
        liquid.step(0.01)
    assert least < spin() / start < most
    values = liquid.diagnostics()
    assert abs(values["momentum_x"]) + abs(values["momentum_y"]) < 1e-3 * liquid.masses.sum()


def test_full_cells_keep_their_particles():
    """A column falls to a pool: `keep_volume` spreads the particles, and the volume stays."""
    cell = 1 / 24
    volumes = {}
    for keep in (True, False):
        x = lattice(half_cells(0, 0.5, cell), half_cells(0, 0.75, cell))
        liquid = substep.GridLiquid(x, cell=cell, bounds=((0, 0), (1, 1)), keep_volume=keep)
        liquid.advance(6.0)
        wet = np.clip(0.5 - liquid.level_set / cell, 0, 1).sum() * cell**2
        volumes[keep] = wet / 0.375
    assert volumes[True] == pytest.approx(1, abs=0.02)
    assert abs(volumes[False] - 1) > 2 * abs(volumes[True] - 1)


@pytest.mark.parametrize("transfer", ["apic", "flip"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_the_same_bits_for_any_threads_and_through_a_checkpoint(tmp_path, transfer, dimension):
    def make(threads):
        cell = 1 / 20
        x = substep.fill_box((0,) * dimension, (0.4, 0.5, 0.6)[:dimension], cell / 2)
        ball = substep.Sphere(0.12, center=(0.6, 0.25, 0.1 if dimension == 3 else 0.0))
        box = substep.Box((0.1, 0.1, 0.4), center=(0.8, 0.1, 0.0))
        block = substep.Collider(box, velocity=(-0.1, 0.0, 0.0))
        return substep.GridLiquid(
            x,
            cell=cell,
            bounds=((0,) * dimension, (1, 0.5, 1)[:dimension]),
            colliders=[ball, block],
            transfer=transfer,
            threads=threads,
        )

    hashes = set()
    for threads in (1, 2, 3):
        liquid = make(threads)
        liquid.advance(0.3)
        hashes.add(substep.state_hash(liquid.positions, liquid.velocities, liquid.pressure))
    assert len(hashes) == 1
    liquid, other = make(2), make(1)
    liquid.advance(0.1)
    liquid.save(tmp_path / "state")
    other.load(tmp_path / "state")
    for one in (liquid, other):
        one.advance(0.2)
    assert substep.state_hash(liquid.positions, liquid.pressure) == substep.state_hash(
        other.positions, other.pressure
    )


def test_emitters_sinks_and_sides():
    tap = substep.Emitter((0.5, 0.5, 0.9), (0, 0, -1), 1.0, radius=0.1)
    drain = substep.Sink(substep.Box((1, 1, 0.1), center=(0.5, 0.5, 0.02)))
    none = np.zeros((0, 3))
    bounds = ((0, 0, 0), (1, 1, 1))
    liquid = substep.GridLiquid(none, cell=1 / 16, bounds=bounds, emitters=[tap], sinks=[drain])
    liquid.advance(0.6)
    assert liquid.emitted[0] == len(liquid) + liquid.absorbed[0]
    assert liquid.absorbed[0] > 0
    x = substep.fill_box((0.25, 0.25), (0.75, 0.75), 1 / 64)
    liquid = substep.GridLiquid(x, cell=1 / 32, bounds=((0, 0), (1, 1)), sides="open")
    liquid.advance(1.0)
    assert len(liquid) == 0
    v = np.tile([2.0, 0.0], (len(x), 1))
    sides = ("periodic", "wall")
    liquid = substep.GridLiquid(
        x, cell=1 / 32, bounds=((0, 0), (1, 1)), sides=sides, velocities=v, gravity=(0, 0)
    )
    liquid.advance(0.5)
    assert np.allclose(liquid.velocities, v, atol=1e-5)
    assert np.allclose(np.sort(liquid.positions, axis=0), np.sort(x, axis=0), atol=1e-4)


def test_jets_end_at_the_sides_of_the_box():
    """What would come out beyond them is lost, so that a state can be restored."""
    bounds = ((0, 0, 0), (0.6, 0.3, 0.4))
    wide = substep.Emitter((0.3, 0.1, 0.2), (0, 0, 1), 1.0, radius=0.3)
    liquid = substep.GridLiquid(np.zeros((0, 3)), cell=0.1, bounds=bounds, emitters=[wide])
    liquid.advance(0.3)
    x = liquid.positions
    assert (x >= 0).all() and (x <= bounds[1]).all()
    assert len(liquid.copy()) == len(liquid) > 0
    with pytest.raises(substep.InputError, match=r"emitters\[0\]"):
        away = substep.Emitter((5, 0.1, 0.3), (1, 0, 0), 1.0, radius=0.1)
        substep.GridLiquid(np.zeros((0, 3)), cell=0.1, bounds=bounds, emitters=[away])


def test_extreme_numbers_stay_finite_or_raise():
    x = substep.fill_box((0, 0), (0.5, 0.5), 0.0625)
    liquid = substep.GridLiquid(x, cell=0.125, bounds=((0, 0), (1, 1)))
    liquid.step(5e-324)
    assert np.isfinite(liquid.pressure).all()
    liquid.set_velocities(np.full((len(x), 2), 3e38))
    with pytest.raises(substep.NonFiniteError):
        print(liquid.cell_velocities)
    state = liquid.state()
    state["next_id"] = 2**62
    liquid.restore(state)
    liquid.set_velocities(np.zeros((len(x), 2)))
    liquid.set_forces(np.ones((len(x), 2)))
    liquid.step(0.001)
    with pytest.raises(substep.InputError, match=r"sides\[1\]"):
        thin = ((0, 0), (1, 0.125))
        substep.GridLiquid(x[:0], cell=0.125, bounds=thin, sides=("wall", "periodic"))


def test_mirrored_starts_stay_mirrored():
    cell = 1 / 32
    x = lattice(half_cells(0.375, 0.625, cell), half_cells(0, 0.5, cell))
    liquid = substep.GridLiquid(
        x, cell=cell, bounds=((0, 0), (1, 1)), dtype="float64", tolerance=1e-10, keep_volume=False
    )
    liquid.advance(0.25)
    ends = liquid.positions
    mirrored = np.array([1, 0]) + np.array([-1, 1]) * ends
    order, other = np.lexsort(x.T), np.lexsort((np.array([1, 0]) + np.array([-1, 1]) * x).T)
    assert np.allclose(ends[order], mirrored[other], atol=1e-6)


@pytest.mark.parametrize(
    ("wrong", "name"),
    [
        ({"cell": 0.0}, "cell"),
        ({"cell": math.nan}, "cell"),
        ({"cell": 0.3}, "bounds"),
        ({"cell": 1e-9}, "bounds"),
        ({"bounds": ((0, 0, 0), (1, 1, 0))}, "bounds"),
        ({"bounds": ((0, 0, 0), (1, 1, math.inf))}, "bounds"),
        ({"positions": [[0.5, 0.5, 1.5]]}, r"positions\[0\]"),
        ({"positions": [[0.5, 0.5, math.nan]]}, "positions"),
        ({"sides": "closed"}, "sides"),
        ({"sides": ("wall", "wall")}, "sides"),
        ({"sides": ("wall", "wall", ("open", "periodic"))}, "sides"),
        ({"transfer": "pif"}, "transfer"),
        ({"flip_rate": 1.5}, "flip_rate"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"density": -1.0}, "density"),
        ({"cfl": 0.0}, "cfl"),
    ],
)
def test_wrong_arguments_are_named(wrong, name):
    good = {"positions": [[0.5, 0.5, 0.5]], "cell": 0.25, "bounds": ((0, 0, 0), (1, 1, 1))}
    with pytest.raises(substep.InputError, match=name):
        substep.GridLiquid(**(good | wrong))


def test_a_grid_that_cannot_fit_is_refused_before_memory_is_taken():
    with pytest.raises(MemoryError, match="GB"):
        substep.GridLiquid(np.zeros((0, 3)), cell=1.0, bounds=((0, 0, 0), (1200, 1200, 1200)))


def test_degenerate_liquids():
    """None, one particle, all obstacle, a cell thick, thousands in a cell, far too long a step."""
    bounds = ((0, 0, 0), (1, 1, 1))
    for x in (np.zeros((0, 3)), [[0.5, 0.5, 0.5]], np.full((3000, 3), 0.51)):
        liquid = substep.GridLiquid(x, cell=0.125, bounds=bounds)
        liquid.advance(0.1)
        assert len(liquid) == len(x)
        assert np.isfinite(liquid.positions).all()
    rock = substep.Box((4, 4, 4))
    liquid = substep.GridLiquid([[0.5, 0.5, 0.5]], cell=0.125, bounds=bounds, colliders=[rock])
    liquid.advance(0.1)
    assert np.isfinite(liquid.positions).all()
    x = substep.fill_box((0, 0, 0), (0.5, 0.125, 0.5), 0.0625)
    liquid = substep.GridLiquid(x, cell=0.125, bounds=((0, 0, 0), (1, 0.125, 1)))
    liquid.step(100.0)
    assert np.isfinite(liquid.positions).all()
    corners = lattice([0.0, 1.0], [0.0, 1.0], [0.0, 0.5, 1.0])
    liquid = substep.GridLiquid(corners, cell=0.125, bounds=bounds)
    liquid.advance(0.1)
    assert np.isfinite(liquid.velocities).all()


def test_a_pressure_that_does_not_converge_leaves_all_as_it_was():
    liquid = pool(32, amplitude=0.05, tolerance=1e-12, max_iterations=1)
    before = liquid.state()
    with pytest.raises(substep.ConvergenceError, match="max_iterations"):
        liquid.step(0.01)
    after = liquid.state()
    assert all(np.array_equal(value, after[name]) for name, value in before.items())
    assert liquid.time == 0
    liquid = pool(16)
    liquid.set_velocities(np.full((len(liquid), 2), 3e38))
    before = substep.state_hash(liquid.positions, liquid.velocities)
    with pytest.raises(substep.SolverError):
        liquid.step(0.01)
    assert substep.state_hash(liquid.positions, liquid.velocities) == before


@pytest.mark.parametrize("fill", [0.5, 1.0])
def test_nothing_leaves_a_round_tank(fill):
    radius, cell = 0.4, 1 / 64
    x = lattice(*[half_cells(0, 1, cell)] * 2)
    x = x[(np.hypot(*(x - 0.5).T) < radius) & (x[:, 1] < fill)]
    tank = substep.Collider(substep.Cylinder(radius, 2, (0.5, 0.5, 0)), hollow=True)
    liquid = substep.GridLiquid(
        x,
        cell=cell,
        bounds=((0, 0), (1, 1)),
        velocities=np.stack([0.5 - x[:, 1], x[:, 0] - 0.5], axis=1),
        colliders=[tank],
    )
    liquid.advance(0.5)
    assert np.hypot(*(liquid.positions - 0.5).T).max() < radius + 0.1 * cell


@pytest.mark.parametrize(
    ("shape", "reach"),
    [
        (substep.Sphere(0.05, (0.5, 0.5, 0)), 0.05),
        (substep.Box((0.06, 0.08, 1), (0.5, 0.5, 0)), 0.5 * math.hypot(0.06, 0.08, 1)),
    ],
)
def test_an_obstacle_that_turns_counts_by_what_it_reaches(shape, reach):
    """Its surface is no faster in the box, 0.7 m away from its middle."""
    spinner = substep.Collider(shape, angular_velocity=(0, 0, 40))
    liquid = pool(32, colliders=[spinner])
    expected = min(reach, math.hypot(0.5, 0.5)) * 40
    assert f"speed of {expected:.4g} m/s" in liquid.step_limit()[1]
    spinner.velocity = (3, 0, 0)
    assert f"speed of {expected + 3:.4g} m/s" in liquid.step_limit()[1] or expected > 20


@pytest.mark.parametrize("make", [substep.GridLiquid, substep.GridFlow])
def test_obstacles_that_do_not_come_into_the_box_do_not_shorten_steps(make):
    """Those that do within a step count, and those without an end as fast as in the box."""
    box = ((0, 0, 0), (1, 1, 1))

    def limit(**motion):
        shape = motion.pop("shape", substep.Sphere(0.2, (4, 0.5, 0.5)))
        colliders = [substep.Collider(shape, **motion)]
        if make is substep.GridFlow:
            return make(box, 1 / 8, colliders=colliders).step_limit()[0]
        x = substep.fill_box((0, 0, 0), (1, 1, 0.5), 1 / 16)
        return make(x, cell=1 / 8, bounds=box, colliders=colliders).step_limit()[0]

    alone = limit()
    assert limit(velocity=(5, 0, 0), angular_velocity=(0, 100, 0)) == alone
    assert limit(velocity=(-500, 0, 0)) < alone
    ground = substep.Plane((0.5, 0.5, 0), (0, 0, 1))
    assert limit(shape=ground, angular_velocity=(0, 0, 100)) < 0.2 * alone


@pytest.mark.parametrize("shift", [(0, 0, 0), (0.3, 0.2, 0.4)])
@pytest.mark.parametrize(
    ("radius", "height", "most"), [(10, 4, 0.08), (10, 6, 0.08), (5, 2, 0.12), (5, 3, 0.25)]
)
def test_still_water_in_a_round_tank_stands_at_its_height(radius, height, most, shift):
    """Above the middle, where walls lean over the surface: what stands in the wedge between them
    stays there. In cells."""
    n = 2 * radius + 6
    middle = n / 2 + np.array(shift)
    tank = substep.Collider(substep.Sphere(radius, middle), hollow=True)
    x = substep.fill_box((0, 0, 0), (n, n, n), 0.5)
    x = x[(tank.distance(x) > 0) & (x[:, 2] < middle[2] + height)]
    liquid = substep.GridLiquid(x, cell=1.0, bounds=((0, 0, 0), (n, n, n)), colliders=[tank])
    liquid.advance(8)
    # The height at which a cap of the ball has as much volume, by Newton's method.
    level = float(height)
    for _ in range(20):
        cap = math.pi * (radius + level) ** 2 * (2 * radius - level) / 3
        level -= (cap - len(x) / 8) / (math.pi * (radius**2 - level**2))
    around = np.arange(int(middle[0]) - radius // 2, int(middle[0]) + radius // 2)
    columns = liquid.level_set[around][:, around].reshape(-1, n)
    top = n - 1 - (columns[:, ::-1] < 0).argmax(axis=1)  # the highest cell in the liquid
    rows = np.arange(len(top))
    inside, above = columns[rows, top], columns[rows, top + 1]
    found = np.mean(top + 0.5 + inside / (inside - above)) - middle[2]
    assert found == pytest.approx(level, abs=most)


@pytest.mark.parametrize("degrees", [25, 30, 35])
def test_still_water_rests_on_a_beach(degrees):
    """Its tip on a floor that leans away is held: it used to shoot up the floor, at 2 m/s."""
    angle, cell = math.radians(degrees), 0.05
    beach = substep.Collider(substep.Plane((-math.sin(angle), 0, math.cos(angle)), (0.4, 0, 0)))
    x = substep.fill_box((0, 0, 0), (1.6, 0.2, 0.25), cell / 2)
    liquid = substep.GridLiquid(
        x[beach.distance(x) > 0], cell=cell, bounds=((0, 0, 0), (1.6, 0.2, 0.6)), colliders=[beach]
    )
    liquid.advance(3)
    assert np.sqrt(np.mean(liquid.velocities**2)) < 0.03
    assert np.abs(liquid.velocities).max() < 0.3
    assert liquid.positions[:, 2].max() < 0.26
