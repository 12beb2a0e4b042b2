"""Equations of second order: `substep.ode.second_order` under the name that users know."""

from .ode.second_order import *  # noqa: F403
from .ode.second_order import __all__ as __all__


def __dir__() -> list[str]:
    return __all__
