"""The material point method: solids, liquids, snow, sand and mud as particles on a grid."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from .. import _core
from ..base.checks import (
    check_array,
    check_choice,
    check_dtype,
    check_positive,
    check_real,
    check_sequence,
    check_within,
    in_range,
)
from ..base.rows import find_rows_or_all, read_only, rows_of
from ..base.schema import Entry
from ..base.simulation import StepReport, momenta, with_energy
from ..errors import InputError, SolverError
from ..geometry import Collider, Shape
from ..geometry.colliders import check_colliders
from ..geometry.skin import Skinned
from ..particles.emitters import Emitter, Sink
from ..particles.state import ON_ESCAPE, Particles, check_bounds, check_kinds
from .materials import Material
from .particle_fields import STATE, cauchy, gradients, own_fields, ratios, set_gradients
from .plastic import Sand

if TYPE_CHECKING:
    from typing_extensions import Self

Array = NDArray[np.float64]

TRANSFERS = ("apic", "aflip", "flip", "pic")
KERNELS = ("linear", "quadratic", "cubic")
FORMS = ("mls", "textbook")
INTEGRATORS = {  # and their other names
    "symplectic_euler": ("explicit", "semi_implicit_euler"),
    "implicit_euler": ("implicit", "backward_euler"),
}
ON_LARGE_STEP = ("raise", "subdivide")
BOUNDARIES = ("separate", "slip", "sticky")
_COUNTS = ("steps", "sorts", "subdivided", "removed", "clamped", "newton", "krylov")
_FAR = 2.0**20  # cells from 0 at which emitters may be


@dataclass
class MaterialPointReport(StepReport):
    """What the last call of `step` or `advance` took and met.

    Attributes
    ----------
    sorts : int
        Sorts of the particles.
    subdivided : int
        Steps that were shorter than asked for.
    limit : str
        What limited the last step: a reason of `step_limit`, "given", or "end" (of the duration).
    removed, clamped : int
        Particles that left the bounds.
    newton, krylov : int
        Iterations of implicit steps, of all together; `iterations` is `newton`.
    """

    sorts: int = 0
    subdivided: int = 0
    limit: str = ""
    removed: int = 0
    clamped: int = 0
    newton: int = 0
    krylov: int = 0

    def _add(self, native: Mapping[str, Any]) -> None:
        for name in _COUNTS:
            setattr(self, name, getattr(self, name) + native[name])
        self.iterations = self.newton
        if native["steps"]:
            self.dt, self.limit = native["dt"], native["limit"]


class MaterialPointMethod(Particles, Skinned):
    """Particles of any material that move through a grid, where forces and obstacles act.

    A particle carries mass, velocity, its affine part, and the deformation of its material. A step
    passes momentum to the nodes of a grid, moves it on there, and brings it back. The grid exists
    only about the particles, wherever they are. docs/mpm.md has the equations, and what this is
    not; docs/mpm_materials.md those of the materials.

    Parameters
    ----------
    positions : array_like, shape (n, 3) or (n, 2)
        Initial positions [m]. In 2D all is as in a layer of 1 m that cannot get thicker (plane
        strain); the particles lie at z = 0, where colliders are cut.
    materials : Material or sequence of Material
        What the particles are made of, such as `substep.mpm.Sand()`; docs/mpm_materials.md has the
        table of all materials.
    cell : float
        Distance of nodes [m], above 0. 8 particles a cell (in 2D 4) are usual.
    volume : float or array_like, shape (n,)
        What a particle fills at rest [m^3; in 2D m^2], above 0; `sample_box` and others give it.
    kinds : int or array_like of int, shape (n,), optional
        Which of the materials each particle is; the first unless given.
    velocities : array_like, shape of positions, optional
        Initial velocities [m/s]; at rest unless given.
    gravity : array_like, shape (3,) or (2,), optional
        Acceleration [m/s^2]; 9.81 downward (along the last axis) unless given.
    colliders : sequence of Collider or Shape
        Obstacles and containers, with their friction. `impulse` is the total exerted on them.
    boundary : {'separate', 'slip', 'sticky'} or sequence of these
        What colliders do to material at their surface: it slides with friction and can leave; it
        slides and cannot leave; it stays. One for all, or one each.
    transfer : {'apic', 'aflip', 'flip', 'pic'}, optional
        What particles take from the grid: velocity and its affine part (keeps angular momentum),
        change of velocity and affine part (whatever the step, loses as much per time), the
        change of velocity, or velocity alone (damps). 'aflip' where there are `Sand` and gravity
        and the kernel is not 'linear', else 'apic', unless given.
    flip_rate : float, optional
        For 'flip' and 'aflip': the share of PIC or APIC per time [1/s], at least 0; after t only
        exp(-flip_rate t) of what the grid does not see is left, whatever the steps. Unless given
        0 for 'flip', and for 'aflip' one over the time in which gravity moves what rests by half a
        cell, (gravity / cell)^(1/2).
    kernel : {'linear', 'quadratic', 'cubic'}
        B-spline between particles and nodes.
    form : {'mls', 'textbook'}
        Gradients by moving least squares, or those of the spline.
    integrator : {'symplectic_euler', 'implicit_euler'}
        Of the grid; implicit Euler takes steps that elastic waves do not limit.
    cfl : float
        Cells that elastic waves and particles may pass in a step, above 0 and at most 1.
    step : float, optional
        Step of `advance` [s]; by `step_limit` unless given.
    largest_step : float
        Longest step of `step_limit` [s], where nothing limits it.
    on_large_step : {'raise', 'subdivide'}
        Steps above the limit are refused with a SolverError, or taken in several.
    emitters : sequence of Emitter
        Nozzles; `Emitter.kind` is the number of the material.
    emitter_spacing : float, optional
        Distance of particles that come out [m]; half a cell unless given.
    sinks : sequence of Sink
        Regions that swallow particles; `advance` looks every four steps.
    on_escape : {'raise', 'remove', 'clamp'}
        What happens to particles that leave the bounds: SolverError, they are taken out, or they
        are held at the bounds.
    bounds : array_like, shape (2, 3) or (2, 2), optional
        Lowest and highest corner [m] of where particles may be; anywhere unless given.
    dtype : {'float32', 'float64'}
        Of the numbers that it computes with. Positions are stored from nodes nearby, so their
        precision is the same everywhere.
    threads : int, optional
        Threads of the native loops; results do not depend on it.
    time : float
        Time of the initial state [s].

    Raises
    ------
    InputError
        If an argument is wrong, with its name and the first bad index.

    References
    ----------
    Jiang, Schroeder, Teran, Stomakhin and Selle, "The material point method for simulating
    continuum materials", SIGGRAPH courses, 2016; Hu et al., "A moving least squares material point
    method with displacement discontinuity and two-way rigid body coupling", ACM Trans. Graph.
    37(4), 2018; Jiang, Schroeder and Teran, "An angular momentum conserving affine-particle-in-cell
    method", J. Comput. Phys. 338, 2017.

    Examples
    --------
    A jelly falls on the ground and stays above it.

    >>> import substep
    >>> x, volume = substep.mpm.sample_box((0, 0, 0.05), (0.2, 0.2, 0.25), 0.02)
    >>> jelly = substep.mpm.NeoHookean(density=1000, young_modulus=2e4, poisson_ratio=0.3)
    >>> ground = substep.Collider(substep.Plane(), friction=0.5)
    >>> body = substep.MaterialPointMethod(
    ...     x, jelly, cell=0.04, volume=volume, colliders=[ground])
    >>> body.step_limit()[1]
    'elastic wave'
    >>> body.advance(0.2)
    >>> bool(ground.distance(body.positions).min() > 0)
    True
    >>> round(body.diagnostics()["mass"], 6)
    8.0
    """

    _fuses_steps = True
    _fewest_cells = 3

    materials: tuple[Material, ...]
    cell: float
    cfl: float
    integrator: str
    dtype: np.dtype[Any]

    def __init__(
        self,
        positions: ArrayLike,
        materials: Material | Sequence[Material],
        *,
        cell: float,
        volume: ArrayLike,
        kinds: ArrayLike | None = None,
        velocities: ArrayLike | None = None,
        gravity: ArrayLike | None = None,
        colliders: Sequence[Collider | Shape] = (),
        boundary: str | Sequence[str] = "separate",
        transfer: str | None = None,
        flip_rate: float | None = None,
        kernel: str = "quadratic",
        form: str = "mls",
        integrator: str = "symplectic_euler",
        cfl: float = 0.5,
        step: float | None = None,
        largest_step: float = 1e-2,
        on_large_step: str = "raise",
        emitters: Sequence[Emitter] = (),
        emitter_spacing: float | None = None,
        sinks: Sequence[Sink] = (),
        on_escape: str = "raise",
        bounds: ArrayLike | None = None,
        dtype: DTypeLike = "float32",
        threads: int | None = None,
        time: float = 0.0,
    ) -> None:
        d = 2 if check_array("positions", positions).shape[1:] == (2,) else 3
        self._dimension = d
        self.materials = _check_materials(materials)
        self.cell = check_real("cell", cell, positive=True)
        volume_of_cell = math.prod([self.cell] * d)  # infinite where cell**d raises
        if not all(1e-30 < m.density * volume_of_cell < 1e30 for m in self.materials):
            raise InputError(f"cell: the mass of a cell is out of range at {cell} m")
        self.colliders = check_colliders(colliders, d)
        down = [0.0, 0.0, -9.81][3 - d :]
        pull = check_array("gravity", down if gravity is None else gravity, (d,))
        self._gravity = read_only(pull)
        self.cfl = check_real("cfl", cfl, positive=True)
        if self.cfl > 1:
            raise InputError(f"cfl: expected a number above 0 and at most 1, got {self.cfl}")
        self._step_size = None if step is None else check_real("step", step, positive=True)
        self.integrator = check_choice("integrator", integrator, INTEGRATORS, aliases=INTEGRATORS)
        kernel = check_choice("kernel", kernel, KERNELS)
        if transfer is None:
            grains = any(isinstance(m, Sand) for m in self.materials)
            transfer = "aflip" if grains and pull.any() and kernel != "linear" else "apic"
        transfer = check_choice("transfer", transfer, TRANSFERS)
        if flip_rate is None:
            flip_rate = math.sqrt(math.hypot(*pull) / self.cell) if transfer == "aflip" else 0.0
        inside = check_bounds(bounds, d)
        self._options = {
            "cell": self.cell,
            "order": 1 + KERNELS.index(kernel),
            "transfer": transfer,
            "form": check_choice("form", form, FORMS),
            "integrator": "implicit" if self.integrator == "implicit_euler" else "explicit",
            "flip_rate": check_real("flip_rate", flip_rate, nonnegative=True),
            "gravity": [*self._gravity, 0.0][:3],
            "cfl": self.cfl,
            "largest_step": check_real("largest_step", largest_step, positive=True),
            "step": self._step_size or 0.0,
            "on_large_step": check_choice("on_large_step", on_large_step, ON_LARGE_STEP),
            "materials": [(m._kind, m._constants()) for m in self.materials],
            "boundaries": _check_boundaries(boundary, len(self.colliders)),
            "on_escape": check_choice("on_escape", on_escape, ON_ESCAPE),
            "bounds": inside,
        }
        self.dtype = check_dtype(dtype)
        spacing = self.cell / 2 if emitter_spacing is None else emitter_spacing
        spacing = check_real("emitter_spacing", spacing, positive=True)
        self._set_flow(emitters, sinks, len(self.materials), spacing, "material")
        self._check_nozzles(inside)
        super().__init__(self._make({}), time, threads)
        self._last: MaterialPointReport = MaterialPointReport()
        self.add(positions, volume, velocities=velocities, kinds=kinds)

    def _check_nozzles(self, bounds: list[list[float]] | None) -> None:
        d = self._dimension
        limit = np.full(d, _FAR * self.cell)
        low, high = -limit, limit
        if bounds is not None:
            low, high = np.maximum(low, bounds[0][:d]), np.minimum(high, bounds[1][:d])
        with in_range("emitter_spacing"):
            volume = np.array([self._emitter_spacing]) ** d
        for k, emitter in enumerate(self.emitters):
            self._check_masses("emitter_spacing", volume, np.array([emitter.kind]))
            x = emitter.position + emitter._layer(self._emitter_spacing)[0]
            if not ((x >= low) & (x <= high)).all():
                raise InputError(f"emitters[{k}]: expected one within the bounds, {low} to {high}")

    def _set_step_size(self, step: float | None) -> None:
        # The native steps know it from their making.
        self._replace(_options=self._options | {"step": step or 0.0}, _step_size=step)

    def _make(self, state: Mapping[str, Any]) -> Any:
        colliders = [c._native for c in self.colliders]
        return _core.MaterialPointMethod(
            self._options, colliders, self._flow(), self._dimension, self.dtype.name
        )

    @property
    def _thinnest(self) -> float:  # type: ignore[override]
        return 2 * self.cell

    @property
    def _pushes_bodies(self) -> bool:  # type: ignore[override]
        return self.integrator != "implicit_euler"

    @property
    def kinds(self) -> NDArray[np.int32]:
        """Which of the materials each particle is, shape (n,); read-only."""
        kinds: NDArray[np.int32] = read_only(self._native.materials())
        return kinds

    @property
    def volumes(self) -> Array:
        """Volumes at rest [m^3; in 2D m^2], shape (n,); read-only."""
        values: Array = read_only(self._native.volumes())
        return values

    @property
    def masses(self) -> Array:
        """Masses [kg] (in 2D of a layer of 1 m), shape (n,); read-only."""
        masses: Array = np.array([m.density for m in self.materials])[self.kinds]
        masses = read_only(masses * self.volumes)
        return masses

    @property
    def affine(self) -> Array:
        """Affine part C of v(x) = v + C (x - x_p) [1/s], shape (n, d, d); read-only."""
        rows: Array = read_only(self._native.affine())
        return rows

    @property
    def deformation_gradients(self) -> Array:
        """Elastic deformation gradients F, shape (n, d, d); read-only.

        Those of the trial state: the return map of plastic materials belongs to the next step.
        Materials that keep the volume ratio J alone (`Fluid`) have J^(1/d) I.
        """
        rows: Array = read_only(
            gradients(self._native, self.kinds, self.materials, self._dimension)
        )
        return rows

    @property
    def volume_ratios(self) -> Array:
        """Determinants J of the elastic deformation, shape (n,); read-only."""
        values: Array = read_only(ratios(self._native, self.kinds, self.materials, self._dimension))
        return values

    @property
    def stresses(self) -> Array:
        """Cauchy stresses [Pa], shape (n, 3, 3), in 2D with the normal stress across; read-only."""
        rows: Array = read_only(cauchy(self._native, self.volume_ratios))
        return rows

    def add(
        self,
        positions: ArrayLike,
        volume: ArrayLike,
        *,
        velocities: ArrayLike | None = None,
        kinds: ArrayLike | None = None,
    ) -> NDArray[np.int64]:
        """Put in particles, undeformed.

        Parameters
        ----------
        positions : array_like, shape (m, 3) or (m, 2)
            Where [m].
        volume : float or array_like, shape (m,)
            What they fill at rest [m^3; in 2D m^2], above 0.
        velocities : array_like, same shape as positions, optional
            Their velocities [m/s]; at rest unless given.
        kinds : int or array_like of int, shape (m,), optional
            Which of the materials they are; the first unless given.

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
        which = check_kinds("kinds", 0 if kinds is None else kinds, m, len(self.materials))
        volumes = check_positive("volume", volume, m)
        self._check_masses("volume", volumes, which)
        ids = np.arange(m, dtype=np.int64)  # before anything changes: there may be no memory
        ids += self._native.add(x, v, which, volumes)
        return ids

    def _check_masses(self, name: str, volumes: NDArray[Any], which: NDArray[Any]) -> None:
        """Refuse volumes, rounded as they are stored, of masses that would over- or underflow."""
        with np.errstate(over="ignore"):
            stored = volumes.astype(self.dtype).astype(np.float64)
        masses = np.array([material.density for material in self.materials])[which] * stored
        wrong = ~((masses > 1e-30) & (masses < 1e30))
        if wrong.any():
            k = int(np.argmax(wrong))
            raise InputError(f"{name}[{k}]: a mass of {masses[k]} kg is out of range")

    def _step_once(self, dt: float | None) -> float:
        dt = self._step_size if dt is None else dt
        if dt is None:
            self._take("step_by_limit")
        else:
            self._take("step", dt)
        return self._last.dt

    def _begin_within(self) -> None:
        super()._begin_within()
        self.__dict__["_last"] = MaterialPointReport()

    def _count(self, dt: float) -> None:
        """The native object has counted."""

    def _run(self, duration: float, end: float, callback: Callable[[Self], object] | None) -> None:
        if callback is None:
            self._take("advance", end)
            return
        first = True
        while self.time < end:  # the same steps, one by one
            self._take("advance_once", end, first)
            first = False
            callback(self)

    def _take(self, call: str, *arguments: Any) -> None:
        """Steps of the native object, and the report of them."""
        try:
            getattr(self._native, call)(*arguments)
        except SolverError as error:
            if error.step is not None:
                error.step += self._last.steps
            self._date(error)
            raise
        finally:
            self._last._add(self._native.report)

    def step_limit(self) -> tuple[float, str]:
        """Largest step that the CFL conditions allow now, and which of them it is.

        Returns
        -------
        float
            The step [s]: `cfl` cells by the fastest elastic wave at the state of the particles
            (explicit steps only) or by the fastest particle, the bound of explicit viscosity, or
            `largest_step`.
        str
            'elastic wave', 'particle speed', 'viscosity' or 'nothing moves'.
        """
        dt, reason = self._native.step_limit()
        return float(dt), str(reason)

    def set_deformation_gradients(self, values: ArrayLike, ids: ArrayLike | None = None) -> None:
        """Deform particles; their volumes at rest and their other numbers stay.

        Parameters
        ----------
        values : array_like, shape (m, d, d)
            Elastic deformation gradients F. Materials that keep J alone take its determinant.
        ids : array_like of int, shape (m,), optional
            Which; all unless given.

        Raises
        ------
        InputError, IndexError
            If an argument is wrong; nothing is changed then.
        """
        d = self._dimension
        places = find_rows_or_all(ids, self.ids)
        rows = check_array("values", rows_of(values, ids, 2), (len(places), d, d))
        check_within("values", rows, self.dtype)
        set_gradients(self._native, rows, places, self.kinds, self.materials, self.dtype)

    def diagnostics(self) -> dict[str, float]:
        """Sums over all particles; in 2D of a layer of 1 m.

        Returns
        -------
        dict of str to float
            `count`; `mass` [kg]; `kinetic_energy`, `gravitational_energy` (0 at the origin),
            `elastic_energy` (without particles that are inverted, where their material has none
            then) and `energy`, their sum [J]; `dissipated_energy` [J], whose sum with it
            changes by the work of forces, moving obstacles and what is put in or taken out;
            `momentum_x`, `_y`, `_z` [N s]; `angular_momentum_x`, `_y`, `_z` about 0, with the
            affine part [N m s].
        """
        sums = self._native.diagnostics()
        values = {
            "count": float(len(self)),
            "mass": sums.mass,
            "kinetic_energy": sums.kinetic,
            "gravitational_energy": sums.potential,
            "elastic_energy": sums.elastic,
            "dissipated_energy": sums.dissipated,
        }
        return with_energy(values | momenta(sums))

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays for recording, with their units.

        Returns
        -------
        dict of str to (ndarray, str)
            `position` and `velocity`, shape of positions; `id`, `material`, `pressure` and
            `von_mises_stress`, shape (n,); then what the materials keep: `plastic_strain`,
            `plastic_volume_ratio`, `volume_correction`, `volume_ratio`; particles of materials
            without it have it as at rest.
        """
        kinds, stress = self.kinds, self.stresses
        mean = np.trace(stress, axis1=1, axis2=2) / 3
        deviator = stress - mean[:, None, None] * np.eye(3)
        own = own_fields(self._native, kinds, self.materials, self._dimension)
        return {
            "position": (self.positions, "m"),
            "velocity": (self.velocities, "m/s"),
            "id": (self.ids, "1"),
            "material": (kinds, "1"),
            "pressure": (-mean, "Pa"),
            "von_mises_stress": (np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2))), "Pa"),
            **own,
        }

    def _schema(self) -> tuple[list[Entry], dict[str, int], Any]:
        return [*STATE, *self._flow_schema()], {"materials": len(self.materials)}, self.dtype

    def _fit(self, state: dict[str, Any]) -> None:
        super()._fit(state)
        counts, volumes = state["counts"], state["volumes"]
        if (counts > len(volumes)).any() or counts.sum() != len(volumes):
            raise InputError("state['counts']: expected the numbers of the particles")
        which = np.repeat(np.arange(len(counts)), counts)
        self._check_masses("state['volumes']", volumes, which)

    def _restore_native(self, state: dict[str, Any]) -> None:
        self._native.restore(state)

    def _forces(self) -> Array:
        forces = self._native.state()["forces"]
        rows = np.zeros((len(self), self._dimension))
        if len(forces):
            rows[:] = forces[:, : self._dimension]
        return rows


def _check_materials(materials: Any) -> tuple[Material, ...]:
    single = isinstance(materials, Material)
    found = (materials,) if single else tuple(check_sequence("materials", materials, "Material"))
    for k, material in enumerate(found):
        if not isinstance(material, Material):
            raise TypeError(f"materials[{k}]: expected a Material, got {material!r}")
    if not found:
        raise InputError("materials: expected at least one")
    return found


def _check_boundaries(boundary: Any, colliders: int) -> list[str]:
    if isinstance(boundary, str):
        return [check_choice("boundary", boundary, BOUNDARIES)] * colliders
    given = check_sequence("boundary", boundary, "names")
    found = [check_choice(f"boundary[{k}]", b, BOUNDARIES) for k, b in enumerate(given)]
    if len(found) != colliders:
        raise InputError(f"boundary: expected one or {colliders}, got {len(found)}")
    return found
