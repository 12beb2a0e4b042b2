"""Kills recorders and packers, and checks what they leave: `kills.py KILLS SEED`.

Each trial forks a process that records frames of known content, acknowledges each through a pipe,
packs, resumes, and so on, until SIGKILL hits it: from outside after a random time, or by its own
hand at a random write, truncate, link, rename or unlink call (HDF5's too: a preloaded library
counts them), in half of the cases after a random part of that write has reached the file. Then
every frame that can be read must be right, none that was acknowledged may be missing, and resuming
must go on.
Prints one line of JSON. The page cache survives SIGKILL: nothing here speaks of power cuts.
"""

import ctypes
import json
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import substep
import substep.recording.packed
from substep.export import pack_here

PRELOADED = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdlib.h>
#include <sys/types.h>
#include <unistd.h>
static long left = -1, seen = 0;
static int torn = 0;
void arm(long calls, int tear, unsigned seed) { left = calls; torn = tear; seen = 0; srand(seed); }
long calls(void) { return seen; }
static int hit(void) { seen++; return left > 0 && --left == 0; }
static void die(void) { kill(getpid(), SIGKILL); for (;;) pause(); }
#define REAL(type, name, ...) static type (*real)(__VA_ARGS__); \
    if (!real) *(void**)&real = dlsym(RTLD_NEXT, name)
ssize_t pwrite64(int fd, const void* b, size_t n, off_t o) {
    REAL(ssize_t, "pwrite64", int, const void*, size_t, off_t);
    if (hit()) { if (torn && n > 1) real(fd, b, 1 + rand() % (n - 1), o); die(); }
    return real(fd, b, n, o); }
ssize_t pwrite(int fd, const void* b, size_t n, off_t o) { return pwrite64(fd, b, n, o); }
ssize_t write(int fd, const void* b, size_t n) {
    REAL(ssize_t, "write", int, const void*, size_t);
    if (hit()) die();
    return real(fd, b, n); }
int ftruncate64(int fd, off_t n) {
    REAL(int, "ftruncate64", int, off_t); if (hit()) die(); return real(fd, n); }
int ftruncate(int fd, off_t n) { return ftruncate64(fd, n); }
int link(const char* a, const char* b) {
    REAL(int, "link", const char*, const char*); if (hit()) die(); return real(a, b); }
int rename(const char* a, const char* b) {
    REAL(int, "rename", const char*, const char*); if (hit()) die(); return real(a, b); }
int unlink(const char* a) {
    REAL(int, "unlink", const char*); if (hit()) die(); return real(a); }
