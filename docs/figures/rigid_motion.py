"""Draws docs/figures/rigid_motion.png and prints the table: python docs/figures/rigid_motion.py."""

import io
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image
from substep import rigid

FOLDER = Path(__file__).resolve().parent
# Okabe and Ito's colours.
COLOUR = {
    "exact": "#0072b2",
    "splitting": "#009e73",
    "matrix": "#e69f00",
    "quaternion": "#d55e00",
}
INERTIA = np.array([[0.29, 1.04, 1.25]]) / 12  # a box of half extents 0.5, 0.25, 0.1 and mass 1
MOMENTUM = INERTIA * [0.01, 5.0, 0.0]
STEP, EVERY, FRAMES = 1 / 240, 4, 6000  # 100 s


def seen_from_body(q):
    """R^T L."""
    w, v = q[0], -q[1:]
    t = 2 * np.cross(v, MOMENTUM[0])
    return MOMENTUM[0] + w * t + np.cross(v, t)


def motion(method):
    """Relative errors of the energy, and the middle component of m over |L|."""
    q = np.array([[1.0, 0.0, 0.0, 0.0]])
    m = [seen_from_body(q[0])]
    for _ in range(FRAMES):
        q = rigid.free_rotation(q, MOMENTUM, INERTIA, EVERY * STEP, method=method, steps=EVERY)
        m.append(seen_from_body(q[0]))
    m = np.array(m)
    energy = (m * m / INERTIA).sum(axis=1)
    length = np.linalg.norm(m, axis=1)
    return energy / energy[0] - 1, np.abs(length / length[0] - 1).max(), m[:, 1] / length[0]


def main():
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    t = np.arange(FRAMES + 1) * EVERY * STEP
    for method, colour in COLOUR.items():
        drift, length, middle = motion(method)
        turns = np.count_nonzero(middle[1:] * middle[:-1] < 0)
        print(f"{method:10} energy {np.abs(drift).max():.1e} |L| {length:.0e} turns {turns}")
        running = np.maximum.accumulate(np.abs(drift))
        left.semilogy(t[1:], np.maximum(running[1:], 1e-17), color=colour)
        left.annotate(method, (t[-1], running[-1]), (-4, 4), textcoords="offset points", ha="right")
        if method != "matrix":
            style, width = {"exact": ("-", 3.5), "splitting": ("--", 1.2)}.get(method, ("-", 0.7))
            order = 1 if method == "quaternion" else 2
            shade = 0.4 if method == "exact" else 1
            right.plot(
                t, middle, style, color=colour, lw=width, alpha=shade, zorder=order, label=method
            )
    left.set(xlabel="time / s", ylabel="largest error of the energy so far", ylim=(1e-17, 1e2))
    right.set(xlabel="time / s", ylabel="cosine between L and the middle axis", xlim=(0, 30))
    figure.legend(*right.get_legend_handles_labels(), loc="outside upper right", ncols=3)
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    image = io.BytesIO()
    figure.savefig(image, dpi=110)
    Image.open(image).convert("P", palette=Image.Palette.ADAPTIVE).save(
        FOLDER / "rigid_motion.png", optimize=True
    )


if __name__ == "__main__":
    main()
