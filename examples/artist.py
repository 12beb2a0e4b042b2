"""A mesh as cloth, snow and pieces beside water: a film, USD for Blender, a traced picture."""

import importlib.util

import numpy as np
import substep
from substep.render import CameraPath, Look, View, save_movie, save_picture

mesh = substep.geometry.sphere_mesh(0.2, subdivisions=3)
ground = substep.Collider(substep.Plane(), friction=0.5)
bodies = substep.RigidBodies()
bodies.add(substep.Plane(), (0, 0, 0), motion="static", friction=0.6)
for side in np.array(np.meshgrid(*3 * [[-1, 1]])).reshape(3, -1).T:
    corner = mesh.vertices[np.all(mesh.vertices * side >= 0, axis=1)]
    piece = substep.ConvexHull(np.vstack([corner, [0, 0, 0]]))
    bodies.add(piece, np.array([0.9, -0.2, 0.35]) + 0.01 * side, friction=0.6)
strings = substep.pbd.cloth(mesh, rigidity=1e-5)
x, masses = mesh.vertices + np.array([0, -0.2, 0.3]), 0.3 * mesh.vertex_areas
cloth = substep.PositionBasedDynamics(x, masses, strings, colliders=[ground])
x, volume = substep.mpm.sample_mesh(mesh, 0.025)
x, grains = x + np.array([0.45, -0.2, 0.3]), substep.mpm.Snow()
snow = substep.MaterialPointMethod(x, grains, cell=0.05, volume=volume, colliders=[ground])
ends = [((1, 0, 0), (0, 0, 0)), ((0, 1, 0), (0, 0.3, 0)), ((0, -1, 0), (0, 0.9, 0))]
sides = [substep.Plane(normal, point) for normal, point in ends]
x = substep.pbf.fill_box((0, 0.3, 0), (0.4, 0.9, 0.4), 0.04)
water = substep.PositionBasedFluid(x, 0.04, colliders=[ground, *sides])
world = substep.World({"bodies": bodies, "cloth": cloth, "snow": snow, "water": water})
run = substep.scenes.record(world, "artist.vtkhdf", 0.4, overwrite=True)

path = CameraPath([0.0, 0.4], [(-0.4, -2.2, 0.9), (1.4, -2.1, 0.9)], (0.45, 0.2, 0.1))
looks = {"bodies": Look(("#c65d47", "#e3b34c")), "snow": Look("#f4f6fa")}
looks["water"] = Look(liquid=True)
view = View(path, looks, ground=lambda recording: 0.0)
print("film:", save_movie(run, "artist.mp4", view=view, size=(480, 270)))
print("for Blender:", *substep.export.save(run, "artist.usdc", liquids={"water": 0.02}))
engine = "cycles" if importlib.util.find_spec("bpy") else "vtk"
save_picture(run, "traced.png", view=view, size=(320, 180), engine=engine, samples=16)
print("picture: traced.png")
