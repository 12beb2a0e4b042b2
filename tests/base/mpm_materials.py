"""One of each material that `substep.mpm` lists, soft, for tests of them all."""

import inspect

import pytest
from substep import mpm
from substep.mpm.materials import Material

CLASSES = [
    value
    for value in (getattr(mpm, name) for name in mpm.__all__)
    if inspect.isclass(value) and issubclass(value, Material)
]
MODULI = {"young_modulus": 1e4, "bulk_modulus": 1e4}
# Where a class demands them; what is not here is 1.
DEMANDED = {"density": 1000.0, "poisson_ratio": 0.3, "yield_stress": 50.0, "consistency": 5.0}


def usual(cls):
    """One of this class."""
    parameters = inspect.signature(cls).parameters.values()
    demanded = {p.name: DEMANDED.get(p.name, 1.0) for p in parameters if p.default is p.empty}
    return cls(**demanded | {p.name: MODULI[p.name] for p in parameters if p.name in MODULI})


MATERIALS = {cls._kind: usual(cls) for cls in CLASSES}
each_material = pytest.mark.parametrize("name", MATERIALS)
