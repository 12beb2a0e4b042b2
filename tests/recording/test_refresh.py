"""A recording that takes in new frames is whole at any moment, whoever interrupts it or reads."""

import gc
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import substep
from substep.recording.journal import Journal


@pytest.fixture(autouse=True)
def _collected():
    """What there is by now is left alone by the many collections of these tests."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.fixture
def run(tmp_path):
    """A recorder, and a recording of its first frame."""
    path = tmp_path / "a.vtkhdf"
    with substep.Recorder(path, parts={"p": substep.Part()}) as recorder:
        append(recorder, 0)
        with substep.Recording(path) as recording:
            yield recorder, recording


def append(recorder, k):
    recorder.append(float(k), {"p": {"points": [[k, 0.0]]}})


def last(recording):
    return recording["p"].points(-1)[0, 0]


def refresh(recording, at_line):
    """Refresh, and call that with the number of each line that the journal's code comes to."""
    lines = 0

    def trace(frame, event, _):
        nonlocal lines
        if not frame.f_code.co_filename.endswith(("journal.py", "reader.py")):
            return None
        if event == "line":
            lines += 1
            at_line(lines)
        return trace

    before = sys.gettrace()
    gc.collect()
    gc.disable()  # what it collects has lines too
    sys.settrace(trace)
    try:
        recording.refresh()
    finally:
        sys.settrace(before)
        gc.enable()
    return lines


def test_an_interrupt_loses_no_frame(run):
    recorder, recording = run
    append(recorder, 1)
    lines = refresh(recording, lambda _: None)
    for wanted in range(1, lines + 1):

        def interrupt(line, wanted=wanted):
            if line == wanted:
                raise KeyboardInterrupt

        append(recorder, wanted + 1)
        with pytest.raises(KeyboardInterrupt):
            refresh(recording, interrupt)
        assert last(recording) in (wanted, wanted + 1)
        assert recording.refresh() == wanted + 2 and last(recording) == wanted + 1


def test_what_is_read_meanwhile_is_whole(run):
    recorder, recording = run
    append(recorder, 1)
    seen = []
    refresh(recording, lambda _: seen.append((len(recording), last(recording))))
    assert set(seen) == {(1, 0), (2, 1)}


def test_one_thread_refreshes_at_a_time(run, monkeypatch):
    recorder, recording = run
    append(recorder, 1)
    walk, walking, most = Journal._walk, [], 0

    def slowly(journal):
        nonlocal most
        walking.append(journal)
        most = max(most, len(walking))
        time.sleep(0.05)
        walk(journal)
        walking.pop()

    monkeypatch.setattr(Journal, "_walk", slowly)
    with ThreadPoolExecutor(2) as threads:
        assert [*threads.map(lambda _: recording.refresh(), range(2))] == [2, 2]
    assert most == 1


@pytest.mark.parametrize("size", [0, 100, -4])
def test_where_a_recording_was_cut_is_told(run, size):
    """Each time, and what was taken in before stays."""
    recorder, recording = run
    append(recorder, 1)
    recording.refresh()
    whole = Path(recording.path).read_bytes()
    end = size % len(whole)
    os.truncate(recording.path, end)
    for read in (recording.refresh, recording.refresh, lambda: recording.frame(1)):
        with pytest.raises(substep.TruncatedError, match=f"the file ends at byte {end}$") as told:
            read()
        assert told.value.offset == end and len(recording) == 2
    Path(recording.path).write_bytes(whole)
    assert recording.refresh() == 2


def test_a_packed_recording_that_is_gone_on_with_is_followed(tmp_path):
    path, parts = tmp_path / "a.vtkhdf", {"p": substep.Part()}
    with substep.Recorder(path, parts=parts) as recorder:
        append(recorder, 0)
    with substep.Recording(path) as recording:
        assert recording.packed and recording.refresh() == 1
        with substep.Recorder(path, parts=parts, resume=True) as recorder:
            append(recorder, 1)
            assert recording.refresh() == 2 and last(recording) == 1 and not recording.packed
            append(recorder, 2)
            assert recording.refresh() == 3
        assert recording.refresh() == 3 and last(recording) == 2 and recording.packed
        with substep.Recorder(path, parts=parts, resume=True) as recorder:
            append(recorder, 3)  # and packed before anyone looks
        assert recording.refresh() == 4 and last(recording) == 3
        path.unlink()
        assert recording.refresh() == 4 and last(recording) == 3
    with pytest.raises(substep.InputError, match="closed"):
        recording.refresh()


@pytest.mark.parametrize("other", [{"scene": "another"}, {"parameters": {"n": 1}}, {"x": 0.5}])
def test_another_run_of_that_name_is_not_taken_for_more_of_this(tmp_path, other):
    path, x = tmp_path / "a.vtkhdf", other.pop("x", 0.0)
    with substep.Recorder(path, parts={"p": substep.Part()}) as recorder:
        append(recorder, 0)
    with substep.Recording(path) as recording:
        with substep.Recorder(
            path, parts={"p": substep.Part()}, overwrite=True, **other
        ) as recorder:
            recorder.append(0.0, {"p": {"points": [[x, 0.0]]}})
            append(recorder, 1)
            assert [recording.refresh() for _ in range(2)] == [1, 1]
        assert recording.refresh() == 1 and last(recording) == 0


# An interrupt between open() and its `with` leaves the file to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interrupt_while_another_file_is_taken_up_loses_no_frame(tmp_path):
    path, parts = tmp_path / "a.vtkhdf", {"p": substep.Part()}
    recorder = substep.Recorder(path, parts=parts)
    append(recorder, 0)
    journal, new = Path(recorder.journal_path), tmp_path / "new"
    short = journal.read_bytes()
    append(recorder, 1)
    long = journal.read_bytes()
    recorder.close()

    def tried(interrupt):
        for content in (short, long):
            new.write_bytes(content)
            os.replace(new, journal)
            if content is short:
                recording = substep.Recording(path)
        with recording:
            try:
                lines = refresh(recording, interrupt)
            except KeyboardInterrupt:
                lines = None
            assert last(recording) == len(recording) - 1 in (0, 1)
            assert recording.refresh() == 2 and last(recording) == 1
        return lines

    lines = tried(lambda _: None)
    assert lines > 50
    for wanted in range(1, lines + 1):

        def interrupt(line, wanted=wanted):
            if line == wanted:
                raise KeyboardInterrupt

        assert tried(interrupt) is None
