"""A handle spins about its middle axis in free fall, and turns over again and again."""

from __future__ import annotations

import weakref
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...base.checks import check_array, check_real
from ...base.quaternions import rotate
from ...base.simulation import Simulation
from ...geometry import Box, Cylinder, TriangleMesh
from ...rigid import MassProperties, compound, free_rotation, mass_properties
from ...view import Camera, Look, View
from ...view.view import default_title
from ..declaration import Parameter, Scene
from .rigid_bodies import joined, shifted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...recording import Part, Recording

Array = NDArray[np.float64]

METHODS = ("exact", "splitting", "quaternion", "matrix")
COLORS = ("#0072b2", "#009e73", "#d55e00", "#cc79a7")  # Okabe and Ito's
APART, REACH = 1.5, 0.62  # of their middles, and of what they sweep [m]
UPRIGHT = np.array([1.0, 1.0, 0.0, 0.0]) / np.sqrt(2)  # turns the y axis to the z axis
SHOWN = 0.6  # of the picture's height, by the tops; the energy is below


def _handle() -> tuple[MassProperties, TriangleMesh]:
    """A bar along x, and a shaft along y from its middle, the axis of intermediate inertia."""
    placed = [
        (Cylinder(0.07, 1.0), np.zeros(3), np.array([1.0, 0, 1, 0]) / np.sqrt(2)),
        (Cylinder(0.055, 0.48), np.array([0, 0.26, 0]), np.array([1.0, -1, 0, 0]) / np.sqrt(2)),
    ]
    body = compound(mass_properties(solid).moved(x, q) for solid, x, q in placed)
    meshes = [shifted(solid.mesh(48), x - body.center_of_mass, q) for solid, x, q in placed]
    return body, joined(meshes)


def _plate() -> tuple[MassProperties, TriangleMesh]:
    box = Box((1.0, 0.5, 0.2))
    return mass_properties(box, 10.0), box.mesh()


