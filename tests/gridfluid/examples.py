"""One small simulation of each class here, for the suites that enrol them."""

import numpy as np
import substep


def GridLiquid():
    """A block of water that falls onto a ball in a tank."""
    axis = 0.05 * (np.arange(4) + 0.5)
    water = np.stack(np.meshgrid(axis, axis, axis + 0.15, indexing="ij"), axis=-1).reshape(-1, 3)
    ball = substep.Sphere(0.1, center=(0.05, 0.1, 0.0))
    tank = ((-0.2, -0.2, 0.0), (0.6, 0.6, 0.8))
    return substep.GridLiquid(water, cell=0.1, bounds=tank, colliders=[ball])
