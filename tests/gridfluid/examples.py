"""One small simulation of each class here, for the suites that enrol them."""

import numpy as np
import substep


def GridFlow():
    """Warm smoke that rises past a ball that moves."""
    ball = substep.Collider(substep.Sphere(0.12, (0.5, 0.6, 0.0)), velocity=(0.2, 0, 0))
    return substep.GridFlow(
        [(0, 0), (1, 1)],
        1 / 12,
        viscosity=0.01,
        colliders=[ball],
        sides=["wall", ("wall", "open")],
        temperature=lambda x: np.exp(-20 * np.sum((x - 0.3) ** 2, axis=1)),
        thermal_expansion=0.5,
        thermal_diffusivity=0.01,
        smoke=0.25,
        emitters=[substep.gridfluid.FlowEmitter(substep.Sphere(0.2, (0.5, 0.2, 0)), smoke=1.0)],
    )


def GridLiquid():
    """A block of water that falls onto a ball in a tank."""
    axis = 0.05 * (np.arange(4) + 0.5)
    water = np.stack(np.meshgrid(axis, axis, axis + 0.15, indexing="ij"), axis=-1).reshape(-1, 3)
    ball = substep.Sphere(0.1, center=(0.05, 0.1, 0.0))
    tank = ((-0.2, -0.2, 0.0), (0.6, 0.6, 0.8))
    return substep.GridLiquid(water, cell=0.1, bounds=tank, colliders=[ball])
