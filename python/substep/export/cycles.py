"""Path-traced images of recordings, by Cycles, which comes with Blender.

What a view says is told to Blender: the region and the ground, the camera of each frame, lights as
suns of some width, looks as materials. A liquid is a clear surface that absorbs light within.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..recording import Recording
from ..view import View
from ..view.extent import radius_in, range_of
from ..view.ground import COLOR
from ..view.liquid import CLARITY
from ..view.look import CameraPath, Look, camera_axes
from ..view.stage import (
    BACKGROUND,
    DARK,
    DARK_GROUND,
    FIXED,
    PALETTE,
    WATER,
    place_camera,
    usual_lights,
)
from ..view.surfaces import CREASE
from ..view.volume import DEPTH, SMOKE
from .blender import check_blender, run_blender, write_volumes
from .usd import prim_names, write_usd

# Radiance of the sky that lights, where it is seen as 1, and irradiance of lights of strength 1:
# what is white and lies flat is then about 1.
SKY, KEY = 0.5, 2.2
LINES = 0.0025  # radius of lines, over the diagonal of the region
STOPS = 32  # of a ramp of colours, the most that Blender has


def check_traced(recording: Recording, view: View) -> None:
    """Refuse what cannot be traced, and to begin where there is no Blender."""
    check_blender()
    if any(points.shape[1] == 2 for points in _first_points(recording)):
        raise InputError("engine: Cycles makes pictures in three dimensions; the recording has two")
    view.check(recording)


def trace(
    recording: Recording,
    view: View,
    frames: Sequence[int],
    out: Callable[[int], Path],
    size: tuple[int, int],
    samples: int,
    on_frame: Callable[[int], None] | None = None,
) -> None:
    """Images of frames, by their numbers from 0, as PNG in the files that `out` names."""
    check_traced(recording, view)
    box, ground = view.region(recording)
    names = prim_names(recording)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        task: dict[str, Any] = {
            "do": "images",
            "size": list(size),
            "samples": samples,
            "denoise": True,
            "sky": _linear(DARK if view.dark else BACKGROUND),
            "sky_strength": SKY,
            "shots": [_shot(recording, view, box, k, out(k), size) for k in frames],
            "lights": _lights(recording, view, box, size),
            "ground": _ground(view, box, ground),
            "looks": _looks(recording, view, names, box),
            "volumes": _volumes(recording, view, frames, folder),
        }
        if names:
            liquids: dict[str, float] = {}
            radii: dict[str, float] = {}
            for part in names:
                look = view.looks.get(part, Look())
                if not look.hidden:
                    drawn = liquids if _is_liquid(recording, view, part) else radii
                    radius = radius_in(recording, part, look)
                    drawn[part] = radius or LINES * float(np.linalg.norm(box[1] - box[0]))
            [usd] = write_usd(recording, folder / "stage.usdc", liquids, radii, frames)
            task["usd"] = str(usd)
        run_blender(task)
    for k in frames:
        if not out(k).exists():
            raise OSError(f"{out(k)}: Blender wrote no image")
        if on_frame is not None:
            on_frame(k)


def _first_points(recording: Recording) -> list[NDArray[Any]]:
    return [a["points"] for a in recording.frame(0).values() if "points" in a]


def _is_liquid(recording: Recording, view: View, name: str) -> bool:
    colored = view.color is not None and view.color in recording.parts[name].fields
    liquid = view.looks.get(name, Look()).liquid and recording.parts[name].kind == "particles"
    return liquid and not colored


def _linear(color: Any) -> list[float]:
    """Red, green and blue in proportion to light, of what a screen is told (IEC 61966-2-1)."""
    from matplotlib.colors import to_rgb

    c = np.array(to_rgb(color) if isinstance(color, str) else tuple(color))
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    return [float(x) for x in linear]


def _quaternion(axes: NDArray[np.float64]) -> list[float]:
    """Of the frame whose axes are the rows: (w, x, y, z), by Shepperd (1978)."""
    m = axes.T
    squares = np.array(
        [
            1 + m[0, 0] + m[1, 1] + m[2, 2],
            1 + m[0, 0] - m[1, 1] - m[2, 2],
            1 - m[0, 0] + m[1, 1] - m[2, 2],
            1 - m[0, 0] - m[1, 1] + m[2, 2],
        ]
    )
    products = np.array(
        [
            [squares[0], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], squares[1], m[1, 0] + m[0, 1], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[1, 0] + m[0, 1], squares[2], m[2, 1] + m[1, 2]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[2, 1] + m[1, 2], squares[3]],
        ]
    )
    k = int(np.argmax(squares))
    q = products[k] / (2 * np.sqrt(squares[k]))
    return [float(x) for x in q]


def _axes(view: View, position: NDArray[np.float64], target: NDArray[np.float64]) -> Any:
    if isinstance(view.camera, CameraPath):
        return camera_axes(position, target)
    return view.camera.axes()


def _shot(
    recording: Recording,
    view: View,
    box: NDArray[np.float64],
    frame: int,
    out: Path,
    size: tuple[int, int],
) -> dict[str, Any]:
    time = float(recording.times[frame])
    position, target, angle = place_camera(view.camera, box, size, time)
    return {
        "frame": frame,
        "out": str(out.absolute()),
        "position": position.tolist(),
        "rotation": _quaternion(_axes(view, position, target)),
        "angle": float(np.radians(angle)),
    }


def _lights(
    recording: Recording, view: View, box: NDArray[np.float64], size: tuple[int, int]
) -> list[dict[str, Any]]:
    """Suns, whose rays go along the negative z axis of theirs."""
    position, target, _ = place_camera(view.camera, box, size, float(recording.times[0]))
    sources = [(light.direction(), light.strength, light.color) for light in view.lights]
    sources = sources or usual_lights(_axes(view, position, target))
    lights = []
    for direction, strength, color in sources:
        x, y, z = direction / np.linalg.norm(direction)
        turned = [0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x))]
        lights.append({"rotation": turned, "strength": KEY * strength, "color": _linear(color)})
    return lights


def _ground(view: View, box: NDArray[np.float64], height: float | None) -> dict[str, Any] | None:
    if height is None:
        return None
    size = float(np.linalg.norm(box[1] - box[0]))
    x, y = box.mean(axis=0)[:2].tolist()
    color = _linear(DARK_GROUND if view.dark else COLOR)
    # Below what stands on it, so that no two surfaces are in one place.
    return {"center": [x, y, height - 1e-4 * size], "half": 1000 * size, "color": color}


def _looks(
    recording: Recording, view: View, names: dict[str, str], box: NDArray[np.float64]
) -> dict[str, Any]:
    """What the parts look like, by their names in the stage."""
    from matplotlib import colormaps

    looks = {}
    for k, (name, part) in enumerate(recording.parts.items()):
        if name not in names:
            continue
        look = view.looks.get(name, Look())
        liquid = _is_liquid(recording, view, name)
        tone = FIXED if part.points is not None else PALETTE[k % len(PALETTE)]
        field = None
        if view.color is not None and view.color in part.fields:
            values = recording[name].field(view.color, 0)
            ramp = colormaps[view.palette](np.linspace(0, 1, STOPS))[:, :3]
            field = {
                "name": view.color,
                "vector": values.ndim == 2,
                "range": list(view.limits or range_of(recording, view.color)),
                "colors": [_linear(color) for color in ramp],
            }
        looks[names[name]] = {
            "colors": [_linear(c) for c in look.colors(WATER if liquid else tone)],
            "opacity": look.opacity,
            "roughness": look.roughness,
            "metallic": look.metallic,
            "hidden": look.hidden,
            "liquid": liquid,
            "absorption": 0.4 / (CLARITY * float(np.linalg.norm(box[1] - box[0]))),
            "crease": np.pi if liquid else float(np.radians(CREASE)),
            "field": field,
        }
    return looks


def _volumes(
    recording: Recording, view: View, frames: Sequence[int], folder: Path
) -> dict[str, Any]:
    """Smoke, as OpenVDB."""
    volumes: dict[str, Any] = {}
    for name, part in recording.parts.items():
        look = view.looks.get(name, Look())
        field = look.density or ("smoke" if "smoke" in part.fields else None)
        if len(part.cells) != 3 or look.hidden or field is None:
            continue
        if not volumes:
            write_volumes(recording, folder / "smoke.vdb", list(frames))
        shortest = float(part.cell or 1) * min(part.cells)
        volumes[name] = {
            "field": field,
            "color": _linear(look.colors(SMOKE)[0]),
            "density": DEPTH * look.opacity / shortest,
            "files": {str(k): str(folder / f"smoke-{name}-{k:04d}.vdb") for k in frames},
        }
    return volumes
