"""What a sweep costs beside its runs, and what is left of it when its processes are killed.

Runs of 5 ms, whose results are compared with those of the function called here: the overhead is the
time of the sweep over all processes, less that of the function called in a loop, per run. Each run
leaves a byte when it begins: as many begin twice, at most, as processes were killed.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import tempfile
import threading
import time

import numpy as np
import psutil
import substep


def work(number: int, seed: int, log: str = os.devnull) -> dict[str, np.ndarray]:
    """About 5 ms."""
    with open(log, "ab", buffering=0) as file:
        file.write(b".")
    x = np.random.default_rng([number, seed]).normal(size=200_000)
    return {"x": np.sort(x)[::1000]}


def is_worker(process: psutil.Process) -> bool:
    """Whether it does runs: a fork of Python's fork server."""
    return "forkserver" in " ".join(process.parent().cmdline())


def killer(count: int, over: threading.Event, killed: list[int]) -> None:
    """Kills processes of the sweep, one each fifth of a second."""
    choose = random.Random(0)
    while not over.is_set() and len(killed) < count:
        time.sleep(0.2)
        with contextlib.suppress(psutil.Error, AttributeError, IndexError):
            children = psutil.Process().children(recursive=True)
            child = choose.choice([c for c in children if is_worker(c)])
            child.kill()
            killed.append(child.pid)


def main() -> None:
    """Print JSON lines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    runs = 200 if parser.parse_args().quick else 1000
    workers = len(os.sched_getaffinity(0))
    begun = time.perf_counter()
    alone = np.array([work(k, 0)["x"] for k in range(runs)])
    serial = time.perf_counter() - begun
    for kills in (0, runs // 50):
        over, killed = threading.Event(), []
        thread = threading.Thread(target=killer, args=(kills, over, killed))
        with tempfile.TemporaryDirectory() as folder:
            thread.start()
            log = os.path.join(folder, "log")
            begun = time.perf_counter()
            parameters = {"number": range(runs), "log": log}
            found = substep.sweep(work, parameters, os.path.join(folder, "out"))
            taken = time.perf_counter() - begun
            over.set()
            thread.join()
            assert not found.failed
            assert np.array_equal(found.arrays()["x"].reshape(alone.shape), alone)
            again = os.path.getsize(log) - runs
            assert 0 <= again <= len(killed)
        record = {"workload": f"{runs} runs, {len(killed)} processes killed", "peer": "none"}
        value = 1e3 * (taken * workers - serial) / runs
        record |= {"metric": "overhead of a run", "value": value, "unit": "ms"}
        record |= {"threads": workers, "isa": "any"}
        print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
