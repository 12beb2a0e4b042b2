"""Jets rise from a basin and fall back into it; what is too much runs off."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Box, Collider, Sphere, sphere_mesh
from ...particles.emitters import Emitter, Sink
from ...pbf import fill_box
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from ..tanks import liquid_view
from .liquids import Liquid, liquid_parameters

if TYPE_CHECKING:
    from ...recording import Recording

GRAVITY = 9.81  # m/s^2
LEVEL = 0.10  # of the water in the basin, over the side of it
BALL = 0.11  # radius of the ball from which the jets come, likewise
DRAIN = 0.06  # side of the sinks in the corners, likewise
LEAN = 15.0  # of the jets [degrees]
OUT = np.radians(40.0)  # of where they leave the ball, from its top


class Fountain(Liquid):
    """A square basin with a ball in the middle, from which jets rise."""

    def __init__(self, parameters: dict[str, Any]) -> None:
        side, nozzle = parameters["side"], parameters["nozzle"]
        spacing = parameters["spacing"]
        side = spacing * max(4, round(side / spacing))  # whole particles between the walls
        level = LEVEL * side
        middle = np.array([side / 2, side / 2, level])
        ball = Collider(Sphere(BALL * side, middle), friction=parameters["friction"])
        water = fill_box((0, 0, 0), (side, side, level), spacing)
        water = water[ball.distance(water) > 0.5 * spacing]
        corners = [(x, y) for x in (0, 1) for y in (0, 1)]
        # What stands higher than the level in a corner runs off.
        size = np.array([DRAIN * side, DRAIN * side, 50 * side])
        sinks = []
        for corner in corners:
            low = (side - size[:2]) * np.array(corner)
            sinks.append(Sink(Box(size, [*(low + size[:2] / 2), level + size[2] / 2])))
        super().__init__(
            water,
            spacing,
            parameters,
            (side, side, parameters["rim"] * side),
            obstacles={"ball": (ball, sphere_mesh(BALL * side, middle, 4))},
            emitters=_jets(parameters, middle, BALL * side + nozzle + spacing, nozzle),
            sinks=sinks,
        )


def _jets(
    parameters: dict[str, Any], middle: NDArray[np.float64], out: float, nozzle: float
) -> list[Emitter]:
    """Jets that lean outwards, so that none falls on itself, and rise to the given height."""
    count, lean = parameters["jets"], np.radians(LEAN)
    speed = float(np.sqrt(2 * GRAVITY * parameters["height"])) / np.cos(lean)
    jets = []
    for turn in 2 * np.pi * np.arange(count) / count:
        along = np.array([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)])
        outwards = np.array([np.sin(OUT) * np.cos(turn), np.sin(OUT) * np.sin(turn), np.cos(OUT)])
        jets.append(Emitter(middle + out * outwards, along, speed, radius=nozzle))
    return jets


def _summary(liquid: Fountain) -> str:
    return (
        f"{liquid.emitted.sum()} particles came and {liquid.absorbed.sum()} went; {liquid.words()}"
    )


def _box(recording: Recording) -> NDArray[np.float64]:
    points = np.asarray(recording.parts["tank"].points)
    low, high = points.min(axis=0), points.max(axis=0)
    level = LEVEL * high[0] + 1.1 * recording.parameters["height"]
    return np.array([low, [high[0], high[1], max(high[2], level)]])


SCENE = Scene(
    name="fountain",
    doc="Jets rise from a basin and fall back into it; what is too much runs off in its corners.",
    parameters={
        "duration": Parameter("time simulated", 3.0, unit="s", above=0),
        "spacing": Parameter("spacing of the particles", 0.022, unit="m", above=0),
        "side": Parameter("side of the basin", 1.6, unit="m", above=0),
        "rim": Parameter("height of the basin as drawn, over its side", 0.18, above=0),
        "jets": Parameter("number of jets", 5, minimum=1, maximum=100),
        "height": Parameter("that the jets rise by", 0.9, unit="m", above=0),
        "nozzle": Parameter("radius of a nozzle", 0.022, unit="m", above=0),
        **liquid_parameters(),
    },
    quick={"duration": 0.2, "spacing": 0.08, "nozzle": 0.06},
    build=lambda parameters, seed: Fountain(parameters),
    parts=Liquid.parts,
    frame=Liquid.frame,
    notes=Liquid.notes,
    summary=_summary,
    picture=liquid_view(Camera(-60.0, 22.0), {"liquid": None}, {"ball": Look("#c9b79c")}, box=_box),
    frames=151,
)
