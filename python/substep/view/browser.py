"""Looking at a simulation while it runs, or at a recording, in the browser."""

from __future__ import annotations

import atexit
import math
import os
import sys
import threading
import time
import webbrowser
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..base.checks import check_flag, check_integer, check_name, check_real, describe
from ..base.simulation import Simulation
from ..errors import InputError, SubstepError
from ..geometry import liquid_surface
from ..gridfluid import GridLiquid
from ..pbf import PositionBasedFluid
from ..recording import Recording
from .drawables import Drawable, Scenery, members_of
from .extent import range_of
from .page import legend
from .painted import Paint, Painter, close_server, open_server, place_camera
from .settings import make_settings
from .surfaces import in_space

OWN = "(none)"  # no field: each part has its own colour
WATER = "#2f86bd"
CUTS = ("volume", "cut across x", "cut across y", "cut across z")
MOST_RATE = 30.0  # pictures per second
LOOK = 0.5  # after which a recording may have more frames [s]
GROWING = 30.0  # for which one counts as being written after a frame [s]


def show(
    source: Any,
    *,
    color: str | None = None,
    interval: float | None = None,
    play: bool = False,
    port: int = 8080,
    open_browser: bool | None = None,
    wait: bool | None = None,
) -> Viewer:
    """Show a simulation or a recording in the browser.

    One looks at it from all sides, colours it by any field, and cuts grids. A recording plays, and
    goes to any frame. A simulation runs, pauses, and takes single steps, and what can be set of it
    (gravity, viscosity, ...) is set there. In a notebook the view stands below the cell, whose last
    line this call is; in a script the call ends when the view is closed or with Ctrl-C; elsewhere
    it returns at once.

    The view is served to this machine alone (127.0.0.1) by viser.

    Parameters
    ----------
    source : Simulation, Recording or path-like
        What is shown; a path is that of a recording, which is closed with the view. One that is
        being written is followed.
    color : str, optional
        Field by which parts that have it are coloured at first.
    interval : float, optional
        Of a simulation: time between two pictures [s]; one step unless given.
    play : bool, optional
        Begin to play, or to run, at once.
    port : int, optional
        Where to serve; the next free one if it is taken.
    open_browser : bool, optional
        Open a tab in the browser; in notebooks not, unless given.
    wait : bool, optional
        Return only when the view is closed; in scripts alone, unless given.

    Returns
    -------
    Viewer
        With `url`, `wait()` and `close()`.

    Raises
    ------
    TypeError
        If the source is none of these.
    InputError
        If there is no such field, the recording holds no frame, or a number is out of range.
    ImportError
        If viser is missing: ``pip install "substep[view]"``.
    OSError
        If no port from `port` to 65535 is free.

    Examples
    --------
    >>> import substep
    >>> water = substep.fill_box((0, 0, 0), (0.4, 0.4, 0.4), 0.05)
    >>> liquid = substep.PositionBasedFluid(water, 0.05, colliders=[substep.Plane()])
    >>> viewer = substep.show(liquid, play=True)  # doctest: +SKIP
    """
    opens = isinstance(source, (str, os.PathLike))
    if not opens and not isinstance(source, (Simulation, Recording)):
        raise TypeError(
            f"source: expected a simulation, a recording or its path, got {describe(source)}"
        )
    if interval is not None:
        interval = check_real("interval", interval, positive=True)
    port = check_integer("port", port, minimum=1, maximum=65535)
    play = check_flag("play", play)
    notebook = "ipykernel" in sys.modules
    interactive = notebook or hasattr(sys, "ps1") or bool(sys.flags.interactive)
    shown = Recording(source) if opens else source
    viewer = None
    try:
        viewer = Viewer(shown, color, interval, play, port, owned=opens)
        if open_browser if open_browser is not None else not notebook:
            webbrowser.open(viewer.url)
        if not interactive if wait is None else wait:
            viewer.wait()
    except BaseException:
        try:
            if viewer is not None:
                viewer.close()
        finally:
            if viewer is not None:
                viewer._stop()
            if opens:
                shown.close()
        raise
    return viewer


