"""Recordings read back as arrays, whether packed or still a journal."""

from .parts import Part
from .reader import RecordedPart, Recording
from .recorder import Recorder

__all__ = [
    "Part",
    "RecordedPart",
    "Recorder",
    "Recording",
]


def __dir__() -> list[str]:
    return __all__
