"""Draws docs/figures/walls.png: python docs/figures/walls.py (some seconds)."""

import io
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import substep
from PIL import Image

FOLDER = Path(__file__).resolve().parent
BLUE, ORANGE, GREEN, RED = "#0072b2", "#d55e00", "#009e73", "#cc3311"


def share(collider, points):
    """What an obstacle adds to the density of a particle that is alone, at each of the points."""
    alone = substep.PositionBasedFluid([[50.0, 50.0, 50.0]], 1.0).densities[0]
    particle = substep.PositionBasedFluid([points[0]], 1.0, colliders=[collider])
    values = []
    for point in points:
        particle.set_positions([point])
        values.append(particle.densities[0] - alone)
    return np.array(values)


def kernel(r, h=2.0):
    """Cubic spline."""
    q = np.asarray(r) / h
    a, b = np.clip(1 - q, 0, None), np.clip(0.5 - q, 0, None)
    return 8 / (np.pi * h**3) * (2 * a**3 - 8 * b**3)


def half_space(s, h=2.0):
    """The integral of W beyond a plane at distance s, by the midpoint rule."""
    edges = np.linspace(s, h, 201)
    z = 0.5 * (edges[1:] + edges[:-1])[:, None]
    rho = h * (np.arange(400) + 0.5)[None] / 400
    plane = (kernel(np.hypot(z, rho)) * 2 * np.pi * rho).sum(1) * h / 400
    return plane.sum() * (h - s) / 200


def lattice():
    """What a lattice half a spacing behind a plane adds half a spacing before it."""
    i = np.arange(-3, 4)
    x, y, z = np.meshgrid(i, i, i, indexing="ij")
    w = kernel(np.sqrt(x**2 + y**2 + z**2))
    return w[x > 0].sum() / w.sum()


def plane_panel(axes):
    s = np.linspace(0.1, 2.0, 77)
    points = np.stack([0 * s, 0 * s, s], axis=1)
    axes.plot(s, [half_space(at) for at in s], color=ORANGE, label="integral over the half space")
    axes.plot(
        s,
        share(substep.Collider(substep.Plane()), points),
        color=BLUE,
        label="mirror: what is used",
    )
    axes.plot(0.5, lattice(), "o", color=RED, label="sum over the lattice, goes on")
    axes.set(xlabel="distance from a plane wall / spacing", ylabel="share of the rest density")
    axes.legend(frameon=False)


def sampled_ball(radius, step):
    x = np.arange(-radius - 4 * step, radius + 4.5 * step, step)
    values = np.sqrt(x[:, None, None] ** 2 + x[:, None] ** 2 + x**2) - radius
    return substep.Collider(substep.SignedDistanceField(values, step, (x[0],) * 3))


def ball_panel(axes, radius=4.0):
    rng = np.random.default_rng(1)
    s = np.linspace(0.1, 1.0, 31)
    normals = rng.normal(size=(len(s), 8, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    points = ((radius + s)[:, None, None] * normals).reshape(-1, 3)
    exact = share(substep.Collider(substep.Sphere(radius)), points)

    def show(values, color, label):
        error = np.abs(values - exact).reshape(len(s), -1).max(1)
        axes.semilogy(s, 100 * error, color=color, label=label)

    flat = share(
        substep.Collider(substep.Plane()), np.repeat(np.stack([0 * s, 0 * s, s], axis=1), 8, axis=0)
    )
    show(flat, ORANGE, "a plane at the nearest point")
    for step, color in ((1.0, RED), (0.5, GREEN), (0.25, BLUE)):
        show(share(sampled_ball(radius, step), points), color, f"map, grid of {step:g} spacings")
    axes.set(
        xlabel="distance from a ball of radius 4 spacings / spacing",
        ylabel="largest error of the density [%]",
        ylim=(1e-2, 20),
    )
    axes.legend(frameon=False)


def main():
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
    plane_panel(left)
    ball_panel(right)
    image = io.BytesIO()
    figure.savefig(image, dpi=110)
    Image.open(image).convert("P", palette=Image.Palette.ADAPTIVE).save(
        FOLDER / "walls.png", optimize=True
    )


if __name__ == "__main__":
    main()
