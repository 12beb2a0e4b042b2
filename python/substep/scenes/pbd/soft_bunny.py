"""A soft body tumbles down a flight of steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import (
    Box,
    Collider,
    Plane,
    TetMesh,
    TriangleMesh,
    box_mesh,
    sphere_mesh,
)
from ...pbd import soft_body
from ...view import Camera, Look, View
from ..declaration import Parameter, Scene
from ..deformables import fill, read_obstacle
from .position_based import Body, pbd_parameters

if TYPE_CHECKING:
    from ...recording import Recording

STEPS = 3
RISE, RUN, ACROSS = 0.45, 0.9, 2.2  # of a step, and its width, over the size of the body


class SoftBunny(Body):
    """An elastic solid above the highest of some steps."""

    def __init__(self, parameters: dict[str, Any]) -> None:
        size, friction = parameters["size"], parameters["friction"]
        lacks = {}
        if parameters["mesh"]:
            surface, lacks["mesh"] = read_obstacle(parameters["mesh"], parameters["up"], size)
        else:
            surface = sphere_mesh(size / 2, subdivisions=4)
        solid, filling = fill(surface, size, parameters["cells"])
        if parameters["mesh"]:
            lacks["filling"] = filling
        x = solid.vertices - solid.vertices.mean(axis=0)
        turn = np.radians(parameters["turn"])
        x = x @ np.array(
            [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
        )
        x[:, 2] += (STEPS * RISE + parameters["height"]) * size - x[:, 2].min()
        self.solid = TetMesh(x, solid.tetrahedra)
        margin = 2e-3 * size
        boxes, steps = [], {}
        for k in range(STEPS):
            sides = size * np.array([(k + 1) * RUN, ACROSS, RISE])
            low = size * np.array([-0.5 * RUN, -0.5 * ACROSS, (STEPS - 1 - k) * RISE])
            center = low + sides / 2
            boxes.append(Box(sides, center))
            steps[f"step{k}"] = _at(center, sides)
        velocity = np.zeros_like(x)
        velocity[:, 0] = parameters["speed"]
        super().__init__(
            x,
            parameters["density"] * self.solid.vertex_volumes,
            soft_body(
                self.solid,
                young_modulus=parameters["young"],
                poisson_ratio=parameters["poisson"],
                damping_time=parameters["damping_time"],
            ),
            parameters,
            part="body",
            topology={"tetrahedra": self.solid.tetrahedra},
            colliders=[Collider(shape, friction=friction) for shape in (Plane(), *boxes)],
            drawn=steps,
            lacks=lacks,
            velocities=velocity,
            contact_margin=margin,
        )

    def volume(self) -> float:
        """Volume now over that at rest."""
        a, b, c, d = (self.positions[self.solid.tetrahedra[:, k]] for k in range(4))
        now = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a).sum() / 6
        return float(now / self.solid.volume)


def _at(center: NDArray[np.float64], sides: NDArray[np.float64]) -> TriangleMesh:
    mesh = box_mesh(sides)
    middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    return TriangleMesh(mesh.vertices - middle + center, mesh.faces)


def _summary(body: SoftBunny) -> str:
    lacks = "".join(f"{text}; " for text in body.lacks.values())
    return (
        f"{lacks}{len(body.solid.tetrahedra)} tetrahedra, volume {body.volume():.3f} times that at "
        f"rest, {body.words()}"
    )


def _box(recording: Recording) -> NDArray[np.float64]:
    """The steps and as much ground again."""
    size = recording.parameters["size"]
    return size * np.array(
        [[-0.5 * RUN, -0.5 * ACROSS, 0], [3.6 * RUN, 0.5 * ACROSS, STEPS * RISE + 0.6]]
    )


SCENE = Scene(
    name="soft-bunny",
    doc="A soft body, a ball or a mesh of yours, tumbles down a flight of steps.",
    parameters={
        "duration": Parameter("time simulated", 3.0, unit="s", above=0),
        "mesh": Parameter(
            "file of a surface to be filled with tetrahedra; a ball unless given", ""
        ),
        "up": Parameter("axis of the file that points upwards", "y", choices=("x", "y", "z")),
        "size": Parameter("longest side", 0.2, unit="m", above=0),
        "cells": Parameter("cells along it", 16, minimum=1, maximum=200),
        "turn": Parameter("rotation of the body about the vertical", 0.0, unit="degrees"),
        "height": Parameter(
            "height above the highest step at the start, over the size", 0.3, above=0.01
        ),
        "speed": Parameter("down the steps at the start", 0.6, unit="m/s"),
        "density": Parameter("mass per volume", 1000.0, unit="kg/m^3", above=0),
        "young": Parameter("Young's modulus", 3e4, unit="Pa", above=0),
        "poisson": Parameter("Poisson's ratio", 0.4, minimum=0, maximum=0.49),
        "damping_time": Parameter("viscous stress over strain rate", 1e-3, unit="s", minimum=0),
        **pbd_parameters(20),
    },
    quick={"duration": 0.2, "cells": 3, "substeps": 5},
    build=lambda parameters, seed: SoftBunny(parameters),
    parts=Body.parts,
    frame=Body.frame,
    notes=Body.notes,
    summary=_summary,
    picture=View(
        Camera(-62.0, 20.0), {"body": Look("#d9566b")}, box=_box, ground=lambda recording: 0.0
    ),
)
