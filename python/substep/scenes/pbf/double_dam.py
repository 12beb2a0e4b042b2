"""Two columns of liquid collapse towards each other."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import InputError
from ...view import Camera
from ..declaration import Parameter, Scene
from ..tanks import liquid_view
from .liquids import Liquid, column, liquid_parameters


def _build(parameters: dict[str, Any], seed: int) -> Liquid:
    width, height, depth = (parameters[key] for key in ("width", "height", "depth"))
    length, second = parameters["length"], parameters["second"]
    if 2 * width > length:
        raise InputError(f"width: two columns of {width:g} m do not fit into {length:g} m")
    volume = width * height * depth * (1 + second)
    spacing = (volume / parameters["particles"]) ** (1 / 3)
    depth = spacing * max(1, round(depth / spacing))  # whole particles between the walls
    left = column((0, 0, 0), (width, depth, height), spacing)
    right = column((0, 0, 0), (width, depth, second * height), spacing)
    right[:, 0] = length - right[:, 0]
    return Liquid(
        np.vstack([left, right]),
        spacing,
        parameters,
        (length, depth, parameters["rim"]),
        names=("left", "right"),
        density=(1000.0, 1000.0 * parameters["ratio"]),
        kinds=np.repeat([0, 1], [len(left), len(right)]),
    )


def _summary(liquid: Liquid) -> str:
    x = liquid.positions[:, 0]
    across = [
        100 * float(np.mean(side * (x[liquid.kinds == k] - liquid.tank[0] / 2) > 0))
        for k, side in enumerate((1, -1))
    ]
    return (
        f"{across[0]:.0f} % of the left liquid and {across[1]:.0f} % of the right one are on the "
        f"other side; {liquid.words()}"
    )


SCENE = Scene(
    name="double-dam",
    doc="Two columns of liquid collapse towards each other; they may differ in density.",
    parameters={
        "duration": Parameter("time simulated", 2.0, unit="s", above=0),
        "particles": Parameter(
            "approximate number of particles", 60_000, minimum=2, maximum=20_000_000
        ),
        "width": Parameter("width of each column, along the tank", 0.7, unit="m", above=0),
        "height": Parameter("height of the left column", 1.1, unit="m", above=0),
        "second": Parameter("height of the right one, over that of the left", 0.8, above=0),
        "depth": Parameter("depth of the columns and the tank", 0.7, unit="m", above=0),
        "length": Parameter("length of the tank", 3.0, unit="m", above=0),
        "rim": Parameter("height of the tank as drawn", 1.4, unit="m", above=0),
        "ratio": Parameter("density of the right liquid over that of the left", 1.0, above=0),
        **liquid_parameters(),
    },
    quick={"duration": 0.1, "particles": 400},
    build=_build,
    parts=Liquid.parts,
    frame=Liquid.frame,
    notes=Liquid.notes,
    summary=_summary,
    picture=liquid_view(Camera(-62.0, 18.0), {"left": "#2f86bd", "right": "#e0703c"}),
    frames=101,
)
