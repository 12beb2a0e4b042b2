"""What the files of a velocity field hold: each velocity with its dimensions and coordinates."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, InputError
from .cf import VELOCITY, decode, decode_time, is_degrees, is_downward, numbers, role, text
from .netcdf import Variable, read_header

Array = NDArray[np.float64]
# Corners of the cells of C grids: NEMO's, which numbers f-points so, and those of ROMS.
_CORNERS = (("glamf", "gphif"), ("lon_psi", "lat_psi"))


@dataclass
class File:
    """A file, or a dataset of xarray, and its variables."""

    name: Path
    header: dict[str, Variable]

    @classmethod
    def open(cls, entry: Any, limit: int) -> File:
        """Read the header."""
        if isinstance(entry, Path):
            return cls(entry, read_header(entry, limit))
        return cls(Path(entry.encoding.get("source") or "dataset"), _of_xarray(entry))


def _of_xarray(dataset: Any) -> dict[str, Variable]:
    def reader(variable: Any) -> Any:
        def read(indices: dict[int, int]) -> NDArray[Any]:
            found = variable.isel({variable.dims[d]: k for d, k in indices.items()})
            return np.asarray(found.values)

        return read

    def attributes(variable: Any) -> dict[str, Any]:
        # Ranges are those of packed numbers (CF 8.1), which xarray has unpacked.
        packed = {"scale_factor", "add_offset"} & set(variable.encoding)
        return {k: a for k, a in variable.attrs.items() if not (packed and "valid" in str(k))}

    return {
        str(name): Variable(
            str(name), tuple(map(str, v.dims)), tuple(v.shape), attributes(v), reader(v)
        )
        for name, v in dataset.variables.items()
    }


@dataclass
class Component:
    """One velocity in one file: along which of its dimensions it has which coordinates."""

    name: Path
    variable: Variable
    places: dict[str, int]  # of "x", "y", "z", "t" among the dimensions
    fixed: dict[int, int]
    x: Array  # (n_x), or (n_x, n_y) of a curvilinear grid
    y: Array
    z: Array | None
    times: Array  # [s], since 1970 where they are dated
    dated: bool
    geographic: bool
    downward: bool

    @classmethod
    def of(cls, file: File, variable: Variable, depth: float | None) -> Component:
        """Find the coordinates; what is found at one depth has two dimensions."""
        places: dict[str, int] = {}
        fixed: dict[int, int] = {}
        found: dict[str, Variable] = {}
        across = _coordinates_of_both(file, variable)
        for number, (dimension, length) in enumerate(
            zip(variable.dimensions, variable.shape, strict=True)
        ):
            if across and dimension in across["x"].dimensions:
                kind = "yx"[across["x"].dimensions.index(dimension)]
            else:
                coordinate = _coordinate(file, dimension)
                kind = role(coordinate) if coordinate else ""
                if coordinate and kind:
                    if coordinate.shape != (length,):
                        raise FormatError(
                            f"{file.name}: {coordinate.name} has shape {coordinate.shape}, "
                            f"expected ({length},) as the dimension of {variable.name}"
                        )
                    if kind in places:
                        raise FormatError(
                            f"{file.name}: two dimensions of {variable.name} are {kind}"
                        )
                    found[kind] = coordinate
            if kind in ("x", "y", "t") or (kind == "z" and length > 1):
                places[kind] = number
            elif length == 1:
                fixed[number] = 0
            else:
                raise FormatError(
                    f"{file.name}: dimension {dimension} of {variable.name} ({length}) has no "
                    "longitude, latitude, depth or time"
                )
        if "x" not in places or "y" not in places:
            raise FormatError(
                f"{file.name}: {variable.name} has no longitude and latitude, or x and y"
            )
        times, dated = np.zeros(1), False
        if "t" in found:
            times, dated = decode_time(file.name, found["t"])
            if not len(times):
                raise FormatError(f"{file.name}: has no times")
        if across:
            x, y = _both(file, across["x"], across["y"])
        else:
            x, y = numbers(file.name, found["x"]), numbers(file.name, found["y"])
        horizontal = across or found
        geographic = is_degrees(horizontal["x"]) or is_degrees(horizontal["y"])
        z, downward = None, False
        if "z" in places:
            z = numbers(file.name, found["z"])
            downward = is_downward(found["z"], z)
            if depth is not None:
                fixed[places.pop("z")] = int(np.argmin(np.abs(z - depth)))
                z = None
        return cls(file.name, variable, places, fixed, x, y, z, times, dated, geographic, downward)

    def same_points(self, other: Component, vertical: bool = True) -> bool:
        """Whether both have the same coordinates."""

        def same(a: Array | None, b: Array | None) -> bool:
            return np.array_equal([] if a is None else a, [] if b is None else b, equal_nan=True)

        return (
            same(self.x, other.x)
            and same(self.y, other.y)
            and (not vertical or same(self.z, other.z))
        )

    def read(self, number: int) -> Array:
        """Velocities at a time [m/s], shape (n_x, n_y[, n_z])."""
        indices = dict(self.fixed)
        if "t" in self.places:
            indices[self.places["t"]] = number
        raw = self.variable.read(indices)
        values = decode(self.name, self.variable, raw)
        left = sorted((self.places[kind], kind) for kind in "xyz" if kind in self.places)
        kinds = [kind for _, kind in left]
        return values.transpose([kinds.index(kind) for kind in "xyz"[: len(kinds)]])

    @property
    def along_the_grid(self) -> bool:
        """Whether the file says that the velocity is along the rows of the grid."""
        return re.search(r"_[xy]_velocity", text(self.variable, "standard_name")) is not None

    @property
    def upward(self) -> bool:
        """Whether the velocity is upward."""
        named = self.variable.name.lower() in ("wo", "vovecrtz")
        return named or "upward" in text(self.variable, "standard_name")


def _coordinate(file: File, dimension: str) -> Variable | None:
    """Of the same name, or else one that has this dimension alone."""
    if dimension in file.header and len(file.header[dimension].shape) == 1:
        return file.header[dimension]
    alone = [v for v in file.header.values() if v.dimensions == (dimension,) and role(v)]
    return alone[0] if alone else None


def _coordinates_of_both(file: File, variable: Variable) -> dict[str, Variable]:
    """Longitude and latitude, or x and y, that depend on two dimensions of a variable."""
    named = text(variable, "coordinates").split()
    found: dict[str, Variable] = {}
    for other in file.header.values():
        kind = role(other)
        if kind not in ("x", "y") or len(other.shape) != 2 or other.name in sum(_CORNERS, ()):
            continue
        if not set(other.dimensions) <= set(variable.dimensions):
            continue
        if kind not in found or other.name in named:
            found[kind] = other
    if len(found) < 2 or found["x"].dimensions != found["y"].dimensions:
        return {}
    return found


def _both(file: File, x: Variable, y: Variable) -> tuple[Array, Array]:
    """Coordinates as (n_x, n_y), NaN where there are none: missing, or more than once (0, 0)."""
    lon, lat = (decode(file.name, v, v.read({}), speed=False).T.copy() for v in (x, y))
    nowhere = (lon == 0) & (lat == 0)
    if np.count_nonzero(nowhere) > 1:
        lon[nowhere] = lat[nowhere] = np.nan
    return lon, lat


def find_corners(files: Sequence[File]) -> tuple[Array, Array] | None:
    """Corners (n_x, n_y) of the cells, where a file has them."""
    for file in files:
        for names in _corners_in(file):
            x, y = (_flat(file, file.header[name]) for name in names)
            return _both(file, x, y)
    return None


def _corners_in(file: File) -> list[tuple[str, str]]:
    return [names for names in _CORNERS if all(name in file.header for name in names)]


def _flat(file: File, variable: Variable) -> Variable:
    """Without dimensions of length 1, as NEMO's time in a mesh mask."""
    single = {d: 0 for d, length in enumerate(variable.shape) if length == 1}
    kept = [d for d in range(len(variable.shape)) if d not in single]
    if len(kept) != 2:
        raise FormatError(f"{file.name}: {variable.name} has shape {variable.shape}")

    def read(indices: dict[int, int]) -> NDArray[Any]:
        return variable.read(single)

    dimensions = tuple(variable.dimensions[d] for d in kept)
    shape = tuple(variable.shape[d] for d in kept)
    return Variable(variable.name, dimensions, shape, variable.attributes, read)


