"""Running a scene: frames into a recording, checkpoints beside it, and going on after a stop.

A run leaves three files in its folder while it goes on: the journal of the recording, and a
checkpoint of the simulation at one of the recorded frames. To resume is to load the checkpoint, to
compute again the frames between it and the journal's end, to compare the last of them with the
journal, and to go on: as simulations are deterministic, the end is that of a run without a stop.
"""

from __future__ import annotations

import errno
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.checks import check_integer, check_real
from ..errors import InputError
from .catalogue import load
from .declaration import Scene, Simulation

if TYPE_CHECKING:
    from ..recording import Recording

CHECKPOINT_INTERVAL = 10.0  # seconds of wall-clock time


class Terminated(KeyboardInterrupt):
    """SIGTERM came; the run stopped as it does on Ctrl-C."""


@dataclass(frozen=True)
class Plan:
    """Frame times of a run.

    Parameters
    ----------
    frames : int
        Their number, the first state included.
    interval : float
        Time between two of them [s].

    Examples
    --------
    >>> import substep
    >>> scene = substep.scenes.load("double-gyre")
    >>> substep.scenes.Plan.of(scene, {"duration": 10.0}, frames=6)
    Plan(frames=6, interval=2.0)
    """

    frames: int
    interval: float

    @classmethod
    def of(
        cls,
        scene: Scene,
        parameters: Mapping[str, Any],
        frames: int | None = None,
        fps: float | None = None,
    ) -> Plan:
        """Two of duration, frames and frame rate give the third.

        Parameters
        ----------
        scene : Scene
            Its `frames` are the default.
        parameters : mapping
            Its `duration`, in the scene's unit of time, is what `frames` are spread over and `fps`
            fills; both together override it.
        frames : int, optional
            Number of frames, the first state included.
        fps : float, optional
            Frames per unit of the scene's time.

        Returns
        -------
        Plan
            The frame times.

        Raises
        ------
        InputError
            If that makes fewer than 2 frames or more than 1e9.
        """
        duration = parameters["duration"]
        if fps is not None:
            interval = 1 / fps
            if frames is None:
                if duration * fps > 1e9:
                    raise InputError(
                        f"fps: {fps:g} for {duration:g} {scene.time_unit} is over 1e9 frames"
                    )
                frames = math.floor(duration * fps * (1 + 1e-12)) + 1
        else:
            frames = scene.frames if frames is None else frames
            interval = duration / max(frames - 1, 1)
        if frames < 2 or not 0 < interval * scene.time_scale < math.inf:
            raise InputError(
                f"frames: expected frames 2 or more, the first state included; {interval:g} "
                f"{scene.time_unit} apart, {duration:g} {scene.time_unit} have {frames}"
            )
        return cls(frames, interval * scene.time_scale)


@dataclass(frozen=True)
class Outcome:
    """What a run left.

    Attributes
    ----------
    recording : Path
        The recording.
    frames : int
        Its frames.
    simulated : float
        Time between the first and the last [s].
    seconds : float
        Wall-clock time spent [s]; 0 where there was nothing left to do.
    summary : str
        How it ended, if the scene has words for it.
    """

    recording: Path
    frames: int
    simulated: float
    seconds: float
    summary: str = ""


def recording_path(scene: Scene, out: str | Path) -> Path:
    """Where the recording of a scene goes."""
    return Path(out) / f"{scene.name}.vtkhdf"


