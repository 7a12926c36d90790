"""Episodes as a data set of touches, a row for each: what a policy saw, did, predicted and earned."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Unpack

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from tactile_envs.episodes import policies
from tactile_envs.episodes.kind import KIND
from tactile_envs.episodes.playing import Episodes, EpisodeSpec, Taken, Touch, episodes_of
from tactile_envs.episodes.policies import Policy
from tactile_toolkit import generation, read, rows, store, touch
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
