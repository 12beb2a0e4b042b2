"""The material point method and wrong input: what is refused leaves everything as it was."""

import copy
import math
import os
import pickle
import signal
import struct
import subprocess
import sys
import threading
import time
import zlib

import numpy as np
import pytest
import substep
from mpm_materials import MATERIALS, each_material
from substep import InputError, NonFiniteError, SolverError, mpm


def body(name="neo_hookean", dimension=3, side=0.4, **options):
    """A cube of 8 (in 2D 4) particles a cell above the ground, at rest."""
    low = np.full(dimension, 0.05)
    x, volume = mpm.sample_box(low, low + side, 0.1, jitter=0.2)
    options = {
        "cell": 0.2,
        "volume": volume,
        "colliders": [substep.Collider(substep.Plane())],
    } | options
    return substep.MaterialPointMethod(x, MATERIALS[name], **options)


def state_hash(simulation):
    return substep.state_hash(*simulation.state().values())


def refused(simulation, error, message, call):
    """The call raises, and the simulation is as it was."""
    before = state_hash(simulation)
    with pytest.raises(error, match=message) as caught:
        call(simulation)
    assert state_hash(simulation) == before
    return caught.value


def is_finite(simulation):
    state = simulation.state()
    return all(np.isfinite(v).all() for v in state.values() if not isinstance(v, str))


GOOD = {"positions": [[0.0, 0, 0], [0.1, 0, 0]], "materials": MATERIALS["snow"]}
GOOD |= {"cell": 0.2, "volume": 1e-3}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"cell": 0.0}, "cell: expected a number above 0"),
        ({"cell": -0.2}, "cell: expected a number above 0"),
        ({"cell": math.nan}, "cell: expected a finite number"),
        ({"cell": 1e-30}, "cell: the mass of a cell is out of range"),
        ({"volume": 0.0}, r"volume\[0\]: expected a number above 0"),
        ({"volume": [1e-3, -1e-3]}, r"volume\[1\]: expected a number above 0"),
        ({"volume": [1e-3, math.nan]}, r"volume\[1\]: expected finite"),
        ({"volume": [1e-3]}, "volume: expected shape"),
        ({"volume": 1e300}, r"volume\[0\]: a mass of .* is out of range"),
        ({"volume": 5e-324}, r"volume\[0\]: a mass of .* is out of range"),
        ({"materials": []}, "materials: expected at least one"),
        ({"kinds": [0, 1]}, r"kinds\[1\]: expected a number from 0 to 0, got 1"),
        ({"kinds": [-1, 0]}, r"kinds\[0\]: expected a number from 0 to 0, got -1"),
        ({"kinds": [0, 2**31]}, r"kinds\[1\]: expected a number from 0 to 0"),
        ({"kinds": [0, 2**63]}, "kinds: expected integers"),
        ({"kinds": [0.0, 0.0]}, "kinds: expected integers"),
        ({"kinds": [0]}, "kinds: expected integers"),
        ({"velocities": [[0, 0, 0]]}, "velocities: expected shape"),
        ({"gravity": (0, -9.81)}, "gravity: expected shape"),
        ({"gravity": (0, 0, math.inf)}, r"gravity\[2\]: expected finite"),
        ({"boundary": "glue"}, "boundary: expected one of"),
        ({"boundary": ["slip"]}, "boundary: expected one or 0, got 1"),
        ({"transfer": "asflip"}, "transfer: expected one of"),
        ({"flip_rate": -1.0}, "flip_rate: expected a number of at least 0"),
        ({"kernel": "quartic"}, "kernel: expected one of"),
        ({"form": "weak"}, "form: expected one of"),
        ({"integrator": "rk4"}, "integrator: expected one of"),
        ({"cfl": 0.0}, "cfl: expected a number above 0"),
        ({"cfl": 1.5}, "cfl: expected a number above 0 and at most 1"),
        ({"step": 0.0}, "step: expected a number above 0"),
        ({"step": math.nan}, "step: expected a finite number"),
        ({"largest_step": -1.0}, "largest_step: expected a number above 0"),
        ({"on_large_step": "ignore"}, "on_large_step: expected one of"),
        ({"on_escape": "ignore"}, "on_escape: expected one of"),
        ({"bounds": [[0, 0, 0]]}, "bounds: expected shape"),
        ({"bounds": [[-1, -1, -1], [1, -1, 1]]}, "bounds: expected the lowest corner"),
        ({"bounds": [[-1, -1, -1], [1, 1, -0.5]]}, r"positions\[0\]: expected a point within"),
        ({"emitter_spacing": 0.0}, "emitter_spacing: expected a number above 0"),
        ({"dtype": "float16"}, "dtype: expected float32 or float64"),
        ({"threads": 0}, "threads: expected an integer from 1 to 1024"),
        ({"time": math.nan}, "time: expected a finite number"),
        ({"positions": [[0, 0, 0], [1e30, 0, 0]]}, r"positions\[1\]: expected a point within"),
        ({"positions": [[0, 0, 0], [0, -1e12, 0]]}, r"positions\[1\]: expected a point within"),
    ],
)
def test_wrong_arguments(wrong, message):
    with pytest.raises(InputError, match=message):
        substep.MaterialPointMethod(**(GOOD | wrong))


