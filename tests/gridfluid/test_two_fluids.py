"""Flows of two densities: at rest, in waves, and where the heavy fluid is on top."""

import math

import numpy as np
import pytest
import substep
from substep.gridfluid import Inflow, Wall

SQUARE = [(0.0, 0.0), (1.0, 1.0)]
SLIP = Wall(slip=True)
BALL = substep.Sphere(0.21, (0.5, 0.5, 0.0))


def layers(n, lower, upper, surface, lengths=(1.0, 1.0), **options):
    """A fluid of density `lower` below surface(x), and one of `upper` above."""
    d = len(lengths)

    def smoke(x):
        return np.clip(0.5 + (surface(x[:, 0]) - x[:, -1]) * n, 0, 1)

    return substep.GridFlow(
        [(0.0,) * d, lengths],
        1 / n,
        density=upper,
        smoke_density=lower,
        smoke=smoke,
        **(
            {
                "gravity": (*[0.0] * (d - 1), -1.0),
                "advection": "central",
                "sides": SLIP,
                "threads": 1,
            }
            | options
        ),
    )


def content(flow):
    return substep.state_hash(*(np.asarray(value) for _, value in sorted(flow.state().items())))


# ---------------------------------------------------------------------------- at rest


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("ratio", [3.0, 1000.0, 1e-3])
@pytest.mark.parametrize("options", [{}, {"colliders": [BALL], "viscosity": 0.01}])
def test_layers_at_rest_stay_at_rest(d, ratio, options):
    """p' = (rho - rho_0) g z of each layer, whatever is light or heavy, around obstacles too."""
    flow = layers(
        16,
        ratio,
        1.0,
        lambda x: 0.55 + 0 * x,
        lengths=(1.0,) * d,
        tolerance=1e-10,
        dtype="float64",
        **options,
    )
    before = flow.smoke
    for _ in range(5):
        flow.step(0.02)
    assert flow.diagnostics()["speed"] < 1e-8 * abs(ratio - 1)
    assert np.allclose(flow.smoke[flow.in_fluid], before[flow.in_fluid], atol=1e-8)
    column = (0,) * (d - 1)
    # Half of the cells beside a face each, so that the cell of the surface has both densities.
    rho = flow.densities[column] - 1
    fall = (rho[1:] + rho[:-1]) / 2 * flow.cell
    assert np.diff(flow.pressure[column]) == pytest.approx(-fall, rel=1e-6, abs=1e-7)


def test_a_body_is_lifted_by_what_it_displaces_beyond_the_first_fluid():
    body = substep.Collider(substep.Sphere(0.2, (0.5, 0.4, 0.0)))
    flow = layers(40, 3.0, 1.0, lambda x: 0.8 + 0 * x, colliders=[body], tolerance=1e-8)
    flow.step(0.01)
    lift = body.impulse / body.duration
    assert lift[1] == pytest.approx((3.0 - 1.0) * math.pi * 0.2**2, rel=0.03)
    assert abs(lift[0]) < 1e-4 * lift[1]


# ---------------------------------------------------------------------------- one fluid of the two


def test_one_of_the_fluids_alone_is_a_flow_of_its_density():
    """Drag, pressure and energy past a body are those of a flow of one density."""

    def channel(**options):
        body = substep.Collider(substep.Box((0.2, 0.2, 1), (0.7, 0.5, 0)))
        flow = substep.GridFlow(
            [(0, 0), (2, 1)],
            1 / 20,
            viscosity=0.01,
            velocity=(1.0, 0.0),
            sides=[(Inflow((1.0, 0.0), smoke=1.0), "open"), SLIP],
            colliders=[body],
            gravity=(0, 0),
            tolerance=1e-9,
            dtype="float64",
            **options,
        )
        for _ in range(20):
            flow.step(0.02)
        return flow, body.impulse

    (one, drag), (two, same) = (
        channel(density=3.0, smoke=1.0),
        channel(density=2.0, smoke_density=3.0, smoke=1.0),
    )
    assert same == pytest.approx(drag, rel=1e-5, abs=1e-9)
    assert np.allclose(two.pressure, one.pressure, atol=1e-5)
    assert np.allclose(two.velocity, one.velocity, atol=1e-6)
    found, expected = two.diagnostics(), one.diagnostics()
    for name in ("kinetic_energy", "momentum_x"):
        assert found[name] == pytest.approx(expected[name], rel=1e-6)


# ---------------------------------------------------------------------------- waves


def rate(k, lower, upper, below, above):
    """omega^2 of small waves between walls: Lamb, "Hydrodynamics", 1932, art. 231."""
    return k * (lower - upper) / (lower / math.tanh(k * below) + upper / math.tanh(k * above))


