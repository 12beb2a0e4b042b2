"""Scenes in TOML files: a small closed schema, whose faults are told with their place."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..mpm import FixedCorotated, Fluid, HerschelBulkley, NeoHookean, Sand, Snow, VonMises
from .declaration import Parameter, closest, shorten
from .run_config import SIZE_LIMIT, decode, parse, printable

MATERIALS = {
    cls.__name__: cls
    for cls in (FixedCorotated, Fluid, HerschelBulkley, NeoHookean, Sand, Snow, VonMises)
}
METHODS = ("pbf", "grid-liquid", "mpm", "rigid")


@dataclass(frozen=True)
class Vector:
    """Several numbers in a list, none greater than `most`."""

    count: int
    most: float | None = None

    def check(self, where: str, value: Any) -> tuple[float, ...]:
        """Return them as floats, or raise as `Parameter.check` does."""
        least = None if self.most is None else -self.most
        number = Parameter("", kind=float, minimum=least, maximum=self.most)
        if not isinstance(value, list) or len(value) != self.count:
            raise InputError(f"{where}: expected {self.count} numbers, got {shorten(value)}")
        return tuple(float(number.check(where, x)) for x in value)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Box:
    """Two corners."""

    def check(self, where: str, value: Any) -> tuple[tuple[float, ...], ...]:
        """Return them, or raise as `Parameter.check` does."""
        if not isinstance(value, list) or len(value) != 2:
            raise InputError(f"{where}: expected two corners, got {shorten(value)}")
        low, high = (Vector(3).check(where, corner) for corner in value)
        if not all(a < b for a, b in zip(low, high, strict=True)):
            raise InputError(f"{where}: expected the lowest corner first, got {value}")
        return low, high


Rule = Parameter | Vector | Box


def _text(doc: str) -> Parameter:
    return Parameter(doc, kind=str)


def _above(doc: str) -> Parameter:
    return Parameter(doc, kind=float, above=0)


def _least(doc: str) -> Parameter:
    return Parameter(doc, kind=float, minimum=0)


SCENE: dict[str, Rule] = {
    "name": _text("of the scene; that of the file unless given"),
    "doc": _text("what it shows, in one line"),
    "method": Parameter("method of the particles", kind=str, choices=METHODS),
    "duration": _above("time simulated [s]"),
    "frames": Parameter("number of frames", kind=int, minimum=2),
    "spacing": _above("of the particles [m]"),
    "bounds": Box(),
    "gravity": Vector(3),
}
_LIQUID: dict[str, Rule] = {
    "density": _above("[kg/m^3]"),
    "viscosity": _least("[m^2/s]"),
    "surface_tension": _least("[N/m]"),
    "cfl": _above("[1]"),
}
OPTIONS: dict[str, dict[str, Rule]] = {
    "pbf": {**_LIQUID, "divergence_free": Parameter("", kind=bool), "xsph": _least("")},
    "grid-liquid": {
        **_LIQUID,
        "slip": Parameter("", kind=bool),
        "transfer": Parameter("", kind=str, choices=("apic", "flip", "pic")),
    },
    "mpm": {"cfl": _above("[1]")},
    "rigid": {},
}
_MOTION: dict[str, Rule] = {"velocity": Vector(3), "angular_velocity": Vector(3)}
_SURFACE: dict[str, Rule] = {"friction": _least(""), "restitution": Parameter("", 0.0, minimum=0)}
SHAPES: dict[str, dict[str, Rule]] = {
    "sphere": {"radius": _above("[m]")},
    "box": {"lengths": Vector(3)},
    "capsule": {"radius": _above("[m]"), "length": _above("[m]")},
    "cylinder": {"radius": _above("[m]"), "length": _above("[m]")},
    "plane": {"normal": Vector(3)},
    "mesh": {
        "file": _text("of a surface"),
        "up": Parameter("", kind=str, choices=("x", "y", "z")),
        "scale": _above("[1]"),
    },
}
_NEEDED = ("radius", "lengths", "length", "normal", "file")
_PLACE: dict[str, Rule] = {
    "shape": Parameter("", kind=str, choices=tuple(SHAPES)),
    "position": Vector(3),
    "rotation_deg": Vector(3, most=1e6),
}
BLOCK: dict[str, Rule] = {
    "low": Vector(3),
    "high": Vector(3),
    "velocity": Vector(3),
    "material": _text("name of one"),
}
KEYFRAME: dict[str, Rule] = {
    "time": _least("[s]"),
    "position": Vector(3),
    "rotation_deg": Vector(3, most=1e6),
}
TABLES = ("scene", "options", "material", "block", "obstacle", "body")


@dataclass
class Layout:
    """What a file says, checked: tables of values by key."""

    path: Path
    text: str
    scene: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)
    material: list[dict[str, Any]] = field(default_factory=list)
    block: list[dict[str, Any]] = field(default_factory=list)
    obstacle: list[dict[str, Any]] = field(default_factory=list)
    body: list[dict[str, Any]] = field(default_factory=list)

    def where(self, key: str, table: str = "", number: int = 0) -> str:
        """`file:line:column: key`, the place of the key in its table, or of the table."""
        lines = self.text.splitlines()
        start, end = 0, len(lines)
        if table:
            header = re.compile(rf"\s*\[\[?\s*{re.escape(table)}\s*\]\]?")
            heads = [i for i, line in enumerate(lines) if header.match(line)]
            start = heads[number] if number < len(heads) else 0
            later = (i for i in range(start + 1, end) if re.match(r"\s*\[", lines[i]))
            end = next((i for i in later if "=" not in lines[i].split("]")[0]), end)
        mention = re.compile(rf"(?<![\w-])[\"']?{re.escape(key)}[\"']?(?=\s*[\].=])")
        for i in range(start, end):
            if found := mention.search(lines[i]):
                return f"{self.path}:{i + 1}:{found.start() + 1}: {printable(key)}"
        return f"{self.path}:{start + 1}:1: {printable(key)}"

    @contextlib.contextmanager
    def told(self, table: str, row: Mapping[str, Any], number: int = 0) -> Iterator[None]:
        """Add the place to faults that other classes find in what the table gave them."""
        try:
            yield
        except InputError as error:
            if str(error).startswith(str(self.path)):
                raise
            key, _, reason = str(error).partition(": ")
            if key.partition("[")[0] in row:
                key, _, index = key.partition("[")
                reason = f"[{index}: {reason}" if index else reason
            elif table in ("scene", "options"):  # it may be of another table
                raise
            else:
                key, reason = next(iter(row)), str(error)
            raise InputError(f"{self.where(key, table, number)}: {reason}") from None


def read_layout(path: Path) -> Layout:
    """Read and check a file.

    Raises
    ------
    FormatError
        If the file is not TOML in UTF-8, too long or nested too deeply.
    InputError
        If it holds an unknown key or a wrong value, or lacks one.
    OSError
        If it cannot be read.
    """
    with open(path, "rb") as file:
        text = decode(path, file.read(SIZE_LIMIT + 1))
    document = parse(path, text)
    layout = Layout(path, text)
    for key, value in document.items():
        if key not in TABLES:
            raise InputError(f"{layout.where(key)}: unknown table; {closest(key, TABLES)}")
        many = key not in ("scene", "options")
        if not isinstance(value, list if many else dict) or (
            many and not all(isinstance(row, dict) for row in value)
        ):
            wanted = f"tables [[{key}]]" if many else f"a table [{key}]"
            raise InputError(f"{layout.where(key)}: expected {wanted}, got {shorten(value)}")
    checked = _Checker(layout)
    layout.scene = checked.table(document.get("scene", {}), SCENE, "scene")
    for key in ("method", "duration"):
        checked.needs(layout.scene, key, "scene")
    method = layout.scene["method"]
    layout.options = checked.table(document.get("options", {}), OPTIONS[method], "options")
    layout.material = [
        checked.material(row, i) for i, row in enumerate(document.get("material", []))
    ]
    layout.block = [checked.block(row, i) for i, row in enumerate(document.get("block", []))]
    for table in ("obstacle", "body"):
        rows = [checked.shape(row, table, i) for i, row in enumerate(document.get(table, []))]
        setattr(layout, table, rows)
    checked.whole()
    return layout


class _Checker:
    """Checks the tables of a file, and tells where one is wrong."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout

    def table(
        self, row: Mapping[str, Any], rules: Mapping[str, Rule], table: str, number: int = 0
    ) -> dict[str, Any]:
        """Values by key, in their own types."""
        checked = {}
        for key, value in row.items():
            where = self._layout.where(key, table, number)
            if key not in rules:
                raise InputError(f"{where}: unknown key of {table}; {closest(key, rules)}")
            checked[key] = rules[key].check(where, value)
        return checked

    def needs(self, row: Mapping[str, Any], key: str, table: str, number: int = 0) -> None:
        """Refuse a table without a key."""
        if key not in row:
            raise InputError(f"{self._layout.where(key, table, number)}: {table} needs it")

    def material(self, row: dict[str, Any], number: int) -> dict[str, Any]:
        """A name, a class and numbers that its constructor takes."""
        known = _text("")
        kind = Parameter("", kind=str, choices=tuple(MATERIALS))
        self.needs(row, "class", "material", number)
        name = kind.check(self._layout.where("class", "material", number), row["class"])
        rules: dict[str, Rule] = {"name": known, "class": kind}
        for key in MATERIALS[str(name)].__dataclass_fields__:  # type: ignore[attr-defined]
            rules[key] = Parameter("", kind=float) if key != "match" else known
        checked = self.table(row, rules, "material", number)
        given = {key: value for key, value in checked.items() if key not in ("name", "class")}
        with self._layout.told("material", checked, number):
            MATERIALS[str(name)](**given)
        return checked

    def block(self, row: dict[str, Any], number: int) -> dict[str, Any]:
        """Particles in a box, or in a mesh."""
        filled = "file" in row
        rules = {**BLOCK, **SHAPES["mesh"], "position": Vector(3)} if filled else BLOCK
        checked = self.table(row, rules, "block", number)
        for key in () if filled else ("low", "high"):
            self.needs(checked, key, "block", number)
        if not filled and not all(
            a < b for a, b in zip(checked["low"], checked["high"], strict=True)
        ):
            where = self._layout.where("high", "block", number)
            raise InputError(f"{where}: expected numbers above those of low, got {row['high']}")
        return checked

    def shape(self, row: dict[str, Any], table: str, number: int) -> dict[str, Any]:
        """An obstacle or a body of any shape."""
        self.needs(row, "shape", table, number)
        where = self._layout.where("shape", table, number)
        name = str(_PLACE["shape"].check(where, row["shape"]))
        rules = {**_PLACE, **SHAPES[name], **_SURFACE, **_MOTION}
        frames = row.get("keyframes") if table == "obstacle" else None
        if table == "obstacle":
            rules["hollow"] = Parameter("", kind=bool)
            row = {key: value for key, value in row.items() if key != "keyframes"}
        else:
            rules["density"] = _above("[kg/m^3]")
            if name == "plane":
                raise InputError(f"{where}: a body is no plane; make it an obstacle")
        checked = self.table(row, rules, table, number)
        for key in SHAPES[name]:
            if key in _NEEDED:
                self.needs(checked, key, table, number)
        if frames is not None:
            checked["keyframes"] = self._keyframes(frames, checked, number)
        return checked

    def _keyframes(self, frames: Any, row: Mapping[str, Any], number: int) -> list[dict[str, Any]]:
        where = self._layout.where("keyframes", "obstacle", number)
        if not isinstance(frames, list) or not all(isinstance(f, dict) for f in frames):
            raise InputError(f"{where}: expected a list of tables, got {shorten(frames)}")
        for key in ("position", "rotation_deg", "velocity", "angular_velocity"):
            if key in row:
                raise InputError(
                    f"{self._layout.where(key, 'obstacle', number)}: the keyframes say it"
                )
        checked = []
        for frame in frames:
            for key in frame:
                if key not in KEYFRAME:
                    raise InputError(
                        f"{where}: unknown key {printable(key)}; {closest(key, KEYFRAME)}"
                    )
            values = {k: KEYFRAME[k].check(f"{where}: {k}", v) for k, v in frame.items()}
            for key in ("time", "position"):
                if key not in values:
                    raise InputError(f"{where}: each keyframe needs a {key}")
            checked.append(values)
        times = [frame["time"] for frame in checked]
        if not times or times[0] != 0 or (np.diff(times) <= 0).any():
            raise InputError(f"{where}: expected ascending times from 0, got {times[:8]}")
        return checked

    def whole(self) -> None:
        """What several tables say must agree."""
        layout = self._layout
        method, where = layout.scene["method"], layout.where
        particles = method != "rigid"
        if particles:
            self.needs(layout.scene, "spacing", "scene")
            if not layout.block:
                raise InputError(f"{where('block')}: {method} needs at least one [[block]]")
        elif layout.block:
            raise InputError(f"{where('low', 'block')}: rigid has no particles, but [[body]]")
        elif not layout.body:
            raise InputError(f"{where('body')}: rigid needs at least one [[body]]")
        if (method == "grid-liquid") != ("bounds" in layout.scene):
            told = "grid-liquid needs it" if method == "grid-liquid" else f"{method} has none"
            raise InputError(f"{where('bounds', 'scene')}: {told}")
        if (method == "mpm") != bool(layout.material):
            told = "mpm needs at least one" if method == "mpm" else f"{method} has none"
            raise InputError(f"{where('class', 'material')}: {told}")
        self._names()
        if layout.body:
            for i, row in enumerate(layout.obstacle):
                for key in ("velocity", "angular_velocity", "keyframes"):
                    if key in row:
                        raise InputError(
                            f"{where(key, 'obstacle', i)}: obstacles are still where there are "
                            "bodies"
                        )
                if row.get("hollow") and row["shape"] != "box":
                    raise InputError(
                        f"{where('hollow', 'obstacle', i)}: only boxes are where there are bodies"
                    )

    def _names(self) -> None:
        """Each block of mpm names its material where there are several."""
        layout = self._layout
        names = [row.get("name", row["class"]) for row in layout.material]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise InputError(f"{layout.where('name', 'material', i)}: {name!r} is there twice")
        for i, row in enumerate(layout.block):
            where = layout.where("material", "block", i)
            if "material" in row and row["material"] not in names:
                raise InputError(
                    f"{where}: no such material; {closest(row['material'], map(printable, names))}"
                )
            if "material" not in row and len(names) > 1:
                raise InputError(f"{where}: expected one of {', '.join(map(printable, names))}")
            row["kind"] = names.index(row["material"]) if "material" in row else 0
