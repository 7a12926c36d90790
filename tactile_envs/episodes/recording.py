"""Episodes as a data set of touches, a row for each: what a policy saw, did, predicted and earned; replays.

In a replay, the same actions must give the same images and rewards. The data card, and what `info` tells,
follow from the manifest.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from typing import TYPE_CHECKING, Any, NamedTuple, Unpack

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

import realtouch
from tactile_envs.episodes import policies
from tactile_envs.episodes.kind import KIND
from tactile_envs.episodes.playing import Episodes, EpisodeSpec, Taken, Touch, episodes_of
from tactile_envs.episodes.policies import Policy
from tactile_sim.sets.data_cards import touches_sheet
from tactile_toolkit import cards, generation, places, read, rows, store, touch, wording
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import Facts
from tactile_toolkit.value_types import (
    AnyArray,
    Bool,
    Float32,
    Float64,
    Int64,
    JsonDict,
    JsonObject,
    UInt8,
)

if TYPE_CHECKING:
    from tactile_envs.config import Action, Observation
    from tactile_envs.environment import TactileVectorEnv

_XY, _XYZ, _XYZW = (read.vectors_type(pa.float64(), size) for size in (2, 3, 4))
_QUALITY = 95
_SHARD_BYTES = 64 << 20
_GROUP_BYTES = 8 << 20
_JPEG_BYTES_PER_PX = 0.25
_SHARDS = 16
_OF_TOUCHES = ("sensor_poses", "object_positions_m", "object_quaternions", "targets")
_OF_ACTIONS = {"action": np.nan, "predictions": np.nan, "rewards": np.nan, "terminated": False}
"""What is stored of actions, and what stands for a missing one."""
_OPTIONAL = {"contacts": "extra.in_contact", "forces_n": "extra.force_n"}
"""What only some environments know of touches, and its column."""
_ENCODINGS = (("sensor_image.list.element.bytes", "PLAIN"),)


class EpisodeRound(rows.TypedRow):
    """One episode."""

    id: str = rows.column(pa.string(), "", "number of the episode")
    label: int = rows.column(pa.int64(), "", "class of the touched object")
    object_id: int = rows.column(pa.int64(), "", "`id` of its mesh in the data set of the objects")
    moved_position_m: Float64 = rows.column(
        _XYZ,
        "T x 3, m, cell frame",
        "position of the object after the touch",
        name="info.object_pose.position",
    )
    moved_quaternion: Float64 = rows.column(
        _XYZW, "T x 4: x, y, z, w", "its orientation then", name="info.object_pose.quaternion"
    )
    positions_m: Float64 = rows.column(_XY, "T x 2, m, cell frame", "where the gel goes", name="pos_in_cell")
    gel_position_m: Float64 = rows.column(
        _XYZ, "T x 3, m, cell frame", "position of the sensor", name="gel_pose_cell_frame.position"
    )
    gel_quaternion: Float64 = rows.column(
        _XYZW, "T x 4: x, y, z, w", "its orientation", name="gel_pose_cell_frame.quaternion"
    )
    images: Sequence[tuple[bytes, str]] = rows.column(
        pa.list_(touch.MEDIA_TYPE), "T images", "what the sensor sees", name="sensor_image"
    )
    time_step: AnyArray = rows.column(
        pa.list_(pa.int64()), "T", "number of the touch in the episode", name="extra.time_step"
    )
    action: AnyArray = rows.column(
        pa.null(), "T x a", "action after the touch; NaN after the last one", name="extra.action"
    )
    prediction: AnyArray = rows.column(
        pa.null(),
        "T x p",
        "prediction with this action: logits of the classes, or numbers; NaN after the last touch",
        name="extra.prediction",
    )
    target: AnyArray = rows.column(pa.null(), "T or T x p", "the true answer", name="extra.target")
    reward: AnyArray = rows.column(
        pa.list_(pa.float32()), "T", "reward of this action; NaN after the last touch", name="extra.reward"
    )
    terminated: Bool = rows.column(
        pa.list_(pa.bool_()),
        "T",
        "whether this action terminated the episode; an episode without such an action was truncated",
        name="extra.terminated",
    )
    in_contact: Bool | None = rows.column(
        pa.list_(pa.bool_()),
        "T",
        "whether the touch met the object, not only the plate; only for sensors that stay upright",
        name=_OPTIONAL["contacts"],
        default=None,
    )
    force_n: Float32 | None = rows.column(
        read.vectors_type(pa.float32(), 3),
        "T x 3, N, sensor frame: x, y, z",
        "force of the object on the gel, z in the direction in which it is pressed in; only for elastic gels",
        name=_OPTIONAL["forces_n"],
        default=None,
    )


class _Form(NamedTuple):
    """What the environments decide about a data set: split, vectors of the action, targets, objects."""

    split: str
    optional: tuple[str, ...]
    action_parts: dict[str, int]
    predictions: int
    target_type: pa.DataType
    ids: Int64
    labels: Int64
    label_names: tuple[str, ...]
    files: list[JsonDict]

    @classmethod
    def of(cls, episodes: Episodes) -> _Form:
        """Begin an episode, whose targets have the type of all."""
        env = episodes.env
        touched = episodes.touch(*env.reset(seed=0), np.ones(env.num_envs, np.bool_))
        targets = touched.targets
        leaf = pa.from_numpy_dtype(targets.dtype)
        target_type = pa.list_(leaf) if targets.ndim == 1 else read.vectors_type(leaf, targets.shape[1])
        return cls(
            env.split,
            tuple(name for name in _OPTIONAL if getattr(touched, name) is not None),
            episodes.action_parts,
            env.prediction_space.shape[1],
            target_type,
            *env.objects(),
        )


@dataclass(frozen=True)
class EpisodeGenerator(generation.RowGenerator):
    """Plays episodes, and makes a row of each. The items are numbers of episodes."""

    spec: EpisodeSpec
    policy: Policy
    policy_facts: JsonDict
    form: _Form = field(repr=False)
    image_format: touch.ImageFormat = "jpeg"
    kind = KIND

    @classmethod
    def of(cls, spec: EpisodeSpec, policy: str | Policy, image_format: touch.ImageFormat) -> EpisodeGenerator:
        """Open the environments; InputError if the id, a setting, the policy or objects cannot be used."""
        made = policies.policy_named(policy)
        facts = policies.fingerprint(made)  # its state before the first episode
        return cls(spec, made, facts, _Form.of(episodes_of(spec)), image_format)

    def manifest(self) -> JsonObject:
        """Return what decides the episodes: specification, policy, and digests of the objects."""
        options = self.spec.to_dict()
        options |= {"policy": self.policy_facts, "image_format": self.image_format}
        options |= {"action": self.form.action_parts, "weights": self.spec.weights_sha256()}
        return {"operation": "record", "options": options, "source": {self.form.split: self.form.files}}

    def items(self) -> Mapping[str, range]:
        """Return the episodes."""
        return {self.form.split: range(self.spec.episodes)}

    def layout(self) -> generation.StorageLayout:
        """Return the storage layout of rows; a shard has whole groups, as one costs as much as all of it."""
        episodes = episodes_of(self.spec)
        config = episodes.env.config
        width, height = config.sensor_output_size
        episode_bytes = (config.step_limit + 1) * (width * height * _JPEG_BYTES_PER_PX + 600)
        groups = max(1, int(_SHARD_BYTES // (episode_bytes * self.spec.num_envs)))
        style = store.ParquetStyle(
            int(min(1024, max(1, _GROUP_BYTES // episode_bytes))), compression_level=3, encodings=_ENCODINGS
        )
        return generation.StorageLayout(
            style,
            libraries=("numpy", "pillow", "pyarrow"),
            smallest=self.spec.num_envs,
            largest=groups * self.spec.num_envs,
            usual_shards=_SHARDS,
            sampled=self.spec.num_envs,
            together=self.spec.num_envs,
        )

    def schema(self, split: str) -> pa.Schema:
        """Return the Arrow schema of a shard."""
        types = {
            "extra.action": read.vectors_type(pa.float32(), sum(self.form.action_parts.values())),
            "extra.prediction": read.vectors_type(pa.float32(), self.form.predictions),
            "extra.target": self.form.target_type,
        }
        unknown = [column for name, column in _OPTIONAL.items() if name not in self.form.optional]
        stored = [column for column in EpisodeRound.plain_schema() if column.name not in unknown]
        schema = pa.schema([pa.field(column.name, types.get(column.name, column.type)) for column in stored])
        return touch.with_features(schema, self.form.label_names)

    def make(self, split: str, items: Sequence[int]) -> Iterator[EpisodeRound]:
        """Play the groups that the episodes belong to, and yield the row of each episode."""
        episodes = episodes_of(self.spec)
        count = self.spec.num_envs
        for group in range(items[0] // count, items[-1] // count + 1):
            chosen = [item - group * count for item in items if item // count == group]
            yield from self._rows(episodes, group, chosen)

    def _rows(self, episodes: Episodes, group: int, chosen: Sequence[int]) -> Iterator[EpisodeRound]:
        """Yield the rows of some episodes of a group."""
        touches: list[Touch] = []
        actions: list[Taken] = []
        images: dict[int, list[bytes]] = {index: [] for index in chosen}
        for touched, taken in episodes.play(self.policy, group):
            if not touches:
                objects = episodes.env.current_data_point_indices
            touches.append(touched)
            if taken is not None:
                actions.append(taken)
            pixels = image_levels(touched.observation["sensor_img"])
            for index in chosen:
                if touched.is_observed[index]:
                    images[index].append(touch.encode_image(pixels[index], self.image_format, _QUALITY))
        names = *_OF_TOUCHES, *self.form.optional
        stacked = {name: np.stack([getattr(touched, name) for touched in touches], axis=1) for name in names}
        done = {name: _actions(actions, name, len(touches), missing) for name, missing in _OF_ACTIONS.items()}
        suffix = touch.IMAGE_SUFFIX[self.image_format]
        for index in chosen:
            count = len(images[index])
            of_touch = {name: values[index, :count] for name, values in stacked.items()}
            of_action = {name: values[index, :count] for name, values in done.items()}
            poses = of_touch["sensor_poses"]
            yield EpisodeRound(
                id=f"{self.form.split}-{group * self.spec.num_envs + index}",
                label=int(self.form.labels[objects[index]]),
                object_id=int(self.form.ids[objects[index]]),
                moved_position_m=of_touch["object_positions_m"],
                moved_quaternion=of_touch["object_quaternions"],
                positions_m=poses[:, :2, 3],
                gel_position_m=poses[:, :3, 3],
                gel_quaternion=Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True),
                images=[(data, f"{number:03d}.{suffix}") for number, data in enumerate(images[index])],
                time_step=np.arange(count),
                action=of_action["action"],
                prediction=of_action["predictions"],
                target=of_touch["targets"],
                reward=of_action["rewards"],
                terminated=of_action["terminated"],
                in_contact=of_touch.get("contacts"),
                force_n=of_touch.get("forces_n"),
            )

    def statistics(self, rows: Sequence[EpisodeRound]) -> Mapping[str, float]:
        """Count the touches, and add up the rewards of the episodes."""
        return {
            "touches": sum(len(row.images) for row in rows),
            "reward": sum(float(np.nansum(row.reward, dtype=np.float64)) for row in rows),
        }


def image_levels(images: AnyArray) -> UInt8:
    """Return observed images, 0 to 1, (n, H, W, C), as levels: colours, or grey (n, H, W) of one channel."""
    levels: UInt8 = np.rint(images * 255).astype(np.uint8)
    return levels[..., 0] if levels.shape[-1] == 1 else levels


def _actions(actions: Sequence[Taken], name: str, count: int, missing: object) -> AnyArray:
    """Return what was done after each of ``count`` touches, (n, count, ...); ``missing`` elsewhere."""
    values = np.stack([getattr(taken, name) for taken in actions], axis=1)
    values[~np.stack([taken.has_action for taken in actions], axis=1)] = missing
    shape = len(values), count - values.shape[1], *values.shape[2:]
    return np.concatenate([values, np.full(shape, missing, values.dtype)], axis=1)


def record(
    spec: EpisodeSpec,
    policy: str | Policy,
    out: str | os.PathLike[str],
    *,
    image_format: touch.ImageFormat = "jpeg",
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Play episodes and write them as a data set of touches; ``realtouch.load`` opens it.

    Each episode is a round. An interrupted recording is continued, with the same bytes.

    Parameters
    ----------
    spec : EpisodeSpec
        Environment, number of episodes, and seed.
    policy : str or callable
        What acts and predicts: a function that takes the observations of n environments and returns their
        ``{"action": ..., "prediction": ...}``; or ``"random"``, ``"constant"``, ``"oracle"``,
        ``"rule"``, or ``"module:attribute"``.
    out : str or path-like
        Folder to write.
    image_format : "jpeg" or "png"
        Format of the images; JPEGs have quality 95.
    **run
        Fields of :class:`tactile_toolkit.store.RunOptions`, such as ``workers`` and ``overwrite``. With
        several workers the policy must be picklable.

    Returns
    -------
    Manifest
        Manifest of the folder.

    Raises
    ------
    InputError
        The id, a setting, the policy or the objects cannot be used.
    SpecMismatchError
        The folder holds another data set.

    Examples
    --------
    ::

        spec = tactile_envs.EpisodeSpec("TactileMNIST-Depth-test-v0", episodes=200, assets="assets")
        tactile_envs.record(spec, "random", "episodes")
    """
    return EpisodeGenerator.of(spec, policy, image_format).generate(out, **run)


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
    generator = _generator_of(place, assets=assets, touches=touches, weights=weights)
    split = generator.form.split
    rounds = realtouch.load(place, split=split)
    assert isinstance(rounds, realtouch.TouchSingleDataset), "an episode has an image for each touch"
    total = min(len(rounds), limit or len(rounds))
    count = 0
    for first in range(0, total, generator.spec.num_envs):
        numbers = range(first, min(first + generator.spec.num_envs, total))
        recorded = {number - first: rounds[number] for number in numbers}
        again = replace(generator, policy=_Recorded(recorded))
        for number, made in zip(numbers, again.make(split, numbers), strict=True):
            difference = _difference(recorded[number - first], made)
            count += len(made.images)
            if difference is not None:
                return Replay(number + 1, count, f"episode {made.id}: {difference}")
        on_progress(numbers.stop, total)
    return Replay(total, count, None)


