"""Particles that collide with each other, and cloth that collides with itself."""

import hashlib
import time

import numpy as np
import pytest
import substep
from substep import InputError
from substep.geometry import grid_mesh
from substep.pbd import Distance, ParticleCollision, PositionBasedDynamics, SelfCollision


def cloth_constraints(mesh):
    """Edges, and the other diagonal of each pair of triangles."""
    return [Distance(mesh.edges), Distance(mesh.hinges[:, 2:])]


def piercings(x, mesh):
    """Edges that pass through triangles: signs of volumes of tetrahedra, in float64."""
    edges, faces = mesh.edges, mesh.faces
    p, q = x[edges[:, 0]], x[edges[:, 1]]
    corners = x[faces]
    low, high = np.minimum(p, q), np.maximum(p, q)
    apart = np.zeros((len(edges), len(faces)), bool)
    for axis in range(3):
        apart |= low[:, None, axis] > corners[:, :, axis].max(1)
        apart |= high[:, None, axis] < corners[:, :, axis].min(1)
    e, f = np.nonzero(~apart)
    shared = (edges[e][:, :, None] == faces[f][:, None, :]).any((1, 2))
    e, f = e[~shared], f[~shared]
    p, q, (a, b, c) = p[e], q[e], np.moveaxis(corners[f], 1, 0)

    def volume(s, t, u, v):
        return np.einsum("ni,ni->n", np.cross(t - s, u - s), v - s)

    sides = (volume(a, b, c, p) > 0) != (volume(a, b, c, q) > 0)
    turns = [volume(p, q, s, t) > 0 for s, t in ((a, b), (b, c), (c, a))]
    return int((sides & (turns[0] == turns[1]) & (turns[1] == turns[2])).sum())


def test_the_check_sees_a_piercing():
    mesh = substep.geometry.TriangleMesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.2, 1], [2, 2, 1]],
        [[0, 1, 2], [3, 4, 5]],
    )
    assert piercings(mesh.vertices, mesh) == 2  # each by an edge of the other
    assert piercings(mesh.vertices + np.repeat([[0, 0, 0], [1, 0, 0]], 3, 0), mesh) == 0


def crumpling(n, contact=True, **options):
    """Cloth that falls on its lower edge, and so onto itself."""
    mesh = grid_mesh(n, n)
    u, v = mesh.vertices[:, 0], mesh.vertices[:, 1] + 0.5
    x = np.column_stack([u, 0.1 * v + 0.02 * np.sin(7 * v), v + 0.02])
    constraints = cloth_constraints(mesh)
    if contact:
        constraints.append(SelfCollision(mesh.faces, thickness=0.3 / (n - 1), friction=0.3))
    floor = substep.Collider(substep.Plane(), friction=0.5)
    sim = PositionBasedDynamics(x, 0.3 / n**2, constraints, colliders=[floor], **options)
    return sim, mesh


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_falling_cloth_that_folds_never_passes_through_itself(dtype):
    with_contact, mesh = crumpling(20, dtype=dtype)
    without, _ = crumpling(20, contact=False, dtype=dtype)
    worst = pierced = 0
    for _ in range(60):
        with_contact.step()
        without.step()
        worst = max(worst, piercings(with_contact.positions, mesh))
        pierced = max(pierced, piercings(without.positions, mesh))
    assert worst == 0
    assert pierced > 100  # what the contact had to keep apart
    assert with_contact.positions[:, 2].max() < 0.3  # it lies folded
    speeds = np.linalg.norm(with_contact.velocities, axis=1)
    assert speeds.max() < 3


@pytest.mark.slow
@pytest.mark.parametrize("substeps", [3, 10])
def test_a_finer_cloth_over_a_ball_never_passes_through_itself(substeps):
    n = 40
    mesh = grid_mesh(n, n)
    x = np.column_stack([mesh.vertices[:, 0], mesh.vertices[:, 1], np.full(n * n, 0.45)])
    ball = substep.Collider(substep.Sphere(0.12, (0, 0, 0.25)), friction=0.3)
    contact = SelfCollision(mesh.faces, thickness=0.3 / (n - 1), friction=0.3)
    constraints = [*cloth_constraints(mesh), contact]
    sim = PositionBasedDynamics(
        x,
        0.3 / n**2,
        constraints,
        colliders=[ball, substep.Collider(substep.Plane(), friction=0.3)],
        substeps=substeps,
    )
    for _ in range(80):
        sim.step()
        assert piercings(sim.positions, mesh) == 0


