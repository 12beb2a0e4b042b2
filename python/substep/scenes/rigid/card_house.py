"""A house of cards stands, until a ball is thrown at it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Box
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from .rigid_bodies import STEEL, rigid_parameters, solids_view
from .thrown_ball import Target, ball_parameters, time_of_flight

if TYPE_CHECKING:
    from ...recording import Recording

Array = NDArray[np.float64]

HEIGHT, WIDTH, THICKNESS = 1.0, 0.7, 0.02  # of a card, in its height
PITCH = 1.01  # of neighbouring pairs, so that level cards do not touch
DENSITY = 700.0  # of cardboard [kg/m^3]


def _storey(angle: float) -> float:
    """Height of a pair that leans at an angle to the ground, in heights of a card."""
    return HEIGHT * np.sin(angle) + THICKNESS * np.cos(angle)


def _cards(levels: int, angle: float) -> tuple[Array, Array, NDArray[np.int64]]:
    """Middles of all cards, by how much they are turned about y, and their levels.

    Cards of a pair touch each other with an edge at the top; level ones lie on the tops of two
    neighbours, and each carries a pair.
    """
    tilt = np.pi / 2 - angle
    off = (
        HEIGHT * np.sin(tilt) + THICKNESS * np.cos(tilt)
    ) / 2  # of a card's middle from its pair's
    high = _storey(angle)
    x, turns, storeys = [], [], []
    for level in range(levels):
        ground = level * (high + THICKNESS)
        pairs = PITCH * (np.arange(levels - level) - (levels - level - 1) / 2)
        roofs = (pairs[1:] + pairs[:-1]) / 2
        for middles, turn, z in (
            (pairs - off, tilt, ground + high / 2),
            (pairs + off, -tilt, ground + high / 2),
            (roofs, np.pi / 2, ground + high + THICKNESS / 2),
        ):
            x += [(middle, 0.0, z) for middle in middles]
            turns += [turn] * len(middles)
            storeys += [level] * len(middles)
    return np.array(x), np.array(turns), np.array(storeys)


class CardHouse(Target):
    """Pairs of cards that lean against each other, and level cards on them.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    seed : int
        Of the colours.
    """

    what = "cards"

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        super().__init__(parameters)
        levels, size = parameters["levels"], parameters["height"]
        x, turns, storeys = _cards(levels, np.radians(parameters["angle"]))
        zero = 0 * turns
        q = np.stack([np.cos(turns / 2), zero, np.sin(turns / 2), zero], axis=-1)
        shade = np.random.default_rng(seed).uniform(-0.06, 0.06, len(x))
        dye = np.clip((storeys + 0.5) / levels + shade, 0, 1)
        card = Box((size * THICKNESS, size * WIDTH, size * HEIGHT))
        cards = self.put("cards", card, size * x, q, dye=dye, density=DENSITY)
        self.build(cards, (1, 0.35, 0), 0.6 * size, 0.3 * size, far=_far(parameters))


def _far(parameters: Mapping[str, Any]) -> float:
    """Where the ball comes from, just outside of the picture [m]."""
    return float(parameters["height"] * (0.5 * parameters["levels"] * PITCH + 8))


def _still(recording: Recording) -> float:
    """While the house falls."""
    p = recording.parameters
    return float(p["stand"] + (time_of_flight(p["speed"], _far(p)) + 0.1 if p["speed"] > 0 else 0))


def _box(recording: Recording) -> Array:
    p = recording.parameters
    size, levels = p["height"], p["levels"]
    high = size * levels * (_storey(np.radians(p["angle"])) + THICKNESS)
    half = size * (levels * PITCH / 2 + 0.2)
    return np.array([[-half, -0.4 * size, 0], [half + 0.3 * size, 0.4 * size, high]])


SCENE = Scene(
    name="card-house",
    doc="A house of cards stands, until a ball is thrown at it.",
    parameters={
        "duration": Parameter("time simulated", 5.0, unit="s", above=0),
        "levels": Parameter("number of levels", 4, minimum=1, maximum=20),
        "angle": Parameter(
            "angle of leaning cards to the ground", 70.0, unit="deg", minimum=60, maximum=85
        ),
        "height": Parameter("height of a card", 0.2, unit="m", above=0),
        **ball_parameters(speed=4.0, radius=0.04),
        **rigid_parameters(step=1 / 240),
    },
    quick={"duration": 0.2, "levels": 2},
    build=CardHouse,
    parts=Target.parts,
    frame=Target.frame,
    summary=Target.words,
    picture=solids_view(
        Camera(-62.0, 12.0),
        "Spectral",
        lambda recording: 0.3 * recording.parameters["height"],
        _box,
        {"ball": Look(STEEL)},
    ),
    still=_still,
    frames=151,
)
