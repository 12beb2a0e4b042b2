"""What is recorded comes back, from the journal, from VTKHDF, and through VTK itself."""

import os
import struct
import subprocess
import sys
import zlib
from concurrent.futures import ThreadPoolExecutor, TimeoutError
from pathlib import Path

import h5py
import numpy as np
import pytest
import substep
from hypothesis import HealthCheck, given, settings, strategies as st
from substep.export import pack_here
from substep.recording.files import lock_for_packing
from vtk_reading import read_by_vtk

TRIANGLES = np.array([[0, 1, 2], [1, 2, 3]])
EDGES = np.array([[0, 1], [2, 3], [1, 3]])
TETRAHEDRA = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
FLOOR = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, -0.1]])
PARTS = {
    "drifters": substep.Part("particles", {"velocity": "m/s", "id": "1"}),
    "boxes": substep.Part("bodies", {"orientation": "1", "mass": "kg"}),
    "cloth": substep.Part("mesh", {"stress": "Pa", "alive": "1"}, TRIANGLES),
    "floor": substep.Part("mesh", triangles=TRIANGLES, points=FLOOR),
    "net": substep.Part("mesh", {"tension": "N"}, TRIANGLES, edges=EDGES),
    "rope": substep.Part("mesh", edges=EDGES),
    "jelly": substep.Part("mesh", {"pressure": "Pa"}, tetrahedra=TETRAHEDRA),
    "anvil": substep.Part("mesh", tetrahedra=TETRAHEDRA[:1], points=FLOOR + 1),
    "air": substep.Part(
        "grid",
        {"velocity": "m/s", "smoke": "1", "strain": "1/s"},
        bounds=[(1, 2, 3), (3, 3.5, 4)],
        cell=0.5,
    ),
    "pond": substep.Part(
        "grid", {"velocity": "m/s", "wet": "1"}, bounds=[(-1, 0), (0, 0.5)], cell=0.125
    ),
}
COUNTS = (10, 0, 7, 12, 3)


def make_frame(k, n):
    rng = np.random.default_rng(k)
    return {
        "drifters": {
            "points": rng.random((n, 2)),
            "velocity": rng.random((n, 2)),
            "id": np.arange(n, dtype=np.int32),
        },
        "boxes": {
            "points": rng.random((3, 3)),
            "orientation": rng.random((3, 4)),
            "mass": rng.random(3),
        },
        "cloth": {
            "points": rng.random((4, 3)).astype(np.float32),
            "stress": rng.random((4, 3, 3)).astype(np.float32),
            "alive": np.array([1, 0, 1, 1], bool),
        },
        "net": {"points": rng.random((4, 3)), "tension": rng.random(4)},
        "rope": {"points": rng.random((5, 3))},
        "jelly": {"points": rng.random((6, 3)), "pressure": rng.random(6)},
        "air": {
            "velocity": rng.random((4, 3, 2, 3)).astype(np.float32),
            "smoke": rng.random((4, 3, 2)),
            "strain": rng.random((4, 3, 2, 3, 3)),
        },
        "pond": {"velocity": rng.random((8, 4, 2)), "wet": rng.random((8, 4)) > 0.5},
    }


def only(names, frame):
    return {name: frame[name] for name in names if name in frame}


def with_constant_points(names, frame):
    """A frame as it is read."""
    fixed = {n: {"points": PARTS[n].points} for n in names if PARTS[n].points is not None}
    return {**only(names, frame), **fixed}


def record(path, names=tuple(PARTS), counts=COUNTS, **options):
    recorder = substep.Recorder(
        path, parts=only(names, PARTS), scene="test", parameters={"n": 1, "f": [0.5]}, **options
    )
    for k, n in enumerate(counts):
        recorder.append(0.1 * k, only(names, make_frame(k, n)))
    return recorder


def assert_same(frame, expected):
    assert frame.keys() == expected.keys()
    for part, arrays in expected.items():
        assert frame[part].keys() == arrays.keys()
        for name, array in arrays.items():
            got = frame[part][name]
            assert got.dtype == array.dtype and got.shape == array.shape, (part, name)
            assert got.tobytes() == array.tobytes(), (part, name)