def test_arguments_of_wrong_types():
    nozzle = substep.Emitter((0, 0), (1, 0), 1.0, radius=0.1)
    other = substep.Emitter((0, 0, 0), (1, 0, 0), 1.0, radius=0.1, kind=1)
    far = substep.Emitter((1e9, 0, 0), (1, 0, 0), 1.0, radius=0.1)
    for wrong, error, message in [
        ({"materials": "snow"}, TypeError, "materials: expected a list of Material"),
        ({"materials": [MATERIALS["snow"], mpm.Snow]}, TypeError, r"materials\[1\]"),
        ({"colliders": [1]}, TypeError, r"colliders\[0\]: expected a Collider"),
        (
            {"sinks": [substep.Collider(substep.Sphere(1.0))]},
            TypeError,
            r"sinks\[0\]: expected Sink",
        ),
        ({"emitters": [nozzle]}, InputError, r"emitters\[0\]: expected one in 3D"),
        ({"emitters": [other]}, InputError, r"emitters\[0\]: there is no material 1"),
        ({"emitters": [far]}, InputError, r"emitters\[0\]: expected one within the bounds"),
        ({"cell": "0.2"}, TypeError, "cell: expected a real number"),
    ]:
        with pytest.raises(error, match=message):
            substep.MaterialPointMethod(**(GOOD | wrong))


def test_the_case_of_a_name_does_not_matter():
    mixed = substep.MaterialPointMethod(**GOOD, kernel="Quadratic")
    mixed.step()
    plain = substep.MaterialPointMethod(**GOOD, kernel="quadratic")
    plain.step()
    assert np.array_equal(mixed.positions, plain.positions)


# Methods: the state stays.
ROW = [[0.1, 0.1, 0.1]]


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda s: s.add(ROW, -1.0), InputError, "volume"),
        (lambda s: s.add(ROW, [1e-3] * 2), InputError, "volume: expected shape"),
        (lambda s: s.add([[0.0, 0.0]], 1e-3), InputError, "positions: expected shape"),
        (lambda s: s.add([[0, 0, math.nan]], 1e-3), InputError, r"positions\[0, 2\]"),
        (lambda s: s.add([ROW[0], [0, 1e30, 0]], 1e-3), InputError, r"positions\[1\]"),
        (lambda s: s.add(ROW, 1e-3, velocities=[[0, 0]]), InputError, "velocities"),
        (lambda s: s.add(ROW, 1e-3, kinds=1), InputError, r"kinds\[0\]"),
        (lambda s: s.remove([0, 10**6]), IndexError, r"ids\[1\]: there is no particle 1000000"),
        (lambda s: s.remove([-1]), IndexError, r"ids\[0\]: there is no particle -1"),
        (lambda s: s.remove([2**31]), IndexError, r"ids\[0\]"),
        (lambda s: s.remove([2**63]), IndexError, r"ids\[0\]"),
        (lambda s: s.remove([0.5]), InputError, "ids: expected integers"),
        (lambda s: s.remove([[0]]), InputError, "ids: expected integers, shape"),
        (lambda s: s.set_positions(ROW), InputError, "values: expected shape"),
        (lambda s: s.set_positions([[0, 0, math.inf]], [3]), InputError, r"values\[0, 2\]"),
        (lambda s: s.set_positions([[0, 1e30, 0]], [3]), InputError, r"values\[0\]: expected a"),
        (lambda s: s.set_velocities([[0, math.nan, 0]], [3]), InputError, r"values\[0, 1\]"),
        (lambda s: s.set_velocities(ROW, [999]), IndexError, r"ids\[0\]"),
        (lambda s: s.set_forces([[0, math.nan, 0]], [3]), InputError, r"values\[0, 1\]"),
        (
            lambda s: s.set_deformation_gradients(np.full((1, 3, 3), math.nan), [3]),
            InputError,
            r"values\[0, 0, 0\]: expected finite",
        ),
        (lambda s: s.set_deformation_gradients(np.eye(3), [3]), InputError, "values: expected sh"),
        *(
            (lambda s, dt=dt: s.step(dt), InputError, "dt: expected a")
            for dt in (0, -1e-3, math.nan, math.inf)
        ),
        (lambda s: s.step("1"), TypeError, "dt: expected a real number"),
        *(
            (lambda s, t=t: s.advance(t), InputError, "duration: expected a")
            for t in (-1, math.nan, math.inf)
        ),
        (lambda s: s.advance(1e308 * 10), InputError, "duration"),
        (lambda s: s.step(1e-320), SolverError, "."),
        (lambda s: s.step(1e300), SolverError, "."),
    ],
)
def test_wrong_calls(call, error, message, dtype):
    simulation = body(dtype=dtype)
    simulation.advance(0.01)
    error = (InputError, SolverError) if error is SolverError else error
    refused(simulation, error, message, call)
    simulation.step()
    assert is_finite(simulation)


