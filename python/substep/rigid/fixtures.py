"""What rigid bodies are made of: shapes with a surface and a weight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_integer, check_real, describe
from ..base.quaternions import multiply, rotate
from ..errors import InputError
from ..geometry import HeightField, Plane, Shape, SignedDistanceField, TriangleMesh
from .mass import MassProperties, compound, mass_properties

Array = NDArray[np.float64]

MOTIONS = ("dynamic", "kinematic", "static")
EVERYTHING = 2**32 - 1  # all groups
_LEVERS = ("rolling_friction", "spinning_friction")


@dataclass(frozen=True, eq=False)
class Fixture:
    """A shape of a body, with its surface and its density.

    What is None is taken from the call that adds the body.

    Parameters
    ----------
    shape : Shape
        Of any kind but `SignedDistanceField`; its centre and rotation are its place in the frame
        of the body. Planes, meshes and height fields are ground: of static bodies only.
    density : float, optional
        [kg/m^3], above 0.
    friction, static_friction, restitution, rolling_friction, spinning_friction : float, optional
        As of `RigidBodies.add`.
    group, mask : int, optional
        As of `RigidBodies.add`.
    material : str, optional
        As of `RigidBodies.add`.

    Raises
    ------
    InputError
        If an argument is wrong, with its name.

    Examples
    --------
    A hammer, of steel and wood:

    >>> import substep
    >>> iron = substep.Box((0.1, 0.04, 0.04), center=(0, 0, 0.15))
    >>> head = substep.rigid.Fixture(iron, density=7800)
    >>> handle = substep.rigid.Fixture(substep.Cylinder(0.015, 0.3), density=700)
    >>> bodies = substep.RigidBodies()
    >>> hammer = bodies.add([head, handle], (0, 0, 1))
    >>> bodies.centers_of_mass[hammer].round(3).tolist()
    [0.0, 0.0, 1.134]
    """

    shape: Shape
    _: KW_ONLY
    density: float | None = None
    friction: float | None = None
    static_friction: float | None = None
    restitution: float | None = None
    rolling_friction: float | None = None
    spinning_friction: float | None = None
    group: int | None = None
    mask: int | None = None
    material: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.shape, Shape):
            raise TypeError(f"shape: expected a shape, got {describe(self.shape)}")
        for name, value in check_surface(self._given()).items():
            object.__setattr__(self, name, value)

    def _given(self) -> dict[str, Any]:
        return {name: v for name in _SURFACE if (v := getattr(self, name)) is not None}

    def _native(self, shapes: dict[int, Any], frame: MassProperties | None) -> tuple[Any, ...]:
        """For the native world, in the principal frame of its body."""
        key = id(self.shape)
        if key not in shapes:
            shapes[key] = self.shape._rigid()
        shape, x, q = shapes[key]
        if frame is not None:
            back = frame.axes * (1, -1, -1, -1)
            x, q = rotate(back, x - frame.center_of_mass), multiply(back, q)
        surface = (getattr(self, name) for name in _SURFACE[:-1])
        return (shape, x.tolist(), q.tolist(), *surface, self.material or "")


Made = tuple[tuple[Fixture, ...], str, MassProperties | None]  # shapes, motion, weight
STILL = MassProperties(1.0, (0, 0, 0), np.eye(3))  # the frame of bodies without mass
_PAIR = ("friction", "static_friction", "restitution", *_LEVERS)  # what two materials may say
_SURFACE = (
    "density",
    "friction",
    "restitution",
    *_LEVERS,
    "group",
    "mask",
    "static_friction",
    "material",
)


def check_surface(given: dict[str, Any]) -> dict[str, Any]:
    """What fixtures have besides a shape and a place."""
    checked: dict[str, Any] = {}
    for name, value in given.items():
        if name in ("group", "mask"):
            checked[name] = check_integer(name, value, minimum=0, maximum=EVERYTHING)
        elif name == "material":
            checked[name] = check_material(name, value)
        else:
            checked[name] = check_real(name, value, nonnegative=True, positive=name == "density")
    if checked.get("restitution", 0.0) > 1:
        raise InputError(
            f"restitution: expected a number from 0 to 1, got {checked['restitution']}"
        )
    friction = checked.get("friction", 0.0)
    if checked.get("static_friction", friction) < friction:
        raise InputError(
            f"static_friction: expected at least the friction, {friction}, "
            f"got {checked['static_friction']}"
        )
    return checked


def check_material(name: str, value: Any) -> str:
    """The name of a material."""
    if not isinstance(value, str):
        raise TypeError(f"{name}: expected the name of a material, got {describe(value)}")
    if not value or "\0" in value:
        raise InputError(f"{name}: expected a name without null characters, got {describe(value)}")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise InputError(f"{name}: expected a name of whole letters, got {value!a}") from None
    return value


def check_pair(given: dict[str, Any]) -> list[float]:
    """What holds between two materials, for the native world; NaN where it follows the rule."""
    checked = check_surface({name: v for name, v in given.items() if v is not None})
    if "static_friction" in checked and "friction" not in checked:
        raise InputError("static_friction: expected friction with it")
    return [checked.get(name, np.nan) for name in _PAIR]


def pair_of(numbers: Sequence[float]) -> dict[str, float]:
    """What `check_pair` was given."""
    told = zip(_PAIR, numbers, strict=True)
    return {name: number for name, number in told if not np.isnan(number)}


def check_fixtures(shape: Any, defaults: dict[str, Any], motion: str) -> tuple[Fixture, ...]:
    """The fixtures of a body, with everything that they leave to the call that adds it."""
    may_be_none = ("static_friction", "material")
    defaults = check_surface(
        {name: v for name, v in defaults.items() if v is not None or name not in may_be_none}
    )
    listed = [shape] if isinstance(shape, (Shape, Fixture)) else shape
    if not isinstance(listed, (list, tuple)):
        raise TypeError(f"shape: expected a shape or a list of Fixture, got {describe(shape)}")
    if not listed:
        raise InputError("shape: expected at least one")
    fixtures = []
    for k, one in enumerate(listed):
        if not isinstance(one, (Shape, Fixture)):
            raise TypeError(f"shape[{k}]: expected a shape or a Fixture, got {describe(one)}")
        fixture = one if isinstance(one, Fixture) else Fixture(one)
        if motion != "static" and is_ground(fixture.shape):
            kind = type(fixture.shape).__name__
            raise InputError(
                f"shape: a {kind} is ground, of static bodies only; a body that moves is made of "
                "convex shapes, such as rigid.ConvexHull"
            )
        if isinstance(fixture.shape, SignedDistanceField):
            fixture.shape._rigid()  # says that it cannot be one
        surface = {**defaults, **fixture._given()}
        surface.setdefault("static_friction", surface["friction"])
        fixtures.append(replace(fixture, **surface))
    return tuple(fixtures)


def is_ground(shape: Shape) -> bool:
    """Whether only static bodies may have it."""
    return isinstance(shape, (Plane, TriangleMesh, HeightField))


def check_mass(
    fixtures: Sequence[Fixture], mass: float | MassProperties | None, inertia: ArrayLike | None
) -> MassProperties:
    """Of a dynamic body in the frame of its fixtures."""
    if isinstance(mass, MassProperties):
        if inertia is not None:
            raise InputError("inertia: is given by mass already")
        found = mass
    else:
        parts = [
            mass_properties(f.shape, f.density)  # type: ignore[arg-type]
            for f in fixtures
        ]
        found = parts[0] if len(parts) == 1 else compound(parts)
        if mass is not None:
            m = check_real("mass", mass, positive=True)
            check_range(m, found.inertia * (m / found.mass))
            found = MassProperties(m, found.center_of_mass, found.inertia * (m / found.mass))
        if inertia is not None:
            given = check_array("inertia", inertia)
            given = check_array("inertia", given, (3,) if given.ndim == 1 else (3, 3))
            found = MassProperties(
                found.mass, found.center_of_mass, np.diag(given) if given.ndim == 1 else given
            )
    check_range(found.mass, found.inertia)
    return found


def check_range(mass: float, inertia: Array) -> None:
    """Masses and moments whose inverses and products are numbers."""
    if not 1e-30 < mass < 1e30:
        raise InputError(f"mass: {mass} kg is out of range")
    if not (1e-60 < np.diag(inertia)).all() or not (np.abs(inertia) < 1e60).all():
        raise InputError("inertia: out of range")


def native_rows(shapes: dict[int, Any], body: Made, *rows: Array) -> tuple[Any, ...]:
    """For `add` of the core: bodies alike, at poses of their principal frames, with velocities."""
    fixtures, motion, weight = body
    frame = STILL if weight is None else weight
    return (
        [fixture._native(shapes, weight) for fixture in fixtures],
        MOTIONS.index(motion),
        frame.mass,
        frame.principal_inertia,
        # Where memory is short this says so; the conversion of the call would not.
        *map(np.ascontiguousarray, rows),
    )
