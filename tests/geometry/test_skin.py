"""Skins: exact in affine maps, near to closed forms in bending, and what is refused."""

import copy
import pickle

import numpy as np
import pytest
import substep
from substep import InputError, geometry
from substep.geometry import Skin


def lattice(lengths, h):
    """Points of a box at the middles of cells of h."""
    return substep.fill_box([-s / 2 for s in lengths], [s / 2 for s in lengths], h)


@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_affine_maps_of_particles_are_exact(jitter):
    rng = np.random.default_rng(3)
    x = lattice((1, 1, 1), 0.1)
    x = x + 0.1 * jitter * rng.uniform(-1, 1, x.shape)
    mesh = geometry.box_mesh((1, 1, 1))  # its corners are outside of all particles
    fine = geometry.TriangleMesh(
        np.vstack([mesh.vertices, rng.uniform(-0.5, 0.5, (500, 3))]), mesh.faces
    )
    skin = Skin(fine, x)
    np.testing.assert_allclose(skin(x), fine.vertices, rtol=0, atol=1e-13)
    beside = np.array([[0.05, 0.0, 0.0], [0.05 + 1e-7, 1e-8, -1e-7], [1e-6, 0.0, 1e-9]])
    symmetric = geometry.TriangleMesh(beside, [[0, 1, 2]])  # several neighbours are equally far
    np.testing.assert_allclose(Skin(symmetric, x)(x), beside, rtol=0, atol=1e-13)
    map_, move = rng.normal(size=(3, 3)), rng.normal(size=3)
    np.testing.assert_allclose(
        skin(x @ map_.T + move), fine.vertices @ map_.T + move, rtol=0, atol=1e-12
    )


def test_affine_maps_of_tetrahedra_are_exact():
    solid = geometry.tetrahedralize(geometry.sphere_mesh(1.0), 0.4)
    mesh = geometry.sphere_mesh(1.05)  # outside of them
    skin = Skin(mesh, solid)
    assert skin.cells.shape == (len(mesh.vertices), 4)
    map_, move = np.random.default_rng(4).normal(size=(3, 3)), np.array([1.0, -2.0, 3.0])
    found = skin(solid.vertices @ map_.T + move)
    np.testing.assert_allclose(found, mesh.vertices @ map_.T + move, rtol=0, atol=1e-12)


def bent(x, radius=0.5):
    """Pure bending of a beam along x to an arc: the neutral line keeps its length."""
    angle, r = x[:, 0] / radius, radius - x[:, 2]
    return np.stack([r * np.sin(angle), x[:, 1], radius - r * np.cos(angle)], axis=1)


@pytest.mark.parametrize("kind", ["particles", "tetrahedra"])
def test_the_skin_of_a_bent_beam_converges_to_its_arc(kind):
    """By the square of the spacing, as what is linear does."""
    rng = np.random.default_rng(5)
    surface = rng.uniform(-0.5, 0.5, (2000, 3)) * [1, 0.2, 0.2]
    surface[:, 2] = np.where(surface[:, 2] > 0, 0.1, -0.1)  # below and above
    mesh = geometry.TriangleMesh(surface, [[0, 1, 2]])
    errors = []
    for n in (5, 10, 20):
        if kind == "particles":
            rest = x = lattice((1, 0.2, 0.2), 0.2 / n)
        else:
            rest = geometry.box_tetrahedra((1, 0.2, 0.2), (5 * n, n, n))
            x = rest.vertices
        off = Skin(mesh, rest)(bent(x)) - bent(mesh.vertices)
        errors.append(np.linalg.norm(off, axis=1).max())
    assert errors[0] < 0.004 and errors[2] < errors[0] / 12  # 16 for the square


def test_sheets_have_skins_in_their_plane():
    coarse, fine = geometry.grid_mesh(11, 11), geometry.grid_mesh(37, 37)
    skin = Skin(fine, coarse.vertices)
    turn = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0.0]])
    np.testing.assert_allclose(
        skin(coarse.vertices @ turn.T), fine.vertices @ turn.T, rtol=0, atol=1e-12
    )
    lifted = geometry.transform_mesh(fine, translation=(0, 0, 0.01))
    with pytest.raises(InputError, match=r"no plane \(more neighbours may help\), got vertex 0"):
        Skin(lifted, coarse.vertices)


