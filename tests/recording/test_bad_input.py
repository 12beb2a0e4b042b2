"""What recordings refuse and survive: wrong arguments, hostile files, full disks."""

import errno
import os
import resource
import shutil
import struct
import subprocess
import sys
import threading
import tracemalloc
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
import substep
from hypothesis import HealthCheck, given, settings, strategies as st
from substep import CorruptError, FormatError, InputError, TruncatedError, VersionError
from substep.export import pack_here
from substep.recording.frames import (
    BYTE_ORDER,
    FILE_HEADER,
    FORMAT_VERSION,
    FRAME_HEADER,
    MAGIC,
    TABLE,
    Encoder,
    Spec,
)

PARTS = {"p": substep.Part("particles", {"v": "m/s"})}
NAN = np.full((5, 3), np.nan)
GOOD = np.zeros((5, 3))
BOX = [(0.0, 0.0), (1.0, 0.5)]
ROCK = substep.Part("mesh", triangles=[[0, 1, 2]], points=GOOD)


def frame(k, n=5):
    x = np.arange(3.0 * n).reshape(n, 3) + k
    return {"p": {"points": x, "v": -x}}


def record(path, frames=4, **options):
    recorder = substep.Recorder(path, parts=PARTS, **options)
    for _ in range(frames):
        k = len(recorder)
        recorder.append(k, frame(k))
    return recorder


def assert_frames(path, count, **options):
    with substep.Recording(path, **options) as recording:
        assert len(recording) == count
        for k, (time, arrays) in enumerate(recording):
            assert time == k
            for name, array in frame(k)["p"].items():
                assert arrays["p"][name].tobytes() == array.tobytes()


@pytest.fixture
def packed(tmp_path):
    path = tmp_path / "a.vtkhdf"
    record(path)._release()
    pack_here(str(path), None, False)
    return path


@pytest.fixture
def journal(tmp_path):
    record(tmp_path / "a.vtkhdf")._release()
    return tmp_path / "a.vtkhdf.journal"


def test_a_closed_recording_says_so(journal):
    recordings = [substep.Recording(journal), substep.Recording(substep.pack(journal))]
    for recording in recordings:
        recording.close()
        recording.close()  # again is harmless
        for read in (lambda r=recording: r.frame(0), lambda r=recording: r["p"].field("v", 1)):
            with pytest.raises(InputError, match="the recording is closed"):
                read()
        assert len(recording) == 4 and recording.times[3] == 3


# ------------------------------------------------------------------------------------- arguments


@pytest.mark.parametrize(
    "name",
    [
        *("", "..", ".", "../x", "a/b", "/x", "a\0", "a\nb", "x\n", "x" * 5000),
        *("CON", "com1", "nul", "Steps", "Assembly", "points", "1a", "-a", "a b", "größe"),
    ],
)
def test_names_of_parts_and_fields_are_confined(tmp_path, name):
    with pytest.raises(InputError, match="fields"):
        substep.Part("particles", {name: "m"})
    with pytest.raises(InputError, match="parts"):
        substep.Recorder(tmp_path / "a", parts={name: substep.Part()})
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("arguments", "error", "match"),
    [
        (("fish",), InputError, "particles, bodies, mesh, grid"),
        (("grid", {"v": "1"}), InputError, "bounds, cell: a grid needs both"),
        (("grid", {"v": "1"}, *4 * [None], BOX), InputError, "bounds, cell: a grid needs both"),
        (("particles", {}, *4 * [None], BOX, 0.5), InputError, "other kinds have none"),
        (("grid", {}, *4 * [None], BOX, 0.5), InputError, "fields: a grid needs one"),
        (("grid", {"v": "1"}, *4 * [None], BOX, 0.0), InputError, "cell"),
        (("grid", {"v": "1"}, *4 * [None], BOX, 0.3), InputError, "whole number of cells"),
        (("grid", {"v": "1"}, *4 * [None], BOX[::-1], 0.5), InputError, "lowest corner"),
        (("grid", {"v": "1"}, *4 * [None], [(0,), (1,)], 0.5), InputError, r"shape \(2, 3\)"),
        (("grid", {"v": "1"}, [[0, 1, 2]], *3 * [None], BOX, 0.5), InputError, "triangles"),
        (("particles", {"v": "m\n"}), InputError, "v"),
        (("particles", {"v": 1}), TypeError, "v"),
        (("particles", ["v"]), TypeError, "fields"),
        (("particles", {1: "m"}), TypeError, "fields"),
        (("bodies", {}), InputError, "orientation"),
        (("mesh", {}), InputError, "triangles"),
        (("particles", {}, [[0, 1, 2]]), InputError, "triangles"),
        (("mesh", {}, [[0, 1]]), InputError, "triangles"),
        (("mesh", {}, [[0, 1, -2]]), InputError, "triangles"),
        (("mesh", {}, [[0.0, 1.0, 2.0]]), InputError, "triangles"),
        (("mesh", {}, None, [[0, 1, 2]]), InputError, "edges"),
        (("mesh", {}, None, [[0, -1]]), InputError, "edges"),
        (("mesh", {}, None, None, [[0, 1, 2]]), InputError, "tetrahedra"),
        (("mesh", {}, [[0, 1, 2]], None, [[0, 1, 2, 3]]), InputError, "tetrahedra: such a mesh"),
        (("mesh", {}, None, None, None, GOOD), InputError, "triangles, edges"),
        (("particles", {}, None, None, None, GOOD), InputError, "other kinds"),
        (("mesh", {}, [[0, 1, 5]], None, None, GOOD), InputError, "need 6 points, got 5"),
        (("mesh", {}, [[0, 1, 2]], None, None, NAN), InputError, r"points\[0, 0"),
        (("mesh", {}, [[0, 1, 2]], None, None, GOOD[:, :2]), InputError, "points"),
        (("mesh", {"v": "1"}, [[0, 1, 2]], None, None, GOOD), InputError, "no fields"),
    ],
)
def test_parts_are_checked(arguments, error, match):
    with pytest.raises(error, match=match):
        substep.Part(*arguments)


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"parts": {}}, InputError, "parts"),
        ({"parts": ["p"]}, TypeError, "parts"),
        ({"parts": {"p": "particles"}}, TypeError, "parts"),
        ({"parts": {"p": substep.Part(), "P": substep.Part()}}, InputError, "case"),
        ({"parts": {"p": ROCK}}, InputError, "one that moves"),
        ({"scene": "a\n"}, InputError, "scene"),
        ({"scene": 1}, TypeError, "scene"),
        ({"parameters": {"a": float("nan")}}, InputError, "'a'"),
        ({"parameters": {"a": object()}}, InputError, "'a'"),
        ({"parameters": {1: 2}}, TypeError, "parameters"),
        ({"seed": -1}, InputError, "seed"),
        ({"seed": 1.5}, InputError, "seed"),
        ({"overwrite": True, "resume": True}, InputError, "overwrite"),
    ],
)
def test_recorder_arguments_are_checked(tmp_path, options, error, match):
    with pytest.raises(error, match=match):
        substep.Recorder(tmp_path / "a", **{"parts": PARTS, **options})
    assert os.listdir(tmp_path) == []


