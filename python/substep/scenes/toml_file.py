"""Scenes in TOML files: a small closed schema, whose faults are told with their place."""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from ..errors import InputError
from .declaration import Parameter, closest, shorten
from .run_config import SIZE_LIMIT, decode, parse, printable
from .toml_rules import (
    BLOCK,
    CLOTH,
    DEFORMING,
    HELD,
    KEYFRAME,
    MATERIALS,
    MOTION,
    NEEDED,
    NEIGHBOURS,
    OPTIONS,
    PARTICLES,
    PLACE,
    PLACED,
    SCENE,
    SHAPES,
    SINGLE,
    SOLID,
    SURFACE,
    TABLES,
    Rule,
    Vector,
    above,
    text,
)


@dataclass
class Layout:
    """What a file says, checked: tables of values by key."""

    path: Path
    text: str
    scene: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)
    cloth: dict[str, Any] = field(default_factory=dict)
    solid: dict[str, Any] = field(default_factory=dict)
    skin: dict[str, Any] = field(default_factory=dict)
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
        many = key not in SINGLE
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
    for table in ("cloth", "solid", "skin"):
        if table in document:
            setattr(layout, table, checked.single(document[table], table, method))
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
        known = text("")
        kind = Parameter("", kind=str, choices=tuple(MATERIALS))
        self.needs(row, "class", "material", number)
        name = kind.check(self._layout.where("class", "material", number), row["class"])
        rules: dict[str, Rule] = {"name": known, "class": kind}
        needed = []
        for one in dataclasses.fields(cast(Any, MATERIALS[str(name)])):
            rules[one.name] = Parameter("", kind=float) if one.name != "match" else known
            if one.default is dataclasses.MISSING:
                needed.append(one.name)
        checked = self.table(row, rules, "material", number)
        for key in needed:
            self.needs(checked, key, "material", number)
        given = {key: value for key, value in checked.items() if key not in ("name", "class")}
        with self._layout.told("material", checked, number):
            MATERIALS[str(name)](**given)
        return checked

    def single(self, row: dict[str, Any], table: str, method: str) -> dict[str, Any]:
        """The one cloth, solid or skin."""
        takes = ("mpm", "soft-body", "pbd") if table == "skin" else ()
        if method not in takes and table not in DEFORMING.get(method, ()):
            raise InputError(f"{self._layout.where(table, table)}: {method} has none")
        if table == "skin":  # which follows the tetrahedra of a soft body, else particles
            rules = PLACED if method == "soft-body" else {**PLACED, **NEIGHBOURS}
            checked, needed = self.table(row, rules, table), ["file"]
        elif table == "cloth":
            shape: dict[str, Rule] = PLACED if "file" in row else {"size": Vector(2)}
            for other, keys in CLOTH.items():
                for key in row:
                    if key not in keys or key in CLOTH[method]:
                        continue
                    own = f"{method} has {', '.join(CLOTH[method])}"
                    raise InputError(
                        f"{self._layout.where(key, table)}: is of cloth of {other}; {own}"
                    )
            rules = {**shape, **CLOTH[method], **HELD, "position": Vector(3)}
            checked = self.table(row, {**rules, "rotation_deg": PLACE["rotation_deg"]}, table)
            needed = [*([] if "file" in row else ["size"]), "density"]
            needed += ["stiffness"] if method == "mass-spring" else []
        else:
            shape = PLACED if "file" in row else {"low": Vector(3), "high": Vector(3)}
            checked = self.table(row, {**shape, **SOLID, **HELD}, table)
            needed = [] if "file" in row else ["low", "high"]
            needed += ["density", "young_modulus", "poisson_ratio"]
        for key in needed:
            self.needs(checked, key, table)
        return checked

    def block(self, row: dict[str, Any], number: int) -> dict[str, Any]:
        """Particles in a box, or in a mesh."""
        filled = "file" in row
        rules = {**BLOCK, **PLACED} if filled else BLOCK
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
        name = str(PLACE["shape"].check(where, row["shape"]))
        rules = {**PLACE, **SHAPES[name], **SURFACE, **MOTION}
        if name == "animation":
            if table == "body":
                raise InputError(f"{where}: a body has a shape that stays; make it an obstacle")
            rules = {key: PLACE["shape"] for key in ("shape",)} | SHAPES[name]
            rules["friction"] = SURFACE["friction"]
        frames = row.get("keyframes") if table == "obstacle" and name != "animation" else None
        if name == "animation":
            pass
        elif table == "obstacle":
            rules["hollow"] = Parameter("", kind=bool)
            row = {key: value for key, value in row.items() if key != "keyframes"}
        else:
            rules["density"] = above("[kg/m^3]")
            if name == "plane":
                raise InputError(f"{where}: a body is no plane; make it an obstacle")
        checked = self.table(row, rules, table, number)
        for key in SHAPES[name]:
            if key in NEEDED:
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
        if method != "rigid":
            self.needs(layout.scene, "spacing", "scene")
        if method in PARTICLES:
            if not layout.block:
                raise InputError(f"{where('block')}: {method} needs at least one [[block]]")
        elif layout.block:
            told = "[[body]]" if method == "rigid" else f"[{'] or ['.join(DEFORMING[method])}]"
            raise InputError(f"{where('low', 'block')}: {method} has no particles, but {told}")
        elif method in DEFORMING:
            if bool(layout.cloth) == bool(layout.solid):
                told = "] or [".join(DEFORMING[method])
                raise InputError(f"{where(DEFORMING[method][0])}: {method} needs one [{told}]")
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
                if row["shape"] == "animation":
                    raise InputError(f"{where('shape', 'obstacle', i)}: bodies do not meet it")
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
