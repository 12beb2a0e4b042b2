"""Objects that one thread uses at a time, by construction: all that is public takes them."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from .. import _core
from .attributes import Checked, is_ours

if TYPE_CHECKING:
    from typing_extensions import Self


class Owned(Checked):
    """One thread at a time uses the object, which may do so again within its own calls.

    While a call takes steps, other threads are refused with InputError; until then they wait. The
    public methods and properties of every class of substep that derives from this are so.
    """

    _owner: _core.Owner

    def __new__(cls, *args: Any, **keywords: Any) -> Self:
        """An object that nobody uses."""
        one = super().__new__(cls)
        one.__dict__["_owner"] = _core.Owner(cls.__name__)
        return one

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if not is_ours(cls.__module__):
            return
        for name, member in list(vars(cls).items()):
            if name[0] == "_" and name not in ("__len__", "__getstate__"):
                continue
            if inspect.isfunction(member) and not hasattr(member, "_takes_by_itself"):
                setattr(cls, name, _alone(member))
            elif isinstance(member, property):
                get, put = (f and _alone(f) for f in (member.fget, member.fset))
                setattr(cls, name, property(get, put, None, member.__doc__))

    def _commit(self, parts: dict[str, Any], call: Callable[..., Any], *arguments: Any) -> Any:
        """Call what changes all or nothing, and set attributes with it: no signal comes between."""
        return _core.commit(self.__dict__, parts, call, arguments)

    def __getstate__(self) -> Any:
        return {name: value for name, value in self.__dict__.items() if name != "_owner"}


def takes_by_itself(function: Callable[..., Any]) -> Any:
    """The method, which does not take the object: those that it calls do, for as long as they run.

    What takes long without the object, as a disk does, is left to other threads.
    """
    function.__dict__["_takes_by_itself"] = True
    return function


def _alone(function: Callable[..., Any]) -> Any:
    """The function, which takes the object for as long as it runs."""
    return functools.update_wrapper(_core.alone(function), function)
