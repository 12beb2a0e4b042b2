"""Constraints of position-based dynamics: every class of substep.pbd, and each on its own."""

import ctypes
import inspect

import numpy as np
import pytest
import substep
from substep import _core, pbd
from substep.pbd import rest as pbd_rest
from substep.pbd.group import Constraint

CLASSES = {
    name: value
    for name, value in vars(pbd).items()
    if name in pbd.__all__
    and inspect.isclass(value)
    and issubclass(value, Constraint)
    and not name.endswith("Collision")  # contacts come and go: tests/test_pbd_self_contact.py
}
# What a class needs beside its particles.
ARGUMENTS = {"NeoHookean": {"young_modulus": 1e3, "poisson_ratio": 0.3}}
FORMULAS = sorted(
    name for name in CLASSES if getattr(CLASSES[name], "_kind", None) in _core.constraint_kinds()
)
JOINED = sorted(set(CLASSES) - {"Attachment"})  # to each other, not to the world
STILL = {"gravity": (0, 0, 0), "substeps": 1, "dtype": "float64"}


def equal_lengths(x):
    """A user's constraint of three particles: |x1 - x0| = |x2 - x1|."""
    one, two = x[:, 1] - x[:, 0], x[:, 2] - x[:, 1]
    length_one, length_two = (np.linalg.norm(d, axis=1) for d in (one, two))
    u, v = one / length_one[:, None], two / length_two[:, None]
    return length_one - length_two, np.stack([-u, u + v, -v], axis=1)


def points(name):
    return _core.constraint_kinds()[CLASSES[name]._kind]["points"]


def make(name, count=12, seed=0, overlap=False, **options):
    """Constraints of the class, and the number of particles that they need."""
    cls, rng = CLASSES[name], np.random.default_rng(seed)
    options = {**ARGUMENTS.get(name, {}), **options}
    k = {"ShapeMatching": 6, "CustomConstraint": 3}.get(name) or points(name)
    number = count * k
    if overlap:
        particles = np.array([rng.choice(number, k, replace=False) for _ in range(count)])
    else:
        particles = rng.permutation(number).reshape(count, k)
    if name == "ShapeMatching":
        return cls(list(particles), **options), number
    if name == "CustomConstraint":
        return cls(particles, equal_lengths, **options), number
    return cls(particles[:, 0] if k == 1 else particles, **options), number


def scene(name, *, dtype="float64", overlap=False, substeps=1, iterations=1, threads=None, **more):
    """A simulation at rest at random places, that is then put somewhere else."""
    constraint, number = make(name, overlap=overlap, **more)
    rng = np.random.default_rng(1)
    rest = rng.uniform(-1, 1, (number, 3))
    sim = substep.PositionBasedDynamics(
        rest,
        rng.uniform(1, 3, number),
        [constraint],
        gravity=(0, 0, 0),
        substeps=substeps,
        iterations=iterations,
        dtype=dtype,
        threads=threads,
    )
    sim.set_positions(rest + rng.uniform(-0.3, 0.3, rest.shape))
    return sim


def residual(sim):
    """|C| of all constraints; of an inequality only what is violated."""
    values = np.concatenate([sim._native.values(g) for g in range(groups(sim))])
    one_sided = isinstance(sim.constraints[0], pbd.Tether)
    return np.linalg.norm(np.minimum(values, 0) if one_sided else values)


def groups(sim):
    return 2 if isinstance(sim.constraints[0], pbd.NeoHookean) else 1


def momenta(sim, x):
    m, v = sim.masses[:, None], sim.velocities
    return (m * v).sum(axis=0), np.cross(x, m * v).sum(axis=0)


def test_every_formula_has_its_class():
    told = set()
    for name in FORMULAS:
        constraint, number = make(name)
        rest = np.random.default_rng(2).uniform(-1, 1, (number, 3))
        told |= {formula.kind for formula in constraint._formulas(rest)}
    assert told == set(_core.constraint_kinds())


@pytest.mark.parametrize("name", FORMULAS)
def test_gradient_is_that_of_finite_differences(name):
    constraint, number = make(name)
    rng, h = np.random.default_rng(2), 1e-5
    rest = rng.uniform(-1, 1, (number, 3))
    x = (rest + rng.uniform(-0.3, 0.3, rest.shape))[constraint.particles]
    for formula in constraint._formulas(rest):
        numbers = np.ascontiguousarray(formula.parameters)
        _, gradient = _core.evaluate_constraints(formula.kind, x, numbers)
        assert gradient.any(axis=(1, 2)).all()
        for i, axis in np.ndindex(x.shape[1:]):
            shift = np.zeros(x.shape)
            shift[:, i, axis] = h
            up, _ = _core.evaluate_constraints(formula.kind, x + shift, numbers)
            down, _ = _core.evaluate_constraints(formula.kind, x - shift, numbers)
            np.testing.assert_allclose(
                gradient[:, i, axis], (up - down) / (2 * h), rtol=1e-5, atol=1e-6
            )


