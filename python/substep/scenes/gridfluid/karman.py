"""A cylinder in a stream sheds vortices; drag, lift and their frequency beside published values."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import Collider, Sphere
from ...gridfluid import GridFlow, Inflow, Wall
from ...view.field_sheet import draw_field
from ..declaration import Parameter, Scene
from ..measured import Measured
from .flows import InBox

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...recording import Part, Recording

Array = NDArray[np.float64]

# The diameter is 1 m, and the speed far away 1 m/s; lengths in diameters, times over that speed.
BEFORE, BEHIND = 7, 19
SHOWN = (-2.5, 17.5, -4.0, 4.0)
SETTLED = 0.6  # of the duration, after which the mean values are taken
# Of others at Re 100 in a boundless stream, the least and the largest of seven (Table 1 of Qu et
# al., J. Fluids Struct. 39, 347, 2013), and the Strouhal number that Williamson measured.
DRAG, LIFT = (1.319, 1.336), (0.222, 0.235)
INK, BLUE, RED = "#30363d", "#0072b2", "#d55e00"


def strouhal(reynolds: Any) -> Any:
    """Williamson (1989), measured from Re 50 to 180."""
    return -3.3265 / reynolds + 0.1816 + 1.6e-4 * reynolds


class Karman(InBox, Measured, GridFlow):
    """A cylinder of 1 m in a stream of 1 m/s, and what acts on it.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    """

    def __init__(self, parameters: dict[str, Any]) -> None:
        half = parameters["width"] / 2
        self.settled = SETTLED * parameters["duration"]
        self.cylinder = Collider(Sphere(0.5, (0, 0, 0)))
        self._before = np.zeros(3)
        super().__init__(
            [(-BEFORE, -half), (BEHIND, half)],
            1 / parameters["cells"],
            viscosity=1 / parameters["reynolds"],
            velocity=_start,
            colliders=[self.cylinder],
            sides=[(Inflow((1.0, 0.0)), "open"), Wall(slip=True)],
            largest_step=0.1,
        )
        # Drag and lift of the last step, sums over the settled time of time, drag, lift and its
        # square; number, first and last time of the lift's zeros upwards.
        self.measured = {"forces": np.zeros(2), "sums": np.zeros(4), "zeros": np.zeros(3)}

    def advance(self, duration: float, callback: Callable[[Any], object] | None = None) -> None:
        """Take steps over a duration [s], and measure after each of them."""
        self._before = np.zeros(3)  # the cylinder counts anew
        super().advance(duration, callback)

    def after_step(self) -> None:
        """Drag and lift of the step, and what follows from them."""
        forces, sums, zeros = self.measured.values()
        now = np.array([*self.cylinder.impulse[:2], self.cylinder.duration])
        change, self._before = now - self._before, now
        dt, lift_before = change[2], forces[1]
        forces[:] = 2 * change[:2] / dt
        if self.time < self.settled:
            return
        drag, lift = forces
        sums += dt * np.array([1.0, drag, lift, lift**2])
        if lift_before < 0 <= lift:
            zeros[2] = self.time - dt * lift / (lift - lift_before)
            zeros[1] = zeros[1] or zeros[2]
            zeros[0] += 1

    @property
    def strouhal(self) -> float:
        """Vortex pairs a second, by the zeros of the lift; NaN before there are two."""
        count, first, last = self.measured["zeros"]
        return float((count - 1) / (last - first)) if count > 1 else np.nan

    def words(self) -> str:
        """Frequency and forces."""
        time, *sums = self.measured["sums"]
        if not time:
            return ""
        drag, lift, square = (x / time for x in sums)
        text = f"drag {drag:.4g}, lift {np.sqrt(max(square - lift**2, 0)):.3g} (rms)"
        if np.isfinite(self.strouhal):
            text = f"Strouhal number {self.strouhal:.4f}, {text}"
        return text

    def parts(self) -> dict[str, Part]:
        """The cells, and the cylinder with what acts on it."""
        from ...recording import Part

        units = {"drag": "1", "lift": "1", "strouhal": "1"}
        return {**super().parts(), "cylinder": Part("particles", units)}

    def frame(self) -> dict[str, dict[str, Any]]:
        """One frame of `parts`; the Strouhal number is 0 before it is known."""
        drag, lift = self.measured["forces"]
        values = {"drag": [drag], "lift": [lift], "strouhal": [np.nan_to_num(self.strouhal)]}
        return {**super().frame(), "cylinder": {"points": np.zeros((1, 2)), **values}}


def _start(x: Array) -> Array:
    """A stream that is bent a little behind the cylinder, so that it need not wait for chance."""
    bend = 0.3 * np.exp(-((x[:, 0] - 1.5) ** 2) - x[:, 1] ** 2)
    return np.stack([np.ones(len(x)), bend], axis=1)


_histories: weakref.WeakKeyDictionary[Recording, dict[str, Array]] = weakref.WeakKeyDictionary()


def _history(recording: Recording) -> dict[str, Array]:
    """Drag, lift and Strouhal number of all frames; read once for a film."""
    if recording not in _histories:
        part = recording["cylinder"]
        _histories[recording] = {
            name: np.array([part.field(name, k)[0] for k in range(len(recording))])
            for name in part.info.fields
        }
    return _histories[recording]


def _picture(recording: Recording, frame: int, figure: Figure) -> None:
    """The street above; below, drag and lift against time, and the frequency beside others'."""
    reynolds, times = recording.parameters["reynolds"], recording.times
    grid = figure.add_gridspec(2, 3, height_ratios=(1.9, 1), width_ratios=(1, 1, 0.8))
    axes: Any = figure.add_subplot(grid[0, :])
    vorticity = recording["flow"].field("vorticity", frame)
    image = draw_field(axes, recording.parts["flow"], vorticity, (-1.8, 1.8), "RdBu_r")
    x, y = 0.5 * np.cos(angle := np.linspace(0, 2 * np.pi, 100)), 0.5 * np.sin(angle)
    axes.fill(x, y, facecolor="#c9ced4", edgecolor=INK, linewidth=1.0, zorder=3)
    axes.set(xlim=SHOWN[:2], ylim=SHOWN[2:])
    axes.set_title(
        f"Vortex street behind a cylinder, Re {reynolds:g}, t = {times[frame]:.1f} s", loc="left"
    )
    axes.spines[["top", "right"]].set_visible(True)
    figure.colorbar(image, ax=axes, label="vorticity [1/s]", shrink=0.85, pad=0.01)
    history = _history(recording)
    _draw_forces(figure, grid, times, frame, history, reynolds == 100)
    _draw_strouhal(figure.add_subplot(grid[1, 2]), reynolds, history["strouhal"][frame])


