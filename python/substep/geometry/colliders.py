"""Obstacles: shapes with a signed distance that move, rub and count what they are given."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import check_array, check_real, check_threads, describe
from ..base.schema import Rows
from ..errors import InputError
from .triangle_mesh import TriangleMesh

if TYPE_CHECKING:
    from typing_extensions import Self

Array = NDArray[np.float64]


class Collider:
    """What all obstacles share; make a `Plane`, `Sphere`, `Box` or `SignedDistanceField`.

    An obstacle belongs to the simulation it is given to: each step of that moves the obstacle
    by `velocity` and `angular_velocity` and leaves in `impulse` and `torque` what it exerted on it.

    Examples
    --------
    >>> import substep
    >>> isinstance(substep.Sphere(), substep.geometry.Collider)
    True
    """

    _native: Any

    def _set_up(
        self,
        native: Any,
        friction: float,
        restitution: float,
        velocity: ArrayLike,
        angular_velocity: ArrayLike,
    ) -> None:
        self._native = native
        self.friction = friction
        self.restitution = restitution
        self.velocity = velocity
        self.angular_velocity = angular_velocity

    @property
    def friction(self) -> float:
        """Coefficient of Coulomb friction, at least 0."""
        return float(self._native.friction)

    @friction.setter
    def friction(self, value: float) -> None:
        self._native.friction = check_real("friction", value, nonnegative=True)

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
        self._native.velocity = check_array("velocity", value, (3,)).tolist()

    @property
    def angular_velocity(self) -> Array:
        """Angular velocity in the world frame [rad/s], shape (3,); a copy."""
        return np.array(self._native.angular_velocity)

    @angular_velocity.setter
    def angular_velocity(self, value: ArrayLike) -> None:
        self._native.angular_velocity = check_array("angular_velocity", value, (3,)).tolist()

    @property
    def position(self) -> Array:
        """Point of the plane, centre of the sphere or box, origin of the field [m]; a copy."""
        return np.array(self._native.position)

    @position.setter
    def position(self, value: ArrayLike) -> None:
        self._native.position = check_array("position", value, (3,)).tolist()

    @property
    def orientation(self) -> Array:
        """Unit quaternion (w, x, y, z), body to world; at first (1, 0, 0, 0); a copy."""
        return np.array(self._native.orientation)

    @orientation.setter
    def orientation(self, value: ArrayLike) -> None:
        self._native.orientation = check_array("orientation", value, (4,)).tolist()

    @property
    def impulse(self) -> Array:
        """Impulse exerted on the obstacle during the last step [N s], shape (3,)."""
        return np.array(self._native.impulse)

    @property
    def torque(self) -> Array:
        """Angular impulse about `position` exerted during the last step [N m s], shape (3,)."""
        return np.array(self._native.torque)

    @property
    def lipschitz(self) -> float:
        """Bound L on the length of the gradient outside of the obstacle.

        A point outside may move by distance / L in any direction and does not enter. 1 for planes,
        spheres and boxes.
        """
        return float(self._native.lipschitz)

    def distance(self, x: ArrayLike, threads: int | None = None) -> Array:
        """Signed distance [m] of the points, below 0 inside the obstacle.

        Parameters
        ----------
        x : array_like, shape (n, 3)
            Points [m].
        threads : int, optional
            Threads to use.

        Returns
        -------
        ndarray, shape (n,)
            Distances [m].
        """
        return np.asarray(self._native.distance(check_array("x", x, (None, 3)), *_to(threads)))

    def gradient(self, x: ArrayLike, threads: int | None = None) -> Array:
        """Gradient of the distance: outward, of length 1 (a sampled distance: about 1).

        Parameters
        ----------
        x : array_like, shape (n, 3)
            Points [m].
        threads : int, optional
            Threads to use.

        Returns
        -------
        ndarray, shape (n, 3)
            Gradients.
        """
        return np.asarray(self._native.gradient(check_array("x", x, (None, 3)), *_to(threads)))

    def hessian(self, x: ArrayLike, threads: int | None = None) -> Array:
        """Second derivatives of the distance [1/m].

        Parameters
        ----------
        x : array_like, shape (n, 3)
            Points [m].
        threads : int, optional
            Threads to use.

        Returns
        -------
        ndarray, shape (n, 3, 3)
            Hessians [1/m].
        """
        return np.asarray(self._native.hessian(check_array("x", x, (None, 3)), *_to(threads)))

    def surface_velocity(self, x: ArrayLike, threads: int | None = None) -> Array:
        """Velocity of the obstacle's material at the points [m/s].

        Parameters
        ----------
        x : array_like, shape (n, 3)
            Points [m].
        threads : int, optional
            Threads to use.

        Returns
        -------
        ndarray, shape (n, 3)
            velocity + angular_velocity x (x - position) [m/s].
        """
        points = check_array("x", x, (None, 3))
        return np.asarray(self._native.surface_velocity(points, *_to(threads)))

    def copy(self) -> Self:
        """Copy exactly; the values of a sampled distance are shared."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        other._native = self._native.copy()
        return other

    __copy__ = copy

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self.copy()

    def advance(self, dt: float) -> None:
        """Move the obstacle as its velocities say; simulations do this in every step.

        Parameters
        ----------
        dt : float
            Time [s], at least 0.
        """
        self._native.advance(check_real("dt", dt, nonnegative=True))


