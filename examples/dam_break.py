"""A column of water collapses in a tank: how far its front has come, and a picture of the water."""

import numpy as np
import substep
from matplotlib.image import imsave
from substep.render import Camera, Look, View

spacing, width, height, depth = 0.05, 0.5, 1.0, 0.4
tank = substep.Collider(
    substep.Box((2.0, depth, 10.0), (1.0, 0.2, 5.0)), hollow=True
)  # from (0, 0, 0) on
ball = substep.Collider(substep.Sphere(0.15, (1.35, 0.2, 0.0)))
shape = substep.geometry.sphere_mesh(0.15, (1.35, 0.2, 0.0), 3)
column = substep.fill_box((0, 0, 0), (width, depth, height), spacing)
water = substep.PositionBasedFluid(column, spacing, colliders=[tank, ball])

parts = {
    "water": substep.Part("particles", {"velocity": "m/s", "id": "1"}),
    "ball": substep.Part("mesh", triangles=shape.faces, points=shape.vertices),
}
with substep.Recorder("dam.vtkhdf", parts=parts, overwrite=True) as recorder:
    for k in range(6):
        water.advance(0.1 * k - water.time)
        x, v = water.positions, water.velocities
        recorder.append(water.time, {"water": {"points": x, "velocity": v, "id": water.ids}})
        error = 100 * water.diagnostics()["mean_density_error"]
        front = np.quantile(x[:, 0], 0.99) + spacing / 2
        print(f"{water.time:.1f} s: front at {front:.2f} m, density error {error:.3f} %")
view = View(
    Camera(-60.0, 18.0),
    {"water": Look(liquid=True, radius=spacing / 2), "ball": Look("#d98f4e")},
    box=lambda recording: [[0, 0, 0], [2.0, depth, height]],
)
with substep.Recording("dam.vtkhdf") as recording:
    imsave("dam.png", view.image(recording, frame=-1))
print("dam.png")
