"""Simulations of several kinds in one world: what they exchange, and one time for all."""

from .world import World

__all__ = ["World"]


def __dir__() -> list[str]:
    return __all__
