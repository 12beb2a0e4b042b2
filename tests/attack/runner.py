"""Runs tortures in child processes: what crashes or hangs costs one job, and is counted.

A torture is a module here with `attack(count, seed)`, which returns Counts or a dict of the same
numbers. Those that may end their process have also `work(job)`, and `attack` gives jobs to
`run_jobs`, which calls `work` in children. A job is what JSON can hold.
"""

import collections
import contextlib
import ctypes
import importlib
import json
import mmap
import os
import random
import resource
import select
import signal
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

HERE = Path(__file__).parent
BASE = HERE.parent / "base"
COLUMNS = ("calls", "crashes", "hangs", "torn", "wrong types", "leaks", "not tried")
# Slow, with terabytes of addresses.
SANITIZED = "libasan" in os.environ.get("LD_PRELOAD", "")
MEMORY = 4 << 30  # of a child
NOTES = 1 << 16  # bytes
# Of a sanitized child: what is too large is a MemoryError, and an error ends it by a signal.
_OPTIONS = {
    "ASAN_OPTIONS": "abort_on_error=1:allocator_may_return_null=1:"
    f"max_allocation_size_mb={MEMORY >> 20}",
    "UBSAN_OPTIONS": "abort_on_error=1",
}


class Counts:
    """Of each row (a class, a format) how often what happened, and how to see it again."""

    def __init__(self, rows=None, findings=None):
        self.rows = collections.defaultdict(collections.Counter)
        self.findings = list(findings or [])
        for row, columns in (rows or {}).items():
            self.rows[row].update(columns)

    def add(self, row, column, count=1, finding=None):
        self.rows[row][column] += count
        if finding is not None:
            self.findings.append(f"{column}: {row}: {finding}")

    def take(self, other, row):
        """Take over what a torture returned; a flat dict is one row."""
        if isinstance(other, Counts):
            other = other.as_dict()
        other = dict(other)
        self.findings += other.pop("findings", [])
        rows = other if all(isinstance(v, dict) for v in other.values()) else {row: other}
        for name, columns in rows.items():
            self.rows[name].update(columns)

    def as_dict(self):
        return {**{row: dict(columns) for row, columns in self.rows.items()}, **self._told()}

    def _told(self):
        return {"findings": self.findings} if self.findings else {}

    def total(self, column):
        return sum(columns[column] for columns in self.rows.values())

    def failures(self):
        return sum(self.total(column) for column in COLUMNS[1:])


# ---------------------------------------------------------------------------- in the child

_notes = None
_last = collections.deque(maxlen=6)


def note(text):
    """Say what is done next: a crash is reported with the last of these."""
    _last.append(text[:2000])
    if _notes is not None:
        data = "\n".join(_last).encode(errors="replace")[-NOTES + 1 :]
        _notes[: len(data) + 1] = data + b"\0"


def memory_in_use():
    """Bytes that the C heap has given out."""
    if SANITIZED:
        told = ctypes.CDLL(None).__sanitizer_get_current_allocated_bytes
        told.restype = ctypes.c_size_t
        return told()

    class Info(ctypes.Structure):
        _fields_ = [
            (name, ctypes.c_size_t)
            for name in (
                "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
            ).split()
        ]

    function = ctypes.CDLL(None).mallinfo2
    function.restype = Info
    info = function()
    return info.uordblks + info.hblkhd


def _child(module, notes, answers):
    """Answer each job that comes in by a line of counts."""
    global _notes
    import faulthandler

    if not SANITIZED:
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 28, 1 << 28))
    faulthandler.enable()
    with open(notes, "r+b") as file:
        _notes = mmap.mmap(file.fileno(), NOTES)
    tempfile.tempdir = tempfile.mkdtemp(dir=os.path.dirname(notes))
    os.chdir(tempfile.tempdir)  # files that calls make go there
    torture = importlib.import_module(module)
    with os.fdopen(int(answers), "w") as out:
        for line in sys.stdin:
            job = json.loads(line)
            random.seed(0)
            counts = torture.work(job)
            out.write(json.dumps(counts.as_dict()) + "\n")
            out.flush()


