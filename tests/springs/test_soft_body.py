"""Soft bodies: forces, conservation, inversion, contact, determinism and bad input."""

import math

import numpy as np
import pytest
import substep
from numpy.testing import assert_allclose
from substep.geometry import box_tetrahedra

MODELS = ("neo_hookean", "st_venant_kirchhoff")
each_model = pytest.mark.parametrize("model", MODELS)
FREE = {"gravity": (0, 0, 0)}


def box(lengths=(0.3, 0.2, 0.2), cells=(3, 2, 2), **options):
    mesh = box_tetrahedra(lengths, cells)
    options = {
        "density": 1000.0,
        "young_modulus": 1e5,
        "poisson_ratio": 0.3,
        "tolerance": 1e-6,
        **options,
    }
    return substep.SoftBody(mesh.vertices, mesh.tetrahedra, **options)


def tetrahedron(**options):
    rest = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    options = {"density": 1000.0, "young_modulus": 1e5, "poisson_ratio": 0.3, **FREE, **options}
    return substep.SoftBody(rest, [[0, 1, 2, 3]], **options)


def random_rotation(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.linalg.det(q)


def forces(body, positions, velocities=0.0):
    """Forces on the vertices, from a step of explicit Euler from the given state."""
    body.positions[:] = positions
    body.velocities[:] = velocities
    before = body.velocities.copy()
    body.step(1.0)
    return body.masses[:, None] * (body.velocities - before)


def energy(body, positions):
    body.positions[:] = positions
    return body.diagnostics()["elastic_energy"]


def inverted(body):
    corners = body.positions[body.mesh.tetrahedra]
    edges = corners[:, 1:] - corners[:, :1]
    return int((np.linalg.det(edges) <= 0).sum())


def angular_momentum(body):
    return np.cross(body.positions, body.masses[:, None] * body.velocities).sum(axis=0)


# Forces.


@each_model
def test_the_force_is_minus_the_slope_of_the_energy(model):
    rng = np.random.default_rng(1)
    body = box(model=model, integrator="euler", step=1.0, **FREE)
    x = body.positions + 0.05 * rng.normal(size=(len(body), 3))  # some are inverted
    body.positions[:] = x
    assert inverted(body) > 0
    f = forces(body, x)
    for direction in rng.normal(size=(5, len(body), 3)):
        h = 1e-6
        slope = (energy(body, x + h * direction) - energy(body, x - h * direction)) / (2 * h)
        assert_allclose(slope, -(f * direction).sum(), rtol=1e-7)


@each_model
def test_affine_deformations_are_exact(model):
    """The patch test, with Hooke's law at small strains: a bar under tension."""
    strain, nu, modulus = 1e-7, 0.3, 1e5
    body = box((1, 1, 1), (2, 3, 2), model=model, integrator="euler", step=1.0, **FREE)
    rest = body.positions.copy()
    f = forces(body, rest * [1 + strain, 1 - nu * strain, 1 - nu * strain])
    ends = np.abs(np.abs(rest[:, 0]) - 0.5) < 1e-9
    assert_allclose(f[~ends], 0, atol=1e-6 * modulus * strain)
    pull = f[rest[:, 0] > 0.49, 0].sum()
    assert_allclose(-pull, modulus * strain, rtol=1e-6)


@each_model
def test_energy_and_forces_turn_with_the_body(model):
    rng = np.random.default_rng(2)
    body = box(model=model, integrator="euler", damping_time=0.01, step=1.0, **FREE)
    x = body.positions + 0.03 * rng.normal(size=(len(body), 3))
    v = rng.normal(size=x.shape)
    R = random_rotation(rng)
    f = forces(body, x, v)
    turned = forces(body, x @ R.T + [1, 2, 3], v @ R.T)
    assert_allclose(turned, f @ R.T, atol=1e-10 * np.abs(f).max())
    assert_allclose(energy(body, x @ R.T), energy(body, x), rtol=1e-12)


def test_damping_is_a_force_in_proportion_to_the_rate_of_strain():
    rng = np.random.default_rng(3)
    tau, small = 0.02, 1e-7
    damped = box(damping_time=tau, integrator="euler", step=1.0, **FREE)
    elastic = box(integrator="euler", step=1.0, **FREE)
    rest, v = damped.positions.copy(), rng.normal(size=(len(damped), 3))
    f = forces(damped, rest, v)
    assert_allclose(f, tau / small * forces(elastic, rest + small * v), rtol=1e-4, atol=1e-3)

    x = rest + 0.02 * rng.normal(size=rest.shape)
    assert ((forces(damped, x, v) - forces(damped, x, 0)) * v).sum() < 0
    omega = np.array([1.0, -2.0, 0.5])
    rigid = np.cross(omega, x) + np.array([1, 2, 3])
    f = forces(damped, x, 0)
    assert_allclose(forces(damped, x, rigid), f, atol=1e-10 * np.abs(f).max())


@each_model
def test_a_mode_oscillates_and_decays_as_it_should(model):
    """Frequency and damping ratio tau omega / 2 of the slowest mode, against linear algebra."""
    tau, small = 2e-3, 1e-6
    probe = box(cells=(2, 1, 1), model=model, integrator="euler", step=1.0, **FREE)
    rest, n = probe.positions.copy(), 3 * len(probe)
    columns = [forces(probe, rest + small * e.reshape(-1, 3)) for e in np.eye(n)]
    stiffness = -np.array(columns).reshape(n, n) / small
    root = np.sqrt(np.repeat(probe.masses, 3))
    squares, vectors = np.linalg.eigh((stiffness + stiffness.T) / 2 / np.outer(root, root))
    omega, shape = math.sqrt(squares[6]), (vectors[:, 6] / root).reshape(-1, 3)
    assert squares[5] < 1e-3 * squares[6]  # six rigid motions

    body = box(cells=(2, 1, 1), model=model, damping_time=tau, integrator="rk4", step=1e-4, **FREE)
    body.positions[:] += 1e-6 * shape / np.abs(shape).max()
    weights = probe.masses[:, None] * shape
    start = (weights * (body.positions - rest)).sum()
    ratio = tau * omega / 2
    for k in range(1, 4):
        body.advance(2e-3)
        t = 2e-3 * k
        fast = omega * math.sqrt(1 - ratio**2)
        wave = math.cos(fast * t) + ratio * omega / fast * math.sin(fast * t)
        expected = math.exp(-ratio * omega * t) * wave
        assert_allclose((weights * (body.positions - rest)).sum() / start, expected, atol=2e-5)


# Conservation.


def test_masses_are_those_of_the_volume():
    body = box((1, 2, 3), (2, 3, 4), density=7.0)
    assert_allclose(body.masses.sum(), 42.0, rtol=1e-14)
    assert_allclose(body.masses @ body.positions, 0, atol=1e-12)


@pytest.mark.parametrize("integrator", ["symplectic_euler", "velocity_verlet", "rk4"])
def test_a_free_body_keeps_its_momenta(integrator):
    rng = np.random.default_rng(4)
    body = box(integrator=integrator, damping_time=1e-3, step=2e-4, **FREE)
    body.positions[:] += 0.01 * rng.normal(size=(len(body), 3))
    body.velocities[:] = rng.normal(size=(len(body), 3)) + np.cross([0, 0, 5], body.positions)
    momentum, spin = body.masses @ body.velocities, angular_momentum(body)
    start = body.diagnostics()
    body.advance(0.1)
    end = body.diagnostics()
    assert_allclose(body.masses @ body.velocities, momentum, rtol=1e-12)
    assert_allclose(angular_momentum(body), spin, rtol=1e-3 if integrator == "rk4" else 1e-10)
    total = ("kinetic_energy", "elastic_energy")
    assert sum(end[k] for k in total) < 0.9 * sum(start[k] for k in total)  # it is damped


def test_velocity_verlet_keeps_the_energy():
    drifts = []
    for step in (4e-4, 2e-4):
        body = box(integrator="velocity_verlet", step=step, **FREE)
        body.positions[:] *= [1.2, 0.9, 1.0]
        total, worst = body.diagnostics()["elastic_energy"], 0.0
        for _ in range(20):
            body.advance(0.02)
            now = body.diagnostics()
            worst = max(worst, abs(now["kinetic_energy"] + now["elastic_energy"] - total) / total)
        drifts.append(worst)
    assert drifts[0] < 0.03
    assert drifts[1] < 0.35 * drifts[0]  # of second order


def test_implicit_euler_keeps_momentum_and_loses_spin_in_proportion_to_the_step():
    losses = []
    for step in (4e-3, 2e-3):
        body = box(integrator="implicit_euler", step=step, tolerance=1e-8, **FREE)
        body.velocities[:] = np.cross([0, 0, 10.0], body.positions) + np.array([1, 2, 3])
        momentum, spin = body.masses @ body.velocities, angular_momentum(body)
        body.advance(0.04)
        assert_allclose(body.masses @ body.velocities, momentum, rtol=1e-9)
        losses.append(1 - angular_momentum(body)[2] / spin[2])
    assert 0 < losses[1] < losses[0] < 0.2
    assert losses[1] < 0.7 * losses[0]


def test_the_step_limit_is_where_velocity_verlet_explodes():
    def run(factor):
        body = box(integrator="velocity_verlet", step=1.0, **FREE)
        limit, reason = body.step_limit()
        assert "omega" in reason
        body.positions[:] += 1e-9 * np.random.default_rng(5).normal(size=(len(body), 3))
        for _ in range(200):
            body.step(factor * limit)
        return np.abs(body.velocities).max()

    assert run(0.97) < 1e-4
    with pytest.raises(substep.NonFiniteError, match="step limit"):
        run(1.03)


def squeezed(load, **keywords):
    """A column that stands on its lower end, under a load."""
    mesh = substep.geometry.box_tetrahedra((0.1, 0.1, 0.2), (4, 4, 8))
    return substep.SoftBody(
        mesh.vertices,
        mesh.tetrahedra,
        density=1000,
        young_modulus=1e4,
        poisson_ratio=0.45,
        pinned=mesh.vertices[:, 2] < -0.099,
        gravity=(0, 0, -load),
        integrator="velocity_verlet",
        **keywords,
    )


def test_the_default_step_has_a_margin_for_what_is_compressed():
    body = squeezed(20.0)
    rest = lowest = body.step_limit()[0]
    for _ in range(40):
        body.advance(0.025)
        lowest = min(lowest, body.step_limit()[0])
    assert body.step_size < lowest < 0.9 * rest
    assert np.abs(body.velocities).max() < 6.0  # it topples


def test_a_step_that_diverges_is_found_before_it_spoils_the_shape():
    body = squeezed(30.0)
    body.step_size = 0.9 * body.step_limit()[0]
    with pytest.raises(substep.NonFiniteError, match=r"diverges.* step_limit\(\)") as caught:
        body.advance(1.0)
    error = caught.value
    assert error.time == body.time > 0.05 and error.step > 0
    assert 0 <= error.index < len(body) and not body.pinned[error.index]
    assert body.step_limit()[0] < body.step_size  # as the error says
    # As with steps that are short enough.
    good = squeezed(30.0)
    good.advance(body.time)
    assert_allclose(body.positions, good.positions, atol=0.02)
    before = body.state()
    with pytest.raises(substep.NonFiniteError, match="diverges"):  # as often as it is tried
        body.step()
    assert all(np.array_equal(body.state()[name], before[name]) for name in before)
    body.step_size = 0.5 * body.step_limit()[0]  # what it advises
    body.advance(0.2)
    assert np.abs(body.velocities).max() < 10.0


# Inversion.

REFLECTED = np.array([1.0, 1.0, -1.0])


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.45])
@pytest.mark.parametrize("how", ["reflected", "flattened", "turned inside out", "random"])
def test_an_inverted_tetrahedron_recovers(how, poisson_ratio):
    body = tetrahedron(poisson_ratio=poisson_ratio, damping_time=0.02, tolerance=1e-3)
    rest = body.positions.copy()
    body.positions[:] = {
        "reflected": rest * REFLECTED,
        "flattened": rest * [1, 1, 0],
        "turned inside out": -rest,
        "random": np.random.default_rng(6).normal(size=(4, 3)),
    }[how]
    body.advance(4.0)
    edges = body.positions[1:] - body.positions[0]
    assert_allclose(edges @ edges.T, np.eye(3), atol=0.02)
    assert np.linalg.det(edges) > 0.98


