"""Validation: figures of publications and closed forms, measured anew by what is installed."""

from .case import Case, Outcome
from .catalogue import cases
from .page import write_page
from .run import run

__all__ = ["Case", "Outcome", "cases", "run", "write_page"]


def __dir__() -> list[str]:
    return __all__
