"""A thread of honey falls onto a plate, buckles and coils."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...geometry import TriangleMesh
from ...geometry.primitives import cylinder_mesh
from ...gridfluid import GridLiquid
from ...particles.emitters import Emitter
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from ..measured import Measured
from ..tanks import InTank, liquid_view

WIDTH = 10.0  # of the plate, over the diameter of the nozzle
DENSITY = 1400.0  # [kg/m^3]
PLATE = 0.05  # its thickness, over its width
LOOKED_AT = 0.4  # height where it is measured how the thread swings, over that of the nozzle
SWINGS = 2e-4  # from the axis, at least, to count [m]


class HoneyThread(InTank, Measured, GridLiquid):
    """A nozzle above a plate that holds what touches it; beyond its edges the honey is gone.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    """

    def __init__(self, parameters: dict[str, Any]) -> None:
        radius, height = parameters["radius"], parameters["height"]
        cell = 2 * radius / parameters["cells"]
        width = cell * round(WIDTH * 2 * radius / cell)
        self.tank = np.array([width, width, cell * math.ceil(height / cell + 2)])
        self.spacing = cell / 2
        self.lacks = {}
        self.height = height
        middle = np.array([width / 2, width / 2, 0.0])
        thick, long = PLATE * width, 3 * radius
        plate = cylinder_mesh(width / 2, thick, 96)
        tap = cylinder_mesh(1.25 * radius, long, 48)
        self.obstacles = {
            "plate": TriangleMesh(plate.vertices + middle - [0, 0, thick / 2], plate.faces),
            "nozzle": TriangleMesh(tap.vertices + middle + [0, 0, height + long / 2], tap.faces),
        }
        nozzle = Emitter(
            middle + np.array([0, 0, height]), (0, 0, -1), parameters["speed"], radius=radius
        )
        super().__init__(
            np.zeros((0, 3)),
            cell=cell,
            bounds=[np.zeros(3), self.tank],
            density=DENSITY,
            sides=("open", "open", ("wall", "open")),
            viscosity=parameters["viscosity"],
            emitters=[nozzle],
        )
        # How often the thread went through its middle, on which side it is, and since when on any.
        self.measured = {"thread": np.array([0.0, 0.0, np.nan])}

    def after_step(self) -> None:
        """Count how often the thread swings across its axis."""
        x = self.positions
        at = np.abs(x[:, 2] - LOOKED_AT * self.height) < self.cell
        off = float(x[at, 0].mean()) - self.tank[0] / 2 if at.any() else 0.0
        if abs(off) < SWINGS:
            return
        thread = self.measured["thread"]
        if thread[1] == 0:
            thread[2] = self.time
        elif thread[1] * off < 0:
            thread[0] += 1
        thread[1] = math.copysign(1, off)

    def words(self) -> str:
        """What became of the thread."""
        crossings, _, since = self.measured["thread"]
        told = [f"{self.emitted.sum()} particles came out"]
        if since < self.time:
            swings = crossings / 2 / (self.time - since)
            told.append(
                f"the thread buckled after {since:.2f} s, and swung {swings:.1f} times a second"
            )
        report = self.report
        told.append(f"last step {report.viscosity_iterations} iterations of viscosity")
        return "; ".join(told)


SCENE = Scene(
    name="honey",
    doc="A thread of honey falls onto a plate, buckles and coils.",
    parameters={
        "duration": Parameter("time simulated", 2.0, unit="s", above=0),
        "cells": Parameter("cells across the nozzle", 4, minimum=2, maximum=64),
        "radius": Parameter("radius of the nozzle", 0.004, unit="m", above=0),
        "height": Parameter("height of the nozzle above the plate", 0.1, unit="m", above=0),
        "speed": Parameter("speed of the outflow", 0.3, unit="m/s", above=0),
        "viscosity": Parameter("kinematic", 0.02, unit="m^2/s", minimum=0),
    },
    quick={"duration": 0.1, "height": 0.02},
    build=lambda parameters, seed: HoneyThread(parameters),
    parts=HoneyThread.parts,
    frame=HoneyThread.frame,
    notes=HoneyThread.notes,
    summary=HoneyThread.words,
    picture=liquid_view(
        Camera(-60.0, 16.0, 0.9),
        {"liquid": "#d98a00"},
        {"tank": Look(hidden=True), "plate": Look("#e8e4dc"), "nozzle": Look("#8a8f98")},
    ),
    still=lambda recording: min(1.2, recording.times[-1]),
    frames=101,
)
