"""Pictures (PNG) and movies (MP4) of recordings, by matplotlib.

A recording names its scene, and the scene knows how to draw it; a recording of another origin gets
a plain view of its parts.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ._checks import check_integer, check_real
from .errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .recording import Recording
    from .scenes import Scene

SIZE = (9.6, 5.4)  # inches
DPI = 100  # of movies, 960 x 540 pixels; pictures have 1.5 times as many a side
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
    try:
        import matplotlib
        import matplotlib.figure
    except ImportError:
        raise ImportError(
            'matplotlib is missing: pip install "substep[plot]" for pictures and movies'
        ) from None
    return matplotlib


def draw(recording: Recording, frame: int = -1, *, scene: Scene | None = None) -> Figure:
    """Draw one frame.

    Parameters
    ----------
    recording : Recording
        The recording.
    frame : int
        Frame number; negative numbers count from the end.
    scene : Scene, optional
        Whose picture to draw; the built-in scene that the recording names unless given.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    InputError
        If there is no such frame.
    ImportError
        If matplotlib is missing.

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
        figure: Figure = matplotlib.figure.Figure(figsize=SIZE, dpi=DPI)
        _picture_of(recording, scene)(recording, _frame_number(recording, frame), figure)
    return figure


def save_picture(
    path: str | Path, out: str | Path, *, frame: int = -1, scene: Scene | None = None
) -> Path:
    """Draw one frame of a recording into a PNG file, replacing it if it exists.

    Parameters
    ----------
    path : str or Path
        The recording: VTKHDF or journal.
    out : str or Path
        The picture.
    frame : int
        Frame number; negative numbers count from the end.
    scene : Scene, optional
        Whose picture to draw; the built-in scene that the recording names unless given.

    Returns
    -------
    Path
        The picture.

    Raises
    ------
    InputError
        If there is no such frame.
    ImportError
        If matplotlib is missing.

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
    from .recording import Recording

    matplotlib = _matplotlib()
    out = Path(out)
    with Recording(path) as recording, matplotlib.rc_context(STYLE):
        figure = draw(recording, frame, scene=scene)
        with _whole_file(out) as part:
            figure.savefig(part, format="png", dpi=1.5 * DPI, metadata={"Software": "substep"})
    return out


def save_movie(
    path: str | Path,
    out: str | Path,
    *,
    fps: float = 25.0,
    scene: Scene | None = None,
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
    on_frame : callable, optional
        `on_frame(frame, frames, time)` is called after each frame.

    Returns
    -------
    Path
        The movie.

    Raises
    ------
    InputError
        If the recording holds no frame.
    ImportError
        If matplotlib or imageio-ffmpeg is missing.

    Examples
    --------
    >>> import substep
    >>> substep.render.save_movie("kepler.vtkhdf", "kepler.mp4", fps=12)  # doctest: +SKIP
    PosixPath('kepler.mp4')
    """
    from .recording import Recording

    matplotlib = _matplotlib()
    try:
        import imageio_ffmpeg
    except ImportError:
        raise ImportError(
            'imageio-ffmpeg is missing: pip install "substep[plot]" for movies'
        ) from None
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    out = Path(out)
    fps = check_real("fps", fps, positive=True)
    with Recording(path) as recording, matplotlib.rc_context(STYLE), _whole_file(out) as part:
        frames = len(recording)
        _frame_number(recording, 0)
        picture = _picture_of(recording, scene)
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


def _picture_of(
    recording: Recording, scene: Scene | None
) -> Callable[[Recording, int, Figure], None]:
    from .scenes import load, names

    if scene is None and recording.scene in names():
        scene = load(recording.scene)
    return plain_picture if scene is None or scene.picture is None else scene.picture


def plain_picture(recording: Recording, frame: int, figure: Figure) -> None:
    """Draw the points of every part, coloured by the first field.

    Parameters
    ----------
    recording : Recording
        The recording.
    frame : int
        Frame number from 0.
    figure : matplotlib.figure.Figure
        Drawn on.

    Examples
    --------
    >>> import substep
    >>> substep.render.plain_picture(recording, 0, figure)  # doctest: +SKIP
    """
    arrays = recording.frame(frame)
    flat = all(
        part["points"].shape[1] == 2 or not np.any(part["points"][:, 2]) for part in arrays.values()
    )
    axes: Any = figure.add_subplot(projection=None if flat else "3d")
    for name, part in recording.parts.items():
        points = arrays[name]["points"]
        columns = points.T[:2] if flat else points.T[:3]
        style: dict[str, Any] = {"s": marker_area(len(points)), "linewidths": 0, "label": name}
        field = next(iter(part.fields), None)
        if field is None:
            axes.scatter(*columns, **style)
            continue
        values = arrays[name][field]
        values = np.linalg.norm(values, axis=1) if values.ndim == 2 else values
        shown = axes.scatter(*columns, c=values, **style)
        unit = part.fields[field]
        figure.colorbar(shown, ax=axes, label=f"{name}: {field}" + (f" [{unit}]" if unit else ""))
    axes.set_aspect("equal")
    axes.set_xlabel("x")
    axes.set_ylabel("y")
    axes.set_title(
        f"{recording.scene or 'recording'}, t = {recording.times[frame]:.4g} s", loc="left"
    )


def marker_area(points: int) -> float:
    """Area of a marker [points^2] with which so many fill a figure without hiding each other.

    Parameters
    ----------
    points : int
        How many markers there are.

    Returns
    -------
    float
        The area.

    Examples
    --------
    >>> import substep
    >>> substep.render.marker_area(10)
    30.0
    """
    return float(np.clip(2e5 / max(points, 1), 0.2, 30.0))
