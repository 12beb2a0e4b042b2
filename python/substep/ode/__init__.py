"""Initial value problems y' = f(t, y): explicit and implicit methods with one entry point."""

from .ensemble import EnsembleResult, solve_ensemble
from .ivp import OdeResult, OdeSolution, methods, solve_ivp
from .second_order import SecondOrderResult, solve_second_order

__all__ = [
    "EnsembleResult",
    "OdeResult",
    "OdeSolution",
    "SecondOrderResult",
    "methods",
    "solve_ensemble",
    "solve_ivp",
    "solve_second_order",
]


def __dir__() -> list[str]:
    return __all__
