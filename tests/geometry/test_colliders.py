"""Obstacles: closed forms, derivatives by finite differences, motion, bounds, bad input."""

import copy
import pickle

import numpy as np
import pytest
import substep
from substep import InputError
from substep.geometry import sphere_mesh


def sampled_box(spacing=0.1):
    axis = np.arange(-1.6, 1.6 + spacing / 2, spacing)
    nodes = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    values = substep.Collider(substep.Box((2, 1.4, 1))).distance(nodes).reshape((len(axis),) * 3)
    return substep.Collider(substep.SignedDistanceField(values, spacing, (-1.6, -1.6, -1.6)))


def hills():
    axis = np.arange(-2.4, 2.5, 0.4)
    return substep.Collider(
        substep.HeightField(0.3 * np.sin(axis[:, None] + 0.5 * axis), 0.4, (-2.4, -2.4, 0.1))
    )


SHAPES = {
    "plane": lambda: substep.Collider(substep.Plane((1, -2, 2), (1, 0, 2))),
    "sphere": lambda: substep.Collider(substep.Sphere(0.7, (0.5, 0, 0))),
    "hollow sphere": lambda: substep.Collider(substep.Sphere(0.7, (0.5, 0, 0)), hollow=True),
    "box": lambda: substep.Collider(substep.Box((1, 0.5, 1.5), (0.1, 0, 0))),
    "hollow box": lambda: substep.Collider(substep.Box((1, 0.5, 1.5), (0.1, 0, 0)), hollow=True),
    "capsule": lambda: substep.Collider(substep.Capsule(0.6, 1.2, (0.1, 0, 0))),
    "hollow capsule": lambda: substep.Collider(substep.Capsule(1.0, 1.2), hollow=True),
    "cylinder": lambda: substep.Collider(substep.Cylinder(0.7, 1.1, (0, 0.1, 0))),
    "hollow cylinder": lambda: substep.Collider(substep.Cylinder(1.0, 1.5), hollow=True),
    "field": sampled_box,
    "heights": hills,
}
points = np.random.default_rng(3).uniform(-2, 2, (3000, 3))


def turned(shape):
    shape.rotation = (0.8, 0.1, -0.5, 0.3)
    return shape


@pytest.fixture(params=SHAPES)
def collider(request):
    return turned(SHAPES[request.param]())


def central_difference(f, x, h):
    axes = h * np.eye(3)
    return np.stack([(f(x + e) - f(x - e)) / (2 * h) for e in axes], axis=-1)


def away_from_kinks(collider):
    """Points about which the first derivatives do not jump."""
    x = points
    h = np.linalg.norm(collider.hessian(x), axis=(1, 2))
    jump = [
        np.abs(collider.gradient(x + e) - collider.gradient(x - e)).max(1) for e in 2e-3 * np.eye(3)
    ]
    return x[np.max(jump, axis=0) < 2 * 4e-3 * (h + 0.5)]


def test_gradient_and_hessian_are_the_derivatives(collider):
    x = away_from_kinks(collider)
    assert len(x) > 2000
    slope = central_difference(collider.distance, x, 1e-6)
    np.testing.assert_allclose(collider.gradient(x), slope, atol=2e-8)
    # The second derivatives of a box and of a spline jump at planes: few points lie that near.
    bend = central_difference(collider.gradient, x, 1e-6)
    close = np.abs(collider.hessian(x) - bend).max((1, 2)) < 2e-5
    assert close.mean() > 0.999


def test_points_of_two_dimensions_lie_in_the_plane(collider):
    x = np.random.default_rng(2).uniform(-1, 1, (50, 2))
    space = np.pad(x, ((0, 0), (0, 1)))
    for method, columns in (("gradient", 2), ("surface_velocity", 2), ("hessian", 2)):
        found, whole = getattr(collider, method)(x), getattr(collider, method)(space)
        np.testing.assert_array_equal(found, whole[:, :columns, ...][..., :columns])
        assert found.flags.c_contiguous
    np.testing.assert_array_equal(collider.distance(x), collider.distance(space))
    with pytest.raises(substep.InputError, match=r"x: expected shape \(n, 3\), got \(1, 4\)"):
        collider.distance([[0, 0, 0, 0]])


def test_no_point_enters_within_its_bound(collider):
    random = np.random.default_rng(5)
    d = collider.distance(points)
    x, d = points[d > 0], d[d > 0]
    assert len(x) > 20
    for _ in range(20):
        direction = random.normal(size=x.shape)
        direction /= np.linalg.norm(direction, axis=1)[:, None]
        there = x + (0.999999 * d / collider.lipschitz)[:, None] * direction
        assert (collider.distance(there) > 0).all()


