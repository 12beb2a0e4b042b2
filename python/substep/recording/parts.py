"""What a recording consists of: its parts, their names and units, and the checks of a frame."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.box import check_box
from ..base.checks import as_array, check_array, check_choice, check_real, describe
from ..errors import InputError
from .frames import CONSTANTS, Constants, Spec

TOPOLOGIES = ("triangles", "edges", "tetrahedra")
SHAPES = ("shape_vertices", "shape_faces", "shape_bodies")
KINDS = ("particles", "bodies", "mesh", "grid")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,63}")
_DEVICES = re.compile(r"con|prn|aux|nul|com[0-9]|lpt[0-9]", re.IGNORECASE)  # Windows opens devices
_RESERVED = ("Assembly", "Steps", "points")


def check_name(what: str, name: Any) -> str:
    """A name that is safe in a file, in a path and in HDF5, and free."""
    if not isinstance(name, str):
        raise TypeError(f"{what}: expected a string, got {describe(name)}")
    if wrong := re.search(r"[^A-Za-z0-9_-]", name):
        raise InputError(
            f"{what}: expected letters, digits, '_' or '-', got {wrong[0]!r} in {describe(name)}"
        )
    if not _NAME.fullmatch(name) or _DEVICES.fullmatch(name) or name in _RESERVED:
        raise InputError(
            f"{what}: expected 1 to 64 letters, digits, '_' or '-', first a letter or '_', and "
            f"none of {', '.join(_RESERVED)} or a device name; got {describe(name)}"
        )
    return name


def check_text(what: str, text: Any, limit: int) -> str:
    """Printable text up to a length."""
    if not isinstance(text, str):
        raise TypeError(f"{what}: expected a string, got {describe(text)}")
    if len(text) > limit or not all(c.isprintable() for c in text):
        raise InputError(
            f"{what}: expected at most {limit} printable characters, got {describe(text)}"
        )
    return text


@dataclass(frozen=True, eq=False)
class Part:
    """One named part of a recording: its kind and its fields.

    Parameters
    ----------
    kind : {'particles', 'bodies', 'mesh', 'grid'}
        Points with fields; bodies also have the field `orientation`, unit quaternions
        (w, x, y, z), shape (n, 4); a mesh has triangles, edges or both, or tetrahedra, which
        stay the same in every frame; a grid has no points, but the cells of a box.
    fields : mapping of str to str
        Unit of every field besides the points, "1" if it has none. A field has one row per point,
        or of a grid one for each cell, in an array of shape (nx, ny[, nz], ...).
    triangles : array_like, shape (m, 3), optional
        Vertex indices of a mesh.
    edges : array_like, shape (m, 2), optional
        Vertex indices of a mesh.
    tetrahedra : array_like, shape (m, 4), optional
        Vertex indices of a mesh that has neither triangles nor edges, and always as many points.
    points : array_like, shape (n, 3), optional
        Positions of a mesh that never moves, an obstacle say [m]: they are written once, the part
        has no fields, and frames leave it out.
    bounds : array_like, shape (2, 3) or (2, 2), optional
        Lowest and highest corner of the box of a grid [m].
    cell : float, optional
        Side of its cells [m]; the box is a whole number of them long.
    shape_vertices : array_like, shape (m, 3), optional
        Of bodies, the vertices of all their shapes, each in the frame of its body [m];
        `body_shapes` gives the three arguments of shapes.
    shape_faces : array_like, shape (k, 3), optional
        Rows of `shape_vertices`, of triangles whose vertices are of one body.
    shape_bodies : array_like, shape (m, 1), optional
        Row of the body that each vertex belongs to.

    Raises
    ------
    InputError
        If the kind, a name or a unit is not valid, a mesh has no topology or other parts have one,
        indices are out of range, bodies have no orientation, or a grid has no box or no field.

    Examples
    --------
    >>> import substep
    >>> substep.Part("particles", fields={"velocity": "m/s"}).fields["velocity"]
    'm/s'
    """

    kind: str = "particles"
    fields: Mapping[str, str] = field(default_factory=dict)
    triangles: ArrayLike | None = None
    edges: ArrayLike | None = None
    tetrahedra: ArrayLike | None = None
    points: ArrayLike | None = None
    bounds: ArrayLike | None = None
    cell: float | None = None
    shape_vertices: ArrayLike | None = None
    shape_faces: ArrayLike | None = None
    shape_bodies: ArrayLike | None = None

    def __post_init__(self) -> None:
        kind = check_choice("kind", self.kind, KINDS)
        if not isinstance(self.fields, Mapping):
            raise TypeError(
                f"fields: expected a mapping of names to units, got {describe(self.fields)}"
            )
        fields = {
            check_name("fields", name): check_text(f"fields[{name!r}]", unit, 64)
            for name, unit in self.fields.items()
        }
        if kind == "bodies" and "orientation" not in fields:
            raise InputError("fields: bodies need the field 'orientation' with the unit '1'")
        constants = {name: _check_constant(name, getattr(self, name)) for name in CONSTANTS}
        self._check_shapes(constants)
        present = [n for n in (*TOPOLOGIES, "points") if constants[n] is not None]
        if (kind == "mesh") != (len(present) > 0) or present == ["points"]:
            raise InputError(
                "triangles, edges, tetrahedra: a mesh needs some of them, and other kinds have none"
            )
        if "tetrahedra" in present and ("triangles" in present or "edges" in present):
            raise InputError("tetrahedra: such a mesh has neither triangles nor edges")
        if "points" in present and fields:
            raise InputError("points: a mesh that never moves has no fields")
        object.__setattr__(self, "kind", kind)
        object.__setattr__(self, "fields", MappingProxyType(fields))
        for name, array in constants.items():
            object.__setattr__(self, name, array)
        self._check_grid()
        if "points" in present:
            check_indices("points", self, len(np.asarray(self.points)))

    def _check_shapes(self, constants: Mapping[str, NDArray[Any] | None]) -> None:
        vertices, faces, bodies = (constants[name] for name in SHAPES)
        if vertices is None and faces is None and bodies is None:
            return
        names = ", ".join(SHAPES)
        if self.kind != "bodies" or vertices is None or faces is None or bodies is None:
            raise InputError(f"{names}: bodies have all three or none, and other kinds have none")
        if len(bodies) != len(vertices):
            raise InputError(f"shape_bodies: expected {len(vertices)} rows, got {len(bodies)}")
        if faces.size and faces.max() >= len(vertices):
            raise InputError(f"shape_faces: need {faces.max() + 1} vertices, got {len(vertices)}")
        if np.any(bodies[faces, 0] != bodies[faces[:, :1], 0]):
            raise InputError("shape_faces: expected the vertices of each to be of one body")

    def _check_grid(self) -> None:
        given = [self.bounds is not None, self.cell is not None]
        if given != 2 * [self.kind == "grid"]:
            raise InputError("bounds, cell: a grid needs both, and other kinds have none")
        if self.bounds is None:
            return
        if not self.fields:
            raise InputError("fields: a grid needs one at least")
        cell = check_real("cell", self.cell, positive=True)
        bounds = np.array(check_box(self.bounds, cell)[0])
        bounds.flags.writeable = False
        object.__setattr__(self, "bounds", bounds)
        object.__setattr__(self, "cell", cell)

    @property
    def cells(self) -> tuple[int, ...]:
        """Of a grid along its axes; empty for other kinds."""
        if self.bounds is None or self.cell is None:
            return ()
        return check_box(self.bounds, self.cell)[1]

    @property
    def array_names(self) -> list[str]:
        """Names of its arrays in a frame."""
        return [*(["points"] if self.kind != "grid" else []), *self.fields]

    def constants(self) -> Constants:
        """What the part has once for all frames: topology, and points that never move.

        Returns
        -------
        dict of str to ndarray
            By name, in the order of the file; read-only.
        """
        arrays = {name: getattr(self, name) for name in CONSTANTS}
        return {name: array for name, array in arrays.items() if array is not None}

    @property
    def needed(self) -> int:
        """Rows that the points of every frame have at least, for topology or shapes to name."""
        named = (getattr(self, name) for name in (*TOPOLOGIES, "shape_bodies"))
        return max((int(np.max(a, initial=-1)) + 1 for a in named if a is not None), default=0)

    def shape_of(self, body: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Shape of a body, by its row.

        Parameters
        ----------
        body : int
            Row of the body.

        Returns
        -------
        tuple of ndarray
            Vertices in its frame, shape (m, 3) [m], and faces, shape (k, 3); of a body without a
            shape there are none.
        """
        if self.shape_vertices is None or self.shape_faces is None or self.shape_bodies is None:
            return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
        owners, faces = np.asarray(self.shape_bodies)[:, 0], np.asarray(self.shape_faces)
        mine = owners == body
        numbers = np.cumsum(mine) - 1
        return np.asarray(self.shape_vertices)[mine], numbers[faces[mine[faces[:, 0]]]]


