"""Packages that only some uses of the library need."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needs(package: str, told: str) -> Iterator[None]:
    """Say what to install where an import finds no such package.

    An import that is interrupted, or fails for want of memory or of another package, passes as it
    is: the package is there.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != package:
            raise
        raise ImportError(told, name=package) from None
