"""Triangle meshes of the shapes of rigid bodies: closed, on the surface, of the right volume."""

import numpy as np
import pytest
import substep
from substep import rigid

POINTS = np.random.default_rng(0).normal(size=(40, 3))


def distance_to_segment(x, half_length):
    along = np.clip(x[:, 2], -half_length, half_length)
    return np.linalg.norm(x - along[:, None] * [0, 0, 1], axis=1)


@pytest.mark.parametrize("segments", [3, 4, 7, 32])
@pytest.mark.parametrize(
    "shape", [rigid.Sphere(0.5), rigid.Capsule(0.2, 1.4), rigid.Cylinder(0.3, 0.8)]
)
def test_round_shapes_are_closed_and_their_vertices_are_on_the_surface(shape, segments):
    mesh = shape.mesh(segments)
    assert mesh.report().closed and mesh.volume > 0
    x = mesh.vertices
    r = np.hypot(x[:, 0], x[:, 1])
    if isinstance(shape, rigid.Cylinder):
        h = shape.length / 2
        np.testing.assert_allclose(np.abs(x[:, 2]), h)
        assert np.all(np.isclose(r, shape.radius) | (r == 0))
        polygon = segments / 2 * np.sin(2 * np.pi / segments) * shape.radius**2
        assert mesh.volume == pytest.approx(2 * h * polygon)
        return
    h = getattr(shape, "length", 0.0) / 2
    np.testing.assert_allclose(distance_to_segment(x, h), shape.radius)
    assert x[:, 2].max() == -x[:, 2].min() == pytest.approx(h + shape.radius)
    assert np.unique(mesh.vertices.round(12), axis=0).shape == mesh.vertices.shape


@pytest.mark.parametrize(
    ("shape", "order"),
    [(rigid.Sphere(0.5), 2), (rigid.Capsule(0.2, 1.4), 2), (rigid.Cylinder(0.3, 0.8), 2)],
)
def test_the_volume_converges_to_that_of_the_solid(shape, order):
    exact = rigid.mass_properties(shape, 1.0).mass
    errors = [exact - shape.mesh(segments).volume for segments in (32, 64)]
    assert 0 < errors[1] < errors[0] < 0.02 * exact
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.05)


@pytest.mark.parametrize("shape", [rigid.Box((1, 0.4, 0.2)), rigid.ConvexHull(POINTS)])
def test_flat_faces_bound_the_same_solid(shape):
    of_mesh = rigid.mass_properties(shape.mesh(), 2.0)
    own = rigid.mass_properties(shape, 2.0)
    assert of_mesh.mass == pytest.approx(own.mass, rel=1e-12)
    np.testing.assert_allclose(of_mesh.center_of_mass, own.center_of_mass, atol=1e-12)
    np.testing.assert_allclose(of_mesh.inertia, own.inertia, rtol=1e-10, atol=1e-12)


def test_the_mesh_of_a_hull_is_convex_and_holds_all_points():
    mesh = rigid.ConvexHull(POINTS).mesh()
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    above = np.einsum("pfk,fk->pf", POINTS[:, None] - a, normals)
    assert above.max() < 1e-9
    cube = rigid.ConvexHull(np.indices((3, 3, 3)).reshape(3, -1).T)
    assert len(cube.mesh().vertices) == 8 and len(cube.mesh().faces) == 12


def test_bad_input():
    with pytest.raises(substep.InputError, match="segments"):
        rigid.Sphere(1.0).mesh(2)
    with pytest.raises(substep.InputError, match="segments"):
        rigid.Cylinder(1.0, 2).mesh(6.5)
    with pytest.raises(substep.InputError, match="plane"):
        rigid.ConvexHull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]).mesh()
    with pytest.raises(
        substep.InputError, match="points: expected at least 4, not all in one plane, got 3"
    ):
        rigid.ConvexHull(np.eye(3))
