"""Recordings as USD, which Blender, Houdini and others open."""

from __future__ import annotations

import errno
import os
import re
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.imports import needs
from ..errors import InputError
from ..geometry import TetMesh
from ..recording import Part, Recording
from ..view.extent import radius_of
from ..view.liquid import surface_or_balls


def write_usd(
    recording: Recording,
    out: Path,
    liquids: Mapping[str, float] | None = None,
    radii: Mapping[str, float] | None = None,
    only: Sequence[int] | None = None,
) -> list[Path]:
    """One stage of all parts but grids; time code k is frame k.

    Of `liquids`, radii of particles by part, the surface is written in place of the particles;
    `radii` are those of other particles and of edges [m]. Of `only` some frames the rest is left
    out.
    """
    with needs("pxr", 'usd-core is missing: pip install "substep[usd]" to write USD'):
        from pxr import Tf, Usd, UsdGeom

    names = prim_names(recording)
    parts = {name: recording.parts[name] for name in names}
    if not parts:
        raise InputError("out: the recording has grids alone, which USD does not hold; write .npz")
    if out.exists() and not out.is_file():
        raise OSError(errno.EINVAL, "expected a file to replace", str(out))
    partial = out.with_name(f".{secrets.token_hex(8)}{out.suffix}")
    try:
        stage = Usd.Stage.CreateNew(str(partial))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/recording").GetPrim())
        frames = len(recording)
        if frames > 1:
            rate = 1 / max(float(np.diff(recording.times).mean()), 1e-300)
            narrow(rate)
            stage.SetTimeCodesPerSecond(rate)
            stage.SetFramesPerSecond(rate)
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(frames - 1)
        writers: dict[str, Any] = {}
        for name, part in parts.items():
            path = f"/recording/{names[name]}"
            if liquids and name in liquids:
                writers[name] = _Liquid(stage, path, liquids[name])
            else:
                writers[name] = _WRITERS[part.kind](stage, path, part)
                if radii and name in radii and part.kind != "bodies":
                    writers[name].set_width(2 * radii[name])
        first, *_ = wanted = range(frames) if only is None else sorted(only)
        for k in wanted:
            frame = recording.frame(k)
            for name, writer in writers.items():
                if parts[name].points is None or k == first:
                    code = Usd.TimeCode(k) if parts[name].points is None else Usd.TimeCode.Default()
                    writer.frame(code, dict(frame[name]))
        stage.Save()
        del stage, writers
        os.replace(partial, out)
    except Tf.ErrorException as error:
        raise OSError(errno.EIO, f"USD: {str(error).strip()[:500]}", str(out)) from None
    finally:
        partial.unlink(missing_ok=True)
    return [out]


def prim_names(recording: Recording) -> dict[str, str]:
    """Names below the root of all parts but grids."""
    parts = [name for name, part in recording.parts.items() if part.kind != "grid"]
    return dict(zip(parts, _unique([re.sub(r"\W", "_", name) for name in parts]), strict=True))


def widths_of(recording: Recording) -> dict[str, float]:
    """How far apart the particles of each part are in the first frame that has several [m]."""
    widths = {}
    for name, part in recording.parts.items():
        for k in range(len(recording)) if part.kind == "particles" else ():
            points = recording[name].points(k)
            if len(points) > 1:
                worlds = recording[name].field("world", k) if "world" in part.fields else None
                widths[name] = 2 * radius_of(to_space(points), worlds)
                break
    return widths


def to_space(vectors: NDArray[Any]) -> NDArray[Any]:
    """Vectors of three numbers; those of a plane, (x, y), as (x, 0, y)."""
    narrow(vectors)
    return vectors if vectors.shape[1] == 3 else np.insert(vectors, 1, 0, axis=1)


def narrow(values: Any) -> NDArray[np.float32]:
    """In single precision, which USD and glTF hold, where that can hold them."""
    with np.errstate(over="ignore"):
        narrowed = np.ascontiguousarray(values, np.float32)
    lost = np.isinf(narrowed) & np.isfinite(values)
    if lost.any():
        which = np.atleast_1d(values)[np.atleast_1d(lost)][0]
        raise InputError(f"recording: {which} is beyond float32, which USD and glTF hold")
    return narrowed