def _draw_forces(
    figure: Figure, grid: Any, times: Array, frame: int, history: dict[str, Array], known: bool
) -> None:
    published = {
        "drag": [DRAG],
        "lift": [np.sqrt(2) * np.array(LIFT), -np.sqrt(2) * np.array(LIFT)],
    }
    for k, (name, color) in enumerate((("drag", BLUE), ("lift", RED))):
        axes: Any = figure.add_subplot(grid[1, k])
        for n, (low, high) in enumerate(published[name] if known else []):
            label = "published, Re 100" if n == 0 else None
            axes.axhspan(low - 0.002, high + 0.002, color="0.8", lw=0, label=label)
        axes.plot(times[1 : frame + 1], history[name][1 : frame + 1], color=color, lw=1.2)
        late = history[name][len(times) // 10 :]
        room = 0.15 * (np.ptp(late) + 0.1)
        axes.set(xlim=(0, times[-1]), ylim=(late.min() - room, late.max() + 2.5 * room))
        axes.set(xlabel="time [s]", ylabel=f"{name} coefficient")
        if known:
            axes.legend(loc="upper left", frameon=False, fontsize=8, borderaxespad=0)


def _draw_strouhal(axes: Any, reynolds: float, found: float) -> None:
    x = np.linspace(50, 180, 50)
    axes.plot(x, strouhal(x), color="0.6", lw=2, label="measured (Williamson)")
    if found:
        axes.plot(reynolds, found, "o", color=INK, ms=6, label=f"here {found:.3f}")
    axes.set(xlabel="Reynolds number", ylabel="Strouhal number", ylim=(0.11, 0.23))
    axes.legend(loc="upper left", frameon=False, fontsize=8, borderaxespad=0)


SCENE = Scene(
    name="karman",
    doc="A cylinder in a stream sheds a street of vortices; its drag, lift and frequency.",
    parameters={
        "duration": Parameter("time simulated", 120.0, unit="s", above=0),
        "reynolds": Parameter("Reynolds number of the cylinder", 100.0, minimum=1, maximum=300),
        "cells": Parameter("cells across the cylinder", 12, minimum=4, maximum=100),
        "width": Parameter("width of the stream, in diameters", 20, minimum=4, maximum=100),
    },
    quick={"duration": 1.0, "cells": 4, "width": 6},
    build=lambda parameters, seed: Karman(parameters),
    parts=Karman.parts,
    frame=Karman.frame,
    summary=Karman.words,
    picture=_picture,
    frames=241,
)
