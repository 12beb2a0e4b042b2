"""A small simulation of each class of `substep.coupling`."""

import substep


def World(threads=None):
    """A ball of cork and a heavy one on a string that fall into a basin of four cells' depth."""
    bodies = substep.RigidBodies(step=1 / 120)
    balls = bodies.add(
        substep.Sphere(0.12), [(0.3, 0.25, 0.33), (0.7, 0.25, 0.4)], density=300.0, restitution=0.2
    )
    bodies.distance(int(balls[1]), None, (0.7, 0.25, 0.4), (0.7, 0.25, 0.9), limits=(0, 0.55))
    bodies.add(substep.Plane(), (0, 0, 0), motion="static")
    water = substep.GridLiquid(
        substep.fill_box((0, 0, 0), (1, 0.5, 0.25), 0.0625),
        cell=0.125,
        bounds=((0, 0, 0), (1, 0.5, 1)),
        colliders=bodies.make_colliders(balls),
    )
    world = substep.World({"bodies": bodies, "water": water})
    world.threads = threads
    return world
