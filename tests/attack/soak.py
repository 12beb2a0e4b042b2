"""Made, used and destroyed many times: what the heap has given out stays as it was."""

import contextlib
import gc
import itertools
import random
import sys

import runner
from runner import Counts
from subjects import subjects

CYCLES = 20_000
NOISE = (30_000, 300)  # bytes and objects that come and go, however many the lives
SLOW = ("functions",)  # a tenth of the cycles


def _cycle(subject, number):
    """One life of a subject: a call that is good, one that is refused."""
    one = subject.make()
    wanted = subject.calls[number % len(subject.calls)]
    with contextlib.suppress(Exception):
        wanted(one)
    with contextlib.suppress(Exception):
        wanted.on(one, {name: object() for name in wanted.arguments(one)})


def _in_use():
    gc.collect()
    return runner.memory_in_use(), sys.getallocatedblocks()


def live_often(subject, cycles, told):
    """The memory of many lives, after as many that fill all caches."""
    counts, calls = Counts(), len(subject.calls)
    lives = max(1, cycles // calls // 3) * calls
    taken = []
    for _ in range(3):  # the first warms up; a leak is what grows in both of the others
        for k in range(lives):
            _cycle(subject, k)
        taken.append(_in_use())
    counts.add(subject.name, "calls", 3 * lives)
    pairs = list(itertools.pairwise(taken))
    grown = min(b[0] - a[0] for a, b in pairs)
    objects = min(b[1] - a[1] for a, b in pairs)
    if grown > NOISE[0] + lives or objects > NOISE[1] + lives / 100:
        told = f"{grown / lives:.0f} bytes, {objects / lives:.2f} objects a cycle; {told}"
        counts.add(subject.name, "leaks", 1, told)
    return counts


def work(job):
    """Many lives of one subject."""
    number, cycles = job
    told = f"job {job}: {subjects()[number].name}"
    runner.note(told)
    return live_often(subjects()[number], cycles, told)


def attack(count, seed, processes=1):
    """So many cycles of each subject."""
    jobs = [
        [number, max(1, count // 10) if subject.name in SLOW else count]
        for number, subject in enumerate(subjects())
    ]
    random.Random(seed).shuffle(jobs)
    return runner.run_jobs(
        __name__,
        jobs,
        patience=60.0 + 0.2 * count,
        processes=processes,
        row=lambda job: subjects()[job[0]].name,
    )
