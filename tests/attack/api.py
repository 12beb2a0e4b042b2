"""The whole public API with arguments that nobody should give.

Each try takes a good call of a subject (or a public function) and replaces some of its arguments by
nasty ones. What it raises must be of the contract's tree, what it raises from must be as before,
what was passed in must be as before, and no call may take long without looking for Ctrl-C.
"""

import contextlib
import dataclasses
import inspect
import math
import random
import signal
import time
import warnings

import numpy as np
import runner
import substep
from runner import Counts
from subjects import Simulation, look, subjects

LONG = 1.0  # [s] after which a bell rings in a call
# [s of this process] that it may take to hear it; 0.1 with nothing else on the machine
DEAF = 1.0 if runner.SANITIZED else 0.3
SHARE = 200  # tries of a job


class Own(Exception):
    """What an argument's own code raises."""


class Bell(BaseException):
    """Rings in a call that takes long."""


class Raising:
    def __array__(self, dtype=None, copy=None):
        raise Own

    def __float__(self):
        raise Own

    def __index__(self):
        raise Own

    def __call__(self, *arguments):
        raise Own

    def __iter__(self):
        raise Own


class Sub(np.ndarray):
    pass


def _wrong(array, value, r):
    changed = np.array(array, float, copy=True)
    if changed.size:
        changed.flat[r.randrange(changed.size)] = value
    return changed


NUMBERS = (
    *(0, 1, -1, 2, 3, 7, 0.5, -0.5, True, False),
    *(math.nan, math.inf, -math.inf, 1e-320, 1e-30, 1e30, 1e308, -1e308),
    *(2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**62, 2**63, -(2**63), 2**64, 10**400),
    *(np.float32(0.5), np.int8(3), np.uint64(2**64 - 1), np.float16(1), np.longdouble(2), 1 + 1j),
)
OBJECTS = (None, "", "x", "rk4", "/", "../x", "\0", b"x", (), [], {}, set(), {"a": 1}, object, ...)


def nasty(good, owner, r):
    """Something in the place of a good argument."""
    kind = r.randrange(7)
    if kind == 0:
        return r.choice(NUMBERS)
    if kind == 1:
        return r.choice(OBJECTS)
    if kind == 2:
        return r.choice((Raising(), object(), owner, iter([1, 2]), lambda *a: None, range(3)))
    array = None
    if isinstance(good, (int, float, list, tuple, np.ndarray)):
        with contextlib.suppress(ValueError):  # rows of unequal length
            array = np.asarray(good)
    if array is None or array.dtype.kind not in "fiub":
        shape = r.choice([(0,), (3,), (4,), (0, 3), (2, 3), (4, 3), (3, 3, 3), (1,) * 9])
        array = np.ones(shape)
    if kind == 3:  # other numbers in it
        return _wrong(array, r.choice(NUMBERS[:18]), r)
    if kind == 4:  # other shapes
        return r.choice(
            (
                lambda: array[..., None],
                lambda: array.reshape(-1)[:-1],
                lambda: array.reshape(-1)[:0],
                lambda: np.zeros((0, 3)),
                lambda: np.zeros((0, 0)),
                lambda: np.concatenate([np.atleast_1d(array)] * 2),
                lambda: [array.tolist(), [1.0]],
                lambda: np.broadcast_to(array, (2, *array.shape)),
                lambda: np.broadcast_to(1.0, (2**40, 3)),
            )
        )()
    if kind == 5:  # other types
        dtype = r.choice(("f4", "f2", "i8", "u1", "?", ">f8", "c16", "O", "S8", "M8[s]", "i4"))
        with contextlib.suppress(TypeError, ValueError), np.errstate(all="ignore"):
            return array.astype(dtype)
        return array.astype(object)
    return r.choice(  # other memory
        (
            lambda: np.repeat(np.atleast_1d(array), 2, axis=0)[::2],
            lambda: np.atleast_1d(array)[::-1],
            lambda: np.asfortranarray(array),
            lambda: _frozen(array),
            lambda: np.ma.MaskedArray(array, mask=np.ones(array.shape, bool)),
            lambda: array.view(Sub),
            lambda: memoryview(np.ascontiguousarray(array)),
            lambda: array.astype(np.int64) - 1,
            lambda: array.astype(np.int64) + 2**40,
        )
    )()


def _frozen(array):
    array = array.copy()
    array.flags.writeable = False
    return array


ALLOWED = (
    substep.SubstepError,
    TypeError,
    IndexError,
    MemoryError,
    OSError,
    KeyboardInterrupt,
    ImportError,  # of an extra that is not installed
    dataclasses.FrozenInstanceError,
    Own,
)


def change(arguments, names, owner, r):
    """Some of the arguments, made nasty; others that the call could have are given too."""
    changed = dict(arguments)
    for name in names:
        if name not in changed:
            if r.random() < 0.1:
                changed[name] = nasty(None, owner, r)
        elif r.random() < 0.3:
            changed[name] = nasty(changed[name], owner, r)
        elif r.random() < 0.02 and name != "value":
            del changed[name]
    return changed


