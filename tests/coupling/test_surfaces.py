"""Cloth and soft bodies as obstacles of others: shares, momentum, weight, light ones, bits."""

import numpy as np
import pytest
import substep
from substep import InputError, mpm
from substep.coupling.surfaces import SurfaceLink
from substep.geometry.facets import Sheet

G = 9.81
ROUNDING = {"float32": 1e-5, "float64": 1e-11}


def sheet(n=7, size=0.6, *, density=2.0, stiffness=2000.0, pinned="rim", at=0.0, **options):
    """A square of cloth in the plane z = at [kg/m^2, N/m]."""
    mesh = substep.geometry.grid_mesh(n, n, (size, size))
    rim = np.abs(mesh.vertices[:, :2]).max(axis=1) > 0.499 * size
    return substep.MassSpring.from_mesh(
        substep.TriangleMesh(mesh.vertices + np.array([0, 0, at]), mesh.faces),
        density=density,
        stiffness=stiffness,
        pinned=rim if pinned == "rim" else (),
        **{"damping_time": 0.01, "step": 1 / 240, **options},
    )


def cube(side, cells, density, at, *, young_modulus=2e4, **options):
    mesh = substep.geometry.box_tetrahedra((side,) * 3, (cells,) * 3)
    return substep.SoftBody(
        mesh.vertices + at,
        mesh.tetrahedra,
        density=density,
        young_modulus=young_modulus,
        poisson_ratio=0.3,
        **{"damping_time": 0.02, "step": 1 / 240, **options},
    )


def lump(low, high, colliders, *, density=1000.0, spacing=0.025, velocity=(0, 0, 0), **options):
    """A soft block of material points."""
    x = substep.fill_box(low, high, spacing)
    return substep.MaterialPointMethod(
        x,
        mpm.NeoHookean(density=density, young_modulus=5e4, poisson_ratio=0.3),
        cell=2 * spacing,
        volume=spacing**3,
        velocities=np.broadcast_to(np.array(velocity, float), x.shape),
        colliders=colliders,
        **options,
    )


def momenta(world):
    """Linear and angular momentum about 0 of all members."""
    sums = np.zeros(6)
    for member in world.members.values():
        p = np.asarray(member.masses)[:, None] * np.asarray(member.velocities, float)
        sums[:3] += p.sum(axis=0)
        sums[3:] += np.cross(np.asarray(member.positions, float), p).sum(axis=0)
    return sums


def load(world, link=0):
    """Force on a surface in the last interval [N]."""
    return world._surfaces.pushed[link][:, :3].sum(axis=0) / world._interval


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


# ---------------------------------------------------------------------------- weight


@pytest.mark.parametrize("density", [2.0, 0.01])  # the jelly weighs 5 times as much, or 1000 times
def test_light_cloth_carries_as_heavy_cloth_does(density):
    cloth = sheet(density=density, damping_time=0.05)
    jelly = lump((-0.1, -0.1, 0.06), (0.1, 0.1, 0.16), cloth.make_colliders(0.1, friction=0.3))
    world = substep.World({"jelly": jelly, "cloth": cloth}, step=1 / 240)
    energies, weight = [world.diagnostics()["energy"]], jelly.masses.sum() * G
    for _ in range(8):
        world.advance(0.1)
        energies.append(world.diagnostics()["energy"])
    world.advance(0.2)  # the obstacles have the sum of all intervals
    given = sum(collider.impulse for collider in jelly.colliders)
    assert given[2] == pytest.approx(-0.2 * weight, rel=0.01)
    assert cloth.positions[:, 2].min() == pytest.approx(-0.0815, abs=0.002)
    assert np.linalg.norm(jelly.velocities, axis=1).max() < 0.15
    assert np.diff(energies).max() < 0.02 * energies[0]


def test_sand_rests_on_a_trampoline():
    cloth = sheet(damping_time=0.05)
    sand = substep.MaterialPointMethod(
        substep.fill_box((-0.1, -0.1, 0.06), (0.1, 0.1, 0.18), 0.025),
        mpm.Sand(),
        cell=0.05,
        volume=0.025**3,
        colliders=cloth.make_colliders(0.1, friction=0.5),
    )
    world = substep.World({"sand": sand, "cloth": cloth}, step=1 / 240)
    world.advance(1.0)
    mean = np.zeros(3)
    for _ in range(12):
        world.step()
        mean += load(world) / 12
    weight = sand.masses.sum() * G
    np.testing.assert_allclose(mean, [0, 0, -weight], atol=0.01 * weight)
    assert np.linalg.norm(sand.velocities, axis=1).mean() < 0.03


def strings(length, width, count, tension, density):
    """Strings along x [N per m of width], pinned at both ends; they are half as long at rest."""
    mesh = substep.geometry.grid_mesh(count, 4, (length, width))
    number = np.arange(4 * count).reshape(count, 4)
    along = np.stack([number[:-1].ravel(), number[1:].ravel()], axis=1)
    across = np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], axis=1)
    rest = length / (count - 1) / 2
    widths = width / 3 * np.array([0.5, 1, 1, 0.5])
    stiffness = np.r_[np.tile(tension * widths, count - 1) / rest, np.full(len(across), 10.0)]
    p = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2
    parts = np.bincount(mesh.faces.ravel(), np.repeat(areas / 3, 3), 4 * count)
    return substep.MassSpring(
        mesh.vertices,
        np.concatenate([along, across]),
        stiffness,
        density * parts,
        drag=500.0,  # stops the liquid on it within the test
        rest_lengths=np.r_[np.full(len(along), rest), np.full(len(across), width / 3)],
        faces=mesh.faces,
        pinned=np.abs(mesh.vertices[:, 0]) > 0.499 * length,
        step=1 / 240,
    )


