"""Balls of wood, stone and steel fall into sand and leave craters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Sphere
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from ..rigid.rigid_bodies import Solids
from .coupled import Coupled
from .sand_bed import SandBed, sand_parameters, sand_view

if TYPE_CHECKING:
    from ...recording import Recording

BED = (1.5, 0.6, 0.22)  # lengths of the tray, and depth of the sand [m]
DENSITIES = {"wood": 700.0, "stone": 2600.0, "steel": 7800.0}  # [kg/m^3]


class Crater(Coupled):
    """Three balls above the sand.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    seed : int
        Of the grains' places.
    """

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        bodies = Solids({**parameters, "step": 1 / 120, "substeps": 8})
        r, height = parameters["radius"], parameters["height"]
        for k, (name, density) in enumerate(DENSITIES.items()):
            x = [BED[0] * (k + 0.5) / 3, BED[1] / 2, BED[2] + r + height]
            bodies.put(name, Sphere(r), [x], density=density, segments=64)
        super().__init__({"balls": bodies, "sand": SandBed(parameters, BED, bodies, seed)})

    def words(self) -> str:
        """How deep the balls lie."""
        bodies = self["balls"]
        rows = np.flatnonzero(bodies.motions == "dynamic")
        lowest = bodies.positions[rows, 2] - self.radius_of_balls
        depths = 1e3 * (BED[2] - lowest)
        told = ", ".join(
            f"{name} {abs(depth):.0f} mm {'above' if depth < 0 else 'below'}"
            for name, depth in zip(DENSITIES, depths, strict=True)
        )
        return f"lowest points over the level at first: {told}; {self['sand'].words()}"

    @property
    def radius_of_balls(self) -> float:
        """Theirs [m]."""
        return float(self["balls"].fixtures(1)[0].shape.radius)


def _box(recording: Recording) -> NDArray[np.float64]:
    return np.array([[0, 0, 0], [BED[0], BED[1], BED[2] + 0.15]])


SCENE = Scene(
    name="crater",
    doc="Balls of wood, stone and steel fall into sand and leave craters.",
    parameters={
        "duration": Parameter("time simulated", 0.8, unit="s", above=0),
        "radius": Parameter("radius of the balls", 0.06, unit="m", above=0.005, maximum=0.2),
        "height": Parameter("height of their fall", 0.2, unit="m", minimum=0),
        **sand_parameters(100_000),
    },
    quick={"duration": 0.05, "particles": 2000, "height": 0.02},
    build=Crater,
    parts=Coupled.parts,
    frame=Coupled.frame,
    notes=Coupled.notes,
    summary=Crater.words,
    picture=sand_view(
        Camera(-70.0, 34.0),
        {"wood": Look("#c98a4b"), "stone": Look("#8d8f92"), "steel": Look("#4a5058")},
        _box,
    ),
    frames=81,
)
