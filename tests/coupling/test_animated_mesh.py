"""Animated surfaces as obstacles: they push as bodies do, and displace their volume."""

import numpy as np
import pytest
import substep
from substep import FormatError, InputError, geometry
from substep.geometry import AnimatedMesh

STEP, SPEED = 1 / 240, 0.5


def methods(colliders):
    """A block between x = 0 and 0.4 by each method, before a piston at x = 0."""
    h = 0.05
    x = substep.fill_box((0, 0, 0), (0.4, 0.2, 0.2), h)
    still = {"gravity": (0, 0, 0), "colliders": colliders}
    soft = substep.mpm.NeoHookean(1000, 1e4, 0.3)
    return {
        "pbd": lambda: substep.PositionBasedDynamics(x, 1.0, dtype="float64", step=STEP, **still),
        "springs": lambda: substep.MassSpring(
            x, np.zeros((0, 2), int), 1.0, 1.0, step=STEP, **still
        ),
        "mpm": lambda: substep.MaterialPointMethod(x, soft, cell=2 * h, volume=h**3, **still),
        "grid": lambda: substep.GridLiquid(
            x, cell=2 * h, bounds=((-0.1, 0, 0), (1, 0.2, 0.6)), **still
        ),
        "pbf": lambda: substep.PositionBasedFluid(x, h, **still),
    }


@pytest.mark.parametrize(
    ("method", "bound"),
    [("pbd", 1e-12), ("springs", 1e-5), ("mpm", 5e-4), ("grid", 5e-4), ("pbf", 2e-3)],
)
def test_a_translation_pushes_as_a_body_that_moves(method, bound):
    """To rounding, to Newton's tolerance, and with grids or liquids to 1 or 4 % of the spacing."""
    slab = substep.Collider(substep.Box((0.3, 6, 8), (-0.15, 1, 0)), velocity=(SPEED, 0, 0))
    alone = methods([slab])[method]()
    corners = np.array([[-0.15, -2, -4], [-0.15, 4, -4], [-0.15, 4, 4], [-0.15, -2, 4]])
    times = np.array([0, 0.1, 0.25, 0.4])
    piston = AnimatedMesh(
        times, corners + SPEED * times[:, None, None] * [1, 0, 0], [[0, 1, 2], [0, 2, 3]]
    )
    pushed = methods(piston.make_colliders(0.3))[method]()
    world = substep.World({"piston": piston, "pushed": pushed}, step=STEP)
    total = np.zeros((2, 3))
    for _ in range(48):
        alone.advance(STEP)
        world.advance(STEP)
        total += slab.impulse, sum(np.array(c.impulse) for c in pushed.colliders)
    x, other = np.array(alone.positions), np.array(pushed.positions)
    assert x[:, 0].min() > 0.1 and np.abs(x - other).max() < bound
    assert total[0, 0] < -0.1
    np.testing.assert_allclose(total[1], total[0], atol=-0.01 * total[0, 0])


def volume(x, faces):
    a, b, c = (x[faces[:, k]] for k in range(3))
    return np.einsum("ij,ij->", np.cross(a, b), c) / 6


@pytest.mark.slow
def test_a_ball_that_swells_in_water_displaces_its_volume():
    """Water of volume V about a ball of V_b at z_b fills A = 0.16 m^2 to H = (V + V_b) / A, so that
    its mean height is (A H^2 / 2 - V_b z_b) / V."""
    h, center = 0.04, np.array([0.2, 0.2, 0.16])
    ball = geometry.sphere_mesh(1.0, subdivisions=2)
    times = np.linspace(0, 0.5, 6)
    part = times / 0.5
    radii = 0.1 + 0.05 * part**2 * (3 - 2 * part)
    swelling = AnimatedMesh(times, center + radii[:, None, None] * ball.vertices, ball.faces)
    x = substep.fill_box((0, 0, 0), (0.4, 0.4, 0.32), h)
    x = x[np.linalg.norm(x - center, axis=1) > 0.1 + h / 2]
    tank = substep.Collider(substep.Box((0.4, 0.4, 2), (0.2, 0.2, 1)), hollow=True)
    water = substep.PositionBasedFluid(x, h, colliders=[tank, *swelling.make_colliders(0.08)])
    world = substep.World({"swelling": swelling, "water": water})
    heights = []
    V, A = len(x) * h**3, 0.16
    before = volume(swelling.positions, ball.faces)
    world.advance(1.2)
    after = volume(swelling.positions, ball.faces)
    for ball_volume in (before, after):
        H = (V + ball_volume) / A
        heights.append((A * H**2 / 2 - ball_volume * center[2]) / V)
    assert heights[1] > 1.2 * heights[0]
    assert water.positions[:, 2].mean() == pytest.approx(heights[1], rel=0.03)
    assert np.linalg.norm(water.positions - center, axis=1).min() > 0.14


