"""Mass-spring systems against closed forms, conservation laws and their own derivatives."""

import itertools
import math

import numpy as np
import pytest
import substep
from substep.springs import grid_springs

G = 9.81


def chain(n, start, end, *, rest, stiffness, mass, **options):
    """A chain of n links from start to end, hung by both ends."""
    s = np.linspace(0.0, 1.0, n + 1)[:, None]
    x = (1 - s) * np.asarray(start, float) + s * np.asarray(end, float)
    edges = np.stack([np.arange(n), np.arange(1, n + 1)], axis=1)
    return substep.MassSpring(
        x, edges, stiffness, mass, rest_lengths=np.full(n, rest), pinned=[0, n], **options
    )


def settle(body, step=0.05, steps=2000, speed=1e-7):
    for _ in range(steps):
        body.step(step)
        if np.abs(body.velocities).max() < speed:
            return
    raise AssertionError(f"still moves at {np.abs(body.velocities).max()} m/s")


def errors_fall(errors, order):
    assert errors[-1] < 0.01
    for coarse, fine in itertools.pairwise(errors):
        assert fine < coarse / (0.75 * 2**order)


def test_chain_hangs_as_the_catenary():
    # 2 a sinh(d / 2a) = L with d = 1, L = 1.5: a = 0.30823647, sag 0.50263326 (closed form).
    errors = []
    for n in (8, 16, 32):
        body = chain(
            n,
            (0, 0, 0),
            (1, 0, 0),
            rest=1.5 / n,
            stiffness=1e7,
            mass=np.full(n + 1, 1.5 / n),
            drag=5.0,
            tolerance=1e-6,
        )
        body.positions[1:-1, 2] = -0.1
        settle(body)
        errors.append(abs(-body.positions[:, 2].min() / 0.50263326 - 1))
    errors_fall(errors, 2)


def test_elastic_rod_hangs_by_its_weight():
    # Tip extension m g L / (2 E A) of the continuous rod; n springs of stiffness n E A / L.
    length, mass, modulus = 2.0, 3.0, 5000.0
    errors = []
    for n in (8, 16, 32):
        masses = np.full(n + 1, mass / n)
        masses[[0, n]] /= 2
        x = np.zeros((n + 1, 3))
        x[:, 2] = -np.linspace(0.0, length, n + 1)
        edges = np.stack([np.arange(n), np.arange(1, n + 1)], axis=1)
        stiffness = n * modulus / length
        body = substep.MassSpring(x, edges, stiffness, masses, pinned=[0], drag=8.0, tolerance=1e-8)
        settle(body)
        extension = -body.positions[n, 2] - length
        discrete = G * np.sum((np.cumsum(masses[::-1])[:n]) / stiffness)
        assert extension == pytest.approx(discrete, rel=1e-6)
        errors.append(abs(extension / (mass * G * length / (2 * modulus)) - 1))
    assert max(errors) < 1e-6  # with half masses at the ends the discrete sum is the integral


