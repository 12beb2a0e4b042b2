"""What every public function does with arrays and numbers of the wrong kind.

Each entry of ENTRIES is one array argument of one public function; all of them go through the same
inputs. What is specific to one function is tested with it.
"""

import math
import os
import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import substep
from substep.base import checks


@dataclass(frozen=True)
class Entry:
    """`call(array)` is legal for `good` and returns arrays."""

    name: str
    call: Callable[[Any], Any]
    good: np.ndarray
    argument: str
    empty: tuple[int, ...] | None = None  # shape of an empty system
    any_length: bool = True  # along the first axis
    complex_ok: bool = False
    rising: bool = False  # equal values are refused
    optional: bool = False  # None is legal
    named: str | None = None  # what a wrong shape is said of, if not of the argument


PLANE = np.array([[0.5, 0.25], [1.0, 0.5], [1.5, 0.75]])


def advected(positions):
    sim = substep.Advection(substep.DoubleGyre(), positions, step=0.1)
    sim.advance(0.2)
    return sim.positions


def recorded(points):
    """What a recording gives back of points, as float64."""
    with tempfile.TemporaryDirectory() as folder:
        recorder = substep.Recorder(os.path.join(folder, "a"), parts={"p": substep.Part()})
        try:
            recorder.append(0.0, {"p": {"points": points}})
            with substep.Recording(recorder.journal_path) as recording:
                return recording["p"].points(0).astype(float)
        finally:
            recorder._release()


def solved(y0, **options):
    decay = substep.solve_ivp(lambda t, y: -y, (0.0, 2.0), y0, method="rk4", step=0.25, **options)
    return decay.y


CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def sagged(positions):
    """A tetrahedron after a step."""
    body = substep.SoftBody(
        positions,
        [[0, 1, 2, 3]],
        rest_positions=CORNERS,
        density=1.0,
        young_modulus=8.0,
        poisson_ratio=0.25,
    )
    body.step(0.25)
    return body.positions


ROWS = np.array([[0.5, 0.25, 1.0], [1.0, 2.0, 3.0]])


def dropped(make):
    """Positions after a step."""
    simulation = make()
    simulation.step(0.25)
    return simulation.positions


def points_of_jelly(positions, **options):
    jelly = substep.mpm.FixedCorotated(1000, 1.0, 0.3)
    return substep.MaterialPointMethod(
        positions, jelly, cell=8.0, volume=1.0, largest_step=1.0, **options
    )


def deformed(values):
    simulation = points_of_jelly(ROWS)
    simulation.set_deformation_gradients(values)
    return simulation.deformation_gradients


def after_a_step(shift=(), **arguments):
    """Poses of two bodies of an odd shape after a step."""
    bodies = substep.RigidBodies()
    hull = substep.rigid.ConvexHull(CORNERS)
    bodies.add(hull, **{"positions": 9 * ROWS, **arguments})
    for name, values in shift:
        getattr(bodies, name)(**values)
    bodies.step(0.25)
    return np.hstack([bodies.positions, bodies.rotations])


def batch_after_a_step(setter, values):
    """Poses of two worlds of two bodies after a step."""
    bodies = substep.RigidBodies()
    bodies.add(substep.rigid.Box((0.2, 0.4, 0.6)), 9 * ROWS)
    batch = substep.RigidBatch(bodies, 2)
    getattr(batch, setter)(**values)
    batch.step(0.25)
    return np.concatenate([batch.positions, batch.rotations], axis=2)


def particles_after_a_step(setter, values):
    """Positions in two worlds of two particles after a step."""
    batch = substep.Batch(substep.PositionBasedDynamics(9 * ROWS, 1.0, dtype="float64"), 2)
    getattr(batch, setter)(**values)
    batch.step(0.25)
    return batch.positions


TURNED = np.array([[1.0, 2, 0.5, 0.25], [2.0, 1, 0, 0]])
MOMENTS = np.array([[2.0, 2.5, 3.0], [1.5, 1.5, 1.25]])

