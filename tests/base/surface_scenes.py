"""Cloth, soft bodies and what meets them, for the tests of surfaces."""

import numpy as np
import substep
from substep import mpm

G = 9.81


def sheet(n=7, size=0.6, *, density=2.0, stiffness=2000.0, pinned="rim", at=0.0, **options):
    """A square of cloth in the plane z = at [kg/m^2, N/m]."""
    mesh = substep.geometry.grid_mesh(n, n, (size, size))
    rim = np.abs(mesh.vertices[:, :2]).max(axis=1) > 0.499 * size
    return substep.MassSpring.from_mesh(
        substep.TriangleMesh(mesh.vertices + np.array([0, 0, at]), mesh.faces),
        density=density,
        stiffness=stiffness,
        pinned=rim if pinned == "rim" else (),
        **{"damping_time": 0.01, "step": 1 / 240, **options},
    )


def cube(side, cells, density, at, *, young_modulus=2e4, **options):
    mesh = substep.geometry.box_tetrahedra((side,) * 3, (cells,) * 3)
    return substep.SoftBody(
        mesh.vertices + at,
        mesh.tetrahedra,
        density=density,
        young_modulus=young_modulus,
        poisson_ratio=0.3,
        **{"damping_time": 0.02, "step": 1 / 240, **options},
    )


def lump(low, high, colliders, *, density=1000.0, spacing=0.025, velocity=(0, 0, 0), **options):
    """A soft block of material points."""
    x = substep.fill_box(low, high, spacing)
    return substep.MaterialPointMethod(
        x,
        mpm.NeoHookean(density=density, young_modulus=5e4, poisson_ratio=0.3),
        cell=2 * spacing,
        volume=spacing**3,
        velocities=np.broadcast_to(np.array(velocity, float), x.shape),
        colliders=colliders,
        **options,
    )


def momenta(world):
    """Linear and angular momentum about 0 of all members."""
    sums = np.zeros(6)
    for member in world.members.values():
        p = np.asarray(member.masses)[:, None] * np.asarray(member.velocities, float)
        sums[:3] += p.sum(axis=0)
        sums[3:] += np.cross(np.asarray(member.positions, float), p).sum(axis=0)
    return sums


def load(world, link=0):
    """Force on a surface in the last interval [N]."""
    return world._surfaces.pushed[link][:, :3].sum(axis=0) / world._interval


def strings(length, width, count, tension, density):
    """Strings along x [N per m of width], pinned at both ends; they are half as long at rest."""
    mesh = substep.geometry.grid_mesh(count, 4, (length, width))
    number = np.arange(4 * count).reshape(count, 4)
    along = np.stack([number[:-1].ravel(), number[1:].ravel()], axis=1)
    across = np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], axis=1)
    rest = length / (count - 1) / 2
    widths = width / 3 * np.array([0.5, 1, 1, 0.5])
    stiffness = np.r_[np.tile(tension * widths, count - 1) / rest, np.full(len(across), 10.0)]
    p = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2
    parts = np.bincount(mesh.faces.ravel(), np.repeat(areas / 3, 3), 4 * count)
    return substep.MassSpring(
        mesh.vertices,
        np.concatenate([along, across]),
        stiffness,
        density * parts,
        drag=500.0,  # stops the liquid on it within the test
        rest_lengths=np.r_[np.full(len(along), rest), np.full(len(across), width / 3)],
        faces=mesh.faces,
        pinned=np.abs(mesh.vertices[:, 0]) > 0.499 * length,
        step=1 / 240,
    )
