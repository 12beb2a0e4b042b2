"""What a recording looks like in three dimensions: cameras, looks of parts, and views of both."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import (
    check_array,
    check_callable,
    check_flag,
    check_name,
    check_real,
    check_sequence,
    describe,
)
from ..base.imports import needs
from ..errors import InputError
from ..recording import Recording
from .extent import box_of, owners_of
from .look import Camera, CameraPath, Light, Look, check_color
from .stage import Coloring, Stage

if TYPE_CHECKING:
    from matplotlib.figure import Figure


SMALL = (4.8, 2.7)  # inches, below which words shrink with the picture
BAR_LEFT, MARGIN = 0.915, 0.01  # of the colour bar, over the width of the picture


@dataclass(frozen=True, eq=False)
class View:
    """A recording in three dimensions: the `picture` of a scene, and of recordings without one.

    Parameters
    ----------
    camera : Camera or CameraPath
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
        [m]; the extent of the parts in all frames unless given.
    ground : callable, optional
        `ground(recording)` returns the height of the ground [m], or None for none; it is at the
        bottom of the box unless given.
    title : callable, optional
        `title(recording, frame)` returns the text above the picture; scene and time unless given.
    nooks : float or callable, optional
        Surfaces nearer to each other than this [m], or than `nooks(recording)`, keep the light of
        the sky from each other: heaps of solids get depth.
    dark : bool
        Draw before a dark background, as suits smoke.
    lights : sequence of Light
        In place of the default ones, from the upper left, from the right
        and along the view.

    Raises
    ------
    InputError
        If a number is not in its range; of a colour or palette that there is not, when it is drawn.
    TypeError
        If something is of another type.

    Examples
    --------
    >>> import substep
    >>> view = substep.render.View(substep.render.Camera(elevation=5.0), color="speed")
    >>> view.color
    'speed'
    """

    camera: Camera | CameraPath = field(default_factory=Camera)
    looks: Mapping[str, Look] = field(default_factory=dict)
    color: str | None = None
    palette: str = "viridis"
    limits: tuple[float, float] | None = None
    bar: bool = True
    box: Callable[[Recording], ArrayLike] | None = None
    ground: Callable[[Recording], float | None] | None = None
    title: Callable[[Recording, int], str] | None = None
    nooks: float | Callable[[Recording], float] | None = None
    dark: bool = False
    lights: Sequence[Light] = ()

    def __post_init__(self) -> None:
        check_type("camera", self.camera, (Camera, CameraPath), "a Camera or CameraPath")
        check_type("looks", self.looks, Mapping, "a mapping of parts to Looks")
        for name, look in self.looks.items():
            check_type(f"looks[{name!r}]", look, Look, "a Look")
        if self.color is not None:
            check_type("color", self.color, str, "the name of a field")
        check_type("palette", self.palette, str, "the name of a palette")
        if self.limits is not None:
            low, high = check_array("limits", self.limits, (2,)).tolist()
            if not low < high:
                raise InputError(f"limits: expected the lower one first, got {low} and {high}")
            object.__setattr__(self, "limits", (low, high))
        for name in ("bar", "dark"):
            check_flag(name, getattr(self, name))
        for name in ("box", "ground", "title"):
            if getattr(self, name) is not None:
                check_callable(name, getattr(self, name))
        if self.nooks is not None and not callable(self.nooks):
            check_real("nooks", self.nooks, positive=True)
        for light in check_sequence("lights", self.lights, "Lights"):
            check_type("lights", light, Light, "Lights")

    def __call__(self, recording: Recording, frame: int, figure: Figure) -> None:
        """Draw one frame on a matplotlib figure."""
        width, height = np.rint(figure.get_size_inches() * figure.dpi).astype(int)
        stage = self._stage(recording, (int(width), int(height)))
        figure.set_layout_engine("none")
        axes: Any = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.imshow(stage.image(recording, frame), aspect="auto", interpolation="none")
        title = self.title or default_title
        ink = "0.9" if self.dark else "black"
        small = min(1.0, *(figure.get_size_inches() / SMALL))
        figure.text(0.02, 0.965, title(recording, frame), va="top", fontsize=11 * small, color=ink)
        if self.bar and self.color is not None and stage.range is not None:
            unit = _unit(recording, self.color)
            _add_color_bar(figure, self.color, unit, stage.range, self.palette, ink, small)

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

    def region(self, recording: Recording) -> tuple[NDArray[np.float64], float | None]:
        """What is shown.

        Parameters
        ----------
        recording : Recording
            Open.

        Returns
        -------
        tuple
            Lowest and highest corner of the region, shape (2, 3), and height of the ground or None
            [m].

        Raises
        ------
        InputError
            If `box` or `ground` return a wrong value.
        """
        box = box_of(recording, self.looks) if self.box is None else self.box(recording)
        box = check_array("box", box, (2, 3))
        if np.any(box[0] > box[1]):
            raise InputError("box: expected the lowest corner first, then the highest")
        ground = float(box[0, 2]) if self.ground is None else self.ground(recording)
        return box, None if ground is None else check_real("ground", ground)

    def check(self, recording: Recording) -> None:
        """Refuse parts and fields that the recording does not have, and unknown colours.

        Parameters
        ----------
        recording : Recording
            Open.

        Raises
        ------
        InputError
            If there is none of that name.
        ImportError
            If matplotlib is missing.
        """
        with needs("matplotlib", 'matplotlib is missing: pip install "substep[plot]" for pictures'):
            from matplotlib import colormaps
            from matplotlib.colors import is_color_like
        if self.palette not in colormaps:
            wanted = "a palette of matplotlib"
            raise InputError(f"palette: expected {wanted}, got {describe(self.palette)}")
        for look in self.looks.values():
            look.check_colors(is_color_like)
        for light in self.lights:
            check_color("color", light.color, is_color_like)
        for name in self.looks:
            check_name("looks", name, recording.parts)
        if self.color is not None:
            owners_of(recording, self.color)

    def _stage(self, recording: Recording, size: tuple[int, int]) -> Stage:
        """The stage of this view, kept as long as the recording is there."""
        self.check(recording)
        stages = _STAGES.setdefault(recording, {})
        key = (self, size)
        if key not in stages:
            box, ground = self.region(recording)
            coloring = None
            if self.color is not None:
                coloring = Coloring(self.color, self.palette, self.limits)
            nooks = self.nooks(recording) if callable(self.nooks) else self.nooks
            if nooks is not None:
                nooks = check_real("nooks", nooks, positive=True)
            stages[key] = Stage(
                recording,
                size,
                self.camera,
                self.looks,
                coloring,
                box,
                ground,
                nooks,
                self.dark,
                self.lights,
            )
        return stages[key]


_STAGES: weakref.WeakKeyDictionary[Recording, dict[tuple[View, tuple[int, int]], Stage]] = (
    weakref.WeakKeyDictionary()
)


def check_type(name: str, value: Any, kinds: Any, wanted: str) -> None:
    """Refuse a value of another type."""
    if not isinstance(value, kinds):
        raise TypeError(f"{name}: expected {wanted}, got {describe(value)}")


def default_title(recording: Recording, frame: int) -> str:
    """Scene and time."""
    return f"{recording.scene or 'recording'}, t = {recording.times[frame]:.3f} s"


def _unit(recording: Recording, name: str) -> str:
    return next(p.fields[name] for p in recording.parts.values() if name in p.fields)


def _add_color_bar(
    figure: Figure,
    name: str,
    unit: str,
    limits: tuple[float, float],
    palette: str,
    ink: str,
    small: float,
) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    shown = ScalarMappable(Normalize(*limits), cmap=palette)
    axes = figure.add_axes((BAR_LEFT, 0.2, 0.014, 0.6))
    label = name if unit in ("", "1") else f"{name} [{unit}]"
    bar = figure.colorbar(shown, cax=axes)
    bar.set_label(label, color=ink, fontsize=10 * small, labelpad=4 * small)
    bar.ax.tick_params(colors=ink, labelsize=10 * small, length=3.5 * small, pad=3.5 * small)
    # Numbers and name want their room, which is more of a small picture.
    extent: Any = axes.get_tightbbox()
    reach = extent.transformed(figure.transFigure.inverted()).x1
    left = min(BAR_LEFT, BAR_LEFT - (reach - (1 - MARGIN)))
    axes.set_position((left, 0.2, 0.014, 0.6))
