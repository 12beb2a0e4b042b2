"""A recording as one HTML file that plays without Python and without a network."""

from __future__ import annotations

import html
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from ..base.checks import check_name, check_real
from ..base.replacing import replace_bytes
from ..errors import InputError
from ..recording import Recording
from .drawables import Scenery
from .extent import range_of
from .painted import Paint, Painter, close_server, open_server, palette, place_camera


def write_page(
    recording: Recording, out: Path, color: str | None = None, fps: float = 25.0
) -> list[Path]:
    """Write the file, with viser's player in it.

    Parameters
    ----------
    recording : Recording
        Open.
    out : Path
        The file; an existing one is replaced.
    color : str, optional
        Field that colours the parts which have it.
    fps : float
        Frames shown per second.

    Returns
    -------
    list of Path
        The file.

    Raises
    ------
    InputError
        If there are no frames, no such field, or `fps` is not above 0.
    ImportError
        If viser is missing.
    OSError
        If it cannot be written.
    """
    pause = 1 / check_real("fps", fps, positive=True)
    if not len(recording):
        raise InputError(f"{recording.path}: has no frames")
    scenery = Scenery(recording)
    if color is not None:
        check_name("color", color, scenery.fields)
    limits = {
        name: range_of(recording, name)
        for name in scenery.fields
        if name == color
        or any(part.cells and name in part.fields for part in recording.parts.values())
    }
    paint, given_up = Paint(color, limits, None if scenery.smoky else 1), threading.Event()
    with ThreadPoolExecutor(1) as apart:  # where no interrupt keeps the server from being closed
        try:
            page = apart.submit(_film, recording, scenery, paint, pause, given_up).result()
        finally:
            given_up.set()
    fields = map(paint.field_of, scenery.at(0))
    shown = color or next((field for field in fields if field is not None), None)
    text = html.escape(recording.scene or "recording")
    if shown is not None:
        text += legend(shown, scenery.fields[shown], limits[shown])
    label = f'<div style="{_CORNER}">{text}</div>'
    head, end, rest = page.rpartition("</body>")
    replace_bytes(out, (head + label + end + rest).encode())
    return [out]


def _film(
    recording: Recording, scenery: Scenery, paint: Paint, pause: float, given_up: threading.Event
) -> str:
    """The page without what is written on it; whatever it is if that is given up."""
    server = open_server(recording.scene or "recording")
    try:
        painter = Painter(server)
        painter.put(scenery.at(0), paint)
        place_camera(server, scenery.at(0) + scenery.at(-1), scenery.flat)
        film = server.get_scene_serializer()
        for frame in range(1, len(recording)):
            if given_up.is_set():
                return ""
            film.insert_sleep(pause)
            painter.put(scenery.at(frame), paint)
        film.insert_sleep(pause)
        return "" if given_up.is_set() else str(film.as_html())
    finally:
        close_server(server)


_CORNER = "position:fixed;left:12px;top:10px;font:14px sans-serif;color:#333;z-index:9"


def legend(name: str, unit: str, limits: tuple[float, float]) -> str:
    """A bar of the colours of a field between its limits, as HTML.

    Parameters
    ----------
    name, unit : str
        The field and its unit.
    limits : tuple of float
        Values at the ends.

    Returns
    -------
    str
        HTML.
    """
    tones: Any = palette(np.linspace(0, 1, 6), name, (0.0, 1.0)).tolist()
    colors = ",".join(f"rgb({r},{g},{b})" for r, g, b in tones)
    label = name if unit in ("", "1") else f"{name} [{unit}]"
    return (
        '<div style="font:12px sans-serif;padding:4px 12px">'
        f"{html.escape(label)}<br>{limits[0]:.4g} "
        f'<span style="display:inline-block;width:8em;height:0.8em;'
        f'background:linear-gradient(90deg,{colors})"></span> {limits[1]:.4g}</div>'
    )