ENTRIES = [
    Entry(
        "rigid.free_rotation rotations",
        lambda q: substep.rigid.free_rotation(q, ROWS, MOMENTS, 0.5),
        TURNED,
        "rotations",
        any_length=False,
    ),
    Entry(
        "rigid.free_rotation angular_momenta",
        lambda L: substep.rigid.free_rotation(TURNED, L, MOMENTS, 0.5),
        ROWS,
        "angular_momenta",
        any_length=False,
    ),
    Entry(
        "rigid.free_rotation inertia",
        lambda inertia: substep.rigid.free_rotation(TURNED, ROWS, inertia, 0.5),
        MOMENTS,
        "inertia",
        any_length=False,
    ),
    Entry(
        "rigid.ConvexHull points", lambda x: substep.rigid.ConvexHull(x).points, CORNERS, "points"
    ),
    Entry(
        "RigidBodies.add positions",
        lambda x: after_a_step(positions=x),
        9 * ROWS,
        "positions",
        empty=(0, 3),
    ),
    Entry(
        "RigidBodies.add rotations",
        lambda q: after_a_step(rotations=q),
        TURNED,
        "rotations",
        any_length=False,
    ),
    Entry(
        "RigidBodies.add velocities",
        lambda v: after_a_step(velocities=v),
        ROWS,
        "velocities",
        any_length=False,
    ),
    Entry(
        "RigidBodies.add angular_velocities",
        lambda w: after_a_step(angular_velocities=w),
        ROWS,
        "angular_velocities",
        any_length=False,
    ),
    *(
        Entry(
            f"RigidBodies.{setter}",
            lambda values, setter=setter: after_a_step([(setter, {"values": values})]),
            rows,
            "values",
            any_length=False,
        )
        for setter, rows in (
            ("set_positions", 9 * ROWS),
            ("set_rotations", TURNED),
            ("set_velocities", ROWS),
            ("set_angular_velocities", ROWS),
            ("set_forces", ROWS),
            ("set_torques", ROWS),
        )
    ),
    Entry(
        "RigidBodies.apply_force",
        lambda F: after_a_step([("apply_force", {"ids": [0, 1], "force": F})]),
        ROWS,
        "force",
        any_length=False,
    ),
    Entry(
        "RigidBodies.apply_impulse point",
        lambda x: after_a_step(
            [("apply_impulse", {"ids": [0, 1], "impulse": (4, 0, 2), "point": x})]
        ),
        ROWS,
        "point",
        any_length=False,
        optional=True,
    ),
    *(
        Entry(
            f"RigidBatch.{setter}",
            lambda values, setter=setter: batch_after_a_step(setter, {"values": values}),
            rows,
            "values",
            any_length=False,
        )
        for setter, rows in (
            ("set_positions", 9 * ROWS),
            ("set_rotations", np.stack([TURNED, TURNED])),
            ("set_velocities", ROWS),
            ("set_angular_velocities", ROWS),
            ("set_forces", ROWS),
            ("set_torques", np.stack([ROWS, ROWS])),
        )
    ),
    *(
        Entry(
            f"Batch.{setter}",
            lambda values, setter=setter: particles_after_a_step(setter, {"values": values}),
            rows,
            "values",
            any_length=False,
        )
        for setter, rows in (
            ("set_positions", np.stack([ROWS, 9 * ROWS])),
            ("set_velocities", ROWS),
            ("set_forces", ROWS),
        )
    ),
    Entry(
        "rigid.MassProperties center_of_mass",
        lambda x: substep.rigid.MassProperties(1.0, x, np.eye(3)).center_of_mass,
        np.array([1.0, 0.5, 2]),
        "center_of_mass",
        any_length=False,
    ),
    Entry(
        "rigid.MassProperties.moved position",
        lambda x: substep.rigid.MassProperties(1.0, [0, 0, 0], np.eye(3)).moved(x).center_of_mass,
        np.array([1.0, 0.5, 2]),
        "position",
        any_length=False,
    ),
    Entry(
        "PositionBasedDynamics positions",
        lambda x: dropped(lambda: substep.PositionBasedDynamics(x, 1.0)),
        ROWS,
        "positions",
        empty=(0, 3),
    ),
    Entry(
        "PositionBasedDynamics velocities",
        lambda v: dropped(lambda: substep.PositionBasedDynamics(ROWS, 1.0, velocities=v)),
        ROWS,
        "velocities",
        any_length=False,
        optional=True,
    ),
    Entry(
        "PositionBasedFluid positions",
        lambda x: dropped(lambda: substep.PositionBasedFluid(x, 0.5)),
        ROWS,
        "positions",
        empty=(0, 3),
    ),
    Entry(
        "PositionBasedFluid velocities",
        lambda v: dropped(lambda: substep.PositionBasedFluid(ROWS, 0.5, velocities=v)),
        ROWS,
        "velocities",
        any_length=False,
        optional=True,
    ),
    Entry(
        "MaterialPointMethod positions",
        lambda x: dropped(lambda: points_of_jelly(x)),
        ROWS,
        "positions",
        empty=(0, 3),
    ),
    Entry(
        "MaterialPointMethod velocities",
        lambda v: dropped(lambda: points_of_jelly(ROWS, velocities=v)),
        ROWS,
        "velocities",
        any_length=False,
        optional=True,
    ),
    Entry(
        "MaterialPointMethod.set_deformation_gradients",
        deformed,
        np.array([[[1.0, 2, 0], [0, 1, 0], [0, 0, 1]], [[2, 0, 1], [0, 1, 0], [0, 0, 1]]]),
        "values",
        any_length=False,
    ),
    Entry(
        "neighbour_lists points",
        lambda x: np.concatenate(substep.geometry.neighbour_lists(x, 4.0)),
        ROWS,
        "points",
        empty=(0, 3),
    ),
    Entry("solve_ivp y0", solved, np.array([0.5, 0.25]), "y0", empty=(0,), complex_ok=True),
    Entry(
        "solve_ivp y0 of a compiled system",
        lambda y0: substep.solve_ivp(substep.systems.Lorenz(), (0.0, 0.1), y0).y,
        np.array([0.5, 0.25, 1.0]),
        "y0",
        any_length=False,
    ),
    Entry(
        "SoftBody positions",
        sagged,
        CORNERS,
        "positions",
        any_length=False,
    ),
    Entry(
        "solve_ivp t_eval",
        lambda t: solved([1.0, 0.0], t_eval=t),
        np.array([0.0, 1.0, 2.0]),
        "t_eval",
        any_length=False,
        rising=True,
        optional=True,
    ),
    Entry(
        "check_array",
        lambda x: checks.check_array("x", x, (None, 2)),
        PLANE,
        "x",
        empty=(0, 2),
    ),
    Entry(
        "max_stable_step",
        lambda jacobian: substep.stability.max_stable_step("rk4", jacobian),
        np.array([[0.0, 2.0], [3.0, 1.0]]),
        "eigenvalues",
        empty=(0, 0),
        any_length=False,
        complex_ok=True,
    ),
    Entry(
        "Recorder.append points",
        recorded,
        np.array([[0.5, 0.25, 1.0], [1.0, 2.0, 3.0]]),
        "p/points",
        empty=(0, 3),
    ),
    Entry(
        "advect",
        lambda x: substep.advect(substep.DoubleGyre(), x, (0.0, 0.2), step=0.1).positions,
        PLANE,
        "positions",
        empty=(0, 2),
    ),
    *(
        Entry(
            f"solve_second_order {name}",
            lambda value, name=name: (
                substep.solve_second_order(
                    lambda t, x, v: -x,
                    (0.0, 1.0),
                    **{"x0": np.ones((3, 2)), "v0": np.ones((3, 2)), name: value},
                    step=0.25,
                ).x
            ),
            PLANE,
            name,
            any_length=False,
            named="0: expected",
        )
        for name in ("x0", "v0")
    ),
    Entry(
        "solve_ensemble",
        lambda rows: substep.solve_ensemble(substep.systems.Lorenz(), (0.0, 0.1), rows).y,
        np.array([[0.5, 0.25, 0.5], [1.0, 0.5, 1.5]]),
        "Y0",
        empty=(0, 3),
    ),
    Entry("Advection", advected, PLANE, "positions", empty=(0, 2)),
    Entry("field", lambda x: substep.DoubleGyre()(0.0, x), PLANE, "x", empty=(0, 2)),
    Entry(
        "GridField axes",
        lambda x: substep.GridField((x, [0.0, 1.0]), np.ones((3, 2, 2)))(0.0, [[1.0, 0.5]]),
        np.array([0.0, 1.0, 2.0]),
        "axes[0]",
        any_length=False,
        rising=True,
    ),
    Entry(
        "Collider.distance",
        lambda x: substep.Collider(substep.Sphere(1.0)).distance(x),
        np.array([[0.5, 0.25, 1.0], [1.0, 2.0, 3.0]]),
        "x",
        empty=(0, 3),
    ),
    Entry(
        "TriangleMesh.signed_distance",
        lambda x: substep.geometry.box_mesh().signed_distance(x),
        np.array([[0.5, 0.25, 1.0], [1.0, 2.0, 3.0]]),
        "x",
        empty=(0, 3),
    ),
    Entry(
        "TriangleMesh vertices",
        lambda x: substep.geometry.TriangleMesh(x, [[0, 1, 2]]).face_areas,
        np.array([[0.5, 0.25, 1.0], [1.0, 2.0, 3.0], [0.0, 0.0, 1.0]]),
        "vertices",
        any_length=False,
    ),
    Entry(
        "Sphere center",
        lambda x: substep.Collider(substep.Sphere(1.0, x), velocity=x).surface_velocity(
            [[0, 0, 0]]
        ),
        np.array([0.5, 0.25, 1.0]),
        "center",
        any_length=False,
    ),
    Entry(
        "stability.max_stable_step",
        lambda x: substep.stability.max_stable_step("rk4", x),
        np.array([0.0, 1.0, 2.0]),
        "eigenvalues",
        complex_ok=True,
    ),
    Entry(
        "stability.region",
        lambda x: substep.stability.region("rk4", bounds=x, resolution=3).modulus,
        np.array([0.0, 1.0, 1.0, 2.0]),
        "bounds",
        any_length=False,
        rising=True,
        optional=True,
    ),
    *(
        Entry(
            f"{solve.__name__} x0",
            lambda x, solve=solve: solve([[2.0, 1.0], [1.0, 3.0]], [1.0, 2.0], x0=x).x,
            np.array([0.5, 0.25]),
            "x0",
            any_length=False,
            complex_ok=solve is substep.linalg.bicgstab,
            optional=True,
        )
        for solve in (substep.linalg.cg, substep.linalg.bicgstab)
    ),
]


