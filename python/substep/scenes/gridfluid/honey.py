"""A thread of honey falls onto a plate, buckles and coils."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import TriangleMesh, box_mesh
from ...geometry.primitives import cylinder_mesh
from ...gridfluid import GridLiquid
from ...particles.emitters import Emitter
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from ..measured import Measured
from ..tanks import InTank, liquid_view

if TYPE_CHECKING:
    from ...recording import Recording

WIDTH = 12.0  # of the plate, over the diameter of the nozzle
DENSITY = 1400.0  # [kg/m^3]
PLATE = 0.05  # its thickness, over its width
LOOKED_AT = 0.4  # height where it is measured how the thread turns, over that of the nozzle
FROM = 2e-4  # distance from the axis at which the thread has a direction [m]


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
        plate = box_mesh((width, width, thick))
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
        # Turns of the thread about its axis so far, its direction, and since when it has one.
        self.measured = {"thread": np.array([0.0, np.nan, np.nan])}

    def after_step(self) -> None:
        """Follow the thread around its axis."""
        x = self.positions
        at = np.abs(x[:, 2] - LOOKED_AT * self.height) < self.cell
        if not at.any():
            return
        along, across = x[at, :2].mean(axis=0) - self.tank[:2] / 2
        thread = self.measured["thread"]
        if math.hypot(along, across) < FROM:
            return
        direction = math.atan2(across, along)
        if np.isnan(thread[1]):
            thread[2] = self.time
        else:
            turn = (direction - thread[1] + math.pi) % (2 * math.pi) - math.pi
            thread[0] += turn / (2 * math.pi)
        thread[1] = direction

    def words(self) -> str:
        """What became of the thread."""
        turns, _, since = self.measured["thread"]
        told = [f"{self.emitted.sum()} particles came out"]
        if since < self.time:
            told.append(
                f"the thread buckled after {since:.2f} s and turned {abs(turns):.1f} times, "
                f"{abs(turns) / (self.time - since):.2g} times a second"
            )
        report = self.report
        told.append(f"last step {report.viscosity_iterations} iterations of viscosity")
        return "; ".join(told)


def _box(recording: Recording) -> NDArray[np.float64]:
    points = np.asarray(recording.parts["tank"].points)
    low, high = points.min(axis=0), points.max(axis=0)
    side = 0.14 * (high[0] - low[0])
    return np.array([[*(low[:2] + side), low[2]], [*(high[:2] - side), high[2]]])


SCENE = Scene(
    name="honey",
    doc="A thread of honey falls onto a plate, buckles and coils.",
    parameters={
        "duration": Parameter("time simulated", 2.0, unit="s", above=0),
        "cells": Parameter("across the nozzle", 4, minimum=2, maximum=64),
        "radius": Parameter("of the nozzle", 0.004, unit="m", above=0),
        "height": Parameter("of the nozzle above the plate", 0.1, unit="m", above=0),
        "speed": Parameter("of what comes out", 0.3, unit="m/s", above=0),
        "viscosity": Parameter("kinematic", 0.02, unit="m^2/s", minimum=0),
    },
    quick={"duration": 0.1, "height": 0.02},
    build=lambda parameters, seed: HoneyThread(parameters),
    parts=HoneyThread.parts,
    frame=HoneyThread.frame,
    notes=HoneyThread.notes,
    summary=HoneyThread.words,
    picture=liquid_view(
        Camera(-60.0, 16.0),
        {"liquid": "#d98a00"},
        {"tank": Look(hidden=True), "plate": Look("#e8e4dc"), "nozzle": Look("#8a8f98")},
        box=_box,
    ),
    frames=101,
)
