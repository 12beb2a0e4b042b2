"""The exceptions of substep: what the caller did wrong, what the numbers did, what a file holds."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

__all__ = [
    "AttributeInputError",
    "ConvergenceError",
    "CorruptError",
    "FormatError",
    "InputError",
    "NonFiniteError",
    "SingularMatrixError",
    "SolverError",
    "StartWarning",
    "SubstepError",
    "TruncatedError",
    "VersionError",
]


def __dir__() -> list[str]:
    return __all__


class SubstepError(Exception):
    """Root of every exception that substep raises on its own account."""


class InputError(SubstepError, ValueError):
    """An argument is wrong; nothing was changed."""


class AttributeInputError(InputError, AttributeError):
    """An attribute that is assigned does not exist, or cannot be changed."""


class SolverError(SubstepError, RuntimeError):
    """The numbers failed; the state is the last good step.

    Attributes
    ----------
    time : float or None
        Time of the failure [s].
    index : int or None
        The worst component, particle or row.
    step : int or None
        Number of the step that failed, from 0.
    result : object
        The part that was solved, where there is one.
    """

    def __init__(
        self,
        message: str,
        *,
        time: float | None = None,
        index: int | None = None,
        step: int | None = None,
        result: Any = None,
    ) -> None:
        super().__init__(message)
        self.time = time
        self.index = index
        self.step = step
        self.result = result


class NonFiniteError(SolverError):
    """A value became NaN or infinite, or a step too long lets it grow without bound."""


class ConvergenceError(SolverError):
    """An iteration did not converge.

    Attributes
    ----------
    residuals : tuple of float
        The residual after each iteration, in the units of the stop rule, where there are any.
    """

    def __init__(
        self,
        message: str,
        *,
        residuals: Iterable[float] = (),
        time: float | None = None,
        index: int | None = None,
        step: int | None = None,
        result: Any = None,
    ) -> None:
        super().__init__(message, time=time, index=index, step=step, result=result)
        self.residuals = tuple(residuals)


class SingularMatrixError(SolverError):
    """A matrix could not be factorised; `index` is the row."""


class FormatError(SubstepError, ValueError):
    """A file is malformed.

    Attributes
    ----------
    offset : int or None
        Byte of the file at which it was noticed, where there is one.
    """

    def __init__(self, message: str, *, offset: int | None = None) -> None:
        super().__init__(message)
        self.offset = offset


class TruncatedError(FormatError):
    """A file ends before its content does."""


class CorruptError(FormatError):
    """A file's content contradicts its checksum or its own header."""


class VersionError(FormatError):
    """A file was written by a version, or on a machine, that this one cannot read."""


class StartWarning(UserWarning):
    """A simulation starts from a state that can hardly be meant."""
