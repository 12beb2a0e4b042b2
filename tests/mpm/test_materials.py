"""Materials of the material point method: constants, and what a simulation of any promises."""

import copy
import dataclasses
import math
import pickle

import numpy as np
import pytest
import substep
from mpm_materials import CLASSES, MATERIALS, each_material
from substep import InputError, _core, mpm

ELASTIC = {"density": 1000.0, "young_modulus": 1e4, "poisson_ratio": 0.3}


def test_every_material_of_the_core_has_a_class():
    assert set(MATERIALS) == set(_core.material_state_fields())
    assert len(MATERIALS) == len(CLASSES)


# Their constants.
@each_material
def test_constants_are_finite_numbers(name):
    material = MATERIALS[name]
    numbers = [f.name for f in dataclasses.fields(material) if f.type == "float"]
    assert "density" in numbers and len(numbers) > 1
    for constant in numbers:
        for value in (math.nan, math.inf, -math.inf):
            with pytest.raises(InputError, match=f"{constant}: expected a finite number"):
                dataclasses.replace(material, **{constant: value})
        for value in ("1000", True, None):
            with pytest.raises(TypeError, match=f"{constant}: expected a real number"):
                dataclasses.replace(material, **{constant: value})


COMMON = [
    *(({"density": value}, "density: expected a number above 0") for value in (0.0, -1.0, 1e300)),
    *(({"young_modulus": value}, "young_modulus: expected a n") for value in (0.0, -1e5, 1e300)),
    *(({"bulk_modulus": value}, "bulk_modulus: expected a n") for value in (0.0, -1e5, 1e300)),
    *(({"poisson_ratio": value}, "poisson_ratio: expected a n") for value in (0.5, 0.7, -1.0)),
    ({"poisson_ratio": 0.5 - 1e-16, "young_modulus": 1e29}, "poisson_ratio: too close to 0.5"),
    ({"yield_stress": -1.0}, "yield_stress: expected a number a"),
    ({"viscosity": -1.0}, "viscosity: expected a number at least 0"),
]


@pytest.mark.parametrize(
    ("name", "wrong", "message"),
    [
        (name, wrong, message)
        for name, material in MATERIALS.items()
        for wrong, message in COMMON
        if wrong.keys() <= vars(material).keys()
    ],
)
def test_common_constants(name, wrong, message):
    with pytest.raises(InputError, match=message):
        dataclasses.replace(MATERIALS[name], **wrong)


@pytest.mark.parametrize(
    ("kind", "wrong", "message"),
    [
        (mpm.Fluid, {"exponent": 0.0}, "exponent: expected a number at least 1"),
        (mpm.Snow, {"critical_compression": 0.0}, "critical_compression: expected a number above"),
        (mpm.Snow, {"critical_compression": 1.0}, "critical_compression: expected a number above"),
        (mpm.Snow, {"critical_stretch": -0.1}, "critical_stretch: expected a number above 0"),
        (mpm.Snow, {"hardening": -1.0}, "hardening: expected a number at least 0"),
        (mpm.Snow, {"largest_hardening": 0.5}, "largest_hardening: expected a number at least 1"),
        (mpm.Snow, {"largest_hardening": math.inf}, "largest_hardening: expected a finite"),
        (mpm.Sand, {"friction_angle": -0.1}, "friction_angle: expected a number at least 0"),
        (mpm.Sand, {"friction_angle": 30.0}, "friction_angle: expected a number .* below 1.57"),
        (mpm.Sand, {"match": "mohr"}, "match: expected one of"),
        (mpm.VonMises, {**ELASTIC, "yield_stress": 0.0}, "yield_stress: expected a number above"),
        (
            mpm.VonMises,
            {**ELASTIC, "yield_stress": 1.0, "hardening_modulus": -1.0},
            "hardening_modulus: expected a number at least 0",
        ),
        (
            mpm.HerschelBulkley,
            {**ELASTIC, "yield_stress": 1.0, "consistency": 0.0},
            "consistency: expected a number above 0",
        ),
        (
            mpm.HerschelBulkley,
            {**ELASTIC, "yield_stress": 1.0, "consistency": 1.0, "flow_index": 3.0},
            "flow_index: expected a number .* at most 2",
        ),
    ],
)
def test_constants(kind, wrong, message):
    with pytest.raises(InputError, match=message):
        kind(**wrong)


