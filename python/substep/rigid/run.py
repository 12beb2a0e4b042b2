"""Steps of rigid bodies: runs with callbacks, and how long a step may be."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.simulation import StepReport
from ..errors import NonFiniteError, SolverError
from .joints import Joints
from .queries import Queries

_TURN = 1.0  # rad that a body in contact may turn in a step
_LEAST_STEP = 1e-100  # [s], where what fails is too small: what is divided by it is too large


@dataclass
class RigidReport(StepReport):
    """What the last call of `step` or `advance` took and met.

    Attributes
    ----------
    contacts : int
        Pairs of shapes that touched in the last step.
    penetration : float
        The deepest of them [m].
    impacts : int
        Contacts with restitution in the last step.
    awake : int
        Dynamic bodies that do not sleep.
    joint_error : float
        Greatest distance or angle by which a joint is off [m or rad].
    """

    contacts: int = 0
    penetration: float = 0.0
    impacts: int = 0
    awake: int = 0
    joint_error: float = 0.0


class Runs(Queries, Joints):
    """A world of rigid bodies in time; make `RigidBodies`."""

    _options: dict[str, Any]
    _step_size: float
    _fixed_step = True

    def _take_step(self, dt: float) -> None:
        try:
            self._native.step(dt)
        except SolverError as error:
            if error.index is None:
                raise
            row, text = error.index, str(error)
            if text.startswith("joint "):
                number = int(self._joint_ids[row])
                text = f"joint {number}: {text.partition(': ')[2]}"
                raise SolverError(text, time=error.time, index=number, step=error.step) from None
            if text.startswith("body "):
                text = text.partition(": ")[2]
            else:  # of a fixture, which are numbered in the order of their bodies
                counts = [len(fixtures) for fixtures, *_ in self._made]
                row = int(np.searchsorted(np.cumsum(counts), row, side="right"))
                text = f"its way is not finite in a step of {dt:g} s; take a smaller step"
            text = re.sub(r"step of [\d.]+ s", f"step of {dt:g} s", text)
            if dt < _LEAST_STEP:
                text = re.sub("take a smaller step.*", "take a longer step", text)
            number = int(self._ids[row])
            time = self.time if error.time is None else error.time
            raise NonFiniteError(
                f"body {number}: {text}", time=time, index=number, step=error.step
            ) from None

    @property
    def report(self) -> RigidReport:
        """What the last call of `step` or `advance` took and met."""
        told = self._native.diagnostics()
        last = self._last
        return RigidReport(
            last.steps,
            last.dt,
            self._options["substeps"] if last.dt > 0 else 0,
            contacts=int(told["contacts"]),
            penetration=told["penetration"],
            impacts=int(told["impacts"]),
            awake=int(told["awake"]),
            joint_error=told["joint_error"],
        )

    def step_limit(self) -> tuple[float, str]:
        """Longest step that keeps contacts and joints accurate, and why.

        Every step is stable. But where bodies touch is found once a step.

        Returns
        -------
        float
            In which no body that touches another or has a joint turns by more than a radian [s];
            infinite if none turns.
        str
            The reason, with the id of the body.
        """
        held = self._native.constrained()
        if not len(held):
            return math.inf, "no body is in contact or has a joint"
        rates = np.linalg.norm(self.angular_velocities[held], axis=1)
        fastest = int(np.argmax(rates))
        if rates[fastest] == 0:
            return math.inf, "no body in contact or with a joint turns"
        limit = float(_TURN / rates[fastest])
        return limit, f"body {self._ids[held[fastest]]} turns by {_TURN:g} rad"
