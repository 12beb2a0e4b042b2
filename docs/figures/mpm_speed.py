"""The figure of docs/mpm_speed.md: time per particle and step, by size, and beside the peers.

python docs/figures/mpm_speed.py bench/results/FILE.jsonl; the file has the records of bench/mpm.py.
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt

FOLDER = Path(__file__).resolve().parent
PEERS = {  # Okabe and Ito's colours
    "substep": "#0072b2",
    "hand-written": "#009e73",
    "taichi colour": "#e69f00",
    "taichi atomic": "#d55e00",
}


def main():
    records = [json.loads(line) for line in Path(sys.argv[1]).read_text().splitlines()]
    found = {}
    for record in records:
        if record.get("metric") == "substep_ns":
            space, material, n = record["workload"].split()
            found[record["peer"], space, material, int(n), record["threads"]] = record["value"]

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for peer, colour in PEERS.items():
        for threads, line in ((2, "o-"), (1, "o--")):
            points = sorted(
                (n, ns)
                for (name, space, material, n, t), ns in found.items()
                if (name, space, material, t) == (peer, "3D", "elastic", threads)
            )
            if points:
                label = f"{peer}, {threads} thread{'s' if threads > 1 else ''}"
                left.loglog(
                    *zip(*points, strict=True), line, color=colour, label=label, markersize=4
                )
    left.set(xlabel="particles", ylabel="ns per particle and step", title="elastic, 3D")
    left.set_ylim(5, 2000)
    left.legend(fontsize="x-small", ncols=2, loc="upper center")

    materials = ("elastic", "snow", "sand")
    for k, (peer, colour) in enumerate(PEERS.items()):
        heights = [found.get((peer, "3D", m, 1_000_000, 2), 0) for m in materials]
        bars = right.bar([i + 0.2 * k for i in range(3)], heights, 0.18, color=colour, label=peer)
        right.bar_label(bars, [f"{h:.3g}" if h else "" for h in heights], fontsize="x-small")
    right.set(yscale="log", ylim=(1, 6000), title="a million particles, two threads")
    right.set_xticks([0.3, 1.3, 2.3], materials)
    right.legend(fontsize="x-small", ncols=2, loc="upper center")
    figure.savefig(FOLDER / "mpm_speed.png", dpi=120)


if __name__ == "__main__":
    main()
