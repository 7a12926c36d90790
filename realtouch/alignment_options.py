"""How streams of other rates are aligned with pictures, imported with nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Alignment:
    """How streams are aligned."""