def test_bound_of_a_sampled_gradient_is_sharp_where_the_distance_is_smooth():
    h = 0.05
    axis = np.arange(-1.4, 1.4 + h / 2, h)
    r = np.sqrt(axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2)
    ball = substep.Collider(substep.SignedDistanceField(r - 1, h, (axis[0],) * 3))
    assert 1 <= ball.lipschitz < 1.08  # the cusp at the centre lies inside and does not count
    vessel = substep.Collider(substep.SignedDistanceField(r - 1, h, (axis[0],) * 3), hollow=True)
    assert vessel.lipschitz == pytest.approx(3**0.5)
    for shape in (ball, vessel, sampled_box()):
        x = np.random.default_rng(8).uniform(-1.5, 1.5, (20000, 3))
        x = x[shape.distance(x) > 0]
        assert np.linalg.norm(shape.gradient(x), axis=1).max() <= shape.lipschitz + 1e-12


def test_closed_forms():
    plane = substep.Collider(substep.Plane((0, 0, 5), (1, 0, 2)))
    np.testing.assert_allclose(plane.distance(points), points[:, 2] - 2, atol=1e-15)
    sphere = substep.Collider(substep.Sphere(0.7, (0.5, 0, 0)))
    d = np.linalg.norm(points - [0.5, 0, 0], axis=1) - 0.7
    np.testing.assert_allclose(sphere.distance(points), d, atol=1e-15)
    np.testing.assert_array_equal(
        substep.Collider(substep.Sphere(0.7, (0.5, 0, 0)), hollow=True).distance(points),
        -sphere.distance(points),
    )
    assert substep.Collider(substep.Sphere(1.0)).gradient([[0, 0, 0]]).tolist() == [[0, 0, 1]]


def test_box_against_its_own_surface():
    half = np.array([1, 0.7, 0.5])
    box = substep.Collider(substep.Box(2 * half))
    nearest = points.clip(-half, half)
    outside = np.linalg.norm(points - nearest, axis=1)
    to_walls = (half - np.abs(points)).min(1)
    expected = np.where(outside > 0, outside, -to_walls)
    np.testing.assert_allclose(box.distance(points), expected, atol=1e-15)


def test_sampled_sphere_loses_what_the_spline_says():
    # f - d = h^2/8 lap d + O(h^3) = h^2 / (4 R) on the surface of a sphere.
    radius, h = 1.0, 0.05
    axis = np.arange(-1.4, 1.4 + h / 2, h)
    r = np.sqrt(axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2)
    field = substep.Collider(substep.SignedDistanceField(r - radius, h, (axis[0],) * 3))
    on = points / np.linalg.norm(points, axis=1)[:, None]
    np.testing.assert_allclose(field.distance(on), h * h / (4 * radius), rtol=1e-2)
    np.testing.assert_allclose(field.gradient(on), on, atol=2e-3)


def test_sampled_distance_stays_within_its_bound_inside_and_never_above_it_outside():
    field, box = sampled_box(), substep.Collider(substep.Box((2, 1.4, 1)))
    x = np.random.default_rng(1).uniform(-1.5, 1.5, (20000, 3))
    error = field.distance(x) - box.distance(x)
    assert np.abs(error).max() < field.shape.error_bound
    assert np.abs(error).max() > 0.1 * field.shape.error_bound  # the bound is not idle
    far = np.random.default_rng(2).uniform(-9, 9, (20000, 3))
    below = box.distance(far) - field.distance(far)
    assert below.min() > -field.shape.error_bound
    assert (below < 0.5 * box.distance(far).clip(0.5)).all()


def test_a_turned_and_moved_box_is_the_box_in_its_own_frame():
    box = substep.Collider(substep.Box((1, 2, 3), (1, 2, 3)))
    box.velocity, box.angular_velocity = (1, 0, -1), (0, 0, np.pi / 2)
    box.advance(0.5)
    box.advance(0.5)
    np.testing.assert_allclose(box.position, [2, 2, 2], atol=1e-15)
    np.testing.assert_allclose(box.rotation, [0.5**0.5, 0, 0, 0.5**0.5], atol=1e-15)
    swapped = substep.Collider(substep.Box((2, 1, 3), (2, 2, 2)))
    np.testing.assert_allclose(box.distance(points), swapped.distance(points), atol=1e-14)
    np.testing.assert_allclose(box.gradient(points), swapped.gradient(points), atol=1e-9)


def test_surface_velocity_is_that_of_its_points():
    ball = substep.Collider(
        substep.Sphere(1.0, (1, 0, 0)), velocity=(0, 1, 0), angular_velocity=(0, 0, 2)
    )
    assert ball.surface_velocity([[2, 0, 0], [1, 1, 5]]).tolist() == [[0, 3, 0], [-2, 1, 0]]


