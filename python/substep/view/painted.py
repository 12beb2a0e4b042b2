"""Drawables in the scene of a viser server, which browsers show."""

from __future__ import annotations

import contextlib
import errno
import io
import socket
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.imports import needs
from .cloud import add_cloud, blocks, opacities, recolor
from .drawables import Drawable, reach
from .field_sheet import PALETTES
from .volume import DEPTH, lit

Array = NDArray[Any]

MOST_PORT = 65535
DISTANCE = 1.9  # of the camera, over the diagonal of what is seen
DIRECTION = np.array([0.45, -0.8, 0.4])  # to the camera, where z is up
TO_LIGHT = np.array([-0.5, -0.4, 0.77])  # of smoke
GREY = "#a5a39f"  # of smoke in full light, before a light background


@dataclass(frozen=True)
class Paint:
    """How drawables look.

    Attributes
    ----------
    field : str or None
        That colours those which have it; own colours unless given. Grids show their first, but
        smoke where it is drawn as a volume.
    limits : dict of str to tuple
        Values at the ends of the colours, by field.
    axis : int or None
        Across which a grid in space is cut; None draws it as a volume.
    place : float
        Where, from 0 to 1.
    """

    field: str | None
    limits: dict[str, tuple[float, float]]
    axis: int | None = 1
    place: float = 0.5

    def field_of(self, one: Drawable) -> str | None:
        """The field whose colours a drawable has; None of one in its own colour."""
        if self.field in one.fields:
            return self.field
        if one.kind != "cells" or (self.fills(one) and "smoke" in one.fields):
            return None
        return next(iter(one.fields))

    def fills(self, one: Drawable) -> bool:
        """Whether a drawable is drawn as a volume."""
        in_space = one.kind == "cells" and next(iter(one.fields.values())).ndim == 3
        return in_space and self.axis is None


def open_server(label: str, port: int = 8080) -> Any:
    """A viser server for this machine alone, at the next free port.

    Parameters
    ----------
    label : str
        Above the controls.
    port : int
        Where to look for a free one first.

    Returns
    -------
    viser.ViserServer
        The server.

    Raises
    ------
    ImportError
        If viser is missing.
    OSError
        If no port from there on is free.
    """
    with needs("viser", 'viser is missing: pip install "substep[view]" for views in the browser'):
        import viser  # noqa: F401
    made: Future[Any] = Future()
    given = made, label, _free_port(port)
    try:  # in a thread, where no interrupt leaves half a server, which nobody can stop
        threading.Thread(target=_make_server, args=given).start()
        return made.result()
    except KeyboardInterrupt:
        made.add_done_callback(_stop_made)
        raise


def _make_server(made: Future[Any], label: str, port: int) -> None:
    try:
        made.set_result(_served(label, port))
    except BaseException as error:
        made.set_exception(error)


def _stop_made(made: Future[Any]) -> None:
    if made.exception() is None:
        close_server(made.result())


def _served(label: str, port: int) -> Any:
    import viser

    with _quiet():  # viser prints a frame about its address
        server = viser.ViserServer(host="127.0.0.1", port=port, label=label, verbose=False)
    try:
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.scene.set_background_image(np.full((1, 1, 3), [242, 245, 247], np.uint8))
    except BaseException:
        close_server(server)
        raise
    return server


def _free_port(first: int) -> int:
    """The first that can be served at; viser would wait for ever where there is none."""
    for port in range(first, MOST_PORT + 1):
        with contextlib.suppress(OSError):
            socket.create_server(("127.0.0.1", port)).close()
            return port
    raise OSError(errno.EADDRINUSE, f"port: none from {first} to {MOST_PORT} is free")


def close_server(server: Any) -> None:
    """End a server, which would say so."""
    with _quiet():
        server.stop()


_one_at_a_time = threading.RLock()  # who redirects in turn with another loses the output for good


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    with _one_at_a_time, contextlib.redirect_stdout(io.StringIO()):
        yield


