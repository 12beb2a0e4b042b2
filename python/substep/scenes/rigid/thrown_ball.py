"""Solids that stand until a ball is thrown at them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...geometry import Sphere
from ..declaration import Parameter
from .rigid_bodies import Solids

Array = NDArray[np.float64]

FLIGHT = 1.2  # of the ball at most, from outside of the picture [s]


def ball_parameters(speed: float, radius: float) -> dict[str, Parameter]:
    """Parameters of the ball.

    Parameters
    ----------
    speed, radius : float
        Their defaults [m/s], [m].

    Returns
    -------
    dict of str to Parameter
        By key.
    """
    return {
        "stand": Parameter("time until the ball is thrown", 2.5, unit="s", above=0),
        "speed": Parameter("speed of the ball, 0 for none", speed, unit="m/s", minimum=0),
        "radius": Parameter("radius of the ball", radius, unit="m", above=0),
    }


def time_of_flight(speed: float, far: float = math.inf) -> float:
    """Of the ball, until it hits.

    Parameters
    ----------
    speed : float
        Across the ground [m/s], above 0.
    far : float
        It comes from no farther away [m].

    Returns
    -------
    float
        In seconds.
    """
    return min(FLIGHT, far / speed)


class Target(Solids):
    """Solids that stand for a while, which is measured, until a ball hits them.

    Parameters
    ----------
    parameters : mapping
        Of the scene, with those of `rigid_parameters` and `ball_parameters`.
    """

    what = "boxes"
    boxes: NDArray[np.int64]
    direction: Array
    start: Array
    fall: float
    flight: float
    thrown: NDArray[np.int64] | None

    def __init__(self, parameters: Mapping[str, Any]) -> None:
        super().__init__(parameters)
        self.stand, self.speed = parameters["stand"], parameters["speed"]
        self.radius = parameters["radius"]
        self.measured = {"drift": np.zeros(1), "sinking": np.zeros(1)}

    def build(
        self,
        boxes: NDArray[np.int64],
        direction: ArrayLike,
        height: float,
        fall: float | None = None,
        far: float = math.inf,
    ) -> None:
        """Remember where the boxes are, and hold a ball ready, outside of the picture.

        Parameters
        ----------
        boxes : ndarray of int64, shape (n,)
            Their ids.
        direction : array_like, shape (3,)
            In which the ball will fly; is normalised.
        height : float
            At which it will hit [m].
        fall : float, optional
            By which what was brought down is lower [m]; the height of the first box's middle
            unless given.
        far : float
            The ball comes from no farther away [m].
        """
        self.boxes = boxes
        self.direction = np.asarray(direction, float) / np.linalg.norm(direction)
        self.start = self.positions[boxes]
        self.fall = self.start[0, 2] if fall is None else fall
        self.thrown = None
        if self.speed > 0:
            self.flight = time_of_flight(self.speed, far)
            x = [0, 0, height] - self.flight * self.speed * self.direction
            self.thrown = self.put("ball", Sphere(self.radius), x, segments=64, density=2000.0)
            self.set_motion("kinematic", self.thrown)

    def after_step(self) -> None:
        """Measure how far boxes have moved, until the ball is thrown."""
        if self.thrown is not None and not self._is_held():
            return
        moved = self.positions[self.boxes] - self.start
        self.measured["drift"][0] = np.hypot(moved[:, 0], moved[:, 1]).max()
        self.measured["sinking"][0] = -moved[:, 2].min()
        if self.thrown is not None and self.time >= self.stand:
            up = -0.5 * self.flight * self.gravity  # as high as now when it hits
            self.set_motion("dynamic", self.thrown)
            self.set_velocities(self.speed * self.direction + up, ids=self.thrown)

    def _is_held(self) -> bool:
        assert self.thrown is not None
        return bool(self.motions[self.rows(self.thrown[0])] == "kinematic")

    def words(self) -> str:
        """How the boxes stood."""
        drift, sinking = (float(self.measured[name][0]) for name in ("drift", "sinking"))
        time = self.time if self.thrown is None else min(self.time, self.stand)
        moved = f"drift of the {self.what} {drift:.2g} m, sinking {1e3 * sinking:.2g} mm"
        text = f"after {time:g} s, {moved}"
        if self.thrown is not None and self.time > self.stand:
            fallen = self.start[:, 2] - self.positions[self.boxes, 2] > self.fall
            text += f"; the ball brought {int(fallen.sum())} of {len(self.boxes)} down"
        return text
