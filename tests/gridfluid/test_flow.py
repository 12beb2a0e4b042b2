"""Flows that fill their box: what the protocol does not say, and what goes wrong."""

import math

import numpy as np
import pytest
import substep
from substep.gridfluid import FlowEmitter, Inflow, Wall

SQUARE = [(0.0, 0.0), (1.0, 1.0)]
BALL = substep.Sphere(0.15, (0.5, 0.5, 0.0))


def content(flow):
    return substep.state_hash(*(np.asarray(value) for _, value in sorted(flow.state().items())))


def vortex(n, viscosity, advection="central", steady=0.0, dtype="float64"):
    """Taylor and Green's vortex in a periodic square, carried along by a steady flow."""

    def velocity(x):
        u = np.cos(x[:, 0]) * np.sin(x[:, 1]) + steady
        return np.stack([u, -np.sin(x[:, 0]) * np.cos(x[:, 1])], axis=1)

    return substep.GridFlow(
        [(0, 0), (2 * math.pi, 2 * math.pi)],
        2 * math.pi / n,
        velocity=velocity,
        viscosity=viscosity,
        sides="periodic",
        advection=advection,
        tolerance=1e-6,
        dtype=dtype,
    )


def plume(n=12, d=3, **options):
    """Hot smoke that rises past a ball, symmetric about the middle."""
    ball = substep.Sphere(0.12, (0.5, 0.5, 0.5) if d == 3 else (0.5, 0.5, 0))
    hot = substep.Sphere(0.15, (0.5, 0.5, 0.2) if d == 3 else (0.5, 0.2, 0))
    return substep.GridFlow(
        [[0] * d, [1] * (d - 1) + [1.5]],
        1 / n,
        colliders=[ball],
        sides=["wall"] * (d - 1) + [("wall", "open")],
        emitters=[FlowEmitter(hot, smoke=1.0, temperature=10.0)],
        **(
            {
                "smoke": 0.0,
                "temperature": 0.0,
                "thermal_expansion": 0.02,
                "viscosity": 1e-3,
                "thermal_diffusivity": 1e-3,
            }
            | options
        ),
    )


# ---------------------------------------------------------------------------- the projection


def test_steps_leave_no_divergence_beyond_the_tolerance():
    flow = plume(tolerance=1e-6, dtype="float64")
    flow.advance(0.2)
    values = flow.diagnostics()
    # Of what the step makes, of the order of the speed over a cell.
    assert values["divergence"] < 1e-4 * values["speed"] * 12
    assert values["residual"] <= 1e-6


def test_rest_stays_rest_and_carries_nothing():
    flow = substep.GridFlow(SQUARE, 0.1, colliders=[BALL], smoke=0.5, viscosity=0.1)
    flow.advance(0.1)
    assert not flow.velocity.any()
    assert np.allclose(flow.smoke, 0.5, atol=1e-6)


def test_what_has_a_divergence_is_taken_from_a_given_velocity():
    flow = substep.GridFlow(SQUARE, 0.1, velocity=lambda x: x, tolerance=1e-8, dtype="float64")
    assert flow.diagnostics()["speed"] < 1e-6  # a gradient through and through


# ---------------------------------------------------------------------------- order and viscosity


BOXES = {
    "closed": "wall",
    "periodic": "periodic",
    "open": "open",
    "chimney": [("wall", "open"), "periodic", ("open", "wall")],
    "channel": ["wall", "wall", "periodic"],  # with a flow through it
}


def stirred(name, d, dtype="float64", n=(12, 7, 10), **options):
    """Velocities by chance in one of the boxes."""
    sides = [BOXES[name]] * d if isinstance(BOXES[name], str) else BOXES[name][:d]
    if name == "channel":
        sides[0] = (Inflow((1.0, 0.0, 0.0)[:d]), "open")
    bounds = [(0,) * d, [0.1 * m for m in n[:d]]]
    velocity = np.random.default_rng(4).uniform(-1, 1, (*n[:d], d))
    return substep.GridFlow(bounds, 0.1, velocity=velocity, sides=sides, dtype=dtype, **options)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name", BOXES)
