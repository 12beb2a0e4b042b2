"""Distances to meshes, winding numbers and sampled fields: closed forms and brute force."""

from pathlib import Path

import numpy as np
import pytest
import substep
from substep import InputError
from substep.geometry import TriangleMesh, box_mesh, grid_mesh, read_mesh, sphere_mesh

MESHES = Path(__file__).parents[3] / "shared" / "data" / "meshes"
random = np.random.default_rng(11)


def real_mesh(name):
    if not MESHES.is_dir():
        pytest.skip("needs ../shared/data/meshes, which is not here")
    return read_mesh(MESHES / name)


def around(mesh, n, margin=0.2):
    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    side = (high - low).max() * margin
    return random.uniform(low - side, high + side, (n, 3))


def brute_distance(mesh, x):
    """Least over the planes (where the foot lies inside) and the edges of all triangles."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    best = np.full(len(x), np.inf)
    for p, q in ((a, b), (b, c), (c, a)):
        along = q - p
        t = np.einsum("nmi,mi->nm", x[:, None] - p, along) / np.einsum("mi,mi->m", along, along)
        foot = p + t.clip(0, 1)[..., None] * along
        best = np.minimum(best, np.linalg.norm(x[:, None] - foot, axis=2).min(1))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    height = np.einsum("nmi,mi->nm", x[:, None] - a, normal)
    foot = x[:, None] - height[..., None] * normal
    over = np.ones(height.shape, bool)
    for p, q in ((a, b), (b, c), (c, a)):
        over &= np.einsum("nmi,mi->nm", foot - p, np.cross(normal, q - p)) >= 0
    return np.minimum(best, np.where(over, np.abs(height), np.inf).min(1))


def brute_winding(mesh, x):
    """Van Oosterom and Strackee (1983), eq. (8), over all triangles."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] - x[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    above = np.einsum("nmi,nmi->nm", a, np.cross(b, c))
    dot = [np.einsum("nmi,nmi->nm", p, q) for p, q in ((a, b), (b, c), (c, a))]
    below = la * lb * lc + dot[0] * lc + dot[1] * la + dot[2] * lb
    return (2 * np.arctan2(above, below)).sum(1) / (4 * np.pi)


@pytest.mark.parametrize("name", ["suzanne.obj", "cow.obj", "teapot.obj"])
def test_nearest_and_winding_number_against_brute_force(name):
    mesh = real_mesh(name)
    x = around(mesh, 150)
    distance, points, faces = mesh.nearest(x)
    np.testing.assert_allclose(distance, brute_distance(mesh, x), rtol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(x - points, axis=1), distance, rtol=1e-12)
    corners = mesh.vertices[mesh.faces[faces]]
    weights = np.linalg.lstsq  # each nearest point lies on the triangle that is named
    for point, corner in zip(points, corners, strict=True):
        system = np.vstack([corner.T, np.ones(3)])
        w = weights(system, np.append(point, 1), rcond=None)[0]
        assert w.min() > -1e-6 and abs(system @ w - np.append(point, 1)).max() < 1e-9
    error = mesh.winding_number(x) - brute_winding(mesh, x)
    assert np.abs(error).max() < 0.05 and np.sqrt(np.mean(error**2)) < 0.012


def test_winding_number_of_a_closed_mesh_is_whole():
    mesh = real_mesh("spot.obj")
    x = around(mesh, 20000)
    w = mesh.winding_number(x)
    assert np.abs(w - w.round()).max() < 0.05
    assert set(w.round()) == {0.0, 1.0}
    inside = w.mean() * np.prod((np.ptp(mesh.vertices, axis=0)) + 0.4 * np.ptp(mesh.vertices))
    assert inside == pytest.approx(mesh.volume, rel=0.05)


def test_signed_distance_of_a_box_is_that_of_the_shape():
    mesh, shape = box_mesh((2, 1, 3)), substep.Collider(substep.Box((2, 1, 3)))
    x = around(mesh, 2000)
    np.testing.assert_allclose(mesh.signed_distance(x), shape.distance(x), atol=1e-14)
    inward = TriangleMesh(mesh.vertices, mesh.faces[:, ::-1])
    np.testing.assert_allclose(inward.signed_distance(x), shape.distance(x), atol=1e-14)


def test_distance_on_the_surface_is_zero():
    mesh = box_mesh((2, 2, 2))
    axis = np.linspace(-1, 1, 5)
    x = np.stack(np.meshgrid(axis, axis, [-1.0, 1.0]), -1).reshape(-1, 3)
    np.testing.assert_array_equal(mesh.signed_distance(x), 0)


def test_overlapping_solids_are_one():
    one, two = sphere_mesh(1.0, (0, 0, 0), 3), sphere_mesh(1.0, (1, 0, 0), 3)
    both = TriangleMesh(
        np.concatenate([one.vertices, two.vertices]),
        np.concatenate([one.faces, two.faces + len(one.vertices)]),
    )
    x = around(both, 3000)
    inside = (one.signed_distance(x) < 0) | (two.signed_distance(x) < 0)
    np.testing.assert_array_equal(both.signed_distance(x) < 0, inside)


