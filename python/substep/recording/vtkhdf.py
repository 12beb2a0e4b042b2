"""Packed recordings: temporal VTKHDF, for ParaView and VTK, with what substep needs beside it.

One part is the root data set; several are blocks of a MultiBlockDataSet. The latter's root gets a
`Steps` group too, which the format does not ask for: without it vtkHDFReader (VTK 9.7.2) forgets in
its second pass that the file has more than one step, and shows the first one for ever.
The group /substep beside /VTKHDF holds metadata, and a CRC-32 for every array of every frame.
`packed.py` reads it back. Layout: docs/recording.md; format: https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from .frames import (
    CONSTANTS,
    FORMAT_VERSION,
    Constants,
    Source,
    Spec,
    arrays_per_frame,
    cells_of,
    dump_json,
    read_checked,
)

TOPOLOGIES = ("Vertices", "Lines", "Polygons", "Strips")
TETRAHEDRON = 10  # VTK_TETRA
# Where the constant arrays of a part are found in its group.
PLACES = {
    "triangles": "Polygons/Connectivity",
    "edges": "Lines/Connectivity",
    "tetrahedra": "Connectivity",
    "points": "Points",
    "shape_vertices": "Shapes/Vertices",  # which VTK does not look at
    "shape_faces": "Shapes/Faces",
    "shape_bodies": "Shapes/Bodies",
}
CHUNK_BYTES = 1 << 19


def stored_shape(spec: Spec, dimension: int) -> tuple[int, ...]:
    """Shape of a row in the file: in a plane, vectors get a third component; matrices go flat."""
    if spec.shape == (2,) and dimension == 2:
        return (3,)
    return (math.prod(spec.shape),) if len(spec.shape) == 2 else spec.shape


def grid_shape(frames: int, cells: tuple[int, ...], row: tuple[int, ...]) -> tuple[int, ...]:
    """Shape of an array of a grid in the file; a single frame has no axis for the time."""
    return (*([frames] if frames != 1 else []), *cells[::-1], *row)


def stored_dtype(spec: Spec) -> str:
    """VTK has no booleans."""
    return "|u1" if spec.dtype == "|b1" else spec.dtype


def write(source: Source, path: str) -> None:
    """Write all frames of a recording into a new file."""
    parts = source.metadata["parts"]
    with h5py.File(path, "x", libver=("v108", "v110"), locking=False) as file:
        root = file.create_group("VTKHDF", track_order=True)
        root.attrs["Version"] = (2, 2)
        if len(parts) == 1:
            _write_any(root, source, parts[0])
        else:
            _set_type(root, "MultiBlockDataSet")
            _write_times(root.create_group("Steps"), source)
            for part in parts:
                group = root.create_group(part["name"])
                group.attrs["Version"] = (2, 2)
                _write_any(group, source, part)
            assembly = root.create_group("Assembly", track_order=True)
            for part in parts:
                assembly[part["name"]] = h5py.SoftLink(f"/VTKHDF/{part['name']}")
        _write_substep(file.create_group("substep"), source)


def _set_type(group: h5py.Group, name: str) -> None:
    group.attrs.create("Type", name.encode(), dtype=h5py.string_dtype("ascii", len(name)))


def _create(
    group: h5py.Group, name: str, shape: tuple[int, ...], dtype: str, *, gzip: bool = False
) -> h5py.Dataset:
    chunks, room = list(shape), CHUNK_BYTES // np.dtype(dtype).itemsize
    for a in range(len(shape) - 1, -1, -1):
        chunks[a] = max(1, min(shape[a], room))
        room //= chunks[a]
    filters = {"shuffle": True, "compression": "gzip", "compression_opts": 1} if gzip else {}
    return group.create_dataset(
        name,
        shape,
        dtype,
        chunks=tuple(chunks),
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


def _write_any(group: h5py.Group, source: Source, part: dict[str, Any]) -> None:
    cells = cells_of(part)
    if cells is None:
        _write_part(group, source, part)
    else:
        _write_grid(group, source, part, cells)


def _write_grid(
    group: h5py.Group, source: Source, part: dict[str, Any], cells: tuple[int, ...]
) -> None:
    """A temporal ImageData: the cells of all frames in one array, x last and so fastest.

    A grid of a plane is an image without thickness, whose arrays have no axis for z.
    """
    _set_type(group, "ImageData")
    frames = len(source.times)
    extent = [end for n in (*cells, 0)[:3] for end in (0, n)] if frames else [0, -1] * 3
    group.attrs["WholeExtent"] = np.array(extent, "i8")
    group.attrs["Origin"] = np.array([*part["bounds"][0], 0.0][:3])
    group.attrs["Spacing"] = np.full(3, float(part["cell"]))
    group.attrs["Direction"] = np.eye(3).ravel()
    steps = group.create_group("Steps")
    _write_times(steps, source)
    for k in _arrays_of(source, part):
        spec = source.specs[k]
        row, dtype = stored_shape(spec, len(cells)), stored_dtype(spec)
        shape = grid_shape(frames, cells, row)
        dataset = _create(group, f"CellData/{spec.name}", shape, dtype, gzip=True)
        dataset.attrs["units"] = dict(part["fields"])[spec.name]
        _store(steps, f"CellDataOffsets/{spec.name}", np.arange(frames), "<i8")
        for i in range(frames):
            rows = _stored(read_checked(source, i, k), row).view(dtype)
            dataset[i if frames != 1 else ...] = rows.reshape(*cells[::-1], *row)


def _write_part(group: h5py.Group, source: Source, part: dict[str, Any]) -> None:
    """A temporal data set: the points of all frames in one array, and offsets for each frame.

    Points that are constant are there once: they begin at row 0 in every frame.
    """
    arrays = _arrays_of(source, part)
    constants = source.constants[source.metadata["parts"].index(part)]
    frames = len(source.times)
    if static := "points" in constants:
        counts = np.full(frames, len(constants["points"]), "i8")
    else:
        counts = np.array([source.counts[i][arrays[0]] for i in range(frames)], "i8")
    offsets = np.zeros(frames) if static else np.cumsum(counts) - counts
    units = dict(part["fields"])
    steps = group.create_group("Steps")
    _write_times(steps, source)
    for name, array in constants.items():
        if name.startswith("shape_"):
            _store(group, PLACES[name], array, CONSTANTS[name][0])
    if static:
        _store(group, "Points", constants["points"], "<f8")
        group["Points"].attrs["units"] = "m"
    if frames == 0:  # VTK then shows one empty step
        if not static:
            _create(group, "Points", (0, 3), "<f4")
        counts = np.zeros(1, "i8")
    if "tetrahedra" in constants:
        topologies, part_offsets = 1, np.zeros(frames, int)
        _write_tetrahedra(group, counts, constants["tetrahedra"])
    else:
        topologies, part_offsets = len(TOPOLOGIES), np.arange(frames)
        _write_cells(group, counts, constants)
    _store(steps, "PointOffsets", offsets, "<i8")
    _store(steps, "NumberOfParts", np.ones(frames), "<i8")
    _store(steps, "PartOffsets", part_offsets, "<i8")
    _store(steps, "CellOffsets", np.zeros((frames, topologies)), "<i8")
    _store(steps, "ConnectivityIdOffsets", np.zeros((frames, topologies)), "<i8")
    for k in arrays:
        spec = source.specs[k]
        name = "Points" if spec.name == "points" else f"PointData/{spec.name}"
        shape = stored_shape(spec, source.specs[arrays[0]].shape[0])
        dataset = _create(group, name, (int(counts.sum()), *shape), stored_dtype(spec))
        dataset.attrs["units"] = units.get(spec.name, "m")
        if spec.name != "points":
            _store(steps, f"PointDataOffsets/{spec.name}", offsets, "<i8")
        start = 0
        for block in _blocks(source, k):
            dataset[start : start + len(block)] = _stored(block, shape).view(stored_dtype(spec))
            start += len(block)


def _stored(block: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Rows of an array as rows of the file."""
    if block.shape[1:] == shape:
        return block
    rows = np.zeros((len(block), *shape), block.dtype)
    width = math.prod(block.shape[1:])
    rows.reshape(len(block), -1)[:, :width] = block.reshape(len(block), width)
    return rows


