"""One language: every class that steps something in time, held to each line of the protocol.

The classes are found by walking the package; `tests/<package>/examples.py` has a function of the
name of each that makes a small one. The words are those of the tables in docs/conventions.md. At
the end a toy that keeps all lines is broken in one after the other, and each must be noticed.
"""

import contextlib
import copy
import dataclasses
import importlib
import importlib.util
import inspect
import math
import pickle
import pkgutil
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import substep
from substep import _core
from substep.base.attributes import settable
from substep.base.rows import Numbered, Points, read_only
from substep.base.schema import TIME, Number, Rows, check
from substep.base.simulation import Simulation, StepReport, with_energy

TESTS = Path(__file__).resolve().parents[1]
DURATION = 0.05


def classes():
    """Simulations that users make: those that no other class of the package is made of."""
    for module in pkgutil.walk_packages(substep.__path__, "substep."):
        if not module.name.startswith(("substep.scenes", "substep._", "substep.__main__")):
            importlib.import_module(module.name)
    found = [Simulation]
    for kind in found:
        found += [k for k in kind.__subclasses__() if is_ours(k) and k not in found]
    return [k for k in found if not any(is_ours(sub) for sub in k.__subclasses__())]


def is_ours(kind):
    return kind.__module__.startswith("substep.") and ".scenes." not in kind.__module__