# ---------------------------------------------------------------------------- in the parent


class _Child:
    def __init__(self, module, folder, environment):
        self.notes = Path(folder) / "notes"
        self.notes.write_bytes(bytes(NOTES))
        self.errors = open(Path(folder) / "errors", "w+b")
        reader, writer = os.pipe()
        path = os.pathsep.join([str(HERE), str(BASE), os.environ.get("PYTHONPATH", "")])
        if SANITIZED:
            options = {n: f"{os.environ.get(n, '')}:{more}" for n, more in _OPTIONS.items()}
            environment = options | environment
        self.process = subprocess.Popen(
            [sys.executable, str(HERE / "runner.py"), module, str(self.notes), str(writer)],
            stdin=subprocess.PIPE,
            stdout=self.errors,
            stderr=self.errors,
            pass_fds=[writer],
            env={"SUBSTEP_NUM_THREADS": "1", **os.environ, "PYTHONPATH": path, **environment},
        )
        os.close(writer)
        self.reader = reader

    def answer(self, job, patience):
        """What the child says of a job; the word for its end, if it says nothing."""
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.write(json.dumps(job).encode() + b"\n")
            self.process.stdin.flush()
        data, noted = b"", None
        while not data.endswith(b"\n"):
            if not select.select([self.reader], [], [], patience)[0]:
                if noted != (noted := self.notes.read_bytes()):
                    continue  # it goes on
                return "hangs", f"nothing new in {patience:.0f} s"
            part = os.read(self.reader, 1 << 20)
            if not part:
                code = self.process.wait()
                if code > 0:  # the torture itself has raised
                    return "not tried", f"exit code {code}"
                return "crashes", signal.Signals(-code).name
            data += part
        return None, json.loads(data)

    def last_words(self):
        self.errors.seek(0)
        said = self.errors.read().decode(errors="replace")
        if "ERROR: AddressSanitizer" in said:
            said = said[said.index("ERROR: AddressSanitizer") :][:3000]
        done = self.notes.read_bytes().split(b"\0")[0].decode(errors="replace")
        return f"last calls:\n{done}\nstandard error:\n{said[-3000:]}"

    def end(self):
        with contextlib.suppress(ProcessLookupError, OSError):
            self.process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(5)
        self.process.kill()
        self.process.wait()
        os.close(self.reader)
        self.errors.close()


def portion(jobs, size, seed):
    """So many of the jobs, the next ones for the next seed, and how often all were done before."""
    order = list(jobs)
    random.Random(0).shuffle(order)
    size = min(size, len(order))
    places = range(seed * size, (seed + 1) * size)
    return [(order[k % len(order)], k // len(order)) for k in places]


def run_jobs(module, jobs, *, patience=60.0, processes=1, environment=None, row=str):
    """Counts of `work` of a module for all jobs; `row(job)` is where a crash or a hang counts."""
    counts, waiting = Counts(), collections.deque(jobs)

    def work(_):
        with tempfile.TemporaryDirectory() as folder:
            child = None
            while True:
                try:
                    job = waiting.popleft()
                except IndexError:
                    break
                child = child or _Child(module, folder, environment or {})
                end, answer = child.answer(job, patience)
                if end is None:
                    counts.take(answer, row(job))
                    continue
                if end == "hangs":
                    child.process.kill()
                counts.add(
                    row(job), end, 1, f"{answer}, job {json.dumps(job)}\n{child.last_words()}"
                )
                child.end()
                child = None
            if child:
                child.end()

    with ThreadPoolExecutor(processes) as pool:
        list(pool.map(work, range(processes)))
    return counts


if __name__ == "__main__":
    importlib.import_module("runner")._child(*sys.argv[1:])  # the one that tortures import
