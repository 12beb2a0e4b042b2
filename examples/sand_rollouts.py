"""Training data for a learned simulator: blocks of sand are thrown into a box, each run otherwise.

substep sweep sand_rollouts.py --repeats 200 --to gns --bounds=0,0,1,1 makes the whole data set.
"""

import json
from pathlib import Path

import numpy as np
import substep
from substep.scenes import Parameter, Scene


def build(parameters, seed):
    random = np.random.default_rng(seed)
    spacing = parameters["spacing"]
    low = random.uniform((0.05, 0.05), (0.55, 0.45))
    positions = substep.fill_box(low, low + random.uniform(0.2, 0.4, 2), spacing)
    walls = [((1, 0, 0), 0), ((0, 1, 0), 0), ((-1, 0, 0), 1), ((0, -1, 0), 1)]
    return substep.MaterialPointMethod(
        positions,
        substep.mpm.Sand(density=1600.0, young_modulus=1e5, friction_angle=np.radians(35)),
        cell=2 * spacing,
        volume=spacing**2,
        velocities=np.tile(random.uniform(-2, 2, 2), (len(positions), 1)),
        colliders=[substep.Collider(substep.Plane(n, (x, x, 0)), friction=0.5) for n, x in walls],
    )


duration = Parameter("time simulated", 1.0, unit="s", above=0)
spacing = Parameter("distance between particles", 0.02, unit="m", above=0)
parameters = {"duration": duration, "spacing": spacing}
SCENE = Scene("sand-rollouts", "A block of sand thrown into a box.", parameters, build, frames=41)

if __name__ == "__main__":
    runs = substep.sweep(__file__, {"duration": 0.2}, "rollouts", repeats=5, frames=9)
    folder = substep.sweeps.write_gns(runs, Path("rollouts/gns"), bounds=[[0, 0], [1, 1]])
    print(runs, json.loads((folder / "metadata.json").read_text())["vel_std"])
