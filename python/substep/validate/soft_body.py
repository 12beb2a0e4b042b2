"""Measured for `substep validate`: beams and bodies of tetrahedra."""

from __future__ import annotations

import numpy as np

from ..geometry import box_tetrahedra
from ..springs import SoftBody

LENGTH, HEIGHT, MODULUS, DENSITY = 1.0, 0.05, 1e7, 1000.0
INERTIA = HEIGHT**4 / 12


def cantilever(cells: int) -> float:
    """Deflection of a beam under a load at its tip over F L^3 / (3 E I)."""
    mesh = box_tetrahedra((LENGTH, HEIGHT, HEIGHT), (30 * cells, cells, 2))
    rest = mesh.vertices
    tip = rest[:, 0] == rest[:, 0].max()
    force = 1e-4 * 3 * MODULUS * INERTIA / LENGTH**3
    body = SoftBody(
        rest,
        mesh.tetrahedra,
        density=DENSITY,
        young_modulus=MODULUS,
        poisson_ratio=0.0,
        pinned=rest[:, 0] == rest[:, 0].min(),
        gravity=(0, 0, 0),
        tolerance=1e-6 * force,
    )
    weights = np.where(np.abs(rest[tip, 1:]) > 0.49 * HEIGHT, 0.5, 1.0).prod(axis=1)
    body.forces[tip, 1] = -force * weights / weights.sum()
    body.step(1e4)  # so long that inertia is nothing
    return float(-(body.positions - rest)[tip, 1].mean() / 1e-4)


def free_box(integrator: str, step: float) -> SoftBody:
    """A box of rubber that is stretched, far from anything."""
    mesh = box_tetrahedra((0.3, 0.2, 0.2), (3, 2, 2))
    body = SoftBody(
        mesh.vertices,
        mesh.tetrahedra,
        density=1000.0,
        young_modulus=1e5,
        poisson_ratio=0.3,
        gravity=(0, 0, 0),
        integrator=integrator,
        step=step,
    )
    body.positions[:] *= [1.2, 0.9, 1.0]
    return body


def energy_drift(step: float) -> float:
    """Largest relative change of the energy of that box in 0.4 s by velocity Verlet."""
    body, worst = free_box("velocity_verlet", step), 0.0
    total = body.diagnostics()["elastic_energy"]
    for _ in range(20):
        body.advance(0.02)
        now = body.diagnostics()
        worst = max(worst, abs((now["kinetic_energy"] + now["elastic_energy"]) / total - 1))
    return worst


def momentum_gained() -> float:
    """Momentum of that box after 0.1 s over the sum of its parts' momenta."""
    body = free_box("velocity_verlet", 2e-4)
    body.advance(0.1)
    momenta = body.masses[:, None] * body.velocities
    return float(np.linalg.norm(momenta.sum(axis=0)) / np.linalg.norm(momenta, axis=1).sum())
