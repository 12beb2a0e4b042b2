"""An attack on `restore` and `load`: states that are wrong in one or two entries.

    python tests/attack/states.py --count 5000 --seed 1 [--only MaterialPointMethod]

Each try takes a state of a small simulation (with contacts, joints, nozzles, obstacles, so that no
entry is trivial), changes one or two entries, and restores it. It must be refused with InputError
or TypeError, and nothing has changed; or it is accepted, and then all can be read, stepped, saved
and loaded without a crash, another exception than SolverError, or NaN. In the end the good state is
restored and must go on with the same bits as ever. Tries run in a child process, so that a crash or
a hang ends one of them only; (seed, number) is all that a try depends on.
"""

import argparse
import hashlib
import inspect
import json
import math
import os
import re
import resource
import select
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from runner import SANITIZED

SLOW = 1.0  # seconds of a try from which on it is told, unless Ctrl-C takes hold
DEAF = 0.1  # seconds until then
HANG = 20.0  # and from which on it is ended
MEMORY = 4 << 30  # bytes of a child

# ------------------------------------------------------------------------- what is attacked


def _flow(substep, d=3):
    """A nozzle and a drain."""
    down = (0.0, 0.0, -1.0)[3 - d :]
    above = (0.3, 0.3, 0.9)[3 - d :]
    below = (0.0, 0.0, -2.0)
    up = (0.0, 0.0, 1.0) if d == 3 else (0.0, 1.0, 0.0)
    return {
        "emitters": [substep.Emitter(above, down, 2.0, radius=0.1)],
        "sinks": [substep.Sink(substep.Plane(up, below))],
    }


def mpm(substep):
    """Three materials between a mesh, a moving ball and the ground."""
    x, volume = substep.mpm.sample_box((0, 0, 0.02), (0.4, 0.4, 0.42), 0.1)
    materials = [
        substep.mpm.NeoHookean(1000.0, 1e4, 0.3),
        substep.mpm.Sand(1500.0),
        substep.mpm.Fluid(1000.0, 1e5),
    ]
    ball = substep.Collider(substep.Sphere(0.2, (0.8, 0.2, 0.2)), velocity=(-1, 0, 0), friction=0.4)
    made = substep.MaterialPointMethod(
        x,
        materials,
        cell=0.2,
        volume=volume,
        kinds=np.arange(len(x)) % 3,
        colliders=[substep.Plane(), ball],
        on_escape="remove",
        bounds=[[-5, -5, -5], [5, 5, 5]],
        **_flow(substep),
    )
    made.advance(0.05)
    made.remove(made.ids[::7])
    made.set_forces(np.ones((len(made), 3)))
    return made


def mpm_plane(substep):
    """In 2D, implicit, in float64, at a place far from 0."""
    x = np.stack(np.meshgrid(np.arange(4), np.arange(4), indexing="ij"), -1).reshape(-1, 2) * 0.1
    made = substep.MaterialPointMethod(
        x + np.array([1000.0, 0.05]),
        [substep.mpm.FixedCorotated(1000.0, 1e4, 0.3), substep.mpm.Snow()],
        cell=0.2,
        volume=0.01,
        kinds=[0, 1] * 8,
        integrator="implicit_euler",
        largest_step=5e-3,
        colliders=[substep.Plane((0, 1, 0))],
        dtype="float64",
    )
    made.advance(0.01)
    return made


def pbf(substep):
    """Two fluids in a tank, with a nozzle."""
    x = substep.fill_box((0.05, 0.05, 0.05), (0.4, 0.4, 0.4), 0.1)
    tank = substep.Collider(substep.Box((1, 1, 1), center=(0.5, 0.5, 0.5)), hollow=True)
    made = substep.PositionBasedFluid(
        x,
        0.1,
        density=[1000.0, 500.0],
        kinds=np.arange(len(x)) % 2,
        viscosity=0.01,
        surface_tension=0.05,
        vorticity_confinement=0.1,
        warm_start=0.3,
        colliders=[tank],
        **_flow(substep),
    )
    made.advance(0.1)
    made.remove(made.ids[::5])
    made.set_forces(np.ones((len(made), 3)))
    return made


