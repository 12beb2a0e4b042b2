"""Pictures of recordings in the plane, by matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..recording import Recording
from .drawables import Scenery
from .field_sheet import draw_grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plain_picture(recording: Recording, frame: int, figure: Figure) -> None:
    """Draw every part in the plane: points coloured by the first field, bodies as their sections.

    Of a recording with a grid, the fields of the grid are drawn.

    Parameters
    ----------
    recording : Recording
        The recording.
    frame : int
        Frame number from 0.
    figure : matplotlib.figure.Figure
        Drawn on.

    Raises
    ------
    IndexError
        If there is no such frame.

    Examples
    --------
    >>> import substep
    >>> substep.render.plain_picture(recording, 0, figure)  # doctest: +SKIP
    """
    from matplotlib.collections import LineCollection

    for name, part in recording.parts.items():
        if part.kind == "grid":
            return draw_grid(recording, frame, name, figure)
    arrays = recording.frame(frame)
    axes: Any = figure.add_subplot()
    seen = {one.name: one for one in Scenery(recording).at(frame)}
    for name, part in recording.parts.items():
        points = arrays[name]["points"]
        if part.shape_vertices is not None and name in seen:
            outline = seen[name]
            lines: Any = outline.points[outline.rows][:, :, :2]
            axes.add_collection(LineCollection(lines, colors=outline.color))
            axes.autoscale_view()
            continue
        columns = points.T[:2]
        style: dict[str, Any] = {"s": marker_area(len(points)), "linewidths": 0, "label": name}
        field = next(iter(part.fields), None)
        if field is None:
            axes.scatter(*columns, **style)
            continue
        values = arrays[name][field]
        values = np.linalg.norm(values, axis=1) if values.ndim == 2 else values
        shown = axes.scatter(*columns, c=values, **style)
        unit = part.fields[field]
        figure.colorbar(shown, ax=axes, label=f"{name}: {field}" + (f" [{unit}]" if unit else ""))
    axes.set_aspect("equal")
    axes.set_xlabel("x")
    axes.set_ylabel("y")
    axes.set_title(
        f"{recording.scene or 'recording'}, t = {recording.times[frame]:.4g} s", loc="left"
    )


def marker_area(points: int) -> float:
    """Area of a marker [points^2] with which so many fill a figure without hiding each other.

    Parameters
    ----------
    points : int
        How many markers there are.

    Returns
    -------
    float
        The area.

    Raises
    ------
    TypeError
        If `points` is no number.

    Examples
    --------
    >>> import substep
    >>> substep.render.marker_area(10)
    30.0
    """
    return float(np.clip(2e5 / max(points, 1), 0.2, 30.0))
