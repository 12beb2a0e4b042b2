"""Memory that runs out: every native allocation of every call of every subject fails in turn.

Afterwards MemoryError has been raised, the object is as before the call (after `advance`, as after
one of its whole steps), and the same call then does what it does to one that was not disturbed.
"""

import ctypes
import random
import shutil
import subprocess
import tempfile
from pathlib import Path

import runner
from runner import Counts
from subjects import Twin, digest, look, subjects

SOURCE = Path(__file__).with_name("failing_malloc.c")
MOST = 2000  # in one call; beyond that a sample


def build(folder):
    """The library that is loaded before all others, or None without a compiler."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return None
    library = Path(folder) / "failing_malloc.so"
    subprocess.run(
        [compiler, "-O2", "-shared", "-fPIC", str(SOURCE), "-o", str(library), "-ldl"], check=True
    )
    return library


class Failing:
    """Fails the n-th native allocation from now on; counts them if there is none."""

    def __init__(self, at=0):
        self.at = at
        self.library = ctypes.CDLL(None)

    def __enter__(self):
        self.library.failing_malloc_arm(ctypes.c_long(self.at))
        return self

    def __exit__(self, *_):
        self.library.failing_malloc_disarm.restype = ctypes.c_long
        self.count = self.library.failing_malloc_disarm()

    @property
    def failed(self):
        """Whether it came so far."""
        return 0 < self.at <= self.count


def _failed(twin, at, counts, told):
    row = twin.subject.name
    one, error, result = twin.make(), None, None
    arguments = twin.call.arguments(one)
    runner.note(told)
    failing = Failing(at)
    with failing:
        try:
            result = twin.call.on(one, arguments)
        except BaseException as raised:
            error = raised
    if not failing.failed:
        return
    counts.add(row, "calls")
    if error is None:
        if digest(one) != twin.after or digest(result) != twin.result:
            counts.add(row, "torn", 1, f"nothing raised, another result; {told}")
        return
    text = f"{error!r:.200}"
    if not isinstance(error, MemoryError):
        counts.add(row, "wrong types", 1, f"{text}; {told}")
    del error
    if look(one) != twin.before:
        complaint = twin.complaint(one)
        if complaint or not twin.call.parts:
            counts.add(row, "torn", 1, f"{complaint or 'is not as before'} after {text}; {told}")
        return
    try:
        result = twin.call.on(one, arguments)
    except Exception as again:
        counts.add(row, "torn", 1, f"the same call then raises {again!r:.200}; {told}")
        return
    if digest(one) != twin.after or digest(result) != twin.result:
        counts.add(row, "torn", 1, f"the same call then does another thing; {told}")


def work(job):
    """All allocations of one call of one subject."""
    number, position, steps, most = job
    ctypes.CDLL(None).failing_malloc_look()
    subject, r, counts = subjects()[number], random.Random(f"{job}"), Counts()
    wanted = subject.calls[position]
    told = f"job {job}: {subject.name}.{wanted.name}"
    runner.note(told)
    try:
        twin = Twin(subject, wanted, steps)
    except OSError:  # there is no such file
        return counts
    one = twin.make()
    arguments = wanted.arguments(one)
    with Failing() as counting:
        wanted.on(one, arguments)
    total = counting.count
    places = range(1, total + 1) if total <= most else sorted(r.sample(range(1, total + 1), most))
    if total > most:
        counts.add(subject.name, "allocations left out", total - most)
    for at in places:
        _failed(twin, at, counts, f"{told}, allocation {at}/{total}")
    return counts


def attack(count, seed, processes=1):
    """About so many failures: the next calls for the next seed, all of them in turn."""
    places = [
        (number, position)
        for number, subject in enumerate(subjects())
        for position in range(len(subject.calls))
    ]
    return run(
        [
            [number, position, turn % 4, MOST]
            for (number, position), turn in runner.portion(places, max(1, count // 50), seed)
        ],
        processes,
    )


def run(jobs, processes=1):
    """Counts of jobs: (subject, call, steps before, most failures)."""
    with tempfile.TemporaryDirectory() as folder:
        library = build(folder)
        if library is None or runner.SANITIZED:  # which has its own malloc
            return Counts()
        return runner.run_jobs(
            __name__,
            jobs,
            patience=60.0,
            processes=processes,
            environment={"LD_PRELOAD": str(library)},
            row=lambda job: subjects()[job[0]].name,
        )
