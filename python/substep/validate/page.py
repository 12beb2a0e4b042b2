"""One page in HTML of what was measured."""

from __future__ import annotations

import html
import os
import platform
from collections.abc import Iterable
from datetime import datetime, timezone
from typing import Any

from .. import __version__, _core
from ..base.checks import describe
from ..base.replacing import check_file_name, replace_file
from ..config import num_threads
from ..errors import InputError
from .case import Case, Outcome
from .catalogue import CASES

_STYLE = """
body { font: 15px/1.4 system-ui, sans-serif; margin: 2em auto; max-width: 75em; color: #222 }
table { border-collapse: collapse; width: 100%; margin-bottom: 2em }
th, td { text-align: left; padding: .3em .6em; border-bottom: 1px solid #ddd; vertical-align: top }
th.number { text-align: right }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }
tr.failed td { background: #fde8e8 }
.source { color: #667; font-size: 13px }
"""
_WIDTH, _HEIGHT = 120, 16  # of a picture [pixels]


def write_page(outcomes: Iterable[Outcome], path: str | os.PathLike[str]) -> None:
    """Write a page in HTML: figures beside what was measured, bands, errors, version and times.

    Parameters
    ----------
    outcomes : iterable of Outcome
        What `run` returned.
    path : path-like
        Where to; an existing file is replaced, once all is written.

    Raises
    ------
    TypeError
        If one is no outcome.
    InputError
        If there is none.
    OSError
        If it cannot be written; an existing file stays then.

    Examples
    --------
    >>> import tempfile
    >>> import substep
    >>> outcomes = substep.validate.run(substep.validate.cases("fields"))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     substep.validate.write_page(outcomes, f"{folder}/page.html")
    """
    given = list(outcomes)
    for outcome in given:
        if not isinstance(outcome, Outcome):
            raise TypeError(f"outcomes: expected those of run(), got {describe(outcome)}")
    if not given:
        raise InputError("outcomes: expected at least one")
    text = _page(given)
    replace_file(check_file_name(path), lambda file: file.write(text.encode()))


def _page(outcomes: list[Outcome]) -> str:
    failed = [outcome for outcome in outcomes if not outcome.passed]
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8"/><title>substep validate</title>',
        f"<style>{_STYLE}</style></head><body>",
        "<h1>Validation of substep</h1>",
        f"<p>{len(outcomes)} cases, {len(failed)} failed, {_time(sum(o.seconds for o in outcomes))}"
        f" in all. Version {_text(__version__)}, level {_text(_core.level)}, {num_threads()} "
        f"threads, Python {_text(platform.python_version())}; "
        f"{datetime.now(timezone.utc):%Y-%m-%d %H:%M} UTC.</p>",
        f"<p>{_extent(outcomes)}</p>",
        "<p>The bar is the band around the reference, the dot what was measured. A control is set "
        "up wrongly, so that its dot, an orange one, must lie outside.</p>",
    ]
    if failed:
        items = "".join(f"<li>{_text(o.case.method)}: {_text(o.case.name)}</li>" for o in failed)
        parts.append(f"<h2>Failed</h2><ul>{items}</ul>")
    for method in dict.fromkeys(outcome.case.method for outcome in outcomes):
        rows = [_row(outcome) for outcome in outcomes if outcome.case.method == method]
        parts += [
            f"<h2>{_text(method)}</h2><table><thead><tr>",
            *(f"<th{_RIGHT * (head in _NUMBERS)}>{head}</th>" for head in _HEADS),
            "</tr></thead><tbody>",
            *rows,
            "</tbody></table>",
        ]
    return "\n".join([*parts, "</body></html>", ""])


_HEADS = ("Case", "Reference", "Band", "Measured", "Error", "", "Time", "Verdict")
_RIGHT = ' class="number"'
_NUMBERS = ("Reference", "Band", "Measured", "Error", "Time")


def _extent(outcomes: list[Outcome]) -> str:
    """Whether that is all that there is to measure of these methods, or less."""
    ran = [outcome.case for outcome in outcomes]
    if any(case not in CASES for case in ran):
        return "Some of these cases are not among those of substep validate."
    known = [case for case in CASES if case.method in {case.method for case in ran}]
    if left := sum(case not in ran for case in known):
        quick = " as with --quick," if all(case.quick for case in ran) else ""
        return f"Not all cases of these methods:{quick} {left} are left out."
    return "All cases of these methods."


def verdict(outcome: Outcome) -> str:
    """`ok` or `FAILED`, and what is special.

    Parameters
    ----------
    outcome : Outcome
        Of the case.

    Returns
    -------
    str
        A word or two.
    """
    if not outcome.passed:
        return "FAILED"
    return "misses, as it must" if outcome.case.control else "ok"


def _row(outcome: Outcome) -> str:
    case = outcome.case
    about = f'{_text(case.name)}<br/><span class="source">{_text(case.source)}</span>'
    if outcome.error:
        about += f"<br/>{_text(outcome.error)}"
    measured = "" if outcome.measured is None else number(outcome.measured, case)
    numbers = [
        number(case.figure, case),
        f"± {case.high - case.figure:.3g}",
        measured,
        outcome.off(),
    ]
    return "".join(
        [
            f'<tr class="{"passed" if outcome.passed else "failed"}">',
            f"<td>{about}</td>",
            *(f'<td class="number">{_text(text)}</td>' for text in numbers),
            f"<td>{_picture(outcome)}</td>",
            f'<td class="number">{_time(outcome.seconds)}</td>',
            f"<td>{_text(verdict(outcome))}</td></tr>",
        ]
    )


def _picture(outcome: Outcome) -> str:
    """The band as a bar in the middle half; the dot is at the rim where it lies further off."""
    case = outcome.case
    shape = f'width="{_WIDTH}" height="{_HEIGHT}" viewBox="0 0 {_WIDTH} {_HEIGHT}"'
    parts = [f'<rect x="{_WIDTH / 4}" y="5" width="{_WIDTH / 2}" height="6" fill="#cde"/>']
    if outcome.measured is not None:
        place = (outcome.measured - case.low) / (case.high - case.low)
        x = _WIDTH * min(max(0.25 + place / 2, 0.04), 0.96)
        met = "#c77700" if case.control else "#27733a"
        color = met if outcome.passed else "#b3261e"
        parts.append(f'<circle cx="{x:.1f}" cy="8" r="4" fill="{color}"/>')
    return f"<svg {shape}>{''.join(parts)}</svg>"


def number(value: float, case: Case) -> str:
    """A number of a case, with its unit.

    Parameters
    ----------
    value : float
        In the unit of the case.
    case : Case
        Of which.

    Returns
    -------
    str
        Six digits at most.
    """
    return f"{value:.6g} {case.unit}".strip()


def _time(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 100 else f"{seconds / 60:.1f} min"


def _text(value: Any) -> str:
    return html.escape(str(value))