def pbf_plane(substep):
    """In 2D and float64, within bounds."""
    x = np.stack(np.meshgrid(np.arange(5), np.arange(5), indexing="ij"), -1).reshape(-1, 2) * 0.1
    made = substep.PositionBasedFluid(
        x + 0.05,
        0.1,
        colliders=[substep.Plane((0, 1, 0))],
        on_escape="clamp",
        bounds=[[-2, -2], [2, 2]],
        dtype="float64",
        **_flow(substep, 2),
    )
    made.advance(0.05)
    return made


def grid_liquid(substep):
    """Water between walls and an open side, with a ball in it."""
    x = substep.fill_box((0, 0, 0), (0.5, 0.5, 0.5), 0.125)
    made = substep.GridLiquid(
        x,
        cell=0.25,
        bounds=((-1, -1, 0), (1, 1, 1)),
        sides=("periodic", ("wall", "open"), "wall"),
        colliders=[substep.Sphere(0.3, (0.25, 0.25, 0.0))],
        step=0.01,
        **_flow(substep),
    )
    made.advance(0.1)
    made.remove(made.ids[::5])
    made.set_forces(np.ones((len(made), 3)))
    return made


def grid_flow(substep):
    """Oil on water past a ball that moves, with an inflow and heat that is carried along."""
    made = substep.GridFlow(
        ((0, 0), (1, 1)),
        0.125,
        density=1000.0,
        smoke=lambda x: (x[:, 1] > 0.5).astype(float),
        smoke_density=800.0,
        temperature=1.0,
        viscosity=0.01,
        sides=((substep.gridfluid.Inflow((0.5, 0), smoke=0.5), "open"), "wall"),
        colliders=[substep.Collider(substep.Sphere(0.2, (0.5, 0.4, 0)), velocity=(0, 0.1, 0))],
        step=0.01,
    )
    made.advance(0.05)
    return made


def _pinned_cloth(substep, **options):
    mesh = substep.geometry.grid_mesh(5, 5)
    ball = substep.Collider(substep.Sphere(0.3, (0, 0, -0.31)), friction=0.3, restitution=0.2)
    constraints = substep.pbd.cloth(mesh, compliance=options.pop("compliance", 1e-5))
    if options.pop("touching", False):
        constraints.append(substep.pbd.SelfCollision(mesh.faces, thickness=0.05, friction=0.3))
    made = substep.PositionBasedDynamics(
        mesh.vertices, 0.1, constraints, pinned=[0, 4], colliders=[ball], step=0.01, **options
    )
    made.advance(0.05)
    return made


def pbd(substep):
    """Cloth on a ball, with targets, forces and contacts with itself."""
    made = _pinned_cloth(substep, touching=True)
    made.set_targets(made.positions[[0, 4]] + 0.01, [0, 4])
    made.set_forces(np.ones((len(made), 3)))
    return made


def pbd_free(substep):
    """Without targets; in float64."""
    return _pinned_cloth(substep, dtype="float64")


def pbd_levels(substep):
    """By the multilevel solver."""
    return _pinned_cloth(substep, solver="multilevel", compliance=0.0)


def pbd_plane(substep):
    """A rope in 2D, by Jacobi's method."""
    x = np.stack([np.arange(6) * 0.1, np.zeros(6)], 1)
    made = substep.PositionBasedDynamics(
        x,
        0.1,
        substep.pbd.rope(6, compliance=1e-6, bending_compliance=1e-3)[:1],
        pinned=[0],
        solver="jacobi",
        colliders=[substep.Plane((0, 1, 0), (0, -0.2, 0))],
    )
    made.advance(0.1)
    return made


def springs(substep, **options):
    """Cloth above a ball that it lies on."""
    mesh = substep.geometry.grid_mesh(4, 4)
    ball = substep.Collider(substep.Sphere(0.3, (0, 0, -0.32)), friction=0.3, velocity=(0.1, 0, 0))
    made = substep.MassSpring.from_mesh(
        mesh, density=0.3, stiffness=100.0, pinned=[0], colliders=[ball], step=0.01, **options
    )
    made.advance(0.05)
    made.forces[3] = (0, 0, 0.1)
    made.targets[0, 2] += 0.01
    return made


def springs_implicit(substep):
    """The same by implicit Euler."""
    return springs(substep, integrator="implicit_euler")