class Raising:
    def __array__(self, dtype=None, copy=None):
        raise ZeroDivisionError


class Stop:
    """Ctrl-C at the n-th instruction of the recorder and its journal."""

    def __init__(self, at):
        self.left = at

    def __call__(self, frame, event, _):
        if not frame.f_code.co_filename.endswith(("recorder.py", "journal.py")):
            return None
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        self.left -= event == "opcode"
        if event == "opcode" and self.left == 0:
            raise KeyboardInterrupt
        return self


def test_an_interrupt_at_any_instruction_of_append_spoils_nothing(tmp_path):
    path = tmp_path / "a.vtkhdf"
    for at in range(1, 10_000):
        recorder, stop = record(path, 1, overwrite=True), Stop(at)
        sys.settrace(stop)
        try:
            recorder.append(1, frame(1))
        except KeyboardInterrupt:
            pass
        finally:
            sys.settrace(None)
        recorder.append(2, frame(2))
        times = recorder.times.tolist()
        recorder._release()
        assert substep.Recording(f"{path}.journal").times.tolist() == times
        assert times in ([0, 2], [0, 1, 2])
        if stop.left > 0:
            break
    assert at > 100


def test_nothing_uses_a_recorder_in_the_middle_of_a_frame(tmp_path):
    recorder, told = record(tmp_path / "a.vtkhdf"), []

    class Using:  # as a handler of signals may
        def __array__(self, dtype=None, copy=None):
            for use in (recorder.close, lambda: recorder.append(9, frame(9))):
                with pytest.raises(InputError, match="in the middle of a frame"):
                    use()
                told.append(use)
            return np.zeros((5, 3))

    def append():
        recorder.append(4, {"p": {**frame(4)["p"], "v": Using()}})

    thread = threading.Thread(target=append, daemon=True)  # which would wait for itself
    thread.start()
    thread.join(10)
    assert len(told) == 2 and not thread.is_alive() and len(recorder) == 5
    recorder.close()


