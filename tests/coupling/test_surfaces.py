"""Cloth and soft bodies as obstacles of other methods: shares, momentum, bits, refusals."""

import numpy as np
import pytest
import substep
from substep import InputError
from substep.coupling.surfaces import SurfaceLink
from substep.geometry.facets import Sheet
from surface_scenes import G, cube, load, lump, momenta, sheet

ROUNDING = {"float32": 1e-5, "float64": 1e-11}


# ---------------------------------------------------------------------------- shares of corners


def test_corners_share_what_pushes_a_triangle():
    rng = np.random.default_rng(1)
    x = rng.normal(size=(4, 3))
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    net = substep.MassSpring(x, [[0, 1], [1, 2], [2, 3]], 1.0, [1.0, 2.0, 3.0, 4.0], faces=faces)
    other = lump((0, 0, 1), (0.1, 0.1, 1.1), net.make_colliders(0.1))
    link = SurfaceLink(
        "a", "b", {"a": other, "b": net}, 0, [(0, 0), (1, 1)], Sheet(faces, 0.05, False)
    )
    link.begin(x, np.zeros((4, 3)))
    J = rng.normal(size=(2, 6))
    given = link.on_vertices(J)
    middles = x[faces].mean(axis=1)
    np.testing.assert_allclose(given.sum(axis=0), J[:, :3].sum(axis=0), atol=1e-13)
    moment = J[:, 3:] + np.cross(middles, J[:, :3])
    np.testing.assert_allclose(np.cross(x, given).sum(axis=0), moment.sum(axis=0), atol=1e-12)
    # Across the triangle: the weights of the point.
    weights = np.array([0.2, 0.5, 0.3])
    point = weights @ x[faces[0]]
    n = np.cross(x[1] - x[0], x[2] - x[0])
    n /= np.linalg.norm(n)
    push = np.r_[n, np.cross(point - middles[0], n)]
    given = link.on_vertices(np.array([push, np.zeros(6)]))
    np.testing.assert_allclose(given @ n, [*weights, 0.0], atol=1e-12)


def test_a_triangle_alone_yields_as_its_three_masses():
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    masses = np.array([1.0, 2.0, 4.0])
    net = substep.MassSpring(x, [[0, 1], [1, 2]], 1.0, masses, faces=[[0, 1, 2]])
    other = lump((0, 0, 1), (0.1, 0.1, 1.1), net.make_colliders(0.1))
    link = SurfaceLink("a", "b", {"a": other, "b": net}, 0, [(0, 0)], Sheet(net.faces, 0.05, False))
    link.begin(x, np.zeros((3, 3)))
    weights = np.array([0.2, 0.5, 0.3])
    arm = weights @ x - x.mean(axis=0)
    push = np.r_[0, 0, 1, np.cross(arm, [0, 0, 1])]
    assert push @ link._W[0] @ push == pytest.approx((weights**2 / masses).sum(), rel=1e-12)


# ---------------------------------------------------------------------------- momentum


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_momentum_stays_where_a_block_hits_free_cloth(dtype):
    cloth = sheet(pinned="", gravity=(0, 0, 0), stiffness=500.0, tolerance=1e-9)
    block = lump(
        (-0.1, -0.08, 0.1),
        (0.1, 0.12, 0.22),
        cloth.make_colliders(0.1, friction=0.4),
        velocity=(0.3, 0, -1.5),
        gravity=(0, 0, 0),
        dtype=dtype,
    )
    world = substep.World({"block": block, "cloth": cloth}, step=1 / 240)
    start, pushed = momenta(world), 0.0
    for _ in range(24):
        world.step()
        pushed += np.abs(world._surfaces.pushed[0][:, :3]).sum()
    scale = np.abs(start[:3]).max() + pushed
    assert pushed > 0.1 * np.abs(start[2])  # they met
    np.testing.assert_allclose(momenta(world)[:3], start[:3], atol=ROUNDING[dtype] * scale)