def nodes_of(field):
    index = np.stack(np.meshgrid(*map(np.arange, field.values.shape), indexing="ij"), -1)
    return (field.origin + field.spacing * index).reshape(-1, 3)


@pytest.mark.parametrize("mesh", [box_mesh((2, 1, 3)), sphere_mesh(subdivisions=2)])
def test_a_sampled_closed_mesh_has_its_distances_on_the_nodes(mesh):
    # Also where nodes of the grid lie on the surface.
    field = substep.SignedDistanceField.from_mesh(mesh, 0.125)
    expected = mesh.signed_distance(nodes_of(field))
    np.testing.assert_allclose(field.values.ravel(), expected, atol=1e-13)


def test_a_sampled_sphere_against_its_closed_form():
    h = 0.08
    field = substep.SignedDistanceField.from_mesh(sphere_mesh(1.0, (3, 0, 0), 5), h)
    x = random.uniform([1, -2, -2], [5, 2, 2], (4000, 3))
    r = np.linalg.norm(x - [3, 0, 0], axis=1)
    near = (r > 0.5) & (r < 1.2)
    # h^2/8 of the Laplacian 2/r, the facets of the mesh (2e-4), and third order
    np.testing.assert_allclose(
        substep.Collider(field).distance(x)[near], (r - 1)[near], atol=h * h / 2 + 5e-4
    )
    assert (substep.Collider(field).distance(x) < r - 1 + field.error_bound).all()


@pytest.mark.parametrize("name", ["teapot.obj", "stanford-bunny.obj", "suzanne.obj"])
def test_open_meshes_become_solids_whose_field_is_a_distance(name):
    mesh = real_mesh(name)
    field = substep.SignedDistanceField.from_mesh(mesh, np.ptp(mesh.vertices) / 40)
    x, values = nodes_of(field), field.values
    np.testing.assert_array_equal(values.ravel() < 0, mesh.winding_number(x) > 0.5)
    for axis in range(3):  # across holes too
        assert np.abs(np.diff(values, axis=axis)).max() <= field.spacing * (1 + 1e-9)
    distance = mesh.nearest(x)[0].reshape(values.shape)
    assert (np.abs(values) <= distance + 1e-12).all()
    assert (np.abs(values) > distance - 1e-12).mean() > 0.3  # elsewhere a cap is nearer
    assert substep.Collider(field).lipschitz <= 3**0.5 + 1e-9


def test_a_sheet_is_no_solid_but_becomes_a_plate():
    sheet = grid_mesh(11, 11)
    with pytest.raises(InputError, match="open: 40 border edges"):
        substep.SignedDistanceField.from_mesh(sheet, 0.05)
    plate = substep.Collider(substep.SignedDistanceField.from_mesh(sheet, 0.02, offset=0.1))
    x = np.array([[0, 0, 0.14], [0, 0, -0.14], [0, 0, 0.08], [0.64, 0, 0]])
    np.testing.assert_allclose(plate.distance(x), [0.04, 0.04, -0.02, 0.04], atol=1e-3)


def test_hollow_field_is_a_vessel():
    mesh = sphere_mesh(subdivisions=4)
    vessel = substep.Collider(
        substep.SignedDistanceField.from_mesh(mesh, 0.1), hollow=True, friction=0.3
    )
    np.testing.assert_allclose(vessel.distance([[0.5, 0, 0], [1.2, 0, 0]]), [0.5, -0.2], atol=0.01)
    np.testing.assert_allclose(vessel.gradient([[0.5, 0, 0]]), [[-1, 0, 0]], atol=0.02)
    assert vessel.friction == 0.3


def test_same_bits_for_any_number_of_threads():
    mesh = real_mesh("teapot.obj")
    x = around(mesh, 5000)
    for f in (
        mesh.signed_distance,
        mesh.winding_number,
        lambda x, threads: mesh.nearest(x, threads)[1],
        lambda x, threads: substep.SignedDistanceField.from_mesh(mesh, 0.2, threads=threads).values,
    ):
        assert len({f(x, threads=n).tobytes() for n in (1, 2, 3)}) == 1


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda m: substep.SignedDistanceField.from_mesh(m, 0), "spacing"),
        (lambda m: substep.SignedDistanceField.from_mesh(m, np.nan), "spacing"),
        (lambda m: substep.SignedDistanceField.from_mesh(m, 1e-4), "nodes"),
        (lambda m: substep.SignedDistanceField.from_mesh(m, offset=-1), "offset"),
        (lambda m: m.signed_distance([[0, 0]]), "x: expected shape"),
        (lambda m: m.nearest([[0, 0, np.inf]]), r"x\[0, 2\]"),
        (lambda m: m.winding_number([[0, 0, 0]], threads=0), "threads"),
    ],
)
def test_bad_input(make, said):
    with pytest.raises(InputError, match=said):
        make(sphere_mesh(subdivisions=1))