def run(
    scene: Scene | str | Path,
    parameters: Mapping[str, Any] | None = None,
    out: str | Path = ".",
    *,
    frames: int | None = None,
    fps: float | None = None,
    seed: int | None = None,
    resume: bool = False,
    overwrite: bool = False,
    on_frame: Callable[[int, int, float], None] | None = None,
) -> Outcome:
    """Run a scene into a recording in the folder `out`.

    Ctrl-C and SIGTERM stop it after a last checkpoint; the recording is then valid up to the last
    frame and `resume` goes on from there, to the bits of a run without a stop.

    Parameters
    ----------
    scene : Scene, str or Path
        The scene, its name, or the Python file that declares it.
    parameters : mapping, optional
        Those that are not to have their defaults. On resuming, those of the recording are taken.
    out : str or Path
        Folder of the recording, the checkpoint and the journal; made if need be.
    frames : int, optional
        Number of frames, the first state included.
    fps : float, optional
        Frames per unit of the scene's time.
    seed : int, optional
        Seed of the scene's random numbers, 0 unless given.
    resume : bool
        Go on with the run whose journal is in `out`; begin it where there is none.
    overwrite : bool
        Replace what is there.
    on_frame : callable, optional
        `on_frame(frame, frames, time)` is called after each frame.

    Returns
    -------
    Outcome
        Path of the recording and figures of the run.

    Raises
    ------
    InputError
        If the scene refuses its parameters, or what is to be resumed is another run.
    FileExistsError
        If there is a recording and neither `resume` nor `overwrite` is given.
    SolverError
        If the simulation fails; the recording holds the frames before.
    KeyboardInterrupt
        On Ctrl-C, and, as its subclass `Terminated`, on SIGTERM.

    Examples
    --------
    >>> import substep, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     outcome = substep.scenes.run("double-gyre", {"particles": 100}, folder, frames=3)
    >>> outcome.frames, outcome.recording.name
    (3, 'double-gyre.vtkhdf')
    """
    from ..recording import Recorder, Recording

    begun = time.monotonic()
    if not isinstance(scene, Scene):
        scene = load(scene)
    path = recording_path(scene, out)
    given = scene.check(parameters or {})
    journal = Path(f"{path}.journal")
    exists = path.exists() or journal.exists()
    if exists and not (resume or overwrite):
        raise FileExistsError(errno.EEXIST, "exists; resume it or overwrite it", str(path))
    recorded, last = 0, None
    if exists and resume:
        with Recording(path) as recording:
            complete, plan, seed = _continued(scene, recording, given, frames, fps, seed)
            recorded = len(recording)
            last = recording.frame(-1) if recorded else None
        if not journal.exists():
            return Outcome(path, recorded, (recorded - 1) * plan.interval, 0.0)
    else:
        complete = scene.complete(given)
        plan = Plan.of(scene, complete, frames, fps)
        seed = 0 if seed is None else check_integer("seed", seed, minimum=0)
    simulation = scene.build(complete, seed)
    made = not Path(out).exists()
    Path(out).mkdir(parents=True, exist_ok=True)
    start, first = simulation.time, 0
    checkpoint = _Checkpoint(path.with_suffix(".checkpoint"))
    if recorded and checkpoint.exists():
        try:
            checkpoint.load(simulation)
            first = round((simulation.time - start) / plan.interval)
        except Exception:
            first = -1
        if not 0 <= first < recorded:  # damaged, not of this run, or beyond what the journal holds
            simulation, first = scene.build(complete, seed), 0
    if not recorded:
        checkpoint.remove()
    about: dict[str, Any] = {"frames": plan.frames, "interval": plan.interval}
    about["notes"] = scene.notes(simulation)
    recorder = Recorder(
        path,
        parts=scene.parts(simulation),
        scene=scene.name,
        parameters={**complete, **about},
        seed=seed,
        overwrite=overwrite,
        resume=resume,
    )
    with _Signals() as signals, recorder:
        try:
            for frame in range(first, plan.frames):
                if frame > first:
                    with signals.at_once():
                        simulation.advance(start + frame * plan.interval - simulation.time)
                arrays = scene.frame(simulation)
                if frame >= recorded:
                    recorder.append(simulation.time, arrays)
                elif last is not None and frame == recorded - 1 and not _same(arrays, last):
                    raise InputError(
                        f"{journal}: frame {frame} is different now: other data, or "
                        "another substep or instruction level; run it anew with overwrite"
                    )
                checkpoint.hold(simulation)
                if on_frame is not None:
                    on_frame(frame, plan.frames, simulation.time)
                signals.check()
            with signals.at_once():
                recorder.close()
        except InputError:  # what the simulation refuses at its first step was wrong from the start
            if len(recorder) < 2 and not recorded:
                journal.unlink(missing_ok=True)
                if made:
                    Path(out).rmdir()
            raise
        except KeyboardInterrupt as stop:
            checkpoint.save_held(simulation)
            raise type(stop)(
                f"stopped with {len(recorder)} of {plan.frames} frames recorded; "
                "--resume goes on from there"
            ) from None
    checkpoint.remove()
    seconds = time.monotonic() - begun
    simulated = (plan.frames - 1) * plan.interval
    return Outcome(path, plan.frames, simulated, seconds, scene.summary(simulation))


