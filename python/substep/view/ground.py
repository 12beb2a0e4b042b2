"""The ground of a picture: a disc that fades into the background, and a soft shadow on it.

The shadow is a picture of its own: all parts in black, flattened onto the ground along the light,
seen from above, and blurred. Hills are ground too: the shadow of the other parts is laid on them.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

COLOR = np.array([0.86, 0.875, 0.89])
PIXELS = 256  # of the shadow, each way
DARKNESS = 0.42  # of the shadow
BLUR = ((0.6, 3.0), (0.4, 12.0))  # weight and width [pixels] of the Gaussians that soften it
SLOPE = np.array([0.45, 0.30])  # where the shadow of a point lies, for each metre above the ground


class Ground:
    """What lies below the parts.

    Parameters
    ----------
    pyvista : module
        PyVista.
    plotter : pyvista.Plotter
        Drawn into.
    box : ndarray, shape (2, 3)
        Lowest and highest corner of what casts the shadow [m].
    height : float
        Of the ground [m].
    bodies : iterable
        What casts it.
    color : ndarray, shape (3,)
        Of the ground.
    """

    def __init__(
        self,
        pyvista: Any,
        plotter: Any,
        box: NDArray[Any],
        height: float,
        bodies: Iterable[Any],
        color: NDArray[Any] = COLOR,
    ) -> None:
        reach = np.array([np.zeros(2), SLOPE * max(box[1, 2] - height, 0.0)])
        low, high = box[0, :2] + reach.min(axis=0), box[1, :2] + reach.max(axis=0)
        center = (low + high) / 2
        half = 0.65 * float(np.max(high - low)) + 1e-9
        radius = max(4 * half, 3 * float(np.linalg.norm(box[1] - box[0])))
        self._shadow = pyvista.Texture(np.zeros((PIXELS, PIXELS, 4), np.uint8))
        for z, side, texture in (
            (height - 1e-3 * half, 2 * radius, _fading_disc(pyvista, color)),
            (height - 5e-4 * half, 2 * half, self._shadow),
        ):
            plane = pyvista.Plane(
                center=(*center, z), i_size=side, j_size=side, i_resolution=1, j_resolution=1
            )
            plotter.add_mesh(plane, texture=texture, lighting=False, reset_camera=False)
        self._from_above = pyvista.Plotter(off_screen=True, window_size=(PIXELS, PIXELS))
        self._from_above.set_background("white")
        flatten = np.eye(4)  # takes every point to its shadow
        flatten[:2, 2] = SLOPE
        flatten[:2, 3] = -height * SLOPE
        flatten[2] = (0, 0, 0, height)
        # From points to the image of the shadow, from 0 to 1.
        onto = flatten[:2] / (2 * half)
        onto[:, 3] += 0.5 - center / (2 * half)
        self._on_hills = pyvista.Texture(np.full((PIXELS, PIXELS, 3), 255, np.uint8))
        self._on_hills.repeat = False
        self._hills: list[Any] = []
        for body in bodies:
            actor = body.add_shadow_to(self._from_above, flatten, 2 * half / PIXELS)
            if body.is_hill:
                body.take_shadow(self._on_hills, onto)
                self._hills.append(actor)
        camera = self._from_above.camera
        camera.parallel_projection = True
        camera.focal_point = (*center, height)
        camera.position = (*center, height + 10 * half)
        camera.up = (0, 1, 0)
        camera.parallel_scale = half
        camera.clipping_range = (half, 100 * half)
        k2 = np.fft.fftfreq(PIXELS)[:, None] ** 2 + np.fft.rfftfreq(PIXELS) ** 2
        across = np.minimum(1, 8 * (1 - np.abs(np.linspace(-1, 1, PIXELS))))
        self._fading = across[:, None] * across  # what flies out of the picture has no edge
        self._blur = sum(weight * np.exp(-2 * (np.pi * sigma) ** 2 * k2) for weight, sigma in BLUR)

    def cast_shadow(self) -> None:
        """Draw the shadow of what is there now."""
        image = self._shadow.to_image()
        image.active_scalars[:, 3] = 255 * self._darkness()
        image.Modified()
        self._shadow.Modified()
        if self._hills:
            for hill in self._hills:
                hill.visibility = False
            image = self._on_hills.to_image()
            image.active_scalars[:] = 255 * (1 - self._darkness())[:, None]
            image.Modified()
            self._on_hills.Modified()
            for hill in self._hills:
                hill.visibility = True

    def _darkness(self) -> NDArray[np.float64]:
        """Of the shadow, from 0 to 1; rows begin at the bottom, as those of images."""
        self._from_above.render()
        dark = 1 - self._from_above.screenshot(None, return_img=True)[..., 0] / 255.0
        soft = self._fading * np.fft.irfft2(np.fft.rfft2(dark) * self._blur, dark.shape)
        darkness: NDArray[np.float64] = np.clip(DARKNESS * soft[::-1].ravel(), 0, 1)
        return darkness

    def __del__(self) -> None:
        with contextlib.suppress(Exception):  # not made, or the interpreter ends
            self._from_above.close()


def _fading_disc(pyvista: Any, color: NDArray[Any]) -> Any:
    x = np.linspace(-1, 1, 512)
    pixels = np.full((512, 512, 4), 255 * np.append(color, 0))
    pixels[..., 3] = 255 * np.clip(1.1 * (1 - np.hypot(x[:, None], x)), 0, 1) ** 1.5
    return pyvista.Texture(pixels.astype(np.uint8))