def assert_recorded(path, names=tuple(PARTS), counts=COUNTS):
    with substep.Recording(path) as recording:
        assert len(recording) == len(counts)
        for k, (time, frame) in enumerate(recording):
            assert time == 0.1 * k == recording.times[k]
            assert_same(frame, with_constant_points(names, make_frame(k, counts[k])))


ALONE = [(name,) for name in PARTS if PARTS[name].points is None]


@pytest.mark.parametrize("names", [tuple(PARTS), *ALONE])
def test_round_trip_through_journal_and_packed_file(tmp_path, names):
    path = tmp_path / "a.vtkhdf"
    recorder = record(path, names, seed=7)
    assert os.listdir(tmp_path) == ["a.vtkhdf.journal"]
    assert_recorded(path, names)
    recorder.close()
    assert os.listdir(tmp_path) == ["a.vtkhdf"]
    assert_recorded(path, names)
    with substep.Recording(path) as recording:
        assert recording.packed
        assert recording.scene == "test" and recording.seed == 7
        assert recording.parameters == {"n": 1, "f": [0.5]}
        assert recording.version == substep.__version__
        assert list(recording.parts) == list(names)
        for name in names:
            part = recording.parts[name]
            assert part.kind == PARTS[name].kind and part.fields == PARTS[name].fields
            assert part.cells == PARTS[name].cells and part.cell == PARTS[name].cell
            assert np.array_equal(part.bounds, PARTS[name].bounds)
            assert part.constants().keys() == PARTS[name].constants().keys()
            for key, array in part.constants().items():
                assert np.array_equal(array, getattr(PARTS[name], key)), (name, key)


DTYPES = ["?", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"]


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    counts=st.lists(st.integers(0, 9), max_size=5),
    dimension=st.sampled_from([2, 3]),
    precision=st.sampled_from(["f4", "f8"]),
    fields=st.lists(
        st.tuples(
            st.sampled_from(DTYPES), st.sampled_from([(), (1,), (2,), (3,), (7,), (2, 2), (3, 3)])
        ),
        max_size=4,
    ),
    seed=st.integers(0, 2**32),
)
def test_any_recording_comes_back_bit_for_bit(tmp_path, counts, dimension, precision, fields, seed):
    rng = np.random.default_rng(seed)
    names = {f"f{k}": field for k, field in enumerate(fields)}
    part = substep.Part("particles", dict.fromkeys(names, "1"))
    path = tmp_path / "a.vtkhdf"
    recorder = substep.Recorder(path, parts={"p": part}, overwrite=True)
    frames = []
    for k, n in enumerate(counts):
        arrays = {"points": rng.normal(size=(n, dimension)).astype(precision)}
        for name, (dtype, shape) in names.items():
            size = (n, *shape, np.dtype(dtype).itemsize)
            bits = rng.integers(0, 2 if dtype == "?" else 256, size, np.uint8)
            arrays[name] = bits.view(dtype)[..., 0]  # NaN and infinity too
        frames.append({"p": arrays})
        recorder.append(float(k), frames[-1])
    recorder._release()
    for packed in (False, True):
        if packed:
            pack_here(str(path), None, False)
        with substep.Recording(path, recover=True) as recording:
            assert recording.packed == packed and len(recording) == len(counts)
            for (time, frame), (k, expected) in zip(recording, enumerate(frames), strict=True):
                assert time == k
                assert_same(frame, expected)


def assert_vtk_sees(data, part, arrays):
    from vtkmodules.util.numpy_support import vtk_to_numpy

    if PARTS[part].kind == "grid":
        return assert_vtk_sees_cells(data, PARTS[part], arrays)
    points = arrays["points"]
    assert data.GetNumberOfPoints() == len(points)
    if PARTS[part].kind == "mesh":
        meshes = {key: a for key, a in PARTS[part].constants().items() if key != "points"}
        assert data.GetNumberOfCells() == sum(len(mesh) for mesh in meshes.values())
        for key, mesh in meshes.items():
            method = {"triangles": "GetPolys", "edges": "GetLines", "tetrahedra": "GetCells"}[key]
            cells = vtk_to_numpy(getattr(data, method)().GetConnectivityArray())
            assert np.array_equal(cells.reshape(mesh.shape), mesh), key
    else:
        assert data.GetNumberOfVerts() == len(points) == data.GetNumberOfCells()
        if len(points):
            cells = vtk_to_numpy(data.GetVerts().GetConnectivityArray())
            assert np.array_equal(cells, np.arange(len(points)))
    if len(points) == 0:
        return
    assert data.GetPointData().GetNumberOfArrays() == len(arrays) - 1
    for name, array in arrays.items():
        got = data.GetPoints().GetData() if name == "points" else data.GetPointData().GetArray(name)
        flat = vtk_to_numpy(got).reshape(len(array), -1)
        expected = array.reshape(len(array), -1)
        assert np.array_equal(flat[:, : expected.shape[1]], expected), name
        assert not flat[:, expected.shape[1] :].any()  # z of a plane


