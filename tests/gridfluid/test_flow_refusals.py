"""Flows that fill their box: what is refused, what runs out of memory, and how they are told."""

import subprocess
import sys

import numpy as np
import pytest
import substep
from substep import InputError, SolverError
from substep.gridfluid import FlowEmitter, Inflow, Wall

SQUARE = [(0.0, 0.0), (1.0, 1.0)]


@pytest.mark.parametrize("cfl", [1e-300, 1e306, 1e308])
def test_any_courant_number_gives_a_step(cfl):
    water = substep.fill_box((0, 0), (0.5, 0.5), 0.0625)
    for made in (
        substep.GridFlow(SQUARE, 0.125, velocity=(1.0, 0.0), sides="periodic", cfl=cfl),
        substep.GridLiquid(water, cell=0.125, bounds=SQUARE, cfl=cfl),
    ):
        limit, reason = made.step_limit()
        assert (0 < limit < 1e-100) if cfl < 1 else (1 / 100 < limit < 1 / 20), reason
        made.advance(2 * limit)
        assert made.report.steps == 2


@pytest.mark.parametrize("x", [2.0, -1.0, 1e308, -1e308])
def test_a_depth_out_of_the_box_is_refused(x):
    water = substep.fill_box((0, 0), (0.5, 0.5), 0.0625)
    liquid = substep.GridLiquid(water, cell=0.125, bounds=SQUARE)
    with pytest.raises(InputError, match="points"):
        liquid.depth([[x]])


def test_an_obstacle_over_a_periodic_side_is_given_twice():
    """What docs/grid_flow.md says: from both sides it is the one that stands within, moved."""
    speeds = {}
    for middles in ((0.5,), (0.0, 1.0)):
        balls = [substep.Sphere(0.2, (x, 0.5, 0)) for x in middles]
        flow = substep.GridFlow(
            SQUARE,
            0.125,
            velocity=(1.0, 0.3),
            sides="periodic",
            colliders=balls,
            dtype="float64",
            tolerance=1e-10,
        )
        flow.step(0.01)
        speeds[middles] = flow.velocity
    within, over = speeds.values()
    assert np.allclose(np.roll(within, 4, axis=0), over, atol=1e-6)


def test_an_obstacle_that_comes_to_cover_an_open_box_is_told():
    lid = substep.Collider(substep.Box((4, 4, 4), (0.5, 3.2, 0)), velocity=(0, -1, 0))
    flow = substep.GridFlow(SQUARE, 0.125, sides="open", colliders=[lid], smoke=1.0)
    before = flow.state()
    with pytest.raises(SolverError, match="no fluid"):
        flow.step(2.0)
    assert all(np.array_equal(before[name], x) for name, x in flow.state().items())
    flow.step(0.01)


@pytest.mark.parametrize(
    "shape",
    [
        substep.Sphere(0.2, (0.5, 0.5, 0.5)),
        substep.Box((0.2, 0.2, 1), (0.5, 0.5, -0.6)),
        substep.Capsule(0.1, 1.0, (0.5, 0.5, 0.2), rotation=(0.5, 0.5, 0.5, 0.5)),
    ],
)
def test_an_obstacle_off_the_plane_is_refused(shape):
    with pytest.raises(InputError, match=r"colliders\[0\]: expected one that reaches z = 0"):
        substep.GridFlow(SQUARE, 0.1, colliders=[shape])
    ball = substep.Collider(shape)
    ball.position = (0.5, 0.5, 0.0)
    substep.GridFlow(SQUARE, 0.1, colliders=[ball])
    rising = substep.Collider(shape, velocity=(0, 0, 1))
    substep.GridFlow(SQUARE, 0.1, colliders=[rising])


def test_fields_are_those_that_are_asked_for(monkeypatch):
    flow = substep.GridFlow(SQUARE, 0.25, velocity=(1.0, 0.0), sides="periodic", smoke=1.0)
    every = flow.fields()
    assert list(every) == ["velocity", "pressure", "vorticity", "smoke"]
    some = flow.fields(["smoke", "velocity"])
    assert list(some) == ["smoke", "velocity"]
    for name, (values, unit) in some.items():
        assert np.array_equal(values, every[name][0]) and unit == every[name][1]
    assert np.array_equal(every["vorticity"][0], flow.vorticity)
    with pytest.raises(InputError, match="names"):
        flow.fields(["heat"])
    monkeypatch.delattr(type(flow), "_vorticity")
    flow.fields(["velocity"])


def test_a_restored_state_has_what_sides_give():
    flow = substep.GridFlow(SQUARE, 0.25)
    state = flow.state()
    state["velocity_x"][0] = 5.0
    flow.restore(state)
    assert not flow.velocity_faces[0][0].any()


@pytest.mark.parametrize(
    "told",
    [
        "Wall()",
        "Wall(slip=False, velocity=[1.0, 0.0])",
        "Wall(heat_flux=2.0)",
        "Inflow(velocity=[1.0, 0.0], temperature=0.0)",
        "FlowEmitter(region=Sphere(radius=0.5), smoke=0.0, heating=3.0)",
    ],
)
def test_what_is_given_tells_what_is_in_it(told):
    names = {"Wall": Wall, "Inflow": Inflow, "FlowEmitter": FlowEmitter, "Sphere": substep.Sphere}
    assert repr(eval(told, names)) == told


def test_many_vectors_are_told_by_their_number():
    assert repr(Inflow(np.ones((8, 2)))) == "Inflow(velocity=array of shape (8, 2))"


@pytest.mark.skipif(sys.platform != "linux", reason="limits memory")
def test_memory_that_runs_out_is_a_memory_error(tmp_path):
    program = f"""if True:
        import resource
        import numpy as np
        import substep
        flow = substep.GridFlow([(0, 0, 0), (1, 1, 1)], 1 / 80, smoke=1.0, threads=1)
        path = {str(tmp_path / "flow")!r}
        flow.save(path)
        points = np.full((100000, 3), 0.5)
        calls = dict(
            velocity=lambda: flow.velocity, vorticity=lambda: flow.vorticity,
            sample=lambda: flow.sample(points), state=flow.state, load=lambda: flow.load(path),
        )
        pages = int(open("/proc/self/statm").read().split()[0])
        limit = pages * resource.getpagesize() + (64 << 20)
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
        refused, passed = set(), set()
        for name, call in calls.items():
            ballast = []
            try:
                while True:
                    ballast.append(bytearray(1 << 20))
            except MemoryError:
                pass
            while ballast and name not in passed:
                del ballast[-1:]
                try:
                    call()
                    passed.add(name)
                except MemoryError:
                    refused.add(name)
        resource.setrlimit(resource.RLIMIT_AS, 2 * (resource.RLIM_INFINITY,))
        print(sorted(refused & passed))
        """
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout == "['load', 'sample', 'state', 'velocity', 'vorticity']\n", done