def soft_body(substep):
    """A cube that falls on the ground, pinned at a corner."""
    cube = substep.geometry.box_tetrahedra((0.1, 0.1, 0.1), (1, 1, 1))
    made = substep.SoftBody(
        cube.vertices + np.array([0, 0, 0.06]),
        cube.tetrahedra,
        density=1000,
        young_modulus=2e4,
        poisson_ratio=0.3,
        pinned=[0],
        colliders=[substep.Collider(substep.Plane(), friction=0.5)],
        integrator="implicit_euler",
        step=0.01,
    )
    made.advance(0.05)
    return made


def bodies(substep):
    """A stack, a sleeping box, joints of every kind, what is excluded, numbers that are gone."""
    made = substep.RigidBodies()
    made.add(substep.Plane(), (0, 0, 0), motion="static", friction=0.6, material="floor")
    box, x = substep.Box((0.4, 0.4, 0.4)), [[0, 0, 0.2], [0, 0, 0.61], [2, 0, 0.2]]
    stack = made.add(box, x, static_friction=0.8, material="oak")
    made.set_material_pair("oak", "floor", friction=0.3, static_friction=0.5)
    balls = made.add(substep.Sphere(0.1), [[3 + k, 0, 1] for k in range(6)], restitution=0.5)
    wheel = made.add(substep.Cylinder(0.2, 0.1), (-2, 0, 0.4), rolling_friction=0.01)
    lift = made.add(substep.Box((1, 1, 0.1)), (0, 3, 1), motion="kinematic", velocities=(0, 0, 0.1))
    speed, spring = substep.rigid.SpeedMotor(1.0, 5.0), substep.rigid.SpringMotor(0.1, 10.0, 1.0)
    made.ball(balls[0], balls[1], (3.5, 0, 1), cone=1.0)
    made.hinge(balls[1], None, (4, 0, 1.5), (0, 1, 0), limits=(-1, 1), motor=speed)
    made.slider(balls[2], lift, (5, 0, 1), (0, 0, 1), limits=(-0.5, 0.5), motor=spring)
    made.fixed(balls[3], balls[4], (6.5, 0, 1)).remove()
    made.fixed(balls[3], balls[4], (6.5, 0, 1))
    turning = substep.rigid.TurnSpring(5.0, 3.0, 0.1, 0.1, (0.1, 0.2, 0.3))
    made.elastic(balls[4], balls[3], (6.6, 0, 1), (1, 0, 0), turning)
    made.universal(balls[4], balls[5], (7.5, 0, 1), (0, 1, 0), (0, 0, 1), motor=speed)
    made.distance(balls[5], None, (8, 0, 1), (8, 0, 2), limits=(0, 1.5))
    made.exclude(wheel, stack[2])
    made.advance(1.5)
    made.remove(balls[2])
    made.step()
    made.set_forces([[0, 0, 1.0]], [balls[3]])
    return made


def batch(substep):
    """Two worlds of different bodies, one of which has failed."""
    one, two = bodies(substep), substep.RigidBodies()
    two.add(substep.Plane(), (0, 0, 0), motion="static")
    two.add(substep.Box((0.2, 0.2, 0.2)), (0, 0, 0.1))
    made = substep.RigidBatch([one, two, two], on_fail="mask")
    made.set_forces([[1.2e153, 0, 0]], ids=[1], worlds=[2])
    made.step(1.0, 30, hold_forces=True)
    assert made.failures[2] and not made.failures[1]
    return made


def advection(substep):
    """In a field on a grid with land, in float32."""
    t, y, x = np.arange(3.0), np.linspace(0, 1, 6), np.linspace(0, 2, 8)
    values = np.random.default_rng(3).normal(size=(2, 3, 6, 8))
    values[:, :, 2, 3] = np.nan
    field = substep.GridField([x, y], np.moveaxis(values, (0, 1), (-1, 0)).swapaxes(1, 2), times=t)
    made = substep.Advection(
        field, [[0.1, 0.1], [1.9, 0.9], [1.0, 0.5], [0.95, 0.42]], step=0.05, dtype=np.float32
    )
    made.advance(0.5)
    return made


def advection_flow(substep):
    """In a formula."""
    made = substep.Advection(substep.DoubleGyre(), [[0.5, 0.5], [1.0, 0.25]], step=0.02)
    made.advance(0.1)
    return made


