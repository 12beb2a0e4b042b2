"""What users assign to: a name that does not exist, or cannot be changed, is refused."""

from __future__ import annotations

import difflib
import functools
import inspect
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import AttributeInputError


class Checked:
    """An object that is made once: after that its properties with a setter can be assigned.

    What `__init__` of a class of substep sets is fixed then. A class that a user (or a scene)
    derives may change what its own `__init__` sets and what its body names. Names that begin with
    an underscore are free.
    """

    _is_made = False
    _fixed: frozenset[str] = frozenset()

    if not TYPE_CHECKING:  # or type checkers would take every name

        def __setattr__(self, name: str, value: Any) -> None:
            if self._is_made and name[:1] != "_" and name not in settable(type(self)):
                if name in self._fixed or name not in self.__dict__:
                    raise AttributeInputError(_refusal(self, name))
            object.__setattr__(self, name, value)

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if "__init__" in cls.__dict__:
            cls.__init__ = _making(cls.__init__, _is_ours(cls))  # type: ignore[method-assign]


class Frozen(Checked):
    """What a simulation is given and reads while it is made: nothing of it can be changed."""


def _making(make: Any, ours: bool) -> Any:
    """`__init__` that notes what it sets, and when the object is made."""

    @functools.wraps(make)
    def made(self: Any, *args: Any, **keywords: Any) -> None:
        before = set(self.__dict__)
        make(self, *args, **keywords)
        own = self.__dict__
        if ours:
            own["_fixed"] = self._fixed | {n for n in own if n[:1] != "_" and n not in before}
        if type(self).__init__ is made:
            own["_is_made"] = True
            for name in self._fixed if isinstance(self, Frozen) else ():
                if isinstance(own[name], np.ndarray):
                    own[name] = own[name].view()
                    own[name].flags.writeable = False

    return made


@functools.cache
def settable(kind: type) -> tuple[str, ...]:
    """Names that can be assigned to at any time."""
    names = set()
    for name in dir(kind):
        found = inspect.getattr_static(kind, name)
        if name[:1] != "_" and isinstance(found, property) and found.fset is not None:
            names.add(name)
    for owner in kind.__mro__:
        if not _is_ours(owner):
            own = {**vars(owner), **inspect.get_annotations(owner)}
            names |= {n for n, v in own.items() if n[:1] != "_" and not _is_of_class(v)}
    return tuple(sorted(names))


def _is_of_class(value: Any) -> bool:
    return isinstance(value, (property, classmethod, staticmethod)) or inspect.isfunction(value)


def _is_ours(owner: type) -> bool:
    names = owner.__module__.split(".")
    return owner is object or (names[0] == __name__.split(".")[0] and names[1] != "scenes")


def _refusal(owner: Any, name: str) -> str:
    """Why an attribute cannot be assigned, and what can."""
    kind: Any = type(owner)
    word = f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}"
    setters = [n for n in dir(kind) if n.startswith("set_")]
    can = [*settable(kind), *(f"{n}()" for n in setters)]
    told = f"what can be set: {', '.join(can) or 'nothing; make another'}"
    arguments = inspect.signature(kind).parameters
    known = {n for n in [*dir(kind), *owner.__dict__, *arguments] if n[:1] != "_"}
    if name in known:
        own = f"; {kind.__name__}.set_{name}() changes it" if f"set_{name}" in setters else ""
        return f"{name}: cannot be changed once {word} is made{own}; {told}"
    near = difflib.get_close_matches(name, sorted(known), 1)
    hint = f"; did you mean {near[0]}?" if near else ";"
    return f"{name}: {word} has no such attribute{hint} {told}"