def with_velocity(files: Sequence[File], variables: Sequence[str] | None) -> list[File]:
    """Those that hold a velocity or corners; all where none does."""
    used = [file for file in files if any(_choose(file, variables)) or _corners_in(file)]
    return used or list(files)


def find_components(
    files: Sequence[File], variables: Sequence[str] | None, depth: float | None
) -> list[list[Component]]:
    """Of the velocities along x, y and, in space where there is one, z: those in each file."""
    found: list[list[Component]] = [[], [], []]
    for file in files:
        chosen = _choose(file, variables)
        if not any(chosen) and not _corners_in(file):
            raise InputError(f"variables: {_none_in(file, variables)}; name them")
        for parts, variable in zip(found, chosen, strict=True):
            if variable is not None:
                parts.append(Component.of(file, variable, depth))
    for number, parts in enumerate(found[: len(variables or ()) or 2]):
        if not parts:
            raise InputError(
                f"variables: no velocity along {'xyz'[number]}: {_none_in(files[0], variables)}"
            )
    in_space = found[0][0].z is not None
    return found if in_space and found[2] else found[:2]


def _none_in(file: File, variables: Sequence[str] | None) -> str:
    listed = ", ".join(file.header)
    if variables is None:
        return f"no velocity found in {file.name}, which has {listed}"
    missing = next(name for name in variables if name not in file.header)
    return f"{missing} is not in {file.name}, which has {listed}"


def _choose(file: File, variables: Sequence[str] | None) -> list[Variable | None]:
    if variables is not None:
        named = [file.header.get(name) for name in variables]
        return [*named, None][:3]
    chosen: list[Variable | None] = []
    for pattern, names in VELOCITY:
        flat = [v for v in file.header.values() if len(v.shape) >= 2]
        found = [v for v in flat if re.search(pattern, text(v, "standard_name"))]
        found = found or [
            v for v in flat if v.name.lower() in names or re.search(pattern, v.name.lower())
        ]
        if len(found) > 1:
            listed = ", ".join(v.name for v in found)
            raise InputError(f"variables: {file.name} has several candidates ({listed}); name them")
        chosen.append(found[0] if found else None)
    return chosen
