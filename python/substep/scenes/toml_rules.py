"""What the tables of scenes in TOML files may say: keys and their values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..errors import InputError
from ..mpm import FixedCorotated, Fluid, HerschelBulkley, NeoHookean, Sand, Snow, VonMises
from .declaration import Parameter, shorten

MATERIALS = {
    cls.__name__: cls
    for cls in (FixedCorotated, Fluid, HerschelBulkley, NeoHookean, Sand, Snow, VonMises)
}
PARTICLES = ("pbf", "grid-liquid", "mpm")
DEFORMING = {  # methods of one cloth or solid, and which it may be
    "mass-spring": ("cloth",),
    "soft-body": ("solid",),
    "pbd": ("cloth", "solid"),
}
METHODS = (*PARTICLES, *DEFORMING, "rigid")


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
            got = f"{len(value)}: " if isinstance(value, list) else ""
            raise InputError(f"{where}: expected {self.count} numbers, got {got}{shorten(value)}")
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


def text(doc: str) -> Parameter:
    """Any text."""
    return Parameter(doc, kind=str)


def above(doc: str) -> Parameter:
    """A number above 0."""
    return Parameter(doc, kind=float, above=0)


def least(doc: str) -> Parameter:
    """A number of at least 0."""
    return Parameter(doc, kind=float, minimum=0)


SCENE: dict[str, Rule] = {
    "name": text("of the scene; that of the file unless given"),
    "doc": text("what it shows, in one line"),
    "method": Parameter("method of the particles", kind=str, choices=METHODS),
    "duration": above("time simulated [s]"),
    "frames": Parameter("number of frames", kind=int, minimum=2),
    "spacing": above("of the particles [m]"),
    "bounds": Box(),
    "gravity": Vector(3),
}
_MARGIN: dict[str, Rule] = {"contact_margin": above("[m]")}
_SPRINGS: dict[str, Rule] = {"step": above("[s]"), "drag": least("[1/s]"), **_MARGIN}
_LIQUID: dict[str, Rule] = {
    "density": above("[kg/m^3]"),
    "viscosity": least("[m^2/s]"),
    "surface_tension": least("[N/m]"),
    "cfl": above("[1]"),
}
OPTIONS: dict[str, dict[str, Rule]] = {
    "pbf": {**_LIQUID, "divergence_free": Parameter("", kind=bool), "xsph": least("")},
    "grid-liquid": {
        **_LIQUID,
        "slip": Parameter("", kind=bool),
        "transfer": Parameter("", kind=str, choices=("apic", "flip", "pic")),
    },
    "mpm": {"cfl": above("[1]")},
    "mass-spring": _SPRINGS,
    "soft-body": _SPRINGS,
    "pbd": {**_SPRINGS, "substeps": Parameter("", kind=int, minimum=1)},
    "rigid": _MARGIN,
}
MOTION: dict[str, Rule] = {"velocity": Vector(3), "angular_velocity": Vector(3)}
SURFACE: dict[str, Rule] = {"friction": least(""), "restitution": Parameter("", 0.0, minimum=0)}
SHAPES: dict[str, dict[str, Rule]] = {
    "sphere": {"radius": above("[m]")},
    "box": {"lengths": Vector(3)},
    "capsule": {"radius": above("[m]"), "length": above("[m]")},
    "cylinder": {"radius": above("[m]"), "length": above("[m]")},
    "plane": {"normal": Vector(3)},
    "mesh": {
        "file": text("of a surface"),
        "up": Parameter("", kind=str, choices=("x", "y", "z")),
        "scale": above("[1]"),
    },
    "animation": {
        "folder": text("of meshes, one for each frame"),
        "fps": above("[1/s]"),
        "thickness": above("[m]"),
        "up": Parameter("", kind=str, choices=("x", "y", "z")),
        "scale": above("[1]"),
    },
}
NEEDED = ("radius", "lengths", "length", "normal", "file", "folder", "fps", "thickness")
PLACE: dict[str, Rule] = {
    "shape": Parameter("", kind=str, choices=tuple(SHAPES)),
    "position": Vector(3),
    "rotation_deg": Vector(3, most=1e6),
}
BLOCK: dict[str, Rule] = {
    "low": Vector(3),
    "high": Vector(3),
    "velocity": Vector(3),
    "material": text("name of one"),
}
KEYFRAME: dict[str, Rule] = {
    "time": least("[s]"),
    "position": Vector(3),
    "rotation_deg": Vector(3, most=1e6),
}
PLACED: dict[str, Rule] = {**SHAPES["mesh"], "position": Vector(3)}
NEIGHBOURS: dict[str, Rule] = {"neighbours": Parameter("", kind=int, minimum=8, maximum=256)}
HELD: dict[str, Rule] = {"density": above(""), "pinned": Box(), "velocity": Vector(3)}
CLOTH: dict[str, dict[str, Rule]] = {
    "mass-spring": {
        "stiffness": above("[N/m]"),
        "bending": least("[1]"),
        "damping_time": least("[s]"),
    },
    "pbd": {"compliance": least("[m/N]"), "rigidity": above("[J]"), "damping": least("")},
}
SOLID: dict[str, Rule] = {
    "young_modulus": above("[Pa]"),
    "poisson_ratio": Parameter("", kind=float),
    "damping_time": least("[s]"),
}
SINGLE = ("scene", "options", "cloth", "solid", "skin")
TABLES = (*SINGLE, "material", "block", "obstacle", "body")
