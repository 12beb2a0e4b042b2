"""Attacks every reader of files with mutated ones: `formats.py COUNT SEED [FORMAT ...]`.

A case is a seed file that was built here, with bits, lengths, counts, words or whole stretches
changed; where the format has checksums, they are made to agree again in two of three cases. Cases
run one after the other in a forked process with 2 GiB of memory more than it has, and 1 s of
processor time each. Right is what is read, or refused by FormatError or OSError (InputError where
it says which argument would help). Prints one line of JSON: for each format how many cases came out
how, and the first findings with the numbers that make them again.
"""

from __future__ import annotations

import collections
import faulthandler
import io
import itertools
import json
import math
import os
import random
import resource
import select
import signal
import struct
import sys
import tempfile
import time
import traceback
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import substep
from runner import SANITIZED
from substep.base.checkpoint import read_checkpoint, write_checkpoint
from substep.export import pack_here
from substep.recording.frames import FILE_HEADER, FRAME_HEADER, TABLE
from substep.scenes.run_config import read_config

SECONDS = 5.0 if SANITIZED else 1.0  # of processor time, for a case
MEMORY = 2 << 30
STUCK = 60  # seconds without a sign: such a process is killed
NUMBERS = [0, 1, 2, 3, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62, 2**63 - 1]
WORDS = (
    "-1 0 1 2 3 1e9 1e308 1e999 -inf nan 4294967296 9223372036854775808 99999999999999999999999 "
    "0x10 x 1.5 -0 1_0 ' \" [ ] { } <a> &b; \0 # $ \\"
).split(" ")


class Format(NamedTuple):
    """The name of such a file, how it is read, examples, and how often it is tried."""

    name: str
    read: Callable[[str], Any]
    seeds: Callable[[], list[bytes]]
    craft: Callable[[random.Random], bytes] | None = None  # another example, of wild content
    mend: Callable[[bytes], bytes] | None = None
    weight: float = 1.0


# ---------------------------------------------------------------------------------------- reading


def read_field(path: str) -> None:
    field = substep.open_field(path, memory_limit=1 << 28)
    lower, upper = field.bounds
    for time_ in {float(field.times[0]), float(field.times[-1])}:
        field(time_, [(lower + upper) / 2])


def read_mesh(path: str) -> None:
    mesh = substep.geometry.read_mesh(path)
    assert np.isfinite(mesh.vertices).all()


def read_recording(path: str) -> None:
    for recover in (False, True):
        try:
            with substep.Recording(path, recover=recover, max_bytes=1 << 28) as recording:
                for _, frame in recording:
                    assert frame.keys() == recording.parts.keys()
                    for name, part in recording.parts.items():
                        for array in part.constants().values():
                            if array.dtype.kind == "i":
                                assert array.max(initial=-1) < len(frame[name]["points"])
        except substep.FormatError:
            if recover:
                raise


def read_state(path: str) -> None:
    read_checkpoint(path, "Toy")


def read_scene(path: str) -> None:
    config = read_config(path)
    substep.scenes.load("double-gyre").check(config.parameters, lambda key: f"parameters: {key}")
    for key in config.parameters:
        config.where(key, "parameters")


# ------------------------------------------------------------------------------------ example files


def netcdf(
    version: int, dims: list[Any], variables: list[Any], records: int = 0, streaming: bool = False
) -> bytes:
    """A classic file: dims are (name, length), variables (name, dims, attributes, type, data)."""
    out = io.BytesIO()
    write = out.write

    def integer(n: int) -> None:
        write(struct.pack(">I", n))

    def number(n: int) -> None:
        write(struct.pack(">Q" if version == 5 else ">I", n))

    def text(s: str) -> None:
        number(len(s))
        write(s.encode() + b"\0" * (-len(s) % 4))

    write(b"CDF" + bytes([version]))
    number((2**64 if version == 5 else 2**32) - 1 if streaming else records)
    integer(10)
    number(len(dims))
    for name, length in dims:
        text(name)
        number(length)
    integer(0)
    number(0)
    integer(11)
    number(len(variables))
    places = []
    for name, numbers, attributes, kind, data in variables:
        text(name)
        number(len(numbers))
        for k in numbers:
            number(k)
        integer(12 if attributes else 0)
        number(len(attributes))
        for key, value in attributes:
            text(key)
            if isinstance(value, str):
                integer(2)
                text(value)
            else:
                integer(6)
                number(len(value))
                write(np.asarray(value, ">f8").tobytes())
        integer(kind)
        number(0)
        places.append((out.tell(), data))
        write(bytes(4 if version == 1 else 8))
    begins = []
    for place, data in places:
        begins.append((place, out.tell()))
        write(data)
    file = bytearray(out.getvalue())
    for place, begin in begins:
        struct.pack_into(">I" if version == 1 else ">Q", file, place, begin)
    return bytes(file)


NODES = np.arange(4.0).astype(">f8").tobytes()
LAT = ("lat", [0], [("units", "degrees_north")], 6, NODES)
LON = ("lon", [1], [("units", "degrees_east")], 6, NODES)


