"""A stack of boxes stands, until a ball is thrown at it."""

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


def _build(parameters: dict[str, Any], seed: int) -> Target:
    n, side = parameters["boxes"], parameters["side"]
    x = np.zeros((n, 3))
    x[:, 2] = side * (np.arange(n) + 0.5)
    stack = Target(parameters)
    box, dye = Box((side,) * 3), np.linspace(0, 1, n)
    ids = [stack.put("boxes", box, x[:-1], dye=dye[:-1])] if n > 1 else []
    top = stack.put("boxes", box, x[-1:], dye=dye[-1:], density=1000.0 * parameters["ratio"])
    stack.build(np.concatenate([*ids, top]), (1, 0, 0), 0.7 * n * side)
    return stack


def _box(recording: Recording) -> NDArray[np.float64]:
    n, side = recording.parameters["boxes"], recording.parameters["side"]
    high = n * side
    return np.array([[-0.3 * high, -0.3 * high, 0], [0.7 * high, 0.3 * high, 1.02 * high]])


SCENE = Scene(
    name="box-stack",
    doc="A stack of boxes stands, until a ball is thrown at it.",
    parameters={
        "duration": Parameter("time simulated", 6.0, unit="s", above=0),
        "boxes": Parameter("number of boxes", 10, minimum=1, maximum=200),
        "side": Parameter("side of a box", 1.0, unit="m", above=0),
        "ratio": Parameter("mass of the topmost over that of another", 1.0, above=0, maximum=1e6),
        **ball_parameters(speed=15.0, radius=0.6),
        **rigid_parameters(),
    },
    quick={"duration": 0.2, "boxes": 3},
    build=_build,
    parts=Target.parts,
    frame=Target.frame,
    summary=Target.words,
    picture=solids_view(
        Camera(-62.0, 12.0),
        "Spectral",
        lambda recording: 0.5 * recording.parameters["side"],
        _box,
        {"ball": Look(STEEL)},
    ),
    frames=181,
)
