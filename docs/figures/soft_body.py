"""Draws docs/figures/soft_body.png: python docs/figures/soft_body.py (about a minute)."""

import io
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import substep
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from PIL import Image
from scipy.integrate import solve_bvp

FOLDER = Path(__file__).resolve().parent
LENGTH, HEIGHT, MODULUS = 1.0, 0.05, 1e7
INERTIA = HEIGHT**4 / 12
BLUE, ORANGE, GREEN = "#0072b2", "#d55e00", "#009e73"


def bend(cells, load):
    """A clamped beam under a dead force at its tip, F L^2 / (E I) = load."""
    mesh = substep.geometry.box_tetrahedra((LENGTH, HEIGHT, HEIGHT), (30 * cells, cells, 2))
    x = mesh.vertices
    force = load * MODULUS * INERTIA / LENGTH**2
    body = substep.SoftBody.from_mesh(
        mesh,
        density=1000.0,
        young_modulus=MODULUS,
        poisson_ratio=0.0,
        pinned=x[:, 0] < -0.4999,
        gravity=(0, 0, 0),
        tolerance=1e-5 * force,
    )
    tip = x[:, 0] > 0.4999
    weights = np.where(np.abs(x[tip, 1:]) > 0.49 * HEIGHT, 0.5, 1.0).prod(axis=1)
    for part in (0.25, 0.5, 0.75, 1.0) if load > 0.1 else (1.0,):
        body.forces[tip, 1] = -part * force * weights / weights.sum()
        body.step(1e4)
    return body, (body.positions - x)[tip].mean(axis=0)


def elastica(load):
    """theta'' = load cos(theta), theta(0) = 0, theta'(1) = 0; the curve as x, y."""
    s = np.linspace(0, 1, 200)
    solution = solve_bvp(
        lambda s, y: [y[1], load * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])],
        lambda a, b: [a[0], b[1], a[2], a[3]],
        s,
        [-s, s - 1, s, -(s**2) / 2],
        tol=1e-8,
    )
    return solution.sol(s)[2:]


def draw_solid(ax, body, size):
    """The surface, lit from above."""
    corners = body.positions[body.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-30
    light = 0.55 + 0.45 * (normals @ [0.3, -0.6, 0.74])
    colours = np.clip(light, 0.25, 1)[:, None] * [0.35, 0.75, 0.95]
    ax.add_collection3d(Poly3DCollection(corners, facecolors=colours, linewidths=0))
    centre = body.positions.mean(axis=0)
    ax.set(
        xlim=centre[0] + np.array([-size, size]),
        ylim=centre[1] + np.array([-size, size]),
        zlim=centre[2] + np.array([-size, size]),
    )
    ax.set_axis_off()
    ax.set_box_aspect((1, 1, 1), zoom=1.7)


def main():
    """A scrambled jelly, the elastica, and the errors of three meshes."""
    style = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
    with plt.rc_context(style):
        figure = plt.figure(figsize=(9.6, 5.6), dpi=140)
        cube = substep.geometry.box_tetrahedra((1, 1, 1), (8, 8, 8))
        body = substep.SoftBody.from_mesh(
            cube,
            density=1000.0,
            young_modulus=1e5,
            poisson_ratio=0.3,
            damping_time=0.002,
            gravity=(0, 0, 0),
            tolerance=0.1,
            step=1 / 60,
        )
        body.positions[:] = np.random.default_rng(1).uniform(-0.5, 0.5, cube.vertices.shape)
        for k, frame in enumerate((0, 6, 18, 60)):
            while round(60 * body.time) < frame:
                body.step()
            ax = figure.add_axes((0.25 * k, 0.52, 0.25, 0.44), projection="3d")
            draw_solid(ax, body, 0.9)
            ax.set_title(
                f"t = {body.time:.2f} s" if frame else "scrambled, t = 0", fontsize=9, y=0.98
            )

        ax = figure.add_axes((0.06, 0.09, 0.42, 0.37))
        for load, colour in ((1.0, BLUE), (2.0, GREEN), (5.0, ORANGE)):
            body, _ = bend(12, load)
            x = body.positions[np.abs(body.mesh.vertices[:, 2]) < 1e-9]
            ax.plot(x[:, 0] + 0.5, x[:, 1], ",", color=colour, alpha=0.35)
            ax.plot(*elastica(load), color="black", lw=1)
            ax.annotate(f"F L² / (E I) = {load:g}", elastica(load)[:, -1] + [0.02, -0.03])
        ax.set(aspect="equal", xlim=(0, 1.3), ylim=(-0.8, 0.05), xlabel="x [m]", ylabel="y [m]")
        ax.set_title("vertices of a beam, and the elastica", loc="left", fontsize=9)

        ax = figure.add_axes((0.6, 0.11, 0.37, 0.35))
        cells = np.array([4, 8, 16])
        load = 1e-3
        small = [1 + 3 * bend(n, load)[1][1] / load for n in cells]
        large = [1 + bend(n, 2.0)[1][1] / 0.493457 for n in cells]
        ax.loglog(
            cells, 100 * np.array(small), "o-", color=BLUE, label="small load, F L³ / (3 E I)"
        )
        ax.loglog(cells, 100 * np.array(large), "s-", color=GREEN, label="F L² / (E I) = 2")
        ax.loglog(cells, 200 / cells**2, ":", color="grey", label="second order")
        ax.set_xticks(cells, [str(n) for n in cells])
        ax.set_yticks([0.3, 1, 3, 10], ["0.3", "1", "3", "10"])
        ax.minorticks_off()
        ax.set(xlabel="cells across the height", ylabel="tip too stiff by [%]")
        ax.legend(frameon=False)
        buffer = io.BytesIO()
        figure.savefig(buffer)
    image = Image.open(buffer).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    image.save(FOLDER / "soft_body.png", optimize=True)


if __name__ == "__main__":
    main()
