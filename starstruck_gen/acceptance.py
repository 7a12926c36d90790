"""Acceptance rate of the rejection sampling of scenes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from starstruck_gen import scene_rows, scene_spec
from starstruck_gen.scene import Scene


@dataclass(frozen=True, slots=True)
class Acceptance:
    """Counts of scenes and of drawn positions, which add up over shards."""

    classes: list[int]  # scenes of each class
    distractors: list[int]  # scenes with 0, 1, 2, ... distractors
    objects: list[int]  # scenes that have a first object, a second one, ...
    attempts: list[int]  # positions drawn for the first object, the second one, ..., in all layouts
    restarts: int  # number of times that scenes were started over

    @property
    def attempts_per_object(self) -> tuple[float, ...]:
        """Mean number of positions drawn for the first object of a scene, the second one, ..."""
        return tuple(tried / count for tried, count in zip(self.attempts, self.objects, strict=True) if count)

    @property
    def accepted(self) -> float:
        """Share of all drawn positions that objects of finished scenes have."""
        return sum(self.objects) / max(1, sum(self.attempts))


def count_scenes(spec: scene_spec.SceneSpec, scenes: Sequence[Scene | scene_rows.SceneRow]) -> Acceptance:
    """Count scenes of one specification."""
    classes = Counter(scene.star_count for scene in scenes)
    distractors = Counter(scene.distractor_count for scene in scenes)
    sizes = Counter(len(scene.attempts) for scene in scenes)
    attempts = [0] * spec.most_objects
    for scene in scenes:
        for number, tried in enumerate(scene.attempts):
            attempts[number] += tried
    return Acceptance(
        classes=[classes[stars] for stars in spec.stars],
        distractors=[distractors[count] for count in range(spec.distractors[1] + 1)],
        objects=[
            sum(count for size, count in sizes.items() if size > number)
            for number in range(spec.most_objects)
        ],
        attempts=attempts,
        restarts=sum(scene.restarts for scene in scenes),
    )
