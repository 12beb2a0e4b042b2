"""Free rotation against the equations of motion; mass properties against closed forms."""

import json
import pickle
import re
from pathlib import Path

import numpy as np
import pytest
import substep
from scipy import integrate, spatial, special
from substep import rigid
from substep.base.quaternions import multiply, rotate
from substep.errors import InputError, NonFiniteError

SHARED = Path(__file__).parents[3] / "shared"

# The box of half extents 0.5, 0.25, 0.1 and mass 1 that spins about its middle axis.
BOX = np.array([0.25 + 0.04, 1 + 0.04, 1 + 0.25]) / 12
SPIN = BOX * [0.01, 5.0, 0.0]


def matrices(q):
    """Rotation matrices of rows (w, x, y, z)."""
    w, x, y, z = np.asarray(q).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def seen_from_body(q, L):
    return np.einsum("nji,nj->ni", matrices(q), L)


def energies(q, L, inertia):
    return 0.5 * (seen_from_body(q, L) ** 2 / inertia).sum(axis=1)


def bodies(count, seed=5):
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(count, 4))
    sides = rng.uniform(0.2, 1.0, (count, 3))
    inertia = np.stack([(sides**2).sum(axis=1) - sides[:, i] ** 2 for i in range(3)], axis=1)
    return q / np.linalg.norm(q, axis=1, keepdims=True), rng.normal(size=(count, 3)), inertia


def motion(t, q, L, inertia):
    """q' = w q / 2 with w = R I^-1 R^T L."""
    R = matrices(q[None])[0]
    wx, wy, wz = R @ ((R.T @ L) / inertia)
    w, x, y, z = q
    return 0.5 * np.array(
        [
            -wx * x - wy * y - wz * z,
            wx * w + wy * z - wz * y,
            wy * w + wz * x - wx * z,
            wz * w + wx * y - wy * x,
        ]
    )


def test_exact_rotation_solves_the_equations_of_motion():
    q, L, inertia = bodies(6)
    q[0], L[0], inertia[0] = [1, 0, 0, 0], SPIN, BOX
    ends = rigid.free_rotation(q, L, inertia, 5.0)
    for i in range(len(q)):
        solved = integrate.solve_ivp(
            motion, (0, 5), q[i], "DOP853", rtol=1e-12, atol=1e-14, args=(L[i], inertia[i])
        )
        error = min(np.abs(solved.y[:, -1] - s * ends[i]).max() for s in (1, -1))
        assert error < (2e-9 if i == 0 else 2e-11)  # the unstable one amplifies that of DOP853


@pytest.mark.figure
def test_a_body_turns_over_when_the_reference_says():
    path = SHARED / "reference" / "solids.json"
    if not path.is_file():
        pytest.skip("needs ../shared/reference/solids.json, which is not here")
    text = json.loads(path.read_text())["dzhanibekov"]["exact"]
    numbers = re.search(r"w_y at ([\d., ]+) s, half-period ([\d.]+) s", text)
    flips, half_period = [float(x) for x in numbers[1].split(",")], float(numbers[2])
    h, count = 1 / 240, 24000

    def middle(q):
        return seen_from_body(q, SPIN[None])[0, 1]

    q, before, found, energy, length = np.array([[1.0, 0, 0, 0]]), SPIN[1], [], [], []
    for k in range(count):
        q_new = rigid.free_rotation(q, SPIN[None], BOX[None], h)
        after = middle(q_new)
        if before * after < 0:
            low, high = 0.0, h
            while high - low > 1e-8:
                half = 0.5 * (low + high)
                at = middle(rigid.free_rotation(q, SPIN[None], BOX[None], half))
                low, high = (half, high) if at * before > 0 else (low, half)
            found.append(k * h + low)
        q, before = q_new, after
        energy.append(energies(q, SPIN[None], BOX)[0])
        length.append(np.linalg.norm(matrices(q)[0].T @ SPIN))
    assert np.abs(np.array(energy) / energies(np.eye(4)[:1], SPIN[None], BOX)[0] - 1).max() < 1e-12
    assert np.abs(np.array(length) / np.linalg.norm(SPIN) - 1).max() < 1e-14
    assert len(found) == 22
    expected = flips + [flips[-1] + k * half_period for k in range(1, 19)]
    assert np.abs(np.array(found) - expected).max() < 1e-5 + 19 * 5e-7  # digits of the half-period


