"""Draws docs/figures/mpm_boundaries.png: python docs/figures/mpm_boundaries.py (half a minute)."""

import io
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import substep
from PIL import Image
from substep import mpm

FOLDER = Path(__file__).resolve().parent
BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "#8a8a8a"
G = 9.81


def sand_panel(axes):
    """Sand runs past a ball and is pushed by a plate that is thinner than a cell."""
    tank = substep.Collider(substep.Box((1.2, 1.0, 1), (0, 0.5, 0)), hollow=True, friction=0.4)
    ball = substep.Collider(substep.Sphere(0.1, (-0.05, 0.22, 0)), friction=0.3)
    plate = substep.Collider(
        substep.Box((0.004, 0.3, 1), (0.45, 0.2, 0)), velocity=(-0.3, 0, 0), friction=0.3
    )
    x, volume = mpm.sample_box((-0.25, 0.36), (0.15, 0.7), 0.008, seed=1)
    sand = mpm.Sand(density=1500, young_modulus=5e5, poisson_ratio=0.3, friction_angle=0.6)
    body = substep.MaterialPointMethod(
        x, sand, cell=0.016, volume=volume, colliders=[tank, ball, plate]
    )
    body.advance(0.55)
    at = body.positions
    speed = np.linalg.norm(body.velocities, axis=1)
    axes.scatter(*at.T, c=speed, s=5, lw=0, cmap="viridis", vmin=0, vmax=1.0)
    axes.add_patch(plt.Circle(ball.position[:2], 0.1, color=GREY))
    axes.add_patch(plt.Rectangle(plate.position[:2] - [0.004, 0.15], 0.008, 0.3, color=ORANGE))
    axes.plot([-0.6, -0.6, 0.6, 0.6], [0.8, 0, 0, 0.8], color="black", lw=1)
    axes.set(aspect="equal", xlim=(-0.63, 0.63), ylim=(-0.02, 0.75))
    axes.set_xlabel("sand past a ball; a plate of 1/4 cell pushes it")


def friction_panel(axes):
    friction = 0.5
    angles = np.degrees(np.arctan(friction)) + np.array([-6, -3, -1, -0.5, 0.5, 1, 3, 6])
    measured = []
    for angle in np.radians(angles):
        floor = substep.Collider(
            substep.Plane((np.sin(angle), np.cos(angle), 0)), friction=friction
        )
        along = np.array([np.cos(angle), -np.sin(angle)])
        normal = np.array([np.sin(angle), np.cos(angle)])
        i, j = np.meshgrid(np.arange(16), np.arange(4), indexing="ij")
        local = 0.05 * (np.stack([i, j], axis=-1).reshape(-1, 2) + 0.5)
        x = (local[:, :1] - 0.4) * along + (local[:, 1:] + 0.002) * normal
        jelly = mpm.NeoHookean(density=1000, young_modulus=1e6, poisson_ratio=0.3)
        slides = np.tan(angle) > friction
        body = substep.MaterialPointMethod(
            x,
            jelly,
            cell=0.1,
            volume=0.05**2,
            velocities=np.broadcast_to(slides * along, x.shape),
            colliders=[floor],
            transfer="pic",
        )
        body.advance(0.6)
        before = body.velocities.mean(axis=0) @ along
        body.advance(0.4)
        measured.append((body.velocities.mean(axis=0) @ along - before) / 0.4)
    axes.plot(angles, measured, "o", color=BLUE, label="measured")
    fine = np.linspace(20, 33, 200)
    rad = np.radians(fine)
    law = np.maximum(G * (np.sin(rad) - friction * np.cos(rad)), 0)
    axes.plot(fine, law, color=GREY, zorder=0, label="Coulomb's law")
    misses = np.array(measured) - np.maximum(
        G * (np.sin(np.radians(angles)) - friction * np.cos(np.radians(angles))), 0
    )
    print("greatest difference from the law:", np.abs(misses).max())
    axes.axvline(np.degrees(np.arctan(friction)), color=GREY, lw=0.8, ls=":")
    axes.set(xlabel="angle of the plane / degrees", ylabel="acceleration of a block / (m/s$^2$)")
    axes.legend(frameon=False)


def weight_panel(axes):
    floor = substep.Collider(substep.Plane((0, 1, 0)), friction=0.6)
    x, volume = mpm.sample_box((-0.1, 0.01), (0.1, 0.31), 0.01, seed=3)
    sand = mpm.Sand(density=1500, young_modulus=1e6, poisson_ratio=0.3, friction_angle=0.6)
    heap = substep.MaterialPointMethod(x, sand, cell=0.02, volume=volume, colliders=[floor])
    weight = G * heap.diagnostics()["mass"]
    times, forces = [], []
    for _ in range(60):
        heap.advance(0.02)
        times.append(heap.time)
        forces.append(-floor.impulse[1] / floor.duration / weight)
    axes.axhline(1, color=GREY, lw=0.8)
    axes.plot(times, forces, color=BLUE)
    axes.set(xlabel="time / s", ylabel="force on the floor / weight of the heap", ylim=(0, None))
    print("at rest:", np.mean(forces[-10:]))


def main():
    figure, axes = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
    sand_panel(axes[0])
    friction_panel(axes[1])
    weight_panel(axes[2])
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110)
    picture = Image.open(buffer).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    picture.save(FOLDER / "mpm_boundaries.png", optimize=True)


if __name__ == "__main__":
    main()
