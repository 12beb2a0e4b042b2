"""The tables and the figure of docs/rigid_speed.md: times by scene and by number of bodies.

python docs/figures/rigid_speed.py bench/results/FILE.jsonl; the file has the records of
bench/rigid.py. Prints the tables of the page.
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt

FOLDER = Path(__file__).resolve().parent
PEERS = {  # Okabe and Ito's colours
    "substep": "#0072b2",
    "MuJoCo": "#009e73",
    "PyBullet maxc": "#e69f00",
    "PyBullet": "#d55e00",
}
STANDING = ("stack 10", "stack 20", "mass ratio 1000", "pyramid 210")
PILES = ("pile 1000 boxes", "pile 1000 mixed")
METRICS = {
    "step": "a step [ms]",
    "settled": "at the end [ms]",
    "second": "a simulated second [ms]",
    "drift": "drift [m]",
    "sinking": "sinking [m]",
    "late_overlap": "overlap, late [m]",
    "fallen": "fallen",
}
EXACT = {
    "incline": ("critical_angle", "creep", "slide_error"),
    "bounce": ("height_error",),
    "tumbling": ("energy_error", "momentum_error"),
    "cradle": ("last_ball", "other_balls"),
    "dominoes": ("fallen", "wave_speed"),
}


def rows(found, workload, metrics):
    """One line for each peer and number of threads that has any of the metrics."""
    who = sorted({(p, t) for w, p, m, t in found if w == workload and m in metrics})
    for peer, threads in sorted(who, key=lambda who: not who[0].startswith("substep")):
        values = [found.get((workload, peer, metric, threads)) for metric in metrics]
        cells = " | ".join("" if v is None else f"{v:.3g}" for v in values)
        print(f"| {workload} | {peer}{', 2 threads' * (threads == 2)} | {cells} |")


def tables(found):
    for workloads, left_out in ((STANDING, ()), (PILES, ("drift", "sinking", "fallen"))):
        metrics = [metric for metric in METRICS if metric not in left_out]
        print("| scene | engine | " + " | ".join(METRICS[m] for m in metrics) + " |")
        print("|---" * (2 + len(metrics)) + "|")
        for workload in workloads:
            rows(found, workload, metrics)
        print()
    for workload, metrics in {**EXACT, "batch stack 10": ("world_steps", "world_seconds")}.items():
        print("| | engine | " + " | ".join(metrics) + " |")
        print("|---" * (2 + len(metrics)) + "|")
        rows(found, workload, metrics)
        print()


def main():
    records = [json.loads(line) for line in Path(sys.argv[1]).read_text().splitlines()]
    found = {
        (r["workload"], r["peer"], r["metric"], r["threads"]): r["value"]
        for r in records
        if "workload" in r
    }
    tables(found)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    names = ("stack 20", "pyramid 210", *PILES)
    for k, (peer, colour) in enumerate(PEERS.items()):
        heights = [
            next(
                (
                    value
                    for (w, p, m, t), value in found.items()
                    if w == name and m == "second" and t == 1 and p.split(" CG")[0] == peer
                ),
                0,
            )
            for name in names
        ]
        bars = left.bar([i + 0.2 * k for i in range(len(names))], heights, 0.18, color=colour)
        bars.set_label(peer)
        left.bar_label(
            bars,
            [f"{h:.0f}" if h > 5 else f"{h:.1f}" if h else "" for h in heights],
            fontsize="xx-small",
        )
    left.set(yscale="log", ylabel="ms per simulated second", title="one thread")
    left.set_xticks([i + 0.3 for i in range(len(names))], [n.replace(" ", "\n") for n in names])
    left.tick_params("x", labelsize="small")
    left.margins(y=0.25)
    left.legend(fontsize="x-small", ncols=2)
    series = {}
    for (workload, peer, metric, threads), value in found.items():
        if workload.startswith("growth") and metric == "second":
            series.setdefault((peer, threads), []).append((int(workload.split()[1]), value))
    for (peer, threads), points in series.items():
        right.loglog(
            *zip(*sorted(points), strict=True),
            "o--" if threads == 2 else "o-",
            color=PEERS[peer.split(" CG")[0]],
            label=f"{peer}{', 2 threads' * (threads == 2)}",
            markersize=4,
        )
    right.set(xlabel="bodies", ylabel="ms per simulated second", title="a pile of boxes")
    right.legend(fontsize="x-small")
    figure.savefig(FOLDER / "rigid_speed.png", dpi=120)


if __name__ == "__main__":
    main()