@pytest.mark.parametrize(
    ("time", "changes", "error", "match"),
    [
        (float("nan"), {}, InputError, "time"),
        (float("inf"), {}, InputError, "time"),
        (3, {}, InputError, "after 3"),
        ("4", {}, TypeError, "time"),
        (4, {"points": NAN}, InputError, r"p/points\[0, 0\]"),
        (4, {"points": np.zeros((5, 4))}, InputError, "p/points"),
        (4, {"points": np.zeros((3, 5))}, InputError, "p/points"),
        (4, {"points": np.zeros((5, 3, 1))}, InputError, "p/points"),
        (4, {"points": np.zeros((5, 2))}, InputError, "first frame"),
        (4, {"points": np.float64(1)}, InputError, "p/points"),
        (4, {"points": [[1.0, 2.0, 3.0], [1.0]]}, InputError, "p/points"),
        (4, {"points": GOOD.astype(complex)}, TypeError, "p/points"),
        (4, {"points": GOOD.astype(object)}, TypeError, "p/points"),
        (4, {"points": GOOD.astype(str)}, TypeError, "p/points"),
        (4, {"points": np.ma.masked_less(GOOD, 1)}, InputError, "p/points"),
        (4, {"points": Raising()}, ZeroDivisionError, None),
        (4, {"v": np.zeros((4, 3))}, InputError, "p/v: expected 5 rows"),
        (4, {"v": np.zeros((5, 65))}, InputError, "p/v"),
        (4, {"v": np.zeros((5, 0))}, InputError, "p/v"),
        (4, {"v": np.zeros(5)}, InputError, "first frame"),
        (4, {"v": GOOD.astype(np.int64) + 2**53}, InputError, "first frame|below"),
        (4, {"w": GOOD}, InputError, "unknown"),
        (4, {"v": None}, TypeError, "p/v"),
    ],
)
def test_a_bad_frame_is_refused_and_nothing_is_written(tmp_path, time, changes, error, match):
    path = tmp_path / "a.vtkhdf"
    recorder = record(path)
    before = Path(f"{path}.journal").read_bytes()
    bad = {"p": {**frame(4)["p"], **changes}}
    with pytest.raises(error, match=match):
        recorder.append(time, bad)
    assert Path(f"{path}.journal").read_bytes() == before and len(recorder) == 4
    for structure in ({}, {"q": {}}, {"p": {}}, [], {"p": 1}, {"p": frame(4)["p"], "q": {}}):
        with pytest.raises((InputError, TypeError), match="frame"):
            recorder.append(4, structure)
    assert Path(f"{path}.journal").read_bytes() == before
    recorder.append(4, frame(4))
    recorder._release()
    assert_frames(path, 5)
    with pytest.raises(InputError, match="closed"):
        recorder.append(5, frame(5))


def test_other_layouts_and_narrower_numbers_are_converted(tmp_path):
    x = frame(0)["p"]["points"]
    views = [
        np.asfortranarray(x),
        np.repeat(x, 2, axis=0)[::2],
        x[::-1][::-1],
        x.astype(">f8"),
        x.astype(np.float32),
        x.tolist(),
        np.ma.array(x, mask=False),
        x.astype(np.int16),
    ]
    with substep.Recorder(tmp_path / "a", parts={"p": substep.Part()}) as recorder:
        recorder.append(-1, {"p": {"points": np.broadcast_to([0.0, 0.0, 0.0], (4, 3))}})
        for k, view in enumerate(views):
            recorder.append(k, {"p": {"points": view}})
    with substep.Recording(tmp_path / "a") as recording:
        for k in range(len(views)):
            assert recording["p"].points(k + 1).tobytes() == x.tobytes()


@pytest.mark.parametrize("dtype", "? b B h H i I q Q e f d g".split())
def test_every_dtype_that_can_be_recorded(tmp_path, dtype):
    values = np.array([0, 1, 1, 0], dtype)
    path = tmp_path / "a"
    recorder = substep.Recorder(path, parts={"p": substep.Part(fields={"f": "1"})})
    recorder.append(0, {"p": {"points": np.zeros((4, 2), np.float32), "f": values}})
    recorder._release()
    for packed in (False, True):
        if packed:
            pack_here(str(path), None, False)
        with substep.Recording(path) as recording:
            got = recording["p"].field("f", 0)
            assert got.dtype == {"e": np.float32, "g": np.float64}.get(dtype, values.dtype)
            assert np.array_equal(got, values) and recording["p"].points(0).dtype == np.float32


def test_bodies_and_meshes_are_checked(tmp_path):
    parts = {
        "b": substep.Part("bodies", {"orientation": "1"}),
        "m": substep.Part("mesh", {}, [[0, 1, 2]]),
    }
    good = {"b": {"points": GOOD, "orientation": np.ones((5, 4))}, "m": {"points": GOOD}}
    with substep.Recorder(tmp_path / "a", parts=parts) as recorder:
        with pytest.raises(InputError, match="b/orientation"):
            recorder.append(0, {**good, "b": {"points": GOOD, "orientation": GOOD}})
        with pytest.raises(InputError, match="triangles need 3 points, got 2"):
            recorder.append(0, {**good, "m": {"points": GOOD[:2]}})
        recorder.append(0, good)


def test_grids_are_checked(tmp_path):
    part = substep.Part("grid", {"v": "m/s", "p": "Pa"}, bounds=BOX, cell=0.25)
    good = {"v": np.ones((4, 2, 2)), "p": np.ones((4, 2))}
    with substep.Recorder(tmp_path / "a", parts={"g": part}) as recorder:
        for changes, match in (
            ({"p": np.ones((2, 4))}, r"g/p: expected shape \(4, 2\), got \(2, 4\)"),
            ({"p": np.ones(8)}, r"g/p: expected shape \(4, 2\), got \(8,\)"),
            ({"p": 1.0}, r"g/p: expected shape \(4, 2\), got \(\)"),
            ({"v": np.ones((4, 2, 2, 2, 2))}, "g/v: expected one row"),
            ({"v": np.ones((4, 2, 65))}, "g/v: expected one row"),
            ({"v": np.ones((4, 2), object)}, "g/v"),
            ({"points": np.ones((8, 2))}, "unknown"),
        ):
            with pytest.raises((InputError, TypeError), match=match):
                recorder.append(0, {"g": {**good, **changes}})
        recorder.append(0, {"g": {**good, "p": np.full((4, 2), np.nan)}})
        with pytest.raises(InputError, match="rows of shape"):
            recorder.append(1, {"g": {**good, "v": np.ones((4, 2))}})
    with substep.Recording(tmp_path / "a") as recording:
        assert len(recording) == 1 and np.isnan(recording["g"].field("p", 0)).all()


