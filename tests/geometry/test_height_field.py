"""Height fields as obstacles: distances to what they say they are, and what rests on them."""

import pickle

import numpy as np
import pytest
import substep
from substep import InputError, geometry

WAVES = 0.35  # amplitude [m]


def waves(x, y):
    return WAVES * np.sin(1.1 * x) * np.cos(0.9 * y)


def waved(spacing=0.2, half=3.0, **place):
    axis = np.arange(-half, half + spacing / 2, spacing)
    return substep.HeightField(
        waves(axis[:, None], axis), spacing, (axis[0], axis[0], 0.0), **place
    )


def tilted(angle, half=2.0, spacing=0.1, heading=0.0):
    """Ground that falls along the heading."""
    axis = np.arange(-half, half + spacing / 2, spacing)
    along = axis[:, None] * np.cos(heading) + axis * np.sin(heading)
    return substep.HeightField(-np.tan(angle) * along, spacing, (axis[0], axis[0], 0.0))


def test_a_tilted_plane_is_a_plane():
    ground = substep.Collider(tilted(0.5, heading=0.7))
    normal = (np.sin(0.5) * np.cos(0.7), np.sin(0.5) * np.sin(0.7), np.cos(0.5))
    plane = substep.Collider(substep.Plane(normal))
    x = np.random.default_rng(0).uniform(-0.6, 0.6, (5000, 3))
    np.testing.assert_allclose(ground.distance(x), plane.distance(x), atol=1e-13)
    np.testing.assert_allclose(ground.gradient(x), plane.gradient(x), atol=1e-12)


def test_the_surface_is_that_of_the_spline_and_between_the_heights():
    """H = h + spacing^2 / 6 lap h, of which the next term is of fourth order."""
    random = np.random.default_rng(1)
    for spacing in (0.2, 0.1):
        ground = substep.Collider(waved(spacing))
        x = random.uniform(-2, 2, (2000, 3))
        h = waves(x[:, 0], x[:, 1])
        x[:, 2] = h - spacing**2 / 6 * (1.1**2 + 0.9**2) * h
        assert np.abs(ground.distance(x)).max() < 0.1 * spacing**4
    rough = random.uniform(-1, 1, (30, 30))
    ground = substep.Collider(substep.HeightField(rough, 0.5))
    x = random.uniform((0, 0, 1.0), (14.5, 14.5, 1.1), (2000, 3))
    assert (ground.distance(x) > 0).all()
    x[:, 2] = -1.0
    inside = np.minimum(x[:, :2], 14.5 - x[:, :2]).min(axis=1)
    assert (ground.distance(x[inside > 0.5]) < 0).all()


@pytest.mark.parametrize("kind", ["waves", "rough"])
def test_the_distance_is_the_least_to_the_surface(kind):
    """Points of the surface are found by dropping on it; none may be nearer than the distance."""
    random = np.random.default_rng(2)
    if kind == "waves":
        field, low, high = waved(0.25), -3.0, 3.0
    else:
        field, low, high = substep.HeightField(random.uniform(-1, 1, (25, 25)), 0.25), 0.0, 6.0
    ground = substep.Collider(field)
    axis = np.linspace(low, high, 241)
    surface = np.stack([*np.meshgrid(axis, axis, indexing="ij"), np.zeros((241, 241))], -1)
    surface = surface.reshape(-1, 3)
    below, above = np.full(len(surface), -1.5), np.full(len(surface), 1.5)
    for _ in range(40):  # bisection along z, with the border as part of the ground
        surface[:, 2] = (below + above) / 2
        inside = ground.distance(surface) < 0
        below, above = (
            np.where(inside, surface[:, 2], below),
            np.where(inside, above, surface[:, 2]),
        )
    interior = (np.abs(surface[:, :2] - (low + high) / 2) < (high - low) / 2 - 1e-9).all(axis=1)
    surface = surface[interior]
    x = random.uniform((low + 1.5, low + 1.5, -1.2), (high - 1.5, high - 1.5, 2.5), (400, 3))
    d = ground.distance(x)
    least = np.array([np.linalg.norm(surface - p, axis=1).min() for p in x])
    near = np.abs(d) < 1.4
    assert near.sum() > 200
    assert (np.abs(d) <= least + 1e-9)[near].all()
    assert (least - np.abs(d))[near].max() < (0.01 if kind == "waves" else 0.06)  # of the sampling
    foot = x - d[:, None] * ground.gradient(x)
    assert np.abs(ground.distance(foot))[near].max() < 1e-9


