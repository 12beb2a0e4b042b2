"""Elastic solids and fluids of the material point method: constants in SI, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

from ..base.checks import check_flag, check_real
from ..errors import InputError

LARGEST = 1e30  # [Pa], [kg/m^3], [Pa s]: what float32 can compute with


class Material:
    """What all materials have in common; make one of its kinds."""

    _kind: str  # its name in the native core
    density: float

    def __post_init__(self) -> None:
        for field in fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if field.type == "float":
                object.__setattr__(self, field.name, check_real(field.name, value))
        check_range(self, "density", above=0, below=LARGEST)
        self._check()

    def _check(self) -> None:
        """Refuses what is out of range."""

    def _constants(self) -> dict[str, Any]:
        """What the native core computes with, under its names."""
        raise NotImplementedError

    @property
    def wave_speed(self) -> float:
        """Speed of pressure waves at rest [m/s], which limits explicit steps."""
        return math.sqrt(self._modulus / self.density)

    @property
    def _modulus(self) -> float:
        """Of pressure waves at rest [Pa]."""
        raise NotImplementedError


def check_range(
    material: Material,
    name: str,
    *,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
) -> None:
    """Refuses a constant that is out of range."""
    value = getattr(material, name)
    wrong = (
        (above is not None and value <= above)
        or (at_least is not None and value < at_least)
        or (below is not None and value >= below)
        or (at_most is not None and value > at_most)
    )
    if wrong:
        words = {"above": above, "at least": at_least, "below": below, "at most": at_most}
        wanted = " and ".join(f"{word} {k:g}" for word, k in words.items() if k is not None)
        raise InputError(f"{name}: expected a number {wanted}, got {value}")


@dataclass(frozen=True)
class Elastic(Material):
    """What is made of E and nu."""

    density: float
    young_modulus: float
    poisson_ratio: float

    def _check(self) -> None:
        check_range(self, "young_modulus", above=0, below=LARGEST)
        check_range(self, "poisson_ratio", above=-1, below=0.5)
        if not self._modulus < LARGEST:
            raise InputError(f"poisson_ratio: too close to 0.5, got {self.poisson_ratio}")

    @property
    def shear_modulus(self) -> float:
        """Lame's mu = E / (2 (1 + nu)) [Pa]."""
        return self.young_modulus / (2 * (1 + self.poisson_ratio))

    @property
    def lame_lambda(self) -> float:
        """Lame's lambda = E nu / ((1 + nu) (1 - 2 nu)) [Pa]."""
        nu = self.poisson_ratio
        return self.young_modulus * nu / ((1 + nu) * (1 - 2 * nu))

    @property
    def _modulus(self) -> float:
        return self.lame_lambda + 2 * self.shear_modulus

    def _constants(self) -> dict[str, Any]:
        return {"density": self.density, "mu": self.shear_modulus, "lambda": self.lame_lambda}


@dataclass(frozen=True)
class NeoHookean(Elastic):
    """A compressible neo-Hookean solid: rubber, jelly.

    Its energy grows without bound as a particle is flattened, so it never inverts in small enough
    steps. docs/mpm_materials.md has the equations of all materials.

    Parameters
    ----------
    density : float
        Of the undeformed material [kg/m^3], above 0.
    young_modulus : float
        E [Pa], above 0.
    poisson_ratio : float
        nu, above -1 and below 0.5. Waves are faster, so steps shorter, the closer it is to 0.5.

    Raises
    ------
    InputError
        If a constant is out of range.

    References
    ----------
    Simo and Hughes, "Computational Inelasticity", 1998, eq. 9.2.3.

    Examples
    --------
    >>> import substep
    >>> jelly = substep.mpm.NeoHookean(density=1000, young_modulus=1e5, poisson_ratio=0.3)
    >>> round(jelly.wave_speed, 2)
    11.6
    """

    _kind = "neo_hookean"


@dataclass(frozen=True)
class FixedCorotated(Elastic):
    """A fixed-corotated solid: linear in the stretches; it goes on through inversion.

    Parameters
    ----------
    density : float
        Of the undeformed material [kg/m^3], above 0.
    young_modulus : float
        E [Pa], above 0.
    poisson_ratio : float
        nu, above -1 and below 0.5.

    Raises
    ------
    InputError
        If a constant is out of range.

    References
    ----------
    Stomakhin, Howes, Schroeder and Teran, "Energetically consistent invertible elasticity", 2012.

    Examples
    --------
    >>> import substep
    >>> substep.mpm.FixedCorotated(1000, 1e5, 0.3).shear_modulus.__round__()
    38462
    """

    _kind = "fixed_corotated"


@dataclass(frozen=True)
class Fluid(Material):
    """A weakly compressible fluid: p = K / gamma (J^-gamma - 1), with viscosity.

    Water has K = 2.2e9 Pa; one of 100 times rho v^2, for speeds v of the flow, keeps its volume
    within about 1 % and takes far longer steps.

    Parameters
    ----------
    density : float
        At rest [kg/m^3], above 0.
    bulk_modulus : float
        K [Pa], above 0.
    exponent : float
        gamma, from 1 to 20; 7 is that of Cole's equation of water.
    viscosity : float
        Dynamic viscosity [Pa s], at least 0.
    tension : bool
        Whether pressure may be below 0. Without, fluid that is pulled apart comes apart.

    Raises
    ------
    InputError
        If a constant is out of range.

    References
    ----------
    Monaghan, "Simulating free surface flows with SPH", J. Comput. Phys. 110, 1994, eq. 4.1.

    Examples
    --------
    >>> import substep
    >>> water = substep.mpm.Fluid(density=1000, bulk_modulus=1e5)
    >>> water.wave_speed
    10.0
    """

    density: float = 1000.0
    bulk_modulus: float = 1e6
    exponent: float = 7.0
    viscosity: float = 0.0
    tension: bool = False

    _kind = "fluid"

    def _check(self) -> None:
        check_range(self, "bulk_modulus", above=0, below=LARGEST)
        check_range(self, "exponent", at_least=1, at_most=20)
        check_range(self, "viscosity", at_least=0, below=LARGEST)
        object.__setattr__(self, "tension", check_flag("tension", self.tension))

    @property
    def _modulus(self) -> float:
        return self.bulk_modulus

    def _constants(self) -> dict[str, Any]:
        return {
            "density": self.density,
            "bulk_modulus": self.bulk_modulus,
            "exponent": self.exponent,
            "viscosity": self.viscosity,
            "tension": self.tension,
        }
