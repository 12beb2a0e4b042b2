"""One small simulation of each class here, for the suites that enrol them."""

import substep


def RigidBodies():
    """Two boxes and a ball that fall on the ground."""
    bodies = substep.RigidBodies()
    box, x = substep.Box((0.2, 0.3, 0.4)), [[0, 0, 0.3], [1, 0, 0.5]]
    bodies.add(box, x, velocities=(0.1, 0, -1), static_friction=0.7, material="wood")
    bodies.add(substep.Sphere(0.1), (2, 0, 0.2))
    bodies.add(substep.Plane(), (0, 0, 0), motion="static", material="ice")
    return bodies


def RigidBatch():
    """Three such worlds."""
    return substep.RigidBatch(RigidBodies(), 3)
