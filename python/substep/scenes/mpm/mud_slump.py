"""A cylinder of mud slumps when its mould is lifted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Box, Collider, TriangleMesh, box_mesh
from ...mpm import HerschelBulkley
from ...view import Camera, Look
from ..declaration import Parameter, Scene
from .material_points import Points, fill_cylinder, mpm_parameters, points_view

if TYPE_CHECKING:
    from ...recording import Recording

POSTS = ((1.9, 0.15), (0.35, 2.0), (-1.75, -1.0))  # around the mould, in its radii
POST = np.array([0.45, 0.45, 1.1])  # their sides, likewise


class MudSlump(Points):
    """A cylinder of mud between posts, dyed by rings."""

    def __init__(self, parameters: dict[str, Any], seed: int) -> None:
        r, self.height = parameters["radius"], parameters["height"]
        x, volumes, spacing = fill_cylinder(parameters, seed)
        mud = HerschelBulkley(
            density=parameters["density"],
            young_modulus=parameters["young"],
            poisson_ratio=0.45,
            yield_stress=parameters["yield"],
            consistency=parameters["consistency"],
            flow_index=parameters["exponent"],
        )
        posts = {}
        for k, at in enumerate(POSTS if parameters["posts"] else ()):
            sides = r * POST
            middle = np.array([*(r * np.array(at)), sides[2] / 2])
            mesh = box_mesh(sides)
            shift = middle - (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
            post = Collider(Box(sides, middle), friction=parameters["friction"])
            posts[f"post{k}"] = (post, TriangleMesh(mesh.vertices + shift, mesh.faces))
        super().__init__(
            x,
            volumes,
            mud,
            parameters,
            spacing=spacing,
            part="mud",
            dye=np.hypot(x[:, 0], x[:, 1]) / r,
            obstacles=posts,
            boundary="sticky",
        )

    def slump(self) -> float:
        """How far the top has sunk, over the height of the mould."""
        return 1 - float(self.positions[:, 2].max()) / self.height


def _summary(mud: MudSlump) -> str:
    return f"slumped by {mud.slump():.2f} of its height; {mud.words()}"


def _box(recording: Recording) -> NDArray[np.float64]:
    r, height = (recording.parameters[key] for key in ("radius", "height"))
    return np.array([[-2.6 * r, -2.6 * r, 0], [2.6 * r, 2.6 * r, height]])


SCENE = Scene(
    name="mud-slump",
    doc="A cylinder of mud slumps between posts when its mould is lifted.",
    parameters={
        "duration": Parameter("time simulated", 1.2, unit="s", above=0),
        "particles": Parameter(
            "approximate number of particles", 100_000, minimum=1, maximum=50_000_000
        ),
        "radius": Parameter("radius of the mould", 0.1, unit="m", above=0),
        "height": Parameter("height of the mould", 0.3, unit="m", above=0),
        "posts": Parameter("whether three stand around it", True),
        "density": Parameter("mass per volume", 1600.0, unit="kg/m^3", above=0),
        "young": Parameter("Young's modulus below yield", 2e5, unit="Pa", above=0),
        "yield": Parameter("yield stress in shear", 100.0, unit="Pa", minimum=0),
        "consistency": Parameter("stress at a shear rate of 1/s", 10.0, unit="Pa s^n", above=0),
        "exponent": Parameter("n of the shear rate", 0.8, above=0, maximum=2),
        **mpm_parameters(0.0),
    },
    quick={"duration": 0.05, "particles": 800},
    build=MudSlump,
    parts=Points.parts,
    frame=Points.frame,
    notes=Points.notes,
    summary=_summary,
    picture=points_view(
        Camera(-60.0, 28.0),
        "mud",
        "copper",
        limits=(-0.4, 3.0),
        looks={f"post{k}": Look("#9fb3a1") for k in range(len(POSTS))},
        box=_box,
    ),
    frames=61,
)
