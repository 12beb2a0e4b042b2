"""Opens velocity fields: NetCDF files as levels in time, and .npz files."""

from __future__ import annotations

import glob
import math
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.checks import check_choice, check_integer, check_path, check_real
from ..base.reading import CONTENT_ERRNOS, DEFLATE_LIMIT
from ..errors import CorruptError, FormatError, InputError, TruncatedError
from .grid import EARTH_RADIUS, GridField
from .netcdf import Variable, read_header

_SECONDS = {
    "second": 1.0, "sec": 1.0, "s": 1.0, "minute": 60.0, "min": 60.0, "hour": 3600.0, "hr": 3600.0,
    "h": 3600.0, "day": 86400.0, "d": 86400.0, "millisecond": 1e-3, "msec": 1e-3, "ms": 1e-3,
    "microsecond": 1e-6,
}  # fmt: skip
_CALENDARS = ("standard", "gregorian", "proleptic_gregorian")
_SPEEDS = {
    "": 1.0, "m/s": 1.0, "cm/s": 0.01, "mm/s": 0.001, "km/h": 1 / 3.6, "knot": 1852 / 3600,
    "knots": 1852 / 3600, "kt": 1852 / 3600,
}  # fmt: skip
_STANDARD_NAMES = {
    "longitude": "x", "projection_x_coordinate": "x", "latitude": "y",
    "projection_y_coordinate": "y", "depth": "z", "height": "z", "altitude": "z", "time": "t",
}  # fmt: skip
_NAMES = {
    "lon": "x", "longitude": "x", "nav_lon": "x", "x": "x",
    "lat": "y", "latitude": "y", "nav_lat": "y", "y": "y",
    "depth": "z", "deptht": "z", "lev": "z", "level": "z", "z": "z",
    "time": "t", "time_counter": "t", "t": "t",
}  # fmt: skip
_NPZ = ("x", "y", "z", "lon", "lat", "depth", "times", "values")
_LONGEST_TEXT = 1000  # characters of an attribute
_LATEST_TIME = 1e15  # [s since 1970]; milliseconds beyond it are none of numpy.datetime64
_VELOCITY = (
    (r"eastward|_x_velocity|x_wind", ("u", "uo", "ugos", "water_u", "ucur", "vozocrtx", "u10")),
    (r"northward|_y_velocity|y_wind", ("v", "vo", "vgos", "water_v", "vcur", "vomecrty", "v10")),
    (r"^(up|down)ward_.*velocity", ("w", "wo", "vovecrtz")),
)