def test_curves_go_through_frames_and_quadratics_are_exact():
    t = np.array([0, 0.1, 0.25, 0.5, 0.6])
    c = np.array([[1.0, 2, 3], [0, 1, 0], [0, 0, 1]])
    v, a = np.array([1.0, 2, 3]), np.array([3.0, 1, -1])
    mesh = AnimatedMesh(t, c + t[:, None, None] * v + t[:, None, None] ** 2 * a, [[0, 1, 2]])
    for s in (0, 0.05, 0.1, 0.17, 0.3, 0.49, 0.55):
        x, rate = mesh.at(s)
        np.testing.assert_allclose(x, c + s * v + s**2 * a, atol=1e-13)
        np.testing.assert_allclose(rate, np.broadcast_to(v + 2 * s * a, (3, 3)), atol=1e-12)
    cubic = AnimatedMesh(t, c + t[:, None, None] ** 3 * a, [[0, 1, 2]])
    d = 1e-6
    for s in (0.05, 0.17, 0.55):  # another curve; its rate is its own
        rate = (cubic.at(s + d)[0] - cubic.at(s - d)[0]) / (2 * d)
        np.testing.assert_allclose(cubic.at(s)[1], rate, atol=1e-7)
    np.testing.assert_array_equal(mesh.at(0.6)[0], mesh.at(9.0)[0])
    assert not mesh.at(0.6)[1].any()
    mesh.advance(0.3)
    np.testing.assert_allclose(mesh.positions, mesh.at(0.3)[0])


def test_worlds_with_animated_meshes_go_on_from_their_states():
    ends = []
    for split in (False, True):
        ball = geometry.sphere_mesh(0.1, subdivisions=1)
        mesh = AnimatedMesh([0, 0.1], [ball.vertices, 1.5 * ball.vertices], ball.faces)
        x = substep.fill_box((0.12, -0.1, -0.1), (0.32, 0.1, 0.1), 0.05)
        water = substep.PositionBasedFluid(
            x, 0.05, gravity=(0, 0, 0), colliders=mesh.make_colliders(0.05)
        )
        world = substep.World({"mesh": mesh, "water": water})
        world.advance(0.05)
        if split:
            kept = world.state()
            world.advance(0.02)
            world.restore(kept)
            world.threads = 2
        world.advance(0.05)
        ends.append(water.positions)
    assert np.array_equal(*ends) and ends[0][:, 0].min() > 0.12


def put(path, mesh):
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces]
    path.write_text("\n".join(lines))


def test_sequences_of_files_are_read_in_the_order_of_their_numbers(tmp_path):
    box = geometry.box_mesh((1, 2, 3))
    for k in (1, 2, 9, 10, 11):
        put(tmp_path / f"frame_{k}.obj", geometry.transform_mesh(box, translation=(k, 0, 0)))
    (tmp_path / "notes.txt").write_text("no mesh")
    mesh = AnimatedMesh.from_files(tmp_path, fps=10, scale=0.1, up="y")
    np.testing.assert_allclose(mesh.times, np.arange(5) / 10)
    places = [mesh.at(t)[0].mean(axis=0) for t in mesh.times]
    # x of the files becomes y where y points upwards
    np.testing.assert_allclose(places, [[0, 0.1 * k, 0] for k in (1, 2, 9, 10, 11)], atol=1e-12)
    put(tmp_path / "frame_12.obj", geometry.box_mesh((1, 1, 1)))
    (tmp_path / "frame_12.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3")
    with pytest.raises(FormatError, match=r"frame_12.obj: expected the triangles of frame_1.obj"):
        AnimatedMesh.from_files(tmp_path, fps=10)
    (tmp_path / "empty").mkdir()
    with pytest.raises(FormatError, match="expected meshes"):
        AnimatedMesh.from_files(tmp_path / "empty", fps=10)


def test_what_is_wrong_is_refused_by_name():
    box = geometry.box_mesh((1, 1, 1))
    good = {"times": [0, 1], "vertices": [box.vertices] * 2, "faces": box.faces}
    for name, wrong in (
        ("times", [0, 0]),
        ("times", [1, 2]),
        ("vertices", [box.vertices]),
        ("vertices", [box.vertices, box.vertices * np.nan]),
        ("vertices", [box.vertices, box.vertices * 1e100]),
        ("faces", [[0, 1, 99]]),
        ("step", 0.0),
    ):
        with pytest.raises(InputError, match=f"^{name}"):
            AnimatedMesh(**good | {name: wrong})