def test_the_half_period_is_that_of_jacobis_functions():
    # 2 K(k) / lambda by SciPy, with the modulus from the constants of the motion (Landau and
    # Lifshitz, Mechanics, eq. 37.8 - 37.10).
    (i1, i2, i3), T2, L2 = BOX, (SPIN**2 / BOX).sum(), (SPIN**2).sum()
    if L2 < T2 * i2:
        i1, i3 = i3, i1
    rate = np.sqrt((i3 - i2) * (L2 - T2 * i1) / (i1 * i2 * i3))
    k2 = (i2 - i1) * (T2 * i3 - L2) / ((i3 - i2) * (L2 - T2 * i1))
    half = 2 * special.ellipk(k2) / rate
    start = seen_from_body([[1.0, 0, 0, 0]], SPIN[None])[0]
    there = seen_from_body(rigid.free_rotation([[1, 0, 0, 0]], [SPIN], [BOX], half), SPIN[None])[0]
    # After half a period the middle component and one more have changed their signs.
    assert np.abs(np.abs(there) - np.abs(start)).max() < 1e-9
    assert np.sign(there[1]) == -np.sign(start[1])


def test_symmetric_tops_precess_at_the_known_rate():
    # The axis goes round L with L / I1: after that period the top points as it did.
    I1, I3 = 0.3, 0.5
    q, L = bodies(1)[0], np.array([[0.3, -0.4, 1.2]])
    inertia = np.array([[I1, I1, I3]])
    period = 2 * np.pi * I1 / np.linalg.norm(L)
    for method, steps in (("exact", 1), ("exact", 1000), ("splitting", 1000)):
        for turns in (1, 50):
            end = rigid.free_rotation(q, L, inertia, turns * period, method=method, steps=steps)
            assert np.abs(matrices(end)[0, :, 2] - matrices(q)[0, :, 2]).max() < 1e-11


@pytest.mark.parametrize("method", ["exact", "splitting"])
def test_time_runs_backward_and_in_pieces(method):
    q, L, inertia = bodies(200)
    there = rigid.free_rotation(q, L, inertia, 0.7, method=method, steps=50)
    back = rigid.free_rotation(there, L, inertia, -0.7, method=method, steps=50)
    assert np.abs(np.abs((back * q).sum(axis=1)) - 1).max() < 1e-14
    if method == "exact":
        whole = rigid.free_rotation(q, L, inertia, 0.7)
        assert np.abs(np.abs((whole * there).sum(axis=1)) - 1).max() < 1e-14


def test_splitting_keeps_the_energy_and_the_textbook_does_not():
    drift = {}
    for method in ("exact", "splitting", "quaternion", "matrix"):
        q, worst = np.array([[1.0, 0, 0, 0]]), 0.0
        for _ in range(240):  # 24000 steps of 1/240 s
            q = rigid.free_rotation(q, [SPIN], [BOX], 100 / 240, method=method, steps=100)
            energy = energies(q, SPIN[None], BOX)[0] / (0.5 * (SPIN**2 / BOX).sum())
            worst = max(worst, abs(energy - 1))
        drift[method] = worst
    assert drift["exact"] < 1e-12
    assert drift["splitting"] < 1e-5
    assert drift["quaternion"] > 1 and drift["matrix"] > 0.05


def test_momenta_of_a_million_radians_per_second_are_finite():
    q, L, inertia = bodies(50)
    ends = rigid.free_rotation(q, 1e6 * L, inertia, 1 / 240)
    before, after = energies(q, 1e6 * L, inertia), energies(ends, 1e6 * L, inertia)
    assert np.abs(after / before - 1).max() < 1e-10
    with pytest.raises(NonFiniteError, match=r"rotations\[0\]"):
        rigid.free_rotation(q, 1e300 * L, inertia, 1e200)


def test_threads_do_not_change_bits():
    q, L, inertia = bodies(5000)
    for method in ("exact", "splitting", "quaternion", "matrix"):
        one, two, three = (
            rigid.free_rotation(q, L, inertia, 0.1, method=method, steps=3, threads=n)
            for n in (1, 2, 3)
        )
        assert (one == two).all() and (one == three).all()
    assert rigid.free_rotation(q[:0], L[:0], inertia[:0], 1.0).shape == (0, 4)


