"""Processes and threads: the same bits, Ctrl-C, fork, memory limits, the end of the interpreter."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import substep
from native_loops import boxes, chain, drift, grains, start

HERE = Path(__file__).parent
SANITIZED = "libasan" in os.environ.get("LD_PRELOAD", "")  # some three times as slow
LOOPS = {"advect": drift, "solve_ivp": chain, "mpm": grains, "rigid": boxes}
each_loop = pytest.mark.parametrize("loop", LOOPS)


def run_python(code, timeout=60):
    head = "import os, signal, sys, threading, time, substep\nfrom native_loops import *\n"
    path = os.pathsep.join([str(HERE), *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.run(
        [sys.executable, "-c", head + code],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=timeout,
    )


@contextlib.contextmanager
def threads_set_to(count):
    before = substep.num_threads()
    substep.set_num_threads(count)
    try:
        yield
    finally:
        substep.set_num_threads(before)


@each_loop
def test_same_bits_for_any_number_of_threads(loop):
    hashes = {LOOPS[loop](threads=threads) for threads in (1, 2, 3, 4, 7)}
    with threads_set_to(3):
        hashes.add(LOOPS[loop]())
    assert len(hashes) == 1


@each_loop
def test_several_python_threads_at_once(loop):
    expected = LOOPS[loop]()
    found = []
    threads = [
        threading.Thread(target=lambda: found.append(LOOPS[loop](threads=2))) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert found == [expected] * 4


@each_loop
def test_the_gil_is_released(loop):
    ticks = []
    done = threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.001)

    other = threading.Thread(target=tick)
    other.start()
    begin = time.perf_counter()
    LOOPS[loop](steps=300, threads=1)
    took = time.perf_counter() - begin
    done.set()
    other.join()
    during = [t for t in ticks if begin <= t <= begin + took]
    assert len(during) >= took / 0.05, "the other thread stood still"


class Alarm(Exception):
    pass


def seconds_to_stop(work, after):
    """How long `work`, interrupted after some seconds, takes to raise."""

    def ring(*_):
        raise Alarm

    before = signal.signal(signal.SIGALRM, ring)
    begin = time.perf_counter()
    signal.setitimer(signal.ITIMER_REAL, after)
    try:
        with pytest.raises(Alarm):
            work()
        return time.perf_counter() - begin - after
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("loop", ["advect", "solve_ivp"])  # others: their own tests
@pytest.mark.parametrize("threads", [1, 2, 4])
def test_signals_stop_a_native_loop(loop, threads):
    size = {"advect": 1_000_000, "solve_ivp": 1_000_000}[loop]
    waits = [
        seconds_to_stop(lambda: LOOPS[loop](n=size, steps=100_000, threads=threads), 0.5)
        for _ in range(4)
    ]
    assert min(waits) <= (0.3 if SANITIZED else 0.1)


def test_the_state_after_an_interrupt_is_a_whole_step():
    positions, step = start(10_000), 2.0**-7  # so that all times are exact
    sim = substep.Advection(substep.DoubleGyre(), positions, step=step)
    seconds_to_stop(lambda: sim.advance(1e6), 0.3)
    steps = sim.steps
    assert sim.time == steps * step > 0
    again = substep.Advection(substep.DoubleGyre(), positions, step=step)
    again.advance(steps * step)
    assert substep.state_hash(sim.positions) == substep.state_hash(again.positions)
    sim.step()  # and it goes on
    assert sim.steps == steps + 1


def test_an_interrupt_at_every_poll_in_turn_leaves_a_whole_step():
    positions, step, many = start(20_000), 2.0**-7, 10**6

    def advanced(steps, polls):
        """What an interrupt at one of its polls leaves, and the polls that it did not come to."""
        sim = substep.Advection(substep.DoubleGyre(), positions, step=step, threads=1)
        substep._core.interrupt_after(polls)
        try:
            sim.advance(steps * step)
        except KeyboardInterrupt:
            pass
        left = substep._core.interrupt_after(0)
        return (sim.steps, substep.state_hash(sim.positions)), left

    whole = [advanced(steps, many)[0] for steps in range(4)]
    polls = many - advanced(3, many)[1]
    stopped = [advanced(3, 1 + poll) for poll in range(polls)]
    assert {left for _, left in stopped} == {0}
    assert polls >= 10
    assert {state for state, _ in stopped} <= set(whole)


def test_keyboard_interrupt_from_the_terminal():
    code = """
