"""A jet turns a water wheel, which a brake holds back."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Box, Cylinder
from ...gridfluid import GridLiquid
from ...particles.emitters import Emitter
from ...rigid import Fixture, SpeedMotor
from ...view import Camera, Look, View
from ..declaration import Parameter, Scene
from ..rigid.rigid_bodies import Solid, Solids, Surfaces, joined, shifted
from ..tanks import EDGES, InTank, radius, tank_box
from .coupled import Coupled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...recording import Part, Recording

Array = NDArray[np.float64]

TANK = (1.6, 0.4, 1.2)  # lengths of the box [m]
AXLE, RADIUS, BREADTH = (0.8, 0.2, 0.6), 0.42, 0.24  # of the wheel [m]
HUB, BLADES = 0.14, 8  # its radius, and how many blades it has
THICK = 2  # of a blade [cells]: water leaks through thinner ones
ACROSS = (math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0)  # turns the z axis along y


class Stream(InTank, GridLiquid):
    """A jet that falls on the wheel; what reaches the walls or the floor is gone."""

    def __init__(self, parameters: dict[str, Any], bodies: Solids) -> None:
        cell = TANK[0] / parameters["cells"]
        self.tank = cell * np.array([math.ceil(side / cell - 1e-9) for side in TANK])
        self.spacing, self.obstacles, self.lacks = cell / 2, {}, {}
        nozzle = Emitter(
            (AXLE[0] + 0.26, AXLE[1], self.tank[2] - 1.5 * cell),
            (0, 0, -1),
            parameters["speed"],
            radius=parameters["nozzle"],
        )
        super().__init__(
            np.zeros((0, 3)),
            cell=cell,
            bounds=(np.zeros(3), self.tank),
            sides=("open", "wall", "open"),
            colliders=bodies.make_colliders(1),
            emitters=[nozzle],
        )


class WaterWheel(Coupled):
    """The wheel on its axle, and the water.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    """

    def __init__(self, parameters: dict[str, Any]) -> None:
        bodies = Solids({**parameters, "friction": 0.3, "step": 1 / 120, "substeps": 8})
        self.wheel = _add_wheel(bodies, parameters["mass"], THICK * TANK[0] / parameters["cells"])
        brake = SpeedMotor(0.0, parameters["brake"])
        self.axle = bodies.hinge(self.wheel, None, AXLE, (0, 1, 0), motor=brake)
        super().__init__({"wheel": bodies, "water": Stream(parameters, bodies)})

    def turning(self) -> tuple[float, float]:
        """Torque of the water on the wheel [N m], and speed of the wheel [rad/s]."""
        _, forces = self.exchanged()["water"]
        return float(forces[0, 4]), float(self["wheel"].joints[0].speed)

    def parts(self) -> dict[str, Part]:
        """Wheel, water, and the axle with torque and speed."""
        from ...recording import Part

        return {**super().parts(), "axle": Part("particles", {"torque": "N m", "speed": "rad/s"})}

    def frame(self) -> dict[str, dict[str, Any]]:
        """One frame of `parts`."""
        torque, speed = self.turning()
        axle = {"points": [AXLE], "torque": [torque], "speed": [speed]}
        return {**super().frame(), "axle": axle}

    def words(self) -> str:
        """How the wheel turns."""
        torque, speed = self.turning()
        return f"the wheel turns at {speed:.2f} rad/s, the water by {torque:.2f} N m"


def _add_wheel(bodies: Solids, mass: float, thick: float) -> int:
    """A hub with flat blades, about the y axis."""
    hub, deep = Cylinder(HUB, BREADTH), RADIUS - HUB + 0.02
    shapes: list[Solid] = [hub]
    meshes = [hub.mesh(48)]
    for angle in 2 * np.pi * np.arange(BLADES) / BLADES:
        turn = (np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2))
        x = (RADIUS - deep / 2) * np.array([np.cos(angle), np.sin(angle), 0])
        blade = Box((deep, thick, BREADTH), x, turn)
        shapes.append(blade)
        meshes.append(shifted(Box(blade.lengths).mesh(), x, turn))
    wheel = int(bodies.add([Fixture(shape) for shape in shapes], AXLE, ACROSS, mass=mass))
    bodies.surfaces.setdefault("blades", Surfaces()).add(np.array([wheel]), joined(meshes), None)
    return wheel


_VIEW = View(
    Camera(-70.0, 14.0),
    {
        "bodies": Look(hidden=True),
        "axle": Look(hidden=True),
        "liquid": Look(liquid=True, radius=radius),
        "tank": Look(EDGES),
        "blades": Look("#b0764e"),
    },
    box=tank_box,
    ground=lambda recording: 0.0,
)


def _picture(recording: Recording, frame: int, figure: Figure) -> None:
    """The wheel, and below it what it was turned by until then."""
    _VIEW(recording, frame, figure)
    torque, speed = (
        np.array([recording["axle"].field(name, k)[0] for k in range(len(recording))])
        for name in ("torque", "speed")
    )
    shown = slice(0, frame % len(recording) + 1)
    axes = figure.add_axes((0.09, 0.09, 0.26, 0.2))
    axes.patch.set_alpha(0.8)
    for values, color, label in (
        (torque, "#1f5f99", "torque of the water [N m]"),
        (speed, "#b0563e", "speed [rad/s]"),
    ):
        axes.plot(recording.times[shown], values[shown], color=color, label=label)
    axes.set_xlim(0, recording.times[-1])
    low, high = min(0, torque.min(), speed.min()), max(torque.max(), speed.max(), 1e-9)
    axes.set_ylim(low, 1.05 * high)
    axes.set_xlabel("t [s]", fontsize=8)
    axes.tick_params(labelsize=7)
    axes.legend(
        fontsize=7,
        loc="lower left",
        bbox_to_anchor=(0, 1, 1, 0),
        mode="expand",
        ncols=2,
        handlelength=1.0,
        frameon=False,
        borderaxespad=0.2,
    )


SCENE = Scene(
    name="water-wheel",
    doc="A jet turns a water wheel, which a brake holds back.",
    parameters={
        "duration": Parameter("time simulated", 3.0, unit="s", above=0),
        "cells": Parameter("cells along the box", 64, minimum=32, maximum=1000),
        "speed": Parameter("speed of the jet", 2.5, unit="m/s", above=0),
        "nozzle": Parameter("radius of the jet", 0.06, unit="m", above=0.01, maximum=0.15),
        "mass": Parameter("mass of the wheel", 12.0, unit="kg", above=0),
        "brake": Parameter("torque of the brake, at most", 8.0, unit="N m", minimum=0),
    },
    quick={"duration": 0.1, "cells": 32},
    build=lambda parameters, seed: WaterWheel(parameters),
    parts=WaterWheel.parts,
    frame=WaterWheel.frame,
    notes=Coupled.notes,
    summary=WaterWheel.words,
    picture=_picture,
    frames=121,
)
