"""Obstacles: shapes with a signed distance, a motion, friction and an impulse counter."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import (
    as_array,
    check_array,
    check_flag,
    check_most,
    check_real,
    check_sequence,
    check_threads,
    describe,
)
from ..base.owned import Owned
from ..base.quaternions import IDENTITY, rotate, unit_quaternions
from ..base.schema import Rows
from ..errors import InputError, SolverError
from .shape import Shape
from .shapes import Plane, Solid

if TYPE_CHECKING:
    from typing_extensions import Self

Array = NDArray[np.float64]

_MOST = 1e150  # of a number of an obstacle, so that products of two are finite


class Collider(Owned):
    """An obstacle: a shape with a surface, which can move and sums its impulses.

    An obstacle belongs to the simulation it is given to: each step of that moves the obstacle
    by `velocity` and `angular_velocity`, and `impulse` is what it exerted on it. Given to two,
    it would be moved by both, `impulse` be that of the last call of either, and one thread at a
    time use both: give each a `copy()`, or, as `make_colliders` makes them, others, for a second
    simulation refuses those. Simulations also take a bare shape: that is a still obstacle without
    friction.

    Parameters
    ----------
    shape : Shape
        Of any kind. Its centre (the point of a plane) and its rotation are where the obstacle is at
        first. The distances of `Plane`, `Sphere`, `Box`, `Capsule`, `Cylinder` and `HeightField`
        are exact; those of `ConvexHull` and `TriangleMesh` are sampled at 1/64 of their longest
        side, or at 1/4 of their mean thickness, which rounds edges at that size: make a
        `SignedDistanceField` to choose the spacing.
    friction : float
        Coefficient of Coulomb friction, at least 0.
    restitution : float
        Normal velocity after an impact over that before it, from 0 to 1.
    velocity : array_like, shape (3,)
        Velocity of `position` [m/s].
    angular_velocity : array_like, shape (3,)
        Angular velocity about `position` [rad/s].
    hollow : bool
        The obstacle is what lies outside of the shape: a tank. A point in it touches the nearest
        wall only, also in a corner of a box.

    Raises
    ------
    InputError
        If a number is not finite or out of range.

    Examples
    --------
    >>> import substep
    >>> ball = substep.Collider(substep.Sphere(0.5, center=(0, 0, 1)), velocity=(1, 0, 0))
    >>> ball.advance(2.0)
    >>> ball.distance([[2.0, 0.0, 0.0]]).tolist()
    [0.5]
    """

    _native: Any
    _shape: Shape
    _deforms = False  # a facet of a surface: its state has its corners

    def __init__(
        self,
        shape: Shape,
        *,
        friction: float = 0.0,
        restitution: float = 0.0,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        hollow: bool = False,
    ) -> None:
        if not isinstance(shape, Shape):
            raise TypeError(f"shape: expected a shape, got {describe(shape)}")
        native = shape._obstacle(check_flag("hollow", hollow))
        self._shape, self._native = shape, native
        if shape.rotation != IDENTITY:
            self.rotation = shape.rotation
        self.friction = friction
        self.restitution = restitution
        self.velocity = velocity
        self.angular_velocity = angular_velocity

    def __repr__(self) -> str:
        return f"Collider({self.shape!r})"

    @property
    def shape(self) -> Shape:
        """The shape, in the place where it was made."""
        return self._shape

    @property
    def hollow(self) -> bool:
        """Whether the obstacle is what lies outside of the shape."""
        return bool(self._native.hollow)

    @property
    def friction(self) -> float:
        """Coefficient of Coulomb friction, at least 0."""
        return float(self._native.friction)

    @friction.setter
    def friction(self, value: float) -> None:
        number = check_real("friction", value, nonnegative=True)
        if number > _MOST:
            raise InputError(f"friction: expected a number of at most {_MOST}, got {number}")
        self._native.friction = number

    @property
    def restitution(self) -> float:
        """Normal velocity after an impact over that before it, from 0 to 1."""
        return float(self._native.restitution)

    @restitution.setter
    def restitution(self, value: float) -> None:
        number = check_real("restitution", value, nonnegative=True)
        if number > 1:
            raise InputError(f"restitution: expected a number from 0 to 1, got {number}")
        self._native.restitution = number

    @property
    def velocity(self) -> Array:
        """Velocity of `position` [m/s], shape (3,); a copy."""
        return np.array(self._native.velocity)

    @velocity.setter
    def velocity(self, value: ArrayLike) -> None:
        self._native.velocity = _vector("velocity", value)

    @property
    def angular_velocity(self) -> Array:
        """Angular velocity in the world frame [rad/s], shape (3,); a copy."""
        return np.array(self._native.angular_velocity)

    @angular_velocity.setter
    def angular_velocity(self, value: ArrayLike) -> None:
        self._native.angular_velocity = _vector("angular_velocity", value)

    @property
    def position(self) -> Array:
        """Where the centre of the shape (the point of a plane) is [m], shape (3,); a copy."""
        return np.array(self._native.position)

    @position.setter
    def position(self, value: ArrayLike) -> None:
        self._native.position = _vector("position", value)

    @property
    def rotation(self) -> Array:
        """Unit quaternion (w, x, y, z), frame of the shape to world, shape (4,); a copy."""
        return np.array(self._native.orientation)

    @rotation.setter
    def rotation(self, value: ArrayLike) -> None:
        self._native.orientation = unit_quaternions("rotation", value, (4,)).tolist()

    @property
    def impulse(self) -> Array:
        """Impulse exerted on the obstacle in the last call of `step` or `advance` [N s]; a copy.

        `collider.impulse / collider.duration` is the mean force. In a callback of `advance` both
        are the sums since that call began. Before any call and after `restore` both are 0, and the
        quotient NaN. A call that took no step changes nothing.
        """
        return np.array(self._native.impulse)

    @property
    def angular_impulse(self) -> Array:
        """Angular impulse about `position`, which moves, in the same time [N m s], shape (3,)."""
        return np.array(self._native.angular_impulse)

    @property
    def duration(self) -> float:
        """Time in which `impulse` and `angular_impulse` were exerted [s]."""
        return float(self._native.duration)

    @property
    def lipschitz(self) -> float:
        """Bound L on the length of the gradient outside of the obstacle.

        A point outside may move by distance / L in any direction and does not enter. 1 except for
        sampled distances.
        """
        return float(self._native.lipschitz)

    def distance(self, x: ArrayLike, threads: int | None = None) -> Array:
        """Signed distance [m] of the points, below 0 inside the obstacle.

        Parameters
        ----------
        x : array_like, shape (n, 3) or (n, 2)
            Points [m]; those of two dimensions lie at z = 0, where obstacles are cut.
        threads : int, optional
            Threads to use.

        Returns
        -------
        ndarray, shape (n,)
            Distances [m].
        """
        return _at(self._native.distance, x, threads)

    def gradient(self, x: ArrayLike, threads: int | None = None) -> Array:
        """Gradient of the distance: outward, of length 1 (a sampled distance: about 1).

        Parameters
        ----------
        x : array_like, shape (n, 3) or (n, 2)
            Points [m]; those of two dimensions lie at z = 0, where obstacles are cut.
        threads : int, optional
            Threads to use.

        Returns
        -------
        ndarray, shape of x
            Gradients; in two dimensions their part in the plane.
        """
        return _at(self._native.gradient, x, threads)

    def hessian(self, x: ArrayLike, threads: int | None = None) -> Array:
        """Second derivatives of the distance [1/m].

        Parameters
        ----------
        x : array_like, shape (n, 3) or (n, 2)
            Points [m]; those of two dimensions lie at z = 0, where obstacles are cut.
        threads : int, optional
            Threads to use.

        Returns
        -------
        ndarray, shape (n, 3, 3)
            Hessians [1/m]; in two dimensions (n, 2, 2), their part in the plane.
        """
        return _at(self._native.hessian, x, threads)

    def surface_velocity(self, x: ArrayLike, threads: int | None = None) -> Array:
        """Velocity of the obstacle's material at the points [m/s].

        Parameters
        ----------
        x : array_like, shape (n, 3) or (n, 2)
            Points [m]; those of two dimensions lie at z = 0, where obstacles are cut.
        threads : int, optional
            Threads to use.

        Returns
        -------
        ndarray, shape of x
            velocity + angular_velocity x (x - position) [m/s]; in two dimensions its part in the
            plane.
        """
        return _at(self._native.surface_velocity, x, threads)

    def copy(self) -> Self:
        """Copy exactly; the values of a sampled distance are shared."""
        other = type(self).__new__(type(self))
        other.__dict__.update(self.__getstate__(), _native=self._native.copy())
        return other

    __copy__ = copy

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self.copy()

    def _join(self, name: str, user: Any) -> None:
        """Be an obstacle of that simulation, which knows it by this name."""

    def advance(self, dt: float) -> None:
        """Move the obstacle as its velocities say; simulations do this in every step.

        Parameters
        ----------
        dt : float
            Time [s], at least 0.

        Raises
        ------
        InputError
            If it is wrong, or the obstacle would be carried beyond 1e150 m; nothing is changed
            then.
        """
        dt = check_real("dt", dt, nonnegative=True)
        try:
            self._native.advance(dt)
        except SolverError as error:
            raise InputError(f"dt: {error}") from None


class StandIn(Collider):
    """An obstacle that represents a part of another simulation: it is for one simulation alone."""

    _user: Callable[[], Any]  # that one, as a weak reference
    _of: ClassVar[tuple[str, ...]] = ("_user",)  # names of simulations that no copy takes over

    def __getstate__(self) -> dict[str, Any]:
        """A copy belongs to no simulation: a world knows whose it is."""
        return {
            name: value for name, value in super().__getstate__().items() if name not in self._of
        }

    def _join(self, name: str, user: Any) -> None:
        other = self.__dict__.get("_user", lambda: None)()
        if other is not None and other is not user and other._is_made:
            raise InputError(
                f"{name}: expected an obstacle of its own, got one of a {type(other).__name__}, "
                f"and what is pushed would get the sum of both; call make_colliders again"
            )
        self.__dict__["_user"] = weakref.ref(user)


def _vector(name: str, value: ArrayLike) -> list[float]:
    """What products of two are finite of."""
    numbers: list[float] = check_most(name, check_array(name, value, (3,)), _MOST).tolist()
    return numbers


def _at(call: Callable[..., Any], x: ArrayLike, threads: int | None) -> Array:
    """What it says of points; of those in the plane the components there."""
    points = as_array("x", x)
    flat = points.ndim == 2 and points.shape[1] == 2
    points = check_array("x", points, (None, 2 if flat else 3))
    if not flat:
        return np.asarray(call(points, check_threads(threads)))
    found = np.asarray(call(np.pad(points, ((0, 0), (0, 1))), check_threads(threads)))
    return np.ascontiguousarray(found[(slice(None), *[slice(2)] * (found.ndim - 1))])


def check_collider(name: str, value: Any) -> Collider:
    """An obstacle, or a shape that is made one."""
    if isinstance(value, Shape):
        return Collider(value)
    if isinstance(value, Collider):
        return value
    raise TypeError(f"{name}: expected a Collider or a shape, got {describe(value)}")


def check_colliders(
    colliders: Iterable[Collider | Shape], dimension: int = 3
) -> tuple[Collider, ...]:
    """Obstacles of a simulation; in 2D they are cut at z = 0."""
    given = check_sequence("colliders", colliders, "Collider or shapes")
    checked = tuple(check_collider(f"colliders[{k}]", c) for k, c in enumerate(given))
    for k, collider in enumerate(checked):
        if any(collider is other for other in checked[:k]):
            raise InputError(f"colliders[{k}]: given twice, so a step would move it twice")
        if dimension == 2 and isinstance(collider.shape, Plane):
            if np.ptp(collider.distance([(0, 0, 0), (1, 0, 0), (0, 1, 0)])) < 1e-9:
                raise InputError(
                    f"colliders[{k}]: the particles lie at z = 0, along this plane; in 2D the "
                    "normal of a ground is (0, 1, 0)"
                )
        if dimension == 2 and _stays_off_plane(collider):
            raise InputError(
                f"colliders[{k}]: expected one that reaches z = 0, where obstacles in 2D are cut, "
                f"or moves there, got {collider!r} at {collider.position}"
            )
    return checked


def _stays_off_plane(collider: Collider) -> bool:
    """Whether a solid lies on one side of z = 0, now and later."""
    shape = collider.shape
    if not isinstance(shape, Solid) or collider.hollow:
        return False
    if collider.velocity[2] or collider.angular_velocity[:2].any():
        return False
    solid: Any = shape
    back = np.array(shape.rotation) * (1, -1, -1, -1)
    local = rotate(back, solid.mesh().vertices - np.array(shape.center))
    z = rotate(collider.rotation, local)[:, 2] + collider.position[2]
    return bool(z.min() > 0 or z.max() < 0)


_STATE = 15  # numbers of `Collider::state`
_LARGEST = 1e70  # of the corners of facets [m], so that products of four are finite


def collider_states(colliders: Sequence[Collider]) -> NDArray[np.float64]:
    """What they go on from, one row each: where some deform, with nine numbers for their shapes."""
    rows = _core.collider_states([collider._native for collider in colliders])
    if any(collider._deforms for collider in colliders):
        shapes = [c._native.corners if c._deforms else (0.0,) * 9 for c in colliders]
        rows = np.concatenate([rows, shapes], axis=1)
    return rows if colliders else np.zeros((0, 0))


def largest_speed(colliders: Sequence[Collider], bounds: NDArray[np.float64], time: float) -> float:
    """Of the surfaces of colliders in a box, if they come there within so long [m/s].

    In 2D, where they are cut at z = 0.
    """
    corners = np.zeros((2, 3))
    corners[:, : bounds.shape[1]] = bounds
    natives = [collider._native for collider in colliders]
    return _core.largest_speed(natives, corners[0].tolist(), corners[1].tolist(), time)


@dataclass(frozen=True)
class _States(Rows):
    """Rows as `Collider::state` has them."""

    def _check_values(self, label: str, array: NDArray[Any], state: Mapping[str, Any]) -> None:
        super()._check_values(label, array, state)
        if not array.size:
            return
        with np.errstate(over="ignore"):
            length, friction, restitution = (
                np.linalg.norm(array[:, 3:7], axis=1),
                *array.T[13:_STATE],
            )
        wrong = ~(np.abs(length - 1) <= 1e-9)
        self._refuse(label, length, wrong, "a rotation of length 1")
        self._refuse(label, friction, friction < 0, "a friction of at least 0")
        wrong = (restitution < 0) | (restitution > 1)
        self._refuse(label, restitution, wrong, "a restitution from 0 to 1")
        most = np.where(np.arange(array.shape[1]) < _STATE, _MOST, _LARGEST)
        wanted = f"numbers within {_MOST}, of corners within {_LARGEST}"
        self._refuse(label, array, np.abs(array) > most, wanted)


def colliders_entry(colliders: Sequence[Collider]) -> Rows:
    """What a state holds of them."""
    return _States("colliders", np.float64, collider_states(colliders).shape)


def restore_colliders(colliders: Sequence[Collider], states: NDArray[np.float64]) -> None:
    """Take over what `collider_states` gave."""
    for collider, values in zip(colliders, states, strict=True):
        collider._native.state = values[:_STATE].tolist()
        if collider._deforms:
            collider._native.corners = values[_STATE:].tolist()