@each_material
def test_materials_are_values(name):
    """They cannot be changed, and a copy is equal to what it was made of."""
    material = MATERIALS[name]
    for field in dataclasses.fields(material):
        with pytest.raises(AttributeError):
            setattr(material, field.name, -1.0)
    assert copy.deepcopy(material) == material == pickle.loads(pickle.dumps(material))
    assert dataclasses.replace(material, density=2 * material.density) != material


# Simulations of them.
def thrown(name, dimension=3, **options):
    """A block of the material that is thrown on the ground."""
    x, volume = mpm.sample_box((0.02,) * dimension, (0.42,) * dimension, 0.025, jitter=0.2)
    ground = substep.Plane(np.roll((1, 0, 0), dimension - 1))
    options = {
        "cell": 0.05,
        "volume": volume,
        "velocities": 0.8 * np.sin(7 * x[:, ::-1]) - 0.5,
        "colliders": [substep.Collider(ground, friction=0.4)],
    } | options
    return substep.MaterialPointMethod(x, MATERIALS[name], **options)


@pytest.mark.parametrize(
    ("dimension", "integrator"),
    [(2, "symplectic_euler"), (3, "symplectic_euler"), (2, "implicit_euler")],
)
@each_material
def test_the_same_bits_for_any_number_of_threads_and_through_a_checkpoint(
    name, dimension, integrator, tmp_path
):
    hashes = set()
    for threads in (1, 2, 3):
        options = {"threads": threads, "integrator": integrator}
        simulation = thrown(name, dimension, **options)
        simulation.advance(0.04)
        if threads == 2:
            simulation.save(tmp_path / "checkpoint")
            simulation = thrown(name, dimension, **options)
            simulation.load(tmp_path / "checkpoint")
        if threads == 3:
            simulation = pickle.loads(pickle.dumps(simulation))
        simulation.advance(0.02)
        hashes.add(substep.state_hash(*simulation.state().values()))
    assert len(hashes) == 1
    assert simulation.colliders[0].impulse[-1 if dimension == 3 else 1] != 0


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@each_material
def test_wave_speed_limits_steps_at_rest(name, dtype):
    simulation = thrown(name, velocities=None, gravity=(0, 0, 0), largest_step=10.0, dtype=dtype)
    wave = 0.5 * 0.05 / MATERIALS[name].wave_speed
    assert simulation.step_limit() == (pytest.approx(wave, rel=1e-5), "elastic wave")


@each_material
def test_mass_and_momentum_are_conserved(name):
    """Whatever the stress is, in free flight; and what a material dissipates is not below 0."""
    simulation = thrown(name, colliders=(), gravity=(0, 0, 0), dtype="float64", transfer="apic")
    before = simulation.diagnostics()
    simulation.advance(0.05)
    after = simulation.diagnostics()
    assert after["mass"] == before["mass"]
    size = before["mass"] * 0.8
    for kind in ("momentum", "angular_momentum"):
        for axis in "xyz":
            key = f"{kind}_{axis}"
            assert after[key] == pytest.approx(before[key], abs=1e-10 * size)
    assert after["dissipated_energy"] > -1e-3 * before["kinetic_energy"]
    assert not np.allclose(simulation.deformation_gradients, np.eye(3), atol=1e-3)


def test_aflip_keeps_momentum_and_nearly_angular_momentum():
    """Particles that move by the grid's velocity turn dt sum m v_grid x v: 0.3 % of all."""
    free = {"colliders": (), "gravity": (0, 0, 0), "dtype": "float64"}
    simulation = thrown("sand", transfer="aflip", flip_rate=0, **free)
    before = simulation.diagnostics()
    simulation.advance(0.05)
    after = simulation.diagnostics()
    size = before["mass"] * 0.8
    for axis in "xyz":
        key = f"momentum_{axis}"
        assert after[key] == pytest.approx(before[key], abs=1e-10 * size)
        key = f"angular_momentum_{axis}"
        assert after[key] == pytest.approx(before[key], rel=0.02, abs=1e-4 * size)
