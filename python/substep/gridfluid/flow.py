"""Flows that fill their box: smoke, and viscous flows in two and three dimensions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .. import _core
from ..base.box import check_box
from ..base.checks import (
    MOST_INT,
    check_array,
    check_choice,
    check_dtype,
    check_flag,
    check_integer,
    check_real,
    check_within,
)
from ..base.rows import read_only
from ..base.schema import OWN, TIME, Entry, Rows
from ..base.simulation import Simulation, StepReport, with_energy
from ..errors import InputError
from ..geometry import Collider, Shape
from ..geometry.colliders import (
    check_colliders,
    collider_states,
    colliders_entry,
    largest_speed,
    restore_colliders,
)
from ..particles.emitters import check_all
from .box import check_cells_fit, curl, time_of_way
from .sides import FlowEmitter, Side, Wall, check_flow_sides, native_side

Array = NDArray[np.float64]
Start = ArrayLike | Callable[[Array], ArrayLike]

ADVECTIONS = ("central", "maccormack", "semi_lagrangian")
_CFL = {"central": 0.8, "maccormack": 2.0, "semi_lagrangian": 2.0}
_MOST_RATIO = 1e4  # of two densities
_AXES = "xyz"
_UNITS = {
    "velocity": "m/s",
    "pressure": "Pa",
    "vorticity": "1/s",
    "temperature": "K",
    "smoke": "1",
    "density": "kg/m^3",
}


@dataclass
class FlowReport(StepReport):
    """What the last call of `step` or `advance` took and met.

    Attributes
    ----------
    solver : str
        How the last step found the pressure: directly by a 'transform', by conjugate gradients
        with 'multigrid', or, where those stalled, with the 'diagonal'.
    residual : float
        Of the pressure in the last step, relative; with a transform that of rounding.
    viscosity_iterations : int
        Of conjugate gradients for viscosity and diffusion, in the last step.
    viscosity_converged : bool
        Whether they met their tolerance.
    """

    solver: str = ""
    residual: float = 0.0
    viscosity_iterations: int = 0
    viscosity_converged: bool = True


class GridFlow(Simulation):
    """An incompressible flow that fills its box, on a staggered grid, with heat and smoke.

    A step moves velocities, temperature and smoke with the flow, adds viscosity and buoyancy, and
    finds the pressure that leaves no divergence. Obstacles cut the cells they stand in. There is no
    free surface. docs/grid_flow.md has the equations and the limits.

    Parameters
    ----------
    bounds : array_like, shape (2, 3) or (2, 2)
        Lowest and highest corner of the box [m].
    cell : float
        Side of a cell [m], above 0; the box is a whole number of cells long.
    velocity : array_like or callable, optional
        Initial velocity [m/s]: one vector, one for the middle of each cell, shape (nx, ny, nz, 3)
        or (nx, ny, 2), or `velocity(positions)` of shape (m, d) at points of that shape, which is
        asked at the faces of cells. Any divergence is removed from it. At rest unless given.
    density : float
        Density [kg/m^3], above 0; in 2D of a layer of 1 m.
    viscosity : float
        Kinematic viscosity [m^2/s], at least 0; of two fluids that of both.
    gravity : array_like, shape (3,) or (2,), optional
        Acceleration [m/s^2] that acts on what heat and smoke make lighter or heavier; 9.81 downward
        (along the last axis) unless given. Pressures are those beside the weight of a fluid of
        `density`.
    sides : str, Wall, Inflow or sequence
        What happens at the sides: 'wall', 'open' (pressure 0), 'periodic', a `Wall` or an `Inflow`;
        one for all, or for each axis one or a pair of the lower and the upper one.
    colliders : sequence of Collider or Shape
        Obstacles, still or moving. In 2D they are cut at z = 0.
    slip : bool, optional
        Whether the flow passes along obstacles freely; unless given, it does without viscosity.
    emitters : sequence of FlowEmitter
        Regions in which smoke, heat or a velocity is given.
    temperature : float, array_like or callable, optional
        Initial temperature [K], of cells as `velocity`; none is carried unless given.
    reference_temperature : float
        At which there is no buoyancy [K], and of what flows in at open sides.
    thermal_expansion : float
        Part of the density that a kelvin takes away [1/K].
    thermal_diffusivity : float
        Conductivity over density and heat capacity [m^2/s], at least 0.
    smoke : float, array_like or callable, optional
        Initial smoke [1], of cells as `velocity`; none is carried unless given.
    smoke_weight : float
        Part of the density that smoke of 1 adds.
    smoke_density : float, optional
        Density where smoke is 1 [kg/m^3], above 0, of which gravity and inertia are then those;
        between 0 and 1 it is linear, and `density` is that without smoke. Smoke is then the part of
        a cell that the second of two fluids fills, and moves by limited fluxes whatever
        `advection` is. Neither `smoke_weight` nor `thermal_expansion` goes with it.
    smoke_diffusivity : float
        Diffusivity of smoke [m^2/s], at least 0.
    advection : {'central', 'maccormack', 'semi_lagrangian'}, optional
        How the flow carries: by central fluxes for steps below a cell, of second order in space and
        time, which viscous flows need; or along paths with any step, as smoke in coarse grids does.
        Unless given, 'central' with viscosity and 'maccormack' without.
    vorticity_confinement : float
        Strength [m/s], at least 0, of the force that spins up eddies.
    cfl : float, optional
        Cells that the flow may pass in a step of `advance`: 0.8 with 'central' or two fluids, and 2
        otherwise, unless given.
    step : float, optional
        Step of `advance` [s]; by `step_limit` unless given.
    largest_step : float
        Upper limit of `step_limit` [s], whatever the flow would allow; raise it where that is slow.
    tolerance : float
        Of the pressure: relative residual at which its iteration stops, above 0. A box without
        obstacles needs no iteration unless its numbers of cells have prime factors above 13, or
        densities are two.
    max_iterations : int
        Limit of its iterations, at least 1.
    dtype : {'float32', 'float64'}
        Of the numbers that it computes with; pressures are float64.
    threads : int, optional
        Threads of the native loops; results do not depend on it.
    time : float
        Time of the initial state [s].

    Raises
    ------
    InputError
        If an argument is wrong, obstacles leave no fluid, or more flows into a closed box than out.
    MemoryError
        If the grid does not fit into the memory.

    References
    ----------
    Harlow and Welch, Phys. Fluids 8, 2182, 1965 (the staggered grid, central fluxes).
    Selle et al., J. Sci. Comput. 35, 350, 2008 (MacCormack's method with a limiter).
    Batty, Bertails and Bridson, ACM Trans. Graph. 26(3), 2007 (obstacles that cut cells).
    Fedkiw, Stam and Jensen, "Visual simulation of smoke", 2001, eq. 9 to 11 (confinement).

    Examples
    --------
    A lid drives a viscous flow in a square.

    >>> import substep
    >>> lid = substep.gridfluid.Wall(velocity=(1.0, 0.0))
    >>> flow = substep.GridFlow([(0, 0), (1, 1)], 1 / 16, viscosity=0.01,
    ...                         sides=["wall", ("wall", lid)])
    >>> flow.advance(1.0)
    >>> bool(flow.diagnostics()["divergence"] < 1e-2)
    True
    >>> bool(flow.sample([(0.5, 0.95)])["velocity"][0, 0] > 0.3)
    True
    """

    _pushes_bodies = False

    bounds: Array
    cell: float
    density: float
    smoke_density: float | None
    viscosity: float
    advection: str
    cfl: float
    largest_step: float
    sides: tuple[tuple[Side, Side], ...]
    emitters: tuple[FlowEmitter, ...]
    dtype: np.dtype[Any]

    def __init__(
        self,
        bounds: ArrayLike,
        cell: float,
        *,
        velocity: Start | None = None,
        density: float = 1.0,
        viscosity: float = 0.0,
        gravity: ArrayLike | None = None,
        sides: Any = "wall",
        colliders: Sequence[Collider | Shape] = (),
        slip: bool | None = None,
        emitters: Sequence[FlowEmitter] = (),
        temperature: Start | None = None,
        reference_temperature: float = 0.0,
        thermal_expansion: float = 0.0,
        thermal_diffusivity: float = 0.0,
        smoke: Start | None = None,
        smoke_weight: float = 0.0,
        smoke_density: float | None = None,
        smoke_diffusivity: float = 0.0,
        advection: str | None = None,
        vorticity_confinement: float = 0.0,
        cfl: float | None = None,
        step: float | None = None,
        largest_step: float = 1 / 60,
        tolerance: float = 1e-4,
        max_iterations: int = 200,
        dtype: DTypeLike = "float32",
        threads: int | None = None,
        time: float = 0.0,
    ) -> None:
        self.cell = check_real("cell", cell, positive=True)
        corners, self._cells = check_box(bounds, self.cell)
        d = self._dimension = len(self._cells)
        self.bounds = read_only(corners)
        if min(self._cells) < 2:
            raise InputError(
                f"bounds: expected at least 2 cells along each axis, got {self._cells}"
            )
        self.dtype = check_dtype(dtype)
        check_cells_fit(self._cells, self.dtype)
        self.density = check_real("density", density, positive=True)
        if not all(1e-30 < m < 1e30 for m in (self.cell**d, self.density * self.cell**d)):
            raise InputError(f"cell: the mass of a cell is out of range at {self.cell} m")
        self.smoke_density = None
        if smoke_density is not None:
            self.smoke_density = self._check_two_fluids(
                smoke_density, smoke, smoke_weight, thermal_expansion
            )
        self.viscosity = check_real("viscosity", viscosity, nonnegative=True)
        if advection is None:
            advection = "central" if self.viscosity > 0 else "maccormack"
        self.advection = check_choice("advection", advection, ADVECTIONS)
        usual = _CFL[self.advection if smoke_density is None else "central"]
        self.cfl = check_real("cfl", usual if cfl is None else cfl, positive=True)
        self._step_size = None if step is None else check_real("step", step, positive=True)
        self.largest_step = check_real("largest_step", largest_step, positive=True)
        self.colliders = check_colliders(colliders, d)
        self.emitters = check_all("emitters", emitters, FlowEmitter)
        self.sides = check_flow_sides(sides, d)
        down = [0.0, 0.0, -9.81][3 - d :]
        pull = check_array("gravity", down if gravity is None else gravity, (d,))
        slips = self.viscosity == 0
        heat = {
            "ambient": check_real("reference_temperature", reference_temperature),
            "buoyancy": check_real("thermal_expansion", thermal_expansion),
            "diffusivity": check_real("thermal_diffusivity", thermal_diffusivity, nonnegative=True),
        }
        soot = {
            "ambient": 0.0,
            "buoyancy": -check_real("smoke_weight", smoke_weight),
            "diffusivity": check_real("smoke_diffusivity", smoke_diffusivity, nonnegative=True),
        }
        carried: dict[str, tuple[Start, dict[str, float]]] = {}
        if temperature is not None:
            carried["temperature"] = temperature, heat
        if smoke is not None:
            carried["smoke"] = smoke, soot
        conducts = temperature is not None and heat["diffusivity"] > 0
        for side in (side for pair in self.sides for side in pair):
            if isinstance(side, Wall) and (side.heat_flux or side.temperature is not None):
                if not conducts:
                    what = "heat_flux" if side.heat_flux else "temperature"
                    needs = "needs temperature= and thermal_diffusivity= above 0 of the flow"
                    raise InputError(f"sides: {what} of a wall {needs}")
        self._scalars = tuple(carried)
        far = {name: given[1]["ambient"] for name, given in carried.items()}
        more = 3 - d
        self._box = {
            "dimension": d,
            "cells": [*self._cells, *[1] * more],
            "low": [*corners[0].tolist(), *[0.0] * more],
            "cell": self.cell,
            "sides": [
                [native_side(f"sides[{a}]", side, a, self._cells, far, slips) for side in pair]
                for a, pair in enumerate(self.sides)
            ],
        }
        self._options = {
            "density": self.density,
            "viscosity": self.viscosity,
            "gravity": [*pull.tolist(), 0.0][:3],
            "slip": slips if slip is None else check_flag("slip", slip),
            "vorticity_confinement": check_real(
                "vorticity_confinement", vorticity_confinement, nonnegative=True
            ),
            "advection": self.advection,
            "tolerance": check_real("tolerance", tolerance, positive=True),
            "max_iterations": check_integer(
                "max_iterations", max_iterations, minimum=1, maximum=MOST_INT
            ),
            "scalars": [options for _, options in carried.values()],
            "smoke": -1 if self.smoke_density is None else self._scalars.index("smoke"),
            "smoke_density": self.smoke_density or self.density,
        }
        self._gravity = read_only(pull)
        super().__init__(self._make({}), time, threads)
        for name, (start, _) in carried.items():
            self._set_scalar(name, name, start)
        self._native.set_velocity(self._faces("velocity", 0.0 if velocity is None else velocity))

    def _make(self, state: Mapping[str, Any]) -> Any:
        emitters = [self._native_emitter(k, source) for k, source in enumerate(self.emitters)]
        colliders = [c._native for c in self.colliders]
        return _core.GridFlow(self._box, colliders, emitters, self._options, self.dtype.name)

    def _check_two_fluids(
        self, smoke_density: float, smoke: Start | None, smoke_weight: float, expansion: float
    ) -> float:
        density = check_real("smoke_density", smoke_density, positive=True)
        if smoke is None:
            raise InputError("smoke_density: needs smoke=, which says where it is")
        for name, given in (("smoke_weight", smoke_weight), ("thermal_expansion", expansion)):
            if given:
                raise InputError(f"{name}: expected 0 with smoke_density, got {given}")
        if not 1 / _MOST_RATIO <= density / self.density <= _MOST_RATIO:
            raise InputError(
                f"smoke_density: expected within a factor of {_MOST_RATIO:g} of the density of "
                f"{self.density:g} kg/m^3, got {density:g}"
            )
        return density

    def _native_emitter(self, k: int, source: FlowEmitter) -> dict[str, Any]:
        rates = {"temperature": source.heating, "smoke": source.smoke_rate}
        for name in rates:
            if name not in self._scalars and (rates[name] or getattr(source, name) is not None):
                raise InputError(f"emitters[{k}]: gives {name}, which this flow does not carry")
        velocity = source.velocity
        if velocity is not None and velocity.shape != (self._dimension,):
            raise InputError(f"emitters[{k}]: velocity: expected {self._dimension} numbers")
        return {
            "region": source._collider._native,
            "held": [getattr(source, name) for name in self._scalars],
            "rate": [rates[name] for name in self._scalars],
            "velocity": None if velocity is None else [*velocity.tolist(), 0.0][:3],
        }

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each axis."""
        return self._cells

    @property
    def gravity(self) -> Array:
        """Acceleration [m/s^2] that acts on what heat and smoke make lighter, shape (d,)."""
        return self._gravity

    @property
    def velocity(self) -> Array:
        """Velocity in the middle of cells [m/s], shape (nx, ny, nz, 3) or (nx, ny, 2); a copy."""
        values = self._native.velocities().reshape(*self._cells, self._dimension)
        return read_only(values)  # type: ignore[no-any-return]

    @property
    def velocity_faces(self) -> tuple[Array, ...]:
        """Of each axis its component at faces [m/s], one more along it than cells; copies."""
        return tuple(
            read_only(self._native.velocity(a).reshape(self._face_shape(a)))
            for a in range(self._dimension)
        )

    @property
    def pressure(self) -> Array:
        """Pressure beside that under the weight of `density` [Pa], shape (nx, ny[, nz]); a copy.

        In a closed region its mean is 0.
        """
        return read_only(self._native.pressure().reshape(self._cells))  # type: ignore[no-any-return]

    @property
    def vorticity(self) -> Array:
        """Curl of the velocity [1/s], shape (nx, ny) or (nx, ny, nz, 3); a copy.

        By central differences between middles of cells, which do not look at obstacles.
        """
        return self._vorticity(self.velocity)

    @property
    def temperature(self) -> Array:
        """Temperature of cells [K], shape (nx, ny[, nz]); a copy. Where none is carried, empty."""
        return self._scalar("temperature")

    @property
    def smoke(self) -> Array:
        """Smoke of cells [1], shape (nx, ny[, nz]); a copy. Where none is carried, empty."""
        return self._scalar("smoke")

    @property
    def densities(self) -> Array:
        """Density of cells [kg/m^3], shape (nx, ny[, nz]); a copy."""
        if self.smoke_density is None:
            return read_only(np.full(self._cells, self.density))  # type: ignore[no-any-return]
        part = np.clip(self.smoke, 0, 1)
        return read_only(self.density + (self.smoke_density - self.density) * part)  # type: ignore[no-any-return]

    @property
    def in_fluid(self) -> NDArray[np.bool_]:
        """Which cells obstacles do not fill, shape (nx, ny[, nz]); a copy."""
        return read_only(self._native.fluid().reshape(self._cells) > 0)  # type: ignore[no-any-return]

    @property
    def report(self) -> FlowReport:
        """What the last call of `step` or `advance` took and met."""
        native = self._native.report
        names = [field.name for field in fields(FlowReport)[2:]]
        values = {name: getattr(native, name) for name in names}
        return FlowReport(self._last.steps, self._last.dt, **values)

    def _vorticity(self, velocity: Array) -> Array:
        around = [pair[0] == "periodic" for pair in self.sides]
        return read_only(curl(velocity, self.cell, around))  # type: ignore[no-any-return]

    def _face_shape(self, axis: int) -> tuple[int, ...]:
        return tuple(n + (a == axis) for a, n in enumerate(self._cells))

    def _scalar(self, name: str) -> Array:
        if name not in self._scalars:
            return read_only(np.zeros(0))  # type: ignore[no-any-return]
        values = self._native.scalar(self._scalars.index(name)).reshape(self._cells)
        return read_only(values)  # type: ignore[no-any-return]

    def positions_of(self, faces_of: int | None = None) -> Array:
        """Where the numbers of a grid stand.

        Parameters
        ----------
        faces_of : int, optional
            The axis of the faces; the middle of cells unless given.

        Returns
        -------
        ndarray, shape (nx, ny[, nz], d)
            Points [m]; of faces there is one more along their axis.

        Raises
        ------
        InputError
            If there is no such axis.
        """
        d = self._dimension
        if faces_of is not None:
            faces_of = check_integer("faces_of", faces_of, minimum=0, maximum=d - 1)
        axes = [
            self.bounds[0, a]
            + self.cell * (np.arange(n + (a == faces_of)) + (0.0 if a == faces_of else 0.5))
            for a, n in enumerate(self._cells)
        ]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    def _at(self, name: str, values: Start, positions: Array, columns: int) -> Array:
        """Numbers of an array, or of a function, at positions."""
        shape = positions.shape[:-1] + ((columns,) if columns else ())
        if callable(values):
            given = check_array(name, values(positions.reshape(-1, self._dimension)))
            wanted = (math.prod(positions.shape[:-1]), *shape[len(positions.shape) - 1 :])
            if given.shape != wanted:
                raise InputError(f"{name}: expected an answer of shape {wanted}, got {given.shape}")
            array = given.reshape(shape)
        else:
            array = check_array(name, values)
            if array.shape not in ((), (columns,) if columns else (), shape):
                raise InputError(f"{name}: expected shape {shape}, got {array.shape}")
            array = np.array(np.broadcast_to(array, shape))
        return check_within(name, array, self.dtype)

    def _faces(self, name: str, values: Start) -> list[list[float]]:
        """Of the faces of each axis, from a function or the means of the cells beside them."""
        d = self._dimension
        if callable(values):
            at = [self._at(name, values, self.positions_of(a), d)[..., a] for a in range(d)]
            return [np.ascontiguousarray(x).ravel().tolist() for x in at]
        cells = self._at(name, values, self.positions_of(), d)
        faces = []
        for a, pair in enumerate(self.sides):
            x = np.moveaxis(cells[..., a], a, 0)
            before, after = (x[-1:], x[:1]) if pair[0] == "periodic" else (x[:1], x[-1:])
            whole = np.concatenate([before, x, after])
            mean = np.moveaxis((whole[:-1] + whole[1:]) / 2, 0, a)
            faces.append(np.ascontiguousarray(mean).ravel().tolist())
        return faces

    def set_velocity(self, values: Start) -> None:
        """Give the flow other velocities; any divergence is removed from them.

        Parameters
        ----------
        values : array_like or callable
            As the argument `velocity` of the class [m/s].

        Raises
        ------
        InputError
            If they are wrong; nothing is changed then.
        """
        self._native.set_velocity(self._faces("values", values))

    def set_temperature(self, values: Start) -> None:
        """Give cells other temperatures.

        Parameters
        ----------
        values : float, array_like or callable
            As the argument `temperature` of the class [K].

        Raises
        ------
        InputError
            If they are wrong, or none is carried; nothing is changed then.
        """
        self._set_scalar("temperature", "values", values)

    def set_smoke(self, values: Start) -> None:
        """Give cells other smoke.

        Parameters
        ----------
        values : float, array_like or callable
            As the argument `smoke` of the class [1].

        Raises
        ------
        InputError
            If it is wrong, or none is carried; nothing is changed then.
        """
        self._set_scalar("smoke", "values", values)

    def _set_scalar(self, which: str, name: str, values: Start) -> None:
        if which not in self._scalars:
            if not callable(values) and np.size(np.asarray(values)) == 0:
                return
            raise InputError(f"{name}: this flow carries no {which}; make one that does")
        array = self._at(name, values, self.positions_of(), 0)
        self._native.set_scalar(self._scalars.index(which), np.ascontiguousarray(array).ravel())

    def sample(self, points: ArrayLike) -> dict[str, Array]:
        """Numbers at points, linear between those of the grid.

        Parameters
        ----------
        points : array_like, shape (m, 3) or (m, 2)
            Points [m]; beyond the box, the value is that at its side.

        Returns
        -------
        dict of str to ndarray
            `velocity` (m, d) [m/s], `pressure` (m,) [Pa] and what is carried: `temperature` (m,)
            [K] and `smoke` (m,).

        Raises
        ------
        InputError
            If the points are wrong.

        Examples
        --------
        >>> import substep
        >>> flow = substep.GridFlow([(0, 0), (1, 1)], 0.1, velocity=(1.0, 0.0), sides="periodic")
        >>> flow.sample([(0.5, 0.5)])["velocity"].tolist()
        [[1.0, 0.0]]
        """
        d = self._dimension
        x = check_array("points", points, (None, d))
        table = self._native.sample(x).reshape(len(x), d + 1 + len(self._scalars))
        found = {"velocity": table[:, :d].copy(), "pressure": table[:, d].copy()}
        return found | {name: table[:, d + 1 + k].copy() for k, name in enumerate(self._scalars)}

    def _next_step(self) -> float:
        return self.step_limit()[0] if self._step_size is None else self._step_size

    def step_limit(self) -> tuple[float, str]:
        """Largest step that the CFL condition allows now, and why.

        Returns
        -------
        float
            The step [s]: in it the fastest flow, obstacle or source passes `cfl` cells, with what
            buoyancy adds to it; at most `largest_step`, and what diffusion is computed well with.
        str
            The reason.
        """
        limits = self._native.limits()
        speeds = [limits.courant]
        speeds += [float(np.abs(s.velocity).sum()) for s in self.emitters if s.velocity is not None]
        speeds += [
            float(np.abs(side.velocity).sum(axis=-1).max())
            for pair in self.sides
            for side in pair
            if not isinstance(side, str) and side.velocity is not None
        ]
        speeds.append(largest_speed(self.colliders, self.bounds, self.largest_step))
        speed = max(speeds) + self._options["vorticity_confinement"]
        limit = time_of_way(self.cfl * self.cell, speed, limits.acceleration)
        longest = min(limits.longest, self.largest_step)
        if limit >= longest:
            return longest, "largest_step" if longest == self.largest_step else "diffusion"
        return limit, f"CFL {self.cfl:g} at a speed of {speed:.4g} m/s"

    def diagnostics(self) -> dict[str, float]:
        """Sums over the flow, and figures of the last step.

        Returns
        -------
        dict of str to float
            `kinetic_energy` and `energy`, the same [J]; of two fluids `gravitational_energy`, 0 at
            the origin, which `energy` then has in it, and `mass` [kg]; `momentum_x`, `_y`, `_z`
            [N s]; `speed`, the largest along an axis [m/s]; `divergence`, the largest of a cell
            [1/s];
            `mean_temperature` [K] and `mean_smoke`, where they are carried; of the last step
            `iterations` and `residual`.
        """
        sums, report = self._native.sums(), self.report
        values = {"kinetic_energy": sums.kinetic}
        if self.smoke_density is not None:
            masses = np.where(self.in_fluid, self.densities, 0) * self.cell**self._dimension
            values["gravitational_energy"] = -float(
                np.sum(masses * (self.positions_of() @ self._gravity))
            )
            values["mass"] = float(masses.sum())
        values |= {f"momentum_{axis}": sums.momentum[a] for a, axis in enumerate(_AXES)}
        values |= {"speed": sums.speed, "divergence": sums.divergence}
        values |= {f"mean_{name}": sums.scalars[k] for k, name in enumerate(self._scalars)}
        return with_energy(values) | {
            "iterations": float(report.iterations),
            "residual": report.residual,
        }

    def fields(self, names: Sequence[str] | None = None) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays over cells for recording, with their units.

        Parameters
        ----------
        names : sequence of str, optional
            Which of them; all unless given.

        Returns
        -------
        dict of str to (ndarray, str)
            `velocity`, shape (nx, ny[, nz], d), `pressure`, `vorticity` as the attribute, and what
            is carried, `temperature` and `smoke`, shape (nx, ny[, nz]); of two fluids `density`.

        Raises
        ------
        InputError
            If there is no such field.
        """
        velocity = cache(lambda: self.velocity)
        arrays: dict[str, Callable[[], Array]] = {
            "velocity": velocity,
            "pressure": lambda: self.pressure,
            "vorticity": lambda: self._vorticity(velocity()),
        }
        arrays |= {name: partial(self._scalar, name) for name in self._scalars}
        if self.smoke_density is not None:
            arrays["density"] = lambda: self.densities
        wanted = arrays if names is None else [check_choice("names", n, arrays) for n in names]
        return {name: (arrays[name](), _UNITS[name]) for name in wanted}

    def _schema(self) -> tuple[list[Entry], dict[str, int], Any]:
        entries: list[Entry] = [TIME, colliders_entry(self.colliders)]
        for a in range(self._dimension):
            entries.append(Rows(f"velocity_{_AXES[a]}", OWN, self._face_shape(a)))
        entries += [Rows(name, OWN, self._cells) for name in self._scalars]
        entries.append(Rows("pressure", np.float64, self._cells))
        return entries, {}, self.dtype

    def _state(self) -> dict[str, Any]:
        native = self._native.state()
        state: dict[str, Any] = {
            "time": native["time"],
            "colliders": collider_states(self.colliders),
        }
        for a, x in enumerate(native["velocity"]):
            state[f"velocity_{_AXES[a]}"] = x.reshape(self._face_shape(a))
        for name, x in zip(self._scalars, native["scalars"], strict=True):
            state[name] = x.reshape(self._cells)
        return state | {"pressure": native["pressure"].reshape(self._cells)}

    def _put_state(self, state: dict[str, Any]) -> None:
        axes = _AXES[: self._dimension]
        self._native.restore(
            state["time"],
            [state[f"velocity_{axis}"].ravel() for axis in axes],
            [state[name].ravel() for name in self._scalars],
            state["pressure"].ravel(),
        )
        restore_colliders(self.colliders, state["colliders"])
