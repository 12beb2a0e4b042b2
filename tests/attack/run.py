"""Attacks everything for some time, and tells what happened: python tests/attack/run.py --hours 8.

Each torture gets its share of the time, in portions with rising seeds, so that the calls whose
allocations and polls are taken in turn come one after the other. The counts so far are in
attack.json and, as a table for docs/reliability.md, in attack.md in the folder of --out.
"""

import argparse
import importlib
import json
import os
import sys
import time
from pathlib import Path

import runner

# What a portion of each torture is, and its share of the time.
TORTURES = {
    "allocations": (1000, 2.0),
    "interrupts": (1000, 2.0),
    "api": (5000, 3.0),
    "threads": (10_000, 1.0),
    "formats": (5000, 1.0),
    "states": (2000, 1.0),
    "soak": (200, 1.0),
}
TOLD = {
    "allocations": "each native allocation of each call fails",
    "interrupts": "Ctrl-C at each instruction and poll of each call, and at random",
    "api": "public functions, methods and assignments with wrong arguments",
    "threads": "a second thread reads while the first steps, or calls what the first calls",
    "formats": "files that were tampered with",
    "states": "states that were tampered with",
    "soak": "made, used and destroyed",
}


def available(only):
    """The tortures by name; a sanitizer has its own malloc, which does not fail."""
    names = only or [name for name in TORTURES if name != "allocations" or not runner.SANITIZED]
    return {name: importlib.import_module(name) for name in names}


# The columns of what becomes of a file; what is read or refused is as it should be.
_OUTCOMES = {"hangs": "hangs", "slow": "hangs", "ends the process": "crashes"}


def _of_formats(got):
    rows = {}
    for name, outcomes in got["formats"].items():
        row = rows[name] = {"calls": sum(outcomes.values())}
        for outcome, count in outcomes.items():
            if outcome not in ("read", "refused", "OSError"):
                column = _OUTCOMES.get(outcome, "wrong types")
                row[column] = row.get(column, 0) + count
    return rows | {"findings": [str(finding) for finding in got["findings"]]}


def run(hours, only=(), seed=0, processes=1, cycles=None, tell=print, keep=lambda counts: None):
    """Counts by torture, after so many hours; every torture has at least one portion.

    `keep` is called with those so far after each portion.
    """
    tortures, end = available(only), time.monotonic() + 3600 * hours
    counts = {name: runner.Counts() for name in tortures}
    spent, portions = dict.fromkeys(tortures, 0.0), dict.fromkeys(tortures, 0)
    while True:
        fresh = [name for name in tortures if not portions[name]]
        if not fresh and time.monotonic() > end:
            return counts
        name = fresh[0] if fresh else min(spent, key=lambda n: spent[n] / TORTURES[n][1])
        begin, known = time.monotonic(), len(counts[name].findings)
        size = cycles if name == "soak" and cycles else TORTURES[name][0]
        more = {"processes": processes} if name not in ("formats", "states") else {}
        got = tortures[name].attack(size, seed + portions[name], **more)
        counts[name].take(_of_formats(got) if name == "formats" else got, name)
        spent[name] += time.monotonic() - begin
        portions[name] += 1
        for finding in counts[name].findings[known:]:
            tell(f"{name}: {finding}\n")
        keep(counts)
        told = ", ".join(f"{counts[name].total(c)} {c}" for c in runner.COLUMNS)
        tell(f"{time.strftime('%H:%M:%S')} {name}: {told} in {spent[name]:.0f} s")


def table(counts):
    """Markdown: a row for each torture, and one for each class in it."""
    lines = ["| torture | " + " | ".join(runner.COLUMNS) + " |"]
    lines.append("|---" + "|--:" * len(runner.COLUMNS) + "|")
    for name, torture in counts.items():
        numbers = [f"{torture.total(c):,}" for c in runner.COLUMNS]
        lines.append(f"| **{TOLD[name]}** | " + " | ".join(numbers) + " |")
        for row, columns in sorted(torture.rows.items()):
            numbers = [f"{columns[c]:,}" for c in runner.COLUMNS]
            lines.append(f"| {row} | " + " | ".join(numbers) + " |")
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=0.1)
    parser.add_argument("--only", action="append", default=[], choices=TORTURES)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--cycles", type=int, help="of the soak, for each class")
    parser.add_argument("--out", type=Path, default=Path("."))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)

    def keep(counts):
        rows = {name: torture.as_dict() for name, torture in counts.items()}
        (given.out / "attack.json").write_text(json.dumps(rows, indent=1))
        (given.out / "attack.md").write_text(table(counts))

    counts = run(given.hours, given.only, given.seed, given.processes, given.cycles, keep=keep)
    print(table(counts))
    return int(any(torture.failures() for torture in counts.values()))


if __name__ == "__main__":
    sys.exit(main())
