"""A progress bar for the command line: rate and time left on a terminal, nothing elsewhere."""

from __future__ import annotations

import sys
from typing import Any


class Progress:
    """A bar with rate and time left on a terminal, nothing elsewhere."""

    def __init__(self, title: str, time_unit: str = "s", time_scale: float = 1.0) -> None:
        self._title = title
        self._unit = time_unit
        self._scale = time_scale
        self._bar: Any = None

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def __call__(self, frame: int, frames: int, time: float) -> None:
        """Called after each frame."""
        self._show(frame + 1, frames, "frame", f"{time / self._scale:.4g} {self._unit}")

    def ended(self, ended: int, runs: int, failed: int) -> None:
        """Called after each run of a sweep."""
        self._show(ended, runs, "run", f"{failed} failed" if failed else "")

    def _show(self, done: int, total: int, unit: str, told: str) -> None:
        if self._bar is None:
            if not sys.stderr.isatty():
                return
            from tqdm import tqdm

            self._bar = tqdm(total=total, initial=done - 1, unit=unit, desc=self._title)
        self._bar.set_postfix_str(told, refresh=False)
        self._bar.update(done - self._bar.n)