def test_same_bits_for_any_number_of_threads(collider):
    for function in (collider.distance, collider.gradient, collider.hessian):
        bits = {function(points, threads=threads).tobytes() for threads in (1, 2, 3)}
        assert len(bits) == 1


def test_no_points():
    ball = substep.Collider(substep.Sphere(1.0))
    assert ball.distance(np.empty((0, 3))).shape == (0,)
    assert ball.hessian(np.empty((0, 3))).shape == (0, 3, 3)


BAD = [
    (lambda: substep.Plane((0, 0, 0)), "normal"),
    (lambda: substep.Plane((0, np.nan, 1)), r"normal\[1\]"),
    (lambda: substep.Plane(point=(0, 0)), "point"),
    (lambda: substep.Collider(substep.Plane(), friction=-0.1), "friction"),
    (lambda: substep.Collider(substep.Plane(), friction=np.nan), "friction"),
    (lambda: substep.Collider(substep.Plane(), restitution=1.1), "restitution"),
    (lambda: substep.Collider(substep.Plane(), velocity=(0, 0, np.inf)), r"velocity\[2\]"),
    (lambda: substep.Sphere(0), "radius"),
    (lambda: substep.Sphere(-1), "radius"),
    (lambda: substep.Sphere(np.inf), "radius"),
    (lambda: substep.Box((1, 0, 1)), "lengths"),
    (lambda: substep.Box((1, np.nan, 1)), r"lengths\[1\]"),
    (lambda: substep.SignedDistanceField(np.ones((3, 9, 9)), 1.0), "axis 0"),
    (
        lambda: substep.SignedDistanceField(np.full((9, 9, 9), -1.0), 1.0),
        r"\[0, 0, 0\].*border",
    ),
    (lambda: substep.SignedDistanceField(np.ones((9, 9, 9)), 0.0), "spacing"),
    (
        lambda: substep.SignedDistanceField(np.full((9, 9, 9), np.nan), 1.0),
        r"\[0, 0, 0\]",
    ),
    (
        lambda: substep.SignedDistanceField(9 * np.eye(9)[..., None] * np.ones(9), 1.0),
        "border",
    ),
]


@pytest.mark.parametrize("make, said", BAD, ids=[said for _, said in BAD])
def test_bad_parameters(make, said):
    with pytest.raises(InputError, match=said):
        make()


def test_what_is_no_distance_is_refused():
    values = np.ones((9, 9, 9))
    values[4, 4, 4] = 4.0
    with pytest.raises(InputError, match="no distance"):
        substep.SignedDistanceField(values, 1.0)


def test_a_refused_assignment_changes_nothing():
    ball = substep.Collider(substep.Sphere(1.0), friction=0.25)
    before = ball._native.state
    for name, value in (
        ("friction", -1),
        ("friction", 1e151),
        ("velocity", (0, -1e151, 0)),
        ("angular_velocity", (0, 0, 1e151)),
        ("position", (1e151, 0, 0)),
        ("restitution", np.nan),
        ("velocity", (0, 0)),
        ("position", (0, np.nan, 0)),
        ("rotation", (0, 0, 0, 0)),
    ):
        with pytest.raises(InputError, match=name):
            setattr(ball, name, value)
    with pytest.raises(InputError, match="dt"):
        ball.advance(-1)
    with pytest.raises(InputError, match=r"x\[0, 1\]"):
        ball.distance([[0, np.nan, 0]])
    assert ball._native.state == before


@pytest.mark.parametrize(
    "copied", [copy.copy, copy.deepcopy, lambda c: pickle.loads(pickle.dumps(c))]
)
def test_copies_are_exact_and_independent(collider, copied):
    collider.velocity, collider.friction = (1, 2, 3), 0.25
    other = copied(collider)
    assert type(other) is type(collider)
    assert other._native.state == collider._native.state
    np.testing.assert_array_equal(other.distance(points), collider.distance(points))
    other.advance(1.0)
    other.friction = 0.75
    assert collider.friction == 0.25
    assert collider._native.state != other._native.state


def test_native_state_round_trip():
    ball = turned(
        substep.Collider(substep.Sphere(1.0, (1, 2, 3)), velocity=(4, 5, 6), friction=0.5)
    )
    state = ball._native.state
    other = substep.Collider(substep.Sphere(1.0))
    other._native.state = state
    assert other._native.state == state
    np.testing.assert_array_equal(other.rotation, ball.rotation)


def test_the_distance_of_a_mesh_is_sampled():
    shape = sphere_mesh(0.7)
    expected = shape.signed_distance(points)
    near = expected < 0.056  # further off a sampled distance is a lower bound
    assert near.sum() > 20
    found = substep.Collider(shape).distance(points)
    np.testing.assert_allclose(found[near], expected[near], atol=0.035)


