"""Warnings of starts that can hardly be meant."""

from __future__ import annotations

import sys
import warnings

from ..errors import StartWarning


def warn_at_user(message: str) -> None:
    """Warns with StartWarning at the line of the user."""
    level, frame = 1, sys._getframe(0)
    while frame.f_back and frame.f_globals["__name__"].split(".")[0] == "substep":
        level, frame = level + 1, frame.f_back
    warnings.warn(message, StartWarning, stacklevel=level)