@pytest.mark.parametrize("how", ["scrambled", "flattened", "crushed"])
def test_a_scrambled_jelly_recovers(how):
    rng = np.random.default_rng(7)
    body = box((1, 1, 1), (5, 5, 5), damping_time=2e-3, tolerance=1e-1, **FREE)
    rest = body.positions.copy()
    body.positions[:] = {
        "scrambled": rng.uniform(-0.5, 0.5, rest.shape),
        "flattened": rest * [1, 1, 0],
        "crushed": 1e-3 * rng.normal(size=rest.shape),
    }[how]
    assert inverted(body) > 200
    body.advance(1.5)
    assert inverted(body) == 0
    left = body.diagnostics()["elastic_energy"]
    assert left < 0.1 * energy(body, rest * 1.01)  # of one per cent of strain


def test_st_venant_kirchhoff_does_not_see_an_inversion():
    body = tetrahedron(model="st_venant_kirchhoff", damping_time=0.02)
    body.positions[:] *= REFLECTED
    before = body.positions.copy()
    body.advance(0.5)
    assert_allclose(body.positions, before, atol=1e-12)


def test_st_venant_kirchhoff_collapses_where_neo_hookean_resists():
    """The force of a bar under compression is largest at a stretch of 1 / sqrt(3)."""

    def push(model, stretch):
        body = tetrahedron(model=model, poisson_ratio=0.0, integrator="euler", step=1.0)
        return forces(body, body.positions * [stretch, 1, 1])[1, 0]

    top = push("st_venant_kirchhoff", 1 / math.sqrt(3))
    assert push("st_venant_kirchhoff", 0.45) < top > push("st_venant_kirchhoff", 0.7)
    assert push("st_venant_kirchhoff", 0.0) == pytest.approx(0, abs=1e-9)
    resisting = [push("neo_hookean", s) for s in (0.9, 0.7, 0.5, 0.3, 0.1, 0.0, -0.5)]
    assert np.all(np.diff(resisting) > 0)


