"""Position-based fluids: liquids of particles that keep their density."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .. import _core
from ..base.checks import (
    MOST_INT,
    as_array,
    check_array,
    check_choice,
    check_dtype,
    check_flag,
    check_integer,
    check_positive,
    check_real,
    check_within,
)
from ..base.rows import read_only
from ..base.schema import MOST, OWN, TIME, Entry, Number, Rows
from ..base.simulation import StepReport, momenta, with_energy
from ..errors import InputError
from ..geometry import Collider, Shape
from ..geometry.colliders import check_colliders
from ..particles.emitters import Emitter, Sink
from ..particles.state import ON_ESCAPE, Particles, check_bounds, check_kinds
from .start import warn_of_start

Array = NDArray[np.float64]

KERNELS = ("cubic_spline", "poly6_spiky")
_XSPH = 0.02  # with divergence_free, which leaves noise
_LARGEST_STEP = 1 / 60  # [s], where nothing moves


@dataclass
class FluidReport(StepReport):
    """What the last call of `step` or `advance` took and met.

    Attributes
    ----------
    mean_error, max_error : float
        Of the density, relative, as measured before the last correction of the last step.
    limited : int
        Corrections of the last step that were cut to a quarter of the kernel's radius.
    divergence_iterations : int
        Of conjugate gradients for velocities without divergence, in the last step.
    divergence_error : float
        Mean compression in a step by the velocities that they left, relative.
    divergence_converged : bool
        Whether they met their tolerance.
    removed, clamped : int
        Particles that left the bounds in it.
    viscosity_iterations : int
        Of conjugate gradients, in the last step.
    viscosity_converged : bool
        Whether they met their tolerance.
    """

    mean_error: float = 0.0
    max_error: float = 0.0
    limited: int = 0
    removed: int = 0
    clamped: int = 0
    viscosity_iterations: int = 0
    viscosity_converged: bool = True
    divergence_iterations: int = 0
    divergence_error: float = 0.0
    divergence_converged: bool = True


class PositionBasedFluid(Particles):
    """A liquid of particles whose density is kept by corrections of their positions.

    Every particle is `spacing` cubed (in 2D squared) of liquid. A step predicts the positions,
    moves them until the density is nowhere above that of the liquid at rest, and takes the
    velocities from how far the particles came, or with `divergence_free` by a pressure that takes
    what would compress from them. docs/pbf.md has the equations and the limits.

    Parameters
    ----------
    positions : array_like, shape (n, 3) or (n, 2)
        Initial positions [m]. In 2D the particles lie at z = 0, where colliders are cut.
    spacing : float
        Distance of neighbours in the lattice of rest density [m], above 0.
    velocities : array_like, shape of positions, optional
        Initial velocities [m/s]; at rest unless given.
    density : float or sequence of float
        Rest density [kg/m^3], above 0; one for each of several fluids. In 2D the layer is taken as
        1 m thick.
    kinds : int or array_like of int, shape (n,), optional
        Which of the densities each particle has; the first unless given.
    gravity : array_like, shape (3,) or (2,), optional
        Acceleration [m/s^2]; 9.81 downward (along the last axis) unless given.
    colliders : sequence of Collider or Shape
        Obstacles and containers (a tank is a `Box` with `hollow`).
    kernel : {'cubic_spline', 'poly6_spiky'}
        Smoothing kernel. The second is the pair of Macklin and Mueller: poly6 for the density, the
        gradient of the spiky kernel for the corrections.
    support : float
        Radius of the kernel in spacings, from 1.2 to 4.
    tolerance : float
        Mean density error, relative, at which a step stops to iterate.
    max_tolerance : float
        Largest density error, relative, at which it does.
    min_iterations : int
        Iterations that a step takes at least. With none, errors below the tolerance add up over
        short steps, and give a splash energy when a later step corrects them.
    max_iterations : int
        Limit of iterations of a step, at least 1.
    warm_start : float
        Share of the corrections of the last step that a step begins with, from 0 to below 1. For
        fixed steps (`step`); where their size changes it can give a splash energy. Not with
        `divergence_free`.
    divergence_free : bool
        Velocities by a pressure solve: a liquid that flows slowly keeps its energy. A step takes
        more than twice as long.
    divergence_tolerance : float
        Mean compression that the velocities may still cause in a step, relative; `divergence_free`.
    divergence_iterations : int
        Limit of iterations of its conjugate gradients, at least 1.
    compliance : float
        Of the density constraint, relative to the sum of squared gradients in the rest
        lattice; at least 0.
    artificial_pressure : float
        Repulsion of close particles against clumps, as the density error that pushes as hard.
    xsph : float, optional
        Part, from 0 to 1, of the difference to the mean velocity around that each step takes away
        (XSPH); smooths the motion, conserves linear momentum only. 0 unless given, 0.02 with
        `divergence_free`.
    viscosity : float or sequence of float
        Kinematic viscosity [m^2/s], at least 0, implicit, so stable with any; one for each fluid.
    vorticity_confinement : float
        Strength [m/s], at least 0, of the force that spins up eddies.
    surface_tension : float
        Surface tension [N/m], at least 0. docs/pbf_forces.md has the equations of these four.
    emitters : sequence of Emitter
        Nozzles.
    sinks : sequence of Sink
        Regions that swallow particles.
    one_sided : bool
        Only compression is corrected. False also pulls particles of low density together, as at a
        free surface.
    on_escape : {'raise', 'remove', 'clamp'}
        What happens to particles that leave the bounds: SolverError, they are taken out, or they
        are held at the bounds.
    bounds : array_like, shape (2, 3) or (2, 2), optional
        Lowest and highest corner [m] of where particles may be; anywhere unless given.
    cfl : float
        Spacings that the fastest particle may move in a step of `advance`.
    step : float, optional
        Step of `advance` [s]; by `step_limit` unless given.
    dtype : {'float32', 'float64'}
        Of the numbers that it computes with; positions are stored from a float64 origin on.
    threads : int, optional
        Threads of the native loops; results do not depend on it.
    time : float
        Time of the initial state [s].

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index.

    Warns
    -----
    StartWarning
        If particles overlap, most are alone, or some are deep in an obstacle or outside of a tank.

    References
    ----------
    Macklin and Mueller, "Position based fluids", ACM Trans. Graph. 32(4), 2013, algorithm 1.
    Solenthaler and Pajarola, "Density contrast SPH interfaces", 2008, eq. 3 (several fluids).

    Examples
    --------
    A column of water of 8 x 8 x 8 particles collapses in a tank.

    >>> import numpy as np
    >>> import substep
    >>> axis = 0.05 * (np.arange(8) + 0.5)
    >>> water = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    >>> box = substep.Box((1.6, 0.4, 1.0), center=(0.8, 0.2, 0.5))
    >>> tank = substep.Collider(box, hollow=True)
    >>> liquid = substep.PositionBasedFluid(water, 0.05, colliders=[tank])
    >>> liquid.advance(0.3)
    >>> bool(liquid.positions[:, 0].max() > 0.6)
    True
    >>> bool(tank.distance(liquid.positions).min() > 0)
    True
    """

    spacing: float
    density: Array
    support: float
    cfl: float
    dtype: np.dtype[Any]

    def __init__(
        self,
        positions: ArrayLike,
        spacing: float,
        *,
        velocities: ArrayLike | None = None,
        density: float | Sequence[float] = 1000.0,
        kinds: ArrayLike | None = None,
        gravity: ArrayLike | None = None,
        colliders: Sequence[Collider | Shape] = (),
        kernel: str = "cubic_spline",
        support: float = 2.0,
        tolerance: float = 1e-3,
        max_tolerance: float = 0.05,
        min_iterations: int = 2,
        max_iterations: int = 10,
        warm_start: float = 0.0,
        divergence_free: bool = False,
        divergence_tolerance: float = 1e-4,
        divergence_iterations: int = 100,
        compliance: float = 1e-3,
        artificial_pressure: float = 0.0,
        xsph: float | None = None,
        viscosity: float | Sequence[float] = 0.0,
        vorticity_confinement: float = 0.0,
        surface_tension: float = 0.0,
        emitters: Sequence[Emitter] = (),
        sinks: Sequence[Sink] = (),
        one_sided: bool = True,
        on_escape: str = "raise",
        bounds: ArrayLike | None = None,
        cfl: float = 0.4,
        step: float | None = None,
        dtype: DTypeLike = "float32",
        threads: int | None = None,
        time: float = 0.0,
    ) -> None:
        x = check_array("positions", positions)
        d = 2 if x.ndim == 2 and x.shape[1] == 2 else 3
        x = check_array("positions", x, (None, d))
        self.dtype = check_dtype(dtype)
        check_within("positions", x, self.dtype)
        self.spacing = check_real("spacing", spacing, positive=True)
        fluids = as_array("density", density)
        if fluids.size == 0:
            raise InputError("density: expected at least one number")
        self.density = read_only(check_positive("density", fluids, fluids.size))
        volume = math.prod([self.spacing] * d)  # infinite where spacing**d raises
        if not all(1e-30 < m < 1e30 for m in (volume, *(volume * self.density).tolist())):
            raise InputError(f"spacing: the mass of a particle is out of range at {spacing} m")
        self.colliders = check_colliders(colliders, d)
        down = [0.0, 0.0, -9.81][3 - d :]
        pull = check_array("gravity", down if gravity is None else gravity, (d,))
        self._gravity = read_only(pull)
        self.support = check_real("support", support)
        if not 1.2 <= self.support <= 4:
            raise InputError(f"support: expected a number from 1.2 to 4, got {self.support}")
        self.cfl = check_real("cfl", cfl, positive=True)
        self._step_size = None if step is None else check_real("step", step, positive=True)
        divergence_free = check_flag("divergence_free", divergence_free)
        self._options = {
            "dimension": d,
            "spacing": self.spacing,
            "support": self.support,
            "kernel": check_choice("kernel", kernel, KERNELS),
            "masses": (self.density * self.spacing**d).tolist(),
            "gravity": [*self._gravity, 0.0][:3],
            "tolerance": check_real("tolerance", tolerance, nonnegative=True),
            "max_tolerance": check_real("max_tolerance", max_tolerance, nonnegative=True),
            "min_iterations": check_integer(
                "min_iterations", min_iterations, minimum=0, maximum=MOST_INT
            ),
            "max_iterations": check_integer(
                "max_iterations", max_iterations, minimum=1, maximum=MOST_INT
            ),
            "warm_start": _check_warm_start(warm_start, divergence_free),
            "divergence_free": divergence_free,
            "divergence_tolerance": check_real(
                "divergence_tolerance", divergence_tolerance, nonnegative=True
            ),
            "divergence_iterations": check_integer(
                "divergence_iterations", divergence_iterations, minimum=1, maximum=MOST_INT
            ),
            "relaxation": check_real("compliance", compliance, nonnegative=True),
            "artificial_pressure": check_real(
                "artificial_pressure", artificial_pressure, nonnegative=True
            ),
            "one_sided": check_flag("one_sided", one_sided),
            "viscosity": _check_viscosity(viscosity, len(self.density)),
            **_check_forces(
                (_XSPH if divergence_free else 0.0) if xsph is None else xsph,
                vorticity_confinement,
                surface_tension,
            ),
            "on_escape": check_choice("on_escape", on_escape, ON_ESCAPE),
            "bounds": check_bounds(bounds, d),
        }
        self._dimension = d
        self._origin = [0.0, 0.0, 0.0]
        self._set_flow(emitters, sinks, len(self.density), self.spacing, "fluid")
        if len(x):
            self._origin[:d] = (0.5 * x.min(axis=0) + 0.5 * x.max(axis=0)).tolist()
        elif self.emitters:
            self._origin[:d] = self.emitters[0].position.tolist()
        for k, emitter in enumerate(self.emitters):
            away = np.abs(emitter.position - self._origin[:d]).max()
            if not away <= 2.0**22 * self.support * self.spacing:
                raise InputError(f"emitters[{k}]: too far from the first of all for float32")
            if not np.abs(emitter.position).max() <= 2.0**40 * self.spacing:
                raise InputError(f"emitters[{k}]: too far from 0 to distinguish its points")
        super().__init__(self._make({}), time, threads)
        self.add(x, velocities=velocities, kinds=kinds)
        warn_of_start(
            x,
            self._native.densities(),
            self._native.lone_density,
            self.spacing,
            self.colliders,
        )

    def _make(self, state: Mapping[str, Any]) -> Any:
        colliders = [c._native for c in self.colliders]
        return _core.PositionBasedFluid(
            self._origin, colliders, self._flow(), self._options, self.dtype.name
        )

    @property
    def kinds(self) -> NDArray[np.int32]:
        """Which of the fluids each particle is, shape (n,); read-only."""
        fluids: NDArray[np.int32] = read_only(self._native.fluids())
        return fluids

    @property
    def masses(self) -> Array:
        """Masses [kg] (in 2D of a layer of 1 m), shape (n,); read-only."""
        masses: Array = read_only(np.array(self._options["masses"])[self.kinds])
        return masses

    @property
    def densities(self) -> Array:
        """Densities where the particles are, walls included, over the rest density, shape (n,)."""
        values: Array = read_only(self._native.densities())
        return values

    @property
    def _thinnest(self) -> float:  # type: ignore[override]
        return self.spacing

    @property
    def report(self) -> FluidReport:
        """What the last call of `step` or `advance` took and met."""
        native = self._native.report
        names = [field.name for field in fields(FluidReport)[2:]]
        return FluidReport(
            self._last.steps, self._last.dt, **{name: getattr(native, name) for name in names}
        )

    def add(
        self, positions: ArrayLike, *, velocities: ArrayLike | None = None, kinds: Any = None
    ) -> NDArray[np.int64]:
        """Put in particles.

        Parameters
        ----------
        positions : array_like, shape (m, 3) or (m, 2)
            Where [m].
        velocities : array_like, same shape, optional
            Their velocities [m/s]; at rest unless given.
        kinds : int or array_like of int, shape (m,), optional
            Which of the fluids they are; the first unless given.

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
        which = check_kinds("kinds", 0 if kinds is None else kinds, m, len(self.density))
        ids = np.arange(m, dtype=np.int64)  # before anything changes: there may be no memory
        ids += self._native.add(x, v, which)
        return ids

    def _next_step(self) -> float:
        return self.step_limit()[0] if self._step_size is None else self._step_size

    def step_limit(self) -> tuple[float, str]:
        """Largest step that the CFL condition allows now, and why.

        Returns
        -------
        float
            The step [s]: `cfl` spacings at the speed of the fastest particle, where each counts as
            fast as it would be after falling to the height of the lowest one; at most 1/60 s.
        str
            The reason.
        """
        speed = max([self._native.fastest, *(emitter.speed for emitter in self.emitters)])
        limit = self.cfl * self.spacing / speed if speed > 0 else math.inf
        waves = self._capillary_step()
        if waves < min(limit, _LARGEST_STEP):
            return waves, "capillary waves of the length of a spacing"
        if limit >= _LARGEST_STEP:
            return _LARGEST_STEP, "nothing moves fast enough to need a shorter one"
        return limit, f"CFL {self.cfl:g} at a speed of {speed:.4g} m/s"

    def _capillary_step(self) -> float:
        """Step that resolves the shortest capillary waves [s].

        Half of what Brackbill, Kothe and Zemach (1992), eq. 61, have: sqrt(rho d^3 / (2 pi sigma)),
        of the lightest fluid.
        """
        sigma: float = self._options["surface_tension"]
        if sigma == 0:
            return math.inf
        return math.sqrt(float(self.density.min()) * self.spacing**3 / (8 * math.pi * sigma))

    def diagnostics(self) -> dict[str, float]:
        """Energies, momenta and the density errors of the last step.

        Returns
        -------
        dict of str to float
            `count`; `kinetic_energy`, `gravitational_energy` (0 at the origin) and `energy`, their
            sum [J]; `momentum_x`, `_y`, `_z` [N s];
            `angular_momentum_x`, `_y`, `_z` about 0 [N m s]; of the last step `iterations`,
            `mean_density_error` and `max_density_error` (relative, before the last correction).
        """
        energies, report = self._native.energies, self.report
        values = {
            "count": float(len(self)),
            "kinetic_energy": energies.kinetic,
            "gravitational_energy": energies.potential,
        }
        return with_energy(values | momenta(energies)) | {
            "iterations": float(report.iterations),
            "mean_density_error": report.mean_error,
            "max_density_error": report.max_error,
        }

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays for recording, with their units.

        Returns
        -------
        dict of str to (ndarray, str)
            `position` and `velocity`, shape of positions; `id` and `fluid`, shape (n,).
        """
        return {
            "position": (self.positions, "m"),
            "velocity": (self.velocities, "m/s"),
            "id": (self.ids, "1"),
            "fluid": (self.kinds, "1"),
        }

    def _schema(self) -> tuple[list[Entry], dict[str, int], Any]:
        flat = self._dimension == 2
        kinds = len(self.density) - 1
        entries: list[Entry] = [
            TIME,
            Number("last_dt", low=0),
            Number("next_id", int, low=0, high=MOST),
            Rows("ids", np.int64, ("n",), low=0, below="next_id", distinct=True),
            Rows("positions", OWN, ("n", 4), flat=flat),
            Rows("velocities", OWN, ("n", 4), flat=flat),
            Rows("forces", OWN, ("n", 4), flat=flat, optional=True),
            Rows("fluids", np.int32, ("n",), low=0, high=kinds),
        ]
        return [*entries, *self._flow_schema()], {}, self.dtype

    def _fit(self, state: dict[str, Any]) -> None:
        super()._fit(state)
        x = state["positions"]
        # A step begins at half of where cells can be numbered (pbf/fluid.cpp, reach).
        far = 2.0 ** (24 if self.dtype == np.float32 else 53) * self.support * self.spacing
        if (np.abs(x[:, :3]) > far).any():
            raise InputError(f"state['positions']: expected numbers within {far:.6g} m")
        masses = np.array(self._options["masses"])
        if not np.array_equal(x[:, 3], (masses[0] / masses).astype(self.dtype)[state["fluids"]]):
            raise InputError("state['positions']: expected the inverse masses of the fluids")

    def _restore_native(self, state: dict[str, Any]) -> None:
        names = "time last_dt next_id positions velocities forces ids fluids layers absorbed"
        self._native.restore(*(state[name] for name in names.split()))

    def _forces(self) -> Array:
        state = self._native.state()
        rows = np.zeros((len(self), self._dimension))
        if len(state["forces"]):
            rows[:] = state["forces"][np.argsort(state["ids"]), : self._dimension]
        return rows


def _check_viscosity(viscosity: Any, fluids: int) -> list[float]:
    """Of each fluid; nothing if there is none."""
    values = check_array("viscosity", np.atleast_1d(as_array("viscosity", viscosity)))
    if values.shape not in ((1,), (fluids,)):
        raise InputError(f"viscosity: expected 1 or {fluids} numbers, got shape {values.shape}")
    if (values < 0).any():
        k = int(np.argmax(values < 0))
        raise InputError(f"viscosity[{k}]: expected at least 0, got {values[k]}")
    rows: list[float] = np.broadcast_to(values, fluids).tolist() if values.any() else []
    return rows


def _check_forces(xsph: Any, confinement: Any, tension: Any) -> dict[str, float]:
    options = {
        "xsph": check_real("xsph", xsph, nonnegative=True),
        "vorticity_confinement": check_real("vorticity_confinement", confinement, nonnegative=True),
        "surface_tension": check_real("surface_tension", tension, nonnegative=True),
    }
    if options["xsph"] > 1:
        raise InputError(f"xsph: expected a number from 0 to 1, got {options['xsph']}")
    return options


def _check_warm_start(warm_start: float, divergence_free: bool) -> float:
    share = check_real("warm_start", warm_start, nonnegative=True)
    if share >= 1:
        raise InputError(f"warm_start: expected a number from 0 to below 1, got {share}")
    if share and divergence_free:
        raise InputError(f"warm_start: expected 0 with divergence_free, got {share}")
    return share
