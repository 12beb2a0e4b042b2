"""Newton's cradle: balls that hang in a row, some of which are let go."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...geometry import Box, Capsule, Sphere, TriangleMesh
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from .rigid_bodies import Solids, joined, rigid_parameters, shifted, solids_view

if TYPE_CHECKING:
    from ...recording import Part, Recording

Array = NDArray[np.float64]

ALONG = np.array([1.0, 0, 1, 0]) / np.sqrt(2)  # turns the z axis to the x axis
TALL, BROAD = 5.0, 2.2  # height of the strings, and half their distance at the top, in radii
CLEARANCE = 1.6  # of the balls from the base, in radii


class Cradle(Solids):
    """Balls that hang by two strings each, and the speeds at their first impact.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    """

    def __init__(self, parameters: dict[str, Any]) -> None:
        super().__init__(parameters)
        n, r, lifted = parameters["balls"], parameters["radius"], parameters["lifted"]
        if lifted >= n:
            raise InputError(f"lifted: expected fewer than the {n} balls, got {lifted}")
        length = TALL * r
        top = (1 + CLEARANCE) * r + length
        x = np.zeros((n, 3))
        x[:, 0] = 2 * r * (np.arange(n) - (n - 1) / 2)
        hooks = x[:, None] + np.array([[0, -BROAD * r, top], [0, BROAD * r, top]])
        angle = np.radians(parameters["angle"]) * (np.arange(n) < lifted)
        x[:, 0] -= length * np.sin(angle)
        x[:, 2] = top - length * np.cos(angle)
        self.hooks = hooks.reshape(-1, 3)
        e = parameters["restitution"]
        dye = np.linspace(0, 1, n) if n > 1 else np.zeros(1)
        self.balls = self.put(
            "balls", Sphere(r), x, dye=dye, segments=64, friction=0.0, restitution=e, density=7800.0
        )
        for ball, center, pair in zip(self.balls, x, hooks, strict=True):
            for hook in pair:
                self.distance(int(ball), None, center, hook)
        self.obstacles["frame"] = _frame_mesh(n, r, top)
        self.radius, self.lifted = r, lifted
        self.quarter = 0.25 * 2 * np.pi * np.sqrt(length / 9.81)
        # Speed of the first ball before it hits; of the last one after, and the others' then.
        self.measured = {name: np.zeros(1) for name in ("first", "last", "others")}
        self.energy_at_start = self._energy()

    def _energy(self) -> float:
        """Above that of the balls at their lowest [J]."""
        values = self.diagnostics()
        lowest = float((self.masses[self.balls] * 9.81).sum()) * (1 + CLEARANCE) * self.radius
        return values["energy"] - lowest

    def after_step(self) -> None:
        """Note the speeds of the first half of a swing."""
        if self.time > 2.5 * self.quarter:
            return
        speeds = np.linalg.norm(self.velocities[self.rows(self.balls)], axis=1)
        first, last, others = self.measured.values()
        first[0] = max(first[0], speeds[0])
        if speeds[-1] > last[0]:
            last[0], others[0] = speeds[-1], speeds[: -self.lifted].max(initial=0.0)

    def words(self) -> str:
        """What the first impact did, and what is left of the energy."""
        first, last, others = (float(values[0]) for values in self.measured.values())
        left = 100 * self._energy() / self.energy_at_start
        text = f"after {self.time:g} s, {left:.4g} % of the energy is left"
        if first == 0 or last == 0:
            return text
        return (
            f"the last ball left at {last / first:.4f} of the speed of the first, the balls at "
            f"rest moved at most at {others / first:.2g} of it; {text}"
        )


def _frame_mesh(n: int, r: float, top: float) -> TriangleMesh:
    """A base, and two rails on posts."""
    half, broad, thick = n * r + 1.2 * r, BROAD * r, 0.16 * r
    parts = [shifted(Box((2 * (half + r), 2 * (broad + r), 0.4 * r)).mesh(), (0, 0, 0.2 * r))]
    for y in (-broad, broad):
        rail = Capsule(thick, 2 * half).mesh(24)
        parts.append(shifted(rail, (0, y, top), ALONG))
        post = Capsule(thick, top).mesh(24)
        parts += [shifted(post, (x, y, top / 2)) for x in (-half, half)]
    return joined(parts)


def _parts(cradle: Cradle) -> dict[str, Part]:
    from ...recording import Part

    number = np.arange(len(cradle.hooks))
    strings = np.stack([number, len(number) + number], axis=-1)
    return {**Solids.parts(cradle), "strings": Part("mesh", edges=strings)}


def _frame(cradle: Cradle) -> dict[str, dict[str, Any]]:
    frame = Solids.frame(cradle)
    ends = np.repeat(frame["bodies"]["points"], 2, axis=0)
    points = np.vstack([cradle.hooks, ends]).astype(np.float32)
    return {**frame, "strings": {"points": points}}


def _box(recording: Recording) -> Array:
    p = recording.parameters
    r, n = p["radius"], p["balls"]
    half = n * r + max(2.4 * r, TALL * r * np.sin(np.radians(p["angle"])))
    return np.array([[-half, -2.4 * r, 0], [half, 2.4 * r, (1.2 + CLEARANCE + TALL) * r]])


SCENE = Scene(
    name="cradle",
    doc="Newton's cradle.",
    parameters={
        "duration": Parameter("time simulated", 10.0, unit="s", above=0),
        "balls": Parameter("number of balls", 5, minimum=2, maximum=50),
        "lifted": Parameter("number of balls that are released", 1, minimum=1),
        "angle": Parameter(
            "angle by which they are lifted", 40.0, unit="deg", minimum=0, maximum=85
        ),
        "radius": Parameter("radius of a ball", 0.1, unit="m", above=0),
        "restitution": Parameter("restitution of their impacts", 1.0, minimum=0, maximum=1),
        **rigid_parameters(step=1 / 240),
    },
    quick={"duration": 0.2, "balls": 3},
    build=lambda parameters, seed: Cradle(parameters),
    parts=_parts,
    frame=_frame,
    summary=Cradle.words,
    picture=solids_view(
        Camera(-65.0, 14.0),
        "Spectral",
        lambda recording: recording.parameters["radius"],
        _box,
        {
            "frame": Look("#8a7560"),
            "strings": Look("#56616c", radius=lambda r: 0.03 * r.parameters["radius"]),
        },
    ),
    frames=251,
)