# Contact.


def jelly_on_incline(angle_deg, friction=0.5):
    """A block at rest on a slope, its base within reach of the barrier."""
    angle = math.radians(angle_deg)
    R = np.array(
        [
            [math.cos(angle), 0, math.sin(angle)],
            [0, 1, 0],
            [-math.sin(angle), 0, math.cos(angle)],
        ]
    )
    mesh = box_tetrahedra((0.3, 0.3, 0.3), (3, 3, 3))
    ground = substep.Collider(substep.Plane(R @ [0, 0, 1.0]), friction=friction)
    body = substep.SoftBody(
        (mesh.vertices + np.array([0, 0, 0.15 + 9e-4])) @ R.T,
        mesh.tetrahedra,
        density=1000.0,
        young_modulus=1e5,
        poisson_ratio=0.3,
        damping_time=0.02,
        colliders=[ground],
        step=1 / 120,
        tolerance=1e-3,
    )
    return body, ground, R[:, 0]


@pytest.mark.figure
def test_a_jelly_that_slides_takes_few_iterations_of_newton():
    mesh = box_tetrahedra((0.2, 0.2, 0.2), (4, 4, 4))
    floor = substep.Collider(substep.Plane(), friction=0.3)
    jelly = substep.SoftBody(
        mesh.vertices + np.array([0, 0, 0.102]),
        mesh.tetrahedra,
        density=500.0,
        young_modulus=2e4,
        poisson_ratio=0.3,
        damping_time=0.02,
        velocities=np.broadcast_to([0.5, 0.0, 0.0], mesh.vertices.shape),
        colliders=[floor],
    )
    taken = 0
    for _ in range(60):
        jelly.step(1 / 240)
        taken += jelly.report.iterations
    assert taken < 320  # 403 by velocities alone


