"""Programs in Python that run in a process of their own: what ends one ends no other."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from types import ModuleType
from typing import IO, Any


def child_environment(*folders: str) -> dict[str, str]:
    """For a child, which may have limits: it imports from where this process does."""
    path = os.pathsep.join([*(os.path.abspath(p) for p in sys.path if p), *folders])
    # Each thread would reserve memory; those of pysplashsurf add up in another order each time.
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "RAYON_NUM_THREADS")
    return {**os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": "1", **dict.fromkeys(names, "1")}


def run_program(
    program: ModuleType,
    arguments: list[Any],
    *,
    answer: IO[bytes],
    question: IO[bytes] | int = subprocess.DEVNULL,
    errors: IO[bytes] | int = subprocess.DEVNULL,
) -> int:
    """Exit code of a module that runs as a program; an interrupt ends it."""
    with subprocess.Popen(
        [sys.executable, str(program.__file__), *map(str, arguments)],
        stdin=question,
        stdout=answer,
        stderr=errors,
        env=child_environment(),
    ) as process:
        try:
            while process.poll() is None:  # not `wait`, which delays an interrupt
                time.sleep(0.005)
        except BaseException:
            process.kill()
            raise
    answer.seek(0)
    return process.returncode
