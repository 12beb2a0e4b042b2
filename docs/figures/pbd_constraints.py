"""Draws docs/figures/pbd_constraints.png: this script, under a minute."""

import io
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import substep
from matplotlib.collections import PolyCollection
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from PIL import Image
from substep import pbd

FOLDER = Path(__file__).resolve().parent
BLUE, ORANGE, GREEN, PINK = "#0072b2", "#d55e00", "#009e73", "#cc79a7"


def draw_faces(ax, x, faces, colour, alpha=1.0):
    """Lit triangles."""
    corners = x[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-30
    light = np.clip(0.6 + 0.4 * np.abs(normals @ [0.3, -0.6, 0.74]), 0.3, 1)
    rgb = np.array([int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    ax.add_collection3d(
        Poly3DCollection(corners, facecolors=light[:, None] * rgb, edgecolors="none", alpha=alpha)
    )


def bare(ax, low, high, azimuth=-60, elevation=18, zoom=1.2):
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    ax.set_box_aspect(np.subtract(high, low), zoom=zoom)
    ax.view_init(elevation, azimuth)
    ax.set_axis_off()


def strips(figure, place):
    """Cloth over an edge, by its rigidity."""
    ax = figure.add_axes(place, projection="3d")
    n, width = 40, 10
    for k, (rigidity, colour) in enumerate(((1e-6, BLUE), (3e-4, GREEN), (3e-3, ORANGE))):
        sheet = substep.geometry.grid_mesh(n + 1, width + 1, (0.4, 0.1))
        x = sheet.vertices + np.array([0.2, 0.16 * k, 0])
        sim = substep.PositionBasedDynamics(
            x,
            0.2 * sheet.vertex_areas,
            pbd.cloth(sheet, rigidity=rigidity, bending="dihedral"),
            pinned=x[:, 0] < 0.06,
            substeps=60,
            drag=3.0,
        )
        sim.advance(3.0)
        draw_faces(ax, sim.positions, sheet.faces, colour)
        ax.text(-0.02, 0.16 * k, 0.05, f"{rigidity:g} J", fontsize=7, color=colour)
    bare(ax, (-0.05, -0.05, -0.33), (0.4, 0.42, 0.06), -50)
    figure.text(0.06, 0.96, "cloth by its flexural rigidity", fontsize=9)


def bars(figure, place):
    """Neo-Hookean bars of three moduli."""
    ax = figure.add_axes(place, projection="3d")
    mesh = substep.geometry.box_tetrahedra((0.6, 0.12, 0.12), (15, 3, 3))
    for k, (modulus, colour) in enumerate(((4e4, BLUE), (1e5, GREEN), (4e5, ORANGE))):
        x = mesh.vertices + np.array([0, 0.2 * k, 0])
        sim = substep.PositionBasedDynamics(
            x,
            1000 * mesh.vertex_volumes,
            pbd.soft_body(mesh, young_modulus=modulus, poisson_ratio=0.4),
            pinned=x[:, 0] < -0.299,
            substeps=60,
            drag=4.0,
        )
        sim.advance(3.0)
        draw_faces(ax, sim.positions, mesh.surface_faces, colour)
        ax.text(-0.34, 0.2 * k, 0.1, f"{modulus / 1e3:g} kPa", fontsize=7, color=colour)
    bare(ax, (-0.35, -0.1, -0.55), (0.35, 0.5, 0.1), -50, zoom=1.1)
    figure.text(0.56, 0.96, "tetrahedra by their Young's modulus", fontsize=9)


def nets(figure, place):
    """A hanging net after a second, without and with tethers."""
    ax = figure.add_axes(place)
    sheet = substep.geometry.grid_mesh(41, 41)
    top = np.flatnonzero(sheet.vertices[:, 1] > 0.4999)
    pins = top[[0, -1]]
    tethers = pbd.tethers(sheet.vertices, sheet.edges, pins)
    for k, held in enumerate(([], [tethers])):
        sim = substep.PositionBasedDynamics(
            sheet.vertices,
            0.2 * sheet.vertex_areas,
            [*pbd.cloth(sheet), *held],
            pinned=pins,
            gravity=(0, -9.81, 0),
            substeps=2,
            drag=2.0,
        )
        sim.advance(2.0)
        x = sim.positions[:, :2] + np.array([1.3 * k, 0])
        colour = (PINK, BLUE)[k]
        ax.add_collection(
            PolyCollection(x[sheet.faces], facecolors=colour, edgecolors="white", linewidths=0.15)
        )
        ax.plot(*x[pins].T, "ko", ms=3)
        ax.text(1.3 * k, 0.6, ("edges", "edges and tethers")[k], fontsize=8, ha="center")
    ax.axhline(-0.5, color="grey", lw=0.7, ls=":")
    ax.set(xlim=(-0.6, 1.9), aspect="equal")
    ax.set_ylim(top=0.7)
    ax.set_axis_off()
    figure.text(0.06, 0.46, "tethers, two projections a frame", fontsize=9)


def clusters(figure, place):
    """Shape matching: a scrambled figure that recovers."""
    mesh = substep.geometry.box_tetrahedra((0.3, 0.3, 0.3), (6, 6, 6))
    body = pbd.ShapeMatching(
        pbd.vertex_clusters(mesh.edges, len(mesh.vertices)), rest_positions=mesh.vertices
    )
    x = np.random.default_rng(1).uniform(-0.2, 0.2, mesh.vertices.shape)
    sim = substep.PositionBasedDynamics(
        x, 1000 * mesh.vertex_volumes, [body], gravity=(0, 0, 0), drag=20.0
    )
    left, bottom, width, height = place
    for k, frame in enumerate((0, 4, 60)):
        while round(60 * sim.time) < frame:
            sim.step()
        ax = figure.add_axes((left + k * width / 3, bottom, width / 3, height), projection="3d")
        centre = sim.positions.mean(axis=0)
        draw_faces(ax, sim.positions - centre, mesh.surface_faces, GREEN)
        bare(ax, (-0.22,) * 3, (0.22,) * 3)
        ax.set_title(f"t = {sim.time:.2f} s", fontsize=8, y=-0.06)
    figure.text(
        left + width / 2, bottom + height * 0.97, "clusters, scrambled", fontsize=9, ha="center"
    )


def main():
    with plt.rc_context({"font.size": 8, "figure.dpi": 140}):
        figure = plt.figure(figsize=(8.6, 6.2))
        strips(figure, (0.0, 0.5, 0.5, 0.48))
        bars(figure, (0.5, 0.5, 0.5, 0.48))
        nets(figure, (0.02, 0.02, 0.46, 0.44))
        clusters(figure, (0.5, 0.06, 0.5, 0.36))
        buffer = io.BytesIO()
        figure.savefig(buffer)
    image = Image.open(buffer).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    image.save(FOLDER / "pbd_constraints.png", optimize=True)


if __name__ == "__main__":
    main()