def test_a_jelly_slips_beyond_the_angle_of_friction_and_never_penetrates():
    critical = math.degrees(math.atan(0.5))
    for offset in (-0.5, 0.5):
        body, ground, down = jelly_on_incline(critical + offset)
        speeds = []
        for k in range(180):
            body.step()
            assert ground.distance(body.positions).min() > 0
            if k + 1 in (120, 180):
                speeds.append(float(body.masses @ (body.velocities @ down)) / body.masses.sum())
        if offset < 0:
            assert abs(speeds[1]) < 2e-3  # creep, about `sticking_speed`
        else:
            angle = math.radians(critical + offset)
            slide = 9.81 * (math.sin(angle) - 0.5 * math.cos(angle))
            assert_allclose(speeds[1] - speeds[0], slide * 0.5, rtol=0.02)


def test_the_impulse_on_the_ground_is_the_weight():
    body, ground, _ = jelly_on_incline(0.0)
    body.advance(1.0)
    impulse = np.zeros(3)
    for _ in range(60):
        body.step()
        impulse += ground.impulse
    weight = body.masses.sum() * 9.81
    assert_allclose(impulse, [0, 0, -weight * 0.5], atol=0.01 * weight * 0.5)


# The protocol.


def falling(threads=None, **options):
    body = box(
        (0.2, 0.2, 0.2),
        (8, 8, 8),  # 3072 tetrahedra: more than one chunk
        damping_time=0.01,
        young_modulus=2e4,
        colliders=[substep.Collider(substep.Plane(point=(0, 0, -0.12)), friction=0.3)],
        step=0.01,
        threads=threads,
        tolerance=1e-2,
        **options,
    )
    body.velocities[:] = [0.5, 0, -1.0]
    return body


