"""Where particles come from, and where they go."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.attributes import Frozen
from ..base.checks import check_array, check_integer, check_real, check_sequence, in_range
from ..errors import InputError
from ..geometry import Collider, Shape
from ..geometry.colliders import check_collider

Array = NDArray[np.float64]

_MOST_POINTS = 2**22  # of a layer: the native side takes no more at once


class Emitter(Frozen):
    """A nozzle that lets out liquid at a given speed.

    Particles leave in layers across the nozzle, one each time that the jet has moved on by the
    layer's thickness, whatever the steps of the simulation: so the flow is `area` times `speed`,
    without gaps and overlaps. In a `PositionBasedFluid` the layers that have not come out yet hold
    what is behind the nozzle; in a `MaterialPointMethod` nothing does.

    Parameters
    ----------
    position : array_like, shape (3,) or (2,)
        Middle of the nozzle [m].
    direction : array_like, same shape
        Where the jet goes, of any length above 0.
    speed : float
        Of the jet [m/s], above 0.
    radius : float, optional
        Of a round nozzle [m]; in 2D half the width of the slit.
    size : array_like, shape (2,), optional
        Width and height of a rectangular nozzle [m], in place of a radius; not in 2D. The width
        is horizontal, or along x where the jet is vertical.
    kind : int
        Which of the fluids or materials of the simulation comes out, as in its `kinds`.
    start, stop : float
        When it is open [s]. Layers since `start` come out in the first step, as far away as
        it has come by then: a simulation whose time is later begins with the whole jet. More than
        2^22 particles at once are refused.

    Raises
    ------
    InputError
        If an argument is wrong, with its name.

    Examples
    --------
    >>> import numpy as np
    >>> import substep
    >>> tap = substep.Emitter((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), 2.0, radius=0.05)
    >>> liquid = substep.PositionBasedFluid(np.zeros((0, 3)), 0.02, emitters=[tap])
    >>> liquid.advance(0.5)
    >>> bool(len(liquid) == liquid.emitted[0] > 0)
    True
    >>> round(len(liquid) * 0.02**3 / (tap.area * 2.0 * 0.5), 1)
    1.0
    """

    def __init__(
        self,
        position: ArrayLike,
        direction: ArrayLike,
        speed: float,
        *,
        radius: float | None = None,
        size: ArrayLike | None = None,
        kind: int = 0,
        start: float = 0.0,
        stop: float = math.inf,
    ) -> None:
        x = check_array("position", position)
        self.dimension = 2 if x.shape == (2,) else 3
        self.position = check_array("position", x, (self.dimension,))
        along = check_array("direction", direction, (self.dimension,))
        largest = float(np.abs(along).max())
        if largest == 0:
            raise InputError(f"direction: expected a vector of a length above 0, got {along}")
        if not 1e-150 < largest < 1e150:  # its square would not be a number
            along = along / largest
        self.direction = along / float(np.linalg.norm(along))
        self.speed = check_real("speed", speed, positive=True)
        if (radius is None) == (size is None) or (size is not None and self.dimension == 2):
            raise InputError("radius, size: expected one of them (in 2D radius)")
        self.radius = None if radius is None else check_real("radius", radius, positive=True)
        self.size = None if size is None else check_array("size", size, (2,))
        if self.size is not None and not (self.size > 0).all():
            raise InputError(f"size: expected numbers above 0, got {self.size}")
        name = "radius" if self.size is None else "size"
        with in_range(name):  # of the area
            check_real(name, self.area, positive=True)
        self.kind = check_integer("kind", kind, minimum=0)
        self.start = check_real("start", start)
        self.stop = check_real("stop", stop, finite=False)

    @property
    def area(self) -> float:
        """Of the nozzle [m^2]; in 2D its width [m]."""
        if self.size is not None:
            return float(np.prod(self.size))
        assert self.radius is not None
        return 2 * self.radius if self.dimension == 2 else math.pi * self.radius**2

    def _layer(self, spacing: float) -> tuple[Array, float]:
        """Points of a layer [m] and its thickness, of which together the density is that of rest.

        Both are a grid, stretched so that each point has the same share of the nozzle's area A; the
        thickness is m spacing^d / A for m points.
        """
        points = self.area / spacing / (spacing if self.dimension == 3 else 1.0)
        if not points <= _MOST_POINTS:
            raise InputError(
                f"emitters: expected layers of at most {_MOST_POINTS} particles, got {points:.1e}"
            )
        if self.size is not None:
            counts = np.maximum(1, np.rint(self.size / spacing)).astype(int)
            flat = _grid([w * _middles(m) / m for w, m in zip(self.size, counts, strict=True)])
        elif self.dimension == 2:
            m = max(1, round(self.area / spacing))
            flat = self.area * _middles(m)[:, None] / m
        else:
            assert self.radius is not None
            m = round(2 * self.radius / spacing)
            grids = [spacing * _grid([_middles(k), _middles(k)]) for k in (m, m + 1)]
            discs = [grid[(grid**2).sum(axis=1) <= self.radius**2] for grid in grids]
            flat = min(discs, key=lambda disc: abs(len(disc) - self.area / spacing**2))
            flat = flat if len(flat) else np.zeros((1, 2))
            flat = flat * math.sqrt(self.area / len(flat)) / spacing
        offsets = flat @ self._across()
        return offsets, len(flat) * spacing**self.dimension / self.area

    def _across(self) -> Array:
        """Rows: unit vectors across the jet, the first horizontal."""
        n = self.direction
        if self.dimension == 2:
            return np.array([[-n[1], n[0]]])
        wide = np.cross([0.0, 0.0, 1.0], n)
        wide = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(wide) < 1e-9 else wide
        wide = wide - (wide @ n) * n
        wide /= np.linalg.norm(wide)
        return np.stack([wide, np.cross(n, wide)])

    def _options(self, spacing: float) -> dict[str, Any]:
        """Of the native emitter, whose particles are `spacing` apart."""
        offsets, thickness = self._layer(spacing)
        return {
            "position": [*self.position, 0.0][:3],
            "direction": [*self.direction, 0.0][:3],
            "speed": self.speed,
            "offsets": np.ascontiguousarray(offsets),
            "thickness": thickness,
            "volume": spacing**self.dimension,
            "kind": self.kind,
            "start": self.start,
            "stop": self.stop,
        }


def _middles(m: int) -> Array:
    """Of m cells of length 1 about 0."""
    return np.arange(m, dtype=np.float64) - 0.5 * (m - 1)


def _grid(axes: list[Array]) -> Array:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


class Sink(Frozen):
    """A region that swallows particles.

    Parameters
    ----------
    shape : Shape or Collider
        Particles inside of it are taken out at the end of each step: a `Box`, a `Plane` (what is
        below it), a hollow `Collider` (what is outside). It stays where it is.

    Attributes
    ----------
    shape : Collider
        The region.

    Raises
    ------
    TypeError
        If it is neither a shape nor a Collider.

    Examples
    --------
    >>> import substep
    >>> drain = substep.Sink(substep.Plane(point=(0.0, 0.0, -1.0)))
    >>> drop = substep.PositionBasedFluid([[0.0, 0.0, 0.0]], 0.1, sinks=[drain])
    >>> drop.advance(1.0)
    >>> len(drop), drop.absorbed
    (0, array([1]))
    """

    shape: Collider

    def __init__(self, shape: Shape | Collider) -> None:
        self.shape = check_collider("shape", shape)


def check_all(name: str, values: Any, kind: type) -> tuple[Any, ...]:
    """A sequence of emitters or sinks."""
    found = tuple(check_sequence(name, values, kind.__name__))
    for k, value in enumerate(found):
        if not isinstance(value, kind):
            raise TypeError(f"{name}[{k}]: expected {kind.__name__}, got {value!r}")
    return found