def _generator_of(place: places.Place, **folders: Any) -> EpisodeGenerator:
    """Return the generator of recorded episodes, for a policy that does not matter; raises InputError.

    ``folders`` are those of :func:`replay`.
    """
    manifest = place.manifest
    if manifest is None or manifest.spec.get("operation") != "record":
        raise InputError(
            f"{place.name!r} was not made by `tactile-envs record`; expected recorded episodes",
            next="name the folder of a recording, not a copy of some of its rows",
        )
    options = manifest.spec["options"]
    stated = {name: options[name] for name in ("env_id", "episodes", "num_envs", "seed", "settings")}
    spec = EpisodeSpec(**stated, **folders)
    generator = EpisodeGenerator.of(spec, "constant", options["image_format"])
    for name, recorded_value, value in (
        ("assets", manifest.spec["source"].get(generator.form.split), generator.form.files),
        ("weights", options["weights"], spec.weights_sha256()),
    ):
        if recorded_value != value:
            raise InputError(
                f"differs from what {place.name!r} was recorded with; other {name} give other images",
                next=f"give the {name} of the recording",
                field=name,
            )
    return generator


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


def _figures(manifest: store.Manifest) -> dict[str, list[float]]:
    """Return the touches, and the mean of the summed rewards of an episode, of each split."""
    table, counts = manifest.split_table(), manifest.statistics()
    return {
        "touches": [counts[split]["touches"] for split in table],
        "mean return": [counts[split]["reward"] / max(held["rows"], 1) for split, held in table.items()],
    }


