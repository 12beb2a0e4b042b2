"""What users assign to: a name that does not exist, or cannot be changed, is refused."""

from __future__ import annotations

import difflib
import functools
import inspect
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import AttributeInputError


class Checked:
    """An object whose public attributes are those that its class declares.

    An annotation in the body of a class of substep declares an attribute that is set once, while
    the object is made; a property with a setter is one that can be changed. In a class that a user
    derives, what the body names or annotates can be changed at any time. Names that begin with an
    underscore are free.
    """

    if not TYPE_CHECKING:  # or type checkers would take every name

        def __setattr__(self, name: str, value: Any) -> None:
            if name[:1] != "_" and name not in settable(type(self)):
                made = name in _set_once(type(self)) and name not in self.__dict__
                if not made:
                    raise AttributeInputError(_refusal(type(self), name))
            object.__setattr__(self, name, value)


class Frozen:
    """An object that is made once: nothing is assigned after that, and its arrays are read-only.

    What a simulation was given (emitters, constraints) is read when that is made, so a change
    would do nothing.
    """

    if not TYPE_CHECKING:

        def __setattr__(self, name: str, value: Any) -> None:
            if name[:1] != "_" and "_frozen" in self.__dict__:
                raise AttributeInputError(
                    f"{name}: cannot be assigned to a {type(self).__name__} that is made; "
                    "what can be set: nothing, make another"
                )
            object.__setattr__(self, name, value)

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "__init__" in cls.__dict__:
            cls.__init__ = _freezing(cls.__init__)  # type: ignore[method-assign]


def _freezing(make: Any) -> Any:
    @functools.wraps(make)
    def made(self: Any, *args: Any, **keywords: Any) -> None:
        make(self, *args, **keywords)
        if type(self).__init__ is made:  # not that of a base
            for name, value in self.__dict__.items():
                if isinstance(value, np.ndarray) and name[:1] != "_":
                    view = value.view()
                    view.flags.writeable = False
                    self.__dict__[name] = view
            self.__dict__["_frozen"] = True

    return made


@functools.cache
def settable(kind: type) -> tuple[str, ...]:
    """Names that can be assigned to at any time."""
    names = set()
    for name in dir(kind):
        if name[:1] != "_":
            found = inspect.getattr_static(kind, name)
            if isinstance(found, property) and found.fset is not None:
                names.add(name)
    for owner in kind.__mro__:
        if not _is_ours(owner):
            names |= {n for n, v in vars(owner).items() if n[:1] != "_" and not callable(v)}
            names |= set(inspect.get_annotations(owner))
    return tuple(sorted(n for n in names if not _is_read_only(kind, n)))


@functools.cache
def _set_once(kind: type) -> frozenset[str]:
    names: set[str] = set()
    for owner in kind.__mro__:
        names |= set(inspect.get_annotations(owner))
    return frozenset(n for n in names if not isinstance(_static(kind, n), property))


def _static(kind: type, name: str) -> Any:
    return inspect.getattr_static(kind, name, None)


def _is_read_only(kind: type, name: str) -> bool:
    found = _static(kind, name)
    return isinstance(found, property) and found.fset is None


def _is_ours(owner: type) -> bool:
    return owner is object or owner.__module__.split(".")[0] == __name__.split(".")[0]


def _refusal(kind: type, name: str) -> str:
    """Why an attribute cannot be assigned, and what can."""
    can = settable(kind)
    setters = [n for n in dir(kind) if n.startswith("set_")]
    told = f"what can be set: {', '.join([*can, *(f'{n}()' for n in setters)]) or 'nothing'}"
    if name in _set_once(kind) or _static(kind, name) is not None:
        own = f"; {kind.__name__}.set_{name}() changes it" if f"set_{name}" in setters else ""
        return f"{name}: cannot be assigned to a {kind.__name__} that is made{own}; {told}"
    known = [n for n in {*dir(kind), *_set_once(kind)} if n[:1] != "_"]
    arguments = [n for n in inspect.signature(kind).parameters if n[:1] != "_"]
    if name in arguments:
        return f"{name}: is given when a {kind.__name__} is made, and cannot be changed; {told}"
    near = difflib.get_close_matches(name, sorted({*known, *arguments}), 1)
    hint = f", did you mean {near[0]}?" if near else ";"
    return f"{name}: a {kind.__name__} has no such attribute{hint} {told}"
