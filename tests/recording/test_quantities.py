"""Quantities of any simulation: their integrals are what momentum says; what is wrong is named."""

import numpy as np
import pytest
import substep
from substep import InputError, Logger
from substep.recording import diagnostics, forces, gauges

G = 9.81


def basin(**options):
    """Water that falls into a tank, which is all that touches it."""
    tank = substep.Collider(substep.Box((0.4, 0.4, 4), (0.2, 0.2, 2)), hollow=True)
    x = substep.fill_box((0, 0, 0.1), (0.4, 0.2, 0.5), 0.05)
    liquid = substep.PositionBasedFluid(x, 0.05, colliders=[tank], dtype="float64", **options)
    return liquid, tank


@pytest.mark.parametrize(("every", "calls"), [(None, 3), (0.02, 1)])
def test_the_integral_of_the_force_is_the_change_of_momentum(every, calls):
    water, tank = basin()
    log = Logger(forces({"tank": tank}), every=every)
    log(water)
    for _ in range(calls):
        water.advance(0.3 / calls, log)
    force, spans = log["tank_force"], np.diff(log.times)
    assert np.isnan(force[0]).all() and log["tank_torque"].shape == force.shape == (len(log), 3)
    assert len(log) == 16 if every else len(log) > 40
    given = (force[1:] * spans[:, None]).sum(axis=0)
    weight = np.array([0, 0, -G * water.masses.sum() * 0.3])
    momentum = water.masses @ water.velocities
    assert -given == pytest.approx(momentum - weight, abs=1e-9 * abs(weight[2]))
    # What was exerted where the logger did not look is left out, not counted to the next sample.
    water.advance(0.1)
    before = log.times[-1]
    water.advance(0.02, log)
    after = log.times > before
    alone = (force := log["tank_force"][after]) * np.diff([0.4, *log.times[after]])[:, None]
    assert len(force) and alone.sum(axis=0) == pytest.approx(tank.impulse, rel=1e-9, abs=1e-12)


def test_a_tank_at_rest_bears_its_weight_and_a_gauge_reads_its_depth():
    d = 0.05
    tank = substep.Collider(substep.Box((0.4, 0.4, 4), (0.2, 0.2, 2)), hollow=True)
    x = substep.fill_box((0, 0, 0), (0.4, 0.4, 0.4), d)
    water = substep.PositionBasedFluid(x, d, colliders=[tank], divergence_free=True)
    energies = diagnostics("kinetic_energy", "gravitational_energy")
    log = Logger(
        {**forces({"tank": tank}), **gauges({"g1": (0.2, 0.2), "off": (3, 3)}, 1.5 * d), **energies}
    )
    water.advance(1.0)
    water.advance(1.0, log)
    load = np.average(log["tank_force"][:, 2]) / (-G * water.masses.sum())
    assert load == pytest.approx(1, abs=0.02)
    assert np.mean(log["g1"]) == pytest.approx(0.4 - d / 2, abs=d / 2)
    assert np.isnan(log["off"]).all()
    potential = water.masses.sum() * G * water.positions[:, 2].mean()
    assert log["gravitational_energy"][-1] == pytest.approx(potential, rel=1e-5)
    assert set(log.columns()) >= {"time", "tank_force[2]", "g1", "kinetic_energy"}


def test_what_is_wrong_is_named():
    water, _tank = basin()
    for call, error, told in (
        (lambda: forces({}), InputError, "colliders: expected at least one"),
        (lambda: forces(3), TypeError, "colliders: expected a mapping"),
        (lambda: forces({"a": substep.Plane()}), TypeError, "colliders.'a'.: expected a Collider"),
        (lambda: gauges({}, 0.1), InputError, "places"),
        (lambda: gauges({"a": (1, 2)}, 0.0), InputError, "radius"),
        (lambda: gauges({"a": (1, 2, 3)}, 0.1), InputError, "places.'a'.: expected x, or x and y"),
        (lambda: Logger(gauges({"a": (1,)}, 0.1))(water), InputError, "places.'a'.: expected 2"),
        (lambda: Logger({"a b": lambda water: 0}), InputError, "got ' ' in 'a b'"),
        (lambda: Logger({"a.": lambda water: 0}), InputError, "expected 1 to 64"),
        (lambda: Logger({"..": lambda water: 0}), InputError, "expected 1 to 64"),
        (lambda: diagnostics(), InputError, "names"),
        (lambda: diagnostics(3), TypeError, "names"),
        (lambda: Logger(diagnostics("energi"))(water), InputError, "energi: expected one of"),
    ):
        with pytest.raises(error, match=told):
            call()


def test_numbers_of_a_member_of_a_world(tmp_path):
    bodies = substep.RigidBodies(step=1 / 60)
    bodies.add(substep.Sphere(0.1), (0, 0, 10))
    world = substep.World({"bodies": bodies})
    log = Logger(diagnostics("bodies.kinetic_energy", "energy"))
    world.advance(0.1, log)
    assert log["bodies.kinetic_energy"][-1] == bodies.diagnostics()["kinetic_energy"]
    log.to_csv(tmp_path / "log.csv")
    assert (tmp_path / "log.csv").read_text().startswith("time,bodies.kinetic_energy,energy\n")