def test_boxes_without_obstacles_are_projected_to_rounding(name, d):
    for dtype, rounding in (("float64", 1e-15), ("float32", 1e-7)):
        flow = stirred(name, d, dtype, tolerance=0.5)
        for _ in range(2):
            assert flow.report.solver == "transform"
            assert flow.report.iterations == 1
            assert flow.report.residual < 1e-12
            found = flow.diagnostics()
            assert found["divergence"] < 30 * rounding * found["speed"] / flow.cell
            flow.step(0.05)


@pytest.mark.parametrize("name", BOXES)
def test_transforms_and_multigrid_find_the_same_flow(name):
    away = substep.Sphere(0.1, (9, 9, 9))
    flows = [stirred(name, 3, colliders=c, tolerance=1e-12) for c in ((), (away,))]
    for flow in flows:
        flow.step(0.02)
    assert [flow.report.solver for flow in flows] == ["transform", "multigrid"]
    for field in ("velocity", "pressure"):
        direct, iterated = (getattr(flow, field) for flow in flows)
        np.testing.assert_allclose(direct, iterated, atol=1e-9 * np.abs(iterated).max())


def test_cells_with_a_large_prime_factor_are_left_to_multigrid():
    assert stirred("closed", 2, n=(17, 8)).report.solver == "multigrid"
    assert stirred("closed", 2, n=(26, 8)).report.solver == "transform"


def error(flow, viscosity, steady=0.0, duration=math.pi / 2):
    """The largest error of u after a time, by the exact solution (formula in fluid.json)."""
    step = 0.4 * flow.cell / (1 + steady)
    flow.step_size = duration / math.ceil(duration / step)
    flow.advance(duration)
    x = flow.positions_of(0)
    u = (
        np.cos(x[..., 0] - steady * duration)
        * np.sin(x[..., 1])
        * math.exp(-2 * viscosity * duration)
    )
    return float(np.abs(flow.velocity_faces[0] - steady - u).max())


@pytest.mark.parametrize(("viscosity", "steady"), [(0.05, 0.0), (0.01, 1.0)])
def test_central_fluxes_are_of_second_order(viscosity, steady):
    errors = [error(vortex(n, viscosity, steady=steady), viscosity, steady) for n in (16, 32, 64)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (orders > 1.7).all(), errors


@pytest.mark.parametrize(
    ("advection", "most"), [("central", 2e-3), ("maccormack", 0.03), ("semi_lagrangian", 0.05)]
)
def test_numerical_viscosity(advection, most, record_property):
    """Of 32 cells a wave, at one cell a step, from the decay of energy without viscosity."""
    flow = vortex(32, 0.0, advection)
    before = flow.diagnostics()["kinetic_energy"]
    flow.step_size = math.pi / 16
    flow.advance(math.pi)
    viscosity = -math.log(flow.diagnostics()["kinetic_energy"] / before) / (4 * math.pi)
    record_property("numerical_viscosity", viscosity)
    assert abs(viscosity) < most


def disk(x):
    """Zalesak's disk (geometry in fluid.json): 1 in it, 0 in its slot and around."""
    x, y = x[:, 0] - 0.5, x[:, 1] - 0.75
    slot = (np.abs(x) < 0.025) & (y < 0.1)
    return ((np.hypot(x, y) < 0.15) & ~slot).astype(float)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("advection", "most"), [("central", 0.15), ("maccormack", 0.7), ("semi_lagrangian", 1.0)]
)
def test_zalesaks_disk_turns_once(advection, most, record_property):
    """Area of what is above a half, and the symmetric difference, after a turn of 2 pi."""
    n = 100

    def turn(x):
        return np.stack([0.5 - x[:, 1], x[:, 0] - 0.5], axis=1)

    flow = substep.GridFlow(
        SQUARE, 1 / n, velocity=turn, sides="open", smoke=disk, advection=advection
    )
    # The velocity is given anew in each step: it is the scalar that is looked at.
    start = flow.smoke > 0.5
    state = flow.state()
    steps = 628 if advection == "central" else 314
    for _ in range(steps):
        flow.step(2 * math.pi / steps)
        flow.restore(flow.state() | {k: v for k, v in state.items() if k.startswith("velocity")})
    end = flow.smoke > 0.5
    area, difference = end.sum() / start.sum(), (end ^ start).sum() / start.sum()
    record_property("area", float(area))
    record_property("difference", float(difference))
    assert difference < most
    if advection == "central":
        assert flow.smoke.min() > -1e-4 and flow.smoke.max() < 1 + 1e-4


