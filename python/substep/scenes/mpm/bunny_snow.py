"""A mesh filled with snow falls on the edge of a wedge."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Box, Collider, TriangleMesh, box_mesh
from ...mpm import sample_mesh
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from ..deformables import read_obstacle
from .material_points import Points, mpm_parameters, points_view
from .snowball import shells, snow, snow_parameters

if TYPE_CHECKING:
    from ...recording import Recording

RIDGE = 0.35  # sides of the wedge, over the size of the body


def _wedge(size: float, friction: float) -> tuple[Collider, TriangleMesh]:
    """A long box along y whose edge points upwards."""
    sides = size * np.array([RIDGE, 3.0, RIDGE])
    mesh = box_mesh(sides)
    x = mesh.vertices - (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    c = np.sqrt(0.5)
    turned = x @ np.array([[c, 0, -c], [0, 1, 0], [c, 0, c]])
    turned[:, 2] = np.maximum(turned[:, 2], 0)  # what is above the ground
    box = Box(sides, rotation=(np.cos(np.pi / 8), 0.0, np.sin(np.pi / 8), 0.0))
    return Collider(box, friction=friction), TriangleMesh(turned, mesh.faces)


def _build(parameters: dict[str, Any], seed: int) -> Points:
    size = parameters["size"]
    surface, text = read_obstacle(parameters["mesh"], parameters["up"], size)
    spacing = size / parameters["resolution"]
    x, volumes = sample_mesh(surface, spacing, seed=seed)
    turn = np.radians(parameters["turn"])
    x = x @ np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    x[:, 2] += (np.sqrt(0.5) * RIDGE + parameters["height"]) * size - x[:, 2].min()
    velocities = np.zeros_like(x)
    velocities[:, 2] = -parameters["speed"]
    return Points(
        x,
        volumes,
        snow(parameters),
        parameters,
        spacing=spacing,
        part="snow",
        dye=shells(x),
        obstacles={"wedge": _wedge(size, parameters["friction"])},
        lacks={"mesh": text},
        velocities=velocities,
    )


def _summary(points: Points) -> str:
    return "".join(f"{text}; " for text in points.lacks.values()) + points.words()


def _box(recording: Recording) -> NDArray[np.float64]:
    size = recording.parameters["size"]
    return size * np.array([[-1.5, -1.1, 0], [1.5, 1.1, 1.45]])


SCENE = Scene(
    name="bunny-snow",
    doc="A mesh of yours, filled with snow, falls on the edge of a wedge.",
    parameters={
        "duration": Parameter("time simulated", 0.5, unit="s", above=0),
        "mesh": Parameter("file of a surface to be filled with snow", kind=str),
        "up": Parameter("axis of the file that points upwards", "y", choices=("x", "y", "z")),
        "size": Parameter("longest side", 0.5, unit="m", above=0),
        "resolution": Parameter("particles along it", 90, minimum=1, maximum=1000),
        "turn": Parameter("rotation of the body about the vertical", 0.0, unit="degrees"),
        "height": Parameter("height above the wedge at the start, over the size", 0.15, minimum=0),
        "speed": Parameter("speed downwards at the start", 4.0, unit="m/s", minimum=0),
        **snow_parameters(),
        **mpm_parameters(0.5),
    },
    quick={"duration": 0.1, "resolution": 12},
    build=_build,
    parts=Points.parts,
    frame=Points.frame,
    notes=Points.notes,
    summary=_summary,
    picture=points_view(
        Camera(-65.0, 16.0, 0.95),
        "snow",
        "Blues_r",
        limits=(-2.0, 1.0),
        looks={"wedge": Look("#8a7f76")},
        box=_box,
    ),
    frames=51,
)