def amplitude(flow):
    n = flow.shape[0]
    height = flow.smoke.sum(axis=1) * flow.cell
    return 2 * np.mean((height - height.mean()) * np.cos(math.pi * (np.arange(n) + 0.5) / n))


def wave(n, lower, upper, depths, height, steps):
    return layers(
        n,
        lower,
        upper,
        lambda x: depths[0] + height / n * np.cos(math.pi * x),
        lengths=(1.0, sum(depths)),
        tolerance=1e-5,
        **steps,
    )


def check_converges(errors):
    """To the closed form, about as fast as the layer of mixed cells gets thin."""
    assert errors[1] < 0.025 and errors[1] < 0.7 * errors[0], errors


@pytest.mark.parametrize(
    ("lower", "upper", "depths"),
    [(1000.0, 800.0, (0.5, 0.5)), (3.0, 1.0, (0.25, 0.75)), (1000.0, 1.0, (0.25, 0.25))],
)
def test_waves_between_two_fluids_swing_with_their_period(lower, upper, depths):
    quarter = math.pi / 2 / math.sqrt(rate(math.pi, lower, upper, *depths))
    errors = []
    for n in (32, 64):
        flow = wave(n, lower, upper, depths, 1.0, {"largest_step": 0.5 / n})
        flow.advance(0.95 * quarter)
        early = amplitude(flow)
        flow.advance(0.1 * quarter)
        late = amplitude(flow)
        errors.append(abs(0.95 + 0.1 * early / (early - late) - 1))
    check_converges(errors)


@pytest.mark.parametrize(("heavy", "depths"), [(3.0, (0.5, 0.5)), (1.5, (0.25, 0.75))])
def test_heavy_fluid_on_top_falls_at_the_rate_of_small_waves(heavy, depths):
    sigma = math.sqrt(-rate(math.pi, 1.0, heavy, *depths))
    errors = []
    for n in (32, 64):
        flow = wave(n, 1.0, heavy, depths, 0.5, {"largest_step": 0.5 / n})
        before = amplitude(flow)
        flow.advance(1.5 / sigma)
        errors.append(abs(math.acosh(amplitude(flow) / before) / 1.5 - 1))
    check_converges(errors)


# ---------------------------------------------------------------------------- falling


# He, Chen and Zhang, "A lattice Boltzmann scheme for incompressible multiphase flow", J. Comput.
# Phys. 152, 642, 1999, digitised: t sqrt(g / H), and heights of bubble and spike over 4 H.
FRONTS = [
    (1.647, 0.5806, 0.3939),
    (2.368, 0.6160, 0.3258),
    (3.021, 0.6450, 0.2652),
    (3.694, 0.6761, 0.2036),
    (4.441, 0.7102, 0.1288),
    (4.990, 0.7348, 0.0639),
]


def front(values, heights, which):
    """Where smoke passes 1/2 on its way up."""
    k = np.flatnonzero((values[:-1] < 0.5) & (values[1:] >= 0.5))[which]
    part = (0.5 - values[k]) / (values[k + 1] - values[k])
    return heights[k] + part * (heights[k + 1] - heights[k])


def fronts(n):
    """Of heavy fluid over light fluid in a box of H x 4 H, of which half is computed."""
    flow = layers(
        n,
        1.0,
        3.0,
        lambda x: 2 + 0.1 * np.cos(2 * math.pi * x),
        lengths=(0.5, 4.0),
        viscosity=1 / 256,
        sides=[SLIP, "wall"],
    )
    before = flow.diagnostics()["mass"]
    found = []
    y = flow.positions_of()[0, :, 1]
    for time, *_ in FRONTS:
        flow.advance(time - flow.time)
        below = 1 - flow.smoke  # smoke is the fluid below
        found.append([front(below[0], y, -1) / 4, front(below[-1], y, 0) / 4])
    assert flow.diagnostics()["mass"] == pytest.approx(before, rel=1e-5)
    assert flow.report.iterations <= 8
    return np.array(found)


def test_rayleigh_taylor_fronts():
    """Relative to the height of the box, and to the way of the fronts from its middle.

    The spike falls a little behind, as that of Lethe (chaos-polymtl/lethe) does.
    """
    reference = np.array(FRONTS)[:, 1:]
    off = [np.abs(fronts(n) - reference) for n in (32, 64)]
    assert off[0].max() < 0.03 and off[1].max() < 0.025, off
    way = off[1] / np.abs(reference - 0.5)
    assert way[:, 0].max() < 0.03 and way[:, 1].max() < 0.055, way


