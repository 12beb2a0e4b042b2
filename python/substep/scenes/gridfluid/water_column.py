"""A column of water collapses in a tank and hits a box, as in an experiment with gauges."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Box, Collider, TriangleMesh, box_mesh
from ...gridfluid import GridLiquid
from ...gridfluid.liquid import TRANSFERS
from ...mpm import sample_box
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from ..measured import Measured
from ..tanks import InTank, liquid_view

if TYPE_CHECKING:
    from ...recording import Part

Array = NDArray[np.float64]

# The experiment, with y from the middle of the tank [m].
TANK = (3.22, 1.0, 1.0)
COLUMN = (1.228, 0.55)  # length and height of the water, at the end of large x
BOX = (0.161, 0.403, 0.161)
MIDDLE = 0.744  # of the box along the tank
GAUGES = {"H1": 0.496, "H2": 0.992, "H3": 1.488, "H4": 2.638}  # where they stand along the tank
# Places of sensors on the faces of the box, and the axis along which these look outwards.
SENSORS = {"P1": ((0.8245, -0.029, 0.021), 0), "P5": ((0.8035, -0.029, 0.161), 2)}
JITTER = 0.8  # of the particles, over their spacing
WET = 0.05  # depth from which a gauge has water [m]
RISE = 1000.0  # pressure from which a sensor was hit [Pa]


class WaterColumn(InTank, Measured, GridLiquid):
    """The tank of the experiment, with its gauges of depth and sensors of pressure.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    seed : int
        Of the places of the particles.
    """

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        length, width, height = TANK
        cell = length / parameters["cells"]
        width = cell * max(1, round(width / cell))  # whole cells between the walls
        self.tank = np.array([length, width, height])
        self.spacing = cell / 2
        self.lacks = {}
        long, high = (self.spacing * max(1, round(side / self.spacing)) for side in COLUMN)
        middle = np.array([MIDDLE, width / 2, BOX[2] / 2])
        mesh = box_mesh(BOX)
        shift = middle - (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        self.obstacles = {"box": TriangleMesh(mesh.vertices + shift, mesh.faces)}
        self.gauges = np.array([[x, width / 2] for x in GAUGES.values()])
        self.sensors = np.array([place for place, _ in SENSORS.values()])
        self.sensors[:, 1] += width / 2
        # In a box the pressure is 0, so that it is read no nearer to a face than in the middle
        # of the cell before it.
        self._read = self.sensors.copy()
        for row, (_, axis) in zip(self._read, SENSORS.values(), strict=True):
            row[axis] = max(row[axis], cell * (math.floor(row[axis] / cell + 1e-9) + 0.5))
        # Particles in rows would make ridges where the water is stretched.
        water, _ = sample_box(
            (length - long, 0, 0), (length, width, high), self.spacing, jitter=JITTER, seed=seed
        )
        super().__init__(
            water,
            cell=cell,
            bounds=((0, 0, 0), (length, width, cell * math.ceil(height / cell - 1e-9))),
            colliders=[Collider(Box(BOX, middle))],
            transfer=parameters["transfer"],
        )
        # The time at which the water came, for each; the highest pressures, and their times.
        self.measured = {
            "wet": np.where(self.depths() > WET, 0.0, np.nan),
            "hit": np.full(len(SENSORS), np.nan),
            "peak": np.zeros((2, len(SENSORS))),
        }

    def depths(self) -> Array:
        """Depths of the water at the gauges H1 to H4 [m]."""
        return self.depth(self.gauges)

    def pressures(self) -> Array:
        """Pressures at the sensors P1 and P5 [Pa], of the last step."""
        return self.sample_pressure(self._read)

    def volume(self) -> float:
        """Volume below the surface [m^3]."""
        filled = np.clip(0.5 - self.level_set / self.cell, 0, 1)
        return float(filled.sum()) * self.cell**3

    def after_step(self) -> None:
        """Note when the water comes, and the highest pressures."""
        wet, hit, peak = self.measured.values()
        wet[np.isnan(wet) & (self.depths() > WET)] = self.time
        pressures = self.pressures()
        hit[np.isnan(hit) & (pressures > RISE)] = self.time
        higher = pressures > peak[0]
        peak[0, higher], peak[1, higher] = pressures[higher], self.time

    def words(self) -> str:
        """What gauges and sensors told."""
        wet, hit, peak = self.measured.values()
        told = []
        if np.isfinite(wet[1]):
            told.append(f"water came to H2 after {wet[1]:.3f} s")
        for name, begun, most, time in zip(SENSORS, hit, *peak, strict=True):
            if np.isfinite(begun):
                told.append(
                    f"to {name} after {begun:.3f} s, at most {most / 1e3:.3g} kPa at {time:.3f} s"
                )
        depths = ", ".join(
            f"{name} {100 * depth:.3g} cm"
            for name, depth in zip(GAUGES, self.depths(), strict=True)
        )
        values = self.diagnostics()
        told.append(
            f"at the end {depths}; {len(self)} particles of {1e3 * self.spacing:.3g} mm; last step "
            f"{values['iterations']:.0f} iterations"
        )
        return "; ".join(told)

    def parts(self) -> dict[str, Part]:
        """Liquid, tank and box; the gauges with the depth, and the sensors with the pressure."""
        from ...recording import Part

        return {
            **super().parts(),
            "gauges": Part("particles", {"depth": "m"}),
            "sensors": Part("particles", {"pressure": "Pa"}),
        }

    def frame(self) -> dict[str, dict[str, Any]]:
        """One frame of `parts`; a gauge is at the top of its water."""
        depths = self.depths()
        return {
            **super().frame(),
            "gauges": {"points": np.column_stack([self.gauges, depths]), "depth": depths},
            "sensors": {"points": self.sensors, "pressure": self.pressures()},
        }


SCENE = Scene(
    name="water-column",
    doc="A column of water collapses in a tank and hits a box, as in an experiment with gauges.",
    parameters={
        "duration": Parameter("time simulated", 6.0, unit="s", above=0),
        "cells": Parameter("cells along the tank", 87, minimum=12, maximum=1000),
        "transfer": Parameter(
            "how velocities go between particles and grid", "apic", choices=TRANSFERS
        ),
    },
    quick={"duration": 0.1, "cells": 16},
    build=WaterColumn,
    parts=WaterColumn.parts,
    frame=WaterColumn.frame,
    notes=WaterColumn.notes,
    summary=WaterColumn.words,
    picture=liquid_view(
        Camera(-120.0, 18.0),
        {"liquid": None},
        {"box": Look("#d98f4e"), "gauges": Look(hidden=True), "sensors": Look(hidden=True)},
    ),
    still=lambda recording: 0.56,
    frames=151,
)
