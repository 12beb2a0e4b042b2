"""Smoke in a picture: a field of a grid that absorbs and scatters light, lit from one side.

How much of the key light comes to a cell is found by going through the grid against the light, a
layer at a time (Kajiya and Von Herzen 1984); what is seen then follows from the colours and
opacities of cells along each ray, by VTK's ray casting.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..recording import Part
from .look import Look

Array = NDArray[np.float32]

SMOKE = "#f4f1ea"  # colour of the light that it scatters
SHADE, KEY = 0.2, 1.1  # light of all directions, and the key light
DEPTH = 14.0  # optical depth of a box's shortest side filled with smoke of 1
FORWARD = 0.2  # part of the key light that goes on where smoke takes it from the view
REACH = 4  # cells over which opacities are given, so that their 256 values are fine enough
SAMPLES = 0.5  # of rays, in cells


class Smoke:
    """One grid: its density as colours and opacities.

    Parameters
    ----------
    pyvista : module
        PyVista.
    part : Part
        The grid, in three dimensions.
    look : Look
        Its colour, and the field of the density; `smoke` or else the first field unless given.
    key : ndarray, shape (3,)
        Direction to the key light.
    coloring : Coloring or None
        A field that is shown in its place, the thicker the greater it is.
    """

    def __init__(
        self,
        pyvista: Any,
        part: Part,
        look: Look,
        key: NDArray[np.float64],
        coloring: Any = None,
    ) -> None:
        from matplotlib.colors import to_rgb

        self.field = look.density or (
            "smoke" if "smoke" in part.fields else next(iter(part.fields))
        )
        known = coloring is not None and coloring.field in part.fields
        self._coloring: Any = coloring if known else None
        if self._coloring:
            self.field = self._coloring.field
        self._cell = float(part.cell or 1.0)
        self._color = np.array(to_rgb(look.colors(SMOKE)[0]), np.float32)
        self._absorption = DEPTH / min(part.cells) * look.opacity
        self._key = np.asarray(key, float) / np.linalg.norm(key)
        low = np.asarray(part.bounds)[0] + 0.5 * self._cell
        self._cells = part.cells
        self.data = pyvista.ImageData(
            dimensions=part.cells, spacing=3 * (self._cell,), origin=tuple(low)
        )
        self.data.point_data["rgba"] = np.zeros((self.data.n_points, 4), np.uint8)
        self.data.point_data.active_scalars_name = "rgba"

    def add_to(self, plotter: Any) -> None:
        """Put it before the camera."""
        from vtkmodules.vtkCommonDataModel import vtkPiecewiseFunction
        from vtkmodules.vtkRenderingCore import vtkVolume, vtkVolumeProperty
        from vtkmodules.vtkRenderingVolumeOpenGL2 import vtkOpenGLGPUVolumeRayCastMapper

        mapper = vtkOpenGLGPUVolumeRayCastMapper()
        mapper.SetInputData(self.data)
        mapper.SetAutoAdjustSampleDistances(False)
        mapper.SetSampleDistance(SAMPLES * self._cell)
        mapper.SetUseJittering(True)
        opacity = vtkPiecewiseFunction()
        opacity.AddPoint(0, 0.0)
        opacity.AddPoint(255, 1.0)
        looks = vtkVolumeProperty()
        looks.SetIndependentComponents(False)
        looks.SetInterpolationTypeToLinear()
        looks.SetScalarOpacity(opacity)
        for component in range(4):
            looks.SetScalarOpacityUnitDistance(component, REACH * self._cell)
        looks.SetShade(False)
        volume = vtkVolume()
        volume.SetMapper(mapper)
        volume.SetProperty(looks)
        plotter.renderer.AddVolume(volume)

    def update(self, arrays: Mapping[str, Any]) -> None:
        """Take the density of a frame."""
        values = np.asarray(arrays[self.field], np.float32).reshape(*self._cells, -1)
        density = values[..., 0] if values.shape[-1] == 1 else np.linalg.norm(values, axis=-1)
        rgba = np.empty((*self._cells, 4), np.uint8)
        if self._coloring:
            depth = self._take_colors(density, rgba)
        else:
            depth = self._absorption * np.clip(density, 0, None)  # of a cell, optical
            rgba[..., :3] = lit(depth, self._key, self._color)
        rgba[..., 3] = np.rint(255 * -np.expm1(-REACH * depth))
        pixels = rgba.transpose(2, 1, 0, 3).reshape(-1, 4)
        self.data.point_data["rgba"][:] = pixels
        self.data.GetPointData().GetScalars().Modified()
        self.data.Modified()

    def _take_colors(self, values: Array, rgba: NDArray[np.uint8]) -> Array:
        """Colours of values; optical depths of cells, 0 for the least value in sight."""
        from matplotlib import colormaps

        low, high = self._coloring.range
        part = np.clip((values - low) / (high - low), 0, 1)
        rgba[..., :3] = colormaps[self._coloring.palette](part, bytes=True)[..., :3]
        return (self._absorption * part**2).astype(np.float32)


def lit(depth: Array, key: NDArray[np.float64], color: Array) -> NDArray[np.uint8]:
    """Colours of smoke in the light of all directions and the key light, of its optical depths."""
    light = SHADE + KEY * through((1 - FORWARD) * depth, key)
    return np.rint(255 * np.minimum(light[..., None] * color, 1)).astype(np.uint8)


def through(depth: Array, key: NDArray[np.float64]) -> Array:
    """Part of the light from direction `key` that comes to each cell, of its optical depths."""
    along = int(np.argmax(np.abs(key)))
    layers = np.moveaxis(depth, along, 0)
    if key[along] > 0:
        layers = layers[::-1]
    shift = np.delete(key, along) / abs(key[along])  # towards the light, in cells for each layer
    longer = float(np.sqrt(1 + shift @ shift))
    light = np.empty_like(layers)
    coming = np.ones(layers.shape[1:], np.float32)  # before the layer
    for k, layer in enumerate(layers):
        light[k] = coming * np.exp(-0.5 * longer * layer)
        coming = _moved(coming * np.exp(-longer * layer), shift)
    if key[along] > 0:
        light = light[::-1]
    return np.moveaxis(light, 0, along)


def _moved(plane: Array, shift: NDArray[np.float64]) -> Array:
    """A plane moved against `shift` by less than a cell each way, linear; 1 comes in."""
    for axis, part in enumerate(shift):
        padded = np.pad(plane, [(1, 1) if a == axis else (0, 0) for a in (0, 1)], constant_values=1)
        padded = np.moveaxis(padded, axis, 0)
        ahead = padded[2:] if part > 0 else padded[:-2]
        plane = np.moveaxis((1 - abs(part)) * padded[1:-1] + abs(part) * ahead, 0, axis)
    return plane.astype(np.float32)
