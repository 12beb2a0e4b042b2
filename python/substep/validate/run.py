"""Measuring cases, one after the other."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

from ..base.checks import check_callable, check_real, describe
from ..errors import InputError
from .case import Case, Outcome


def run(cases: Iterable[Case], on_case: Callable[[Outcome], object] | None = None) -> list[Outcome]:
    """Measure cases, one after the other.

    Parameters
    ----------
    cases : iterable of Case
        What to measure: of those that `cases` returns, or your own.
    on_case : callable, optional
        `on_case(outcome)` is called after each.

    Returns
    -------
    list of Outcome
        One for each case, in their order. A case that raises has failed, and the others go on.

    Raises
    ------
    TypeError
        If one is no case.
    InputError
        If there is none.

    Examples
    --------
    >>> import substep
    >>> orders = [case for case in substep.validate.cases("ode") if "order" in case.name]
    >>> all(outcome.passed for outcome in substep.validate.run(orders[:2]))
    True
    """
    chosen = list(cases)
    for case in chosen:
        if not isinstance(case, Case):
            raise TypeError(f"cases: expected substep.validate.Case, got {describe(case)}")
    if not chosen:
        raise InputError("cases: expected at least one")
    if on_case is not None:
        check_callable("on_case", on_case)
    outcomes = []
    for case in chosen:
        outcomes.append(_measure(case))
        if on_case is not None:
            on_case(outcomes[-1])
    return outcomes


def _measure(case: Case) -> Outcome:
    start = time.perf_counter()
    measured, error = None, ""
    try:
        measured = check_real("measure()", case.measure(), finite=False)
    except Exception as failure:
        error = f"{type(failure).__name__}: {failure}"
    return Outcome(case, measured, time.perf_counter() - start, error)
