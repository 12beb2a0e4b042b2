"""Recordings: frames appended to a journal, packed into VTKHDF, read back; logs of quantities."""

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
    "diagnostics",
    "forces",
    "gauges",
]


def __dir__() -> list[str]:
    return __all__
