"""The force of a dam break on a pillar over time: a plot and a table."""

import numpy as np
import substep

# It reaches below the floor, and its sides are off the faces of the cells, also of half the size:
# on faces they would be pushed sideways (docs/grid_liquid.md).
pillar = substep.Collider(substep.Box((0.1, 0.1, 0.8), (0.94, 0.3, 0.35)))
tank = ((0, 0, 0), (1.6, 0.6, 0.8))
column = substep.fill_box((0, 0, 0), (0.4, 0.6, 0.3), 0.02)
water = substep.GridLiquid(column, cell=0.04, bounds=tank, colliders=[pillar], step=5e-3)
log = substep.Logger(substep.recording.forces({"pillar": pillar}), every=0.01)
water.advance(1.2, log)
log.to_csv("pillar.csv")
log.plot("pillar.png")
k = np.argmax(log["pillar_force"][:, 0])
print(f"{log['pillar_force'][k, 0]:.1f} N at {log.times[k]:.2f} s; wrote pillar.csv, pillar.png")