def _to(threads: int | None) -> tuple[int]:
    return (check_threads(threads),)


class Plane(Collider):
    """A half space: everything on the side of the plane that its normal points away from.

    Parameters
    ----------
    point : array_like, shape (3,)
        A point of the plane [m].
    normal : array_like, shape (3,)
        Outward normal, of any length above 0.
    friction : float
        Coefficient of Coulomb friction, at least 0.
    restitution : float
        Normal velocity after an impact over that before it, from 0 to 1.
    velocity : array_like, shape (3,)
        Velocity of the point [m/s].
    angular_velocity : array_like, shape (3,)
        Angular velocity about the point [rad/s].

    Raises
    ------
    InputError
        If the normal is zero, or a number is not finite or out of range.

    Examples
    --------
    >>> import substep
    >>> ground = substep.Plane(friction=0.5)
    >>> ground.distance([[1.0, 2.0, 3.0]]).tolist()
    [3.0]
    """

    def __init__(
        self,
        point: ArrayLike = (0.0, 0.0, 0.0),
        normal: ArrayLike = (0.0, 0.0, 1.0),
        *,
        friction: float = 0.0,
        restitution: float = 0.0,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        direction = check_array("normal", normal, (3,))
        length = math.hypot(*direction)
        if not (0 < length < math.inf):
            raise InputError(f"normal: expected a vector that is not zero, got {describe(normal)}")
        native = _core.Collider.plane(
            check_array("point", point, (3,)).tolist(), (direction / length).tolist()
        )
        self._set_up(native, friction, restitution, velocity, angular_velocity)


class Sphere(Collider):
    """A ball, or with `hollow` all space outside of it.

    Parameters
    ----------
    center : array_like, shape (3,)
        Centre [m].
    radius : float
        Radius [m], above 0.
    hollow : bool
        The obstacle is what lies outside of the sphere: a round container.
    friction : float
        Coefficient of Coulomb friction, at least 0.
    restitution : float
        Normal velocity after an impact over that before it, from 0 to 1.
    velocity : array_like, shape (3,)
        Velocity of the centre [m/s].
    angular_velocity : array_like, shape (3,)
        Angular velocity [rad/s].

    Raises
    ------
    InputError
        If a number is not finite or out of range.

    Examples
    --------
    >>> import substep
    >>> ball = substep.Sphere((0, 0, 1), 0.5, velocity=(1, 0, 0))
    >>> ball.advance(2.0)
    >>> ball.distance([[2.0, 0.0, 0.0]]).tolist()
    [0.5]
    """

    def __init__(
        self,
        center: ArrayLike = (0.0, 0.0, 0.0),
        radius: float = 1.0,
        *,
        hollow: bool = False,
        friction: float = 0.0,
        restitution: float = 0.0,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        native = _core.Collider.sphere(
            check_array("center", center, (3,)).tolist(),
            check_real("radius", radius, positive=True),
            bool(hollow),
        )
        self._set_up(native, friction, restitution, velocity, angular_velocity)


class Box(Collider):
    """A solid box, or with `hollow` all space outside of it.

    Parameters
    ----------
    center : array_like, shape (3,)
        Centre [m].
    lengths : array_like, shape (3,)
        Full lengths of the edges [m], above 0, along x, y and z while `orientation` is not set.
    hollow : bool
        The obstacle is what lies outside of the box: a tank. A point then touches the nearest wall
        only, also in a corner.
    friction : float
        Coefficient of Coulomb friction, at least 0.
    restitution : float
        Normal velocity after an impact over that before it, from 0 to 1.
    velocity : array_like, shape (3,)
        Velocity of the centre [m/s].
    angular_velocity : array_like, shape (3,)
        Angular velocity [rad/s].

    Raises
    ------
    InputError
        If a number is not finite or out of range.

    Examples
    --------
    >>> import substep
    >>> box = substep.Box(lengths=(2, 2, 2))
    >>> box.distance([[0.0, 0.0, 0.75], [4.0, 5.0, 0.0]]).tolist()
    [-0.25, 5.0]
    """

    def __init__(
        self,
        center: ArrayLike = (0.0, 0.0, 0.0),
        lengths: ArrayLike = (1.0, 1.0, 1.0),
        *,
        hollow: bool = False,
        friction: float = 0.0,
        restitution: float = 0.0,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        sides = check_array("lengths", lengths, (3,))
        if not (sides > 0).all():
            raise InputError(f"lengths: expected numbers above 0, got {sides.tolist()}")
        native = _core.Collider.box(
            check_array("center", center, (3,)).tolist(), (sides / 2).tolist(), bool(hollow)
        )
        self._set_up(native, friction, restitution, velocity, angular_velocity)


class SignedDistanceField(Collider):
    """An obstacle of any form: its signed distance on the nodes of a regular grid.

    Between the nodes the distance is the quadratic B-spline of the values, which is continuously
    differentiable and never further from the true distance than `error_bound`; edges are rounded at
    the size of the grid, a sphere of radius R loses spacing**2 / (4 R). Outside of the grid the
    distance is a lower bound of the true one, at least 0.7 of it.

    Parameters
    ----------
    values : array_like, shape (n_x, n_y, n_z)
        Signed distances [m], below 0 inside; at least 4 nodes along each axis, and above 0 on the
        outer two layers.
    spacing : float
        Distance between neighbouring nodes [m], the same along all axes.
    origin : array_like, shape (3,)
        Position of values[0, 0, 0] [m], in the frame of the obstacle, which is turned about
        `position`.
    position : array_like, shape (3,)
        Where the origin of that frame lies in the world [m].
    hollow : bool
        The obstacle is what lies outside: a vessel.
    friction : float
        Coefficient of Coulomb friction, at least 0.
    restitution : float
        Normal velocity after an impact over that before it, from 0 to 1.
    velocity : array_like, shape (3,)
        Velocity of `position` [m/s].
    angular_velocity : array_like, shape (3,)
        Angular velocity [rad/s].
    threads : int, optional
        Threads to use at construction.

    Raises
    ------
    InputError
        If a value is not finite, neighbours differ by more than twice the spacing (no distance
        does), or the surface comes too near to the border.

    Examples
    --------
    >>> import numpy as np, substep
    >>> x = np.linspace(-2, 2, 41)
    >>> values = np.sqrt(x[:, None, None] ** 2 + x[:, None] ** 2 + x**2) - 1
    >>> ball = substep.SignedDistanceField(values, spacing=0.1, origin=(-2, -2, -2))
    >>> float(ball.distance([[1.5, 0.0, 0.0]])[0].round(2))
    0.5
    """

    def __init__(
        self,
        values: ArrayLike,
        spacing: float,
        origin: ArrayLike = (0.0, 0.0, 0.0),
        *,
        position: ArrayLike = (0.0, 0.0, 0.0),
        hollow: bool = False,
        friction: float = 0.0,
        restitution: float = 0.0,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        threads: int | None = None,
    ) -> None:
        self._field = _core.SampledDistance(
            check_array("values", values, (None, None, None)),
            check_array("origin", origin, (3,)).tolist(),
            check_real("spacing", spacing, positive=True),
            check_threads(threads),
        )
        native = _core.Collider.sampled(
            self._field, check_array("position", position, (3,)).tolist(), bool(hollow)
        )
        self._set_up(native, friction, restitution, velocity, angular_velocity)

    @classmethod
    def from_mesh(
        cls,
        mesh: TriangleMesh,
        spacing: float | None = None,
        *,
        offset: float = 0.0,
        position: ArrayLike = (0.0, 0.0, 0.0),
        hollow: bool = False,
        friction: float = 0.0,
        restitution: float = 0.0,
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        threads: int | None = None,
    ) -> SignedDistanceField:
        """Sample the signed distance of a mesh, which may be open, not manifold or cut itself.

        Parameters
        ----------
        mesh : TriangleMesh
            The surface; inside is where its winding number is above 1/2.
        spacing : float, optional
            Distance between neighbouring nodes [m]; by default 1/64 of the longest side of the
            mesh's bounding box. Parts thinner than about two spacings get lost.
        offset : float
            Grow the solid by this much [m], at least 0: a sheet becomes a plate of thickness
            2 offset.
        position, hollow, friction, restitution, velocity, angular_velocity, threads
            As for the class.

        Returns
        -------
        SignedDistanceField
            In the frame of the mesh's vertices.

        Raises
        ------
        InputError
            If no node lies inside, or the grid would have more than 1e8 nodes.

        Examples
        --------
        >>> import substep
        >>> ball = substep.SignedDistanceField.from_mesh(substep.geometry.sphere_mesh(), 0.1)
        >>> float(ball.distance([[1.2, 0.0, 0.0]])[0].round(1))
        0.2
        """
        low, high = mesh.vertices[mesh.faces].min((0, 1)), mesh.vertices[mesh.faces].max((0, 1))
        h = (high - low).max() / 64 if spacing is None else spacing
        h = check_real("spacing", h, positive=True)
        grown = check_real("offset", offset, nonnegative=True)
        pad = grown + 3 * h
        cells = np.ceil((high - low + 2 * pad) / h)
        if not np.prod(cells + 1) <= 1e8:
            raise InputError(f"spacing: {h} gives a grid of {np.prod(cells + 1):.1e} nodes")
        origin = 0.5 * (low + high - cells * h)
        shape = [int(n) + 1 for n in cells]
        values = mesh._tree.sample(shape, origin.tolist(), h, check_threads(threads)) - grown
        if not (values < 0).any():
            lacks = "; ".join(mesh.report().lacks) or "parts thinner than the spacing"
            raise InputError(
                f"mesh: no node lies inside ({lacks}); make spacing smaller than {h} or offset "
                f"larger than {grown}"
            )
        return cls(
            values,
            h,
            origin,
            position=position,
            hollow=hollow,
            friction=friction,
            restitution=restitution,
            velocity=velocity,
            angular_velocity=angular_velocity,
            threads=threads,
        )

    @property
    def values(self) -> Array:
        """Signed distances at the nodes [m], shape (n_x, n_y, n_z); a copy."""
        return np.asarray(self._field.values)

    @property
    def spacing(self) -> float:
        """Distance between neighbouring nodes [m]."""
        return float(self._field.spacing)

    @property
    def origin(self) -> Array:
        """Position of the first node in the frame of the obstacle [m]."""
        return np.array(self._field.origin)

    @property
    def error_bound(self) -> float:
        """sqrt(3)/2 spacing [m]: the most by which a true distance on the nodes is missed."""
        return float(self._field.error_bound)


def check_colliders(colliders: Iterable[Collider], dimension: int = 3) -> tuple[Collider, ...]:
    """Obstacles of a simulation; in 2D they are cut at z = 0."""
    checked = tuple(colliders)
    for k, collider in enumerate(checked):
        if not isinstance(collider, Collider):
            raise TypeError(f"colliders[{k}]: expected a Collider, got {collider!r}")
        if dimension == 2 and isinstance(collider, Plane):
            if np.ptp(collider.distance([(0, 0, 0), (1, 0, 0), (0, 1, 0)])) < 1e-9:
                raise InputError(
                    f"colliders[{k}]: the particles lie at z = 0, along this plane; in 2D the "
                    "normal of a ground is (0, 1, 0)"
                )
    return checked


def collider_states(colliders: Sequence[Collider]) -> NDArray[np.float64]:
    """All that changes of them, one row each."""
    rows = [collider._native.state for collider in colliders]
    return np.array(rows) if rows else np.zeros((0, 0))


def colliders_entry(colliders: Sequence[Collider]) -> Rows:
    """What a state holds of them."""
    return Rows("colliders", np.float64, collider_states(colliders).shape)


def restore_colliders(colliders: Sequence[Collider], states: NDArray[np.float64]) -> None:
    """Take over what `collider_states` gave."""
    for collider, values in zip(colliders, states, strict=True):
        collider._native.state = values.tolist()