def crash(substep):
    """What the attack must notice: the first state that is not its own ends the process."""
    made = advection_flow(substep)
    own = iter(range(2))  # calls that Target makes
    restore = made.restore
    object.__setattr__(made, "restore", lambda s: os.abort() if next(own, 2) > 1 else restore(s))
    return made


MAKERS = {
    maker.__name__: maker
    for maker in (
        mpm,
        mpm_plane,
        pbf,
        pbf_plane,
        grid_liquid,
        grid_flow,
        pbd,
        pbd_free,
        pbd_levels,
        pbd_plane,
        springs,
        springs_implicit,
        soft_body,
        bodies,
        batch,
        advection,
        advection_flow,
    )
}


def _entry(name, change):
    """A state with another entry."""
    return lambda state: state | {name: change(state[name])}


def _at(*index, value):
    """An array with another number."""

    def change(array):
        array = array.copy()
        array[index] = value
        return array

    return change


# What was found: crashes, exceptions of other kinds, states that cannot be read without all memory.
PAST = [
    ("pbd_free", _entry("pinned", np.ones_like)),
    ("pbd_free", lambda s: s | {"targets": s["positions"]}),
    ("pbd", lambda s: s | {"targets": s["targets"][:0], "pinned": np.ones_like(s["pinned"])}),
    ("pbd", _entry("forces", _at(1, 2, value=1e300))),
    ("pbd_free", _entry("velocities", _at(18, 2, value=-1.7e308))),
    ("pbd_plane", lambda s: s | {"targets": s["targets"][:, :2]}),
    ("mpm_plane", _entry("blocks", _at(2, 0, value=2147483646))),
    ("pbd_plane", _entry("velocities", _at(1, 2, value=1.0))),
    *(
        (name, _entry("colliders", _at(0, column, value=value)))
        for name in ("pbd", "pbf", "mpm", "springs")
        for column, value in ((13, -1.0), (14, -1.0), (14, 7.0), (13, math.inf), (3, 0.0))
    ),
    ("mpm", lambda s: s | {"next_id": 2**31 - 2}),
    ("pbf", lambda s: s | {"next_id": 2**31 - 2}),
    ("pbf", lambda s: s | {"next_id": 2**61}),
    ("pbf", _entry("positions", _at(0, 3, value=0.0))),
    ("pbf", _entry("positions", _at(0, 0, value=1e30))),
    ("mpm", _entry("volumes", _at(0, value=1e-44))),
    ("mpm", lambda s: s | {"supplied": 1.7e308}),
    *((name, lambda s: s | {"steps": 2**62}) for name in ("bodies", "advection")),
    ("batch", _entry("each_steps", _at(0, value=2**62))),
    ("batch", lambda s: s | {"failures": '["\\ud800", "", ""]'}),
    ("batch", lambda s: s | {"failures": "[" * 10**5}),
    ("bodies", _entry("positions", _at(1, 1, value=1e200))),
    ("bodies", _entry("contacts", _at(0, 0, value=5.0))),
    ("bodies", _entry("joint_pairs", _at(0, 0, value=9))),
    ("bodies", _entry("joint_pairs", _at(0, 3, value=9))),
]

# ------------------------------------------------------------------------------ mutations


def _numbers(rng, dtype):
    """A number of a dtype that is likely to be wrong."""
    if dtype.kind == "f":
        far = float(np.finfo(dtype).max)
        values = [math.nan, math.inf, -math.inf, -1.0, 0.0, 1.0, 2.0, 1e-30, 1e6, -1e9, 1e30]
        values += [far, -far, far**0.5, 1e-310, -0.0, 0.999, 1e18]
    else:
        low, far = int(np.iinfo(dtype).min), int(np.iinfo(dtype).max)
        values = [-1, 0, 1, 2, 3, 4, 5, 7, 100, 2**15, 2**31 - 1, 2**31, 2**62, low, far, far - 1]
        values = [v for v in values if low <= v <= far]
    return values[rng.integers(len(values))]


