"""Obstacles that go from place to place at given times."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.attributes import Frozen
from ..base.checks import check_array, check_callable, check_real, check_sequence, describe
from ..base.quaternions import multiply, unit_quaternions
from ..errors import InputError
from .colliders import Collider

Array = NDArray[np.float64]

_SLACK = 1e-9  # of a time: times of simulations are sums of steps


class Keyframes(Frozen):
    """Places and rotations at given times, between which an obstacle moves evenly.

    Between two keyframes velocity and angular velocity are constant; rotations go the shorter way,
    so that a turn by more than half a circle needs a keyframe in between. After the last keyframe
    the obstacle is at rest.

    Parameters
    ----------
    times : array_like, shape (n,)
        Ascending, the first 0, apart by more than 2e-9 max(1, t), which is what times of
        simulations, sums of steps, are told apart by [s].
    positions : array_like, shape (n, 3)
        Where the obstacle's `position` is then [m].
    rotations : array_like, shape (n, 4), optional
        Its `rotation` then, unit quaternions (w, x, y, z); it does not turn unless given.

    Raises
    ------
    InputError
        If the times do not ascend from 0 or are too near to each other, the lengths differ, or a
        number is not finite.

    See Also
    --------
    follow_keyframes : Advances a simulation whose obstacles move so.

    Examples
    --------
    >>> import substep
    >>> lift = substep.geometry.Keyframes([0, 1, 3], [(0, 0, 0), (0, 0, 0.5), (0, 0, 0)])
    >>> lift.at(2.0)[0].tolist()
    [0.0, 0.0, 0.25]
    """

    times: Array
    positions: Array
    rotations: Array | None

    def __init__(
        self, times: ArrayLike, positions: ArrayLike, rotations: ArrayLike | None = None
    ) -> None:
        t = check_times(times)
        n = len(t)
        x = check_array("positions", positions, (n, 3))
        q = None
        if rotations is not None:
            q = unit_quaternions("rotations", rotations, (n, 4))
        self.times, self.positions, self.rotations = t, x, q

    def at(self, time: float) -> tuple[Array, Array | None]:
        """Place and rotation at a time.

        Parameters
        ----------
        time : float
            When [s].

        Returns
        -------
        position : ndarray, shape (3,)
            Where [m].
        rotation : ndarray, shape (4,), or None
            Unit quaternion; None if there are none.
        """
        t = min(max(check_real("time", time), 0.0), float(self.times[-1]))
        k = max(int(np.searchsorted(self.times, t)) - 1, 0)
        if len(self.times) == 1:
            return self.positions[0], None if self.rotations is None else self.rotations[0]
        part = (t - self.times[k]) / (self.times[k + 1] - self.times[k])
        x = (1 - part) * self.positions[k] + part * self.positions[k + 1]
        if self.rotations is None:
            return x, None
        turn = part * _turn(self.rotations[k], self.rotations[k + 1])
        return x, multiply(_quaternion(turn), self.rotations[k])

    def next(self, time: float) -> float:
        """The first keyframe after a time, or infinity.

        Parameters
        ----------
        time : float
            When [s].

        Returns
        -------
        float
            Its time [s].
        """
        time = check_real("time", time)
        after = self.times[self.times > time + _SLACK * max(1.0, abs(time))]
        return float(after[0]) if len(after) else math.inf

    def guide(self, collider: Collider, time: float) -> None:
        """Give an obstacle the velocities that bring it to the next keyframe in time.

        Parameters
        ----------
        collider : Collider
            The obstacle.
        time : float
            Now [s].
        """
        end = self.next(time)
        velocity, spin = np.zeros(3), np.zeros(3)
        if end < math.inf:
            k = int(np.searchsorted(self.times, end))
            velocity = (self.positions[k] - collider.position) / (end - time)
            if self.rotations is not None:
                spin = _turn(collider.rotation, self.rotations[k]) / (end - time)
        collider.velocity = velocity
        if self.rotations is not None:
            collider.angular_velocity = spin


def check_times(times: ArrayLike) -> Array:
    """Those of frames: ascending from 0, and not too near to each other."""
    t: Array = check_array("times", times, (None,))
    if len(t) == 0 or t[0] != 0 or not (np.diff(t) > 2 * _SLACK * np.maximum(1.0, t[1:])).all():
        raise InputError(
            "times: expected ascending ones from 0, apart by more than 2e-9 max(1, t), "
            f"got {t[:8].tolist()}"
        )
    return t


def _turn(start: Array, end: Array) -> Array:
    """Axis times angle of the shorter turn from one rotation to another [rad], in the world."""
    w, *v = multiply(end, start * [1.0, -1.0, -1.0, -1.0])
    axis, sign = np.array(v), -1.0 if w < 0 else 1.0
    sine = float(np.linalg.norm(axis))
    return sign * axis * (2 * math.atan2(sine, abs(w)) / sine if sine > 0 else 0.0)


def _quaternion(turn: Array) -> Array:
    angle = float(np.linalg.norm(turn))
    axis = turn * (math.sin(angle / 2) / angle if angle > 0 else 0.5)
    return np.array([math.cos(angle / 2), *axis])


def follow_keyframes(
    simulation: Any,
    duration: float,
    paths: Sequence[tuple[Collider, Keyframes]],
    callback: Callable[[Any], object] | None = None,
) -> None:
    """Advance a simulation whose obstacles move along keyframes.

    Obstacles are made where their first keyframes are. No step goes across a keyframe. `impulse`
    and `duration` of the obstacles are those since the last keyframe.

    Parameters
    ----------
    simulation : simulation or World
        What has a `time` and can `advance`.
    duration : float
        How long [s], at least 0.
    paths : sequence of (Collider, Keyframes)
        Each obstacle of the simulation that moves, and how.
    callback : callable, optional
        As for `advance`.

    Raises
    ------
    TypeError
        If a path is not such a pair.
    InputError
        If the duration is wrong, an obstacle is not of the simulation or has two paths, or at time
        0 it is not at the place and the rotation where its path begins.
    SolverError
        As `advance` does.

    Examples
    --------
    >>> import substep
    >>> from substep.geometry import Keyframes, follow_keyframes
    >>> plate = substep.Collider(substep.Box((1, 1, 0.1)))
    >>> water = substep.PositionBasedFluid([[0, 0, 0.2]], 0.05, colliders=[plate])
    >>> follow_keyframes(water, 0.5, [(plate, Keyframes([0, 1], [(0, 0, 0), (0, 0, -1)]))])
    >>> plate.position.round(6).tolist()
    [0.0, 0.0, -0.5]
    """
    length = check_real("duration", duration, nonnegative=True)
    pairs = check_sequence("paths", paths, "pairs of a Collider and Keyframes")
    for pair in pairs:
        if not (
            isinstance(pair, tuple)
            and len(pair) == 2
            and isinstance(pair[0], Collider)
            and isinstance(pair[1], Keyframes)
        ):
            raise TypeError(f"paths: expected a Collider and Keyframes, got {describe(pair)}")
    if callback is not None:
        check_callable("callback", callback)
    members = getattr(simulation, "members", {"": simulation}).values()
    own = [one for member in members for one in getattr(member, "colliders", ())]
    for k, (collider, _) in enumerate(pairs):
        if not any(collider is one for one in own):
            raise InputError(f"paths[{k}]: expected an obstacle of the simulation")
        if any(collider is one for one, _ in pairs[:k]):
            raise InputError(f"paths[{k}]: its obstacle has a path already")
    if simulation.time == 0:
        for k, (collider, path) in enumerate(pairs):
            if not np.allclose(collider.position, path.positions[0], rtol=0, atol=1e-9):
                raise InputError(
                    f"paths[{k}]: expected an obstacle at its first keyframe, "
                    f"{path.positions[0].tolist()}, got one at {collider.position.tolist()}"
                )
            start = None if path.rotations is None else path.rotations[0]
            if start is not None and np.linalg.norm(_turn(collider.rotation, start)) > 1e-9:
                raise InputError(
                    f"paths[{k}]: expected an obstacle turned as in its first keyframe, "
                    f"{start.tolist()}, got one at {collider.rotation.tolist()}"
                )
    end = simulation.time + length
    while True:
        now = simulation.time
        for collider, path in pairs:
            path.guide(collider, now)
        until = min([end, *(path.next(now) for _, path in pairs)])
        if until >= end - _SLACK * max(1.0, abs(end)):
            simulation.advance(max(end - now, 0.0), callback)
            return
        simulation.advance(until - now, callback)
