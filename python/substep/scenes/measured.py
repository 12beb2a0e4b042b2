"""What scenes share that measure while they run: numbers that are a part of the state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.checks import check_array


class Measured:
    """Numbers that are measured after every step, and resumed with the rest of the state.

    Subclasses put it before the class of the simulation.

    Attributes
    ----------
    measured : dict of str to ndarray
        By name; their shapes stay.
    """

    measured: dict[str, NDArray[np.float64]]

    def after_step(self) -> None:
        """What is done and measured after every step; nothing by default."""

    def advance(
        self: Any, duration: float, callback: Callable[[Any], object] | None = None
    ) -> None:
        """Take steps over a duration [s], and measure after each of them."""

        def both(simulation: Any) -> None:
            self.after_step()
            if callback is not None:
                callback(simulation)

        super().advance(duration, both)  # type: ignore[misc]

    def state(self: Any) -> dict[str, Any]:
        """Copy the whole state, with what was measured."""
        measured = {f"measured_{name}": values.copy() for name, values in self.measured.items()}
        return {**super().state(), **measured}  # type: ignore[misc]

    def restore(self: Any, state: dict[str, Any]) -> None:
        """Go back to a state, bit for bit."""
        measured = {
            name: check_array(name, state.get(f"measured_{name}"), values.shape, finite=False)
            for name, values in self.measured.items()
        }
        rest = {key: value for key, value in state.items() if not key.startswith("measured_")}
        super().restore(rest)  # type: ignore[misc]
        self.measured = {name: values.copy() for name, values in measured.items()}
