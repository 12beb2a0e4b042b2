"""What the scenes of the material point method share: the body, its recording and picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import InputError
from ...geometry import Collider, Plane, TriangleMesh
from ...mpm import MaterialPointMethod, sample_box
from ...view import Camera, Look, View
from ..declaration import Parameter

if TYPE_CHECKING:
    from ...mpm.materials import Material
    from ...recording import Part, Recording

Array = NDArray[np.float64]

PER_CELL = 2  # particles along each axis of a cell


def mpm_parameters(friction: float) -> dict[str, Parameter]:
    """Parameters of every such scene.

    Parameters
    ----------
    friction : float
        Default of the coefficient of friction.

    Returns
    -------
    dict of str to Parameter
        By key.
    """
    return {
        "friction": Parameter("coefficient of friction of all obstacles", friction, minimum=0),
        "cfl": Parameter(
            "cells that waves and particles may pass in a step", 0.4, above=0, maximum=1
        ),
    }


def fill_cylinder(
    parameters: Mapping[str, Any], seed: int, *, jitter: float = 0.5
) -> tuple[Array, Array, float]:
    """Particles in an upright cylinder on the ground.

    Parameters
    ----------
    parameters : dict
        Of the scene, with `radius`, `height` and `particles`, about how many there will be.
    seed : int
        Of the random numbers.
    jitter : float
        As of `sample_box`.

    Returns
    -------
    positions : ndarray, shape (n, 3)
        Where they are [m].
    volumes : ndarray, shape (n,)
        Of each [m^3].
    spacing : float
        Distance between them [m].

    Raises
    ------
    InputError
        If so few do not make a cylinder.
    """
    r, height, particles = (parameters[key] for key in ("radius", "height", "particles"))
    spacing = float(np.pi * r**2 * height / particles) ** (1 / 3)
    if spacing > min(r, height):
        raise InputError(
            f"particles: {particles} cannot fill a cylinder of {r:g} m radius and {height:g} m "
            "height"
        )
    x, volumes = sample_box((-r, -r, 0), (r, r, height), spacing, jitter=jitter, seed=seed)
    inside = np.hypot(x[:, 0], x[:, 1]) < r
    return x[inside], volumes[inside], spacing


class Points(MaterialPointMethod):
    """Bodies of material points above a ground at z = 0, with obstacles.

    Parameters
    ----------
    positions : array_like, shape (n, 3)
        Of the particles [m].
    volume : float or array_like, shape (n,)
        Of each [m^3].
    materials : Material or sequence of Material
        What they are of.
    parameters : dict
        Of the scene, with those of `mpm_parameters`.
    spacing : float
        Distance of the particles [m]; the cells are twice as wide.
    part : str
        Name of what is recorded.
    dye : array_like, shape (n,)
        A number that each particle keeps, to be seen where it goes.
    obstacles : mapping of str to (Collider, TriangleMesh)
        By name, with what is drawn of them.
    beside : sequence of Collider
        Other obstacles, which are not drawn.
    lacks : mapping of str to str
        What is wrong with meshes that were read.
    options
        Others of `MaterialPointMethod`.
    """

    def __init__(
        self,
        positions: ArrayLike,
        volume: ArrayLike,
        materials: Material | Sequence[Material],
        parameters: Mapping[str, Any],
        *,
        spacing: float,
        part: str,
        dye: ArrayLike,
        obstacles: Mapping[str, tuple[Collider, TriangleMesh]] | None = None,
        beside: Sequence[Collider] = (),
        lacks: Mapping[str, str] | None = None,
        **options: Any,
    ) -> None:
        obstacles = obstacles or {}
        self.part, self.spacing = part, spacing
        self.dye = np.asarray(dye, np.float32)
        self.lacks = dict(lacks or {})
        self.drawn = {name: mesh for name, (_, mesh) in obstacles.items()}
        ground = Collider(Plane(), friction=parameters["friction"])
        super().__init__(
            positions,
            materials,
            cell=PER_CELL * spacing,
            volume=volume,
            colliders=[ground, *(collider for collider, _ in obstacles.values()), *beside],
            cfl=parameters["cfl"],
            **options,
        )

    def outside(self) -> int:
        """How many particles are under the ground or in an obstacle."""
        x = self.positions
        return int(sum(np.sum(collider.distance(x) < 0) for collider in self.colliders))

    def still(self) -> str:
        """How fast the particles are, in words."""
        speed = float(np.sqrt(np.mean(np.sum(self.velocities**2, axis=1))))
        return f"at rest ({speed:.2g} m/s)" if speed < 0.02 else f"moving ({speed:.2g} m/s)"

    def words(self) -> str:
        """How the run ended."""
        dt, reason = self.step_limit()
        return (
            f"{len(self)} particles of {1e3 * self.spacing:.3g} mm, {self.outside()} of them "
            f"outside, {self.still()}; last step {dt:.2g} s ({reason})"
        )

    def parts(self) -> dict[str, Part]:
        """Particles with speed and dye; obstacles, which never move."""
        from ...recording import Part

        parts = {self.part: Part("particles", {"speed": "m/s", "dye": "1"})}
        for name, mesh in self.drawn.items():
            parts[name] = Part("mesh", triangles=mesh.faces, points=mesh.vertices)
        return parts

    def frame(self) -> dict[str, dict[str, Any]]:
        """Positions and numbers as float32, which they are computed in."""
        speed = np.linalg.norm(self.velocities, axis=1).astype(np.float32)
        x = self.positions.astype(np.float32)
        return {self.part: {"points": x, "speed": speed, "dye": self.dye}}

    def notes(self) -> dict[str, str]:
        """Spacing of the particles, and what meshes lack, for the recording."""
        return {"spacing": repr(self.spacing), **self.lacks}


def radius(recording: Recording) -> float:
    """Of the particles as drawn [m]: their balls overlap a little."""
    return 0.6 * float(recording.parameters["notes"]["spacing"])


def points_view(
    camera: Camera,
    part: str,
    palette: str,
    *,
    limits: tuple[float, float] | None = None,
    looks: Mapping[str, Look] | None = None,
    box: Callable[[Recording], ArrayLike] | None = None,
) -> View:
    """A heap on the ground in the colours of its dye, whose numbers say nothing: without a bar.

    Parameters
    ----------
    camera : Camera
        Where from.
    part : str
        The particles.
    palette : str
        Colours of the dye.
    limits : tuple of float, optional
        Values at the ends of the palette; those that occur unless given.
    looks : mapping of str to Look, optional
        Of the obstacles.
    box : callable, optional
        Region shown; what the particles reach unless given.

    Returns
    -------
    View
        The picture.
    """
    return View(
        camera,
        {part: Look(radius=radius, heap=True), **(looks or {})},
        color="dye",
        palette=palette,
        limits=limits,
        bar=False,
        box=box,
        ground=lambda recording: 0.0,
    )