def test_net_hangs_between_four_walls_as_a_membrane():
    # Springs of rest length 0 pull with k x each, so heights obey the discrete Poisson equation
    # k sum (z_j - z_i) = m g, whose limit on the unit square has its centre at
    # -0.0736713532814 q, q = m g / (k d^2): lap z = q (Timoshenko, Woinowsky-Krieger, sec. 44).
    errors = []
    stiffness, density = 50.0, 2.0
    for n in (9, 17, 33):
        d = 1 / (n - 1)
        mesh = substep.geometry.grid_mesh(n, n)
        edges, k = grid_springs(n, n, stiffness=stiffness, shear=0.0, bending=0.0)
        ids = np.arange(n * n).reshape(n, n)
        walls = np.unique(np.concatenate([ids[0], ids[-1], ids[:, 0], ids[:, -1]]))
        keep = k > 0
        body = substep.MassSpring(
            mesh.vertices,
            edges[keep],
            k[keep],
            density * d * d,
            rest_lengths=np.zeros(keep.sum()),
            pinned=walls,
            drag=10.0,
            tolerance=1e-9,
        )
        settle(body, step=0.5)
        sag = -body.positions[ids[n // 2, n // 2], 2]
        errors.append(abs(sag / (0.0736713532814 * density * G / stiffness) - 1))
    errors_fall(errors, 2)


def oscillator(integrator, *, step, damping=0.0, stiffness=100.0, mass=1.0):
    return substep.MassSpring(
        [[0, 0, 0], [0, 0, 1.1]],
        [[0, 1]],
        stiffness,
        mass,
        damping=damping,
        rest_lengths=[1.0],
        pinned=[0],
        gravity=(0, 0, 0),
        integrator=integrator,
        step=step,
        tolerance=1e-10,
    )


@pytest.mark.parametrize("integrator", ["velocity_verlet", "symplectic_euler", "rk4"])
def test_oscillator_has_its_period(integrator):
    # omega = sqrt(k / m) = 10; three steps, the finest within 1 %.
    errors = []
    for h in (0.04, 0.02, 0.01):
        body, crossings = oscillator(integrator, step=h), []
        while len(crossings) < 9:
            before = body.positions[1, 2] - 1.0
            body.step()
            after = body.positions[1, 2] - 1.0
            if before * after <= 0:
                crossings.append(body.time - h * after / (after - before))
        period = (crossings[-1] - crossings[0]) / 4
        errors.append(abs(period / (2 * math.pi / 10) - 1))
    assert errors[-1] < 0.01
    assert errors[2] < errors[0]


@pytest.mark.parametrize("integrator", ["velocity_verlet", "symplectic_euler"])
@pytest.mark.parametrize("frames", [20, 25, 50, 60, 100, 240])
def test_frames_do_not_swing_the_fastest_mode_up(integrator, frames):
    spring = substep.MassSpring(
        [[0, 0, 0], [0, 0, -1.01]],
        [[0, 1]],
        stiffness=1e4,
        masses=0.02,
        rest_lengths=1.0,
        pinned=[0],
        integrator=integrator,
    )
    start = spring.diagnostics()["energy"]
    for _ in range(2 * frames):
        spring.advance(1 / frames)
    assert abs(spring.diagnostics()["energy"]) < 20 * start
    assert spring.time == pytest.approx(2, rel=1e-12)


@pytest.mark.parametrize("integrator", ["velocity_verlet", "rk4"])
def test_damper_decays_as_the_closed_form(integrator):
    # x(t) = A exp(-zeta omega t) cos(omega_d t - phi) with zeta = c / (2 sqrt(k m)) = 0.1.
    body = oscillator(integrator, step=1e-3, damping=2.0)
    body.advance(2.0)
    omega, zeta = 10.0, 0.1
    damped = omega * math.sqrt(1 - zeta**2)
    x = (
        0.1
        * math.exp(-zeta * omega * 2.0)
        * (math.cos(damped * 2.0) + zeta * omega / damped * math.sin(damped * 2.0))
    )
    assert body.positions[1, 2] - 1.0 == pytest.approx(x, abs=1e-5)


def test_implicit_euler_damps_the_oscillator_as_predicted():
    # |R(i z)| = 1 / sqrt(1 + z^2) with z = omega h (solids: the closed form of one step).
    for h in (0.01, 0.1, 1.0):
        body = oscillator("implicit_euler", step=h)
        amplitudes = []
        for _ in range(5):
            x, v = body.positions[1, 2] - 1.0, body.velocities[1, 2] / 10.0
            amplitudes.append(math.hypot(x, v))
            body.step()
        ratio = np.array(amplitudes[1:]) / amplitudes[:-1]
        assert ratio == pytest.approx(1 / math.sqrt(1 + (10 * h) ** 2), rel=1e-6)


def test_damping_is_a_force_on_the_spring_alone():
    # It stops a stretch, not a rotation: the rate of the length vanishes in a rotating pair.
    body = substep.MassSpring(
        [[-0.5, 0, 0], [0.5, 0, 0]],
        [[0, 1]],
        0.0,
        1.0,
        damping=10.0,
        gravity=(0, 0, 0),
        integrator="rk4",
        velocities=[[0, 1, 0], [0, -1, 0]],
    )
    energy = body.diagnostics()["kinetic_energy"]
    body.step(1e-6)
    assert body.diagnostics()["kinetic_energy"] == pytest.approx(energy, rel=1e-8)


def tumbling(integrator, step):
    mesh = substep.geometry.grid_mesh(6, 6)
    edges, k = grid_springs(6, 6, stiffness=40.0)
    x = mesh.vertices.copy()
    x[:, 2] = 0.2 * np.sin(3 * x[:, 0]) * x[:, 1]
    spin = np.cross([0.3, -0.5, 1.0], x - x.mean(axis=0))
    return substep.MassSpring(
        x,
        edges,
        k,
        0.01 + 0.001 * np.arange(36),
        velocities=spin + np.array([0.1, 0.2, 0.3]),
        damping=0.01,
        gravity=(0, 0, 0),
        integrator=integrator,
        step=step,
        tolerance=1e-12,
    )


@pytest.mark.figure
def test_smooth_motion_of_a_stiff_cloth_takes_few_iterations():
    # Hung by two corners, in the midst of its swing. With tensions as they are, where a small turn
    # of a stiff spring looks like a great force, Newton's method takes 6 to 9 iterations a step.
    n = 48
    axis = np.linspace(0, 1, n)
    x = np.array([(b, 0.0, a) for a in axis for b in axis])
    edges, k = grid_springs(n, n, stiffness=1e4)
    cloth = substep.MassSpring(
        x, edges, k, 0.3 / n**2, pinned=[0, n - 1], gravity=(0, -G, 0), step=1 / 60
    )
    cloth.advance(15 / 60)
    iterations = []
    for _ in range(7):
        cloth.step()
        iterations.append(cloth.report.iterations)
    assert np.mean(iterations) < 4.5


@pytest.mark.parametrize("integrator", ["euler", "symplectic_euler", "velocity_verlet", "rk4"])
def test_free_body_keeps_its_momentum(integrator):
    body = tumbling(integrator, 1e-4)

    def momenta():
        p = body.masses[:, None] * body.velocities
        return np.sum(p, axis=0), np.sum(np.cross(body.positions, p), axis=0)

    before = momenta()
    body.advance(0.2)
    after = momenta()
    assert np.abs(after[0] - before[0]).max() < 1e-12
    # Explicit Euler adds h^2 sum v x f / m; the others keep it to their order or exactly.
    exact = {"symplectic_euler": 1e-12, "velocity_verlet": 1e-6, "rk4": 1e-9}
    assert np.abs(after[1] - before[1]).max() < exact.get(integrator, 1e-3)


def test_implicit_euler_keeps_linear_momentum_and_loses_angular_at_first_order():
    lost = []
    for h in (0.02, 0.01, 0.005):
        body = tumbling("implicit_euler", h)
        p = body.masses @ body.velocities
        L = np.sum(np.cross(body.positions, body.masses[:, None] * body.velocities), axis=0)
        body.advance(0.2)
        assert np.abs(body.masses @ body.velocities - p).max() < 1e-11
        now = np.sum(np.cross(body.positions, body.masses[:, None] * body.velocities), axis=0)
        lost.append(np.linalg.norm(now - L))
    assert lost[1] == pytest.approx(lost[0] / 2, rel=0.3)
    assert lost[2] == pytest.approx(lost[1] / 2, rel=0.3)


def test_rotated_cloth_moves_as_the_rotated_motion():
    body = tumbling("implicit_euler", 0.01)
    q, _ = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))
    q *= np.linalg.det(q)
    turned = substep.MassSpring(
        body.positions @ q.T,
        body.edges,
        body.stiffness,
        body.masses,
        velocities=body.velocities @ q.T,
        damping=body.damping,
        gravity=(0, 0, 0),
        tolerance=1e-12,
    )
    for _ in range(10):
        body.step(0.01)
        turned.step(0.01)
    assert np.abs(turned.positions - body.positions @ q.T).max() < 1e-8


