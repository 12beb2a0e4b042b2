"""A driven cart crosses a bed of sand on four wheels with paddles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Box, Cylinder
from ...rigid import Fixture, SpeedMotor
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from ..rigid.rigid_bodies import Solid, Solids, Surfaces, joined, shifted
from .coupled import Coupled
from .sand_bed import SandBed, sand_parameters, sand_view

if TYPE_CHECKING:
    from ...recording import Recording

Array = NDArray[np.float64]

BED = (1.6, 0.7, 0.12)  # lengths of the tray, and depth of the sand [m]
RADIUS, BREADTH = 0.085, 0.07  # of a wheel [m]
BLADES, BLADE = 10, (0.03, 0.012)  # of a wheel: how many, how far they stand out, how thick [m]
AXLE, TRACK = 0.15, 0.17  # of the wheels from the middle, along and across the cart [m]
CHASSIS = (0.42, 0.2, 0.06)  # [m]
MASS, OF_WHEEL = 8.0, 0.8  # of the chassis and of a wheel [kg]
ACROSS = np.array([np.sqrt(0.5), np.sqrt(0.5), 0, 0])  # turns the z axis across the cart


class SandWheels(Coupled):
    """A cart on sand, whose wheels are driven.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    seed : int
        Of the grains' places.
    """

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        bodies = Solids({**parameters, "step": 1 / 120, "substeps": 8})
        height = BED[2] + RADIUS + BLADE[0] + 0.005
        start = np.array([0.32, BED[1] / 2, height])
        cart = bodies.put("cart", Box(CHASSIS), [start + np.array([0, 0, 0.05])], mass=MASS)[0]
        motor = SpeedMotor(parameters["speed"] / RADIUS, parameters["torque"])
        for along in (-AXLE, AXLE):
            for across in (-TRACK, TRACK):
                axle = start + np.array([along, across, 0])
                wheel = _add_wheel(bodies, axle)
                bodies.hinge(wheel, int(cart), axle, (0, 1, 0), motor=motor)
        self.start = float(start[0])
        super().__init__({"cart": bodies, "sand": SandBed(parameters, BED, bodies, seed)})

    def words(self) -> str:
        """How far the cart came, and how far its wheels turned for it."""
        bodies = self["cart"]
        way = float(bodies.positions[1, 0]) - self.start
        turned = RADIUS * float(np.mean([joint.coordinate for joint in bodies.joints]))
        slip = f", slip {1 - way / turned:.2f}" if turned > 0.01 else ""
        return f"drove {way:.3f} m while its wheels rolled {turned:.3f} m{slip}"


def _add_wheel(bodies: Solids, axle: Array) -> int:
    """A drum with blades, about the y axis."""
    drum = Cylinder(RADIUS, BREADTH)
    blade = Box((BLADE[0] + 0.01, BLADE[1], BREADTH))
    place = RADIUS + BLADE[0] / 2 - 0.005
    shapes: list[Solid] = [drum]
    meshes = [drum.mesh(48)]
    for angle in 2 * np.pi * np.arange(BLADES) / BLADES:
        turn = (np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2))
        x = place * np.array([np.cos(angle), np.sin(angle), 0])
        shapes.append(Box(blade.lengths, x, turn))
        meshes.append(shifted(blade.mesh(), x, turn))
    wheel = int(
        bodies.add([Fixture(shape) for shape in shapes], axle, ACROSS, mass=OF_WHEEL, friction=0.6)
    )
    bodies.surfaces.setdefault("wheels", Surfaces()).add(np.array([wheel]), joined(meshes), None)
    return wheel


def _box(recording: Recording) -> Array:
    return np.array([[0, 0, 0], [BED[0], BED[1], BED[2] + 0.2]])


SCENE = Scene(
    name="sand-wheels",
    doc="A driven cart crosses a bed of sand on four wheels with blades.",
    parameters={
        "duration": Parameter("time simulated", 3.0, unit="s", above=0),
        "speed": Parameter("speed at which the wheels are driven", 0.4, unit="m/s"),
        "torque": Parameter("largest torque of a wheel", 4.0, unit="N m", minimum=0),
        **sand_parameters(100_000),
    },
    quick={"duration": 0.05, "particles": 2000},
    build=SandWheels,
    parts=Coupled.parts,
    frame=Coupled.frame,
    notes=Coupled.notes,
    summary=SandWheels.words,
    picture=sand_view(
        Camera(-60.0, 28.0),
        {"cart": Look("#c8452d"), "wheels": Look("#4a5058")},
        _box,
    ),
    frames=151,
)
