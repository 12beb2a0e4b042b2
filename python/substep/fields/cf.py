"""What the variables of a NetCDF file mean, by the conventions for climate and forecast (CF)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError
from .netcdf import Variable

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
    "depth": "z", "deptht": "z", "depthu": "z", "depthv": "z", "depthw": "z", "lev": "z",
    "level": "z", "z": "z",
    "time": "t", "time_counter": "t", "t": "t",
}  # fmt: skip
_LONGEST_TEXT = 1000  # characters of an attribute
_LATEST_TIME = 1e15  # [s since 1970]; milliseconds beyond it are none of numpy.datetime64
VELOCITY = (
    (r"eastward|_x_velocity|x_wind", ("u", "uo", "ugos", "water_u", "ucur", "vozocrtx", "u10")),
    (r"northward|_y_velocity|y_wind", ("v", "vo", "vgos", "water_v", "vcur", "vomecrty", "v10")),
    (r"^(up|down)ward_.*velocity", ("w", "wo", "vovecrtz")),
)


def text(variable: Variable, key: str) -> str:
    """An attribute, or nothing."""
    for name, value in variable.attributes.items():
        if name.lower() == key or (key == "units" and name.lower() == "unit"):
            return str(value).strip()[:_LONGEST_TEXT]
    return ""


def role(variable: Variable) -> str:
    """Whether it is a coordinate: x, y, z, t, or nothing."""
    standard, units, axis = (text(variable, key) for key in ("standard_name", "units", "axis"))
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
    return _NAMES.get(variable.name.lower().split("_grid")[0], "")  # nav_lon_grid_U


def is_degrees(variable: Variable) -> bool:
    """Whether it is a longitude or a latitude."""
    standard, units = text(variable, "standard_name"), text(variable, "units")
    named = variable.name.lower().startswith(("lon", "lat", "nav_lon", "nav_lat"))
    return standard in ("longitude", "latitude") or units.lower().startswith("degree") or named


def is_downward(variable: Variable, values: NDArray[np.float64]) -> bool:
    """Whether it is a depth and no height; where nobody says, one by its name."""
    positive = text(variable, "positive").lower()
    if positive in ("down", "up"):
        return positive == "down"
    return variable.name.lower().startswith("depth") and bool((values >= 0).all())


def numbers(path: Path, variable: Variable) -> NDArray[np.float64]:
    """All of a coordinate."""
    values = decode(path, variable, variable.read({}), speed=False)
    if not np.isfinite(values).all():
        raise FormatError(f"{path}: coordinate {variable.name} is not a list of finite numbers")
    return values


@np.errstate(all="ignore")
def decode(
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
        units = text(variable, "units")
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
def decode_time(path: Path, variable: Variable) -> tuple[NDArray[np.float64], bool]:
    """CF section 4.4: seconds since 1970 from "<unit> since <date>", and True.

    Without a date in whatever unit there is, else in seconds, and False.
    """
    raw = variable.read({})
    if raw.dtype.kind in "mM":  # xarray has decoded them
        seconds = raw.astype(f"{raw.dtype.kind}8[us]").astype(np.int64) / 1e6
        if np.isnat(raw).any():
            raise FormatError(f"{path}: {variable.name} has times that are missing")
        return seconds, raw.dtype.kind == "M"
    units = text(variable, "units")
    pattern = (
        r"(\w+?)s? since (-?\d{1,6})-(\d+)-(\d+)"
        r"(?:[T ]+(\d+):(\d+)(?::(\d+(?:\.\d*)?))?)?\s*(?:Z|UTC|GMT|[+-]0+:?0*|\+?0)?\s*$"
    )
    match = re.match(pattern, units, re.I)
    unit = (match.group(1) if match else re.sub(r"s$", "", units)).lower() or "s"
    factor = _SECONDS.get(unit) or _SECONDS.get(unit + "s")
    if factor is None:
        raise FormatError(
            f"{path}: {variable.name} has units {units!r}, expected '<unit> since <date>'"
        )
    if match is None:
        return _checked_times(path, variable, raw, factor, 0.0), False
    calendar = text(variable, "calendar").lower() or "standard"
    if calendar not in _CALENDARS:
        raise FormatError(f"{path}: calendar {calendar} is not one of {', '.join(_CALENDARS)}")
    year, month, day = (int(match.group(i)) for i in (2, 3, 4))
    try:
        date = np.datetime64(f"{year:04d}-{month:02d}-{day:02d}T00:00:00", "s")
    except (ValueError, OverflowError):
        raise FormatError(f"{path}: {variable.name} has units {units!r}: no such date") from None
    clock = sum(float(match.group(i) or 0) * f for i, f in ((5, 3600), (6, 60), (7, 1)))
    reference = float((date - np.datetime64("1970-01-01T00:00:00", "s")).astype(np.int64)) + clock
    return _checked_times(path, variable, raw, factor, reference), True


def _checked_times(
    path: Path, variable: Variable, raw: NDArray[Any], factor: float, reference: float
) -> NDArray[np.float64]:
    times = decode(path, variable, raw, speed=False) * factor + reference
    if not (np.abs(times) < _LATEST_TIME).all():
        raise FormatError(f"{path}: {variable.name} has times that no calendar has")
    return times