import _thread
drift(n=100)  # numpy.random, too, is loaded by that: a Ctrl-C within its loading is lost
threading.Timer(0.5, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
begin = time.perf_counter()
try:
    drift(n=200000, steps=10**6)
except KeyboardInterrupt:
    print(time.perf_counter() - begin - 0.5)
assert drift(n=100) == drift(n=100)
"""
    done = run_python(code)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < 0.5  # with the start of a timer thread; the bound is tested above


def test_a_handler_of_signals_cannot_use_what_is_in_a_step():
    sim = substep.PositionBasedDynamics(start(20_000), 1.0, substeps=10**6)
    before = signal.signal(signal.SIGALRM, lambda *_: sim.positions)
    signal.setitimer(signal.ITIMER_REAL, 0.05)
    try:
        with pytest.raises(substep.InputError, match="in the middle of a step"):
            sim.step(1.0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert len(sim.positions) == 20_000 and sim.time == 0.0


def test_rows_that_are_taken_out_during_a_call():
    code = """
import numpy as np
class Emptying:  # does what a handler of signals may do between any two lines
    def __init__(self, one):
        self.one = one
    def __array__(self, dtype=None, copy=None):
        rows = np.zeros((len(self.one), 3))
        self.one.remove(self.one.ids)
        return rows
x, jelly = np.random.default_rng(0).random((3000, 3)), substep.mpm.NeoHookean(1e3, 1e4, 0.3)
def bodies():
    one = substep.RigidBodies()
    one.add(substep.Sphere(0.01), 100 * x)
    return one
def tried(make, name, *given):
    one = make()
    try:
        getattr(one, name)(*(g(one) for g in given))
    except (substep.InputError, IndexError):
        one.step()
        return len(one)
    return "accepted"
for make in (
    lambda: substep.MaterialPointMethod(x, jelly, cell=0.1, volume=1e-3),
    lambda: substep.PositionBasedFluid(x, 0.05),
    lambda: substep.GridLiquid(x, cell=1.0, bounds=((-8, -8, -8), (8, 8, 8))),
):
    for name in ("set_positions", "set_velocities", "set_forces"):
        print(tried(make, name, Emptying))
for name in ("apply_force", "apply_impulse"):
    print(tried(bodies, name, lambda one: one.ids, lambda one: (0, 0, 1), Emptying))
"""
    done = run_python(code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["0"] * 11


def test_simulations_that_share_an_obstacle_are_one_at_a_time():
    ball = substep.Collider(substep.Sphere(0.1))
    one, other = (
        substep.PositionBasedDynamics([[0, 0, 1]], 1.0, colliders=[ball]) for _ in range(2)
    )
    told = []

    def use():
        for work in (other.step, lambda: ball.impulse, other.copy):
            try:
                told.append(work())
            except substep.InputError as error:
                told.append("in use by another thread" in str(error))

    def look(_):
        other.step()  # this thread may
        thread = threading.Thread(target=use)
        thread.start()
        thread.join()

    one.step()
    one.advance(1 / 60, look)
    assert told == [True, True, True] and other.report.steps == 1


def test_threads_take_turns():
    """One that uses a simulation again and again lets another step."""
    simulation, holds, done = substep.MassSpring([[0, 0, 0]], [], 0.0, 1.0), [], threading.Event()

    def hold():
        while not done.is_set():
            with contextlib.suppress(substep.InputError), simulation._owner:
                time.sleep(0.002)
                holds.append(simulation.time)

    thread = threading.Thread(target=hold)
    thread.start()
    try:
        while len(holds) < 5:
            time.sleep(0.001)
        before = len(holds)
        for _ in range(20):
            simulation.step(0.01)
        assert len(holds) - before <= 2 * 20
    finally:
        done.set()
        thread.join()


def test_files_are_written_while_others_use_the_simulation(tmp_path, monkeypatch):
    simulation, told = substep.MassSpring([[0, 0, 0]], [], 0.0, 1.0), []
    simulation.step()

    def write(path, kind, state):
        thread = threading.Thread(target=lambda: (simulation.step(), told.append(state["time"])))
        thread.start()
        thread.join(10.0)

    monkeypatch.setattr("substep.base.simulation.write_checkpoint", write)
    before = simulation.time
    simulation.save(tmp_path / "saved")
    assert told == [before] and simulation.time > before


def test_one_object_from_two_threads_is_refused():
    sim = substep.Advection(substep.DoubleGyre(), start(50_000), step=0.01)
    outcomes = []
    barrier = threading.Barrier(2)

    def work():
        barrier.wait()
        try:
            sim.advance(2.0)
            outcomes.append("done")
        except substep.InputError as error:
            outcomes.append(str(error))

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert sorted(outcome == "done" for outcome in outcomes) == [False, True]
    assert any("in use" in outcome for outcome in outcomes)
    assert sim.steps == 200


FORK = """
expected = {work}(threads=4)
def child():
    return 0 if {work}(threads=4) == expected else 1
"""
WAIT = """
def wait(pid):
    for _ in range(2000):
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(pid, signal.SIGKILL)
    return "hang"
"""


@pytest.mark.parametrize("work", ["drift", "chain", "grains"])
def test_fork_after_a_parallel_step(work):
    code = (
        FORK.format(work=work)
        + WAIT
        + """
for _ in range(5):
    pid = os.fork()
    if pid == 0:
        os._exit(child())
    assert wait(pid) == 0
assert child() == 0
"""
    )
    done = run_python(code)
    assert done.returncode == 0, done.stderr


# The child would have the lock of ASan's malloc that the other thread may hold.
@pytest.mark.skipif(SANITIZED, reason="ASan and fork()")
def test_fork_while_another_thread_is_in_a_native_loop():
    code = (
        FORK.format(work="drift")
        + WAIT
        + """
stop = threading.Event()
def keep_on():
    while not stop.is_set():
        drift(threads=4)
other = threading.Thread(target=keep_on)
other.start()
for _ in range(20):
    pid = os.fork()
    if pid == 0:
        os._exit(child())
    assert wait(pid) == 0
stop.set()
other.join()
"""
    )
    done = run_python(code, timeout=120)
    assert done.returncode == 0, done.stderr


def test_fork_while_another_thread_uses_a_simulation():
    code = (
        WAIT
        + """
import numpy as np
inside, done = threading.Event(), threading.Event()
class Slow:
    def __array__(self, dtype=None, copy=None):
        inside.set()
        done.wait()
        return np.zeros((1, 3))
sim = substep.PositionBasedDynamics([[0.0, 0.0, 1.0]], 1.0)
other = threading.Thread(target=sim.set_positions, args=(Slow(),))
other.start()
inside.wait()
pid = os.fork()
if pid == 0:  # the thread that would let go of it is not here
    try:
        sim.positions
    except substep.InputError as error:
        os._exit(0 if "fork" in str(error) else 2)
    os._exit(1)
print(wait(pid))
done.set()
other.join()
"""
    )
    done = run_python(code.replace("2000", "500"))
    assert done.stdout.split() == ["0"], done.stderr


@pytest.mark.skipif(SANITIZED, reason="ASan and fork()")
def test_interrupt_in_a_forked_child():
    # The thread that forks is the main thread of the child: it gets the signals there.
    code = (
        WAIT
        + """
def fork_and_wait():
    pid = os.fork()
    if pid == 0:
        class Alarm(Exception): pass
        def ring(*_): raise Alarm
        signal.signal(signal.SIGALRM, ring)
        signal.setitimer(signal.ITIMER_REAL, 0.2, 0.2)  # again: C code may swallow one
        try:
            drift(n=100000, steps=10**6)
        except Alarm:
            os._exit(0)
        os._exit(1)
    status.append(wait(pid))
status = []
thread = threading.Thread(target=fork_and_wait)
thread.start()
thread.join()
assert status == [0], status
"""
    )
    done = run_python(code)
    assert done.returncode == 0, done.stderr


def test_multiprocessing_by_fork():
    code = """
import multiprocessing
expected = drift(threads=2)
with multiprocessing.get_context("fork").Pool(2) as pool:
    assert pool.map(drift, [20000] * 4) == [expected] * 4
"""
    done = run_python(code)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(SANITIZED, reason="ASan reserves terabytes")
@pytest.mark.parametrize("call", ["drift(n=40_000_000, steps=2)", "chain(n=40_000_000, steps=2)"])
def test_memory_limit(call):
    code = f"""
import resource
expected = drift(threads=2), chain(threads=2)
sim = substep.Advection(substep.DoubleGyre(), start(1000), step=0.01)
before = substep.state_hash(sim.positions)
used = int(open("/proc/self/statm").read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
resource.setrlimit(resource.RLIMIT_AS, (used + 400_000_000, resource.RLIM_INFINITY))
try:
    {call}
except MemoryError:
    print("MemoryError")
assert substep.state_hash(sim.positions) == before
sim.step()
assert (drift(threads=2), chain(threads=2)) == expected
"""
    done = run_python(code)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "MemoryError\n"


@pytest.mark.skipif(SANITIZED, reason="ASan reserves terabytes")
def test_no_more_threads_to_be_had():
    # New threads need address space for their stacks: without, those that there are do the work.
    code = """
import resource
expected = drift(threads=1)
used = int(open("/proc/self/statm").read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
resource.setrlimit(resource.RLIMIT_AS, (used + 30_000_000, resource.RLIM_INFINITY))
assert drift(threads=64) == expected
"""
    done = run_python(code)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("delay", [0.0, 0.05, 0.2])
@pytest.mark.parametrize("steps", [1, 50, 10**6])
def test_interpreter_exit_during_a_daemon_thread(steps, delay):
    code = f"""
def forever():
    while True:
        drift(n=2000, steps={steps}, threads=2)
for _ in range(3):
    threading.Thread(target=forever, daemon=True).start()
time.sleep({delay})
"""
    for _ in range(3):
        done = run_python(code)
        assert (done.returncode, done.stderr) == (0, "")


# The main thread ends where the other one lets it: at the first array that C++ gets, where NumPy is
# looked up, or while Python functions run.
@pytest.mark.parametrize(
    ("before", "call"),
    [
        ("", "_core.RigidShape.hull(np.eye(4, 3))"),
        ("cg(np.eye(3), np.ones(3))", "cg(slow, np.ones(3))"),
        ("chain()", "solve_ivp(lambda t, y: slow(y), (0.0, 1.0), [1.0], method='rk4', step=0.1)"),
    ],
    ids=["first-array", "cg", "solve_ivp"],
)
def test_interpreter_exit_where_a_daemon_thread_lets_it(before, call):
    code = f"""
import numpy as np
from substep import _core, solve_ivp
from substep.linalg import cg
def slow(x):
    time.sleep(0.01)
    return x
def last():
    time.sleep(0.1)
    sys.setswitchinterval(1000.0)
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        pass
    while True:
        {call}
{before}
threading.Thread(target=last, daemon=True).start()
time.sleep(0.3)
"""
    done = run_python(code)
    assert (done.returncode, done.stderr) == (0, "")


def test_exit_while_workers_wait():
    done = run_python("drift(threads=4); print('end')")
    assert (done.returncode, done.stdout, done.stderr) == (0, "end\n", "")


def test_subinterpreter_works_or_refuses():
    code = """
import importlib
for name in ("_interpreters", "_xxsubinterpreters"):
    try:
        interpreters = importlib.import_module(name)
        break
    except ImportError:
        pass
else:
    sys.exit(0)
drift(threads=2)
inner = '''
try:
    import substep
    substep.num_threads()
except ImportError as error:
    pass
'''
identity = interpreters.create()
interpreters.run_string(identity, inner)
interpreters.destroy(identity)
assert drift(threads=2) == drift(threads=1)
"""
    done = run_python(code)
    assert done.returncode == 0, done.stderr


def test_no_openmp_regions_and_no_gl_in_the_core():
    # libgomp comes with SuiteSparse; our own loops do not use it.
    code = """
drift(threads=2)
maps = open("/proc/self/maps").read()
core = open(substep._core.__file__, "rb").read()
print([name for name in ("libomp", "libGL", "libEGL", "libtbb") if name in maps] +
      [name for name in (b"GOMP_parallel", b"GOMP_task") if name in core])
"""
    done = run_python(code)
    assert done.stdout == "[]\n", done.stderr
