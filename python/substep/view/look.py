"""Cameras, and what the parts of a recording look like."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..base.checks import check_real
from ..errors import InputError
from ..recording import Recording


@dataclass(frozen=True)
class Camera:
    """Where a scene is looked at from; its distance follows from what is to be seen.

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


@dataclass(frozen=True)
class Look:
    """What one part of a recording looks like.

    Parameters
    ----------
    color : str, optional
        A colour that matplotlib knows; one of a palette unless given, grey for what never moves.
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

    Examples
    --------
    >>> import substep
    >>> substep.render.Look("tomato", edges=True).opacity
    1.0
    """

    color: str | None = None
    back: str | None = None
    opacity: float = 1.0
    edges: bool = False
    radius: float | Callable[[Recording], float] | None = None
    liquid: bool = False
    heap: bool = False
    density: str | None = None
    hidden: bool = False
