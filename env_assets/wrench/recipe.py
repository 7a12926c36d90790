"""How the usual wrench is made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from env_assets.wrench.generation import SPLIT, write_wrench
from env_assets.wrench.spec import WrenchSpec

__all__ = ["WrenchRecipe"]


@dataclass(frozen=True, slots=True)
class WrenchRecipe:
    """The usual wrench: it has neither a seed nor classes."""

    seed: int
    per_class: int | None
    splits: tuple[str, ...] = (SPLIT,)

    def spec(self) -> Any:
        """Return the specification."""
        return WrenchSpec.for_size()

    def begun(self, spec: Mapping[str, Any]) -> None:
        """Return None: folders of other wrenches are made by their own settings."""
        return

    def arguments(self, split: str) -> str:
        """Return the arguments of the command that makes a split."""
        return ""

    def make(self, out: str, split: str, workers: int) -> None:
        """Make one split."""
        write_wrench(self.spec(), out)
