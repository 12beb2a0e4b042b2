"""A soft body falls on the ground, or on an incline."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import (
    Collider,
    Plane,
    TetMesh,
    TriangleMesh,
    box_tetrahedra,
    sphere_mesh,
)
from ...springs import SoftBody
from ...view import Camera, Look, View
from ..declaration import Parameter, Scene
from ..deformables import GRAVITY, Watched, fill, read_obstacle, solver_parameters

if TYPE_CHECKING:
    from ...recording import Recording


class Jelly(Watched, SoftBody):
    """An elastic solid above a plane."""

    part = "jelly"

    def __init__(self, parameters: dict[str, Any]) -> None:
        size = parameters["size"]
        self.lacks = {}
        vertices, tetrahedra = self._solid(parameters)
        incline = _about_y(parameters["incline"])
        vertices = (vertices - vertices.mean(axis=0)) @ _about_y(parameters["tilt"]).T
        vertices[:, 2] += parameters["height"] * size - vertices[:, 2].min()
        half = 1.5 * size
        corners = half * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        corners[:, 0] += half * (parameters["incline"] > 0)  # it goes down to the right
        slope = TriangleMesh(corners @ incline.T, [[0, 1, 2], [0, 2, 3]])
        self.obstacles = {"slope": slope} if parameters["incline"] else {}
        mass = parameters["density"] * TetMesh(vertices, tetrahedra).volume / len(vertices)
        super().__init__(
            vertices @ incline.T,
            tetrahedra,
            density=parameters["density"],
            young_modulus=parameters["young"],
            poisson_ratio=parameters["poisson"],
            model=parameters["model"],
            damping_time=parameters["damping_time"],
            colliders=[Collider(Plane(incline[:, 2]), friction=parameters["friction"])],
            drag=parameters["drag"],
            integrator=parameters["integrator"],
            step=parameters["step"],
            tolerance=parameters["tolerance"] * mass * GRAVITY,
            contact_margin=2e-3 * size,
        )
        self.watch(room=0.5 * size)

    def _solid(self, parameters: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Vertices and tetrahedra of the chosen shape."""
        size, cells = parameters["size"], parameters["cells"]
        if not parameters["mesh"] and parameters["shape"] == "box":
            box = box_tetrahedra((size, size, size), (cells, cells, cells))
            return box.vertices, box.tetrahedra
        if parameters["mesh"]:
            surface, self.lacks["mesh"] = read_obstacle(parameters["mesh"], parameters["up"], size)
        else:
            surface = sphere_mesh(size / 2, subdivisions=4)
        solid, filling = fill(surface, size, cells)
        if parameters["mesh"]:
            self.lacks["filling"] = filling
        return solid.vertices, solid.tetrahedra

    def volume(self) -> float:
        """Volume now over that at rest."""
        a, b, c, d = (self.positions[self.mesh.tetrahedra[:, k]] for k in range(4))
        now = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a).sum() / 6
        return float(now / self.mesh.volume)


def _about_y(degrees: float) -> NDArray[np.float64]:
    """Rotation about the y axis, by which x goes downwards."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _summary(jelly: Jelly) -> str:
    lacks = "".join(f"{text}; " for text in jelly.lacks.values())
    distance = 1e3 * jelly.diagnostics()["distance"]
    return (
        f"{lacks}{len(jelly.mesh.tetrahedra)} tetrahedra, {jelly.still()}, volume "
        f"{jelly.volume():.3f} times that at rest, smallest distance to the ground "
        f"{distance:.2g} mm; {jelly.work()}"
    )


def _box(recording: Recording) -> NDArray[np.float64]:
    """What the body reaches, but of a slope only what lies below it."""
    frames = np.linspace(0, len(recording) - 1, min(len(recording), 60)).astype(int)
    points = np.concatenate([recording["jelly"].points(int(k)) for k in frames])
    low, high = points.min(axis=0), points.max(axis=0)
    if not recording.parameters["incline"]:
        low[2] = 0.0
    return np.array([low, high])


def _ground(recording: Recording) -> float | None:
    return None if recording.parameters["incline"] else 0.0


SCENE = Scene(
    name="jelly",
    doc="A soft body, a box, a ball or a mesh of yours, falls on the ground or on an incline.",
    parameters={
        "duration": Parameter("time simulated", 2.0, unit="s", above=0),
        "shape": Parameter("what falls, unless it is a mesh", "box", choices=("box", "ball")),
        "mesh": Parameter("file of a surface to be filled with tetrahedra", ""),
        "up": Parameter("axis of the file that points upwards", "y", choices=("x", "y", "z")),
        "size": Parameter("longest side", 0.2, unit="m", above=0),
        "cells": Parameter("cells along it", 10, minimum=1, maximum=200),
        "tilt": Parameter("tilt of the body at the start", 20.0, unit="degrees"),
        "height": Parameter("height above the ground at the start, over the size", 0.5, above=0.01),
        "incline": Parameter("slope of the ground", 0.0, unit="degrees", minimum=0, maximum=80),
        "friction": Parameter("coefficient of friction", 0.5, minimum=0),
        "density": Parameter("mass per volume", 1000.0, unit="kg/m^3", above=0),
        "young": Parameter("Young's modulus", 2e4, unit="Pa", above=0),
        "poisson": Parameter("Poisson's ratio", 0.4, minimum=0, maximum=0.49),
        "model": Parameter(
            "elastic energy", "neo_hookean", choices=("neo_hookean", "st_venant_kirchhoff")
        ),
        "damping_time": Parameter("viscous stress over strain rate", 2e-3, unit="s", minimum=0),
        **solver_parameters(0.01, 0.1),
    },
    quick={"duration": 0.2, "cells": 3},
    build=lambda parameters, seed: Jelly(parameters),
    parts=Watched.parts,
    frame=Watched.frame,
    notes=Watched.notes,
    summary=_summary,
    picture=View(Camera(-70.0, 14.0), {"jelly": Look("#d9566b")}, box=_box, ground=_ground),
)