@pytest.mark.parametrize("overlap", [False, True])
@pytest.mark.parametrize("name", JOINED)
def test_a_projection_keeps_momentum(name, overlap):
    sim = scene(name, overlap=overlap)
    before = sim.positions
    sim.step(0.01)
    linear, angular = momenta(sim, before)
    size = np.abs(sim.masses[:, None] * sim.velocities).sum()
    assert size > 1e-3
    assert np.abs(linear).max() < 1e-13 * size
    # Where constraints follow each other, each keeps it about where the ones before have moved to.
    if not overlap and name != "NeoHookean":
        assert np.abs(angular).max() < 1e-12 * size


@pytest.mark.parametrize("name", JOINED)
def test_a_turned_and_shifted_scene_turns_and_shifts(name):
    sim, other = scene(name), scene(name)
    axis, angle = np.array([1.0, 2.0, -1.0]) / 6**0.5, 1.1
    K = np.cross(np.eye(3), axis)
    R = np.eye(3) - np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    shift = np.array([3.0, -5.0, 2.0])
    other.set_positions(sim.positions @ R.T + shift)
    sim.step(0.01)
    other.step(0.01)
    np.testing.assert_allclose(other.positions, sim.positions @ R.T + shift, atol=1e-10)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("name", sorted(CLASSES))
def test_projections_let_the_residual_fall(name, dtype):
    sim = scene(name, dtype=dtype, iterations=30)
    before = residual(sim)
    assert before > 0.1
    sim.step(1e-2)
    # Neo-Hookean constraints are soft, and balance each other.
    assert residual(sim) < (0.999 if name == "NeoHookean" else 1e-3) * before


@pytest.mark.parametrize("name", sorted(CLASSES))
def test_bits_do_not_depend_on_threads(name):
    hashes = set()
    for threads in (1, 2, 3):
        sim = scene(name, dtype="float32", overlap=True, substeps=4, threads=threads, count=300)
        sim.step(0.01)
        hashes.add(substep.state_hash(sim.positions, sim.velocities))
    assert len(hashes) == 1


@pytest.mark.parametrize("name", ["Attachment", "Distance", "Tether"])
def test_the_step_of_soft_constraints_does_not_depend_on_iterations(name):
    """XPBD, where constraints do not touch and the first projection is all there is to do."""
    once, often = (scene(name, iterations=n, compliance=1e-3) for n in (1, 20))
    once.step(0.01)
    often.step(0.01)
    assert residual(once) > 0.1
    np.testing.assert_allclose(once.positions, often.positions, atol=1e-12)


DEGENERATE = {
    "coincident": lambda x: np.zeros_like(x),
    "on a line": lambda x: np.outer(np.arange(len(x)), [1.0, 2.0, -0.5]),
    "in a plane": lambda x: x * [1, 1, 0],
    "stretched": lambda x: 1e6 * x,
    "crushed": lambda x: 1e-2 * x,
    "mirrored": lambda x: x * [1, 1, -1],
}


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("where", DEGENERATE)
@pytest.mark.parametrize("name", sorted(set(CLASSES) - {"CustomConstraint"}))
def test_degenerate_places_never_give_nan(name, where, dtype):
    for at_rest in (False, True):
        constraint, number = make(name)
        x = np.random.default_rng(1).uniform(-1, 1, (number, 3))
        bad = DEGENERATE[where](x)
        sim = substep.PositionBasedDynamics(
            bad if at_rest else x, 1.0, [constraint], gravity=(0, 0, 0), dtype=dtype
        )
        if not at_rest:
            sim.set_positions(bad)
        for _ in range(5):
            sim.step(0.01)
        assert np.isfinite(sim.positions).all()
        assert np.isfinite(sim.velocities).all()
        if at_rest and where != "stretched":
            np.testing.assert_allclose(sim.positions, bad, atol=1e-3)


@pytest.mark.parametrize("name", sorted(CLASSES))
def test_pinned_particles_are_not_moved(name):
    constraint, number = make(name)
    x = np.random.default_rng(1).uniform(-1, 1, (number, 3))
    sim = substep.PositionBasedDynamics(x, 1.0, [constraint], pinned=range(number), **STILL)
    sim.set_positions(1.5 * x)
    sim.step(0.01)
    np.testing.assert_allclose(sim.positions, 1.5 * x, rtol=1e-15)


