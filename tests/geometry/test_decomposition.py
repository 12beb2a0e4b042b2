"""Convex decomposition by coacd: volumes, bodies that hang and hold, and what is refused."""

import importlib.util
import sys

import numpy as np
import pytest
import substep
from substep import InputError, rigid
from substep.geometry import TriangleMesh, convex_decomposition, sphere_mesh, tetrahedralize


def prism(outline, caps, thickness):
    """An outline in the plane of x and z, which triangles fill, along y."""
    n, half = len(outline), thickness / 2
    points = [[[x, y, z] for x, z in outline] for y in (-half, half)]
    front = np.array(caps)
    faces = [*front, *(front[:, ::-1] + n)]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, j + n, j), (i, i + n, j + n)]
    return TriangleMesh(np.concatenate(points), faces)


def hook():
    """A U turned over: 1 m wide, 1.2 m high, arms of 0.2 m."""
    outline = [(0, 0), (0.2, 0), (0.2, 1), (0.8, 1), (0.8, 0.4), (1, 0.4), (1, 1.2), (0, 1.2)]
    return prism(outline, [(0, 1, 2), (0, 2, 7), (2, 6, 7), (2, 3, 6), (3, 4, 5), (3, 5, 6)], 0.3)


def bowl(outer=0.5, inner=0.4, around=16, rings=5):
    """Half a shell, open to the top; its volume."""
    angle = 2 * np.pi * np.arange(around) / around
    down = np.linspace(np.pi, np.pi / 2, rings + 1)[1:]
    profile = [(outer, a) for a in down] + [(inner, a) for a in down[::-1]]
    ring = np.stack([np.cos(angle), np.sin(angle), np.ones(around)], axis=-1)
    turns = [r * np.array([np.sin(a), np.sin(a), np.cos(a)]) * ring for r, a in profile]
    vertices = np.concatenate([[[0, 0, -outer]], *turns, [[0, 0, -inner]]])
    i, j = np.arange(around), (np.arange(around) + 1) % around
    first, last, top = 1, 1 + around * (2 * rings - 1), len(vertices) - 1
    faces = [np.stack([0 * i, first + j, first + i], axis=-1)]
    for start in range(first, last, around):
        p, q = start + i, start + j
        faces += [np.stack([p, q, q + around], axis=-1), np.stack([p, q + around, p + around], -1)]
    faces.append(np.stack([0 * i + top, last + i, last + j], axis=-1))
    return TriangleMesh(vertices, np.concatenate(faces))


def share_inside(hulls, points):
    """Which points are in one of the hulls."""
    inside = np.zeros(len(points), bool)
    for hull in hulls:
        inside |= hull.mesh().signed_distance(points) <= 0
    return inside


needs_coacd = pytest.mark.skipif(
    importlib.util.find_spec("coacd") is None, reason="coacd is not installed"
)


@needs_coacd
class TestHulls:
    def test_they_are_the_solid(self):
        mesh = hook()
        assert mesh.report().lacks == [] and mesh.volume == pytest.approx(0.3 * 0.52)
        hulls = convex_decomposition(mesh)
        assert 3 <= len(hulls) <= 5
        points = np.random.default_rng(1).uniform([-0.1, -0.2, -0.1], [1.1, 0.2, 1.3], (20_000, 3))
        distance = mesh.signed_distance(points)
        inside = share_inside(hulls, points)
        assert inside[distance < -2e-3].all() and not inside[distance > 2e-3].any()
        assert sum(h.mesh().volume for h in hulls) == pytest.approx(mesh.volume, rel=2e-3)

    @pytest.mark.slow
    def test_the_concavity_is_kept(self):
        mesh = bowl()
        hulls = convex_decomposition(mesh, 0.2)
        points = np.random.default_rng(2).uniform(-0.55, 0.55, (20_000, 3))
        distance, inside = mesh.signed_distance(points), share_inside(hulls, points)
        assert inside[distance < -5e-3].all() and distance[inside].max() < 0.2 * 0.5
        assert len(hulls) > 6
        assert len(convex_decomposition(mesh, 0.2, max_hulls=4)) == 4

    def test_same_input_same_hulls(self):
        one, other = (convex_decomposition(hook(), seed=3) for _ in range(2))
        assert [hull.points.tobytes() for hull in one] == [hull.points.tobytes() for hull in other]

    def test_far_away_and_large(self):
        mesh = hook()
        near, far = (
            convex_decomposition(TriangleMesh(size * mesh.vertices + away, mesh.faces))
            for size, away in ((1, 0), (64, 4096))
        )
        for one, other in zip(near, far, strict=True):
            np.testing.assert_allclose(64 * one.points + 4096, other.points, atol=1e-9)

    def test_triangles_with_vertices_of_their_own(self):
        mesh = hook()
        apart = TriangleMesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(84).reshape(-1, 3))
        assert not apart.report().closed
        hulls = convex_decomposition(apart)
        assert sum(h.mesh().volume for h in hulls) == pytest.approx(mesh.volume, rel=2e-3)

    def test_faces_inwards(self):
        mesh = hook()
        hulls = convex_decomposition(TriangleMesh(mesh.vertices, mesh.faces[:, ::-1]))
        assert sum(h.mesh().volume for h in hulls) == pytest.approx(mesh.volume, rel=2e-3)

    def test_what_is_convex_is_one_hull(self):
        ball = sphere_mesh(0.5, subdivisions=2)
        (hull,) = convex_decomposition(ball)
        assert hull.mesh().volume == pytest.approx(ball.volume, rel=1e-3)


