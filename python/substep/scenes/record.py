"""A recording of any simulation, without a scene."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ..base.checks import MOST_INT, check_real, describe
from ..base.replacing import check_file_name
from ..errors import InputError
from ..recording import Recorder
from ..recording.files import JOURNAL_SUFFIX
from .declaration import particle_frame, particle_parts


def check_simulation(name: str, value: Any, wanted: str = "a simulation") -> None:
    """One of ours, or what speaks as they do; no class of them."""
    words = ("fields", "advance", "time", "state", "restore")
    if isinstance(value, type) or not all(hasattr(value, word) for word in words):
        raise TypeError(f"{name}: expected {wanted}, got {describe(value)}")


def record(
    simulation: Any,
    path: str | os.PathLike[str],
    duration: float,
    *,
    fps: float = 25.0,
    overwrite: bool = False,
) -> Path:
    """Advance a simulation, and record it frame by frame.

    The parts are those of a scene that does not say otherwise: particles with all fields, rigid
    bodies with their shapes, cloth and soft bodies as meshes, grids, and of a `World` one for each
    member.

    Parameters
    ----------
    simulation : simulation
        Of any class, or a `World`; it ends `duration` later than it began.
    path : path-like
        Of the recording, by custom `*.vtkhdf`.
    duration : float
        How long it goes on [s], at least 0.
    fps : float
        Frames for each second of its time; the first is the state it is in. The last is at the last
        whole interval: 0.5 s at 25 frames per second end at 0.48 s in the recording, while the
        simulation goes on to 0.5 s.
    overwrite : bool
        Replace a recording that is there.

    Returns
    -------
    Path
        The recording.

    Raises
    ------
    InputError
        If an argument is wrong.
    FileExistsError
        If a recording is there, without `overwrite`.
    SolverError
        If the simulation fails; the frames before are in the journal.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import os, tempfile
    >>> import substep
    >>> bodies = substep.RigidBodies()
    >>> box = bodies.add(substep.Box((1, 1, 1)), (0, 0, 2))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = substep.scenes.record(bodies, os.path.join(folder, "fall.vtkhdf"), 0.2, fps=10)
    ...     with substep.Recording(path) as recording:
    ...         print(len(recording), recording.parts["particles"].kind)
    3 bodies
    """
    check_simulation("simulation", simulation)
    duration = check_real("duration", duration, nonnegative=True)
    fps = check_real("fps", fps, positive=True)
    target = check_file_name(path)
    start, name = float(simulation.time), type(simulation).__name__
    if not (count := duration * fps * (1 + 1e-12)) < MOST_INT:
        raise InputError(f"fps: expected less than {MOST_INT} frames, got {count:.3g}")
    with Recorder(
        target, parts=particle_parts(simulation), scene=name, overwrite=overwrite
    ) as recorder:
        recorder.append(start, particle_frame(simulation))
        for k in range(1, int(count) + 1):
            before = simulation.time
            if (left := start + k / fps - before) > 0:
                simulation.advance(left)
            if not simulation.time > before:
                if k == 1:
                    Path(target + JOURNAL_SUFFIX).unlink()
                raise InputError(f"fps: {fps} frames per second are nearer than times can be")
            recorder.append(simulation.time, particle_frame(simulation))
    if (left := start + duration - simulation.time) > 0:
        simulation.advance(left)
    return Path(target)