def test_a_column_of_liquid_on_strings_under_tension():
    """A load q on strings of length L and tension T, both per width, sags by q L^2 / (8 T)."""
    length, width, depth, d = 0.8, 0.3, 0.2, 0.05
    q = 1000 * G * depth
    tension = q * length**2 / (8 * 0.03)
    net = strings(length, width, 9, tension, 5.0)
    tank = substep.Collider(substep.Box((length, width, 2.0)), hollow=True)
    x = substep.fill_box((-length / 2, -width / 2, 0.05), (length / 2, width / 2, 0.05 + depth), d)
    liquid = substep.PositionBasedFluid(x, d, colliders=[tank, *net.make_colliders(0.1)])
    world = substep.World({"liquid": liquid, "net": net}, step=1 / 240)
    middle, sags, loads = np.flatnonzero(np.abs(net.positions[:, 0]) < 1e-9), [], []
    for k in range(180):
        world.step()
        if k >= 120:
            sags.append(-net.positions[middle, 2].mean())
            loads.append(-load(world)[2])
    own = 5.0 * G * length**2 / (8 * tension)
    assert np.mean(loads) == pytest.approx(liquid.masses.sum() * G, rel=0.02)
    assert np.mean(sags) == pytest.approx(0.03 + own, rel=0.06)
    assert liquid.positions[:, 2].min() > -0.03


# ---------------------------------------------------------------------------- soft bodies


def test_a_closed_surface_displaces_its_volume():
    box = cube(0.3, 2, 500.0, (0, 0, 0))
    obstacles = box.make_colliders(0.05)
    x = np.array([[0, 0, 0.16], [0, 0.1, 0.149], [0.2, 0.05, -0.05], [0, -0.151, 0.12]])
    nearest = np.min([c.distance(x) for c in obstacles], axis=0)
    np.testing.assert_allclose(nearest, [0.01, -0.001, 0.05, 0.001], atol=2e-4)


@pytest.mark.parametrize("method", ["particles", pytest.param("grid", marks=pytest.mark.slow)])
def test_a_jelly_floats_at_half_of_its_height(method):
    """The mean over a bob, as it is not damped; draft = density ratio."""
    side, depth, wide = 0.24, 0.24, 0.6
    d = 0.04 if method == "particles" else 0.03
    box = cube(side, 2, 500.0, (wide / 2, wide / 2, depth))
    x = substep.fill_box((0, 0, 0), (wide, wide, depth), d)
    gap = d if method == "particles" else 0
    x = x[np.abs(x - (wide / 2, wide / 2, depth)).max(axis=1) > (side + gap) / 2 - 1e-9]
    if method == "particles":
        tank = substep.Collider(
            substep.Box((wide, wide, 2.0), (wide / 2, wide / 2, 1)), hollow=True
        )
        liquid = substep.PositionBasedFluid(x, d, colliders=[tank, *box.make_colliders(0.04)])
    else:
        liquid = substep.GridLiquid(
            x,
            cell=2 * d,
            bounds=((0, 0, 0), (wide, wide, wide)),
            colliders=box.make_colliders(0.12),
        )
    world = substep.World({"liquid": liquid, "box": box}, step=1 / 120)
    drafts, loads, weight = [], [], box.masses.sum() * G
    for k in range(96):
        world.step()
        if k < 12:
            continue
        centre = box.masses @ box.positions / box.masses.sum()
        far = np.abs(liquid.positions[:, :2] - wide / 2).max(axis=1) > side / 2 + 0.06
        level = np.sort(liquid.positions[far, 2])[-20:].mean() + (d / 2 if gap else 0)
        drafts.append((level - centre[2]) / side + 0.5)
        loads.append(load(world)[2] / weight)
    assert np.mean(drafts) == pytest.approx(0.5, abs=0.03)
    assert np.mean(loads) == pytest.approx(1.0, abs=0.04)


@pytest.mark.slow
def test_a_jelly_of_tetrahedra_rests_on_a_trampoline():
    cloth = sheet(damping_time=0.05)
    box = cube(0.2, 2, 500.0, (0, 0, 0.16), colliders=cloth.make_colliders(0.1, friction=0.3))
    world = substep.World({"box": box, "cloth": cloth}, step=1 / 240)
    world.advance(0.7)
    before = world.diagnostics()["energy"]
    world.advance(0.3)
    weight = box.masses.sum() * G
    np.testing.assert_allclose(load(world), [0, 0, -weight], atol=0.01 * weight)
    assert world.diagnostics()["energy"] <= before + 1e-3 * weight * 0.2


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
    with pytest.raises(InputError, match=r"colliders\[0\] of 'block' stands for a surface of no"):
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
    first = cube(0.1, 1, 500.0, (0, 0, 1))
    second = cube(0.1, 1, 500.0, (0, 0, 2), colliders=first.make_colliders(0.02))
    third = cube(0.1, 1, 500.0, (0, 0, 3), colliders=second.make_colliders(0.02))
    world = substep.World({"first": first, "second": second, "third": third})
    assert world._surfaces.order == ["third", "second", "first"]
