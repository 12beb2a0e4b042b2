"""What a case is, and what came of one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from ..base.checks import check_callable, check_real, describe
from ..errors import InputError


@dataclass(frozen=True)
class Case:
    """A figure of a publication or of a closed form, and how it is measured.

    Parameters
    ----------
    name : str
        What is measured, in one line.
    method : str
        Whose: `ode`, `springs`, `pbf` and so on.
    source : str
        Where the figure is from: a paper with its equation or table, or a closed form.
    figure : float
        The figure itself, in `unit`.
    measure : callable
        `measure()` computes and returns the same quantity.
    relative, absolute : float
        Half the width of the band around the figure: a part of the figure, and in `unit`. What is
        measured shall lie within the sum of both.
    unit : str
        Unit of the figure; 1 is left out.
    quick : bool
        Whether it takes seconds.
    control : bool
        Whether it is set up wrongly, so that what is measured must lie outside the band.

    Raises
    ------
    TypeError
        If `measure` cannot be called, or a name is no text.
    InputError
        If there is no name, method or source, the figure is not finite, or the band has no width.

    Examples
    --------
    >>> from substep.validate import Case
    >>> case = Case("root of two", "numbers", "Euclid", 2**0.5, lambda: 1.414, relative=1e-3)
    >>> case.low < 1.414 < case.high
    True
    """

    name: str
    method: str
    source: str
    figure: float
    measure: Callable[[], float]
    relative: float = 0.0
    absolute: float = 0.0
    unit: str = ""
    quick: bool = True
    control: bool = False

    def __post_init__(self) -> None:
        for key in ("name", "method", "source", "unit"):
            value = getattr(self, key)
            if not isinstance(value, str):
                raise TypeError(f"{key}: expected a text, got {describe(value)}")
            if key != "unit" and not value.strip():
                raise InputError(f"{key}: expected a text, got {value!r}")
        check_callable("measure", self.measure)
        check_real("figure", self.figure)
        for key in ("relative", "absolute"):
            check_real(key, getattr(self, key), nonnegative=True)
        if not self.low < self.high:
            raise InputError("relative, absolute: expected a band that has a width")

    @property
    def low(self) -> float:
        """The least that is right."""
        return self.figure - self.relative * abs(self.figure) - self.absolute

    @property
    def high(self) -> float:
        """The most that is right."""
        return self.figure + self.relative * abs(self.figure) + self.absolute


@dataclass(frozen=True)
class Outcome:
    """What came of a case.

    Attributes
    ----------
    case : Case
        The case.
    measured : float or None
        What was measured; None where it failed.
    seconds : float
        Time that it took [s].
    error : str
        What failed; empty where nothing did.
    inside : bool
        Whether what was measured lies in the band.
    passed : bool
        Whether it does, or, of a control, does not.
    """

    case: Case
    measured: float | None
    seconds: float
    error: str = ""

    @property
    def inside(self) -> bool:
        """Whether what was measured lies in the band."""
        return self.measured is not None and self.case.low <= self.measured <= self.case.high

    @property
    def passed(self) -> bool:
        """Whether the case was measured, and is as it must be."""
        return self.measured is not None and self.inside != self.case.control

    def off(self) -> str:
        """How far what was measured is from the figure, in words.

        Returns
        -------
        str
            A part of the figure in percent; where the figure is 0, the difference.
        """
        if self.measured is None:
            return "failed"
        if self.case.figure == 0:
            return f"{self.measured:+.2g}"
        off = (self.measured - self.case.figure) / abs(self.case.figure)
        return f"{100 * off:+.2g} %" if math.isfinite(off) else "not finite"
