"""What a sweep has left: its runs, and their results as arrays."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..base.checks import check_callable, check_integer, check_path
from ..base.imports import needs
from ..errors import CorruptError, InputError
from ..scenes.catalogue import load
from .design import Design, Value
from .task import ERROR, RESULT, is_done

if TYPE_CHECKING:
    import xarray

    from ..recording import Recording


@dataclass(frozen=True)
class Run:
    """One run of a sweep.

    Attributes
    ----------
    index : int
        Its number.
    parameters : dict
        Its parameters.
    seed : int
        Its seed.
    path : Path
        Its folder.
    state : str
        ``"done"``, ``"failed"``, or ``"missing"`` where it has not ended.
    error : str
        Why it failed, in one line.
    kind : str
        What was run, ``"scene"`` or ``"function"``.

    Examples
    --------
    >>> import tempfile
    >>> import substep
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     runs = substep.sweep("double-gyre", {"particles": [10, 20]}, folder, frames=2)
    ...     with runs[1].recording() as recording:
    ...         print(runs[1].parameters, len(recording["particles"].points(0)))
    {'particles': 20} 20
    """

    index: int
    parameters: dict[str, Value]
    seed: int
    path: Path
    state: str
    error: str
    kind: str

    def result(self) -> dict[str, NDArray[Any]]:
        """Arrays by name that the function returned.

        Raises
        ------
        InputError
            If the run is not done, or is one of a scene.
        CorruptError
            If the file is damaged.
        """
        self._check("function", "recording()")
        try:
            with np.load(self.path / RESULT, allow_pickle=False) as file:
                return dict(file)
        except (FileNotFoundError, MemoryError):
            raise
        except Exception as error:  # of many kinds, as the archive is damaged
            raise CorruptError(
                f"{self.path / RESULT}: {error}; remove the folder, and the sweep runs it again"
            ) from None

    def recording(self) -> Recording:
        """The recording of a scene's run, open for reading.

        Raises
        ------
        InputError
            If the run is not done, or is one of a function.
        """
        from ..recording import Recording

        self._check("scene", "result()")
        return Recording(next(self.path.glob("*.vtkhdf")))

    def _check(self, kind: str, other: str) -> None:
        if self.kind != kind:
            raise InputError(f"the sweep is one of a {self.kind}: read {other}")
        if self.state != "done":
            raise InputError(
                f"run {self.index} is {self.state}{': ' * bool(self.error)}{self.error}"
            )


class RunCollection:
    """The runs of a sweep, in the order of their numbers: repeats innermost.

    Parameters
    ----------
    path : path-like
        Folder of the sweep. It may still go on.

    Raises
    ------
    FormatError
        If it holds no sweep.
    OSError
        If it cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> import substep
    >>> def square(side):
    ...     return {"area": side**2}
    >>> folder = tempfile.TemporaryDirectory()
    >>> runs = substep.sweep(square, {"side": [1.0, 2.0, 3.0]}, folder.name)
    >>> runs
    RunCollection(square: 3 runs of side[3], 3 done)
    >>> substep.RunCollection(folder.name).arrays()["area"].ravel()
    array([1., 4., 9.])
    >>> folder.cleanup()
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(check_path(path))
        self._design = Design.read(self.path)

    @property
    def parameters(self) -> dict[str, tuple[Value, ...]]:
        """Values of each parameter."""
        return dict(self._design.parameters)

    @property
    def repeats(self) -> int:
        """Runs of each combination."""
        return self._design.repeats

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each parameter, and of repeats."""
        return self._design.shape

    def __len__(self) -> int:
        return len(self._design)

    def __getitem__(self, index: int) -> Run:
        """Return the run of that number."""
        k = check_integer("index", index, minimum=-len(self), maximum=len(self) - 1) % len(self)
        folder = self._design.folder(self.path, k)
        state, error = "missing", ""
        if is_done(folder, self._design):
            state = "done"
        elif (folder / ERROR).exists():
            state = "failed"
            error = (folder / ERROR).read_text(errors="replace").partition("\n")[0]
        values, seed = self._design.values(k), self._design.seed_of(k)
        return Run(k, values, seed, folder, state, error, self._design.kind)

    def _simulation(self, index: int) -> Any:
        """What the scene of a run builds, before its first step."""
        scene = load(self._design.task)
        complete = scene.complete(scene.check(self._design.values(index)))
        return scene.build(complete, self._design.seed_of(index))

    def __iter__(self) -> Iterator[Run]:
        return (self[k] for k in range(len(self)))

    @property
    def failed(self) -> list[Run]:
        """The runs that failed, with their errors."""
        return [run for run in self if run.state == "failed"]

    def __repr__(self) -> str:
        states = [run.state for run in self]
        counts = ", ".join(
            f"{states.count(state)} {state}"
            for state in ("done", "failed", "missing")
            if state in states
        )
        names = [f"{name}[{len(v)}]" for name, v in self.parameters.items()]
        if self.repeats > 1:
            names.append(f"repeats[{self.repeats}]")
        return (
            f"RunCollection({self._design.name}: {len(self)} runs"
            f"{' of ' * bool(names)}{' x '.join(names)}, {counts})"
        )

    def arrays(
        self, read: Callable[[Run], Mapping[str, Any]] | None = None
    ) -> dict[str, NDArray[Any]]:
        """Collect one number or array of each run.

        Parameters
        ----------
        read : callable, optional
            ``read(run)`` returns a mapping of names to numbers or arrays, which have the same
            shape in every run. By default `Run.result`, which is for functions.

        Returns
        -------
        dict
            For each name an array of shape ``(*shape, ...)``. Runs that are not done are NaN.

        Raises
        ------
        InputError
            If the runs have different names or shapes, or none is done.
        """
        read = Run.result if read is None else check_callable("read", read)
        found: dict[int, dict[str, NDArray[Any]]] = {}
        for run in self:
            if run.state == "done":
                found[run.index] = {name: np.asarray(v) for name, v in read(run).items()}
        if not found:
            raise InputError("arrays: no run is done")
        first = next(iter(found.values()))
        for index, values in found.items():
            shapes = {name: value.shape for name, value in values.items()}
            if shapes != {name: value.shape for name, value in first.items()}:
                raise InputError(f"arrays: run {index} has other names or shapes than the first")
        collected = {}
        for name, value in first.items():
            dtype = np.result_type(*{values[name].dtype for values in found.values()})
            empty: Any = "" if dtype.kind in "US" else np.nan
            if len(found) < len(self) and dtype.kind in "biu":
                dtype = np.dtype(np.float64)
            whole = np.empty((len(self), *value.shape), dtype)
            for index in range(len(self)):
                whole[index] = found[index][name] if index in found else empty
            collected[name] = whole.reshape(*self.shape, *value.shape)
        return collected

    def to_xarray(self, read: Callable[[Run], Mapping[str, Any]] | None = None) -> xarray.Dataset:
        """Collect as `arrays` does, with the parameters as coordinates.

        Parameters
        ----------
        read : callable, optional
            As of `arrays`.

        Returns
        -------
        xarray.Dataset
            Dimensions are the parameters, ``repeat`` (with the seeds), and those of the arrays.

        Raises
        ------
        InputError
            As `arrays`.
        ImportError
            If xarray is missing: ``pip install xarray``.
        """
        with needs("xarray", "xarray is missing: pip install xarray for to_xarray"):
            import xarray
        names = [*self.parameters, "repeat"]
        data = {}
        for name, values in self.arrays(read).items():
            own = [f"{name}_{k}" for k in range(values.ndim - len(names))]
            data[name] = ([*names, *own], values)
        coordinates: dict[str, Any] = {name: list(v) for name, v in self.parameters.items()}
        seeds = [self._design.seed_of(k) for k in range(self.repeats)]
        return xarray.Dataset(data, {**coordinates, "seed": ("repeat", seeds)})