@pytest.mark.parametrize("shape", [sphere_mesh(0.7), substep.Plane((1, 2, 3))], ids=repr)
def test_shapes_are_values(shape):
    for name in (*shape._fields, "colour"):
        with pytest.raises(AttributeError, match="make another"):
            setattr(shape, name, 1)
    again = pickle.loads(pickle.dumps(shape))
    assert copy.deepcopy(shape) is shape
    if not isinstance(shape, substep.TriangleMesh):
        assert again == shape and hash(again) == hash(shape)
        assert shape != substep.Plane((1, 0, 0))


def test_what_does_not_change_is_refused():
    box = substep.Collider(substep.Box((1, 1, 1)))
    for name in ("shape", "hollow", "impulse", "duration", "frction"):
        with pytest.raises(AttributeError, match=name):
            setattr(box, name, 1)


def test_a_bare_shape_is_a_still_obstacle_without_friction():
    drop = substep.PositionBasedDynamics([[0, 0, 1]], 1.0, [], colliders=[substep.Plane()])
    (ground,) = drop.colliders
    assert ground.shape == substep.Plane() and ground.friction == ground.restitution == 0
    with pytest.raises(TypeError, match=r"colliders\[0\]: expected a Collider or a shape"):
        substep.PositionBasedDynamics([[0, 0, 1]], 1.0, [], colliders=["ground"])


def press(method, ground):
    """A body at rest on the ground, and its weight [N]."""
    if method == "pbd":
        body = substep.PositionBasedDynamics([[0, 0, 1e-3]], 2.0, [], colliders=[ground])
    elif method == "pbf":
        body = substep.PositionBasedFluid([[0, 0, 0.05]], 0.1, colliders=[ground])
    elif method == "springs":
        body = substep.MassSpring(
            [[0, 0, 1e-3], [1, 0, 1e-3]], [[0, 1]], 100.0, 1.0, colliders=[ground], step=0.01
        )
    else:
        x, volumes = substep.mpm.sample_box((-0.1, -0.1, 0), (0.1, 0.1, 0.2), 0.05, jitter=0.0)
        jelly = substep.mpm.NeoHookean(1000, 1e5, 0.3)
        body = substep.MaterialPointMethod(
            x, jelly, cell=0.1, volume=volumes, colliders=[ground], transfer="pic"
        )
    return body, 9.81 * float(np.sum(body.masses))


@pytest.mark.parametrize("method", ["pbd", "pbf", "springs", "mpm"])
def test_the_mean_force_of_a_call_is_the_weight(method):
    ground = substep.Collider(substep.Plane())
    body, weight = press(method, ground)
    assert ground.duration == 0
    body.advance(0.5)
    before = body.time
    body.advance(0.25)
    assert ground.duration == pytest.approx(body.time - before, abs=1e-12)
    force = -ground.impulse[2] / ground.duration
    assert force == pytest.approx(weight, rel=0.02)
    body.step(0.001)
    assert ground.duration == 0.001
    held = ground.impulse
    body.advance(0.0)
    np.testing.assert_array_equal(ground.impulse, held)


def test_thin_meshes_and_hulls_are_sampled_finely_enough():
    """A beam whose 1/64 is its thickness, along an axis and across space, and a plate."""
    turn = (np.cos(0.4), 0.0, 0.0, np.sin(0.4))
    for beam in substep.Box((10, 0.2, 0.2)), substep.Box((10, 0.2, 0.2), rotation=turn):
        along = np.array([[-4.0, 0, 0], [0.3, 0, 0], [4.0, 0, 0]])
        over = beam_points(beam, along + np.array([0, 0, 0.12]))
        found = substep.Collider(beam.mesh()).distance(over)
        np.testing.assert_allclose(found, 0.02, atol=2e-3)
    plate = substep.Collider(substep.ConvexHull(substep.Box((2, 2, 0.03)).mesh().vertices))
    np.testing.assert_allclose(plate.distance([[0.3, 0.2, 0.025]]), 0.01, atol=1e-3)


def beam_points(beam, local):
    w, x, y, z = beam.rotation
    v = 2 * np.cross([x, y, z], local)
    return local + w * v + np.cross([x, y, z], v)


@pytest.mark.parametrize(
    "motion", [{"velocity": (0, 0, 1e150)}, {"angular_velocity": (0, 0, 1e150)}]
)
def test_an_obstacle_stays_where_a_state_can_hold_it(motion):
    ball = substep.Collider(substep.Sphere(1.0, (0, 0, 1)), **motion)
    with pytest.raises(InputError, match="dt: an obstacle would be carried"):
        ball.advance(10.0)
    assert ball.position.tolist() == [0, 0, 1] and ball.rotation.tolist() == [1, 0, 0, 0]
