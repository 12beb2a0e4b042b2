"""Pictures for notebooks, by matplotlib: of simulations, recordings, results, fields, regions."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.simulation import Simulation
from ..errors import SubstepError
from ..fields import AdvectionResult, DoubleGyre, Field
from ..ode import EnsembleResult, OdeResult, SecondOrderResult
from ..recording import Recording
from ..stability.analysis import Region
from .drawables import Drawable, Scenery, reach
from .field_sheet import PALETTES
from .flat import marker_area
from .look import Camera

SIZE = (4.8, 3.2)  # inches
MOST = 20_000  # points and triangles that are drawn
LINES = 20  # of a result
LIGHT = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])


def picture(what: Any) -> bytes | None:
    """A small picture of something, as PNG.

    Parameters
    ----------
    what : object
        A simulation, recording, result, field or region.

    Returns
    -------
    bytes or None
        None where there is nothing to draw, or no matplotlib.
    """
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError:
        return None
    draw = next(f for kind, f in _DRAWN.items() if isinstance(what, kind))
    figure = Figure(figsize=SIZE, dpi=100, layout="constrained")
    try:
        draw(what, figure)
    except SubstepError:  # another thread uses it, or it is closed
        return None
    if not figure.axes:
        return None
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _draw_scenery(source: Any, figure: Any) -> None:
    if isinstance(source, Recording) and not len(source):
        return
    scenery = Scenery(source)
    drawn = scenery.at()
    axes = figure.add_subplot()
    cells = [one for one in drawn if one.kind == "cells"]
    if cells or scenery.flat:
        _draw_plane(axes, drawn)
    else:
        _draw_space(axes, drawn)
    time = source.times[-1] if isinstance(source, Recording) else source.time
    axes.set_title(f"t = {time:.4g} s", loc="left", fontsize=9)
    axes.set_aspect("equal")


def _draw_plane(axes: Any, drawn: list[Drawable]) -> None:
    for one in drawn:
        x, y = one.points[:, 0], one.points[:, 1]
        if one.kind == "cells":
            name, values = next(iter(one.fields.items()))
            if values.ndim == 3:  # cut in the middle, seen from the front
                values = values[:, values.shape[1] // 2]
                y = one.points[:, 2]
            extent = (x[0], x[1], y[0], y[1])
            palette = PALETTES.get(name, "viridis")
            axes.imshow(values.T, origin="lower", extent=extent, cmap=palette)
        elif one.kind == "points":
            axes.scatter(x, y, s=marker_area(len(x)), c=one.color, linewidths=0)
        elif len(one.rows):
            _add_polygons(axes, one.points[one.rows][:, :, :2], one.color, one.opacity)


def _draw_space(axes: Any, drawn: list[Drawable]) -> None:
    """As a camera far away sees it, what is behind first."""
    camera = Camera(elevation=22.0).axes()
    low, high = reach(drawn)
    middle = (low + high) / 2
    for one in sorted(drawn, key=lambda one: one.kind == "lines" or not one.still):
        seen = (one.points - middle) @ camera.T
        if one.kind == "points":
            some = np.argsort(seen[:, 2])[:: max(1, len(seen) // MOST)]
            axes.scatter(
                *seen[some, :2].T,
                s=marker_area(len(some)),
                c=one.color,
                linewidths=0.2,
                edgecolors="0.25",
                alpha=one.opacity,
            )
        elif len(one.rows):
            corners = seen[one.rows]
            if one.kind == "surface":
                order = np.argsort(corners[:, :, 2].mean(axis=1))[:: max(1, len(corners) // MOST)]
                corners = corners[order]
                tones: Any = _shaded(one, one.rows[order])
            else:
                tones = one.color
            _add_polygons(axes, corners[:, :, :2], tones, one.opacity)
    axes.set_axis_off()
    axes.autoscale_view()


def _shaded(one: Drawable, faces: NDArray[np.int64]) -> NDArray[np.float64]:
    from matplotlib.colors import to_rgb

    a, b, c = (one.points[faces[:, k]].astype(float) for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    light = 0.55 + 0.45 * np.abs(normal @ LIGHT) / np.where(length > 0, length, 1)
    return np.clip(light[:, None] * np.array(to_rgb(one.color)), 0, 1)


def _add_polygons(axes: Any, corners: Any, color: Any, opacity: float) -> None:
    from matplotlib.collections import LineCollection, PolyCollection

    if corners.shape[1] == 2:
        axes.add_collection(LineCollection(corners, colors=color, linewidths=0.8))
    else:
        axes.add_collection(
            PolyCollection(corners, facecolors=color, edgecolors="none", alpha=opacity)
        )
    axes.autoscale_view()


def _draw_lines(t: Any, rows: NDArray[Any], figure: Any, label: str) -> None:
    axes = figure.add_subplot()
    for row in rows[:LINES]:
        axes.plot(t, row, linewidth=1)
    axes.set(xlabel="t", ylabel=label)


def _draw_ode(result: Any, figure: Any) -> None:
    _draw_lines(result.t, np.atleast_2d(np.real(result.y)), figure, "y")


def _draw_second_order(result: Any, figure: Any) -> None:
    _draw_lines(result.t, result.x.reshape(-1, len(result.t)), figure, "x [m]")


def _draw_ensemble(result: Any, figure: Any) -> None:
    if result.y.ndim == 3:
        _draw_lines(result.t, result.y[:, 0], figure, "first component of y")
        return
    axes = figure.add_subplot()
    x, y = (
        (result.y[:, 0], result.y[:, 1])
        if result.y.shape[1] > 1
        else (np.arange(len(result.y)), result.y[:, 0])
    )
    axes.scatter(x, y, s=marker_area(len(x)), linewidths=0)
    axes.set(xlabel="first component of y", ylabel="second component of y")


def _draw_paths(result: Any, figure: Any) -> None:
    axes = figure.add_subplot()
    for k in range(min(result.positions.shape[1], 10 * LINES)):
        axes.plot(*result.positions[:, k, :2].T, linewidth=0.7, color="0.6")
    x, y = result.final[:, :2].T
    axes.scatter(x, y, s=marker_area(len(x)), linewidths=0, zorder=3)
    axes.set(xlabel="x", ylabel="y")


def _draw_field(flow: Any, figure: Any) -> None:
    """The speed, and arrows; of a field in space in the middle of its third axis."""
    low, high = _box_of(flow)
    t = float(flow.times[0]) if hasattr(flow, "times") else 0.0
    x, y = (np.linspace(low[a], high[a], 81) for a in range(2))
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    if flow.dimension == 3:
        grid = np.column_stack([grid, np.full(len(grid), (low[2] + high[2]) / 2)])
    u = np.asarray(flow(t, grid), float)[:, :2].reshape(81, 81, 2)
    axes = figure.add_subplot()
    shown = axes.pcolormesh(x, y, np.linalg.norm(u, axis=-1), shading="nearest")
    some = slice(4, None, 9)
    axes.quiver(x[some], y[some], u[some, some, 0], u[some, some, 1], color="white", width=0.004)
    figure.colorbar(shown, ax=axes, label="speed [m/s]")
    axes.set_title(f"t = {t:.4g} s", loc="left", fontsize=9)


def _box_of(flow: Any) -> tuple[Any, Any]:
    """What is drawn of a field: its grid, one period, or what is within 1 m of the origin."""
    if hasattr(flow, "bounds"):
        return tuple(np.asarray(flow.bounds, float))
    if isinstance(flow, DoubleGyre):
        return np.zeros(2), np.array([2.0, 1.0])
    starts = zip(flow.lower, flow.periods, strict=True)
    low = np.array([-1.0 if period is None else first for first, period in starts])
    size = np.array([2.0 if p is None else p for p in flow.periods])
    return low, low + size


def _draw_region(region: Any, figure: Any) -> None:
    from ..stability.plotting import _draw

    _draw([region], None, figure.add_subplot())


_DRAWN: dict[Any, Any] = {
    (Simulation, Recording): _draw_scenery,
    OdeResult: _draw_ode,
    SecondOrderResult: _draw_second_order,
    EnsembleResult: _draw_ensemble,
    AdvectionResult: _draw_paths,
    Field: _draw_field,
    Region: _draw_region,
}
