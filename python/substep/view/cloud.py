"""A grid in space as a cloud of Gaussian blobs, which the browser draws from behind to the front.

Each blob stands for a block of cells. It has the optical depth of the block, and is so wide that a
row of equal blobs is even. What hides what is known to the browser for every blob (Kerbl, Kopanas,
Leimkühler and Drettakis, "3D Gaussian splatting for real-time radiance field rendering", 2023).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

MOST = 1 << 16  # blobs of a grid
WIDTH = 0.6  # standard deviation of a blob, over the side of its block
SEEN = 0.01  # opacity of a pixel below which viser leaves it out, and so the edge of each blob


def blocks(values: Array, most: int = MOST) -> tuple[Array, int]:
    """Means over cubes of cells, the smallest of which there are at most so many.

    Parameters
    ----------
    values : ndarray, shape (nx, ny, nz)
        Of the cells. What is no number counts as 0, and so does what is beyond the last cells.
    most : int
        Number of blocks.

    Returns
    -------
    means : ndarray of float32
        One for each block.
    side : int
        Of a block, in cells.
    """
    cells, side = np.array(values.shape), 1
    while np.prod(-(-cells // side)) > most:
        side += 1
    counts = -(-cells // side)
    known = np.nan_to_num(np.asarray(values, np.float32), posinf=0, neginf=0)
    padded = np.pad(known, [(0, n * side - c) for n, c in zip(counts, cells, strict=True)])
    split = padded.reshape(*np.stack([counts, np.full(3, side)], axis=1).ravel())
    return split.mean(axis=(1, 3, 5)), side


def opacities(depth: Array) -> NDArray[np.uint8]:
    """Of the middles of blobs, 255 for opaque, by the optical depth of a block along its side.

    A normal distribution of standard deviation s has 1 / (2 pi s^2) at its middle. Of a blob whose
    middle has the opacity a, small, viser draws the part (a - SEEN) / a, so that SEEN is added.
    """
    middle = -np.expm1(-depth / (2 * np.pi * WIDTH**2))
    steps = np.where(255 * middle < 0.25, 0, np.rint(255 * np.minimum(middle + SEEN, 1)))
    return steps.astype(np.uint8)


def add_cloud(server: Any, name: str, corners: Array, side: float, rgba: NDArray[np.uint8]) -> Any:
    """Put a cloud into the scene of a viser server.

    Parameters
    ----------
    server : viser.ViserServer
        Whose scene.
    name : str
        Of its node.
    corners : ndarray, shape (2, 3)
        Of the box of the grid [m].
    side : float
        Of a block [m].
    rgba : ndarray of uint8, shape (nx, ny, nz, 4)
        Colours and opacities of the blobs.

    Returns
    -------
    viser.GaussianSplatHandle
        The node.
    """
    # Blobs are in units of a block, since their squared widths are sent as float16.
    return server.scene.add_gaussian_splats(
        name, *_blobs(rgba), scale=float(side), position=corners[0]
    )


def recolor(node: Any, rgba: NDArray[np.uint8]) -> None:
    """Give the blobs of a cloud other colours and opacities, in one message."""
    node.set_gaussians(*_blobs(rgba))


def _blobs(rgba: NDArray[np.uint8]) -> tuple[Array, Array, Array, Array]:
    """Middles, covariances, colours and opacities, a row for each blob."""
    middles = np.moveaxis(np.indices(rgba.shape[:3]), 0, -1).reshape(-1, 3) + 0.5
    wide = np.broadcast_to(WIDTH**2 * np.eye(3), (len(middles), 3, 3))
    tones = rgba.reshape(-1, 4)
    return middles, wide, tones[:, :3], tones[:, 3:]
