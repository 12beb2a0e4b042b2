"""Pictures (PNG) and movies (MP4) of recordings, by matplotlib, and in three dimensions by PyVista.

A recording names its scene, and the scene knows how to draw it; a recording of another origin gets
a plain view of its parts. Pictures in three dimensions are `View`s.
"""

from __future__ import annotations

import dataclasses
import errno
import os
import secrets
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .base.checks import (
    check_callable,
    check_choice,
    check_integer,
    check_real,
    describe,
)
from .base.imports import needs
from .base.replacing import check_file_name, check_folder
from .errors import InputError
from .recording import Recording
from .recording.files import check_not_itself
from .scenes import Scene, load, names, record
from .scenes.declaration import Simulation
from .scenes.record import check_simulation
from .view import Camera, CameraPath, Light, Look, View, marker_area, plain_picture
from .view.extent import is_flat
from .view.film import Film, find_ffmpeg
from .view.stage import import_pyvista

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "Camera",
    "CameraPath",
    "Light",
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


DPI = 100  # of movies
PICTURE_DPI = 150
ENGINES = ("vtk", "cycles")
SLOWEST, FASTEST = 1e-3, 1e5  # frames per second that films can have
AT_A_TIME = 50  # frames that Cycles makes before the film takes them
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
    camera: Camera | CameraPath | None = None,
    color: str | None = None,
    view: View | None = None,
    size: tuple[int, int] = (1440, 810),
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
    camera : Camera or CameraPath, optional
        Where a picture in three dimensions is taken from.
    color : str, optional
        Field that colours a picture in three dimensions, with a colour bar.
    view : View, optional
        Draws it in three dimensions, in place of the picture of a scene.
    size : tuple of int
        Width and height at the figure's own resolution [pixels].

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
    inches = np.array(_check_size(size)) / PICTURE_DPI
    with matplotlib.rc_context(STYLE):
        figure: Figure = matplotlib.figure.Figure(figsize=tuple(inches), dpi=PICTURE_DPI)
        frame = _frame_number(recording, _still(recording, scene) if frame is None else frame)
        _picture_of(recording, scene, camera, color, view)(recording, frame, figure)
    return figure


