"""What the scenes of cloth and soft bodies share: solver settings, energy watch, recording."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError, SolverError
from ..geometry import TetMesh, TriangleMesh, read_mesh, tetrahedralize
from .declaration import Parameter

if TYPE_CHECKING:
    from ..recording import Part

INTEGRATORS = ("implicit_euler", "symplectic_euler", "velocity_verlet", "rk4", "euler")
GRAVITY = 9.81  # m/s^2


def solver_parameters(step: float, drag: float) -> dict[str, Parameter]:
    """Parameters of every such scene.

    Parameters
    ----------
    step : float
        Default of the time step [s].
    drag : float
        Default of the drag [1/s].

    Returns
    -------
    dict of str to Parameter
        By key.
    """
    return {
        "integrator": Parameter("integrator", "implicit_euler", choices=INTEGRATORS),
        "step": Parameter("time step", step, unit="s", above=0),
        "drag": Parameter("drag: a force -drag m v on each vertex", drag, unit="1/s", minimum=0),
        "tolerance": Parameter(
            "force left by a step of implicit Euler, over the weight of a mean vertex",
            1e-3,
            above=0,
        ),
    }


class Watched:
    """A body that is driven by nothing but gravity, so that its energy cannot grow.

    Subclasses put it before `MassSpring` or `SoftBody`, and call `watch` when they are made.

    Attributes
    ----------
    obstacles : dict of str to TriangleMesh
        What is drawn of the colliders.
    lacks : dict of str to str
        What is wrong with the meshes that were read, by their files.
    """

    obstacles: dict[str, TriangleMesh]
    lacks: dict[str, str]

    def watch(self: Any, room: float) -> None:
        """Allow the energy to grow by what the whole body gains when it is lifted by `room` [m]."""
        self._start = self.energy()
        self._room = float(self.masses.sum()) * GRAVITY * room
        self._limit, self._reason = self.step_limit()

    def energy(self: Any) -> float:
        """Sum of all energies [J]."""
        return float(self.diagnostics()["energy"])

    def advance(self: Any, duration: float, callback: Any = None) -> None:
        """Go on, or stay at the state before if the energy grows."""
        before = self.state()
        steps = max(1, math.ceil(duration / self.step_size - 1e-9))
        end = self.time + duration
        for k in range(steps):
            super().advance((end - self.time) / (steps - k), callback)  # type: ignore[misc]
            energy = self.energy()
            if not energy <= self._start + self._room:  # NaN as well
                time = self.time
                self.restore(before)
                raise SolverError(self._explosion(duration / steps, time, energy), time=time)

    def _explosion(self: Any, step: float, time: float, energy: float) -> str:
        grown = (
            f"{self.integrator} exploded at time {time:.4g} s: the energy grew from "
            f"{self._start:.3g} J to {energy:.3g} J"
        )
        if step > self._limit:
            cause = f"as the step, {step:.3g} s, is above its limit, {self._limit:.3g} s"
        else:
            cause = f"with the step {step:.3g} s; at the start its limit was {self._limit:.3g} s"
        return f"{grown}, {cause} ({self._reason}); take a shorter step, or implicit_euler"

    def still(self: Any) -> str:
        """How fast the fastest vertex is, in words."""
        speed = self.diagnostics()["speed"]
        return f"at rest ({speed:.2g} m/s)" if speed < 0.02 else f"moving, up to {speed:.2g} m/s"

    def work(self: Any) -> str:
        """What the solver did, in words."""
        if self.integrator != "implicit_euler":
            return f"step {self.step_size:g} s, limit {self._limit:.3g} s"
        values = self.diagnostics()
        return f"last step {values['iterations']:.0f} iterations, {values['residual']:.2g} N left"

    def parts(self: Any) -> dict[str, Part]:
        """The body as a mesh with its velocity, and the obstacles, which never move."""
        from ..recording import Part

        solid = getattr(self, "mesh", None)
        topology = {"triangles": self.faces} if solid is None else {"tetrahedra": solid.tetrahedra}
        parts = {self.part: Part("mesh", {"velocity": "m/s"}, **topology)}
        for name, mesh in self.obstacles.items():
            parts[name] = Part("mesh", triangles=mesh.faces, points=mesh.vertices)
        return parts

    def frame(self: Any) -> dict[str, dict[str, Any]]:
        """Positions as float64, velocities as float32."""
        velocity = self.velocities.astype(np.float32)
        return {self.part: {"points": self.positions.copy(), "velocity": velocity}}

    def notes(self: Any) -> dict[str, str]:
        """What the meshes lack, for the recording."""
        return dict(self.lacks)


def fill(surface: TriangleMesh, size: float, cells: int) -> tuple[TetMesh, str]:
    """Fill a surface with tetrahedra, so many along its size, and say what got lost.

    Raises InputError for what has no inside, or falls into pieces.
    """
    try:
        solid = tetrahedralize(surface, size / cells)
    except InputError as error:
        cause = str(error).removeprefix("spacing: ")
        raise InputError(f"cells: with {cells} of them, {cause}, that is more cells") from error
    used, corners = np.unique(solid.tetrahedra, return_inverse=True)
    lost = [phrase for phrase in solid.lacks if not phrase.startswith("surface ")]
    told = "; ".join(["filled with tetrahedra", *lost])
    return TetMesh(solid.vertices[used], corners.reshape(-1, 4)), told


def read_obstacle(path: str, up: str, size: float) -> tuple[TriangleMesh, str]:
    """A surface from a file, standing on the ground in the middle.

    Parameters
    ----------
    path : str
        The file.
    up : {'x', 'y', 'z'}
        The file's axis that points upwards.
    size : float
        Longest side it gets [m].

    Returns
    -------
    TriangleMesh
        The surface.
    str
        What it has, and what it lacks.

    Raises
    ------
    InputError
        If the file holds something else.
    """
    mesh = read_mesh(path)
    if not isinstance(mesh, TriangleMesh):
        mesh = mesh.surface()[0]
    report = mesh.report()
    lacks = "; ".join(report.lacks) or "closed, manifold, oriented"
    turned = np.roll(mesh.vertices, 2 - "xyz".index(up), axis=1)
    used = turned[mesh.faces]
    low, high = used.min((0, 1)), used.max((0, 1))
    if not np.max(high - low) > 0:
        raise InputError(f"mesh: {path} has no extent")
    scale = size / float(np.max(high - low))
    foot = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    placed = TriangleMesh((turned - foot) * scale, mesh.faces)
    return placed, f"{Path(path).name}: {report.vertices} vertices, {report.faces} faces; {lacks}"
