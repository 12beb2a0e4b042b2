"""Joints between rigid bodies: making them, and taking them out."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_flag, check_real, in_range
from ..errors import InputError
from .joint import KINDS, Joint, Motor, TurnSpring, check_limits, check_motor, check_spring
from .rows import BodyRows

Ids = NDArray[np.int64]
NO_SPRING = TurnSpring(0.0, 0.0)._native()


class Joints(BodyRows):
    """Joints of a world of rigid bodies; make `RigidBodies`."""

    _joint_ids: Ids
    _next_joint: int

    @property
    def joints(self) -> tuple[Joint, ...]:
        """All joints, in the order in which they were made."""
        return tuple(Joint(self, int(number)) for number in self._joint_ids)

    def ball(
        self,
        a: int,
        b: int | None,
        anchor: ArrayLike,
        *,
        axis: ArrayLike = (1.0, 0.0, 0.0),
        limits: ArrayLike | None = None,
        cone: float = math.pi,
        collide: bool = False,
    ) -> Joint:
        """Join two bodies at a point about which they turn freely.

        Parameters
        ----------
        a, b : int
            Ids of the bodies; b None is the world.
        anchor : array_like, shape (3,)
            The point, in the world, where the bodies are now [m].
        axis : array_like, shape (3,), optional
            About which the twist is measured, and that the cone is about.
        limits : array_like, shape (2,), optional
            Least and greatest twist from now on [rad].
        cone : float, optional
            Largest angle between the axes of both bodies, at most pi [rad].
        collide : bool, optional
            Whether the bodies still touch each other.

        Returns
        -------
        Joint
            The joint.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        half = check_real("cone", cone, positive=True)
        if half > math.pi:
            raise InputError(f"cone: expected an angle above 0 and at most pi, got {half}")
        return self._join(
            "ball",
            a,
            b,
            anchor,
            _axis(axis),
            limits,
            None,
            collide,
            math.inf if half == math.pi else half,
        )

    def hinge(
        self,
        a: int,
        b: int | None,
        anchor: ArrayLike,
        axis: ArrayLike,
        *,
        limits: ArrayLike | None = None,
        motor: Motor | None = None,
        collide: bool = False,
    ) -> Joint:
        """Join two bodies by an axis about which they turn.

        Parameters
        ----------
        a, b : int
            Ids of the bodies; b None is the world.
        anchor : array_like, shape (3,)
            A point of the axis, in the world, where the bodies are now [m].
        axis : array_like, shape (3,)
            Its direction, in the world. Seen from b, the angle grows as a turns about it by the
            right-hand rule.
        limits : array_like, shape (2,), optional
            Least and greatest angle from now on [rad].
        motor : SpeedMotor or SpringMotor, optional
            Acts on the angle.
        collide : bool, optional
            Whether the bodies still touch each other.

        Returns
        -------
        Joint
            The joint.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.

        Examples
        --------
        A pendulum of 1 m swings back after about two seconds:

        >>> import substep
        >>> bodies = substep.RigidBodies()
        >>> bob = bodies.add(substep.Sphere(0.01), (0.1, 0, -0.995))
        >>> hinge = bodies.hinge(bob, None, (0, 0, 0), (0, 1, 0))
        >>> bodies.advance(2.0)
        >>> bool(abs(hinge.coordinate) < 0.01), max(hinge.error) < 1e-6
        (True, True)
        """
        return self._join("hinge", a, b, anchor, _axis(axis), limits, motor, collide)

    def slider(
        self,
        a: int,
        b: int | None,
        anchor: ArrayLike,
        axis: ArrayLike,
        *,
        limits: ArrayLike | None = None,
        motor: Motor | None = None,
        collide: bool = False,
    ) -> Joint:
        """Join two bodies by a rail along which they slide without turning.

        Parameters
        ----------
        a, b : int
            Ids of the bodies; b None is the world.
        anchor : array_like, shape (3,)
            A point of the rail, in the world, where the bodies are now [m].
        axis : array_like, shape (3,)
            Its direction, in the world, fixed in b; the translation is that of a.
        limits : array_like, shape (2,), optional
            Least and greatest translation from now on [m].
        motor : SpeedMotor or SpringMotor, optional
            Acts on the translation.
        collide : bool, optional
            Whether the bodies still touch each other.

        Returns
        -------
        Joint
            The joint.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        return self._join("slider", a, b, anchor, _axis(axis), limits, motor, collide)

    def fixed(self, a: int, b: int | None, anchor: ArrayLike, *, collide: bool = False) -> Joint:
        """Join two bodies as they are now.

        Parameters
        ----------
        a, b : int
            Ids of the bodies; b None is the world.
        anchor : array_like, shape (3,)
            Where, in the world, where the bodies are now [m]; `force` and `torque` are about it.
        collide : bool, optional
            Whether the bodies still touch each other.

        Returns
        -------
        Joint
            The joint.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        return self._join("fixed", a, b, anchor, (1.0, 0.0, 0.0), None, None, collide)

    def elastic(
        self,
        a: int,
        b: int | None,
        anchor: ArrayLike,
        axis: ArrayLike,
        spring: TurnSpring,
        *,
        collide: bool = False,
    ) -> Joint:
        """Join two bodies at a point, with springs against twist and swing.

        Parameters
        ----------
        a, b : int
            Ids of the bodies; b None is the world.
        anchor : array_like, shape (3,)
            The point, in the world, where the bodies are now [m].
        axis : array_like, shape (3,)
            About which the twist is measured, in the world; along the rod, of a rod.
        spring : TurnSpring
            Turns the bodies back to where they are now, or to its rest.
        collide : bool, optional
            Whether the bodies still touch each other.

        Returns
        -------
        Joint
            The joint.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.

        Examples
        --------
        A pendulum of torsion swings back in half a period, pi sqrt(I / k):

        >>> import math, substep
        >>> bodies = substep.RigidBodies(gravity=(0, 0, 0))
        >>> disk = bodies.add(substep.Cylinder(0.2, 0.1), (0, 0, 0), mass=50.0)  # 1 kg m^2
        >>> bodies.set_angular_velocities([(0, 0, 0.5)])
        >>> spring = substep.rigid.TurnSpring(swing=100.0, twist=math.pi**2)
        >>> wire = bodies.elastic(disk, None, (0, 0, 0), (0, 0, 1), spring)
        >>> bodies.advance(1.0)
        >>> bool(abs(wire.coordinate) < 1e-4), round(wire.speed, 3)
        (True, -0.5)
        """
        turning = check_spring(spring)
        return self._join("elastic", a, b, anchor, _axis(axis), None, None, collide, spring=turning)

    def universal(
        self,
        a: int,
        b: int | None,
        anchor: ArrayLike,
        axis_a: ArrayLike,
        axis_b: ArrayLike,
        *,
        limits: ArrayLike | None = None,
        motor: Motor | None = None,
        collide: bool = False,
    ) -> Joint:
        """Join two bodies by a cross of two axes: it bends, and carries the twist over.

        Parameters
        ----------
        a, b : int
            Ids of the bodies; b None is the world.
        anchor : array_like, shape (3,)
            Where the axes cross, in the world, where the bodies are now [m].
        axis_a, axis_b : array_like, shape (3,)
            Axes about which the cross turns in a and in b, in the world, at right angles. A shaft
            is at right angles to the axis in it.
        limits : array_like, shape (2,), optional
            Least and greatest angle about `axis_a` from now on [rad].
        motor : SpeedMotor or SpringMotor, optional
            Acts on the angle about `axis_a`.
        collide : bool, optional
            Whether the bodies still touch each other.

        Returns
        -------
        Joint
            The joint.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.

        Examples
        --------
        Half a turn of a shaft that is bent by 30 degrees; its end is slower then, by the cosine:

        >>> import math, substep
        >>> bodies = substep.RigidBodies(gravity=(0, 0, 0))
        >>> shaft = substep.rigid.Box((1, 0.1, 0.1))
        >>> driver, driven = bodies.add(shaft, [(-0.5, 0, 0), (0.433, 0.25, 0)])
        >>> out = bodies.hinge(driven, None, (0, 0, 0), (math.cos(math.pi / 6), 0.5, 0))
        >>> motor = substep.rigid.SpeedMotor(math.pi)
        >>> turning = bodies.hinge(driver, None, (0, 0, 0), (1, 0, 0), motor=motor)
        >>> cross = bodies.universal(driven, driver, (0, 0, 0), (-0.5, 0.866, 0), (0, 0, 1))
        >>> bodies.advance(1.0)
        >>> round(out.coordinate, 2), round(out.speed / turning.speed, 2)
        (3.14, 0.87)
        """
        x, y = _axis(axis_a, "axis_a"), _axis(axis_b, "axis_b")
        return self._join("universal", a, b, anchor, x, limits, motor, collide, math.inf, axis_b=y)

    def distance(
        self,
        a: int,
        b: int | None,
        point_a: ArrayLike,
        point_b: ArrayLike,
        *,
        limits: ArrayLike | None = None,
        motor: Motor | None = None,
        collide: bool = True,
    ) -> Joint:
        """Join points of two bodies by a rod, a rope or a spring.

        Parameters
        ----------
        a, b : int
            Ids of the bodies; b None is the world.
        point_a, point_b : array_like, shape (3,)
            The points, in the world, where the bodies are now [m].
        limits : array_like, shape (2,), optional
            Least and greatest distance [m]; that of now for both unless given: a rod. A rope is
            (0, length), and (0, inf) with a `SpringMotor` a spring.
        motor : SpeedMotor or SpringMotor, optional
            Acts on the distance, within `limits`, which have to be given then.
        collide : bool, optional
            Whether the bodies still touch each other.

        Returns
        -------
        Joint
            The joint.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        x, y = check_array("point_a", point_a, (3,)), check_array("point_b", point_b, (3,))
        if limits is None:
            if motor is not None:
                check_motor(motor)
                raise InputError(
                    "limits: expected the distances between which the motor acts, such as "
                    "(0, inf) for a spring; without them the joint is a rod"
                )
            with in_range("point_a, point_b"):
                length = float(np.linalg.norm(x - y))
            limits = (length, length)
        return self._join("distance", a, b, x, y.tolist(), limits, motor, collide)

    def _join(
        self,
        kind: str,
        a: int,
        b: int | None,
        anchor: ArrayLike,
        axis: Any,
        limits: ArrayLike | None,
        motor: Motor | None,
        collide: bool,
        cone: float = math.inf,
        axis_b: Any = (0.0, 0.0, 0.0),
        spring: Any = NO_SPRING,
    ) -> Joint:
        point = check_array("anchor", anchor, (3,)).tolist()
        lower, upper = check_limits("limits", limits)
        drive = check_motor(motor)
        touching = check_flag("collide", collide)
        first = self._row("a", a)
        second = -1 if b is None else self._row("b", b)
        number = self._next_joint
        ids = np.append(self._joint_ids, np.int64(number))
        bodies, ends = (first, second), (lower, upper)
        joint = Joint(self, number)
        self._commit(
            {"_joint_ids": ids, "_next_joint": number + 1},
            self._native.add_joint,
            *(
                KINDS.index(kind),
                *bodies,
                point,
                axis,
                axis_b,
                *ends,
                cone,
                drive,
                spring,
                touching,
            ),
        )
        return joint

    def _remove_joint(self, row: int) -> None:
        left = {"_joint_ids": np.delete(self._joint_ids, row)}
        self._commit(left, self._native.remove_joints, np.array([row]))

    def _joints_of(self, bodies: Ids) -> Ids:
        """Those that hold one of these bodies."""
        held = self._native.joint_bodies()
        return np.flatnonzero(np.isin(held, bodies).any(axis=1))


def _axis(axis: ArrayLike, name: str = "axis") -> list[float]:
    n: list[float] = check_array(name, axis, (3,)).tolist()
    if not any(n):
        raise InputError(f"{name}: expected a vector that is not 0")
    return n