def test_no_duration_is_no_step():
    simulation = body()
    before = state_hash(simulation)
    simulation.advance(0.0)
    assert state_hash(simulation) == before
    assert simulation.report.steps == 0


# The rows of the method itself.
def changed(name, F, index=7, **options):
    """A body in which one particle has another deformation."""
    simulation = body(name, **options)
    d = simulation.positions.shape[1]
    F = np.diag(np.asarray(F, float)) if np.ndim(F) == 1 else np.asarray(F, float)
    simulation.set_deformation_gradients(F[None, :d, :d], [index])
    return simulation


INVERTED = {
    "inverted": (-0.5, 1.0, 1.0),
    "all inverted": (-1.0, -1.0, -1.0),
    "singular": (0.0, 1.0, 1.0),
    "nothing": (0.0, 0.0, 0.0),
}
HUGE = {
    "flattened": (1e-6, 1.0, 1.0),
    "stretched": (1e12, 1.0, 1.0),
    "beyond float32": (1e30, 1e30, 1e30),
}


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("kind", INVERTED)
@each_material
def test_impossible_deformations(name, kind, dtype):
    """The material brings it back, or the step names the particle and leaves the state."""
    simulation = changed(name, INVERTED[kind], dtype=dtype, on_large_step="subdivide")
    before = state_hash(simulation)
    try:
        simulation.step(1e-4)
    except SolverError as error:
        assert state_hash(simulation) == before
        assert isinstance(error, NonFiniteError) and error.index == 7
        assert error.time == pytest.approx(simulation.time, abs=1e-3)
    else:
        assert is_finite(simulation)
        assert np.abs(simulation.positions).max() < 10


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("kind", HUGE)
@each_material
def test_huge_deformations(name, kind, dtype):
    """The waves are faster than any step, or the numbers have no end: refused."""
    if (name, kind, dtype) == ("fluid", "beyond float32", "float32"):  # its determinant is
        with pytest.raises(InputError, match=r"determinants of values\[0\]"):
            changed(name, HUGE[kind], dtype=dtype)
        return
    simulation = changed(name, HUGE[kind], dtype=dtype)
    before = state_hash(simulation)
    try:
        simulation.step(1e-4)
    except SolverError:
        assert state_hash(simulation) == before
    else:  # sand and snow yield at once, a fluid has no pressure
        assert is_finite(simulation)


def test_inverted_rubber_is_named_and_inverted_corotated_goes_on():
    error = refused(
        changed("neo_hookean", INVERTED["inverted"]),
        NonFiniteError,
        "particle 7",
        lambda s: s.step(1e-4),
    )
    assert error.index == 7
    simulation = changed("fixed_corotated", INVERTED["inverted"], gravity=(0, 0, 0))
    before = np.linalg.det(simulation.deformation_gradients[7])
    simulation.advance(0.2)
    assert is_finite(simulation)
    assert before < np.linalg.det(simulation.deformation_gradients[7])


