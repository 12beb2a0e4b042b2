"""What a recording reaches in space and in its fields, over all frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.checks import check_real, describe
from ..base.quaternions import rotate
from ..errors import InputError
from ..recording import Part, Recording
from .look import Look
from .surfaces import in_space, magnitude

FRAMES_LOOKED_AT = 60  # for the region that is shown and the range of colours


def posed(part: Part, arrays: Mapping[str, Any]) -> NDArray[np.float32]:
    """Points of a part in a frame; of bodies that have shapes the vertices of these."""
    if part.shape_vertices is None:
        return in_space(arrays["points"])
    rows = np.asarray(part.shape_bodies)[:, 0]
    x, q = arrays["points"][rows], arrays["orientation"][rows]
    return in_space(in_space(x) + rotate(np.asarray(q, float), np.asarray(part.shape_vertices)))


def radius_of(points: NDArray[Any], worlds: Any = None) -> float:
    """Half the median distance to the nearest point, of a sample.

    Of points of several worlds, which lie on each other, those of the first world alone.
    """
    if worlds is not None and len(points):
        points = points[np.ravel(worlds) == np.ravel(worlds)[0]]
    if len(points) < 2:
        return 0.05
    some = points[:: max(1, len(points) // 20_000)]
    near = [
        np.partition(np.linalg.norm(some - point, axis=1), 1)[1]
        for point in some[:: max(1, len(some) // 100)]
    ]
    scale = (len(some) / len(points)) ** (1 / points.shape[1])  # the sample is sparser
    return 0.5 * float(np.median(near)) * scale or 1e-3


def radius_in(recording: Recording, name: str, look: Look) -> float:
    """Radius of a part's particles [m]."""
    if callable(look.radius):
        return check_real(f"radius of {name!r}", look.radius(recording), positive=True)
    if look.radius is not None:
        return look.radius
    part = recording.parts[name]
    if part.kind == "mesh" or part.shape_vertices is not None:
        return 0.0
    for frame in _frames_looked_at(recording):
        points = in_space(recording[name].points(frame))
        if len(points):
            named = "world" in part.fields
            return radius_of(points, recording[name].field("world", frame) if named else None)
    return 0.05


def _frames_looked_at(recording: Recording) -> list[int]:
    count = min(len(recording), FRAMES_LOOKED_AT)
    return np.unique(np.linspace(0, len(recording) - 1, count).astype(int)).tolist()


def box_of(recording: Recording, looks: Mapping[str, Look]) -> NDArray[np.float64]:
    """Lowest and highest corner of what the parts reach in all frames [m]."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for name, part in recording.parts.items():
        look = looks.get(name, Look())
        if look.hidden:
            continue
        if part.cells:
            corners = in_space(np.asarray(part.bounds))
            low, high = np.minimum(low, corners[0]), np.maximum(high, corners[1])
            continue
        radius = radius_in(recording, name, look)
        for frame in _frames_looked_at(recording) if part.points is None else [0]:
            points = posed(part, recording.frame(frame)[name])
            low = np.minimum(low, points.min(axis=0, initial=np.inf) - radius)
            high = np.maximum(high, points.max(axis=0, initial=-np.inf) + radius)
    if not np.all(low <= high):
        return np.array([[-1.0, -1, -1], [1, 1, 1]])
    half = np.maximum((high - low) / 2, 1e-3 * max(float(np.max(high - low)), 1e-3))
    return np.array([(low + high) / 2 - half, (low + high) / 2 + half])


def _numbers(recording: Recording, owners: list[str], color: str) -> Iterator[NDArray[Any]]:
    """The finite values of a field, of vectors the norm, frame by frame."""
    for name in owners:
        for frame in _frames_looked_at(recording):
            values = recording[name].field(color, frame)
            if cells := recording.parts[name].cells:
                values = values.reshape(-1, *values.shape[len(cells) :])
            values = magnitude(values)
            yield values[np.isfinite(values)]


def usual(recording: Recording, color: str, part: float) -> float:
    """What a part of the values of each frame is within; of 0 alone 0.5."""
    owners = [name for name, each in recording.parts.items() if color in each.fields]
    frames = [v for v in _numbers(recording, owners, color) if v.size]
    return max((float(np.quantile(np.abs(v), part)) for v in frames), default=0.0) or 0.5


def owners_of(recording: Recording, color: str) -> list[str]:
    """The parts that have a field, at least one."""
    owners = [name for name, part in recording.parts.items() if color in part.fields]
    if not owners:
        known = sorted({field for part in recording.parts.values() for field in part.fields})
        told = f"known: {', '.join(known)}" if known else "there are none"
        raise InputError(f"color: no part has a field {describe(color)}; {told}")
    return owners


def range_of(recording: Recording, color: str) -> tuple[float, float]:
    """Least and greatest value of a field in all frames."""
    owners = owners_of(recording, color)
    low, high = np.inf, -np.inf
    for values in _numbers(recording, owners, color):
        low, high = min(low, values.min(initial=low)), max(high, values.max(initial=high))
    if low < high:
        return float(low), float(high)
    middle = float(low) if low == high else 0.0
    return middle - 0.5, middle + 0.5


def is_flat(recording: Recording) -> bool:
    """Whether the first, the middle and the last frame lie in the plane z = 0."""
    frames = (0, len(recording) // 2, -1)
    return all(lies_flat(recording.parts, recording.frame(frame)) for frame in frames)


def lies_flat(parts: Mapping[str, Part], frame: Mapping[str, Any]) -> bool:
    """Whether no grid has three dimensions, and no point is off the plane z = 0."""
    points = (arrays["points"] for arrays in frame.values() if "points" in arrays)
    grids = (part.cells for part in parts.values() if part.cells)
    return all(len(cells) == 2 for cells in grids) and not any(x[:, 2:].any() for x in points)