def netcdf_seeds() -> list[bytes]:
    flat = [(name, [0, 1], [("units", "m s-1")], 6, NODES * 4) for name in "uv"]
    packed = [("scale_factor", [0.5]), ("add_offset", [1.0]), ("_FillValue", [3.0])]
    limits = [("valid_range", [-5.0, 5.0]), ("missing_value", [1.0, 2.0]), ("units", "cm/s")]
    small = np.arange(32).astype(">i2").tobytes()
    since = [("units", "hours since 1990-06-01 12:00:00"), ("calendar", "standard")]
    level = [
        ("time", [2], since, 6, NODES[:16]),
        *((name, [2, 0, 1], packed + limits, 3, small) for name in "uv"),
    ]
    time_ = ("time", [2], since, 6, NODES[8:16])
    record = [time_, *((name, [2, 0, 1], limits, 6, NODES * 4) for name in "uv")]
    dims = [("lat", 4), ("lon", 4)]
    bent = np.add.outer(np.arange(4.0), np.arange(4.0) ** 2 / 9)
    around = [
        (name, [0, 1], [("units", "degrees")], 6, x.astype(">f8").tobytes())
        for name, x in (("nav_lon", bent.T), ("nav_lat", bent))
    ]
    corners = [
        (name, [0, 1], [], 6, x.astype(">f8").tobytes())
        for name, x in (("glamf", bent.T + 0.5), ("gphif", bent + 0.5))
    ]
    return [
        *(netcdf(1, [("y", 4), ("x", 4)], [*around, *more, *flat]) for more in ([], corners)),
        *(netcdf(version, dims, [LAT, LON, *flat]) for version in (1, 2, 5)),
        netcdf(2, [*dims, ("time", 2)], [LAT, LON, *level]),
        netcdf(1, [*dims, ("time", 0)], [LAT, LON, *record], records=1),
        netcdf(5, [*dims, ("time", 0)], [LAT, LON, *record], streaming=True),
    ]


def wild(rng: random.Random, key: str) -> Any:
    """A value for an attribute, as it should be or not."""
    usual = {"units": "m/s", "_FillValue": [3.0], "valid_range": [0.0, 9.0], "scale_factor": [2.0]}
    texts = ("", "m/s", "degrees_east", "degrees_north", "days since 2000-01-01", "x" * 5000)
    texts += ("days since 999999-99-99", "days since 2000-01-01 " + "9" * 400 + ":0", "1", "nan")
    numbers = ([], [0.0], [float("nan")], [float("inf")], [1e300, -1e300], [1e-300] * 3)
    return rng.choice((usual.get(key, "1"), rng.choice(texts), list(rng.choice(numbers))))


KEYS = ("units", "_FillValue", "valid_range", "valid_min", "scale_factor", "add_offset", "axis")
KEYS += ("missing_value", "standard_name", "calendar", "positive", "UNITS", "odd")


def craft_netcdf(rng: random.Random) -> bytes:
    """Dimensions, types and attributes that do not go together."""
    odd = (0, 0, 1, 2, 3, 2**20, 2**31, 2**40, 2**63)
    sizes = [rng.choice(odd) if rng.random() < 0.15 else 4 for _ in range(4)]
    names = rng.sample(("lat", "lon", "time", "depth", "x", "y", "lat"), 4)
    if rng.random() < 0.7:
        names[:2], sizes[:2] = ["lat", "lon"], [4, 4]
    version = rng.choice((1, 2, 5))
    dims = [(n, s if version == 5 else s % 2**32) for n, s in zip(names, sizes, strict=True)]

    def attributes() -> list[Any]:
        keys = rng.sample(KEYS, rng.choice((0, 0, 0, 1, 2)))
        return [(key, wild(rng, key)) for key in keys]

    variables = []
    for k, name in enumerate(names):
        of = [k] if rng.random() < 0.97 else rng.choices(range(4), k=rng.randrange(3))
        units = {"lat": "degrees_north", "lon": "degrees_east", "time": "hours since 1990-06-01"}
        own = [("units", units.get(name, "m"))] if rng.random() < 0.9 else []
        kind = 6 if rng.random() < 0.9 else rng.choice((1, 3, 5))
        variables.append((name, of, own + attributes(), kind, NODES))
    of = rng.choice(([0, 1], [0, 1], [1, 0], [2, 0, 1], [2, 3, 0, 1], [0, 0], [3, 2, 1]))
    kind = rng.choice((6, 6, 3, 1, 2, 10))
    data = NODES * rng.choice((64, 64, 4, 1))
    variables += [(name, of, attributes(), kind, data) for name in "uvw"[: rng.choice((2, 2, 3))]]
    records = rng.choice((0, 1, 1, 2, 2**31, 2**32 - 2))
    return netcdf(version, dims, variables, records, streaming=rng.random() < 0.2)