def test_what_has_no_gradient_is_counted():
    line = np.outer(np.arange(4.0), [1, 0, 0])
    for constraint, skipped in (
        (pbd.Bending([[0, 1, 2, 3]], 0.5), 1),
        (pbd.TriangleArea([[0, 1, 2]], 1.0), 1),
        (pbd.TetrahedronVolume([[0, 1, 2, 3]], 1.0), 1),
        (pbd.NeoHookean([[0, 1, 2, 3]], 1e3, 0.3), 1),  # the hydrostatic one
    ):
        sim = substep.PositionBasedDynamics(line, 1.0, [constraint], **STILL)
        sim.step(0.01)
        assert sim.diagnostics()["skipped"] == skipped, constraint


def test_what_is_satisfied_is_not_counted():
    sheet = substep.geometry.grid_mesh(4, 4)
    sim = substep.PositionBasedDynamics(
        sheet.vertices,
        1.0,
        [pbd.IsometricBending(sheet.hinges), pbd.Attachment([0]), pbd.Tether([[0, 3]])],
        **STILL,
    )
    sim.step(0.01)
    assert sim.diagnostics()["skipped"] == 0


@pytest.mark.parametrize("name", FORMULAS)
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf, [0.0, 0.0]])
def test_softness_is_checked(name, value):
    argument = "damping_time" if name == "NeoHookean" else "compliance"
    if name == "NeoHookean" and isinstance(value, list):
        with pytest.raises(TypeError, match="damping_time"):
            make(name, damping_time=value)
        return
    with pytest.raises(substep.errors.InputError, match=argument):
        make(name, **{argument: value})


@pytest.mark.parametrize("name", FORMULAS)
@pytest.mark.parametrize("bad", ["negative", "repeated", "float", "beyond"])
def test_indices_are_checked(name, bad):
    k = points(name)
    row = np.arange(k)
    if bad == "repeated" and k == 1:
        pytest.skip("one particle")
    row = {
        "negative": row - 1,
        "repeated": np.zeros(k, int),
        "float": row + 0.0,
        "beyond": row + 2**31,
    }[bad]
    with pytest.raises((substep.errors.InputError, TypeError)):
        CLASSES[name](row if k == 1 else [row], **ARGUMENTS.get(name, {}))


@pytest.mark.parametrize("name", sorted(CLASSES))
def test_indices_beyond_the_particles_are_refused(name):
    constraint, _ = make(name)
    with pytest.raises(substep.errors.InputError, match=r"expected (an index|indices) from 0"):
        substep.PositionBasedDynamics(np.eye(3), 1.0, [constraint])


@pytest.mark.parametrize(
    ("call", "argument"),
    [
        (lambda: pbd.Bending([[0, 1, 2, 3]], rest_angles=np.nan), "rest_angles"),
        (lambda: pbd.TriangleArea([[0, 1, 2]], rest_areas=-1.0), "rest_areas"),
        (lambda: pbd.TetrahedronVolume([[0, 1, 2, 3]], rest_volumes=[1, 2]), "rest_volumes"),
        (lambda: pbd.Tether([[0, 1]], lengths=-1.0), "lengths"),
        (lambda: pbd.Attachment([[0]]), "particles"),
        (lambda: pbd.Attachment([0], targets=[[0, 0]]), "targets"),
        (lambda: pbd.NeoHookean([[0, 1, 2, 3]], 0.0, 0.3), "young_modulus"),
        (lambda: pbd.NeoHookean([[0, 1, 2, 3]], 1.0, 0.5), "poisson_ratio"),
        (lambda: pbd.NeoHookean([[0, 1, 2, 3]], 1.0, -1.0), "poisson_ratio"),
        (lambda: pbd.IsometricBending([[0, 1, 2, 3]], rest_positions=np.eye(3)), "hinges"),
        (lambda: pbd.ShapeMatching([]), "clusters"),
        (lambda: pbd.ShapeMatching([[0, 0]]), "clusters"),
        (lambda: pbd.ShapeMatching([[0, 1]], linear=1.5), "linear"),
        (lambda: pbd.Tether([[0, 1]], stiffness=1.5), "stiffness"),
        (lambda: pbd.Tether([[0, 1]], stiffness=0.5, compliance=1.0), "stiffness"),
        (lambda: pbd.rope(1), "count"),
        (lambda: pbd.cloth("sheet"), "mesh"),
        (lambda: pbd.soft_body("jelly"), "mesh"),
        (lambda: pbd.vertex_clusters([[0, 1]], 2, rings=0), "rings"),
        (lambda: pbd.tethers(np.eye(3), [[0, 1]], [2]), "pins"),
    ],
)
def test_wrong_arguments_are_named(call, argument):
    with pytest.raises(substep.errors.InputError, match=argument):
        call()


# Custom constraints


