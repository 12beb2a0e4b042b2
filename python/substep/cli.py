"""The command line: `substep run`, `sweep`, `scenes`, `info`, `render`, `validate` and others.

Exit codes: 0 done; 1 the simulation failed, or the machine did (disk, memory, a missing extra);
2 what was typed or read is wrong; 130 Ctrl-C; 143 SIGTERM; 141 the reader of our output went away.
Each failure is one line on standard error.
"""

from __future__ import annotations

import argparse
import difflib
import os
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, cast

from .base.progress import Progress
from .errors import FormatError, InputError, SolverError, SubstepError

if TYPE_CHECKING:
    from .scenes import Outcome, Parameter, Scene
    from .scenes.run_config import RunConfig
    from .validate import Outcome as Measured
    from .view import Camera

__all__ = ["main"]


def __dir__() -> list[str]:
    return __all__


SEQUENCE = 4  # files beyond which they are told in one line
USAGE, FAILED, INTERRUPTED, PIPE_CLOSED, TERMINATED = 2, 1, 130, 141, 143


class _Failure(Exception):
    """An exit code and the line that explains it."""

    def __init__(self, code: int, line: str) -> None:
        super().__init__(line)
        self.code = code


class _Parser(argparse.ArgumentParser):
    """One-line errors, and the closest word for one that is not known."""

    def __init__(self, **options: Any) -> None:
        super().__init__(allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        raise _Failure(USAGE, f"{message}; see {self.prog} --help")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            known = [str(choice) for choice in action.choices]
            near = difflib.get_close_matches(str(value), known, n=1)
            hint = f"did you mean {near[0]}? " if near else ""
            which = "/".join(action.option_strings)
            told = f"argument {which}: unknown" if which else "unknown command"
            self.error(f"{told} {str(value)[:60]!r}: {hint}known: {', '.join(known)}")


def _folder_name(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("expected the name of a folder, got none")
    return text


def _file_name(text: str) -> Path:
    if not os.path.basename(text):
        told = "a folder" if text else "none"
        raise argparse.ArgumentTypeError(f"expected the name of a file, got {told}")
    return Path(text)


def _parser() -> _Parser:
    from . import __version__  # loads the core

    parser = _Parser(
        prog="substep",
        description="Run simulations, record them and draw them.",
        epilog="Start with: substep scenes",
    )
    parser.add_argument("--version", action="version", version=f"substep {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)

    def command(name: str, text: str) -> _Parser:
        made = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        assert isinstance(made, _Parser)
        made.add_argument(
            "--traceback", action="store_true", help="show where an error arose, for a report"
        )
        return made

    run = command("run", "run a scene into a recording and a picture")
    run.add_argument(
        "scene", nargs="?", metavar="SCENE", help="built-in scene, Python or TOML file"
    )
    run.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="set a parameter (repeatable)",
    )
    run.add_argument("--config", type=Path, metavar="FILE.toml", help="read settings from a file")
    run.add_argument("--frames", metavar="N", help="number of frames, the first state included")
    run.add_argument("--fps", metavar="F", help="frames per unit of the scene's time")
    run.add_argument("--seed", metavar="N", help="seed of random numbers (0)")
    run.add_argument("--threads", metavar="N", help="threads of native loops (all cores)")
    run.add_argument("--out", type=_folder_name, metavar="DIR", help="output folder (runs/SCENE)")
    drawn = run.add_mutually_exclusive_group()
    drawn.add_argument("--no-picture", action="store_true", help="leave the picture out")
    drawn.add_argument("--movie", action="store_true", help="make a movie too (MP4, 25 frames/s)")
    mode = run.add_mutually_exclusive_group()
    mode.add_argument("--resume", action="store_true", help="go on with an interrupted run")
    mode.add_argument("--overwrite", action="store_true", help="replace an earlier run")
    run.set_defaults(action=_run)

    sweep = command("sweep", "run a scene for many parameters and seeds, on all cores")
    sweep.add_argument("scene", metavar="SCENE", help="built-in scene, Python or TOML file")
    sweep.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUES",
        help="values of a parameter: A,B,C or FIRST:LAST:COUNT (repeatable)",
    )
    sweep.add_argument("--repeats", metavar="N", help="runs of each combination (1)")
    sweep.add_argument("--seed", metavar="N", help="seed of the first repeat (0)")
    sweep.add_argument("--frames", metavar="N", help="number of frames of each run")
    sweep.add_argument("--fps", metavar="F", help="frames per unit of the scene's time")
    sweep.add_argument("--workers", metavar="N", help="processes (all cores)")
    sweep.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler that runs it instead")
    sweep.add_argument(
        "--out", type=_folder_name, metavar="DIR", help="output folder (sweeps/SCENE)"
    )
    sweep.add_argument(
        "--to",
        choices=["gns", "meshgraphnets"],
        help="write a data set for learned simulators of particles or meshes, in DIR/NAME",
    )
    sweep.add_argument("--bounds", metavar="X0,Y0,X1,Y1", help="walls of the set gns [m]")
    sweep.add_argument("--material", metavar="KEY", help="parameter that gns has for each particle")
    sweep.set_defaults(action=_sweep)

    scenes = command("scenes", "list the scenes and their parameters")
    scenes.add_argument("scene", nargs="?", metavar="SCENE", help="only this one")
    scenes.set_defaults(action=_scenes)

    info = command("info", "say what a recording holds")
    info.add_argument("file", type=Path, metavar="FILE")
    info.set_defaults(action=_info)

    render = command("render", "draw a recording as a picture (PNG) or a movie (MP4)")
    render.add_argument("file", type=Path, metavar="FILE")
    render.add_argument(
        "--out", type=_file_name, metavar="FILE.png|FILE.mp4", help="beside FILE unless given"
    )
    render.add_argument("--frame", metavar="I", help="frame of the picture, from 0; -1 is the last")
    render.add_argument("--fps", metavar="F", help="frames per second of the movie (25)")
    render.add_argument("--scene", metavar="FILE.py", help="Python file of the recording's scene")
    render.add_argument(
        "--camera",
        metavar="A,E[,D]",
        help="in 3D: azimuth and elevation [degrees], distance (1 shows everything)",
    )
    render.add_argument("--color", metavar="FIELD", help="in 3D: field to colour by")
    render.add_argument("--size", metavar="WxH", help="pixels (1440x810, of a movie 960x540)")
    render.add_argument("--engine", metavar="vtk|cycles", help="in 3D: cycles traces light (vtk)")
    render.add_argument("--samples", metavar="N", help="rays for each pixel of cycles (64)")
    render.set_defaults(action=_render)

    view = command("view", "look at a recording in the browser")
    view.add_argument("file", type=Path, metavar="FILE")
    view.add_argument("--color", metavar="FIELD", help="field to colour by, at first")
    view.add_argument("--port", metavar="N", type=int, default=8080, help="where to serve (8080)")
    view.add_argument("--no-browser", action="store_true", help="print the address alone")
    view.set_defaults(action=_view)

    export = command("export", "write a recording as VTKHDF, USD, a page, arrays, tables or meshes")
    export.add_argument("file", type=Path, metavar="FILE")
    export.add_argument(
        "--out",
        type=_file_name,
        metavar="FILE.SUFFIX",
        help="vtkhdf (beside FILE unless given), usd, usda, abc, glb, vdb, html, npz, csv, ply, "
        "obj or vtu",
    )
    export.add_argument(
        "--liquid",
        action="append",
        default=[],
        metavar="PART=RADIUS",
        help="write the surface of a liquid, of particles twice RADIUS [m] apart (repeatable)",
    )
    export.set_defaults(action=_export)

    validate = command("validate", "measure published figures anew, and write a page of them")
    validate.add_argument("--quick", action="store_true", help="only what takes seconds")
    validate.add_argument("--method", metavar="METHOD", help="only that of one method")
    validate.add_argument(
        "--out",
        type=_file_name,
        default=Path("validation.html"),
        metavar="FILE.html",
        help="the page",
    )
    validate.set_defaults(action=_validate)

    config = command("config", "print version, instruction level, threads and libraries")
    config.set_defaults(action=_config)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line and return its exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        The arguments; those of the process by default.

    Returns
    -------
    int
        The exit code.

    Raises
    ------
    Exception
        What went wrong, where `--traceback` is given; the exit code tells otherwise.

    Examples
    --------
    >>> from substep.cli import main
    >>> main(["--version"])
    substep ...
    0
    """
    arguments = None
    try:
        arguments = _parser().parse_args(argv)
        try:
            arguments.action(arguments)
        finally:
            sys.stdout.flush()
        return 0
    except SystemExit as stop:  # --help and --version
        return stop.code if isinstance(stop.code, int) else 0
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the interpreter flushes stdout once more
        return PIPE_CLOSED
    except KeyboardInterrupt as stop:
        terminated = type(stop).__name__ == "Terminated"
        _complain(str(stop) or "interrupted")
        return TERMINATED if terminated else INTERRUPTED
    except Exception as error:
        if getattr(arguments, "traceback", False):
            raise
        code, line = _judge(error)
        if code is None:
            raise
        _complain(line)
        return code


def _complain(line: str) -> None:
    """One line; `substep: ` goes before it unless it begins with a place in a file."""
    text = " ".join(line.split())
    place = re.match(r".+?:\d+:(\d+:)? ", text)
    print(text if place else f"substep: {text}", file=sys.stderr)


def _judge(error: Exception) -> tuple[int | None, str]:
    """Exit code and line for an exception; no code for one that is a bug of ours."""
    line = str(error)
    if isinstance(error, _Failure):
        return error.code, line
    if isinstance(error, (InputError, FormatError)):
        return USAGE, line
    if isinstance(error, SolverError):
        at = f" at time {error.time:g} s" if error.time is not None and "time" not in line else ""
        return FAILED, f"{line}{at}"
    if isinstance(error, FileExistsError) or (
        isinstance(
            error, (FileNotFoundError, IsADirectoryError, NotADirectoryError, PermissionError)
        )
    ):
        return USAGE, _describe_os_error(error)
    if isinstance(error, OSError):
        return FAILED, _describe_os_error(error)
    if isinstance(error, MemoryError):
        return FAILED, f"out of memory{': ' + line if line else ''}"
    if isinstance(error, (ImportError, SubstepError)):
        return FAILED, line
    return None, line


def _describe_os_error(error: OSError) -> str:
    if error.filename is None or error.strerror is None:
        return str(error)
    return f"{error.filename}: {error.strerror}"


def _given(name: str, text: str | None) -> Any:
    """An option that is also a key of the configuration, checked by the same rule."""
    from .scenes.run_config import KEYS

    return None if text is None else KEYS[name].parse(f"--{name}", text)


def _settings(arguments: argparse.Namespace) -> tuple[dict[str, Any], RunConfig | None]:
    """Options over configuration: what is typed wins."""
    from .scenes.run_config import read_config

    config = read_config(arguments.config) if arguments.config is not None else None
    values = dict(config.values) if config is not None else {}
    for name in ("frames", "fps", "threads", "seed"):
        if (given := _given(name, getattr(arguments, name))) is not None:
            values[name] = given
    for name in ("scene", "out"):
        if getattr(arguments, name) is not None:
            values[name] = getattr(arguments, name)
    if "scene" not in values:
        raise _Failure(USAGE, "run: which SCENE? substep scenes lists them")
    return values, config


def _assignments(
    items: Sequence[str], option: str = "--set", form: str = "KEY=VALUE"
) -> dict[str, str]:
    """`key=value` of each --set, or what it is called elsewhere."""
    values: dict[str, str] = {}
    for item in items:
        key, equals, value = item.partition("=")
        if not equals or not key:
            raise InputError(f"{option} {item[:60]}: expected {form}")
        if key in values:
            raise InputError(f"{option} {key}: given twice")
        values[key] = value
    return values


def _run(arguments: argparse.Namespace) -> None:
    from .scenes import load, run
    from .scenes.run import recording_path

    values, config = _settings(arguments)
    scene = load(values["scene"])
    typed = scene.check(_assignments(arguments.set), lambda key: f"--set {key}", parse=True)
    parameters = dict(typed)
    if config is not None:
        written = scene.check(config.parameters, lambda key: config.where(key, "parameters"))
        parameters = {**written, **typed}
    if "threads" in values:
        from . import set_num_threads

        set_num_threads(values["threads"])
    out = Path(values.get("out", f"runs/{scene.name}"))
    bar = Progress(scene.name, scene.time_unit, scene.time_scale)
    recording = recording_path(scene, out)
    try:
        with bar as progress, _explained(values["scene"], recording):
            outcome = run(
                scene,
                parameters,
                out,
                frames=values.get("frames"),
                fps=values.get("fps"),
                seed=values.get("seed"),
                resume=arguments.resume,
                overwrite=arguments.overwrite,
                on_frame=progress,
            )
    except _Failure as failure:
        if isinstance(failure.__cause__, SolverError) and not arguments.no_picture:
            _draw(scene, recording, frame=-1)  # the last state before it
        raise
    _summarize(scene, outcome)
    if not arguments.no_picture:
        _draw(scene, recording, movie=arguments.movie)


def _sweep(arguments: argparse.Namespace) -> None:
    from .scenes import Parameter, load
    from .sweeps import sweep, write_gns, write_meshgraphnets

    for key in ("bounds", "material"):
        if getattr(arguments, key) is not None and arguments.to != "gns":
            raise InputError(f"--{key}: for --to gns only")
    scene = load(arguments.scene)
    parameters = {}
    for key, text in _assignments(arguments.set).items():
        if key not in scene.parameters:
            scene.check({key: text}, lambda key: f"--set {key}")
        parameters[key] = _values(f"--set {key}", scene.parameters[key], text)
    options: dict[str, Any] = {
        name: _given(name, getattr(arguments, name)) for name in ("frames", "fps")
    }
    options["seed"] = _given("seed", arguments.seed) or 0
    for name in ("repeats", "workers"):
        if (text := getattr(arguments, name)) is not None:
            options[name] = Parameter(name, kind=int, minimum=1).parse(f"--{name}", text)
    out = Path(arguments.out or f"sweeps/{scene.name}")
    with Progress(scene.name) as progress:
        runs = sweep(
            arguments.scene,
            parameters,
            out,
            scheduler=arguments.scheduler,
            on_run=progress.ended,
            **options,
        )
    failed = runs.failed
    print(f"{scene.name}: {len(runs)} runs, {len(runs) - len(failed)} done, {len(failed)} failed")
    print(f"sweep: {out}", flush=True)
    for run in failed:
        told = ", ".join(f"{name}={value}" for name, value in run.parameters.items())
        print(f"run {run.index} ({told}{', ' * bool(told)}seed {run.seed}): {run.error}")
    with warnings.catch_warnings(record=True) as told_of:
        warnings.simplefilter("always", UserWarning)
        if arguments.to == "gns":
            bounds = None if arguments.bounds is None else _corners(arguments.bounds)
            folder = write_gns(runs, out / "gns", bounds=bounds, material=arguments.material)
            print(f"data set: {folder}")
        elif arguments.to == "meshgraphnets":
            print(f"data set: {write_meshgraphnets(runs, out / 'meshgraphnets')}")
    for warning in told_of:
        _complain(f"warning: {warning.message}")
    if failed:
        raise _Failure(
            FAILED, f"{len(failed)} of {len(runs)} runs failed; say it again to retry them"
        )


def _corners(text: str) -> list[list[float]]:
    """`x0,y0,x1,y1` or `x0,y0,z0,x1,y1,z1`."""
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (4, 6):
        raise InputError(f"--bounds: expected X0,Y0,X1,Y1 or six numbers, got {text[:60]!r}")
    return [numbers[: len(numbers) // 2], numbers[len(numbers) // 2 :]]


def _values(where: str, parameter: Parameter, text: str) -> list[Any]:
    """`A,B,C` or `FIRST:LAST:COUNT`; of a parameter that is a list itself, one value."""
    if parameter.kind is tuple:
        return [text]
    words = text.split(":")
    if parameter.kind in (int, float) and len(words) == 3:
        import numpy as np

        from .scenes import Parameter

        rules = [parameter, parameter, Parameter("count", kind=int, minimum=2, maximum=1e6)]
        ends = [rule.parse(where, word) for rule, word in zip(rules, words, strict=True)]
        first, last, count = (cast(int, end) for end in ends)
        values = np.linspace(first, last, count).tolist()
        if parameter.kind is int:
            if any(value != round(value) for value in values):
                raise InputError(f"{where}: {text[:60]} meets values between integers")
            values = [round(value) for value in values]
        return values
    return [parameter.parse(where, word) for word in text.split(",")]


@contextmanager
def _explained(scene: str, recording: Path) -> Iterator[None]:
    """Add what the command line can do about a run that failed."""
    from .scenes.catalogue import describe_error

    try:
        yield
    except FileExistsError as error:
        if error.filename != str(recording):
            raise
        line = f"{recording}: there is an earlier run; say --resume, --overwrite or another --out"
        raise _Failure(USAGE, line) from error
    except SolverError as error:
        journal = f"{recording}.journal"
        raise _Failure(FAILED, f"{_judge(error)[1]}; the frames before are in {journal}") from error
    except Exception as error:
        if _judge(error)[0] is None and scene.endswith(".py"):  # a fault of the user's code
            raise _Failure(FAILED, describe_error(error, Path(scene))) from error
        raise


def _summarize(scene: Scene, outcome: Outcome) -> None:
    size = outcome.recording.stat().st_size
    print(
        f"{scene.name}: {outcome.frames} frames, {outcome.simulated / scene.time_scale:g} "
        f"{scene.time_unit}, in {outcome.seconds:.1f} s, {_bytes(size)}"
    )
    if outcome.summary:
        print(outcome.summary)
    print(f"recording: {outcome.recording}", flush=True)


def _draw(scene: Scene, recording: Path, *, frame: int | None = None, movie: bool = False) -> None:
    from .render import save_movie, save_picture

    try:
        out = recording.with_suffix(".png")
        picture = save_picture(recording, out, frame=frame, scene=scene)
        print(f"picture: {picture}", flush=True)
        if movie:
            out = recording.with_suffix(".mp4")
            with Progress(out.name) as progress:
                save_movie(recording, out, scene=scene, on_frame=progress)
            print(f"movie: {out}")
    except ImportError as error:
        print(f"no picture: {error}", file=sys.stderr)


def _bytes(size: float) -> str:
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} GB"


def _scenes(arguments: argparse.Namespace) -> None:
    from .scenes import load, names

    for name in names() if arguments.scene is None else [arguments.scene]:
        scene = load(name)
        print(f"{scene.name}: {scene.doc}")
        width = max(len(key) for key in scene.parameters)
        for key, parameter in scene.parameters.items():
            default = parameter.default
            if isinstance(default, tuple):
                default = ",".join(default)
            shown = "required" if default is None else _plain(default)
            unit = f" {parameter.unit}" if parameter.unit and default is not None else ""
            print(f"    {key:<{width}}  {parameter.doc} ({shown}{unit})")
            if parameter.choices:
                print(f"    {'':<{width}}  {parameter.expected()}")


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def _info(arguments: argparse.Namespace) -> None:
    from .recording import Recording

    with Recording(arguments.file) as recording:
        file = Path(recording.path)  # the journal beside the file that was named, perhaps
        print(f"file        {file} ({_bytes(file.stat().st_size)})")
        print(f"scene       {recording.scene or '-'}, seed {recording.seed}")
        print(f"written by  substep {recording.version}")
        for key, value in recording.parameters.items():
            print(f"parameter   {key} = {', '.join(value) if isinstance(value, list) else value}")
        times = recording.times
        span = f", {times[0]:g} s to {times[-1]:g} s" if len(times) else ""
        print(f"frames      {len(recording)}{span}")
        last = recording.frame(-1) if len(recording) else {}
        for name, part in recording.parts.items():
            rows = last.get(name, {})
            points = f", {len(rows['points'])} points" if "points" in rows else ""
            fields = ", ".join(f"{f} [{unit}]" if unit else f for f, unit in part.fields.items())
            print(f"part        {name}: {part.kind}{points}{'; ' + fields if fields else ''}")


def _render(arguments: argparse.Namespace) -> None:
    from .render import save_movie, save_picture
    from .scenes import Parameter, load

    out = arguments.out or arguments.file.with_suffix(".png")
    suffix = out.suffix.lower()
    if suffix not in (".png", ".mp4"):
        raise InputError(f"--out: expected a file ending in .png or .mp4, got {str(out)[:60]!r}")
    scene = None if arguments.scene is None else load(arguments.scene)
    look: dict[str, Any] = {"scene": scene, "color": arguments.color}
    if arguments.size is not None:
        look["size"] = _size(arguments.size)
    if arguments.engine is not None:
        engines = Parameter("engine", kind=str, choices=("vtk", "cycles"))
        look["engine"] = engines.parse("--engine", arguments.engine)
    if arguments.samples is not None:
        rule = Parameter("samples", kind=int, minimum=1, maximum=1 << 20)
        look["samples"] = rule.parse("--samples", arguments.samples)
    look["camera"] = None if arguments.camera is None else _camera(arguments.camera)
    if suffix == ".png":
        if arguments.fps is not None:
            raise InputError("--fps: a picture has no frame rate; it is for --out FILE.mp4")
        if arguments.frame is not None:
            look["frame"] = Parameter("frame", -1).parse("--frame", arguments.frame)
        print(f"picture: {save_picture(arguments.file, out, **look)}")
    else:
        if arguments.frame is not None:
            raise InputError("--frame: a movie shows every frame; it is for --out FILE.png")
        fps = Parameter("rate", 25.0, above=0, maximum=1000).parse("--fps", arguments.fps or "25")
        assert isinstance(fps, float)
        with Progress(out.name) as progress:
            save_movie(arguments.file, out, fps=fps, on_frame=progress, **look)
        print(f"movie: {out}")


def _size(text: str) -> tuple[int, int]:
    """`WIDTHxHEIGHT`."""
    found = re.fullmatch(r"(\d{1,6})x(\d{1,6})", text)
    if found is None:
        raise InputError(f"--size: expected WIDTHxHEIGHT, got {text[:60]!r}")
    return int(found[1]), int(found[2])


def _camera(text: str) -> Camera:
    """`azimuth,elevation` or `azimuth,elevation,distance`."""
    from .view import Camera

    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3):
        raise InputError(f"--camera: expected AZIMUTH,ELEVATION[,DISTANCE], got {text[:60]!r}")
    try:
        return Camera(*numbers)
    except InputError as error:
        raise InputError(f"--camera: {error}") from None


def _view(arguments: argparse.Namespace) -> None:
    from . import Recording, show

    with Recording(arguments.file) as recording:
        options = {"color": arguments.color, "port": arguments.port, "play": True}
        viewer = show(recording, open_browser=not arguments.no_browser, wait=False, **options)
        print(f"{viewer.url} (Ctrl-C ends it)", flush=True)
        viewer.wait()


def _export(arguments: argparse.Namespace) -> None:
    from .export import pack, save
    from .scenes import Parameter

    if arguments.out is None:
        if arguments.liquid:
            raise InputError("--liquid: is for --out FILE.usdc, .abc or .glb")
        print(f"recording: {pack(arguments.file)}")
    else:
        given = _assignments(arguments.liquid, "--liquid", "PART=RADIUS").items()
        radius = Parameter("radius", kind=float, above=0)
        liquids = {part: radius.parse(f"--liquid {part}", text) for part, text in given}
        written = save(arguments.file, arguments.out, liquids=cast(Any, liquids))
        if len(written) > SEQUENCE:
            print(f"written: {len(written)} files, {written[0]} to {written[-1].name}")
        else:
            print(*(f"written: {path}" for path in written), sep="\n")


def _validate(arguments: argparse.Namespace) -> None:
    from .base.replacing import check_folder
    from .validate import cases, run, write_page
    from .validate.page import number, verdict

    if arguments.out.suffix.lower() != ".html":
        raise InputError(f"--out: expected a file ending in .html, got {str(arguments.out)[:60]!r}")
    try:
        chosen = cases(arguments.method, quick=arguments.quick)
    except InputError as error:
        raise InputError(f"--{error}") from None
    width = max(len(case.name) for case in chosen)

    check_folder(arguments.out)

    def tell(outcome: Measured) -> None:
        case = outcome.case
        measured = "" if outcome.measured is None else number(outcome.measured, case)
        print(
            f"{case.method:<11} {case.name:<{width}}  {number(case.figure, case):>17} "
            f"{measured:>17}  {outcome.off():>9} {outcome.seconds:7.1f} s  {verdict(outcome)}",
            flush=True,
        )

    print(f"{'':<11} {'':<{width}}  {'reference':>17} {'measured':>17}  {'error':>9} {'time':>9}")
    outcomes = run(chosen, tell)
    write_page(outcomes, arguments.out)
    failed = [outcome for outcome in outcomes if not outcome.passed]
    print(f"{len(outcomes)} cases, {len(failed)} failed")
    for outcome in failed:
        print(f"failed: {outcome.case.method}: {outcome.case.name} {outcome.error}".rstrip())
    print(f"page: {arguments.out}", flush=True)
    if failed:
        raise _Failure(FAILED, f"{len(failed)} of {len(outcomes)} cases failed")


def _config(arguments: argparse.Namespace) -> None:
    from . import show_config

    show_config()
