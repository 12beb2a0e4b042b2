"""Writes a recording in the form that the name of the file asks for."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..base.checks import check_name, check_path, check_real, describe
from ..base.replacing import check_file_name, check_folder
from ..errors import InputError
from ..recording import Recording
from ..recording.files import check_not_itself

SUFFIXES = {
    ".vtkhdf": "VTKHDF, for ParaView",
    ".usd": "USD, binary",
    ".usdc": "USD, binary",
    ".usda": "USD, text",
    ".html": "a page that plays in any browser",
    ".abc": "Alembic",
    ".glb": "glTF, binary",
    ".vdb": "OpenVDB, a file for each frame and grid",
    ".npz": "arrays of NumPy",
    ".csv": "a table for each part",
    ".ply": "a file for each frame and part",
    ".obj": "a file for each frame and part",
    ".vtu": "a file for each frame and part",
}


def save(
    recording: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    liquids: Mapping[str, float] | None = None,
) -> list[Path]:
    """Write a recording in another form.

    The suffix of `out` says which:

    - ``.vtkhdf``: packed, as by `substep.pack`.
    - ``.usd``, ``.usdc``, ``.usda``: one USD stage of all parts but grids, z up, in metres, one
      time code for each frame. Particles are points with their velocities, a mesh is a mesh, edges
      are curves, and each body is a transform with its shape (``pip install "substep[usd]"``).
    - ``.html``: one page that plays in any browser, without Python and without a network, as by
      `Recording.to_html` (``pip install "substep[view]"``).
    - ``.abc``: the same as Alembic, where particles are vertices (``pip install
      "substep[blender]"``, in Python 3.11).
    - ``.glb``: the same as glTF, y up, where what deforms has a morph target for each frame
      (``pip install "substep[gltf]"``).
    - ``.vdb``: grids in three dimensions as OpenVDB, NAME-PART-0000.vdb (``pip install
      "substep[blender]"``).
    - ``.npz``: ``times``, and ``PART/points`` and ``PART/FIELD`` of shape (frames, n, ...), or
      ``PART/FIELD/FRAME`` where n changes.
    - ``.csv``: a row for each point and frame; with several parts a file for each, NAME-PART.csv.
    - ``.ply``, ``.obj``, ``.vtu``: a file for each frame, NAME-PART-0000.ply; ``.obj`` of triangles
      alone and without fields (``pip install "substep[mesh]"``).

    Points of a plane, (x, y), become (x, 0, y) in USD, Alembic and glTF, so that what is up stays
    up.

    Parameters
    ----------
    recording : path-like
        The recording, or its journal.
    out : path-like
        File to write; an existing file is replaced, except a ``.vtkhdf``.
    liquids : mapping of str to float, optional
        Half the distance of neighbouring particles at rest [m] of the parts whose surface, as
        `liquid_surface` makes it, is written in place of particles; in USD, Alembic and glTF.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    InputError
        If the suffix is none of these, nothing in the recording can be written so, `liquids` names
        what is no part of particles, `out` is the recording, or numbers are beyond the float32 that
        USD and glTF hold.
    FormatError
        If the recording is damaged.
    ImportError
        If an extra is missing.
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> import os, tempfile
    >>> import numpy as np
    >>> import substep
    >>> folder = tempfile.TemporaryDirectory()
    >>> run = substep.scenes.run("double-gyre", {"particles": 10}, folder.name, frames=3)
    >>> [file] = substep.export.save(run.recording, os.path.join(folder.name, "gyre.npz"))
    >>> np.load(file)["particles/points"].shape
    (3, 10, 2)
    >>> folder.cleanup()
    """
    target = Path(check_file_name(out, "out"))
    suffix = target.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(
            f"out: expected a file ending in {', '.join(SUFFIXES)}, got {str(target)[-60:]!r}"
        )
    radii = _check_liquids(liquids, suffix)
    check_folder(target)
    if suffix == ".vtkhdf":
        from ..recording.packing import pack

        return [Path(pack(recording, target))]
    write: Callable[..., list[Path]]
    if suffix.startswith(".usd"):
        from .usd import write_usd as write
    elif suffix == ".html":
        from ..view.page import write_page as write
    elif suffix == ".abc":
        from .blender import write_alembic as write
    elif suffix == ".glb":
        from .gltf import write_gltf as write
    elif suffix == ".vdb":
        from .blender import write_volumes as write
    elif suffix == ".npz":
        from .tables import write_arrays as write
    elif suffix == ".csv":
        from .tables import write_tables as write
    else:
        from .meshes import write_meshes as write
    with Recording(check_path(recording)) as opened:
        check_not_itself(target, opened.path)
        if not len(opened):
            raise InputError(f"{opened.path}: has no frames")
        particles = [name for name, part in opened.parts.items() if part.kind == "particles"]
        for name in radii:
            check_name("liquids", name, opened.parts if name in opened.parts else particles)
            if (kind := opened.parts[name].kind) != "particles":
                raise InputError(f"liquids: expected parts of particles, but {name} is of {kind}")
        return write(opened, target, radii) if radii else write(opened, target)


def _check_liquids(liquids: Any, suffix: str) -> dict[str, float]:
    if liquids is None:
        return {}
    if not isinstance(liquids, Mapping):
        raise TypeError(f"liquids: expected a mapping of parts to radii, got {describe(liquids)}")
    radii = {
        name: check_real(f"liquids[{name!r}]", radius, positive=True)
        for name, radius in liquids.items()
    }
    if radii and suffix not in (".usd", ".usdc", ".usda", ".abc", ".glb"):
        raise InputError(f"liquids: {suffix} files hold no surfaces that change; write .usdc")
    return radii
