"""What notebooks show of an object: its words, and a picture where matplotlib is installed.

`substep.view` draws, which stands above all that is drawn, so it is found by its name.
"""

from __future__ import annotations

import html
import importlib
from base64 import b64encode
from typing import Any

import numpy as np


class Pictured:
    """An object that a notebook shows as a picture."""

    def _repr_png_(self) -> bytes | None:
        """A picture, or None where there is none, or no matplotlib."""
        png: bytes | None = importlib.import_module("substep.view.sketch").picture(self)
        return png

    def _repr_html_(self) -> str:
        """The words of `repr`, and the picture below."""
        words = f"<pre>{html.escape(repr(self))}</pre>"
        png = self._repr_png_()
        if png is None:
            return words
        return f'{words}<img src="data:image/png;base64,{b64encode(png).decode()}">'


def outline(one: Any) -> str:
    """Words for an object of arrays and numbers: the shapes of those, the values of these."""
    told = []
    for name, value in vars(one).items():
        if isinstance(value, np.ndarray):
            told.append(f"{name}: {value.dtype} {value.shape}")
        elif isinstance(value, list):
            told.append(f"{name}: {len(value)}")
        elif name[:1] != "_":
            told.append(f"{name}={value!r}")
    return f"{type(one).__name__}({', '.join(told)})"
