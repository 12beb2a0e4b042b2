"""Surfaces that move and deform as frames say, whatever is in their way."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_most, check_path, check_real
from ..base.rows import read_only
from ..base.schema import TIME, Entry
from ..errors import FormatError, InputError
from .facets import Deforming
from .keyframes import check_times
from .mesh_io import read_mesh
from .topology import MOST, Array, Indices, check_indices
from .transform import transform_mesh
from .triangle_mesh import TriangleMesh

_SUFFIXES = (".obj", ".off", ".ply", ".stl", ".vtk", ".vtu")


class _Clock:
    """What stands for a native simulation."""

    def __init__(self, count: int) -> None:
        self.time, self.threads = 0.0, 0
        self.forces = np.zeros((count, 3))  # what is pushed does not yield

    def step(self, dt: float) -> None:
        self.time += dt


class AnimatedMesh(Deforming):
    """A surface whose vertices go through given places at given times: an obstacle that deforms.

    Between frames each vertex moves along a smooth curve through all of its places (Catmull and
    Rom), so that its velocity does not jump; after the last frame it is at rest. What meets the
    surface is pushed by it, and does not push it: give `make_colliders` of it to another
    simulation, and both to a `World`. Rigid bodies do not meet it.

    Parameters
    ----------
    times : array_like, shape (m,)
        Of the frames, ascending, the first 0 [s].
    vertices : array_like, shape (m, n, 3)
        Positions of all vertices in each frame [m].
    faces : array_like of int, shape (k, 3)
        Vertices of the triangles, which look outward where the surface is closed.
    step : float
        Step of `advance` [s], and the longest interval of a `World` with its obstacles: a triangle
        is rigid within it.
    time : float
        Initial time [s].
    threads : int, optional
        Of nothing here; simulations have it.

    Attributes
    ----------
    times : ndarray, shape (m,)
        Of the frames [s].
    faces : ndarray of int64, shape (k, 3)
        Triangles.

    Raises
    ------
    InputError
        If an argument is wrong, with its name.

    References
    ----------
    Catmull and Rom, "A class of local interpolating splines", 1974.

    Examples
    --------
    A ball that swells pushes water away.

    >>> import numpy as np, substep
    >>> ball = substep.geometry.sphere_mesh(0.1, subdivisions=1)
    >>> shapes = [ball.vertices + [0, 0, 0.2], 2 * ball.vertices + [0, 0, 0.2]]
    >>> swelling = substep.geometry.AnimatedMesh([0, 0.2], shapes, ball.faces)
    >>> water = substep.PositionBasedFluid(
    ...     substep.fill_box((0.12, -0.1, 0.1), (0.32, 0.1, 0.3), 0.05), 0.05, gravity=(0, 0, 0),
    ...     colliders=swelling.make_colliders(0.05))
    >>> world = substep.World({"swelling": swelling, "water": water})
    >>> world.advance(0.2)
    >>> bool(water.positions[:, 0].mean() > 0.225)
    True
    """

    times: Array
    faces: Indices
    _rows_are = "vertices"
    _dimension = 3
    _fixed_step = True

    def __init__(
        self,
        times: ArrayLike,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        step: float = 1 / 240,
        time: float = 0.0,
        threads: int | None = None,
    ) -> None:
        self.times = read_only(check_times(times))
        frames = check_array("vertices", vertices, (len(self.times), None, 3))
        self._frames = check_most("vertices", frames, MOST)
        self.faces = read_only(check_indices("faces", faces, 3, self._frames.shape[1]))
        self._step_size = check_real("step", step, positive=True)
        super().__init__(self._make({}), time, threads)

    @classmethod
    def from_files(
        cls,
        path: str | os.PathLike[str],
        *,
        fps: float,
        up: str = "z",
        scale: float = 1.0,
        step: float = 1 / 240,
        time: float = 0.0,
        threads: int | None = None,
    ) -> AnimatedMesh:
        r"""Read a sequence of meshes: a folder of .obj, .ply or other files, one for each frame.

        Parameters
        ----------
        path : path-like
            The folder; its meshes follow each other by the numbers in their names.
        fps : float
            Frames per second, above 0.
        up : {'z', 'y', 'x'}
            The files' axis that points upwards.
        scale : float
            Factor of all lengths, above 0 [1].
        step, time, threads
            As for `AnimatedMesh`.

        Returns
        -------
        AnimatedMesh
            With the triangles of the first file.

        Raises
        ------
        FormatError
            If there are no meshes, or one has other triangles than the first, or cannot be read.
        InputError
            If an argument is wrong.
        OSError
            If the folder cannot be read.

        Examples
        --------
        >>> import pathlib, substep
        >>> pathlib.Path("flag").mkdir()
        >>> for k in range(3):
        ...     lines = [f"v 0 0 {k}", "v 1 0 0", "v 0 1 0", "f 1 2 3"]
        ...     _ = pathlib.Path(f"flag/{k}.obj").write_text("\n".join(lines))
        >>> flag = substep.geometry.AnimatedMesh.from_files("flag", fps=25)
        >>> flag.times.tolist()
        [0.0, 0.04, 0.08]
        """
        rate = check_real("fps", fps, positive=True)
        folder = Path(check_path(path))
        files = [file for file in folder.iterdir() if file.suffix.lower() in _SUFFIXES]
        files.sort(key=lambda file: [(int(n), s) for n, s in _split(file.name)])
        if not files:
            raise FormatError(f"{path}: expected meshes ({', '.join(_SUFFIXES)}), found none")
        frames: list[Array] = []
        for file in files:
            mesh = read_mesh(file)
            if not isinstance(mesh, TriangleMesh):
                mesh = mesh.surface()[0]
            if not frames:
                faces = mesh.faces
            elif mesh.vertices.shape != frames[0].shape or not np.array_equal(mesh.faces, faces):
                raise FormatError(f"{file}: expected the triangles of {files[0].name}, got others")
            frames.append(transform_mesh(mesh, up=up, scale=scale).vertices)
        if not len(files) / rate < math.inf:
            raise InputError(f"fps: expected a larger number for {len(files)} frames, got {fps!r}")
        times = np.arange(len(files)) / rate
        return cls(times, np.array(frames), faces, step=step, time=time, threads=threads)

    def __len__(self) -> int:
        return int(self._frames.shape[1])

    @property
    def positions(self) -> Array:
        """Where the vertices are now [m], shape (n, 3), read-only."""
        array: Array = read_only(self.at(self.time)[0])
        return array

    @property
    def pinned(self) -> NDArray[np.bool_]:
        """True for all vertices, shape (n,), read-only: nothing moves them but the frames."""
        flags: NDArray[np.bool_] = read_only(np.ones(len(self), bool))
        return flags

    @property
    def masses(self) -> Array:
        """Infinite ones, shape (n,), read-only."""
        array: Array = read_only(np.full(len(self), np.inf))
        return array

    def at(self, time: float) -> tuple[Array, Array]:
        """Give the vertices at a time.

        Parameters
        ----------
        time : float
            When [s].

        Returns
        -------
        positions : ndarray, shape (n, 3)
            Where they are [m].
        velocities : ndarray, shape (n, 3)
            How they move [m/s].
        """
        t, times, x = check_real("time", time), self.times, self._frames
        if not times[0] <= t < times[-1]:
            return x[0 if t < times[0] else -1].copy(), np.zeros(x.shape[1:])
        k = int(np.searchsorted(times, t, "right")) - 1
        h = times[k + 1] - times[k]
        s = (t - times[k]) / h
        step, before, after = x[k + 1] - x[k], self._slope(k), self._slope(k + 1)
        # Hermite's cubic x_k + s step + s (1 - s) ((1 - s) (h m_k - step) - s (h m_k+1 - step)).
        a, b = h * before - step, h * after - step
        place = x[k] + s * step + s * (1 - s) * ((1 - s) * a - s * b)
        rate = step + (1 - s) * (1 - 3 * s) * a - s * (2 - 3 * s) * b
        return place, rate / h

    def _slope(self, k: int) -> Array:
        """Velocity in a frame: that of the parabola through it and the two nearest frames."""

        def mean(i: int, j: int) -> Array:
            velocity: Array = (self._frames[j] - self._frames[i]) / (self.times[j] - self.times[i])
            return velocity

        last = len(self.times) - 1
        if 0 < k < last:
            return mean(k - 1, k) + mean(k, k + 1) - mean(k - 1, k + 1)
        inner = 1 if k == 0 else last - 1
        return mean(0, 1) if last == 1 else 2 * mean(k, inner) - self._slope(inner)

    def step_limit(self) -> tuple[float, str]:
        """Largest step, and why.

        Returns
        -------
        float
            Infinite.
        str
            The reason.
        """
        return math.inf, "it goes where its frames say"

    def diagnostics(self) -> dict[str, float]:
        """How fast the vertices are.

        Returns
        -------
        dict of str to float
            `speed`, the largest [m/s].
        """
        v = self.at(self.time)[1]
        return {"speed": float(np.linalg.norm(v, axis=1).max(initial=0.0))}

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays for recording, with their units.

        Returns
        -------
        dict of str to (ndarray, str)
            `position` and `velocity`, shape (n, 3).
        """
        x, v = self.at(self.time)
        return {"position": (x, "m"), "velocity": (v, "m/s")}

    def _write(self, name: str, values: Array, rows: Indices) -> None:
        """Forces change nothing."""

    def _schema(self) -> tuple[list[Entry], dict[str, int], Any]:
        return [TIME], {}, np.float64

    def _state(self) -> dict[str, Any]:
        return {"time": self.time}

    def _put_state(self, state: dict[str, Any]) -> None:
        self._native.time = state["time"]

    def _make(self, state: Mapping[str, Any]) -> Any:
        return _Clock(self._frames.shape[1])


def _split(name: str) -> list[tuple[str, str]]:
    """Numbers in a name and the words after them, so that 10 comes after 9."""
    return re.findall(r"(\d+)(\D*)", "0" + name)
