"""Ropes that hang by one end swing down onto a ball."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Collider, Plane, Sphere, sphere_mesh
from ...pbd import ParticleCollision, rope
from ...view import Camera, Look, View
from ..declaration import Parameter, Scene
from .position_based import Body, pbd_parameters

if TYPE_CHECKING:
    from ...recording import Recording

BALL = np.array([0.0, 0.0, 0.28])  # its centre, over the length of the ropes
RADIUS = 0.28  # likewise
TOP = 0.95  # height of the pins, likewise


class Ropes(Body):
    """Ropes side by side, pinned at one end above a ball, horizontal at first."""

    def __init__(self, parameters: dict[str, Any]) -> None:
        length, n, count = parameters["length"], parameters["segments"] + 1, parameters["ropes"]
        thickness = parameters["thickness"]
        along = np.linspace(0, length, n)
        across = 1.5 * RADIUS * length * (np.arange(count) - (count - 1) / 2) / max(count - 1, 1)
        points = np.zeros((count, n, 3))
        points[:, :, 0] = along
        points[:, :, 1] = across[:, None]
        points[:, :, 2] = TOP * length
        first = n * np.arange(count)
        number = np.arange(n - 1)
        self.edges = (first[:, None, None] + np.stack([number, number + 1], axis=-1)).reshape(-1, 2)
        mass = parameters["density"] * length / (n - 1)
        masses = np.full((count, n), mass)
        masses[:, [0, -1]] *= 0.5
        masses[:, -1] += parameters["weight"]
        friction = parameters["friction"]
        ball = Sphere(RADIUS * length + thickness / 2, BALL * length)
        ground = Plane(point=(0, 0, thickness / 2))
        constraints = [
            constraint
            for k in first
            for constraint in rope(
                n,
                first=int(k),
                compliance=parameters["compliance"],
                bending_compliance=parameters["bending"] or None,
            )
        ]
        constraints.append(ParticleCollision(thickness / 2, friction=friction))
        super().__init__(
            points.reshape(-1, 3),
            masses.ravel(),
            constraints,
            parameters,
            part="rope",
            topology={"edges": self.edges},
            colliders=[Collider(shape, friction=friction) for shape in (ball, ground)],
            drawn={"ball": sphere_mesh(RADIUS * length, BALL * length, 4)},
            pinned=first,
        )
        self.spacing = length / (n - 1)


def _summary(ropes: Ropes) -> str:
    strain = 100 * ropes.strain(ropes.edges, ropes.spacing)
    return f"{len(ropes)} particles, strain {strain:.2g} % rms, {ropes.words()}"


def _box(recording: Recording) -> NDArray[np.float64]:
    length = recording.parameters["length"]
    return length * np.array([[-0.5, -0.35, 0], [0.6, 0.35, TOP]])


SCENE = Scene(
    name="rope",
    doc="Ropes that hang by one end swing down onto a ball.",
    parameters={
        "duration": Parameter("time simulated", 4.0, unit="s", above=0),
        "ropes": Parameter("number of ropes", 12, minimum=1, maximum=10_000),
        "segments": Parameter("segments of each", 100, minimum=1, maximum=1_000_000),
        "length": Parameter("length of each", 2.0, unit="m", above=0),
        "thickness": Parameter("thickness of the ropes", 0.03, unit="m", above=0),
        "density": Parameter("mass per length", 0.3, unit="kg/m", above=0),
        "weight": Parameter("mass at the free end", 0.2, unit="kg", minimum=0),
        "compliance": Parameter("compliance of a segment", 0.0, unit="m/N", minimum=0),
        "bending": Parameter(
            "compliance of the distance across two segments, 0 for none",
            2e-3,
            unit="m/N",
            minimum=0,
        ),
        **pbd_parameters(40),
    },
    quick={"duration": 0.2, "ropes": 3, "segments": 12, "substeps": 5},
    build=lambda parameters, seed: Ropes(parameters),
    parts=Body.parts,
    frame=Body.frame,
    notes=Body.notes,
    summary=_summary,
    picture=View(
        Camera(-50.0, 16.0),
        {
            "rope": Look("#c8553d", radius=lambda r: r.parameters["thickness"] / 2),
            "ball": Look("#8fa3b5"),
        },
        box=_box,
        ground=lambda recording: 0.0,
    ),
)
