"""A plume of smoke rises from a warm source and flows around a ball."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Sphere
from ...gridfluid import FlowEmitter, GridFlow
from ...view import Camera, Look, View
from ..declaration import Parameter, Scene
from .flows import InBox

Array = NDArray[np.float64]

HEIGHT = 1.5  # of the box, over its width of 1 m
SOURCE, SOURCE_HEIGHT = 0.11, 0.1  # radius, and height of its middle [m]
BALL_HEIGHT = 0.62
EXPANSION = 1 / 300  # of air [1/K]
SWIRL = 0.03  # of what stirs the air at the start [m/s]


class Plume(InBox, GridFlow):
    """A warm source of smoke on the floor of a box with an open top, and a ball above it.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    seed : int
        Of what stirs the air at the start.
    """

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        cell = 1 / parameters["cells"]
        self.recorded = parameters["fields"]
        source = Sphere(SOURCE, (0.5, 0.5, SOURCE_HEIGHT))
        ball = Sphere(parameters["radius"], (0.5, 0.5, BALL_HEIGHT))
        emitter = FlowEmitter(source, smoke=1.0, temperature=parameters["heat"])
        mesh = ball.mesh(96)
        self.obstacles = {"ball": mesh}
        random = np.random.default_rng(seed)
        waves, phases = random.uniform(4, 12, (6, 3)), random.uniform(0, 2 * np.pi, (6, 3))

        def stir(x: Array) -> Array:
            angles = x[:, None, :] * waves + phases
            return SWIRL * np.roll(np.sin(angles), 1, axis=2).sum(axis=1)

        super().__init__(
            [(0, 0, 0), (1, 1, cell * round(HEIGHT / cell))],
            cell,
            velocity=stir,
            sides=["wall", "wall", ("wall", "open")],
            colliders=[ball],
            emitters=[emitter],
            smoke=0.0,
            temperature=0.0,
            thermal_expansion=EXPANSION,
            vorticity_confinement=parameters["confinement"],
            largest_step=0.04,
            tolerance=1e-3,
        )

    def words(self) -> str:
        """What there is of smoke, and the last step."""
        values = self.diagnostics()
        height = self.positions_of()[..., 2][self.smoke > 0.05].max(initial=0.0)
        return (
            f"smoke up to {height:.3g} m, fastest {values['speed']:.3g} m/s; last step "
            f"{values['iterations']:.0f} iterations"
        )


SCENE = Scene(
    name="smoke",
    doc="A plume of smoke rises from a warm source and flows around a ball.",
    parameters={
        "duration": Parameter("time simulated", 3.0, unit="s", above=0),
        "cells": Parameter(
            "cells across the box, half as many more upwards", 64, minimum=8, maximum=512
        ),
        "heat": Parameter(
            "heat of the source above the air", 80.0, unit="K", minimum=0, maximum=300
        ),
        "radius": Parameter("radius of the ball", 0.16, unit="m", above=0, maximum=0.4),
        "confinement": Parameter(
            "strength of what spins up eddies", 0.03, unit="m/s", minimum=0, maximum=10
        ),
        "fields": Parameter(
            "what is recorded",
            ("smoke",),
            choices=("smoke", "temperature", "velocity", "pressure", "vorticity"),
        ),
    },
    quick={"duration": 0.2, "cells": 12},
    build=Plume,
    parts=Plume.parts,
    frame=Plume.frame,
    summary=Plume.words,
    picture=View(
        Camera(-58.0, 7.0, 0.86),
        {"ball": Look("#e0703a")},
        dark=True,
    ),
    still=lambda recording: 2.6,
    frames=76,
)