def assert_vtk_sees_cells(data, part, arrays):
    """Each cell is where it should be, and has its own values."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    assert data.IsA("vtkImageData") and data.GetNumberOfCells() == np.prod(part.cells)
    d = len(part.cells)
    places = np.array([data.GetCell(k).GetBounds() for k in range(data.GetNumberOfCells())])
    low, high = places[:, ::2], places[:, 1::2]
    assert np.allclose((high - low)[:, :d], part.cell, rtol=1e-12)
    assert np.array_equal([low.min(axis=0)[:d], high.max(axis=0)[:d]], part.bounds)
    assert d == 3 or not (low[:, 2].any() or high[:, 2].any())
    index = tuple(np.rint((low[:, :d] - part.bounds[0]) / part.cell).astype(int).T)
    assert data.GetCellData().GetNumberOfArrays() == len(arrays)
    for name, array in arrays.items():
        got = vtk_to_numpy(data.GetCellData().GetArray(name)).reshape(len(places), -1)
        expected = array[index].reshape(len(places), -1)
        assert np.array_equal(got[:, : expected.shape[1]], expected), name
        assert not got[:, expected.shape[1] :].any()  # z of a plane


@pytest.mark.parametrize("counts", [COUNTS, (5,), (0, 0), (6, 6)])
@pytest.mark.parametrize("names", [tuple(PARTS), *ALONE])
def test_vtk_reads_every_frame_without_error(tmp_path, names, counts):
    path = tmp_path / "a.vtkhdf"
    record(path, names, counts).close()
    steps = read_by_vtk(path)
    assert len(steps) == len(counts)
    for k, (time, blocks) in enumerate(steps):
        assert time == (0.1 * k if len(counts) > 1 else None)
        assert len(blocks) == len(names)
        for name in names:
            data = blocks[name if len(names) > 1 else None]
            expected = with_constant_points(names, make_frame(k, counts[k]))
            assert_vtk_sees(data, name, expected[name])


def test_many_small_frames(tmp_path):
    path = tmp_path / "a.vtkhdf"
    recorder = substep.Recorder(path, parts={"p": substep.Part("particles", {"k": "1"})})
    sizes = np.random.default_rng(0).integers(0, 200, 600)
    for k, n in enumerate(sizes):
        recorder.append(k, {"p": {"points": np.full((n, 3), k), "k": np.full(n, k)}})
    recorder.close()
    with substep.Recording(path) as recording:
        for k in (*range(600), *np.random.default_rng(1).integers(0, 600, 300)):
            assert np.array_equal(recording["p"].points(k), np.full((sizes[k], 3), k))
            recording["p"].points(k)[...] = 0  # the caller's own
            assert np.array_equal(recording["p"].field("k", k), np.full(sizes[k], k))
    for k, (_, blocks) in zip(range(0, 600, 50), read_by_vtk(path)[::50], strict=True):
        assert blocks[None].GetNumberOfPoints() == sizes[k]


def test_an_empty_recording_packs_and_opens(tmp_path):
    path = tmp_path / "a.vtkhdf"
    record(path, counts=()).close()
    with substep.Recording(path) as recording:
        assert len(recording) == 0 and list(recording) == []
        assert recording.parts["cloth"].triangles.shape == (2, 3)
        assert recording.parts["jelly"].tetrahedra.shape == (2, 4)
        assert np.array_equal(recording["floor"].info.points, FLOOR)
    for _, blocks in read_by_vtk(path):
        assert all(block.GetNumberOfPoints() == 0 for block in blocks.values())


def test_the_file_says_what_it_holds_without_substep(tmp_path):
    path = tmp_path / "a.vtkhdf"
    record(path, ("drifters",), seed=3).close()
    with h5py.File(path) as file:
        assert file["VTKHDF/PointData/velocity"].attrs["units"] == "m/s"
        assert file["VTKHDF/Points"].attrs["units"] == "m"
        assert file["substep"].attrs["scene"] == "test"
        assert file["substep"].attrs["parameters"] == '{"n":1,"f":[0.5]}'
        assert file["substep"].attrs["seed"] == 3
        assert file["substep"].attrs["substep_version"] == substep.__version__
        datasets = []
        file.visititems(lambda _, node: datasets.append(node) if hasattr(node, "chunks") else None)
        assert datasets and all(dataset.fletcher32 for dataset in datasets)
        k, n = 3, COUNTS[3]
        start = file["VTKHDF/Steps/PointOffsets"][k]
        points = file["VTKHDF/Points"][start : start + file["VTKHDF/NumberOfPoints"][k]]
        assert np.array_equal(points[:, :2], make_frame(k, n)["drifters"]["points"])


def test_a_flow_is_recorded(tmp_path):
    """As it stands in the documentation; x is fastest in the file."""
    flow = substep.GridFlow(
        [(0, 0, 1), (2, 1, 2)], 0.25, velocity=lambda x: np.cos(x), sides="periodic", smoke=0.5
    )
    units = {name: unit for name, (_, unit) in flow.fields().items()}
    parts = {"air": substep.Part("grid", units, bounds=flow.bounds, cell=flow.cell)}
    path, frames = tmp_path / "flow.vtkhdf", []
    with substep.Recorder(path, parts=parts) as recorder:
        for _ in range(3):
            frames.append({name: values for name, (values, _) in flow.fields().items()})
            recorder.append(flow.time, {"air": frames[-1]})
            flow.step(0.01)
    with substep.Recording(path) as recording:
        for k, expected in enumerate(frames):
            assert_same(recording.frame(k), {"air": expected})
            assert np.array_equal(recording["air"].field("velocity", k), expected["velocity"])
        with pytest.raises(KeyError, match="velocity, pressure"):
            recording["air"].points(0)
    with h5py.File(path) as file:
        stored = file["VTKHDF/CellData/velocity"]
        assert stored.shape == (3, 4, 4, 8, 3) and stored.attrs["units"] == "m/s"
        assert stored[2, 1, 3, 6].tolist() == frames[2]["velocity"][6, 3, 1].tolist()


def test_grids_of_many_cells_are_chunked(tmp_path):
    part = substep.Part("grid", {"f": "1"}, bounds=[(0, 0), (4000, 300)], cell=1)
    values = np.random.default_rng(0).random((4000, 300))
    path = tmp_path / "a.vtkhdf"
    with substep.Recorder(path, parts={"g": part}) as recorder:
        recorder.append(0, {"g": {"f": values}})
        recorder.append(1, {"g": {"f": -values}})
    with h5py.File(path) as file:
        assert 2**18 < np.prod(file["VTKHDF/CellData/f"].chunks) * 8 <= 2**19
    with substep.Recording(path) as recording:
        assert np.array_equal(recording["g"].field("f", 1), -values)


def test_constant_points_are_written_once(tmp_path):
    points = np.random.default_rng(0).random((50_000, 3))
    parts = {
        "rock": substep.Part("mesh", triangles=[[0, 1, 2]], points=points),
        "p": substep.Part(),
    }
    sizes = []
    for frames in (2, 50):
        path = tmp_path / f"{frames}.vtkhdf"
        with substep.Recorder(path, parts=parts) as recorder:
            for k in range(frames):
                recorder.append(k, {"p": {"points": np.full((2, 3), k)}})
            journal = os.path.getsize(recorder.journal_path)
        sizes.append(np.array([journal, os.path.getsize(path)]))
        with substep.Recording(path) as recording:
            assert np.array_equal(recording["rock"].points(1), points)
            assert np.array_equal(recording.frame(-1)["rock"]["points"], points)
    assert np.all(sizes[1] < sizes[0] + 100_000), sizes  # 58 MB if they were in every frame


def test_files_of_version_1_are_read(tmp_path):
    """Their meshes have triangles only, and in HDF5 the checksums go by another name."""
    names = ("drifters", "cloth")
    path = tmp_path / "a.vtkhdf"
    record(path, names)._release()
    journal = Path(f"{path}.journal")
    raw = bytearray(journal.read_bytes())
    raw[12:16] = struct.pack("<I", 1)
    raw[36:40] = struct.pack("<I", zlib.crc32(raw[:36]))
    journal.write_bytes(raw)
    assert_recorded(path, names)
    substep.pack(path)
    with h5py.File(path, "r+") as file:
        group = file["substep"]
        group.attrs["format_version"] = 1
        text = group["metadata"][...].tobytes()[:-4].replace(b"constants_crc32", b"triangles_crc32")
        group["metadata"][...] = np.frombuffer(text + struct.pack("<I", zlib.crc32(text)), "u1")
    assert_recorded(path, names)


def test_one_array_at_a_time(tmp_path):
    path = tmp_path / "a.vtkhdf"
    record(path).close()
    with substep.Recording(path) as recording:
        drifters = recording["drifters"]
        expected = make_frame(4, COUNTS[4])["drifters"]
        assert np.array_equal(drifters.points(4), expected["points"])
        assert np.array_equal(drifters.points(-1), expected["points"])
        assert np.array_equal(drifters.field("velocity", 4), expected["velocity"])
        assert drifters.info.fields["velocity"] == "m/s"
        with pytest.raises(KeyError, match="velocity"):
            drifters.field("mass", 0)
        with pytest.raises(KeyError, match="boxes"):
            recording["fish"]
        for index in (5, -6, 2**70):
            with pytest.raises(IndexError, match="5 frames"):
                recording.frame(index)
        with pytest.raises(TypeError):
            recording.frame(1.5)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("torn", [0, 1, 30, 200])
def test_resume_goes_on_after_the_last_whole_frame(tmp_path, packed, torn):
    path = tmp_path / "a.vtkhdf"
    record(path, counts=COUNTS[:3])._release()
    journal = Path(f"{path}.journal")
    if packed:
        substep.pack(path)
    elif torn:
        whole = journal.read_bytes()
        record(tmp_path / "b.vtkhdf", counts=COUNTS[:4])._release()
        longer = (tmp_path / "b.vtkhdf.journal").read_bytes()
        journal.write_bytes(longer[: len(whole) + torn])
        assert_recorded(path, counts=COUNTS[:3])
    options = {"parts": PARTS, "scene": "test", "parameters": {"n": 1, "f": [0.5]}}
    with substep.Recorder(path, **options, resume=True) as recorder:
        assert len(recorder) == 3 and np.array_equal(recorder.times, 0.1 * np.arange(3))
        for k in (3, 4):
            recorder.append(0.1 * k, make_frame(k, COUNTS[k]))
    assert_recorded(path)
    assert set(os.listdir(tmp_path)) <= {"a.vtkhdf", "b.vtkhdf.journal"}


@pytest.mark.parametrize("name", ["times", "parts", "source", "path"])
def test_a_recording_that_is_read_cannot_be_changed(tmp_path, name):
    """A read after it had failed inside, or without end."""
    record(tmp_path / "run.vtkhdf")
    with substep.Recording(tmp_path / "run.vtkhdf") as recording:
        with pytest.raises(substep.InputError, match=name):
            setattr(recording, name, recording)


def test_resume_of_nothing_starts(tmp_path):
    record(tmp_path / "a.vtkhdf", resume=True).close()
    assert_recorded(tmp_path / "a.vtkhdf")


def test_an_exception_leaves_a_valid_journal(tmp_path):
    path = tmp_path / "a.vtkhdf"
    with pytest.raises(ZeroDivisionError), record(path):
        raise ZeroDivisionError
    assert os.listdir(tmp_path) == ["a.vtkhdf.journal"]
    assert_recorded(path)
    assert substep.pack(path) == str(path)
    assert os.listdir(tmp_path) == ["a.vtkhdf"]
    assert_recorded(path)


def test_pack_while_recording_and_to_another_place(tmp_path):
    path, copy = tmp_path / "a.vtkhdf", tmp_path / "copy.vtkhdf"
    recorder = record(path, counts=COUNTS[:3])
    substep.pack(path, copy)
    assert_recorded(copy, counts=COUNTS[:3])
    substep.pack(path)
    assert sorted(os.listdir(tmp_path)) == ["a.vtkhdf", "a.vtkhdf.journal", "copy.vtkhdf"]
    for k in (3, 4):
        recorder.append(0.1 * k, make_frame(k, COUNTS[k]))
    assert_recorded(path)  # the journal is newer than the packed file
    with pytest.raises(FileExistsError):
        substep.pack(path, copy)
    recorder.close()
    recorder.close()
    substep.pack(path, copy, overwrite=True)  # of a packed file: a copy
    assert sorted(os.listdir(tmp_path)) == ["a.vtkhdf", "copy.vtkhdf"]
    assert_recorded(path)
    assert_recorded(copy)


def test_two_recorders_cannot_share_a_journal(tmp_path):
    recorder = record(tmp_path / "a.vtkhdf")
    with pytest.raises(BlockingIOError):
        record(tmp_path / "a.vtkhdf", counts=(), resume=True)
    recorder.close()
    assert_recorded(tmp_path / "a.vtkhdf")


def test_packers_of_one_journal_take_turns(tmp_path):
    path = tmp_path / "a.vtkhdf"
    record(path)._release()
    fd = lock_for_packing(f"{path}.journal")
    with ThreadPoolExecutor() as pool:
        later = pool.submit(substep.pack, path)
        with pytest.raises(TimeoutError):
            later.result(timeout=1.0)
        assert os.listdir(tmp_path) == ["a.vtkhdf.journal"]
        os.close(fd)
        assert later.result(timeout=60) == str(path)
    assert os.listdir(tmp_path) == ["a.vtkhdf"]
    assert lock_for_packing(f"{path}.journal") is None
    assert substep.pack(path) == str(path)  # nothing left to do
    with pytest.raises(FileNotFoundError):
        substep.pack(tmp_path / "b.vtkhdf")


def test_a_forked_process_neither_records_nor_keeps_the_journal(tmp_path):
    path = tmp_path / "a.vtkhdf"
    program = """