def example(kind):
    """The function that makes a small one."""
    path = TESTS / kind.__module__.split(".")[1] / "examples.py"
    assert path.exists(), f"{path}: expected, with a function {kind.__name__}"
    spec = importlib.util.spec_from_file_location(f"examples_{path.parent.name}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert hasattr(module, kind.__name__), f"{path}: expected a function {kind.__name__}"
    return getattr(module, kind.__name__)


def words():
    """Of each table of the dictionary the words, and those that are not used."""
    text = (TESTS.parent / "docs/conventions.md").read_text().split("## Dictionary")[1]
    text = re.split(r"\n## ", text)[0]
    tables = {}
    for section in text.split("### ")[1:]:
        name = section.split("\n", 1)[0].rsplit(" ", 1)[-1]
        rows = [line.split("|") for line in section.splitlines() if line.startswith("| `")]
        tables[name] = (
            {word for row in rows for word in re.findall(r"`(\w+)`", row[1])},
            {word for row in rows for word in re.findall(r"`(\w+)`", row[3])},
        )
    return tables


WORDS = words()


def word_of(name):
    """The word in a name, which in a world has that of a member before it."""
    return name.rpartition(".")[2]


def content(simulation):
    """A hash of the whole state."""
    arrays = []
    for name, value in sorted(simulation.state().items()):
        text = value if isinstance(value, str) else ""
        arrays.append(np.frombuffer(f"{name}{text}".encode(), np.uint8))
        if not text:
            arrays.append(np.asarray(value))
    return substep.state_hash(*arrays)


def public_arrays(simulation):
    """Properties that are arrays."""
    kind = type(simulation)
    for name in dir(kind):
        if name[:1] != "_" and isinstance(inspect.getattr_static(kind, name), property):
            value = getattr(simulation, name)
            if isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
                yield name, value


def setters(simulation):
    """Methods set_<array>(values, ids=None), whose array can be read."""
    arrays = dict(public_arrays(simulation))
    for name in dir(type(simulation)):
        if name.startswith("set_") and name[4:] in arrays:
            yield name[4:], getattr(simulation, name)


# ---------------------------------------------------------------------------- the lines


def diagnostics_have_the_words(make):
    simulation = make()
    simulation.advance(DURATION)
    values = simulation.diagnostics()
    unknown = {word_of(name) for name in values} - WORDS["diagnostics"][0]
    assert not unknown, f"not in the dictionary: {unknown}"
    assert all(type(value) is float for value in values.values())
    parts = [values[n] for n in values if n in ("kinetic_energy", "elastic_energy")]
    if parts:
        parts += [values.get("gravitational_energy", 0.0)]
        assert values["energy"] == pytest.approx(sum(parts), abs=1e-12)


def fields_have_the_words(make):
    simulation = make()
    fields = simulation.fields()
    unknown = {word_of(name) for name in fields} - WORDS["fields"][0]
    assert not unknown, f"not in the dictionary: {unknown}"
    lengths = {
        (name.rpartition(".")[0], len(values))
        for name, (values, unit) in fields.items()
        if isinstance(unit, str)
    }
    assert len(lengths) == len({owner for owner, _ in lengths})


def arguments_and_properties_have_the_words(make):
    kind = type(make())
    used = {n for n in dir(kind) if n[:1] != "_"}
    for method in ("__init__", "add", "step", "advance"):
        if hasattr(kind, method):
            used |= set(inspect.signature(getattr(kind, method)).parameters)
    refused = used & WORDS["properties"][1]
    assert not refused, f"other words in the dictionary: {refused}"
    arguments = inspect.signature(kind).parameters
    assert arguments["threads"].default is None
    assert not any(p.kind is p.VAR_KEYWORD for p in arguments.values())


def integrators_have_the_words(make):
    simulation = make()
    if "integrator" not in inspect.signature(type(simulation)).parameters:
        return
    text = (TESTS.parent / "docs/conventions.md").read_text()
    row = next(line for line in text.splitlines() if line.startswith("| `integrator`"))
    assert simulation.integrator in re.findall(r"`(\w+)`", row.split("(")[0])


def unknown_attributes_are_refused(make):
    simulation = make()
    before = content(simulation)
    for name in ("gravty", "step_sise", "viscosities"):
        with pytest.raises(substep.InputError, match="what can be set") as caught:
            setattr(simulation, name, 1)
        assert isinstance(caught.value, AttributeError)
        assert not hasattr(simulation, name)
        assert "step_size" in str(caught.value)
    assert content(simulation) == before


def fixed_attributes_are_refused(make):
    simulation = make()
    kind = type(simulation)
    for name in {*inspect.signature(kind).parameters, *dir(kind), *vars(simulation)}:
        if name[:1] == "_" or name in settable(kind):
            continue
        with pytest.raises(substep.InputError, match=f"^{name}: .*what can be set"):
            setattr(simulation, name, 1.0)


def step_size_takes_effect(make):
    for take in ("step", "advance"):
        simulation = make()
        size = simulation.step_size or simulation.step_limit()[0]
        simulation.step_size = h = size / 2
        assert simulation.step_size == h
        start, times = simulation.time, []
        if take == "step":
            simulation.step()
            assert simulation.time == pytest.approx(start + h, rel=1e-12)
        else:
            simulation.advance(3 * h, lambda s, times=times: times.append(s.time))
            assert times == pytest.approx([start + k * h for k in (1, 2, 3)])
            other = make()
            other.step_size = h
            other.advance(3 * h)
            assert other.report.steps == 3
        for wrong in (0.0, -1.0, math.nan):
            with pytest.raises(substep.InputError, match="step_size"):
                simulation.step_size = wrong


def arrays_are_views_or_read_only(make):
    simulation = make()
    simulation.advance(DURATION)
    for name, array in public_arrays(simulation):
        if not array.flags.writeable or not array.size:
            continue
        kept = array.copy()
        array[:] = array + (0.25 if array.dtype.kind == "f" else 1)
        assert np.array_equal(getattr(simulation, name), array), f"{name}: a change is lost"
        array[:] = kept


def setters_write_rows(make):
    simulation = make()
    if not isinstance(simulation, Numbered):  # a grid: no rows with ids
        return
    names = [name for name, _ in setters(simulation)]
    assert "positions" in names
    if hasattr(simulation, "velocities"):
        assert {"velocities", "forces"} <= set(names)
    for name, setter in setters(simulation):
        assert list(inspect.signature(setter).parameters)[:2] == ["values", "ids"]
        assert inspect.signature(setter).parameters["ids"].default is None
        present = getattr(simulation, name).copy()
        ids = simulation.ids if simulation.ids.ndim == 1 else simulation.ids[0]
        axis = simulation.ids.ndim - 1
        one = present.take([1], axis)
        one += 0.25 if name != "rotations" else 0.0  # they stay of length 1
        setter(one, ids[1:2])
        after = getattr(simulation, name)
        assert np.allclose(after.take([1], axis), one, rtol=1e-6, atol=1e-6)
        rest = range(2, after.shape[axis])
        assert np.array_equal(after.take(rest, axis), present.take(rest, axis))
        before = content(simulation)
        with pytest.raises(IndexError):
            setter(one, [10**6])
        with pytest.raises(substep.InputError):
            setter(one[..., :1], ids[1:2])
        assert content(simulation) == before


def forces_are_used_up(make):
    if not hasattr(make(), "forces"):
        assert not hasattr(make(), "velocities")
        return
    ends = []
    for push in (0.0, 3.0):
        simulation = make()
        forces = np.zeros(simulation.forces.shape)
        forces[..., 1, 0] = push
        simulation.set_forces(forces)
        assert np.array_equal(simulation.forces, forces)
        simulation.step()
        assert not simulation.forces.any(), "forces: expected that a step uses them up"
        ends.append(np.array(simulation.velocities)[..., 1, 0])
    assert (ends[1] > ends[0]).all(), "forces: expected that they accelerate"


def gravity_is_told(make):
    simulation = make()
    if not hasattr(simulation, "velocities"):
        return
    columns = simulation.velocities.shape[-1]
    assert simulation.gravity.shape[-1] == columns
    assert not simulation.gravity.flags.writeable
    assert (simulation.gravity[..., -1] == -9.81).all()
    if simulation.gravity.ndim > 1:  # of many worlds
        return
    view = simulation.velocities  # where it can be written into, it goes on being a view
    simulation.gravity = 2 * simulation.gravity
    if view.flags.writeable:
        view[-1] += 1
        assert np.array_equal(view, simulation.velocities)
    for take in (lambda s: s.step(0.001), lambda s: s.advance(0.001)):
        simulation, other = make(), make()
        other.gravity = 3 * simulation.gravity
        assert content(other) == content(simulation)
        assert np.array_equal(other.gravity, 3 * simulation.gravity)
        take(simulation)
        take(other)
        fall = np.array(other.velocities)[..., -1] - np.array(simulation.velocities)[..., -1]
        assert (fall <= 0).all() and fall.min() == pytest.approx(-2 * 9.81 * 0.001, rel=0.2)
    for wrong in (3.0, (0, math.nan, 0), (0, 0, 0, 0)):
        with pytest.raises(substep.InputError, match="gravity"):
            simulation.gravity = wrong


def states_are_exact(make):
    simulation = make()
    simulation.advance(DURATION)
    kept, before = simulation.state(), content(simulation)
    simulation.advance(DURATION)
    after = content(simulation)
    assert after != before
    simulation.restore(kept)
    assert content(simulation) == before
    simulation.advance(DURATION)
    assert content(simulation) == after
    other = make()
    other.restore(kept)
    other.advance(DURATION)
    assert content(other) == after


def wrong_states_are_refused_by_name(make):
    simulation = make()
    simulation.advance(DURATION)
    good, before = simulation.state(), content(simulation)
    for name, value in good.items():
        wrong = [{k: v for k, v in good.items() if k != name}]
        if isinstance(value, np.ndarray):
            wrong.append(good | {name: value[..., None]})
            wrong.append(good | {name: value.astype(np.complex128)})
        else:
            wrong.append(good | {name: None})
        if isinstance(value, float):
            wrong.append(good | {name: math.nan})
        for state in wrong:
            with pytest.raises((substep.InputError, TypeError), match=name):
                simulation.restore(state)
            assert content(simulation) == before
    simulation.restore(good)


def copies_are_exact(make):
    simulation = make()
    simulation.advance(DURATION)
    simulation.threads = 2
    before = content(simulation)
    ways = (
        lambda s: s.copy(),
        copy.copy,
        copy.deepcopy,
        lambda s: pickle.loads(pickle.dumps(s)),
    )
    twins = [way(simulation) for way in ways]
    assert content(simulation) == before
    for twin in twins:
        assert type(twin) is type(simulation)
        assert content(twin) == before
        assert (twin.time, twin.threads, twin.step_size) == (
            simulation.time,
            simulation.threads,
            simulation.step_size,
        )
        twin.advance(DURATION)
        assert content(simulation) == before, "a copy shares what changes"
    simulation.advance(DURATION)
    after = content(simulation)
    assert [content(twin) for twin in twins] == [after] * len(twins)


def files_are_exact(make):
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        simulation = make()
        simulation.advance(DURATION)
        simulation.save(f"{folder}/a")
        other = make()
        other.load(f"{folder}/a")
        assert content(other) == content(simulation)


def callbacks_follow_steps(make):
    simulation = make()
    seen = []
    simulation.advance(DURATION, lambda given: seen.append((given, given.time)))
    assert seen and all(given is simulation for given, _ in seen)
    times = [time for _, time in seen]
    assert times == sorted(times) and times[-1] == simulation.time == pytest.approx(DURATION)
    assert simulation.report.steps == len(seen)
    unseen = make()
    unseen.advance(DURATION)
    assert content(unseen) == content(simulation)
    for method in ("step", "advance"):
        with pytest.raises(substep.InputError, match=f"{method}: called by the callback"):
            simulation.advance(DURATION, lambda given, name=method: getattr(given, name)(0.01))

    class Stop(Exception):
        pass

    def stop(given):
        given.state()  # may be read
        raise Stop

    time = simulation.time
    with pytest.raises(Stop):
        simulation.advance(DURATION, stop)
    assert simulation.time > time
    simulation.step()  # nobody owns it any more
    with pytest.raises(TypeError, match="callback"):
        simulation.advance(DURATION, 3)


def callbacks_may_go_back(make):
    """And change the step: `advance` takes what is left from there."""
    simulation, unseen, seen = make(), make(), []
    for one in (simulation, unseen):
        one.step_size = size = (one.step_size or one.step_limit()[0]) / 2
    start = simulation.state()

    def back(given):
        seen.append(given.time)
        if len(seen) == 2:
            given.restore(start)

    simulation.advance(3 * size, back)
    unseen.advance(3 * size)
    assert len(seen) == simulation.report.steps == 5
    assert content(simulation) == content(unseen)
    simulation.advance(3 * size, lambda given: setattr(given, "step_size", size / 2))
    assert simulation.report.steps == 5
    assert simulation.time == pytest.approx(start["time"] + 6 * size)


def interrupts_let_go(make):
    """Of a simulation that they stop, whichever instruction of Python they hit."""

    class Stop(BaseException):  # as KeyboardInterrupt: numpy makes a TypeError of an Exception
        pass

    armed = True

    def ring(*_):
        if armed:
            raise Stop

    simulation = make()
    start = simulation.state()
    before = signal.signal(signal.SIGALRM, ring)
    hook = sys.unraisablehook
    sys.unraisablehook = lambda lost: None if lost.exc_type is Stop else hook(lost)  # by Python
    try:
        for seconds in np.random.default_rng(0).uniform(1e-4, 2e-3, 150):
            try:
                with contextlib.suppress(Stop):
                    signal.setitimer(signal.ITIMER_REAL, seconds, 1)  # again if Python lost it
                    while True:
                        simulation.step()
                        simulation.advance(simulation.report.dt, lambda given: given.time)
                signal.setitimer(signal.ITIMER_REAL, 0)
                simulation.restore(start)
            except substep.InputError as error:
                raise AssertionError("it is still in use") from error
    except Stop:  # came while that was told
        raise AssertionError("it is still in use") from None
    finally:
        armed = False
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        sys.unraisablehook = hook


def public_members(kind):
    """Names of its methods and properties that substep has written."""
    for name in dir(kind):
        owner = next(k for k in kind.__mro__ if name in vars(k))
        member = vars(owner)[name]
        if is_ours(owner) and (name[0] != "_" or name == "__len__"):
            if callable(member) or isinstance(member, property):
                yield name


def other_threads_are_refused_while_it_steps(make):
    simulation = make()
    told = {}

    def use():
        for name in public_members(type(simulation)):
            try:
                found = getattr(simulation, name)
                given = ("no/where",) if name == "save" else ()
                told[name] = found(*given) if callable(found) else found
            except Exception as error:
                told[name] = error
        try:
            simulation.step_size = 0.01
        except substep.InputError as error:
            told["step_size"] = error

    def look(given):
        thread = threading.Thread(target=use)
        thread.start()
        thread.join()

    simulation.advance(1e-9, look)
    assert {"step", "advance", "state", "restore", "copy", "time"} <= set(told)
    assert "set_positions" in told or not isinstance(simulation, Numbered)
    for name, answer in told.items():
        assert isinstance(answer, substep.InputError), f"{name}: {answer!r}"
        assert "in use by another thread" in str(answer), f"{name}: {answer}"


def other_threads_see_whole_steps(make):
    simulation, twin = make(), make()
    whole = {content(twin)}
    h = simulation.step_size or simulation.step_limit()[0] / 2
    for _ in range(30):
        twin.step(h)
        whole.add(content(twin))
    seen, going = set(), True

    def look():
        while going or not seen:
            try:
                seen.add(content(simulation))
                seen.add(content(simulation.copy()))
            except substep.InputError as error:
                assert "in use by another thread" in str(error)

    every = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    thread = threading.Thread(target=look)
    thread.start()
    try:
        for _ in range(30):
            simulation.step(h)
            assert content(simulation) in whole  # it waits, and is not refused
    finally:
        going = False
        thread.join()
        sys.setswitchinterval(every)
    assert seen and seen <= whole


def reports_tell_of_the_last_call(make):
    simulation = make()
    h = simulation.step_size or simulation.step_limit()[0] / 2
    simulation.step_size = h
    assert isinstance(simulation.report, StepReport)
    assert dataclasses.is_dataclass(simulation.report)
    simulation.step()
    assert simulation.report.steps == 1
    assert simulation.report.dt == pytest.approx(h)
    simulation.advance(2 * h)
    report = simulation.report
    assert report.steps == 2
    assert isinstance(report.converged, bool) and isinstance(report.iterations, int)
    simulation.step()
    assert report.steps == 2, "a report is of its call"


def advance_is_one(make):
    simulation = make()
    kind = type(simulation)
    assert list(inspect.signature(kind.advance).parameters)[:3] == ["self", "duration", "callback"]
    assert list(inspect.signature(kind.step).parameters)[:2] == ["self", "dt"]
    before = content(simulation)
    for wrong in (-1.0, math.nan, math.inf):
        with pytest.raises(substep.InputError, match="duration"):
            simulation.advance(wrong)
    for wrong in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(substep.InputError, match="dt"):
            simulation.step(wrong)
    simulation.advance(0.0)
    assert content(simulation) == before
    duration = 2.7 * (simulation.step_size or simulation.step_limit()[0])
    simulation.advance(duration)
    assert simulation.time == duration


def limits_and_ids_are_told(make):
    simulation = make()
    dt, reason = simulation.step_limit()
    assert isinstance(dt, float) and dt > 0 and isinstance(reason, str)
    assert isinstance(simulation, Simulation)
    if not isinstance(simulation, Numbered):
        return
    assert simulation.ids.dtype == np.int64
    assert (np.diff(simulation.ids, axis=-1) > 0).all()
    own = simulation.ids if simulation.ids.ndim == 1 else simulation.ids[0]
    assert simulation.rows(own[::-1]).tolist() == list(range(len(own)))[::-1]
    assert simulation.rows(int(own[1])) == 1


def threads_change_no_bits(make):
    found = set()
    for threads in (1, 2):
        simulation = make()
        simulation.threads = threads
        assert simulation.threads == threads
        simulation.advance(DURATION)
        found.add(content(simulation))
    assert len(found) == 1
    with pytest.raises(substep.InputError, match="threads"):
        simulation.threads = 0


LINES = (
    diagnostics_have_the_words,
    fields_have_the_words,
    arguments_and_properties_have_the_words,
    integrators_have_the_words,
    unknown_attributes_are_refused,
    fixed_attributes_are_refused,
    step_size_takes_effect,
    arrays_are_views_or_read_only,
    setters_write_rows,
    forces_are_used_up,
    gravity_is_told,
    states_are_exact,
    wrong_states_are_refused_by_name,
    copies_are_exact,
    files_are_exact,
    callbacks_follow_steps,
    callbacks_may_go_back,
    interrupts_let_go,
    other_threads_are_refused_while_it_steps,
    other_threads_see_whole_steps,
    reports_tell_of_the_last_call,
    advance_is_one,
    limits_and_ids_are_told,
    threads_change_no_bits,
)


@pytest.mark.parametrize("line", LINES, ids=lambda line: line.__name__)
@pytest.mark.parametrize("kind", classes(), ids=lambda kind: kind.__name__)
def test_each_class_keeps_each_line(kind, line):
    line(example(kind))


LOADING = """
import importlib, sys
sys.path.insert(0, sys.argv[1])
import test_conformance
from test_conformance import DURATION, content
maker = getattr(test_conformance, sys.argv[3])
for module, name in (kind.split(":") for kind in sys.argv[4:]):
    simulation = maker(getattr(importlib.import_module(module), name))()
    simulation.load(f"{sys.argv[2]}/{name}")
    simulation.advance(DURATION)
    print(name, content(simulation))
"""


def assert_goes_on_in_a_new_process(simulations, folder, maker=example):
    for simulation in simulations:
        simulation.save(folder / type(simulation).__name__)
        simulation.advance(DURATION)
    kinds = [f"{type(s).__module__}:{type(s).__name__}" for s in simulations]
    command = [sys.executable, "-c", LOADING, Path(__file__).parent, folder]
    command += [maker.__name__, *kinds]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    found = dict(line.split() for line in done.stdout.splitlines())
    assert found == {type(s).__name__: content(s) for s in simulations}, done.stderr


def test_checkpoints_go_on_in_a_new_process(tmp_path):
    simulations = [example(kind)() for kind in classes()]
    for simulation in simulations:
        simulation.advance(DURATION)
    assert_goes_on_in_a_new_process(simulations, tmp_path)


def trampoline():
    """A world whose steps are short; liquids take as many in a row of their own."""
    bodies = substep.RigidBodies(step=1 / 120)
    ball = bodies.add(substep.Sphere(0.35), (0, 0, 0.4), density=10.0)
    mesh = substep.geometry.grid_mesh(5, 5)
    cloth = substep.MassSpring.from_mesh(
        mesh,
        density=0.5,
        stiffness=500.0,
        damping_time=0.01,
        pinned=abs(mesh.vertices[:, :2]).max(axis=1) > 0.4,
        colliders=bodies.make_colliders(ball),
    )
    return substep.World({"bodies": bodies, "cloth": cloth})


def lasting(kind):
    """The function that makes one for many steps."""
    return trampoline if kind is substep.World else example(kind)


@pytest.mark.slow
@pytest.mark.parametrize("kind", classes(), ids=lambda kind: kind.__name__)
def test_checkpoints_after_many_steps_go_on_in_a_new_process(kind, tmp_path):
    simulation = lasting(kind)()
    step_size, threads = simulation.step_size, simulation.threads
    simulation.step_size = step = step_size or simulation.step_limit()[0] / 2
    simulation.threads = 1  # two wait for each other most of such short loops
    steps = 25_000 if kind is substep.World else 100_000  # of which each is one of every member
    simulation.advance(steps * step)
    assert simulation.report.steps >= steps
    simulation.step_size, simulation.threads = step_size, threads
    assert_goes_on_in_a_new_process([simulation], tmp_path, lasting)


def test_public_simulations_are_enrolled():
    assert {kind.__name__ for kind in classes()} >= {
        name
        for name in substep.__all__
        if inspect.isclass(found := getattr(substep, name)) and issubclass(found, Simulation)
    }


@pytest.mark.parametrize(
    ("held", "name"),
    [
        (lambda: substep.Emitter((0, 0, 1), (0, 0, -1), 1.0, radius=0.1), "speed"),
        (lambda: substep.Sink(substep.Plane()), "shape"),
        (lambda: substep.Distance([[0, 1]]), "compliance"),
        (lambda: substep.pbd.SelfCollision([[0, 1, 2]], thickness=0.1), "friction"),
        (lambda: substep.mpm.Sand(young_modulus=1e5), "density"),
        (lambda: substep.rigid.SpeedMotor(1.0), "speed"),
    ],
)
def test_what_users_hold_cannot_be_changed_in_silence(held, name):
    one = held()
    for attribute in (name, f"{name}s"):
        with pytest.raises(AttributeError):
            setattr(one, attribute, 1.0)
    for value in vars(one).values():
        assert not isinstance(value, np.ndarray) or not value.flags.writeable


def test_a_derived_class_may_change_what_is_its_own():
    class Counted(substep.RigidBodies):
        limit = 3

        def __init__(self):
            self.early = 1
            super().__init__()
            self.late = 2

    bodies = Counted()
    bodies.early, bodies.late, bodies.limit = 4, 5, 6
    with pytest.raises(substep.InputError, match=r"gravty.*did you mean gravity\?"):
        bodies.gravty = 1
    with pytest.raises(substep.InputError, match="other: a Counted has no such attribute"):
        bodies.other = 1
    twin = bodies.copy()
    assert (twin.early, twin.late, twin.limit) == (4, 5, 3 if twin.limit == 3 else 6)


# ---------------------------------------------------------------------------- a toy, broken


class Toy(Points):
    """Masses that fall: all lines are kept."""

    _dimension = 3
    _fixed_step = True

    def __init__(self, n=3, *, step=0.01, time=0.0, threads=None):
        native = SimpleNamespace(
            positions=np.zeros((n, 3)), velocities=np.zeros((n, 3)), forces=np.zeros((n, 3))
        )
        native.positions[:, 0] = np.arange(n)
        super().__init__(native, time, threads)
        self._step_size = step
        self._gravity, self._options = read_only(np.array([0.0, 0.0, -9.81])), {}

    def __len__(self):
        return len(self._native.positions)

    positions = property(lambda self: read_only(self._native.positions.copy()))
    velocities = property(lambda self: read_only(self._native.velocities.copy()))
    forces = property(lambda self: read_only(self._native.forces.copy()))

    def _write(self, name, values, rows):
        getattr(self._native, name)[rows] = values

    def _take_step(self, dt):
        native = self._native
        native.velocities += dt * (self._gravity + native.forces)
        native.positions += dt * native.velocities
        native.forces[:] = 0.0
        native.time += dt

    def step_limit(self):
        return 1.0, "a toy"

    def diagnostics(self):
        return with_energy({"kinetic_energy": float((self._native.velocities**2).sum()) / 2})

    def fields(self):
        return {"position": (self.positions, "m"), "velocity": (self.velocities, "m/s")}

    def _schema(self):
        arrays = [Rows(n, np.float64, ("n", 3)) for n in ("positions", "velocities", "forces")]
        return [TIME, *arrays], {"n": len(self)}, np.float64

    def _state(self):
        names = ("positions", "velocities", "forces")
        return {"time": self.time} | {n: getattr(self._native, n).copy() for n in names}

    def _put_state(self, state):
        for name, value in state.items():
            setattr(self._native, name, value)

    def _make(self, state):
        return SimpleNamespace(**{n: np.array(v) for n, v in state.items()})


@pytest.mark.parametrize("line", LINES, ids=lambda line: line.__name__)
def test_the_toy_keeps_each_line(line):
    line(Toy)


class OtherEnergy(Toy):
    def diagnostics(self):
        return {"potential_energy": 0.0}


class OtherField(Toy):
    def fields(self):
        return {"positions": (self.positions, "m")}


class OtherArgument(Toy):
    def __init__(self, margin=0.1, threads=None):
        super().__init__(threads=threads)


class OtherIntegrator(Toy):
    def __init__(self, integrator="leap", threads=None):
        super().__init__(threads=threads)
        self.integrator = integrator


class Open(Toy):
    def __setattr__(self, name, value):
        object.__setattr__(self, name, value)


class OpenArgument(Toy):
    step_limit_factor = 2.0
    step = Toy.step

    def __init__(self, viscosity=1.0, threads=None):
        super().__init__(threads=threads)
        self.viscosity = viscosity

    def __setattr__(self, name, value):
        if name == "viscosity":
            object.__setattr__(self, name, value)
        else:
            super().__setattr__(name, value)


class StepWithoutItsSize(Toy):
    def _next_step(self):
        return 0.01


class LostChange(Toy):
    positions = property(lambda self: self._native.positions.copy())


class SetterOfAll(Toy):
    def set_velocities(self, values, ids=None):
        self._native.velocities[:] = values[0]


class KeptForces(Toy):
    def _take_step(self, dt):
        kept = self._native.forces.copy()
        super()._take_step(dt)
        self._native.forces = kept


class OtherGravity(Toy):
    gravity = property(lambda self: np.array([0.0, 0.0, -9.81]))


class HalfState(Toy):
    def _put_state(self, state):
        self._native.positions, self._native.time = state["positions"], state["time"]


class LooseState(Toy):
    def _checked(self, state):
        schema, sizes, own = self._schema()
        return check(schema[:-1], state, sizes, own) | {"forces": np.zeros((len(self), 3))}


class SharedCopy(Toy):
    def copy(self):
        other = super().copy()
        other._native.positions = self._native.positions
        return other

    __copy__ = __deepcopy__ = lambda self, memo=None: self.copy()


class OtherFile(Toy):
    def load(self, path):
        """Nothing."""


class CallbackOfTime(Toy):
    def advance(self, duration, callback=None):
        super().advance(duration, callback and (lambda given: callback(given.time)))


class StepsOfTheStart(Toy):
    def advance(self, duration, callback=None):
        self._run(duration, self._end("duration", duration), callback)


class NeverLetGo(Toy):
    def step(self, dt=None):
        self._owner.__enter__()
        self._begin("step")
        self._count(self._step_once(dt))
        self._owner.__exit__(None, None, None)


class OpenToThreads(Toy):
    @property
    def _owner(self):
        return _core.Owner("toy")

    def _take_step(self, dt):
        self._native.positions += 1.0
        time.sleep(1e-3)
        self._native.positions -= 1.0
        super()._take_step(dt)


class ReportOfNothing(Toy):
    def _count(self, dt):
        """Nothing."""


class OtherAdvance(Toy):
    def advance(self, span):
        super().advance(span)


class NoLimit(Toy):
    def step_limit(self):
        return 1.0


class BitsOfThreads(Toy):
    def _take_step(self, dt):
        super()._take_step(dt * (1 + 1e-12 * (self.threads or 0)))


BROKEN = {
    diagnostics_have_the_words: OtherEnergy,
    fields_have_the_words: OtherField,
    arguments_and_properties_have_the_words: OtherArgument,
    integrators_have_the_words: OtherIntegrator,
    unknown_attributes_are_refused: Open,
    fixed_attributes_are_refused: OpenArgument,
    step_size_takes_effect: StepWithoutItsSize,
    arrays_are_views_or_read_only: LostChange,
    setters_write_rows: SetterOfAll,
    forces_are_used_up: KeptForces,
    gravity_is_told: OtherGravity,
    states_are_exact: HalfState,
    wrong_states_are_refused_by_name: LooseState,
    copies_are_exact: SharedCopy,
    files_are_exact: OtherFile,
    callbacks_follow_steps: CallbackOfTime,
    callbacks_may_go_back: StepsOfTheStart,
    interrupts_let_go: NeverLetGo,
    other_threads_are_refused_while_it_steps: OpenToThreads,
    other_threads_see_whole_steps: OpenToThreads,
    reports_tell_of_the_last_call: ReportOfNothing,
    advance_is_one: OtherAdvance,
    limits_and_ids_are_told: NoLimit,
    threads_change_no_bits: BitsOfThreads,
}


@pytest.mark.parametrize("line", LINES, ids=lambda line: line.__name__)
def test_a_class_that_breaks_a_line_is_noticed(line):
    with pytest.raises((AssertionError, pytest.fail.Exception, TypeError, AttributeError)):
        line(BROKEN[line])


def test_a_class_without_an_example_is_noticed():
    kind = type("Nowhere", (Toy,), {"__module__": "substep.pbd.nowhere"})
    with pytest.raises(AssertionError, match="expected a function Nowhere"):
        example(kind)


def test_schemas_refuse_by_name():
    schema = [
        Number("next_id", int, low=0),
        Rows("ids", np.int64, ("n",), low=0, below="next_id", rising=True),
        Rows("x", np.float64, ("n", 3)),
    ]
    good = {"next_id": 9, "ids": np.array([1, 4]), "x": np.zeros((2, 3))}
    check(schema, good, {})
    for wrong, message in [
        ({"next_id": 4}, "ids.*below next_id"),
        ({"next_id": -1}, "next_id"),
        ({"ids": np.array([4, 1])}, "ids.*ascending"),
        ({"x": np.zeros((3, 3))}, r"x.*shape \(2, 3\), got \(3, 3\)"),
        ({"x": np.full((2, 3), np.nan)}, r"x.*\[0, 0\]"),
        ({"x": np.zeros((2, 3), np.float32)}, "x.*dtype float64"),
    ]:
        with pytest.raises(substep.InputError, match=message):
            check(schema, good | wrong, {})
    with pytest.raises(substep.InputError, match="state: expected a dict"):
        check(schema, 3, {})
