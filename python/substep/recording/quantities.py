"""Quantities that a logger takes of any simulation: forces on obstacles, levels, diagnostics."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_real, describe
from ..errors import InputError
from ..geometry import Collider

Array = NDArray[np.float64]
Quantity = Callable[[Any], Any]

_UNITS = {  # of diagnostics, but for energies
    "angular_momentum": "N m s",
    "mass": "kg",
    "momentum": "N s",
    "speed": "m/s",
    "penetration": "m",
}
_SLACK = 1e-9  # of a time: times are sums of steps


class _Exerted:
    """Mean of what was exerted on an obstacle since the sample before; NaN at the first."""

    components = ("x", "y", "z")

    def __init__(self, collider: Collider, name: str, unit: str) -> None:
        self._collider, self._name, self.unit = collider, name, unit
        self._before: tuple[float, float, Array] | None = None  # start of the call, duration, sum

    def __call__(self, simulation: Any) -> Array:
        total, duration = getattr(self._collider, self._name), self._collider.duration
        start = simulation.time - duration
        gained, passed = total, duration
        if self._before is not None:
            slack = _SLACK * max(1.0, abs(simulation.time))
            if abs(start - self._before[0]) <= slack:  # the same call of advance goes on
                gained, passed = total - self._before[2], duration - self._before[1]
        self._before = start, duration, total
        return gained / passed if passed > 0 else np.full(3, np.nan)


def forces(colliders: Mapping[str, Collider]) -> dict[str, Quantity]:
    """Forces and torques on obstacles, for a `Logger`.

    A sample is the mean since the one before, within one call of `advance`; the first is NaN
    where nothing was exerted yet.

    Parameters
    ----------
    colliders : mapping of str to Collider
        Obstacles of the simulation, by the names that they get in the log.

    Returns
    -------
    dict of str to callable
        `NAME_force`, the force that the simulation exerts, shape (3,) [N], and `NAME_torque`, its
        moment about the obstacle's position, shape (3,) [N m].

    Raises
    ------
    TypeError
        If it is no mapping, or one is no `Collider`.
    InputError
        If there is none.

    Examples
    --------
    >>> import substep
    >>> floor = substep.Collider(substep.Plane())
    >>> water = substep.PositionBasedFluid([[0, 0, 0.025]], 0.05, colliders=[floor])
    >>> log = substep.Logger(substep.recording.forces({"floor": floor}))
    >>> water.advance(0.5, log)
    >>> weight = log["floor_force"][-20:, 2].mean() / (9.81 * water.masses[0])
    >>> round(float(weight), 2)
    -1.0
    """
    _check_mapping("colliders", colliders)
    found: dict[str, Quantity] = {}
    for name, collider in colliders.items():
        if not isinstance(collider, Collider):
            raise TypeError(f"colliders[{name!r}]: expected a Collider, got {describe(collider)}")
        found[f"{name}_force"] = _Exerted(collider, "impulse", "N")
        found[f"{name}_torque"] = _Exerted(collider, "angular_impulse", "N m")
    return found


def gauges(places: Mapping[str, ArrayLike], radius: float) -> dict[str, Quantity]:
    """Levels of what particles fill, for a `Logger`: the highest particle near a vertical line.

    `GridLiquid.depth` is finer where there is a grid.

    Parameters
    ----------
    places : mapping of str to array_like, shape (d - 1,)
        Where the lines stand: x, or x and y in three dimensions [m]; by the names that they get.
    radius : float
        How far from the line particles count, a spacing or two [m].

    Returns
    -------
    dict of str to callable
        Height of the centre of the highest particle there [m]; NaN where there is none.

    Raises
    ------
    TypeError
        If `places` is no mapping.
    InputError
        If a place is not one, there is none, or the radius is not above 0.

    Examples
    --------
    >>> import substep
    >>> x = substep.fill_box((0, 0, 0), (1, 1, 0.4), 0.1)
    >>> water = substep.PositionBasedFluid(x, 0.1, colliders=[substep.Plane()])
    >>> log = substep.Logger(substep.recording.gauges({"middle": (0.5, 0.5)}, 0.1))
    >>> log(water)
    >>> log["middle"].round(3)
    array([0.35])
    """
    _check_mapping("places", places)
    reach = check_real("radius", radius, positive=True)
    found: dict[str, Quantity] = {}
    for name, place in places.items():
        at = check_array(f"places[{name!r}]", place, (None,))
        if len(at) not in (1, 2):
            raise InputError(f"places[{name!r}]: expected x, or x and y, got {at.tolist()}")
        found[name] = _gauge(name, at, reach)
    return found


def _check_mapping(what: str, value: Any) -> None:
    if not isinstance(value, Mapping):
        raise TypeError(f"{what}: expected a mapping, got {describe(value)}")
    if not value:
        raise InputError(f"{what}: expected at least one")


def _gauge(name: str, at: Array, reach: float) -> Quantity:
    def level(simulation: Any) -> float:
        x = simulation.positions
        if x.shape[1] != len(at) + 1:
            raise InputError(f"places[{name!r}]: expected {x.shape[1] - 1} numbers, got {len(at)}")
        near = ((x[:, :-1] - at) ** 2).sum(axis=1) <= reach**2
        return float(x[near, -1].max()) if near.any() else float("nan")

    return _measured(level, "m")


def diagnostics(*names: str) -> dict[str, Quantity]:
    """Diagnostics of a simulation, such as energies and momenta, for a `Logger`.

    Parameters
    ----------
    *names : str
        Keys of what `diagnostics()` of the simulation returns.

    Returns
    -------
    dict of str to callable
        Each of them, by its name. A key that the simulation does not have is an `InputError` at
        the first sample.

    Raises
    ------
    TypeError
        If one is no text.
    InputError
        If there is none.

    Examples
    --------
    >>> import substep
    >>> bodies = substep.RigidBodies()
    >>> ball = bodies.add(substep.Sphere(0.1), (0, 0, 10))
    >>> log = substep.Logger(substep.recording.diagnostics("kinetic_energy", "energy"))
    >>> bodies.advance(0.5, log)
    >>> float(log["energy"].std().round(6))
    0.0
    """
    if not names:
        raise InputError("names: expected at least one")
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"names: expected texts, got {describe(name)}")
    return {name: _diagnostic(name) for name in names}


def _diagnostic(name: str) -> Quantity:
    def value(simulation: Any) -> float:
        found = simulation.diagnostics()
        if name not in found:
            raise InputError(f"{name}: expected one of {', '.join(found)}")
        return float(found[name])

    return _measured(value, _unit_of(name))


def _measured(quantity: Any, unit: str, components: Sequence[str] = ()) -> Any:
    """The quantity, a function, which then tells its unit and its components to plots."""
    quantity.unit, quantity.components = unit, tuple(components)
    return quantity


def _unit_of(name: str) -> str:
    """The unit of a diagnostic, by the last part of its name; nothing where it is unknown."""
    key = re.sub("_[xyz]$", "", name.split(".")[-1])
    return "J" if key.endswith("energy") else _UNITS.get(key, "")