def state_hash(body):
    return substep.state_hash(body.positions, body.velocities)


@pytest.mark.parametrize("integrator", ["implicit_euler", "velocity_verlet"])
def test_the_same_bits_for_any_number_of_threads(integrator):
    hashes = set()
    for threads in (1, 2, 3):
        body = falling(threads, integrator=integrator)
        for _ in range(2):
            body.step(0.01 if integrator == "implicit_euler" else 1e-4)
        hashes.add(state_hash(body))
    assert len(hashes) == 1


def test_the_same_bits_through_a_checkpoint(tmp_path):
    body = falling()
    body.advance(0.03)
    body.save(tmp_path / "jelly")
    body.advance(0.03)
    again = falling()
    again.load(tmp_path / "jelly")
    again.advance(0.03)
    assert state_hash(again) == state_hash(body)
    assert again.time == body.time


def test_rest_positions_may_differ_from_the_initial_ones():
    mesh = box_tetrahedra((1, 1, 1), (1, 1, 1))
    options = {"density": 1.0, "young_modulus": 1.0, "poisson_ratio": 0.0, **FREE}
    body = substep.SoftBody(
        2 * mesh.vertices, mesh.tetrahedra, rest_positions=mesh.vertices, **options
    )
    assert_allclose(body.masses.sum(), 1.0)
    assert body.diagnostics()["elastic_energy"] > 0.1


def test_materials_may_differ_from_tetrahedron_to_tetrahedron():
    mesh = box_tetrahedra((2, 1, 1), (2, 1, 1))
    middle = mesh.vertices[mesh.tetrahedra].mean(axis=1)[:, 0]
    modulus = np.where(middle < 0, 1e4, 1e6)
    body = substep.SoftBody(
        mesh.vertices,
        mesh.tetrahedra,
        density=np.where(middle < 0, 500.0, 1500.0),
        young_modulus=modulus,
        poisson_ratio=0.0,
        pinned=mesh.vertices[:, 0] < -0.99,
        tolerance=1e-6,
        **FREE,
    )
    assert_allclose(body.masses.sum(), 2000.0)
    right = mesh.vertices[:, 0] > 0.99
    body.forces[right, 0] = 1.0 * body.masses[right] / body.masses[right].sum()
    body.step(1e5)
    stretch = (body.positions - mesh.vertices)[:, 0]
    assert_allclose(stretch[right].mean(), 1e-4 + 1e-6, rtol=2e-3)


def test_a_surface_is_filled():
    ball = substep.geometry.sphere_mesh(0.1)
    options = {"density": 1000.0, "young_modulus": 1e4, "poisson_ratio": 0.4}
    one = substep.SoftBody.from_mesh(ball, spacing=0.03, **options)
    other = substep.SoftBody.from_mesh((ball.vertices, ball.faces), spacing=0.03, **options)
    assert state_hash(one) == state_hash(other)
    assert len(one.mesh.lacks) == 1  # a coarse filling has less volume, and says so
    assert "volume" in one.mesh.lacks[0]
    assert_allclose(one.masses.sum(), 1000 * 4 / 3 * math.pi * 0.1**3, rtol=0.05)


def test_a_mesh_file_is_read(tmp_path):
    path = tmp_path / "ball.obj"
    ball = substep.geometry.sphere_mesh(0.1)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in ball.vertices.tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in ball.faces.tolist()]
    path.write_text("\n".join(lines))
    options = {"density": 1000.0, "young_modulus": 1e4, "poisson_ratio": 0.4, "spacing": 0.03}
    body = substep.SoftBody.from_mesh(path, **options)
    assert state_hash(body) == state_hash(substep.SoftBody.from_mesh(ball, **options))