def test_what_is_below_comes_out_at_the_top_however_deep_and_there_is_no_bottom():
    ground = substep.Collider(waved(half=6.0))
    x = np.random.default_rng(3).uniform((-1, -1, -4), (1, 1, -1), (500, 3))
    assert (ground.distance(x) < 0).all() and (ground.gradient(x)[:, 2] > 0.5).all()
    assert ground.distance([[0, 0, -1e3]])[0] == -6.0  # to a side, which is nearer
    body = substep.PositionBasedDynamics(x, 1.0, [], colliders=[ground], contact_margin=0.01)
    body.advance(1 / 60)
    assert (body.positions[:, 2] > -WAVES - 0.1).all()
    assert (ground.distance(body.positions) > 0).all()


def test_beyond_the_border_is_nothing():
    ground = substep.Collider(substep.HeightField(np.ones((5, 9)), 0.5, (0, 0, -1)))
    x = [[-1, 1, -3], [3, 1, -3], [1, 5, -1], [-0.3, 1, 0.4], [2.3, 4.4, 1.2], [1, 2, 5]]
    expected = [1, 1, 1, 0.5, np.hypot(0.5, 1.2), 5]
    np.testing.assert_allclose(ground.distance(x), expected, atol=1e-14)
    drop = substep.PositionBasedDynamics(
        [[-0.01, 1, 0.2], [0.01, 1, 0.2]], 1.0, [], colliders=[ground]
    )
    drop.advance(0.5)
    assert drop.positions[0, 2] < -0.9 and drop.positions[1, 2] >= 0


def test_two_heights_along_an_axis_are_enough_and_a_turned_field_is_turned():
    ramp = substep.HeightField([[0, 0], [1, 1]], 1.0, center=(1, 2, 3))
    ground = substep.Collider(ramp)
    np.testing.assert_allclose(ground.distance([[1.5, 2.5, 3.5]]), 0, atol=1e-15)
    normal = np.array([[-1, 0, 1]]) / np.sqrt(2)
    np.testing.assert_allclose(ground.gradient([[1.5, 2.5, 3.6]]), normal, atol=1e-15)
    turned = substep.HeightField(np.zeros((3, 3)), 1.0, (-1, -1, 0), rotation=(1, -1, 0, 0))
    np.testing.assert_allclose(
        substep.Collider(turned).gradient([[0.1, 0.5, 0.2]]), [[0, 1, 0]], atol=1e-15
    )
    sheet = substep.PositionBasedFluid([[0.0, 0.2]], 0.1, colliders=[turned])  # 2D: y is up
    sheet.advance(0.5)
    assert 0 < sheet.positions[0, 1] < 0.1


def block(method, ground, middle):
    """512 particles, which fall; a liquid is thick, and stands in a tank."""
    size, spacing = 0.5, 0.0625
    x = spacing * (np.indices((8, 8, 8)).reshape(3, -1).T + 0.5) + middle - size / 2
    if method == "pbd":
        grains = substep.pbd.ParticleCollision(spacing / 2, friction=0.4)
        return substep.PositionBasedDynamics(x, 1.0, [grains], colliders=[ground])
    if method == "pbf":
        tank = substep.Collider(substep.Box((1, 1, 4), (middle[0], middle[1], 0)), hollow=True)
        return substep.PositionBasedFluid(x, spacing, viscosity=20.0, colliders=[ground, tank])
    return substep.MaterialPointMethod(
        x, substep.mpm.Sand(), cell=2 * spacing, volume=spacing**3, colliders=[ground]
    )


@pytest.mark.parametrize("method", ["pbd", "pbf", "mpm"])
@pytest.mark.parametrize("kind", ["tilted", "waved"])
def test_particles_come_to_rest_and_none_is_below(method, kind):
    field, x = (tilted(0.15), 0.0) if kind == "tilted" else (waved(), -1.43)
    ground = substep.Collider(field, friction=0.0 if method == "pbf" else 1.0)
    body = block(method, ground, np.array([x, 0.0, 0.35]))
    depths = []
    body.advance(2.0, lambda b: depths.append(ground.distance(b.positions).min()))
    assert min(depths) > -1e-5
    speed = np.linalg.norm(body.velocities, axis=1)
    assert np.sqrt((speed**2).mean()) < 0.15
    assert np.median(ground.distance(body.positions)) < 0.3