def open_field(
    path: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    variables: Sequence[str] | None = None,
    *,
    depth: float | None = None,
    interpolation: str = "linear",
    radius: float = EARTH_RADIUS,
    memory_limit: int = 1 << 31,
) -> GridField:
    """Open a velocity field from NetCDF files, whose times become its levels, or from .npz.

    Coordinates and velocities are found by the CF attributes `standard_name`, `units` and `axis`,
    else by their usual names. `_FillValue`, `missing_value`, `valid_min`, `valid_max`,
    `valid_range`, `scale_factor` and `add_offset` are obeyed. Longitude and latitude make the
    field geographic. Levels are read when they are needed. The field's times [s] begin with 0 at
    its first level; its attribute `origin` (numpy.datetime64) tells when that is.

    Parameters
    ----------
    path : path-like or list of path-like
        A NetCDF file (classic or NetCDF-4), a folder of them, a pattern (`"*.nc"`), or a list; or
        one .npz with arrays `x, y[, z]` or `lon, lat[, depth]`, `values` of shape
        ([n_t,] n_x, n_y[, n_z], d) and, with levels, `times` [s].
    variables : sequence of str, optional
        Names of the velocity variables along x, y and, in space, z, where they are not found.
    depth : float, optional
        Depth or height [m] whose nearest layer is taken, which makes the field two-dimensional.
    interpolation : {'linear', 'cubic'}
        In space; see `GridField`.
    radius : float
        Radius of the Earth [m].
    memory_limit : int
        Bytes of levels kept in memory. A compressed file may unpack to that many bytes, or to its
        own size where that is larger; else it is refused.

    Returns
    -------
    GridField
        With the attributes `origin` and `sources`.

    Raises
    ------
    FormatError
        If a file is cut off (TruncatedError), contradicts itself (CorruptError), or is not what
        was expected.
    InputError
        If the velocities are ambiguous: the candidates are named.
    OSError
        If there is no such file, or it cannot be read.

    References
    ----------
    NetCDF Climate and Forecast (CF) Metadata Conventions 1.11, sections 2.5.1, 3.3, 4, 8.1.

    Examples
    --------
    >>> import numpy as np, substep, tempfile, os
    >>> path = os.path.join(tempfile.mkdtemp(), "channel.npz")
    >>> np.savez(path, x=[0.0, 1.0], y=[0.0, 1.0], values=np.ones((2, 2, 2)))
    >>> substep.open_field(path)(0.0, [[0.5, 0.5]]).tolist()
    [[1.0, 1.0]]
    """
    options: dict[str, Any] = {
        "interpolation": check_choice("interpolation", interpolation, ("linear", "cubic")),
        "radius": check_real("radius", radius, positive=True),
        "memory_limit": check_integer("memory_limit", memory_limit, minimum=1),
    }
    paths = _find(path)
    if len(paths) == 1 and paths[0].suffix == ".npz":
        return _open_npz(paths[0], options)
    layouts = [_Layout.of(file, variables, depth, memory_limit) for file in paths]
    first = layouts[0]
    for other in layouts[1:]:
        if not first.same_grid(other):
            raise FormatError(f"{other.path}: its grid is not that of {first.path}")
    entries = sorted(
        ((time, number, layout) for layout in layouts for number, time in enumerate(layout.times)),
        key=lambda entry: entry[0],
    )
    moments = np.array([time for time, _, _ in entries])
    same = np.flatnonzero(np.diff(moments) <= 0)
    if len(same):
        one, two = entries[int(same[0])][2].path, entries[int(same[0]) + 1][2].path
        raise FormatError(f"{two}: has the same time as {one}")
    source = _Levels([(layout, number) for _, number, layout in entries], len(first.axes))
    levels: Any = source if len(entries) > 1 else source[0]
    times = moments - moments[0] if len(entries) > 1 else None
    field = _grid_field(
        first.path, first.axes, levels, times, geographic=first.geographic, **options
    )
    epoch = np.datetime64("1970-01-01T00:00:00.000")
    field.origin = epoch + np.timedelta64(round(float(moments[0]) * 1000), "ms")
    field.sources = tuple(str(file) for file in paths)
    return field


def _grid_field(path: Path, *content: Any, **options: Any) -> GridField:
    """A field of what a file holds; options are checked, so what is refused is the content."""
    try:
        return GridField(*content, **options)
    except (InputError, TypeError) as error:
        raise FormatError(f"{path}: {error}") from error


def _find(path: Any) -> list[Path]:
    if isinstance(path, (list, tuple)):
        paths = [Path(check_path(entry)) for entry in path]
    elif (file := Path(name := check_path(path))).is_dir():
        paths = sorted(p for p in file.iterdir() if p.suffix in (".nc", ".nc4", ".cdf"))
    elif glob.has_magic(name) and not file.exists():
        paths = [Path(entry) for entry in sorted(glob.glob(name))]
    else:
        paths = [file]
    if not paths:
        raise FileNotFoundError(f"{path}: no NetCDF files there")
    return paths


def _text(variable: Variable, key: str) -> str:
    for name, value in variable.attributes.items():
        if name.lower() == key or (key == "units" and name.lower() == "unit"):
            return str(value).strip()[:_LONGEST_TEXT]
    return ""


def _role(variable: Variable) -> str:
    standard, units, axis = (_text(variable, key) for key in ("standard_name", "units", "axis"))
    if standard in _STANDARD_NAMES:
        return _STANDARD_NAMES[standard]
    if re.match(r"degrees?_?(east|e)$", units, re.I):
        return "x"
    if re.match(r"degrees?_?(north|n)$", units, re.I):
        return "y"
    if re.match(r"\w+ since ", units):
        return "t"
    if axis.lower() in ("x", "y", "z", "t"):
        return axis.lower()
    return _NAMES.get(variable.name.lower(), "")


