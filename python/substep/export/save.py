"""Writes a recording in the form that the name of the file asks for."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from ..base.checks import check_path
from ..errors import InputError
from ..recording import Recording

SUFFIXES = {
    ".vtkhdf": "VTKHDF, for ParaView",
    ".usd": "USD, binary",
    ".usdc": "USD, binary",
    ".usda": "USD, text",
    ".html": "a page that plays in any browser",
    ".npz": "arrays of NumPy",
    ".csv": "a table for each part",
    ".ply": "a file for each frame and part",
    ".obj": "a file for each frame and part",
    ".vtu": "a file for each frame and part",
}


def save(recording: str | os.PathLike[str], out: str | os.PathLike[str]) -> list[Path]:
    """Write a recording in another form.

    The suffix of `out` says which:

    - ``.vtkhdf``: packed, as by `substep.pack`.
    - ``.usd``, ``.usdc``, ``.usda``: one USD stage of all parts but grids, z up, in metres, one
      time code for each frame. Particles are points with their velocities, a mesh is a mesh, edges
      are curves, and each body is a transform (``pip install "substep[usd]"``).
    - ``.html``: one page that plays in any browser, without Python and without a network, as by
      `Recording.to_html` (``pip install "substep[view]"``).
    - ``.npz``: ``times``, and ``PART/points`` and ``PART/FIELD`` of shape (frames, n, ...), or
      ``PART/FIELD/FRAME`` where n changes.
    - ``.csv``: a row for each point and frame; with several parts a file for each, NAME-PART.csv.
    - ``.ply``, ``.obj``, ``.vtu``: a file for each frame, NAME-PART-0000.ply; ``.obj`` of triangles
      alone and without fields (``pip install "substep[mesh]"``).

    Points of a plane, (x, y), become (x, 0, y) in USD, so that what is up stays up.

    Parameters
    ----------
    recording : path-like
        The recording, or its journal.
    out : path-like
        File to write; what is there is replaced, but for a ``.vtkhdf``.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    InputError
        If the suffix is none of these, or nothing in the recording can be written so.
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
    target = Path(check_path(out))
    suffix = target.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(
            f"out: expected a file ending in {', '.join(SUFFIXES)}, got {str(target)[-60:]!r}"
        )
    if suffix == ".vtkhdf":
        from ..recording.packing import pack

        return [Path(pack(recording, target))]
    write: Callable[[Recording, Path], list[Path]]
    if suffix.startswith(".usd"):
        from .usd import write_usd as write
    elif suffix == ".html":
        from ..view.page import write_page as write
    elif suffix == ".npz":
        from .tables import write_arrays as write
    elif suffix == ".csv":
        from .tables import write_tables as write
    else:
        from .meshes import write_meshes as write
    with Recording(check_path(recording)) as opened:
        if target.exists() and os.path.samefile(target, opened.path):
            raise InputError(f"out: {str(target)[-60:]!r} is the recording itself")
        if not len(opened):
            raise InputError(f"{opened.path}: has no frames")
        return write(opened, target)
