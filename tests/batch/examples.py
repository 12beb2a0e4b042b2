"""One small simulation of each class here, for the suites that enrol them."""

import substep


def Batch():
    """Three chains of springs above the ground, of which one is heavier."""
    made = []
    for mass in (0.5, 0.5, 2.0):
        made.append(
            substep.MassSpring(
                [[0.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0]],
                [[0, 1], [1, 2]],
                500.0,
                mass,
                pinned=[0],
                step=0.01,
                colliders=[substep.Plane((0, 0, 1), (0, 0, -2.0))],
            )
        )
    return substep.Batch(made)
