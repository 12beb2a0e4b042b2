"""A second thread that reads everything of a simulation while the first steps it.

What it gets is refused ("in use"), or is what the simulation has after a whole number of steps.
Live views are only asked for: native code writes into them during a step.
"""

import inspect
import random
import sys
import threading
import time

import numpy as np
import runner
import substep
from runner import Counts
from subjects import digest, go_on, of_simulations

STEPS = 12
_METHODS = ("state", "copy", "diagnostics", "fields", "step_limit", "__len__")


def readers(one):
    """Functions of a simulation that read something of it, by name."""
    kind = type(one)
    found = {}
    for name in dir(kind):
        static = inspect.getattr_static(kind, name)
        if name[:1] != "_" and isinstance(static, property):
            found[name] = lambda owner, name=name: getattr(owner, name)
    for name in _METHODS:
        if hasattr(kind, name):
            found[name] = lambda owner, name=name: getattr(owner, name)()
    for name in ("impulse", "position", "duration"):
        if one.colliders:
            found[f"collider.{name}"] = lambda owner, name=name: getattr(owner.colliders[0], name)
    if getattr(one, "joints", ()):
        found["joint.coordinate"] = lambda owner: owner.joints[0].coordinate
        found["joint.force"] = lambda owner: owner.joints[0].force
    # What does not change, or is no value of its own.
    return {n: f for n, f in found.items() if n not in ("colliders", "joints", "info")}


def _is_view(value):
    return isinstance(value, np.ndarray) and value.flags.writeable


def _whole(subject, names):
    """Digests of what each reader gives before and after each step."""
    one, found = subject.make(), {name: set() for name in names}
    for _ in range(STEPS + 1):
        for name, read in names.items():
            value = read(one)
            found[name].add("view" if _is_view(value) else digest(value))
        go_on(one)
    return found


def _read(one, names, whole, r, done, counts, row, told):
    while not done.is_set():
        name = r.choice(list(names))
        try:
            value = names[name](one)
        except substep.InputError as error:
            refused = "in use" in str(error)
            counts.add(row, "refused" if refused else "wrong types")
            if not refused:
                counts.findings.append(f"wrong types: {row}: {name}: {error!r}; {told}")
            continue
        except Exception as error:
            counts.add(row, "wrong types", 1, f"{name}: {error!r}; {told}")
            continue
        finally:
            counts.add(row, "calls")
        got = "view" if _is_view(value) else digest(value)
        if got not in whole[name]:
            counts.add(row, "torn", 1, f"{name} is that of no whole step; {told}")


def work(job):
    """Two threads at one simulation."""
    number, _, repeats = job
    subject, r, counts = of_simulations()[number], random.Random(f"{job}"), Counts()
    names = readers(subject.make())
    whole = _whole(subject, names)
    told = f"job {job}: {subject.name}"
    runner.note(told)
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    for _ in range(repeats):
        one, done = subject.make(), threading.Event()
        arguments = (one, names, whole, r, done, counts, subject.name, told)
        other = threading.Thread(target=_read, args=arguments)
        other.start()
        try:
            for _ in range(STEPS):
                _stepped(one)
                time.sleep(r.random() * 1e-4)
        finally:
            done.set()
            other.join()
        if digest(one.state()) not in whole["state"]:
            counts.add(subject.name, "torn", 1, f"its own state is that of no whole step; {told}")
    sys.setswitchinterval(before)
    return counts


def _stepped(one):
    """One step, as soon as the other thread lets go."""
    while True:
        try:
            return go_on(one)
        except substep.InputError as error:
            if "in use" not in str(error):
                raise


def attack(count, seed, processes=1):
    """About so many reads."""
    repeats = max(1, count // (len(of_simulations()) * 100))
    jobs = [[number, seed, repeats] for number in range(len(of_simulations()))]
    return runner.run_jobs(
        __name__,
        jobs,
        patience=30.0 + repeats,
        processes=processes,
        row=lambda job: of_simulations()[job[0]].name,
    )
