"""Runs every benchmark of this folder and collects what they print under bench/results/.

python bench/run.py [--quick] [NAME ...]: each bench/NAME.py (default: all) prints JSON lines
{workload, peer, metric, value, unit, threads, isa}; they are written, with a header of the CPU, the
instruction level, the threads, the versions and the date, to bench/results/CPU-LEVEL.jsonl.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import io
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import substep

HERE = Path(__file__).resolve().parent
KEYS = {"workload", "peer", "metric", "value", "unit", "threads", "isa"}


def cpu_name() -> str:
    """Model name of the processor."""
    match = re.search(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    return match[1].strip() if match else "unknown"


def header(quick: bool) -> dict[str, object]:
    """What the figures were measured with."""
    with contextlib.redirect_stdout(io.StringIO()):
        config = substep.show_config()
    now = datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds")
    return {"cpu": cpu_name(), "date": now, "quick": quick, **config}


def run(name: str, quick: bool) -> list[dict[str, object]]:
    """The records that one program prints; a program that fails or omits a key ends the run."""
    command = [sys.executable, str(HERE / f"{name}.py"), *(["--quick"] if quick else [])]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"bench/{name}.py failed:\n{done.stderr}")
    records = []
    for line in done.stdout.splitlines():
        if not line.startswith("{"):
            continue
        record = json.loads(line)
        missing = KEYS - record.keys()
        if missing:
            sys.exit(f"bench/{name}.py: {sorted(missing)} missing in {line}")
        records.append({"program": name, **record})
    return records


def main() -> None:
    """Run the programs that were named, or all."""
    names = sorted(path.stem for path in HERE.glob("*.py") if not path.stem.startswith("_"))
    names.remove("run")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(names))
    parser.add_argument("--quick", action="store_true", help="each program within a minute")
    options = parser.parse_args()
    for name in options.names:
        if name not in names:
            parser.error(f"no bench/{name}.py; there are {', '.join(names)}")
    head = header(options.quick)
    lines = [head]
    for name in options.names or names:
        start = time.perf_counter()
        records = run(name, options.quick)
        lines += records
        print(f"{name}: {len(records)} figures in {time.perf_counter() - start:.0f} s", flush=True)
    cpu = re.sub(r"[^A-Za-z0-9]+", "-", str(head["cpu"])).strip("-").lower()
    path = HERE / "results" / f"{cpu}-{head['level']}{'-quick' if options.quick else ''}.jsonl"
    path.parent.mkdir(exist_ok=True)
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    print(path.relative_to(HERE.parent))


if __name__ == "__main__":
    main()
