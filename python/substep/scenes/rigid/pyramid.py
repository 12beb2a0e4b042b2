"""A wall of boxes in the shape of a pyramid stands, until a ball flies through it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Box
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from .rigid_bodies import STEEL, rigid_parameters, solids_view
from .thrown_ball import Target, ball_parameters

if TYPE_CHECKING:
    from ...recording import Recording

CAMERA = Camera(-65.0, 14.0)  # the ball comes towards it, from behind the wall
APART = 1.05  # of the middles of neighbours, in sides of a box


def _build(parameters: dict[str, Any], seed: int) -> Target:
    rows, side = parameters["rows"], parameters["side"]
    row, place = np.array([(k, i) for k in range(rows) for i in range(rows - k)]).T
    x = np.zeros((len(row), 3))
    x[:, 0] = APART * side * (place - (rows - row - 1) / 2)
    x[:, 2] = side * (row + 0.5)
    pyramid = Target(parameters)
    shade = np.random.default_rng(seed).uniform(-0.05, 0.05, len(row))
    dye = np.clip((row + 0.5) / rows + shade, 0, 1)
    boxes = pyramid.put("boxes", Box((side,) * 3), x, dye=dye)
    pyramid.build(boxes, CAMERA.axes()[2] * [1, 1, 0], 0.2 * rows * side)
    return pyramid


def _box(recording: Recording) -> NDArray[np.float64]:
    rows, side = recording.parameters["rows"], recording.parameters["side"]
    high = rows * side
    return np.array([[-0.52 * high, -0.2 * high, 0], [0.52 * high, 0.3 * high, 1.08 * high]])


SCENE = Scene(
    name="pyramid",
    doc="A pyramid of boxes stands, until a ball flies through it.",
    parameters={
        "duration": Parameter("time simulated", 6.0, unit="s", above=0),
        "rows": Parameter("number of rows", 20, minimum=1, maximum=100),
        "side": Parameter("side of a box", 1.0, unit="m", above=0),
        **ball_parameters(speed=30.0, radius=1.5),
        **rigid_parameters(),
    },
    quick={"duration": 0.2, "rows": 4},
    build=_build,
    parts=Target.parts,
    frame=Target.frame,
    summary=Target.words,
    picture=solids_view(
        CAMERA,
        "YlOrRd",
        lambda recording: 0.5 * recording.parameters["side"],
        _box,
        {"ball": Look(STEEL)},
    ),
    frames=181,
)
