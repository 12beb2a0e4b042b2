"""Cameras, lights, and what the parts of a recording look like."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_flag, check_real, describe, in_range
from ..errors import InputError
from ..recording import Recording

NEAREST = 1e-6  # that a camera may come to its target, over how far it is at the times given


def check_color(name: str, color: Any, known: Callable[[Any], bool] | None = None) -> None:
    """Refuse what is no name of a colour, and what is none that is known."""
    if not isinstance(color, str):
        raise TypeError(f"{name}: expected the name of a colour, got {describe(color)}")
    if known is not None and not known(color):
        raise InputError(f"{name}: expected a colour of matplotlib, got {describe(color)}")


@dataclass(frozen=True)
class Camera:
    """A direction of view; the distance follows from the region to be shown.

    Parameters
    ----------
    azimuth : float
        Where the camera is, from the x axis towards the y axis [degrees].
    elevation : float
        Its height above the horizon, from -90 to 90 [degrees].
    distance : float
        Above 0; 1 shows everything, less comes nearer.

    Raises
    ------
    InputError
        If a number is not in its range.

    Examples
    --------
    >>> import substep
    >>> substep.render.Camera(azimuth=30.0).elevation
    18.0
    """

    azimuth: float = -60.0
    elevation: float = 18.0
    distance: float = 1.0

    def __post_init__(self) -> None:
        check_real("azimuth", self.azimuth)
        if abs(check_real("elevation", self.elevation)) > 90:
            raise InputError(f"elevation: expected -90 to 90 degrees, got {self.elevation}")
        check_real("distance", self.distance, positive=True)

    def axes(self) -> NDArray[np.float64]:
        """Unit vectors of the picture.

        Returns
        -------
        ndarray, shape (3, 3)
            Rows: to the right, up, and towards the camera.
        """
        a, e = np.radians([self.azimuth, self.elevation])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        back = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        return np.array([right, np.cross(back, right), back])


@dataclass(frozen=True, eq=False)
class CameraPath:
    """A camera that moves: its position and its target at some times.

    Between them it moves along cubic curves whose slope at each time is that between the times
    before and after (Catmull and Rom 1974); before the first and after the last it stands still.

    Parameters
    ----------
    times : array_like, shape (n,)
        In increasing order [s].
    positions : array_like, shape (n, 3)
        Of the camera [m].
    targets : array_like, shape (n, 3) or (3,)
        What is in the middle of the picture [m].
    angle : float
        Of the picture's height, above 0 and below 180 [degrees].

    Raises
    ------
    InputError
        If the times do not increase, a shape is wrong, or the camera is at its target at a time or
        between two.

    Examples
    --------
    >>> import substep
    >>> path = substep.render.CameraPath([0, 2], [(4, 0, 1), (0, 4, 2)], (0, 0, 0.5))
    >>> path.at(1.0)[0].tolist()
    [2.0, 2.0, 1.5]
    """

    times: ArrayLike
    positions: ArrayLike
    targets: ArrayLike
    angle: float = 30.0

    def __post_init__(self) -> None:
        times = check_array("times", self.times, (None,))
        if not len(times) or np.any(times[1:] <= times[:-1]):
            raise InputError("times: expected at least one, in increasing order")
        positions = check_array("positions", self.positions, (len(times), 3))
        given = np.asarray(self.targets)
        targets = check_array("targets", given, (3,) if given.ndim == 1 else (len(times), 3))
        targets = np.array(np.broadcast_to(targets, positions.shape))
        if np.any(np.all(positions == targets, axis=1)):
            raise InputError("targets: expected others than the positions")
        if not 0 < check_real("angle", self.angle) < 180:
            raise InputError(f"angle: expected more than 0 and less than 180, got {self.angle}")
        with in_range("times, positions and targets"):
            time = _meeting(times, positions - targets)
        if time is not None:
            raise InputError(f"targets: the camera passes through its target, at {time:g} s")
        for name, array in (("times", times), ("positions", positions), ("targets", targets)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def at(self, time: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The position of the camera and its target.

        Parameters
        ----------
        time : float
            [s].

        Returns
        -------
        tuple of ndarray, shape (3,)
            Position and target [m].

        Raises
        ------
        InputError
            If the time is not a finite number.
        """
        time = check_real("time", time)
        times = np.asarray(self.times)
        if len(times) == 1 or time <= times[0]:
            return np.array(self.positions)[0], np.array(self.targets)[0]
        if time >= times[-1]:
            return np.array(self.positions)[-1], np.array(self.targets)[-1]
        k = int(np.searchsorted(times, time, side="right")) - 1
        length = times[k + 1] - times[k]
        s = (time - times[k]) / length
        # Of the Hermite polynomials: values and slopes at both ends.
        weights = ((1 + 2 * s) * (1 - s) ** 2, s**2 * (3 - 2 * s))
        sloped = (length * s * (1 - s) ** 2, -length * s**2 * (1 - s))
        position, target = (
            weights[0] * x[k] + weights[1] * x[k + 1] + sloped[0] * v[k] + sloped[1] * v[k + 1]
            for x in (np.asarray(self.positions), np.asarray(self.targets))
            for v in [_slopes(times, x)]
        )
        return position, target