@pytest.mark.parametrize("advection", ["central", "maccormack"])
@pytest.mark.parametrize("ratio", [3.0, 10.0, 1000.0])
def test_a_column_collapses_in_what_is_lighter(ratio, advection):
    def smoke(x):
        return (x[:, 0] < 0.4) & (x[:, 1] < 0.6)

    flow = substep.GridFlow(
        SQUARE,
        1 / 32,
        density=1.0,
        smoke=smoke,
        smoke_density=ratio,
        viscosity=1e-3,
        advection=advection,
        largest_step=0.005,
    )
    before = flow.diagnostics()
    for _ in range(6):
        flow.advance(0.05)
        assert flow.report.solver == "multigrid"
        assert flow.report.iterations <= 10
        after = flow.diagnostics()
        assert after["mass"] == pytest.approx(before["mass"], rel=1e-5)
        # Densities stand half a step behind velocities, and what fell in it is counted twice.
        assert after["energy"] < 1.02 * before["energy"]
    assert -1e-3 < flow.smoke.min() and flow.smoke.max() < 1.001


# ---------------------------------------------------------------------------- protocol


def tank(**options):
    ball = substep.Collider(substep.Sphere(0.12, (0.6, 0.4, 0.0)), velocity=(0.2, 0, 0))
    return layers(
        16,
        3.0,
        1.0,
        lambda x: 0.5 + 0.1 * x,
        viscosity=1e-3,
        colliders=[ball],
        sides=["periodic", ("wall", "open")],
        emitters=[substep.gridfluid.FlowEmitter(substep.Sphere(0.1, (0.2, 0.8, 0)), smoke=1.0)],
        **options,
    )


@pytest.mark.parametrize("advection", ["central", "maccormack"])
def test_bits_do_not_depend_on_threads_and_go_through_a_checkpoint(advection, tmp_path):
    contents = []
    for threads in (1, 2, 3):
        flow = tank(advection=advection, threads=threads)
        for _ in range(3):
            flow.step(0.01)
        flow.save(tmp_path / "flow")
        for _ in range(3):
            flow.step(0.01)
        contents.append(content(flow))
    again = tank(advection=advection, threads=1)
    again.load(tmp_path / "flow")
    for _ in range(3):
        again.step(0.01)
    assert {*contents, content(again)} == {contents[0]}


def test_density_is_a_field_and_counts_in_the_diagnostics():
    flow = layers(16, 3.0, 1.0, lambda x: 0.5 + 0 * x, gravity=(0, -2.0))
    density, unit = flow.fields()["density"]
    assert unit == "kg/m^3"
    assert density[3, 0] == pytest.approx(3.0) and density[3, -1] == pytest.approx(1.0)
    values = flow.diagnostics()
    assert values["mass"] == pytest.approx(2.0)
    assert values["gravitational_energy"] == pytest.approx(2.0 * (3 * 0.125 + 0.375))
    assert values["energy"] == values["kinetic_energy"] + values["gravitational_energy"]
    flow.set_smoke(2.0)  # what is beyond 1 counts as 1
    assert (flow.densities == 3.0).all()
    assert "density" not in substep.GridFlow(SQUARE, 0.1, smoke=0.0).fields()


def test_smoke_that_is_set_anew_brings_its_pressure_along():
    flow = layers(16, 1000.0, 1.0, lambda x: 0.25 + 0 * x, dtype="float64", tolerance=1e-10)
    flow.set_smoke(lambda x: (x[:, 1] < 0.5).astype(float))
    flow.step(0.02)
    assert flow.diagnostics()["speed"] < 1e-5


def test_what_contradicts_two_fluids_is_refused_by_name():
    def raises(match, **options):
        with pytest.raises((substep.InputError, TypeError), match=match):
            substep.GridFlow(SQUARE, 0.1, **options)

    raises("smoke_density: needs smoke", smoke_density=2.0)
    raises("smoke_density", smoke=0.0, smoke_density=0.0)
    raises("smoke_density", smoke=0.0, smoke_density=math.nan)
    raises("smoke_density", smoke=0.0, smoke_density="heavy")
    raises("smoke_density: expected within a factor", smoke=0.0, smoke_density=1e6)
    full = {"smoke": 0.5, "smoke_density": 2.0, "colliders": [substep.Box((9, 9, 9))]}
    raises("no fluid", **full)
    raises("smoke_weight", smoke=0.0, smoke_density=2.0, smoke_weight=0.1)
    raises(
        "thermal_expansion", smoke=0.0, smoke_density=2.0, temperature=0.0, thermal_expansion=0.1
    )
