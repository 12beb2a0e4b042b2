"""Velocity fields in closed form, and callables of the user as fields."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import _core
from ..base.checks import (
    check_array,
    check_callable,
    check_integer,
    check_real,
    describe,
    first_bad_index,
    in_range,
)
from ..base.pictured import Pictured
from ..errors import InputError, NonFiniteError

Array = NDArray[Any]


class Steps(NamedTuple):
    """Steps of h from the time origin + first * h on."""

    origin: float
    h: float
    first: int
    number: int

    def time(self, step: int) -> float:
        """Time before step number `step` of these."""
        return self.origin + (self.first + step) * self.h


@dataclass
class Particles:
    """Positions, what became of each particle, and until when it moved."""

    x: Array
    status: Array
    stop_time: Array

    def copy(self) -> Particles:
        """Copy all arrays."""
        return Particles(self.x.copy(), self.status.copy(), self.stop_time.copy())


class Moved(NamedTuple):
    """Particles after some steps; step and index of the first landing and escape, or -1."""

    particles: Particles
    landed: tuple[int, int] = (-1, -1)
    escaped: tuple[int, int] = (-1, -1)


class Field(Pictured):
    """A velocity field dx/dt = u(t, x); call it as `field(t, x)`.

    Attributes
    ----------
    dimension : int
        2 or 3.
    periods : tuple of float or None
        Period of each coordinate, None where the field is not periodic.

    Examples
    --------
    >>> import substep
    >>> isinstance(substep.Shear(), substep.fields.Field)
    True
    """

    dimension: int
    position_units: tuple[str, ...] = ("m", "m", "m")
    block_steps: int | None = None

    def __call__(self, t: float, x: ArrayLike) -> Array:
        """Velocities at the positions x and the time t.

        Parameters
        ----------
        t : float
            Time [s].
        x : array_like, shape (n, d)
            Positions.

        Returns
        -------
        ndarray, shape (n, d)
            Velocities [m/s].
        """
        raise NotImplementedError

    @property
    def periods(self) -> tuple[float | None, ...]:
        """Period of each coordinate, None where the field is not periodic."""
        return (None,) * self.dimension

    @property
    def lower(self) -> tuple[float, ...]:
        """Where each coordinate's first period begins."""
        return (0.0,) * self.dimension

    def wrap(self, x: ArrayLike) -> Array:
        """Bring positions into the first period of each periodic coordinate.

        Positions are never wrapped while particles move, so that paths stay continuous.

        Parameters
        ----------
        x : array_like, shape (n, d)
            Positions.

        Returns
        -------
        ndarray, shape (n, d)
            A copy, wrapped.
        """
        wrapped = check_array("x", x, (None, self.dimension))
        for axis, (period, low) in enumerate(zip(self.periods, self.lower, strict=True)):
            if period is not None:
                with in_range("x"):
                    beyond = wrapped[:, axis] - low
                    outside = (beyond < 0) | (beyond >= period)
                    wrapped[outside, axis] = low + np.mod(beyond[outside], period)
        return wrapped

    def _check_time(self, name: str, t: float) -> None:
        """Refuse times at which the field is not known."""

    def _move(
        self, particles: Particles, steps: Steps, method: str, threads: int, memo: dict[str, Any]
    ) -> Moved:
        """Take the steps; `particles` stay as they are, `memo` is kept for the next call."""
        raise NotImplementedError


class Flow(Field):
    """A velocity field in closed form, computed by the native core."""

    def _native(self) -> Any:
        raise NotImplementedError

    def __call__(self, t: float, x: ArrayLike) -> Array:
        """Velocities at the positions x and the time t; see `Field`."""
        x = check_array("x", x, (None, self.dimension))
        t = check_real("t", t)
        return _check_finite("velocity", self._native().velocity(t, x, 0), t)

    def _move(
        self, particles: Particles, steps: Steps, method: str, threads: int, memo: dict[str, Any]
    ) -> Moved:
        """Take the steps natively."""
        x = self._native().advect(particles.x, *steps, method, threads)
        return Moved(Particles(x, particles.status.copy(), particles.stop_time.copy()))