def test_free_rotation_refuses():
    q, L, inertia = bodies(3)
    bad = inertia.copy()
    for row, wanted in (([1, 0, 1], "above 0"), ([1, 1, 3], "sum of the other two")):
        bad[1] = row
        with pytest.raises(InputError, match=rf"inertia\[1.*{wanted}"):
            rigid.free_rotation(q, L, bad, 1.0)
    zero = q.copy()
    zero[2] = 0
    with pytest.raises(InputError, match=r"rotations\[2\]: expected a quaternion that is not 0"):
        rigid.free_rotation(zero, L, inertia, 1.0)
    with pytest.raises(InputError, match="method: expected one of exact"):
        rigid.free_rotation(q, L, inertia, 1.0, method="euler")
    for steps in (0, -1, 1.5, True):
        with pytest.raises(InputError, match="steps"):
            rigid.free_rotation(q, L, inertia, 1.0, steps=steps)
    with pytest.raises(InputError, match="duration"):
        rigid.free_rotation(q, L, inertia, np.nan)
    # Unnormalised quaternions are normalised.
    scaled = rigid.free_rotation(q * [[1e-200], [3.0], [1e200]], L, inertia, 1.0)
    assert np.abs(scaled - rigid.free_rotation(q, L, inertia, 1.0)).max() < 1e-14


# Mass properties.


def test_mass_of_shapes():
    ball = rigid.mass_properties(rigid.Sphere(0.3), 500)
    assert ball.mass == pytest.approx(500 * 4 / 3 * np.pi * 0.027, rel=1e-15)
    assert ball.principal_inertia == pytest.approx(0.4 * ball.mass * 0.09, rel=1e-15)
    box = rigid.mass_properties(rigid.Box([1, 0.5, 0.2]), 10)
    assert box.principal_inertia == pytest.approx(BOX, rel=1e-15)
    assert (box.axes == [1, 0, 0, 0]).all() and (box.center_of_mass == 0).all()
    rod = rigid.mass_properties(rigid.Cylinder(0.1, 1), 10)
    assert rod.principal_inertia[2] == pytest.approx(rod.mass * 0.01 / 2, rel=1e-15)
    pill = rigid.mass_properties(rigid.Capsule(0.1, 1), 10)
    assert pill.mass == pytest.approx(rod.mass + 10 * 4 / 3 * np.pi * 1e-3, rel=1e-15)


def test_moved_bodies_and_compounds():
    box = rigid.mass_properties(rigid.Box([1, 0.5, 0.2]), 10)
    turned = box.moved([1, 2, 3], [3, 0.3, -0.6, 0.9])
    assert (turned.center_of_mass == [1, 2, 3]).all()
    assert turned.principal_inertia == pytest.approx(BOX, rel=1e-14)
    R = matrices(turned.axes[None])[0]
    assert R @ np.diag(turned.principal_inertia) @ R.T == pytest.approx(turned.inertia, abs=1e-15)
    halves = [box.moved([-0.5, 0, 0]), box.moved([0.5, 0, 0])]
    whole = rigid.compound(halves)
    long = rigid.mass_properties(rigid.Box([2, 0.5, 0.2]), 10)
    assert whole.principal_inertia == pytest.approx(long.principal_inertia, rel=1e-14)
    again = pickle.loads(pickle.dumps(turned))
    assert (again.inertia == turned.inertia).all() and (again.axes == turned.axes).all()
    with pytest.raises(InputError, match="at least one"):
        rigid.compound([])
    with pytest.raises(TypeError, match="parts"):
        rigid.compound([box, 3])


def test_mass_of_convex_hulls_is_that_of_qhull():
    points = np.random.default_rng(2).normal(size=(60, 3))
    body = rigid.mass_properties(rigid.ConvexHull(points), 2.0)
    assert body.mass == pytest.approx(2 * spatial.ConvexHull(points).volume, rel=1e-9)
    parts = spatial.Delaunay(points).simplices  # the hull in tetrahedra
    corners = points[parts]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
    centre = (volumes[:, None] * corners.mean(axis=1)).sum(axis=0) / volumes.sum()
    assert body.center_of_mass == pytest.approx(centre, abs=1e-9)
    r = corners - centre
    s = r.sum(axis=1)
    C = np.einsum("t,tki,tkj->ij", volumes / 20, r, r) + np.einsum("t,ti,tj", volumes / 20, s, s)
    assert body.inertia == pytest.approx(2 * (np.trace(C) * np.eye(3) - C), abs=1e-8)


def real_mesh(name):
    path = SHARED / "data" / "meshes" / f"{name}.obj"
    if not path.is_file():
        pytest.skip("needs ../shared/data/meshes, which is not here")
    return substep.geometry.read_mesh(path)