class Raising:
    """An object whose conversion fails with an exception of its own."""

    class Own(ValueError):
        pass

    def __array__(self, dtype=None, copy=None):
        raise Raising.Own("mine")


class Convertible:
    def __init__(self, array):
        self.array = array

    def __array__(self, dtype=None, copy=None):
        return self.array if dtype is None else self.array.astype(dtype)


def arrays_of(result):
    """All numbers in a result, for comparison bit by bit."""
    if isinstance(result, np.ndarray):
        return substep.state_hash(result)
    if isinstance(result, (list, tuple)):
        return [arrays_of(part) for part in result]
    if isinstance(result, float):
        return result.hex()
    return result


def with_value(array, value):
    changed = array.copy()
    changed.flat[changed.size - 1] = value
    return changed


def strided(array):
    wide = np.full((*array.shape[:-1], 2 * array.shape[-1]), np.nan)
    wide[..., ::2] = array
    return wide[..., ::2]


def read_only(array):
    array = array.copy()
    array.flags.writeable = False
    return array


# What is accepted, by copy, with the result of the plain array.
SAME = {
    "float32": lambda a: a.astype(np.float32),
    "float16": lambda a: a.astype(np.float16),
    "longdouble": lambda a: a.astype(np.longdouble),
    "list": lambda a: a.tolist(),
    "tuple of rows": lambda a: tuple(a),
    "Fortran order": np.asfortranarray,
    "stride of two": strided,
    "negative stride": lambda a: a[::-1].copy()[::-1],
    "byte-swapped": lambda a: a.astype(a.dtype.newbyteorder()),
    "read-only": read_only,
    "masked array without a mask": np.ma.MaskedArray,
    "object with __array__": Convertible,
    "subclass": lambda a: a.view(type("Sub", (np.ndarray,), {})),
    "unaligned": lambda a: (
        np.frombuffer(b"x" + a.tobytes(), np.uint8)[1:].view(a.dtype).reshape(a.shape)
    ),
}
NOT_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
WRONG_SHAPE = {
    "0-d": lambda a: np.float64(1.0),
    "one axis more": lambda a: a[..., None],
    "two axes more": lambda a: a[None, None],
    "one column more": lambda a: np.concatenate([a, a[..., :1]], axis=-1),
    "ragged list": lambda a: [*a.tolist(), [1.0] * 7],
}
WRONG_TYPE = {
    "object": lambda a: a.astype(object),
    "str": lambda a: a.astype(str),
    "bytes": lambda a: a.astype("S8"),
    "datetime": lambda a: a.astype("M8[s]"),
    "structured": lambda a: np.zeros(a.shape, [("x", float), ("y", float)]),
    "None": lambda a: None,
    "text": lambda a: "positions",
    "dict": lambda a: {"x": 1.0},
    "list with None": lambda a: with_value(a.astype(object), None).tolist(),
}