@dataclass(frozen=True)
class RigidRotation(Flow):
    """Rigid rotation: u = omega x (x - center).

    Parameters
    ----------
    omega : float or array_like, shape (3,)
        Angular velocity [rad/s]: a number in the plane (counter-clockwise), a vector in space.
    center : array_like, shape (2,) or (3,), optional
        A point that rests [m]; the origin by default.

    Raises
    ------
    InputError
        If the shapes of `omega` and `center` do not go together.

    Examples
    --------
    >>> import math, substep
    >>> field = substep.RigidRotation(math.pi)
    >>> substep.advect(field, [[1.0, 0.0]], (0, 1), step=0.01).final.round(6).tolist()
    [[-1.0, 0.0]]
    """

    omega: Any = 1.0
    center: Any = None

    def __post_init__(self) -> None:
        vector = check_array("omega", self.omega)
        if vector.shape not in ((), (3,)):
            raise InputError(f"omega: expected a number or shape (3,), got shape {vector.shape}")
        dimension = 3 if vector.shape else 2
        middle = np.zeros(dimension) if self.center is None else self.center
        center = check_array("center", middle, (dimension,))
        object.__setattr__(self, "omega", tuple(vector.tolist()) if vector.shape else float(vector))
        object.__setattr__(self, "center", tuple(center.tolist()))

    @property
    def dimension(self) -> int:  # type: ignore[override]
        """2 or 3."""
        return len(self.center)

    def _native(self) -> Any:
        if self.dimension == 3:
            return _core.Flow("rigid_rotation", 3, [*self.omega, *self.center])
        return _core.Flow("rigid_rotation", 2, [0.0, 0.0, self.omega, *self.center, 0.0])


@dataclass(frozen=True)
class Shear(Flow):
    """Simple shear: the velocity along one axis grows linearly along another.

    Parameters
    ----------
    rate : float
        Shear rate [1/s].
    dimension : int
        2 or 3.
    flow_axis, gradient_axis : int
        Axis of the velocity, and axis along which it grows; they differ.

    Raises
    ------
    InputError
        If an axis does not exist or both are the same.

    Examples
    --------
    >>> import substep
    >>> substep.Shear(2.0)(0.0, [[0.0, 3.0]]).tolist()
    [[6.0, 0.0]]
    """

    rate: float = 1.0
    dimension: int = 2
    flow_axis: int = 0
    gradient_axis: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "rate", check_real("rate", self.rate))
        check_integer("dimension", self.dimension, minimum=2, maximum=3)
        for name in ("flow_axis", "gradient_axis"):
            check_integer(name, getattr(self, name), minimum=0, maximum=self.dimension - 1)
        if self.flow_axis == self.gradient_axis:
            raise InputError(
                f"gradient_axis: expected another axis than flow_axis, got {self.flow_axis}"
            )

    def _native(self) -> Any:
        axes = [float(self.flow_axis), float(self.gradient_axis)]
        return _core.Flow("shear", self.dimension, [self.rate, *axes])


