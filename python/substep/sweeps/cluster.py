"""Spreads the runs of a sweep over processes, by Dask."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ..base.checks import check_callable, check_integer, check_path, check_real
from ..base.imports import needs
from ..base.replacing import replace_bytes
from ..errors import InputError
from ..scenes.catalogue import load
from ..scenes.declaration import Scene, shorten
from ..scenes.run import Plan
from .collection import RunCollection
from .design import MOST_RUNS, Design, check_parameters
from .task import BEGUN, FUNCTION, execute, is_done, write_error

_PAUSE, _PATIENCE = 0.005, 2.0  # between looks at runs, and at processes [s]
_STARTS = 20  # of the processes, when their parent ends
_ALONE = 20.0  # without any, as where their server died as it began [s]


def sweep(
    task: str | Path | Callable[..., Mapping[str, Any]],
    parameters: Mapping[str, Any] | None = None,
    out: str | os.PathLike[str] = "sweep",
    *,
    repeats: int = 1,
    seed: int = 0,
    frames: int | None = None,
    fps: float | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    on_run: Callable[[int, int, int], None] | None = None,
) -> RunCollection:
    """Run a scene or a function for every combination of parameters, on all cores.

    Each run has a folder of its own in `out`. A second call with the same arguments goes on where
    the first was stopped, also by ``kill -9``: runs that are done are left as they are, and those
    that failed are tried again. A run that fails is listed with its error and the others go on. The
    bits of a run are those of the same run alone.

    Runs are spread by Dask (``pip install "substep[sweep]"``) over processes of one thread.

    Parameters
    ----------
    task : str, Path or callable
        The name of a scene, the Python file that declares one, or a function that is called with
        the parameters by name, with ``seed=`` as well if it takes that, and returns a mapping of
        names to arrays or numbers. Functions defined in the script or notebook itself serve.
    parameters : mapping, optional
        For each name a number, a text or a sequence of them. Every combination is run.
    out : path-like
        Folder of the sweep; new, empty, or that of the sweep to go on with.
    repeats : int
        Runs for each combination; repeat r has the seed ``seed + r``.
    seed : int
        Seed of the first repeat.
    frames : int, optional
        Frames of each run of a scene, as in `substep.scenes.run`.
    fps : float, optional
        Frame rate of each run of a scene, as in `substep.scenes.run`.
    workers : int, optional
        Processes, as many as there are cores by default.
    scheduler : str, optional
        Address of a Dask scheduler, such as ``"tcp://10.0.0.1:8786"``, whose workers run the sweep
        instead; they need substep and the same folder `out`.
    on_run : callable, optional
        ``on_run(ended, runs, failed)`` is called when a run has ended.

    Returns
    -------
    RunCollection
        All runs, those that failed too.

    Raises
    ------
    InputError
        If an argument is wrong, or `out` holds another sweep.
    ImportError
        If Dask is missing.
    OSError
        If `out` cannot be written, or no process can be started.
    KeyboardInterrupt
        On Ctrl-C; the runs that had ended are kept.

    Examples
    --------
    >>> import math, tempfile
    >>> import substep
    >>> def landing(angle, speed):
    ...     return {"range": speed**2 * math.sin(2 * math.radians(angle)) / 9.81}
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     runs = substep.sweep(landing, {"angle": [30, 45, 60], "speed": 10.0}, folder)
    ...     runs.arrays()["range"].round(2).ravel().tolist()
    [8.83, 10.19, 8.83]
    """
    design, function = _design(task, parameters, repeats, seed, frames, fps)
    workers = (
        len(os.sched_getaffinity(0))
        if workers is None
        else check_integer("workers", workers, minimum=1, maximum=4096)
    )
    if scheduler is not None and not re.fullmatch(r"[a-z]+://[^\s/]+:\d+", str(scheduler)):
        raise InputError(
            f"scheduler: expected an address such as tcp://10.0.0.1:8786, got {shorten(scheduler)}"
        )
    if on_run is not None:
        check_callable("on_run", on_run)
    folder = Path(check_path(out, "out")).absolute()
    with needs("distributed", 'dask is missing: pip install "substep[sweep]" to run sweeps'):
        import distributed  # noqa: F401
    design.write(folder)
    collection = RunCollection(folder)
    left = [k for k in range(len(design)) if not is_done(design.folder(folder, k), design)]
    for k in left:  # deaths count in this sweep
        (design.folder(folder, k) / BEGUN).unlink(missing_ok=True)
    if left:
        digest = "" if function is None else _write_function(folder, function)
        try:
            with _Cluster(scheduler, min(workers, len(left))) as cluster:
                _spread(cluster, folder, design, digest, left, on_run)
        finally:
            with contextlib.suppress(OSError):
                (folder / FUNCTION).unlink(missing_ok=True)
    return collection


def _design(
    task: Any, parameters: Any, repeats: Any, seed: Any, frames: Any, fps: Any
) -> tuple[Design, Callable[..., Any] | None]:
    """What was given, checked."""
    values = check_parameters({} if parameters is None else parameters)
    repeats = check_integer("repeats", repeats, minimum=1, maximum=MOST_RUNS)
    seed = check_integer("seed", seed, minimum=0, maximum=2**63 - 1 - repeats)
    if frames is not None:
        frames = check_integer("frames", frames, minimum=2, maximum=10**9)
    if fps is not None:
        fps = check_real("fps", fps, positive=True)
    if callable(task):
        if frames is not None or fps is not None:
            raise InputError("frames, fps: for scenes only, got a function")
        takes_seed = _check_signature(task, values)
        if repeats > 1 and not takes_seed:
            raise InputError(
                f"repeats: {repeats} runs of a function that takes no seed would be the same"
            )
        name = getattr(task, "__qualname__", type(task).__qualname__)
        options: dict[str, Any] = {"takes_seed": takes_seed}
        design = Design(name, "function", values, repeats, seed, options, name)
    else:
        if not isinstance(task, (str, Path)):
            raise InputError(
                f"task: expected a scene's name or file, or a function, got {type(task).__name__}"
            )
        scene = load(task)
        _check_scene(scene, values, frames, fps)
        where = str(Path(task).absolute()) if str(task).endswith((".py", ".toml")) else str(task)
        options = {"frames": frames, "fps": fps}
        design = Design(where, "scene", values, repeats, seed, options, scene.name)
    design.check_size()
    return design, task if callable(task) else None


def _check_signature(function: Callable[..., Any], values: Mapping[str, Any]) -> bool:
    """Whether the function takes a seed; refuse parameters that it does not take."""
    try:
        signature = inspect.signature(function)
    except ValueError:  # of the interpreter's own
        return False
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    names = {name for name, p in signature.parameters.items() if p.kind in by_name}
    any_name = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in signature.parameters.values())
    takes_seed = any_name or "seed" in names
    try:
        signature.bind(**dict.fromkeys([*values, *(["seed"] if takes_seed else [])]))
    except TypeError as error:
        raise InputError(f"parameters: the function does not take them: {error}") from None
    return takes_seed


def _check_scene(scene: Scene, values: Mapping[str, Any], frames: Any, fps: Any) -> None:
    """Refuse a run before any has begun."""
    first = {name: column[0] for name, column in values.items()}
    for name, column in values.items():
        for value in column:
            scene.check({name: value}, lambda key: f"parameters[{key!r}]")
    complete = scene.complete(scene.check(first))
    for duration in values.get("duration", [complete["duration"]]):
        Plan.of(scene, {**complete, "duration": duration}, frames, fps)


def _write_function(folder: Path, function: Callable[..., Any]) -> str:
    """Write what processes read; return its digest."""
    import cloudpickle

    try:
        data = cloudpickle.dumps(function)
    except Exception as error:
        raise InputError(
            f"task: the function cannot be sent to other processes: {error}"
        ) from error
    replace_bytes(folder / FUNCTION, data)
    return hashlib.sha256(data).hexdigest()


def _spread(
    cluster: _Cluster,
    folder: Path,
    design: Design,
    digest: str,
    left: list[int],
    on_run: Callable[[int, int, int], None] | None,
) -> None:
    """Have the processes do the runs that are left."""
    from distributed import as_completed

    folders = [os.path.abspath(p) for p in sys.path]
    run = functools.partial(execute, str(folder), design, digest, folders)
    futures = cluster.client.map(run, left, pure=False)
    index_of = {future.key: index for future, index in zip(futures, left, strict=True)}
    runs, ended, failed = len(design), len(design) - len(left), 0
    waiting = as_completed(futures, loop=cluster.client.loop, raise_errors=False)
    del futures  # what has ended is let go
    looked = time.monotonic()
    while waiting.count():
        batch = waiting.next_batch(block=False)
        for future in batch:
            path = design.folder(folder, index_of[future.key])
            if future.status == "error":  # its process died, more than once
                path.mkdir(exist_ok=True)
                write_error(path, f"the process died: {future.exception()}")
            ended += 1
            # What it returned may be lost with its process, and so is waited for until there is
            # another one; what is in its folder is not.
            failed += not is_done(path, design)
            if on_run is not None:
                on_run(ended, runs, failed)
        if not batch:
            time.sleep(_PAUSE)
        if time.monotonic() - looked > _PATIENCE:
            cluster.look_after()
            looked = time.monotonic()


class _Cluster:
    """A client of a scheduler: that of the address, or one of our own with its processes."""

    def __init__(self, scheduler: str | None, workers: int) -> None:
        import dask
        from distributed import Client, LocalCluster

        self._own = None
        self._processes: subprocess.Popen[bytes] | None = None
        self._workers, self._starts = workers, 0
        self._exits = contextlib.ExitStack()
        try:
            if scheduler is None:
                # Who dies is counted for each run (task.py); its neighbours are not to blame.
                with dask.config.set({"distributed.scheduler.allowed-failures": MOST_RUNS}):
                    own = LocalCluster(
                        n_workers=0, dashboard_address="127.0.0.1:0", silence_logs="CRITICAL"
                    )
                self._own = self._exits.enter_context(own)
                scheduler = self._own.scheduler_address
                self._scratch = self._exits.enter_context(
                    tempfile.TemporaryDirectory(prefix="substep-sweep-")
                )
                self._exits.callback(self._stop)
                self._start()
            self.client = self._exits.enter_context(Client(scheduler, set_as_default=False))
        except BaseException:
            self._exits.close()
            raise

    def __enter__(self) -> _Cluster:
        return self

    def __exit__(self, *error: Any) -> None:
        self._exits.close()

    def _start(self) -> None:
        """Dask's own command, so that no process runs the caller's script again."""
        assert self._own is not None
        home = str(Path(__file__).resolve().parents[2])
        command = [sys.executable, "-m", "substep.sweeps.processes", self._own.scheduler_address]
        command += ["--nworkers", str(self._workers), "--nthreads", "1", "--memory-limit", "0"]
        command += ["--local-directory", self._scratch, "--no-dashboard", "--death-timeout", "10"]
        path = os.pathsep.join([home, *(os.path.abspath(p) for p in sys.path if p)])
        self._seen = time.monotonic()
        self._log = open(os.path.join(self._scratch, "log"), "w+b")
        self._processes = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stderr=self._log,
            env={**os.environ, "PYTHONPATH": path},
            start_new_session=True,  # Ctrl-C is for us
        )

    def _stop(self) -> None:
        if self._processes is not None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._processes.pid, signal.SIGKILL)
            self._processes.wait()
            self._log.close()

    def look_after(self) -> None:
        """Start the processes again if their parent has ended or has none, but not for ever."""
        if self._processes is None:
            return
        assert self._own is not None
        if self._own.scheduler.workers:
            self._seen = time.monotonic()
        if self._processes.poll() is not None or time.monotonic() - self._seen > _ALONE:
            self._starts += 1
            if self._starts > _STARTS:
                with open(self._log.name, errors="replace") as log:
                    told = (log.read().strip().splitlines() or ["no reason was given"])[-1]
                raise OSError(f"the processes of the sweep end as soon as they begin: {told}")
            self._stop()
            self._start()
