"""Packed recordings: temporal VTKHDF, for ParaView and VTK, with what substep needs beside it.

One part is the root PolyData; several are blocks of a MultiBlockDataSet. The latter's root gets a
`Steps` group too, which the format does not ask for: without it vtkHDFReader (VTK 9.7.2) forgets in
its second pass that the file has more than one step, and shows the first one for ever.
The group /substep beside /VTKHDF holds metadata, and a CRC-32 for every array of every frame.
Layout: docs/recording.md; format: https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format.
"""

from __future__ import annotations

import contextlib
import math
import os
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from ._frames import (
    DTYPES,
    FORMAT_VERSION,
    Source,
    Spec,
    arrays_per_frame,
    dump_json,
    frame_names,
    load_json,
    read_checked,
)
from .errors import CorruptError, FormatError, TruncatedError, VersionError

SIGNATURE = b"\x89HDF\r\n\x1a\n"
TOPOLOGIES = ("Vertices", "Lines", "Polygons", "Strips")
CHUNK_BYTES = 1 << 19
LARGEST_CHUNK = 1 << 26
ALLOWED_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
# Deflate shrinks no more than this: https://zlib.net/zlib_tech.html, Maximum Compression Factor.
DEFLATE_LIMIT = 1032


def stored_shape(spec: Spec, dimension: int) -> tuple[int, ...]:
    """Shape of a row in the file: in a plane, vectors get a third component; matrices go flat."""
    if spec.shape == (2,) and dimension == 2:
        return (3,)
    return (math.prod(spec.shape),) if len(spec.shape) == 2 else spec.shape


def stored_dtype(spec: Spec) -> str:
    """VTK has no booleans."""
    return "|u1" if spec.dtype == "|b1" else spec.dtype


# ---------------------------------------------------------------------------------------- writing


def write(source: Source, path: str) -> None:
    """Write all frames of a recording into a new file."""
    parts = source.metadata["parts"]
    with h5py.File(path, "x", libver=("v108", "v110"), locking=False) as file:
        root = file.create_group("VTKHDF", track_order=True)
        root.attrs["Version"] = (2, 2)
        if len(parts) == 1:
            _write_part(root, source, parts[0])
        else:
            _set_type(root, "MultiBlockDataSet")
            _write_times(root.create_group("Steps"), source)
            for part in parts:
                group = root.create_group(part["name"])
                group.attrs["Version"] = (2, 2)
                _write_part(group, source, part)
            assembly = root.create_group("Assembly", track_order=True)
            for part in parts:
                assembly[part["name"]] = h5py.SoftLink(f"/VTKHDF/{part['name']}")
        _write_substep(file.create_group("substep"), source)


def _set_type(group: h5py.Group, name: str) -> None:
    group.attrs.create("Type", name.encode(), dtype=h5py.string_dtype("ascii", len(name)))