@dataclass
class _Layout:
    """What one file holds: its axes and times, and which variables are the velocity."""

    path: Path
    axes: list[NDArray[np.float64]]
    times: NDArray[np.float64]  # [s since 1970]
    velocity: list[Variable | None]
    fixed: list[dict[int, int]]
    roles: list[str]
    geographic: bool
    downward: bool

    @classmethod
    def of(
        cls, path: Path, variables: Sequence[str] | None, depth: float | None, limit: int
    ) -> _Layout:
        header = read_header(path, limit)
        velocity = _choose(path, header, variables)
        main = velocity[0]
        assert main is not None
        roles: list[str] = []
        axes, fixed = {}, {}
        times, downward, geographic = np.zeros(1), False, False
        for number, (name, length) in enumerate(zip(main.dimensions, main.shape, strict=True)):
            coordinate = header.get(name)
            role = _role(coordinate) if coordinate else ""
            if role and role in roles:
                raise FormatError(f"{path}: two dimensions of {main.name} are {role}")
            if coordinate and role and coordinate.shape != (length,):
                raise FormatError(
                    f"{path}: {name} has shape {coordinate.shape}, expected ({length},) as the "
                    f"dimension of {main.name}"
                )
            if role == "t" and coordinate:
                times = _decode_time(path, coordinate)
                if not len(times):
                    raise FormatError(f"{path}: has no times")
            elif role in ("x", "y") and coordinate:
                axes[role] = _numbers(path, coordinate)
                geographic |= _is_degrees(coordinate)
            elif role == "z" and coordinate and length > 1:
                layers = _numbers(path, coordinate)
                downward = _text(coordinate, "positive").lower() == "down"
                if depth is None:
                    axes["z"] = layers
                else:
                    fixed[number] = int(np.argmin(np.abs(layers - check_real("depth", depth))))
            elif length == 1:
                fixed[number] = 0
            else:
                raise FormatError(
                    f"{path}: dimension {name} of {main.name} ({length}) is no longitude, "
                    "latitude, depth or time of a rectilinear grid"
                )
            roles.append("" if number in fixed else role)
        if "x" not in axes or "y" not in axes:
            raise FormatError(f"{path}: {main.name} has no longitude and latitude, or x and y")
        if "z" not in axes:
            velocity = velocity[:2]
        ordered = [axes[role] for role in "xyz" if role in axes]
        velocity += [None] * (len(ordered) - len(velocity))
        for other in velocity[1:]:
            if other is not None and (other.dimensions, other.shape) != (
                main.dimensions,
                main.shape,
            ):
                raise FormatError(f"{path}: {other.name} is on another grid than {main.name}")
        kept = [fixed] * len(velocity)
        return cls(path, ordered, times, velocity, kept, roles, geographic, downward)

    def same_grid(self, other: _Layout) -> bool:
        """Whether both have the same axes."""
        return len(self.axes) == len(other.axes) and all(
            np.array_equal(a, b) for a, b in zip(self.axes, other.axes, strict=True)
        )

    def read(self, number: int) -> NDArray[np.float64]:
        """Velocities at a time, shape (n_x, n_y[, n_z], d)."""
        shape = tuple(len(axis) for axis in self.axes)
        level = np.zeros((*shape, len(self.axes)))
        for d, (variable, fixed) in enumerate(zip(self.velocity, self.fixed, strict=True)):
            if variable is None:
                continue
            indices = dict(fixed)
            if "t" in self.roles:
                indices[self.roles.index("t")] = number
            values = _decode(self.path, variable, variable.read(indices))
            left = [role for role in self.roles if role in ("x", "y", "z")]
            level[..., d] = values.transpose([left.index(role) for role in "xyz"[: len(left)]])
            upward = re.search("upward", _text(variable, "standard_name"))
            if d == 2 and self.downward and upward:
                level[..., d] *= -1
        return level


class _Levels:
    """Levels read when asked for; see GridField."""

    def __init__(self, entries: list[tuple[_Layout, int]], dimension: int) -> None:
        self._entries = entries
        axes = entries[0][0].axes
        self.shape = (len(entries), *(len(axis) for axis in axes), dimension)

    def __getitem__(self, level: int) -> NDArray[np.float64]:
        layout, number = self._entries[level]
        return layout.read(number)