# ---------------------------------------------------------------------------- symmetry, bits


@pytest.mark.parametrize("advection", ["central", "maccormack", "semi_lagrangian"])
def test_symmetric_scenes_stay_symmetric(advection):
    flow = plume(d=2, n=20, advection=advection, dtype="float64", tolerance=1e-9)
    flow.advance(0.5)
    assert flow.smoke.max() > 0.9
    assert np.abs(flow.smoke - flow.smoke[::-1]).max() < 1e-6
    assert np.abs(flow.velocity[..., 1] - flow.velocity[::-1, :, 1]).max() < 1e-6


@pytest.mark.parametrize("advection", ["central", "maccormack"])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_bits_do_not_depend_on_threads_and_go_through_a_checkpoint(advection, dtype, tmp_path):
    found = set()
    for threads in (1, 2, 3):
        flow = plume(advection=advection, dtype=dtype, threads=threads, vorticity_confinement=0.01)
        flow.advance(0.1)
        flow.save(tmp_path / "flow")
        other = plume(advection=advection, dtype=dtype, vorticity_confinement=0.01)
        other.load(tmp_path / "flow")
        assert content(other) == content(flow)
        flow.advance(0.1)
        other.advance(0.1)
        assert content(other) == content(flow)
        found.add(content(flow))
    assert len(found) == 1


# ---------------------------------------------------------------------------- sides, obstacles


@pytest.mark.parametrize("advection", ["central", "maccormack"])
def test_internal_waves_neither_grow_nor_die(advection):
    """In a stratified box, omega^2 = N^2 k^2 / (k^2 + l^2), in 30 steps a period."""

    def temperature(x):
        return 10 * x[:, 1] + 0.1 * np.cos(np.pi * x[:, 0]) * np.sin(np.pi * x[:, 1])

    flow = substep.GridFlow(
        [(0, 0), (1, 1)],
        1 / 32,
        gravity=(0, -1),
        temperature=temperature,
        thermal_expansion=0.1,
        sides=Wall(slip=True),
        advection=advection,
        dtype="float64",
    )
    x, y = np.moveaxis(flow.positions_of(), -1, 0)
    mode = np.cos(np.pi * x) * np.sin(np.pi * y)

    def amplitude():
        return 4 * ((flow.temperature - 10 * y) * mode).mean() / 0.1

    step = 2 * np.pi / math.sqrt(0.5) / 30
    for _ in range(15):
        flow.step(step)
    assert amplitude() == pytest.approx(-1, abs=0.05)
    for _ in range(15):
        flow.step(step)
    assert amplitude() == pytest.approx(1, abs=0.08)


def test_an_obstacle_that_reaches_into_a_wall_goes_through_a_checkpoint(tmp_path):
    def pushed():
        ball = substep.Collider(substep.Sphere(0.12, (0.85, 0.6, 0)), velocity=(0.2, 0, 0))
        return substep.GridFlow(SQUARE, 1 / 12, colliders=[ball], sides=["wall", ("wall", "open")])

    flow, other = pushed(), pushed()
    for _ in range(40):
        flow.step(0.02)
    flow.save(tmp_path / "flow")
    other.load(tmp_path / "flow")
    for _ in range(2):
        assert content(other) == content(flow)
        flow.step(0.02), other.step(0.02)