def _check_constant(name: str, value: Any) -> NDArray[Any] | None:
    """An owned, read-only array of the form that the file has."""
    if value is None:
        return None
    dtype, columns = CONSTANTS[name]
    given = as_array(name, value)
    places = dtype == "<f8"
    if not places and given.dtype.kind not in "iu":
        raise InputError(f"{name}: expected integer indices")
    array = check_array(name, given, (None, columns), dtype=dtype)
    if not places and array.size and array.min() < 0:
        raise InputError(f"{name}: expected indices of at least 0, got {array.min()}")
    array.flags.writeable = False
    return array


def check_indices(where: str, part: Part, points: int) -> None:
    """The topology of a part names points that there are."""
    for name in (*TOPOLOGIES, "shape_bodies"):
        array = getattr(part, name)
        if array is not None and (largest := np.max(array, initial=-1)) >= points:
            raise InputError(f"{where}: {name} need {largest + 1} points, got {points}")


def check_parts(parts: Any) -> dict[str, Part]:
    """Parts under valid names."""
    if not isinstance(parts, Mapping):
        raise TypeError(f"parts: expected a mapping of names to Part, got {describe(parts)}")
    if not parts or len(parts) > 256:
        raise InputError(f"parts: expected 1 to 256 parts, got {len(parts)}")
    for name, part in parts.items():
        check_name("parts", name)
        if not isinstance(part, Part):
            raise TypeError(f"parts[{name!r}]: expected a Part, got {describe(part)}")
    if all(part.points is not None for part in parts.values()):
        raise InputError("parts: expected one that moves")
    if len({name.lower() for name in parts}) != len(parts):
        raise InputError("parts: two names differ in case only")
    return dict(parts)