def write_card(folder: store.DataFolder, manifest: store.Manifest) -> None:
    """Write ``README.md`` of a folder of episodes and its picture; IntegrityError for a damaged shard."""
    options: JsonObject = manifest.spec["options"]
    figures = _figures(manifest)
    parts = ", then ".join(f"`{name}` ({count})" for name, count in options["action"].items())
    policy = options["policy"]
    digest = policy["sha256"] or "not known, as it cannot be pickled"
    cards.Card(
        template=KIND.card_template,
        title=f"Episodes of {options['env_id']}",
        columns=EpisodeRound.meanings(),
        picture=("touches.png", "The first touches of the first episodes"),
        drawn=touches_sheet,
        licence="mit",
        tags=["tactile", "active-perception", "reinforcement-learning", "offline-rl", "synthetic"],
        tasks={"task_categories": ["robotics", "reinforcement-learning"]},
        figures={
            "touches": [f"{count:,}" for count in figures["touches"]],
            "mean return": [f"{mean:.3f}" for mean in figures["mean return"]],
        },
        made=[
            ("environment", f"`{options['env_id']}`"),
            ("policy", f"{wording.markdown_code(policy['name'])}, SHA-256 of its state: {digest}"),
            ("seed", str(options["seed"])),
            ("action", f"the values of {parts}"),
        ],
        limits=["What the environment simplifies holds here, too."],
        values={
            "env_id": options["env_id"],
            "touches": f"{sum(figures['touches']):,}",
            "num_envs": str(options["num_envs"]),
        },
    ).write(folder, manifest, KIND)


def facts(_folder: store.DataFolder, manifest: store.Manifest) -> Facts:
    """Return the touches and the mean return of each split; reads no row."""
    figures = _figures(manifest)
    rows = [
        (split, f"{touches:,}", f"{mean:.3f}")
        for split, touches, mean in zip(manifest.splits, *figures.values(), strict=True)
    ]
    return Facts(header=("split", "touches", "mean return"), rows=tuple(rows), document={"figures": figures})