class Viewer:
    """A view in the browser; `show` makes it.

    Attributes
    ----------
    url : str
        Where it is.
    source : Simulation or Recording
        What it shows.
    """

    def __init__(
        self,
        source: Any,
        color: str | None,
        interval: float | None,
        play: bool,
        port: int,
        owned: bool = False,
    ) -> None:
        self.source, self._owned = source, owned
        self._live = not isinstance(source, Recording)
        if not self._live and not len(source):
            raise InputError(f"{source.path}: has no frames")
        self._scenery = Scenery(source)
        fields = self._scenery.fields
        if color is not None:
            check_name("color", color, fields)
        self._interval = interval
        self._lock = threading.RLock()  # held by whoever touches the source
        self._closed, self._changed = threading.Event(), threading.Event()
        self._stopping, self._stopped = threading.RLock(), False  # of the server
        self._limits: dict[str, tuple[float, float]] = {}
        self._problem = ""
        self._count = 0 if self._live else len(source)  # frames that the slider knows
        self._grew = -math.inf  # when the recording was last seen to have more frames
        self.drawn = 0  # pictures sent
        label = type(source).__name__ if self._live else source.scene or "recording"
        self._thread = threading.Thread(target=self._go, name="substep-view", daemon=True)
        self._server = open_server(label, port)
        try:
            self.url = f"http://127.0.0.1:{self._server.get_port()}"
            self._painter = Painter(self._server)
            place_camera(self._server, self._extent(), self._scenery.flat)
            self._make_controls(color, play)
            self._draw()
            atexit.register(self.close)
            self._thread.start()
        except BaseException:
            try:
                self.close()
            finally:
                self._stop()
            raise

    def wait(self) -> None:
        """Return when the view is closed; Ctrl-C closes it."""
        try:
            while not self._closed.wait(0.2):
                pass
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """End the view, after the step that it is in; the simulation stays as it is.

        A recording that `show` opened by its path is closed.
        """
        self._closed.set()
        self._changed.set()
        if self._stopped:
            return
        try:
            if self._thread.is_alive() and threading.current_thread() is not self._thread:
                self._thread.join()
            with self._lock:  # of a single step
                if self._owned:
                    self.source.close()
        finally:
            try:
                self._stop()
            except BaseException:  # a second interrupt, after which there is to be no server either
                self._stop()
                raise

    def _stop(self) -> None:
        """End the server, unless that is done; what was interrupted may be called again."""
        with self._stopping:
            if not self._stopped:
                close_server(self._server)
                self._stopped = True
                atexit.unregister(self.close)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Viewer({self.url}{', closed' if self._closed.is_set() else ''})"

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" width="100%" height="480" style="border:0"></iframe>'

    def _extent(self) -> list[Drawable]:
        if self._live:
            return self._scenery.at()
        count = len(self.source)
        return [d for k in {0, count // 2, count - 1} for d in self._scenery.at(k)]

    # What is on the right: controls, whose callbacks run in threads of the server.

    def _make_controls(self, color: str | None, play: bool) -> None:
        gui = self._server.gui
        self._told = gui.add_markdown("")
        self._playing = gui.add_checkbox("run" if self._live else "play", initial_value=play)
        self._playing.on_update(self._touch)
        if self._live:
            gui.add_button("step").on_click(self._single)
        else:
            last = self._count - 1
            self._frame = gui.add_slider(
                "frame", min=0, max=max(last, 1), step=1, initial_value=0, disabled=last == 0
            )
            self._frame.on_update(self._touch)
            self._rate = gui.add_number("frames/s", initial_value=25.0, min=0.1, max=1000.0)
        self._color = gui.add_dropdown(
            "colour", [OWN, *self._scenery.fields], initial_value=color or OWN
        )
        self._color.on_update(self._touch)
        self._legend = gui.add_html("")
        self._liquid = None
        if _has_surfaces() and self._may_be_liquid():
            self._liquid = gui.add_checkbox("liquid surface", initial_value=False)
            self._liquid.on_update(self._touch)
        self._cut = None
        if any(len(part.cells) == 3 for part in self._scenery.parts.values()):
            self._cut = gui.add_dropdown(
                "grid", CUTS, initial_value=CUTS[0] if self._scenery.smoky else CUTS[2]
            )
            self._place = gui.add_slider("at", min=0.0, max=1.0, step=0.005, initial_value=0.5)
            self._cut.on_update(self._touch)
            self._place.on_update(self._touch)
        if self._live:
            for name, member in members_of(self.source):
                for attribute, control in make_settings(gui, name, member):
                    control.on_update(self._setter(member, attribute, control))
        gui.add_button("close").on_click(lambda _: threading.Thread(target=self.close).start())

    def _may_be_liquid(self) -> bool:
        """Whether there are particles in space, of a liquid where that is known."""
        kinds = {part.kind for part in self._scenery.parts.values()}
        known = not self._live or any(
            isinstance(m, (GridLiquid, PositionBasedFluid)) for _, m in members_of(self.source)
        )
        return known and "particles" in kinds and not self._scenery.flat

    def _setter(self, member: Any, attribute: str, control: Any) -> Callable[[Any], None]:
        def put(_: Any) -> None:
            with self._lock:
                try:
                    setattr(member, attribute, control.value)
                    self._problem = ""
                except (SubstepError, TypeError, ValueError) as error:
                    self._problem = str(error)
            self._touch()

        return put

    def _touch(self, _: Any = None) -> None:
        self._changed.set()

    def _single(self, _: Any = None) -> None:
        self._playing.value = False
        self._advance()
        self._touch()

    # What runs: one thread, which draws.

    def _advance(self) -> None:
        with self._lock:
            try:
                if self._interval is None:
                    self.source.step()
                else:
                    self.source.advance(self._interval)
                self._problem = ""
            except Exception as error:  # also of a callback of the user: the view tells
                self._playing.value = False
                own = isinstance(error, SubstepError)
                self._problem = str(error) if own else f"{type(error).__name__}: {error}"

    def _refresh(self) -> bool:
        """Whether the recording has more frames than before, whoever took them in."""
        with self._lock:
            count = int(self.source.refresh())
        grown = count > self._count
        if grown:
            self._frame.max, self._frame.disabled = count - 1, False
            self._count, self._grew = count, time.monotonic()
        return grown

    def _play(self) -> float:
        """Go to what is shown next; how long that is to be seen [s]."""
        if self._live:
            self._advance()
            return 1 / MOST_RATE
        following = int(self._frame.value) + 1
        if following < self._count or self._refresh():
            self._frame.value = following
        elif time.monotonic() - self._grew < GROWING:
            return LOOK
        else:
            self._frame.value = 0
        return 1 / max(float(self._rate.value), 0.1)

    def _wait(self) -> None:
        """Until something is changed; of a recording that grows the last frame is followed."""
        while not self._changed.wait(None if self._live else LOOK):
            last = self._count - 1
            if self._refresh():
                if int(self._frame.value) == last:
                    self._frame.value = self._count - 1
                return

    def _go(self) -> None:
        while not self._closed.is_set():
            began, pause = time.monotonic(), 0.0
            try:
                if self._playing.value:
                    pause = self._play()
                else:
                    self._wait()
                self._changed.clear()
                if self._closed.is_set():
                    return
                self._draw()
            except Exception as error:  # the view tells, and lives on
                self._playing.value = False
                self._told.content = f"**{type(error).__name__}**: {error}"
                pause = LOOK
            self._closed.wait(max(0.0, pause - (time.monotonic() - began)))

    def _draw(self) -> None:
        field = None if self._color.value == OWN else self._color.value
        with self._lock:
            frame = -1 if self._live else int(self._frame.value)
            drawn = self._scenery.at(frame)
            when = self.source.time if self._live else self.source.times[frame]
        paint = Paint(field, self._limits)
        if self._cut is not None:
            axis = CUTS.index(self._cut.value) - 1
            paint = replace(paint, axis=None if axis < 0 else axis, place=float(self._place.value))
            self._place.disabled = axis < 0
        shown = [name for name in (field, *map(paint.field_of, drawn)) if name is not None]
        for name in shown:
            self._limits[name] = self._limits_of(name, drawn)
        if self._liquid is not None and self._liquid.value:
            drawn = [_wrapped(d) for d in drawn]
        self._painter.put(drawn, paint)
        of = next(iter(shown), None)
        units = self._scenery.fields
        self._legend.content = "" if of is None else legend(of, units[of], self._limits[of])
        problem = f"\n\n**{self._problem}**" if self._problem else ""
        self._told.content = f"t = {when:.6g} s{problem}"
        self.drawn += 1

    def _limits_of(self, name: str, drawn: list[Drawable]) -> tuple[float, float]:
        """Of all frames that a recording had at first, and of what was drawn so far."""
        if name not in self._limits and not self._live:
            self._limits[name] = range_of(self.source, name)
        low, high = self._limits.get(name, (np.inf, -np.inf))
        for each in (d.fields[name] for d in drawn if name in d.fields):
            known = each[np.isfinite(each)]
            low, high = min(low, known.min(initial=low)), max(high, known.max(initial=high))
        return (float(low), float(high)) if low <= high else (0.0, 1.0)


def _has_surfaces() -> bool:
    import importlib.util

    return importlib.util.find_spec("pysplashsurf") is not None


def _wrapped(one: Drawable) -> Drawable:
    """The surface of the liquid that balls are of."""
    if one.kind != "points" or not len(one.points) or np.ptp(one.points[:, 2]) == 0:
        return one
    surface = liquid_surface(one.points, one.radius)
    points = in_space(surface.vertices)
    return Drawable(one.name, "surface", points, surface.faces.astype(np.int64), color=WATER)
