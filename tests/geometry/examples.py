"""A small simulation of each class of `substep.geometry`."""

import numpy as np
import substep


def AnimatedMesh():
    """A box that grows while it rises."""
    box = substep.geometry.box_mesh((0.2, 0.2, 0.2))
    x = box.vertices
    frames = np.stack([x, 1.2 * x, x]) + np.array([[[0, 0, 0]], [[0, 0, 0.1]], [[0, 0, 0.5]]])
    return substep.geometry.AnimatedMesh([0, 0.1, 0.3], frames, box.faces)
