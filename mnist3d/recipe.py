"""How a data set of digits is made without any input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mnist3d.generation import GenerateSpec, generate
from mnist3d.sources.synthetic import SyntheticSource
from mnist3d.splits import SPLITS, SplitSpec

__all__ = ["DigitRecipe"]


@dataclass(frozen=True, slots=True)
class DigitRecipe:
    """Digits of the embedded synthetic source."""

    seed: int
    per_class: int | None
    splits: tuple[str, ...] = SPLITS

    def spec(self) -> Any:
        """Return the specification."""
        source = SyntheticSource(seed=self.seed)
        return GenerateSpec(source, split=SplitSpec(seed=self.seed), per_class=self.per_class)

    def begun(self, spec: Mapping[str, Any]) -> DigitRecipe:
        """Return the recipe of a folder with this specification."""
        return DigitRecipe(dict(spec.get("split") or {}).get("seed", 0), spec.get("per_class"))

    def arguments(self, split: str) -> str:
        """Return the arguments of the command that makes a split."""
        limit = "" if self.per_class is None else f" --per-class {self.per_class}"
        return f"--split {split}{limit}" + (f" --seed {self.seed}" if self.seed else "")

    def make(self, out: str, split: str, workers: int) -> None:
        """Make one split."""
        generate(self.spec(), out, (split,), workers=workers)
