"""The figure of docs/pbd_collision.md: python docs/figures/pbd_collision.py."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pyvista as pv
import substep
from substep.geometry import grid_mesh
from substep.pbd import Distance, PositionBasedDynamics, SelfCollision

FOLDER = Path(__file__).resolve().parent
N = 48
TIMES = (0.2, 0.4, 1.0)


def cloth(contact):
    """A sheet that stands on its lower edge."""
    mesh = grid_mesh(N, N)
    u, v = mesh.vertices[:, 0], mesh.vertices[:, 1] + 0.5
    x = np.column_stack([u, 0.1 * v + 0.02 * np.sin(7 * v) + 0.02 * u * v, v + 0.02])
    constraints = [Distance(mesh.edges), Distance(mesh.hinges[:, 2:])]
    if contact:
        constraints.append(SelfCollision(mesh.faces, thickness=0.3 / N, friction=0.3))
    floor = substep.Collider(substep.Plane(), friction=0.5)
    return PositionBasedDynamics(x, 0.3 / N**2, constraints, colliders=[floor]), mesh


def picture(x, mesh):
    """Rendered, seen from the side."""
    plotter = pv.Plotter(off_screen=True, window_size=(640, 480), lighting="three lights")
    faces = np.column_stack([np.full(len(mesh.faces), 3), mesh.faces]).ravel()
    sheet = pv.PolyData(x, faces)
    front, back = "#5b8fc7", "#e8b04a"
    plotter.add_mesh(
        sheet,
        color=front,
        smooth_shading=True,
        backface_params={"color": back},
        specular=0.2,
    )
    plotter.add_mesh(pv.Plane(i_size=4, j_size=4), color="#f2f0ec")
    plotter.set_background("white")
    plotter.camera_position = [(0.9, -1.6, 0.75), (0.0, 0.05, 0.22), (0, 0, 1)]
    plotter.enable_anti_aliasing("ssaa")
    image = plotter.screenshot(return_img=True)
    plotter.close()
    return image


def main():
    figure, axes = plt.subplots(2, len(TIMES), figsize=(9.6, 5.2))
    for row, contact in zip(axes, (False, True), strict=True):
        sim, mesh = cloth(contact)
        for ax, time in zip(row, TIMES, strict=True):
            sim.advance(time - sim.time)
            ax.imshow(picture(sim.positions, mesh))
            ax.axis("off")
            if not contact:
                ax.set_title(f"{time:g} s", fontsize=10)
    figure.tight_layout(pad=0.3)
    figure.savefig(FOLDER / "pbd_collision.png", dpi=100)


if __name__ == "__main__":
    main()