each_entry = pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)


@each_entry
@pytest.mark.parametrize("kind", SAME)
def test_accepted_by_copy(entry, kind):
    value = SAME[kind](entry.good)
    kept = substep.state_hash(np.asarray(value))
    assert arrays_of(entry.call(value)) == arrays_of(entry.call(entry.good))
    assert substep.state_hash(np.asarray(value)) == kept, "the caller's array was changed"


@each_entry
@pytest.mark.parametrize("dtype", ["i1", "i4", "i8", "u8", "?"])
def test_integers_are_widened(entry, dtype):
    value = entry.good.astype(dtype)
    if entry.rising and dtype == "?":
        with pytest.raises(substep.InputError):
            entry.call(value)
        return
    assert arrays_of(entry.call(value)) == arrays_of(entry.call(value.astype(float)))


@each_entry
def test_matrix_and_broadcast_view(entry):
    if entry.good.ndim == 2:
        as_matrix = entry.good.view(np.matrix)
        assert arrays_of(entry.call(as_matrix)) == arrays_of(entry.call(entry.good))
    view = np.broadcast_to(entry.good[:1], entry.good.shape)
    assert 0 in view.strides
    if entry.rising:
        with pytest.raises(substep.InputError):
            entry.call(view)
        return
    assert arrays_of(entry.call(view)) == arrays_of(entry.call(view.copy()))