def _slopes(times: NDArray[Any], x: NDArray[Any]) -> NDArray[np.float64]:
    """Between the times before and after; at the ends, between the first or last two."""
    before, after = np.arange(len(times)) - 1, np.arange(len(times)) + 1
    before[0], after[-1] = 0, len(times) - 1
    slopes: NDArray[np.float64] = (x[after] - x[before]) / (times[after] - times[before])[:, None]
    return slopes


def _meeting(times: NDArray[Any], apart: NDArray[Any]) -> float | None:
    """When the camera is as good as at its target, from which it is so far apart at its times."""
    far = np.linalg.norm(apart, axis=1)
    slopes = _slopes(times, apart)
    for k, length in enumerate(np.diff(times)):
        (x, y), (v, w) = apart[k : k + 2], length * slopes[k : k + 2]
        # The cubic of a segment by powers of s, and where its square is least.
        cubic = np.array([x, v, 3 * (y - x) - 2 * v - w, 2 * (x - y) + v + w])
        cubic /= far[k : k + 2].max()
        square = sum((Polynomial(c) ** 2 for c in cubic.T), Polynomial([0.0])).trim(1e-14)
        for s in [0.0, *np.clip(square.deriv().roots().real, 0, 1)]:
            if np.linalg.norm(s ** np.arange(4) @ cubic) <= NEAREST:
                return float(times[k] + s * length)
    return None


