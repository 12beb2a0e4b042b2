"""A snowball hits a wall: what it loses of its energy, and a picture of where it was pressed."""

import numpy as np
import substep
from matplotlib.image import imsave
from substep import mpm
from substep.render import Camera, Look, View

cell, radius = 0.04, 0.2
x, volume = mpm.sample_sphere((0.0, 0.0, 0.3), radius, cell / 2, pattern="poisson")
wall = substep.Collider(substep.Box((0.2, 2.0, 1.0), (0.4, 0.0, 0.5)), friction=0.5)
slab = substep.geometry.box_mesh((0.2, 1.2, 0.7))
slab = substep.geometry.TriangleMesh(slab.vertices + np.array([0.4, 0, 0.35]), slab.faces)
snow = substep.MaterialPointMethod(
    x,
    mpm.Snow(young_modulus=1.4e5, critical_compression=0.02),
    cell=cell,
    volume=volume,
    velocities=np.tile([2.5, 0.0, 0.0], (len(x), 1)),
    colliders=[substep.Collider(substep.Plane(), friction=0.5), wall],
)

fields = {"velocity": "m/s", "plastic_volume_ratio": "1"}
parts = {
    "snow": substep.Part("particles", fields),
    "wall": substep.Part("mesh", triangles=slab.faces, points=slab.vertices),
}
with substep.Recorder("snowball.vtkhdf", parts=parts, overwrite=True) as recorder:
    for k in range(5):
        snow.advance(0.05 * k - snow.time)
        now, energy = snow.fields(), snow.diagnostics()
        frame = {name: now[name][0] for name in fields}
        recorder.append(snow.time, {"snow": {"points": now["position"][0], **frame}})
        kept = [f"{name} {energy[f'{name}_energy']:.1f} J" for name in ("kinetic", "dissipated")]
        print(f"{snow.time:.2f} s: {', '.join(kept)}; {snow.report.steps} steps")
look = {"color": "plastic_volume_ratio", "limits": (0.7, 1.0)}
view = View(Camera(-92.0, 8.0), {"snow": Look(heap=True)}, **look)
with substep.Recording("snowball.vtkhdf") as recording:
    imsave("snowball.png", view.image(recording, frame=-1))
print("snowball.png")
