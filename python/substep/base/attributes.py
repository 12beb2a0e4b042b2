"""What users assign to: a name that does not exist, or cannot be changed, is refused."""

from __future__ import annotations

import difflib
import functools
import inspect
import sys
from abc import ABCMeta
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import AttributeInputError

# What people call things: for hints, where the right word can be set.
_WORDS = {
    "acceleration": "gravity",
    "bounciness": "restitution",
    "center": "position",
    "delta_t": "step_size",
    "dt": "step_size",
    "external_forces": "forces",
    "g": "gravity",
    "h": "step_size",
    "mu": "friction",
    "n_threads": "threads",
    "num_threads": "threads",
    "orientation": "rotation",
    "orientations": "rotations",
    "step": "step_size",
    "time_step": "step_size",
    "timestep": "step_size",
    "v": "velocities",
    "x": "positions",
}


class _Making(ABCMeta):
    """An object is made once its outermost `__init__` has returned, whoever wrote that."""

    if not TYPE_CHECKING:  # or type checkers would take any arguments

        def __call__(cls, *args: Any, **keywords: Any) -> Any:
            one = super().__call__(*args, **keywords)
            one._finish()
            return one

    @property
    def __signature__(cls) -> inspect.Signature:
        """That of `__init__`, which that of `__call__` would hide."""
        make = inspect.signature(cls.__init__)  # type: ignore[misc]
        return make.replace(parameters=list(make.parameters.values())[1:])


class Checked(metaclass=_Making):
    """An object that is made once: after that its properties with a setter can be assigned.

    What code of substep sets while it is made is fixed then. A class that a user (or a scene)
    derives may change what its own code sets and what its body names. Names that begin with an
    underscore are free.
    """

    _is_made = False
    _fixed: frozenset[str] = frozenset()
    _read_only: frozenset[str] = frozenset()  # arrays; numpy forgets it in pickles and deep copies

    if not TYPE_CHECKING:  # or type checkers would take every name

        def __setattr__(self, name: str, value: Any) -> None:
            if self._is_made and not _is_open(self, name):
                raise AttributeInputError(_refusal(self, name))
            object.__setattr__(self, name, value)
            if not self._is_made and name[:1] != "_" and name in self.__dict__:
                if is_ours(sys._getframe(1).f_globals.get("__name__", "")):
                    self._fixed |= {name}

        def __getattr__(self, name: str) -> Any:
            kind = type(self)
            hint = _given_to(kind, name)
            told = f"{kind.__name__!r} object has no attribute {name!r}"
            raise AttributeError(f"{told}; {hint}" if hint else told, name=name, obj=self)

        def __delattr__(self, name: str) -> None:
            if self._is_made and not (name in self.__dict__ and _is_open(self, name)):
                raise AttributeInputError(f"{name}: attributes of {_word(self)} cannot be deleted")
            object.__delattr__(self, name)

    def _finish(self) -> None:
        """The object is made."""
        self._is_made = True
        arrays = {n: v for n, v in self.__dict__.items() if isinstance(v, np.ndarray)}
        self._read_only = frozenset(n for n, v in arrays.items() if not v.flags.writeable)

    def _freeze(self) -> None:
        """Make read-only again, in a copy, what was."""
        for name in self._read_only:
            if isinstance(self.__dict__.get(name), np.ndarray):
                self.__dict__[name].flags.writeable = False


class Frozen(Checked):
    """What a simulation is given and reads while it is made: nothing of it can be changed."""

    def _finish(self) -> None:
        for name in self._fixed:
            value = self.__dict__.get(name)
            if isinstance(value, np.ndarray) and value.flags.writeable:
                self.__dict__[name] = value.view()
                self.__dict__[name].flags.writeable = False
        super()._finish()

    def __getstate__(self) -> dict[str, Any]:
        """All but what is computed when it is asked for."""
        kind = type(self)
        return {
            name: value
            for name, value in self.__dict__.items()
            if not isinstance(getattr(kind, name, None), functools.cached_property)
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._freeze()


@functools.cache
def _named(kind: type) -> dict[str, bool]:
    """Names in the bodies of a class and its bases, and whether they can be assigned to."""
    found = {}
    for owner in reversed(kind.__mro__):
        theirs = not is_ours(owner.__module__)
        for name, value in {**inspect.get_annotations(owner), **vars(owner)}.items():
            if isinstance(value, property):
                found[name] = value.fset is not None
            else:
                found[name] = theirs and not _is_of_class(value)
    return found


def settable(kind: type) -> tuple[str, ...]:
    """Names that can be assigned to at any time."""
    return tuple(sorted(n for n, can in _named(kind).items() if can and n[:1] != "_"))


def _is_open(owner: Checked, name: str) -> bool:
    """Whether a name of an object that is made can be assigned to."""
    if name[:1] == "_":
        return True
    return name not in owner._fixed and _named(type(owner)).get(name, name in owner.__dict__)


def _is_of_class(value: Any) -> bool:
    return isinstance(value, (classmethod, staticmethod)) or inspect.isroutine(value)


def is_ours(module: str) -> bool:
    """Whether a module is of substep, and not a scene's."""
    return module.startswith("substep.") and not module.startswith("substep.scenes.")


def _word(owner: Checked) -> str:
    name = type(owner).__name__
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"


@functools.cache
def _given_to(kind: type, name: str) -> str:
    """Which methods take what is no attribute, as the friction of bodies."""
    if name[:1] == "_":
        return ""
    methods = {n: getattr(kind, n) for n in dir(kind) if n[:1] != "_"}
    ours = {n: m for n, m in methods.items() if is_ours(str(getattr(m, "__module__", "")))}
    takers = [f"{n}()" for n, m in ours.items() if name in inspect.signature(m).parameters]
    return f"it is an argument of {' and '.join(takers)}" if takers else ""


def _refusal(owner: Checked, name: str) -> str:
    """Why an attribute cannot be assigned, and what can."""
    kind: Any = type(owner)
    can = {n: n for n in settable(kind) if n not in owner._fixed}
    can |= {n[4:]: f"{n}()" for n in dir(kind) if n.startswith("set_")}
    told = f"what can be set: {', '.join(can.values()) or 'nothing; make another'}"
    meant = _WORDS.get(name)
    if name in {*dir(kind), *owner.__dict__, *inspect.signature(kind).parameters}:
        why = f"cannot be changed once {_word(owner)} is made"
        if name in can:
            return f"{name}: {why}; {kind.__name__}.{can[name]} changes it; {told}"
    else:
        why = f"{_word(owner)} has no such attribute"
        if hint := _given_to(kind, name):
            why += f", {hint}"
        if meant not in can:
            meant = next(iter(difflib.get_close_matches(name, can, 1, 0.7)), None)
    meaning = f"; did you mean {can[meant]}?" if meant in can else ";"
    return f"{name}: {why}{meaning} {told}"
