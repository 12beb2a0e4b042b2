"""One small simulation of each class here, for the suites that enrol them."""

import numpy as np
import substep


def PositionBasedFluid():
    """A block of water above the ground."""
    axis = 0.05 * (np.arange(4) + 0.5)
    water = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return substep.PositionBasedFluid(water, 0.05, colliders=[substep.Plane()])
