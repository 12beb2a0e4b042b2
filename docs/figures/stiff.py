"""The table and the figure of docs/stiff.md, from a file that bench/run.py wrote.

python docs/figures/stiff.py bench/results/FILE.jsonl prints the table and draws the figure.
"""

import json
import re
import sys
from collections import defaultdict
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

FOLDER = Path(__file__).resolve().parent
PANELS = [
    ("vdpol", "Van der Pol, mu = 1000", "largest relative error", 1e-5),
    ("robertson", "Robertson, to t = 1e11", "largest relative error", 1e-5),
    ("bruss1d_N500", "Brusselator, 500 points", "largest error", 1e-3),
    ("bruss2d_N128", "Brusselator, 128 x 128", "largest error", 2e-3),
]
# Peer, threads: label, colour, marker. Okabe and Ito's colours.
PEERS = {
    ("substep Radau", 1): ("substep Radau", "#009e73", "o-"),
    ("substep Radau, direct", 1): ("substep Radau", "#009e73", "o-"),
    ("substep Radau, krylov", 1): ("substep Radau, Krylov", "#009e73", "s--"),
    ("substep implicit_euler", 1): ("substep implicit Euler", "#000000", "v-"),
    ("substep RKC2", 1): ("substep RKC2", "#0072b2", "D-"),
    ("substep RKC2", 2): ("substep RKC2, 2 threads", "#0072b2", "d--"),
    ("scipy BDF", 1): ("SciPy BDF", "#d55e00", "x:"),
    ("scipy Radau", 1): ("SciPy Radau", "#e69f00", "+:"),
    ("numbalsoda lsoda", 1): ("numbalsoda LSODA", "#cc79a7", "^:"),
    ("cvode_bdf_dense", 1): ("CVODE, dense", "#777777", "*:"),
    ("cvode_bdf_klu", 1): ("CVODE, KLU", "#777777", "p:"),
    ("cpp_rkc2", 2): ("RKC2 by hand in C++, 2 threads", "#56b4e9", "1:"),
}


def curves(records, problem):
    """(error, time) of every tolerance by peer and threads."""
    found = defaultdict(dict)
    for record in records:
        workload = record.get("workload", "")
        if re.fullmatch(rf"{problem}_rtol[\de-]+", workload) and record["unit"] in ("ms", "1"):
            key = record["peer"], record["threads"], workload
            found[key][record["metric"]] = record["value"]
    result = defaultdict(list)
    for (peer, threads, _), values in found.items():
        if {"time", "max_error"} <= values.keys():
            result[peer, threads].append((values["max_error"], values["time"]))
    return {key: sorted(points) for key, points in result.items()}


def time_at(points, error):
    """Time for at most an error: straight lines in logarithms between the points, as text."""
    errors, times = np.log10(np.array(points)).T
    if np.log10(error) < errors.min():
        return "–"
    return f"{10 ** np.interp(np.log10(error), errors, times):.3g} ms"


def main(path):
    """Print the table and draw the figure."""
    records = [json.loads(line) for line in Path(path).read_text().splitlines()]
    fig, axes = plt.subplots(2, 2, figsize=(9, 7.2), constrained_layout=True)
    handles, rows = {}, defaultdict(dict)
    for ax, (problem, title, label, error) in zip(axes.flat, PANELS, strict=True):
        found = curves(records, problem)
        for key, (name, colour, style) in PEERS.items():
            if key not in found:
                continue
            errors, times = zip(*found[key], strict=True)
            handles[name] = ax.loglog(errors, times, style, color=colour, label=name, ms=6)[0]
            rows[name][problem] = time_at(found[key], error)
        ax.invert_xaxis()
        ax.set(xlabel=f"{label} at the end", ylabel="time [ms]")
        ax.set_title(title, loc="left", fontsize=10, weight="bold")
        ax.grid(alpha=0.3)
        ax.spines[["top", "right"]].set_visible(False)
    fig.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=4, fontsize=8)
    print("| | " + " | ".join(f"{title}, {error:g}" for _, title, _, error in PANELS) + " |")
    print("|---" * (len(PANELS) + 1) + "|")
    for name, cells in rows.items():
        print(f"| {name} | " + " | ".join(cells.get(p[0], "–") for p in PANELS) + " |")
    fig.savefig(FOLDER / "stiff_precision.png", dpi=100)


if __name__ == "__main__":
    main(sys.argv[1])
