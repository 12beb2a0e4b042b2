"""The tables of kernels in docs/performance.md, from a file with the records of bench/kernels.py.

python docs/figures/kernels.py bench/results/FILE.jsonl prints them.
"""

import json
import sys
from pathlib import Path


def size(value):
    """Bytes in the unit that suits them."""
    for unit in ("B", "KB", "MB"):
        if value < 1000 or unit == "MB":
            return f"{value:.3g} {unit}"
        value /= 1024
    return ""


def main(path):
    """Print the roofs, and the kernels."""
    records = [json.loads(line) for line in Path(path).read_text().splitlines()]
    records = [r for r in records if r.get("program") == "kernels"]
    print("| roof, one thread | |\n|---|---|")
    for record in records:
        if record["peer"] == "fma":
            print(f"| {record['workload'].rsplit('/')[-1]}, FMA | {record['value']:.4g} GFlop/s |")
        if record["peer"] == "triad":
            print(f"| triad over {size(record['set'])} | {record['value']:.3g} GB/s |")
    times = {r["workload"]: r["value"] for r in records if r["metric"] == "time_per_item"}
    print("\n| kernel | ns an item | bytes | flops | over | share of the roofline | roof |")
    print("|---|---|---|---|---|---|---|")
    for record in records:
        if record["metric"] != "share_of_roofline":
            continue
        name = record["workload"]
        cells = [
            name.removesuffix("/real_time").removesuffix("/1000000/1"),
            f"{times[name]:.3g}",
            f"{record['bytes_per_item']:.3g}",
            f"{record['flops_per_item']:.3g}",
            size(record["set"]) if record["set"] else "–",
            f"{100 * record['value']:.2g} %",
            record["roof"],
        ]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main(sys.argv[1])
