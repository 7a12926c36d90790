"""Where tasks run: the calling process, local processes, a Ray cluster."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tactile_toolkit.run.parts import Check, Finish, Part
    from tactile_toolkit.run.processes import InlineRunner, ProcessRunner, Runner
    from tactile_toolkit.run.ray import RayRunner

__all__ = ["Check", "Finish", "InlineRunner", "Part", "ProcessRunner", "RayRunner", "Runner"]

_HOMES = {
    "Check": "parts",
    "Finish": "parts",
    "Part": "parts",
    "InlineRunner": "processes",
    "ProcessRunner": "processes",
    "Runner": "processes",
    "RayRunner": "ray",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    message = f"module {__name__!r} has no attribute {name!r}"
    raise AttributeError(message)


def __dir__() -> list[str]:
    return sorted(__all__)