def angular_momentum(world):
    """About 0; of the block with what its particles spin by."""
    cloth, told = world["cloth"], world["block"].diagnostics()
    spin = np.cross(cloth.positions, cloth.masses[:, None] * cloth.velocities).sum(axis=0)
    return np.array([told[f"angular_momentum_{axis}"] for axis in "xyz"]) + spin, spin


def test_angular_momentum_is_kept_as_the_interval_is_made_shorter():
    lost = []
    for rate in (240, 960):
        cloth = sheet(
            pinned="",
            gravity=(0, 0, 0),
            stiffness=500.0,
            tolerance=1e-9,
            damping_time=0,
            step=1 / rate,
        )
        colliders = cloth.make_colliders(0.1, friction=0.4)
        low, high = (-0.1, -0.08, 0.1), (0.14, 0.12, 0.2)
        block = lump(low, high, colliders, velocity=(0.3, 0, -1.5), gravity=(0, 0, 0))
        world = substep.World({"block": block, "cloth": cloth})
        (start, _), _ = angular_momentum(world), world.advance(0.1)
        end, exchanged = angular_momentum(world)
        lost.append(np.linalg.norm(end - start) / np.linalg.norm(exchanged))
    assert lost[0] < 0.03
    assert lost[1] < lost[0] / 2.5


def test_fast_cloth_sweeps_up_what_lies_before_it():
    """In one interval it moves by more than its thickness; nothing passes."""
    cloth = sheet(pinned="", gravity=(0, 0, 0), velocities=None)
    cloth.velocities[:] = (0, 0, 30.0)
    block = lump((-0.1, -0.1, 0.1), (0.1, 0.1, 0.2), cloth.make_colliders(0.1), density=100.0)
    world = substep.World({"block": block, "cloth": cloth}, step=1 / 240)
    assert 30.0 / 240 > 0.1
    for _ in range(12):
        world.step()
    near = np.abs(block.positions[:, :2]).max(axis=1) < 0.2
    level = cloth.positions[:, 2].min()
    assert block.positions[near, 2].min() > level


# ---------------------------------------------------------------------------- in company


def test_cloth_of_constraints_carries_too():
    mesh = substep.geometry.grid_mesh(7, 7, (0.6, 0.6))
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    cloth = substep.PositionBasedDynamics(
        mesh.vertices,
        0.72 / 49,
        [substep.pbd.Distance(np.unique(np.sort(edges, axis=1), axis=0), compliance=1e-5)],
        gravity=(0, 0, 0),
        step=1 / 240,
        dtype="float64",
    )
    colliders = cloth.make_colliders(0.1, faces=mesh.faces, friction=0.4)
    block = lump(
        (-0.1, -0.1, 0.06),
        (0.1, 0.1, 0.16),
        colliders,
        velocity=(0.2, 0, -1),
        gravity=(0, 0, 0),
        dtype="float64",
    )
    world = substep.World({"block": block, "cloth": cloth})
    assert world.step_limit()[0] == 1 / 240
    start = momenta(world)
    for _ in range(24):
        world.step()
    assert cloth.velocities[:, 2].min() < -0.5
    np.testing.assert_allclose(momenta(world)[:3], start[:3], atol=1e-11 * np.abs(start).max())


def test_a_jelly_on_cloth_goes_on_as_the_cloth_does():
    cloth = sheet(6, 0.5)
    jelly = cube(0.2, 4, 500.0, (0, 0, 0.155), colliders=cloth.make_colliders(0.1, friction=0.3))
    world = substep.World({"jelly": jelly, "cloth": cloth})
    taken = 0
    for _ in range(40):
        world.step()
        taken += jelly.report.iterations
    assert taken < 700  # 776 from where all is at rest, friction by velocities alone


