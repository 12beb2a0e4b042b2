"""A short share of each torture; `python tests/attack/run.py --hours 8` is the long run."""

import inspect
import os

import allocations
import api
import interrupts
import numpy as np
import pytest
import runner
import soak
import subjects
import threads
from runner import SANITIZED
from subjects import Subject, Twin, call
from test_conformance import Toy, classes


def holds(counts):
    assert counts.total("calls"), "nothing was tried"
    assert not counts.failures(), "\n\n".join(counts.findings[:5])


# ---------------------------------------------------------------------------- what is attacked


def test_every_public_function_and_class_is_called():
    called = {call.name.rsplit(".", 1)[-1] for call in subjects.functions()}
    called |= {subject.name.split(" ")[0] for subject in subjects.subjects()}
    missing = {n for n in subjects.public_callables() if n.rsplit(".", 1)[-1] not in called}
    assert missing == subjects.NOT_CALLED


@pytest.mark.parametrize("kind", classes(), ids=lambda kind: kind.__name__)
def test_every_method_of_a_simulation_is_called(kind):
    subject = next(s for s in subjects.subjects() if s.name == kind.__name__)
    called = {call.name.rstrip("=") for call in subject.calls}
    for name in dir(kind):
        static = inspect.getattr_static(kind, name)
        if name[:1] != "_" and (callable(static) or getattr(static, "fset", None)):
            if name != "set_motor_targets":  # no batch among the subjects has motors
                assert name in called, f"{kind.__name__}.{name}: not in subjects.py"


# ---------------------------------------------------------------------------- short shares


def test_public_api():
    holds(api.attack(150 if SANITIZED else 400, seed=0))


def place(name, wanted):
    """Where a call is among all subjects."""
    for number, subject in enumerate(subjects.subjects()):
        for position, one in enumerate(subject.calls):
            if (subject.name, one.name) == (name, wanted):
                return number, position
    raise AssertionError(f"{name}.{wanted}: not in subjects.py")


def number_of(name, among):
    return [subject.name for subject in among].index(name)


@pytest.mark.parametrize("name", ["Advection", "MassSpring", "RigidBodies"])
def test_a_second_thread(name):
    holds(threads.work(["reads", number_of(name, subjects.of_simulations()), 0, 1]))


@pytest.mark.parametrize("name", ["Collider", "RK45", "RigidBodies (joints)"])
def test_two_threads_that_call(name):
    holds(threads.work(["calls", number_of(name, subjects.subjects()), 0, 2]))


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("GridFlow (two fluids)", "set_velocity"),
        ("MaterialPointMethod", "set_positions"),
        ("MaterialPointMethod (flowing)", "set_deformation_gradients"),
        ("PositionBasedDynamics", "state"),
        ("PositionBasedDynamics", "gravity="),
        ("RigidBodies", "remove"),
        ("RigidBodies (joints)", "step"),
    ],
)
def test_interrupts(name, wanted):
    holds(interrupts.work([*place(name, wanted), 0, 1]))


def test_interrupts_in_numpy(monkeypatch):
    """It made a TypeError of one in a comparison of rows as structures."""
    monkeypatch.setattr(interrupts, "OURS", os.path.dirname(np.__file__))
    holds(interrupts.work([*place("TetMesh", "surface"), 0, 0]))


# Most were a crash, or left a state of no whole call.
ALLOCATIONS = [
    ("SoftBody", "step"),
    ("GridFlow (two fluids)", "set_velocity"),
    ("functions", "systems.Oscillators"),
    ("TaylorGreen", "__call__"),
    ("RigidBodies", "set_velocities"),
    ("RigidBodies", "ball"),
    ("RigidBodies", "remove"),
    ("MaterialPointMethod", "step"),
    ("LU", "factor"),
    ("MassSpring", "step"),
    ("PositionBasedDynamics (multilevel)", "step"),
    ("RK45", "step"),
]


@pytest.mark.skipif(SANITIZED, reason="sanitizers have their own malloc")
def test_memory_that_runs_out():
    holds(allocations.run([[*place(*call), 0, 80] for call in ALLOCATIONS]))


@pytest.mark.parametrize("name", ["Radau", "RigidBodies"])
def test_many_lives(name):
    holds(soak.work([number_of(name, subjects.subjects()), 90]))


# ---------------------------------------------------------------------------- tortures that notice


class Torn(Toy):
    """Writes in two parts."""

    def _write(self, name, values, rows):
        array = getattr(self._native, name)
        for row, value in zip(rows, values, strict=True):
            array[row] = value


class Leaking(Toy):
    kept = []  # noqa: RUF012

    def _take_step(self, dt):
        super()._take_step(dt)
        self.kept.append(np.zeros(100))


class Wrong(Toy):
    def set_velocities(self, values, ids=None):
        super().set_velocities(values, ids)
        raise KeyError("velocities")


def toy(kind, *calls):
    return Subject(kind.__name__, kind, calls)


def test_a_torn_state_is_noticed(monkeypatch):
    monkeypatch.setattr(interrupts, "OURS", __file__)
    values = np.ones((3, 3))
    for kind, torn in ((Toy, False), (Torn, True)):
        twin = Twin(
            toy(kind, call("set_velocities", values=values)), call("set_velocities", values=values)
        )
        counts = interrupts.interrupt_everywhere(twin, 0, "toy")
        assert bool(counts.total("torn")) == torn, counts.findings


def test_a_wrong_type_and_a_change_are_noticed():
    wanted, counts = call("set_velocities", values=np.ones((3, 3))), runner.Counts()
    for k in range(20):
        api.one_try(toy(Wrong, wanted), wanted, api.random.Random(k), counts, "toy")
    assert counts.total("wrong types") and counts.total("torn")


def test_what_two_threads_get_is_noticed(monkeypatch):
    wrong = toy(Wrong, call("set_velocities", values=np.ones((3, 3))))
    monkeypatch.setattr(threads, "subjects", lambda: [wrong])
    assert threads.work(["calls", 0, 0, 1]).total("wrong types")


def test_a_leak_is_noticed():
    for kind, leaks in ((Toy, 0), (Leaking, 1)):
        assert soak.live_often(toy(kind, call("step")), 90, "toy").total("leaks") == leaks


def test_crashes_and_hangs_are_noticed():
    counts = runner.run_jobs("mishaps", ["good", "crash", "hang", "good"], patience=3.0)
    assert counts.rows == {"good": {"calls": 2}, "crash": {"crashes": 1}, "hang": {"hangs": 1}}
    assert "SEGV" in counts.findings[0]  # the signal, or what ASan tells
