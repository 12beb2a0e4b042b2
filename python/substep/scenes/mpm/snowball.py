"""A snowball is thrown against a wall, and bursts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Box, Collider, TriangleMesh, box_mesh
from ...mpm import Snow, sample_sphere
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from .material_points import Points, mpm_parameters, points_view

if TYPE_CHECKING:
    from ...recording import Recording

WALL = np.array([0.4, 6.0, 5.0])  # thickness, width and height, in radii of the ball
AWAY, ABOVE = 2.0, 3.0  # of the ball at the start: from the wall, and from the ground


def snow_parameters(stretch: float = 0.0075) -> dict[str, Parameter]:
    """Constants of snow (Stomakhin et al., 2013, table 2).

    Parameters
    ----------
    stretch : float
        Default of the one at which it breaks; the table's unless given.

    Returns
    -------
    dict of str to Parameter
        By key.
    """
    return {
        "density": Parameter("mass per volume", 400.0, unit="kg/m^3", above=0),
        "young": Parameter("Young's modulus", 1.4e5, unit="Pa", above=0),
        "compression": Parameter("compression at which it yields", 0.025, above=0, maximum=0.5),
        "stretch": Parameter("stretch at which it breaks", stretch, above=0, maximum=0.5),
        "hardening": Parameter("hardening of compressed snow", 10.0, minimum=0),
    }


def snow(parameters: dict[str, Any]) -> Snow:
    """The material.

    Parameters
    ----------
    parameters : dict
        Of the scene, with those of `snow_parameters`.

    Returns
    -------
    Snow
        With its constants.
    """
    return Snow(
        density=parameters["density"],
        young_modulus=parameters["young"],
        critical_compression=parameters["compression"],
        critical_stretch=parameters["stretch"],
        hardening=parameters["hardening"],
    )


def shells(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance from the middle, over the largest one."""
    away = np.linalg.norm(x - x.mean(axis=0), axis=1)
    dye: NDArray[np.float64] = away / away.max()
    return dye


def _build(parameters: dict[str, Any], seed: int) -> Points:
    r = parameters["radius"]
    spacing = float(4 / 3 * np.pi * r**3 / parameters["particles"]) ** (1 / 3)
    center = np.array([-(AWAY + 1) * r, 0.0, ABOVE * r])
    x, volumes = sample_sphere(center, r, spacing, seed=seed)
    sides = r * WALL
    middle = np.array([sides[0] / 2, 0.0, sides[2] / 2])
    mesh = box_mesh(sides)
    shift = middle - (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    wall = Collider(Box(sides, middle), friction=parameters["friction"])
    return Points(
        x,
        volumes,
        snow(parameters),
        parameters,
        spacing=spacing,
        part="snow",
        dye=shells(x),
        obstacles={"wall": (wall, TriangleMesh(mesh.vertices + shift, mesh.faces))},
        boundary=("separate", parameters["wall"]),
        velocities=np.tile([parameters["speed"], 0.0, 0.1 * parameters["speed"]], (len(x), 1)),
    )


def _box(recording: Recording) -> NDArray[np.float64]:
    r = recording.parameters["radius"]
    return r * np.array([[-3.2, -3.4, 0], [0.4, 3.4, 5.8]])


SCENE = Scene(
    name="snowball",
    doc="A snowball is thrown against a wall, and bursts.",
    parameters={
        "duration": Parameter("time simulated", 0.12, unit="s", above=0),
        "particles": Parameter(
            "approximate number of particles", 80_000, minimum=1, maximum=50_000_000
        ),
        "radius": Parameter("radius of the ball", 0.1, unit="m", above=0),
        "speed": Parameter("speed of the throw along the ground", 12.0, unit="m/s", minimum=0),
        "wall": Parameter("what the snow does there", "sticky", choices=("sticky", "separate")),
        **snow_parameters(stretch=0.005),
        **mpm_parameters(0.5),
    },
    quick={"duration": 0.05, "particles": 800},
    build=_build,
    parts=Points.parts,
    frame=Points.frame,
    notes=Points.notes,
    summary=Points.words,
    picture=points_view(
        Camera(-140.0, 14.0),
        "snow",
        "Blues_r",
        limits=(-2.0, 1.0),
        looks={"wall": Look("#8a7f76")},
        box=_box,
    ),
    frames=61,
)