def place_camera(server: Any, drawn: list[Drawable], flat: bool) -> None:
    """Look at everything: from the front above, or at a plane from before it."""
    low, high = reach(drawn)
    up, to = ("+y", np.array([0.0, 0, 1])) if flat else ("+z", DIRECTION)
    server.scene.set_up_direction(up)
    size = max(float(np.linalg.norm(high - low)), 1e-6)
    camera, middle = server.initial_camera, (low + high) / 2
    camera.near, camera.far = size * 1e-3, size * 1e2
    camera.fov = np.radians(35.0)
    camera.position = middle + DISTANCE * size * to / np.linalg.norm(to)
    camera.look_at = middle


class Painter:
    """Puts drawables into a scene, and sends what has changed.

    Parameters
    ----------
    server : viser.ViserServer
        Whose scene.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._nodes: dict[str, tuple[Any, tuple[Any, ...], list[Array]]] = {}

    def put(self, drawn: list[Drawable], paint: Paint) -> None:
        """Show these drawables instead of those before.

        Parameters
        ----------
        drawn : list of Drawable
            With names of their own.
        paint : Paint
            Their colours.
        """
        with self._server.atomic():
            for gone in set(self._nodes) - {one.name for one in drawn}:
                self._nodes.pop(gone)[0].remove()
            for one in drawn:
                self._put(one, paint)

    def _put(self, one: Drawable, paint: Paint) -> None:
        colors: Array = _rgb(one.color)
        shape: tuple[Any, ...]
        arrays: list[Array]
        field = paint.field_of(one)
        if paint.fills(one):
            rgba, side = cloud(one, paint)
            shape, arrays = ("cloud", rgba.shape), [rgba]
        elif one.kind == "cells":
            image, corners = sheet(one, paint)
            shape, arrays = ("cells", image.shape, paint.axis), [image, corners]
        else:
            if field is not None:
                colors = palette(one.fields[field], field, paint.limits[field])
            shape = (one.kind, len(one.points), colors.ndim, one.radius)
            arrays = [one.points, colors, one.rows]
        node: Any
        node, before, sent = self._nodes.get(one.name, (None, (), []))
        if before == shape and all(map(np.array_equal, sent, arrays)):
            return
        name = f"/{one.name}"
        if one.kind == "points" and before == shape:
            node.points, node.colors = arrays[0], colors
        elif one.kind == "surface" and before == shape and colors.ndim == 1:
            node.vertices = arrays[0]
        elif paint.fills(one) and before == shape:
            recolor(node, rgba)
        elif paint.fills(one):
            node = add_cloud(self._server, name, one.points, side, rgba)
        elif one.kind == "points":
            node = self._server.scene.add_point_cloud(
                name,
                arrays[0],
                colors,
                point_size=one.radius,
                point_shape="circle",
                precision="float32",
            )
        elif one.kind == "cells":
            node = self._add_sheet(name, image, corners)
        elif one.kind == "lines":
            ends = one.points[one.rows]
            tones = colors if colors.ndim == 1 else colors[one.rows]
            node = self._server.scene.add_line_segments(
                name, ends, tones, thickness=2.0, thickness_units="screen"
            )
        elif colors.ndim == 1:
            node = self._server.scene.add_mesh_simple(
                name,
                one.points,
                one.rows,
                color=tuple(colors.tolist()),
                side="double",
                opacity=None if one.opacity == 1 else one.opacity,
                flat_shading=True,
            )
        else:
            node = self._add_colored_mesh(name, one, colors)
        self._nodes[one.name] = node, shape, [array.copy() for array in arrays]

    def _add_colored_mesh(self, name: str, one: Drawable, colors: Array) -> Any:
        import trimesh

        mesh = trimesh.Trimesh(one.points, one.rows, vertex_colors=colors, process=False)
        return self._server.scene.add_mesh_trimesh(name, mesh)

    def _add_sheet(self, name: str, image: Array, corners: Array) -> Any:
        across = np.argmin(np.ptp(corners, axis=0))
        a, b = (k for k in range(3) if k != across)
        width, height = (corners[1] - corners[0])[[a, b]]
        # viser lays the image in its x y plane, its first row at -y.
        turn = np.zeros((3, 3))
        turn[a, 0] = turn[b, 1] = 1
        turn[:, 2] = np.cross(turn[:, 0], turn[:, 1])
        return self._server.scene.add_image(
            name,
            image[::-1],
            float(width),
            float(height),
            format="png",
            wxyz=_quaternion(turn),
            position=corners.mean(axis=0),
            cast_shadow=False,
            receive_shadow=False,
        )


def _rgb(color: str) -> NDArray[np.uint8]:
    return np.frombuffer(bytes.fromhex(color[1:]), np.uint8)


def palette(values: Array, field: str | None, limits: tuple[float, float]) -> NDArray[np.uint8]:
    """Red, green and blue of the values of a field; grey where there is no number.

    Parameters
    ----------
    values : ndarray
        Numbers.
    field : str or None
        Whose they are.
    limits : tuple of float
        Values at the ends of the colours.

    Returns
    -------
    ndarray of uint8, shape of the values + (3,)
        The colours.
    """
    with needs("matplotlib", 'matplotlib is missing: pip install "substep[plot]" for colours'):
        from matplotlib import colormaps
    low, high = limits
    with np.errstate(invalid="ignore"):
        at = np.clip((values - low) / (high - low if high > low else 1.0), 0, 1)
    known = np.isfinite(at)
    table = colormaps[PALETTES.get(field or "", "viridis")](np.arange(256) / 255.0)[:, :3]
    colors = np.rint(255 * table).astype(np.uint8)[(255 * np.where(known, at, 0)).astype(int)]
    colors[~known] = 160
    return colors


def cloud(one: Drawable, paint: Paint) -> tuple[NDArray[np.uint8], float]:
    """A grid in space as blobs: smoke that scatters light, or a field, thicker the greater it is.

    Parameters
    ----------
    one : Drawable
        Of cells.
    paint : Paint
        Which field.

    Returns
    -------
    rgba : ndarray of uint8, shape (nx, ny, nz, 4)
        Colours and opacities.
    side : float
        Of the block that a blob stands for [m].
    """
    field = paint.field_of(one)
    grid = one.fields[field or "smoke"]
    values, side = blocks(grid)
    thick = side * DEPTH / min(grid.shape)
    if field is None:
        depth = thick * np.maximum(values, 0)
        tone = np.array(_rgb(GREY) / 255, np.float32)
        colors = lit(depth, TO_LIGHT / np.linalg.norm(TO_LIGHT), tone)
    else:
        low, high = paint.limits[field]
        depth = thick * np.clip((values - low) / (high - low or 1.0), 0, 1) ** 2
        colors = palette(values, field, (low, high))
    rgba = np.concatenate([colors, opacities(depth)[..., None]], axis=-1)
    return rgba, side * float(np.ptp(one.points[:, 0])) / grid.shape[0]


def sheet(one: Drawable, paint: Paint) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """The picture of a grid, or of a cut through one in space, and the corners of its place.

    Parameters
    ----------
    one : Drawable
        Of cells.
    paint : Paint
        Which field; where it is cut.

    Returns
    -------
    image : ndarray of uint8, shape (rows, columns, 3)
        From the top: against the second axis of the cut.
    corners : ndarray of float32, shape (2, 3)
        Lowest and highest [m].
    """
    field = paint.field_of(one) or ""
    values, corners = one.fields[field], one.points.copy()
    if values.ndim == 3 and paint.axis is not None:
        n = values.shape[paint.axis]
        values = np.take(values, min(int(paint.place * n), n - 1), axis=paint.axis)
        low, high = corners[:, paint.axis]
        corners[:, paint.axis] = low + paint.place * (high - low)
    else:  # behind what else is in the plane
        corners[:, 2] -= 2e-3 * float(np.ptp(corners[:, :2]))
    colors = palette(values, field, paint.limits[field])
    return np.ascontiguousarray(colors.swapaxes(0, 1)[::-1]), corners


def _quaternion(turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of one of three rotations by its matrix."""
    half = 0.5**0.5
    axes = {(0, 1): [1.0, 0, 0, 0], (0, 2): [half, half, 0, 0], (1, 2): [0.5, 0.5, 0.5, 0.5]}
    x, y = (int(np.argmax(turn[:, k])) for k in range(2))
    return np.array(axes[x, y])