"""
COUNTED = (
    *("killed", "unreadable", "lost", "wrong", "frames"),
    *("resumed_elsewhere", "wrong_after_resume", "left_behind"),
)
PARTS = {"p": substep.Part("particles", {"velocity": "m/s"})}


def frame(k):
    n = 60 - (k * 17) % 23
    x = np.arange(3 * n, dtype=np.float32).reshape(n, 3) + np.float32(k)
    return {"p": {"points": x, "velocity": x * np.float32(-0.5)}}


def right(k, time, arrays):
    wanted = frame(k)["p"]
    return time == k / 24 and all(
        arrays["p"][name].dtype == a.dtype and arrays["p"][name].tobytes() == a.tobytes()
        for name, a in wanted.items()
    )


def resume(path):
    return substep.Recorder(path, parts=PARTS, scene="kills", seed=1, resume=True)


def work(path, acknowledge, frames, rounds):
    """Record, pack, resume: what is killed. Closing packs in this process, to be killed with it."""
    for _ in range(rounds):
        recorder = resume(path)
        acknowledge(len(recorder))
        for _ in range(frames):
            recorder.append(len(recorder) / 24, frame(len(recorder)))
            acknowledge(len(recorder))
        recorder._release()
        pack_here(recorder.journal_path, None, False)


def fork_worker(path, before, *, frames=8, rounds=50):
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.close(reader)
            before()
            work(path, lambda k: os.write(writer, struct.pack("<I", k)), frames, rounds)
        finally:
            os._exit(0)
    os.close(writer)
    return child, reader


def wait(child, reader):
    """Frames acknowledged (-1: not even started), and whether it was killed."""
    data = b""
    while block := os.read(reader, 65536):
        data += block
    os.close(reader)
    _, status = os.waitpid(child, 0)
    count = struct.unpack(f"<{len(data) // 4}I", data)[-1] if data else -1
    return count, os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGKILL


def check(path, acknowledged, tally, *, pack):
    try:
        with substep.Recording(path) as recording:
            found = [right(k, t, arrays) for k, (t, arrays) in enumerate(recording)]
    except FileNotFoundError:
        found = []
        if acknowledged >= 0:
            tally["unreadable"] += 1
            return
    except Exception as error:
        tally["unreadable"] += 1
        tally["messages"].append(repr(error)[:200])
        return
    tally["wrong"] += not all(found)
    tally["lost"] += len(found) < acknowledged
    tally["frames"] += len(found)
    recorder = resume(path)
    tally["resumed_elsewhere"] += len(recorder) != len(found)
    recorder.append(len(recorder) / 24, frame(len(recorder)))
    recorder._release()
    if pack:
        pack_here(recorder.journal_path, None, False)
        tally["left_behind"] += os.listdir(os.path.dirname(path)) != [os.path.basename(path)]
    with substep.Recording(path) as recording:
        again = [right(k, t, arrays) for k, (t, arrays) in enumerate(recording)]
    tally["wrong_after_resume"] += len(again) != len(found) + 1 or not all(again)


def kill_by_timer(path, rng, tally):
    child, reader = fork_worker(path, lambda: None)
    first = os.read(reader, 4)
    time.sleep(rng.random() * 0.025)
    os.kill(child, signal.SIGKILL)
    count, killed = wait(child, reader)
    tally["killed"] += killed
    return max(count, struct.unpack("<I", first)[0])


def kill_at_call(path, rng, tally, library, calls):
    def arm():
        library.arm(rng.randint(1, calls), rng.randint(0, 1), rng.randrange(2**31))

    child, reader = fork_worker(path, arm, frames=rng.choice((2, 8)))
    count, killed = wait(child, reader)
    tally["killed"] += killed
    return count


def calls_of_a_run(folder, library):
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        library.arm(-1, 0, 0)
        work(os.path.join(folder, "count.vtkhdf"), lambda k: os.write(writer, b""), 8, 2)
        os.write(writer, struct.pack("<q", library.calls()))
        os._exit(0)
    calls = struct.unpack("<q", os.read(reader, 8))[0]
    os.waitpid(child, 0)
    os.close(reader)
    os.close(writer)
    return calls


def preload(source_folder):
    """Start again with the counting library; None where there is no C compiler."""
    if "RECORDING_KILLS_LIBRARY" in os.environ:
        return ctypes.CDLL(os.environ["RECORDING_KILLS_LIBRARY"])
    source, library = source_folder / "calls.c", source_folder / "calls.so"
    source.write_text(PRELOADED)
    if shutil.which("cc") is None:
        return None
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    preloaded = ":".join(filter(None, [str(library), os.environ.get("LD_PRELOAD")]))
    done = subprocess.run(
        [sys.executable, *sys.argv],
        env={**os.environ, "LD_PRELOAD": preloaded, "RECORDING_KILLS_LIBRARY": str(library)},
        check=False,
    )
    sys.exit(done.returncode)


def main(kills, seed):
    with tempfile.TemporaryDirectory() as folder:
        library = preload(Path(folder))
        calls = calls_of_a_run(folder, library) if library else 0
        tally = {"kills": kills, "at_calls": 0, "calls": calls, **dict.fromkeys(COUNTED, 0)}
        tally["messages"] = []
        start = time.monotonic()
        for i in range(kills):
            rng = random.Random(seed * 1_000_003 + i)
            home = Path(folder, f"trial{i}")
            home.mkdir()
            path = str(home / "run.vtkhdf")
            if library and i % 2:
                tally["at_calls"] += 1
                acknowledged = kill_at_call(path, rng, tally, library, calls)
            else:
                acknowledged = kill_by_timer(path, rng, tally)
            check(path, acknowledged, tally, pack=i % 8 == 0)
            shutil.rmtree(home)
    print(json.dumps({**tally, "seconds": round(time.monotonic() - start, 1)}))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
