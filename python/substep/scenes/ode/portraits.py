"""Pictures that set methods side by side: one portrait for each, and their energy below."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...recording import Recording

# Okabe and Ito's eight colours, told apart with any colour vision (jfly.uni-koeln.de/color, 2008),
# the yellow left out for it is faint on white.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000", "#56b4e9", "#e69f00")

_Columns = tuple[NDArray[np.float64], NDArray[np.float64]]
_columns: weakref.WeakKeyDictionary[Recording, _Columns] = weakref.WeakKeyDictionary()


def history(recording: Recording, frame: int) -> _Columns:
    """Points, shape (frames, methods, 2), and relative energy errors, (frames, methods)."""
    if recording not in _columns:  # read once for all frames of a movie
        frames = [recording.frame(i)["particles"] for i in range(len(recording))]
        energy = np.array([arrays["energy"] for arrays in frames])
        points = np.array([arrays["points"][:, :2] for arrays in frames])
        _columns[recording] = points, np.abs(energy / energy[0] - 1)
    points, error = _columns[recording]
    return points[: frame + 1], error[: frame + 1]


def draw_portraits(
    figure: Figure,
    recording: Recording,
    frame: int,
    period: float,
    exact: NDArray[np.float64],
    reach: tuple[float, float, float, float],
    labels: tuple[str, str],
) -> None:
    """One portrait a method over the exact curve, shape (m, 2); below, the energy errors.

    `reach` is what the portraits show: left, right, bottom, top.
    """
    methods = recording.parameters["methods"]
    points, error = history(recording, frame)
    columns = min(5, len(methods))
    rows = -(-len(methods) // columns)
    grid = figure.add_gridspec(rows + 1, columns, height_ratios=(1,) * rows + (1.3,))
    for k, method in enumerate(methods):
        axes = figure.add_subplot(grid[divmod(k, columns)])
        axes.plot(exact[:, 0], exact[:, 1], color="0.8", lw=3)
        axes.plot(points[:, k, 0], points[:, k, 1], color=_colour(k), lw=0.6)
        axes.plot(points[-1, k, 0], points[-1, k, 1], "o", color=_colour(k), ms=4)
        axes.set(xlim=reach[:2], ylim=reach[2:], aspect="equal")
        axes.set(xticks=(-1, 0, 1), yticks=(-1, 0, 1))
        axes.set_title(method, fontsize=9)
        axes.tick_params(labelsize=7, length=2)
        axes.set_xlabel(labels[0], fontsize=8)
        if k % columns == 0:
            axes.set_ylabel(labels[1], fontsize=8)
    _draw_energy(figure.add_subplot(grid[rows, :]), recording, error, period)


def _draw_energy(
    axes: Any, recording: Recording, error: NDArray[np.float64], period: float
) -> None:
    """Draw the largest error of each period; within one the symplectic methods swing widely."""
    times = recording.times / period
    largest = _largest_of_periods(times, error)
    end = _largest_of_periods(times, history(recording, len(recording) - 1)[1])
    for k, method in enumerate(recording.parameters["methods"]):
        axes.plot(
            0.5 + np.arange(len(largest)),
            largest[:, k],
            marker=".",
            ms=4,
            lw=1.2,
            color=_colour(k),
            linestyle=(0, (4, 3)) if k % 2 else "-",
            zorder=3 if k % 2 else 2,  # dashes over lines, so that equal errors show
            label=method,
        )
    axes.set(yscale="log", ylim=(end.min() / 10, end.max() * 10), xlabel="time [periods]")
    axes.set_xlim(0, max(1, times[-1]))
    axes.set_ylabel("energy error,\nlargest of a period", fontsize=9)
    axes.minorticks_off()
    axes.grid(True, color="0.9")
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)


def _largest_of_periods(
    times: NDArray[np.float64], error: NDArray[np.float64]
) -> NDArray[np.float64]:
    period = np.maximum(np.ceil(times[: len(error)] - 1e-6), 1)
    starts = np.unique(period, return_index=True)[1]
    return np.maximum(np.maximum.reduceat(error, starts, axis=0), 1e-16)


def _colour(k: int) -> str:
    return _COLOURS[k % len(_COLOURS)]
