"""The scenes of flows on a grid show what others computed and measured."""

import numpy as np
import pytest
import substep
from substep import scenes
from substep.scenes.gridfluid import karman


def run(name, tmp_path, frames=5, **parameters):
    return scenes.run(scenes.load(name), parameters, tmp_path, frames=frames)


def test_a_cylinder_sheds_vortices_as_often_as_measured(tmp_path):
    """Williamson's Strouhal number; near walls and coarse cells make it larger."""
    outcome = run("karman", tmp_path, frames=141, duration=70.0, cells=6, width=10)
    with substep.Recording(outcome.recording) as recording:
        found = recording["cylinder"].field("strouhal", -1)[0]
        forces = [
            np.array([recording["cylinder"].field(name, k)[0] for k in range(84, 141)])
            for name in ("drag", "lift")
        ]
        assert recording["flow"].field("vorticity", 0).shape == (156, 60)
    assert karman.strouhal(100) == pytest.approx(0.1643, abs=1e-4)
    assert found == pytest.approx(karman.strouhal(100), rel=0.1)
    assert f"Strouhal number {found:.4f}" in outcome.summary
    drag, lift = forces
    assert 1.2 < drag.mean() < 1.6 and abs(lift.mean()) < 0.05 and 0.1 < lift.std() < 0.4


def test_forces_on_the_cylinder_are_those_of_each_step():
    scene = scenes.load("karman")
    parameters = scene.complete({"cells": 4, "width": 6})
    flows = [scene.build(parameters, 0) for _ in range(2)]
    flows[0].advance(1.0)
    for k in range(5):
        flows[1].advance(0.2 * (k + 1) - flows[1].time)
    one, several = (flow.measured["forces"] for flow in flows)
    np.testing.assert_allclose(one, several, rtol=0.02, atol=0.02)
    assert 1 < one[0] < 5


def test_profiles_of_the_cavity_are_those_of_others(tmp_path):
    """Ghia et al. (1982), within the 0.02 that a fine grid has at Re 1000."""
    outcome = run("cavity", tmp_path, frames=3, reynolds=100.0, cells=32, duration=10.0)
    assert "of Ghia et al. (1982)" in outcome.summary
    scene = scenes.load("cavity")
    module = __import__("substep.scenes.gridfluid.cavity", fromlist=["error"])
    with substep.Recording(outcome.recording) as recording:
        velocity = recording["flow"].field("velocity", -1)
        assert module.error(velocity, 100) < 0.02
        assert module.error(recording["flow"].field("velocity", 1), 100) < 0.03
    assert module.error(velocity, 1000) > 0.1 and module.error(velocity, 200) is None
    assert scene.build(scene.complete({"reynolds": 50.0, "cells": 8}), 0).words().count(";") == 0


def test_smoke_rises_and_flows_around_the_ball(tmp_path):
    outcome = run(
        "smoke", tmp_path, frames=4, cells=16, duration=1.5, fields="smoke,temperature,velocity"
    )
    assert outcome.summary.startswith("smoke up to ")
    with substep.Recording(outcome.recording) as recording:
        assert set(recording.parts) == {"flow", "ball"}
        assert list(recording.parts["flow"].fields) == ["smoke", "temperature", "velocity"]
        assert recording.parts["flow"].cells == (16, 16, 24)
        first, last = (recording["flow"].field("smoke", k) for k in (1, -1))
        tops = [int(np.flatnonzero((smoke > 0.05).any(axis=(0, 1)))[-1]) for smoke in (first, last)]
        assert tops[0] < tops[1] and tops[1] >= 10
        assert last.min() > -1e-6 and last.max() < 1 + 1e-6
        ball = np.asarray(recording.parts["ball"].points)
        np.testing.assert_allclose(ball.mean(axis=0), [0.5, 0.5, 0.62], atol=0.01)


@pytest.mark.parametrize(
    ("name", "parameters", "match"),
    [
        ("karman", {"reynolds": 0.0}, "reynolds"),
        ("karman", {"cells": 2}, "cells"),
        ("cavity", {"reynolds": float("nan")}, "reynolds"),
        ("cavity", {"cells": 8.5}, "cells"),
        ("smoke", {"radius": 0.5}, "radius"),
        ("smoke", {"fields": "smoke,fish"}, "fields"),
        ("smoke", {"heat": -1.0}, "heat"),
    ],
)
def test_wrong_parameters_are_named(tmp_path, name, parameters, match):
    with pytest.raises(substep.InputError, match=match):
        run(name, tmp_path, **parameters)
    assert not list(tmp_path.iterdir())