def _plain(value: Any) -> Any:
    """NumPy scalars and arrays and paths as what JSON knows."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"cannot be written as JSON: {describe(value)}")


def check_parameters(parameters: Any) -> dict[str, Any]:
    """Parameters as JSON will give them back."""
    if parameters is None:
        return {}
    if not isinstance(parameters, Mapping) or not all(isinstance(k, str) for k in parameters):
        raise TypeError(
            f"parameters: expected a mapping with string keys, got {describe(parameters)}"
        )
    plain = {}
    for key, value in parameters.items():
        try:
            plain[key] = json.loads(json.dumps(value, default=_plain, allow_nan=False))
        except (TypeError, ValueError, RecursionError) as error:
            raise InputError(f"parameters[{key!r}]: {error}") from None
    return plain


def metadata_of(
    parts: Mapping[str, Part], scene: str, parameters: dict[str, Any], seed: int
) -> dict[str, Any]:
    """What a recording says of itself, as JSON."""
    from .. import __version__  # loads the core

    return {
        "substep": __version__,
        "scene": scene,
        "parameters": parameters,
        "seed": seed,
        "parts": [
            {
                "name": name,
                "kind": part.kind,
                "fields": [[field_name, unit] for field_name, unit in part.fields.items()],
                "triangles": None,
                **{constant: len(array) for constant, array in part.constants().items()},
                **(_box_of(part) if part.kind == "grid" else {}),
            }
            for name, part in parts.items()
        ],
    }


def _box_of(part: Part) -> dict[str, Any]:
    return {"bounds": np.asarray(part.bounds).tolist(), "cell": part.cell}


def check_keys(what: str, value: Any, names: Any) -> None:
    """Exactly these names."""
    if not isinstance(value, Mapping):
        raise TypeError(f"{what}: expected a mapping, got {describe(value)}")
    missing = [name for name in names if name not in value]
    unknown = [name for name in value if name not in names]
    if missing or unknown:
        raise InputError(f"{what}: missing {missing}, unknown {unknown}")


def _recorded_dtype(got: np.dtype[Any], points: bool) -> np.dtype[Any]:
    """The dtype that numbers of some dtype are recorded with."""
    if got.kind == "f":
        return np.dtype({2: "<f4", 4: "<f4"}.get(got.itemsize, "<f8"))
    return np.dtype("<f8") if points else got.newbyteorder("<")


def _rows_of_cells(what: str, values: Any, cells: tuple[int, ...]) -> Any:
    """A row for each cell, x fastest as VTK has them."""
    d = len(cells)
    if values.shape[:d] != cells:
        raise InputError(f"{what}: expected shape {cells}, got {values.shape}")
    return values.transpose(*range(d - 1, -1, -1), *range(d, values.ndim)).reshape(
        -1, *values.shape[d:]
    )


def as_cells(rows: NDArray[Any], cells: tuple[int, ...]) -> NDArray[Any]:
    """What `_rows_of_cells` was given."""
    d = len(cells)
    values = rows.reshape(*cells[::-1], *rows.shape[1:])
    return np.ascontiguousarray(values.transpose(*range(d - 1, -1, -1), *range(d, values.ndim)))


def check_values(
    what: str, value: Any, points: bool, known: Spec | None, cells: tuple[int, ...] = ()
) -> NDArray[Any]:
    """An array as it goes to the file: little-endian, contiguous, one row per point or cell."""
    try:
        raw = value if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
    except ValueError as error:
        if not isinstance(value, (list, tuple)):
            raise  # the value's own doing
        raise InputError(f"{what}: expected rows of equal length; {error}") from None
    if cells:
        raw = _rows_of_cells(what, raw, cells)
    got = _recorded_dtype(raw.dtype, points)
    target = np.dtype(known.dtype) if known else got
    array = check_array(what, raw, dtype=target, finite=points)
    if not np.can_cast(got, target, "safe"):
        raise InputError(f"{what}: expected {target} as in the first frame, got {got}")
    if (
        array.ndim < 1
        or array.ndim > 3
        or 0 in array.shape[1:]
        or max(array.shape[1:], default=1) > 64
    ):
        raise InputError(
            f"{what}: expected one row of at most 64 x 64 numbers per point or cell, "
            f"got shape {array.shape}"
        )
    if points and (array.ndim != 2 or array.shape[1] not in (2, 3)):
        raise InputError(f"{what}: expected shape (n, 2) or (n, 3), got {array.shape}")
    if known and array.shape[1:] != known.shape:
        raise InputError(
            f"{what}: expected rows of shape {known.shape} as in the first frame, got {array.shape}"
        )
    return array


def check_part(name: str, part: Part, arrays: list[NDArray[Any]], names: list[str]) -> None:
    """The arrays of a part fit each other."""
    count = len(arrays[0])
    for field_name, array in zip(names, arrays, strict=True):
        if len(array) != count:
            raise InputError(f"{name}/{field_name}: expected {count} rows, got {len(array)}")
        if part.kind == "bodies" and field_name == "orientation" and array.shape[1:] != (4,):
            raise InputError(f"{name}/orientation: expected shape (n, 4), got {array.shape}")
    check_indices(f"{name}/points", part, count)
