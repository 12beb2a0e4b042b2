"""Materials of the material point method that yield: constants in SI, checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ..base.checks import check_choice
from .materials import LARGEST, Elastic, check_range


@dataclass(frozen=True)
class Snow(Elastic):
    """Snow: it yields to compression and to stretch, and is the harder the more it is compressed.

    Parameters
    ----------
    density : float
        Of the undeformed snow [kg/m^3], above 0.
    young_modulus : float
        E [Pa], above 0, before it hardens.
    poisson_ratio : float
        nu, above -1 and below 0.5.
    critical_compression : float
        theta_c, above 0 and below 1: singular values of F_E stay above 1 - theta_c.
    critical_stretch : float
        theta_s, above 0: they stay below 1 + theta_s.
    hardening : float
        xi, at least 0: the moduli grow by exp(xi (1 - J_P)).
    largest_hardening : float
        Bound of that factor, at least 1 and at most 1e6. Steps are as short as it demands only
        where snow has become that hard.

    Raises
    ------
    InputError
        If a constant is out of range.

    References
    ----------
    Stomakhin, Schroeder, Chai, Teran and Selle, "A material point method for snow simulation",
    ACM Trans. Graph. 32(4), 2013, section 5; the defaults are those of its table 2.

    Examples
    --------
    >>> import substep
    >>> powder = substep.mpm.Snow(young_modulus=4.8e4, critical_compression=0.03)
    >>> powder.hardening
    10.0
    """

    density: float = 400.0
    young_modulus: float = 1.4e5
    poisson_ratio: float = 0.2
    critical_compression: float = 2.5e-2
    critical_stretch: float = 7.5e-3
    hardening: float = 10.0
    largest_hardening: float = 100.0

    _kind = "snow"

    def _check(self) -> None:
        super()._check()
        check_range(self, "critical_compression", above=0, below=1)
        check_range(self, "critical_stretch", above=0, below=LARGEST)
        check_range(self, "hardening", at_least=0, below=LARGEST)
        check_range(self, "largest_hardening", at_least=1, at_most=1e6)

    def _constants(self) -> dict[str, Any]:
        return super()._constants() | {
            "critical_compression": self.critical_compression,
            "critical_stretch": self.critical_stretch,
            "hardening": self.hardening,
            "largest_hardening": self.largest_hardening,
        }


@dataclass(frozen=True)
class Sand(Elastic):
    """Dry sand: it resists shear by friction and tension not at all (Drucker and Prager).

    Parameters
    ----------
    density : float
        Of the packed grains with the air between them [kg/m^3], above 0.
    young_modulus : float
        E [Pa], above 0. That of real sand gives very short steps; the default is stiff enough for
        heaps of metres.
    poisson_ratio : float
        nu, above -1 and below 0.5.
    friction_angle : float
        phi [rad], from 0 (no friction) to below pi / 2.
    match : {'compression', 'plane_strain'}
        Where the cone meets Mohr and Coulomb's pyramid of this angle: at its outer edges (Klar et
        al.), or in plane strain at constant volume.
    hardening_slope, hardening_rate, initial_softening : float
        h_1 [rad], h_2 and h_3 [rad], at least 0, of the friction angle after the plastic strain q:
        phi + (h_1 q - h_3) exp(-h_2 q).

    Raises
    ------
    InputError
        If a constant is out of range.

    References
    ----------
    Klar, Gast, Pradhana, Fu, Schroeder, Jiang and Teran, "Drucker-Prager elastoplasticity for sand
    animation", ACM Trans. Graph. 35(4), 2016; Tampubolon et al., "Multi-species simulation of
    porous sand and water mixtures", 2017 (volume correction).

    Examples
    --------
    >>> import math
    >>> import substep
    >>> sand = substep.mpm.Sand(friction_angle=math.radians(35))
    >>> sand.density
    1600.0
    """

    density: float = 1600.0
    young_modulus: float = 3.5e5
    poisson_ratio: float = 0.3
    friction_angle: float = math.pi / 6
    match: str = "plane_strain"
    hardening_slope: float = 0.0
    hardening_rate: float = 0.0
    initial_softening: float = 0.0

    _kind = "sand"

    def _check(self) -> None:
        super()._check()
        object.__setattr__(
            self, "match", check_choice("match", self.match, ("compression", "plane_strain"))
        )
        check_range(self, "friction_angle", at_least=0, below=math.pi / 2)
        for name in ("hardening_slope", "hardening_rate", "initial_softening"):
            check_range(self, name, at_least=0, below=LARGEST)

    def _constants(self) -> dict[str, Any]:
        return super()._constants() | {
            "friction_angle": self.friction_angle,
            "plane_strain": self.match == "plane_strain",
            "hardening_slope": self.hardening_slope,
            "hardening_rate": self.hardening_rate,
            "initial_softening": self.initial_softening,
        }


@dataclass(frozen=True)
class VonMises(Elastic):
    """Clay or metal: it yields where the deviatoric stress is too large, and hardens linearly.

    Parameters
    ----------
    density : float
        Of the undeformed material [kg/m^3], above 0.
    young_modulus : float
        E [Pa], above 0.
    poisson_ratio : float
        nu, above -1 and below 0.5.
    yield_stress : float
        sigma_y [Pa] of a tension test, above 0; pure shear yields at sigma_y / sqrt(3).
    hardening_modulus : float
        H [Pa], at least 0: the yield stress grows by H times the equivalent plastic strain.

    Raises
    ------
    InputError
        If a constant is out of range.

    References
    ----------
    Simo and Hughes, "Computational Inelasticity", 1998 (radial return, logarithmic strains).

    Examples
    --------
    >>> import substep
    >>> clay = substep.mpm.VonMises(1800, 1e6, 0.4, yield_stress=5e3)
    >>> clay.hardening_modulus
    0.0
    """

    yield_stress: float
    hardening_modulus: float = 0.0

    _kind = "von_mises"

    def _check(self) -> None:
        super()._check()
        check_range(self, "yield_stress", above=0, below=LARGEST)
        check_range(self, "hardening_modulus", at_least=0, below=LARGEST)

    def _constants(self) -> dict[str, Any]:
        return super()._constants() | {
            "yield_stress": self.yield_stress,
            "hardening_modulus": self.hardening_modulus,
        }


@dataclass(frozen=True)
class HerschelBulkley(Elastic):
    """Mud, paste or foam: elastic below a yield stress in shear, and flowing above it.

    In steady shear at the rate g the stress is yield_stress + consistency g^flow_index.

    Parameters
    ----------
    density : float
        Of the undeformed material [kg/m^3], above 0.
    young_modulus : float
        E [Pa], above 0.
    poisson_ratio : float
        nu, above -1 and below 0.5.
    yield_stress : float
        tau_y [Pa], in shear, at least 0.
    consistency : float
        K [Pa s^n], above 0; for n = 1 the plastic viscosity.
    flow_index : float
        n, from 0.1 to 2: 1 is Bingham's fluid, below 1 it thins as it is sheared.

    Raises
    ------
    InputError
        If a constant is out of range.

    References
    ----------
    Herschel and Bulkley, Kolloid-Zeitschrift 39, 1926; Yue, Smith, Batty, Zheng and Grinspun,
    "Continuum foam", ACM Trans. Graph. 34(5), 2015.

    Examples
    --------
    >>> import substep
    >>> mud = substep.mpm.HerschelBulkley(1500, 1e5, 0.4, yield_stress=100, consistency=20)
    >>> mud.flow_index
    1.0
    """

    yield_stress: float
    consistency: float
    flow_index: float = 1.0

    _kind = "herschel_bulkley"

    def _check(self) -> None:
        super()._check()
        check_range(self, "yield_stress", at_least=0, below=LARGEST)
        check_range(self, "consistency", above=0, below=LARGEST)
        check_range(self, "flow_index", at_least=0.1, at_most=2)

    def _constants(self) -> dict[str, Any]:
        return super()._constants() | {
            "yield_stress": self.yield_stress,
            "consistency": self.consistency,
            "flow_index": self.flow_index,
        }