def test_flow_between_plates_is_a_parabola():
    """u = y (1 - y) / (2 nu) dp/dx: the mean is 1 of an inflow of 1, the largest 1.5."""
    flow = substep.GridFlow(
        [(0, 0), (4, 1)],
        1 / 16,
        viscosity=0.1,
        velocity=(1.0, 0.0),
        sides=[(Inflow((1.0, 0.0)), "open"), "wall"],
        largest_step=0.05,
    )
    flow.advance(6.0)
    y = (np.arange(16) + 0.5) / 16
    assert np.allclose(flow.velocity_faces[0][48], 6 * y * (1 - y), atol=0.02)
    slope = np.diff(flow.pressure[40:56, 8]) / flow.cell
    assert np.allclose(slope, -12 * 0.1, rtol=0.03)


def test_a_lid_drives_and_slip_walls_do_not_brake():
    lid = Wall(velocity=(1.0, 0.0))
    flow = substep.GridFlow(
        SQUARE, 1 / 8, viscosity=1.0, sides=["periodic", ("wall", lid)], largest_step=0.05
    )
    flow.advance(2.0)  # Couette's flow
    y = (np.arange(8) + 0.5) / 8
    assert np.allclose(flow.velocity_faces[0][3], y, atol=1e-3)
    free = substep.GridFlow(
        SQUARE, 1 / 8, viscosity=1.0, velocity=(1.0, 0.0), sides=["periodic", Wall(slip=True)]
    )
    free.advance(0.5)
    assert np.allclose(free.velocity[..., 0], 1.0, atol=1e-5)


def test_a_wall_conducts_heat():
    """Between two temperatures the profile is a line; a flux makes its slope."""
    walls = (Wall(temperature=1.0), Wall(heat_flux=0.5))
    flow = substep.GridFlow(
        SQUARE,
        1 / 8,
        sides=["periodic", walls],
        temperature=1.0,
        thermal_diffusivity=0.5,
        largest_step=0.05,
    )
    flow.advance(8.0)
    y = (np.arange(8) + 0.5) / 8
    assert np.allclose(flow.temperature[3], 1 + y, atol=2e-3)


def test_smoke_is_kept():
    closed = substep.GridFlow(
        SQUARE,
        1 / 16,
        colliders=[BALL],
        velocity=lambda x: np.stack([-np.cos(3 * x[:, 1]), np.sin(5 * x[:, 0])], axis=1),
        smoke=lambda x: (x[:, 0] < 0.4).astype(float),
        advection="central",
        tolerance=1e-7,
    )
    before = closed.smoke[closed.in_fluid].sum()
    closed.advance(0.5)
    assert closed.smoke[closed.in_fluid].sum() == pytest.approx(before, rel=1e-4)
    assert closed.smoke.min() > -1e-5 and closed.smoke.max() < 1 + 1e-5


def test_a_uniform_flow_pushes_what_it_meets():
    """The drag of a still ball, and that of one that moves, in a frame where the flow rests."""
    forces = []
    for speed in (0.0, 1.0):
        ball = substep.Collider(BALL, velocity=(-speed, 0, 0))
        ball.position = (0.5 + 0.1 * speed, 0.5, 0)
        u = 1.0 - speed
        flow = substep.GridFlow(
            [(-1, 0), (2, 1)],
            1 / 20,
            viscosity=0.05,
            velocity=(u, 0.0),
            colliders=[ball],
            sides=[(Inflow((u, 0.0)), "open"), Wall(slip=True)],
        )
        flow.advance(0.1)
        flow.advance(0.05)
        forces.append(ball.impulse[0] / ball.duration)
    assert forces[0] > 0.1
    assert forces[1] == pytest.approx(forces[0], rel=0.15)


# ---------------------------------------------------------------------------- bad input


def raises(match, **options):
    arguments = {"bounds": SQUARE, "cell": 0.1} | options
    with pytest.raises((substep.InputError, TypeError), match=match):
        substep.GridFlow(**arguments)


