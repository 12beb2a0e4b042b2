"""Sides of the box that a flow fills, and regions in it that give it something."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.attributes import Frozen
from ..base.checks import check_array, check_choice, check_flag, check_real, describe
from ..errors import InputError
from ..geometry import Collider, Shape

Array = NDArray[np.float64]

SIDES = ("wall", "open", "periodic")
_MOST = 1e15  # of a number that is given, so that float32 holds its square


def _number(name: str, value: Any) -> float | None:
    if value is None:
        return None
    number = check_real(name, value)
    if abs(number) > _MOST:
        raise InputError(f"{name}: expected a number within {_MOST:g}, got {number}")
    return number


def _told(owner: Any, **defaults: Any) -> str:
    """An object in words: what of it is not the default; of many vectors their shape."""
    words = []
    for name, default in defaults.items():
        value = getattr(owner, name)
        if isinstance(value, np.ndarray):
            value = value.tolist() if value.ndim == 1 else f"array of shape {value.shape}"
        if value != default:
            words.append(f"{name}={value}")
    return f"{type(owner).__name__}({', '.join(words)})"


def _vectors(name: str, value: ArrayLike) -> Array:
    array = check_array(name, value)
    if array.ndim == 0 or array.shape[-1] not in (2, 3):
        raise InputError(f"{name}: expected a vector, or one for each face, got {array.shape}")
    if array.size and np.abs(array).max() > _MOST:
        raise InputError(f"{name}: expected numbers within {_MOST:g}")
    return array


class Wall(Frozen):
    """A side of the box that lets nothing through.

    Parameters
    ----------
    slip : bool, optional
        Whether the flow passes along it freely; unless given, it does where it has no viscosity.
    velocity : array_like, shape (d,) or (faces along the side..., d), optional
        Of a wall that does not let it slip, along itself [m/s]; at rest unless given.
    temperature : float, optional
        That the wall is held at [K]; unless given, `heat_flux` passes it.
    heat_flux : float
        What flows into the box, over density and heat capacity [K m/s].

    Raises
    ------
    InputError
        If an argument is wrong.

    Examples
    --------
    >>> import substep
    >>> lid = substep.gridfluid.Wall(velocity=(1.0, 0.0))
    >>> flow = substep.GridFlow([(0, 0), (1, 1)], 0.1, viscosity=0.1,
    ...                         sides=["wall", ("wall", lid)])
    >>> flow.step(0.01)
    >>> bool(flow.velocity[5, -1, 0] > 0)
    True
    """

    slip: bool | None
    velocity: Array | None
    temperature: float | None
    heat_flux: float

    def __init__(
        self,
        *,
        slip: bool | None = None,
        velocity: ArrayLike | None = None,
        temperature: float | None = None,
        heat_flux: float = 0.0,
    ) -> None:
        self.slip = None if slip is None else check_flag("slip", slip)
        self.velocity = None if velocity is None else _vectors("velocity", velocity)
        self.temperature = _number("temperature", temperature)
        self.heat_flux = _number("heat_flux", heat_flux) or 0.0
        if self.temperature is not None and self.heat_flux:
            raise InputError("heat_flux: a wall has a temperature or a flux")
        if self.slip and self.velocity is not None:
            raise InputError("velocity: a wall that lets the flow slip does not drive it")

    def __repr__(self) -> str:
        return _told(self, slip=None, velocity=None, temperature=None, heat_flux=0.0)


class Inflow(Frozen):
    """A side of the box through which a given flow passes, in or out.

    Parameters
    ----------
    velocity : array_like, shape (d,) or (faces along the side..., d)
        Of what passes [m/s]: one vector, or one for each face of the side, of a parabola say.
    temperature : float, optional
        Of what flows in [K]: the `reference_temperature` of the flow unless given.
    smoke : float
        Smoke in what flows in [1].

    Raises
    ------
    InputError
        If an argument is wrong.

    Examples
    --------
    >>> import numpy as np
    >>> import substep
    >>> y = (np.arange(8) + 0.5) / 8
    >>> parabola = np.stack([4 * y * (1 - y), 0 * y], axis=-1)
    >>> inflow = substep.gridfluid.Inflow(parabola)
    >>> flow = substep.GridFlow([(0, 0), (2, 1)], 1 / 8, viscosity=0.1,
    ...                         sides=[(inflow, "open"), "wall"])
    >>> bool(np.allclose(flow.velocity_faces[0][0], parabola[:, 0]))
    True
    """

    velocity: Array
    temperature: float | None
    smoke: float

    def __init__(
        self, velocity: ArrayLike, *, temperature: float | None = None, smoke: float = 0.0
    ) -> None:
        self.velocity = _vectors("velocity", velocity)
        self.temperature = _number("temperature", temperature)
        self.smoke = _number("smoke", smoke) or 0.0

    def __repr__(self) -> str:
        return _told(self, velocity=None, temperature=None, smoke=0.0)


class FlowEmitter(Frozen):
    """A region in which a flow is given smoke, heat or a velocity.

    Parameters
    ----------
    region : Shape
        Where: cells whose middle is in it. In 2D it is cut at z = 0.
    smoke, temperature : float, optional
        That it is held at [1, K].
    smoke_rate, heating : float
        That is added in it [1/s, K/s].
    velocity : array_like, shape (d,), optional
        That the flow has there before the pressure acts [m/s].

    Raises
    ------
    InputError
        If an argument is wrong.

    Examples
    --------
    >>> import substep
    >>> chimney = substep.gridfluid.FlowEmitter(substep.Sphere(0.2, (0.5, 0.2, 0)), smoke=1.0)
    >>> flow = substep.GridFlow([(0, 0), (1, 1)], 0.1, smoke=0.0, emitters=[chimney])
    >>> flow.step(0.01)
    >>> float(flow.smoke.max())
    1.0
    """

    region: Shape
    smoke: float | None
    temperature: float | None
    smoke_rate: float
    heating: float
    velocity: Array | None

    def __init__(
        self,
        region: Shape,
        *,
        smoke: float | None = None,
        temperature: float | None = None,
        smoke_rate: float = 0.0,
        heating: float = 0.0,
        velocity: ArrayLike | None = None,
    ) -> None:
        if not isinstance(region, Shape):
            raise TypeError(f"region: expected a shape, got {describe(region)}")
        self.region = region
        self._collider = Collider(region)
        self.smoke = _number("smoke", smoke)
        self.temperature = _number("temperature", temperature)
        self.smoke_rate = _number("smoke_rate", smoke_rate) or 0.0
        self.heating = _number("heating", heating) or 0.0
        self.velocity = None if velocity is None else _vectors("velocity", velocity)
        if self.velocity is not None and self.velocity.ndim != 1:
            raise InputError(f"velocity: expected one vector, got {self.velocity.shape}")

    def __repr__(self) -> str:
        held: dict[str, Any] = dict.fromkeys(("region", "smoke", "temperature", "velocity"))
        return _told(self, **held, smoke_rate=0.0, heating=0.0)


Side = str | Wall | Inflow


def check_flow_sides(sides: Any, d: int) -> tuple[tuple[Side, Side], ...]:
    """The lower and upper side of each axis."""
    one = isinstance(sides, (str, Wall, Inflow))
    per_axis: Sequence[Any] = [sides] * d if one else sides
    if not isinstance(per_axis, (list, tuple)) or len(per_axis) != d:
        raise InputError(f"sides: expected one side, or {d} or pairs, got {describe(sides)}")
    pairs = []
    for a, given in enumerate(per_axis):
        pair = (given, given) if isinstance(given, (str, Wall, Inflow)) else given
        if not isinstance(pair, (list, tuple)) or len(pair) != 2:
            raise InputError(f"sides[{a}]: expected a side or two, got {describe(given)}")
        low, high = (
            side if isinstance(side, (Wall, Inflow)) else check_choice(f"sides[{a}]", side, SIDES)
            for side in pair
        )
        if ("periodic" in (low, high)) and low != high:
            raise InputError(f"sides[{a}]: both sides of an axis are periodic, or none is")
        pairs.append((low, high))
    return tuple(pairs)


def native_side(
    name: str,
    side: Side,
    axis: int,
    cells: tuple[int, ...],
    scalars: Mapping[str, float],
    slips: bool,
) -> dict[str, Any]:
    """A side for the native core; scalars: what is carried, and what of it is far away."""
    if side == "wall":
        side = Wall()
    kind = side if isinstance(side, str) else "wall" if isinstance(side, Wall) else "inflow"
    slip, velocity = True, np.zeros(0)
    values, holds = [0.0] * len(scalars), [False] * len(scalars)
    if not isinstance(side, str):
        slip = isinstance(side, Wall) and (slips if side.slip is None else side.slip)
        if side.velocity is not None:
            velocity = _side_velocity(name, side, axis, cells)
        for k, (scalar, ambient) in enumerate(scalars.items()):
            if isinstance(side, Inflow):
                given = getattr(side, scalar)
                values[k], holds[k] = ambient if given is None else given, True
            elif scalar == "temperature":
                held = side.temperature
                values[k], holds[k] = side.heat_flux if held is None else held, held is not None
    return {
        "kind": kind,
        "slip": slip,
        "velocity": velocity.ravel().tolist(),
        "scalar": values,
        "holds": holds,
    }


def _side_velocity(name: str, side: Wall | Inflow, axis: int, cells: tuple[int, ...]) -> Array:
    """Of each face of a side."""
    d = len(cells)
    along = tuple(n for a, n in enumerate(cells) if a != axis)
    velocity = side.velocity
    assert velocity is not None
    if velocity.shape not in ((d,), (*along, d)):
        raise InputError(
            f"{name}: velocity: expected shape ({d},) or {(*along, d)}, got {velocity.shape}"
        )
    if isinstance(side, Wall) and velocity[..., axis].any():
        raise InputError(f"{name}: velocity: that of a wall is along it; use an Inflow")
    return np.ascontiguousarray(np.broadcast_to(velocity, (*along, d)))