@each_material
def test_a_failure_in_the_middle_leaves_the_last_good_step(name):
    """A particle that is thrown out of the world: the state is that before the step that failed."""
    bounds = [[-1, -1, -1], [2, 2, 2]]
    simulation = body(name, bounds=bounds, step=1e-3, gravity=(0, 0, 0), colliders=())
    simulation.set_velocities(np.tile([20.0, 0, 0], (len(simulation), 1)))
    twin = simulation.copy()
    with pytest.raises(SolverError, match="bounds") as caught:
        simulation.advance(1.0)
    good = caught.value.step
    assert good > 10
    assert simulation.time == pytest.approx(good * 1e-3)
    for _ in range(good):
        twin.step(1e-3)
    a, b = simulation.positions, twin.positions
    assert np.abs(a - b).max() < 1e-4  # a run fuses its steps: not the same bits
    assert simulation.report.steps == good
    simulation.set_velocities(np.zeros_like(a))
    simulation.advance(0.01)


def test_steps_below_the_spacing_of_times_are_refused():
    """At time 0 every step is above it: but the end would never come."""

    def ring(*_):
        raise TimeoutError

    simulation = body(gravity=(0, 0, 0))
    v = np.zeros((len(simulation), 3))
    v[5, 0] = 1e30
    simulation.set_velocities(v)
    old = signal.signal(signal.SIGALRM, ring)
    try:
        signal.setitimer(signal.ITIMER_REAL, 10)
        error = refused(
            simulation, SolverError, "particle speed, is below the spacing", lambda s: s.advance(1)
        )
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, old)
    assert (error.index, error.step, error.time) == (5, 0, 0.0)
    assert "start again with shorter steps" in str(error)


def test_stiffness_without_bound_names_the_particle():
    simulation = changed("neo_hookean", (1e20, 1e20, 1e20), dtype="float64")
    error = refused(
        simulation, SolverError, "elastic wave, is below the spacing", lambda s: s.advance(1)
    )
    assert error.index == 7