def _blocks(source: Source, array: int) -> Iterator[NDArray[Any]]:
    """One array of all frames, several at a time where they are small."""
    waiting: list[NDArray[Any]] = []
    size = 0
    for i in range(len(source.times)):
        data = read_checked(source, i, array)
        if len(data):
            waiting.append(data)
            size += data.nbytes
        if size >= CHUNK_BYTES:
            yield waiting[0] if len(waiting) == 1 else np.concatenate(waiting)
            waiting, size = [], 0
    if waiting:
        yield np.concatenate(waiting)


def _write_tetrahedra(group: h5py.Group, counts: NDArray[Any], tetrahedra: NDArray[Any]) -> None:
    """An UnstructuredGrid, as PolyData has no solid cells, of one piece that all frames use.

    A piece has one number of points, so they cannot change theirs. (With a piece for each frame,
    vtkHDFReader would look for its own list of cells, too.)
    """
    _set_type(group, "UnstructuredGrid")
    number = len(tetrahedra)
    _store(group, "NumberOfPoints", counts[:1], "<i8")
    _store(group, "NumberOfCells", [number], "<i8")
    _store(group, "NumberOfConnectivityIds", [4 * number], "<i8")
    _store(group, "Connectivity", tetrahedra.ravel(), "<i8", gzip=True)
    _store(group, "Offsets", np.arange(0, 4 * number + 1, 4), "<i8", gzip=True)
    _store(group, "Types", np.full(number, TETRAHEDRON), "|u1", gzip=True)


def _write_cells(group: h5py.Group, counts: NDArray[Any], constants: Constants) -> None:
    """A PolyData: a vertex cell per point, or the mesh; every frame uses the same list."""
    _set_type(group, "PolyData")
    _store(group, "NumberOfPoints", counts, "<i8")
    meshes = {"Lines": constants.get("edges"), "Polygons": constants.get("triangles")}
    for topology in TOPOLOGIES:
        cells = group.create_group(topology)
        mesh = meshes.get(topology)
        if topology == "Vertices" and not ("edges" in constants or "triangles" in constants):
            number, width, connectivity = counts, 1, np.arange(counts.max(initial=0))
        elif mesh is not None:
            number, width = np.full(len(counts), len(mesh)), mesh.shape[1]
            connectivity = mesh.ravel()
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
        "index_crc32": index_crc(source),
        "constants_crc32": [zlib.crc32(a.tobytes()) for c in source.constants for a in c.values()],
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


def index_crc(source: Source) -> int:
    """Checksum of the times, counts and checksums of all frames."""
    crc = zlib.crc32(np.array(source.times, "<f8").tobytes())
    crc = zlib.crc32(np.array(source.counts, "<i8").tobytes(), crc)
    return zlib.crc32(np.array(source.crcs, "<u4").tobytes(), crc)