def craft_hdf5(rng: random.Random) -> bytes:
    """Shapes, chunks, types and attributes of HDF5 that do not go together."""
    out = io.BytesIO()
    with h5py.File(out, "w", libver=rng.choice(("earliest", "latest"))) as file:
        size = rng.choice((4, 4, 4, 4, 1, 2**20, 2**40))
        kinds = ("f8", "f4", "i2", "u8", "f2", "S4", "?", h5py.string_dtype(), "V3", ">i4")
        for name in ("lat", "lon", "u", "v"):
            n = size if rng.random() < 0.95 else 3
            shape = {"lat": (n,), "lon": (4,)}.get(name, (n, 4))
            shape = shape if rng.random() < 0.97 else ()
            kind = rng.choice(kinds) if rng.random() < 0.1 else "f8"
            chunks = rng.choice((None, True, tuple(min(m, 2**18) for m in shape)))
            options: dict[str, Any] = {"chunks": chunks} if shape and n > 4 else {}
            if options and chunks:
                options["compression"] = rng.choice((None, "gzip", "lzf"))
            elif n > 4:
                options["chunks"] = (4,) * len(shape) or None
            data = file.create_dataset(name, shape, kind, **options)
            if kind == "f8" and n <= 4:
                data[...] = np.arange(float(data.size)).reshape(shape)
            units = {"lat": "degrees_north", "lon": "degrees_east"}.get(name, "m/s")
            data.attrs["units"] = units
            for key in rng.sample(KEYS, rng.choice((0, 0, 0, 1, 2))):
                value = wild(rng, key)
                other = (np.arange(3), h5py.Empty("f4"), [b"a", b"b"], ["a", "b"], file.ref, True)
                data.attrs[key] = value if rng.random() < 0.6 else rng.choice(other)
            if shape:
                for d, axis in enumerate(("lat", "lon")[: len(shape)]):
                    if name in ("u", "v") and isinstance(file.get(axis), h5py.Dataset):
                        data.dims[d].attach_scale(file[axis])
                if name in ("lat", "lon") and rng.random() < 0.9:
                    data.make_scale(name)
    return out.getvalue()