class Tops(Simulation):
    """One top under several methods for the rotation of a body on which no torque acts.

    Parameters
    ----------
    parameters : dict
        Of the scene.
    """

    def __init__(self, parameters: dict[str, Any]) -> None:
        body, self.mesh = _handle() if parameters["shape"] == "handle" else _plate()
        self.methods, self._step_size = parameters["methods"], parameters["step"]
        self.inertia: Array = body.principal_inertia
        n = len(self.methods)
        rates = parameters["spin"] * np.array([parameters["tilt"], 1.0, 0.0])
        self.momenta: Array = np.tile(rotate(UPRIGHT, self.inertia * rates), (n, 1))
        self.rotations: Array = np.tile(UPRIGHT, (n, 1))
        self.flips = np.zeros(n, np.int64)
        self.first, self.last = np.zeros(n), np.zeros(n)  # times of the flips [s]
        super().__init__(SimpleNamespace(time=0.0, threads=0, step=self._turn), 0.0, None)
        self._energy_at_start = self.energies()

    def rates(self) -> Array:
        """Angular velocities along the axes of each body [rad/s], shape (methods, 3)."""
        return rotate(self.rotations * [1, -1, -1, -1], self.momenta) / self.inertia

    def energies(self) -> Array:
        """Of rotation [J], shape (methods,)."""
        energies: Array = 0.5 * (self.rates() ** 2 @ self.inertia)
        return energies

    def _turn(self, dt: float) -> None:
        """One step of each top; it turns over where the spin about its shaft changes sign."""
        before = self.rates()[:, 1]
        each = zip(self.methods, self.rotations, self.momenta, strict=True)
        self.rotations = np.vstack(
            [free_rotation(q[None], L[None], self.inertia[None], dt, method=m) for m, q, L in each]
        )
        after = self.rates()[:, 1]
        for k in np.flatnonzero(before * after < 0):
            self.last[k] = self.time + dt * before[k] / (before[k] - after[k])
            if self.flips[k] == 0:
                self.first[k] = self.last[k]
            self.flips[k] += 1
        self._native.time += dt

    def step_limit(self) -> tuple[float, str]:
        """The step, which is fixed."""
        return self._next_step(), "fixed"

    def diagnostics(self) -> dict[str, float]:
        """Energy of each method's top [J]."""
        return dict(zip(self.methods, self.energies().tolist(), strict=True))

    def fields(self) -> dict[str, tuple[NDArray[Any], str]]:
        """Arrays with one row per method, and their units."""
        n = len(self.methods)
        x = np.zeros((n, 3))
        x[:, 0] = APART * (np.arange(n) - (n - 1) / 2)
        return {
            "position": (x, "m"),
            "orientation": (self.rotations.copy(), "1"),
            "angular_velocity": (rotate(self.rotations, self.rates()), "rad/s"),
            "energy": (self.energies(), "J"),
        }

    def state(self) -> dict[str, Any]:
        """A copy of the whole state."""
        arrays = {name: getattr(self, name).copy() for name in ("rotations", *_MEASURED)}
        return {"time": self.time, **arrays}

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to a state, bit for bit."""
        time, n = check_real("time", state["time"]), len(self.methods)
        rotations = check_array("rotations", state["rotations"], (n, 4))
        measured = {
            name: check_array(name, state[name], (n,), dtype=getattr(self, name).dtype)
            for name in _MEASURED
        }
        self._native.time, self.rotations = time, rotations.copy()
        for name, values in measured.items():
            setattr(self, name, values.copy())

    def words(self) -> str:
        """Flips, and what became of the energy."""
        drift = self.energies() / self._energy_at_start - 1
        texts = []
        for k, method in enumerate(self.methods):
            n = int(self.flips[k])
            every = f", one in {(self.last[k] - self.first[k]) / (n - 1):.5f} s" if n > 1 else ""
            texts.append(f"{method} {n} flips{every}, energy {100 * drift[k]:+.1g} %")
        return "; ".join(texts)


_MEASURED = ("flips", "first", "last")


def _parts(tops: Tops) -> dict[str, Part]:
    """The surface of each body, named after its method, and what is known of all of them."""
    from ...recording import Part

    units = {name: unit for name, (_, unit) in tops.fields().items() if name != "position"}
    surfaces = {method: Part("mesh", triangles=tops.mesh.faces) for method in tops.methods}
    return {**surfaces, "tops": Part("bodies", units)}


def _frame(tops: Tops) -> dict[str, dict[str, Any]]:
    columns = {name: values for name, (values, _) in tops.fields().items()}
    x = columns.pop("position")
    surfaces = {
        method: {"points": (rotate(q, tops.mesh.vertices) + p).astype(np.float32)}
        for method, q, p in zip(tops.methods, tops.rotations, x, strict=True)
    }
    return {**surfaces, "tops": {"points": x, **columns}}


def _box(recording: Recording) -> Array:
    half = APART * (len(recording.parameters["methods"]) - 1) / 2 + REACH
    return np.array([[-half, -REACH, -REACH], [half, REACH, REACH]])


_LOOKS = {method: Look(color) for method, color in zip(METHODS, COLORS, strict=True)}
_VIEW = View(
    Camera(-90.0, 12.0, 0.86),
    {"tops": Look(hidden=True), **_LOOKS},
    box=_box,
    ground=lambda recording: None,
)
_histories: weakref.WeakKeyDictionary[Recording, Array] = weakref.WeakKeyDictionary()


def _history(recording: Recording) -> Array:
    """Relative errors of the energy, shape (frames, methods); read once for a film."""
    if recording not in _histories:
        frames = range(len(recording))
        energies = np.array([recording.frame(k)["tops"]["energy"] for k in frames])
        _histories[recording] = np.maximum(np.abs(energies / energies[0] - 1), 1e-16)
    return _histories[recording]


def _spread(heights: Array, gap: float) -> Array:
    """Heights from 0 to 1, moved apart to a gap at least, in the same order."""
    order = np.argsort(heights, kind="stable")
    steps = gap * np.arange(len(order))
    raised = np.maximum.accumulate(heights[order] - steps)
    spread = np.empty_like(heights)
    spread[order] = np.minimum(raised, 1 - steps[-1]) + steps
    return spread


def _picture(recording: Recording, frame: int, figure: Figure) -> None:
    """The tops side by side, and the errors of their energies below."""
    width, height = np.rint(figure.get_size_inches() * figure.dpi).astype(int)
    figure.set_layout_engine("none")
    axes: Any = figure.add_axes((0, 1 - SHOWN, 1, SHOWN))
    axes.set_axis_off()
    pixels = _VIEW.image(recording, frame, (int(width), round(SHOWN * height)))
    figure.set_facecolor(tuple(pixels[-1, 0] / 255))
    axes.imshow(pixels, aspect="auto", interpolation="none")
    figure.text(0.02, 0.965, default_title(recording, frame), va="top", fontsize=11)
    below: Any = figure.add_axes((0.1, 0.12, 0.76, 0.97 - SHOWN - 0.14))
    error, times = _history(recording), recording.times
    low, high = np.log10([error.min() / 4, 4 * error.max()])
    heights = _spread((np.log10(error[frame]) - low) / (high - low), 0.11)
    for k, method in enumerate(recording.parameters["methods"]):
        style: dict[str, Any] = {"color": _LOOKS[method].color}
        below.plot(times[: frame + 1], error[: frame + 1, k], lw=1.6, **style)
        place = {"transform": below.transAxes, "va": "center", "fontsize": 10}
        below.text(1.01, heights[k], method, **place, **style)
    below.set(yscale="log", ylim=(10**low, 10**high), xlim=(0, times[-1] or 1))
    below.set(xlabel="time [s]", ylabel="relative error\nof the energy")
    below.minorticks_off()
    below.grid(True, color="0.85")
    below.set_facecolor("none")


SCENE = Scene(
    name="tumbling-top",
    doc="A handle that spins about its middle axis turns over again and again.",
    parameters={
        "duration": Parameter("time simulated", 20.0, unit="s", above=0),
        "shape": Parameter("what spins", "handle", choices=("handle", "plate")),
        "spin": Parameter("spin about the middle axis", 5.0, unit="rad/s", above=0),
        "tilt": Parameter("spin about the axis beside it, over that", 2e-3, minimum=-1, maximum=1),
        "methods": Parameter("methods of rotation", METHODS, choices=METHODS),
        "step": Parameter("time step", 1 / 240, unit="s", above=0),
    },
    quick={"duration": 0.5},
    build=lambda parameters, seed: Tops(parameters),
    parts=_parts,
    frame=_frame,
    summary=Tops.words,
    picture=_picture,
    frames=501,
)
