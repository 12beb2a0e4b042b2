"""Where the C++ peer programs are: the folder SUBSTEP_PEERS, or ../shared/peers/ode/cpp/bin."""

from __future__ import annotations

import os
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "shared/peers/ode/cpp/bin"


def peer_program(name: str) -> Path | None:
    """The program, or None (and a line that says so) where it has not been built."""
    program = Path(os.environ.get("SUBSTEP_PEERS", FOLDER)) / name
    if program.exists():
        return program
    print(f"# {name} is left out: build it, and name its folder in SUBSTEP_PEERS")
    return None