import os, sys, time, numpy as np, substep
recorder = substep.Recorder(sys.argv[1], parts={"p": substep.Part()})
reader, writer = os.pipe()
if os.fork() == 0:
    os.close(writer)
    try:
        recorder.append(0, {"p": {"points": np.zeros((1, 3))}})
    except substep.InputError as error:
        assert "forked" in str(error)
        recorder = None
        os.read(reader, 1)
        os._exit(0)
    os._exit(1)
time.sleep(0.2)
recorder.append(0, {"p": {"points": np.ones((1, 3))}})
recorder.close()
os.close(writer)
_, status = os.wait()
sys.exit(status)
"""
    subprocess.run([sys.executable, "-c", program, str(path)], check=True)
    assert os.listdir(tmp_path) == ["a.vtkhdf"]
    with substep.Recording(path) as recording:
        assert recording["p"].points(0).tolist() == [[1.0, 1.0, 1.0]]


def test_modules_in_the_working_directory_are_not_imported(tmp_path, monkeypatch):
    for name in ("json", "h5py", "numpy", "substep"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit(3)")
    monkeypatch.chdir(tmp_path)
    record("a.vtkhdf").close()
    assert_recorded("a.vtkhdf")


def test_fsync_records_the_same(tmp_path):
    record(tmp_path / "a.vtkhdf", fsync=True).close()
    assert_recorded(tmp_path / "a.vtkhdf")


def test_long_parameters_and_large_frames(tmp_path):
    path = tmp_path / "a.vtkhdf"
    rng = np.random.default_rng(0)
    frames = [rng.random((100_000, 3)) for _ in range(3)]
    parameters = {"text": "x" * 200_000, "array": np.arange(3)}
    with substep.Recorder(
        path, parts={"p": substep.Part()}, parameters=parameters, scene="größer"
    ) as recorder:
        for k, points in enumerate(frames):
            recorder.append(k, {"p": {"points": points}})
    with substep.Recording(path) as recording:
        assert recording.parameters == {"text": "x" * 200_000, "array": [0, 1, 2]}
        assert recording.scene == "größer"
        for k, points in enumerate(frames):
            assert recording["p"].points(k).tobytes() == points.tobytes()


def test_shapes_of_bodies_come_back(tmp_path):
    """From the journal and from the packed file; those of each body in its own frame."""
    bodies = substep.RigidBodies()
    bodies.add(substep.Plane(), (0, 0, 0), motion="static")
    head = substep.Box((0.4, 0.2, 0.2), center=(0, 0, 0.5))
    hammer = bodies.add([head, substep.Cylinder(0.05, 1.0)], (0, 0, 2))
    ball = bodies.add(substep.Sphere(0.3), (2, 0, 1))
    shapes = substep.recording.body_shapes(bodies, [ball, hammer])
    part = substep.Part("bodies", {"orientation": "1"}, **shapes)
    frame = {"points": bodies.positions[1:], "orientation": bodies.rotations[1:]}
    path = tmp_path / "a.vtkhdf"
    with substep.Recorder(path, parts={"tools": part}) as recorder:
        recorder.append(0.0, {"tools": frame})
        with substep.Recording(f"{path}.journal") as recording:
            journal = recording.parts["tools"].constants()
    with substep.Recording(path) as recording:
        packed = recording.parts["tools"]
    for name, array in part.constants().items():
        np.testing.assert_array_equal(journal[name], array)
        np.testing.assert_array_equal(packed.constants()[name], array)
    vertices, faces = packed.shape_of(0)
    assert np.allclose(np.linalg.norm(vertices, axis=1), 0.3) and faces.max() < len(vertices)
    vertices, faces = packed.shape_of(1)
    assert vertices[:, 2].max() == pytest.approx(0.6) and faces.max() < len(vertices)
    assert len(packed.shape_of(2)[0]) == 0
    apart = [[0, 1, len(shapes["shape_vertices"]) - 1]]
    one = {**shapes, "shape_bodies": shapes["shape_bodies"] * 0}
    for kind, options, told in (
        ("particles", shapes, "bodies have all three"),
        ("bodies", {"shape_faces": [[0, 1, 2]]}, "bodies have all three"),
        ("bodies", {**one, "shape_bodies": [[0]]}, "shape_bodies: expected"),
        ("bodies", {**one, "shape_faces": [[0, 1, 99999]]}, "shape_faces: need 100000"),
        (
            "bodies",
            {**shapes, "shape_faces": apart},
            "one body",
        ),
    ):
        with pytest.raises(substep.InputError, match=told):
            substep.Part(kind, {"orientation": "1"}, **options)
    with substep.Recorder(tmp_path / "b.vtkhdf", parts={"tools": part}) as recorder:
        with pytest.raises(substep.InputError, match="shape_bodies need 2 points, got 1"):
            recorder.append(0.0, {"tools": {name: a[:1] for name, a in frame.items()}})


def test_what_was_written_since_is_taken_in(tmp_path):
    """Half a frame is none yet; the last frames are there though the journal is packed and gone."""
    path = tmp_path / "a.vtkhdf"
    recorder = substep.Recorder(path, parts={"p": substep.Part()})
    recorder.append(0.0, {"p": {"points": [[0.0, 0.0]]}})
    with substep.Recording(path) as recording:
        assert recording.refresh() == 1
        whole = Path(recording.path).read_bytes()
        recorder.append(1.0, {"p": {"points": [[1.0, 0.0]]}})
        both = Path(recording.path).read_bytes()
        os.truncate(recording.path, len(both) - 4)
        assert recording.refresh() == 1
        with open(recording.path, "r+b") as file:
            file.write(both)
        assert recording.refresh() == 2 and recording.times.tolist() == [0, 1]
        with open(recording.path, "ab") as file:
            file.write(both[len(whole) :])  # that frame once more
        with pytest.raises(substep.CorruptError, match="another frame"):
            recording.refresh()
        assert len(recording) == 2
        recorder.append(2.0, {"p": {"points": [[2.0, 0.0]]}})
        recorder.close()
        assert not os.path.exists(recording.path)
        assert recording.refresh() == 3 and recording["p"].points(-1)[0, 0] == 2
    with substep.Recording(path) as recording:
        assert recording.packed and recording.refresh() == 3
    with pytest.raises(substep.InputError, match="closed"):
        recording.refresh()
