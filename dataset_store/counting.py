"""Numbers with what they count, in words."""

from __future__ import annotations

__all__ = ["counted"]

_LONG_PLURALS = ("ches", "shes", "sses", "xes")


def counted(count: int, things: str) -> str:
    """Write a number with what it counts: ``1 file``, ``2,000 files``, ``1 touch``."""
    if count == 1:
        things = things.removesuffix("es" if things.endswith(_LONG_PLURALS) else "s")
    return f"{count:,} {things}"