def _items(rng, array, name):
    """An array with one number, row or column changed, or several numbers at once."""
    array = array.copy()
    if not array.size:
        return array, "empty as it was"
    kind = rng.choice(["one", "one", "one", "by one", "factor", "row", "column", "some", "copied"])
    at = tuple(int(rng.integers(n)) for n in array.shape)
    value = _numbers(rng, array.dtype)
    with np.errstate(all="ignore"):
        if kind == "one":
            array[at] = value
        elif kind == "by one":
            array[at] += array.dtype.type(rng.choice([-1, 1]))
        elif kind == "factor":
            array[at] = array.dtype.type(array[at] * array.dtype.type(rng.choice([-1, 2, 0])))
        elif kind == "row":
            array[at[0]] = value
        elif kind == "column":
            array[(slice(None), *at[1:])] = value
        elif kind == "some":
            array[rng.random(array.shape) < 0.2] = value
        else:
            value = tuple(int(rng.integers(n)) for n in array.shape)
            array[at] = array[value]
    return array, f"{kind} {list(at)} {value}"


def _form(rng, array, name):
    """An array of another form."""
    ways = {
        "reversed": lambda: array[::-1],
        "permuted": lambda: rng.permutation(array),
        "rolled": lambda: np.roll(array, 1),
        "truncated": lambda: array[:-1],
        "longer": lambda: np.concatenate([array, array[-1:]]),
        "empty": lambda: array[:0],
        "transposed": lambda: array.T,
        "narrow": lambda: array[..., :-1],
        "deeper": lambda: array[..., None],
        "flat": lambda: array.ravel(),
        "scalar": lambda: array.dtype.type(0),
        "float32": lambda: array.astype(np.float32),
        "float64": lambda: array.astype(np.float64),
        "int64": lambda: array.astype(np.int64),
        "complex": lambda: array.astype(np.complex128),
        "object": lambda: array.astype(object),
        "text": lambda: array.astype(str),
        "swapped bytes": lambda: array.astype(array.dtype.newbyteorder()),
        "list": array.tolist,
        "zeros": lambda: np.zeros_like(array),
        "repeated": lambda: np.repeat(array, 2, 0),
        "ragged": lambda: [[1.0], [1.0, 2.0]],
        "none": lambda: None,
        "strided": lambda: np.asfortranarray(array),
    }
    way = rng.choice(list(ways))
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return ways[way](), way


def _scalar(rng, value, name):
    """Something in the place of a number or a text."""
    others = [math.nan, math.inf, -1, -1.0, 0, 0.0, 1, 2, 1e300, -1e300, 5e-324, 2**31 - 1, 2**31]
    others += [2**53, 2**61, 2**63, 2**200, True, None, "", "1", b"1", [1], {}, 1j, np.float32(1)]
    others += [np.int64(3), np.array(1.0), np.array([1.0]), np.bool_(True), "[]", '["\\ud800"]']
    others += ['["", "\\ud800", ""]', '["a", "b", "c"]', "[1, 2, 3]", "[" * 10**5, "null"]
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        others += [value + 1, value - 1, -value, value * 2, value * 1e9]
    if isinstance(value, bool):
        others += [not value] * 8
    k = int(rng.integers(len(others)))
    return others[k], repr(others[k])[:40]


def mutate(rng, state):
    """A state with one or two entries that are not its own, and what was done."""
    state, told = dict(state), []
    for _ in range(1 + (rng.random() < 0.25)):
        name = str(rng.choice(sorted(state)))
        value, way = state[name], rng.random()
        if way < 0.02:
            del state[name]
            told.append(f"{name} missing")
        elif way < 0.08:
            other = str(rng.choice(sorted(state)))
            state[name], state[other] = state[other], state[name]
            told.append(f"{name} and {other} swapped")
        elif not isinstance(value, np.ndarray) or not value.ndim:
            state[name], what = _scalar(rng, value, name)
            told.append(f"{name}: {what}")
        else:
            if value.dtype.kind not in "fiu":  # it was changed before
                continue
            state[name], what = (_items if way < 0.72 else _form)(rng, value, name)
            told.append(f"{name}: {what}")
    return state, "; ".join(told)


# ----------------------------------------------------------------------------- the child

# NaN where a deformation has no volume, and its material no stress.
STRESSES = {"stresses", "fields()['pressure']", "fields()['von_mises_stress']"}


def digest(state):
    """A hash of all bits of a state."""
    sha = hashlib.sha256()
    for name, value in sorted(state.items()):
        sha.update(name.encode())
        sha.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
    return sha.hexdigest()


