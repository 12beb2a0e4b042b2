"""A cloth falls over a ball that turns, or over a mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import (
    Collider,
    Plane,
    SignedDistanceField,
    Sphere,
    TriangleMesh,
    grid_mesh,
    sphere_mesh,
)
from ...pbd import SelfCollision, cloth
from ...pbd.group import Constraint
from ...view import Camera, Look, View
from ..declaration import Parameter, Scene
from ..deformables import read_obstacle
from .position_based import Body, pbd_parameters

if TYPE_CHECKING:
    from ...recording import Recording

CLEARANCE = 0.4  # by which the obstacle grows, over the spacing of the cloth's vertices: contact
# acts at these, and between them something thin would stick out


class Cloth(Body):
    """A square cloth above an obstacle that stands on the ground and turns about the vertical."""

    def __init__(self, parameters: dict[str, Any]) -> None:
        size, n, friction = parameters["size"], parameters["vertices"], parameters["friction"]
        side = parameters["side"] * size
        offset = CLEARANCE * side / (n - 1)
        lacks = {}
        shape: Sphere | SignedDistanceField
        if parameters["mesh"]:
            mesh, lacks["mesh"] = read_obstacle(parameters["mesh"], parameters["up"], size)
            cells = parameters["cells"]
            shape = SignedDistanceField.from_mesh(mesh, size / cells, offset=offset)
            top = float(mesh.vertices[:, 2].max())
        else:
            center, top = (0.0, 0.0, size / 2), size
            mesh = sphere_mesh(size / 2, center, 4)
            shape = Sphere(size / 2 + offset, center)
        spin = (0.0, 0.0, parameters["spin"])
        obstacle = Collider(shape, friction=friction, angular_velocity=spin)
        flat = grid_mesh(n, n, (side, side))
        middle = flat.vertices.mean(axis=0)
        middle[2] -= top + offset + parameters["height"] * size
        self.sheet = TriangleMesh(flat.vertices - middle, flat.faces)
        super().__init__(
            self.sheet.vertices,
            parameters["density"] * self.sheet.vertex_areas,
            _constraints(self.sheet, side / (n - 1), parameters),
            parameters,
            part="cloth",
            topology={"triangles": self.sheet.faces},
            colliders=[obstacle, Collider(Plane(), friction=friction)],
            drawn={"obstacle": mesh},
            turning={"obstacle": obstacle} if parameters["mesh"] else {},  # a ball looks the same
            lacks=lacks,
        )


def _constraints(sheet: TriangleMesh, edge: float, parameters: dict[str, Any]) -> list[Constraint]:
    constraints = cloth(
        sheet, compliance=parameters["compliance"], rigidity=parameters["rigidity"] or None
    )
    if parameters["collide"]:
        constraints.append(
            SelfCollision(sheet.faces, thickness=edge / 3, friction=parameters["friction"])
        )
    return constraints


def _summary(body: Cloth) -> str:
    mesh = "".join(f"{text}; " for text in body.lacks.values())
    ends = body.sheet.vertices[body.sheet.edges]
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    strain = 100 * body.strain(body.sheet.edges, lengths)
    return f"{mesh}{len(body)} vertices, strain {strain:.2g} % rms, {body.words()}"


def _box(recording: Recording) -> NDArray[np.float64]:
    obstacle = np.asarray(recording["obstacle"].points(0))
    margin = 0.3 * recording.parameters["size"]
    low, high = obstacle.min(axis=0) - margin, obstacle.max(axis=0) + margin
    low[2], high[2] = 0.0, high[2] - 0.7 * margin
    return np.array([low, high])


SCENE = Scene(
    name="cloth-ball",
    doc="A cloth falls over a ball that turns and winds it up, or over a mesh of yours.",
    parameters={
        "duration": Parameter("time simulated", 4.0, unit="s", above=0),
        "mesh": Parameter("file of the obstacle's surface; a ball unless given", ""),
        "up": Parameter("axis of the file that points upwards", "y", choices=("x", "y", "z")),
        "size": Parameter("longest side of the obstacle", 1.0, unit="m", above=0),
        "spin": Parameter("spin of the obstacle about the vertical", 2.0, unit="rad/s"),
        "cells": Parameter("cells of the distance field along it", 96, minimum=8, maximum=600),
        "vertices": Parameter("vertices along a side of the cloth", 100, minimum=2, maximum=2000),
        "side": Parameter("length of a side, over the obstacle's size", 1.8, above=0),
        "height": Parameter(
            "height of the cloth above it at the start, likewise", 0.05, above=0.01
        ),
        "collide": Parameter("whether the cloth collides with itself", False),
        "density": Parameter("mass per area", 0.2, unit="kg/m^2", above=0),
        "compliance": Parameter("compliance of the edges", 1e-4, unit="m/N", minimum=0),
        "rigidity": Parameter("flexural rigidity, 0 for none", 1e-4, unit="J", minimum=0),
        **pbd_parameters(20),
    },
    quick={"duration": 0.2, "vertices": 10, "substeps": 5},
    build=lambda parameters, seed: Cloth(parameters),
    parts=Body.parts,
    frame=Body.frame,
    notes=Body.notes,
    summary=_summary,
    picture=View(
        Camera(-60.0, 22.0),
        looks={"cloth": Look("#c8553d"), "obstacle": Look("#b4bac2")},
        box=_box,
        ground=lambda recording: 0.0,
    ),
)