def test_wrong_arguments_are_refused_by_name():
    raises("cell", cell=0.0)
    raises("cell", cell=math.nan)
    raises("bounds", bounds=[(0, 0), (0, 1)])
    raises("bounds", cell=0.3)
    raises("bounds.*2 cells", bounds=[(0, 0), (0.1, 1)])
    raises("velocity", velocity=np.full((10, 10, 2), math.nan))
    raises("velocity", velocity=np.zeros((10, 9, 2)))
    raises("viscosity", viscosity=-1.0)
    raises("cfl", cfl=0.0)
    raises("advection", advection="upwind")
    raises("sides", sides=["wall"])
    raises(r"sides\[0\]", sides=[("periodic", "wall"), "wall"])
    raises(r"sides\[1\]: velocity", sides=["wall", Wall(velocity=(0.0, 1.0))])
    raises(r"emitters\[0\].*smoke", emitters=[FlowEmitter(BALL, smoke=1.0)])
    raises("tolerance", tolerance=0.0)


def test_a_grid_beyond_the_memory_is_refused():
    with pytest.raises(MemoryError):
        substep.GridFlow([(0, 0, 0), (1, 1, 1)], 1 / 1200, dtype="float64")


def test_no_fluid_and_closed_boxes_with_inflow_are_refused():
    raises("no fluid", colliders=[substep.Box((9, 9, 9))])
    raises("more flow into the closed box", sides=[(Inflow((1.0, 0.0)), "wall"), "wall"])
    raises(
        "closed",
        colliders=[substep.Box((0.2, 9, 9), (0.5, 0.5, 0))],
        sides=[(Inflow((1.0, 0.0)), "open"), "wall"],
        viscosity=0.1,
    )


def test_a_piston_that_squeezes_a_closed_box_raises_and_changes_nothing():
    piston = substep.Collider(substep.Box((0.3, 9, 9), (0.0, 0.5, 0)))
    flow = substep.GridFlow(SQUARE, 0.1, colliders=[piston])
    piston.velocity = (1.0, 0, 0)
    before = content(flow)
    with pytest.raises(substep.SolverError, match="closed"):
        flow.step(0.01)
    assert content(flow) == before


def test_a_pressure_that_does_not_converge_raises_and_changes_nothing():
    flow = plume(tolerance=1e-14, max_iterations=1)
    before = content(flow)
    with pytest.raises(substep.ConvergenceError) as caught:
        flow.step(0.05)
    assert caught.value.time == pytest.approx(0.05)
    assert content(flow) == before


def test_huge_steps_are_finite_or_raise():
    for advection in ("central", "maccormack", "semi_lagrangian"):
        flow = vortex(16, 0.0, advection, dtype="float32")
        before = content(flow)
        try:
            flow.step(1e6)
        except substep.SolverError:
            assert content(flow) == before
        else:
            assert np.isfinite(flow.velocity).all()


@pytest.mark.parametrize("advection", ["central", "maccormack"])
def test_the_shortest_step_keeps_the_pressure(advection):
    flow = plume(advection=advection)
    flow.advance(0.1)
    before = flow.pressure
    assert before.any()
    flow.step(5e-324)
    assert np.array_equal(flow.pressure, before)
    flow.step(0.01)
    assert np.isfinite(flow.pressure).all()


def test_paths_take_steps_of_many_cells():
    flow = vortex(32, 0.0, "maccormack", dtype="float32")
    flow.step_size = 5 * flow.cell
    before = flow.diagnostics()["kinetic_energy"]
    flow.advance(20 * flow.cell)
    assert 0.3 * before < flow.diagnostics()["kinetic_energy"] <= before