def test_mass_of_a_real_mesh_is_what_its_inside_says():
    mesh = real_mesh("spot")
    body = rigid.mass_properties(mesh, 1.0)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    n = 60
    grid = (np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), -1).reshape(-1, 3) + 0.5) / n
    grid += np.random.default_rng(1).uniform(-0.5 / n, 0.5 / n, grid.shape)  # one point per cell
    points = low + grid * (high - low)
    inside = points[mesh.winding_number(points) > 0.5]
    cell = (high - low).prod() / n**3
    assert body.mass == pytest.approx(len(inside) * cell, rel=3e-3)
    assert body.mass == pytest.approx(mesh.volume, rel=1e-12)
    assert body.center_of_mass == pytest.approx(inside.mean(axis=0), abs=2e-3)
    r = inside - body.center_of_mass
    C = cell * r.T @ r
    assert body.inertia == pytest.approx(np.trace(C) * np.eye(3) - C, abs=2e-3)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("cow", "cuts itself: 72 edges"),
        ("stanford-bunny", "is not closed: the edge (10125, 10208) belongs to no other face"),
        ("suzanne", "is not closed"),
        ("teapot", "is not closed"),
    ],
)
def test_meshes_that_bound_no_solid_are_refused(name, wrong):
    with pytest.raises(InputError, match=re.escape(wrong)):
        rigid.mass_properties(real_mesh(name).cleaned())


# Two triangles for each side of a cube; bits of a corner's number are its x, y and z.
CUBE = np.array(
    [
        [[int(v) for v in face] for face in (a + c + d, a + d + b)]
        for a, b, c, d in ("0123", "4657", "0415", "2367", "0246", "1537")
    ]
).reshape(12, 3)


def test_mass_properties_refuse():
    cube = substep.geometry.TriangleMesh(
        [[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)],
        CUBE,
    )
    assert rigid.mass_properties(cube, 3).mass == pytest.approx(3, rel=1e-15)
    assert (rigid.mass_properties(cube).axes == [1, 0, 0, 0]).all()  # equal moments have no axes
    inward = substep.geometry.TriangleMesh(cube.vertices, cube.faces[:, ::-1])
    with pytest.raises(InputError, match="inside out"):
        rigid.mass_properties(inward)
    two = substep.geometry.TriangleMesh(
        np.vstack([cube.vertices, cube.vertices + np.array([0.5, 0.4, 0.3])]),
        np.vstack([cube.faces, cube.faces + 8]),
    )
    with pytest.raises(InputError, match="cuts itself"):
        rigid.mass_properties(two)
    for density in (0, -1, np.nan, np.inf):
        with pytest.raises(InputError, match="density"):
            rigid.mass_properties(cube, density)
    for bad in (0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="radius"):
            rigid.Sphere(bad)
        with pytest.raises(InputError, match="length"):
            rigid.Capsule(1, bad)
        with pytest.raises(InputError, match="lengths"):
            rigid.Box([2, bad, 2])
    with pytest.raises(InputError, match="plane"):
        rigid.mass_properties(rigid.ConvexHull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]))
    with pytest.raises(TypeError, match="shape"):
        rigid.mass_properties("ball")
    with pytest.raises(InputError, match="mass"):
        rigid.MassProperties(0, [0, 0, 0], np.eye(3))
    for inertia, wanted in (
        (np.diag([1, 1, 0]), "above 0"),
        (np.diag([1, 1, 3]), "sum of the other two"),
        ([[1, 0.1, 0], [0, 1, 0], [0, 0, 1]], "symmetric"),
    ):
        with pytest.raises(InputError, match=wanted):
            rigid.MassProperties(1, [0, 0, 0], inertia)
    with pytest.raises(InputError, match="rotation: expected a quaternion that is not 0"):
        rigid.mass_properties(cube).moved([0, 0, 0], [0, 0, 0, 0])


def test_rotations_of_few_rows_have_the_bits_of_many():
    rng = np.random.default_rng(0)
    p, q = rng.normal(size=(2, 40, 4))
    for formula, right in ((multiply, q), (rotate, q[:, 1:])):
        many = formula(p, right)
        assert np.array_equal(formula(p[3], right[3]), many[3])
        for n in (0, 1, 5, 16, 17):
            assert np.array_equal(formula(p[:n], right[:n]), many[:n])