@pytest.mark.parametrize("integrator", ["symplectic_euler", "velocity_verlet", "rk4", "euler"])
def test_step_limit_predicts_where_a_cloth_explodes(integrator):
    def cloth(h):
        mesh = substep.geometry.grid_mesh(8, 8)
        edges, k = grid_springs(8, 8, stiffness=500.0)
        # Explicit Euler is stable with damping only.
        damping = 1e-3 * k if integrator == "euler" else 0.0
        body = substep.MassSpring(
            mesh.vertices,
            edges,
            k,
            0.02,
            damping=damping,
            pinned=np.flatnonzero((mesh.vertices[:, 0] == 0) | (mesh.vertices[:, 0] == 1)),
            gravity=(0, 0, 0),
            integrator=integrator,
            step=h,
        )
        body.velocities[:] = 1e-9 * np.random.default_rng(0).normal(size=(64, 3))
        body.velocities[body.pinned] = 0
        return body

    limit, reason = cloth(1.0).step_limit()
    assert "omega" in reason
    below, above = cloth(0.98 * limit), cloth(1.02 * limit)
    for _ in range(1500):
        below.step()
    assert np.abs(below.velocities).max() < 1e-6
    with pytest.raises(substep.NonFiniteError) as caught:
        for _ in range(200_000):
            above.step()
            if np.abs(above.velocities).max() > 1e-3:
                raise substep.NonFiniteError("grew a millionfold", time=above.time)
    assert caught.value.time is not None


