"""A lid drives the flow in a square; its profiles beside those of others."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...gridfluid import GridFlow, Wall
from ...view.field_sheet import draw_field, draw_streamlines
from ..declaration import Parameter, Scene
from .flows import InBox

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...recording import Recording

Array = NDArray[np.float64]

# Places on the middle lines [of the side], and there u and v [of the lid's speed].
Y = [0, 0.0547, 0.0625, 0.0703, 0.1016, 0.1719, 0.2813, 0.4531, 0.5, 0.6172, 0.7344, 0.8516, 0.9531,
     0.9609, 0.9688, 0.9766, 1]  # fmt: skip
X = [0, 0.0625, 0.0703, 0.0781, 0.0938, 0.1563, 0.2266, 0.2344, 0.5, 0.8047, 0.8594, 0.9063, 0.9453,
     0.9531, 0.9609, 0.9688, 1]  # fmt: skip
# Ghia, Ghia and Shin, J. Comput. Phys. 48, 387, 1982, Tables I and II; Botella and Peyret, Comput.
# Fluids 27, 421, 1998, Tables 9 and 10.
PUBLISHED = {
    100: (
        "Ghia et al. (1982)",
        [0, -0.03717, -0.04192, -0.04775, -0.06434, -0.1015, -0.15662, -0.2109, -0.20581, -0.13641,
         0.00332, 0.23151, 0.68717, 0.73722, 0.78871, 0.84123, 1],
        [0, 0.09233, 0.10091, 0.1089, 0.12317, 0.16077, 0.17507, 0.17527, 0.05454, -0.24533,
         -0.22445, -0.16914, -0.10313, -0.08864, -0.07391, -0.05906, 0],
    ),
    1000: (
        "Botella and Peyret (1998)",
        [0, -0.1812881, -0.20233, -0.2228955, -0.3004561, -0.3885691, -0.2803696, -0.1081999,
         -0.0620561, 0.0570178, 0.1886747, 0.3372212, 0.4723329, 0.5169277, 0.5808359, 0.6644227,
         1],
        [0, 0.2807056, 0.2962703, 0.3099097, 0.3330442, 0.3769189, 0.3339924, 0.3253592, 0.0257995,
         -0.3202137, -0.4264545, -0.5264392, -0.4103754, -0.3553213, -0.2936869, -0.2279225, 0],
    ),
}  # fmt: skip


class Cavity(InBox, GridFlow):
    """A square of 1 m under a lid that moves with 1 m/s.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    """

    recorded = ("velocity", "pressure", "vorticity")

    def __init__(self, parameters: dict[str, Any]) -> None:
        self.reynolds = parameters["reynolds"]
        super().__init__(
            [(0, 0), (1, 1)],
            1 / parameters["cells"],
            viscosity=1 / self.reynolds,
            sides=["wall", ("wall", Wall(velocity=(1.0, 0.0)))],
            cfl=1.2,
            largest_step=1.2 / parameters["cells"],
        )

    def words(self) -> str:
        """Extremes on the middle lines, and the distance from what others found."""
        (_, u), (_, v) = profiles(self.velocity)
        text = f"least u {u.min():.4f}, v from {v.min():.4f} to {v.max():.4f}"
        found = error(self.velocity, self.reynolds)
        return text if found is None else f"{text}; within {found:.3g} of {found.name}"


class _Difference(float):
    name: str


def error(velocity: Array, reynolds: float) -> _Difference | None:
    """Largest difference from published profiles [m/s], if there are any at this number."""
    if reynolds not in PUBLISHED:
        return None
    name, *published = PUBLISHED[int(reynolds)]
    lines = zip(profiles(velocity), (Y, X), published, strict=True)
    found = _Difference(max(np.abs(np.interp(x, *line) - p).max() for line, x, p in lines))
    found.name = name
    return found


def profiles(velocity: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Places and u on the vertical through the middle, and v on the horizontal; with the walls."""
    n = len(velocity)
    middle = [(n - 1) // 2, n // 2]
    places = np.concatenate([[0.0], (np.arange(n) + 0.5) / n, [1.0]])
    u = np.concatenate([[0.0], velocity[middle, :, 0].mean(axis=0), [1.0]])
    v = np.concatenate([[0.0], velocity[:, middle, 1].mean(axis=1), [0.0]])
    return (places, u), (places, v)


def _picture(recording: Recording, frame: int, figure: Figure) -> None:
    """Speed and streamlines on the left, the profiles on the right."""
    reynolds, part = recording.parameters["reynolds"], recording.parts["flow"]
    velocity = recording["flow"].field("velocity", frame)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.35, 1))
    axes: Any = figure.add_subplot(grid[:, 0])
    image = draw_field(axes, part, velocity, (0, 0.8), "viridis")
    draw_streamlines(axes, part, velocity, color="white", density=1.7, linewidth=0.7)
    axes.set(xlim=(0, 1), ylim=(0, 1), xticks=[0, 0.5, 1], yticks=[0, 0.5, 1])
    axes.set_title(
        f"Lid-driven cavity, Re {reynolds:g}, t = {recording.times[frame]:.1f} s", loc="left"
    )
    figure.colorbar(image, ax=axes, label="speed [m/s]", shrink=0.8, extend="max")
    name, *published = PUBLISHED.get(int(reynolds), ("", None, None))
    lines = profiles(velocity)
    texts = (("y [m]", "u at x = 0.5 [m/s]"), ("x [m]", "v at y = 0.5 [m/s]"))
    for k, ((x, values), places, known) in enumerate(zip(lines, (Y, X), published, strict=True)):
        plot: Any = figure.add_subplot(grid[k, 1])
        plot.axhline(0, color="0.85", lw=1)
        plot.plot(x, values, color="#0072b2", lw=1.8, label="here")
        if known is not None and reynolds in PUBLISHED:
            plot.plot(places, known, "o", ms=5, mfc="white", mec="#d55e00", mew=1.4, label=name)
        plot.set(xlim=(0, 1), xlabel=texts[k][0], ylabel=texts[k][1])
        if k == 0:
            plot.legend(loc="upper left", frameon=False, fontsize=9)


SCENE = Scene(
    name="cavity",
    doc="A lid drives the flow in a square; its profiles beside published ones.",
    parameters={
        "duration": Parameter("time simulated", 50.0, unit="s", above=0),
        "reynolds": Parameter("Reynolds number of side and lid", 1000.0, minimum=1, maximum=5000),
        "cells": Parameter("cells along a side", 128, minimum=8, maximum=2048),
    },
    quick={"duration": 1.0, "cells": 16},
    build=lambda parameters, seed: Cavity(parameters),
    parts=Cavity.parts,
    frame=Cavity.frame,
    summary=Cavity.words,
    picture=_picture,
)