def test_a_ball_a_block_and_the_cloth_that_carries_both():
    bodies = substep.RigidBodies()
    ball = bodies.add(substep.Sphere(0.08), (0.05, 0, 0.25), density=800.0)
    cloth = sheet(damping_time=0.1, colliders=bodies.make_colliders(ball))
    colliders = [*cloth.make_colliders(0.1, friction=0.4), *bodies.make_colliders(ball)]
    block = lump((-0.25, -0.1, 0.06), (-0.15, 0.1, 0.16), colliders)
    world = substep.World({"bodies": bodies, "block": block, "cloth": cloth}, step=1 / 240)
    pushed = []
    for k in range(180):
        world.step()
        if k >= 120:
            pushed.append(load(world)[2])
    weight = block.masses.sum() * G
    assert np.mean(pushed) == pytest.approx(-weight, rel=0.05)
    assert world.exchanged()["cloth"][1][0, 2] > 0
    assert cloth.positions[:, 2].min() < -0.04
    away = np.linalg.norm(cloth.positions - bodies.positions[ball], axis=1)
    assert 0.08 < away.min() < 0.12
    other = world.copy()
    for w in (world, other):
        w.step()
    assert digest(other) == digest(world)


# ---------------------------------------------------------------------------- bits


def falling(threads=None):
    cloth = sheet(5, threads=threads)
    block = lump((-0.1, -0.1, 0.06), (0.1, 0.1, 0.16), cloth.make_colliders(0.1), threads=threads)
    world = substep.World({"block": block, "cloth": cloth}, step=1 / 240)
    world.threads = threads
    return world


def steps(world, count):
    for _ in range(count):
        world.step()


def digest(world):
    return substep.state_hash(
        *(np.asarray(v, np.float64).ravel() for v in world.state().values() if np.ndim(v) > 0)
    )


def test_bits_do_not_depend_on_threads_or_a_checkpoint(tmp_path):
    hashes = []
    for threads in (1, 2, 3):
        world = falling(threads)
        steps(world, 24)
        hashes.append(digest(world))
    assert len(set(hashes)) == 1
    world = falling()
    steps(world, 12)
    world.save(tmp_path / "world")
    for other in (falling(), world.copy()):
        other.load(tmp_path / "world")
        steps(other, 12)
        assert digest(other) == hashes[0]


def test_a_restored_world_has_its_surfaces_where_they_were():
    """At once, before its next step: corners are in the state of the member that meets them."""
    world, points = falling(), substep.fill_box((-0.3, -0.3, -0.1), (0.3, 0.3, 0.1), 0.1)

    def distances(w):
        return np.array([collider.distance(points) for collider in w["block"].colliders])

    steps(world, 6)
    kept, there = world.state(), distances(world)
    steps(world, 12)
    assert np.abs(distances(world) - there).max() > 1e-3
    other = falling()
    for w in (world, other):
        w.restore(kept)
        np.testing.assert_array_equal(distances(w), there)
    np.testing.assert_array_equal(distances(world.copy()), there)
    steps(world, 12)
    other["block"].restore(world["block"].state())
    np.testing.assert_array_equal(distances(other), distances(world))


def test_obstacles_out_of_reach_change_no_bits():
    """Those that are culled are those that could not have acted, in each method."""
    mesh = substep.geometry.grid_mesh(6, 6, (0.6, 0.6))
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    sand = substep.fill_box((-0.1, -0.1, 0.06), (0.1, 0.1, 0.14), 0.025)
    water = substep.fill_box((-0.3, -0.3, 0.06), (0.3, 0.3, 0.2), 0.05)
    bounds = ((-0.4, -0.4, -0.2), (0.4, 0.4, 0.4))
    makers = (
        lambda c: lump((-0.1, -0.1, 0.06), (0.1, 0.1, 0.16), c),
        lambda c: substep.MaterialPointMethod(
            sand, substep.mpm.Sand(), cell=0.05, volume=0.025**3, colliders=c
        ),
        lambda c: substep.PositionBasedFluid(water, 0.05, colliders=c),
        lambda c: substep.GridLiquid(water, cell=0.1, bounds=bounds, colliders=c),
        lambda c: cube(0.2, 2, 500.0, (0.01, 0.02, 0.17), colliders=c),
        lambda c: substep.PositionBasedDynamics(
            mesh.vertices + np.array([0.01, 0.02, 0.09]),
            0.01,
            [substep.pbd.Distance(np.unique(np.sort(edges, axis=1), axis=0), compliance=1e-5)],
            step=1 / 240,
            colliders=c,
        ),
    )
    for make in makers:
        hashes = []
        for far in (False, True):
            cloth = sheet(5, damping_time=0.05, pinned="")
            cloth.velocities[:, 2] = 1.0
            obstacles = cloth.make_colliders(0.2 if make is makers[3] else 0.1, friction=0.3)
            balls = [
                substep.Collider(substep.Sphere(0.1, (0.3 * k, 3.0, 0.05)), velocity=(0, 0.1, 0))
                for k in range(40)
            ]
            colliders = [*balls[:20], *obstacles, *balls[20:]] if far else obstacles
            member = make(colliders)
            world = substep.World({"member": member, "cloth": cloth}, step=1 / 240)
            met = []
            for _ in range(16):
                world.step()
                met.append(load(world)[2])
            hashes.append(
                substep.state_hash(*(np.asarray(m.positions) for m in world.members.values()))
            )
            assert min(met) < 0
        assert hashes[0] == hashes[1], type(member).__name__