def _is_vector(values: NDArray[Any] | None) -> bool:
    return values is not None and values.ndim == 2 and values.shape[1] in (2, 3)


def _unique(names: list[str]) -> list[str]:
    """With numbers after those that stand before."""
    found: list[str] = []
    for name in names:
        copies = sum(other == name or other.startswith(f"{name}__") for other in found)
        found.append(f"{name}__{copies}" if copies else name)
    return found


def _vectors(values: NDArray[Any]) -> Any:
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(narrow(to_space(values)))


class _Points:
    """Particles, with their fields as primvars."""

    def __init__(self, stage: Any, path: str, part: Part) -> None:
        from pxr import UsdGeom

        self._points = UsdGeom.Points.Define(stage, path)
        self._width: float | None = None

    def set_width(self, width: float) -> None:
        """Of all of them, in all frames."""
        from pxr import Vt

        self._width = width
        self._points.GetWidthsAttr().Set(Vt.FloatArray([width]))
        self._points.SetWidthsInterpolation("constant")

    def frame(self, code: Any, columns: dict[str, NDArray[Any]]) -> None:
        """Write one."""
        from pxr import Vt

        points = columns.pop("points")
        self._points.GetPointsAttr().Set(_vectors(points), code)
        if self._width is None and len(points) > 1:
            self.set_width(2 * radius_of(to_space(points), columns.get("world")))
        _set_extent(self._points, points, self._width, code)
        ids = columns.pop("id", None)
        if ids is not None and ids.ndim == 1:
            numbers = np.ascontiguousarray(ids, np.int64)
            self._points.GetIdsAttr().Set(Vt.Int64Array.FromNumpy(numbers), code)
        if _is_vector(columns.get("velocity")):
            self._points.GetVelocitiesAttr().Set(_vectors(columns["velocity"]), code)
        _set_primvars(self._points, columns, code)


class _Liquid:
    """The surface of a liquid, whose triangles are others in every frame."""

    def __init__(self, stage: Any, path: str, radius: float) -> None:
        self._mesh, self._radius = _new_mesh(stage, path), radius

    def frame(self, code: Any, columns: dict[str, NDArray[Any]]) -> None:
        """Write one."""
        points, faces, _ = surface_or_balls(to_space(columns["points"]), self._radius)
        _set_triangles(self._mesh, faces, code)
        self._mesh.GetPointsAttr().Set(_vectors(points), code)
        _set_extent(self._mesh, points, None, code)


class _Mesh:
    """Triangles or the surface of tetrahedra as a mesh, edges as curves."""

    def __init__(self, stage: Any, path: str, part: Part) -> None:
        from pxr import UsdGeom, Vt

        self._edges: NDArray[Any] | None = None
        self._mesh: Any = None
        self._curves: Any = None
        self._width: float | None = None
        self._faced = False
        self._part = part
        if part.triangles is not None or part.tetrahedra is not None:
            self._mesh = _new_mesh(stage, path)
        if part.edges is not None:
            self._edges = np.asarray(part.edges).ravel()
            self._curves = UsdGeom.BasisCurves.Define(
                stage, path if self._mesh is None else f"{path}/edges"
            )
            self._curves.GetTypeAttr().Set(UsdGeom.Tokens.linear)
            counts = np.full(len(self._edges) // 2, 2, np.int32)
            self._curves.GetCurveVertexCountsAttr().Set(Vt.IntArray.FromNumpy(counts))

    def set_width(self, width: float) -> None:
        """Of edges."""
        from pxr import UsdGeom, Vt

        self._width = width
        if self._curves is not None:
            self._curves.GetWidthsAttr().Set(Vt.FloatArray([width]))
            self._curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)

    def frame(self, code: Any, columns: dict[str, NDArray[Any]]) -> None:
        """Write one."""
        points = columns.pop("points")
        if self._mesh is not None and not self._faced:
            self._set_faces(points)
        if self._mesh is not None:
            self._mesh.GetPointsAttr().Set(_vectors(points), code)
            _set_extent(self._mesh, points, None, code)
            if _is_vector(columns.get("velocity")):
                self._mesh.GetVelocitiesAttr().Set(_vectors(columns["velocity"]), code)
            _set_primvars(self._mesh, columns, code)
        if self._edges is not None:
            self._curves.GetPointsAttr().Set(_vectors(points[self._edges]), code)
            _set_extent(self._curves, points, self._width, code)

    def _set_faces(self, points: NDArray[Any]) -> None:
        """Once, when points are known."""
        faces = self._part.triangles
        if self._part.tetrahedra is not None:
            faces = TetMesh(points, self._part.tetrahedra).surface_faces
        _set_triangles(self._mesh, faces)
        self._faced = True


