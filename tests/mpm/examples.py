"""One small simulation of each class here, for the suites that enrol them."""

import substep


def MaterialPointMethod():
    """A jelly above the ground."""
    x, volume = substep.mpm.sample_box((0, 0, 0.05), (0.2, 0.2, 0.25), 0.05)
    jelly = substep.mpm.NeoHookean(density=1000, young_modulus=2e4, poisson_ratio=0.3)
    return substep.MaterialPointMethod(
        x, jelly, cell=0.1, volume=volume, colliders=[substep.Plane()]
    )