def _choose(
    path: Path, header: dict[str, Variable], variables: Sequence[str] | None
) -> list[Variable | None]:
    if variables is not None:
        if isinstance(variables, str) or len(variables) not in (2, 3):
            raise InputError(f"variables: expected two or three names, got {variables!r}")
        for name in variables:
            if name not in header:
                raise InputError(
                    f"variables: {name} is not in {path}, which has {', '.join(header)}"
                )
        return [header[name] for name in variables]
    chosen: list[Variable | None] = []
    for pattern, names in _VELOCITY:
        flat = [v for v in header.values() if len(v.shape) >= 2]
        found = [v for v in flat if re.search(pattern, _text(v, "standard_name"))]
        found = found or [
            v for v in flat if v.name.lower() in names or re.search(pattern, v.name.lower())
        ]
        if len(found) > 1:
            listed = ", ".join(v.name for v in found)
            raise InputError(f"variables: {path} has several candidates ({listed}); name them")
        if not found and len(chosen) < 2:
            raise InputError(
                f"variables: no velocity found in {path}, which has {', '.join(header)}; name them"
            )
        chosen += found
    return chosen


def _is_degrees(variable: Variable) -> bool:
    standard, units = _text(variable, "standard_name"), _text(variable, "units")
    named = variable.name.lower() in ("lon", "lat", "longitude", "latitude", "nav_lon", "nav_lat")
    return standard in ("longitude", "latitude") or units.lower().startswith("degree") or named


def _numbers(path: Path, variable: Variable) -> NDArray[np.float64]:
    values = _decode(path, variable, variable.read({}), speed=False)
    if not np.isfinite(values).all():
        raise FormatError(f"{path}: coordinate {variable.name} is not a list of finite numbers")
    return values


@np.errstate(all="ignore")
def _decode(
    path: Path, variable: Variable, raw: NDArray[Any], speed: bool = True
) -> NDArray[np.float64]:
    """CF sections 2.5.1 (missing data) and 8.1 (packed data)."""
    if raw.dtype.kind not in "fiu":
        raise FormatError(f"{path}: {variable.name} does not hold numbers")

    def given(key: str) -> NDArray[np.float64]:
        value = variable.attributes.get(key)
        if value is None:
            return np.empty(0)
        array = np.asarray(value)
        try:
            if array.dtype.kind not in "fiuUS":
                raise ValueError
            return array.astype(np.float64).ravel()
        except ValueError:
            raise FormatError(f"{path}: {variable.name}: {key} is no number") from None

    values = raw.astype(np.float64)
    missing = np.isin(values, np.concatenate([given("_FillValue"), given("missing_value")]))
    if raw.dtype.kind == "f":
        missing |= np.abs(values) > 9e36  # the default fill value of floats is 9.97e36
    low, high = given("valid_min"), given("valid_max")
    valid = given("valid_range")
    if len(valid) == 2:
        low, high = valid[:1], valid[1:]
    if len(low):
        missing |= values < low[0]
    if len(high):
        missing |= values > high[0]
    scale, offset = given("scale_factor"), given("add_offset")
    values = values * (scale[0] if len(scale) else 1.0) + (offset[0] if len(offset) else 0.0)
    if speed:
        units = _text(variable, "units")
        plain = re.sub(r"met(er|re)s?", "m", units.lower())
        plain = re.sub(r"sec(ond)?s?", "s", plain)
        plain = re.sub(r"[\s.*]*s(\^|\*\*)?-1$", "/s", plain).replace(" ", "")
        if plain not in _SPEEDS:
            raise FormatError(f"{path}: {variable.name} has units {units!r}, which are no speed")
        values *= _SPEEDS[plain]
    values[missing] = np.nan
    if np.isinf(values).any():
        raise FormatError(f"{path}: {variable.name} has numbers beyond float64")
    return values


