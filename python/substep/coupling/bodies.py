"""Rigid bodies behind the obstacles of another simulation: how they yield, and what they are given.

A body of mass m, moments I about its centre of mass and velocity V = (v, omega) answers an impulse
J = (j, l) by V + W J, W = diag(1 / m, I^-1): its mobility, of which joints, and motors that are
strong enough in step 1 below, take what they hold (rigid/solver/mobility.h). In an interval of
exchange dt
1. the bodies try the interval with the impulses J' of the last one, which gives V';
2. the simulation advances with bodies that move by V + a t + W J, a dt = V' - V - W J', where J is
   what it pushes them by itself: what holds and carries them is in a, what it changes in W J;
3. the bodies take the interval with J; those that nothing but gravity and J moved then go where
   their obstacles went: in that member's steps J was not even over the interval, and an obstacle
   that is put back by h dV / 2 may be deep in what it met.
Where contacts, ropes or ends of joints take more than half of what J' does, W is what they leave;
where J would lift the body off them, the interval is taken again with all of W. What springs and
motors take is no support: they pull as well, and are in W.
Where J' = J that is the motion of the bodies under J, contacts and joints and all, whatever W is;
where it is not, W is how it begins to differ. A body that nothing else touches moves by its
mobility alone, so that the exchange is exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import _core
from ..base.quaternions import cross, multiply, rotate
from ..base.start_warning import warn_at_user
from ..errors import InputError
from ..geometry.shapes import Solid

if TYPE_CHECKING:
    from ..base.simulation import Simulation
    from ..rigid import RigidBodies

SPARED = 0.5  # of the strength of a motor: it keeps its speed while it needs less
_HELD = 0.5  # of what impulses do to a body alone: it is held where supports take more

Array = NDArray[np.float64]
Ids = NDArray[np.int64]


def velocities_of(bodies: RigidBodies, rows: Ids) -> Array:
    """Rows (v of the centre of mass, omega)."""
    return np.concatenate([bodies.velocities[rows], bodies.angular_velocities[rows]], axis=1)


class Link:
    """The obstacles of one simulation that stand for bodies.

    Parameters
    ----------
    name : str
        Of the simulation.
    member : Simulation
        That has the obstacles.
    places : list of tuple
        Of each: which of the colliders it is, the id of its body, and where its shape is there.
    """

    def __init__(
        self, name: str, member: Simulation, places: Sequence[tuple[int, int, Array, Array]]
    ) -> None:
        self.name, self.places = name, list(places)
        self._member: Any = member
        self._obstacles = [member.colliders[place[0]] for place in places]
        self._pushes = member._pushes_bodies
        self._in_plane = getattr(member, "positions", np.empty((0, 3))).shape[1] == 2
        self.colliders = [collider._native for collider in self._obstacles]
        ids = np.array([place[1] for place in places], np.int64)
        # The bodies, an obstacle of each, and the body of each obstacle.
        self.ids, self._first, self.of = np.unique(ids, return_index=True, return_inverse=True)
        self._x = np.array([place[2] for place in places])
        self._q = np.array([place[3] for place in places])

    def rows(self, bodies: RigidBodies) -> Ids:
        """Of the bodies, now."""
        known = bodies.ids
        rows = np.searchsorted(known, self.ids)
        gone = known[np.minimum(rows, len(known) - 1)] != self.ids if len(known) else rows == 0
        if gone.any():
            body = int(self.ids[np.argmax(gone)])
            raise InputError(
                f"body {body}, which an obstacle of {self.name!r} stands for, has been removed"
            )
        yields = np.isfinite(bodies.masses[rows])
        if not self._pushes and yields.any():
            raise InputError(
                f"body {int(self.ids[np.argmax(yields)])}: {self.name!r} has no way to push "
                "dynamic bodies; make it kinematic"
            )
        if self._in_plane and bodies.gravity[2] != 0 and yields.any():
            raise InputError(
                f"gravity of the bodies: expected none along z, as {self.name!r} has two "
                f"dimensions, got {tuple(map(float, bodies.gravity))}"
            )
        return rows

    def warn_of_small(self, bodies: RigidBodies) -> None:
        """Warns of dynamic bodies that are too few cells across for the grid of the member."""
        fewest = self._member._fewest_cells
        if fewest == 0:
            return
        cell = self._member.cell
        rows = self.rows(bodies)
        for k in np.flatnonzero(np.isfinite(bodies.masses[rows])):
            shapes = [c.shape for c, of in zip(self._obstacles, self.of, strict=True) if of == k]
            if not all(isinstance(shape, Solid) for shape in shapes):
                continue
            x = np.concatenate([shape.mesh().vertices for shape in shapes])
            if self._in_plane:
                x = rotate(bodies.rotations[rows[k]], x)[:, :2]
            size = float(np.ptp(x, axis=0).max())
            if size < fewest * cell * (1 - 1e-9):
                warn_at_user(
                    f"members: body {self.ids[k]} is {size:.3g} m across, {size / cell:.2g} cells "
                    f"of {self.name!r}, each of {cell:.3g} m: below {fewest:g} the grid hardly "
                    f"sees it, and it may fall through; take cell={size / fewest:.2g} or less, or "
                    "a larger body"
                )
                return

    def place(
        self, bodies: RigidBodies, rows: Ids, velocities: Array, W: Array, accelerations: Array
    ) -> None:
        """Put the obstacles where the bodies are, with the velocities of these."""
        of = self.of
        q = bodies.rotations[rows][of]
        x = bodies.positions[rows][of] + rotate(q, self._x)
        q = multiply(q, self._q)
        back = q * (1.0, -1.0, -1.0, -1.0)
        centres = rotate(back, bodies.centers_of_mass[rows][of] - x)
        self._placed = q, centres
        yields = np.isfinite(bodies.masses[rows])
        _core.place_bodies(
            self.colliders,
            np.where(yields, np.arange(len(rows)), -1)[of].tolist(),
            np.concatenate([x, q], axis=1),
            velocities[of],
            centres,
            W[of].reshape(len(of), 36),
            accelerations[of],
        )

    def strays(self, x: Array, velocities: Array, dt: float) -> Array:
        """How much further than under constant forces they went since `place` [m], [rad]."""
        first = self._first
        state = _core.collider_states([self.colliders[k] for k in first])
        q0, centres = self._placed[0][first], self._placed[1][first]
        arm = rotate(state[:, 3:7], centres)
        turn = multiply(state[:, 3:7], q0 * (1.0, -1.0, -1.0, -1.0))
        turn *= np.where(turn[:, :1] < 0, -1.0, 1.0)
        sine = np.linalg.norm(turn[:, 1:], axis=1, keepdims=True)
        angle = 2 * np.arctan2(sine, turn[:, :1])
        turned = turn[:, 1:] * np.divide(angle, sine, out=np.full_like(sine, 2.0), where=sine > 0)
        went = np.concatenate([state[:, :3] + arm - x, turned], axis=1)
        spin = state[:, 10:13]
        end = np.concatenate([state[:, 7:10] + cross(spin, arm), spin], axis=1)
        return went - dt * (velocities + end) / 2

    def release(self) -> None:
        """Let the obstacles move as they are told: alone, a member has no bodies."""
        _core.release_bodies(self.colliders)

    def impulses(self) -> Array:
        """What the bodies were given since `place` [N s], [N m s], a row for each."""
        given = np.zeros((len(self.ids), 6))
        np.add.at(given, self.of, _core.impulses_of_bodies(self.colliders))
        return given


def give(bodies: RigidBodies, rows: Ids, impulses: Array, dt: float) -> None:
    """Let the bodies take these impulses over the next step, of dt."""
    native: Any = bodies._native
    with np.errstate(over="ignore"):  # the step refuses what is not finite
        np.add.at(native.forces, rows, impulses[:, :3] / dt)
        np.add.at(native.torques, rows, impulses[:, 3:] / dt)


@dataclass
class Supports:
    """What held bodies against the last impulses J': contacts, ropes, ends of joints.

    One that changed the velocity of a body by R = W p, and took by that more than half of what J'
    does, W J', holds it along p, which leaves the mobility W - R R^T / (R . p). It pushes but does
    not pull: other impulses J release the body where 1 - R . (J - J') / (R . p) < 0.
    """

    rows: list[int]
    reactions: list[Array]  # R
    powers: list[float]  # R . p

    def released(self, more: Array) -> set[int]:
        """Bodies that their supports would have to pull under so much more than J'."""
        found = zip(self.rows, self.reactions, self.powers, strict=True)
        return {k for k, R, power in found if R @ more[k] > power}


def find_supports(
    W: Array, candidates: NDArray[np.bool_], reactions: Array, impulses: Array
) -> Supports:
    """Take from mobilities what supports hold, in place."""
    supports = Supports([], [], [])
    does = np.einsum("ki,kij,kj->k", impulses, W, impulses)
    taken = -np.einsum("ki,ki->k", impulses, reactions)
    for k in np.flatnonzero(candidates & (does > 0) & (taken > _HELD * does)).tolist():
        p = np.linalg.pinv(W[k], rcond=1e-9, hermitian=True) @ reactions[k]
        R = W[k] @ p  # without what joints hold
        if not R @ p > 0:
            continue
        W[k] -= np.outer(R, R) / (R @ p)
        supports.rows.append(k)
        supports.reactions.append(R)
        supports.powers.append(R @ p)
    return supports


def move(bodies: RigidBodies, shifts: Array) -> None:
    """Put bodies elsewhere by rows of (shift of the centre of mass, turn)."""
    rows = np.flatnonzero(shifts.any(axis=1))
    half = shifts[rows, 3:] / 2
    angle = np.linalg.norm(half, axis=1, keepdims=True)
    turn = np.concatenate([np.cos(angle), half * np.sinc(angle / np.pi)], axis=1)
    bodies.centers_of_mass[rows] += shifts[rows, :3]
    bodies.principal_rotations[rows] = multiply(turn, bodies.principal_rotations[rows])