@each_entry
@pytest.mark.parametrize("value", NOT_FINITE)
def test_not_finite(entry, value):
    array = with_value(entry.good, NOT_FINITE[value])
    kept = substep.state_hash(array)
    last = [int(n) - 1 for n in entry.good.shape]
    with pytest.raises(substep.InputError) as caught:
        entry.call(array)
    message = str(caught.value)
    assert entry.argument in message and str(last) in message and value in message
    assert substep.state_hash(array) == kept


@each_entry
@pytest.mark.parametrize("kind", WRONG_SHAPE)
def test_wrong_shape(entry, kind):
    if kind == "one column more" and entry.good.ndim == 1 and entry.any_length:
        entry.call(WRONG_SHAPE[kind](entry.good))
        return
    named = entry.named or entry.argument
    with pytest.raises(substep.InputError, match=re.escape(named)):
        entry.call(WRONG_SHAPE[kind](entry.good))


@each_entry
@pytest.mark.parametrize("kind", WRONG_TYPE)
def test_wrong_type(entry, kind):
    if kind == "None" and entry.optional:
        entry.call(None)
        return
    with pytest.raises(TypeError, match=re.escape(entry.argument)):
        entry.call(WRONG_TYPE[kind](entry.good))


@each_entry
def test_complex(entry):
    if entry.complex_ok:
        entry.call(entry.good.astype(complex))
    else:
        with pytest.raises(TypeError, match=re.escape(entry.argument)):
            entry.call(entry.good.astype(complex))


