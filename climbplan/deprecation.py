"""Old names of the Python interface, which keep working and say what replaced them."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

_P = ParamSpec("_P")
_T = TypeVar("_T")


def warn_renamed(old: str, new: str, stacklevel: int = 3) -> None:
    """Warn that the user's code has an old name; `stacklevel` as of `warnings.warn`."""
    warnings.warn(f"{old} is now {new}", FutureWarning, stacklevel=stacklevel)


def renamed_parameters(**renamed: str) -> Callable[[Callable[_P, _T]], Callable[_P, _T]]:
    """Let a function take old keyword names, given as `old="new"`, with a warning for each.

    The decorated function raises TypeError where old and new name of one parameter are both given.
    """

    def decorate(function: Callable[_P, _T]) -> Callable[_P, _T]:
        @wraps(function)
        def call(*arguments: _P.args, **keywords: _P.kwargs) -> _T:
            for old, new in renamed.items():
                if old in keywords:
                    if new in keywords:
                        raise TypeError(f"`{old}` is the old name of `{new}`: give one of them")
                    warn_renamed(f"the parameter `{old}`", f"`{new}`")
                    keywords[new] = keywords.pop(old)
            return function(*arguments, **keywords)

        return call

    return decorate


class RenamedAttribute:
    """An attribute or method of a class under its old name; reading it warns."""

    def __init__(self, new: str) -> None:
        self._new = new

    def __set_name__(self, owner: type, name: str) -> None:
        self._shown = f"{owner.__name__}.{name}"
        self._shown_new = f"{owner.__name__}.{self._new}"

    def __get__(self, instance: object, owner: type) -> Any:
        """Return what the new name gives; the class itself has the same without a warning."""
        if instance is None:
            return getattr(owner, self._new)
        warn_renamed(f"`{self._shown}`", f"`{self._shown_new}`")
        return getattr(instance, self._new)