@np.errstate(all="ignore")
def _decode_time(path: Path, variable: Variable) -> NDArray[np.float64]:
    """CF section 4.4: seconds since 1970 from "<unit> since <date>"."""
    units = _text(variable, "units")
    pattern = (
        r"(\w+?)s? since (-?\d{1,6})-(\d+)-(\d+)"
        r"(?:[T ]+(\d+):(\d+)(?::(\d+(?:\.\d*)?))?)?\s*(?:Z|UTC|GMT|[+-]0+:?0*|\+?0)?\s*$"
    )
    match = re.match(pattern, units, re.I)
    unit = match.group(1).lower() if match else ""
    factor = _SECONDS.get(unit) or _SECONDS.get(unit + "s")
    if match is None or factor is None:
        raise FormatError(
            f"{path}: {variable.name} has units {units!r}, expected '<unit> since <date>'"
        )
    calendar = _text(variable, "calendar").lower() or "standard"
    if calendar not in _CALENDARS:
        raise FormatError(f"{path}: calendar {calendar} is not one of {', '.join(_CALENDARS)}")
    year, month, day = (int(match.group(i)) for i in (2, 3, 4))
    try:
        date = np.datetime64(f"{year:04d}-{month:02d}-{day:02d}T00:00:00", "s")
    except (ValueError, OverflowError):
        raise FormatError(f"{path}: {variable.name} has units {units!r}: no such date") from None
    clock = sum(float(match.group(i) or 0) * f for i, f in ((5, 3600), (6, 60), (7, 1)))
    reference = float((date - np.datetime64("1970-01-01T00:00:00", "s")).astype(np.int64)) + clock
    times = _decode(path, variable, variable.read({}), speed=False) * factor + reference
    if not (np.abs(times) < _LATEST_TIME).all():
        raise FormatError(f"{path}: {variable.name} has times that no calendar has")
    return times


def _open_npz(path: Path, options: dict[str, Any]) -> GridField:
    try:
        with zipfile.ZipFile(path) as archive:
            entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
            declared, size = (
                sum(entry.file_size for entry in entries.values()),
                os.path.getsize(path),
            )
            if declared > max(options["memory_limit"], size) or declared > DEFLATE_LIMIT * size:
                raise CorruptError(
                    f"{path}: unpacks to {declared} bytes, more than memory_limit = "
                    f"{options['memory_limit']} or than a file of {size} bytes can hold"
                )
            arrays = {
                name: _read_npy(f"{path}: {name}", archive, entries[name])
                for name in _NPZ
                if name in entries
            }
    except (
        *(zipfile.BadZipFile, zlib.error, struct.error),
        *(OSError, ValueError, EOFError, RuntimeError, KeyError, OverflowError),
    ) as error:
        system = isinstance(error, OSError) and error.errno not in CONTENT_ERRNOS
        if system or isinstance(error, FormatError):
            raise
        kind = TruncatedError if "File is not a zip file" in str(error) else CorruptError
        raise kind(f"{path}: cannot be read as .npz: {error}") from error
    geographic = "lon" in arrays
    names = ("lon", "lat", "depth") if geographic else ("x", "y", "z")
    axes = [arrays[name] for name in names if name in arrays]
    if len(axes) < 2 or "values" not in arrays:
        found = ", ".join(entries)
        raise FormatError(f"{path}: expected x, y or lon, lat, and values; it has {found}")
    times = arrays.get("times")
    field = _grid_field(path, axes, arrays["values"], times, geographic=geographic, **options)
    field.sources = (str(path),)
    return field


def _read_npy(where: str, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    """An array of numbers, as long as its header says.

    NEP 1, "A Simple File Format for NumPy Arrays".
    """
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise FormatError(f"{where}: compressed otherwise than by deflate; refused")
    with archive.open(entry) as file:
        try:
            version = np.lib.format.read_magic(file)
            if version == (1, 0):
                shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
            else:
                shape, fortran, dtype = np.lib.format.read_array_header_2_0(file)
        except Exception as error:  # it parses at most 10,000 characters of Python
            raise CorruptError(f"{where}: not an array of NumPy ({error})") from error
        data = file.read()  # at most entry.file_size bytes, whose checksum agrees
    if dtype.kind not in "fiub":
        raise FormatError(f"{where}: expected numbers, got dtype {dtype}")
    if min(shape, default=0) < 0 or len(data) != math.prod(shape) * dtype.itemsize:
        raise CorruptError(f"{where}: {len(data)} bytes are no array of shape {shape}")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")