def save_picture(
    source: str | Path | Simulation,
    out: str | Path,
    *,
    frame: int | None = None,
    scene: Scene | None = None,
    camera: Camera | CameraPath | None = None,
    color: str | None = None,
    view: View | None = None,
    size: tuple[int, int] = (1440, 810),
    engine: str = "vtk",
    samples: int = 64,
) -> Path:
    """Draw one frame of a recording, or a simulation as it is, into a PNG file.

    A file that is there is replaced.

    Parameters
    ----------
    source : str, Path or simulation
        The recording, VTKHDF or journal, or any simulation, which is not changed.
    out : str or Path
        The picture.
    frame : int, optional
        Frame number; negative numbers count from the end. The one that the scene chose, or else
        the last, unless given.
    scene : Scene, optional
        Whose picture to draw; the built-in scene that the recording names unless given.
    camera : Camera or CameraPath, optional
        Where a picture in three dimensions is taken from.
    color : str, optional
        Field that colours a picture in three dimensions, with a colour bar.
    view : View, optional
        Draws it in three dimensions, in place of the picture of a scene.
    size : tuple of int
        Width and height [pixels].
    engine : {'vtk', 'cycles'}
        Cycles traces the ways of light, which takes seconds to minutes for an image, and draws
        neither title nor colour bar (``pip install "substep[blender]"``, in Python 3.11).
    samples : int
        Ways of light for each pixel of Cycles; its noise, which is then filtered, falls with the
        square root.

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
    out, size = Path(check_file_name(out, "out")), _check_size(size)
    _check_source(source)
    engine, samples = _check_engine(engine, samples)
    with _recorded(source, out) as recording, matplotlib.rc_context(STYLE):
        if engine == "cycles":
            view = _view_of(recording, scene, camera, color, view)
            k = _frame_number(recording, _still(recording, scene) if frame is None else frame)
            with _whole_file(out) as part:
                _trace(recording, view, [k], lambda _: part, size, samples)
            return out
        figure = draw(
            recording, frame, scene=scene, camera=camera, color=color, view=view, size=size
        )
        with _whole_file(out) as part:
            figure.savefig(part, format="png", dpi="figure", metadata={"Software": "substep"})
    return out


def save_movie(
    source: str | Path | Simulation,
    out: str | Path,
    duration: float | None = None,
    *,
    fps: float = 25.0,
    scene: Scene | None = None,
    camera: Camera | CameraPath | None = None,
    color: str | None = None,
    view: View | None = None,
    size: tuple[int, int] = (960, 540),
    engine: str = "vtk",
    samples: int = 64,
    on_frame: Callable[[int, int, float], None] | None = None,
) -> Path:
    """Draw every frame of a recording, or a simulation as it goes on, into an MP4 file (H.264).

    A file that is there is replaced.

    Parameters
    ----------
    source : str, Path or simulation
        The recording, VTKHDF or journal, or any simulation, which is advanced by `duration`, or
        left as it was if no film can be made of it.
    out : str or Path
        The movie.
    duration : float, optional
        How long a simulation is filmed [s]; a recording has its own times.
    fps : float
        Frames shown per second, from 0.001 to 100000; of a simulation also frames per second of its
        time.
    scene : Scene, optional
        Whose picture to draw; the built-in scene that the recording names unless given.
    camera : Camera or CameraPath, optional
        Where a picture in three dimensions is taken from.
    color : str, optional
        Field that colours a picture in three dimensions, with a colour bar.
    view : View, optional
        Draws it in three dimensions, in place of the picture of a scene.
    size : tuple of int
        Width and height [pixels], even numbers.
    engine : {'vtk', 'cycles'}
        Cycles traces the ways of light, which takes seconds to minutes for an image, and draws
        neither title nor colour bar (``pip install "substep[blender]"``, in Python 3.11).
    samples : int
        Ways of light for each pixel of Cycles; its noise, which is then filtered, falls with the
        square root.
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
    OSError
        If the file cannot be written, as on a full disk; the previous file stays.

    Examples
    --------
    >>> import substep
    >>> substep.render.save_movie("kepler.vtkhdf", "kepler.mp4", fps=12)  # doctest: +SKIP
    PosixPath('kepler.mp4')
    """
    matplotlib = _matplotlib()
    find_ffmpeg()
    out = Path(check_file_name(out, "out"))
    if out.suffix.lower() != ".mp4":
        raise InputError(f"out: expected a file ending in .mp4, got {describe(str(out))}")
    fps = check_real("fps", fps)
    if not SLOWEST <= fps <= FASTEST:
        raise InputError(f"fps: expected a number from {SLOWEST} to {FASTEST}, got {fps}")
    size = _check_size(size, even=True)
    engine, samples = _check_engine(engine, samples)
    if on_frame is not None:
        check_callable("on_frame", on_frame)
    duration = _check_duration(source, duration)
    if isinstance(source, (str, os.PathLike)):
        filmed = _recorded(source, out)
    else:
        filmed = _filmed(source, duration, fps, scene, camera, color, view, engine=engine)
    with (
        matplotlib.rc_context(STYLE),
        _whole_file(out) as part,
        filmed as recording,
    ):
        frames = len(recording)
        _frame_number(recording, 0)
        if engine == "cycles":
            images = _traced(
                recording, _view_of(recording, scene, camera, color, view), size, samples
            )
        else:
            images = _drawn(recording, _picture_of(recording, scene, camera, color, view), size)
        with Film(part, size, fps) as film:
            for frame, pixels in enumerate(images):
                film.add(pixels)
                if on_frame is not None:
                    on_frame(frame, frames, float(recording.times[frame]))
    return out


def _drawn(
    recording: Recording, picture: Callable[[Recording, int, Figure], None], size: tuple[int, int]
) -> Iterator[NDArray[np.uint8]]:
    """Frame by frame, on one figure."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(size[0] / DPI, size[1] / DPI), dpi=DPI)
    canvas = FigureCanvasAgg(figure)
    for frame in range(len(recording)):
        figure.clear()
        picture(recording, frame, figure)
        canvas.draw()
        yield np.asarray(canvas.buffer_rgba())[:, :, :3]


def _traced(
    recording: Recording, view: View, size: tuple[int, int], samples: int
) -> Iterator[NDArray[np.uint8]]:
    """Frame by frame, of which Blender makes many at a time."""
    from matplotlib.image import imread

    with tempfile.TemporaryDirectory() as folder:
        for first in range(0, len(recording), AT_A_TIME):
            frames = range(first, min(first + AT_A_TIME, len(recording)))
            path = {k: Path(folder) / f"{k}.png" for k in frames}
            _trace(recording, view, frames, path.__getitem__, size, samples)
            for k in frames:
                yield np.rint(255 * imread(path[k])[..., :3]).astype(np.uint8)
                path[k].unlink()