def test_a_custom_distance_is_the_built_in_one():
    def distance(x):
        d = x[:, 0] - x[:, 1]
        length = np.linalg.norm(d, axis=1)
        n = d / length[:, None]
        return length - 1.0, np.stack([n, -n], axis=1)

    pairs = [[0, 1], [2, 3], [4, 5]]
    x = np.random.default_rng(3).normal(size=(6, 3))
    results = []
    for constraint in (
        pbd.CustomConstraint(pairs, distance, compliance=1e-3, damping=5.0, check_gradient=True),
        pbd.Distance(pairs, 1.0, compliance=1e-3, damping=5.0),
    ):
        sim = substep.PositionBasedDynamics(
            x, [1, 2, 3, 1, 2, 3], [constraint], iterations=3, dtype="float64"
        )
        for _ in range(10):
            sim.step()
        results.append(sim.positions)
    np.testing.assert_allclose(*results, atol=1e-9)


C_DISTANCE = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4)


@C_DISTANCE
def c_distance(x, c, gradient, p):
    at = np.ctypeslib.as_array((ctypes.c_double * 6).from_address(x)).reshape(2, 3)
    out = np.ctypeslib.as_array((ctypes.c_double * 6).from_address(gradient)).reshape(2, 3)
    d = at[0] - at[1]
    length = np.sqrt(d @ d)
    out[0], out[1] = d / length, -d / length
    ctypes.c_double.from_address(c).value = length - ctypes.c_double.from_address(p).value


def test_a_compiled_chain_is_the_built_in_one():
    pairs = np.stack([np.arange(5), np.arange(1, 6)], axis=1)
    lengths = np.linspace(0.5, 1, 5)
    x = np.outer([0, *np.cumsum(lengths)], [1, 0, 0])
    results = []
    for constraint in (
        pbd.CustomConstraint(pairs, c_distance, parameters=lengths[:, None], check_gradient=True),
        pbd.Distance(pairs, lengths),
    ):
        sim = substep.PositionBasedDynamics(
            x, 1.0, [constraint], pinned=[0], dtype="float64", substeps=200
        )
        sim.advance(0.25)
        results.append(sim.positions)
    # The order of the sweep differs, so only what is converged agrees.
    assert np.abs(np.linalg.norm(np.diff(results[0], axis=0), axis=1) - lengths).max() < 1e-3
    np.testing.assert_allclose(*results, atol=2e-3)


def test_numba_functions_are_compiled_constraints():
    numba = pytest.importorskip("numba")
    pointer = numba.types.CPointer(numba.types.float64)

    @numba.cfunc(numba.types.void(pointer, pointer, pointer, pointer))
    def height(x, c, gradient, p):
        c[0] = x[2] - p[0]
        gradient[2] = 1.0

    ground = pbd.CustomConstraint([[0], [1]], height, parameters=[[-1.0], [-2.0]], inequality=True)
    sim = substep.PositionBasedDynamics(np.zeros((2, 3)), 1.0, [ground])
    sim.advance(2.0)
    np.testing.assert_allclose(sim.positions[:, 2], [-1, -2], atol=1e-6)


def free_fall(fun, **options):
    constraint = pbd.CustomConstraint([[0, 1]], fun, **options)
    sim = substep.PositionBasedDynamics([[0, 0, 0], [1, 0, 0]], 1.0, [constraint])
    return sim


def test_a_custom_gradient_of_zero_is_skipped_and_counted():
    sim = free_fall(lambda x: (np.ones(1), np.zeros((1, 2, 3))))
    sim.step(0.01)
    assert sim.diagnostics()["skipped"] == sim.substeps
    np.testing.assert_allclose(sim.velocities[:, 2], -0.0981, rtol=1e-5)


@pytest.mark.parametrize(
    "use",
    [
        lambda sim: sim.positions,
        lambda sim: sim.set_velocities(np.zeros((2, 3))),
        lambda sim: sim.step(0.01),
    ],
)
def test_a_function_in_the_middle_of_a_step_cannot_use_the_simulation(use):
    sim = free_fall(lambda x: (use(sim), np.zeros(x.shape)))
    before = sim.state()
    with pytest.raises(substep.InputError, match="in the middle of a step"):
        sim.step(0.01)
    after = sim.state()
    assert all(np.array_equal(after[name], before[name]) for name in before)
    other = free_fall(lambda x: (np.zeros(1), np.zeros(x.shape)))
    inner = free_fall(lambda x: (other.step(0.01), (np.zeros(1), np.zeros(x.shape)))[1])
    inner.step(0.01)  # another simulation is free
    assert other.report.steps == 1 and other.time == pytest.approx(0.01 * inner.substeps)


def test_an_exception_passes_and_the_state_is_as_before():
    class Own(Exception):
        pass

    mine, calls = Own("mine"), []

    def fun(x):
        calls.append(1)
        if len(calls) == 14:
            raise mine
        return x[:, 0, 0], np.ones(x.shape)

    sim = free_fall(fun)
    sim.step(0.01)
    before = substep.state_hash(sim.positions, sim.velocities, np.array(sim.time))
    with pytest.raises(Own) as caught:
        sim.step(0.01)
    assert caught.value is mine
    assert substep.state_hash(sim.positions, sim.velocities, np.array(sim.time)) == before
    sim.step(0.01)
    assert sim.time == pytest.approx(0.02)