def camera_axes(position: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors to the right, up, and towards the camera; z is up in the picture."""
    back = (position - target) / np.linalg.norm(position - target)
    right = np.cross((0.0, 0.0, 1.0), back)
    if np.linalg.norm(right) < 1e-9:  # seen from above or below
        right = np.array([0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(back, right), back])


@dataclass(frozen=True)
class Light:
    """A light so far away that its rays are parallel, as the sun's are.

    Parameters
    ----------
    azimuth : float
        Where it comes from, from the x axis towards the y axis [degrees].
    elevation : float
        Its height above the horizon, from -90 to 90 [degrees].
    strength : float
        1 is that of all the default lights together; at least 0.
    color : str
        A colour that matplotlib knows.

    Raises
    ------
    InputError
        If a number is not in its range; of a colour that there is not, when it is drawn.
    TypeError
        If something is of another type.

    Examples
    --------
    >>> import substep
    >>> substep.render.Light(azimuth=-120.0, elevation=40.0).strength
    1.0
    """

    azimuth: float
    elevation: float
    strength: float = 1.0
    color: str = "white"

    def __post_init__(self) -> None:
        check_real("azimuth", self.azimuth)
        if abs(check_real("elevation", self.elevation)) > 90:
            raise InputError(f"elevation: expected -90 to 90 degrees, got {self.elevation}")
        check_real("strength", self.strength, nonnegative=True)
        check_color("color", self.color)

    def direction(self) -> NDArray[np.float64]:
        """Unit vector towards it.

        Returns
        -------
        ndarray, shape (3,)
            In the frame of the recording.
        """
        return Camera(self.azimuth, self.elevation).axes()[2]


@dataclass(frozen=True)
class Look:
    """What one part of a recording looks like.

    Parameters
    ----------
    color : str or tuple of str, optional
        A colour that matplotlib knows; one of a palette unless given, grey for what never moves.
        Of bodies that have shapes several, which they take in turns.
    back : str, optional
        Colour of the other side of an open surface; a lighter one unless given.
    opacity : float
        1 is opaque; of smoke, how thick it is.
    edges : bool
        Draw the edges of a surface.
    radius : float or callable, optional
        Of particles [m], or `radius(recording)` which returns it; half the distance to the next
        one unless given. Of lines, which are four pixels wide unless given.
    liquid : bool
        Draw the surface of a liquid instead of its particles, unless a field colours these; needs
        `pip install "substep[surface]"`.
    heap : bool
        Light particles by the surface of the heap that they make, not each for itself.
    density : str, optional
        Of a grid the field that is drawn as smoke; `smoke` unless given. Without it a temperature
        is drawn in colours, and else the first field as smoke.
    hidden : bool
        Leave it out.
    roughness : float
        0 is a mirror and 1 is matt, of pictures that Cycles makes.
    metallic : float
        1 is metal and 0 is not, of pictures that Cycles makes.

    Raises
    ------
    InputError
        If a number is not in its range; of a colour that there is not, when it is drawn.
    TypeError
        If something is of another type.

    Examples
    --------
    >>> import substep
    >>> substep.render.Look("tomato", edges=True).opacity
    1.0
    """

    color: str | tuple[str, ...] | None = None
    back: str | None = None
    opacity: float = 1.0
    edges: bool = False
    radius: float | Callable[[Recording], float] | None = None
    liquid: bool = False
    heap: bool = False
    density: str | None = None
    hidden: bool = False
    roughness: float = 0.6
    metallic: float = 0.0

    def __post_init__(self) -> None:
        self.check_colors()
        check_real("opacity", self.opacity, nonnegative=True)
        for name in ("edges", "liquid", "heap", "hidden"):
            check_flag(name, getattr(self, name))
        if self.radius is not None and not callable(self.radius):
            check_real("radius", self.radius, positive=True)
        if self.density is not None and not isinstance(self.density, str):
            raise TypeError(f"density: expected the name of a field, got {describe(self.density)}")
        for name in ("roughness", "metallic"):
            if not 0 <= check_real(name, getattr(self, name)) <= 1:
                raise InputError(
                    f"{name}: expected a number from 0 to 1, got {getattr(self, name)}"
                )

    def check_colors(self, known: Callable[[Any], bool] | None = None) -> None:
        """Refuse what are no names of colours, or none that are known.

        Parameters
        ----------
        known : callable, optional
            `known(color)` tells whether there is one.

        Raises
        ------
        InputError
            If a colour is not known.
        TypeError
            If it is no name.
        """
        several = isinstance(self.color, (tuple, list))
        for color in self.color or () if several else (self.color,):
            if several or color is not None:
                check_color("color", color, known)
        if self.back is not None:
            check_color("back", self.back, known)

    def colors(self, tone: str) -> tuple[str, ...]:
        """Its colour or colours.

        Parameters
        ----------
        tone : str
            What is taken unless one is given.

        Returns
        -------
        tuple of str
            At least one.
        """
        if self.color is None or len(self.color) == 0:
            return (tone,)
        return (self.color,) if isinstance(self.color, str) else tuple(self.color)
