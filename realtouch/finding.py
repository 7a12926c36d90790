"""A finding of a check of recordings."""

from __future__ import annotations

from dataclasses import dataclass

MAX_NAMED = 20
"""Touches that a finding names; it counts the others."""


@dataclass(frozen=True)
class RecordingFinding:
    """One fault of a recording.

    Attributes
    ----------
    rule : str
        Name of the rule, for example ``frozen-frames``.
    found, expected : str
        The value found and the threshold, each with its unit.
    where : str
        Split, round or file concerned.
    touches : tuple of str
        The touches concerned, at most the first 20, as ``round:touch`` (``12:0``, or ``12:0-255`` for all) in
        data sets, and as a path in other formats.
    count : int
        Number of all touches concerned.
    next : str
        A sentence with the next step.
    """

    rule: str
    found: str
    expected: str
    where: str
    touches: tuple[str, ...] = ()
    count: int = 0
    next: str = ""
