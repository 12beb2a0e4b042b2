"""Which runs a sweep has, and where each one leaves its results."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base.checks import check_integer
from ..base.reading import load_json
from ..base.replacing import replace_bytes
from ..errors import FormatError, InputError
from ..scenes.declaration import shorten

Value = bool | int | float | str
MOST_RUNS = 1_000_000
FILE = "sweep.json"


@dataclass(frozen=True)
class Design:
    """Every combination of the values of all parameters, each `repeats` times with other seeds.

    Runs are numbered with the repeats innermost, then the last parameter.
    """

    task: str  # the scene, or the name of the function
    kind: str  # "scene" or "function"
    parameters: Mapping[str, tuple[Value, ...]]
    repeats: int
    seed: int
    options: Mapping[str, Any]  # frames and fps of a scene; whether a function takes a seed
    name: str  # of a scene's recordings

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of each parameter, and of repeats."""
        return (*(len(values) for values in self.parameters.values()), self.repeats)

    def __len__(self) -> int:
        return math.prod(self.shape)

    def check_size(self) -> None:
        """Refuse too many runs."""
        if math.prod(self.shape) > MOST_RUNS:
            raise InputError(
                f"parameters: expected at most {MOST_RUNS} runs, got {math.prod(self.shape)}"
            )

    def folder(self, out: Path, index: int) -> Path:
        """Of a run."""
        return out / f"{index:0{len(str(len(self) - 1))}d}"

    def values(self, index: int) -> dict[str, Value]:
        """Parameters of a run."""
        place = np.unravel_index(index, self.shape)
        return {
            name: values[int(i)]
            for (name, values), i in zip(self.parameters.items(), place, strict=False)
        }

    def seed_of(self, index: int) -> int:
        """Seed of a run: that of the sweep, plus the number of the repeat."""
        return self.seed + index % self.repeats

    def write(self, out: Path) -> None:
        """Write it into the folder, or find the same one there."""
        content = {
            "task": self.task,
            "kind": self.kind,
            "parameters": {name: list(values) for name, values in self.parameters.items()},
            "repeats": self.repeats,
            "seed": self.seed,
            "options": dict(self.options),
            "name": self.name,
        }
        if (out / FILE).exists():
            there = _read(out)
            for key, value in content.items():
                if there.get(key) != value:
                    had, got = str(there.get(key))[:60], str(value)[:60]
                    raise InputError(
                        f"{key}: the sweep in {out} has {had}, got {got}; choose another folder"
                    )
            return
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise InputError(f"out: expected a folder that is empty or of a sweep, got {out}")
        replace_bytes(out / FILE, json.dumps(content, indent=1).encode())

    @classmethod
    def read(cls, out: Path) -> Design:
        """Of the sweep in a folder."""
        content = _read(out)
        try:
            found = cls(
                str(content["task"]),
                str(content["kind"]),
                check_parameters(content["parameters"]),
                check_integer("repeats", content["repeats"], minimum=1, maximum=MOST_RUNS),
                check_integer("seed", content["seed"], minimum=0),
                dict(content["options"]),
                str(content["name"]),
            )
            found.check_size()
            return found
        except (InputError, KeyError, TypeError, ValueError) as error:
            raise FormatError(f"{out / FILE}: not of a sweep: {error}") from None


def _read(out: Path) -> dict[str, Any]:
    path = out / FILE
    content = load_json(path.read_bytes(), str(path))
    if not isinstance(content, dict):
        raise FormatError(f"{path}: not of a sweep")
    return content


def check_parameters(parameters: Any) -> dict[str, tuple[Value, ...]]:
    """Return the values of each parameter, in Python's own types.

    Raises
    ------
    InputError
        If they are no mapping of names to numbers, texts, or sequences of such.
    """
    if not isinstance(parameters, Mapping):
        raise InputError(f"parameters: expected a mapping, got {type(parameters).__name__}")
    checked = {}
    for name, given in parameters.items():
        if not (isinstance(name, str) and name.isidentifier()):
            raise InputError(f"parameters: expected names as keys, got {shorten(name)}")
        if name == "seed":
            raise InputError("parameters: seeds are set by seed and repeats, got the name 'seed'")
        if isinstance(given, np.ndarray):
            given = given.tolist()
        listed = isinstance(given, Sequence) and not isinstance(given, (str, bytes, bytearray))
        values = given if listed else [given]
        if len(values) > MOST_RUNS:
            raise InputError(f"parameters[{name!r}]: expected at most {MOST_RUNS} values")
        if not values:
            raise InputError(f"parameters[{name!r}]: expected at least one value, got none")
        checked[name] = tuple(_plain(f"parameters[{name!r}]", value) for value in values)
    return checked


def _plain(where: str, value: Any) -> Value:
    if isinstance(value, np.generic):
        value = value.item()
    if not isinstance(value, (bool, int, float, str)):
        raise InputError(f"{where}: expected numbers, texts or booleans, got {shorten(value)}")
    if isinstance(value, int) and abs(value) >= 2**63:
        raise InputError(f"{where}: expected integers of 64 bits, got a larger one")
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError(f"{where}: expected finite numbers, got {value}")
    return value
