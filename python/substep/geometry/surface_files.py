"""Readers of .obj, .ply, .stl and .off.

Each gives the vertices, the numbers of corners of its polygons, and the corners of all, one after
the other. What is read is bounded by the bytes that there are, whatever a header counts.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import FormatError, TruncatedError


class Surface(NamedTuple):
    """Vertices, the number of corners of each polygon, and the vertices at the corners of all."""

    vertices: NDArray[Any]
    sizes: NDArray[np.int64]
    corners: NDArray[np.int64]


def _surface(path: Path, vertices: Any, sizes: Any, corners: Any) -> Surface:
    points = np.array(vertices, np.float64).reshape(-1, 3)
    whole = []
    for what, values in (("sizes of faces", sizes), ("corners", corners)):
        numbers = np.array(values)  # floats, where words were read as such
        if numbers.dtype == object or (numbers.size and not (np.abs(numbers) < 2.0**53).all()):
            raise FormatError(f"{path}: {what} beyond 2**53")
        if (numbers != np.trunc(numbers)).any():
            raise FormatError(f"{path}: {what} that are no whole numbers")
        whole.append(numbers.astype(np.int64))
    return Surface(points, whole[0], whole[1])


def _refuse(path: Path, number: int, line: str) -> NoReturn:
    raise FormatError(f"{path}:{number}: cannot read {line[:60].strip()!r}") from None


def read_obj(path: Path) -> Surface:
    """Lines `v x y z` and `f v/vt/vn ...`, numbered from 1, or from the end where negative."""
    points: list[list[float]] = []
    sizes: list[int] = []
    corners: list[int] = []
    with path.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, 1):
            try:
                if line.startswith("v "):
                    x, y, z = map(float, line.split()[1:4])
                    points.append([x, y, z])
                elif line.startswith("f "):
                    polygon = [int(word.split("/", 1)[0]) for word in line.split()[1:]]
                    if len(polygon) < 3 or 0 in polygon:
                        raise ValueError
                    sizes.append(len(polygon))
                    corners.extend(i - 1 if i > 0 else len(points) + i for i in polygon)
            except ValueError:
                _refuse(path, number, line)
    return _surface(path, points, sizes, corners)


def read_off(path: Path) -> Surface:
    """`OFF`, the numbers of vertices and faces, and a line for each; colours are left out.

    Format: Geomview Manual 1.9, "OFF", without its binary and N-dimensional kinds.
    """
    with path.open(encoding="utf-8", errors="replace") as lines:
        rows = [
            (number, line, words)
            for number, line in enumerate(lines, 1)
            if (words := line.split("#", 1)[0].split())
        ]
    if not rows or rows[0][2].pop(0) != "OFF":
        raise FormatError(f"{path}: does not begin with OFF")
    if not rows[0][2]:
        del rows[0]
    if not rows:
        raise TruncatedError(f"{path}: ends before its numbers of vertices and faces")
    number, line, words = rows.pop(0)
    points: list[list[float]] = []
    sizes: list[int] = []
    corners: list[int] = []
    try:
        vertices, faces = (int(word) for word in words[:2])
        if vertices < 0 or faces < 0:
            raise ValueError
        if vertices + faces > len(rows):
            raise TruncatedError(
                f"{path}: declares {vertices} vertices and {faces} faces in {len(rows)} lines"
            )
        for row in range(vertices + faces):
            number, line, words = rows[row]
            if row < vertices:
                x, y, z = map(float, words[:3])
                points.append([x, y, z])
            else:
                size = int(words[0])
                if not 0 < size < len(words):
                    raise ValueError
                sizes.append(size)
                corners.extend(map(int, words[1 : 1 + size]))
    except FormatError:
        raise
    except ValueError:
        _refuse(path, number, line)
    return _surface(path, points, sizes, corners)


def read_stl(path: Path) -> Surface:
    """Triangles, binary or as text; corners that agree exactly are joined.

    Format: 3D Systems, "StereoLithography Interface Specification" (1989).
    """
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    if data[:5] == b"solid" and len(data) != 84 + 50 * count:
        points: Any = []
        for number, line in enumerate(data.decode(errors="replace").splitlines(), 1):
            words = line.split()
            if words and words[0].lower() == "vertex":
                try:
                    x, y, z = map(float, words[1:])
                except ValueError:
                    _refuse(path, number, line)
                points.append([x, y, z])
        if len(points) % 3:
            raise TruncatedError(f"{path}: {len(points)} corners are no triangles")
    else:
        if len(data) < 84 + 50 * count:
            raise TruncatedError(
                f"{path}: declares {count} triangles, and ends at byte {len(data)}"
            )
        rows = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        points = np.frombuffer(data, rows, count, 84)["corners"] if count else []
    with np.errstate(invalid="ignore"):  # NaN is refused by the mesh
        corners = np.array(points, np.float64).reshape(-1, 3)
    vertices, indices = np.unique(corners, axis=0, return_inverse=True)
    return _surface(path, vertices, np.full(len(corners) // 3, 3), indices.ravel())


# ---------------------------------------------------------------------------------------------- ply

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8", "int64": "i8", "uint64": "u8",
}  # fmt: skip
_WIDEST = 64  # numbers in rows that are read all at once
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


class _Element(NamedTuple):
    """Rows of properties; a list has the dtype of its length besides that of its entries."""

    name: str
    number: int
    properties: list[tuple[str, str, str | None]]


def read_ply(path: Path) -> Surface:
    """Elements `vertex` and `face`, as text or binary; others are read over.

    Format: Turk, "The PLY Polygon File Format" (1994).
    """
    data = path.read_bytes()
    end = data.find(b"end_header")
    begin = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or begin == 0:
        raise FormatError(
            f"{path}: the header of a .ply file begins with ply, ends with end_header"
        )
    order, elements = _ply_header(path, data[:end].decode(errors="replace").splitlines())
    rows = _Words(path, data[begin:]) if order == "" else _Bytes(path, data, begin, order)
    columns = {element.name: _ply_element(path, rows, element) for element in elements}
    vertex, face = columns.get("vertex", {}), columns.get("face", {})
    if not all(isinstance(vertex.get(axis), np.ndarray) for axis in "xyz"):
        raise FormatError(f"{path}: its vertices have no x, y and z")
    listed = face.get("vertex_indices", face.get("vertex_index"))
    sizes, corners = listed if isinstance(listed, tuple) else ([], [])
    with np.errstate(invalid="ignore"):  # NaN is refused by the mesh
        points = np.column_stack([vertex[axis].astype(np.float64) for axis in "xyz"])
    return _surface(path, points, sizes, corners)


def _ply_header(path: Path, lines: list[str]) -> tuple[str, list[_Element]]:
    order = None
    elements: list[_Element] = []
    for number, line in enumerate(lines, 1):
        words = line.split()
        try:
            match words:
                case [] | ["ply"] | ["comment" | "obj_info", *_]:
                    pass
                case ["format", kind, "1.0"]:
                    order = _FORMATS[kind]
                case ["element", name, count]:
                    if int(count) < 0 or any(element.name == name for element in elements):
                        raise ValueError
                    elements.append(_Element(name, int(count), []))
                case ["property", "list", length, entry, name]:
                    elements[-1].properties.append((name, _TYPES[entry], _TYPES[length]))
                case ["property", kind, name]:
                    elements[-1].properties.append((name, _TYPES[kind], None))
                case _:
                    raise ValueError
        except (KeyError, IndexError, ValueError):
            _refuse(path, number, line)
    if order is None:
        raise FormatError(f"{path}: the header names no format")
    return order, elements


class _Words:
    """The body of a text file, word by word."""

    def __init__(self, path: Path, body: bytes) -> None:
        self.path, self._words, self.at = path, body.split(), 0

    def take(self, count: int, dtype: str) -> NDArray[Any]:
        """The next `count` numbers."""
        if not 0 <= count <= len(self._words) - self.at:
            raise TruncatedError(f"{self.path}: declares {count} numbers that it has not")
        words = self._words[self.at : self.at + count]
        self.at += count
        try:
            return np.array([float(word) if dtype[0] == "f" else int(word) for word in words])
        except (ValueError, OverflowError) as error:
            raise FormatError(f"{self.path}: {error}") from None

    def rows(self, count: int, dtypes: list[str]) -> list[NDArray[Any]]:
        """The next `count` rows of single numbers, column by column."""
        return list(self.take(count * len(dtypes), "f8").reshape(count, len(dtypes)).T)


class _Bytes:
    """The body of a binary file."""

    def __init__(self, path: Path, data: bytes, begin: int, order: str) -> None:
        self.path, self._data, self.at, self._order = path, data, begin, order

    def take(self, count: int, dtype: str) -> NDArray[Any]:
        """The next `count` numbers."""
        return self._records(count, np.dtype(self._order + dtype))

    def rows(self, count: int, dtypes: list[str]) -> list[NDArray[Any]]:
        """The next `count` rows of single numbers, column by column."""
        kind = np.dtype([(f"f{k}", self._order + dtype) for k, dtype in enumerate(dtypes)])
        records = self._records(count, kind)
        return [records[name] for name in kind.names or ()]

    def _records(self, count: int, dtype: np.dtype[Any]) -> NDArray[Any]:
        if not 0 <= count * dtype.itemsize <= len(self._data) - self.at:
            raise TruncatedError(
                f"{self.path}: declares {count} rows of {dtype.itemsize} bytes at byte {self.at} "
                f"of {len(self._data)}"
            )
        records = np.frombuffer(self._data, dtype, count, self.at) if count else np.empty(0, dtype)
        self.at += records.nbytes
        return records


def _ply_element(path: Path, rows: _Words | _Bytes, element: _Element) -> dict[str, Any]:
    """The columns of an element by name; of a list its lengths and all entries, as a pair."""
    names = [name for name, _, _ in element.properties]
    if not names or len(set(names)) != len(names):
        raise FormatError(f"{path}: element {element.name} has a property twice, or none")
    if any(length for _, _, length in element.properties):
        return _equal_rows(rows, element) or _unequal_rows(rows, element)
    dtypes = [dtype for _, dtype, _ in element.properties]
    return dict(zip(names, rows.rows(element.number, dtypes), strict=True))


def _equal_rows(rows: _Words | _Bytes, element: _Element) -> dict[str, Any]:
    """The columns of an element whose lists are as long in every row as in the first; else none."""
    start, sizes = rows.at, []
    found: dict[str, Any] = {}
    try:
        for _, dtype, length in element.properties:
            sizes.append(1 if length is None else int(rows.take(1, length)[0]))
            rows.take(sizes[-1], dtype)
        rows.at = start
        dtypes: list[str] = []
        for (_, dtype, length), size in zip(element.properties, sizes, strict=True):
            dtypes += ([] if length is None else [length]) + [dtype] * min(size, _WIDEST)
        columns = iter(rows.rows(element.number, dtypes) if len(dtypes) <= _WIDEST else [])
        for (name, _, length), size in zip(element.properties, sizes, strict=True):
            lengths = next(columns)
            found[name] = lengths
            if length is not None:
                entries = [next(columns) for _ in range(size)]
                if not (lengths == size).all():
                    raise FormatError(name)
                found[name] = lengths, np.array(entries).T.ravel()
    except (FormatError, StopIteration):  # what is wrong is found again, row by row
        rows.at = start
        return {}
    return found


def _unequal_rows(rows: _Words | _Bytes, element: _Element) -> dict[str, Any]:
    sizes: dict[str, list[int]] = {name: [] for name, _, _ in element.properties}
    parts: dict[str, list[NDArray[Any]]] = {name: [] for name in sizes}
    for _ in range(element.number):  # every row takes a word or byte at least
        for name, dtype, length in element.properties:
            size = 1 if length is None else int(rows.take(1, length)[0])
            sizes[name].append(size)
            parts[name].append(rows.take(size, dtype))
    whole = {name: np.concatenate([np.empty(0, np.int64), *parts[name]]) for name in parts}
    return {
        name: whole[name] if length is None else (sizes[name], whole[name])
        for name, _, length in element.properties
    }
