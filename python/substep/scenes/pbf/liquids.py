"""What the scenes of position-based fluids share: the tank, its parameters, and columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...geometry import Box, Collider, TriangleMesh
from ...pbf import PositionBasedFluid, fill_box
from ..declaration import Parameter
from ..tanks import InTank

Array = NDArray[np.float64]


def liquid_parameters() -> dict[str, Parameter]:
    """Parameters of every such scene.

    Returns
    -------
    dict of str to Parameter
        By key.
    """
    return {
        "friction": Parameter("coefficient of friction of the walls", 0.0, minimum=0),
        "viscosity": Parameter("kinematic viscosity", 0.0, unit="m^2/s", minimum=0),
        "xsph": Parameter("smoothing of the velocities in a step", 0.1, minimum=0, maximum=1),
        "divergence_free": Parameter("velocities by a pressure, for slow flow", False),
        "tolerance": Parameter("mean density error at which a step is done", 1e-3, above=0),
        "iterations": Parameter("largest number of iterations of a step", 8, minimum=1),
        "cfl": Parameter("spacings that the fastest particle may move in a step", 0.4, above=0),
    }


class Liquid(InTank, PositionBasedFluid):
    """A liquid in an open tank that stands on the ground, with obstacles.

    Parameters
    ----------
    positions : array_like, shape (n, 3)
        Of the particles [m].
    spacing : float
        Their distance at rest [m].
    parameters : dict
        Of the scene, with those of `liquid_parameters`.
    tank : array_like, shape (3,)
        Length, width and height of the tank [m], whose lowest corner is at 0. Its walls go on above
        its rim, so that nothing leaves it.
    obstacles : mapping of str to (Collider, TriangleMesh)
        By name, with what is drawn of them.
    lacks : mapping of str to str
        What is wrong with meshes that were read.
    names : sequence of str
        Of the parts, one for each fluid.
    options
        Others of `PositionBasedFluid`.
    """

    def __init__(
        self,
        positions: ArrayLike,
        spacing: float,
        parameters: Mapping[str, Any],
        tank: ArrayLike,
        *,
        obstacles: Mapping[str, tuple[Collider, TriangleMesh]] | None = None,
        lacks: Mapping[str, str] | None = None,
        names: Sequence[str] = ("liquid",),
        **options: Any,
    ) -> None:
        self.tank = np.asarray(tank, float)
        self.names = tuple(names)
        self.lacks = dict(lacks or {})
        self.obstacles = {name: mesh for name, (_, mesh) in (obstacles or {}).items()}
        high = self.tank * [1, 1, 50]
        self.walls = Collider(Box(high, high / 2), hollow=True, friction=parameters["friction"])
        super().__init__(
            positions,
            spacing,
            colliders=[self.walls, *(collider for collider, _ in (obstacles or {}).values())],
            tolerance=parameters["tolerance"],
            max_iterations=parameters["iterations"],
            cfl=parameters["cfl"],
            viscosity=parameters["viscosity"],
            xsph=parameters["xsph"],
            divergence_free=parameters["divergence_free"],
            **options,
        )

    def outside(self) -> int:
        """How many particles are behind a wall or in an obstacle."""
        x = self.positions
        return int(sum(np.sum(collider.distance(x) < 0) for collider in self.colliders))

    def words(self) -> str:
        """How the run ended."""
        values = self.diagnostics()
        error = 100 * values["mean_density_error"]
        return (
            f"{len(self)} particles of {1e3 * self.spacing:.3g} mm, {self.outside()} of them "
            f"outside; last step {values['iterations']:.0f} iterations, density error "
            f"{error:.2g} % in the mean"
        )


def column(low: ArrayLike, high: ArrayLike, spacing: float) -> Array:
    """Particles that fill a box, whose sides are rounded to whole particles.

    Parameters
    ----------
    low, high : array_like, shape (3,)
        Corners [m].
    spacing : float
        Distance of neighbours [m].

    Returns
    -------
    ndarray, shape (n, 3)
        Positions [m].
    """
    low = np.asarray(low, float)
    counts = np.maximum(1, np.rint((np.asarray(high, float) - low) / spacing))
    return fill_box(low, low + counts * spacing, spacing)
