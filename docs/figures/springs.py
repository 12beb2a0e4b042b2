"""The figure of docs/springs.md, from what bench/springs.py printed.

python docs/figures/springs.py bench/results/FILE.jsonl
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt

FOLDER = Path(__file__).resolve().parent
OURS, PEER = "substep", "CHOLMOD called directly"
# Peer, metric, threads: label, colour, marker. Okabe and Ito's colours.
STEPS = {
    (OURS, "newton_step", 2): ("Newton, converged", "#0072b2", "o-"),
    (OURS, "projective_step", 2): ("ten projective iterations", "#009e73", "s-"),
    (PEER, "ms_per_step", 2): ("reference: Newton, at most 40 iterations", "#d55e00", "o:"),
    (PEER, "ten_local_global_iterations", 1): ("reference: ten projective", "#e69f00", "s:"),
}
PARTS = {
    (OURS, "factorization", 1): ("factorization, one thread", "#56b4e9", "o--"),
    (OURS, "factorization", 2): ("factorization", "#0072b2", "o-"),
    (PEER, "factor_ms", 2): ("factorization by CHOLMOD", "#d55e00", "o:"),
    (OURS, "solve", 2): ("solution", "#009e73", "s-"),
    (OURS, "assembly", 2): ("gradient and Hessian", "#cc79a7", "D-"),
}


def main():
    records = [json.loads(line) for line in Path(sys.argv[1]).read_text().splitlines()]
    figure, panels = plt.subplots(1, 2, figsize=(9, 3.8), sharex=True, layout="constrained")
    for axes, curves, title in (
        (panels[0], STEPS, "a step of 1/60 s"),
        (panels[1], PARTS, "parts of an iteration"),
    ):
        for wanted, (label, color, style) in curves.items():
            points = sorted(
                (int(r["workload"].removeprefix("cloth ").removesuffix("^2")), r["value"])
                for r in records
                if (r.get("peer"), r.get("metric"), r.get("threads")) == wanted
            )
            if points:
                axes.loglog(*zip(*points, strict=True), style, color=color, label=label)
        axes.set(title=f"{title}, two threads", xlabel="vertices along an edge", ylabel="time [ms]")
        axes.set_xticks([32, 64, 128, 256], ["32", "64", "128", "256"])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        axes.legend(frameon=False, fontsize=8)
    figure.savefig(FOLDER / "springs.png", dpi=110)


if __name__ == "__main__":
    main()
