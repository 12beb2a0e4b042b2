"""A joint of rigid bodies, its limits and its motor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_array, check_integer, check_real, describe
from ..base.owned import Owned
from ..errors import InputError
from .rows import BodyRows

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

KINDS = ("ball", "hinge", "slider", "fixed", "distance", "universal", "elastic")
_FREE = (-math.inf, math.inf)


@dataclass(frozen=True)
class SpeedMotor:
    """Turns or shifts a joint at a speed, as far as its strength allows.

    Parameters
    ----------
    speed : float
        Of the coordinate of the joint [rad/s] or [m/s].
    strength : float, optional
        Largest torque [N m] or force [N]; without bound unless given.

    Raises
    ------
    InputError
        If a number is not finite, or the strength is below 0.

    Examples
    --------
    >>> import substep
    >>> substep.rigid.SpeedMotor(2.0, strength=50.0)
    SpeedMotor(speed=2.0, strength=50.0)
    """

    speed: float
    strength: float = math.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "speed", check_real("speed", self.speed))
        object.__setattr__(self, "strength", _check_strength(self.strength))

    def _native(self) -> tuple[int, float, float, float, float]:
        return 1, self.speed, 0.0, 0.0, self.strength


@dataclass(frozen=True)
class SpringMotor:
    """Pulls a joint to a target: the force is stiffness (target - coordinate) - damping rate.

    Parameters
    ----------
    target : float
        Of the coordinate of the joint [rad] or [m].
    stiffness : float
        At least 0 [N m/rad] or [N/m].
    damping : float, optional
        At least 0 [N m s/rad] or [N s/m].
    strength : float, optional
        Largest torque [N m] or force [N]; without bound unless given.

    Raises
    ------
    InputError
        If a number is not finite, or below 0 where it must not be.

    Examples
    --------
    >>> import substep
    >>> substep.rigid.SpringMotor(0.5, stiffness=100.0, damping=5.0).target
    0.5
    """

    target: float
    stiffness: float
    damping: float = 0.0
    strength: float = math.inf

    def __post_init__(self) -> None:
        object.__setattr__(self, "target", check_real("target", self.target))
        for name in ("stiffness", "damping"):
            object.__setattr__(self, name, check_real(name, getattr(self, name), nonnegative=True))
        object.__setattr__(self, "strength", _check_strength(self.strength))

    def _native(self) -> tuple[int, float, float, float, float]:
        return 2, self.target, self.stiffness, self.damping, self.strength


@dataclass(frozen=True)
class TurnSpring:
    """Turns a ball back to its rest, in proportion to the rotation vector.

    Parameters
    ----------
    swing, twist : float
        Stiffness across the axis of the joint and about it, at least 0 [N m/rad].
    swing_damping, twist_damping : float, optional
        At least 0 [N m s/rad].
    rest : array_like, shape (3,), optional
        Rotation vector of rest: the twist and the swing about two axes across, shorter than pi
        [rad]; where the joint was made unless given.

    Raises
    ------
    InputError
        If a number is not finite, below 0 where it must not be, or the rest too far.

    Examples
    --------
    >>> import substep
    >>> substep.rigid.TurnSpring(10.0, 5.0, swing_damping=0.1)
    TurnSpring(swing=10.0, twist=5.0, swing_damping=0.1, twist_damping=0.0, rest=(0.0, 0.0, 0.0))
    """

    swing: float
    twist: float
    swing_damping: float = 0.0
    twist_damping: float = 0.0
    rest: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("swing", "twist", "swing_damping", "twist_damping"):
            object.__setattr__(self, name, check_real(name, getattr(self, name), nonnegative=True))
        rest = check_array("rest", self.rest, (3,)).tolist()
        if not math.hypot(*rest) < math.pi:
            raise InputError(f"rest: expected a rotation vector shorter than pi, got {rest}")
        object.__setattr__(self, "rest", tuple(rest))

    def _native(self) -> tuple[tuple[float, float, float], float, float, float, float]:
        return self.rest, self.twist, self.twist_damping, self.swing, self.swing_damping


Motor = SpeedMotor | SpringMotor


class _World(Protocol):
    """What a joint needs of the `RigidBodies` that it is in."""

    _native: Any
    _ids: Ids
    _joint_ids: Ids
    _owner: _core.Owner

    def _remove_joint(self, row: int) -> None: ...


class Joint(Owned):
    """A joint of `RigidBodies`, as its methods `ball`, `hinge`, ... give it.

    Parameters
    ----------
    world : RigidBodies
        Whose joint it is.
    number : int
        Its number, which no other joint has or will have.

    Raises
    ------
    InputError
        If the number is no integer of at least 0.

    Attributes
    ----------
    number : int
        Its number.

    Examples
    --------
    >>> import substep
    >>> bodies = substep.RigidBodies()
    >>> bob = bodies.add(substep.rigid.Sphere(0.1), (1, 0, 0))
    >>> hinge = bodies.hinge(bob, None, anchor=(0, 0, 0), axis=(0, 1, 0))
    >>> bodies.advance(0.1)
    >>> bool(hinge.coordinate > 0), hinge.bodies
    (True, (0, None))
    """

    number: int

    def __init__(self, world: _World, number: int) -> None:
        if not isinstance(world, BodyRows):
            raise TypeError(f"world: expected RigidBodies, got {describe(world)}")
        self._world = world
        self.number = check_integer("number", number, minimum=0)

    @property
    def _owner(self) -> _core.Owner:  # type: ignore[override]
        return self._world._owner

    def __repr__(self) -> str:
        return f"Joint({self.number})"

    def _row(self) -> int:
        ids = self._world._joint_ids
        row = int(np.searchsorted(ids, self.number))
        if row == len(ids) or ids[row] != self.number:
            raise IndexError(f"there is no joint {self.number}: it was removed")
        return row

    def _told(self) -> dict[str, Any]:
        told: dict[str, Any] = self._world._native.joint(self._row())
        return told

    @property
    def kind(self) -> str:
        """'ball', 'hinge', 'slider', 'fixed', 'distance', 'universal' or 'elastic'."""
        return KINDS[self._told()["kind"]]

    @property
    def bodies(self) -> tuple[int, int | None]:
        """Ids of the two bodies; None is the world."""
        told = self._told()
        ids = self._world._ids
        return int(ids[told["a"]]), None if told["b"] < 0 else int(ids[told["b"]])

    @property
    def coordinate(self) -> float:
        """Where the joint is in its freedom, at the end of the last step.

        The angle of a hinge and the first one of a universal joint, over all turns, and the twist
        of a ball or an elastic joint [rad], the translation of a slider and the length of a
        distance [m]; 0 when the joint was made, except for lengths.
        """
        return float(self._told()["coordinate"])

    @property
    def coordinates(self) -> Array:
        """All coordinates, where the bodies are now [rad] or [m], shape (k,); a copy.

        Of a universal joint the angle of a about its axis and that of the cross about the axis of
        b, the latter within half a turn; of an elastic one the rotation vector of a as seen from b:
        the twist about the axis and the swing about two axes across; of others the one
        `coordinate`, if the joint has one.
        """
        return np.array(self._told()["coordinates"])

    @property
    def speed(self) -> float:
        """The rate of `coordinate`, by the velocities of the bodies now [rad/s] or [m/s]."""
        return float(self._told()["speed"])

    @property
    def axis(self) -> Array:
        """Direction of the coordinate in the world, a unit vector, shape (3,); a copy.

        The axis of a hinge or slider as the second body has it, of a ball the mean of both, of a
        universal joint that in the first body, of a distance from the point of the second body to
        that of the first; 0 of 'fixed'.
        """
        return np.array(self._told()["axis"])

    @property
    def limits(self) -> tuple[float, float]:
        """Least and greatest coordinate; assign to change them, which wakes the bodies."""
        lower, upper = self._told()["limits"]
        return float(lower), float(upper)

    @limits.setter
    def limits(self, value: ArrayLike | None) -> None:
        lower, upper = check_limits("limits", value)
        self._set(lower=lower, upper=upper)

    @property
    def motor(self) -> Motor | None:
        """The motor, if there is one; assign to change it, which wakes the bodies.

        Hinges, sliders, distances and universal joints can have one.
        """
        kind, target, stiffness, damping, strength = self._told()["motor"]
        if kind == 0:
            return None
        if kind == 1:
            return SpeedMotor(target, strength)
        return SpringMotor(target, stiffness, damping, strength)

    @motor.setter
    def motor(self, value: Motor | None) -> None:
        self._set(motor=check_motor(value))

    @property
    def spring(self) -> TurnSpring | None:
        """The springs of an elastic joint; assign to change them, which wakes the bodies."""
        told = self._told()
        if KINDS[told["kind"]] != "elastic":
            return None
        rest, twist, twist_damping, swing, swing_damping = told["spring"]
        return TurnSpring(swing, twist, swing_damping, twist_damping, tuple(rest))

    @spring.setter
    def spring(self, value: TurnSpring) -> None:
        native = check_spring(value)
        if self.kind != "elastic":
            raise InputError(f"spring: only elastic joints have one, this is a {self.kind}")
        self._set(spring=native)

    def _set(self, **changes: Any) -> None:
        row = self._row()
        told = self._world._native.joint(row)
        lower, upper = told["limits"]
        given = {"lower": lower, "upper": upper, **told, **changes}
        changed = (given[name] for name in ("lower", "upper", "motor", "spring"))
        self._world._native.set_joint(row, *changed)

    @property
    def force(self) -> Array:
        """What the joint did to the first body at its anchor, mean of the last step [N]; a copy."""
        return np.array(self._told()["force"])

    @property
    def torque(self) -> Array:
        """Torque on the first body about its anchor, mean of the last step [N m]; a copy."""
        return np.array(self._told()["torque"])

    @property
    def effort(self) -> float:
        """What motor, spring and limits did along the coordinate, mean of the last step.

        It is positive where it drives the coordinate up [N m] or [N], and a part of `torque` or
        `force`.
        """
        return float(self._told()["effort"])

    @property
    def error(self) -> tuple[float, float]:
        """How far the joint was off at the end of the last step: a length [m], an angle [rad]."""
        length, angle = self._told()["error"]
        return float(length), float(angle)

    @property
    def anchors(self) -> Array:
        """The point of either body that the joint holds, in the world [m], shape (2, 3); a copy."""
        return np.array(self._told()["anchors"]).reshape(2, 3)

    def quantities(self, name: str = "joint") -> dict[str, Callable[[Any], ArrayLike]]:
        """What a `substep.Logger` can log of the joint, in its bodies or in a `World` of them.

        Parameters
        ----------
        name : str, optional
            What their names begin with.

        Returns
        -------
        dict of str to callable
            `name_coordinate` and `name_speed`, but for 'fixed'; the `effort` as `name_torque` of a
            hinge or universal joint [N m] and as `name_force` of a slider or distance [N], of a
            ball and of 'fixed' `name_force` and `name_torque`, shape (3,): means of the last step,
            on the first body.

        Raises
        ------
        IndexError
            If the joint was taken out.

        Examples
        --------
        >>> import substep
        >>> bodies = substep.RigidBodies()
        >>> bob = bodies.add(substep.Sphere(0.1), (1, 0, 0))
        >>> hinge = bodies.hinge(bob, None, anchor=(0, 0, 0), axis=(0, 1, 0))
        >>> log = substep.Logger(hinge.quantities("pivot"))
        >>> bodies.advance(0.1, log)
        >>> log.names
        ('pivot_coordinate', 'pivot_speed', 'pivot_torque')
        """
        number = self.number

        def of(read: Callable[[Joint], ArrayLike]) -> Callable[[Any], ArrayLike]:
            # That of a copy in a copy, of the bodies in a `World`.
            return lambda world: read(Joint(getattr(world, "_bodies", world), number))

        along = {"hinge": "rad", "slider": "m", "distance": "m"}.get(self.kind, "")
        units = {"force": "N", "torque": "N m", "coordinate": along}
        units["speed"] = along and f"{along}/s"
        reads: dict[str, Callable[[Joint], ArrayLike]] = {}
        if (kind := self.kind) != "fixed":
            reads |= {
                "coordinate": lambda joint: joint.coordinate,
                "speed": lambda joint: joint.speed,
            }
        if kind in ("slider", "distance"):
            reads["force"] = lambda joint: joint.effort
        elif kind in ("hinge", "universal"):
            reads["torque"] = lambda joint: joint.effort
        else:
            reads |= {"force": lambda joint: joint.force, "torque": lambda joint: joint.torque}
        found = {f"{name}_{what}": of(read) for what, read in reads.items()}
        for quantity, what in zip(found.values(), reads, strict=True):
            told: Any = quantity  # for plots
            told.unit, told.components = units[what], ("x", "y", "z")
        return found

    def remove(self) -> None:
        """Take the joint out; its bodies wake.

        Raises
        ------
        IndexError
            If it was taken out before.
        """
        self._world._remove_joint(self._row())


def check_limits(name: str, limits: ArrayLike | None) -> tuple[float, float]:
    """Least and greatest value; None is without bounds."""
    if limits is None:
        return _FREE
    lower, upper = check_array(name, limits, (2,), finite=False).tolist()
    if not lower <= upper:
        raise InputError(f"{name}: expected the lower one first, got {lower} and {upper}")
    return lower, upper


def check_motor(motor: Any) -> tuple[int, float, float, float, float]:
    """For the native core."""
    if motor is None:
        return 0, 0.0, 0.0, 0.0, math.inf
    if not isinstance(motor, Motor):
        raise TypeError(f"motor: expected a SpeedMotor or a SpringMotor, got {describe(motor)}")
    return motor._native()


def check_spring(spring: Any) -> tuple[tuple[float, float, float], float, float, float, float]:
    """For the native core."""
    if not isinstance(spring, TurnSpring):
        raise TypeError(f"spring: expected a TurnSpring, got {describe(spring)}")
    return spring._native()


def _check_strength(value: Any) -> float:
    return check_real("strength", value, nonnegative=True, finite=False)
