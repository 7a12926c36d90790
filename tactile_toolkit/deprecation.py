"""Former names of what users hold: they work for one version, with a warning that names what to write."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")
T = TypeVar("T")


def warn_former(former: str, name: str, stacklevel: int = 3) -> None:
    """Warn the caller of the caller that it used a former name."""
    warnings.warn(f"{former!r} is deprecated; use {name!r}", DeprecationWarning, stacklevel)


def former_arguments(**names: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Let a function take arguments by former keywords, too: ``former_arguments(old="new")``."""

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            for former in names.keys() & kwargs.keys():
                warn_former(former, names[former])
                kwargs[names[former]] = kwargs.pop(former)
            return function(*args, **kwargs)

        return call

    return decorate


def former_attributes(**names: str) -> Callable[[type[T]], type[T]]:
    """Let a dataclass take and give fields, or other attributes, by former names, too."""

    def decorate(kind: type[T]) -> type[T]:
        def former_attribute(former: str) -> property:
            def read(self: Any) -> Any:
                warn_former(former, names[former])
                return getattr(self, names[former])

            return property(read)

        setattr(kind, "__init__", former_arguments(**names)(kind.__init__))  # noqa: B010  (mypy)
        for former in names:
            setattr(kind, former, former_attribute(former))
        return kind

    return decorate
