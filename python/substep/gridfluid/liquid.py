"""Liquids with a free surface: particles that carry the liquid through a grid of pressures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
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
)
from ..base.rows import read_only
from ..base.schema import MOST, OWN, TIME, Entry, Number, Rows
from ..base.simulation import StepReport, momenta, with_energy
from ..errors import InputError
from ..geometry import Collider, Shape
from ..geometry.colliders import (
    check_colliders,
    collider_states,
    largest_speed,
    restore_colliders,
)
from ..particles.emitters import Emitter, Sink
from ..particles.state import Particles
from .box import check_cells_fit, check_open_sides, interpolate, time_of_way

Array = NDArray[np.float64]

TRANSFERS = ("apic", "flip", "pic")
_LARGEST_STEP = 1 / 30  # [s], where nothing moves
_NARROWEST = 3  # band of particles [cells]


@dataclass
class LiquidReport(StepReport):
    """What the last call of `step` or `advance` took and met.

    Attributes
    ----------
    residual : float
        Of the pressure of the last step, relative.
    viscosity_iterations : int
        Of the solve for the viscosity, in the last step.
    viscosity_converged : bool
        Whether it reached its tolerance: a step in which it does not is a `ConvergenceError`.
    volume_iterations : int
        Of the solve that spreads the particles evenly, in the last step.
    mean_error : float
        Of the density, relative: before that, the mean over full cells of how far they are from
        holding as many particles as they should.
    removed : int
        Particles that left by an open side in it.
    """

    residual: float = 0.0
    viscosity_iterations: int = 0
    viscosity_converged: bool = True
    volume_iterations: int = 0
    mean_error: float = 0.0
    removed: int = 0


def check_narrow_band(cells: Any, viscosity: float) -> int | None:
    """Of a liquid of that viscosity."""
    if cells is None:
        return None
    band = check_integer("narrow_band", cells, minimum=_NARROWEST, maximum=MOST_INT)
    if viscosity > 0:
        raise InputError("narrow_band: expected None with a viscosity")
    return band


class GridLiquid(Particles):
    """A liquid with a free surface, whose particles move in a grid that keeps its volume.

    Particles carry the velocity, a staggered grid gives the pressure: a step passes the velocities
    to the grid, adds gravity, makes them free of divergence, with the free surface and obstacles at
    their true places between the nodes, passes them back and moves the particles along (FLIP, APIC
    or PIC). Above the surface is nothing: air at pressure 0. Viscosity is implicit, and leaves what
    turns alone, so that a thread of honey coils; surface tension is explicit, from a smoothed
    surface. docs/grid_liquid.md has the equations and the limits.

    Parameters
    ----------
    positions : array_like, shape (n, 3) or (n, 2)
        Initial positions [m], half a cell apart as by `fill_box`: 8 particles to a full cell, in 2D
        4. In 2D the particles lie at z = 0, where colliders are cut.
    cell : float
        Side of a cell of the grid [m], above 0.
    bounds : array_like, shape (2, 3) or (2, 2)
        Lowest and highest corner of the grid [m], a whole number of cells apart.
    velocities : array_like, shape of positions, optional
        Initial velocities [m/s]; at rest unless given.
    density : float
        Of the liquid [kg/m^3], above 0. In 2D the layer is taken as 1 m thick.
    gravity : array_like, shape (3,) or (2,), optional
        Acceleration [m/s^2]; 9.81 downward (along the last axis) unless given.
    colliders : sequence of Collider or Shape
        Obstacles and containers, along which the liquid slips unless it is viscous. Their
        friction and restitution are not used.
    sides : {'wall', 'open', 'periodic'} or sequence
        What the sides of the box are: all of them, or one for each axis, of which any may be a pair
        for its lower and upper side. Liquid slips along walls, unless it is viscous, and leaves by
        open sides, where the pressure is 0.
    transfer : {'apic', 'flip', 'pic'}
        How velocities go between particles and grid. APIC keeps angular momentum and is calm; FLIP
        is lively and noisy; PIC damps all that turns.
    flip_rate : float
        With 'flip', the part of it, from 0 to 1; the rest is PIC.
    viscosity : float
        Kinematic viscosity [m^2/s], at least 0.
    surface_tension : float
        Of the surface [N/m], at least 0; water has 0.073. The surface meets walls at a right angle.
    slip : bool
        Whether a viscous liquid passes along walls and obstacles freely, instead of being held.
        Without viscosity it always does.
    keep_volume : bool
        Spread the particles so that full cells keep as many as they should, by a second pressure
        solve that moves them and leaves their velocities.
    narrow_band : int, optional
        Cells below the surface, and around obstacles, emitters and sinks, that particles fill, at
        least 3; deeper liquid lives on the grid alone. Particles everywhere are to be given all the
        same, and those in the deep go with the first step. Not with `viscosity`, nor with forces
        on particles. Unless given there are particles everywhere.
    tolerance : float
        Relative residual at which the pressure is solved, above 0.
    max_iterations : int
        Limit of its iterations, at least 1.
    emitters : sequence of Emitter
        Nozzles in the box; what of a jet would come out beyond it is lost.
    sinks : sequence of Sink
        Regions that swallow particles.
    cfl : float
        Cells that the fastest particle may move in a step of `advance`.
    step : float, optional
        Step of `advance` [s]; by `step_limit` unless given.
    dtype : {'float32', 'float64'}
        Of the numbers that it computes with. The pressure is float64 in both.
    threads : int, optional
        Threads of the native loops; results do not depend on it.
    time : float
        Time of the initial state [s].

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index.
    MemoryError
        If the grid does not fit into the memory of the machine.

    References
    ----------
    Zhu and Bridson, "Animating sand as a fluid", ACM Trans. Graph. 24(3), 2005 (FLIP).
    Jiang et al., "The affine particle-in-cell method", ACM Trans. Graph. 34(4), 2015.
    Batty, Bertails and Bridson, "A fast variational framework for accurate solid-fluid coupling",
    ACM Trans. Graph. 26(3), 2007 (obstacles).
    Batty and Bridson, "Accurate viscous free surfaces for buckling, coiling, and rotating liquids",
    SCA 2008, eq. 8 (`viscosity`).
    Kang, Fedkiw and Liu, "A boundary condition capturing method for multiphase incompressible
    flow", J. Sci. Comput. 15, 2000 (`surface_tension`).
    Kugelstadt et al., "Implicit density projection for volume conserving liquids", IEEE TVCG 27(4),
    2021 (`keep_volume`).
    Ferstl et al., "Narrow band FLIP for liquid simulations", Comput. Graph. Forum 35(2), 2016
    (`narrow_band`).

    Examples
    --------
    A column of water collapses in a tank.

    >>> import substep
    >>> water = substep.fill_box((0, 0, 0), (0.4, 0.2, 0.4), 0.025)
    >>> tank = ((0, 0, 0), (1.2, 0.2, 0.6))
    >>> liquid = substep.GridLiquid(water, cell=0.05, bounds=tank)
    >>> liquid.advance(0.3)
    >>> bool(liquid.positions[:, 0].max() > 0.7)
    True
    """

    _fewest_cells = 1.5

    cell: float
    bounds: Array
    density: float
    transfer: str
    viscosity: float
    surface_tension: float
    narrow_band: int | None
    sides: tuple[tuple[str, str], ...]
    cfl: float
    dtype: np.dtype[Any]

    def __init__(
        self,
        positions: ArrayLike,
        *,
        cell: float,
        bounds: ArrayLike,
        velocities: ArrayLike | None = None,
        density: float = 1000.0,
        gravity: ArrayLike | None = None,
        colliders: Sequence[Collider | Shape] = (),
        sides: str | Sequence[str | Sequence[str]] = "wall",
        transfer: str = "apic",
        flip_rate: float = 0.97,
        viscosity: float = 0.0,
        surface_tension: float = 0.0,
        slip: bool = False,
        keep_volume: bool = True,
        narrow_band: int | None = None,
        tolerance: float = 1e-4,
        max_iterations: int = 200,
        emitters: Sequence[Emitter] = (),
        sinks: Sequence[Sink] = (),
        cfl: float = 1.0,
        step: float | None = None,
        dtype: DTypeLike = "float32",
        threads: int | None = None,
        time: float = 0.0,
    ) -> None:
        self.cell = check_real("cell", cell, positive=True)
        corners, cells = check_box(bounds, self.cell)
        self.bounds, self._cells = read_only(corners), cells
        self._dimension = d = len(cells)
        x = check_array("positions", positions, (None, d))
        self.dtype = check_dtype(dtype)
        self.density = check_real("density", density, positive=True)
        volume = math.prod([self.cell] * d)
        if not all(1e-30 < m < 1e30 for m in (volume, volume * self.density)):
            raise InputError(
                f"density: the mass of a cell is out of range at {self.density} and {self.cell} m"
            )
        self.colliders = check_colliders(colliders, d)
        down = [0.0, 0.0, -9.81][3 - d :]
        pull = check_array("gravity", down if gravity is None else gravity, (d,))
        self._gravity = read_only(pull)
        self.sides = check_open_sides(sides, cells)
        self.transfer = check_choice("transfer", transfer, TRANSFERS)
        rate = check_real("flip_rate", flip_rate, nonnegative=True)
        if rate > 1:
            raise InputError(f"flip_rate: expected a number from 0 to 1, got {rate}")
        self.viscosity = check_real("viscosity", viscosity, nonnegative=True)
        self.surface_tension = check_real("surface_tension", surface_tension, nonnegative=True)
        self.narrow_band = check_narrow_band(narrow_band, self.viscosity)
        self.cfl = check_real("cfl", cfl, positive=True)
        self._step_size = None if step is None else check_real("step", step, positive=True)
        check_cells_fit(cells, self.dtype)
        more = 3 - d
        self._options = {
            "dimension": d,
            "cells": [*cells, *[1] * more],
            "low": [*corners[0].tolist(), *[0.0] * more],
            "cell": self.cell,
            "open": [[side == "open" for side in pair] for pair in self.sides]
            + [[False, False]] * more,
            "periodic": [pair[0] == "periodic" for pair in self.sides] + [False] * more,
            "density": self.density,
            "gravity": [*self._gravity, 0.0][:3],
            "transfer": self.transfer,
            "flip_rate": rate,
            "viscosity": self.viscosity,
            "surface_tension": self.surface_tension,
            "slip": check_flag("slip", slip),
            "tolerance": check_real("tolerance", tolerance, positive=True),
            "max_iterations": check_integer(
                "max_iterations", max_iterations, minimum=1, maximum=MOST_INT
            ),
            "keep_volume": check_flag("keep_volume", keep_volume),
            "narrow_band": min(self.narrow_band or 0, max(cells)),
        }
        self._set_flow(emitters, sinks, 1, self.cell / 2, "fluid")
        for k, emitter in enumerate(self.emitters):
            if not ((corners[0] <= emitter.position) & (emitter.position <= corners[1])).all():
                raise InputError(f"emitters[{k}]: expected a position in the box")
        super().__init__(self._make({}), time, threads)
        self.add(x, velocities=velocities)

    def _make(self, state: Mapping[str, Any]) -> Any:
        colliders = [c._native for c in self.colliders]
        return _core.GridLiquid(colliders, self._flow(), self._options, self.dtype.name)

    @property
    def _thinnest(self) -> float:  # type: ignore[override]
        return 2 * self.cell

    @property
    def shape(self) -> tuple[int, ...]:
        """Cells along each axis."""
        return self._cells

    @property
    def masses(self) -> Array:
        """Masses of the particles [kg] (in 2D of a layer of 1 m), shape (n,); read-only."""
        mass = self.density * (self.cell / 2) ** self._dimension
        masses: Array = read_only(np.full(len(self), mass))
        return masses

    @property
    def pressure(self) -> Array:
        """Pressure of the last step at the middle of the cells [Pa], shape of the grid; read-only.

        0 in air and obstacles, and before the first step.
        """
        return self._of_cells(self._native.pressure())

    @property
    def level_set(self) -> Array:
        """Signed distance of the middle of the cells to the surface [m], below 0 in the liquid.

        Shape of the grid; about right within three cells of the surface, further away only its sign
        is. Read-only.
        """
        return self._of_cells(self._native.level_set())

    @property
    def cell_velocities(self) -> Array:
        """Velocities of the liquid at the middle of the cells [m/s], 0 in air, as by PIC.

        Shape of the grid, then (3,) or (2,); read-only.
        """
        return self._of_cells(self._native.grid_velocity(), self._dimension)

    def _of_cells(self, values: Array, *row: int) -> Array:
        array: Array = read_only(values.reshape(*self._cells, *row))
        return array

    def sample_pressure(self, points: ArrayLike) -> Array:
        """Pressure at points, linear between the middles of the cells.

        Parameters
        ----------
        points : array_like, shape (m, 3) or (m, 2)
            Where [m], in the box. Nearer to a side than half a cell the pressure is that half a
            cell away from it; cells inside of obstacles do not count.

        Returns
        -------
        ndarray, shape (m,)
            Of the last step [Pa]; 0 in air.

        Raises
        ------
        InputError
            If a point is not in the box.
        """
        pressure = self.pressure
        covered = (pressure == 0) & (self.level_set < 0)  # by an obstacle, in the liquid
        return interpolate("points", points, self.bounds, self.cell, pressure, ~covered)

    def depth(self, points: ArrayLike) -> Array:
        """Depth of the liquid along the last axis: how much of a line is wet.

        Parameters
        ----------
        points : array_like, shape (m, 2) or (m, 1)
            Where the lines stand [m]: all coordinates but the last.

        Returns
        -------
        ndarray, shape (m,)
            Lengths in the liquid [m], as a gauge of wires measures them.

        Raises
        ------
        InputError
            If a point is not in the box.
        """
        sides = self.bounds[:, :-1]
        x = check_array("points", points, (None, self._dimension - 1))
        at = np.clip(
            (x.clip(*sides) - sides[0]) / self.cell - 0.5, 0, np.array(self._cells[:-1]) - 1
        )
        low = at.min(axis=0, initial=np.inf).clip(0, np.array(self._cells[:-1]) - 1).astype(int)
        high = np.ceil(at.max(axis=0, initial=0)).astype(int) + 1
        block = tuple(slice(i, j) for i, j in zip(low, high, strict=True))
        wet = np.clip(0.5 - self.level_set[block] / self.cell, 0, 1) * self._open(low, high)
        corners = sides[0] + self.cell * np.array([low, high])
        inside = x.clip(*corners) if ((sides[0] <= x) & (x <= sides[1])).all() else x
        return interpolate("points", inside, corners, self.cell, wet.sum(axis=-1) * self.cell)

    def _open(self, low: NDArray[np.int_], high: NDArray[np.int_]) -> Array:
        """What obstacles leave of the cells of some columns, about."""
        ends = [*zip(low, high, strict=True), (0, self._cells[-1])]
        axes = [
            start + self.cell * (np.arange(i, j) + 0.5)
            for start, (i, j) in zip(self.bounds[0], ends, strict=True)
        ]
        middles = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        points = np.zeros((middles[..., 0].size, 3))
        points[:, : self._dimension] = middles.reshape(-1, self._dimension)
        room = np.ones(len(points))
        for collider in self.colliders:
            room = np.minimum(room, np.clip(0.5 + collider.distance(points) / self.cell, 0, 1))
        return room.reshape(middles.shape[:-1])

    @property
    def report(self) -> LiquidReport:
        """What the last call of `step` or `advance` took and met."""
        native = self._native.report
        names = [field.name for field in fields(LiquidReport)[2:]]
        return LiquidReport(
            self._last.steps, self._last.dt, **{name: getattr(native, name) for name in names}
        )

    def add(
        self, positions: ArrayLike, *, velocities: ArrayLike | None = None
    ) -> NDArray[np.int64]:
        """Put in particles.

        Parameters
        ----------
        positions : array_like, shape (m, 3) or (m, 2)
            Where [m], in the box.
        velocities : array_like, same shape, optional
            Their velocities [m/s]; at rest unless given.

        Returns
        -------
        ndarray of int64, shape (m,)
            Their ids, which no other particle had or will have.

        Raises
        ------
        InputError
            If an argument is wrong; nothing is changed then.
        """
        x = self._vectors("positions", positions, None)
        m = len(x)
        v = np.zeros(x.shape) if velocities is None else self._vectors("velocities", velocities, m)
        ids = np.arange(m, dtype=np.int64)  # before anything changes: there may be no memory
        ids += self._native.add(x, v)
        return ids

    def _next_step(self) -> float:
        return self.step_limit()[0] if self._step_size is None else self._step_size

    def step_limit(self) -> tuple[float, str]:
        """Largest step that the CFL condition and capillary waves allow now, and why.

        Returns
        -------
        float
            The step [s], in which nothing moves by more than `cfl` cells: neither the fastest
            particle, with what gravity adds, nor the surface of an obstacle that is in the box or
            can come there within 1/30 s; at most 1/30 s. With surface tension at most
            sqrt(rho dx^3 / (2 pi sigma)), for capillary waves.
        str
            The reason.
        """
        pull = float(np.linalg.norm(self._gravity))
        speed = max([self._native.fastest, *(emitter.speed for emitter in self.emitters)])
        speed = max(speed, largest_speed(self.colliders, self.bounds, _LARGEST_STEP))
        # The root of v dt + g dt^2 = cfl dx.
        limit = time_of_way(self.cfl * self.cell, speed, 2 * pull)
        if self.surface_tension > 0:
            mass = self.density * self.cell**3
            waves = math.sqrt(mass / (2 * math.pi * self.surface_tension))
            if waves < min(limit, _LARGEST_STEP):
                tension = f"with a surface tension of {self.surface_tension:g} N/m"
                return waves, f"capillary waves of a cell's size, {tension}"
        if limit >= _LARGEST_STEP:
            return _LARGEST_STEP, "nothing moves fast enough to need a shorter one"
        return limit, f"CFL {self.cfl:g} at a speed of {speed:.4g} m/s and a pull of {pull:.4g}"

    def diagnostics(self) -> dict[str, float]:
        """Energies, momenta and figures of the last step.

        Returns
        -------
        dict of str to float
            `count` of particles, and `deep_cells`, full without them; `kinetic_energy`,
            `gravitational_energy` (0 at the origin) and `energy`, their sum
            [J]; `momentum_x`, `_y`, `_z` [N s]; `angular_momentum_x`, `_y`,
            `_z` about 0 [N m s]; of the last step `iterations`, `residual` and
            `mean_density_error`, as in the report.
        """
        energies, report = self._native.energies, self.report
        values = {
            "count": float(len(self)),
            "deep_cells": float(self._native.deep_cells),
            "kinetic_energy": energies.kinetic,
            "gravitational_energy": energies.potential,
        }
        return with_energy(values | momenta(energies)) | {
            "iterations": float(report.iterations),
            "residual": report.residual,
            "mean_density_error": report.mean_error,
        }

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays for recording, with their units.

        Returns
        -------
        dict of str to (ndarray, str)
            `position` and `velocity`, shape of positions; `id`, shape (n,).
        """
        return {
            "position": (self.positions, "m"),
            "velocity": (self.velocities, "m/s"),
            "id": (self.ids, "1"),
        }

    def _schema(self) -> tuple[list[Entry], dict[str, int], Any]:
        d = self._dimension
        entries: list[Entry] = [
            TIME,
            Number("last_dt", low=0),
            Number("next_id", int, low=0, high=MOST),
            Rows("ids", np.int64, ("n",), low=0, below="next_id", distinct=True),
            Rows("positions", OWN, ("n", d), low=0),
            Rows("velocities", OWN, ("n", d)),
            Rows("affine", OWN, ("n", d * d), optional=self.transfer != "apic"),
            Rows("forces", OWN, ("n", d), optional=True),
            Rows("pressure", np.float64, (math.prod(self._cells),)),
            *self._deep_schema(),
        ]
        return [*entries, *self._flow_schema()], {}, self.dtype

    def _deep_schema(self) -> list[Entry]:
        cells, band = np.array(self._cells), self.narrow_band is not None
        faces = sum(math.prod(cells + axis) for axis in np.eye(self._dimension, dtype=int))
        return [
            Rows("deep", np.uint8, (math.prod(self._cells) * band,), high=1),
            Rows("deep_velocity", OWN, (int(faces) * band,)),
            Number("seeded", int, low=0, high=MOST if band else 0),
            Number("missing", int, low=-MOST if band else 0, high=MOST if band else 0),
        ]

    def _fit(self, state: dict[str, Any]) -> None:
        super()._fit(state)
        outside = state["positions"] > self._cells
        if outside.any():
            row = int(np.argmax(outside.any(axis=1)))
            raise InputError(f"state['positions'][{row}]: expected a point in the grid")

    def _restore_native(self, state: dict[str, Any]) -> None:
        names = (
            "time last_dt next_id positions velocities affine forces ids pressure deep"
            " deep_velocity seeded missing layers absorbed"
        )
        self._native.restore(*(state[name] for name in names.split()))

    def _way_back(self) -> Callable[[], None]:
        colliders = collider_states(self.colliders)
        self._native.keep()

        def go_back() -> None:
            self._native.rewind()
            restore_colliders(self.colliders, colliders)

        return go_back

    def _write(self, name: str, values: Array, rows: NDArray[np.int64]) -> None:
        if name == "forces" and self.narrow_band is not None:
            raise InputError("forces: expected none with narrow_band, which has no deep particles")
        super()._write(name, values, rows)

    def _forces(self) -> Array:
        state = self._native.state()
        rows = np.zeros((len(self), self._dimension))
        if len(state["forces"]):
            rows[:] = state["forces"][np.argsort(state["ids"])]
        return rows
