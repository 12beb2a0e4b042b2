"""Recordings as glTF, which browsers and most programs of graphics open, by pygltflib.

A mesh that keeps its topology is a mesh with a morph target for each frame after the first; a
liquid's surface, and particles whose number changes, are a node for each frame, which has its size
in that frame and the size 0 in others. Bodies are nodes that move and turn.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.imports import needs
from ..base.replacing import replace_file
from ..errors import InputError
from ..geometry import TetMesh
from ..recording import Part, Recording
from ..view.liquid import surface_or_balls
from .usd import narrow, prim_names, to_space, widths_of

POINTS, LINES, TRIANGLES = 0, 1, 4
FLOAT, UINT = 5126, 5125
UPRIGHT = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # x, y, z, w: z up in the file is y up in glTF


def write_gltf(
    recording: Recording, out: Path, liquids: Mapping[str, float] | None = None
) -> list[Path]:
    """All parts but grids, in one binary file."""
    with needs("pygltflib", 'pygltflib is missing: pip install "substep[gltf]" to write glTF'):
        import pygltflib

    names = prim_names(recording)
    if not names:
        raise InputError("out: the recording has grids alone, which glTF does not hold; write .vdb")
    file = _File(pygltflib, recording)
    widths = widths_of(recording)
    for name, node in names.items():
        part = recording.parts[name]
        if liquids and name in liquids:
            file.add_sequence(node, TRIANGLES, _surfaces(recording, name, liquids[name]), {})
        elif part.kind == "bodies":
            file.add_bodies(node, name, part)
        else:
            extras = {"width": widths[name]} if name in widths else {}
            file.add_points(node, name, part, extras)
    data = file.bytes()
    replace_file(str(out), lambda target: target.write(data))
    return [out]


def _surfaces(recording: Recording, name: str, radius: float) -> list[tuple[Any, Any]]:
    found = []
    for k in range(len(recording)):
        vertices, faces, _ = surface_or_balls(to_space(recording[name].points(k)), radius)
        found.append((vertices, faces))
    return found


class _File:
    """What is written, piece by piece."""

    def __init__(self, pygltflib: Any, recording: Recording) -> None:
        self._lib, self._recording = pygltflib, recording
        self._blob = bytearray()
        self._gltf = pygltflib.GLTF2()
        self._gltf.asset.generator = "substep"
        self._gltf.scenes = [pygltflib.Scene(nodes=[0])]
        self._gltf.scene = 0
        self._gltf.nodes = [pygltflib.Node(name="recording", rotation=UPRIGHT, children=[])]
        self._animation = pygltflib.Animation(name="recording")
        times = narrow(recording.times - recording.times[0])
        if np.any(times[1:] <= times[:-1]):
            raise InputError(
                "recording: its times are too near to each other for float32, which glTF uses"
            )
        self._times = self._accessor(times, bounds=True) if len(times) > 1 else None

    def bytes(self) -> bytes:
        """The whole file."""
        if self._animation.channels:
            self._gltf.animations = [self._animation]
        self._gltf.buffers = [self._lib.Buffer(byteLength=len(self._blob))]
        self._gltf.set_binary_blob(bytes(self._blob))
        return b"".join(self._gltf.save_to_bytes())

    def add_points(self, node: str, name: str, part: Part, extras: dict[str, Any]) -> None:
        """Particles, or a mesh: the vertices of every frame over one list of faces or edges."""
        fixed = part.points is not None
        count = 1 if fixed else len(self._recording)
        frames = [to_space(self._recording[name].points(k)) for k in range(count)]
        faces = part.triangles
        if part.tetrahedra is not None:
            faces = TetMesh(frames[0], part.tetrahedra).surface_faces
        lists = [(TRIANGLES, faces), (LINES, part.edges)]
        lists = [(mode, rows) for mode, rows in lists if rows is not None] or [(POINTS, None)]
        if len({len(points) for points in frames}) > 1:
            for mode, rows in lists:
                pairs = [(points, rows) for points in frames]
                self.add_sequence(node, mode, pairs, extras)
            return
        if not len(frames[0]):
            return
        base = self._accessor(narrow(frames[0]), bounds=True)
        targets = [
            {"POSITION": self._accessor(narrow(points.astype(float) - frames[0]), bounds=True)}
            for points in frames[1:]
        ]
        mesh = self._lib.Mesh(
            name=node,
            primitives=[self._primitive(mode, base, rows, targets) for mode, rows in lists],
            weights=[0.0] * len(targets),
        )
        at = self._add_node(self._lib.Node(name=node, mesh=self._add_mesh(mesh), extras=extras))
        if targets:
            weights = np.vstack([np.zeros(len(targets)), np.eye(len(targets))])
            self._move(at, "weights", weights.reshape(-1))

    def add_sequence(
        self, node: str, mode: int, frames: list[tuple[Any, Any]], extras: dict[str, Any]
    ) -> None:
        """A node for each frame, of which one is seen at a time."""
        for k, (points, rows) in enumerate(frames):
            if not len(points):
                continue
            base = self._accessor(narrow(points), bounds=True)
            primitive = self._primitive(mode, base, rows, [])
            name = f"{node}-{k:04d}"
            mesh = self._add_mesh(self._lib.Mesh(name=name, primitives=[primitive]))
            at = self._add_node(self._lib.Node(name=name, mesh=mesh, extras=extras))
            seen = np.zeros((len(frames), 3))
            seen[k] = 1
            self._move(at, "scale", seen, "STEP")

    def add_bodies(self, node: str, name: str, part: Part) -> None:
        """A node for each body, with its shape."""
        recording = self._recording[name]
        frames = range(len(self._recording))
        x = [to_space(recording.points(k)) for k in frames]
        q = [recording.field("orientation", k)[:, [1, 2, 3, 0]] for k in frames]
        count = min(len(points) for points in x)
        for body in range(count):
            vertices, faces = part.shape_of(body)
            mesh = None
            if len(faces):
                base = self._accessor(narrow(vertices), bounds=True)
                primitive = self._primitive(TRIANGLES, base, faces, [])
                mesh = self._add_mesh(self._lib.Mesh(name=node, primitives=[primitive]))
            moved = np.array([points[body] for points in x])
            turned = np.array([quaternions[body] for quaternions in q])
            turned[1:] *= np.cumprod(_same_side(turned))[:, None]
            made = self._lib.Node(
                name=f"{node}-body_{body}",
                mesh=mesh,
                translation=moved[0].tolist(),
                rotation=turned[0].tolist(),
            )
            at = self._add_node(made)
            self._move(at, "translation", moved)
            self._move(at, "rotation", turned)

    def _primitive(self, mode: int, base: int, rows: Any, targets: list[Any]) -> Any:
        primitive = self._lib.Primitive(
            attributes=self._lib.Attributes(POSITION=base), mode=mode, targets=targets or None
        )
        if rows is not None:
            indices = np.ascontiguousarray(rows, np.uint32).ravel()
            primitive.indices = self._accessor(indices)
        return primitive

    def _add_mesh(self, mesh: Any) -> int:
        self._gltf.meshes.append(mesh)
        return len(self._gltf.meshes) - 1

    def _add_node(self, node: Any) -> int:
        self._gltf.nodes.append(node)
        self._gltf.nodes[0].children.append(len(self._gltf.nodes) - 1)
        return len(self._gltf.nodes) - 1

    def _move(self, node: int, path: str, values: NDArray[Any], way: str = "LINEAR") -> None:
        """Animate a property of a node; a single frame needs none."""
        if self._times is None:
            return
        output = self._accessor(narrow(values))
        sampler = self._lib.AnimationSampler(input=self._times, output=output, interpolation=way)
        self._animation.samplers.append(sampler)
        target = self._lib.AnimationChannelTarget(node=node, path=path)
        channel = self._lib.AnimationChannel(
            sampler=len(self._animation.samplers) - 1, target=target
        )
        self._animation.channels.append(channel)

    def _accessor(self, array: NDArray[Any], bounds: bool = False) -> int:
        view = self._lib.BufferView(buffer=0, byteOffset=len(self._blob), byteLength=array.nbytes)
        self._blob += array.tobytes()  # of four bytes each, so that the next is aligned
        self._gltf.bufferViews.append(view)
        width = 1 if array.ndim == 1 else array.shape[1]
        accessor = self._lib.Accessor(
            bufferView=len(self._gltf.bufferViews) - 1,
            componentType=FLOAT if array.dtype == np.float32 else UINT,
            count=len(array),
            type={1: "SCALAR", 3: "VEC3", 4: "VEC4"}[width],
        )
        if bounds:
            accessor.min = np.atleast_1d(array.min(axis=0)).astype(float).tolist()
            accessor.max = np.atleast_1d(array.max(axis=0)).astype(float).tolist()
        self._gltf.accessors.append(accessor)
        return len(self._gltf.accessors) - 1


def _same_side(quaternions: NDArray[Any]) -> NDArray[Any]:
    """1 or -1, so that each is turned from the one before by the short way."""
    return np.where(np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0, -1.0, 1.0)
