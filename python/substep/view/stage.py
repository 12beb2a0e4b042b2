"""Images of recordings in three dimensions, by PyVista (VTK) without a window.

A `Stage` holds what the parts of a recording look like, and moves them from frame to frame. Light
falls on both sides of a surface, from three directions that go with the camera.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.imports import needs
from ..geometry import TetMesh
from ..geometry.topology import equal_rows
from ..recording import Part, Recording
from .egl import window_class
from .extent import posed, radius_in, range_of
from .field_sheet import PALETTES
from .ground import COLOR, Ground
from .heap_light import heap_light
from .liquid import LiquidBody, LiquidLayer, compose, distances
from .look import Camera, CameraPath, Light, Look, camera_axes
from .surfaces import magnitude, split_at_creases, vertex_normals
from .volume import Smoke

PALETTE = ("#c65d47", "#3f7ea6", "#d9a441", "#5d9e6e", "#8a6fb0", "#4fa3a5")
WATER = "#2f86bd"
FIXED = "#b4bac2"  # parts that never move
BACKGROUND = (0.95, 0.96, 0.97)
DARK, DARK_GROUND = (0.062, 0.07, 0.085), np.array([0.105, 0.115, 0.135])
VIEW_ANGLE = np.radians(30.0)  # of the picture's height
FILLING = 0.86  # of the picture by the scene
MATTE = {"ambient": 0.26, "diffuse": 0.85, "specular": 0.12, "specular_power": 12}
NOOK_BIAS = 0.04  # how far, in their reach, a surface is in front of itself
RELIEF = {"points": (0.5, 0.55), "heap": (0.67, 0.37)}  # a heap has its own light and shade
LIT = "lit"  # name of the colours of the particles of a heap
# A particle: a disc that faces the camera, shaded as a ball of so much light and shade.
BALL = """//VTK::Color::Impl
float r2 = dot(offsetVCVSOutput.xy, offsetVCVSOutput.xy);
if (r2 > 1.0) discard;
vec3 ballNormal = vec3(offsetVCVSOutput.xy, sqrt(1.0 - r2));
float ballLight = %g + %g * max(dot(ballNormal, vec3(-0.39, 0.75, 0.53)), 0.0);
ambientColor *= ballLight;
diffuseColor *= ballLight;
"""


def import_pyvista() -> Any:
    """PyVista, or an ImportError that says what to install."""
    told = 'pyvista is missing: pip install "substep[viz]" for pictures in three dimensions'
    with needs("pyvista", told):
        import pyvista
    window_class()
    return pyvista


@contextlib.contextmanager
def _without_window() -> Iterator[None]:
    """VTK would look for an X server first, and complain that there is none."""
    name, before = "VTK_DEFAULT_OPENGL_WINDOW", os.environ.get("VTK_DEFAULT_OPENGL_WINDOW")
    if before is None:
        os.environ[name] = window_class()
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]


@dataclass(frozen=True)
class Coloring:
    """A field that colours parts, matplotlib's name of the colours, and the range of its values."""

    field: str
    palette: str = "viridis"
    range: tuple[float, float] | None = None


def _heat(recording: Recording, part: Part, look: Look) -> Coloring | None:
    """Colours of the temperature of a grid that holds no smoke."""
    name = "temperature"
    if look.density is not None or "smoke" in part.fields or name not in part.fields:
        return None
    return Coloring(name, PALETTES[name], range_of(recording, name))