def test_the_same_cloth_explodes_with_one_integrator_and_stands_with_another():
    def cloth(integrator):
        mesh = substep.geometry.grid_mesh(10, 10)
        edges, k = grid_springs(10, 10, stiffness=1e4)
        return substep.MassSpring(
            mesh.vertices, edges, k, 3e-3, pinned=[0, 9], integrator=integrator, step=1 / 60
        )

    for integrator in ("euler", "symplectic_euler", "velocity_verlet", "rk4"):
        body = cloth(integrator)
        with pytest.raises(substep.NonFiniteError, match="beyond the step limit") as caught:
            body.advance(20.0)
        assert np.isfinite(body.positions).all()
        assert caught.value.time == pytest.approx(body.time)
    standing = cloth("implicit_euler")
    standing.advance(1.0)
    reach = np.linalg.norm(standing.positions - standing.positions[0], axis=1)
    assert reach.max() < 1.02 * math.sqrt(2)


def incline(degrees, mu, **options):
    angle = math.radians(degrees)
    normal = np.array([math.sin(angle), 0, math.cos(angle)])
    down = np.array([math.cos(angle), 0, -math.sin(angle)])
    mesh = substep.geometry.grid_mesh(5, 5, (0.4, 0.4))
    edges, k = grid_springs(5, 5, stiffness=500.0)
    x = mesh.vertices @ np.array([down, [0, 1, 0], normal]) + 5e-4 * normal
    plane = substep.Collider(substep.Plane(normal), friction=mu)
    options = {"tolerance": 1e-6, **options}
    return substep.MassSpring(x, edges, k, 0.01, colliders=[plane], **options), plane, normal, down


@pytest.mark.parametrize("mu", [0.2, 0.5])
def test_cloth_slips_at_the_angle_of_friction(mu):
    critical = math.degrees(math.atan(mu))
    for offset in (-0.5, 0.5):
        body, plane, normal, down = incline(critical + offset, mu)
        for _ in range(120):
            body.step(1 / 60)
            assert body.diagnostics()["distance"] > 0
        slope = math.radians(critical + offset)
        speed = float((body.velocities @ down).mean())
        expected = G * (math.sin(slope) - mu * math.cos(slope)) * 2.0
        if offset < 0:
            assert speed < 1e-3  # below the sticking speed
        else:
            assert speed == pytest.approx(expected, rel=0.05)
        weight = body.masses.sum() * G
        push = -float(np.dot(plane.impulse, normal)) * 60
        assert push == pytest.approx(weight * math.cos(slope), rel=0.01)