@pytest.mark.parametrize(
    "answer",
    [
        lambda x: np.zeros(1),
        lambda x: (np.zeros(2), np.zeros(x.shape)),
        lambda x: (np.zeros(1), np.zeros((1, 2, 2))),
        lambda x: (0.0, np.zeros(x.shape)),
        lambda x: None,
    ],
)
def test_a_wrong_shape_is_refused(answer):
    sim = free_fall(answer)
    before = sim.positions
    with pytest.raises(substep.errors.InputError, match="fun"):
        sim.step(0.01)
    np.testing.assert_array_equal(sim.positions, before)


def test_a_nan_of_the_user_is_not_taken():
    sim = free_fall(lambda x: (np.array([np.nan]), np.ones(x.shape)))
    with pytest.raises(substep.errors.NonFiniteError, match="custom constraint 0"):
        sim.step(0.01)
    np.testing.assert_array_equal(sim.positions, [[0, 0, 0], [1, 0, 0]])


def test_positions_are_read_only():
    def fun(x):
        x[0] = 1
        return np.zeros(1), np.zeros(x.shape)

    with pytest.raises(ValueError, match="read-only"):
        free_fall(fun).step(0.01)


def test_a_wrong_gradient_is_found():
    def wrong(x):
        c, gradient = equal_lengths(x)
        return c, -gradient

    with pytest.raises(substep.errors.InputError, match=r"gradient\[0, 0, 0\]"):
        substep.PositionBasedDynamics(
            np.random.default_rng(0).normal(size=(3, 3)),
            1.0,
            [pbd.CustomConstraint([[0, 1, 2]], wrong, check_gradient=True)],
        )


def test_many_custom_constraints_on_one_particle_stay_stable():
    """A heavy hub with 60 spokes: all evaluated at once, projected one after the other."""
    n = 60
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    rim = 1.05 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)

    def spokes(x):
        d = x[:, 1] - x[:, 0]
        length = np.linalg.norm(d, axis=1)
        u = d / length[:, None]
        return length - 1, np.stack([-u, u], axis=1)

    wheel = pbd.CustomConstraint(np.stack([np.zeros(n, int), np.arange(1, n + 1)], 1), spokes)
    sim = substep.PositionBasedDynamics(
        np.concatenate([np.zeros((1, 3)), rim]), [n, *[1] * n], [wheel], drag=5.0
    )
    sim.advance(1.0)
    lengths = np.linalg.norm(sim.positions[1:] - sim.positions[0], axis=1)
    np.testing.assert_allclose(lengths, 1, atol=1e-3)


def test_positions_of_custom_constraints_are_in_the_world():
    seen = []

    def fun(x):
        seen.append(x.copy())
        return np.zeros(len(x)), np.zeros(x.shape)

    x = np.array([[1000.0, 2, 3], [1001, 2, 3]])
    constraint = pbd.CustomConstraint([[1, 0]], fun)
    substep.PositionBasedDynamics(x, 1.0, [constraint], gravity=(0, 0, 0)).step(0.01)
    np.testing.assert_array_equal(seen[0][0], x[::-1])


# What each is for


def test_an_attachment_is_a_damped_spring():
    """Implicit Euler of m x'' = -k x - c x', step by step."""
    k, c, m, h = 400.0, 3.0, 2.0, 0.01
    sim = substep.PositionBasedDynamics(
        [[0.5, 0, 0]],
        m,
        [pbd.Attachment([0], [[0, 0, 0]], compliance=1 / k, damping=c)],
        gravity=(0, 0, 0),
        substeps=1,
        dtype="float64",
    )
    x, v = 0.5, 0.0
    for _ in range(50):
        sim.step(h)
        v = (m * v - h * k * x) / (m + h * c + h * h * k)
        x += h * v
        assert sim.positions[0, 0] == pytest.approx(x, abs=1e-12)


def test_tethers_carry_a_pin_through_a_cloth():
    """60 x 60 vertices hanging by one edge, ten projections a frame."""
    sheet = substep.geometry.grid_mesh(60, 60)
    top = np.flatnonzero(sheet.vertices[:, 1] == sheet.vertices[:, 1].max())
    longest = []
    for held in ([], [pbd.tethers(sheet.vertices, sheet.edges, top)]):
        sim = substep.PositionBasedDynamics(
            sheet.vertices,
            0.2 * sheet.vertex_areas,
            [*pbd.cloth(sheet), *held],
            pinned=top,
            gravity=(0, -9.81, 0),
        )
        for _ in range(30):
            sim.step()
        longest.append(np.ptp(sim.positions[:, 1]))
    height = np.ptp(sheet.vertices[:, 1])
    assert longest[0] > 1.05 * height
    assert longest[1] < 1.005 * height


