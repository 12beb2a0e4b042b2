"""Recordings: frames appended to a journal, packed into VTKHDF, read back; logs of quantities."""

from .body_shapes import body_shapes
from .logger import Logger
from .parts import Part
from .quantities import diagnostics, forces, gauges
from .reader import RecordedPart, Recording
from .recorder import Recorder

__all__ = [
    "Logger",
    "Part",
    "RecordedPart",
    "Recorder",
    "Recording",
    "body_shapes",
    "diagnostics",
    "forces",
    "gauges",
]


def __dir__() -> list[str]:
    return __all__
