"""Dominoes in a spiral fall, each over the next."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...base.quaternions import multiply, rotate
from ...geometry import Box
from ...view import Camera
from ..declaration import Parameter, Scene
from .rigid_bodies import Solids, rigid_parameters, solids_view

if TYPE_CHECKING:
    from ...recording import Recording

Array = NDArray[np.float64]

INNER, ARMS = 1.6, 1.35  # radius where a spiral begins, and the distance of its arms, in heights
FALLEN = np.cos(np.radians(30.0))  # a domino falls when it leans by more
SPREAD = 10  # the speed is measured between dominoes so far from either end


def _spiral(lengths: Array, height: float) -> tuple[Array, Array]:
    """Points at lengths along a spiral of Archimedes, and the directions in which it goes there.

    r = r0 + b a at the angle a, of which the length is the integral of sqrt(r^2 + b^2).
    """
    r0, b = INNER * height, ARMS * height / (2 * np.pi)
    end = (np.sqrt(r0**2 + 2 * b * (lengths[-1] + height)) - r0) / b  # of b s < b (r0 a + b a^2/2)
    a = np.linspace(0, end, 40 * len(lengths))
    speed = np.hypot(r0 + b * a, b)
    s = np.concatenate([[0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(a))])
    angle = np.interp(lengths, s, a)
    r = r0 + b * angle
    radial = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    across = np.stack([-radial[:, 1], radial[:, 0]], axis=-1)
    way = b * radial + r[:, None] * across
    return r[:, None] * radial, np.arctan2(way[:, 1], way[:, 0])


class Dominoes(Solids):
    """Dominoes that fall over each other, and when each of them did.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    """

    def __init__(self, parameters: dict[str, Any]) -> None:
        super().__init__(parameters)
        n, self.pitch = parameters["dominoes"], parameters["pitch"]
        t, w, h = (parameters[name] for name in ("thickness", "width", "height"))
        along = self.pitch * np.arange(n)
        x, q = np.zeros((n, 3)), np.zeros((n, 4))
        if parameters["path"] == "spiral":
            x[:, :2], heading = _spiral(along, h)
        else:
            x[:, 0], heading = along, np.zeros(n)
        x[:, 2] = h / 2
        q[:, 0], q[:, 3] = np.cos(heading / 2), np.sin(heading / 2)
        # The first leans over its front foot.
        lean = parameters["lean"]
        foot = np.array([t / 2, 0, -h / 2])
        tilt = np.array([np.cos(lean / 2), 0, np.sin(lean / 2), 0])
        x[0] += rotate(q[0], foot - rotate(tilt, foot))
        q[0] = multiply(q[0], tilt)
        dye = np.linspace(0, 1, n)
        self.dominoes = self.put("dominoes", Box((t, w, h)), x, q, dye=dye)
        self.measured = {"fell": np.full(n, np.inf)}  # when [s]

    def after_step(self) -> None:
        """Note the time of those that begin to fall."""
        _, a, b, _ = self.rotations[self.rows(self.dominoes)].T
        fell = self.measured["fell"]
        fell[(1 - 2 * (a**2 + b**2) < FALLEN) & np.isinf(fell)] = self.time

    def wave_speed(self) -> float:
        """Of the wave, between dominoes that are not near an end and fell [m/s], or nan."""
        fell = self.measured["fell"]
        inner = np.flatnonzero(np.isfinite(fell[SPREAD : len(fell) - SPREAD + 1])) + SPREAD
        if len(inner) < 2:
            return np.nan
        first, last = inner[[0, -1]]
        return float(self.pitch * (last - first) / (fell[last] - fell[first]))

    def words(self) -> str:
        """How many fell, and how fast."""
        fell = int(np.isfinite(self.measured["fell"]).sum())
        speed = self.wave_speed()
        text = f"{fell} of {len(self.dominoes)} dominoes fell"
        return text if np.isnan(speed) else f"{text}; the wave went at {speed:.3g} m/s"


def _box(recording: Recording) -> Array:
    p = recording.parameters
    points = recording.frame(0)["dominoes"]["points"][:, :2]
    low, high = points.min(axis=0), points.max(axis=0)
    room = 0.3 * p["height"]
    return np.array([[*(low - room), 0], [*(high + room), p["height"]]])


SCENE = Scene(
    name="dominoes",
    doc="Dominoes in a spiral fall, each over the next.",
    parameters={
        "duration": Parameter("time simulated", 11.0, unit="s", above=0),
        "dominoes": Parameter("number of dominoes", 160, minimum=1, maximum=10_000),
        "path": Parameter("path on which they stand", "spiral", choices=("spiral", "line")),
        "height": Parameter("height of a domino", 0.25, unit="m", above=0),
        "width": Parameter("width of a domino", 0.125, unit="m", above=0),
        "thickness": Parameter("thickness of a domino", 0.03, unit="m", above=0),
        "pitch": Parameter("distance of neighbours along the path", 0.1, unit="m", above=0),
        "lean": Parameter("lean of the first at the start", 0.3, unit="rad", minimum=0, maximum=1),
        **rigid_parameters(step=1 / 240),
    },
    quick={"duration": 0.2, "dominoes": 6},
    build=lambda parameters, seed: Dominoes(parameters),
    parts=Solids.parts,
    frame=Solids.frame,
    summary=Dominoes.words,
    picture=solids_view(
        Camera(-60.0, 38.0),
        "rainbow",
        lambda recording: 0.5 * recording.parameters["height"],
        _box,
    ),
    frames=276,
)
