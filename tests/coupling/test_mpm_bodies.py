"""Bodies that yield in the material point method: momentum, weight, light bodies, friction, floats."""

import numpy as np
import pytest
import substep
from substep import mpm

G = 9.81


def yields(collider, mass, inertia=np.inf, gravity=(0, 0, -G), number=0, centre=(0, 0, 0)):
    """The collider stands for a body of this mass [kg] and moment of inertia about any axis."""
    mobility = np.diag([1 / mass] * 3 + [1 / inertia] * 3)
    acceleration = [*map(float, gravity), 0.0, 0.0, 0.0]
    collider._native.set_body(
        number, tuple(map(float, centre)), mobility.ravel().tolist(), acceleration
    )
    return collider


def received(collider):
    return np.array(collider._native.received)


def block(low, counts, spacing):
    """A lattice of particles; its corner `low` is half a spacing off the first."""
    axes = [at + spacing * (np.arange(n) + 0.5) for at, n in zip(low, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def jelly(young_modulus=1e5):
    return mpm.NeoHookean(density=1000, young_modulus=young_modulus, poisson_ratio=0.3)


def momentum(simulation):
    diagnostics = simulation.diagnostics()
    return np.array([diagnostics[f"momentum_{axis}"] for axis in "xyz"])


def elastic_and_kinetic(simulation, body, mass):
    diagnostics = simulation.diagnostics()
    own = diagnostics["kinetic_energy"] + diagnostics["elastic_energy"]
    return own + 0.5 * mass * body.velocity @ body.velocity


def falling_plate(boundary="separate", dtype="float32", threads=None, **options):
    x = block((-0.2, -0.2, 0), (16, 16, 8), 0.025)
    plate = substep.Collider(
        substep.Box((0.3, 0.3, 0.02), (0, 0, 0.225)), friction=0.4, velocity=(0.5, 0, -2)
    )
    yields(plate, 20.0, 0.4, gravity=(0, 0, 0))
    simulation = substep.MaterialPointMethod(
        x,
        jelly(),
        cell=0.05,
        volume=0.025**3,
        gravity=(0, 0, 0),
        colliders=[plate],
        boundary=boundary,
        dtype=dtype,
        threads=threads,
        **options,
    )
    return simulation, plate


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"transfer": "aflip"},
        {"transfer": "flip"},
        {"form": "textbook"},
        {"kernel": "linear"},
        {"kernel": "cubic"},
    ],
    ids=str,
)
@pytest.mark.parametrize("boundary", ["separate", "slip", "sticky"])
@pytest.mark.parametrize(("dtype", "tolerance"), [("float32", 1e-6), ("float64", 1e-12)])
def test_a_heavy_plate_and_a_jelly_exchange_momentum(options, boundary, dtype, tolerance):
    simulation, plate = falling_plate(boundary, dtype, **options)
    before = 20 * plate.velocity
    simulation.advance(0.03)
    given = received(plate)[:3]
    size = np.abs(given).max()
    assert size > 2
    assert 20 * plate.velocity - before == pytest.approx(given, abs=1e-12 * size)
    assert momentum(simulation) == pytest.approx(-given, abs=tolerance * size)
