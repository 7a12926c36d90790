"""Acceptance statistics: how hard it was to place objects, counted so that shards add up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from starstruck_gen.scene import Scene
from starstruck_gen.spec import SceneSpec

__all__ = ["Acceptance", "count_scenes"]


@dataclass(frozen=True, slots=True)
class Acceptance:
    """Counts over scenes.

    Attributes
    ----------
    classes : tuple of int
        Scenes of each class.
    distractors : tuple of int
        Scenes with 0, 1, 2, ... distractors.
    objects : tuple of int
        Scenes that have a first object, a second one, ...
    attempts : tuple of int
        Positions drawn for the first objects, the second ones, ..., all layouts together.
    restarts : int
        How often scenes were started over.
    """

    classes: tuple[int, ...]
    distractors: tuple[int, ...]
    objects: tuple[int, ...]
    attempts: tuple[int, ...]
    restarts: int

    @property
    def attempts_per_object(self) -> tuple[float, ...]:
        """Mean number of positions drawn for the first object of a scene, the second one, ..."""
        return tuple(tried / count for tried, count in zip(self.attempts, self.objects, strict=True) if count)

    @property
    def accepted(self) -> float:
        """Share of all positions drawn at which an object was left standing."""
        return sum(self.objects) / max(1, sum(self.attempts))

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values that add up over shards."""
        return {
            "classes": list(self.classes),
            "distractors": list(self.distractors),
            "objects": list(self.objects),
            "attempts": list(self.attempts),
            "restarts": self.restarts,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Acceptance:
        """Rebuild counts from :meth:`to_dict`."""
        lists = {name: tuple(count) for name, count in values.items() if name != "restarts"}
        return cls(**lists, restarts=values["restarts"])


def count_scenes(spec: SceneSpec, scenes: Sequence[Scene]) -> Acceptance:
    """Count scenes of one specification."""
    classes = [0] * len(spec.stars)
    distractors = [0] * (spec.distractors[1] + 1)
    objects = [0] * spec.most_objects
    attempts = [0] * spec.most_objects
    for scene in scenes:
        classes[spec.stars.index(scene.star_count)] += 1
        distractors[scene.distractor_count] += 1
        for number, tried in enumerate(scene.attempts):
            objects[number] += 1
            attempts[number] += tried
    restarts = sum(scene.restarts for scene in scenes)
    return Acceptance(tuple(classes), tuple(distractors), tuple(objects), tuple(attempts), restarts)