class _Bodies:
    """A transform for each body, with its shape below."""

    def __init__(self, stage: Any, path: str, part: Part) -> None:
        from pxr import UsdGeom

        UsdGeom.Xform.Define(stage, path)
        self._stage, self._path, self._part = stage, path, part
        self._ops: list[Any] = []

    def frame(self, code: Any, columns: dict[str, NDArray[Any]]) -> None:
        """Write one."""
        from pxr import Gf, UsdGeom

        points = to_space(columns["points"]).astype(float)
        for k in range(len(self._ops), len(points)):
            body = UsdGeom.Xform.Define(self._stage, f"{self._path}/body_{k}")
            precision = UsdGeom.XformOp.PrecisionDouble
            self._ops.append((body.AddTranslateOp(precision), body.AddOrientOp(precision)))
            vertices, faces = self._part.shape_of(k)
            if len(faces):
                mesh = _new_mesh(self._stage, f"{self._path}/body_{k}/body_{k}_shape")
                _set_triangles(mesh, faces)
                mesh.GetPointsAttr().Set(_vectors(vertices))
                _set_extent(mesh, vertices, None)
        for (move, turn), x, q in zip(self._ops, points, columns["orientation"], strict=False):
            move.Set(Gf.Vec3d(*x.tolist()), code)
            turn.Set(Gf.Quatd(*q.astype(float).tolist()), code)


_WRITERS: dict[str, Any] = {"particles": _Points, "bodies": _Bodies, "mesh": _Mesh}


def _new_mesh(stage: Any, path: str) -> Any:
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.GetSubdivisionSchemeAttr().Set(UsdGeom.Tokens.none)
    mesh.GetDoubleSidedAttr().Set(True)
    return mesh


def _set_triangles(mesh: Any, faces: Any, *code: Any) -> None:
    from pxr import Vt

    corners = np.ascontiguousarray(faces, np.int32)
    counts = np.full(len(corners), 3, np.int32)
    mesh.GetFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(counts), *code)
    mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(corners.ravel()), *code)


def _set_extent(geometry: Any, points: NDArray[Any], width: float | None, *code: Any) -> None:
    """The box around points that are so wide, which viewers ask for."""
    if len(points):
        inside, half = to_space(points), 0.5 * (width or 0.0)
        box = np.array([inside.min(axis=0) - half, inside.max(axis=0) + half])
        geometry.GetExtentAttr().Set(_vectors(box), *code)


def _set_primvars(geometry: Any, columns: dict[str, NDArray[Any]], code: Any) -> None:
    """Fields of one number for each point, or of a vector."""
    from pxr import Sdf, UsdGeom, Vt

    api = UsdGeom.PrimvarsAPI(geometry)
    names = _unique([name.replace("-", "_") for name in columns])
    for name, values in zip(names, columns.values(), strict=True):
        if values.ndim == 1:
            kind, array = (
                Sdf.ValueTypeNames.FloatArray,
                Vt.FloatArray.FromNumpy(narrow(values)),
            )
        elif _is_vector(values):
            kind, array = Sdf.ValueTypeNames.Vector3fArray, _vectors(values)
        else:
            continue
        primvar = api.CreatePrimvar(name, kind, UsdGeom.Tokens.vertex)
        primvar.Set(array, code)