@pytest.mark.parametrize("integrator", ["implicit_euler", "velocity_verlet"])
def test_resting_cloth_gives_its_weight_to_the_floor(integrator):
    body, plane, *_ = incline(0.0, 0.4, integrator=integrator, drag=2.0, step=1 / 240)
    given = np.zeros(3)
    for k in range(720):
        body.step()
        given += np.asarray(plane.impulse) if k >= 480 else 0
    weight = body.masses.sum() * G
    assert given[2] == pytest.approx(-weight, rel=0.01)  # over one second
    assert np.abs(given[:2]).max() < 0.01 * weight


def test_cloth_never_enters_what_it_falls_on():
    mesh = substep.geometry.grid_mesh(12, 12)
    edges, k = grid_springs(12, 12, stiffness=100.0)
    ball = substep.Collider(substep.Sphere(0.25, (0, 0, 0.25)), friction=0.3)
    box = substep.Collider(substep.Box((0.2, 0.2, 0.2), (0.1, 0.1, 0.1)), friction=0.3)
    floor = substep.Collider(substep.Plane(), friction=0.5)
    body = substep.MassSpring(
        mesh.vertices + np.array([0, 0, 0.7]),
        edges,
        k,
        0.3 / 144,
        colliders=[ball, box, floor],
        velocities=np.tile([0, 0, -20.0], (144, 1)),
    )
    for _ in range(30):
        body.step(1 / 60)
        assert body.diagnostics()["distance"] > 0


@pytest.mark.parametrize("gravity", [(-9.81, 0, -9.81), (-5, -1, -9.81), (-9, -8, -9.81)])
def test_a_vertex_comes_to_rest_in_the_edges_and_corners_of_tanks(gravity):
    """As between planes, and in a pipe on a plane, that stand where the walls are."""

    def rests(*colliders):
        colliders = [
            substep.Collider(c) if not isinstance(c, substep.Collider) else c for c in colliders
        ]
        for c in colliders:
            c.friction = 0.1
        body = substep.MassSpring(
            [(-0.3, -0.2, -0.45)], [], 0.0, 0.1, gravity=gravity, drag=1.0, colliders=colliders
        )
        body.advance(1.0)
        return [*body.positions[0], *sum(c.impulse for c in colliders)]

    floor = substep.Plane(point=(0, 0, -0.5))
    walls = [substep.Plane((1, 0, 0), (-0.5, 0, 0)), substep.Plane((0, 1, 0), (0, -0.5, 0))]
    tank = substep.Collider(substep.Box((1, 1, 1)), hollow=True)
    assert rests(tank) == pytest.approx(rests(floor, *walls), abs=1e-6)
    pipe = substep.Collider(substep.Cylinder(0.5, 50.0), hollow=True)
    drum = substep.Collider(substep.Cylinder(0.5, 1.0), hollow=True)
    assert rests(drum) == pytest.approx(rests(floor, pipe), abs=1e-6)


def test_moving_colliders_push_and_pull():
    plate = substep.Collider(substep.Plane(), velocity=(0.5, 0, 1.0), friction=1.0)
    body = substep.MassSpring(
        [[0, 0, 0.01], [0.1, 0, 0.01], [0, 0.1, 0.01]],
        [[0, 1], [1, 2], [2, 0]],
        100.0,
        0.1,
        colliders=[plate],
    )
    body.advance(1.0)
    assert np.abs(body.velocities - [0.5, 0, 1.0]).max() < 2e-3
    assert plate.position[2] == pytest.approx(1.0)


def test_pins_move_and_pull_along():
    body = chain(4, (0, 0, 0), (0, 0, -1), rest=0.25, stiffness=1e4, mass=0.1, drag=2.0)
    body.pinned = [0]
    for k in range(240):
        body.targets[0] = [0.5 * (k + 1) / 60, 0, 0]
        body.step(1 / 60)
    assert body.positions[0] == pytest.approx([2.0, 0, 0])
    assert body.velocities[-1, 0] == pytest.approx(0.5, abs=0.05)
    body.pinned = np.zeros(5, bool)
    body.advance(0.5)
    assert body.positions[0, 2] < -0.5