@dataclass(frozen=True)
class TaylorGreen(Flow):
    """Taylor-Green vortices in the plane, an exact solution of the Navier-Stokes equations.

    u = F sin(k x) cos(k y), v = -F cos(k x) sin(k y), F = U exp(-2 nu k^2 t).

    Parameters
    ----------
    amplitude : float
        U [m/s].
    wavenumber : float
        k [rad/m], above 0.
    viscosity : float
        nu [m^2/s], at least 0; 0 gives a steady flow.

    References
    ----------
    Taylor and Green (1937), Proc. R. Soc. A 158, 499.

    Examples
    --------
    >>> import substep
    >>> field = substep.TaylorGreen()
    >>> float(field.stream_function(0.0, [[1.0, 2.0]])[0].round(6))
    0.765147
    """

    amplitude: float = 1.0
    wavenumber: float = 1.0
    viscosity: float = 0.0
    dimension = 2

    def __post_init__(self) -> None:
        object.__setattr__(self, "amplitude", check_real("amplitude", self.amplitude))
        k = check_real("wavenumber", self.wavenumber, positive=True)
        object.__setattr__(self, "wavenumber", k)
        nu = check_real("viscosity", self.viscosity, nonnegative=True)
        object.__setattr__(self, "viscosity", nu)

    @property
    def periods(self) -> tuple[float | None, ...]:
        """2 pi / k along both axes."""
        return (2 * math.pi / self.wavenumber,) * 2

    def stream_function(self, t: float, x: ArrayLike) -> Array:
        """Stream function psi: u = dpsi/dy, v = -dpsi/dx; constant along paths in a steady flow.

        Parameters
        ----------
        t : float
            Time [s].
        x : array_like, shape (n, 2)
            Positions [m].

        Returns
        -------
        ndarray, shape (n,)
            psi [m^2/s].
        """
        x = check_array("x", x, (None, 2))
        k = self.wavenumber
        t = check_real("t", t)
        with in_range("t, x"):
            f = self.amplitude * math.exp(-2 * self.viscosity * k * k * t)
            psi: Array = f / k * np.sin(k * x[:, 0]) * np.sin(k * x[:, 1])
        return _check_finite("stream_function", psi, t)

    def _native(self) -> Any:
        return _core.Flow("taylor_green", 2, [self.amplitude, self.wavenumber, self.viscosity])


@dataclass(frozen=True)
class ABC(Flow):
    """Arnold-Beltrami-Childress flow in space, of period 2 pi: a steady Euler flow with chaos.

    u = A sin z + C cos y, v = B sin x + A cos z, w = C sin y + B cos x.

    Parameters
    ----------
    a, b, c : float
        A, B and C [m/s].

    References
    ----------
    Dombre et al. (1986), J. Fluid Mech. 167, 353, eq. (1.1).

    Examples
    --------
    >>> import substep
    >>> substep.ABC(a=1, b=2, c=3)(0.0, [[0.0, 0.0, 0.0]]).tolist()
    [[3.0, 1.0, 2.0]]
    """

    a: float = math.sqrt(3.0)
    b: float = math.sqrt(2.0)
    c: float = 1.0
    dimension = 3

    def __post_init__(self) -> None:
        for name in ("a", "b", "c"):
            object.__setattr__(self, name, check_real(name, getattr(self, name)))

    @property
    def periods(self) -> tuple[float | None, ...]:
        """2 pi along all axes."""
        return (2 * math.pi,) * 3

    def _native(self) -> Any:
        return _core.Flow("abc", 3, [self.a, self.b, self.c])


