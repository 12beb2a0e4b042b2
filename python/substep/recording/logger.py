"""Logging a run: named numbers and small arrays against time."""

from __future__ import annotations

import codecs
import csv
import math
import os
from collections.abc import Callable, Iterable, Mapping
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import (
    check_array,
    check_callable,
    check_most,
    check_real,
    describe,
)
from ..base.imports import needs
from ..base.owned import Owned
from ..base.replacing import check_file_name, check_folder, replace_file
from ..errors import InputError
from .parts import check_name

Array = NDArray[np.float64]

_SLACK = 1e-6  # of an interval: times are sums of steps
_MOST_DRAWN = 1e300  # matplotlib computes with what is somewhat larger than the values


class Logger(Owned):
    """Logs quantities of a run against time: the callback of `advance`.

    Parameters
    ----------
    quantities : mapping of str to callable
        `quantity(simulation)` gives a number, or an array that always has the same shape. Names
        are letters, digits, `_`, `-` and, between them, `.`.
    every : float, optional
        Time from one sample to the next [s]; each call is one unless given. Samples are taken at
        the first step that ends then or later.

    Attributes
    ----------
    every : float or None
        Time from one sample to the next [s].

    Raises
    ------
    TypeError
        If `quantities` is no mapping, or holds what cannot be called.
    InputError
        If there are no quantities, a name is wrong, or `every` is not above 0.

    See Also
    --------
    Recorder : Whole frames, safe on the disk.

    Examples
    --------
    >>> import substep
    >>> bodies = substep.RigidBodies(step=0.01)
    >>> ball = bodies.add(substep.Sphere(0.1), (0, 0, 10))
    >>> log = substep.Logger({"height": lambda bodies: bodies.positions[ball, 2]}, every=0.1)
    >>> log(bodies)  # the start
    >>> bodies.advance(0.3, log)
    >>> log.times, log["height"].round(3)
    (array([0. , 0.1, 0.2, 0.3]), array([10.   ,  9.951,  9.804,  9.559]))
    """

    every: float | None

    def __init__(
        self, quantities: Mapping[str, Callable[[Any], ArrayLike]], *, every: float | None = None
    ) -> None:
        self._quantities = _check_quantities(quantities)
        self.every = None if every is None else check_real("every", every, positive=True)
        self._samples: list[tuple[float, tuple[Array, ...]]] = []

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "_samples": list(self._samples)}

    def __call__(self, simulation: Any) -> None:
        """Take a sample, if one is due.

        Parameters
        ----------
        simulation : Simulation
            What has a `time`, and is given to the quantities.

        Raises
        ------
        TypeError
            If `simulation` has no time, or a quantity is no real number and no array of them.
        InputError
            If the shape of a quantity is not that of the first sample, or the time is before the
            last sample.
        """
        if not hasattr(simulation, "time"):
            raise TypeError(f"simulation: expected one, got {describe(simulation)}")
        with self._owner:
            self._alone()
            time = check_real("time", simulation.time)
            if self._is_due(time):
                quantities = enumerate(self._quantities.items())
                row = tuple(self._value(k, *quantity, simulation) for k, quantity in quantities)
                self._samples.append((time, row))

    def _alone(self) -> None:
        """Refuse quantities and handlers of signals that would sample or clear."""
        try:
            self._owner.begin("Logger")
        except InputError:
            raise InputError("the logger is in the middle of a sample") from None

    def _is_due(self, time: float) -> bool:
        if not self._samples:
            return True
        first, last = self._samples[0][0], self._samples[-1][0]
        if time < last:
            raise InputError(
                f"time: expected one after {last}, the last sample, got {time}; clear() the logger "
                "or make another"
            )
        if self.every is None or time == last or time - last >= self.every:
            return time > last
        intervals = [math.floor((t - first) / self.every + _SLACK) for t in (last, time)]
        return intervals[1] > intervals[0]

    def _value(self, k: int, name: str, quantity: Callable[[Any], Any], simulation: Any) -> Array:
        """The quantity now; what it raises passes, with a note that names it."""
        what = f"quantities[{name!r}]"
        try:
            given = quantity(simulation)
        except Exception as error:
            if hasattr(error, "add_note"):  # from Python 3.11 on
                error.add_note(f"raised by {what} at {simulation.time} s")
            raise
        value = check_array(what, given, finite=False)
        if self._samples and value.shape != (shape := self._samples[0][1][k].shape):
            raise InputError(f"{what}: expected shape {shape} as at first, got {value.shape}")
        return value

    def __len__(self) -> int:
        """Samples so far."""
        return len(self._samples)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the quantities."""
        return tuple(self._quantities)

    @property
    def times(self) -> Array:
        """Times of the samples, shape (n,) [s]."""
        return np.array([time for time, _ in self._samples], np.float64)

    def __getitem__(self, name: str) -> Array:
        """Samples of a quantity, shape (n, ...); KeyError if there is none of that name."""
        if name not in self._quantities:
            raise KeyError(f"{name!r}; the logger has {', '.join(self._quantities)}")
        k = list(self._quantities).index(name)
        return np.array([row[k] for _, row in self._samples], np.float64)

    def arrays(self) -> dict[str, Array]:
        """All samples.

        Returns
        -------
        dict of str to ndarray
            `time`, shape (n,) [s], and each quantity, shape (n, ...): copies.
        """
        return {"time": self.times, **{name: self[name] for name in self._quantities}}

    def columns(self) -> dict[str, Array]:
        """All samples as columns of numbers, as `to_csv` and `to_pandas` have them.

        Returns
        -------
        dict of str to ndarray, shape (n,)
            `time` [s], each number by its name, and each element of an array as `name[i]`.
        """
        found = {}
        for name, values in self.arrays().items():
            for index in np.ndindex(values.shape[1:]):
                key = name + "".join(f"[{i}]" for i in index)
                found[key] = values[(slice(None), *index)].copy()
        return found

    def clear(self) -> None:
        """Forget all samples."""
        self._alone()
        self._samples = []

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the columns to a file of comma-separated values, with a line of their names.

        Numbers are written so that they are read back exactly.

        Parameters
        ----------
        path : path-like
            Where to; an existing file is replaced, once all is written.

        Raises
        ------
        OSError
            If it cannot be written; an existing file stays then.
        """
        columns = self.columns()

        def write(file: IO[bytes]) -> None:
            lines = csv.writer(codecs.getwriter("utf-8")(file), lineterminator="\n")
            lines.writerow(columns)
            lines.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))

        replace_file(check_file_name(path), write)

    def to_pandas(self) -> Any:
        """The columns as a table of pandas, by `time`.

        Returns
        -------
        pandas.DataFrame
            One row for each sample.

        Raises
        ------
        ImportError
            If pandas is missing.
        """
        with needs("pandas", "pandas is missing: pip install pandas for tables"):
            import pandas
        return pandas.DataFrame(self.columns()).set_index("time")

    def plot(self, path: str | os.PathLike[str]) -> None:
        """Draw every quantity against time, one above the other; many in several columns.

        A quantity may have the attributes `unit`, a text that stands beside its name, and
        `components`, names of the numbers of its array, which have their indices otherwise. Those
        of `substep.recording` and of joints have them.

        Parameters
        ----------
        path : path-like
            Where to; its suffix says how: `.png`, `.pdf`, `.svg`.

        Raises
        ------
        ImportError
            If matplotlib is missing.
        InputError
            If there are no samples, no such suffix, or numbers that are too large to be drawn.
        OSError
            If it cannot be written.
        """
        file = check_file_name(path)
        told = 'matplotlib is missing: pip install "substep[plot]" to plot quantities'
        with needs("matplotlib", told):
            from matplotlib.figure import Figure
        times, names = _drawable("time", self.times), self.names
        if not len(times):
            raise InputError("the logger has no samples to plot")
        check_folder(file)
        columns = 1 if len(names) <= 4 else math.ceil(math.sqrt(len(names) / 3))
        rows = math.ceil(len(names) / columns)
        width = 7.2 if columns == 1 else 4.8 * columns
        figure = Figure(figsize=(width, 1.2 + 1.6 * rows), layout="constrained")
        _check_suffix(file, figure.canvas.get_supported_filetypes())
        grid = figure.subplots(rows, columns, squeeze=False, sharex=True).flat
        panels = grid[: len(names)]
        for panel in grid[len(names) :]:
            panel.remove()
        for panel, name in zip(panels, names, strict=True):
            values = _drawable(f"quantities[{name!r}]", self[name])
            values = values.reshape(len(times), math.prod(values.shape[1:]))
            lines = panel.plot(times, values, linewidth=1.2)
            if len(lines) > 1:
                numbers = getattr(self._quantities[name], "components", ())
                if len(numbers) != len(lines):
                    numbers = [f"[{i}]" for i in range(len(lines))]
                panel.legend(lines, numbers, loc="center left", bbox_to_anchor=(1, 0.5))
            unit = getattr(self._quantities[name], "unit", "")
            panel.set_ylabel(f"{name} [{unit}]" if unit else name)
            panel.grid(True, color="0.9")
        for panel in panels[-columns:]:  # the lowest of each column
            panel.set_xlabel("time [s]")
            panel.tick_params(labelbottom=True)
        figure.savefig(file, dpi=150)


def _check_suffix(path: str, known: Iterable[str]) -> None:
    """Refuse what says no format that there is; without a suffix matplotlib chooses one."""
    suffix = os.path.splitext(path)[1].lower()
    if suffix[1:] and suffix[1:] not in known:
        listed = ", ".join(f".{name}" for name in sorted(known))
        raise InputError(f"path: expected a file ending in one of {listed}; got {describe(suffix)}")


def _drawable(name: str, values: Array) -> Array:
    """The values, where matplotlib can compute with those that it draws, which are finite."""
    check_most(name, np.where(np.isfinite(values), values, 0), _MOST_DRAWN)
    return values


def _check_quantities(quantities: Any) -> dict[str, Callable[[Any], Any]]:
    if not isinstance(quantities, Mapping):
        raise TypeError(f"quantities: expected a mapping, got {describe(quantities)}")
    if not quantities:
        raise InputError("quantities: expected at least one")
    for name, quantity in quantities.items():
        for piece in name.split(".") if isinstance(name, str) and name else [name]:
            check_name("quantities", piece)  # with dots as those of a `World`, NAME.KEY
        if name == "time":
            raise InputError("quantities: 'time' is the time of the samples")
        check_callable(f"quantities[{name!r}]", quantity)
    return dict(quantities)