@pytest.mark.parametrize("speed", [2.0, 20.0, 200.0])
def test_a_sheet_thrown_at_another(speed):
    """A small sheet against one held at its border; at 200 m/s it passes 0.33 m a substep."""
    big, small = grid_mesh(12, 12), grid_mesh(6, 6, (0.4, 0.4))
    held = np.flatnonzero(np.abs(big.vertices[:, :2]).max(1) > 0.499)
    x = np.concatenate([big.vertices, small.vertices @ turn(0.3) + [0.01, 0.02, 0.3]])
    mesh = substep.geometry.TriangleMesh(
        x, np.concatenate([big.faces, small.faces + len(big.vertices)])
    )
    v = np.zeros_like(x)
    v[len(big.vertices) :, 2] = -speed
    sim = PositionBasedDynamics(
        x,
        1e-3,
        [*cloth_constraints(mesh), SelfCollision(mesh.faces, thickness=0.02)],
        velocities=v,
        pinned=held,
        gravity=(0, 0, 0),
    )
    for _ in range(30):
        sim.step()
        assert piercings(sim.positions, mesh) == 0
    below = sim.positions[len(big.vertices) :, 2].mean()
    assert below > sim.positions[: len(big.vertices), 2].min()


def turn(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def test_a_flat_cloth_exerts_nothing_on_itself():
    mesh = grid_mesh(9, 9)
    contact = SelfCollision(mesh.faces, thickness=0.5, friction=1.0)  # far more than the edges
    sim = PositionBasedDynamics(mesh.vertices, 1.0, [contact], gravity=(0, 0, 0))
    before = sim.positions
    sim.advance(0.1)
    assert np.abs(sim.positions - before).max() < 1e-6
    drifting = PositionBasedDynamics(
        mesh.vertices,
        1.0,
        [contact],
        gravity=(0, 0, 0),
        velocities=np.full((81, 3), 3.0),
        dtype="float64",
    )
    drifting.advance(0.5)
    assert np.abs(drifting.positions - before - 1.5).max() < 1e-12


def test_sheets_lie_at_their_thickness():
    low, high = grid_mesh(8, 8, (1.4, 1.4)), grid_mesh(8, 8)
    n = len(low.vertices)
    x = np.concatenate([low.vertices, high.vertices @ turn(0.2) + [0, 0, 0.2]])
    faces = np.concatenate([low.faces, high.faces + n])
    mesh = substep.geometry.TriangleMesh(x, faces)
    sim = PositionBasedDynamics(
        x,
        1e-3,
        [*cloth_constraints(mesh), SelfCollision(faces, thickness=0.05, friction=0.3)],
        pinned=np.arange(n),
        drag=2.0,
        dtype="float64",
    )
    sim.advance(2.0)
    heights = sim.positions[n:, 2]
    assert abs(heights.mean() - 0.05) < 0.002
    assert heights.min() > 0.045


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_sheet_slides_on_another_as_friction_says(friction):
    """A rigid sheet on a held one: it slows down by mu g, and not at all without friction."""
    low, high = grid_mesh(5, 13, (1.0, 3.0)), grid_mesh(3, 3, (0.3, 0.3))
    n = len(low.vertices)
    x = np.concatenate([low.vertices, high.vertices + np.array([0.02, -0.8, 0.02])])
    faces = np.concatenate([low.faces, high.faces + n])
    v = np.zeros_like(x)
    v[n:, 1] = 2.0
    mesh = substep.geometry.TriangleMesh(x, faces)
    sim = PositionBasedDynamics(
        x,
        1.0,
        [*cloth_constraints(mesh), SelfCollision(faces, thickness=0.02, friction=friction)],
        velocities=v,
        pinned=np.arange(n),
        dtype="float64",
    )
    sim.advance(0.25)
    expected = 2.0 - friction * 9.81 * 0.25
    assert abs(sim.velocities[n:, 1].mean() - expected) < 0.1


def digest(sim):
    parts = (sim.positions.tobytes(), sim.velocities.tobytes())
    return hashlib.sha256(b"".join(parts)).hexdigest()


def heap(**options):
    """Balls of several sizes that fall into a box."""
    random = np.random.default_rng(5)
    x = random.uniform((-0.4, -0.4, 0.6), (0.4, 0.4, 1.4), (200, 3))
    radii = random.uniform(0.02, 0.06, 200)
    box = substep.Collider(substep.Box((1.0, 1.0, 2.0), (0, 0, 1)), hollow=True)
    contact = ParticleCollision(radii, friction=0.4)
    return PositionBasedDynamics(x, radii**3, [contact], colliders=[box], **options)


@pytest.mark.parametrize("make", [lambda **o: crumpling(14, **o)[0], heap])
def test_the_same_bits_for_any_number_of_threads_and_through_a_checkpoint(make, tmp_path):
    hashes = set()
    for threads in (1, 2, 3, 4):
        sim = make(threads=threads)
        for k in range(25):
            sim.step()
            if k == 11 and threads == 3:
                sim.save(tmp_path / "half")
                sim = make()
                sim.load(tmp_path / "half")
        hashes.add(digest(sim))
    assert len(hashes) == 1


def test_balls_keep_momentum_and_do_not_overlap():
    random = np.random.default_rng(2)
    x = random.uniform(-1, 1, (300, 3))
    x = x[[k for k in range(300) if (np.linalg.norm(x[:k] - x[k], axis=1) > 0.12).all()]]
    masses = random.uniform(0.5, 5, len(x))
    v = -3 * x + random.normal(size=x.shape)
    sim = PositionBasedDynamics(
        x,
        masses,
        [ParticleCollision(0.06, friction=0.5)],
        velocities=v,
        gravity=(0, 0, 0),
        iterations=4,
        dtype="float64",
    )
    momentum = masses @ v
    energy = 0.5 * masses @ (v**2).sum(1)
    for _ in range(40):
        sim.step()
    assert (
        np.abs(masses @ sim.velocities - momentum).max() < 1e-10 * np.abs(masses @ np.abs(v)).max()
    )
    now = 0.5 * masses @ (sim.velocities**2).sum(1)
    assert now < 0.9 * energy  # they met
    gaps = np.linalg.norm(sim.positions[:, None] - sim.positions, axis=2)
    np.fill_diagonal(gaps, 1)
    assert gaps.min() > 0.115


def test_two_balls_of_unequal_mass():
    sim = PositionBasedDynamics(
        [[0, 0, 0], [1, 0, 0]],
        [1.0, 3.0],
        [ParticleCollision(0.1)],
        velocities=[[2, 0, 0.0], [0, 0, 0]],
        gravity=(0, 0, 0),
        dtype="float64",
    )
    sim.advance(1.0)
    np.testing.assert_allclose(sim.velocities[:, 0], 0.5, rtol=1e-12)  # (1 * 2 + 3 * 0) / 4
    assert np.diff(sim.positions[:, 0])[0] == pytest.approx(0.2, abs=1e-12)


@pytest.mark.parametrize("friction", [0.0, 0.3, 10.0])
def test_friction_between_balls(friction):
    """A glancing blow: the first ball loses N along n and min(mu N, |s| / 2) across it."""
    v = np.array([2.0, 1.0, 0.0])
    sim = PositionBasedDynamics(
        [[0, 0, 0], [0.3, 0, 0]],
        1.0,
        [ParticleCollision([0.1, 0.1], friction=friction)],
        velocities=[v, [0, 0, 0]],
        gravity=(0, 0, 0),
        substeps=1000,
        dtype="float64",
    )
    sim.advance(0.12)
    # |(0.3, 0, 0) - v t| = 0.2
    t = (0.3 * v[0] - np.sqrt((0.3 * v[0]) ** 2 - (v @ v) * 0.05)) / (v @ v)
    n = (v * t - [0.3, 0, 0]) / 0.2
    impulse = -0.5 * (v @ n)
    across = v - (v @ n) * n
    lost = min(friction * impulse, 0.5 * np.linalg.norm(across))
    expected = v + impulse * n - lost * across / np.linalg.norm(across)
    assert np.abs(sim.velocities[0] - expected).max() < 0.01
    assert np.abs(sim.velocities.sum(0) - v).max() < 1e-10


def test_a_rope_of_overlapping_balls_exerts_nothing_on_itself():
    x = np.column_stack([np.linspace(0, 1, 21), np.zeros(21), np.zeros(21)])
    sim = PositionBasedDynamics(x, 1.0, [ParticleCollision(0.1)], gravity=(0, 0, 0))
    before = sim.positions
    sim.advance(0.1)
    assert np.abs(sim.positions - before).max() < 1e-6


def test_balls_in_the_plane():
    sim = PositionBasedDynamics(
        [[0.0, 0.0], [1.0, 0.05]],
        1.0,
        [ParticleCollision(0.1)],
        velocities=[[1.0, 0.0], [-1.0, 0.0]],
        gravity=(0, 0),
    )
    sim.advance(1.0)
    assert np.linalg.norm(np.diff(sim.positions, axis=0)) > 0.199


def test_coincident_balls_are_skipped():
    contact = ParticleCollision(0.1)
    sim = PositionBasedDynamics([[0, 0, 0], [1, 0, 0]], 1.0, [contact], gravity=(0, 0, 0))
    sim.set_positions([[1, 0, 0], [1, 0, 0]])
    sim.step()
    assert np.isfinite(sim.positions).all()
    assert sim.diagnostics()["skipped"] == 10


def test_balls_beyond_the_numbers():
    sim = PositionBasedDynamics(
        [[0, 0, 0], [1, 0, 0]], 1.0, [ParticleCollision(0.1)], velocities=[[1e30, 0, 0], [0, 0, 0]]
    )
    before = sim.positions
    with pytest.raises(substep.SolverError, match="too far"):
        sim.step()
    assert (sim.positions == before).all() and sim.time == 0


def test_bad_input():
    x = np.zeros((4, 3)) + np.arange(4)[:, None]
    for bad in (-0.1, np.nan, np.inf, [0.1, 0.1], [0.1, -0.1, 0.1, 0.1]):
        with pytest.raises(InputError, match="radii"):
            PositionBasedDynamics(x, 1.0, [ParticleCollision(bad)])
    for bad in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="thickness"):
            SelfCollision([[0, 1, 2]], thickness=bad)
    for bad in ([[0, 1]], [[0, 1, -1]], [[0, 1, 1]], [[0.0, 1.0, 2.0]], [0, 1, 2], [[0, 1, 2**31]]):
        with pytest.raises(InputError, match="faces"):
            SelfCollision(bad, thickness=0.1)
    with pytest.raises(InputError, match=r"faces\[1\]"):
        PositionBasedDynamics(x, 1.0, [SelfCollision([[0, 1, 2], [1, 2, 4]], thickness=0.1)])
    for make in (
        lambda mu: ParticleCollision(0.1, friction=mu),
        lambda mu: SelfCollision([[0, 1, 2]], thickness=0.1, friction=mu),
    ):
        for bad in (-0.1, np.nan, np.inf):
            with pytest.raises(InputError, match="friction"):
                make(bad)


def test_cloth_that_is_torn_apart_takes_no_longer():
    """Its triangles are thousands of times as large as at rest, and reach across each other."""
    mesh = grid_mesh(5, 5)
    sim = PositionBasedDynamics(
        mesh.vertices,
        1.0,
        [*substep.pbd.cloth(mesh), SelfCollision(mesh.faces, thickness=0.02)],
        pinned=[0, 4],
        threads=1,
    )
    sim.step()
    sim.set_velocities(1e8 * np.random.default_rng(0).normal(size=(25, 3)))
    before = time.process_time()
    for _ in range(5):
        sim.step(1e-3)
    assert time.process_time() - before < 1.0  # 0.05 s, and 10 s with pieces for the cloth at rest
    assert np.abs(sim.positions).max() > 1e4


def test_nothing_to_collide():
    for n, faces in ((0, []), (1, []), (3, [[0, 1, 2]])):
        x = np.arange(3.0 * n).reshape(n, 3) ** 1.5
        contacts = [ParticleCollision(0.0), SelfCollision(faces, thickness=0.1)]
        sim = PositionBasedDynamics(x, 1.0, contacts)
        sim.step()
        assert np.isfinite(sim.positions).all()
