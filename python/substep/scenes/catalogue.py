"""The scenes there are: the built-in ones by name, others by the file that declares them."""

from __future__ import annotations

import importlib
import importlib.util
import sys
import traceback
from pathlib import Path

from ..errors import InputError
from .declaration import Scene, closest

BUILT_IN = {  # and the folder that each is in
    "box-stack": "rigid",
    "bunny-snow": "mpm",
    "card-house": "rigid",
    "cavity": "gridfluid",
    "cloth-ball": "pbd",
    "cloth-drape": "springs",
    "cloth-hang": "springs",
    "cradle": "rigid",
    "crater": "coupling",
    "dam-break": "pbf",
    "dominoes": "rigid",
    "double-dam": "pbf",
    "double-gyre": "fields",
    "float": "coupling",
    "fountain": "pbf",
    "hammock": "coupling",
    "honey": "gridfluid",
    "jelly": "springs",
    "jelly-bath": "coupling",
    "jelly-cubes": "mpm",
    "karman": "gridfluid",
    "kepler": "ode",
    "mud-slump": "mpm",
    "ocean-drift": "fields",
    "oscillator": "ode",
    "pile": "rigid",
    "pyramid": "rigid",
    "ragdolls": "rigid",
    "rope": "pbd",
    "rover": "rigid",
    "sand-column": "mpm",
    "sand-wheels": "coupling",
    "smoke": "gridfluid",
    "snowball": "mpm",
    "soft-bunny": "pbd",
    "tumbling-top": "rigid",
    "water-column": "gridfluid",
    "water-wheel": "coupling",
}


class SceneFileError(InputError):
    """A scene file failed on its own account; `__cause__` is its exception."""


def names() -> tuple[str, ...]:
    """Names of the built-in scenes.

    Returns
    -------
    tuple of str
        In alphabetical order.

    Examples
    --------
    >>> import substep
    >>> "kepler" in substep.scenes.names()
    True
    """
    return tuple(BUILT_IN)


def load(scene: str | Path) -> Scene:
    """Find a scene by its name or in a file.

    A Python file declares its scene by one `Scene` among its module's names. Loading executes it.
    A TOML file says what there is: blocks of particles, obstacles, bodies.

    Parameters
    ----------
    scene : str or Path
        Name of a built-in scene, or path of a file ending in `.py` or `.toml`.

    Returns
    -------
    Scene
        The declaration.

    Raises
    ------
    InputError
        If there is no such scene, the Python file does not declare exactly one, or the TOML file
        has an unknown key or a wrong value.
    FormatError
        If a TOML file is not one.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> import substep
    >>> substep.scenes.load("oscillator").name
    'oscillator'
    """
    text = str(scene)
    if text in BUILT_IN:
        module = importlib.import_module(f".{BUILT_IN[text]}.{text.replace('-', '_')}", __package__)
        found: Scene = module.SCENE
        return found
    if text.endswith(".py"):
        return _load_file(Path(text))
    if text.endswith(".toml"):
        from .assembly import read_scene

        return read_scene(Path(text))
    raise InputError(
        f"scene: {text[:60]!r} is neither a built-in scene nor a file ending in .py or .toml; "
        + closest(text, BUILT_IN)
    )


def _load_file(path: Path) -> Scene:
    code = path.read_bytes()  # an OSError names the path
    name = f"substep_scene_{path.stem}"
    spec = importlib.util.spec_from_loader(name, loader=None, origin=str(path))
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    module.__file__ = str(path)
    sys.modules[name] = module  # dataclasses and pickles look their module up
    try:
        exec(compile(code, str(path), "exec"), module.__dict__)
    except Exception as error:
        del sys.modules[name]
        raise SceneFileError(describe_error(error, path)) from error
    scenes = {id(value): value for value in vars(module).values() if isinstance(value, Scene)}
    if len(scenes) != 1:
        raise InputError(f"{path}: expected one substep.scenes.Scene, found {len(scenes)}")
    return next(iter(scenes.values()))


def describe_error(error: BaseException, path: Path) -> str:
    """`file:line: kind: text` of an exception that a scene file raised."""
    line: int | None = None
    if isinstance(error, SyntaxError) and error.filename == str(path):
        line, text = error.lineno, error.msg
    else:
        for frame in traceback.extract_tb(error.__traceback__):
            line = frame.lineno if frame.filename == str(path) else line
        text = str(error)
    first = (text.splitlines() or [""])[0]
    return f"{path}:{line or 1}: {type(error).__name__}: {first}"
