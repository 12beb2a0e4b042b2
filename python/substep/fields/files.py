"""Opens velocity fields: NetCDF files as levels in time, and .npz files."""

from __future__ import annotations

import glob
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from ..base.checks import (
    check_choice,
    check_integer,
    check_path,
    check_real,
    check_sequence,
    describe,
)
from ..errors import FormatError, InputError
from .curvilinear import CurvilinearField
from .grid import GridField
from .layout import File, find_components, find_corners, with_velocity
from .levels import EARTH_RADIUS
from .npz import read_npz
from .staggered import Stack, arrange

if TYPE_CHECKING:
    import xarray

    Source: TypeAlias = str | os.PathLike[str] | xarray.Dataset


def open_field(
    path: Source | Sequence[Source],
    variables: Sequence[str] | None = None,
    *,
    depth: float | None = None,
    interpolation: str = "linear",
    radius: float = EARTH_RADIUS,
    memory_limit: int = 1 << 31,
) -> GridField | CurvilinearField:
    """Open a velocity field from NetCDF files, whose times become its levels, or from .npz.

    Coordinates and velocities are found by the CF attributes `standard_name`, `units` and `axis`,
    else by their usual names. `_FillValue`, `missing_value`, `valid_min`, `valid_max`,
    `valid_range`, `scale_factor` and `add_offset` are obeyed. Longitude and latitude make the
    field geographic. Levels are read when they are needed. The field's times [s] begin with 0 at
    its first level; its attribute `origin` (numpy.datetime64) is the date of that, where the times
    have a date. The velocities may lie in files of their own.

    Longitudes and latitudes that depend on both dimensions make a `CurvilinearField`. Velocities on
    different points are those of an Arakawa C grid: the corners of its cells are taken from
    variables `glamf` and `gphif` (NEMO's coordinates or mesh mask, as one more file) or `lon_psi`
    and `lat_psi` (ROMS), or lie half way between the points of the velocities. NEMO's layout is
    expected: U at [j, i] is east of the cell [j, i], V north of it; where the corners are not
    given, also U west and V south.

    Parameters
    ----------
    path : path-like, xarray.Dataset or list of these
        A NetCDF file (classic or NetCDF-4), a folder of them, a pattern (`"*.nc"`), or a list; or
        one .npz with arrays `x, y[, z]` or `lon, lat[, depth]`, `values` of shape
        ([n_t,] n_x, n_y[, n_z], d) and, with levels, `times` [s].
    variables : sequence of str, optional
        Names of the velocity variables along x, y and, in space, z, where they are not found.
    depth : float, optional
        Depth or height [m] whose nearest layer is taken, which makes the field two-dimensional.
    interpolation : {'linear', 'cubic'}
        In space; see `GridField`. On curvilinear grids 'linear' alone.
    radius : float
        Radius of the Earth [m].
    memory_limit : int
        Bytes of levels kept in memory. A compressed file may unpack to that many bytes, or to its
        own size where that is larger; else it is refused.

    Returns
    -------
    GridField or CurvilinearField
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
        "radius": check_real("radius", radius, positive=True),
        "memory_limit": check_integer("memory_limit", memory_limit, minimum=1),
    }
    kind = check_choice("interpolation", interpolation, ("linear", "cubic"))
    entries = _find(path)
    if len(entries) == 1 and isinstance(entries[0], Path) and entries[0].suffix == ".npz":
        axes, values, times, geographic = read_npz(entries[0], options["memory_limit"])
        content: tuple[Any, ...] = axes, values, times
        field = _make(
            entries[0], GridField, *content, interpolation=kind, geographic=geographic, **options
        )
        field._sources = (str(entries[0]),)
        return field
    if variables is not None:
        names = [variables] if isinstance(variables, str) else variables
        names = check_sequence("variables", names, "names")
        if len(names) not in (2, 3) or not all(isinstance(name, str) for name in names):
            raise InputError(f"variables: expected two or three names, got {describe(variables)}")
        variables = names
    if depth is not None:
        depth = check_real("depth", depth)
    files = [File.open(entry, options["memory_limit"]) for entry in entries]
    if not isinstance(path, (list, tuple)):
        files = with_velocity(files, variables)
    components = find_components(files, variables, depth)
    stacks = [Stack(parts) for parts in components]
    first = stacks[0]
    grid = arrange(stacks, find_corners(files))
    times = first.times - first.times[0] if len(first.times) > 1 else None
    values = grid.levels if len(first.times) > 1 else grid.levels[0]
    options["geographic"] = first.geographic
    if grid.axes is not None:
        field = _make(
            first.name, GridField, grid.axes, values, times, interpolation=kind, **options
        )
    else:
        if kind == "cubic":
            raise InputError(f"interpolation: {first.name} is on a curvilinear grid: linear alone")
        assert grid.corners is not None
        field = _make(
            first.name,
            CurvilinearField,
            *grid.corners,
            values,
            times,
            z=grid.z,
            arakawa=grid.arakawa,
            **options,
        )
    if first.dated:
        epoch = np.datetime64("1970-01-01T00:00:00.000")
        field._origin = epoch + np.timedelta64(round(float(first.times[0]) * 1000), "ms")
    field._sources = tuple(str(file.name) for file in files)
    return field


def _make(name: object, kind: Any, *content: Any, **options: Any) -> Any:
    """A field of what a file holds; options are checked, so what is refused is the content."""
    try:
        return kind(*content, **options)
    except (InputError, TypeError) as error:
        raise FormatError(f"{name}: {error}") from error


def _find(path: Any) -> list[Any]:
    """Paths and datasets of xarray."""
    if isinstance(path, (list, tuple)):
        entries = [entry if _is_dataset(entry) else Path(check_path(entry)) for entry in path]
    elif _is_dataset(path):
        entries = [path]
    elif (file := Path(name := check_path(path))).is_dir():
        entries = sorted(p for p in file.iterdir() if p.suffix in (".nc", ".nc4", ".cdf"))
    elif glob.has_magic(name) and not file.exists():
        entries = [Path(entry) for entry in sorted(glob.glob(name))]
    else:
        entries = [file]
    if not entries:
        raise FileNotFoundError(f"{path}: no NetCDF files there")
    return entries


def _is_dataset(entry: Any) -> bool:
    xarray = sys.modules.get("xarray")  # who has a dataset has loaded it
    return xarray is not None and isinstance(entry, xarray.Dataset)
