"""What a scene is: a name, checked parameters, and functions that build, record and draw it."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from ..errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..recording import Part, Recording

Value = bool | int | float | str | tuple[str, ...]

_WORDS = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}
_KINDS = {bool: "true or false", int: "an integer", float: "a finite number", str: "a text"}


class Simulation(Protocol):
    """What a scene builds; every simulation class of substep speaks it."""

    @property
    def time(self) -> float:
        """Time of the state [s]."""

    def advance(self, duration: float) -> Any:
        """Go on by `duration` [s], in as many steps as it takes."""

    def fields(self) -> Mapping[str, Any]:
        """Return (array, unit) by name; `position` is one of them, but of a grid."""

    def state(self) -> Any:
        """Return a copy of the whole state."""

    def restore(self, state: Any) -> None:
        """Go back to a state, bit for bit."""

    def save(self, path: Any) -> None:
        """Write the whole state to a file."""

    def load(self, path: Any) -> None:
        """Read the whole state from a file, bit for bit."""


def closest(word: str, known: Iterable[str]) -> str:
    """Return a hint for a word that is not known: the closest one that is, and the list."""
    listed = sorted(known)
    near = difflib.get_close_matches(word, listed, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}? " if near else ""
    return f"{hint}known: {', '.join(listed)}" if listed else "there are none"


def shorten(value: Any) -> str:
    """What came, in one line; containers by their kind only, for they may be nested without end."""
    if isinstance(value, (dict, list)):
        return "a table" if isinstance(value, dict) else "a list"
    text = repr(value) if not isinstance(value, bool) else str(value).lower()
    return text if len(text) <= 60 else f"{text[:57]}..."


@dataclass(frozen=True)
class Parameter:
    """One parameter of a scene, with what it may be.

    Parameters
    ----------
    doc : str
        What it is, in one line.
    default : bool, int, float, str or tuple of str, optional
        Its value where none is given. Without a default it must be given.
    kind : type, optional
        bool, int, float, str or tuple (several of `choices`); the default's type unless given.
    unit : str
        Unit of a number.
    minimum, maximum : float, optional
        Bounds, themselves allowed.
    above : float, optional
        Bound that is itself not allowed.
    choices : tuple of str
        The texts that are allowed.

    Raises
    ------
    InputError
        If the kind is none of these, or the default is not what it allows.

    Examples
    --------
    >>> from substep.scenes import Parameter
    >>> Parameter("time step", 0.1, unit="s", above=0).parse("step", "2.5e-1")
    0.25
    """

    doc: str
    default: Value | None = None
    kind: type | None = None
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    above: float | None = None
    choices: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.kind is None:
            object.__setattr__(self, "kind", str if self.default is None else type(self.default))
        if self.kind not in (*_KINDS, tuple):
            raise InputError(f"kind: expected bool, int, float, str or tuple, got {self.kind!r}")
        if self.default is not None:
            object.__setattr__(self, "default", self.check("default", self.default))

    def expected(self) -> str:
        """What a value must be, in words."""
        if self.choices:
            listed = ", ".join(self.choices)
            return f"some of {listed}" if self.kind is tuple else f"one of {listed}"
        words = _KINDS[self.kind or str]
        if self.above is not None:
            words += f" above {self.above:g}"
        if self.minimum is not None and self.maximum is not None:
            words += f" from {self.minimum:g} to {self.maximum:g}"
        elif self.minimum is not None:
            words += f" of at least {self.minimum:g}"
        elif self.maximum is not None:
            words += f" of at most {self.maximum:g}"
        return f"{words} [{self.unit}]" if self.unit else words

    def check(self, where: str, value: Any) -> Value:
        """Return the value in the parameter's own type, or raise.

        Parameters
        ----------
        where : str
            Begins the message.
        value : object
            What was given.

        Returns
        -------
        bool, int, float, str or tuple of str
            The value.

        Raises
        ------
        InputError
            If it is not what the parameter must be.
        """
        wrong = InputError(f"{where}: expected {self.expected()}, got {shorten(value)}")
        if self.kind is tuple:
            names = value.split(",") if isinstance(value, str) else value
            if not isinstance(names, (list, tuple)) or not names:
                raise wrong
            return tuple(self._choose(name, wrong) for name in names)
        if self.kind is str:
            if not isinstance(value, str):
                raise wrong
            if "\0" in value:
                raise InputError(f"{where}: expected a text without NUL, got {shorten(value)}")
            return self._choose(value, wrong) if self.choices else value
        if self.kind is bool:
            if not isinstance(value, bool):
                raise wrong
            return value
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise wrong
        if self.kind is int and isinstance(value, float):
            raise wrong
        try:
            inside = math.isfinite(value)
        except OverflowError:  # an integer beyond float64
            inside = False
        inside = inside and (self.above is None or value > self.above)
        inside = inside and (self.minimum is None or value >= self.minimum)
        if not inside or (self.maximum is not None and value > self.maximum):
            raise wrong
        return float(value) if self.kind is float else int(value)

    def parse(self, where: str, text: str) -> Value:
        """Return the value that `text` means, or raise as `check(where, value)` does."""
        value: Any = text
        if self.kind is bool:
            value = _WORDS.get(text.strip().lower(), text)
        elif self.kind in (int, float):
            try:
                value = float(text)
                if self.kind is int and value.is_integer():  # 1e6 is an integer that people type
                    value = int(value) if "e" in text.lower() or "." in text else int(text)
            except (ValueError, OverflowError):
                value = text
        return self.check(where, value)

    def _choose(self, value: Any, wrong: InputError) -> str:
        for choice in self.choices:
            if isinstance(value, str) and choice.lower() == value.strip().lower():
                return choice
        raise wrong


def particle_parts(simulation: Any) -> dict[str, Part]:
    """One part of all fields that the simulation offers: `particles`, or the cells of a `grid`.

    Cloth, nets and soft bodies are meshes. Of a `World` one for each member, under its name.
    """
    from ..recording import Part
    from .topology import shapes_of, topology_of

    parts = {}
    for name, member, columns in _blocks(simulation):
        units = {key: unit for key, (_, unit) in columns.items() if key != "position"}
        if "position" in columns:
            topology = topology_of(member)
            kind = "bodies" if "orientation" in units else "mesh" if topology else "particles"
            shapes = shapes_of(member) if kind == "bodies" else {}
            parts[name or "particles"] = Part(kind, units, **topology, **shapes)
        else:
            parts[name or "grid"] = Part("grid", units, bounds=member.bounds, cell=member.cell)
    return parts


def particle_frame(simulation: Simulation) -> dict[str, dict[str, Any]]:
    """One frame of `particle_parts(simulation)`."""
    frame = {}
    for name, _, units in _blocks(simulation):
        columns = {key: values for key, (values, _) in units.items()}
        if "position" in columns:
            frame[name or "particles"] = {"points": columns.pop("position"), **columns}
        else:
            frame[name or "grid"] = columns
    return frame


def _blocks(simulation: Any) -> list[tuple[str, Any, dict[str, tuple[Any, str]]]]:
    """Name, simulation and fields of each member of a world, or of the one simulation."""
    members = getattr(simulation, "members", {"": simulation})
    return [(name, member, _columns(member)) for name, member in members.items()]


def no_notes(simulation: Simulation) -> dict[str, str]:
    """Nothing about the `simulation` besides its parameters."""
    return {}


def no_summary(simulation: Simulation) -> str:
    """Nothing about the `simulation` besides what every run says."""
    return ""


def _columns(simulation: Simulation) -> dict[str, tuple[Any, str]]:
    return {name: (values, unit or "1") for name, (values, unit) in simulation.fields().items()}


@dataclass(frozen=True)
class Scene:
    """Everything that `substep run` needs to know about a scene.

    Parameters
    ----------
    name : str
        Lower-case letters, digits, `-` and `_`; names the files of a run.
    doc : str
        What it shows, in one line.
    parameters : mapping of str to Parameter
        They include `duration`, in units of `time_unit`.
    build : callable
        `build(parameters, seed)` returns a `Simulation` at its first state.
    parts : callable
        `parts(simulation)` returns the parts of the recording (name to `substep.Part`); one set
        of particles, or of cells, with every field by default, cloth and soft bodies as meshes,
        of a `World` one for each member.
    frame : callable
        `frame(simulation)` returns the arrays of one frame, by part.
    notes : callable
        `notes(simulation)` returns what else the recording shall know, as texts by name; they are
        its `parameters["notes"]`. Nothing by default.
    summary : callable
        `summary(simulation)` says in one line how the run ended; nothing by default.
    picture : callable, optional
        `picture(recording, frame, figure)` draws one frame on a matplotlib figure, a
        `substep.render.View` for example; a plain view of all parts unless given.
    still : callable, optional
        `still(recording)` returns the time [s] of the frame that a picture shows unless told
        otherwise, the one recorded nearest to it; the last frame unless given.
    frames : int
        Number of frames unless the run says otherwise, the first state included.
    time_unit : str
        Unit of `duration` and of frame rates.
    time_scale : float
        Length of that unit [s].
    quick : mapping
        Values of some parameters with which a run takes about a second: to try the scene, and for
        the tests.

    Examples
    --------
    >>> from substep.scenes import load
    >>> load("double-gyre").parameters["step"].unit
    's'
    """

    name: str
    doc: str
    parameters: Mapping[str, Parameter]
    build: Callable[[dict[str, Any], int], Simulation]
    parts: Callable[[Any], dict[str, Part]] = particle_parts
    frame: Callable[[Any], dict[str, dict[str, Any]]] = particle_frame
    notes: Callable[[Any], dict[str, str]] = no_notes
    summary: Callable[[Any], str] = no_summary
    picture: Callable[[Recording, int, Figure], None] | None = None
    still: Callable[[Recording], float] | None = None
    frames: int = 101
    time_unit: str = "s"
    time_scale: float = 1.0
    quick: Mapping[str, Value] = field(default_factory=dict)

    def __post_init__(self) -> None:
        plain = self.name.replace("-", "").replace("_", "")
        if not (plain.isalnum() and plain.isascii() and plain.islower() and len(self.name) <= 64):
            raise InputError(
                "name: expected at most 64 of a-z, 0-9, - and _, with a letter among them; "
                f"got {shorten(self.name)}"
            )
        if "duration" not in self.parameters:
            raise InputError(f"parameters of {self.name}: expected one named duration")
        for key in ("frames", "interval", "notes"):
            if key in self.parameters:
                raise InputError(f"parameters of {self.name}: the name {key} is taken")
        self.check(self.quick, lambda key: f"quick: {key}")

    def check(
        self,
        values: Mapping[str, Any],
        where: Callable[[str], str] = lambda key: key,
        parse: bool = False,
    ) -> dict[str, Value]:
        """Check some of the parameters.

        Parameters
        ----------
        values : mapping
            Values by key.
        where : callable
            `where(key)` begins a message about that key.
        parse : bool
            Whether the values are texts, as typed on a command line.

        Returns
        -------
        dict
            The values in the parameters' own types.

        Raises
        ------
        InputError
            If a key is unknown or a value is wrong.
        """
        checked = {}
        for key, value in values.items():
            parameter = self.parameters.get(key)
            if parameter is None:
                raise InputError(
                    f"{where(key)}: {self.name} has no such parameter; "
                    + closest(key, self.parameters)
                )
            checked[key] = (parameter.parse if parse else parameter.check)(where(key), value)
        return checked

    def complete(self, values: Mapping[str, Value]) -> dict[str, Any]:
        """All parameters: the checked `values`, and defaults for the rest.

        Raises
        ------
        InputError
            If one that has no default is missing.
        """
        for key, parameter in self.parameters.items():
            if key not in values and parameter.default is None:
                raise InputError(
                    f"{key}: {self.name} needs it: {parameter.doc}; say --set {key}=... or write "
                    f"it under [parameters] of the configuration"
                )
        return {key: values.get(key, p.default) for key, p in self.parameters.items()}