def test_pins_hold_what_whirls_and_what_hangs():
    """A mass at the end of a spring on a circle is pulled by m omega^2 l = k (l - r)."""
    k, r, omega, m = 50.0, 1.0, 3.0, 2.0
    length = k * r / (k - m * omega**2)
    sling = substep.MassSpring(
        [[0, 0, 0], [length, 0, 0]],
        [[0, 1]],
        k,
        [1.0, m],
        rest_lengths=[r],
        velocities=[[0, 0, 0], [0, omega * length, 0]],
        gravity=(0, 0, 0),
        pinned=[0],
        integrator="velocity_verlet",
        step=1e-3,
    )
    sling.advance(1.0)
    turn = [-math.cos(omega), -math.sin(omega), 0]  # the pin holds against it
    expected = np.outer([m * omega**2 * length, 0], turn)
    np.testing.assert_allclose(sling.pin_forces(), expected, atol=1e-3)
    cube = substep.geometry.box_tetrahedra((0.1, 0.1, 0.1), (3, 3, 3))
    jelly = substep.SoftBody(
        cube.vertices,
        cube.tetrahedra,
        density=1000,
        young_modulus=2e4,
        poisson_ratio=0.3,
        damping_time=0.02,
        pinned=cube.vertices[:, 2] > 0.04,
    )
    before = jelly.positions.copy()
    jelly.pin_forces()
    assert np.array_equal(jelly.positions, before) and jelly.time == 0
    jelly.advance(1.0)
    np.testing.assert_allclose(jelly.pin_forces().sum(axis=0), [0, 0, 9.81], atol=0.01)


def test_external_forces_act_for_one_step():
    body = substep.MassSpring(
        [[0, 0, 0]], np.zeros((0, 2), int), 1.0, 2.0, gravity=(0, 0, 0), step=0.1
    )
    body.forces[0] = [4.0, 0, 0]
    body.step()
    assert body.velocities[0].tolist() == pytest.approx([0.2, 0, 0])
    assert not body.forces.any()
    body.step()
    assert body.velocities[0].tolist() == pytest.approx([0.2, 0, 0])


def draped(threads=None, solver="newton"):
    mesh = substep.geometry.grid_mesh(24, 24)
    edges, k = grid_springs(24, 24, stiffness=300.0)
    ball = substep.Collider(
        substep.Sphere(0.3, (0, 0, -0.31)), friction=0.4, angular_velocity=(0, 0, 2.0)
    )
    body = substep.MassSpring(
        mesh.vertices,
        edges,
        k,
        0.3 / 576,
        damping=0.001,
        colliders=[ball],
        threads=threads,
        solver=solver,
        faces=mesh.faces,
    )
    return body, ball


def ball_bits(body):
    return body.state()["colliders"]


def test_same_bits_for_any_number_of_threads_and_through_a_checkpoint(tmp_path):
    hashes = set()
    for threads in (1, 2, 3):
        body, _ = draped(threads)
        body.advance(0.1)
        hashes.add(substep.state_hash(body.positions, body.velocities, *ball_bits(body)))
    assert len(hashes) == 1
    body, _ = draped()
    body.advance(0.05)
    body.save(tmp_path / "half.checkpoint")
    fresh, _ = draped()
    fresh.load(tmp_path / "half.checkpoint")
    time = body.time
    fresh.advance(0.1 - time)
    body.advance(0.1 - time)
    assert substep.state_hash(
        fresh.positions, fresh.velocities, *ball_bits(fresh)
    ) == substep.state_hash(body.positions, body.velocities, *ball_bits(body))


def test_views_are_the_state_and_keep_it_alive():
    body, _ = draped()
    x = body.positions
    first = x[0].copy()
    body.step()
    assert x[0].tolist() != first.tolist()
    x[0] = [0.0, 0.0, 5.0]
    assert body.positions[0].tolist() == [0.0, 0.0, 5.0]
    del body
    assert np.isfinite(x).all()
