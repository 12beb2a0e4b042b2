"""A cloth falls over an obstacle and comes to rest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Collider, Plane, SignedDistanceField, Sphere, grid_mesh, sphere_mesh
from ...springs import MassSpring, grid_springs
from ...view import Camera, Look, View
from ..declaration import Parameter, Scene
from ..deformables import GRAVITY, Watched, read_obstacle, solver_parameters

if TYPE_CHECKING:
    from ...recording import Recording

THICKNESS = 0.006  # of the cloth, over the obstacle's size
CLEARANCE = 0.4  # by which the obstacle grows, over the spacing of the cloth's vertices: contact
# acts at these, and between them something thin would stick out


class DrapedCloth(Watched, MassSpring):
    """A square cloth above an obstacle that stands on the ground."""

    part = "cloth"

    def __init__(self, parameters: dict[str, Any]) -> None:
        size, friction = parameters["size"], parameters["friction"]
        self.lacks = {}
        thickness = THICKNESS * size
        n, side = parameters["vertices"], parameters["side"] * size
        offset = max(thickness, CLEARANCE * side / (n - 1))
        obstacle: Sphere | SignedDistanceField
        if parameters["mesh"]:
            mesh, text = read_obstacle(parameters["mesh"], parameters["up"], size)
            self.lacks["mesh"] = text
            obstacle = SignedDistanceField.from_mesh(
                mesh, size / parameters["cells"], offset=offset
            )
            top = float(mesh.vertices[:, 2].max())
        else:
            center = (0.0, 0.0, size / 2)
            mesh = sphere_mesh(size / 2, center, 4)
            obstacle = Sphere(size / 2 + offset, center)
            top = size
        self.obstacles = {"obstacle": mesh}
        grid = grid_mesh(n, n, (side, side))
        angle = np.radians(parameters["turn"])
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0]])
        flat = (grid.vertices - grid.vertices.mean(axis=0))[:, :2] @ turn
        positions = flat + np.array([0, 0, top + offset + parameters["height"] * size])
        edges, stiffness = grid_springs(
            n,
            n,
            stiffness=parameters["stiffness"],
            shear=parameters["shear"],
            bending=parameters["bending"],
        )
        mass = parameters["density"] * side**2 / n**2
        super().__init__(
            positions,
            edges,
            stiffness,
            mass,
            damping=parameters["damping_time"] * stiffness,
            faces=grid.faces,
            colliders=[Collider(shape, friction=friction) for shape in (obstacle, Plane())],
            drag=parameters["drag"],
            integrator=parameters["integrator"],
            step=parameters["step"],
            tolerance=parameters["tolerance"] * mass * GRAVITY,
            contact_margin=thickness,
        )
        self.watch(room=0.5 * size)


def _summary(cloth: DrapedCloth) -> str:
    mesh = "; ".join(cloth.lacks.values())
    distance = 1e3 * cloth.diagnostics()["distance"]
    return (
        f"{mesh + '; ' if mesh else ''}{len(cloth)} vertices of cloth, {cloth.still()}, "
        f"smallest distance to the obstacle {distance:.2g} mm; {cloth.work()}"
    )


def _box(recording: Recording) -> NDArray[np.float64]:
    obstacle = np.asarray(recording.parts["obstacle"].points)
    low, high = obstacle.min(axis=0), obstacle.max(axis=0)
    margin = 0.18 * recording.parameters["size"]
    return np.array(
        [[low[0] - margin, low[1] - margin, 0], [*high[:2] + margin, high[2] + 0.1 * margin]]
    )


SCENE = Scene(
    name="cloth-drape",
    doc="A cloth falls over an obstacle, a ball or a mesh of yours, and comes to rest.",
    parameters={
        "duration": Parameter("time simulated", 4.0, unit="s", above=0),
        "mesh": Parameter("file of the obstacle's surface; a ball unless given", ""),
        "up": Parameter("axis of the file that points upwards", "y", choices=("x", "y", "z")),
        "size": Parameter("longest side of the obstacle", 1.0, unit="m", above=0),
        "cells": Parameter("cells of the distance field along it", 96, minimum=8, maximum=600),
        "vertices": Parameter("vertices along a side of the cloth", 64, minimum=2, maximum=2000),
        "side": Parameter("length of a side, over the obstacle's size", 1.3, above=0),
        "height": Parameter(
            "height of the cloth above it at the start, likewise", 0.05, above=0.01
        ),
        "turn": Parameter("rotation of the cloth about the vertical", 20.0, unit="degrees"),
        "density": Parameter("mass per area", 0.3, unit="kg/m^2", above=0),
        "stiffness": Parameter(
            "stiffness of the springs between neighbours", 200.0, unit="N/m", above=0
        ),
        "shear": Parameter("stiffness of the diagonals, as a part of that", 0.3, minimum=0),
        "bending": Parameter("stiffness across every second vertex, likewise", 0.02, minimum=0),
        "damping_time": Parameter(
            "damping time of the springs, over their stiffness", 5e-3, unit="s", minimum=0
        ),
        "friction": Parameter("coefficient of friction", 0.4, minimum=0),
        **solver_parameters(0.02, 1.0),
    },
    quick={"duration": 0.2, "vertices": 12},
    build=lambda parameters, seed: DrapedCloth(parameters),
    parts=Watched.parts,
    frame=Watched.frame,
    notes=Watched.notes,
    summary=_summary,
    picture=View(
        Camera(-60.0, 20.0), looks={"cloth": Look("#3f7ea6")}, box=_box, ground=lambda r: 0.0
    ),
)
