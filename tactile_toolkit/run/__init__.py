"""Where tasks run: the calling process, local processes, a Ray cluster."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tactile_toolkit.lazy_names import on_first_use

if TYPE_CHECKING:
    from tactile_toolkit.run.parts import Check, Finish, Part
    from tactile_toolkit.run.processes import InlineRunner, ProcessRunner, Runner
    from tactile_toolkit.run.ray import RayRunner

__all__ = ["Check", "Finish", "InlineRunner", "Part", "ProcessRunner", "RayRunner", "Runner"]

__getattr__, __dir__ = on_first_use(
    __name__,
    {
        "tactile_toolkit.run.parts": ("Check", "Finish", "Part"),
        "tactile_toolkit.run.processes": ("InlineRunner", "ProcessRunner", "Runner"),
        "tactile_toolkit.run.ray": ("RayRunner",),
    },
)