def names_of(wanted, owner):
    """Arguments that a call could have."""
    if wanted.name.endswith("="):
        return ["value"]
    target = owner
    try:
        for part in wanted.name.split("."):
            target = getattr(target, part)
        parameters = inspect.signature(target).parameters.values()
        return [p.name for p in parameters if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
    except (TypeError, ValueError):
        return []


def describe(arguments):
    return ", ".join(f"{k}={_short(v)}" for k, v in arguments.items())


def _short(value):
    try:
        if isinstance(value, np.ndarray) and value.size > 12:
            return f"<{type(value).__name__} {value.dtype}{value.shape}>"
        return " ".join(repr(value).split())[:160]
    except Exception:
        return type(value).__name__


def one_try(subject, wanted, r, counts, label):
    """Call once, and look at everything."""
    owner = subject.made(r.randrange(2))
    arguments = change(wanted.arguments(owner), names_of(wanted, owner), owner, r)
    is_module = owner is substep
    before = None if is_module else look(owner)
    time_before = getattr(owner, "time", 0.0)
    told = f"{label}: {subject.name}.{wanted.name}({describe(arguments)})"
    runner.note(told)
    row = wanted.name.split(".")[0] if is_module else subject.name
    row = row if is_module and row[:1].isupper() else subject.name
    kept = look(arguments)
    error = None
    begin, cpu = time.perf_counter(), time.process_time()
    signal.setitimer(signal.ITIMER_REAL, LONG)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", "At least one element of `rtol`")  # as SciPy's own
            warnings.simplefilter("ignore", substep.StartWarning)
            wanted.on(owner, arguments)
            if wanted.name.endswith("=") and not isinstance(owner, Simulation):
                before = look(owner)  # it was taken: the next call goes by it
                following = r.choice([c for c in subject.calls if c.name[-1] != "="])
                told = f"{told}; {following.name}"
                runner.note(told)
                following(owner)
    except BaseException as raised:
        error = raised
    signal.setitimer(signal.ITIMER_REAL, 0)
    took, cpu = time.perf_counter() - begin, time.process_time() - cpu
    counts.add(row, "calls")
    if isinstance(error, Bell) or took > LONG:
        counts.add(row, "long")
        if cpu > LONG + DEAF:
            counts.add(row, "hangs", 1, f"{cpu:.1f} s without a look for Ctrl-C; {told}")
        return
    if error is not None:
        counts.add(row, "refused")
        if not isinstance(error, ALLOWED):
            counts.add(row, "wrong types", 1, f"{type(error).__name__}: {str(error)[:200]}; {told}")
        if before is not None:
            after = look(owner)
            # A run that is broken off, as by its callback, keeps the whole steps before.
            run = wanted.parts is not None or "steps" in arguments
            stepped = run and getattr(owner, "time", 0.0) > time_before
            if after != before and not stepped:
                counts.add(row, "torn", 1, f"changed by a call that raised {error!r:.200}; {told}")
    elif isinstance(owner, Simulation) and not is_module:
        _look_for_nan(owner, counts, row, told)
    if look(arguments) != kept and not _shares(arguments, owner):
        counts.add(row, "torn", 1, f"an argument was changed; {told}")
    with contextlib.suppress(Exception):
        substep.set_num_threads(1)


def _shares(arguments, owner):
    """Whether an argument is what the call may change."""
    kinds = (Simulation, substep.Collider)
    return any(
        value is owner or isinstance(value, kinds) or hasattr(value, "__next__")
        for value in arguments.values()
    )


def _look_for_nan(owner, counts, row, told):
    """After a call that was accepted, a state holds numbers."""
    for name in ("positions", "velocities"):
        value = getattr(owner, name, None)
        if value is not None and not np.isfinite(value).all():
            counts.add(row, "torn", 1, f"{name} not finite after a call that was accepted; {told}")


def _bell(*_):
    raise Bell


def work(job):
    """Tries of one subject with one seed; `only` is a single try of these."""
    number, seed, count, *only = job
    signal.signal(signal.SIGALRM, _bell)
    subject, counts = subjects()[number], Counts()
    for k in only or range(count):
        r = random.Random(f"{seed} {number} {k}")
        wanted = r.choice(subject.calls)
        one_try(subject, wanted, r, counts, f"job {[number, seed, count, k]}")
    return counts


def attack(count, seed, processes=1):
    """About so many calls, spread over all subjects; functions get the larger part."""
    weights = [8 if s.name == "functions" else 1 for s in subjects()]
    jobs = []
    for number, weight in enumerate(weights):
        share = max(1, round(count * weight / sum(weights)))
        jobs += [
            [number, seed * 1000 + k, min(SHARE, share - SHARE * k)]
            for k in range(-(-share // SHARE))
        ]
    random.Random(seed).shuffle(jobs)
    patience = 30.0 + SHARE * 0.5
    return runner.run_jobs(
        __name__,
        jobs,
        patience=patience,
        processes=processes,
        row=lambda job: subjects()[job[0]].name,
    )