class Stage:
    """The parts of a recording on a ground, in the light, before a camera.

    Parameters
    ----------
    recording : Recording
        Open.
    size : tuple of int
        Width and height of the images [pixels].
    camera : Camera or CameraPath
        Where from.
    looks : mapping of str to Look
        By part.
    coloring : Coloring or None
        Field that colours the parts which have it; its range that of all frames unless given.
    box : ndarray, shape (2, 3)
        Lowest and highest corner of the region shown [m].
    ground : float or None
        Height of the ground [m], which is drawn if the camera is above it.
    nooks : float or None
        How near surfaces shade each other [m].
    dark : bool
        Whether background and ground are dark.
    lights : sequence of Light
        In place of the usual ones.
    """

    def __init__(
        self,
        recording: Recording,
        size: tuple[int, int],
        camera: Camera | CameraPath,
        looks: Mapping[str, Look],
        coloring: Coloring | None,
        box: NDArray[np.float64],
        ground: float | None,
        nooks: float | None = None,
        dark: bool = False,
        lights: Sequence[Light] = (),
    ) -> None:
        pyvista = import_pyvista()
        self.range = None if coloring is None else coloring.range
        if coloring is not None:
            self.range = self.range or range_of(recording, coloring.field)
            coloring = Coloring(coloring.field, coloring.palette, self.range)
        time = float(recording.times[0])
        self._camera, self._box, self._size = camera, box, size
        position, target, _ = place_camera(camera, box, size, time)
        axes = camera_axes(position, target) if isinstance(camera, CameraPath) else camera.axes()
        sources = [(light.direction(), light.strength, light.color) for light in lights]
        sources = sources or usual_lights(axes)
        lit = [(direction, strength) for direction, strength, _ in sources]
        first = recording.frame(0)
        with _without_window():
            self._plotter = pyvista.Plotter(off_screen=True, window_size=size, lighting="none")
            self._plotter.set_background(DARK if dark else BACKGROUND)
            self._bodies: dict[str, _Body] = {}
            self._liquids: dict[str, LiquidBody] = {}
            self._smokes: dict[str, Smoke] = {}
            for k, (name, part) in enumerate(recording.parts.items()):
                look = looks.get(name, Look())
                if part.cells and not look.hidden:
                    colors = coloring or _heat(recording, part, look)
                    self._smokes[name] = Smoke(pyvista, part, look, lit[0][0], colors)
                    self._smokes[name].add_to(self._plotter)
                elif not look.hidden:
                    tone = FIXED if part.points is not None else PALETTE[k % len(PALETTE)]
                    own = coloring if coloring and coloring.field in part.fields else None
                    radius = radius_in(recording, name, look)
                    if look.liquid and own is None:
                        self._liquids[name] = LiquidBody(pyvista, look.colors(WATER)[0], radius)
                        continue
                    body = _Body(
                        pyvista, part, first[name], look, look.colors(tone), own, radius, lit
                    )
                    body.add_to(self._plotter)
                    self._bodies[name] = body
            self._look_from(time)
            self._ground: Ground | None = None
            if ground is not None and self._plotter.camera.position[2] > ground:
                # What is drawn last has the darker shadow.
                casting = [*self._liquids.values(), *self._bodies.values()]
                earth = DARK_GROUND if dark else COLOR
                self._ground = Ground(pyvista, self._plotter, box, ground, casting, earth)
            self._add_lights(pyvista, sources)
            if nooks is None:
                self._plotter.enable_anti_aliasing("msaa", multi_samples=8)
            else:  # whose passes know no multiple samples
                self._plotter.enable_ssao(radius=nooks, bias=NOOK_BIAS * nooks, kernel_size=64)
                self._plotter.enable_anti_aliasing("ssaa")
            self._layers = [
                LiquidLayer(
                    pyvista,
                    self._plotter,
                    liquid,
                    self._bodies.values(),
                    axes,
                    lit[0][0],
                    float(np.linalg.norm(box[1] - box[0])),
                )
                for liquid in self._liquids.values()
            ]

    def _look_from(self, time: float) -> NDArray[np.float64]:
        """Place the camera where it is at a time; returns the axes of the picture."""
        position, target, angle = place_camera(self._camera, self._box, self._size, time)
        if isinstance(self._camera, CameraPath):
            axes = camera_axes(position, target)
        else:
            axes = self._camera.axes()
        distance = float(np.linalg.norm(position - target))
        view = self._plotter.camera
        view.view_angle = angle
        view.focal_point, view.position, view.up = target, position, axes[1]
        reach = distance + float(np.linalg.norm(self._box[1] - self._box[0]))
        near = 0.02 * distance
        view.clipping_range = (
            near,
            40 * (reach if isinstance(self._camera, CameraPath) else distance),
        )
        return axes

    def _add_lights(self, pyvista: Any, lights: list[Source]) -> None:
        for direction, intensity, color in lights:
            light = pyvista.Light(position=tuple(direction), light_type="scene light")
            light.positional = False
            light.focal_point = (0, 0, 0)
            light.intensity = intensity
            light.diffuse_color = light.specular_color = color
            self._plotter.add_light(light)

    def image(self, recording: Recording, frame: int) -> NDArray[np.uint8]:
        """One frame of the recording as pixels, shape (height, width, 3)."""
        arrays = recording.frame(frame)
        if isinstance(self._camera, CameraPath):
            axes = self._look_from(float(recording.times[frame]))
            for layer in self._layers:
                layer.turn(axes)
        for name, body in self._bodies.items():
            body.update(arrays[name])
        for name, liquid in self._liquids.items():
            liquid.update(arrays[name])
        for name, smoke in self._smokes.items():
            smoke.update(arrays[name])
        with _without_window():
            if self._ground is not None:
                self._ground.cast_shadow()
            self._plotter.render()
            pixels: NDArray[np.uint8] = self._plotter.screenshot(None, return_img=True)
            if self._layers:
                pixels = compose(self._layers, pixels, distances(self._plotter))
        return pixels

    def __del__(self) -> None:
        with contextlib.suppress(Exception):  # not made, or the interpreter ends
            self._plotter.close()