def test_tetrahedra_keep_their_number_of_points(tmp_path):
    """A VTKHDF file has one number for all frames; after resuming, too."""
    path, parts = tmp_path / "a", {"jelly": substep.Part("mesh", tetrahedra=[[0, 1, 2, 3]])}
    recorder = substep.Recorder(path, parts=parts)
    recorder.append(0, {"jelly": {"points": GOOD}})
    for resumed in (False, True):
        if resumed:
            recorder._release()
            recorder = substep.Recorder(path, parts=parts, resume=True)
        with pytest.raises(InputError, match=r"jelly/points: .* 5; got 4"):
            recorder.append(3, {"jelly": {"points": GOOD[:4]}})
        recorder.append(len(recorder), {"jelly": {"points": GOOD}})
    recorder.close()
    with substep.Recording(path) as recording:
        assert len(recording) == 3


def test_resume_refuses_other_metadata(tmp_path):
    path = tmp_path / "a"
    record(path, scene="a", parameters={"n": 1})._release()
    before = Path(f"{path}.journal").read_bytes()
    for options in ({"scene": "b"}, {"parameters": {"n": 2}}, {"seed": 1}):
        with pytest.raises(InputError, match=next(iter(options))):
            record(path, **{"scene": "a", "parameters": {"n": 1}, **options}, resume=True)
    other = {"q": substep.Part()}
    with pytest.raises(InputError, match="parts"):
        substep.Recorder(path, parts=other, scene="a", parameters={"n": 1}, resume=True)
    assert Path(f"{path}.journal").read_bytes() == before


# ----------------------------------------------------------------------------- files and folders


def test_an_existing_recording_is_kept_unless_overwritten(packed):
    before = packed.read_bytes()
    with pytest.raises(FileExistsError, match="overwrite"):
        record(packed)
    assert packed.read_bytes() == before
    record(packed, frames=1, overwrite=True)._release()
    assert_frames(packed, 1)
    with pytest.raises(FileExistsError, match="overwrite"):
        record(packed)
    record(packed, frames=2, overwrite=True).close()
    assert_frames(packed, 2)


def test_paths_that_cannot_be_written(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"missing'$"):
        record(tmp_path / "missing" / "a.vtkhdf")
    with pytest.raises(OSError, match="too long"):
        record(tmp_path / ("x" * 5000))
    with pytest.raises(InputError, match="path"):
        record(str(tmp_path) + "/a\0b")
    with pytest.raises(TypeError):
        record(3)
    with pytest.raises(FileExistsError):
        record(tmp_path)
    with pytest.raises(OSError):
        record(tmp_path, overwrite=True)
    for path in (tmp_path / "missing", tmp_path):
        with pytest.raises(OSError):
            substep.Recording(path)


def test_without_permission(tmp_path):
    tmp_path.chmod(0o755)
    for folder in tmp_path.parents[:2]:
        folder.chmod(folder.stat().st_mode | 0o055)
    (tmp_path / "secret").write_bytes(b"x")
    (tmp_path / "secret").chmod(0)
    tmp_path.chmod(0o555)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        with pytest.raises(PermissionError):
            record(tmp_path / "a.vtkhdf")
        with pytest.raises(PermissionError):
            substep.Recording(tmp_path / "secret")
    finally:
        if root:
            os.seteuid(0)
        tmp_path.chmod(0o755)


def test_links_are_not_written_through(tmp_path):
    victim = tmp_path / "victim"
    victim.write_bytes(b"precious")
    path = tmp_path / "a.vtkhdf"
    for name in (path, f"{path}.journal"):
        os.symlink(victim, name)
        with pytest.raises(FileExistsError):
            record(path)
        with pytest.raises((OSError, FormatError)):
            record(path, resume=True)
        record(path, frames=1, overwrite=True).close()
        assert victim.read_bytes() == b"precious" and not path.is_symlink()
        path.unlink()
    for name in (f"{path}.part", f"{path}.journal.part"):
        os.symlink(victim, name)
    record(path).close()
    assert_frames(path, 4)
    assert victim.read_bytes() == b"precious"


def test_the_folder_is_removed_while_recording(tmp_path):
    (tmp_path / "run").mkdir()
    recorder = record(tmp_path / "run" / "a.vtkhdf")
    shutil.rmtree(tmp_path / "run")
    with pytest.raises(FileNotFoundError, match="removed"):
        recorder.append(4, frame(4))
    other = record(tmp_path / "b.vtkhdf")  # the run goes on elsewhere
    other.append(4, frame(4))
    other.close()
    assert_frames(tmp_path / "b.vtkhdf", 5)
    with pytest.raises(FileNotFoundError):
        recorder.close()


