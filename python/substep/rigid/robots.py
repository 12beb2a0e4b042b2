"""Robots from files (MJCF, URDF): worlds of rigid bodies whose bodies and joints have names."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.checks import check_choice, describe
from ..errors import InputError
from .fixtures import STILL, Made, check_fixtures, check_mass, native_rows
from .joint import Joint
from .joints import Joints
from .mjcf import Plan, element, read_plan
from .rows import principal_frames

if TYPE_CHECKING:
    from typing_extensions import Self

_COORDINATE = -9  # in a row of joints of a state, as cpp/bindings/rigid_state.cpp writes it


class Robots(Joints):
    """A world that may come from a file; make `RigidBodies`."""

    _body_names: Mapping[str, int] = {}
    _joint_names: Mapping[str, int] = {}
    _strengths: Mapping[str, float] = {}
    _ignored: tuple[str, ...] = ()

    @classmethod
    def from_mjcf(
        cls,
        path: str | os.PathLike[str],
        *,
        keyframe: str | None = None,
        coordinates: Mapping[str, float] | None = None,
        gravity: ArrayLike | None = None,
        step: float = 1 / 60,
        substeps: int = 8,
        rotation: str = "splitting",
        sleeping: bool = True,
        continuous: bool = True,
        contact_margin: float = 0.02,
        time: float = 0.0,
        threads: int | None = None,
    ) -> Self:
        """Make the bodies and joints of an MJCF file, the format of MuJoCo.

        docs/rigid_robots.md says what of a file becomes what. Joints have the coordinate 0 where
        the file has them (at `ref`); servos of positions hold them where they start.

        Parameters
        ----------
        path : path-like
            The file; its includes and meshes are beside it.
        keyframe : str, optional
            Start at the positions and controls of this keyframe.
        coordinates : dict of str to float, optional
            Where hinges and sliders start, by name [rad] or [m].
        gravity : array_like, shape (3,), optional
            Acceleration [m/s^2]; that of the file unless given.
        step, substeps, rotation, sleeping, continuous, contact_margin, time, threads
            As for `RigidBodies`.

        Returns
        -------
        RigidBodies
            The world, which has names: `body`, `joint`, `ignored`.

        Raises
        ------
        FormatError
            If it is no MJCF file, MuJoCo refuses it, or it has height fields, signed distance
            fields or deformable bodies.
        ImportError
            If mujoco is missing.
        InputError
            If an argument is wrong, or a number of the file, with its element.
        OSError
            If the file cannot be read.

        Examples
        --------
        >>> import pathlib, substep
        >>> text = '''<mujoco><worldbody><body name="bob"><joint name="pin" axis="0 1 0"/>
        ...     <geom size=".05" pos=".5 0 0" mass="1"/></body></worldbody></mujoco>'''
        >>> _ = pathlib.Path("pendulum.xml").write_text(text)
        >>> pendulum = substep.RigidBodies.from_mjcf("pendulum.xml")
        >>> pendulum.advance(0.3)
        >>> round(pendulum.joint("pin").coordinate, 2), pendulum.ignored
        (0.86, ())
        """
        plan = read_plan(path, "mujoco", keyframe=keyframe, coordinates=coordinates)
        return cls._built(
            plan,
            gravity=plan.gravity if gravity is None else gravity,
            step=step,
            substeps=substeps,
            rotation=rotation,
            sleeping=sleeping,
            continuous=continuous,
            contact_margin=contact_margin,
            time=time,
            threads=threads,
        )

    @classmethod
    def from_urdf(
        cls,
        path: str | os.PathLike[str],
        *,
        free_base: bool = False,
        coordinates: Mapping[str, float] | None = None,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        step: float = 1 / 60,
        substeps: int = 8,
        rotation: str = "splitting",
        sleeping: bool = True,
        continuous: bool = True,
        contact_margin: float = 0.02,
        time: float = 0.0,
        threads: int | None = None,
    ) -> Self:
        """Make the bodies and joints of a URDF file, the format of ROS.

        As `from_mjcf`; shapes for collisions only. Links that are fixed to each other are one body,
        which has all of their names.

        Parameters
        ----------
        path : path-like
            The file; its meshes beside it.
        free_base : bool, optional
            Whether the root link is free to move, rather than fixed to the world.
        coordinates : dict of str to float, optional
            Where hinges and sliders start, by name [rad] or [m].
        gravity : array_like, shape (3,), optional
            Acceleration [m/s^2].
        step, substeps, rotation, sleeping, continuous, contact_margin, time, threads
            As for `RigidBodies`.

        Returns
        -------
        RigidBodies
            The world, which has names: `body`, `joint`, `ignored`.

        Raises
        ------
        FormatError
            If it is no URDF file, or MuJoCo, which reads it, refuses it.
        ImportError
            If mujoco is missing.
        InputError
            If an argument is wrong, or a number of the file, with its element.
        OSError
            If the file cannot be read.

        Examples
        --------
        >>> import pathlib, substep
        >>> text = '''<robot name="rod"><link name="rod"><inertial><mass value="2"/><inertia
        ...     ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="0.1"/></inertial></link></robot>'''
        >>> _ = pathlib.Path("rod.urdf").write_text(text)
        >>> rod = substep.RigidBodies.from_urdf("rod.urdf", free_base=True)
        >>> float(rod.masses[rod.body("rod")])
        2.0
        """
        plan = read_plan(path, "robot", free_base=free_base, coordinates=coordinates)
        return cls._built(
            plan,
            gravity=gravity,
            step=step,
            substeps=substeps,
            rotation=rotation,
            sleeping=sleeping,
            continuous=continuous,
            contact_margin=contact_margin,
            time=time,
            threads=threads,
        )

    @classmethod
    def _built(cls, plan: Plan, **options: Any) -> Self:
        make: Any = cls
        world: Any = make(**options)
        _add_bodies(world, plan)
        ids = world._ids.tolist()
        made = []
        for link in plan.links:
            join = getattr(world, link.kind)
            b = None if link.b is None else ids[link.b]
            given: dict[str, Any] = {"collide": link.collide}
            if link.kind in ("hinge", "slider"):
                given |= {"axis": link.axis, "limits": link.limits, "motor": link.motor}
            with element(plan.file, link.name):
                made.append(join(ids[link.a], b, link.anchor, **given))
        for one, other, surface in plan.pairs:
            world.set_material_pair(one, other, **surface)
        for i, j in plan.excluded:
            world.exclude(ids[i], ids[j])
        if ids:
            world.set_positions(np.array([body.start[0] for body in plan.bodies]))
            world.set_rotations(np.array([body.start[1] for body in plan.bodies]))
            state = world.state()
            for row, link in zip(state["joints"], plan.links, strict=True):
                if link.kind in ("hinge", "slider"):
                    row[_COORDINATE] = link.start
            world.restore(state)
        world._body_names = {name: ids[k] for name, k in plan.body_names.items()}
        world._joint_names = {name: made[k].number for name, k in plan.link_names.items()}
        world._strengths, world._ignored = plan.strengths, plan.ignored
        made_one: Self = world
        return made_one

    def body(self, name: str) -> int:
        """The id of a body of the file that the world was made from.

        Parameters
        ----------
        name : str
            As in the file; one that has none there is called ``"body_3"``, by its number, or
            ``"body_3_"`` where another has that name.

        Returns
        -------
        int
            The id of the body that it is, or that it is fixed to.

        Raises
        ------
        InputError
            If the file has no such body.
        IndexError
            If it was removed.
        """
        number = self._body_names[_known("bodies", name, self._body_names)]
        self._row("name", number)
        return number

    def joint(self, name: str) -> Joint:
        """A joint of the file that the world was made from.

        Parameters
        ----------
        name : str
            As in the file; one that has none there is called ``"joint_3"``, by its number, or
            ``"joint_3_"`` where another has that name.

        Returns
        -------
        Joint
            The joint.

        Raises
        ------
        InputError
            If the file has no such joint; a free joint is none.
        IndexError
            If it was removed.
        """
        joint = Joint(self, self._joint_names[_known("joints", name, self._joint_names)])
        joint._row()
        return joint

    @property
    def body_names(self) -> tuple[str, ...]:
        """What `body` knows, in the order of the file."""
        return tuple(self._body_names)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """What `joint` knows, in the order of the file."""
        return tuple(self._joint_names)

    @property
    def strengths(self) -> dict[str, float]:
        """Largest torque [N m] or force [N] that the file lets drive each hinge and slider.

        By name; infinite where it says none. A copy.
        """
        return dict(self._strengths)

    @property
    def ignored(self) -> tuple[str, ...]:
        """What the file has and the world has not, or has otherwise: one sentence for each kind."""
        return self._ignored


def _add_bodies(world: Any, plan: Plan) -> None:
    """Put in the bodies, as `add` does one by one, with the arrays of all at once."""
    made: list[Made] = []
    for body in plan.bodies:
        with element(plan.file, body.name):
            fixtures = check_fixtures(body.fixtures, {}, body.motion)
            weight = check_mass(fixtures, body.mass, None) if body.motion == "dynamic" else None
        made.append((fixtures, body.motion, weight))
    if not made:
        return
    frames = [STILL if weight is None else weight for *_, weight in made]
    centres = np.array([frame.center_of_mass for frame in frames])
    axes = np.array([frame.axes for frame in frames])
    own = np.array([[frame.mass, *frame.principal_inertia] for frame in frames])
    own[[weight is None for *_, weight in made]] = np.nan
    places, turns = (np.array([body.pose[k] for body in plan.bodies]) for k in (0, 1))
    x, q = principal_frames(places, turns, centres, axes)
    still = np.zeros((1, 3))
    for k, (body, kind) in enumerate(zip(plan.bodies, made, strict=True)):
        with element(plan.file, body.name):
            world._native.add(*native_rows({}, kind, x[k : k + 1], q[k : k + 1], still, still))
    world.__dict__.update(world._grown(made, centres, axes, own))


def _known(what: str, name: str, names: Mapping[str, int]) -> str:
    """One of the names that the file gave."""
    if not names:
        raise InputError(
            f"name: expected that of one of the {what} of a file, but this world has none with "
            f"names, which from_mjcf and from_urdf give; got {describe(name)}"
        )
    return check_choice("name", name, names)
