"""Compiled right-hand sides: classical systems that run without the interpreter.

A system goes where `fun` goes: ``substep.solve_ivp(substep.systems.Lorenz(), ...)``. It can also be
called as ``system(t, y)``, so every other solver takes it too.
"""

from .large import NBody, Oscillators, SpringChain
from .small import (
    Arenstorf,
    HarmonicOscillator,
    HenonHeiles,
    Kepler,
    Lorenz,
    Pendulum,
    Pleiades,
    VanDerPol,
)
from .stiff import Brusselator1D, Brusselator2D, Hires, Orego, Robertson
from .system import System

__all__ = [
    "Arenstorf",
    "Brusselator1D",
    "Brusselator2D",
    "HarmonicOscillator",
    "HenonHeiles",
    "Hires",
    "Kepler",
    "Lorenz",
    "NBody",
    "Orego",
    "Oscillators",
    "Pendulum",
    "Pleiades",
    "Robertson",
    "SpringChain",
    "System",
    "VanDerPol",
]


def __dir__() -> list[str]:
    return __all__
