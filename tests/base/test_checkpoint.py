"""Checkpoint files whose checksum is right and whose content is not."""

import json
import struct
import sys
import zlib

import numpy as np
import pytest
from substep import CorruptError
from substep.base.checkpoint import read_checkpoint, write_checkpoint

HEADER = {
    "kind": "Toy",
    "values": {"a": "0x1p3"},
    "floats": ["a"],
    "arrays": [["x", "<f8", [2, 2]]],
}


def checkpoint(header, data=bytes(32)):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    lengths = struct.pack("<QQ", len(text), len(data))
    crc = zlib.crc32(data, zlib.crc32(text, zlib.crc32(lengths)))
    return b"SUBSTEPC" + struct.pack("<II", 1, crc) + lengths + text + data


def test_what_is_written_is_read(tmp_path):
    state = {"x": np.eye(3), "lit": np.array([True, False]), "none": np.empty((0, 3)), "a": 0.1}
    write_checkpoint(tmp_path / "a", "Toy", state)
    again = read_checkpoint(tmp_path / "a", "Toy")
    assert again["a"] == 0.1 and again["none"].shape == (0, 3)
    for name in ("x", "lit"):
        np.testing.assert_array_equal(again[name], state[name])
    (tmp_path / "a").write_bytes(checkpoint(HEADER))
    assert read_checkpoint(tmp_path / "a", "Toy")["x"].shape == (2, 2)


@pytest.mark.parametrize(
    "changes",
    [
        {"values": {"a": "0x1p99999"}},  # OverflowError
        {"values": {"a": 3}},
        {"values": 3},
        {"floats": ["b"]},
        {"arrays": [["x", "<f8", [-1]]]},  # as many as there are
        {"arrays": [["x", "<f8", [2, -2]]]},
        {"arrays": [["x", "<f8", [2**62, 2**62]]]},
        {"arrays": [["x", "<f8", [1] * 65]]},
        {"arrays": [["x", "<f8", [2]]]},  # 16 bytes are left over
        {"arrays": [["x", "<f8", ["2", 2]]]},
        {"arrays": [["x", "|O", [4]]]},
        {"arrays": [[["x"], "<f8", [4]]]},
        {"arrays": 4},
    ],
)
def test_headers_that_were_not_written_so(tmp_path, changes):
    (tmp_path / "a").write_bytes(checkpoint({**HEADER, **changes}))
    with pytest.raises(CorruptError, match=str(tmp_path / "a")):
        read_checkpoint(tmp_path / "a", "Toy")


@pytest.mark.parametrize("header", [b"[" * 100_000, b"{}", b"[]", b"\xff", b'{"kind": NaN}'])
def test_headers_that_are_none(tmp_path, header):
    (tmp_path / "a").write_bytes(checkpoint(header))
    with pytest.raises(CorruptError):
        read_checkpoint(tmp_path / "a", "Toy")


def test_booleans_are_0_or_1(tmp_path):
    header = {**HEADER, "arrays": [["x", "|b1", [32]]]}
    (tmp_path / "a").write_bytes(checkpoint(header, b"\1\0" * 15 + b"\7\0"))
    with pytest.raises(CorruptError, match="array x: expected booleans"):
        read_checkpoint(tmp_path / "a", "Toy")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # closed late
def test_no_interrupt_leaves_a_temporary_file(tmp_path):
    class Stop(BaseException):
        pass

    def stop_at(count):
        """Whether it came to that many lines of Python, at the last of which it was stopped."""
        left = count

        def trace(frame, event, argument):
            nonlocal left
            there = list(tmp_path.iterdir()) if event in ("line", "return") else []
            left -= bool(there)  # from when the file is there
            if not left:
                sys.settrace(None)
                raise Stop
            return trace

        before = sys.gettrace()
        sys.settrace(trace)
        try:
            write_checkpoint(tmp_path / "a", "Toy", {"x": np.eye(3)})
        except Stop:
            return True
        finally:
            sys.settrace(before)
        return False

    count = 1
    while stop_at(count):
        assert [path.name for path in tmp_path.iterdir()] in ([], ["a"]), count
        (tmp_path / "a").unlink(missing_ok=True)
        count += 1
    assert count > 3
