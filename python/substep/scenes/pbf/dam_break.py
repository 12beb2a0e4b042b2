"""A column of water, or a mesh filled with it, collapses in a tank."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...geometry import Box, Collider, TriangleMesh, box_mesh
from ...pbf import fill_mesh
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from ..deformables import read_obstacle
from ..tanks import liquid_view
from .liquids import Liquid, column, liquid_parameters

PLACE = 0.72  # of the pillar along the tank
PILLAR = np.array([0.08, 0.22, 0.45])  # lengths, over those of the tank


def _build(parameters: dict[str, Any], seed: int) -> Liquid:
    width, height, depth = (parameters[key] for key in ("width", "height", "depth"))
    length = parameters["length"]
    if width > length:
        raise InputError(f"width: a column of {width:g} m does not fit into a tank of {length:g} m")
    if parameters["pillar"] and width > (PLACE - PILLAR[0] / 2) * length:
        raise InputError(f"pillar: it would be inside the column, which is {width:g} m wide")
    if parameters["mesh"]:
        positions, spacing, text = _filled(parameters, np.array([width, depth, height]))
        lacks = {"mesh": text}
    else:
        spacing = (width * height * depth / parameters["particles"]) ** (1 / 3)
        depth = spacing * max(1, round(depth / spacing))  # whole particles between the walls
        positions, lacks = column((0, 0, 0), (width, depth, height), spacing), {}
    tank = np.array([length, depth, parameters["rim"]])
    obstacles = {}
    if parameters["pillar"]:
        sides = PILLAR * tank
        center = np.array([PLACE * tank[0], 0.5 * tank[1], 0.5 * sides[2]])
        mesh = box_mesh(sides)
        middle = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
        placed = TriangleMesh(mesh.vertices - middle + center, mesh.faces)
        obstacles["pillar"] = (
            Collider(Box(sides, center), friction=parameters["friction"]),
            placed,
        )
    return Liquid(positions, spacing, parameters, tank, obstacles=obstacles, lacks=lacks)


def _filled(
    parameters: dict[str, Any], room: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float, str]:
    """Particles inside a mesh that is as large as the room that the column would take."""
    mesh, text = read_obstacle(parameters["mesh"], parameters["up"], 1.0)
    sides = np.ptp(mesh.vertices[mesh.faces].reshape(-1, 3), axis=0)
    scale = float(np.min(room / sides))
    mesh = TriangleMesh(scale * mesh.vertices + [room[0] / 2, room[1] / 2, 0], mesh.faces)
    longest = scale * float(sides.max())
    coarse = longest / 64
    volume = coarse**3 * len(fill_mesh(mesh, coarse, margin=0.0))
    spacing = (volume / parameters["particles"]) ** (1 / 3)
    return fill_mesh(mesh, spacing), spacing, text


def _summary(liquid: Liquid) -> str:
    mesh = "".join(f"{text}; " for text in liquid.lacks.values())
    front = float(np.quantile(liquid.positions[:, 0], 0.99))
    return f"{mesh}99 % of it is within {front:.2f} m; {liquid.words()}"


SCENE = Scene(
    name="dam-break",
    doc="A column of water, or a mesh of yours filled with it, collapses in a tank.",
    parameters={
        "duration": Parameter("time simulated", 1.5, unit="s", above=0),
        "particles": Parameter(
            "approximate number of particles", 100_000, minimum=1, maximum=20_000_000
        ),
        "width": Parameter("width of the column, along the tank", 1.0, unit="m", above=0),
        "height": Parameter("height of the column", 1.2, unit="m", above=0),
        "depth": Parameter("depth of the column and the tank", 0.8, unit="m", above=0),
        "length": Parameter("length of the tank", 3.0, unit="m", above=0),
        "rim": Parameter("height of the tank as drawn", 1.5, unit="m", above=0),
        "pillar": Parameter("whether a pillar stands in the way", True),
        "mesh": Parameter("file of a surface to be filled with water in place of the column", ""),
        "up": Parameter("axis of the file that points upwards", "y", choices=("x", "y", "z")),
        **liquid_parameters(),
    },
    quick={"duration": 0.1, "particles": 400},
    build=_build,
    parts=Liquid.parts,
    frame=Liquid.frame,
    notes=Liquid.notes,
    summary=_summary,
    picture=liquid_view(Camera(-60.0, 18.0), {"liquid": None}, {"pillar": Look("#d98f4e")}),
    frames=76,
)
