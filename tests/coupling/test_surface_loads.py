"""What lies on cloth and soft bodies: weights, closed forms, light cloth, floating."""

import numpy as np
import pytest
import substep
from substep import mpm
from surface_scenes import G, cube, load, lump, sheet, strings

# ---------------------------------------------------------------------------- weight


@pytest.mark.parametrize("density", [2.0, 0.01])  # the jelly weighs 5 times as much, or 1000 times
def test_light_cloth_carries_as_heavy_cloth_does(density):
    cloth = sheet(density=density, damping_time=0.05)
    jelly = lump((-0.1, -0.1, 0.06), (0.1, 0.1, 0.16), cloth.make_colliders(0.1, friction=0.3))
    world = substep.World({"jelly": jelly, "cloth": cloth}, step=1 / 240)
    energies, weight = [world.diagnostics()["energy"]], jelly.masses.sum() * G
    for _ in range(14):  # before, it still swings by 1 % of the weight
        world.advance(0.1)
        energies.append(world.diagnostics()["energy"])
    world.advance(0.2)  # the obstacles have the sum of all intervals
    given = sum(collider.impulse for collider in jelly.colliders)
    assert given[2] == pytest.approx(-0.2 * weight, rel=0.01)
    # How the jelly came to lie depends on rounding.
    assert cloth.positions[:, 2].min() == pytest.approx(-0.083, abs=0.0025)
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


@pytest.mark.parametrize(
    ("cells", "locking"),
    [((16, 3, 3), 0.4), pytest.param((32, 3, 4), 0.15, marks=pytest.mark.slow)],
)
def test_a_column_of_liquid_on_an_elastic_plate(cells, locking):
    """Clamped at both ends, w = q L^4 / (384 D), D = E h^3 / 12 where nu = 0.

    (hydrostatic_column_on_elastic_plate of ../shared/reference/coupling.json, made softer.) Linear
    tetrahedra bend less than that; but as much under the liquid as under its weight as forces.
    """
    length, width, height, depth, d = 0.8, 0.16, 0.08, 0.2, 0.04
    q = 1000 * G * depth
    modulus = 12 * (q + 1000 * G * height) * length**4 / (384 * 0.01) / height**3
    mesh = substep.geometry.box_tetrahedra((length, width, height), cells)
    x = mesh.vertices

    def plate():
        return substep.SoftBody(
            x,
            mesh.tetrahedra,
            density=1000.0,
            young_modulus=modulus,
            poisson_ratio=0.0,
            pinned=np.abs(x[:, 0]) > 0.499 * length,
            damping_time=0.03,
            step=1 / 240,
        )

    middle = np.abs(x[:, 0]) < 1e-9
    alone, body = plate(), plate()
    top = body.faces[(x[body.faces][:, :, 2] > 0.499 * height).all(axis=1)]
    p = x[top]
    areas = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2
    weights = q * np.bincount(top.ravel(), np.repeat(areas / 3, 3), len(x))
    for _ in range(120):
        alone.set_forces(np.outer(weights, [0, 0, -1]))
        alone.step()
    sag = -(alone.positions - x)[middle, 2].mean()
    low = height / 2 + 0.03
    drops = substep.fill_box(
        (-length / 2, -width / 2, low), (length / 2, width / 2, low + depth), d
    )
    tank = substep.Collider(substep.Box((length, width, 4.0)), hollow=True)
    liquid = substep.PositionBasedFluid(
        drops, d, colliders=[tank, *body.make_colliders(0.06, faces=top)]
    )
    world = substep.World({"liquid": liquid, "body": body}, step=1 / 240)
    world.advance(0.4)
    sags, loads = [], []
    for _ in range(48):
        world.step()
        sags.append(-(body.positions - x)[middle, 2].mean())
        loads.append(-load(world)[2])
    assert np.mean(loads) == pytest.approx(liquid.masses.sum() * G, rel=0.01)
    assert np.mean(sags) == pytest.approx(sag, rel=0.01)
    assert np.mean(sags) == pytest.approx(0.01, rel=locking)


# ---------------------------------------------------------------------------- soft bodies


def test_a_closed_surface_displaces_its_volume():
    box = cube(0.3, 2, 500.0, (0, 0, 0))
    obstacles = box.make_colliders(0.05)
    x = np.array([[0, 0, 0.16], [0, 0.1, 0.149], [0.2, 0.05, -0.05], [0, -0.151, 0.12]])
    nearest = np.min([c.distance(x) for c in obstacles], axis=0)
    np.testing.assert_allclose(nearest, [0.01, -0.001, 0.05, 0.001], atol=2e-4)


@pytest.mark.parametrize(
    "method",
    ["particles", *(pytest.param(m, marks=pytest.mark.slow) for m in ("grid", "fine grid"))],
)
def test_a_jelly_floats_at_half_of_its_height(method):
    """The mean over a bob, as it is not damped; draft = density ratio."""
    side, depth, wide = 0.24, 0.24, 0.6
    d = {"particles": 0.04, "grid": 0.03, "fine grid": 0.0075}[method]
    fine = method == "fine grid"  # 300 triangles instead of 48, of which many are in one cell
    box = cube(side, 5 if fine else 2, 500.0, (wide / 2, wide / 2, depth))
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
            colliders=box.make_colliders(4.02 * d),
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
    assert method == "particles" or liquid.report.iterations <= 12


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