def test_vertices_off_the_plane_of_their_nearest_follow_more():
    """Layers 2.1 h apart: the 13 nearest of a point are in its layer, the 14th is above it."""
    n = np.arange(7.0)
    x = np.stack(np.meshgrid(n, n, 2.1 * n[:3], indexing="ij"), axis=-1).reshape(-1, 3)
    on = np.array([[3.0, 3, 0], [3, 3, 2.1], [3, 4, 0]])
    off = on[[0, 2]] + [[0, 0, 0.05], [0, 0, -0.05]]
    mesh = geometry.TriangleMesh(np.vstack([on, off]), [[0, 1, 2]])
    skin, wide = Skin(mesh, x), Skin(mesh, x, neighbours=16)
    assert skin.cells.shape == skin.weights.shape == (5, 16)
    np.testing.assert_array_equal(skin.weights[3:], wide.weights[3:])
    np.testing.assert_array_equal(skin.cells[3:], wide.cells[3:])
    plain = Skin(geometry.TriangleMesh(on, [[0, 1, 2]]), x)
    np.testing.assert_array_equal(skin.weights[:3, :12], plain.weights)
    assert not skin.weights[:3, 12:].any()
    map_, move = np.random.default_rng(7).normal(size=(3, 3)), np.array([1.0, -2.0, 3.0])
    np.testing.assert_allclose(
        skin(x @ map_.T + move), mesh.vertices @ map_.T + move, rtol=0, atol=1e-12
    )


def snow():
    """A block of it in the air."""
    x = lattice((0.4, 0.4, 0.4), 0.05)
    return substep.MaterialPointMethod(
        x, substep.mpm.NeoHookean(500, 2e4, 0.3), cell=0.1, volume=0.05**3, gravity=(0, 0, 0)
    )


def spinning(x):
    """Velocities of a rigid motion."""
    return np.array([1.0, 0, 0]) + np.cross([0, 0, 2.0], x)


def test_a_simulation_with_a_skin_is_recorded_as_that(tmp_path):
    body, mesh = snow(), geometry.sphere_mesh(0.19)
    body.skin = Skin(mesh, body.positions)
    body.set_velocities(spinning(body.positions))
    path = substep.scenes.record(body, tmp_path / "a.vtkhdf", 0.1, fps=10)
    with substep.Recording(path) as recording:
        part = recording["particles"]
        assert recording.parts["particles"].kind == "mesh"
        np.testing.assert_allclose(part.points(0), mesh.vertices, atol=1e-6)
        np.testing.assert_allclose(part.field("velocity", 0), spinning(mesh.vertices), atol=1e-5)
        assert abs(part.points(1).mean(axis=0)[0] - 0.1) < 1e-3
    substep.export.save(path, tmp_path / "a.obj")
    assert len(list(tmp_path.glob("**/*.obj"))) == 2
    for twin in (body.copy(), copy.deepcopy(body), pickle.loads(pickle.dumps(body))):
        assert np.array_equal(twin.skin(twin.positions), body.skin(body.positions))
    plain = snow()
    plain.restore(body.state())
    assert plain.skin is None
    body.skin = None
    assert substep.recording.contents.particle_parts(body)["particles"].kind == "particles"


def test_what_does_not_fit_is_refused():
    body, mesh = snow(), geometry.sphere_mesh(0.19)
    skin = Skin(mesh, body.positions)
    for wrong in (np.zeros((5, 3)), np.zeros((len(body), 2)), np.full((len(body), 3), np.nan)):
        with pytest.raises(InputError, match="values"):
            skin(wrong)
    far = geometry.transform_mesh(mesh, scale=1000)
    with pytest.raises(InputError, match=r"mesh: expected vertices within 0\.175 m of the box"):
        Skin(far, body.positions)
    with pytest.raises(InputError, match=r"mesh: expected vertices within 0\.5 m of the box"):
        Skin(far, geometry.box_tetrahedra((1, 1, 1), (2, 2, 2)))
    with pytest.raises(InputError, match="rest: expected more points than neighbours, 12, got 4"):
        Skin(mesh, np.eye(4, 3))
    with pytest.raises(InputError, match="rest: expected points at different places"):
        Skin(mesh, np.zeros((20, 3)))
    with pytest.raises(InputError, match=r"rest: expected points at different .* of vertex 0"):
        Skin(mesh, np.concatenate([body.positions, np.tile(mesh.vertices[:1], (13, 1))]))
    with pytest.raises(InputError, match="neighbours"):
        Skin(mesh, body.positions, neighbours=3)
    with pytest.raises(TypeError, match="skin: expected a Skin or None"):
        body.skin = mesh
    other = Skin(mesh, body.positions[1:])
    with pytest.raises(InputError, match="skin: expected one of 512 points in 3D, got one of 511"):
        body.skin = other
    assert body.skin is None


def test_the_nearest_are_the_nearest():
    """Also where points are uneven: compared with all distances."""
    rng = np.random.default_rng(6)
    x = np.vstack([rng.normal(0, 0.05, (300, 3)), rng.uniform(-1, 1, (50, 3))])
    v = rng.uniform(-1, 1, (200, 3))
    from substep.geometry.skin import _nearest

    cells, distances = _nearest(v, x, 9)
    every = np.linalg.norm(v[:, None] - x, axis=2)
    np.testing.assert_array_equal(cells, np.argsort(every, axis=1)[:, :9])
    np.testing.assert_allclose(distances, np.sort(every, axis=1)[:, :9], atol=1e-15)
