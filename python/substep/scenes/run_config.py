"""Reading the TOML file of `substep run --config`: every fault is told with its line and column."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import FormatError, InputError
from .declaration import Parameter, closest, shorten

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# A configuration is written by hand. TOML readers take quadratic time for long dotted keys.
SIZE_LIMIT = 1 << 16  # bytes
LINE_LIMIT = 1 << 12  # bytes
_TRIALS = 200  # readings of the text to find a key's place; then the place is not told
KEYS = {
    "scene": Parameter(
        "built-in scene, or a Python or TOML file below this one's folder", kind=str
    ),
    "frames": Parameter("number of frames, the first state included", kind=int, minimum=2),
    "fps": Parameter("frames per unit of the scene's time", kind=float, above=0),
    "out": Parameter("output folder below the current one", kind=str),
    "threads": Parameter("threads of native loops", kind=int, minimum=1, maximum=1024),
    "seed": Parameter("seed of random numbers", kind=int, minimum=0, maximum=2**63 - 1),
}
_DEVICES = {
    "con",
    "prn",
    "aux",
    "nul",
    *(f"{port}{i}" for port in ("com", "lpt") for i in range(10)),
}


@dataclass(frozen=True)
class RunConfig:
    """The checked content of a configuration; `parameters` are checked by the scene."""

    path: Path
    text: str
    values: dict[str, Any] = field(default_factory=dict)
    parameters: dict[str, Any] = field(default_factory=dict)

    def where(self, key: str, table: str | None = None) -> str:
        """`file:line:column: key`, the place of the key in the text."""
        line, column = _locate(self.text, key, table)
        return f"{self.path}:{line}:{column}: {printable(key)}"


def read_config(path: str | Path) -> RunConfig:
    """Read and check a configuration.

    Raises
    ------
    FormatError
        If the file is not TOML in UTF-8, too long or nested too deeply.
    InputError
        If it holds an unknown key or a wrong value.
    OSError
        If it cannot be read.
    """
    path = Path(path)
    with open(path, "rb") as file:
        data = file.read(SIZE_LIMIT + 1)
    text = decode(path, data)
    document = parse(path, text)
    config = RunConfig(path, text)
    for key, value in document.items():
        if key == "parameters":
            if not isinstance(value, dict):
                raise InputError(
                    f"{config.where(key)}: expected a table, got {type(value).__name__}"
                )
            config.parameters.update(value)
        elif key in KEYS:
            config.values[key] = KEYS[key].check(config.where(key), value)
        else:
            known = closest(key, [*KEYS, "parameters"])
            raise InputError(f"{config.where(key)}: unknown key; {known}")
    for key in ("scene", "out"):
        if key in config.values:
            confine(config.where(key), config.values[key])
    return config


def printable(key: str) -> str:
    """A key in one line: quoted keys may hold line ends, and what drives a terminal."""
    return shorten(key) if not key.isprintable() or len(key) > 60 else key


def confine(where: str, name: str, folder: str | Path = ".") -> None:
    """Refuse a path that leaves the folder it starts from, or that some system cannot hold."""
    parts = PurePosixPath(name.replace("\\", "/")).parts
    if not parts or name[0] in "/\\" or ".." in parts or ":" in name:
        raise InputError(f"{where}: expected a path inside the folder, got {name[:60]!r}")
    for part in parts:
        if (
            len(part.encode()) > 255
            or part.split(".")[0].lower() in _DEVICES
            or not part.isprintable()
        ):
            raise InputError(f"{where}: not a usable file name: {part[:60]!r}")
    if len(name) > 1024:
        raise InputError(f"{where}: a path of {len(name)} characters; at most 1024 are accepted")
    if not Path(folder, name).resolve().is_relative_to(Path(folder).resolve()):
        raise InputError(f"{where}: a link leads out of the folder: {name[:60]!r}")


def decode(path: Path, data: bytes) -> str:
    """The text of a file, or a FormatError that says why it is none."""
    if len(data) > SIZE_LIMIT:
        raise FormatError(f"{path}:1:1: file: longer than {SIZE_LIMIT} bytes; not a configuration")
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise FormatError(f"{path}:1:1: file: UTF-16 text; save it as UTF-8")
    if data.startswith(b"\xef\xbb\xbf"):
        raise FormatError(f"{path}:1:1: file: starts with a byte order mark; save it without")
    for number, content in enumerate(data.split(b"\n"), 1):
        if len(content) > LINE_LIMIT:
            raise FormatError(f"{path}:{number}:1: file: a line longer than {LINE_LIMIT} bytes")
    nul = data.find(b"\0")
    if nul >= 0:
        line, column = _line_column(data[:nul].decode("utf-8", "replace"))
        raise FormatError(f"{path}:{line}:{column}: file: holds a NUL byte; not a text")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        line, column = _line_column(data[: error.start].decode("utf-8", "replace"))
        raise FormatError(f"{path}:{line}:{column}: file: not UTF-8 text") from None


def parse(path: Path, text: str) -> dict[str, Any]:
    """The document, or a FormatError that tells the place of the fault."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        reason = str(error)
        found = re.search(r" \(at (?:line (\d+), column (\d+)|end of document)\)", reason)
        line, column = _line_column(text)
        if found and found[1]:
            line, column = int(found[1]), int(found[2])
        reason = reason[: found.start()] if found else reason
        told = "".join(text.split("\n")[line - 1 : line])
        key = re.match(r"\s*([A-Za-z0-9_.\"'-]+)\s*=", told)
        raise FormatError(
            f"{path}:{line}:{column}: {key[1] if key else 'file'}: {reason}"
        ) from None
    except RecursionError:
        raise FormatError(f"{path}:1:1: file: nested too deeply") from None
    except ValueError as error:  # an integer of more digits than int() takes
        raise FormatError(f"{path}:1:1: file: {str(error).split(';')[0]}") from None


def _line_column(before: str) -> tuple[int, int]:
    """Line and column, from 1, of what follows the text."""
    return before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1


def _locate(text: str, key: str, table: str | None) -> tuple[int, int]:
    """Line and column of a key of the top level or of a table; of the document if it is not found.

    A key stands on the first line that mentions it and with which the document, read up to there,
    comes to hold it: so mentions in comments, texts and other tables do not count.
    """
    lines = text.splitlines(keepends=True)
    mention = re.compile(rf"(?<![\w-])[\"']?{re.escape(key)}[\"']?(?=\s*[\].=])")
    trials = 0
    for number, line in enumerate(lines):
        found = mention.search(line)
        if found is None or _holds(lines[:number], key, table) is not False:
            trials += found is not None
        else:
            for end in range(number + 1, len(lines) + 1):  # a value may span lines
                holds = _holds(lines[:end], key, table)
                if holds:
                    return number + 1, found.start() + 1
                trials += 1
                if holds is False or trials > _TRIALS:
                    break
        if trials > _TRIALS:
            break
    return 1, 1


def _holds(lines: list[str], key: str, table: str | None) -> bool | None:
    """Whether the document holds the key; None where it is no document."""
    try:
        document = tomllib.loads("".join(lines))
    except (ValueError, RecursionError):
        return None
    inside = document if table is None else document.get(table)
    return isinstance(inside, dict) and key in inside
