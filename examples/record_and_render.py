"""Record a run frame by frame, read the recording back, draw its last frame."""

import numpy as np
import substep

start = np.random.default_rng(0).uniform([0, 0], [2, 1], (20_000, 2))
drift = substep.Advection(substep.DoubleGyre(), start, step=0.05)
parts = {"drifters": substep.Part("particles", fields={"start_x": "m"})}

with substep.Recorder("drift.vtkhdf", parts=parts, scene="my double gyre") as recorder:
    for _ in range(21):
        frame = {"points": drift.positions, "start_x": start[:, 0]}
        recorder.append(drift.time, {"drifters": frame})  # safe on disk from here on
        drift.advance(0.5)

with substep.Recording("drift.vtkhdf") as recording:
    print(f"{len(recording)} frames up to t = {recording.times[-1]:.1f} s; ParaView opens the file")
    moved = recording["drifters"].points(-1)[:, :2] - start
    print(f"mean distance from the start {np.hypot(*moved.T).mean():.4f} m")
substep.render.save_picture("drift.vtkhdf", "drift.png")
print("wrote drift.png")
