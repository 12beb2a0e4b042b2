"""Native loops that test_threads.py runs, in its own process and in others."""

import numpy as np
import substep


def start(n):
    return np.random.default_rng(1).uniform([0.0, 0.0], [2.0, 1.0], (n, 2))


def drift(n=20000, steps=20, threads=None):
    """Hash of n particles after some steps in the double gyre."""
    result = substep.advect(
        substep.DoubleGyre(), start(n), (0.0, 0.01 * steps), step=0.01, threads=threads
    )
    return substep.state_hash(result.positions)


def chain(n=100000, steps=20, threads=None):
    """Hash of a chain of n masses after some steps of RK4."""
    result = substep.solve_ivp(
        substep.systems.SpringChain(n),
        (0.0, 0.01 * steps),
        np.sin(np.arange(2.0 * n)),
        method="rk4",
        step=0.01,
        t_eval=[0.01 * steps],
        threads=threads,
    )
    return substep.state_hash(result.y)


def boxes(n=64, steps=20, threads=None):
    """Hash of n boxes that fall on one another, after some steps."""
    bodies = substep.RigidBodies(threads=threads, sleeping=False)
    bodies.add(substep.rigid.Plane(), (0, 0, 0), motion="static")
    k = np.arange(n)
    x = np.stack([0.25 * (k % 4), 0.25 * (k // 4 % 4), 0.15 + 0.22 * (k // 16)], axis=1)
    x += np.random.default_rng(2).uniform(-0.02, 0.02, x.shape)
    bodies.add(substep.rigid.Box((0.2, 0.2, 0.2)), x, restitution=0.2)
    bodies.advance(steps / 60)
    return substep.state_hash(*bodies.state().values())


def grains(n=2000, steps=20, threads=None):
    """Hash of about n grains of sand after some steps, on a grid that they are sorted into."""
    side = 0.1 * (n / 4) ** (1 / 3)
    x, volume = substep.mpm.sample_box((0, 0, 0.05), (2 * side, side, 0.05 + 2 * side), 0.1)
    sand = substep.MaterialPointMethod(
        x,
        substep.mpm.Sand(young_modulus=1e5),
        cell=0.2,
        volume=volume,
        velocities=np.tile([1.0, 0.5, -2.0], (len(x), 1)),
        colliders=[substep.Collider(substep.Plane(), friction=0.5)],
        step=2.0**-8,
        threads=threads,
    )
    sand.advance(steps * 2.0**-8)
    return substep.state_hash(*sand.state().values())