def _trace(*arguments: Any) -> None:
    from .export.cycles import trace

    trace(*arguments)


def _view_of(recording: Recording, *how: Any) -> View:
    picture = _picture_of(recording, *how)
    if not isinstance(picture, View):
        raise InputError("engine: Cycles makes pictures in three dimensions; give a view")
    return picture


def _check_size(size: Any, even: bool = False) -> tuple[int, int]:
    if not isinstance(size, (tuple, list)) or len(size) != 2:
        raise InputError(f"size: expected width and height, got {describe(size)}")
    width, height = (check_integer("size", n, minimum=16, maximum=16384) for n in size)
    if even and (width % 2 or height % 2):
        raise InputError(f"size: expected even numbers for a movie, got {width} x {height}")
    return width, height


def _check_engine(engine: Any, samples: Any) -> tuple[str, int]:
    samples = check_integer("samples", samples, minimum=1, maximum=1 << 20)
    return check_choice("engine", engine, ENGINES), samples


def _check_source(source: Any) -> None:
    if not isinstance(source, (str, os.PathLike)):
        check_simulation("source", source, "a recording or a simulation")


def _check_duration(source: Any, duration: Any) -> float:
    _check_source(source)
    if isinstance(source, (str, os.PathLike)):
        if duration is not None:
            raise InputError("duration: a recording has its own times; it is for simulations")
        return 0.0
    if duration is None:
        raise InputError("duration: expected how long the simulation is filmed [s]")
    return check_real("duration", duration, positive=True)


@contextmanager
def _recorded(source: Any, out: Path) -> Iterator[Recording]:
    """The recording, or one of a simulation as it is, which is then forgotten."""
    if isinstance(source, (str, os.PathLike)):
        with Recording(source) as recording:
            check_not_itself(out, recording.path)
            yield recording
        return
    with tempfile.TemporaryDirectory() as folder:
        path = record(source, Path(folder) / "still.vtkhdf", 0.0)
        with Recording(path) as recording:
            yield recording


@contextmanager
def _filmed(
    source: Simulation, duration: float, fps: float, *how: Any, engine: str
) -> Iterator[Recording]:
    """A recording of a simulation that goes on; it is as it was if there is no film of it."""
    with tempfile.TemporaryDirectory() as folder:
        with Recording(record(source, Path(folder) / "first.vtkhdf", 0.0)) as first:
            _rehearse(first, *how, engine=engine)
        before = source.state()
        try:
            path = record(source, Path(folder) / "film.vtkhdf", duration, fps=fps)
            with Recording(path) as recording:
                yield recording
        except BaseException:
            source.restore(before)
            raise


def _rehearse(
    first: Recording,
    scene: Scene | None,
    camera: Camera | CameraPath | None,
    color: str | None,
    view: View | None,
    *,
    engine: str,
) -> None:
    """Refuse what no film of it can have, by its first frame."""
    points = [arrays["points"] for arrays in first.frame(0).values() if "points" in arrays]
    if view is None and is_flat(first) and any(x.shape[1] == 3 for x in points):
        return  # whether it stays in the plane, and has the picture of one, is not known yet
    picture = _picture_of(first, scene, camera, color, view)
    if engine == "cycles":
        from .export.cycles import check_traced

        check_traced(first, _view_of(first, scene, camera, color, view))
    elif isinstance(picture, View):
        import_pyvista()
        picture.check(first)


class _whole_file:
    """A path to write to, renamed to the wanted one at the end, removed on an error."""

    def __init__(self, out: Path) -> None:
        self._out = out

    def __enter__(self) -> Path:
        out = self._out
        check_folder(out)
        if out.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(out))
        self._part = out.with_name(f".{out.stem[:100]}-{secrets.token_hex(8)}.part{out.suffix}")
        try:
            self._part.open("xb").close()  # so that it can be written is known before there is work
        except OSError as error:
            error.filename = str(out)  # the name that was given
            raise
        return self._part

    def __exit__(self, kind: object, error: object, *_: object) -> None:
        if kind is None:
            os.replace(self._part, self._out)
        else:
            with suppress(FileNotFoundError):
                self._part.unlink()
            if isinstance(error, OSError) and error.filename == str(self._part):
                error.filename = str(self._out)  # the name that was given


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
    camera: Camera | CameraPath | None,
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
            if name == "color" and view is None:  # what suits the scene's own field may not suit it
                picture = dataclasses.replace(picture, palette=View.palette, limits=None, bar=True)
    return picture