def test_vertices_without_a_tetrahedron_are_left_out_of_a_mesh():
    mesh = substep.geometry.TetMesh(
        [[9, 9, 9], [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[1, 2, 3, 4]]
    )
    body = substep.SoftBody.from_mesh(mesh, density=6.0, young_modulus=1.0, poisson_ratio=0.0)
    assert body.masses.tolist() == [0.25] * 4


# Bad input.

CORNERS = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]
GOOD = {
    "positions": CORNERS,
    "tetrahedra": [[0, 1, 2, 3]],
    "density": 1.0,
    "young_modulus": 1.0,
    "poisson_ratio": 0.3,
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"poisson_ratio": 0.5}, r"poisson_ratio\[0\]"),
        ({"poisson_ratio": 0.7}, r"poisson_ratio\[0\]"),
        ({"poisson_ratio": -1.0}, r"poisson_ratio\[0\]"),
        ({"poisson_ratio": [0.3, 0.3]}, "poisson_ratio"),
        ({"poisson_ratio": math.nan}, "poisson_ratio"),
        ({"young_modulus": 0.0}, r"young_modulus\[0\]"),
        ({"young_modulus": -1.0}, r"young_modulus\[0\]"),
        ({"young_modulus": math.inf}, "young_modulus"),
        ({"density": 0.0}, r"density\[0\]"),
        ({"density": math.nan}, "density"),
        ({"damping_time": -1.0}, "damping_time"),
        ({"damping_time": math.nan}, "damping_time"),
        ({"model": "rubber"}, "model"),
        ({"integrator": "leapfrog"}, "integrator"),
        ({"solver": "projective"}, "solver"),
        ({"tetrahedra": [[0, 1, 2, 4]]}, r"tetrahedra\[0, 3\]"),
        ({"tetrahedra": [[0, 1, 2, -1]]}, r"tetrahedra\[0, 3\]"),
        ({"tetrahedra": [[0, 1, 2, 2**31]]}, r"tetrahedra\[0, 3\]"),
        ({"tetrahedra": [[0, 1, 2, 2]]}, r"tetrahedra\[0\]"),
        ({"tetrahedra": [[0.0, 1.0, 2.0, 3.0]]}, "tetrahedra"),
        ({"tetrahedra": [[0, 1, 2]]}, "tetrahedra"),
        ({"tetrahedra": []}, "tetrahedra"),
        ({"positions": [*CORNERS[:3], [1, 1, 0]]}, r"tetrahedra\[0\]"),
        ({"positions": [*CORNERS[:3], [0.3, 0.3, 1e-13]]}, r"tetrahedra\[0\]: flat"),
        ({"positions": [*CORNERS[:3], [math.nan, 0, 1]]}, r"positions\[3, 0\]"),
        ({"positions": [*CORNERS, [5, 5, 5]]}, r"positions\[4\]: no tetrahedron"),
        ({"rest_positions": CORNERS[:3]}, "rest_positions"),
        ({"pinned": [4]}, r"pinned\[0\]"),
    ],
)
def test_bad_input_is_refused(change, message):
    with pytest.raises(substep.InputError, match=message):
        substep.SoftBody(**{**GOOD, **change})


def test_flipped_tetrahedra_are_turned_and_counted():
    body = substep.SoftBody(**{**GOOD, "tetrahedra": [[0, 2, 1, 3]]})
    assert body.mesh.flipped == 1
    assert (body.mesh.volumes > 0).all()
    assert body.diagnostics()["elastic_energy"] == 0


@pytest.mark.parametrize("integrator", ["implicit_euler", "velocity_verlet"])
def test_nan_in_the_state_is_refused_and_changes_nothing(integrator):
    body = box(integrator=integrator, step=1e-3)
    body.advance(2e-3)
    body.velocities[3, 1] = math.nan
    before = substep.state_hash(body.positions, body.velocities), body.time
    with pytest.raises(substep.NonFiniteError):
        body.step()
    assert (substep.state_hash(body.positions, body.velocities), body.time) == before


def test_positions_far_apart_end_in_an_error_or_finite():
    body = box()
    body.positions[0] = 1e160
    before = body.positions.copy()
    try:
        body.step()
    except substep.SolverError:
        assert (body.positions == before).all()
    assert np.isfinite(body.positions).all()
