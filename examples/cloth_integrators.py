"""The same cloth by five integrators at one step: which explode, and did their limits say so?"""

from contextlib import suppress

import numpy as np
import substep
from matplotlib.figure import Figure
from substep.render import Camera, Look, View

INTEGRATORS = "euler symplectic_euler velocity_verlet rk4 implicit_euler".split()
n = 20
mesh = substep.geometry.grid_mesh(n, n)
edges, stiffness = substep.springs.grid_springs(n, n, stiffness=300.0)
box = [[-0.5, -0.5, -1.05], [0.5, 0.5, 0.1]]
view = View(Camera(115, 38), {"cloth": Look(edges=True)}, box=lambda recording: box)


def make_cloth(integrator, step):
    return substep.MassSpring(
        mesh.vertices, edges, stiffness, 0.3 / n**2, faces=mesh.faces,
        pinned=[0, n * (n - 1)], integrator=integrator, step=step)  # fmt: skip


step = 1.2 * make_cloth("symplectic_euler", 1.0).step_limit()[0]
figure = Figure(figsize=(15, 3.6), layout="constrained")
for integrator, axes in zip(INTEGRATORS, figure.subplots(1, 5), strict=True):
    cloth, diverges = make_cloth(integrator, step), suppress(substep.NonFiniteError)
    limit, parts = cloth.step_limit()[0], {"cloth": substep.Part("mesh", triangles=mesh.faces)}
    with substep.Recorder(f"{integrator}.vtkhdf", parts=parts, overwrite=True) as log, diverges:
        while cloth.time < 0.45 and np.abs(cloth.positions[:, 0]).max() < 0.6:  # not too wide
            cloth.step()
            log.append(cloth.time, {"cloth": {"points": cloth.positions}})
    verdict = "stands" if cloth.time >= 0.45 else f"explodes from {cloth.time:.3f} s on"
    with substep.Recording(f"{integrator}.vtkhdf") as recording:
        axes.imshow(view.image(recording, -1, (560, 560)))
    axes.axis("off")
    axes.set_title(f"{integrator}\nlimit {1e3 * limit:.2f} ms: {verdict}", fontsize=10)
    print(f"{integrator:<20} step {step:.3g} s, limit {limit:.3g} s: {verdict}")
figure.savefig("cloth.png")
print("cloth.png")
