"""Replays of recorded episodes: the same actions must give the same images and rewards."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

import realtouch
from tactile_envs.episodes.playing import EpisodeSpec
from tactile_envs.episodes.recording import EpisodeGenerator, EpisodeRound
from tactile_toolkit import places
from tactile_toolkit.errors import InputError

if TYPE_CHECKING:
    from tactile_envs.config import Action, Observation
    from tactile_envs.environment import TactileVectorEnv


@dataclass(frozen=True, slots=True)
class Replay:
    """Result of a replay: the episodes that were played, and the first difference in words, or None."""

    episodes: int
    touches: int
    difference: str | None


class _Recorded:
    """The policy that repeats the actions of some recorded episodes; the others of a group stay still."""

    def __init__(self, rounds: Mapping[int, realtouch.TouchSingleRound]) -> None:
        self._done = {
            index: (held.extra["action"], held.extra["prediction"], held.touch_count - 1)
            for index, held in rounds.items()
        }

    def begin(self, env: TactileVectorEnv, seed: int) -> None:
        """Begin with the first touch."""
        self._parts = env.action_space["action"].spaces
        self._still = np.zeros(env.prediction_space.shape, np.float32)
        self._touch = 0

    def __call__(self, observation: Observation) -> Action:
        """Return what was done after this touch."""
        parts = {name: np.zeros(part.shape, np.float32) for name, part in self._parts.items()}
        predictions = self._still.copy()
        for index, (actions, recorded, steps) in self._done.items():
            if self._touch >= steps:
                continue
            predictions[index] = recorded[self._touch]
            first = 0
            for values in parts.values():
                end = first + values[index].size
                values[index] = actions[self._touch, first:end].reshape(values[index].shape)
                first = end
        self._touch += 1
        return {"action": parts, "prediction": predictions}


def replay(
    name: places.Name | places.Place,
    *,
    assets: str | PathLike[str] | None = None,
    touches: str | PathLike[str] | None = None,
    weights: str | PathLike[str] | None = None,
    limit: int | None = None,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Replay:
    """Play the actions of recorded episodes again, and compare images and rewards bit for bit.

    Parameters
    ----------
    name : str, path-like or Place
        Data set that :func:`record` made.
    assets, touches, weights : path or str, optional
        Where the objects and weights are, as for :func:`tactile_envs.make_vector`.
    limit : int, optional
        Number of episodes, from the first one on; all by default.
    on_progress : callable
        Called with the number of compared episodes and that of all.

    Raises
    ------
    InputError
        The data set was not recorded, or the objects are not those of the recording.
    IntegrityError
        The data set is damaged.
    """
    place = places.open_place(name)
    manifest = place.manifest
    if manifest is None or manifest.spec.get("operation") != "record":
        raise InputError(
            f"{place.name!r} was not made by `tactile-envs record`; expected recorded episodes",
            next="name the folder of a recording, not a copy of some of its rows",
        )
    options = manifest.spec["options"]
    stated = {name: options[name] for name in ("env_id", "episodes", "num_envs", "seed", "settings")}
    spec = EpisodeSpec(**stated, assets=assets, touches=touches, weights=weights)
    generator = EpisodeGenerator.of(spec, "constant", options["image_format"])
    split = generator.form.split
    for field, recorded_value, value in (
        ("assets", manifest.spec["source"].get(split), generator.form.files),
        ("weights", options["weights"], spec.weights_sha256()),
    ):
        if recorded_value != value:
            raise InputError(
                f"differs from what {place.name!r} was recorded with; other {field} give other images",
                next=f"give the {field} of the recording",
                field=field,
            )
    rounds = realtouch.load(place, split=split)
    assert isinstance(rounds, realtouch.TouchSingleDataset), "an episode has an image for each touch"
    total = min(len(rounds), limit or len(rounds))
    count = 0
    for first in range(0, total, spec.num_envs):
        numbers = range(first, min(first + spec.num_envs, total))
        recorded = {number - first: rounds[number] for number in numbers}
        again = replace(generator, policy=_Recorded(recorded))
        for number, made in zip(numbers, again.make(split, numbers), strict=True):
            difference = _difference(recorded[number - first], made)
            count += len(made.images)
            if difference is not None:
                return Replay(number + 1, count, f"episode {made.id}: {difference}")
        on_progress(numbers.stop, total)
    return Replay(total, count, None)


def _difference(stored: realtouch.TouchSingleRound, made: EpisodeRound) -> str | None:
    """Return the first difference between an episode and its repetition in words; None without any."""
    if stored.touch_count != len(made.images):
        return f"{stored.touch_count} touches were recorded, {len(made.images)} were made"
    rewards = stored.extra["reward"]
    for number, (image, _) in enumerate(made.images):
        if bytes(stored.sensor_image.encoded(number)) != image:
            return f"touch {number} has another image"
        if not np.array_equal(rewards[number], made.reward[number], equal_nan=True):
            return (
                f"touch {number} has the reward {made.reward[number]:.6g}; {rewards[number]:.6g} was recorded"
            )
    return None
