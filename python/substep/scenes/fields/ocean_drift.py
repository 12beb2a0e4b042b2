"""Drifters on the surface of a real ocean: currents from NetCDF files, land and all."""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ... import Advection, CurvilinearField, GridField, InputError, open_field
from ..declaration import Parameter, Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...recording import Part, Recording

DAY = 86400.0  # s
Currents: TypeAlias = GridField | CurvilinearField


class Drifters(Advection):
    """Particles on the water, spread evenly over it, with the outline of the land."""

    field: Currents

    def __init__(self, field: Currents, positions: NDArray[Any], step: float, method: str) -> None:
        super().__init__(field, positions, step=step, method=method)
        self.land = land_cells(field)

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Position and speed as float32 (half a metre, a millionth), and status.

        The speed of a drifter at rest on a coast or beyond the data is 0.
        """
        velocity = self.field(self.time, self.positions)
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        status = self.status
        speed[(status != 0) | np.isnan(speed)] = 0
        return {
            "position": (self.positions.astype(np.float32), "degree"),
            "speed": (speed.astype(np.float32), "m/s"),
            "status": (status, "1"),
        }


def land_cells(field: Currents) -> NDArray[np.float64]:
    """Corners of the cells that have no current: shape (4 cells, 2) [degrees].

    Those around the nodes of a rectilinear grid, and the own ones of a curvilinear one.
    """
    if isinstance(field, CurvilinearField):
        return _land_between_corners(field)
    nodes = np.stack(np.meshgrid(*field.axes, indexing="ij"), axis=-1).reshape(-1, 2)
    missing = nodes[np.isnan(field(float(field.times[0]), nodes)).any(axis=1)]
    edges = [
        np.concatenate([axis[:1], 0.5 * (axis[1:] + axis[:-1]), axis[-1:]]) for axis in field.axes
    ]
    i, j = (np.searchsorted(axis, missing[:, d]) for d, axis in enumerate(field.axes))
    x, y = edges
    corners = [(x[i], y[j]), (x[i + 1], y[j]), (x[i + 1], y[j + 1]), (x[i], y[j + 1])]
    return np.stack([np.column_stack(corner) for corner in corners], axis=1).reshape(-1, 2)


def _land_between_corners(field: CurvilinearField) -> NDArray[np.float64]:
    corners = np.stack([field.x, field.y], axis=-1)
    cells = np.stack(
        [corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]], axis=2
    ).reshape(-1, 4, 2)
    cells = cells[np.isfinite(cells).all(axis=(1, 2))]
    cells[:, 1:, 0] -= 360 * np.round((cells[:, 1:, 0] - cells[:, :1, 0]) / 360)
    middles = cells.mean(axis=1)
    missing = np.isnan(field(float(field.times[0]), middles)).any(axis=1)
    return cells[missing].reshape(-1, 2)


def release(field: Currents, count: int, seed: int) -> NDArray[np.float64]:
    """Positions on water at the first time, evenly over its area on the sphere [degrees]."""
    random = np.random.default_rng(seed)
    (west, south), (east, north) = field.bounds
    bottom, top = np.sin(np.radians([south, north]))
    found = np.empty((0, 2))
    for _ in range(100):
        u = random.random((count, 2))
        latitude = np.degrees(np.arcsin(bottom + (top - bottom) * u[:, 1]))
        positions = np.column_stack([west + (east - west) * u[:, 0], latitude])
        afloat = Advection(field, positions, step=1.0).status == 0
        found = np.concatenate([found, positions[afloat]])
        if len(found) >= count:
            return found[:count]
    raise InputError("data: there is hardly any water in it")


def _build(parameters: dict[str, Any], seed: int) -> Drifters:
    field = open_field(parameters["data"])
    if not field.geographic or field.dimension != 2:
        raise InputError("data: expected currents by longitude and latitude at one depth")
    days = float(field.times[-1] - field.times[0]) / DAY
    if not field.steady and parameters["duration"] > days * (1 + 1e-9):
        raise InputError(
            f"duration: the data covers {days:g} days, got {parameters['duration']:g}; "
            "say --set duration=..."
        )
    positions = release(field, parameters["particles"], seed)
    return Drifters(field, positions, parameters["step"], parameters["method"])


def _parts(simulation: Drifters) -> dict[str, Part]:
    from ...recording import Part

    cells = np.arange(len(simulation.land)).reshape(-1, 4)
    triangles = np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])
    return {
        "drifters": Part("particles", fields={"speed": "m/s", "status": "1"}),
        "land": Part("mesh", triangles=triangles),
    }


def _frame(simulation: Drifters) -> dict[str, dict[str, Any]]:
    arrays = {name: values for name, (values, _) in simulation.fields().items()}
    return {
        "drifters": {"points": arrays.pop("position"), **arrays},
        "land": {"points": simulation.land.astype(np.float32)},
    }


def _notes(simulation: Drifters) -> dict[str, str]:
    origin = simulation.field.origin
    return {} if origin is None else {"origin": str(origin.astype("datetime64[s]"))}


_Sums = tuple[int, NDArray[np.float64], NDArray[np.float64]]
_sums: weakref.WeakKeyDictionary[Recording, _Sums] = weakref.WeakKeyDictionary()


def _bin(arrays: dict[str, Any], extent: list[tuple[float, float]]) -> tuple[Any, Any]:
    """Number of moving drifters and sum of their speeds in every bin of the map."""
    moving = arrays["status"] == 0
    points, speed = arrays["points"][moving], arrays["speed"][moving]
    across = int(np.clip(np.sqrt(len(arrays["points"]) / 5), 20, 480))  # about ten in a bin
    options: dict[str, Any] = {"bins": (across, across // 2), "range": extent}
    count = np.histogram2d(points[:, 0], points[:, 1], **options)[0]
    return count, np.histogram2d(points[:, 0], points[:, 1], weights=speed, **options)[0]


def _mean_speed(
    recording: Recording, frame: int, extent: list[tuple[float, float]]
) -> NDArray[np.float64]:
    """Mean speed of the drifters that came through each bin up to a frame; NaN where none did."""
    nothing = (-1, np.zeros(()), np.zeros(()))
    done, count, total = _sums.get(recording, nothing)
    if done > frame:
        done, count, total = nothing
    for k in range(done + 1, frame + 1):  # a movie asks for one frame after the other
        more, speed = _bin(recording.frame(k)["drifters"], extent)
        count, total = count + more, total + speed
    _sums[recording] = (frame, count, total)
    return _ratio(total, count)


def _ratio(total: NDArray[np.float64], count: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)


def _picture(recording: Recording, frame: int, figure: Figure) -> None:
    first, arrays = recording.frame(0), recording.frame(frame)["drifters"]
    outline = np.concatenate([first["drifters"]["points"], first["land"]["points"]])[:, :2]
    (west, south), (east, north) = outline.min(axis=0), outline.max(axis=0)
    extent = [(float(west), float(east)), (float(south), float(north))]
    count, total = _bin(arrays, extent)
    now = _ratio(total, count)
    figure.set_size_inches(8.0, 9.6)
    maps = figure.subplots(2, 1, sharex=True, sharey=True)
    begin, end = _date(recording, 0), _date(recording, frame)
    titles = (
        f"Mean speed of the drifters that passed, {begin} to {end}",
        f"{int(count.sum()):,} of {len(arrays['points']):,} drifters still under way on {end}",
    )
    land = first["land"]["points"].reshape(-1, 4, first["land"]["points"].shape[1])[:, :, :2]
    mean = _mean_speed(recording, frame, extent)
    known = mean[np.isfinite(mean)]
    top = max(0.2, float(np.quantile(known, 0.998))) if known.size else 1.0
    for axes, title, speed in zip(maps, titles, (mean, now), strict=True):
        shown = axes.imshow(
            speed.T,
            origin="lower",
            extent=(*extent[0], *extent[1]),
            vmin=0,
            vmax=top,
            interpolation="nearest",
        )
        _draw_map(axes, land)
        axes.set(xlim=extent[0], ylim=extent[1])
        axes.set_aspect(1 / np.cos(np.radians(0.5 * (south + north))))
        axes.set_title(title, loc="left")
    figure.colorbar(shown, ax=maps, label="speed [m/s]", extend="max", shrink=0.6, aspect=30)


def _draw_map(axes: Any, land: NDArray[Any]) -> None:
    from matplotlib.collections import PolyCollection

    axes.add_collection(PolyCollection(list(land), facecolors="0.72", edgecolors="0.72", lw=0.3))
    axes.xaxis.set_major_formatter(lambda x, _: f"{abs(x):g}°{'E' if x >= 0 else 'W'}")
    axes.yaxis.set_major_formatter(lambda y, _: f"{abs(y):g}°{'N' if y >= 0 else 'S'}")
    axes.locator_params(steps=(1, 2, 5, 10))
    axes.spines[["top", "right"]].set_visible(True)


def _date(recording: Recording, frame: int) -> str:
    seconds = round(float(recording.times[frame]))
    origin = recording.parameters.get("notes", {}).get("origin")
    if origin is None:
        return f"day {seconds / DAY:.3g}"
    date = (np.datetime64(origin) + np.timedelta64(seconds, "s")).astype(object)
    return f"{date.day} {date:%B %Y}"


SCENE = Scene(
    name="ocean-drift",
    doc="Drifters in real ocean currents (NetCDF): a million particles on the water, for 60 days.",
    parameters={
        "data": Parameter("NetCDF file or folder of files with surface currents", kind=str),
        "duration": Parameter("time simulated", 60.0, unit="days", above=0),
        "particles": Parameter("number of drifters", 1_000_000, minimum=1, maximum=10**9),
        "step": Parameter("time step", 3600.0, unit="s", above=0),
        "method": Parameter("integrator", "rk4", choices=("euler", "midpoint", "heun", "rk4")),
    },
    quick={"duration": 2.0, "particles": 500},
    build=_build,
    parts=_parts,
    frame=_frame,
    notes=_notes,
    picture=_picture,
    frames=61,
    time_unit="days",
    time_scale=DAY,
)
