"""One small simulation of each class here, for the suites that enrol them."""

import substep


def PositionBasedDynamics():
    """A chain of three links beside a wall, pinned at one end."""
    return substep.PositionBasedDynamics(
        [[0.0, 0, 0], [0.5, 0, 0], [1.0, 0, 0], [1.5, 0, 0]],
        0.5,
        [substep.Distance([[0, 1], [1, 2], [2, 3]], compliance=1e-4)],
        pinned=[0],
        colliders=[substep.Plane((1.0, 0, 0), (-2.0, 0, 0))],
    )
