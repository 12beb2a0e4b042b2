"""Pictures (PNG) and movies (MP4) of recordings, by matplotlib, and in three dimensions by PyVista.

A recording names its scene, and the scene knows how to draw it; a recording of another origin gets
a plain view of its parts. Pictures in three dimensions are `View`s.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .base.checks import check_integer, check_real, describe
from .base.imports import needs
from .errors import InputError
from .recording import Recording
from .scenes import Scene, load, names
from .view import Camera, Look, View, marker_area, plain_picture
from .view.extent import is_flat

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "Camera",
    "Look",
    "View",
    "draw",
    "marker_area",
    "plain_picture",
    "save_movie",
    "save_picture",
]


def __dir__() -> list[str]:
    return __all__


SIZE = (9.6, 5.4)  # inches
DPI = 100  # of movies, 960 x 540 pixels
PICTURE_DPI = 150  # 1440 x 810 pixels
STYLE = {
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": False,
    "image.cmap": "viridis",
    "figure.constrained_layout.use": True,
    "path.simplify": True,
}


def _matplotlib() -> Any:
    told = 'matplotlib is missing: pip install "substep[plot]" for pictures and movies'
    with needs("matplotlib", told):
        import matplotlib
        import matplotlib.figure
    return matplotlib


def draw(
    recording: Recording,
    frame: int | None = None,
    *,
    scene: Scene | None = None,
    camera: Camera | None = None,
    color: str | None = None,
    view: View | None = None,
) -> Figure:
    """Draw one frame.

    Parameters
    ----------
    recording : Recording
        The recording.
    frame : int, optional
        Frame number; negative numbers count from the end. The one that the scene chose, or else
        the last, unless given.
    scene : Scene, optional
        Whose picture to draw; the built-in scene that the recording names unless given.
    camera : Camera, optional
        Where a picture in three dimensions is taken from.
    color : str, optional
        Field that colours a picture in three dimensions, with a colour bar.
    view : View, optional
        Draws it in three dimensions, in place of the picture of a scene.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    InputError
        If there is no such frame or field, or the picture is not in three dimensions.
    ImportError
        If matplotlib is missing; in three dimensions PyVista, or the system's EGL library.

    Examples
    --------
    >>> import substep, tempfile
    >>> scene = substep.scenes.load("double-gyre")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     outcome = substep.scenes.run(scene, {"particles": 100}, folder, frames=3)
    ...     with substep.Recording(outcome.recording) as recording:
    ...         figure = substep.render.draw(recording)
    >>> len(figure.axes)
    2
    """
    matplotlib = _matplotlib()
    with matplotlib.rc_context(STYLE):
        figure: Figure = matplotlib.figure.Figure(figsize=SIZE, dpi=PICTURE_DPI)
        frame = _frame_number(recording, _still(recording, scene) if frame is None else frame)
        _picture_of(recording, scene, camera, color, view)(recording, frame, figure)
    return figure


def save_picture(
    path: str | Path,
    out: str | Path,
    *,
    frame: int | None = None,
    scene: Scene | None = None,
    camera: Camera | None = None,
    color: str | None = None,
    view: View | None = None,
) -> Path:
    """Draw one frame of a recording into a PNG file, replacing it if it exists.

    Parameters
    ----------
    path : str or Path
        The recording: VTKHDF or journal.
    out : str or Path
        The picture.
    frame : int, optional
        Frame number; negative numbers count from the end. The one that the scene chose, or else
        the last, unless given.
    scene : Scene, optional
        Whose picture to draw; the built-in scene that the recording names unless given.
    camera : Camera, optional
        Where a picture in three dimensions is taken from.
    color : str, optional
        Field that colours a picture in three dimensions, with a colour bar.
    view : View, optional
        Draws it in three dimensions, in place of the picture of a scene.

    Returns
    -------
    Path
        The picture.

    Raises
    ------
    InputError
        If there is no such frame or field, or the picture is not in three dimensions.
    ImportError
        If matplotlib is missing; in three dimensions PyVista, or the system's EGL library.

    Examples
    --------
    >>> import substep, tempfile
    >>> scene = substep.scenes.load("double-gyre")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     outcome = substep.scenes.run(scene, {"particles": 100}, folder, frames=3)
    ...     picture = substep.render.save_picture(outcome.recording, folder + "/gyre.png")
    >>> picture.name
    'gyre.png'
    """
    matplotlib = _matplotlib()
    out = Path(out)
    with Recording(path) as recording, matplotlib.rc_context(STYLE):
        figure = draw(recording, frame, scene=scene, camera=camera, color=color, view=view)
        with _whole_file(out) as part:
            figure.savefig(part, format="png", dpi="figure", metadata={"Software": "substep"})
    return out


def save_movie(
    path: str | Path,
    out: str | Path,
    *,
    fps: float = 25.0,
    scene: Scene | None = None,
    camera: Camera | None = None,
    color: str | None = None,
    view: View | None = None,
    on_frame: Callable[[int, int, float], None] | None = None,
) -> Path:
    """Draw every frame of a recording into an MP4 file (H.264), replacing it if it exists.

    Parameters
    ----------
    path : str or Path
        The recording: VTKHDF or journal.
    out : str or Path
        The movie.
    fps : float
        Frames shown per second.
    scene : Scene, optional
        Whose picture to draw; the built-in scene that the recording names unless given.
    camera : Camera, optional
        Where a picture in three dimensions is taken from.
    color : str, optional
        Field that colours a picture in three dimensions, with a colour bar.
    view : View, optional
        Draws it in three dimensions, in place of the picture of a scene.
    on_frame : callable, optional
        `on_frame(frame, frames, time)` is called after each frame.

    Returns
    -------
    Path
        The movie.

    Raises
    ------
    InputError
        If `out` does not end in .mp4, the recording holds no frame or no such field, or the picture
        is not in three dimensions.
    ImportError
        If matplotlib or imageio-ffmpeg is missing; in three dimensions PyVista, or the system's EGL
        library.

    Examples
    --------
    >>> import substep
    >>> substep.render.save_movie("kepler.vtkhdf", "kepler.mp4", fps=12)  # doctest: +SKIP
    PosixPath('kepler.mp4')
    """
    matplotlib = _matplotlib()
    told = 'imageio-ffmpeg is missing: pip install "substep[plot]" for movies'
    with needs("imageio_ffmpeg", told):
        import imageio_ffmpeg
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    out = Path(out)
    if out.suffix.lower() != ".mp4":
        raise InputError(f"out: expected a file ending in .mp4, got {describe(str(out))}")
    fps = check_real("fps", fps, positive=True)
    with Recording(path) as recording, matplotlib.rc_context(STYLE), _whole_file(out) as part:
        frames = len(recording)
        _frame_number(recording, 0)
        picture = _picture_of(recording, scene, camera, color, view)
        figure = matplotlib.figure.Figure(figsize=SIZE, dpi=DPI)
        canvas = FigureCanvasAgg(figure)
        size = (round(SIZE[0] * DPI), round(SIZE[1] * DPI))
        writer = imageio_ffmpeg.write_frames(
            str(part), size, fps=fps, macro_block_size=2, quality=7, ffmpeg_log_level="error"
        )
        writer.send(None)
        try:
            for frame in range(frames):
                figure.clear()
                picture(recording, frame, figure)
                canvas.draw()
                pixels = np.asarray(canvas.buffer_rgba())[:, :, :3]
                writer.send(np.ascontiguousarray(pixels))
                if on_frame is not None:
                    on_frame(frame, frames, float(recording.times[frame]))
        finally:
            writer.close()
    return out


class _whole_file:
    """A path to write to, renamed to the wanted one at the end, removed on an error."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._part = out.with_name(f".{out.stem}.part{out.suffix}")

    def __enter__(self) -> Path:
        if self._out.is_dir():
            raise IsADirectoryError(21, os.strerror(21), str(self._out))
        return self._part

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            os.replace(self._part, self._out)
        else:
            with suppress(FileNotFoundError):
                self._part.unlink()


