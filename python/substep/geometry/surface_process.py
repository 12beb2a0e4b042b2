"""Makes the surface of a liquid by pysplashsurf: `surface_process.py CELL SMOOTHING`.

`liquid_surface` runs it as a program, since pysplashsurf ends its process where memory runs out.
Standard input has the particles, in units of their radius; standard output gets three arrays
(vertices, triangles, normals).
"""

from __future__ import annotations

import os
import sys
from typing import Any

# Of the kernel, as multiples of the radius: its support is twice that, so two spacings. The
# docstring of reconstruct_surface calls its lengths absolute; they are multiples all the same.
SMOOTHING_LENGTH = 2.0
THRESHOLD = 0.6  # of the indicator that is 1 inside and 0 outside
NORMAL_SMOOTHING = 3  # passes over the normals; drops of one particle would lose theirs by many


def main(cell: str, smoothing: str) -> None:
    """Read, reconstruct, write."""
    import numpy as np
    import pysplashsurf

    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(2, 1)
        found: Any = pysplashsurf.reconstruction_pipeline(
            np.load(sys.stdin.buffer, allow_pickle=False),
            particle_radius=1.0,
            smoothing_length=SMOOTHING_LENGTH,
            cube_size=float(cell),
            iso_surface_threshold=THRESHOLD,
            mesh_cleanup=True,
            mesh_smoothing_iters=int(smoothing),
            mesh_smoothing_weights=True,
            compute_normals=True,
            normals_smoothing_iters=NORMAL_SMOOTHING,
        )[0]
        np.save(answer, np.asarray(found.mesh.vertices))
        np.save(answer, np.asarray(found.mesh.triangles).astype(np.int64))
        np.save(answer, np.asarray(found.point_attributes["normals"], np.float32))


if __name__ == "__main__":
    main(*sys.argv[1:])