def _is_finite(state, limit=math.inf):
    values = [np.asarray(v) for v in state.values() if not isinstance(v, str)]
    values = [v for v in values if v.dtype.kind in "fiu"]
    return all(np.isfinite(v).all() and (np.abs(v) <= limit).all() for v in values)


def _look(simulation):
    """Read all that can be read; returns where NaN is."""
    found, kind = [], type(simulation)
    values = {}
    for name in dir(kind):
        if name[:1] != "_" and isinstance(inspect.getattr_static(kind, name), property):
            values[name] = getattr(simulation, name)
    values |= {f"fields()[{k!r}]": v for k, (v, _) in simulation.fields().items()}
    values |= {f"diagnostics()[{k!r}]": v for k, v in simulation.diagnostics().items()}
    values["step_limit()"] = simulation.step_limit()[0]
    for name, value in values.items():
        if isinstance(value, (float, np.ndarray)):
            array = np.asarray(value)
            if array.dtype.kind == "f" and np.isnan(array).any():
                found.append(name)
    return found


class Target:
    """A simulation, its good state, and the bits that it goes on with."""

    def __init__(self, name, make):
        import substep

        self.substep = substep
        self.simulation = make(substep)
        self.good = self.simulation.state()
        self.sees_nan = set(_look(self.simulation))  # padding of batches
        self.dt = min(self.simulation.step_limit()[0], self.simulation.step_size or 0.01)
        self.path = Path(tempfile.gettempdir()) / f"attack-{os.getpid()}-{name}"
        self.after = self._goes_on()
        self.refused = (substep.InputError, TypeError)

    def _goes_on(self):
        """The bits after the good state and a step."""
        self.simulation.restore(self.good)
        assert digest(self.simulation.state()) == digest(self.good)
        self.simulation.step(self.dt)
        after = digest(self.simulation.state())
        self.simulation.restore(self.good)
        return after

    def attack(self, state):
        """Restore a state: the outcome, and what must not be, or None."""
        simulation, before = self.simulation, digest(self.good)
        try:
            simulation.restore(state)
        except self.refused:
            if digest(simulation.state()) != before:
                simulation.restore(self.good)
                return "refused", "refused, but changed"
            return "refused", None
        except Exception as error:
            return "refused", f"{type(error).__name__} of restore: {error}"
        wrong = self._use()
        if self._goes_on() != self.after:
            wrong = wrong or "after the good state was restored, the bits are others"
        return "accepted", wrong

    def _use(self):
        try:
            for do in (self._round_trip, self._read, self._step, self._round_trip, self._read):
                wrong = do()
                if wrong:
                    return wrong
        except self.substep.SolverError:
            pass  # is what a state of large numbers comes to
        except Exception as error:
            return f"{type(error).__name__} in use: {error}"
        return None

    def _round_trip(self):
        state = self.simulation.state()
        bits = digest(state)
        try:
            self.simulation.restore(state)
            self.simulation.save(self.path)
            self.simulation.load(self.path)
            same = digest(self.simulation.copy().state())
        except Exception as error:
            return f"what state() gives is refused: {type(error).__name__}: {error}"
        if digest(self.simulation.state()) != bits or same != bits:
            return "what state() gives is not restored"
        return None

    def _read(self):
        modest = _is_finite(self.simulation.state(), 1e15)  # squares of more may be infinite
        seen = set(_look(self.simulation)) - self.sees_nan
        if isinstance(self.simulation, self.substep.MaterialPointMethod):
            seen -= STRESSES
        return f"NaN in {sorted(seen)}" if modest and seen else None

    def _step(self):
        for take in (self.simulation.step, self.simulation.advance):
            finite = _is_finite(self.simulation.state())
            try:
                take(self.dt)
            except self.substep.InputError:
                return None  # a vertex inside an obstacle, the end of a field's time
            if finite and not _is_finite(self.simulation.state()):
                return "a step made numbers that are not finite, without an error"
        return None


def column_of(wrong):
    """Under which word what must not be is counted."""
    if wrong.startswith("took"):
        return "hangs"
    return "wrong types" if re.match(r"\w+ (of restore|in use): ", wrong) else "torn"