def _frame_number(recording: Recording, frame: int) -> int:
    frames = len(recording)
    if frames == 0:
        raise InputError("the recording holds no frame yet")
    frame = check_integer("frame", frame, minimum=-frames, maximum=frames - 1)
    return frame % frames


def _scene_of(recording: Recording, scene: Scene | None) -> Scene | None:
    if scene is None:
        return load(recording.scene) if recording.scene in names() else None
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: expected a Scene, got {describe(scene)}")
    return scene


def _still(recording: Recording, scene: Scene | None) -> int:
    """The frame that the scene chose, or the last."""
    scene = _scene_of(recording, scene)
    if scene is None or scene.still is None or len(recording) == 0:
        return -1
    return int(np.argmin(np.abs(recording.times[:] - scene.still(recording))))


def _picture_of(
    recording: Recording,
    scene: Scene | None,
    camera: Camera | None,
    color: str | None,
    view: View | None,
) -> Callable[[Recording, int, Figure], None]:
    if view is not None and not isinstance(view, View):
        raise TypeError(f"view: expected a View, got {describe(view)}")
    scene = _scene_of(recording, scene)
    picture: Callable[[Recording, int, Figure], None] | None
    picture = view if scene is None or view is not None else scene.picture
    if picture is None:
        picture = plain_picture if is_flat(recording) else View()
    changes: dict[str, Any] = {"camera": camera, "color": color}
    for name, value in changes.items():
        if value is not None:
            if not isinstance(picture, View):
                raise InputError(f"{name}: only pictures in three dimensions have one")
            picture = dataclasses.replace(picture, **{name: value})
            if name == "color":  # what suits the values of the scene's own field may not suit these
                picture = dataclasses.replace(picture, palette=View.palette, limits=None, bar=True)
    return picture
