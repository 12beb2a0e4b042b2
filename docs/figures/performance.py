"""The table and the figure of docs/performance.md, from a file that bench/run.py wrote.

python docs/figures/performance.py bench/results/FILE.jsonl prints the table and draws the figure.
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt

FOLDER = Path(__file__).resolve().parent
# Label, workload, threads, name of substep's row, and what turns its value into a time.
RATE, TIME = (lambda value: 1e9 / value, "ns"), (lambda value: value, None)
ROWS = [
    ("Lorenz, a step of RK4", "lorenz_rk4", 1, "substep system", RATE),
    ("a call of a Python function, own cost", "python_call_array", 1, "substep", TIME),
    ("Arenstorf at 1e-8", "arenstorf_rtol1e-8", 1, "substep DOP853", TIME),
    ("Pleiades at 1e-12", "pleiades_rtol1e-12", 1, "substep DOP853", TIME),
    ("1e6 oscillators, a step of RK4", "oscillators_1e6_rk4", 2, "substep", TIME),
    ("1e6 oscillators, velocity Verlet", "oscillators_1e6_verlet", 2, "substep", TIME),
    ("chain of 1e6 masses, RK4", "chain_1e6_rk4", 2, "substep", TIME),
    ("chain of 1e6 masses, velocity Verlet", "chain_1e6_verlet", 2, "substep", TIME),
    ("a particle in the ABC flow, RK4", "advect_abc_rk4_float64_1e+06", 2, "substep", RATE),
    ("a particle on a 64³ grid, RK4", "advect_grid64_rk4_float64_1e+06", 2, "substep", RATE),
]
METRICS = {"steps_per_s", "own_cost_per_call", "time", "ms_per_step", "particle_steps_per_s"}
KINDS = [
    ("scipy", "SciPy", "#d55e00", "s"),
    ("nump", "NumPy", "#e69f00", "D"),
    ("numba", "numba, numbalsoda", "#0072b2", "^"),
    (("odeint", "cpp"), "C++ (odeint, written by hand)", "#777777", "o"),
]


def best_times(records, row):
    """Shortest time of substep and of each kind of peer, in the workload's unit."""
    _, workload, threads, own, (to_time, unit) = row
    times = {}
    for record in records:
        if record.get("workload", "").rsplit("_float64", 1)[0] != workload.rsplit("_float64", 1)[0]:
            continue
        if record["metric"] not in METRICS or "float32" in record["workload"]:
            continue
        peer = record["peer"]
        if peer == own:
            if record["threads"] != threads:
                continue
            kind = "substep"
        else:
            kinds = [name for start, name, *_ in KINDS if peer.lower().startswith(start)]
            if not kinds:
                continue
            kind = kinds[0]
        time = to_time(record["value"])
        times[kind] = min(time, times.get(kind, float("inf")))
        unit = unit or record["unit"]
    return times, unit


def main(path):
    """Print the table and draw the figure."""
    records = [json.loads(line) for line in Path(path).read_text().splitlines()]
    names = ["substep", *(kind[1] for kind in KINDS)]
    print("| | threads | " + " | ".join(names) + " |")
    print("|---" * (len(names) + 2) + "|")
    fig, ax = plt.subplots(figsize=(8, 4.4), constrained_layout=True)
    for i, row in enumerate(ROWS):
        times, unit = best_times(records, row)
        cells = [f"{times[name]:.3g} {unit}" if name in times else "–" for name in names]
        print(f"| {row[0]} | {row[2]} | " + " | ".join(cells) + " |")
        for _, name, colour, marker in KINDS:
            if name in times:
                ratio = times[name] / times["substep"]
                ax.plot(ratio, i, marker, color=colour, label=name, ms=7)
    handles = dict(zip(*reversed(ax.get_legend_handles_labels()), strict=True))
    ax.axvline(1.0, color="#009e73", lw=2)
    ax.text(1.03, -0.75, "substep", color="#009e73", weight="bold", va="center")
    ax.set(xscale="log", xlabel="time of the peer / time of substep, same run")
    ax.set_yticks(range(len(ROWS)), [f"{row[0]} ({row[2]} thr.)" for row in ROWS], fontsize=8)
    ax.set_ylim(len(ROWS) - 0.5, -1.1)
    ax.grid(axis="x", alpha=0.3)
    ax.spines[["top", "right"]].set_visible(False)
    ax.legend(
        handles.values(),
        handles.keys(),
        frameon=False,
        fontsize=8,
        loc="lower center",
        ncols=4,
        bbox_to_anchor=(0.3, 1.0),
    )
    fig.savefig(FOLDER / "performance.png", dpi=110)


if __name__ == "__main__":
    main(sys.argv[1])