def _continued(
    scene: Scene,
    recording: Recording,
    given: Mapping[str, Any],
    frames: int | None,
    fps: float | None,
    seed: int | None,
) -> tuple[dict[str, Any], Plan, int]:
    """Parameters, plan and seed of the recording; what is given again must be the same."""
    where = f"resume: {recording.path}"
    if recording.scene != scene.name:
        raise InputError(f"{where} is of the scene {recording.scene!r}, not {scene.name}")
    stored = dict(recording.parameters)
    try:
        plan = Plan(
            check_integer("frames", stored.pop("frames"), minimum=2),
            check_real("interval", stored.pop("interval"), positive=True),
        )
        stored.pop("notes", None)
    except (KeyError, InputError, TypeError) as error:
        raise InputError(f"{where} was not written by a run: {error}") from None
    complete = scene.complete(scene.check(stored, lambda key: f"{where}: {key}"))
    wanted = {
        **{key: (value, complete[key]) for key, value in given.items()},
        "frames": (frames, plan.frames),
        "fps": (fps, scene.time_scale / plan.interval),
        "seed": (seed, recording.seed),
    }
    for key, (now, then) in wanted.items():
        if now is not None and (abs(now - then) > 1e-9 * then if key == "fps" else now != then):
            raise InputError(f"{key}: the run to resume has {then}, got {now}; leave it out")
    return complete, plan, recording.seed


def _same(arrays: Mapping[str, Any], recorded: Mapping[str, Any]) -> bool:
    """Whether a frame holds the bits that were recorded (in the recording's own precision)."""
    for part, columns in arrays.items():  # parts that never move are not among them
        for name, values in columns.items():
            old = recorded[part][name]
            new = np.asarray(values).astype(old.dtype)
            if new.shape != old.shape or new.tobytes() != old.tobytes():
                return False
    return True


class _Checkpoint:
    """The simulation's state at the last frame: held in memory, on disk every few seconds."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._held: Any = None
        self._saved = time.monotonic()

    def hold(self, simulation: Simulation) -> None:
        """Take the state of a frame that is recorded."""
        self._held = simulation.state()
        if time.monotonic() - self._saved > CHECKPOINT_INTERVAL:
            self._save(simulation)

    def save_held(self, simulation: Simulation) -> None:
        """Go back to the last frame and write its state."""
        if self._held is not None:
            simulation.restore(self._held)
            self._save(simulation)

    def _save(self, simulation: Simulation) -> None:
        part = self._path.with_name(self._path.name + ".part")
        part.unlink(missing_ok=True)
        simulation.save(part)
        with open(part, "rb") as file:
            os.fsync(file.fileno())
        os.replace(part, self._path)
        self._saved = time.monotonic()

    def exists(self) -> bool:
        """Whether there is one on disk."""
        return self._path.exists()

    def load(self, simulation: Simulation) -> None:
        """Read the state."""
        simulation.load(self._path)

    def remove(self) -> None:
        """Remove the file."""
        self._path.unlink(missing_ok=True)


class _Signals:
    """SIGINT and SIGTERM raise at once within `at_once`, elsewhere at the next `check`."""

    def __init__(self) -> None:
        self._received: type[KeyboardInterrupt] | None = None
        self._immediate = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> _Signals:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._receive)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        self._received = Terminated if number == signal.SIGTERM else KeyboardInterrupt
        if self._immediate:
            raise self._received

    def check(self) -> None:
        """Raise if a signal came."""
        if self._received is not None:
            raise self._received

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Let signals interrupt what is done here."""
        self._immediate = True
        try:
            self.check()
            yield
        finally:
            self._immediate = False