def place_camera(
    camera: Camera | CameraPath, box: NDArray[Any], size: tuple[int, int], time: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Position, target and angle of the picture's height [degrees].

    Without a path, as near as all corners of the box are seen, and these in the middle.
    """
    if isinstance(camera, CameraPath):
        return *camera.at(time), camera.angle
    axes = camera.axes()
    center = box.mean(axis=0)
    tangents = np.tan(VIEW_ANGLE / 2) * np.array([size[0] / size[1], 1.0])
    for _ in range(5):
        corners = np.array(np.meshgrid(*(box - center).T)).reshape(3, -1).T @ axes.T
        needed = (np.abs(corners[:, :2]) / tangents).max(axis=1) / FILLING + corners[:, 2]
        distance = max(needed.max(), 1e-9)
        seen = corners[:, :2] / (distance - corners[:, 2:])
        center = center + 0.5 * distance * (seen.min(axis=0) + seen.max(axis=0)) @ axes[:2]
    return center + distance * camera.distance * axes[2], center, float(np.degrees(VIEW_ANGLE))


Source = tuple[NDArray[np.float64], float, str]  # direction, strength, colour


def usual_lights(axes: NDArray[np.float64]) -> list[Source]:
    """A key light from above on the left, a fill from the right, and one along the view."""
    right, up, back = axes
    z = np.array([0.0, 0.0, 1.0])
    return [
        (0.9 * z - 0.55 * right + 0.45 * back, 0.62, "white"),
        (0.25 * z + 0.9 * right + 0.35 * back, 0.22, "white"),
        (0.2 * up + back, 0.32, "white"),
    ]


class _Body:
    """One part: its data set, and how a frame changes it."""

    def __init__(
        self,
        pyvista: Any,
        part: Part,
        arrays: Mapping[str, Any],
        look: Look,
        tones: tuple[str, ...],
        coloring: Coloring | None,
        radius: float,
        lights: list[tuple[NDArray[np.float64], float]],
    ) -> None:
        self._pyvista, self._look, self._coloring = pyvista, look, coloring
        self._tone, self._part = tones[0], part
        field = self._field = None if coloring is None else coloring.field
        self._lights = lights
        self._fixed = part.points is not None
        self._vertices: NDArray[np.int64] | None = None  # recorded numbers of those shown
        points = posed(part, arrays)
        triangles = _triangles_of(part, points)
        if triangles is not None:
            self.kind = "surface"
            self._vertices, self._faces = split_at_creases(points, triangles)
            self._open = not _is_closed(triangles)
            self.data = pyvista.PolyData.from_regular_faces(points[self._vertices], self._faces)
            self._set_normals()
        elif part.edges is not None:
            self.kind = "lines"
            edges = np.asarray(part.edges)
            rows = np.hstack([np.full((len(edges), 1), 2), edges])
            self.data = pyvista.PolyData(points, lines=rows.ravel())
            if radius > 0 and len(edges):
                self.kind, self._wire, self._radius = "tubes", self.data, radius
                self.data = self._tubes()
        else:
            self.kind = "points"
            # One stands for none until the first update: PyVista refuses empty meshes.
            self.data = pyvista.PolyData(points if len(points) else np.zeros((1, 3), np.float32))
            self._radius = radius
            if look.heap:
                self.kind = "heap"
        self._by_particle = self.kind == "heap" or (self.kind == "points" and field is not None)
        self._by_body = len(tones) > 1 and part.shape_bodies is not None and field is None
        if self._by_body and self._vertices is not None:
            from matplotlib.colors import to_rgb

            colors = np.array([to_rgb(tone) for tone in tones])
            rows = np.asarray(part.shape_bodies)[self._vertices, 0] % len(tones)
            self.data.point_data[LIT] = np.rint(255 * colors[rows]).astype(np.uint8)
        if self._by_particle:  # the mapper of discs does not look colours up again
            self.data.point_data[LIT] = np.zeros((self.data.n_points, 3), np.uint8)
        elif field is not None:
            self.data.point_data[field] = np.zeros(self.data.n_points)

    def _tubes(self) -> Any:
        """Tubes along the lines, which are joined to as few as they can be."""
        return self._wire.strip(join=True).tube(radius=self._radius, n_sides=16)

    def add_to(self, plotter: Any) -> Any:
        """Put it before the camera; returns the actor."""
        options: dict[str, Any] = {"opacity": self._look.opacity, **MATTE, "color": self._tone}
        if self._by_particle or self._by_body:
            options |= {"scalars": LIT, "rgb": True, "color": None}
        elif self._coloring is not None:
            options |= {"scalars": self._field, "clim": self._coloring.range, "color": None}
            options |= {"cmap": self._coloring.palette, "show_scalar_bar": False}
        if self.kind == "surface":
            options |= {"interpolation": "Phong", "show_edges": self._look.edges}
            options |= {"edge_opacity": 0.25, "line_width": 1}
            if self._open and self._field is None and not self._by_body:
                back = self._look.back or _lighter(self._tone)
                options["backface_params"] = {"color": back, "ambient": 0.4, "diffuse": 0.7}
        elif self.kind == "lines":
            options |= {"render_lines_as_tubes": True, "line_width": 4}
        elif self.kind == "tubes":
            options["interpolation"] = "Phong"
        else:
            options |= {"style": "points_gaussian", "emissive": False}
            options["render_points_as_spheres"] = True
        actor = self._actor = plotter.add_mesh(self.data, reset_camera=False, **options)
        if self.kind in RELIEF:
            actor.mapper.scale_factor = self._radius
            actor.mapper.SetSplatShaderCode(BALL % RELIEF[self.kind])
        return actor

    @property
    def is_hill(self) -> bool:
        """Whether it is a fixed surface above the ground of which no part is above another."""
        if not (self._fixed and self.kind == "surface" and self._look.opacity == 1):
            return False
        a, b, c = (np.asarray(self.data.points)[self._faces[:, k]] for k in range(3))
        upwards = np.cross(b - a, c - a)[:, 2]
        return bool(np.all(upwards > 0) or np.all(upwards < 0))

    def take_shadow(self, texture: Any, coordinates: NDArray[np.float64]) -> None:
        """Lay an image on it; `coordinates` is a matrix that takes points into that [0 to 1]."""
        points = np.asarray(self.data.points)
        self.data.active_texture_coordinates = points @ coordinates[:, :3].T + coordinates[:, 3]
        self._actor.texture = texture

    def add_shadow_to(self, plotter: Any, flatten: NDArray[np.float64], pixel: float) -> Any:
        """Put it, black and flattened, before the camera that sees the shadow, a pixel so wide.

        Returns the actor.
        """
        options: dict[str, Any] = {"color": "black", "lighting": False, "reset_camera": False}
        if self.kind == "lines":
            options["line_width"] = 2
        elif self.kind in ("points", "heap"):
            options |= {"style": "points", "point_size": max(2.0, 2 * self._radius / pixel)}
        actor = plotter.add_mesh(self.data, **options)
        actor.mapper.scalar_visibility = False
        actor.user_matrix = flatten
        return actor

    def update(self, arrays: Mapping[str, Any]) -> None:
        """Take the points and the colours of a frame."""
        if self._fixed:
            return
        points = posed(self._part, arrays)
        if self._vertices is not None:
            points = points[self._vertices]
        if self.kind == "tubes":
            self._wire.points = points
            if self._field is not None:
                self._wire.point_data.set_scalars(magnitude(arrays[self._field]), self._field)
            self.data.copy_from(self._tubes())
            return
        if len(points) != self.data.n_points:  # of particles
            self.data.copy_from(self._pyvista.PolyData(points))
        self.data.points = points
        if len(points) == 0:
            return
        if self._vertices is not None:
            self._set_normals()
        if self._by_particle:
            colors = self._colors(arrays, len(points))
            if self.kind == "heap":
                colors = colors * heap_light(points, self._radius, self._lights)[:, None]
            self.data.point_data.set_scalars((255 * np.clip(colors, 0, 1)).astype(np.uint8), LIT)
        elif self._field is not None:
            values = magnitude(arrays[self._field])
            if self._part.shape_bodies is not None:
                values = values[np.asarray(self._part.shape_bodies)[:, 0]]
            shown = values if self._vertices is None else values[self._vertices]
            self.data.point_data.set_scalars(shown, self._field)

    def _colors(self, arrays: Mapping[str, Any], n: int) -> NDArray[np.float32]:
        """Red, green and blue of each point."""
        from matplotlib import colormaps
        from matplotlib.colors import Normalize, to_rgb

        if self._coloring is None or self._coloring.range is None:
            return np.tile(np.array(to_rgb(self._tone), np.float32), (n, 1))
        values = Normalize(*self._coloring.range)(magnitude(arrays[self._coloring.field]))
        return colormaps[self._coloring.palette](values)[:, :3].astype(np.float32)

    def _set_normals(self) -> None:
        normals = vertex_normals(np.asarray(self.data.points), self._faces)
        self.data.point_data.set_array(normals, "Normals")
        self.data.point_data.active_normals_name = "Normals"


def _triangles_of(part: Part, points: NDArray[Any]) -> NDArray[np.int64] | None:
    """Triangles of a part, or of the surface of its tetrahedra."""
    if part.shape_faces is not None:
        return np.asarray(part.shape_faces)
    if part.triangles is not None:
        return np.asarray(part.triangles)
    if part.tetrahedra is not None:
        return TetMesh(points, part.tetrahedra).surface_faces
    return None


def _is_closed(triangles: NDArray[np.int64]) -> bool:
    """Every edge is between two faces, so that no back is seen."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return bool(np.all(equal_rows(sides)[1] == 2))


def _lighter(color: str) -> tuple[float, ...]:
    from matplotlib.colors import to_rgb

    return tuple(0.55 * c + 0.45 for c in to_rgb(color))