def run_tries(seed, begin, end, only):
    """In the child: tries one after the other, told as lines of JSON."""
    warnings.simplefilter("ignore")
    targets = {}
    names = [only] if only else list(MAKERS)
    for number in range(begin, end):
        past = PAST[number] if number < len(PAST) else None
        name = past[0] if past else names[number % len(names)]
        if name not in names:
            continue
        if name not in targets:
            print(json.dumps({"making": name}), flush=True)
            targets[name] = Target(name, MAKERS.get(name, crash))
        good = targets[name].good
        if past:
            state, told = past[1](good), "found before"
        else:
            state, told = mutate(np.random.default_rng([seed, number]), good)
        print(json.dumps({"try": number, "what": f"{name}: {told}"}), flush=True)
        start = time.process_time()  # whatever else the machine does
        outcome, wrong = targets[name].attack(state)
        took = time.process_time() - start
        if took > SLOW and not wrong and not SANITIZED:
            deaf = _deaf(targets.pop(name), state)
            wrong = f"took {took:.1f} s, and {deaf:.2f} s after Ctrl-C" if deaf > DEAF else None
        told = {"outcome": outcome, "wrong": wrong, "column": column_of(wrong or "")}
        print(json.dumps({"done": number, **told}), flush=True)


def _deaf(target, state):
    """Seconds from Ctrl-C in a slow try until it takes hold."""
    from interrupts import Alarm  # imports all of substep

    sent = time.perf_counter() + SLOW / 2
    try:
        with Alarm(SLOW / 2):
            target.attack(state)
    except KeyboardInterrupt:
        return time.perf_counter() - sent
    return math.inf


# ------------------------------------------------------------------------------ the parent


def _limit_memory():
    if not SANITIZED:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


def _lines(child):
    """Lines of a child as they come; None where none comes for long."""
    rest = b""
    while True:
        ready, _, _ = select.select([child.stdout], [], [], HANG * (10 if SANITIZED else 1))
        if not ready:
            yield None
            return
        chunk = os.read(child.stdout.fileno(), 1 << 16)
        if not chunk:
            return
        *whole, rest = (rest + chunk).split(b"\n")
        yield from map(json.loads, whole)


def attack(count, seed, only=None, begin=0):
    """Try `count` states: first what was found before, then what comes of the seed.

    Returns
    -------
    dict
        Of each maker `calls`, `refused`, `accepted`, `crashes`, `hangs`, `wrong types` and `torn`
        (all else that must not be); and `findings`, how to see each again.
    """
    rows, findings = {}, []

    def note(what, column, finding=None):
        row = rows.setdefault(what.partition(":")[0], {})
        row[column] = row.get(column, 0) + 1
        if finding:
            findings.append(f"{what}: {finding} (seed {seed}, try {begin})")

    while begin < count:
        numbers = [str(seed), str(begin), str(count)]
        child = subprocess.Popen(
            [sys.executable, __file__, "--child", *numbers, *([only] if only else [])],
            stdout=subprocess.PIPE,
            preexec_fn=_limit_memory,
        )
        line, what = None, "nothing"
        for line in _lines(child):
            if line is None:
                child.kill()
                note(what, "hangs", "no answer")
                break
            if "making" in line:
                what = f"making {line['making']}"
            elif "try" in line:
                begin, what = line["try"], line["what"]
                note(what, "calls")
            else:
                note(what, line["outcome"])
                if line["wrong"]:
                    note(what, line["column"], line["wrong"])
        code = child.wait()
        child.stdout.close()
        assert not what.startswith("making"), f"{what} ended with {code}"
        if code and line is not None:
            note(what, "crashes", f"ended with {code}")
        begin += 1
    return {**rows, "findings": findings}


def main():
    if sys.argv[1:2] == ["--child"]:
        seed, begin, end = map(int, sys.argv[2:5])
        return run_tries(seed, begin, end, sys.argv[5] if len(sys.argv) > 5 else None)
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=list(MAKERS))
    given = parser.parse_args()
    for begin in range(0, given.count, 500):
        told = attack(min(begin + 500, given.count), given.seed, given.only, begin)
        print("\n".join(["", *told.pop("findings"), *map(str, told.items())]), flush=True)
    return None


if __name__ == "__main__":
    main()
