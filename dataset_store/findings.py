"""What is wrong with a data set folder, one thing at a time."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Finding"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong.

    Attributes
    ----------
    file : str
        Path inside the folder.
    problem : str
        What was found and what was expected.
    """

    file: str
    problem: str
