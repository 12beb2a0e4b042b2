"""A cloth of position-based dynamics falls on a ball: strain by substeps, and a picture."""

import numpy as np
import substep
from matplotlib.image import imsave
from substep.render import Camera, Look, View

sheet = substep.geometry.grid_mesh(40, 40, (1.6, 1.6))
start = sheet.vertices - [0, 0, -1.05]
ball = substep.geometry.sphere_mesh(0.5, (0, 0, 0.5), 4)
ends = start[sheet.edges]
lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
parts = {
    "cloth": substep.Part("mesh", triangles=sheet.faces),
    "ball": substep.Part("mesh", triangles=ball.faces, points=ball.vertices),
}
for substeps in (5, 20):
    cloth = substep.PositionBasedDynamics(
        start,
        0.2 * sheet.vertex_areas,
        substep.pbd.cloth(sheet, rigidity=1e-4),
        colliders=[
            substep.Collider(substep.Sphere(0.515, (0, 0, 0.5)), friction=0.4),
            substep.Collider(substep.Plane(), friction=0.4),
        ],
        substeps=substeps,
    )
    with substep.Recorder("cloth.vtkhdf", parts=parts, overwrite=True) as recorder:
        for k in range(5):
            cloth.advance(0.2 * k - cloth.time)
            recorder.append(cloth.time, {"cloth": {"points": cloth.positions}})
    ends = cloth.positions[sheet.edges]
    strain = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / lengths - 1
    print(f"{substeps:3} substeps: strain {100 * np.sqrt(np.mean(strain**2)):.2f} % rms")
with substep.Recording("cloth.vtkhdf") as recording:
    view = View(Camera(-60.0, 22.0), {"cloth": Look("#c8553d")})
    imsave("cloth.png", view.image(recording, frame=-1))
print("cloth.png")
