"""Sources of levels that are not what they say, and fields that are written to."""

import copy
import pickle

import numpy as np
import pytest
import substep

AXIS = np.linspace(0, 1, 4)
CORNERS = np.meshgrid(AXIS, AXIS, indexing="ij")
HERE = [[0.5, 0.5]]


class Source:
    """Levels that are all the same, whatever their shape says."""

    shape = (2, 4, 4, 2)

    def __init__(self, level):
        self.level = level

    def __getitem__(self, number):
        return self.level


def field(kind, source):
    if kind == "grid":
        return substep.GridField((AXIS, AXIS), source, times=[0, 1])
    return substep.CurvilinearField(*CORNERS, source, times=[0, 1])


@pytest.mark.parametrize("kind", ["grid", "curvilinear"])
@pytest.mark.parametrize(
    "level",
    [np.ones((2, 2, 2)), np.ones((4, 4)), 1.0, [[1.0], [1.0, 2.0]], np.ones((4, 4, 3))],
    ids=["small", "flat", "number", "ragged", "more"],
)
def test_a_level_of_another_shape_is_refused(kind, level):
    """Foreign memory was read, or the process ended."""
    with pytest.raises(substep.InputError, match="level 0: expected"):
        field(kind, Source(level))(0.0, HERE)


@pytest.mark.parametrize("shape", [(2, 4, 4), np.ones((2, 4, 4, 2)), [[2], [4, 4, 2]], None])
def test_a_source_of_another_shape_is_refused(monkeypatch, shape):
    monkeypatch.setattr(Source, "shape", shape)
    with pytest.raises(substep.InputError, match=r"values: expected shape \(2, 4, 4, 2\), got"):
        field("grid", Source(np.ones((4, 4, 2))))


@pytest.mark.parametrize("level", [np.full((4, 4, 2), "a"), np.full((4, 4, 2), 1j)])
def test_a_level_of_no_real_numbers_is_refused(level):
    with pytest.raises(TypeError, match="level 0: expected real numbers"):
        field("grid", Source(level))(0.0, HERE)


@pytest.mark.parametrize("kind", ["grid", "curvilinear"])
def test_what_a_level_masks_is_land(kind):
    level = np.ma.masked_array(np.full((4, 4, 2), 9.97e36), mask=True)
    level[1:] = 0.5
    flow = field(kind, Source(level))
    assert np.isnan(flow(0.0, [[0.1, 0.5]])).all()
    assert flow(0.0, [[0.8, 0.5]]) == pytest.approx(0.5)


@pytest.mark.parametrize("kind", ["grid", "curvilinear"])
@pytest.mark.parametrize(
    "again", [lambda f: f, copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))]
)
def test_a_field_cannot_be_changed(kind, again):
    """Assigned axes were read beyond their ends."""
    flow = again(field(kind, np.ones((2, 4, 4, 2))))
    for name in ("axes", "x", "times", "dimension", "steady", "radius", "origin", "sources"):
        with pytest.raises((substep.InputError, AttributeError), match=name):
            setattr(flow, name, None)
    arrays = [flow.times, *(flow.axes if kind == "grid" else (flow.x, flow.y))]
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 0
    assert flow(0.0, HERE) == pytest.approx(1.0)


def test_times_that_are_far_apart():
    """Their distance over the step had no integer."""
    level = np.ones((2, 4, 4, 2))
    for times in ([0, 1e308], [-1e308, 1e308]):
        flow = substep.GridField((AXIS, AXIS), level, times=times, memory_limit=1)
        moved = substep.advect(flow, HERE, (0, 0.1), 0.01)
        assert moved.positions[-1] == pytest.approx(np.array(HERE) + 0.1)
