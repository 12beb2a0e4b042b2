"""Checks the files that git tracks for paths of one machine, open ends and large files."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
MACHINE_PATH = re.compile(r"(?<![\w.}$])/(work|tmp|root|home|farm|opt|mnt|Users)/\w")
OPEN_END = re.compile(r"\b(TODO|FIXME|XXX)\b")
MAX_BYTES = 1_000_000


def complaints(name: str) -> list[str]:
    """What is wrong with one file."""
    path = ROOT / name
    found = []
    if path.stat().st_size > MAX_BYTES:
        found.append(f"{name}: more than {MAX_BYTES} bytes")
    if name == Path(__file__).relative_to(ROOT).as_posix():
        return found
    try:
        lines = path.read_text().splitlines()
    except UnicodeDecodeError:
        return found
    for number, line in enumerate(lines, 1):
        if MACHINE_PATH.search(line):
            found.append(f"{name}:{number}: a path of one machine: {line.strip()}")
        if OPEN_END.search(line):
            found.append(f"{name}:{number}: an open end: {line.strip()}")
    return found


if __name__ == "__main__":
    names = subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True).splitlines()
    lines = [line for name in names if (ROOT / name).is_file() for line in complaints(name)]
    print("\n".join(lines) or f"text: {len(names)} files")
    sys.exit(bool(lines))
