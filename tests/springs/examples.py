"""One small simulation of each class here, for the suites that enrol them."""

import substep


def MassSpring():
    """Two masses on springs above the ground, hanging from a pin."""
    return substep.MassSpring(
        [[0, 0, 2.0], [0.1, 0, 1.5], [0, 0, 1.0]],
        [[0, 1], [1, 2]],
        stiffness=200.0,
        masses=0.5,
        pinned=[0],
        colliders=[substep.Plane()],
    )


def SoftBody():
    """A jelly that hangs from its top."""
    cube = substep.geometry.box_tetrahedra((0.1, 0.1, 0.1), (2, 2, 2))
    return substep.SoftBody(
        cube.vertices,
        cube.tetrahedra,
        density=1000,
        young_modulus=2e4,
        poisson_ratio=0.3,
        pinned=cube.vertices[:, 2] > 0.04,
    )
