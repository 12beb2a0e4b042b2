"""Cuts a mesh into convex parts by coacd: `decomposition_process.py CONCAVITY MOST SEED`.

`convex_decomposition` runs it as a program, since coacd prints, cannot be interrupted, and its
threads add up in another order each time. Standard input has vertices and triangles; standard
output gets the points of all hulls, and how many each has.
"""

from __future__ import annotations

import os
import sys


def main(concavity: str, most: str, seed: str) -> None:
    """Read, decompose, write."""
    import coacd
    import numpy as np

    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(2, 1)
        coacd.set_log_level("error")
        vertices, faces = (np.load(sys.stdin.buffer, allow_pickle=False) for _ in range(2))
        parts = coacd.run_coacd(
            coacd.Mesh(vertices, faces),
            threshold=float(concavity),
            max_convex_hull=int(most),
            seed=int(seed),
        )
        points = [np.asarray(part[0], np.float64) for part in parts]
        np.save(answer, np.vstack(points) if points else np.zeros((0, 3)))
        np.save(answer, np.array([len(part) for part in points], np.int64))


if __name__ == "__main__":
    main(*sys.argv[1:])
