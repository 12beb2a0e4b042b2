"""Bodies of many densities are washed away by a breaking dam; the light ones float."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Box, Capsule, Cylinder, Sphere
from ...gridfluid import GridLiquid
from ...mpm import sample_box
from ...view import Camera, Look, View
from ..declaration import Parameter, Scene
from ..rigid.rigid_bodies import Solid, Solids
from ..tanks import EDGES, InTank, radius, tank_box
from .coupled import Coupled, add_walls

Array = NDArray[np.float64]

WIDTH, RIM = 0.35, 0.4  # of the tank, and its height, over its length
COLUMN = (0.3, 0.3)  # length and height of the water that breaks, likewise
POOL = 0.08  # depth of the water before it, likewise
DENSITIES = (100.0, 1200.0)  # of the bodies [kg/m^3]


class Water(InTank, GridLiquid):
    """The tank with its water, and the bodies in it."""

    def __init__(self, parameters: dict[str, Any], bodies: Solids, seed: int) -> None:
        length = parameters["length"]
        cell = length / parameters["cells"]
        self.tank = cell * np.array(
            [parameters["cells"], *(math.ceil(s * parameters["cells"]) for s in (WIDTH, RIM))]
        )
        self.spacing, self.obstacles, self.lacks = cell / 2, {}, {}
        pool, _ = sample_box(
            (0, 0, 0), (*self.tank[:2], POOL * length), self.spacing, jitter=0.8, seed=seed
        )
        column, _ = sample_box(
            (0, 0, POOL * length),
            (COLUMN[0] * length, self.tank[1], COLUMN[1] * length),
            self.spacing,
            jitter=0.8,
            seed=seed + 1,
        )
        water = np.vstack([pool, column])
        colliders = bodies.make_colliders(np.flatnonzero(bodies.motions == "dynamic"))
        dry = np.min([c.distance(water) for c in colliders], axis=0) > 0
        super().__init__(
            water[dry], cell=cell, bounds=(np.zeros(3), self.tank), colliders=colliders
        )


class Float(Coupled):
    """The bodies and the water.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    seed : int
        Of the bodies' places and the water's.
    """

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        bodies = Solids({**parameters, "step": 1 / 60, "substeps": 8})
        random = np.random.default_rng(seed)
        length, n = parameters["length"], parameters["bodies"]
        width, size = WIDTH * length, parameters["size"]
        add_walls(bodies, length, width)
        shapes: list[Solid] = [
            Box((2 * size,) * 3),
            Sphere(1.2 * size),
            Box((4 * size, 2 * size, size)),
            Capsule(0.8 * size, 2 * size),
            Cylinder(1.2 * size, 1.6 * size),
        ]
        # Apart from each other, however they are turned, in the pool and above it: in layers, if
        # they are too many for the room beside the column.
        apart, room = 4.6 * size, (1 - COLUMN[0]) * length
        across, along = (max(1, int(side / apart)) for side in (width, room))
        density = np.linspace(*DENSITIES, n)[random.permutation(n)]
        for k in range(n):
            layer, place = divmod(k, across * along)
            x = length - room * (1 - (place // across + 0.5) / along)
            y = width * (place % across + 0.5) / across
            z = 1.6 * size + POOL * length * random.uniform(0.4, 1.2)
            z += layer * (apart + POOL * length)
            turn = random.normal(size=4)
            dye = (density[k] - DENSITIES[0]) / (DENSITIES[1] - DENSITIES[0])
            shape = shapes[k % len(shapes)]
            bodies.put("solids", shape, [[x, y, z]], [turn], dye=[dye], density=density[k])
        super().__init__({"bodies": bodies, "water": Water(parameters, bodies, seed)})

    def words(self) -> str:
        """How many float in the end."""
        bodies, water = self["bodies"], self["water"]
        rows = np.flatnonzero(bodies.motions == "dynamic")
        lifted = sum(bodies.positions[row, 2] > 2.5 * water.spacing * 2 for row in rows)
        return (
            f"{lifted} of {len(rows)} bodies are off the floor; {len(water)} particles of "
            f"{1e3 * water.spacing:.3g} mm; last step {water.report.iterations} iterations"
        )


SCENE = Scene(
    name="float",
    doc="Bodies of densities from 0.1 to 1.2 of the water's are washed away by a breaking dam.",
    parameters={
        "duration": Parameter("time simulated", 4.0, unit="s", above=0),
        "cells": Parameter("cells along the tank", 72, minimum=24, maximum=1000),
        "length": Parameter("length of the tank", 3.0, unit="m", above=0),
        "bodies": Parameter("number of bodies", 12, minimum=1, maximum=30),
        "size": Parameter("half the edge of a cube", 0.09, unit="m", above=0.01),
        "friction": Parameter("coefficient of friction", 0.3, minimum=0),
    },
    quick={"duration": 0.1, "cells": 32, "bodies": 3},
    build=Float,
    parts=Coupled.parts,
    frame=Coupled.frame,
    notes=Coupled.notes,
    summary=Float.words,
    picture=View(
        Camera(-60.0, 20.0),
        {
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
    still=lambda recording: 0.6 * float(recording.times[-1]),
    frames=121,
)