def test_path_lengths_are_the_shortest():
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    sheet = substep.geometry.grid_mesh(9, 7)
    a, b = sheet.edges.T
    lengths = np.linalg.norm(sheet.vertices[a] - sheet.vertices[b], axis=1)
    graph = coo_array((lengths, (a, b)), shape=(63, 63)).tocsr()
    expected = dijkstra(graph, directed=False, indices=[0, 62]).min(axis=0)
    tether = pbd.tethers(sheet.vertices, sheet.edges, [0, 62])
    np.testing.assert_allclose(tether.lengths, expected[tether.particles[:, 1]])


@pytest.mark.figure
@pytest.mark.parametrize("bending", ["isometric", "dihedral"])
def test_a_strip_comes_to_rest_in_its_minimum(bending):
    """A clamped strip under its weight, against the linear system K z = -m g of small bends."""
    n, length, density, rigidity = 16, 0.5, 0.2, 1e-3
    strip = substep.geometry.grid_mesh(n + 1, 3, (length, 2 * length / n))
    strip = substep.geometry.TriangleMesh(strip.vertices - strip.vertices.min(axis=0), strip.faces)
    x, masses = strip.vertices, density * strip.vertex_areas
    pinned = x[:, 0] < 1.5 * length / n
    gravity = 0.01 * length * 8 * rigidity / (density * length**4)  # for about 1 % of the length
    sim = substep.PositionBasedDynamics(
        x,
        masses,
        pbd.cloth(strip, rigidity=rigidity, bending=bending),
        pinned=pinned,
        gravity=(0, 0, -gravity),
        substeps=2000,
        step=0.5,
        drag=1.0,
        dtype="float64",
    )
    sim.advance(25)
    K = np.zeros((len(x), len(x)))
    for hinge, k in zip(strip.hinges, pbd_rest.isometric_weights(x, strip.hinges), strict=True):
        row = np.zeros(len(x))
        row[hinge] = -k[:3].sum(), *k[:3]
        K += rigidity * np.outer(row, row)
    z, free = np.zeros(len(x)), ~pinned
    z[free] = np.linalg.solve(K[np.ix_(free, free)], -gravity * masses[free])
    assert z.min() < -0.008 * length
    np.testing.assert_allclose(sim.positions[:, 2], z, atol=-0.01 * z.min())


@pytest.mark.parametrize("direction", [0.0, 0.2, 0.5, np.pi / 6])
def test_a_cylinder_has_the_energy_of_its_rigidity(direction):
    """D/2 kappa^2 per area on equilateral triangles, whatever the direction of the bend."""
    i, j = np.meshgrid(np.arange(40), np.arange(40))
    flat = np.stack([i + 0.5 * j, np.sqrt(0.75) * j, 0 * i], axis=-1).reshape(-1, 3)
    faces = np.concatenate([[k, k + 1, k + 40, k + 1, k + 41, k + 40] for k in range(39 * 40)])
    faces = faces.reshape(-1, 3)[[k % 40 != 39 for k in np.repeat(np.arange(39 * 40), 2)]]
    sheet = substep.geometry.TriangleMesh(flat, faces)
    x, kappa = flat.copy(), 1e-4
    x[:, 2] = 0.5 * kappa * (np.cos(direction) * x[:, 0] + np.sin(direction) * x[:, 1]) ** 2
    area = pbd_rest.hinge_areas(flat, sheet.hinges)[0].sum() / 3  # what the hinges stand for
    for bending in ("isometric", "dihedral"):
        _, bend = pbd.cloth(sheet, rigidity=0.7, bending=bending)
        c, _ = bend.evaluate(x)
        energy = (c**2 / (2 * bend.compliance)).sum()
        exact = 0.5 * 0.7 * kappa**2 * area
        assert energy == pytest.approx(exact, rel=0.02)


def test_isometric_bending_keeps_a_curved_shape():
    strip = substep.geometry.grid_mesh(9, 5)
    x = strip.vertices.copy()
    x[:, 2] = 0.3 * x[:, 0] ** 2
    c, _ = pbd.IsometricBending(strip.hinges, x).evaluate(x)
    np.testing.assert_allclose(c, 0, atol=1e-15)
    c, _ = pbd.IsometricBending(strip.hinges, x).evaluate(strip.vertices)
    assert np.abs(c).max() > 0.01