def craft_npz(rng: random.Random) -> bytes:
    """Arrays whose headers claim what they are not."""
    out = io.BytesIO()
    shapes = (
        (3,),
        (),
        (0,),
        (2**62,),
        (-1,),
        (3, 1),
        (1,) * 40,
        (2**63, 0),
        (2, 3, 3, 2),
        (3, 3, 2),
    )
    with zipfile.ZipFile(out, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as file:
        for name, shape in (("x", (3,)), ("y", (3,)), ("values", (3, 3, 2)), ("times", (2,))):
            if name == "times" and rng.random() < 0.7:
                continue
            size = 8 * math.prod(shape)
            shape = rng.choice(shapes) if rng.random() < 0.15 else shape
            kinds = (">f4", "|b1", "|O", "<U3", "<M8[s]", "|V0", "<c16")
            kind = rng.choice(kinds) if rng.random() < 0.15 else "<f8"
            head = (
                f"{{'descr': '{kind}', 'fortran_order': {rng.random() < 0.3}, 'shape': {shape}, }}"
            )
            if rng.random() < 0.1:
                head = rng.choice(
                    ("(" * 5000, "{}", "[", "{'descr': 1}", "'" * 9999, "1e9999", head * 2)
                )
            text = head.encode() + b"\n"
            magic = b"\x93NUMPY" + rng.choice((b"\1\0", b"\1\0", b"\1\0", b"\2\0", b"\3\0"))
            length = struct.pack("<H" if magic[6] == 1 else "<I", len(text))
            size = size if rng.random() < 0.9 else rng.choice((0, 1, 24, 144))
            body = np.arange(18.0).tobytes()[:size]
            file.writestr(f"{name}.npy", magic + length + text + body)
    return out.getvalue()


def hdf5(version: str, **options: Any) -> bytes:
    """A NetCDF-4 file; that of "earliest" has no checksums."""
    out = io.BytesIO()
    with h5py.File(out, "w", libver=version) as file:
        axes = (("time", 2, "hours since 1990-06-01"), ("lat", 3, "degrees_north"))
        for name, n, units in (*axes, ("lon", 4, "degrees_east")):
            file[name] = np.arange(float(n))
            file[name].attrs["units"] = units
            file[name].make_scale(name)
        for name in "uv":
            data = file.create_dataset(name, data=np.ones((2, 3, 4), "f4"), **options)
            data.attrs["units"] = "m/s"
            data.attrs["_FillValue"] = np.float32(-1)
            for d, axis in enumerate(("time", "lat", "lon")):
                data.dims[d].attach_scale(file[axis])
    return out.getvalue()


def hdf5_seeds() -> list[bytes]:
    gzip = {"chunks": (1, 2, 4), "compression": "gzip", "shuffle": True, "fletcher32": True}
    return [
        hdf5("earliest"),
        hdf5("earliest", **gzip),
        hdf5("earliest", chunks=(1, 2, 2), maxshape=(None, 3, 4)),
        hdf5("latest", **gzip),
    ]


def npz(compress: bool, **arrays: Any) -> bytes:
    out = io.BytesIO()
    (np.savez_compressed if compress else np.savez)(out, **arrays)
    return out.getvalue()


def npz_seeds() -> list[bytes]:
    axis, values = np.arange(3.0), np.ones((2, 3, 3, 2), "f4")
    return [
        npz(False, x=axis, y=axis, values=values, times=[0, 1]),
        npz(True, lon=axis, lat=axis, values=np.asfortranarray(values[0])),
    ]


def mend_npz(data: bytes) -> bytes:
    """The checksums of an archive as its content has them, where it is one still."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = []
            for entry in archive.infolist():
                with archive.open(entry) as file:
                    file._expected_crc = None
                    members.append((entry.filename, entry.compress_type, file.read()))
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w") as archive:
            for name, kind, content in members:
                archive.writestr(zipfile.ZipInfo(name), content, compress_type=kind)
        return out.getvalue()
    except Exception:
        return data


POINTS = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
FACES = "3 0 1 2\n3 0 1 3\n3 0 2 3\n3 1 2 3\n"
CORNERS = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])
TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def ply_seeds() -> list[bytes]:
    head = (
        "ply\nformat {} 1.0\ncomment a\nelement vertex 4\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar red\nelement face {}\nproperty list uchar int "
        "vertex_indices\nelement edge 1\nproperty int a\nend_header\n"
    )
    colours = POINTS.replace("\n", " 7\n")
    seeds = [(head.format("ascii", 4) + colours + FACES + "5\n").encode()]
    seeds += [(head.format("ascii", 2) + colours + "4 0 1 2 3\n3 0 1 2\n5\n").encode()]
    for kind, order in (("little", "<"), ("big", ">")):
        points = b"".join(struct.pack(order + "fffB", *p, 7) for p in TETRAHEDRON)
        faces = b"".join(struct.pack(order + "Biii", 3, *map(int, c)) for c in CORNERS)
        name = f"binary_{kind}_endian"
        seeds.append(head.format(name, 4).encode() + points + faces + bytes(4))
        quad = struct.pack(order + "Biiii", 4, 0, 1, 2, 3)
        seeds.append(head.format(name, 2).encode() + points + quad + faces[:13] + bytes(4))
    return seeds


def stl_seeds() -> list[bytes]:
    record = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    rows = np.zeros(4, record)
    rows["corners"] = TETRAHEDRON[CORNERS]
    facets = "".join(
        "facet normal 0 0 1\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in TETRAHEDRON[corners])
        + "endloop\nendfacet\n"
        for corners in CORNERS
    )
    text = f"solid a\n{facets}endsolid a\n"
    return [bytes(80) + struct.pack("<I", 4) + rows.tobytes(), text.encode()]


def off_seeds() -> list[bytes]:
    return [
        f"OFF\n# a\n4 4 6\n{POINTS}{FACES}".encode(),
        f"OFF 4 1 0\n{POINTS}4 0 1 2 3 7 7 7".encode(),
    ]


def obj_seeds() -> list[bytes]:
    text = "# a\no b\nv 0 0 0\nv 1 0 0\nv 0 1 0 1\nv 0 0 1\nvt 0 0\nvn 0 0 1\n"
    return [(text + "f 1/1/1 2/1/1 3/1/1\nf -4//1 -2//1 -1//1\nf 1 2 3 4\n").encode()]


def vtk_seeds() -> list[bytes]:
    cells = f"CELLS 4 16\n{FACES}CELL_TYPES 4\n5\n5\n5\n5\n"
    head = "# vtk DataFile Version 4.2\na\nASCII\nDATASET "
    points = f"UNSTRUCTURED_GRID\nPOINTS 4 double\n{POINTS}"
    grid = "STRUCTURED_POINTS\nDIMENSIONS 2 2 1\nORIGIN 0 0 0\nSPACING 1 1 1\n"
    return [(head + points + cells).encode(), (head + grid).encode()]


def vtu_seeds() -> list[bytes]:
    def array(kind: str, name: str, words: str, more: str = "") -> str:
        return f'<DataArray type="{kind}" Name="{name}" format="ascii"{more}>{words}</DataArray>\n'

    corners = " ".join(map(str, CORNERS.ravel()))
    return [
        (
            '<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="0.1" '
            'byte_order="LittleEndian">\n<UnstructuredGrid>\n'
            '<Piece NumberOfPoints="4" NumberOfCells="4">\n<Points>\n'
            + array("Float64", "Points", POINTS, ' NumberOfComponents="3"')
            + "</Points>\n<Cells>\n"
            + array("Int32", "connectivity", corners)
            + array("Int32", "offsets", "3 6 9 12")
            + array("Int32", "types", "5 5 5 5")
            + "</Cells>\n</Piece>\n</UnstructuredGrid>\n</VTKFile>\n"
        ).encode()
    ]


def msh_seeds() -> list[bytes]:
    lines = [line for line in POINTS.splitlines()]
    nodes = "".join(f"{i} {line}\n" for i, line in enumerate(lines, 1))
    old = f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n{nodes}$EndNodes\n"
    new = f"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 4 1 4\n2 1 0 4\n1\n2\n3\n4\n{POINTS}"
    return [
        (old + "$Elements\n2\n1 2 2 0 1 1 2 3\n2 4 2 0 1 1 2 3 4\n$EndElements\n").encode(),
        (new + "$EndNodes\n$Elements\n1 1 1 1\n2 1 2 1\n1 1 2 3\n$EndElements\n").encode(),
    ]


def medit_seeds() -> list[bytes]:
    points, faces = POINTS.replace("\n", " 0\n"), "1 2 3 0\n1 2 4 0\n"
    head = "MeshVersionFormatted 2\nDimension 3\nVertices\n4\n"
    return [f"{head}{points}Triangles\n2\n{faces}End\n".encode()]


def recordings() -> tuple[bytes, bytes]:
    """A journal, and the same packed."""
    parts = {
        "dust": substep.Part("particles", {"velocity": "m/s", "lit": "1"}),
        "sheet": substep.Part("mesh", {}, [[0, 1, 2], [0, 2, 3]]),
        "block": substep.Part("mesh", {}, tetrahedra=[[0, 1, 2, 3]]),
        "floor": substep.Part("mesh", {}, [[0, 1, 2]], points=TETRAHEDRON),
    }
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "a.vtkhdf")
        recorder = substep.Recorder(path, parts=parts, scene="a", parameters={"b": 1})
        for k in range(3):
            dust = {"points": np.ones((3 + k, 2)), "velocity": np.ones((3 + k, 2))}
            dust["lit"] = np.arange(3 + k) > 1
            mesh = {"points": TETRAHEDRON}
            recorder.append(k, {"dust": dust, "sheet": mesh, "block": mesh})
        recorder._release()
        journal = Path(path + ".journal").read_bytes()
        pack_here(path, None, False)
        return journal, Path(path).read_bytes()


def packed_seeds() -> list[bytes]:
    """As written, and as an earlier HDF5 has it, without checksums of its own structures."""
    packed = recordings()[1]
    out = io.BytesIO()
    with h5py.File(io.BytesIO(packed)) as new, h5py.File(out, "w", libver="earliest") as old:
        for name in new:
            new.copy(name, old, expand_soft=False)
    return [packed, out.getvalue()]


def mend_journal(data: bytes) -> bytes:
    """The checksums of a journal as its content has them, where it has the lengths for it."""
    file = bytearray(data)
    if len(file) < FILE_HEADER.size:
        return data
    _, _, _, text, blob, _, _ = FILE_HEADER.unpack_from(file)
    at = FILE_HEADER.size + text + blob
    if at <= len(file):
        body = file[FILE_HEADER.size : at]
        struct.pack_into("<I", file, FILE_HEADER.size - 8, zlib.crc32(body))
    struct.pack_into("<I", file, FILE_HEADER.size - 4, zlib.crc32(file[: FILE_HEADER.size - 4]))
    while at + FRAME_HEADER.size <= len(file):
        _, arrays, index, time_, payload, _, _ = FRAME_HEADER.unpack_from(file, at)
        rows, end = at + FRAME_HEADER.size, at + FRAME_HEADER.size + TABLE.itemsize * arrays
        if end + payload > len(file) or arrays > 100:
            break
        table = np.frombuffer(bytes(file[rows:end]), TABLE).copy()
        start = end
        for row in table:
            size = int(row["count"]) * max(1, int(row["shape"].prod(where=row["shape"] > 0)))
            with_width = [w for w in (1, 2, 4, 8) if row["dtype"].endswith(b"%d" % w)]
            size *= with_width[0] if with_width else 1
            seed = zlib.crc32(struct.pack("<Qd", index, time_))
            row["crc32"] = zlib.crc32(file[start : min(start + size, len(file))], seed)
            start += size
        file[rows:end] = table.tobytes()
        struct.pack_into("<I", file, rows - 8, zlib.crc32(file[rows:end]))
        struct.pack_into("<I", file, rows - 4, zlib.crc32(file[at : rows - 4]))
        at = end + payload
    return bytes(file)


def checkpoint_seeds() -> list[bytes]:
    state = {
        "x": np.ones((4, 3)),
        "ids": np.arange(4),
        "pinned": np.array([True, False]),
        "none": np.empty((0, 3), "f4"),
        "time": 0.5,
        "step": 3,
        "words": '["a", "b"]',
    }
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "a")
        write_checkpoint(path, "Toy", state)
        return [Path(path).read_bytes()]


def mend_checkpoint(data: bytes) -> bytes:
    """Its lengths and its checksum as the content has them."""
    if len(data) < 32:
        return data
    header = min(struct.unpack_from("<Q", data, 16)[0], len(data) - 32)
    middle = struct.pack("<QQ", header, len(data) - 32 - header)
    crc = zlib.crc32(data[32:], zlib.crc32(middle))
    return data[:12] + struct.pack("<I", crc) + middle + data[32:]


def scene_seeds() -> list[bytes]:
    text = (
        'scene = "double-gyre"\nframes = 5\nfps = 2.5\nout = "a/b"\nthreads = 1\nseed = 3\n\n'
        "[parameters]\nduration = 1e1\nparticles = 100\n"
    )
    nested = 'nested = {a = [1, 2], "b.c" = 1979-05-27}\n'  # no such parameter
    return [text.encode(), text.replace("duration", nested + "duration").encode()]


HDF5, MESHIO = 1 / 5, 1 / 400  # these are read in a process of their own
FORMATS = [
    Format("classic.nc", read_field, netcdf_seeds, craft_netcdf, weight=2),
    Format("hdf5.nc", read_field, hdf5_seeds, craft_hdf5, weight=HDF5),
    Format("field.npz", read_field, npz_seeds, craft_npz, mend_npz),
    Format("mesh.ply", read_mesh, ply_seeds, weight=MESHIO),
    Format("mesh.stl", read_mesh, stl_seeds, weight=MESHIO),
    Format("mesh.off", read_mesh, off_seeds, weight=MESHIO),
    Format("mesh.obj", read_mesh, obj_seeds),
    Format("mesh.vtk", read_mesh, vtk_seeds, weight=MESHIO),
    Format("mesh.vtu", read_mesh, vtu_seeds, weight=MESHIO),
    Format("mesh.msh", read_mesh, msh_seeds, weight=MESHIO),
    Format("mesh.mesh", read_mesh, medit_seeds, weight=MESHIO),
    Format("run.journal", read_recording, lambda: [recordings()[0]], mend=mend_journal),
    Format("run.vtkhdf", read_recording, packed_seeds, weight=HDF5),
    Format("state.checkpoint", read_state, checkpoint_seeds, mend=mend_checkpoint),
    Format("scene.toml", read_scene, scene_seeds),
]


# ---------------------------------------------------------------------------------------- mutations


def flip(data: bytearray, rng: random.Random, other: bytes) -> None:
    for _ in range(rng.choice((1, 1, 2, 8))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def poke(data: bytearray, rng: random.Random, other: bytes) -> None:
    """A number of 1, 2, 4 or 8 bytes somewhere."""
    width = rng.choice((1, 2, 4, 4, 8, 8))
    at = rng.randrange(len(data))
    at -= rng.choice((0, at % 4))
    value = rng.choice(NUMBERS) + rng.choice((0, 0, 0, -1, 1)) * rng.randrange(3)
    value = rng.choice((value, -value)) % 256**width
    data[at : at + width] = value.to_bytes(width, rng.choice(("little", "big")))


def poke_float(data: bytearray, rng: random.Random, other: bytes) -> None:
    kind = rng.choice(("<d", ">d", "<f", ">f"))
    value = rng.choice((0.0, -1.0, 1e30, -1e30, 1e-40, float("nan"), float("inf")))
    at = rng.randrange(len(data)) // 4 * 4
    data[at : at + struct.calcsize(kind)] = struct.pack(kind, value)


def cut(data: bytearray, rng: random.Random, other: bytes) -> None:
    del data[rng.randrange(len(data)) :]


def remove(data: bytearray, rng: random.Random, other: bytes) -> None:
    at = rng.randrange(len(data))
    del data[at : at + rng.choice((1, 2, 4, 8, 50))]


def repeat(data: bytearray, rng: random.Random, other: bytes) -> None:
    at = rng.randrange(len(data))
    data[at:at] = data[at : at + rng.choice((1, 4, 8, 50, 500))] * rng.choice((1, 1, 2, 20))


def splice(data: bytearray, rng: random.Random, other: bytes) -> None:
    """A stretch of another example, of the same place or not."""
    at, length = rng.randrange(len(other)), rng.choice((4, 8, 40, 400))
    to = rng.choice((at, rng.randrange(len(data))))
    data[to : to + length] = other[at : at + length]


def word(data: bytearray, rng: random.Random, other: bytes) -> None:
    """A word or number of a text becomes another."""
    parts = [m.strip(b"\n") for m in bytes(data).split(b" ")]
    if len(parts) < 3:
        return poke(data, rng, other)
    text = bytes(data)
    places = [i for i, c in enumerate(text) if c in b" \n=/,\"'<>[]{}:"]
    k = rng.randrange(len(places))
    end = places[k + 1] if k + 1 < len(places) else len(text)
    new = rng.choice((rng.choice(WORDS), str(rng.choice(NUMBERS)), str(-rng.choice(NUMBERS))))
    data[places[k] + 1 : end] = new.encode() * rng.choice((1, 1, 1, 1, 30))
    return None


def lines(data: bytearray, rng: random.Random, other: bytes) -> None:
    """Lines of a text go, come twice, or change places."""
    rows = bytes(data).split(b"\n")
    i, j = rng.randrange(len(rows)), rng.randrange(len(rows))
    rows[i], rows[j] = rng.choice(((rows[j], rows[i]), (rows[j], rows[j]), (b"", rows[j])))
    data[:] = b"\n".join(rows)


BINARY = (flip, flip, poke, poke, poke, poke_float, cut, remove, repeat, splice)
TEXT = (word, word, word, word, lines, *BINARY)


def examples(format_: Format) -> list[bytes]:
    if format_.name not in _examples:
        _examples[format_.name] = format_.seeds()
    return _examples[format_.name]


_examples: dict[str, list[bytes]] = {}


def case(seed: int, number: int, formats: list[Format]) -> tuple[Format, bytes]:
    """One mutated file: the same for the same numbers."""
    rng = random.Random(f"{seed}/{number}")
    format_ = rng.choices(formats, [f.weight for f in formats])[0]
    seeds = examples(format_)
    if format_.craft is not None and rng.random() < 0.3:
        return format_, format_.craft(rng)
    data = bytearray(rng.choice(seeds))
    textual = data.isascii() or rng.random() < 0.3
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 6))):
        if data:
            rng.choice(TEXT if textual else BINARY)(data, rng, rng.choice(seeds))
    if format_.mend is not None and rng.random() < 0.7:
        return format_, format_.mend(bytes(data))
    return format_, bytes(data)


def cases(seed: int, names: list[str] | None = None) -> Iterator[tuple[str, Any, bytes]]:
    """Without end: the name of a file, what reads it, and its bytes."""
    formats = [f for f in FORMATS if not names or f.name in names]
    for number in itertools.count():
        format_, data = case(seed, number, formats)
        yield format_.name, format_.read, data


# ------------------------------------------------------------------------------------------ running


class Slow(BaseException):
    """More than `SECONDS` of processor time."""


def outcome(name: str, read: Callable[[str], Any], path: str) -> tuple[str, str]:
    """What came of a file, and the words of the exception where it is a wrong one."""

    def ring(*_: Any) -> None:
        raise Slow

    signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read(path)
        return "read", ""
    except substep.FormatError as error:
        signal.setitimer(signal.ITIMER_PROF, 0)
        right = os.path.basename(path) in str(error) and len(str(error)) < 3000
        return ("refused", "") if right else ("refused without the file", str(error))
    except OSError:
        return "OSError", ""
    except substep.InputError as error:
        text = str(error)
        if (name.endswith((".nc", ".npz")) and text.startswith("variables:")) or ".toml" in name:
            return "refused", ""
        return "InputError", text
    except Slow:
        return "slow", ""
    except BaseException as error:
        return type(error).__name__, str(error)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


RIGHT = ("read", "refused", "OSError")


def run(
    files: Callable[[int], tuple[str, Any, bytes]], count: int, seconds: float = math.inf
) -> list[tuple[str, str, str]]:
    """(name, outcome, words) of all files, which a forked process reads until one ends it."""
    done: list[tuple[str, str, str]] = []
    end = time.monotonic() + seconds
    while len(done) < count and time.monotonic() < end:
        reader, writer = os.pipe()
        stack = tempfile.TemporaryFile()  # where the child was when it ended
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of forking with threads
            child = os.fork()
        if child == 0:
            os.close(reader)
            faulthandler.enable(stack)
            _run_here(files, range(len(done), count), writer)
        os.close(writer)
        last, rest, stuck = None, b"", False
        while True:
            stuck = not select.select([reader], [], [], STUCK)[0]
            if stuck or not (block := os.read(reader, 1 << 16)):
                break
            *told, rest = (rest + block).split(b"\n")
            for message in map(json.loads, told):
                last = message[0] if len(message) == 1 else None
                if len(message) == 2:
                    raise RuntimeError(message[1])  # of the attack itself
                if len(message) == 3:
                    done.append(tuple(message))
            if time.monotonic() > end and last is None:
                break
        os.close(reader)
        os.kill(child, signal.SIGABRT if stuck else signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        if last is not None:
            stack.seek(0)
            words = f"status {status} {stack.read().decode()}"
            done.append((last, "hangs" if stuck else "ends the process", words))
        stack.close()
    return done


def _run_here(files: Callable[[int], tuple[str, Any, bytes]], numbers: range, writer: int) -> None:
    """Report the name of every file before it is read, and then what came of it."""
    with open("/proc/self/statm") as statm:
        memory = int(statm.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (memory + MEMORY, memory + MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    try:
        with tempfile.TemporaryDirectory() as folder:
            for number in numbers:
                name, read, data = files(number)
                path = os.path.join(folder, name)
                Path(path).write_bytes(data)
                os.write(writer, json.dumps([name]).encode() + b"\n")
                result = (name, *outcome(name, read, path))
                os.write(writer, json.dumps([text[:300] for text in result]).encode() + b"\n")
    except BaseException:
        os.write(writer, json.dumps(["attack", traceback.format_exc()]).encode() + b"\n")
    finally:
        os._exit(0)


def attack(
    count: int, seed: int, names: list[str] | None = None, seconds: float = math.inf
) -> dict[str, Any]:
    """Outcomes by format of up to `count` cases, and findings with the numbers that make them."""
    formats = [f for f in FORMATS if not names or f.name in names]
    for format_ in formats:
        examples(format_)

    def files(number: int) -> tuple[str, Any, bytes]:
        format_, data = case(seed, number, formats)
        return format_.name, format_.read, data

    begun = time.monotonic()
    tally: dict[str, collections.Counter[str]] = {f.name: collections.Counter() for f in formats}
    findings = []
    results = run(files, count, seconds)
    for number, (name, how, words) in enumerate(results):
        tally[name][how] += 1
        if how not in RIGHT:
            findings.append([seed, number, name, how, words])
    return {
        "cases": len(results),
        "seconds": round(time.monotonic() - begun, 1),
        "formats": tally,
        "wrong": len(findings),
        "findings": findings[:50],
    }


# ----------------------------------------------------------------------------------- past findings


def bomb(rows: int) -> bytes:
    """A NetCDF-4 file of some kB that declares that many latitudes."""
    out = io.BytesIO()
    with h5py.File(out, "w") as file:
        for name, units in (("lat", "degrees_north"), ("lon", "degrees_east")):
            shape, chunks = ((rows,), (1024,)) if name == "lat" else ((4,), (4,))
            data = file.create_dataset(name, shape, "f8", chunks=chunks)
            data.attrs["units"] = units
            data.make_scale(name)
        for name in "uv":
            data = file.create_dataset(name, (rows, 4), "f4", chunks=(4, 4))
            data.dims[0].attach_scale(file["lat"])
            data.dims[1].attach_scale(file["lon"])
    return out.getvalue()


def endless_heap() -> bytes:
    """A NetCDF-4 file whose first text is -16 bytes long, with which HDF5 comes to no end."""
    file = bytearray(hdf5("earliest"))
    struct.pack_into("<Q", file, file.index(b"GCOL") + 24, 2**64 - 16)
    return bytes(file)


def claim(archive: bytes, member: bytes, size: int) -> bytes:
    """An archive whose directory gives a member another size (APPNOTE.TXT 4.3.12)."""
    file = bytearray(archive)
    struct.pack_into("<I", file, file.rindex(member) - 46 + 24, size)
    return bytes(file)


def past() -> dict[str, tuple[str, bytes]]:
    """What was found: the name of a file and its bytes, by what is wrong with it."""
    flat = [(name, [0, 1], [], 6, NODES * 4) for name in "uv"]
    empty = [(name, [0, 1], [], 6, b"") for name in "uv"]
    axes = [
        (n, [2], [("units", f"degrees_{d}")], 6, NODES)
        for n, d in (("lat", "north"), ("lon", "east"))
    ]
    twice = ("lat", [0], [("units", "degrees_north"), ("a", [1.0, 2.0])], 6, NODES)
    dims = [("lat", 4), ("lon", 4)]
    ply = (
        "ply\nformat {} 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
        "property float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    entities = "".join(
        f'<!ENTITY a{i} "{f"&a{i - 1};" * 10 if i else "lol" * 10}">' for i in range(10)
    )
    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    found: dict[str, tuple[str, Any]] = {
        "a dimension of 2**40 rows of no bytes": (
            "a.nc",
            netcdf(5, [("lat", 2**40), ("lon", 0), ("n", 4)], [*axes, *empty]),
        ),
        "a variable twice": (
            "a.nc",
            netcdf(5, [("lat", 0), ("lon", 4)], [twice, twice, LON, *flat], records=1),
        ),
        "an axis of another length than its dimension": (
            "a.nc",
            netcdf(5, [("lat", 4), ("lon", 3)], [LAT, ("lon", [0], *LON[2:]), *flat]),
        ),
        "a million fill values": (
            "a.nc",
            netcdf(
                1,
                dims,
                [LAT, LON, ("u", [0, 1], [("missing_value", range(10**6))], 6, NODES * 4), flat[1]],
            ),
        ),
        "a unit of a million points": (
            "a.nc",
            netcdf(
                1, dims, [LAT, LON, ("u", [0, 1], [("units", "." * 10**6)], 6, NODES * 4), flat[1]]
            ),
        ),
        "3 * 2**27 latitudes in some kB": ("a.nc", bomb(3 * 2**27)),
        "2**40 latitudes in some kB": ("a.nc", bomb(2**40)),
        "hdf5: an object of the heap that ends where it begins": ("a.nc", endless_heap()),
        "an archive that declares 4 GB": ("a.npz", claim(npz_seeds()[1], b"values.npy", 2**32 - 2)),
        "ply: 10**9 vertices": ("a.ply", ply.format("ascii", 10**9, 1) + POINTS),
        "ply: 10**9 faces": ("a.ply", ply.format("ascii", 4, 10**9) + POINTS + FACES),
        "ply: 3 * 10**9 vertices, binary": (
            "a.ply",
            ply.format("binary_little_endian", 3 * 10**9, 1).encode() + bytes(60),
        ),
        "stl: 3 * 10**9 triangles": ("a.stl", bytes(80) + struct.pack("<I", 3 * 10**9) + bytes(50)),
        "off: 10**9 vertices": ("a.off", "OFF\n1000000000 1000000000 0\n0 0 0\n"),
        "obj: a corner beyond 64 bits": ("a.obj", triangle + "f 1 2 9000000000000000000000\n"),
        "obj: 900,000 corners": ("a.obj", triangle + "f " + "1 2 3 " * 300_000 + "\n"),
        "medit: 2 * 10**8 vertices": (
            "a.mesh",
            "MeshVersionFormatted 1\nDimension 3\nVertices 200000000\n0 0 0 1\nEnd\n",
        ),
        "xdmf: entities of entities": (
            "a.xdmf",
            f'<?xml version="1.0"?><!DOCTYPE x [{entities}]><Xdmf Version="3.0"><Domain>'
            '<Grid Name="&a9;"/></Domain></Xdmf>',
        ),
    }
    return {
        why: (name, data.encode() if isinstance(data, str) else data)
        for why, (name, data) in found.items()
    }


READERS = {".nc": read_field, ".npz": read_field}


def relive() -> dict[str, tuple[str, str]]:
    """Outcome and words of every past finding."""
    found = past()
    entries = [
        (name, READERS.get(Path(name).suffix, read_mesh), data) for name, data in found.values()
    ]
    results = run(lambda number: entries[number], len(entries))
    return {why: (how, words) for why, (_, how, words) in zip(found, results, strict=True)}


if __name__ == "__main__":
    print(json.dumps(attack(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])))