@needs_coacd
class TestBodies:
    def test_a_hook_hangs_on_a_bar(self):
        mesh = hook()
        bodies = substep.RigidBodies()
        along = np.array([1, 1, 0, 0]) / np.sqrt(2)  # turns the z axis to the y axis
        bodies.add(rigid.Capsule(0.15, 2), (0.5, 0, 0.85), along, motion="static")
        mass = rigid.mass_properties(mesh, 500.0)
        body = bodies.add(convex_decomposition(mesh), (0, 0, 0), mass=mass)
        assert bodies.masses[body] == pytest.approx(500 * 0.3 * 0.52)
        log = substep.Logger({"force": lambda bodies: bodies.contact_force(body, 0)})
        bodies.advance(4.0, log)
        assert np.abs(bodies.positions[body]).max() < 0.4  # it hangs askew, as its arms differ
        weight = [0, 0, 9.81 * mass.mass]
        np.testing.assert_allclose(log["force"][-60:].mean(axis=0), weight, atol=0.05 * weight[2])

    def test_a_ball_stays_in_a_bowl(self):
        mesh = bowl()
        bodies = substep.RigidBodies()
        bodies.add(rigid.Plane(), (0, 0, 0), motion="static")
        hulls = convex_decomposition(mesh, 0.1)
        body = bodies.add(hulls, (0, 0, 0.5), mass=rigid.mass_properties(mesh))
        ball = bodies.add(rigid.Sphere(0.1), (0.15, 0, 0.8))
        bodies.advance(4.0)
        away = bodies.positions[ball] - bodies.positions[body]
        assert np.linalg.norm(away[:2]) < 0.15
        assert 0.25 < np.linalg.norm(away) < 0.31  # 0.3 above an exact floor
        assert bodies.positions[ball, 2] > 0.19


class TestRefused:
    @pytest.mark.parametrize(
        ("change", "error", "words"),
        [
            ({"mesh": [1]}, TypeError, "mesh: expected a TriangleMesh"),
            ({"concavity": 0}, InputError, r"concavity: expected a number from 0.01 to 1, got 0"),
            ({"concavity": np.nan}, InputError, "concavity"),
            ({"max_hulls": 0}, InputError, "max_hulls"),
            (
                {"max_hulls": 2**31},
                InputError,
                "max_hulls: expected an integer from 1 to 2147483647",
            ),
            ({"seed": -1}, InputError, "seed"),
            ({"seed": 0.5}, InputError, "seed"),
        ],
    )
    def test_arguments(self, change, error, words):
        with pytest.raises(error, match=words):
            convex_decomposition(**{"mesh": hook(), **change})

    @needs_coacd
    def test_fewer_hulls_than_parts_that_are_apart(self):
        ball = sphere_mesh(0.5, subdivisions=1)
        x, n = ball.vertices, len(ball.vertices)
        two = TriangleMesh(
            np.vstack([x, x + np.array([2, 0, 0])]), np.vstack([ball.faces, ball.faces + n])
        )
        with pytest.raises(InputError, match=r"max_hulls: expected at least 2, got 1; .* 2 compon"):
            convex_decomposition(two, max_hulls=1)
        assert len(convex_decomposition(two, max_hulls=2)) == 2

    def test_open_meshes(self):
        mesh = hook()
        hole = TriangleMesh(mesh.vertices, mesh.faces[:-1])
        with pytest.raises(InputError, match=r"mesh: expected a closed one.*tetrahedralize"):
            convex_decomposition(hole)
        assert tetrahedralize(hole).surface()[0].report().closed  # as the message says

    @needs_coacd
    def test_flat_meshes(self):
        corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
        both = TriangleMesh(corners, [[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]])
        with pytest.raises((InputError, substep.SolverError)):
            convex_decomposition(both)

    def test_coacd_is_missing(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "coacd", None)
        monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
        with pytest.raises(ImportError, match=r'coacd is missing: pip install "substep\[decompos'):
            convex_decomposition(hook())
