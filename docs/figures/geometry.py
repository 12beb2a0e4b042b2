"""Draws docs/figures/geometry.png: an open mesh, the solid it becomes and its distance field.

python docs/figures/geometry.py    (needs pyvista and ../shared/data/meshes beside the clone)
"""

from pathlib import Path

import numpy as np
import pyvista
import substep
from PIL import Image

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
UPRIGHT = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # the file has y up


def main():
    """Three views of the teapot, side by side."""
    teapot = substep.geometry.read_mesh(ROOT.parent / "shared/data/meshes/teapot.obj")
    mesh = substep.geometry.TriangleMesh(teapot.vertices @ np.array(UPRIGHT).T, teapot.faces)
    solid = substep.geometry.tetrahedralize(mesh, 0.22)
    field = substep.Collider(substep.SignedDistanceField.from_mesh(mesh, 0.08))

    pyvista.OFF_SCREEN = True
    plotter = pyvista.Plotter(shape=(1, 3), window_size=(1500, 370), border=False)
    plotter.set_background("white")

    plotter.subplot(0, 0)
    surface = pyvista.PolyData.from_regular_faces(mesh.vertices, mesh.faces)
    plotter.add_mesh(surface, color="#c9d6df", smooth_shading=True, split_sharp_edges=True)
    borders = mesh.edges[mesh.edge_uses == 1]
    lines = np.insert(borders, 0, 2, axis=1).ravel()
    plotter.add_mesh(pyvista.PolyData(mesh.vertices, lines=lines), color="#d55e00", line_width=4)
    look_at(plotter, (0.35, -1.0, 0.45))

    plotter.subplot(0, 1)
    centers = solid.vertices[solid.tetrahedra].mean(axis=1)
    behind = solid.tetrahedra[centers[:, 1] > 0]
    cells = {pyvista.CellType.TETRA: behind}
    plotter.add_mesh(
        pyvista.UnstructuredGrid(cells, solid.vertices), color="#7fb3d5", show_edges=True
    )
    look_at(plotter, (0.35, -1.0, 0.45))

    plotter.subplot(0, 2)
    low, high = field.origin, field.origin + field.spacing * (np.array(field.values.shape) - 1)
    x, z = (np.linspace(low[i] - 0.6, high[i] + 0.6, 700) for i in (0, 2))
    grid = pyvista.RectilinearGrid(x, [0.0], z)
    grid["distance"] = field.distance(grid.points)
    plotter.add_mesh(
        grid, cmap="RdBu", clim=(-1.2, 1.2), show_scalar_bar=False, lighting=False, n_colors=24
    )
    plotter.add_mesh(
        grid.contour([0.0], scalars="distance"), color="black", line_width=2, lighting=False
    )
    look_at(plotter, (0.0, -1.0, 0.0))

    image = Image.fromarray(plotter.screenshot(None, return_img=True))
    image.quantize(128, dither=Image.Dither.NONE).save(FOLDER / "geometry.png", optimize=True)


def look_at(plotter, direction):
    """Set a camera without perspective."""
    plotter.enable_parallel_projection()
    plotter.camera_position = [direction, (0, 0, 0), (0, 0, 1)]
    plotter.reset_camera()
    plotter.camera.zoom(1.35)


if __name__ == "__main__":
    main()
