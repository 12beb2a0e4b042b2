"""A rover with six driven wheels on sprung arms crosses hills."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...base.quaternions import rotate
from ...geometry import Box, Capsule, Cylinder, HeightField, TriangleMesh
from ...rigid import SpeedMotor, SpringMotor
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from .rigid_bodies import STEEL, Solids, Surfaces, joined, rigid_parameters, shifted, solids_view

if TYPE_CHECKING:
    from ...recording import Recording

Array = NDArray[np.float64]

LENGTH, WIDTH, MARGIN = 14.0, 8.0, 3.0  # of the hills, and of their flat border [m]
WAVES, STONES = 8, 60  # that hills are made of, and that lie on them
RADIUS, BREADTH = 0.25, 0.18  # of a wheel [m]
AXLES, HALF = (-0.62, 0.0, 0.62), 0.55  # where wheels are along and across the rover [m]
ARM = np.array([0.3, 0.0, 0.14])  # of an axle to its pivot, at rest [m]
SPOKES = 3  # of a wheel, each across all of it
CHASSIS, MAST = (1.5, 0.75, 0.26), 0.55  # [m]
MASS, OF_WHEEL, OF_ARM = 60.0, 5.0, 2.0  # [kg]
SAG = 0.25  # of the springs under the load [rad]
ACROSS = np.array([1.0, 1.0, 0.0, 0.0]) / np.sqrt(2)  # turns the z axis across the rover


def _hills(parameters: dict[str, Any], random: np.random.Generator) -> HeightField:
    """Waves of all directions with stones on them, from 0 upwards and 0 at the border."""
    s = parameters["spacing"]
    x = s * np.arange(np.ceil(LENGTH / s) + 1)[:, None] - LENGTH / 2
    y = s * np.arange(np.ceil(WIDTH / s) + 1) - WIDTH / 2
    heights = np.zeros(np.broadcast_shapes(x.shape, y.shape))
    for _ in range(WAVES):
        angle, phase = random.uniform(0, 2 * np.pi, 2)
        k = 2 * np.pi / random.uniform(2.5, 6.0)
        heights += (1 + np.sin(k * (np.cos(angle) * x + np.sin(angle) * y) + phase)) / WAVES
    heights *= parameters["hills"]
    for _ in range(STONES):
        at = random.uniform((-LENGTH / 2, -WIDTH / 2), (LENGTH / 2, WIDTH / 2))
        size = random.uniform(0.1, 0.3)
        r2 = (x - at[0]) ** 2 + (y - at[1]) ** 2
        heights += parameters["stones"] * np.exp(-r2 / (2 * size**2))
    inside = np.minimum(LENGTH / 2 - np.abs(x), WIDTH / 2 - np.abs(y)) / MARGIN
    rise = np.clip(inside, 0, 1)
    return HeightField(heights * rise**2 * (3 - 2 * rise), s, (x[0, 0], y[0], 0.0))


def _spokes() -> TriangleMesh:
    """Spokes and a hub, drawn on both sides of a wheel to show how it turns."""
    bar = Box((1.6 * RADIUS, 0.16 * RADIUS, BREADTH + 0.01)).mesh()
    angles = np.arange(SPOKES) * np.pi / SPOKES / 2
    bars = [shifted(bar, (0, 0, 0), (np.cos(a), 0, 0, np.sin(a))) for a in angles]
    return joined([Cylinder(0.3 * RADIUS, BREADTH + 0.03).mesh(), *bars])


class Rover(Solids):
    """A chassis on six arms, each with a spring and a driven wheel.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    seed : int
        Of the hills.
    """

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        super().__init__(parameters)
        field = _hills(parameters, np.random.default_rng(seed))
        self.add(field, (0, 0, 0), motion="static", friction=self.friction)
        self.obstacles["hills"] = field.mesh()
        start = np.array([-LENGTH / 2 - 0.5, 0.0, RADIUS + ARM[2]])
        body = start + np.array([0, 0, 0.1])
        self.chassis = int(self.put("rover", Box(CHASSIS), [body], mass=MASS, dye=0.93)[0])
        mast = Capsule(0.04, MAST, (0, 0, MAST / 2))
        head = body + np.array([0.35 * CHASSIS[0], 0, CHASSIS[2] / 2])
        top = int(self.put("rover", mast, [head], mass=1.0, dye=0.3)[0])
        self.fixed(top, self.chassis, head)
        self.wheels = [
            self._wheel(start + np.array([along, side * HALF, 0]), parameters)
            for side in (-1, 1)
            for along in AXLES
        ]
        self.start = start
        # The farthest lean [rad], and how far it was above its start [m].
        self.measured = {name: np.zeros(1) for name in ("lean", "climbed")}

    def _wheel(self, pivot: Array, parameters: dict[str, Any]) -> int:
        """An arm that trails from the pivot, with a wheel at its end."""
        axle, axis = pivot - ARM, (0.0, 1.0, 0.0)
        side = np.sign(pivot[1])
        length = float(np.linalg.norm(ARM))
        lean = np.arctan2(ARM[0], ARM[2])
        turn = [np.cos(lean / 2), 0, np.sin(lean / 2), 0]
        inner = [0, 0.5 * side * BREADTH + 0.05 * side, 0]
        arm = self.put(
            "rover", Capsule(0.035, length), [axle + ARM / 2 - inner], turn, mass=OF_ARM, dye=0.3
        )[0]
        tyre = Cylinder(RADIUS, BREADTH)
        wheel = self.put("wheels", tyre, [axle], ACROSS, mass=OF_WHEEL, segments=64)
        self.surfaces.setdefault("spokes", Surfaces()).add(wheel, _spokes(), None)
        stiffness = MASS * 9.81 / (2 * len(AXLES)) * ARM[0] / SAG
        damping = parameters["damping"] * stiffness
        spring = SpringMotor(-SAG, stiffness, damping)
        self.hinge(int(arm), self.chassis, pivot, axis, limits=(-0.6, 0.9), motor=spring)
        motor = SpeedMotor(parameters["speed"] / RADIUS, parameters["torque"])
        self.hinge(int(wheel[0]), int(arm), axle, axis, motor=motor)
        return int(wheel[0])

    def after_step(self) -> None:
        """Note how far it leans, and how high it was."""
        row = self.rows(self.chassis)
        up = rotate(self.rotations[row], np.array([0.0, 0.0, 1.0]))
        lean, climbed = self.measured.values()
        lean[0] = max(lean[0], np.arccos(min(up[2], 1.0)))
        climbed[0] = max(climbed[0], self.positions[row][2] - self.start[2])

    def words(self) -> str:
        """How far it came, and over what."""
        lean, climbed = (float(values[0]) for values in self.measured.values())
        way = float(self.positions[self.rows(self.chassis)][0] - self.start[0])
        return (
            f"drove {way:.2f} m in {self.time:g} s, up to {climbed:.2f} m high, and leaned by at "
            f"most {np.degrees(lean):.0f} degrees"
        )


def _box(recording: Recording) -> Array:
    """Around its way, where it goes on the whole; the hills reach out of the picture."""
    high = recording.parameters["hills"] + 0.3
    return np.array([[-LENGTH / 2 - 0.6, -1.0, 0], [LENGTH / 2 - 2.4, 1.8, high]])


SCENE = Scene(
    name="rover",
    doc="A rover with six driven wheels on sprung arms crosses hills.",
    parameters={
        "duration": Parameter("time simulated", 12.0, unit="s", above=0),
        "hills": Parameter("height of the highest", 0.8, unit="m", minimum=0, maximum=3),
        "stones": Parameter("height of the stones", 0.12, unit="m", minimum=0, maximum=0.5),
        "spacing": Parameter("spacing of the heights", 0.1, unit="m", above=0.01, maximum=1),
        "speed": Parameter("speed at which the wheels are driven", 1.0, unit="m/s"),
        "torque": Parameter("largest torque of a wheel", 40.0, unit="N m", minimum=0),
        "damping": Parameter(
            "damping of the springs, over their stiffness", 0.06, unit="s", minimum=0
        ),
        **rigid_parameters(step=1 / 120),
        "friction": Parameter("coefficient of friction", 0.9, minimum=0),
    },
    quick={"duration": 0.2, "spacing": 0.5},
    build=Rover,
    parts=Solids.parts,
    frame=Solids.frame,
    summary=Rover.words,
    picture=solids_view(
        Camera(75.0, 32.0),
        "magma",
        lambda recording: RADIUS,
        _box,
        {"hills": Look("#b0764e"), "wheels": Look(STEEL), "spokes": Look("#e8e2d4")},
    ),
    still=lambda recording: 0.75 * float(recording.times[-1]),
    frames=241,
)
