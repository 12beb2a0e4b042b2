"""A bed of sand that rigid bodies lie on, with what scenes of it share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ...geometry import Collider, Plane
from ...mpm import Sand, sample_box
from ...view import Camera, Look, View
from ..declaration import Parameter
from ..mpm.material_points import Points, mpm_parameters, radius
from ..rigid.rigid_bodies import Solids

if TYPE_CHECKING:
    from ...recording import Recording

LAYERS = 5  # of dye in the bed


class SandBed(Points):
    """Sand in a tray without lid, whose layers are dyed, and obstacles that stand for bodies.

    Parameters
    ----------
    parameters : mapping
        Of the scene, with `particles`, `angle`, `young`, `friction` and `cfl`.
    sides : array_like, shape (3,)
        Lengths of the tray, and depth of the sand [m].
    bodies : Solids
        The dynamic ones of them meet the sand.
    seed : int
        Of the grains' places.
    """

    def __init__(
        self, parameters: Mapping[str, Any], sides: ArrayLike, bodies: Solids, seed: int
    ) -> None:
        self.sides = np.asarray(sides, float)
        spacing = float((self.sides.prod() / parameters["particles"]) ** (1 / 3))
        x, volumes = sample_box((0, 0, 0), self.sides, spacing, jitter=1.0, seed=seed)
        sand = Sand(
            density=1600.0,
            young_modulus=parameters["young"],
            friction_angle=np.radians(parameters["angle"]),
        )
        walls = [
            Collider(Plane(sign * axis, self.sides * (axis * (sign < 0))))
            for axis in np.eye(3)[:2]
            for sign in (1, -1)
        ]
        moving = np.flatnonzero(bodies.motions == "dynamic")
        super().__init__(
            x,
            volumes,
            sand,
            parameters,
            spacing=spacing,
            part="sand",
            dye=0.3 + 0.4 * (np.floor(LAYERS * x[:, 2] / self.sides[2]) % 2),
            beside=[*walls, *bodies.make_colliders(moving)],
        )


def sand_parameters(particles: int) -> dict[str, Parameter]:
    """Parameters of every such scene.

    Parameters
    ----------
    particles : int
        Default of about how many there are.

    Returns
    -------
    dict of str to Parameter
        By key.
    """
    return {
        "particles": Parameter(
            "approximate number of particles", particles, minimum=100, maximum=50_000_000
        ),
        "young": Parameter("Young's modulus of the sand", 5e5, unit="Pa", above=0),
        "angle": Parameter(
            "friction angle of the grains", 33.0, unit="degrees", minimum=0, maximum=60.0
        ),
        **mpm_parameters(0.6),
    }


def sand_view(
    camera: Camera, looks: Mapping[str, Look], box: Callable[[Recording], ArrayLike]
) -> View:
    """Dyed sand, and the surfaces of bodies.

    Parameters
    ----------
    camera : Camera
        Where from.
    looks : mapping of str to Look
        Of the surfaces, by part.
    box : callable
        Region shown.

    Returns
    -------
    View
        The picture.
    """
    return View(
        camera,
        {"bodies": Look(hidden=True), "sand": Look(heap=True, radius=radius), **looks},
        color="dye",
        palette="copper",
        limits=(-0.8, 1.1),
        bar=False,
        box=box,
        ground=lambda recording: 0.0,
    )
