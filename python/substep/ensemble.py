"""Many solutions at once: `substep.ode.ensemble` under the name that users know."""

from .ode.ensemble import *  # noqa: F403
from .ode.ensemble import __all__ as __all__


def __dir__() -> list[str]:
    return __all__
