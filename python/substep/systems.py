"""Systems of equations: `substep.ode.systems` under the name that users know."""

from .ode.systems import *  # noqa: F403
from .ode.systems import __all__ as __all__


def __dir__() -> list[str]:
    return __all__
