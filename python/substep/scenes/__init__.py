"""Scenes: declared simulations that `substep run` runs, records, resumes and draws."""

from .catalogue import load, names
from .declaration import Parameter, Scene
from .record import record
from .run import Outcome, Plan, run

__all__ = ["Outcome", "Parameter", "Plan", "Scene", "load", "names", "record", "run"]


def __dir__() -> list[str]:
    return __all__
