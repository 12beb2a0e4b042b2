"""Liquids in a picture: clear, with reflections, and seen through what is not in front of them.

Every liquid is composed into the finished image of all that is solid, pixel by pixel. Two more
images say how: one of what its surface reflects and where it points, with the solid parts cut out
of it, and the distances to its front and its back. Behind a point of the surface lies

    (1 - F) (T B + (1 - T) S) + R,    T = exp(-s thickness), s = (1.2 - color) / CLARITY

(Beer and Lambert): B is the image of the solids, displaced by refraction, S the light that the
liquid scatters, F the reflectance of water by Schlick (1994), eq. (15), and R what is reflected of
a bright sky, the ground, and the key light. The thickness is that of the first layer.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import SolverError
from ..geometry import liquid_surface, sphere_mesh
from .surfaces import in_space

REFLECTANCE = 0.02  # of water, seen along the normal
GRAZING = 0.6  # and across it, where it is 1, but the rims of drops would be white lines
CLARITY = 0.07  # depth into which light gets, over the diagonal of what is shown
REFRACTION = 0.25  # of the thickness, by which what is behind is displaced, for a normal across
SHADOW = 0.45  # brightness of a shadow before it is softened; 0 is that of solids

SKY = (0.92, 0.97, 1.0)  # colour of what is reflected

# Reflected light, and the normal across the view, both as colours. up, key: in the axes of it.
SURFACE = """
vec3 n = normalize(normalVCVSOutput);
vec3 v = normalize(vertexVC.xyz);
vec3 r = reflect(v, n);
float F = {reflectance} + ({grazing} - {reflectance}) * pow(1.0 - clamp(-dot(n, v), 0.0, 1.0), 5.0);
float height = dot(r, vec3{up});
float sky = mix(0.66, 1.0, smoothstep(-0.45, 0.25, height));
float toKey = max(dot(r, vec3{key}), 0.0);
float light = F * sky + 0.75 * pow(toKey, 220.0) + 0.10 * pow(toKey, 18.0);
fragOutput0 = vec4(min(light, 1.0), 0.5 + 0.5 * n.x, 0.5 + 0.5 * n.y, 1.0);
"""
CUT_OUT = "fragOutput0 = vec4(0.0, 0.0, 0.0, 1e-3);\n"  # nothing, but what VTK draws


class LiquidBody:
    """The surface of one part of particles.

    Parameters
    ----------
    pyvista : module
        PyVista.
    color : str
        Of the light that the liquid scatters.
    radius : float
        Half the distance of its particles [m].
    """

    def __init__(self, pyvista: Any, color: str, radius: float) -> None:
        from matplotlib.colors import to_rgb

        self.color, self.radius = np.array(to_rgb(color)), radius
        self.points = np.zeros((0, 3), np.float32)
        self._pyvista = pyvista
        point = np.zeros((3, 3), np.float32)  # PyVista takes no empty ones
        self.data = self._poly_data(point, np.arange(3)[None], point)

    def update(self, arrays: Mapping[str, Any]) -> None:
        """Take the points of a frame."""
        self.points = in_space(arrays["points"])
        self.data.copy_from(self._poly_data(*surface_or_balls(self.points, self.radius)))

    def _poly_data(
        self, points: NDArray[np.float32], faces: NDArray[np.int64], normals: NDArray[np.float32]
    ) -> Any:
        if not len(points):
            return self._pyvista.PolyData()
        data = self._pyvista.PolyData.from_regular_faces(points, faces)
        data.point_data.set_array(normals, "Normals")
        data.point_data.active_normals_name = "Normals"
        return data

    is_hill = False  # on which shadows fall

    def add_shadow_to(self, plotter: Any, flatten: NDArray[np.float64], pixel: float) -> Any:
        """Put it, grey and flattened, before the camera that sees the shadow; returns the actor."""
        actor = plotter.add_mesh(self.data, color=(SHADOW,) * 3, lighting=False, reset_camera=False)
        actor.user_matrix = flatten
        return actor


def surface_or_balls(
    points: NDArray[Any], radius: float
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.float32]]:
    """Vertices, faces and normals of a liquid; where they cannot be made, a ball per particle."""
    try:
        surface = liquid_surface(points, radius)
        return surface.vertices.astype(np.float32), surface.faces, surface.normals
    except SolverError as error:
        warnings.warn(f"a liquid is drawn as particles: {error}", RuntimeWarning, stacklevel=2)
    ball = sphere_mesh(1.0, subdivisions=0)
    count, size = len(points), len(ball.vertices)
    vertices = (points[:, None] + radius * ball.vertices).reshape(-1, 3).astype(np.float32)
    faces = (size * np.arange(count)[:, None, None] + ball.faces).reshape(-1, 3)
    return vertices, faces, np.tile(ball.vertices, (count, 1)).astype(np.float32)


class LiquidLayer:
    """One liquid in front of the solids, behind the same camera.

    Parameters
    ----------
    pyvista : module
        PyVista.
    plotter : pyvista.Plotter
        The picture of the solids.
    liquid : LiquidBody
        The liquid.
    solids : iterable
        What hides it, or is hidden.
    axes : ndarray, shape (3, 3)
        Of the camera.
    key : ndarray, shape (3,)
        Direction to the key light.
    diagonal : float
        Of the region shown [m].
    """

    def __init__(
        self,
        pyvista: Any,
        plotter: Any,
        liquid: LiquidBody,
        solids: Any,
        axes: NDArray[np.float64],
        key: NDArray[np.float64],
        diagonal: float,
    ) -> None:
        self._liquid = liquid
        self._light = key / np.linalg.norm(key)
        self._clarity = CLARITY * diagonal
        # Pixels that a metre takes at a distance of 1 m.
        angle = np.radians(plotter.camera.view_angle)
        self._focal = plotter.window_size[1] / (2 * np.tan(angle / 2))
        self._plotter = pyvista.Plotter(
            off_screen=True, window_size=plotter.window_size, lighting="none"
        )
        self._plotter.set_background("black")
        self._plotter.add_light(pyvista.Light(light_type="headlight"))  # else there are no normals
        self._plotter.camera = plotter.camera
        self._hiding = []
        for body in solids:
            actor = body.add_to(self._plotter)
            _shade(actor, CUT_OUT)
            self._hiding.append(actor)
        self._actor = self._plotter.add_mesh(
            liquid.data, interpolation="Phong", reset_camera=False, color="white"
        )
        self.turn(axes)
        self._plotter.enable_anti_aliasing("msaa", multi_samples=8)
        self._plotter.screenshot(None, return_img=True)  # from now on it renders when asked to

    def turn(self, axes: NDArray[np.float64]) -> None:
        """Take the axes of the camera, to which the shader is written."""
        self._axes, self._key = axes, axes @ self._light
        text = SURFACE.format(
            reflectance=REFLECTANCE,
            grazing=GRAZING,
            up=tuple(map(float, axes[:, 2])),
            key=tuple(map(float, self._key)),
        )
        self._actor.GetShaderProperty().ClearAllFragmentShaderReplacements()
        _shade(self._actor, text)

    def paint(
        self,
        image: NDArray[np.uint8],
        behind: NDArray[np.float32],
        seen: tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.uint8]],
        where: NDArray[np.bool_],
    ) -> NDArray[np.uint8]:
        """Put the liquid, as `look` saw it, into an image of what is behind, at some pixels."""
        front, depth, buffer = seen
        rows, columns = np.nonzero(where & (buffer[..., 3] > 0) & np.isfinite(front))
        coverage = buffer[rows, columns, 3:] / 255.0
        reflected, nx, ny = (buffer[rows, columns, :3] / (255.0 * coverage)).T
        nx, ny = 2 * nx - 1, 2 * ny - 1
        nz = np.sqrt(np.clip(1 - nx**2 - ny**2, 0, 1))
        x = (columns + 0.5 - 0.5 * image.shape[1]) / self._focal  # of the ray, with z = -1
        y = (0.5 * image.shape[0] - rows - 0.5) / self._focal
        facing = np.clip((nz - nx * x - ny * y) / np.sqrt(x**2 + y**2 + 1), 0, 1)
        mirror = REFLECTANCE + (GRAZING - REFLECTANCE) * (1 - facing) ** 5
        front, depth = front[rows, columns], depth[rows, columns]
        shift = REFRACTION * np.minimum(depth, 2 * self._clarity) * self._focal / front
        background = _sample(image, behind, front, rows, columns, shift * ny, -shift * nx)
        lit = 0.62 + 0.38 * np.clip(nx * self._key[0] + ny * self._key[1] + nz * self._key[2], 0, 1)
        through = np.exp(-np.outer(depth / self._clarity, 1.2 - self._liquid.color))
        body = background * through + 255 * self._liquid.color * lit[:, None] * (1 - through)
        shine = 255 * np.outer(reflected, SKY)
        color = np.clip((1 - mirror[:, None]) * body + shine, 0, 255)
        result = image.copy()
        old = image[rows, columns]
        result[rows, columns] = np.rint(old + coverage * (color - old)).astype(np.uint8)
        return result

    def look(
        self, behind: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.uint8]]:
        """Distance to the front, depth of the liquid, and the image of what is reflected.

        `behind` are the distances to the solids.
        """
        plotter, property_ = self._plotter, self._actor.prop
        property_.culling = "front"
        for actor in self._hiding:
            actor.visibility = False
        plotter.render()
        back = distances(plotter)
        property_.culling = "none"
        for actor in self._hiding:
            actor.visibility = True
        plotter.render()
        buffer = plotter.screenshot(None, return_img=True, transparent_background=True)
        front = _to_the_border(distances(plotter))
        with np.errstate(invalid="ignore"):
            first = np.minimum(np.where(np.isfinite(back), back, front), behind) - front
        return front, np.fmax(first, self._depth(behind)), buffer

    def _depth(self, behind: NDArray[np.float32]) -> NDArray[np.float64]:
        """Volume of the particles before the solids, over the area of the pixels they are seen in.

        A particle is spread over several pixels, as wide as it is.
        """
        camera, shape = self._plotter.camera, behind.shape
        away = (self._liquid.points - np.asarray(camera.position)) @ self._axes.T
        distance = np.maximum(-away[:, 2], 1e-9)
        place = away[:, :2] * (self._focal / distance)[:, None] + 0.5 * np.array(shape[::-1])
        column, row = place[:, 0].astype(int), (shape[0] - place[:, 1]).astype(int)
        seen = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
        row, column, distance = row[seen], column[seen], distance[seen]
        visible = behind[row, column] > distance
        row, column, distance = row[visible], column[visible], distance[visible]
        if not len(row):
            return np.zeros(shape)
        volume = (2 * self._liquid.radius) ** 3 * (self._focal / distance) ** 2
        sums = np.bincount(row * shape[1] + column, volume, shape[0] * shape[1]).reshape(shape)
        width = self._liquid.radius * self._focal / float(np.median(distance))
        k2 = np.fft.fftfreq(shape[0])[:, None] ** 2 + np.fft.rfftfreq(shape[1]) ** 2
        blur = np.exp(-2 * (np.pi * width) ** 2 * k2)
        spread: NDArray[np.float64] = np.fft.irfft2(np.fft.rfft2(sums) * blur, shape)
        return spread

    def __del__(self) -> None:
        with contextlib.suppress(Exception):  # not made, or the interpreter ends
            self._plotter.close()


def compose(
    layers: list[LiquidLayer], image: NDArray[np.uint8], behind: NDArray[np.float32]
) -> NDArray[np.uint8]:
    """All liquids before an image of the solids, with the distances to these; far ones first."""
    seen = [layer.look(behind) for layer in layers]
    order = np.argsort([-front for front, _, _ in seen], axis=0, kind="stable")
    for rank in order:
        for k, layer in enumerate(layers):
            image = layer.paint(image, behind, seen[k], rank == k)
    return image


def distances(plotter: Any) -> NDArray[np.float32]:
    """Along the view, from the camera to what each pixel shows [m]; infinite for nothing."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkFloatArray

    width, height = plotter.window_size
    buffer = vtkFloatArray()
    plotter.render_window.GetZbufferData(0, 0, width - 1, height - 1, buffer)
    z = vtk_to_numpy(buffer).reshape(height, width)[::-1]
    near, far = plotter.camera.clipping_range
    with np.errstate(divide="ignore"):
        distance: NDArray[np.float32] = np.where(
            z < 1, near * far / (far - z * (far - near)), np.inf
        ).astype(np.float32)
    return distance


