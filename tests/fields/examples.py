"""One small simulation of each class here, for the suites that enrol them."""

import substep


def Advection():
    """Particles in the double gyre."""
    return substep.Advection(
        substep.DoubleGyre(), [[0.5, 0.5], [1.0, 0.25], [1.5, 0.75]], step=0.02
    )