def _create(
    group: h5py.Group, name: str, shape: tuple[int, ...], dtype: str, *, gzip: bool = False
) -> h5py.Dataset:
    row_bytes = max(1, np.dtype(dtype).itemsize * math.prod(shape[1:]))
    rows = max(1, min(shape[0], CHUNK_BYTES // row_bytes))
    filters = {"shuffle": True, "compression": "gzip", "compression_opts": 1} if gzip else {}
    return group.create_dataset(
        name,
        shape,
        dtype,
        chunks=(rows, *shape[1:]),
        maxshape=(None, *shape[1:]),
        fletcher32=True,
        **filters,
    )


def _store(group: h5py.Group, name: str, data: Any, dtype: str, *, gzip: bool = False) -> None:
    values = np.asarray(data, dtype)
    dataset = _create(group, name, values.shape, dtype, gzip=gzip)
    if values.size:
        dataset[...] = values


def _write_times(steps: h5py.Group, source: Source) -> None:
    steps.attrs["NSteps"] = np.int64(len(source.times))
    _store(steps, "Values", source.times, "<f8")


def _arrays_of(source: Source, part: dict[str, Any]) -> list[int]:
    return [k for k, spec in enumerate(source.specs) if spec.part == part["name"]]


def _write_part(group: h5py.Group, source: Source, part: dict[str, Any]) -> None:
    """A temporal PolyData: the points of all frames in one dataset, and offsets for each frame."""
    _set_type(group, "PolyData")
    arrays = _arrays_of(source, part)
    frames = len(source.times)
    counts = np.array([source.counts[i][arrays[0]] for i in range(frames)], "i8")
    offsets = np.cumsum(counts) - counts
    units = dict(part["fields"])
    steps = group.create_group("Steps")
    _write_times(steps, source)
    if frames == 0:  # VTK then shows one empty step
        _create(group, "Points", (0, 3), "<f4")
        counts = np.zeros(1, "i8")
    _store(group, "NumberOfPoints", counts, "<i8")
    _write_cells(group, counts, _triangles_of(source, part))
    _store(steps, "PointOffsets", offsets, "<i8")
    _store(steps, "NumberOfParts", np.ones(frames), "<i8")
    _store(steps, "PartOffsets", np.arange(frames), "<i8")
    _store(steps, "CellOffsets", np.zeros((frames, len(TOPOLOGIES))), "<i8")
    _store(steps, "ConnectivityIdOffsets", np.zeros((frames, len(TOPOLOGIES))), "<i8")
    for k in arrays:
        spec = source.specs[k]
        name = "Points" if spec.name == "points" else f"PointData/{spec.name}"
        shape = stored_shape(spec, source.specs[arrays[0]].shape[0])
        dataset = _create(group, name, (int(counts.sum()), *shape), stored_dtype(spec))
        dataset.attrs["units"] = units.get(spec.name, "m")
        if spec.name != "points":
            _store(steps, f"PointDataOffsets/{spec.name}", offsets, "<i8")
        for i in range(frames):
            data = read_checked(source, i, k)
            if len(data):
                rows = np.zeros((len(data), *shape), stored_dtype(spec))
                width = math.prod(spec.shape)
                rows.reshape(len(data), -1)[:, :width] = data.reshape(len(data), width)
                dataset[offsets[i] : offsets[i] + counts[i]] = rows


def _triangles_of(source: Source, part: dict[str, Any]) -> NDArray[Any] | None:
    meshes = [p["name"] for p in source.metadata["parts"] if p["triangles"] is not None]
    return source.triangles[meshes.index(part["name"])] if part["name"] in meshes else None


def _write_cells(group: h5py.Group, counts: NDArray[Any], triangles: NDArray[Any] | None) -> None:
    """A vertex cell per point, or the triangles; every frame uses the same list from its start."""
    for topology in TOPOLOGIES:
        cells = group.create_group(topology)
        if topology == "Vertices" and triangles is None:
            number, width, connectivity = counts, 1, np.arange(counts.max(initial=0))
        elif topology == "Polygons" and triangles is not None:
            number, width = np.full(len(counts), len(triangles)), 3
            connectivity = triangles.ravel()
        else:
            number, width, connectivity = np.zeros(len(counts)), 1, np.zeros(0)
        _store(cells, "NumberOfCells", number, "<i8")
        _store(cells, "NumberOfConnectivityIds", number * width, "<i8")
        _store(cells, "Connectivity", connectivity, "<i8", gzip=True)
        offsets = np.arange(0, len(connectivity) + 1, width)
        _store(cells, "Offsets", offsets, "<i8", gzip=True)


def _write_substep(group: h5py.Group, source: Source) -> None:
    """Metadata under its checksum, and as attributes for people who look with other tools."""
    meta = source.metadata
    shape = (len(source.times), arrays_per_frame(meta))
    _store(group, "crc32", np.reshape(source.crcs, shape), "<u4")
    _store(group, "counts", np.reshape(source.counts, shape), "<i8")
    packed = {
        **meta,
        "frames": len(source.times),
        "arrays": [[s.part, s.name, s.dtype, list(s.shape)] for s in source.specs],
        "index_crc32": _index_crc(source),
        "triangles_crc32": [zlib.crc32(t.tobytes()) for t in source.triangles],
    }
    text = dump_json(packed)
    _store(
        group, "metadata", np.frombuffer(text + struct.pack("<I", zlib.crc32(text)), "u1"), "|u1"
    )
    group.attrs["format_version"] = np.int64(FORMAT_VERSION)
    group.attrs["substep_version"] = meta["substep"]
    group.attrs["scene"] = meta["scene"]
    group.attrs["parameters"] = dump_json(meta["parameters"]).decode()
    group.attrs["seed"] = np.uint64(meta["seed"])


def _index_crc(source: Source) -> int:
    crc = zlib.crc32(np.array(source.times, "<f8").tobytes())
    crc = zlib.crc32(np.array(source.counts, "<i8").tobytes(), crc)
    return zlib.crc32(np.array(source.crcs, "<u4").tobytes(), crc)


# ---------------------------------------------------------------------------------------- reading


@contextlib.contextmanager
def _damage_to_errors(path: str) -> Iterator[None]:
    """What h5py raises on a damaged file becomes CorruptError."""
    try:
        yield
    except (FormatError, MemoryError):
        raise
    except (
        OSError,
        RuntimeError,
        KeyError,
        ValueError,
        TypeError,
        AttributeError,
        IndexError,
    ) as e:
        text = str(e).splitlines()[0] if str(e) else type(e).__name__
        raise CorruptError(f"{path}: {text}") from None


class Packed:
    """The frames of a packed recording; the attributes are those of `Source`.

    Only what `write` makes is read: hard links, chunked or contiguous data within the file, gzip,
    shuffle and Fletcher-32 filters. Sizes are compared with the file before anything is allocated.
    """

    def __init__(self, path: str, max_bytes: int) -> None:
        self.path = path
        self._max_bytes = max_bytes
        self.problem: FormatError | None = None
        self.size = os.path.getsize(path)
        self._check_superblock()
        with _damage_to_errors(path):
            self._file = h5py.File(path, "r", locking=False)
        try:
            with _damage_to_errors(path):
                self._read_index()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file."""
        with contextlib.suppress(RuntimeError, OSError):
            self._file.close()

    def _check_superblock(self) -> None:
        """The length in superblocks 2 and 3 (HDF5 File Format Specification 3.0, II.A)."""
        with open(self.path, "rb") as file:
            head = file.read(48)
        if len(head) < 48:
            raise TruncatedError(
                f"{self.path}: the file ends at byte {len(head)}", offset=len(head)
            )
        end = struct.unpack_from("<Q", head, 28)[0]
        if head[8] in (2, 3) and head[9] == 8 and end > self.size:
            raise TruncatedError(
                f"{self.path}: the file ends at byte {self.size} of {end}", offset=self.size
            )

    def _dataset(
        self, name: str, dtype: str, columns: tuple[int, ...], rows: int | None = None
    ) -> h5py.Dataset:
        """A dataset that is safe to read, with the dtype and the shape it must have."""
        where = f"{self.path}: {name}"
        node: Any = self._file
        for step in name.split("/"):
            link = node.get(step, getlink=True)
            if not isinstance(link, h5py.HardLink):
                raise CorruptError(f"{where}: only hard links are followed")
            node = node[step]
        if not isinstance(node, h5py.Dataset):
            raise CorruptError(f"{where}: not a dataset")
        _check_storage(node, where, self.size)
        found, wanted = node.dtype, np.dtype(dtype)
        if found != wanted:
            if found.kind == wanted.kind:
                raise VersionError(f"{where}: stored as {found.str}, expected {wanted.str}")
            raise CorruptError(f"{where}: stored as {found.str}, expected {wanted.str}")
        if node.shape[1:] != columns or rows not in (None, node.shape[0]):
            raise CorruptError(f"{where}: its shape is {node.shape}")
        return node

    def _load(
        self, name: str, dtype: str, columns: tuple[int, ...], rows: int | None = None
    ) -> NDArray[Any]:
        """A whole dataset."""
        dataset = self._dataset(name, dtype, columns, rows)
        if dataset.size * dataset.dtype.itemsize > self._max_bytes:
            raise FormatError(f"{self.path}: {name}: larger than max_bytes, {self._max_bytes}")
        return dataset[...]

    def _read_index(self) -> None:
        name = "substep/metadata"
        if "substep" not in self._file:
            raise CorruptError(f"{self.path}: an HDF5 file, but not a recording of substep")
        self._check_version()
        raw = self._load(name, "|u1", ()).tobytes()
        if len(raw) < 4 or zlib.crc32(raw[:-4]) != struct.unpack("<I", raw[-4:])[0]:
            raise CorruptError(f"{self.path}: the checksum of the metadata differs")
        self.metadata = load_json(raw[:-4], self.path)
        self.specs = [Spec(p, n, d, tuple(s)) for p, n, d, s in self.metadata["arrays"]]
        self._check_specs()
        frames, arrays = self.metadata["frames"], arrays_per_frame(self.metadata)
        prefix = self._prefix(self.metadata["parts"][0]["name"])
        times = self._load(f"{prefix}/Steps/Values", "<f8", (), frames)
        counts = self._load("substep/counts", "<i8", (arrays,), frames)
        crcs = self._load("substep/crc32", "<u4", (arrays,), frames)
        self.times: list[float] = times.tolist()
        self.counts: list[tuple[int, ...]] = [tuple(row) for row in counts.tolist()]
        self.crcs: list[tuple[int, ...]] = [tuple(row) for row in crcs.tolist()]
        if _index_crc(self) != self.metadata["index_crc32"]:
            raise CorruptError(f"{self.path}: the checksum of the index differs")
        self._offsets = (np.cumsum(counts, axis=0) - counts).tolist()
        self._rows = counts.sum(axis=0).tolist() if frames else [0] * arrays
        self._datasets: dict[int, h5py.Dataset] = {}
        self._read_triangles()

    def _check_version(self) -> None:
        version = self._file["substep"].attrs["format_version"]
        if int(version) != FORMAT_VERSION:
            raise VersionError(
                f"{self.path}: format version {version}; this substep reads {FORMAT_VERSION}"
            )

    def _check_specs(self) -> None:
        wanted = [(p["name"], n) for p in self.metadata["parts"] for n in frame_names(p)]
        if self.specs and [(s.part, s.name) for s in self.specs] != wanted:
            raise CorruptError(f"{self.path}: the arrays are not those of the parts")
        for spec in self.specs:
            if spec.dtype not in DTYPES or len(spec.shape) > 2 or min(spec.shape, default=1) < 1:
                raise CorruptError(f"{self.path}: {spec.part}/{spec.name}: unknown kind of array")

    def _prefix(self, part: str) -> str:
        return "VTKHDF" if len(self.metadata["parts"]) == 1 else f"VTKHDF/{part}"

    def _read_triangles(self) -> None:
        self.triangles: list[NDArray[Any]] = []
        crcs = iter(self.metadata["triangles_crc32"])
        for part in self.metadata["parts"]:
            if part["triangles"] is not None:
                name = f"{self._prefix(part['name'])}/Polygons/Connectivity"
                data = self._load(name, "<i8", (), 3 * part["triangles"]).reshape(-1, 3)
                if zlib.crc32(data.tobytes()) != next(crcs):
                    raise CorruptError(f"{self.path}: {name}: the checksum differs")
                self.triangles.append(data)

    def forget(self, frames: int) -> None:
        """Keep the first `frames` frames only."""
        for column in (self.times, self.counts, self.crcs):
            del column[frames:]  # type: ignore[attr-defined]

    def read(self, index: int, array: int) -> NDArray[Any]:
        """One array of one frame, unchecked."""
        spec = self.specs[array]
        with _damage_to_errors(self.path):
            if array not in self._datasets:
                dimension = next(s.shape[0] for s in self.specs if s.part == spec.part)
                leaf = "Points" if spec.name == "points" else f"PointData/{spec.name}"
                self._datasets[array] = self._dataset(
                    f"{self._prefix(spec.part)}/{leaf}",
                    stored_dtype(spec),
                    stored_shape(spec, dimension),
                    self._rows[array],
                )
            start, count = self._offsets[index][array], self.counts[index][array]
            width = math.prod(spec.shape)
            rows = self._datasets[array][start : start + count]
            flat = rows.reshape(count, math.prod(rows.shape[1:]))[:, :width]
            return np.ascontiguousarray(flat).view(spec.dtype).reshape(count, *spec.shape)


def _check_storage(dataset: h5py.Dataset, where: str, file_size: int) -> None:
    """Refuse data elsewhere, foreign filters, and more data than the file can hold."""
    if dataset.id.get_type().get_class() not in (h5py.h5t.INTEGER, h5py.h5t.FLOAT):
        raise CorruptError(f"{where}: not an array of numbers")
    if dataset.external or dataset.is_virtual:
        raise CorruptError(f"{where}: data in another file are refused")
    properties = dataset.id.get_create_plist()
    filters = {properties.get_filter(k)[0] for k in range(properties.get_nfilters())}
    if not filters <= ALLOWED_FILTERS:
        raise CorruptError(f"{where}: filter {min(filters - ALLOWED_FILTERS)} is refused")
    if dataset.shape is None or len(dataset.shape) < 1:
        raise CorruptError(f"{where}: not an array of rows")
    declared = dataset.dtype.itemsize * math.prod(dataset.shape)
    stored = dataset.id.get_storage_size()
    limit = stored * (DEFLATE_LIMIT if h5py.h5z.FILTER_DEFLATE in filters else 1)
    if stored > file_size or declared > limit:
        raise CorruptError(f"{where}: declares {declared} bytes, the file holds {stored}")
    if dataset.chunks is not None:
        if dataset.dtype.itemsize * math.prod(dataset.chunks) > LARGEST_CHUNK:
            raise CorruptError(f"{where}: its chunks are larger than {LARGEST_CHUNK} bytes")
        wanted = math.prod(-(-n // c) for n, c in zip(dataset.shape, dataset.chunks, strict=True))
        if declared and dataset.id.get_num_chunks() != wanted:
            raise CorruptError(f"{where}: chunks are missing")