def _to_the_border(front: NDArray[np.float32]) -> NDArray[np.float32]:
    """Distances also in the pixels at the border, of which the surface covers a part only."""
    wide = np.pad(front, 1, constant_values=np.inf)
    around = [np.roll(wide, shift, axis) for axis in (0, 1) for shift in (-1, 1)]
    near: NDArray[np.float32] = np.minimum.reduce(around)[1:-1, 1:-1]
    return np.where(np.isfinite(front), front, near)


def _shade(actor: Any, code: str) -> None:
    actor.GetShaderProperty().AddFragmentShaderReplacement("//VTK::Light::Impl", True, code, False)


def _sample(
    image: NDArray[np.uint8],
    behind: NDArray[np.float32],
    front: NDArray[np.float32],  # of the pixels
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    down: NDArray[np.float64],
    right: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The image beside the pixels, linearly between its own; in place where that is in front."""
    height, width = behind.shape
    r = np.clip(rows + down, 0, height - 1.001)
    c = np.clip(columns + right, 0, width - 1.001)
    hidden = behind[np.rint(r).astype(int), np.rint(c).astype(int)] < front
    r, c = np.where(hidden, rows, r), np.where(hidden, columns, c)
    i, j = np.minimum(r.astype(int), height - 2), np.minimum(c.astype(int), width - 2)
    a, b = (r - i)[:, None], (c - j)[:, None]
    upper = image[i, j] * (1 - b) + image[i, j + 1] * b
    lower = image[i + 1, j] * (1 - b) + image[i + 1, j + 1] * b
    result: NDArray[np.float64] = upper * (1 - a) + lower * a
    return result
