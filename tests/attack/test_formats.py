"""Files from strangers: what was found, and some hundred mutations of every format."""

import signal
import time

import formats
import pytest
import substep

READ = {"a million fill values", "obj: 900,000 corners"}  # these are files like others


def test_past_findings():
    """Each is refused in a second, with 2 GiB of memory."""
    got = formats.relive()
    expected = {why: ("read" if why in READ else "refused", "") for why in got}
    assert got == expected


def test_examples_are_read():
    own = [f for f in formats.FORMATS if f.weight > formats.MESHIO]
    files = [(f.name, f.read, data) for f in own for data in formats.examples(f)[:1]]
    got = formats.run(files.__getitem__, len(files))
    assert got == [(name, "read", "") for name, _, _ in files]


def test_mutations():
    result = formats.attack(600, seed=1)
    assert result["wrong"] == 0, result["findings"]
    tallies = [result["formats"][f.name] for f in formats.FORMATS if f.weight > formats.MESHIO]
    assert min(sum(tally.values()) for tally in tallies) > 10
    read = sum(tally["read"] for tally in tallies)
    assert 60 < read < 500  # else the mutations are too weak, or nothing can be read at all


@pytest.mark.parametrize("name", ["a.nc", "a.mdpa"])
def test_ctrl_c_while_a_library_comes_to_no_end(tmp_path, name):
    pytest.importorskip("meshio")
    if formats.SANITIZED and name == "a.mdpa":
        pytest.skip("the process that reads meshes has few addresses, ASan takes terabytes")
    mdpa = b"Begin ModelPartData\nEnd ModelPartData\nBegin Nodes\n 1 0 0 0\n"
    (tmp_path / name).write_bytes(formats.endless_heap() if name == "a.nc" else mdpa)
    read = substep.open_field if name == "a.nc" else substep.geometry.read_mesh
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.setitimer(signal.ITIMER_REAL, 0.4)
    begun = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            read(tmp_path / name)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert time.monotonic() - begun < 5