@pytest.mark.figure
@pytest.mark.parametrize("gravity", [1.0, 9.81])
@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.45])
def test_a_neo_hookean_bar_comes_to_rest_where_implicit_euler_does(poisson_ratio, gravity):
    """The static solution of SoftBody, which has the same energy, on the same mesh."""
    bar = substep.geometry.box_tetrahedra((0.4, 0.1, 0.1), (6, 1, 1))
    tip = bar.vertices[:, 0] > 0.199
    held = {"pinned": bar.vertices[:, 0] < -0.199, "gravity": (0, 0, -gravity)}
    elastic = {"young_modulus": 1e5, "poisson_ratio": poisson_ratio}
    newton = substep.SoftBody.from_mesh(bar, density=1000, tolerance=1e-8, **elastic, **held)
    newton.step(1e4)
    sim = substep.PositionBasedDynamics(
        bar.vertices,
        1000 * bar.vertex_volumes,
        pbd.soft_body(bar, **elastic),
        substeps=400,
        drag=10.0,
        dtype="float64",
        **held,
    )
    sim.advance(2.5)
    expected = (newton.positions - bar.vertices)[tip].mean(axis=0)
    assert expected[2] < -0.005
    assert sim.diagnostics()["speed"] < 1e-3
    found = (sim.positions - bar.vertices)[tip].mean(axis=0)
    np.testing.assert_allclose(found, expected, atol=5e-3 * np.linalg.norm(expected))


def uniaxial(stress, modulus, nu):
    """Stretches along and across a pull: P = m I / (I + 1) F + l (J - a) cof F."""
    mu, lame = modulus / (2 * (1 + nu)), modulus * nu / ((1 + nu) * (1 - 2 * nu))
    m, bulk = 4 / 3 * mu, lame + 5 / 6 * mu
    along, across = 1.0, 1.0
    for _ in range(400):  # a fixed point, slow but sure
        square = along**2 + 2 * across**2
        pressure = bulk * (along * across**2 - 1) - 0.75 * m
        shear = m * square / (square + 1)
        along += 0.3 * (stress - shear * along - pressure * across**2) / modulus
        across -= 0.1 * (shear * across + pressure * along * across) / modulus
    return along, across


@pytest.mark.figure
def test_a_neo_hookean_cube_is_hookes_law():
    """Pulled at one face while three others slide: E by its length, nu by its width."""
    modulus, nu, side, stress = 1e5, 0.35, 0.1, 1e3
    cube = substep.geometry.box_tetrahedra([side] * 3, (2, 2, 2))
    x = cube.vertices + side / 2
    slides = [
        pbd.CustomConstraint(
            np.flatnonzero(x[:, k] < 1e-9)[:, None],
            lambda at, k=k: (at[:, 0, k], np.eye(3)[None, k] + 0 * at),
        )
        for k in range(3)
    ]
    sim = substep.PositionBasedDynamics(
        x,
        1000 * cube.vertex_volumes,
        [*slides, *pbd.soft_body(cube, young_modulus=modulus, poisson_ratio=nu)],
        gravity=(0, 0, 0),
        substeps=200,
        drag=60.0,
        step=0.02,
        dtype="float64",
    )
    far = x[:, 2] > side - 1e-9
    faces = cube.surface_faces[far[cube.surface_faces].all(axis=1)]
    forces = np.zeros_like(x)
    forces[:, 2] = stress * substep.geometry.TriangleMesh(x, faces).vertex_areas
    for _ in range(50):
        sim.set_forces(forces)
        sim.step()
    along = sim.positions[far, 2].mean() / side
    across = sim.positions[x[:, 0] > side - 1e-9, 0].mean() / side
    exact = uniaxial(stress, modulus, nu)
    np.testing.assert_allclose([along - 1, across - 1], np.subtract(exact, 1), rtol=2e-2)
    small = uniaxial(1e-6 * modulus, modulus, nu)
    np.testing.assert_allclose(np.subtract(small, 1), [1e-6, -nu * 1e-6], rtol=1e-4)


def test_an_inverted_neo_hookean_tetrahedron_turns_back():
    rest = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    flesh = pbd.NeoHookean([[0, 1, 2, 3]], 1e4, 0.4)
    for start in (rest * [1, 1, -1], 0.01 * rest, rest * [1, 1, 0], rest * [1, 0, 0], -rest):
        sim = substep.PositionBasedDynamics(
            rest, 1.0, [flesh], gravity=(0, 0, 0), substeps=20, drag=10.0
        )
        sim.set_positions(start + np.random.default_rng(0).normal(scale=1e-3, size=(4, 3)))
        sim.advance(3.0)
        x = sim.positions
        assert np.linalg.det(x[1:] - x[0]) == pytest.approx(1, rel=0.02)
        sides = np.linalg.norm(x[:, None] - x, axis=2)
        np.testing.assert_allclose(sides, np.linalg.norm(rest[:, None] - rest, axis=2), atol=0.02)


