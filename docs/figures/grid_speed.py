"""The figure of docs/grid_flow.md and docs/grid_liquid.md: what a step costs, by size.

python docs/figures/grid_speed.py bench/results/FILE.jsonl; the file has the records of
bench/gridfluid.py.
"""

import json
import re
import sys
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.ticker import NullFormatter

FOLDER = Path(__file__).resolve().parent
COLOURS = {  # Okabe and Ito's
    "apic": "#0072b2",
    "flip": "#009e73",
    "maccormack": "#0072b2",
    "semi_lagrangian": "#009e73",
    "central": "#d55e00",
    "direct": "#009e73",
    "ball": "#0072b2",
    "pyamg": "#e69f00",
}


def draw(axes, found, kinds, title, **labels):
    for kind in kinds:
        for threads, line in ((2, "o-"), (1, "o--")):
            points = sorted((n, v) for (k, n, t), v in found.items() if (k, t) == (kind, threads))
            if points:
                label = f"{kind.replace('_', '-')}, {threads} thread{'s' if threads > 1 else ''}"
                style = dict(color=COLOURS[kind], label=label, markersize=4)
                axes.loglog(*zip(*points, strict=True), line, **style)
    axes.set(title=title, **labels)
    axes.set_ylim(bottom=10)
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.legend(fontsize="x-small")


def main():
    liquid, smoke, projection = {}, {}, {}
    for line in Path(sys.argv[1]).read_text().splitlines():
        record = json.loads(line)
        if "workload" not in record:
            continue
        words = record["workload"].replace(",", "").split()
        cells = 1
        for n in re.findall(r"\d+", record["workload"].replace("^3", "")):
            cells *= int(n)
        key = record["metric"], record["threads"]
        if words[0] == "dam" and key[0] == "particle":
            liquid[words[2], 2 * cells, key[1]] = record["value"]  # a quarter of 8 to a cell
        elif words[0] == "smoke" and key[0] == "cell":
            smoke[words[1], cells**3, key[1]] = record["value"]
        elif words[:2] == ["open", "top"] and key[0] == "projection":
            kind = "pyamg" if record["peer"] == "pyamg" else "ball" if "ball" in words else "direct"
            if words.count("x") == 2:
                projection[kind, cells, key[1]] = 1e6 * record["value"] / cells

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
    draw(left, liquid, ("apic", "flip"), "dam break", xlabel="particles", ylabel="ns per particle")
    kinds = ("central", "maccormack", "semi_lagrangian")
    draw(middle, smoke, kinds, "smoke in a closed box", xlabel="cells", ylabel="ns per cell")
    kinds = ("pyamg", "ball", "direct")
    draw(right, projection, kinds, "projection", xlabel="cells", ylabel="ns per cell")
    figure.savefig(FOLDER / "grid_speed.png", dpi=120)


if __name__ == "__main__":
    main()
