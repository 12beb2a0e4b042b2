"""Ragdolls fall down stairs, into a heap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...base.quaternions import multiply, rotate
from ...geometry import Box, Capsule
from ...rigid import SpringMotor
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from .rigid_bodies import Solids, joined, rigid_parameters, shifted, solids_view

if TYPE_CHECKING:
    from ...recording import Recording

Array = NDArray[np.float64]
Point = tuple[float, float, float]


@dataclass(frozen=True)
class Limb:
    """A capsule of a doll that stands upright and looks along x, and the joint to its parent.

    A hinge turns about `axis` within `limits`; a ball lets `axis` lean by `cone`, and twist within
    `limits`.
    """

    ends: tuple[Point, Point]  # of the segment [m]
    radius: float  # [m]
    mass: float  # [kg]
    parent: str = ""
    anchor: Point = (0, 0, 0)  # [m]
    axis: Point = (0, 0, 1)
    limits: tuple[float, float] = (-0.3, 0.3)  # [rad]
    cone: float | None = None  # [rad]; None is a hinge


LIMBS = ("thigh", "shin", "foot", "arm", "forearm")  # of either side
ACROSS, DOWN, UP = (0, 1, 0), (0, 0, -1), (0, 0, 1)


def _doll() -> dict[str, Limb]:
    """A man of 1.75 m and 75 kg; its limits are what people can do without pain, or less."""
    pelvis, belly, chest = (
        ((0, -y, z), (0, y, z)) for y, z in ((0.08, 1), (0.03, 1.17), (0.08, 1.36))
    )
    head = ((0, 0, 1.61), (0, 0, 1.66))
    limbs = {
        "pelvis": Limb(pelvis, 0.1, 11),
        "belly": Limb(belly, 0.1, 9, "pelvis", (0, 0, 1.09), UP, cone=0.35),
        "chest": Limb(chest, 0.11, 18, "belly", (0, 0, 1.26), UP, cone=0.35),
        "head": Limb(head, 0.09, 5, "chest", (0, 0, 1.5), ACROSS, (-0.6, 0.8)),
    }
    for side, s in (("left", 1), ("right", -1)):
        thigh, shin, foot, arm, forearm = (f"{side} {limb}" for limb in LIMBS)
        y, outer = 0.1 * s, 0.25 * s
        upper, lower = ((0, y, 0.84), (0, y, 0.53)), ((0, y, 0.47), (0, y, 0.12))
        sole = ((0, y, 0.05), (0.14, y, 0.05))
        above, below = ((0, outer, 1.4), (0, outer, 1.13)), ((0, outer, 1.09), (0, outer, 0.86))
        limbs[thigh] = Limb(upper, 0.07, 8, "pelvis", (0, y, 0.92), DOWN, cone=1.2)
        limbs[shin] = Limb(lower, 0.05, 3.5, thigh, (0, y, 0.5), ACROSS, (0, 2.3))
        limbs[foot] = Limb(sole, 0.04, 1, shin, (0, y, 0.09), ACROSS, (-0.4, 0.6))
        limbs[arm] = Limb(above, 0.045, 2, "chest", (0, 0.2 * s, 1.41), DOWN, (-0.8, 0.8), 1.6)
        limbs[forearm] = Limb(below, 0.04, 1.5, arm, (0, outer, 1.11), ACROSS, (-2.3, 0))
    return limbs


MIDDLE = np.array([0, 0, 1.0])  # of a doll, about which it is turned
REACH = 1.0  # from there [m]
RISE, TREAD, WIDE = 0.28, 0.34, 4.0  # of a step [m]
DAMPING = 1.0  # of hinges [N m s/rad]
LANDING = 1.5  # behind the topmost step [m]
SEGMENTS = 16  # around limbs, as they are recorded
APART = 2.0  # of the middles of dolls at the start [m]


def _along(d: Array) -> Array:
    """The quaternion that turns the z axis to a direction."""
    x, y, z = d / np.linalg.norm(d)
    q = np.array([1.0, 0, 0, 0]) if z < -0.999 else np.array([1 + z, -y, x, 0])
    return q / np.linalg.norm(q)


class Ragdolls(Solids):
    """Ragdolls above stairs, and how far their joints were apart at most.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    seed : int
        Of how the dolls are turned.
    """

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        super().__init__(parameters)
        self._build_stairs(parameters["steps"])
        random = np.random.default_rng(seed)
        n, steps = parameters["dolls"], parameters["steps"]
        across = max(1, int(WIDE / APART))
        number = np.arange(n)
        place = np.stack([number // across % 2, number % across, number // across // 2], axis=-1)
        x = APART * (place - [0.0, (across - 1) / 2, 0.0])
        x[:, 0] -= (steps - 1) * TREAD - 0.2
        x[:, 2] += steps * RISE + REACH
        x[:, :2] += random.uniform(-0.1, 0.1, (n, 2))
        q = random.normal(size=(n, 4))
        q /= np.linalg.norm(q, axis=1, keepdims=True)
        self._build_dolls(x, q, np.linspace(0, 1, n), (parameters["speed"], 0, 0))
        self.measured = {"joint_error": np.zeros(1), "penetration": np.zeros(1)}

    def _build_stairs(self, steps: int) -> None:
        """Each step is a box from the ground up; they lead down along x to the origin."""
        meshes = []
        for k in range(steps):
            lengths = np.array([TREAD + (LANDING if k == steps - 1 else 0), WIDE, (k + 1) * RISE])
            center = np.array([-k * TREAD - lengths[0] / 2, 0, lengths[2] / 2])
            self.add(Box(lengths), center, motion="static", friction=self.friction)
            meshes.append(shifted(Box(lengths).mesh(), center))
        self.obstacles["stairs"] = joined(meshes)

    def _build_dolls(self, x: Array, q: Array, dye: Array, velocity: Any) -> None:
        """Dolls whose middles are at x, turned by q; each has a colour."""
        limbs, ids = _doll(), {}
        for name, limb in limbs.items():
            ends = np.array(limb.ends, float)
            segment = ends[1] - ends[0]
            shape = Capsule(limb.radius, float(np.linalg.norm(segment)))
            middles = x + rotate(q, ends.mean(axis=0) - MIDDLE)
            turns = multiply(q, np.broadcast_to(_along(segment), q.shape))
            own = {"mass": limb.mass, "velocities": velocity}
            ids[name] = self.put("dolls", shape, middles, turns, dye=dye, segments=SEGMENTS, **own)
        for name, limb in limbs.items():
            if limb.parent:
                anchors = x + rotate(q, np.array(limb.anchor) - MIDDLE)
                axes = rotate(q, np.broadcast_to(np.array(limb.axis, float), x.shape))
                for own, parent, p, n in zip(
                    ids[name], ids[limb.parent], anchors, axes, strict=True
                ):
                    self._join_limb(limb, int(own), int(parent), p, n)

    def _join_limb(self, limb: Limb, own: int, parent: int, anchor: Array, axis: Array) -> None:
        if limb.cone is None:
            damper = SpringMotor(0.0, stiffness=0.0, damping=DAMPING)
            self.hinge(own, parent, anchor, axis, limits=limb.limits, motor=damper)
        else:
            self.ball(own, parent, anchor, axis=axis, limits=limb.limits, cone=limb.cone)

    def after_step(self) -> None:
        """Note how far joints were apart, and bodies in each other."""
        report = self.report
        for name, values in self.measured.items():
            values[0] = max(values[0], getattr(report, name))

    def words(self) -> str:
        """How well joints held, how deep bodies were in each other, and what sleeps."""
        error, depth = (float(values[0]) for values in self.measured.values())
        n = int((self.motions == "dynamic").sum())
        asleep = n - self.diagnostics()["awake"]
        return (
            f"{n // len(_doll())} ragdolls, joints off by at most {error:.2g} m or rad, "
            f"penetration at most {1e3 * depth:.2g} mm; {asleep:.0f} of {n} bodies sleep"
        )


def _box(recording: Recording) -> Array:
    steps = recording.parameters["steps"]
    back = steps * TREAD + LANDING
    return np.array([[-back, -WIDE / 2, 0], [2.4, WIDE / 2, steps * RISE + 0.8]])


SCENE = Scene(
    name="ragdolls",
    doc="Ragdolls fall down stairs, into a heap.",
    parameters={
        "duration": Parameter("time simulated", 6.0, unit="s", above=0),
        "dolls": Parameter("number of dolls", 12, minimum=1, maximum=10_000),
        "steps": Parameter("number of steps of the stairs", 10, minimum=1, maximum=100),
        "speed": Parameter("speed of the dolls at the start, down the stairs", 1.5, unit="m/s"),
        **rigid_parameters(step=1 / 240),
    },
    quick={"duration": 0.2, "dolls": 2},
    build=Ragdolls,
    parts=Solids.parts,
    frame=Solids.frame,
    summary=Ragdolls.words,
    picture=solids_view(
        Camera(-48.0, 16.0),
        "Spectral",
        lambda recording: 0.3,
        _box,
        {"stairs": Look("#b9b2a6")},
    ),
    frames=151,
)
