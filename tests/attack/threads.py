"""A second thread at what the first uses.

Either it reads everything of a simulation while the first steps it: what it gets is refused ("in
use"), or is what the simulation has after a whole number of steps. Live views are only asked for:
native code writes into them during a step. Or both call whatever there is to call, of one object or
of it and its copy, which share what never changes: nothing but refusals is raised, and in the end
nobody uses it. `python tests/attack/threads.py REPEATS` does all of it in this process, for the
thread sanitizer (.ci/threads).
"""

import inspect
import os
import random
import sys
import tempfile
import threading
import time

import numpy as np
import runner
import substep
from api import ALLOWED
from runner import Counts
from subjects import digest, go_on, of_simulations, subjects

STEPS = 12
CALLS = 15  # of each thread
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
    last = False
    while not last:
        last = done.is_set()  # at least one is read
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


def read_and_step(job):
    """One thread reads while the other steps."""
    number, _, repeats = job
    subject, r, counts = of_simulations()[number], random.Random(f"{job}"), Counts()
    names = readers(subject.make())
    whole = _whole(subject, names)
    told = f"job {['reads', *job]}: {subject.name}"
    runner.note(told)
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
    return counts


def _stepped(one):
    """One step, as soon as the other thread lets go."""
    while True:
        try:
            return go_on(one)
        except substep.InputError as error:
            if "in use" not in str(error):
                raise


def _call(one, calls, r, start, counts, row, told):
    start.wait()
    for _ in range(CALLS):
        wanted = r.choice(calls)
        counts.add(row, "calls")
        try:
            wanted(one)
        except ALLOWED:
            counts.add(row, "refused")
        except RuntimeError as error:
            if "finished solver" not in str(error):  # SciPy's own words
                counts.add(row, "wrong types", 1, f"{wanted.name}: {error!r}; {told}")
        except Exception as error:
            counts.add(row, "wrong types", 1, f"{wanted.name}: {error!r}; {told}")


def both_call(job):
    """Both threads call what there is, of the same object or of two that share parts."""
    number, _, repeats = job
    subject, r, row = subjects()[number], random.Random(f"{job}"), subjects()[number].name
    told, counts = f"job {['calls', *job]}: {row}", Counts()
    runner.note(told)
    for k in range(repeats):
        one = subject.make()
        other = one.copy() if k % 2 and hasattr(one, "copy") else one
        start, each = threading.Barrier(2), (Counts(), Counts())
        both = [
            threading.Thread(
                target=_call,
                args=(thing, subject.calls, random.Random(r.random()), start, own, row, told),
            )
            for thing, own in zip((one, other), each, strict=True)
        ]
        for thread in both:
            thread.start()
        for thread in both:
            thread.join()
        for own in each:
            counts.take(own, row)
        if getattr(getattr(one, "_owner", None), "taken", False):
            counts.add(row, "torn", 1, f"is in use for ever; {told}")
    return counts


KINDS = {"reads": (read_and_step, of_simulations), "calls": (both_call, subjects)}


def work(job):
    """Two threads at one thing: the kind, the number of the subject, a seed, how often."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        return KINDS[job[0]][0](job[1:])
    finally:
        sys.setswitchinterval(before)


def _jobs(seed, repeats):
    return [
        [kind, number, seed, repeats]
        for kind, (_, among) in KINDS.items()
        for number in range(len(among()))
    ]


def attack(count, seed, processes=1):
    """About so many calls."""
    repeats = max(1, count // (len(of_simulations()) * 100))
    return runner.run_jobs(
        __name__,
        _jobs(seed, repeats),
        patience=30.0 + repeats,
        processes=processes,
        row=lambda job: KINDS[job[0]][1]()[job[1]].name,
    )


def main():
    counts = Counts()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # files that calls make go there
        for job in _jobs(0, int(sys.argv[1])):
            counts.take(work(job), "")
    print(f"{counts.total('calls')} calls", *counts.findings, sep="\n\n")
    return int(bool(counts.failures()))


if __name__ == "__main__":
    sys.exit(main())
