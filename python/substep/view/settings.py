"""Controls for what can be set of a simulation, in the browser."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..base.attributes import settable


def make_settings(gui: Any, name: str, member: Any) -> list[tuple[str, Any]]:
    """A control for each number, vector and switch that can be set.

    Parameters
    ----------
    gui : viser.GuiApi
        Where they are put, in a folder.
    name : str
        Of a member of a world; else empty.
    member : Simulation
        Whose attributes they are.

    Returns
    -------
    list of tuple
        Name of the attribute, and its control.
    """
    values: dict[str, Any] = {}
    for attribute in settable(type(member)):
        value: Any = getattr(member, attribute, None)
        if attribute in member._fixed or attribute == "threads":
            continue
        if isinstance(value, (bool, int, float)) and math.isfinite(value):
            values[attribute] = value
        elif isinstance(value, np.ndarray) and value.shape in ((2,), (3,)):
            values[attribute] = tuple(map(float, value))
    if not values:
        return []
    with gui.add_folder(f"settings of {name}" if name else "settings"):
        return [(key, _control(gui, member, key, value)) for key, value in values.items()]


def _control(gui: Any, member: Any, attribute: str, value: Any) -> Any:
    add: Any = gui.add_number
    options: dict[str, Any] = {}
    if isinstance(value, bool):
        add = gui.add_checkbox
    elif isinstance(value, tuple):
        add, options = (gui.add_vector2, gui.add_vector3)[len(value) - 2], {"step": 0.01}
    elif isinstance(value, float):
        digits = math.floor(math.log10(abs(value))) - 2 if value else -3
        options = {"step": 10.0**digits}
    hint = (getattr(type(member), attribute).__doc__ or "").split("\n")[0]
    return add(attribute, initial_value=value, hint=hint, **options)
