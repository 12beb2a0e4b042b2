"""A cylinder of dry sand collapses on the ground."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...mpm import Sand
from ...view import Camera
from ..declaration import Parameter, Scene
from .material_points import Points, fill_cylinder, mpm_parameters, points_view

if TYPE_CHECKING:
    from ...recording import Recording


class SandColumn(Points):
    """A cylinder of sand whose layers are dyed by their height."""

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        self.radius = parameters["radius"]
        x, volumes, spacing = fill_cylinder(parameters, seed, jitter=1.0)
        sand = Sand(
            density=parameters["density"],
            young_modulus=parameters["young"],
            friction_angle=np.radians(parameters["angle"]),
            match="plane_strain",
        )
        super().__init__(
            x,
            volumes,
            sand,
            parameters,
            spacing=spacing,
            part="sand",
            dye=x[:, 2] / parameters["height"],
        )

    def run_out(self) -> float:
        """How far 99 % of the sand came, over the radius at the start."""
        x = self.positions
        return float(np.quantile(np.hypot(x[:, 0], x[:, 1]), 0.99)) / self.radius - 1


def _summary(column: SandColumn) -> str:
    return f"run-out {column.run_out():.2f} radii; {column.words()}"


def _box(recording: Recording) -> NDArray[np.float64]:
    """The column, and the ground that the sand will cover."""
    radius, height = (recording.parameters[key] for key in ("radius", "height"))
    reach = radius * (1 + 1.3 * np.sqrt(height / radius))
    return np.array([[-reach, -reach, 0], [reach, reach, height]])


SCENE = Scene(
    name="sand-column",
    doc="A cylinder of dry sand collapses on the ground.",
    parameters={
        "duration": Parameter("time simulated", 1.4, unit="s", above=0),
        "particles": Parameter(
            "approximate number of particles", 200_000, minimum=1, maximum=50_000_000
        ),
        "radius": Parameter("radius of the column", 0.4, unit="m", above=0),
        "height": Parameter("height of the column", 0.8, unit="m", above=0),
        "density": Parameter("mass of packed grains per volume", 1600.0, unit="kg/m^3", above=0),
        "young": Parameter("Young's modulus", 1e6, unit="Pa", above=0),
        "angle": Parameter(
            "friction angle of the grains", 30.0, unit="degrees", minimum=0, maximum=60.0
        ),
        **mpm_parameters(0.577),
    },
    quick={"duration": 0.1, "particles": 800},
    build=SandColumn,
    parts=Points.parts,
    frame=Points.frame,
    notes=Points.notes,
    summary=_summary,
    picture=points_view(Camera(-60.0, 26.0, 0.88), "sand", "copper", limits=(-0.8, 1.1), box=_box),
    frames=71,
)
