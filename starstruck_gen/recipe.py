"""How a data set of scenes is made without any input."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from starstruck_gen.generation import PUBLISHED_SIZES, GenerateSpec, generate
from starstruck_gen.kind import KIND
from starstruck_gen.streams import SPLITS

__all__ = ["SceneRecipe"]


@dataclass(frozen=True, slots=True)
class SceneRecipe:
    """Scenes as published, or fewer of them."""

    seed: int
    per_class: int | None
    splits: tuple[str, ...] = SPLITS

    def spec(self) -> Any:
        """Return the specification."""
        return GenerateSpec(scenes=self._scenes(), seed=self.seed)

    def begun(self, spec: Mapping[str, Any]) -> SceneRecipe | None:
        """Return the recipe of a folder with this specification."""
        counts = spec.get("scenes")
        most = max(counts.values(), default=0) if isinstance(counts, Mapping) else 0
        seed, per_class = spec.get("seed", 0), most // len(KIND.class_names)
        return SceneRecipe(seed, per_class) if per_class and isinstance(seed, int) else None

    def arguments(self, split: str) -> str:
        """Return the arguments of the command that makes a split."""
        sizes = ",".join(f"{name}={size}" for name, size in self._scenes())
        scenes = "" if self.per_class is None else f" --scenes {sizes}"
        return f"--split {split}{scenes}" + (f" --seed {self.seed}" if self.seed else "")

    def make(self, out: str, split: str, workers: int) -> None:
        """Make one split."""
        generate(self.spec(), out, (split,), workers=workers)

    def _scenes(self) -> tuple[tuple[str, int], ...]:
        most = None if self.per_class is None else self.per_class * len(KIND.class_names)
        return tuple((split, size if most is None else min(size, most)) for split, size in PUBLISHED_SIZES)
