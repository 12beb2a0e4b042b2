"""Ctrl-C wherever it can come, in every call of every subject.

At every instruction of substep's Python at which CPython runs signal handlers, at every poll of the
native loops (`_core.interrupt_after`), both in turn, and at random times. Afterwards the object is
in the state before the call, after it or after one of its whole steps, nobody uses it any more, and
it goes on with the bits of one that was not disturbed.
"""

import dis
import functools
import os
import random
import signal
import sys
import time

import runner
import substep
from runner import Counts
from subjects import Twin, subjects
from substep import _core

OURS = os.path.dirname(substep.__file__)
LEAD = 3e-4  # [s] which a timer needs at least
MOST = 300  # of one kind in one call; beyond that a sample
_PLACES = ("RESUME", "JUMP_BACKWARD", "JUMP_ABSOLUTE", "CALL")


@functools.cache
def _looks(code):
    """Offsets of instructions after which CPython looks for signals."""
    return frozenset(
        i.offset
        for i in dis.get_instructions(code)
        if i.opname.startswith(_PLACES) and i.opname != "JUMP_BACKWARD_NO_INTERRUPT"
    )


class Strike:
    """Raises KeyboardInterrupt at the n-th such place from now on; counts them if there is none."""

    def __init__(self, at=None):
        self.at, self.count = at, 0
        self.last = {}

    def __enter__(self):
        self.before = sys.gettrace()
        sys.settrace(self.trace)

    def __exit__(self, *_):
        sys.settrace(self.before)

    def trace(self, frame, event, _):
        if not frame.f_code.co_filename.startswith(OURS):
            return None
        if event == "call":
            frame.f_trace_opcodes, frame.f_trace_lines = True, False
            self.last[frame] = None
        elif event == "opcode":
            last = self.last.get(frame)
            self.last[frame] = frame.f_lasti
            if last in _looks(frame.f_code):
                self.count += 1
                if self.count == self.at:
                    raise KeyboardInterrupt
        elif event == "return":
            self.last.pop(frame, None)
        return self.trace


class Poll:
    """Raises KeyboardInterrupt at the n-th poll from now on; counts them if there is none."""

    def __init__(self, at=None):
        self.at = at or 10**9

    def __enter__(self):
        _core.interrupt_after(self.at)

    def __exit__(self, *_):
        self.count = self.at - _core.interrupt_after(0)


class Alarm:
    """A signal so many seconds after the body begins."""

    def __init__(self, after):
        self.after = after

    def __enter__(self):
        signal.signal(signal.SIGALRM, signal.default_int_handler)
        signal.setitimer(signal.ITIMER_REAL, LEAD + self.after)
        end = time.perf_counter() + LEAD
        while time.perf_counter() < end:
            pass

    def __exit__(self, *_):
        signal.setitimer(signal.ITIMER_REAL, 0)


def kinds():
    """What there is to interrupt with; builds for users may lack the hook of the polls."""
    return (Strike, Poll) if hasattr(_core, "interrupt_after") else (Strike,)


def _places(count, r):
    return range(1, count + 1) if count <= MOST else sorted(r.sample(range(1, count + 1), MOST))


def _interrupted(twin, interrupt, counts, told):
    """One interrupt in one call, and a look at what it left."""
    row = twin.subject.name
    one, error = twin.make(), None
    arguments = twin.call.arguments(one)
    runner.note(told)
    try:
        with interrupt:
            twin.call.on(one, arguments)
    except BaseException as raised:
        error = raised
    counts.add(row, "calls")
    if error is None:
        counts.add(row, "came too late")
    elif type(error) is not KeyboardInterrupt:
        counts.add(row, "wrong types", 1, f"{error!r:.200}; {told}")
    complaint = twin.complaint(one)
    if complaint:
        counts.add(row, "torn", 1, f"{complaint}; {told}")


def interrupt_everywhere(twin, times, told):
    """All interrupts of one call."""
    counts, r = Counts(), random.Random(told)
    for kind in kinds():
        counting = kind()
        one = twin.make()
        arguments = twin.call.arguments(one)
        with counting:
            twin.call.on(one, arguments)
        for at in _places(counting.count, r):
            _interrupted(twin, kind(at), counts, f"{told}, {kind.__name__} {at}/{counting.count}")
    one = twin.make()
    arguments = twin.call.arguments(one)
    begin = time.perf_counter()
    twin.call.on(one, arguments)
    took = time.perf_counter() - begin
    for k in range(times):
        _interrupted(twin, Alarm(r.uniform(0, took)), counts, f"{told}, at random, {k}")
    return counts


def work(job):
    """All interrupts of one call of one subject."""
    number, position, steps, times = job
    subject = subjects()[number]
    twin = Twin(subject, subject.calls[position], steps)
    return interrupt_everywhere(twin, times, f"job {job}: {subject.name}.{twin.call.name}")


def attack(count, seed, processes=1, times=5):
    """About so many interrupts: the next calls for the next seed, all of them in turn."""
    places = [
        (number, position)
        for number, subject in enumerate(subjects())
        if subject.name != "functions"
        for position in range(len(subject.calls))
    ]
    jobs = [
        [number, position, turn % 4, times]
        for (number, position), turn in runner.portion(places, max(1, count // 50), seed)
    ]
    return runner.run_jobs(
        __name__,
        jobs,
        patience=60.0,
        processes=processes,
        row=lambda job: subjects()[job[0]].name,
    )