def test_a_failure_leaves_all_as_it_was():
    world = falling()
    steps(world, 12)
    before = digest(world)
    world["block"].set_velocities([0, 0, -1e30], ids=0)
    with pytest.raises(substep.SolverError, match="block"):
        world.step()
    world["block"].set_velocities([0, 0, 0], ids=0)
    assert np.isfinite(world["cloth"].positions).all()
    assert digest(world) != before  # only that particle's velocity
    world.step()


def test_a_vertex_that_is_not_finite_is_told():
    world = falling()
    steps(world, 2)
    before = world["block"].positions
    world["cloth"].positions[3] = np.nan
    with pytest.raises(substep.NonFiniteError, match="cloth: vertex 3") as caught:
        world.step()
    assert caught.value.index == 3
    np.testing.assert_array_equal(world["block"].positions, before)


def test_intervals_are_halved_where_a_triangle_would_be_put_back_too_far():
    """Then obstacles have the sum of all, and members count the steps that were taken."""
    cloth = sheet(pinned="rim", stiffness=2e4, density=0.5)
    block = lump(
        (-0.1, -0.1, 0.06), (0.1, 0.1, 0.16), cloth.make_colliders(0.1), velocity=(0, 0, -6)
    )
    world = substep.World({"block": block, "cloth": cloth}, step=1 / 60)
    p = block.masses @ block.velocities
    world.step(1 / 60)
    assert cloth.report.steps > 4  # of 1/240 s
    gained = block.masses @ block.velocities - p - block.masses.sum() * np.array([0, 0, -G]) / 60
    given = sum(collider.impulse for collider in block.colliders)
    np.testing.assert_allclose(given, -gained, atol=1e-4 * np.abs(gained).max())


# ---------------------------------------------------------------------------- what is refused


def test_what_cannot_be_an_obstacle_is_refused():
    cloth = sheet(3)
    with pytest.raises(InputError, match="thickness"):
        cloth.make_colliders(0.0)
    with pytest.raises(InputError, match=r"faces\[0, 2\]"):
        cloth.make_colliders(0.1, faces=[[0, 1, 99]])
    with pytest.raises(InputError, match="friction"):
        cloth.make_colliders(0.1, friction=-1.0)
    rope = substep.MassSpring([[0, 0, 0], [0, 0, 1]], [[0, 1]], 1.0, 1.0)
    with pytest.raises(InputError, match="faces"):
        rope.make_colliders(0.1)
    flat = substep.PositionBasedDynamics([[0.0, 0.0], [1.0, 0.0]], 1.0, [])
    with pytest.raises(InputError, match="plane"):
        flat.make_colliders(0.1)