def test_cloth_lies_in_a_valley_and_newtons_method_converges():
    sheet = geometry.grid_mesh(16, 16, (1.2, 1.2))
    x = sheet.vertices + np.array([-1.43, 0.0, 0.1])
    ground = substep.Collider(waved(), friction=0.3)
    cloth = substep.MassSpring.from_mesh(
        geometry.TriangleMesh(x, sheet.faces),
        density=0.3,
        stiffness=300.0,
        colliders=[ground],
        step=0.01,
        on_fail="raise",
    )
    cloth.advance(1.5)
    d = ground.distance(cloth.positions)
    assert (d > 0).all() and np.median(d) < 0.05
    assert cloth.diagnostics()["kinetic_energy"] < 1e-2


def test_the_weight_of_what_lies_there_is_what_the_ground_is_given():
    ground = substep.Collider(waved(), friction=1.0)
    body = block("pbd", ground, np.array([-1.43, 0.0, 0.35]))
    body.advance(1.5)
    body.advance(0.5)
    assert -ground.impulse[2] / ground.duration == pytest.approx(512 * 9.81, rel=0.02)


def test_a_field_is_a_value_and_pickles():
    field = waved(center=(1, 0, 0))
    again = pickle.loads(pickle.dumps(field))
    assert again == field and hash(again) == hash(field) and field != waved()
    assert repr(field) == "HeightField(31 x 31 heights, spacing=0.2)"
    x = np.random.default_rng(5).uniform(-2, 2, (100, 3))
    copied = pickle.loads(pickle.dumps(substep.Collider(field)))
    np.testing.assert_array_equal(copied.distance(x), substep.Collider(field).distance(x))
    with pytest.raises(ValueError, match="read-only"):
        field.heights[0, 0] = 1.0
    mesh = field.mesh()
    assert not mesh.report().closed and len(mesh.faces) == 2 * 30 * 30
    np.testing.assert_array_equal(mesh.vertices[31 * 2 + 3, 2], field.heights[2, 3])
    assert (mesh.face_normals[:, 2] > 0).all()


FLAT = np.zeros((4, 5))
BAD = {
    "nan": (
        lambda: substep.HeightField(np.where(np.eye(4, 5) > 0, np.nan, 0), 1.0),
        r"heights\[0, 0\]",
    ),
    "infinite": (lambda: substep.HeightField(FLAT + np.inf, 1.0), r"heights\[0, 0\]"),
    "one row": (lambda: substep.HeightField(FLAT[:1], 1.0), "at least 2"),
    "one column": (lambda: substep.HeightField(FLAT[:, :1], 1.0), "at least 2"),
    "empty": (lambda: substep.HeightField(np.zeros((0, 3)), 1.0), "at least 2"),
    "flat list": (lambda: substep.HeightField([0, 1, 2], 1.0), "heights"),
    "three axes": (lambda: substep.HeightField(np.zeros((3, 3, 1)), 1.0), "heights"),
    "spacing 0": (lambda: substep.HeightField(FLAT, 0.0), "spacing"),
    "spacing below 0": (lambda: substep.HeightField(FLAT, -1.0), "spacing"),
    "spacing nan": (lambda: substep.HeightField(FLAT, np.nan), "spacing"),
    "spacing tiny": (lambda: substep.HeightField(FLAT, 1e-200), "spacing"),
    "origin": (lambda: substep.HeightField(FLAT, 1.0, (0, 0)), "origin"),
    "wall": (lambda: substep.HeightField(1001 * np.eye(4), 1.0), r"heights\[0, 0\].*1000"),
    "huge": (lambda: substep.HeightField(FLAT + 1e200, 1.0), "heights"),
    "hollow": (lambda: substep.Collider(substep.HeightField(FLAT, 1.0), hollow=True), "hollow"),
    "moving": (
        lambda: substep.RigidBodies().add(substep.HeightField(FLAT, 1.0), (0, 0, 0)),
        "ground",
    ),
    "mass": (lambda: substep.rigid.mass_properties(substep.HeightField(FLAT, 1.0), 1.0), "mass"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(name):
    make, said = BAD[name]
    with pytest.raises(InputError, match=said):
        make()


def test_bad_types():
    for heights in (FLAT.astype(complex), FLAT.astype(str), None):
        with pytest.raises(TypeError, match="heights"):
            substep.HeightField(heights, 1.0)
