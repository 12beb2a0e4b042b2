"""Trajectories of particles in the form that graph network simulators are trained on."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import check_array, check_integer, check_name, check_path, check_real
from ..base.replacing import replace_bytes
from ..errors import InputError
from ..recording import Recording
from ..view.extent import radius_of
from .collection import RunCollection
from .training import SPLITS, chosen_part, read_runs

SAND = 6  # particle types of the data sets of Learning to Simulate: 3 is kinematic, 5 water, 7 goop
LOW, HIGH = 0.1, 0.9  # of their walls, in the unit box
ROUNDING = 1e-6  # of the longest side, by which positions in float32 may be off


def write_gns(
    runs: RunCollection,
    out: str | os.PathLike[str],
    *,
    bounds: ArrayLike | None = None,
    part: str | None = None,
    particle_type: int = SAND,
    radius: float | None = None,
    material: str | None = None,
    fractions: Sequence[float] = (0.8, 0.1, 0.1),
) -> Path:
    """Write the runs of a scene of particles as a data set of "Learning to Simulate".

    The folder gets ``train.npz``, ``valid.npz`` and ``test.npz``, as the PyTorch implementation of
    graph network simulators reads them: one entry per run, the positions of shape (frames, n, dim)
    in float32, the types of the n particles and, if `material` names a parameter, its value for
    each. Runs of one seed are in one of the sets. ``metadata.json`` has the bounds, the number of
    frames after the first, the time between two frames, the radius of connectivity, and mean and
    standard deviation of velocities and accelerations in training, which are differences between
    frames.
    Positions are moved and scaled, alike in all directions, so that the longest side of `bounds`
    reaches from 0.1 to 0.9.

    Parameters
    ----------
    runs : RunCollection
        Of a scene. Those that are not done are left out.
    out : path-like
        Folder, made if need be. Files of these names are replaced.
    bounds : array_like, shape (2, dim), optional
        Low and high corner of the domain [m], which no particle leaves; by default of all
        positions.
    part : str, optional
        Part of the recordings, where there are several.
    particle_type : int
        Of all particles, 0 to 8: 5 is water, 6 sand, 7 goop.
    radius : float, optional
        Radius of connectivity [m]; by default twice the median distance to the nearest neighbour.
    material : str, optional
        Parameter of the sweep whose values the network shall know as a property of the particles.
    fractions : sequence of float
        Parts of the seeds for training, validation and test, or of the runs if all have one seed.
        Each part above 0 gets one at least, in this order, where there are enough; UserWarning
        names those that stay empty.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    InputError
        If an argument is wrong, particles come or go within a run, or leave the bounds, or frames
        are apart by different times. Nothing is written then.
    OSError
        If a file cannot be written.

    References
    ----------
    .. [1] A. Sanchez-Gonzalez et al., "Learning to simulate complex physics with graph networks",
       ICML 2020.
    .. [2] K. Kumar and J. Vantassel, "GNS: A generalizable graph neural network-based simulator
       for particulate and fluid modeling", Journal of Open Source Software 8 (88), 5025, 2023.

    Examples
    --------
    >>> import json, os, tempfile
    >>> import substep
    >>> from substep.sweeps import write_gns
    >>> folder = tempfile.TemporaryDirectory()
    >>> runs = substep.sweep("double-gyre", {"particles": 20}, folder.name, repeats=5, frames=4)
    >>> data = write_gns(runs, os.path.join(folder.name, "gns"), bounds=[[0, 0], [2, 1]])
    >>> json.loads((data / "metadata.json").read_text())["bounds"]
    [[0.1, 0.9], [0.1, 0.5]]
    >>> folder.cleanup()
    """
    kind = check_integer("particle_type", particle_type, minimum=0, maximum=8)
    folder = Path(check_path(out, "out"))
    done, read, dt, sets = read_runs(
        runs, fractions, lambda recording, run: _read(recording, run, part), "another dimension"
    )
    if material is not None:
        values = runs.parameters[check_name("material", material, runs.parameters)]
        if not all(isinstance(value, (int, float)) for value in values):
            raise InputError(f"material: expected a parameter of numbers, got {material!r}")
    dim = read[0].shape[2]
    low, high = _bounds(bounds, read, dim)
    if radius is None:
        reach = 4 * radius_of(read[0][0])
    else:
        reach = check_real("radius", radius, positive=True)
    with np.errstate(all="ignore"):
        size = high - low
        scale = (HIGH - LOW) / size.max()
    if not 0 < scale < np.inf:
        raise InputError(f"bounds: expected other lengths, got {size.tolist()}")
    for run, positions in zip(done, read, strict=True):
        _check_within(f"run {run.index}", positions, low, high)
    trajectories = [(LOW + scale * (positions - low)).astype(np.float32) for positions in read]
    for run, positions, scaled in zip(done, read, trajectories, strict=True):
        if _is_one_point(scaled) and not _is_one_point(positions):
            raise InputError(
                f"bounds: expected smaller ones, in which positions of run {run.index} differ in "
                f"float32; they are {size.tolist()} m long"
            )
    metadata = {
        "bounds": np.stack([np.full(dim, LOW), LOW + scale * (high - low)], 1).round(6).tolist(),
        "sequence_length": min(len(positions) for positions in trajectories) - 1,
        "default_connectivity_radius": float(scale * reach),
        "dim": dim,
        "dt": dt,
        **_statistics("vel", [np.diff(trajectories[k], axis=0) for k in sets[0]]),
        **_statistics("acc", [np.diff(trajectories[k], 2, axis=0) for k in sets[0]]),
        "scale": float(scale),  # ours: position = LOW + scale (x - origin)
        "origin": low.tolist(),
    }
    folder.mkdir(parents=True, exist_ok=True)
    for split, chosen in zip(SPLITS, sets, strict=True):
        entries = {}
        for k in chosen:
            count = trajectories[k].shape[1]
            columns: list[Any] = [trajectories[k], np.full(count, kind, np.int64)]
            if material is not None:
                columns.append(np.full(count, done[k].parameters[material], np.float32))
            entry = np.empty(len(columns), object)
            entry[:] = columns
            entries[f"simulation_trajectory_{done[k].index}"] = entry
        buffer = io.BytesIO()
        np.savez_compressed(buffer, allow_pickle=True, **entries)
        replace_bytes(folder / f"{split}.npz", buffer.getbuffer())
    replace_bytes(folder / "metadata.json", json.dumps(metadata, indent=1).encode())
    return folder


def _read(recording: Recording, run: int, part: str | None) -> tuple[NDArray[Any], int]:
    """Positions of shape (frames, n, dim) [m], and dim."""
    names = [name for name, one in recording.parts.items() if one.kind == "particles"]
    if part is None and not names:
        kinds = {one.kind for one in recording.parts.values()}
        hint = "; write meshes and grids with --to meshgraphnets, or write_meshgraphnets"
        told = hint if kinds & {"mesh", "grid"} else ""
        raise InputError(f"part: the recordings have no parts of particles{told}")
    chosen = recording[chosen_part(part, names, "parts of particles")]
    frames = [np.array(chosen.points(k), np.float64) for k in range(len(recording))]
    if len({len(points) for points in frames}) > 1:
        raise InputError(f"runs: in run {run} particles come or go")
    return np.stack(frames), frames[0].shape[1]


def _bounds(
    given: ArrayLike | None, positions: list[NDArray[Any]], dim: int
) -> tuple[NDArray[Any], NDArray[Any]]:
    if given is None:
        low = np.min([x.min((0, 1)) for x in positions], axis=0)
        high = np.max([x.max((0, 1)) for x in positions], axis=0)
    else:
        low, high = check_array("bounds", given, (2, dim))
    if not (high > low).all():
        raise InputError("bounds: expected a high corner above the low one")
    return low, high


def _check_within(
    name: str, positions: NDArray[Any], low: NDArray[Any], high: NDArray[Any]
) -> None:
    """Refuse particles beyond the walls, which a network knows by its distance from them alone."""
    slack = ROUNDING * (high - low).max()
    outside = (positions < low - slack) | (positions > high + slack)
    if outside.any():
        frame, particle, axis = np.unravel_index(int(np.argmax(outside)), outside.shape)
        raise InputError(
            f"bounds: expected all particles within them, but in {name}, frame {frame}, particle "
            f"{particle} is at {'xyz'[axis]} = {positions[frame, particle, axis]:.6g} m, not "
            f"between {low[axis]:.6g} and {high[axis]:.6g}"
        )


def _is_one_point(positions: NDArray[Any]) -> bool:
    return bool((positions == positions[:1, :1]).all())


def _statistics(name: str, values: list[NDArray[Any]]) -> dict[str, list[float]]:
    """Mean and standard deviation of each component over all particles, frames and runs."""
    if not values:
        raise InputError("fractions: no run is left for training")
    rows = np.concatenate([x.reshape(-1, x.shape[-1]) for x in values]).astype(np.float64)
    return {f"{name}_mean": rows.mean(0).tolist(), f"{name}_std": rows.std(0).tolist()}
