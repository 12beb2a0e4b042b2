"""Rigid bodies: shapes and mass, contact with friction, joints, queries.

Rotations are unit quaternions (w, x, y, z) that take the frame of the body into the world.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import (
    check_array,
    check_choice,
    check_flag,
    check_integer,
    check_real,
    describe,
)
from ..base.rows import read_only
from ..base.simulation import with_energy
from ..errors import InputError
from .colliders import BodyCollider, colliders_of
from .fixtures import (
    EVERYTHING,
    MOTIONS,
    STILL,
    Fixture,
    Made,
    Shape,
    check_fixtures,
    check_mass,
    check_material,
    check_pair,
    native_rows,
    pair_of,
)
from .mass import MassProperties
from .robots import Robots
from .rows import check_momenta, is_one, principal_frames
from .run import Runs
from .state import States, rename

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

ROTATIONS = ("splitting", "exact", "quaternion")


class RigidBodies(Robots, Runs, States):
    """Rigid bodies that fall, collide, rub, roll, and hang together by joints.

    A body has one or several shapes; `add` puts bodies in. Where they are is in `positions` and
    `rotations`, as they were put in: of the frame in which the shapes of a body are given. What a
    step moves are the views `centers_of_mass`, `principal_rotations`, `momenta` and
    `angular_momenta`. Arrays have one row for each body, in the order of `ids`. docs/rigid.md has
    how to use it, docs/rigid_contact.md what a step does.

    Parameters
    ----------
    gravity : array_like, shape (3,), optional
        Acceleration [m/s^2].
    step : float, optional
        Step of `advance` [s].
    substeps : int, optional
        Parts that the solver of contacts and joints cuts a step into.
    rotation : {'splitting', 'exact', 'quaternion'}, optional
        How bodies turn: symplectic, in closed form, or as in textbooks (`free_rotation`).
    sleeping : bool, optional
        Bodies that have come to rest cost nothing until something moves them.
    continuous : bool, optional
        Bodies that are fast for their size never pass through others.
    contact_margin : float, optional
        Distance at which contacts begin to be looked at [m].
    time : float, optional
        Time of the initial state [s].
    threads : int, optional
        Threads of the native loops; results do not depend on it.

    Raises
    ------
    InputError
        If an argument is wrong, with its name.

    See Also
    --------
    free_rotation : The rotation of bodies on which nothing acts.

    References
    ----------
    Macklin et al., "Small steps in physics simulation", SCA 2019; Moreau, "Unilateral contact and
    dry friction in finite freedom dynamics", 1988; Smith et al., "Reflections on simultaneous
    impact", ACM Trans. Graph. 31(4), 2012; Touma and Wisdom, Astron. J. 107, 1994.

    Examples
    --------
    Three boxes on one another, and a ball that bounces:

    >>> import substep
    >>> bodies = substep.RigidBodies()
    >>> ground = bodies.add(substep.Plane(), (0, 0, 0), motion="static")
    >>> stack = bodies.add(
    ...     substep.Box((1, 1, 1)), [[0, 0, 0.5], [0, 0, 1.5], [0, 0, 2.5]])
    >>> ball = bodies.add(substep.Sphere(0.1), (3, 0, 1.1), restitution=0.8)
    >>> bodies.advance(1.0)
    >>> bodies.positions[stack, 2].round(2).tolist()
    [0.5, 1.5, 2.5]
    >>> bool(bodies.positions[ball, 2] > 0.4)
    True
    """

    _rows_are = "bodies"

    def __init__(
        self,
        *,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        step: float = 1 / 60,
        substeps: int = 8,
        rotation: str = "splitting",
        sleeping: bool = True,
        continuous: bool = True,
        contact_margin: float = 0.02,
        time: float = 0.0,
        threads: int | None = None,
    ) -> None:
        self._options = {
            "gravity": check_array("gravity", gravity, (3,)).tolist(),
            "substeps": check_integer("substeps", substeps, minimum=1, maximum=1000),
            "rotation": check_choice("rotation", rotation, ROTATIONS),
            "sleeping": check_flag("sleeping", sleeping),
            "continuous": check_flag("continuous", continuous),
            "contact_margin": check_real("contact_margin", contact_margin, positive=True),
        }
        self._step_size = check_real("step", step, positive=True)
        self._ids = np.zeros(0, np.int64)
        self._next_id = 0
        self._centres, self._axes = np.zeros((0, 3)), np.zeros((0, 4))
        self._weights = np.zeros((0, 4))
        self._made: list[Made] = []
        self._joint_ids, self._next_joint = np.zeros(0, np.int64), 0
        super().__init__(_core.RigidWorld(self._options), time, threads)

    @property
    def gravity(self) -> Array:
        """Acceleration [m/s^2], shape (3,), read-only; assign to change it, which wakes all bodies.

        It is not part of a state.
        """
        return read_only(np.array(self._options["gravity"]))

    @gravity.setter
    def gravity(self, value: ArrayLike) -> None:
        g = check_array("gravity", value, (3,)).tolist()
        parts = {"_options": {**self._options, "gravity": g}}  # copies have the old one
        self._commit(parts, setattr, self._native, "gravity", g)

    def add(
        self,
        shape: Shape | Fixture | Sequence[Shape | Fixture],
        positions: ArrayLike,
        rotations: ArrayLike = (1.0, 0.0, 0.0, 0.0),
        velocities: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocities: ArrayLike = (0.0, 0.0, 0.0),
        *,
        motion: str = "dynamic",
        density: float = 1000.0,
        mass: float | MassProperties | None = None,
        inertia: ArrayLike | None = None,
        friction: float = 0.5,
        static_friction: float | None = None,
        restitution: float = 0.0,
        rolling_friction: float = 0.0,
        spinning_friction: float = 0.0,
        group: int = 1,
        mask: int = EVERYTHING,
        material: str | None = None,
    ) -> Any:
        """Put in one body, or several alike.

        Parameters
        ----------
        shape : Shape, Fixture or list
            The shape in the frame of the body (of any kind but `SignedDistanceField`), or those of
            a compound. Planes, meshes (`geometry.TriangleMesh`, which may be open) and height
            fields are ground, of static bodies only.
        positions : array_like, shape (3,) or (n, 3)
            Where the frames of the bodies are, in which their shapes are given [m].
        rotations : array_like, shape (4,) for all or (n, 4), optional
            Quaternions (w, x, y, z) that turn the frames; are normalised.
        velocities : array_like, shape (3,) for all or (n, 3), optional
            Of the centres of mass [m/s].
        angular_velocities : array_like, shape (3,) for all or (n, 3), optional
            In the world [rad/s].
        motion : {'dynamic', 'kinematic', 'static'}, optional
            Moved by forces and impulses; at the velocities given, whatever it meets; not at all.
        density : float, optional
            [kg/m^3]; gives a dynamic body its mass, centre and inertia.
        mass : float or MassProperties, optional
            Of each body [kg], instead of that by `density`, or all that it weighs, in the frame of
            the body.
        inertia : array_like, shape (3,) or (3, 3), optional
            About the centre of mass along the axes of the frame [kg m^2], instead of that by
            `density` and `mass`.
        friction : float, optional
            Coefficient of Coulomb friction, of what slips; of two surfaces the root of the product
            holds.
        static_friction : float, optional
            That of what sticks, at least `friction`, which it is unless given; of two surfaces the
            root of the product holds.
        restitution : float, optional
            Normal velocity after an impact over that before it, from 0 to 1; of two surfaces the
            greater one holds.
        rolling_friction, spinning_friction : float, optional
            Levers of the torques that resist rolling and spinning on the spot [m]; of two surfaces
            the greater ones hold.
        group, mask : int, optional
            32 bits each: shapes touch where `group` of each has a bit of `mask` of the other.
        material : str, optional
            A name for the surface: `set_material_pair` says what holds between two of them.

        Returns
        -------
        int or ndarray of int64, shape (n,)
            Their ids, which no other body had or will have.

        Raises
        ------
        InputError
            If an argument is wrong; nothing is changed then.

        Examples
        --------
        >>> import substep
        >>> bodies = substep.RigidBodies(gravity=(0, 0, 0))
        >>> bodies.add(substep.Sphere(0.5), [[0, 0, 0], [2, 0, 0]], mass=3.0)
        array([0, 1])
        >>> bodies.masses.tolist()
        [3.0, 3.0]
        """
        way = check_choice("motion", motion, MOTIONS)
        defaults = {
            "density": density,
            "friction": friction,
            "static_friction": static_friction,
            "restitution": restitution,
            "rolling_friction": rolling_friction,
            "spinning_friction": spinning_friction,
            "group": group,
            "mask": mask,
            "material": material,
        }
        fixtures = check_fixtures(shape, defaults, way)
        weight = None
        if way == "dynamic":
            weight = check_mass(fixtures, mass, inertia)
        elif mass is not None or inertia is not None:
            raise InputError(f"mass, inertia: a {way} body has none")
        single = is_one(positions)
        x = check_array("positions", positions, (3,) if single else (None, 3))
        n = 1 if single else len(x)
        every = np.arange(n)
        q = self._quaternions("rotations", rotations, every)
        x = self._vectors("positions", x, every)
        v = self._vectors("velocities", velocities, every)
        w = self._vectors("angular_velocities", angular_velocities, every)
        if way == "static" and (v.any() or w.any()):
            raise InputError("velocities: a static body has none")
        frame = STILL if weight is None else weight
        body: Made = (fixtures, way, weight)
        poses = principal_frames(x, q, frame.center_of_mass, frame.axes)
        ids = np.arange(self._next_id, self._next_id + n, dtype=np.int64)
        own = [np.nan] * 4 if weight is None else [frame.mass, *frame.principal_inertia]
        for name, given in (("velocities", v), ("angular_velocities", w)):
            check_momenta(name, given, np.array(own))
        rows = (frame.center_of_mass, frame.axes, own)
        grown = self._grown([body] * n, *(np.tile(row, (n, 1)) for row in rows))
        self._commit(grown, self._native.add, *native_rows({}, body, *poses, v, w))
        return int(ids[0]) if single else ids

    def _grown(self, bodies: list[Made], centres: Array, axes: Array, own: Array) -> dict[str, Any]:
        """What changes here where bodies are put in."""
        end = self._next_id + len(bodies)
        return {
            "_ids": np.concatenate([self._ids, np.arange(self._next_id, end, dtype=np.int64)]),
            "_centres": np.concatenate([self._centres, centres]),
            "_axes": np.concatenate([self._axes, axes]),
            "_weights": np.concatenate([self._weights, own]),
            "_made": self._made + bodies,
            "_next_id": end,
        }

    def remove(self, ids: ArrayLike) -> None:
        """Remove bodies, and the joints that hold them. Bodies that they touch wake.

        Parameters
        ----------
        ids : int or array_like of int, shape (m,)
            Which.

        Raises
        ------
        IndexError
            If there is no such body; nothing is changed then.
        """
        rows = np.unique(self._rows(ids))
        keep = np.ones(len(self), bool)
        keep[rows] = False
        joints = self._joints_of(rows)
        left = {
            "_ids": self._ids[keep],
            "_weights": self._weights[keep],
            "_centres": self._centres[keep],
            "_axes": self._axes[keep],
            "_made": [made for made, kept in zip(self._made, keep, strict=True) if kept],
            "_joint_ids": np.delete(self._joint_ids, joints),
        }
        self._commit(left, self._native.remove, rows)

    def exclude(self, a: int, b: int, excluded: bool = True) -> None:
        """Let two bodies go through each other, or no more.

        Parameters
        ----------
        a, b : int
            Their ids.
        excluded : bool, optional
            Whether they do.

        Raises
        ------
        InputError, IndexError
            If there are no two such bodies.
        """
        first, second = self._row("a", a), self._row("b", b)
        if first == second:
            raise InputError(f"b: expected another body than {a}")
        self._native.exclude(first, second, check_flag("excluded", excluded))

    def set_material_pair(
        self,
        a: str,
        b: str,
        *,
        friction: float | None = None,
        static_friction: float | None = None,
        restitution: float | None = None,
        rolling_friction: float | None = None,
        spinning_friction: float | None = None,
    ) -> None:
        """Say what holds between surfaces of two materials, from the next step on. Bodies wake.

        It replaces earlier values for the pair. What is None follows from the two
        surfaces, as `add` says, but static friction follows from `friction` where that is given;
        where all is None, the pair is like any other again.

        Parameters
        ----------
        a, b : str
            Materials of shapes of bodies, in any order; may be the same.
        friction : float, optional
            Coefficient of Coulomb friction of what slips.
        static_friction : float, optional
            Of what sticks, at least `friction`, which it needs beside it and is unless given.
        restitution : float, optional
            From 0 to 1.
        rolling_friction, spinning_friction : float, optional
            Levers [m].

        Raises
        ------
        InputError
            If an argument is wrong, or no shape is of such a material; nothing is changed then.

        Examples
        --------
        >>> import substep
        >>> bodies = substep.RigidBodies()
        >>> ice = bodies.add(substep.Plane(), (0, 0, 0), motion="static", material="ice")
        >>> tyre = bodies.add(
        ...     substep.Box((1, 1, 1)), (0, 0, 0.5), velocities=(1, 0, 0), material="rubber")
        >>> bodies.set_material_pair("rubber", "ice", friction=0.1, static_friction=0.15)
        >>> bodies.advance(0.5)
        >>> bodies.velocities[tyre, 0].round(2).tolist()
        0.51
        """
        known = {fixture.material for made in self._made for fixture in made[0]} - {None}
        known.update(name for pair in self.material_pairs for name in pair)
        names = [check_material(*given) for given in (("a", a), ("b", b))]
        for argument, name in zip("ab", names, strict=True):
            if name not in known:
                if not known:
                    raise InputError(f"{argument}: no shape has a material, got {describe(name)}")
                told = ", ".join(sorted(map(repr, known)))
                raise InputError(
                    f"{argument}: expected a material of a shape, {told}, got {describe(name)}"
                )
        numbers = check_pair(
            {
                "friction": friction,
                "static_friction": static_friction,
                "restitution": restitution,
                "rolling_friction": rolling_friction,
                "spinning_friction": spinning_friction,
            }
        )
        self._native.set_material_pair(*names, numbers)

    @property
    def material_pairs(self) -> dict[tuple[str, str], dict[str, float]]:
        """What `set_material_pair` has said, by the two names in alphabetical order; a copy."""
        return {(a, b): pair_of(numbers) for a, b, numbers in self._native.material_pairs()}

    def fixtures(self, body: int) -> tuple[Fixture, ...]:
        """What a body is made of.

        Parameters
        ----------
        body : int
            Its id.

        Returns
        -------
        tuple of Fixture
            In the frame of the body, which is at its position and turned by its rotation.

        Raises
        ------
        IndexError
            If there is no such body.
        """
        return self._made[self._row("body", body)][0]

    def make_colliders(self, ids: ArrayLike | None = None) -> list[BodyCollider]:
        """Make obstacles of another simulation that represent bodies, one for each shape.

        Parameters
        ----------
        ids : int or array_like of int, shape (m,), optional
            Of which bodies; all unless given.

        Returns
        -------
        list of BodyCollider
            Where the bodies are now, with the friction and the restitution of their shapes. Give
            them to one simulation, among its `colliders`, and put both into a `World`; call this
            again for another simulation.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong, or a shape cannot be an obstacle.

        Examples
        --------
        >>> import substep
        >>> bodies = substep.RigidBodies()
        >>> ball = bodies.add(substep.Sphere(0.2), (0.5, 0.5, 0.6), density=300.0)
        >>> bodies.make_colliders(ball)
        [BodyCollider(Sphere(radius=0.2), body=0)]
        """
        return colliders_of(self, ids)

    def diagnostics(self) -> dict[str, float]:
        """Energies and momenta of the dynamic bodies, and figures of the last step.

        Returns
        -------
        dict of str to float
            `count`, of bodies; `kinetic_energy`, `gravitational_energy` (0 at the origin) and
            `energy`, their sum [J];
            `momentum_x`, `_y`, `_z` [N s]; `angular_momentum_x`, `_y`, `_z` about the origin
            [N m s]; of the last step `contacts`, `penetration`, the deepest [m], `impacts` with
            restitution; `awake`, the dynamic bodies that do not sleep; `joint_error`, the greatest
            distance or angle by which a joint is off [m or rad].
        """
        values: dict[str, float] = self._native.diagnostics()
        return with_energy(rename(values))

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays for recording, with their units.

        Returns
        -------
        dict of str to (ndarray, str)
            `position` and `orientation`, which are `positions` and `rotations`; `velocity` of the
            centres of mass, `angular_velocity`, `id` and `asleep`; read-only.
        """
        return {
            "position": (self.positions, "m"),
            "orientation": (self.rotations, "1"),
            "velocity": (self.velocities, "m/s"),
            "angular_velocity": (self.angular_velocities, "rad/s"),
            "id": (self.ids, "1"),
            "asleep": (self._native.asleep(), "1"),
        }