@dataclass(frozen=True)
class DoubleGyre(Flow):
    """Double gyre: two vortices in the box [0, 2] x [0, 1] whose border swings to and fro.

    Stream function A sin(pi f(x, t)) sin(pi y), f = e x^2 + (1 - 2 e) x, e = epsilon sin(omega t).

    Parameters
    ----------
    amplitude : float
        A [m/s].
    epsilon : float
        How far the border swings [m]; 0 gives a steady flow.
    omega : float
        Angular frequency [rad/s].

    References
    ----------
    Shadden, Lekien and Marsden (2005), Physica D 212, 271, eq. (50)-(52).

    Examples
    --------
    >>> import substep
    >>> result = substep.advect(substep.DoubleGyre(), [[0.5, 0.25]], (0, 20), step=0.01)
    >>> bool((result.final >= 0).all() and (result.final <= [2, 1]).all())
    True
    """

    amplitude: float = 0.1
    epsilon: float = 0.25
    omega: float = 2 * math.pi / 10
    dimension = 2

    def __post_init__(self) -> None:
        for name in ("amplitude", "epsilon", "omega"):
            object.__setattr__(self, name, check_real(name, getattr(self, name)))

    def stream_function(self, t: float, x: ArrayLike) -> Array:
        """Stream function psi, as the paper has it: u = -dpsi/dy, v = dpsi/dx.

        Parameters
        ----------
        t : float
            Time [s].
        x : array_like, shape (n, 2)
            Positions [m].

        Returns
        -------
        ndarray, shape (n,)
            psi [m^2/s].
        """
        x = check_array("x", x, (None, 2))
        e = self.epsilon * math.sin(check_real("t", self.omega * check_real("t", t)))
        with in_range("x"):
            f = (e * x[:, 0] + (1 - 2 * e)) * x[:, 0]
            psi: Array = self.amplitude * np.sin(np.pi * f) * np.sin(np.pi * x[:, 1])
        return psi

    def _native(self) -> Any:
        return _core.Flow("double_gyre", 2, [self.amplitude, self.epsilon, self.omega])


def _check_finite(what: str, u: Array, t: float) -> Array:
    """What a field gives for each position at a time."""
    bad = ~np.isfinite(u)
    if bad.any():
        where = first_bad_index(bad)
        raise NonFiniteError(
            f"field: {what}(t, x){where} = {u[bad][0]} at t = {t}",
            time=t,
            index=int(np.argmax(bad.reshape(len(u), -1).any(axis=1))),
        )
    return u


class CallableField(Field):
    """A Python callable velocity(t, x) on all positions at once, x of shape (n, d)."""

    block_steps = 1

    def __init__(self, velocity: Callable[[float, Array], ArrayLike], dimension: int) -> None:
        self._velocity = check_callable("field", velocity)
        self.dimension = dimension

    def __call__(self, t: float, x: ArrayLike) -> Array:
        """Velocities at the positions x and the time t; what comes is checked and copied."""
        seen = np.asarray(x).view()
        seen.flags.writeable = False
        u = np.asarray(_core.call_user(self._velocity, (t, seen)))
        if u.shape != seen.shape:
            raise InputError(
                f"field: velocity(t, x) returned shape {u.shape}, expected {seen.shape}"
            )
        if u.dtype.kind not in "fiub":
            raise TypeError(f"field: velocity(t, x) returned {describe(u)}, expected real numbers")
        return _check_finite("velocity", np.array(u, dtype=seen.dtype), t)

    def _move(
        self, particles: Particles, steps: Steps, method: str, threads: int, memo: dict[str, Any]
    ) -> Moved:
        """Take the steps stage by stage; see cpp/substep/fields/steps.h."""
        a, b, c, divisor = _core.advection_methods[method]
        x = particles.x
        h = x.dtype.type(steps.h)
        for step in range(steps.number):
            t = steps.time(step)
            k: list[Array] = []
            for row, c_i in zip(a, c, strict=True):
                y = x
                with np.errstate(over="ignore", invalid="ignore"):
                    for a_ij, k_j in zip(row, k, strict=True):
                        if a_ij:
                            y = y + (h * x.dtype.type(a_ij)) * k_j
                try:
                    k.append(self(t + c_i * steps.h, y))
                except NonFiniteError as error:
                    error.step = step
                    raise
            with np.errstate(over="ignore", invalid="ignore"):
                total = sum(x.dtype.type(b_i) * k_i for b_i, k_i in zip(b, k, strict=True) if b_i)
                x = x + (h / x.dtype.type(divisor)) * total
            bad = ~np.isfinite(x).all(axis=1)
            if bad.any():
                index = int(np.argmax(bad))
                raise NonFiniteError(
                    f"position of particle {index} is no longer finite in step {step}; "
                    "take a smaller step",
                    time=t,
                    index=index,
                    step=step,
                )
        return Moved(Particles(x, particles.status.copy(), particles.stop_time.copy()))