def test_what_cannot_meet_a_surface_is_refused():
    cloth, other = sheet(3), sheet(3)
    block = lump((0, 0, 0.1), (0.1, 0.1, 0.2), cloth.make_colliders(0.1))
    with pytest.raises(InputError, match=r"colliders\[0\] of 'block' represents a surface of no"):
        substep.World({"block": block})
    with pytest.raises(InputError, match="of no member"):
        substep.World({"block": block, "cloth": other})
    thin = lump((0, 0, 0.1), (0.1, 0.1, 0.2), cloth.make_colliders(0.09))
    with pytest.raises(InputError, match=r"thickness of at least 0\.1 m there, got 0\.09"):
        substep.World({"block": thin, "cloth": cloth})
    air = substep.GridFlow([(0, 0, 0), (1, 1, 1)], 1 / 8, colliders=cloth.make_colliders(0.3))
    with pytest.raises(InputError, match="GridFlow cannot meet"):
        substep.World({"air": air, "cloth": cloth})
    flat = substep.PositionBasedFluid([[9.0, 9.0]], 0.1, colliders=cloth.make_colliders(0.3))
    with pytest.raises(InputError, match="PositionBasedFluid in the plane cannot meet"):
        substep.World({"flat": flat, "cloth": cloth})
    slow = substep.MaterialPointMethod(
        [[0.0, 0.0, 0.1]],
        substep.mpm.NeoHookean(density=500, young_modulus=5e4, poisson_ratio=0.3),
        cell=0.05,
        volume=0.025**3,
        integrator="implicit_euler",
        colliders=cloth.make_colliders(0.1),
    )
    with pytest.raises(InputError, match="MaterialPointMethod with implicit steps cannot meet"):
        substep.World({"slow": slow, "cloth": cloth})
    first = cube(0.1, 1, 500.0, (0, 0, 1))
    second = cube(0.1, 1, 500.0, (0, 0, 2), colliders=first.make_colliders(0.02))
    third = cube(0.1, 1, 500.0, (0, 0, 3), colliders=second.make_colliders(0.02))
    world = substep.World({"first": first, "second": second, "third": third})
    assert world._surfaces.order == ["third", "second", "first"]


@pytest.mark.parametrize("kind", ["surface", "bodies"])
def test_one_list_of_obstacles_is_for_one_simulation(kind):
    """Whose impulses would be summed, unless the other is gone or was never made."""
    cloth, bodies = sheet(3), substep.RigidBodies()
    bodies.add(substep.Sphere(0.1), (0, 0, 1), density=300.0)

    def made():
        return cloth.make_colliders(0.1) if kind == "surface" else bodies.make_colliders()

    def block(colliders, density=500.0):
        return lump((0, 0, 0.1), (0.1, 0.1, 0.2), colliders, density=density)

    colliders = made()
    with pytest.raises(InputError, match="density"):
        block(colliders, density=-1.0)
    first = block(colliders)
    with pytest.raises(InputError, match=r"colliders\[1\]: expected an obstacle of its own"):
        block([substep.Plane(), *colliders])
    block(made())
    other = first.copy()
    del first
    assert block(colliders) is not other


@pytest.mark.parametrize("apart", [0.0, 1e-17])
def test_a_cloth_all_of_whose_vertices_coincide_is_a_ball_that_does_not_turn(apart):
    mesh = substep.geometry.grid_mesh(5, 5, (1.0, 1.0))
    cloth = substep.MassSpring.from_mesh(mesh, density=1.0, stiffness=1e3, gravity=(0, 0, 0))
    cloth.positions[:] = np.array((0.35, 0.35, 0)) + apart * np.arange(75.0).reshape(25, 3)
    jelly = substep.MaterialPointMethod(
        substep.fill_box((0.2, 0.2, 0.05), (0.5, 0.5, 0.35), 0.05),
        substep.mpm.FixedCorotated(1000.0, 1e5, 0.3),
        cell=0.1,
        volume=0.05**3,
        bounds=((-1, -1, -0.5), (2, 2, 2)),
        colliders=cloth.make_colliders(0.2),
    )
    world = substep.World({"cloth": cloth, "jelly": jelly})
    for _ in range(5):
        world.step()
    assert np.abs(jelly.velocities).max() < 2