@each_entry
def test_masked_values(entry):
    masked = np.ma.MaskedArray(entry.good, mask=with_value(np.zeros(entry.good.shape, bool), True))
    with pytest.raises(substep.InputError, match=rf"{re.escape(entry.argument)}.*mask"):
        entry.call(masked)


@each_entry
def test_integers_beyond_float64(entry):
    with pytest.raises(substep.InputError, match=re.escape(entry.argument)):
        entry.call(with_value(entry.good.astype(np.int64), 2**53 + 1))


@each_entry
def test_exception_of_the_argument_passes(entry):
    with pytest.raises(Raising.Own, match="mine"):
        entry.call(Raising())


@each_entry
def test_empty_system(entry):
    if entry.empty is not None:
        entry.call(np.empty(entry.empty))


# The scalar checks.


class Number:
    """An object whose conversions give something, or raise it."""

    def __init__(self, outcome):
        self.outcome = outcome

    def __float__(self):
        if isinstance(self.outcome, Exception):
            raise self.outcome
        return self.outcome

    __index__ = __float__


@pytest.mark.parametrize(
    "value", [1, 1.0, np.float32(1), np.int8(1), np.array(1.0), np.longdouble(1)]
)
def test_real_accepts(value):
    assert checks.check_real("x", value) == 1.0
    assert type(checks.check_real("x", value)) is float


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10**400, np.float32("nan")])
def test_real_refuses_what_is_not_finite(value):
    with pytest.raises(substep.InputError, match=r"^x: expected a finite number"):
        checks.check_real("x", value)


@pytest.mark.parametrize(
    "value",
    [True, np.True_, "1.0", b"1", None, 1j, [1.0], np.ones(1), np.ones(2), object(), Number("1")],
)
def test_real_refuses_other_types(value):
    with pytest.raises(TypeError, match=r"^x: expected a real number"):
        checks.check_real("x", value)


def test_real_bounds():
    assert checks.check_real("x", math.inf, finite=False) == math.inf
    assert checks.check_real("x", 5e-324, positive=True) == 5e-324
    assert checks.check_real("x", 0.0, nonnegative=True) == 0.0
    for value in (0.0, -0.0, -1.0):
        with pytest.raises(substep.InputError, match="above 0"):
            checks.check_real("x", value, positive=True)
    with pytest.raises(substep.InputError, match="at least 0"):
        checks.check_real("x", -1e-300, nonnegative=True)
    with pytest.raises(substep.InputError, match="finite"):
        checks.check_real("x", math.nan, finite=False)


@pytest.mark.parametrize("error", [ValueError, TypeError, OverflowError, ZeroDivisionError])
def test_what_a_number_of_the_caller_raises_passes(error):
    own = error("mine")
    for check in (checks.check_real, checks.check_integer):
        with pytest.raises(error) as caught:
            check("x", Number(own))
        assert caught.value is own


