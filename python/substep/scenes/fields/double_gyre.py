"""Particles stirred by the double gyre, dyed by where they began."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ... import Advection, DoubleGyre
from ..declaration import Parameter, Scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...recording import Recording


class DyedParticles(Advection):
    """Particles in the box [0, 2] x [0, 1] that remember how far to the right they began."""

    def __init__(
        self, field: DoubleGyre, positions: NDArray[Any], step: float, method: str
    ) -> None:
        super().__init__(field, positions, step=step, method=method)
        self._start = positions[:, 0].astype(np.float32)

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Positions and the start's x, float32: for pictures, to 1e-7 of the box."""
        return {
            "position": (self.positions.astype(np.float32), "m"),
            "start": (self._start.copy(), "m"),
        }


def _build(parameters: dict[str, Any], seed: int) -> DyedParticles:
    random = np.random.default_rng(seed)
    positions = random.random((parameters["particles"], 2)) * (2.0, 1.0)
    field = DoubleGyre(parameters["amplitude"], parameters["epsilon"], parameters["omega"])
    return DyedParticles(field, positions, parameters["step"], parameters["method"])


def _picture(recording: Recording, frame: int, figure: Figure) -> None:
    from ...view import marker_area

    arrays = recording.frame(frame)["particles"]
    axes = figure.add_subplot()
    shown = axes.scatter(
        arrays["points"][:, 0],
        arrays["points"][:, 1],
        c=arrays["start"],
        s=marker_area(len(arrays["points"])),
        vmin=0,
        vmax=2,
        linewidths=0,
        rasterized=True,
    )
    axes.set(xlim=(0, 2), ylim=(0, 1), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(
        f"Double gyre: {len(arrays['points']):,} particles after {recording.times[frame]:.3g} s",
        loc="left",
    )
    axes.spines[["top", "right"]].set_visible(True)
    figure.colorbar(shown, ax=axes, label="x at the start [m]", shrink=0.82)


SCENE = Scene(
    name="double-gyre",
    doc="Particles stirred by two vortices whose border swings, dyed by where they began.",
    parameters={
        "duration": Parameter("time simulated", 30.0, unit="s", above=0),
        "particles": Parameter("number of particles", 50_000, minimum=1, maximum=10**8),
        "step": Parameter("time step", 0.05, unit="s", above=0),
        "method": Parameter("integrator", "rk4", choices=("euler", "midpoint", "heun", "rk4")),
        "amplitude": Parameter("amplitude of the flow", 0.1, unit="m/s"),
        "epsilon": Parameter("swing of the border", 0.25, unit="m", minimum=0, maximum=0.5),
        "omega": Parameter("angular frequency of the swing", 0.6283185307179586, unit="rad/s"),
    },
    quick={"duration": 2.0, "particles": 300},
    build=_build,
    picture=_picture,
    frames=121,
)