@pytest.mark.skipif("libasan" in os.environ.get("LD_PRELOAD", ""), reason="ASan reserves terabytes")
def test_memory_that_runs_out_leaves_the_last_good_step():
    """However much there is: the sort in a run fails, or what comes after it, or new particles."""
    code = """
import resource
import numpy as np
import substep
from substep import mpm

def used():
    return int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()

def limit(bytes):
    resource.setrlimit(resource.RLIMIT_AS, (bytes, resource.RLIM_INFINITY))

dt = 2e-3
x, volume = mpm.sample_box((0, 0, 0), (1, 1, 1), 1 / 48, jitter=0.2)
start = substep.MaterialPointMethod(
    x, mpm.NeoHookean(density=1000.0, young_modulus=1e3, poisson_ratio=0.3), cell=1 / 24,
    volume=volume, velocities=np.sin(5 * x[:, ::-1]), step=dt, threads=1, gravity=(3, 0, 0),
)
failed = set()
for extra in range(0, 16):
    sim = start.copy()
    sim.advance(3 * dt)
    limit(used() + extra * 500_000)
    try:
        sim.advance(60 * dt)
    except MemoryError:
        failed.add(round(sim.time / dt) > 3)
        limit(resource.RLIM_INFINITY)
        twin = start.copy()
        for _ in range(round(sim.time / dt)):
            twin.step(dt)
        assert abs(twin.time - sim.time) < 1e-9
        for name in ("positions", "velocities", "deformation_gradients"):
            assert np.abs(getattr(sim, name) - getattr(twin, name)).max() < 1e-4, name
        sim.advance(5 * dt)
        assert np.isfinite(sim.positions).all()
    limit(resource.RLIM_INFINITY)
def state_hash(sim):
    return substep.state_hash(*(v for v in sim.state().values() if not isinstance(v, str)))

sim.set_forces(x)
refused = 0
for extra in range(0, 40, 4):
    before = state_hash(sim)
    limit(used() + extra * 1_000_000)
    try:
        sim.add(x[:1000], volume[:1000])
        break
    except MemoryError:
        refused += 1
    finally:
        limit(resource.RLIM_INFINITY)
    assert state_hash(sim) == before
sim.advance(5 * dt)
print(True in failed, refused > 3)
"""
    environment = {**os.environ, "MALLOC_MMAP_THRESHOLD_": "65536", "MALLOC_ARENA_MAX": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout == "True True\n", done.stderr


@pytest.mark.parametrize("how", ["raise", "remove", "clamp"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_on_escape(how, dimension):
    bounds = [[-1] * dimension, [1] * dimension]
    x = np.zeros((2, dimension))
    x[1, 0] = -0.5
    simulation = substep.MaterialPointMethod(
        x,
        MATERIALS["sand"],
        cell=0.1,
        volume=1e-3,
        velocities=[[2.0] + [0.0] * (dimension - 1), [0.0] * dimension],
        gravity=np.zeros(dimension),
        bounds=bounds,
        on_escape=how,
        step=5e-3,
    )
    simulation.advance(0.45)
    if how == "raise":
        twin = simulation.copy()
        with pytest.raises(SolverError, match="particle 0") as caught:
            twin.advance(0.2)
        assert caught.value.index == 0
        assert 0.45 <= twin.time <= 0.5
        assert twin.positions[0, 0] <= 1
        return
    simulation.advance(0.2)
    if how == "remove":
        assert simulation.ids.tolist() == [1]
        assert simulation.report.removed == 1
    else:
        assert simulation.positions[0, 0] == pytest.approx(1)
        assert simulation.velocities[0, 0] == 0
        assert simulation.report.clamped > 0
    assert simulation.positions[-1, 0] == pytest.approx(-0.5)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("dimension", [2, 3])
@each_material
def test_one_particle_falls_freely_and_none_is_legal(name, dimension, dtype):
    """Also of sand without pressure, fluid without volume to lose; at the edges of cells."""
    for at in (0.0, 0.1, 0.2, 0.8 - 1e-9, 0.3):
        one = substep.MaterialPointMethod(
            [[at] * dimension], MATERIALS[name], cell=0.2, volume=1e-3, step=1e-3, dtype=dtype
        )
        one.advance(0.1)
        fall = np.zeros(dimension)
        fall[-1] = 1.0
        # Symplectic Euler falls g h t / 2 too far.
        expected = at - fall * (9.81 * 0.1**2 / 2 + 9.81 * 1e-3 * 0.1 / 2)
        tolerance = 1e-6 if dtype == "float32" else 1e-12
        assert one.velocities[0] == pytest.approx(-9.81 * 0.1 * fall, abs=50 * tolerance)
        assert one.positions[0] == pytest.approx(expected, abs=5 * tolerance)
        assert one.volume_ratios[0] == pytest.approx(1, abs=100 * tolerance)
    none = substep.MaterialPointMethod(
        np.zeros((0, dimension)), MATERIALS[name], cell=0.2, volume=1.0, dtype=dtype
    )
    none.advance(0.1)
    assert none.time == pytest.approx(0.1)
    assert none.positions.shape == (0, dimension)
    assert none.stresses.shape == (0, 3, 3)
    assert none.diagnostics()["mass"] == 0
    assert all(len(values) == 0 for values, _ in none.fields().values())
    assert none.step_limit()[1] == "nothing moves"


@each_material
def test_coincident_particles(name):
    """All on one node: they move as one."""
    x = np.tile([[0.4, 0.2, 0.0]], (1000, 1))
    simulation = substep.MaterialPointMethod(x, MATERIALS[name], cell=0.2, volume=1e-5, step=1e-3)
    simulation.advance(0.02)
    assert is_finite(simulation)
    spread = np.ptp(simulation.positions, axis=0).max()
    assert spread < 1e-5
    assert simulation.velocities[:, 2] == pytest.approx(-9.81 * 0.02, rel=1e-3)


def test_particles_thrown_far_away():
    """The grid is only where they are; each falls alone."""
    x = np.array([[0.0, 0, 0], [1e5, 0, 0], [0, -1e5, 0], [0, 0, 1e5], [-1e5, 1e5, -1e5]])
    simulation = substep.MaterialPointMethod(x, MATERIALS["sand"], cell=0.2, volume=1e-3)
    simulation.advance(0.1)
    fallen = simulation.positions - x
    assert fallen == pytest.approx(np.tile(fallen[0], (5, 1)), abs=1e-4)
    assert fallen[0, 2] == pytest.approx(-9.81 * 0.1**2 / 2, rel=0.2)


def test_a_particle_faster_than_the_grid():
    simulation = body(time=1.0)
    simulation.set_velocities([[0, 0, 1e30]], [5])
    refused(simulation, SolverError, "particle speed", lambda s: s.step(1e-3))
    refused(simulation, SolverError, ".", lambda s: s.advance(1e-2))


@each_material
def test_steps_above_the_elastic_limit(name):
    simulation = body(name, gravity=(0, 0, 0), largest_step=10.0)
    limit, reason = simulation.step_limit()
    assert reason in ("elastic wave", "viscosity")
    error = refused(simulation, SolverError, ".", lambda s: s.step(20 * limit))
    assert error.time is not None
    refused(simulation, SolverError, reason, lambda s: s.step(1e3 * limit))
    willing = body(name, gravity=(0, 0, 0), largest_step=10.0, on_large_step="subdivide")
    willing.step(20 * limit)
    assert willing.time == pytest.approx(20 * limit)
    assert willing.report.steps >= 20
    assert willing.report.subdivided > 0
    assert is_finite(willing)


def test_hardening_cannot_overflow():
    """Snow of xi = 1000 that is pressed to half its volume: exp(1000) would be infinite."""
    snow = mpm.Snow(hardening=1e3, largest_hardening=50.0)
    x, volume = mpm.sample_box((0, 0, 0), (0.4, 0.4, 0.4), 0.1)
    simulation = substep.MaterialPointMethod(
        x, snow, cell=0.2, volume=volume, gravity=(0, 0, 0), on_large_step="subdivide"
    )
    simulation.set_deformation_gradients(np.tile(0.8 * np.eye(3), (len(x), 1, 1)))
    softest = simulation.step_limit()[0]
    for _ in range(3):  # the return map of the first is done by the second
        simulation.step(1e-6)
    pressed = simulation.fields()["plastic_volume_ratio"][0]
    assert pressed == pytest.approx(0.8**3 / 0.975**3, rel=0.01)
    assert softest / 60 < simulation.step_limit()[0] < softest
    simulation.advance(0.02)
    assert is_finite(simulation)


def test_an_inverted_deformation_that_is_set_right_leaves_nothing(tmp_path):
    simulation, twin = body("neo_hookean"), body("neo_hookean")
    simulation.set_deformation_gradients([np.diag([1.0, 1, -1])], [0])
    simulation.save(tmp_path / "inverted")
    assert all(map(math.isfinite, simulation.diagnostics().values()))
    simulation.set_deformation_gradients([np.eye(3)], [0])
    simulation.advance(0.01)
    twin.advance(0.01)
    assert simulation.diagnostics() == twin.diagnostics()
    simulation.save(tmp_path / "right")
    for name in ("inverted", "right"):
        twin.load(tmp_path / name)
        assert state_hash(twin.copy()) == state_hash(twin)
    assert state_hash(twin) == state_hash(simulation)


def test_a_fluid_that_is_inverted_has_a_gradient():
    simulation = body("fluid")
    simulation.set_deformation_gradients([-0.5 * np.eye(3)], [0])
    assert np.allclose(simulation.deformation_gradients[0], -0.5 * np.eye(3))


def test_energies_beyond_all_numbers_are_not_summed():
    simulation = body("neo_hookean", dtype="float64")
    simulation.set_velocities([[1e200, 0, 0]], [0])
    simulation.set_velocities([[0.0, 0, 0]], [0])
    assert simulation.diagnostics()["dissipated_energy"] == pytest.approx(0, abs=1e-9)
    simulation.restore(simulation.state())
    fluid = body("fluid", dtype="float64")
    with pytest.raises(InputError, match=r"determinants of values\[0\]"):
        fluid.set_deformation_gradients([1e200 * np.eye(3)], [0])


def test_masses_are_those_of_volumes_as_they_are_stored():
    heavy = substep.mpm.NeoHookean(1e20, 1e25, 0.3)
    simulation = substep.MaterialPointMethod(np.zeros((0, 3)), heavy, cell=0.2, volume=1.0)
    with pytest.raises(InputError, match=r"volume\[0\]: a mass of 0.0 kg"):
        simulation.add([[0.2, 0.2, 0.2]], 1e-46)
    nozzle = substep.Emitter((0, 0, 1), (0, 0, -1), 1.0, radius=1e-16)
    with pytest.raises(InputError, match=r"emitter_spacing\[0\]: a mass of"):
        body("neo_hookean", emitters=[nozzle], emitter_spacing=1e-16)


def test_few_particles_of_many_that_were():
    """Ids may be as large as they like: no table of all that were ever given is made."""
    simulation = two_materials()
    kept = simulation.ids[::5]
    simulation.remove(np.setdiff1d(simulation.ids, kept))
    twin, state = simulation.copy(), simulation.state()
    far = 2**20
    simulation.restore(state | {"next_id": 2**20 + 1000, "ids": state["ids"] + np.int32(far)})
    assert np.array_equal(simulation.ids, kept + far)
    for one in (simulation, twin):
        one.set_velocities([[1.0, 0, 0]], one.ids[3:4])
        one.set_forces([[0.0, 1, 0]], one.ids[4:5])
        one.set_positions([[0.2, 0.2, 0.3]], one.ids[5:6])
        one.set_deformation_gradients([1.01 * np.eye(3)], one.ids[6:7])
        one.remove(one.ids[7:8])
        one.step(1e-4)
    for name in ("positions", "velocities", "kinds", "stresses", "volume_ratios"):
        assert np.array_equal(getattr(simulation, name), getattr(twin, name)), name


# Files and states.
def test_states_that_do_not_fit():
    simulation = two_materials()
    simulation.advance(0.01)
    good = simulation.state()
    n = len(simulation)
    changes = {
        "counts": [good["counts"][:1], good["counts"] + 1, good["counts"].astype(float)],
        "ids": [good["ids"] * 0, good["ids"] - 1, good["ids"] + n, good["ids"].astype(np.int64)],
        "blocks": [good["blocks"][1:], good["blocks"].astype(np.int64)],
        "values": [good["values"][1:], np.full_like(good["values"], np.nan), good["values"] + 100],
        "motion": [
            good["motion"][1:],
            np.full_like(good["motion"], np.inf),
            good["motion"].astype(float),
        ],
        "volumes": [
            *(good["volumes"] * np.float32(factor) for factor in (-1, 0, 1e-35, 1e37)),
            good["volumes"][1:],
        ],
        "forces": [np.zeros((1, 3)), np.zeros(3), np.full((n, 3), np.nan), np.full((n, 3), 1e40)],
        "time": [math.nan, "0", None],
        "drift": [math.inf],
        "before": [-1.0],
        "supplied": [math.nan, math.inf],
        "next_id": [3, -1, 2.5],
        "trial": [1, None],
        "colliders": [np.zeros((2, 15)), np.full((1, 15), np.nan)],
        "layers": [np.zeros(1, np.int64), np.zeros(0)],
        "absorbed": [np.zeros(1, np.int64)],
    }
    assert set(changes) <= set(good)
    for name, values in changes.items():
        for value in values:
            refused(
                simulation,
                (InputError, TypeError),
                "state",
                lambda s, name=name, value=value: s.restore(good | {name: value}),
            )
        rest = {k: v for k, v in good.items() if k != name}
        refused(simulation, InputError, f"{name} missing", lambda s, rest=rest: s.restore(rest))
    simulation.restore(good)
    assert state_hash(simulation) == substep.state_hash(*good.values())


def two_materials(**options):
    x, volume = mpm.sample_box((0, 0, 0.05), (0.4, 0.4, 0.45), 0.1)
    return substep.MaterialPointMethod(
        x,
        [MATERIALS["snow"], MATERIALS["fluid"]],
        cell=0.2,
        volume=volume,
        kinds=np.arange(len(x)) % 2,
        colliders=[substep.Plane()],
        **options,
    )


def test_checkpoints_that_are_spoiled(tmp_path):
    simulation = two_materials()
    simulation.advance(0.01)
    path, bad = tmp_path / "good", tmp_path / "bad"
    simulation.save(path)
    whole = path.read_bytes()
    simulation.advance(0.01)
    for cut in (0, 7, 20, 100, len(whole) - 1):
        bad.write_bytes(whole[:cut])
        refused(simulation, substep.FormatError, ".", lambda s: s.load(bad))
    rng = np.random.default_rng(0)
    for at in rng.integers(0, len(whole), 60):
        flipped = bytearray(whole)
        flipped[at] ^= 1 << int(rng.integers(8))
        bad.write_bytes(flipped)
        refused(simulation, substep.FormatError, ".", lambda s: s.load(bad))
    bad.write_bytes(whole + b"x")
    refused(simulation, substep.CorruptError, "too many", lambda s: s.load(bad))
    # A header that is spoiled with the right checksum.
    body_of = bytearray(whole.replace(b'"trial": true', b'"trial": "no"', 1))
    body_of[12:16] = struct.pack("<I", zlib.crc32(bytes(body_of[16:])))
    bad.write_bytes(body_of)
    refused(simulation, substep.FormatError, ".", lambda s: s.load(bad))
    for other in (body(), two_materials(dtype="float64")):
        refused(other, substep.CorruptError, "does not fit", lambda s: s.load(path))
    liquid = substep.PositionBasedFluid([[0.0, 0, 0]], 0.1)
    with pytest.raises(substep.FormatError, match="not of PositionBasedFluid"):
        liquid.load(path)
    with pytest.raises(OSError):
        simulation.load(tmp_path / "absent")
    with pytest.raises(OSError):
        simulation.save(tmp_path / "absent" / "file")
    simulation.load(path)


@pytest.mark.parametrize(
    "copied",
    [lambda s: s.copy(), copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))],
)
def test_copies_are_exact_and_independent(copied):
    nozzle = substep.Emitter((0.2, 0.2, 0.6), (0, 0, -1), 1.0, radius=0.1, kind=1)
    simulation = two_materials(emitters=[nozzle], threads=2)
    simulation.advance(0.02)
    simulation.set_forces(np.ones((len(simulation), 3)))
    twin = copied(simulation)
    assert state_hash(twin) == state_hash(simulation)
    assert twin.threads == 2
    assert twin.colliders[0] is not simulation.colliders[0]
    before = state_hash(simulation)
    twin.advance(0.1)
    assert state_hash(simulation) == before
    simulation.advance(0.1)
    assert state_hash(twin) == state_hash(simulation)
    assert (twin.emitted > 0).all()


# Processes and threads.
def falling(threads, n):
    """n^3 grains that fall."""
    side = 0.01 * n
    x, volume = mpm.sample_box((0, 0, 0), (side, side, side), 0.01)
    return substep.MaterialPointMethod(
        x, MATERIALS["sand"], cell=0.02, volume=volume, step=2.0**-12, threads=threads
    )


class Alarm(Exception):
    pass


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
def test_signals_stop_a_large_run(threads):
    """Between two steps, of 343,000 grains, or sooner."""
    simulation = falling(threads, n=70)
    x = simulation.positions
    begin = time.perf_counter()
    simulation.advance(4 * 2.0**-12)
    step = (time.perf_counter() - begin) / 4

    def ring(*_):
        raise Alarm

    waits = []
    before = signal.signal(signal.SIGALRM, ring)
    try:
        for _ in range(4):
            begin = time.perf_counter()
            signal.setitimer(signal.ITIMER_REAL, 0.5)
            with pytest.raises(Alarm):
                simulation.advance(1e3)
            waits.append(time.perf_counter() - begin - 0.5)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert min(waits) <= 2 * step + 0.02
    # The state is a whole step: symplectic Euler of free fall.
    steps = simulation.time * 2.0**12
    assert steps == round(steps) > 0
    fall = 9.81 * 2.0**-24 * steps * (steps + 1) / 2
    assert simulation.positions[:, 2] - x[:, 2] == pytest.approx(-fall, abs=1e-5)
    simulation.step()


def test_one_object_from_two_threads_is_refused():
    simulation = falling(1, n=30)
    outcomes = []
    barrier = threading.Barrier(2)

    def work():
        barrier.wait()
        try:
            simulation.advance(50 * 2.0**-12)
            outcomes.append("done")
        except InputError as error:
            outcomes.append(str(error))

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert sorted(outcome == "done" for outcome in outcomes) == [False, True]
    assert any("in use" in outcome for outcome in outcomes)
    assert simulation.time == 50 * 2.0**-12


def test_a_plane_along_the_particles_of_2d_is_refused():
    x, volume = mpm.sample_box((0, 0), (1, 1), 0.5)
    jelly = mpm.NeoHookean(1000.0, 1e4, 0.3)
    with pytest.raises(InputError, match=r"colliders\[0\]: .* in 2D the normal of a ground"):
        substep.MaterialPointMethod(x, jelly, cell=1, volume=volume, colliders=[substep.Plane()])
    with pytest.raises(InputError, match=r"colliders\[0\]"):
        substep.PositionBasedFluid(x, 0.5, colliders=[substep.Plane()])
    ground = substep.Collider(substep.Plane((0, 1, 0)))
    substep.MaterialPointMethod(x, jelly, cell=1, volume=volume, colliders=[ground])
