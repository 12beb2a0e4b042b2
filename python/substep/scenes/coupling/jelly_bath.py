"""A ring of jelly and rigid bodies fall into a bath, and float."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Box, Collider, Plane, Sphere, TetMesh, box_tetrahedra
from ...gridfluid import GridLiquid
from ...mpm import sample_box
from ...springs import SoftBody
from ...view import Camera, Look, View
from ..declaration import Parameter, Scene
from ..rigid.rigid_bodies import Solid, Solids
from ..tanks import EDGES, InTank, radius, tank_box
from .coupled import Coupled, add_walls

if TYPE_CHECKING:
    from ...recording import Part

Array = NDArray[np.float64]

DEPTH, RIM = 0.3, 0.55  # of the water, and the height of the tank, over its length
RING, TUBE = 0.24, 0.09  # radii of the ring's middle line and of its tube, likewise
AROUND, ACROSS = 24, 2  # cubes of tetrahedra around the ring and across its tube
DROP = 0.14  # of its middle above the water at the start, likewise
DENSITIES = (150.0, 800.0)  # of the bodies [kg/m^3]


def ring(radius: float, tube: float, around: int, across: int) -> TetMesh:
    """A torus of tetrahedra about the z axis.

    Parameters
    ----------
    radius, tube : float
        Of its middle line and of its tube [m].
    around, across : int
        How many cubes, of six tetrahedra each, along its middle line and across its tube.

    Returns
    -------
    TetMesh
        A bar whose ends are one, bent, with its square of cubes pulled to a disk.
    """
    bar = box_tetrahedra((1.0, 2.0, 2.0), (around, across, across))
    x = bar.vertices - bar.vertices.min(axis=0)
    square = x[:, 1:] - 1
    largest = np.abs(square).max(axis=1)
    length = np.linalg.norm(square, axis=1)
    disk = tube * square * (largest / np.where(length > 0, length, 1))[:, None]
    places = np.c_[np.where(x[:, 0] < 1 - 1e-9, x[:, 0], 0), square]  # of the ends the same
    _, same = np.unique(np.round(places, 9), axis=0, return_inverse=True)
    first = np.zeros(same.max() + 1, np.int64)
    first[same.ravel()[::-1]] = np.arange(len(x))[::-1]
    angle = -2 * math.pi * x[:, 0]
    r = radius + disk[:, 0]
    bent = np.c_[r * np.cos(angle), r * np.sin(angle), disk[:, 1]]
    return TetMesh(bent[first], same.ravel()[bar.tetrahedra])


class Jelly(SoftBody):
    """The ring, above the water.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    bodies : Solids
        That it meets.
    """

    def __init__(self, parameters: dict[str, Any], bodies: Solids) -> None:
        length = parameters["length"]
        mesh = ring(RING * length, TUBE * length, AROUND, ACROSS)
        tilt = math.radians(parameters["tilt"])
        c, s = math.cos(tilt), math.sin(tilt)
        turned = mesh.vertices @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T
        middle = length * np.array([0.5, 0.5, DEPTH + DROP])
        walls = [
            Collider(Plane((1, 0, 0))),
            Collider(Plane((-1, 0, 0), (length, 0, 0))),
            Collider(Plane((0, 1, 0))),
            Collider(Plane((0, -1, 0), (0, length, 0))),
            Collider(Plane()),
        ]
        dynamic = np.flatnonzero(bodies.motions == "dynamic")
        super().__init__(
            turned + middle,
            mesh.tetrahedra,
            density=parameters["density"],
            young_modulus=parameters["young"],
            poisson_ratio=parameters["poisson"],
            damping_time=parameters["damping_time"],
            colliders=[*walls, *bodies.make_colliders(dynamic)],
            step=parameters["step"],
            contact_margin=0.01 * length,
        )

    def parts(self) -> dict[str, Part]:
        """The jelly as a mesh with its velocity."""
        from ...recording import Part

        return {
            "jelly": Part("mesh", {"velocity": "m/s"}, tetrahedra=self.mesh.tetrahedra),
        }

    def frame(self) -> dict[str, dict[str, Any]]:
        """Positions as float64, velocities as float32."""
        velocity = self.velocities.astype(np.float32)
        return {"jelly": {"points": self.positions.copy(), "velocity": velocity}}


class Bath(InTank, GridLiquid):
    """The tank with its water, the bodies and the jelly in it."""

    def __init__(self, parameters: dict[str, Any], bodies: Solids, jelly: Jelly, seed: int) -> None:
        cells, length = parameters["cells"], parameters["length"]
        cell = length / cells
        self.tank = cell * np.array([cells, cells, math.ceil(RIM * cells)])
        self.spacing, self.obstacles, self.lacks = cell / 2, {}, {}
        water, _ = sample_box(
            (0, 0, 0), (length, length, DEPTH * length), self.spacing, jitter=0.8, seed=seed
        )
        dynamic = np.flatnonzero(bodies.motions == "dynamic")
        colliders = [*bodies.make_colliders(dynamic), *jelly.make_colliders(2.01 * cell)]
        super().__init__(water, cell=cell, bounds=(np.zeros(3), self.tank), colliders=colliders)


class JellyBath(Coupled):
    """The bodies, the jelly and the water.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    seed : int
        Of the bodies' turns and the water's places.
    """

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        bodies = Solids({**parameters, "step": 1 / 60, "substeps": 8})
        random = np.random.default_rng(seed)
        length, n = parameters["length"], parameters["bodies"]
        add_walls(bodies, length, length)
        size = 0.055 * length
        shapes: list[Solid] = [Sphere(1.2 * size), Box((2 * size,) * 3)]
        places = np.array([[0.5, 0.5], [0.14, 0.14], [0.86, 0.86], [0.14, 0.86], [0.86, 0.14]])
        density = np.linspace(*DENSITIES, max(n, 2))
        for k in range(n):
            x = [*length * places[k % 5], length * (DEPTH + 0.1 + 0.16 * (k // 5))]
            turn = random.normal(size=4)
            dye = (density[k] - DENSITIES[0]) / (DENSITIES[1] - DENSITIES[0])
            shape = shapes[k % len(shapes)]
            bodies.put("solids", shape, [x], [turn], dye=[dye], density=density[k], segments=48)
        jelly = Jelly(parameters, bodies)
        water = Bath(parameters, bodies, jelly, seed)
        super().__init__(
            {"bodies": bodies, "water": water, "jelly": jelly}, step=parameters["step"]
        )

    def words(self) -> str:
        """How deep the jelly lies in the end."""
        jelly, water = self["jelly"], self["water"]
        middle = float(jelly.masses @ jelly.positions[:, 2] / jelly.masses.sum())
        return (
            f"{len(jelly.faces)} triangles of jelly, their middle at {middle:.3f} m over "
            f"{DEPTH * self._length():.3g} m of water; {len(water)} particles; last step "
            f"{water.report.iterations} iterations"
        )

    def _length(self) -> float:
        return float(self["water"].tank[0])


SCENE = Scene(
    name="jelly-bath",
    doc="A ring of soft jelly and rigid bodies fall into a bath, and float.",
    parameters={
        "duration": Parameter("time simulated", 3.0, unit="s", above=0),
        "cells": Parameter("cells along the tank", 40, minimum=24, maximum=400),
        "length": Parameter("length of the tank", 1.0, unit="m", above=0),
        "bodies": Parameter("number of rigid bodies", 5, minimum=0, maximum=20),
        "density": Parameter("density of the jelly", 500.0, unit="kg/m^3", above=0),
        "young": Parameter("Young's modulus of the jelly", 2e4, unit="Pa", above=0),
        "poisson": Parameter("Poisson's ratio of the jelly", 0.4, minimum=0, maximum=0.49),
        "damping_time": Parameter(
            "viscous stress of the jelly over strain rate", 5e-3, unit="s", minimum=0
        ),
        "tilt": Parameter("tilt of the jelly at the start", 25.0, unit="degrees"),
        "friction": Parameter("coefficient of friction", 0.3, minimum=0),
        "step": Parameter("interval of exchange", 1 / 120, unit="s", above=0),
    },
    quick={"duration": 0.02, "cells": 24, "bodies": 1},
    build=JellyBath,
    parts=Coupled.parts,
    frame=Coupled.frame,
    notes=Coupled.notes,
    summary=JellyBath.words,
    picture=View(
        Camera(-60.0, 24.0),
        {
            "jelly": Look("#d9566b"),
            "bodies": Look(hidden=True),
            "liquid": Look(liquid=True, radius=radius),
            "tank": Look(EDGES),
        },
        color="dye",
        palette="YlOrRd",
        limits=(0, 255),
        bar=False,
        box=tank_box,
        ground=lambda recording: 0.0,
    ),
    frames=91,
)
