"""Fields of grids in the plane, by matplotlib: colours, streamlines, and the range of both."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..recording import Part, Recording
from .extent import range_of, usual

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[Any]

# Palettes of fields by name: those of both signs about white, the others from one end.
PALETTES = {"vorticity": "RdBu_r", "pressure": "RdBu_r", "temperature": "inferno", "smoke": "bone"}
SIGNED = ("vorticity", "pressure")
MOST = 0.98  # of the numbers of a frame that colours of both signs reach
_ranges: weakref.WeakKeyDictionary[Recording, dict[str, tuple[float, float]]] = (
    weakref.WeakKeyDictionary()
)


def scalar(part: Part, values: Array) -> Array:
    """A number for each cell: of vectors the norm."""
    flat = np.asarray(values, float).reshape(*part.cells, -1)
    return flat[..., 0] if flat.shape[-1] == 1 else np.linalg.norm(flat, axis=-1)


def limits_of(recording: Recording, name: str) -> tuple[float, float]:
    """Range of a field in all frames; of one of both signs about 0, without its few extremes.

    A vorticity at walls and edges is many times that of the flow, which would be white beside it.
    """
    known = _ranges.setdefault(recording, {})
    if name not in known:
        low, high = range_of(recording, name)
        if name in SIGNED and low < 0:
            high = usual(recording, name, MOST)
            low = -high
        known[name] = low, high
    return known[name]


def draw_field(
    axes: Any,
    part: Part,
    values: Array,
    limits: tuple[float, float],
    palette: str = "viridis",
    smooth: bool = True,
) -> Any:
    """Draw a field over its box; returns the image, for a colour bar."""
    (left, bottom), (right, top) = np.asarray(part.bounds)
    image = axes.imshow(
        scalar(part, values).T,
        origin="lower",
        extent=(left, right, bottom, top),
        vmin=limits[0],
        vmax=limits[1],
        cmap=palette,
        interpolation="bicubic" if smooth else "nearest",
    )
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    return image


def draw_streamlines(axes: Any, part: Part, velocity: Array, **style: Any) -> None:
    """Draw lines along velocities, shape (nx, ny, 2); `style` as matplotlib's `streamplot` has."""
    low, cell = np.asarray(part.bounds)[0], part.cell or 1.0
    x, y = (low[a] + cell * (np.arange(part.cells[a]) + 0.5) for a in range(2))
    u, v = (velocity[..., a].T.astype(float) for a in range(2))
    axes.streamplot(x, y, u, v, **{"linewidth": 0.8, "arrowsize": 0.7, **style})


def draw_grid(recording: Recording, frame: int, name: str, figure: Figure) -> None:
    """A panel for each field of a grid in the plane, at most four."""
    part = recording.parts[name]
    fields = list(part.fields)[:4]
    columns = min(2, len(fields))
    for k, (field, unit) in enumerate((f, part.fields[f]) for f in fields):
        axes: Any = figure.add_subplot(-(-len(fields) // columns), columns, k + 1)
        values = recording[name].field(field, frame)
        palette = PALETTES.get(field, "viridis")
        image = draw_field(axes, part, values, limits_of(recording, field), palette)
        label = field if unit in ("", "1") else f"{field} [{unit}]"
        figure.colorbar(image, ax=axes, label=label, shrink=0.85)
    title = f"{recording.scene or 'recording'}, t = {recording.times[frame]:.4g} s"
    figure.suptitle(title, x=0.01, ha="left", fontsize=11)