def test_a_soft_attachment_follows_a_pin_that_moves():
    """Tied to a moving particle by a spring of no length."""
    k = 400.0
    tie = pbd.Distance([[0, 1]], 0.0, compliance=1 / k, damping=40.0)
    sim = substep.PositionBasedDynamics(np.zeros((2, 3)), 1.0, [tie], pinned=[0])
    for frame in range(120):
        sim.set_targets([[0.01 * (frame + 1), 0, 0]], [0])
        sim.step()
    behind = sim.positions[0] - sim.positions[1]
    # The weight hangs below; a damper to a pin of the same velocity does not pull.
    np.testing.assert_allclose(behind, [0, 0, 9.81 / k], atol=3e-4)


def test_shape_matching_holds_a_stack_of_its_own():
    """Rigid clusters conserve momentum and keep their shape in free flight."""
    cube = np.stack(np.meshgrid(*[[0.0, 1]] * 3), axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(5)
    masses = rng.uniform(1, 3, 8)
    spin = np.cross([1.0, 2, 3], cube)
    sim = substep.PositionBasedDynamics(
        cube, masses, [pbd.ShapeMatching([range(8)])], velocities=spin, **{**STILL, "substeps": 20}
    )
    before = momenta(sim, cube)
    sim.advance(1.0)
    after = momenta(sim, sim.positions)
    np.testing.assert_allclose(after[0], before[0], rtol=1e-8)
    assert np.linalg.norm(after[1] - before[1]) < 0.02 * np.linalg.norm(before[1])
    sides = np.linalg.norm(sim.positions[:, None] - sim.positions, axis=2)
    np.testing.assert_allclose(sides, np.linalg.norm(cube[:, None] - cube, axis=2), atol=1e-12)


@pytest.mark.parametrize("linear", [0.0, 0.5])
def test_overlapping_clusters_bend_and_come_back(linear):
    bar = substep.geometry.box_tetrahedra((0.6, 0.1, 0.1), (12, 2, 2))
    sim = substep.PositionBasedDynamics(
        bar.vertices,
        1000 * bar.vertex_volumes,
        [
            pbd.ShapeMatching(
                pbd.vertex_clusters(bar.edges, len(bar.vertices)), linear=linear, compliance=1e-5
            )
        ],
        pinned=bar.vertices[:, 0] < -0.29,
        drag=5.0,
    )
    sim.advance(1.0)
    fall = -(sim.positions - bar.vertices)[:, 2].min()
    assert 0.005 < fall < 0.5
    for _ in range(180):  # without its weight
        sim.set_forces(np.outer(1000 * bar.vertex_volumes, [0, 0, 9.81]))
        sim.step()
    assert np.abs(sim.positions - bar.vertices).max() < 0.02 * fall


@pytest.mark.parametrize("name", sorted(CLASSES))
def test_jacobi_lets_the_residual_fall(name):
    constraint, number = make(name, overlap=True)
    rest = np.random.default_rng(1).uniform(-1, 1, (number, 3))
    sim = substep.PositionBasedDynamics(
        rest, 1.0, [constraint], gravity=(0, 0, 0), solver="jacobi", substeps=1, iterations=60
    )
    sim.set_positions(rest + np.random.default_rng(2).uniform(-0.1, 0.1, rest.shape))
    before = residual(sim)
    sim.step(0.01)
    assert residual(sim) < (0.999 if name == "NeoHookean" else 0.5) * before


def test_plain_pbd_leaves_one_minus_its_stiffness():
    """After a step, whatever the number of iterations."""
    for name in ("Attachment", "Tether", "ShapeMatching", "CustomConstraint"):
        for iterations in (1, 7):
            sim = scene(name, iterations=iterations, stiffness=0.6)
            before = residual(sim)
            sim.step(0.01)
            # Those of three particles are not linear.
            loose = 0.05 if name == "CustomConstraint" else 1e-9
            assert residual(sim) == pytest.approx(0.4 * before, rel=loose)


def test_copies_and_checkpoints_go_on_with_the_same_bits(tmp_path):
    sheet = substep.geometry.grid_mesh(6, 6)

    def build():
        return substep.PositionBasedDynamics(
            sheet.vertices,
            0.2 * sheet.vertex_areas,
            [
                *pbd.cloth(sheet, rigidity=1e-4, compliance=1e-6),
                pbd.ShapeMatching([range(9)], compliance=1e-4),
                pbd.Attachment([35], compliance=1e-2),
                pbd.CustomConstraint([[0, 7, 14]], equal_lengths, compliance=1e-3),
            ],
            pinned=[0, 5],
        )

    sim = build()
    sim.advance(0.1)
    sim.save(tmp_path / "state")
    other, loaded = sim.copy(), build()
    loaded.load(tmp_path / "state")
    hashes = set()
    for each in (sim, other, loaded):
        each.advance(0.1)
        hashes.add(substep.state_hash(each.positions, each.velocities))
    assert len(hashes) == 1