def test_vorticity_of_what_turns_and_of_waves():
    """Exact for a rigid rotation, and by the symbol of central differences for waves."""
    turning = substep.GridFlow(SQUARE, 0.1, velocity=lambda x: np.stack([-x[:, 1], x[:, 0]], 1))
    inside = substep.GridFlow(
        SQUARE, 0.1, velocity=lambda x: np.stack([-x[:, 1], x[:, 0]], 1), sides="open"
    )
    np.testing.assert_allclose(inside.vorticity, 2.0, rtol=1e-4)
    assert abs(turning.vorticity.mean()) < 2  # walls stop it
    k, h = 2 * np.pi, 1 / 16
    wave = substep.GridFlow(
        [(0, 0, 0), (1, 1, 1)], h, sides="periodic", dtype="float64",
        velocity=lambda x: np.stack([np.sin(k * x[:, 2]), 0 * x[:, 0], np.sin(k * x[:, 1])], 1),
    )  # fmt: skip
    at = wave.positions_of()
    slope = np.sin(k * h) / h
    expected = np.stack(
        [slope * np.cos(k * at[..., 1]), slope * np.cos(k * at[..., 2]), 0 * at[..., 0]], axis=-1
    )
    np.testing.assert_allclose(wave.vorticity, expected, atol=1e-9)
    np.testing.assert_array_equal(wave.fields()["vorticity"][0], wave.vorticity)


# ---------------------------------------------------------------------------- what sides hold


def through(n=16, **options):
    """A flow from an inflow at the left to an open side at the right, past a ball."""
    return substep.GridFlow(
        SQUARE,
        1 / n,
        sides=[(Inflow((1.0, 0.0)), "open"), "wall"],
        viscosity=0.3,
        colliders=[BALL],
        dtype="float64",
        **options,
    )


def test_smoke_that_weighs_nothing_changes_no_flow():
    plain, carrying = through(), through(smoke=0.0)
    for _ in range(10):
        plain.step(0.01)
        carrying.step(0.01)
    np.testing.assert_array_equal(plain.velocity, carrying.velocity)
    np.testing.assert_array_equal(plain.pressure, carrying.pressure)


@pytest.mark.parametrize("advection", ["central", "maccormack"])
@pytest.mark.parametrize("diffusivity", [0.01, 1.0])
def test_smoke_stays_within_its_bounds_where_flow_enters_by_open_sides(advection, diffusivity):
    flow = substep.GridFlow(
        SQUARE,
        1 / 16,
        velocity=(1.0, 0.0),
        smoke=lambda x: (x[:, 0] > 0.5).astype(float),
        smoke_diffusivity=diffusivity,
        sides=["open", "periodic"],
        advection=advection,
    )
    for _ in range(40):
        flow.step(0.02)
    assert flow.smoke.min() > -1e-3 and flow.smoke.max() < 1 + 1e-3


def test_what_leaves_by_an_inflow_takes_its_temperature_along():
    flow = substep.GridFlow(
        SQUARE,
        1 / 16,
        velocity=(1.0, 0.0),
        temperature=300.0,
        thermal_diffusivity=0.1,
        sides=[(Inflow((1.0, 0.0), temperature=300.0), Inflow((1.0, 0.0))), "wall"],
    )
    flow.advance(0.5)
    np.testing.assert_allclose(flow.temperature, 300.0, rtol=1e-5)


@pytest.mark.parametrize("options", [{}, {"temperature": 0.0}, {"thermal_diffusivity": 0.1}])
def test_a_flux_of_heat_needs_something_that_conducts_it(options):
    with pytest.raises(substep.InputError, match=r"heat_flux.*thermal_diffusivity"):
        substep.GridFlow(SQUARE, 1 / 8, sides=Wall(heat_flux=1.0), **options)


def test_a_step_in_which_more_diffuses_than_float32_holds_is_refused():
    options = {"temperature": lambda x: np.sin(30 * x[:, 0]), "thermal_diffusivity": 100.0}
    flow = substep.GridFlow(SQUARE, 1 / 32, largest_step=1.0, **options)
    flow.step(0.001)
    before, report = content(flow), flow.report
    with pytest.raises(substep.SolverError, match=r"steps of at most 0\.039.*float64"):
        flow.step(0.05)
    assert content(flow) == before
    assert flow.report.residual == report.residual and flow.report.converged
    assert flow.step_limit() == (pytest.approx(4e3 / 32**2 / 100), "diffusion")
    flow.advance(0.1)
    assert abs(flow.temperature).max() < 0.1