def test_a_failing_disk_is_reported_and_the_next_append_repairs(tmp_path, monkeypatch):
    path = tmp_path / "a.vtkhdf"
    recorder = record(path)
    pwrite, truncate = os.pwrite, os.ftruncate

    def stale(*_):
        raise OSError(errno.ESTALE, os.strerror(errno.ESTALE))

    calls = []

    def half(fd, data, offset):
        calls.append(len(data))
        return stale() if len(calls) == 2 else pwrite(fd, data[: len(data) // 2], offset)

    monkeypatch.setattr(os, "pwrite", half)
    monkeypatch.setattr(os, "ftruncate", stale)
    with pytest.raises(OSError, match="Stale"):
        recorder.append(4, {"p": {"points": np.ones((50, 3)), "v": np.ones((50, 3))}})
    assert_frames(path, 4)  # the torn frame is behind the end
    monkeypatch.setattr(os, "pwrite", pwrite)
    with pytest.raises(OSError, match="Stale"):
        recorder.append(4, frame(4))
    monkeypatch.setattr(os, "ftruncate", truncate)
    recorder.append(4, frame(4))
    recorder._release()
    assert_frames(path, 5)


# --------------------------------------------------------------------------------------- disk full


def fill(path):
    """Record until it fails; frames written."""
    recorder = record(path, frames=0)
    while True:
        before = Path(f"{path}.journal").read_bytes()
        big = frame(len(recorder), 1000)
        try:
            recorder.append(len(recorder), big)
        except OSError as error:
            assert error.errno in (errno.ENOSPC, errno.EFBIG)
            assert Path(f"{path}.journal").read_bytes() == before
            assert (big["p"]["points"] == frame(len(recorder), 1000)["p"]["points"]).all()
            return recorder


def assert_served(path, count):
    with substep.Recording(path) as recording:
        assert len(recording) == count > 3
        for k, (_, arrays) in enumerate(recording):
            assert np.array_equal(arrays["p"]["v"], frame(k, 1000)["p"]["v"])


@pytest.fixture
def largest_file():
    """Limits the size of files; the system call then fails as on a full disk."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    def limit(size):
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))

    yield limit
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_file_size_limit(tmp_path, largest_file):
    path = tmp_path / "a.vtkhdf"
    largest_file(300_000)
    recorder = fill(path)
    count = len(recorder)
    assert_served(path, count)
    recorder.append(count, frame(count, 10))  # a smaller one fits
    with substep.Recording(path) as recording:
        assert len(recording) == count + 1
    largest_file(200_000)
    with pytest.raises(OSError):
        recorder.close()
    largest_file(resource.getrlimit(resource.RLIMIT_FSIZE)[1])
    assert os.listdir(tmp_path) == ["a.vtkhdf.journal"]
    substep.pack(path)
    assert os.listdir(tmp_path) == ["a.vtkhdf"]
    with substep.Recording(path) as recording:
        assert recording.packed and len(recording) == count + 1


def test_full_disk(tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a small disk needs root; test_file_size_limit is the other route")
    try:
        path = disk / "a.vtkhdf"
        recorder = fill(path)
        count = len(recorder)
        assert_served(path, count)
        with substep.Recorder(tmp_path / "b.vtkhdf", parts=PARTS) as other:
            other.append(count, frame(count, 1000))  # the run goes on elsewhere
        with pytest.raises(OSError) as caught:
            recorder.close()
        assert caught.value.errno == errno.ENOSPC
        assert os.listdir(disk) == ["a.vtkhdf.journal"]
        assert_served(path, count)
        assert_served(substep.pack(path, tmp_path / "c.vtkhdf"), count)
    finally:
        subprocess.run(["umount", str(disk)], check=True)


# ----------------------------------------------------------------------------------- damaged files


def test_every_prefix_of_a_journal_is_read_up_to_its_last_whole_frame(tmp_path):
    path = tmp_path / "a"
    recorder = substep.Recorder(path, parts={"p": substep.Part()})
    ends = [os.path.getsize(recorder.journal_path)]
    for k in range(4):
        recorder.append(k, {"p": {"points": np.full((k, 2), k, np.float32)}})
        ends.append(os.path.getsize(recorder.journal_path))
    recorder._release()
    whole = Path(recorder.journal_path).read_bytes()
    victim = tmp_path / "victim"
    for length in range(len(whole) + 1):
        victim.write_bytes(whole[:length])
        if length < ends[0]:
            with pytest.raises(TruncatedError) as caught:
                substep.Recording(victim)
            assert caught.value.offset == length
            continue
        with substep.Recording(victim) as recording:
            assert len(recording) == sum(length >= end for end in ends[1:])
            for k in range(len(recording)):
                assert np.array_equal(recording["p"].points(k), np.full((k, 2), k))


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_journal_of_any_bytes_is_an_error_or_valid(tmp_path, data):
    record(tmp_path / "a", frames=3, overwrite=True)._release()
    whole = (tmp_path / "a.journal").read_bytes()
    start = data.draw(st.integers(0, len(whole)))
    junk = data.draw(st.binary(max_size=200))
    (tmp_path / "b").write_bytes(whole[:start] + junk + whole[start + len(junk) :])
    for recover in (False, True):
        try:
            with substep.Recording(tmp_path / "b", recover=recover) as recording:
                for k, (_, arrays) in enumerate(recording):
                    assert arrays["p"]["v"].tobytes() == frame(k)["p"]["v"].tobytes()
        except FormatError:
            pass


def flip(path, offset):
    data = bytearray(path.read_bytes())
    data[offset] ^= 1
    path.write_bytes(data)


def test_a_damaged_frame_is_named_and_the_valid_prefix_recovered(journal):
    whole = journal.read_bytes()
    header = whole.index(b"FRAM", whole.index(b"FRAM") + 1)  # of frame 1
    flip(journal, header + FRAME_HEADER.size + 2 * TABLE.itemsize + 5)  # its payload
    with substep.Recording(journal) as recording:
        assert len(recording) == 4  # found when it is read
        recording.frame(0)
        with pytest.raises(CorruptError, match=r"frame 1, p/points"):
            recording.frame(1)
        assert recording["p"].field("v", 1).tobytes() == frame(1)["p"]["v"].tobytes()
    assert_frames(journal, 1, recover=True)
    with pytest.raises(CorruptError, match="frame 1"):
        substep.pack(journal)
    assert journal.exists()
    for offset in (header, header + 20, header + FRAME_HEADER.size):
        journal.write_bytes(whole)
        flip(journal, offset)
        with pytest.raises(CorruptError, match="frame 1 at byte") as caught:
            substep.Recording(journal)
        assert caught.value.offset == header
        assert_frames(journal, 1, recover=True)
        with pytest.raises(CorruptError):  # the frames behind it may be good: nothing is cut off
            record(str(journal).removesuffix(".journal"), frames=0, resume=True)


@pytest.mark.parametrize("tail", ["zeros", "last payload"])
def test_resume_after_a_power_cut(journal, tail):
    path = str(journal).removesuffix(".journal")
    if tail == "zeros":
        journal.write_bytes(journal.read_bytes() + bytes(5000))
    else:
        flip(journal, -3)
    valid = 4 if tail == "zeros" else 3
    if tail == "zeros":
        assert_frames(path, valid)
    else:  # it may have been whole once
        with pytest.raises(CorruptError, match="frame 3 at byte"):
            substep.Recording(path)
    assert_frames(path, valid, recover=True)
    record(path, frames=2, resume=True).close()
    assert_frames(path, valid + 2)


def test_a_packed_file_is_checked_at_every_read(packed):
    data = packed.read_bytes()
    with h5py.File(packed) as file:
        start = file["VTKHDF/PointData/v"].id.get_chunk_info(0).byte_offset
    flip(packed, start + 2 * frame(0)["p"]["v"].nbytes)
    with substep.Recording(packed) as recording:
        with pytest.raises(CorruptError):
            recording.frame(2)
    for length in (0, 7):
        packed.write_bytes(data[:length])
        with pytest.raises(FormatError):
            substep.Recording(packed)
    for length in (8, 47, 48, 1000, len(data) - 1):
        packed.write_bytes(data[:length])
        with pytest.raises(TruncatedError) as caught:
            substep.Recording(packed)
        assert caught.value.offset == length


# ----------------------------------------------------------------------- versions, hostile content


def file_header(
    text, blob=b"", *, order=BYTE_ORDER, version=FORMAT_VERSION, text_bytes=0, blob_bytes=0
):
    """A header with valid checksums and any content."""
    head = FILE_HEADER.pack(
        MAGIC,
        order,
        version,
        text_bytes or len(text),
        blob_bytes or len(blob),
        zlib.crc32(blob, zlib.crc32(text)),
        0,
    )[:-4]
    return head + struct.pack("<I", zlib.crc32(head)) + text + blob


def frame_record(index, time, counts, payload, dtype=b"<f8"):
    table = np.zeros(len(counts), TABLE)
    table["count"], table["dtype"], table["shape"] = counts, dtype, (3, 0)
    rows = table.tobytes()
    head = FRAME_HEADER.pack(b"FRAM", len(counts), index, time, payload, zlib.crc32(rows), 0)[:-4]
    return head + struct.pack("<I", zlib.crc32(head)) + rows


def metadata(journal):
    data = journal.read_bytes()
    length = FILE_HEADER.unpack_from(data)[3]
    return data[FILE_HEADER.size : FILE_HEADER.size + length]


def test_newer_version_and_other_byte_order(journal):
    text = metadata(journal)
    packed = Path(substep.pack(journal))
    journal.write_bytes(file_header(text, version=5))
    with pytest.raises(VersionError, match="version 5"):
        substep.Recording(journal)
    journal.write_bytes(file_header(text, order=0x04030201))
    with pytest.raises(VersionError, match="byte order"):
        substep.Recording(journal)
    journal.unlink()
    with h5py.File(packed, "r+") as file:
        file["substep"].attrs.modify("format_version", 5)
    with pytest.raises(VersionError, match="version 5"):
        substep.Recording(packed)


@pytest.mark.parametrize("dtype", [">f8", "<f4", "<f2"])
def test_other_byte_order_and_float_width_of_hdf5(packed, dtype):
    replace(packed, "VTKHDF/Points", lambda old: {"data": old.astype(dtype)})
    with substep.Recording(packed) as recording, pytest.raises(VersionError, match="Points"):
        recording.frame(0)


def replace(path, name, make):
    with h5py.File(path, "r+") as file:
        old = file[name][...]
        del file[name]
        file.create_dataset(name, **make(old))


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"{",
        b"[]",
        b"null",
        b'{"a":NaN}',
        b'{"a":1e999}',
        b'{"a":1,"a":2}',
        b"[" * 100_000,
        b"\xff",
        b'{"parts":[{"name":"p","fields":[],"triangles":null}]}',
        b'{"parts":[{"kind":"particles","fields":[],"triangles":null}],'
        b'"scene":"","parameters":{},"seed":0,"substep":"1"}',
        b'{"parts":[{"name":"../p","kind":"particles","fields":[],"triangles":null}],'
        b'"scene":"","parameters":{},"seed":0,"substep":"1"}',
        b'{"parts":[{"name":"p","kind":"particles","fields":[["a/b","m"]],"triangles":null}],'
        b'"scene":"","parameters":{},"seed":0,"substep":"1"}',
        b'{"parts":[{"name":"p","kind":"mesh","fields":[],"triangles":1152921504606846976}],'
        b'"scene":"","parameters":{},"seed":0,"substep":"1"}',
        b'{"parts":[{"name":"p","kind":"mesh","fields":[],"triangles":-1}],'
        b'"scene":"","parameters":{},"seed":0,"substep":"1"}',
        b'{"parts":[{"name":"p","kind":"mesh","fields":[],"edges":0.0}],'
        b'"scene":"","parameters":{},"seed":0,"substep":"1"}',
        b'{"parts":[{"name":"p","kind":"mesh","fields":[],"points":0}],'
        b'"scene":"","parameters":{},"seed":0,"substep":"1"}',
    ],
)
def test_hostile_metadata_with_valid_checksums(journal, text):
    journal.write_bytes(file_header(text))
    for recover in (False, True):
        with pytest.raises(CorruptError):
            substep.Recording(journal, recover=recover)


def test_huge_declared_sizes_in_a_journal(journal):
    text = metadata(journal)
    good = file_header(text)
    tracemalloc.start()
    for content, error in [
        (file_header(text, text_bytes=2**60), TruncatedError),
        (file_header(text, blob_bytes=2**63), TruncatedError),
        (good + frame_record(0, 0.0, [2**60, 1], 48) + bytes(48), CorruptError),
        (good + frame_record(0, 0.0, [1, 1], 48, b"|O8\0") + bytes(48), CorruptError),
        (good + frame_record(0, float("nan"), [1, 1], 48) + bytes(48), CorruptError),
        (good + frame_record(1, 0.0, [1, 1], 48) + bytes(48), CorruptError),
        (good + frame_record(0, 0.0, [1], 24) + bytes(24), CorruptError),
        # a frame that is longer than the file is what a killed writer leaves: no frame
        (good + frame_record(0, 0.0, [2**58, 2**58], 48 * 2**58) + bytes(48), None),
    ]:
        journal.write_bytes(content)
        if error is None:
            assert_frames(journal, 0)
        else:
            with pytest.raises(error):
                substep.Recording(journal)
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()


def test_frames_that_do_not_fit_their_parts(tmp_path):
    """With right checksums: who draws a mesh relies on its topology, and on equal lengths."""
    path = tmp_path / "a.vtkhdf"
    recorder = substep.Recorder(path, parts={"m": substep.Part("mesh", {"v": "1"}, [[0, 1, 2]])})
    recorder.append(0, {"m": {"points": GOOD, "v": GOOD}})
    recorder._release()
    file = Path(f"{path}.journal")
    whole = file.read_bytes()
    points, v = Spec("m", "points", "<f8", (3,)), Spec("m", "v", "<f8", (3,))
    for arrays, said in (
        ((GOOD[:2], GOOD[:2]), "frame 1: the topology of m needs 3 points"),
        ((GOOD, GOOD[:4]), "frame 1: the arrays of m differ in length"),
    ):
        file.write_bytes(whole + bytes(Encoder().encode(1, 1.0, (points, v), arrays)))
        with pytest.raises(CorruptError, match=said):
            substep.Recording(path)
        with substep.Recording(path, recover=True) as recording:
            assert len(recording) == 1
    grid = substep.Part("grid", {"v": "1"}, bounds=BOX, cell=0.25)
    recorder = substep.Recorder(path, parts={"g": grid}, overwrite=True)
    spec = [Spec("g", "v", "<f8", ())]
    recorder._release()
    record = bytes(Encoder().encode(0, 0.0, spec, [np.ones(7)]))
    file.write_bytes(file.read_bytes() + record)
    with pytest.raises(CorruptError, match="frame 0: the arrays of g need 8 cells"):
        substep.Recording(path)
    wide = np.zeros((5, 4))
    header = whole[: len(whole) - len(Encoder().encode(0, 0.0, (points, v), (GOOD, GOOD)))]
    specs = (Spec("m", "points", "<f8", (4,)), v)
    file.write_bytes(header + bytes(Encoder().encode(0, 0.0, specs, (wide, GOOD))))
    with pytest.raises(CorruptError, match=r"m/points has rows of shape \(4,\)"):
        substep.Recording(path)


def test_booleans_are_0_or_1(tmp_path):
    path = tmp_path / "a.vtkhdf"
    recorder = substep.Recorder(path, parts={"p": substep.Part(fields={"lit": "1"})})
    for k in range(2):
        recorder.append(k, {"p": {"points": GOOD, "lit": GOOD[:, 0] > 1}})
    recorder._release()
    file = Path(f"{path}.journal")
    specs = (Spec("p", "points", "<f8", (3,)), Spec("p", "lit", "|b1", ()))
    right = bytes(Encoder().encode(0, 0.0, specs, (GOOD, np.zeros(5, bool))))
    wrong = bytes(Encoder().encode(0, 0.0, specs, (GOOD, np.full(5, 7, "u1").view(bool))))
    assert right != wrong
    file.write_bytes(file.read_bytes().replace(right, wrong))
    with substep.Recording(path) as recording:
        recording.frame(1)
        with pytest.raises(CorruptError, match="p/lit: expected booleans"):
            recording.frame(0)


def test_max_bytes(journal):
    with substep.Recording(journal, max_bytes=239) as recording:
        with pytest.raises(FormatError, match="max_bytes"):
            recording.frame(0)
        recording["p"].points(0)
    with pytest.raises(FormatError, match="max_bytes"):
        substep.Recording(journal, max_bytes=239, recover=True)
    assert_frames(journal, 4, max_bytes=240)
    packed = substep.pack(journal)
    with pytest.raises(FormatError, match="metadata: larger than max_bytes"):
        substep.Recording(packed, max_bytes=100)
    assert_frames(packed, 4, max_bytes=1000)
    with pytest.raises(InputError, match="max_bytes"):
        substep.Recording(packed, max_bytes=0)


def test_huge_declared_sizes_in_hdf5(packed):
    points = "VTKHDF/Points"
    whole = packed.read_bytes()
    for make in (
        lambda old: {"shape": (2**38, 3), "dtype": "f8", "chunks": (2**10, 3)},
        lambda old: {"shape": (20, 3), "dtype": "f8", "chunks": (7, 3), "maxshape": (None, 3)},
        lambda old: {"shape": (20, 3), "dtype": "f8"},
        lambda old: {"data": np.zeros((20, 4))},
        lambda old: {"data": old[:-1]},
        lambda old: {"data": old, "chunks": (2**22, 3), "maxshape": (None, 3)},
        lambda old: {"data": h5py.Empty("f8")},
    ):
        packed.write_bytes(whole)
        replace(packed, points, make)
        with substep.Recording(packed) as recording, pytest.raises(CorruptError, match="Points"):
            recording.frame(0)
    for name in ("substep/metadata", "substep/counts", "substep/crc32", "VTKHDF/Steps/Values"):
        packed.write_bytes(whole)
        replace(
            packed,
            name,
            lambda old: {"shape": (2**40, *old.shape[1:]), "dtype": old.dtype, "chunks": True},
        )
        with pytest.raises(CorruptError):
            substep.Recording(packed)


def test_data_elsewhere_foreign_filters_and_objects_are_refused(packed, tmp_path):
    points = "VTKHDF/Points"
    whole = packed.read_bytes()
    secret = tmp_path / "secret.bin"
    with h5py.File(packed) as file:
        secret.write_bytes(file[points][...].tobytes())
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["Points"] = np.zeros((20, 3))

    def external(file):
        file.create_dataset(points, (20, 3), "f8", external=[(str(secret), 0, 480)])

    def external_link(file):
        file[points] = h5py.ExternalLink(str(tmp_path / "other.h5"), "Points")

    def soft_link(file):
        file["elsewhere"] = np.zeros((20, 3))
        file[points] = h5py.SoftLink("/elsewhere")

    def virtual(file):
        layout = h5py.VirtualLayout((20, 3), "f8")
        layout[...] = h5py.VirtualSource(str(tmp_path / "other.h5"), "Points", (20, 3))
        file.create_virtual_dataset(points, layout)

    def foreign_filter(file):
        file.create_dataset(points, data=np.zeros((20, 3)), compression="lzf")

    def objects(file):
        file.create_dataset(points, (20, 3), h5py.vlen_dtype(np.uint8))

    def opaque(file):
        file.create_dataset(points, (20, 3), np.dtype("V8"))

    def group(file):
        file.create_group(points)

    def nothing(file):
        pass

    for tamper, reason in [
        (external, "other files"),
        (external_link, "hard links"),
        (soft_link, "hard links"),
        (virtual, "other files"),
        (foreign_filter, "filter 32000"),
        (objects, "not an array of numbers"),
        (opaque, "not an array of numbers"),
        (group, "not a dataset"),
        (nothing, "Points"),
    ]:
        packed.write_bytes(whole)
        with h5py.File(packed, "r+") as file:
            del file[points]
            tamper(file)
        with substep.Recording(packed) as recording, pytest.raises(CorruptError, match=reason):
            recording.frame(0)
    packed.write_bytes(whole)
    with h5py.File(packed, "r+") as file:
        del file["substep"]
        file["substep"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/")
    with pytest.raises(CorruptError, match="not a recording"):
        substep.Recording(packed)
    packed.write_bytes(whole)
    with h5py.File(packed, "r+") as file:
        file["substep"].attrs["format_version"] = "2"
    with pytest.raises(CorruptError, match="no number"):
        substep.Recording(packed)


def test_files_of_others(tmp_path):
    path = tmp_path / "x"
    with h5py.File(path, "w") as file:
        file["x"] = [1]
    with pytest.raises(CorruptError, match="not a recording"):
        substep.Recording(path)
    np.savez(tmp_path / "y.npz", x=np.array([{}], dtype=object))
    with pytest.raises(CorruptError, match="neither"):
        substep.Recording(tmp_path / "y.npz")
    path.write_bytes(b"")
    with pytest.raises(TruncatedError):
        substep.Recording(path)