@pytest.mark.parametrize(
    "value", [1.0, 1.5, True, np.True_, "1", None, math.nan, 1j, [1], Number("1")]
)
def test_integer_refuses(value):
    with pytest.raises(substep.InputError, match=r"^n: expected an integer"):
        checks.check_integer("n", value, minimum=0)


def test_integer_bounds():
    assert checks.check_integer("n", np.uint8(3), minimum=0, maximum=3) == 3
    assert checks.check_integer("n", 2**70, minimum=0) == 2**70
    for value in (-1, 4, 2**31, 2**63, -(2**63)):
        with pytest.raises(substep.InputError, match=f"from 0 to 3, got {value}"):
            checks.check_integer("n", value, minimum=0, maximum=3)


def test_choice():
    assert checks.check_choice("method", "rk45", ["RK45", "euler"]) == "RK45"
    for value in ("rk", "", None, 4, b"euler", ["euler"]):
        with pytest.raises(substep.InputError, match=r"^method: expected one of RK45, euler; got"):
            checks.check_choice("method", value, ["RK45", "euler"])


def test_long_values_are_shortened_in_messages():
    with pytest.raises(substep.InputError) as caught:
        checks.check_choice("method", "x" * 10000, ["euler"])
    assert len(str(caught.value)) < 150


HUGE = 10**5000  # Python writes no integers beyond 4300 digits


@pytest.mark.parametrize(
    "call",
    [
        lambda: checks.check_integer("n", -HUGE, minimum=0),
        lambda: checks.check_integer("n", HUGE, minimum=0, maximum=3),
        lambda: checks.check_choice("n", [HUGE], ["euler"]),
        lambda: substep.set_num_threads(HUGE),
        lambda: substep.Emitter((0, 0, 0), (0, 0, 1), 1.0, radius=0.1, kind=-HUGE),
    ],
)
def test_integers_too_long_to_be_written(call):
    with pytest.raises(substep.InputError, match=r": .*too long to be written$"):
        call()


@pytest.mark.parametrize("kind", [list, tuple])
def test_lists_that_give_an_array_of_their_own_are_copied(kind):
    buffer = np.ones((2, 2))

    class Own(kind):
        def __array__(self, dtype=None, copy=None):
            return buffer

    array = checks.check_array("x", Own(buffer.tolist()))
    buffer[:] = 7.0
    assert array.tolist() == [[1.0, 1.0], [1.0, 1.0]]

    class Wrong(kind):
        def __array__(self, dtype=None, copy=None):
            raise ValueError("mine")

    with pytest.raises(ValueError, match=r"^mine$"):
        checks.check_array("x", Wrong([1.0]))


class NoArray:
    """An object whose `__array__` gives something else."""

    def __array__(self, dtype=None, copy=None):
        return "no array"


@pytest.mark.parametrize(
    "call",
    [
        lambda value: checks.check_array("x", value),
        lambda value: checks.check_array("x", [value, value]),
        lambda value: checks.check_positive("x", value, 3),
        lambda value: substep.Box(value),
        lambda value: substep.RigidBodies(gravity=value),
        lambda value: substep.RigidBodies().add(substep.Sphere(1.0), value),
        lambda value: substep.RigidBodies().set_positions(value),
    ],
)
def test_objects_that_give_no_array_are_refused_by_name(call):
    wanted = r"^(x|lengths|gravity|positions|values): expected .*; object __array__ method not"
    with pytest.raises(substep.InputError, match=wanted):
        call(NoArray())
    with pytest.raises(Raising.Own, match=r"^mine$"):
        call(Raising())


def test_a_choice_is_that_of_its_case_where_there_are_two():
    assert checks.check_choice("name", "Arm", ["arm", "Arm"]) == "Arm"
    assert checks.check_choice("name", "ARM", ["arm", "Arm"]) == "arm"
