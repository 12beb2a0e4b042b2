"""What a recording looks like in three dimensions: cameras, looks of parts, and views of both."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._checks import check_real
from .errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ._render3d import Stage
    from .recording import Recording


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
        1 is opaque.
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
    hidden: bool = False


@dataclass(frozen=True, eq=False)
class View:
    """A recording in three dimensions: the `picture` of a scene, and of recordings without one.

    Parameters
    ----------
    camera : Camera
        Where from.
    looks : mapping of str to Look
        By part; parts that are not named look as they do by default.
    color : str, optional
        Field that colours the parts which have it; of vectors the norm.
    palette : str
        Name of the colours of that field, as matplotlib has them.
    limits : tuple of float, optional
        Its values at the ends of the palette; the least and the greatest in all frames unless
        given.
    bar : bool
        Draw the bar of these colours, with the name of the field and its unit.
    box : callable, optional
        `box(recording)` returns the lowest and highest corner of the region shown, shape (2, 3)
        [m]; what the parts reach in all frames unless given.
    ground : callable, optional
        `ground(recording)` returns the height of the ground [m], or None for none; it is at the
        bottom of the box unless given.
    title : callable, optional
        `title(recording, frame)` returns the text above the picture; scene and time unless given.
    nooks : float or callable, optional
        Surfaces nearer to each other than this [m], or than `nooks(recording)`, keep the light of
        the sky from each other: heaps of solids get depth.

    Examples
    --------
    >>> import substep
    >>> view = substep.render.View(substep.render.Camera(elevation=5.0), color="speed")
    >>> view.camera.elevation
    5.0
    """

    camera: Camera = Camera()
    looks: Mapping[str, Look] = field(default_factory=dict)
    color: str | None = None
    palette: str = "viridis"
    limits: tuple[float, float] | None = None
    bar: bool = True
    box: Callable[[Recording], ArrayLike] | None = None
    ground: Callable[[Recording], float | None] | None = None
    title: Callable[[Recording, int], str] | None = None
    nooks: float | Callable[[Recording], float] | None = None

    def __call__(self, recording: Recording, frame: int, figure: Figure) -> None:
        """Draw one frame on a matplotlib figure."""
        width, height = np.rint(figure.get_size_inches() * figure.dpi).astype(int)
        stage = self._stage(recording, (int(width), int(height)))
        figure.set_layout_engine("none")
        axes: Any = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.imshow(stage.image(recording, frame), aspect="auto", interpolation="none")
        title = self.title or default_title
        figure.text(0.02, 0.965, title(recording, frame), va="top", fontsize=11)
        if self.bar and self.color is not None and stage.range is not None:
            unit = _unit(recording, self.color)
            _add_color_bar(figure, self.color, unit, stage.range, self.palette)

    def image(
        self, recording: Recording, frame: int = -1, size: tuple[int, int] = (960, 540)
    ) -> NDArray[np.uint8]:
        """One frame as pixels, without title and colour bar.

        Parameters
        ----------
        recording : Recording
            Open.
        frame : int
            Frame number; negative numbers count from the end.
        size : tuple of int
            Width and height [pixels].

        Returns
        -------
        ndarray of uint8, shape (height, width, 3)
            Red, green and blue.

        Raises
        ------
        ImportError
            If PyVista, or the system's EGL library, is missing.
        """
        return self._stage(recording, size).image(recording, frame)

    def _stage(self, recording: Recording, size: tuple[int, int]) -> Stage:
        """The stage of this view, kept as long as the recording is there."""
        from ._extent import box_of
        from ._render3d import Coloring, Stage

        stages = _STAGES.setdefault(recording, {})
        key = (self, size)
        if key not in stages:
            box = box_of(recording, self.looks) if self.box is None else self.box(recording)
            box = np.asarray(box, float)
            ground = float(box[0, 2]) if self.ground is None else self.ground(recording)
            coloring = None
            if self.color is not None:
                coloring = Coloring(self.color, self.palette, self.limits)
            nooks = self.nooks(recording) if callable(self.nooks) else self.nooks
            stages[key] = Stage(
                recording, size, self.camera, self.looks, coloring, box, ground, nooks
            )
        return stages[key]


_STAGES: weakref.WeakKeyDictionary[Recording, dict[tuple[View, tuple[int, int]], Stage]] = (
    weakref.WeakKeyDictionary()
)


def default_title(recording: Recording, frame: int) -> str:
    """Scene and time."""
    return f"{recording.scene or 'recording'}, t = {recording.times[frame]:.3f} s"


def _unit(recording: Recording, name: str) -> str:
    return next(p.fields[name] for p in recording.parts.values() if name in p.fields)


def _add_color_bar(
    figure: Figure, name: str, unit: str, limits: tuple[float, float], palette: str
) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    shown = ScalarMappable(Normalize(*limits), cmap=palette)
    axes = figure.add_axes((0.915, 0.2, 0.014, 0.6))
    label = name if unit in ("", "1") else f"{name} [{unit}]"
    figure.colorbar(shown, cax=axes, label=label)
