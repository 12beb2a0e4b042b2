"""What data sets for learned simulators have in common: runs, the part of them, and three sets."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..base.checks import check_array, check_name
from ..errors import InputError
from ..recording import Recording
from .collection import Run, RunCollection

SPLITS = ("train", "valid", "test")
Read = TypeVar("Read")


def read_runs(
    runs: Any, fractions: Any, read: Callable[[Recording, int], tuple[Read, int]], other: str
) -> tuple[list[Run], list[Read], float, list[list[int]]]:
    """Read the runs that are done, and share them out.

    Parameters
    ----------
    runs : RunCollection
        Of a scene.
    fractions : sequence of float
        Parts of the seeds for training, validation and test, see `_split_by_seed`.
    read : callable
        ``read(recording, index)`` gives what is wanted of a run, and its width, which is the same
        in all.
    other : str
        What a run of another width has.

    Returns
    -------
    done : list of Run
        Those that are done.
    found : list
        What was read of each.
    dt : float
        Time between frames [s].
    sets : list of list of int
        Which of them are for training, validation and test.

    Raises
    ------
    InputError
        If `runs` or `fractions` is something else, none is done, frames are less than 3 or apart
        by different times, or runs differ in that or in their width.
    """
    done = _done(runs)
    shares = check_array("fractions", fractions, (3,))
    if (shares < 0).any() or abs(shares.sum() - 1) > 1e-9:
        raise InputError(f"fractions: expected parts of 1, got {shares.tolist()}")
    found, widths, intervals = [], [], []
    for run in done:
        with run.recording() as recording:
            steps = np.diff(recording.times)
            if len(steps) < 2 or np.ptp(steps) > 1e-6 * steps.mean():
                raise InputError(
                    f"runs: expected 3 frames or more at equal times, as run {run.index} has not"
                )
            one, width = read(recording, run.index)
        found.append(one)
        widths.append(width)
        intervals.append(float(steps.mean()))
        if width != widths[0] or abs(intervals[-1] - intervals[0]) > 1e-6 * intervals[0]:
            raise InputError(f"runs: run {run.index} has {other} or another frame rate")
    sets = _split_by_seed(done, shares)
    wanted = zip(SPLITS, sets, shares, strict=True)
    if empty := [name for name, chosen, share in wanted if share > 0 and not chosen]:
        told = f"no run is left for {' and '.join(empty)}: {_counted(done)}"
        warnings.warn(told, UserWarning, stacklevel=3)
    return done, found, intervals[0], sets


def chosen_part(part: str | None, names: list[str], kind: str) -> str:
    """The part of that name, or the only one; InputError otherwise."""
    if part is not None:
        return check_name("part", part, names)
    if not names:
        raise InputError(f"part: the recordings have no {kind}")
    if len(names) > 1:
        raise InputError(f"part: the recordings have {len(names)} {kind}: {', '.join(names)}")
    return names[0]


def _done(runs: Any) -> list[Run]:
    if not isinstance(runs, RunCollection):
        raise InputError(f"runs: expected a RunCollection, got {type(runs).__name__}")
    done = [run for run in runs if run.state == "done"]
    if not done:
        why = f"; run 0: {runs[0].error}" if runs[0].error else ""
        raise InputError(f"runs: expected some that are done, got none{why}")
    return done


def _counted(runs: list[Run]) -> str:
    seeds = len({run.seed for run in runs})
    return f"the runs have {seeds} seeds" if seeds > 1 else f"there are {len(runs)}"


def _split_by_seed(runs: list[Run], shares: NDArray[Any]) -> list[list[int]]:
    """Numbers of the runs of each set: those of a seed together, of a single seed one by one.

    Each set of which the share is not 0 has one seed at least, as far as they go round.
    """
    seeds = [run.seed for run in runs]
    keys = seeds if len(set(seeds)) > 1 else list(range(len(seeds)))
    order = np.random.default_rng(0).permutation(np.unique(keys))
    counts = np.diff(np.round(np.cumsum(shares) * len(order)).astype(int), prepend=0)
    for k in np.flatnonzero((counts == 0) & (shares > 0)):
        largest = int(np.argmax(counts))
        if counts[largest] > 1:
            counts[k] += 1
            counts[largest] -= 1
    ends = np.cumsum(counts)
    return [[k for k, key in enumerate(keys) if key in part] for part in np.split(order, ends[:2])]
