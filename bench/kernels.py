"""The kernels in C++ beside the roofline, from the Google Benchmark program of bench/cpp.

Prints JSON lines: what the processor can do, as the peers "triad" (bytes a second from each cache
and from memory) and "fma" (flops a second), and of each kernel the time of an item and its share of
the roofline: of the speed that it would have if only its bytes (from where they fit) or only its
flops took time. Everything on one thread, by the processor's time. The program is substep_bench, as
SUBSTEP_BENCH=ON builds it; SUBSTEP_KERNELS names it, else it is looked for in build/.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
# Those that count what they move; of the benchmarks with threads, the runs on one.
KERNELS = "^(roof|ode|linalg|springs|pbd|pbf|rigid/(narrow_phase|contacts|joints)|fields)/"
MPM = "^mpm/.*/3D/elastic/1000000/1/"


def find_program() -> Path | None:
    """The newest program, or None and a line that says so."""
    named = os.environ.get("SUBSTEP_KERNELS")
    found = [Path(named)] if named else sorted(ROOT.glob("build/*/substep_bench"), key=age)
    if found and found[-1].exists():
        return found[-1]
    print("# substep_bench is left out: build it with SUBSTEP_BENCH=ON (docs/performance.md)")
    return None


def age(path: Path) -> float:
    """When it was built."""
    return path.stat().st_mtime


def measure(program: Path, quick: bool) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """The context of the run, and the fastest repetition of each benchmark."""
    command = [str(program), f"--benchmark_filter={KERNELS}|{MPM}", "--benchmark_format=json"]
    command += [f"--benchmark_repetitions={4 if quick else 5}"]
    command += [f"--benchmark_min_time={0.05 if quick else 0.5}"]
    command += ["--benchmark_enable_random_interleaving=true"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{program} failed:\n{done.stderr}")
    out = json.loads(done.stdout)
    best: dict[str, dict[str, Any]] = {}
    for run in out["benchmarks"]:
        if run["run_type"] != "iteration":
            continue
        unit = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0}[run["time_unit"]]
        run["seconds"] = unit * min(run["cpu_time"], run["real_time"])
        name = run["name"]
        if name not in best or run["seconds"] < best[name]["seconds"]:
            best[name] = run
    return out["context"], dict(sorted(best.items()))


def main() -> None:
    """Run all of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="end within a minute or two")
    quick = parser.parse_args().quick
    program = find_program()
    if program is None:
        return
    context, runs = measure(program, quick)

    def emit(workload: str, peer: str, metric: str, value: float, unit: str, **more: Any) -> None:
        record = {"workload": workload, "peer": peer, "metric": metric}
        measured = {"value": float(f"{value:.4g}"), "unit": unit, "threads": 1}
        print(json.dumps({**record, **measured, "isa": context["level"], **more}), flush=True)

    made = {"compiler": context["compiler"], "load": round(context["load_avg"][0], 1)}
    bandwidth: dict[float, float] = {}  # by the size of what is gone over
    peak: dict[float, float] = {}  # by whether it is float32
    for name, run in runs.items():
        if not name.startswith("roof/"):
            continue
        rate = run["items"] / run["seconds"]
        if name.startswith("roof/triad"):
            bandwidth[run["set"]] = rate * run["bytes/item"]
            speed = bandwidth[run["set"]] / 1e9
            emit(name, "triad", "bytes_per_s", speed, "GB/s", set=run["set"], **made)
        else:
            peak[run["single"]] = rate * run["flops/item"]
            emit(name, "fma", "flops_per_s", peak[run["single"]] / 1e9, "GFlop/s", **made)
    for name, run in runs.items():
        if name.startswith("roof/"):
            continue
        seconds = run["seconds"] / run["items"]
        place = min((size for size in bandwidth if size >= run["set"]), default=max(bandwidth))
        by_bytes = run["bytes/item"] / bandwidth[place]
        by_flops = run["flops/item"] / peak[run["single"]]
        emit(name, "substep", "time_per_item", 1e9 * seconds, "ns")
        emit(
            name, "substep", "share_of_roofline", max(by_bytes, by_flops) / seconds, "1",
            roof="bytes" if by_bytes > by_flops else "flops", set=run["set"],
            bytes_per_item=float(f"{run['bytes/item']:.4g}"),
            flops_per_item=float(f"{run['flops/item']:.4g}"),
        )  # fmt: skip


if __name__ == "__main__":
    main()
