"""Reads a mesh by meshio, within limits: `meshio_process.py FILE BYTES SECONDS`.

`mesh_io` runs it as a program, without the rest of substep. Standard output gets four arrays
(vertices, sizes of the polygons, their corners, tetrahedra), or the reason why there are none.
"""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from typing import Any, BinaryIO

REFUSED = 3  # exit code; the reason is in standard output


def limit(memory: int, seconds: int) -> None:
    """Let the system end this process when it takes more."""
    with contextlib.suppress(ImportError):  # not a POSIX system: no limits
        import resource

        wanted = {resource.RLIMIT_AS: memory, resource.RLIMIT_CPU: seconds, resource.RLIMIT_CORE: 0}
        for what, most in wanted.items():
            hard = resource.getrlimit(what)[1]
            most = most if hard == resource.RLIM_INFINITY else min(most, hard)
            resource.setrlimit(what, (most, hard))


def read(path: str) -> list[Any]:
    """Vertices, sizes of the polygons, their corners, tetrahedra."""
    import meshio
    import numpy as np

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # overflows while it tries what a file may be
        data = meshio.read(path)
    points = np.asarray(data.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise ValueError(f"expected points of 3 coordinates, got shape {points.shape}")
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    kinds = ("triangle", "quad", "polygon")
    sizes, corners, tets = [none := np.empty(0, np.int64)], [none], [none.reshape(0, 4)]
    for block in data.cells:
        if block.type == "tetra":
            tets.append(np.asarray(block.data, np.int64))
        for rows in [block.data] if isinstance(block.data, np.ndarray) else block.data:
            if block.type in kinds:
                polygons = np.atleast_2d(np.asarray(rows, np.int64))
                sizes.append(np.full(len(polygons), polygons.shape[1]))
                corners.append(polygons.ravel())
    return [points, np.concatenate(sizes), np.concatenate(corners), np.concatenate(tets)]


def main(path: str, memory: str, seconds: str) -> int:
    """Read, and write what was read."""
    limit(int(memory), int(seconds))
    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(2, 1)  # meshio prints
        return answer_with(answer, path)


def answer_with(answer: BinaryIO, path: str) -> int:
    """Write the arrays, or why there are none."""
    try:
        arrays = read(path)
    except BaseException as error:  # SystemExit too
        reason = (
            "it gave up" if isinstance(error, SystemExit) else f"{type(error).__name__}: {error}"
        )
        answer.write(reason.encode(errors="replace"))
        return REFUSED
    import numpy as np

    for array in arrays:
        np.save(answer, array, allow_pickle=False)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
