"""What the commands of the Hub say alike."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["SHOWN", "listed"]

SHOWN = 8
"""Files of a longer list that are named."""


def listed(paths: Sequence[str]) -> str:
    """Name some files, and how many more there are."""
    more = f" and {len(paths) - SHOWN:,} more" if len(paths) > SHOWN else ""
    return ", ".join(paths[:SHOWN]) + more
