"""Exports of touches in the formats of other libraries, and those with a row for each frame.

Rows of frames are numbered in episodes: clips, or rounds of single images.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Literal, Unpack

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from realtouch import contact
from realtouch.convert import conversion
from realtouch.formats import touch_rows
from realtouch.touches import datasets, loading, media, poses, schema, stored_round
from realtouch.touches.schema import POSE_COLUMN
from tactile_toolkit import catalog, errors, kind, places, read, store
from tactile_toolkit.touch import IMAGE_SUFFIX, MEDIA_TYPE, EncodedImage
from tactile_toolkit.value_types import AnyArray, Int64, JsonDict

ExportLayout = Literal[
    "png", "jpeg", "flat", "webdataset", "lerobot", "minari", "oxt", "replay", "fota", "anytouch"
]
EXPORTS = {
    layout: kind.lazy(f"realtouch.formats.{module}:plan_{layout}")
    for layout, module in {
        "png": "touch_rows",
        "jpeg": "touch_rows",
        "flat": "touch_rows",
        "webdataset": "tar_samples",
        "lerobot": "lerobot_export",
        "minari": "minari_export",
        "oxt": "zarr_export",
        "replay": "zarr_export",
        "fota": "tar_samples",
        "anytouch": "media_files",
    }.items()
}
IMAGE = "observation.images.tactile"
STATE = "observation.state"
ACTION = "action"
TIME = "time_s"
CONTACT = "in_contact"
"""Column that marks the frames from the first to the last contact of a clip."""
DEPTH = "observation.images.depth"
"""Column of depth maps, for rounds of single images that have them."""
_POSES = {kind: f"{name}.position" for kind, name in POSE_COLUMN.items()}
_Episode = tuple[int | None, list[memoryview], dict[str, object]]
"""The touch of a clip (None for all touches of a round), the images of the frames, and columns."""
_OF_EPISODES = ("action", "prediction", "target", "reward", "terminated")
_OF_POLICIES = {"extra.action": ACTION, "extra.reward": "next.reward", "extra.terminated": "next.terminated"}
"""Names that other libraries give to what a policy did after a touch, and earned; the last touch has none."""
OUR_NAMES = {
    STATE: "gel_pose",
    ACTION: "pos_in_cell",
    TIME: "time_s",
    CONTACT: CONTACT,
    "label": "label",
    "object_id": "object_id",
}
"""Names of columns of frames, as the mark of an export states them, by which an import restores them."""
FEATURE = "observation."
"""Prefix of the names of further columns, as columns of frames."""
# Columns and arrays of the formats themselves.
_TAKEN = (
    *("images.tactile", "images.depth", "state", "action"),
    *("tactile", "label", "object_id", "gel_pose", "pos_in_cell", "in_contact", "time_s"),
    *("timestamps", "right_wrist_pose", "camera_main_rgb", "sub_task_instruction"),
)


def export(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    layout: ExportLayout,
    *,
    frame: str = "contact_end",
    difference: touch_rows.Difference | None = None,
    **job: Unpack[conversion.JobOptions],
) -> store.Manifest:
    """Write touches in the format of another library; stored JPEGs are copied, never encoded again.

    Parameters
    ----------
    source, out, split, ids, labels, per_class, limit, workers, overwrite, on_progress
        As for :func:`realtouch.clips_to_images`.
    layout : str
        ``"png"`` and ``"jpeg"``: files ``images/SPLIT/ROUND/TOUCH.png``, each named in ``index.csv`` with its
        checksum, label, position and pose; characters of an id other than letters, digits, ``-`` and ``_``
        are percent-encoded. ``"flat"``: Parquet with a row for each touch, for `datasets`, pandas and polars.
        ``"webdataset"``: the same in tars below ``webdataset/``, an image and a JSON file for each touch.
        ``"lerobot"``: a
        LeRobotDataset v3.0 in ``lerobot/``, an episode for each clip, or for each round of single images,
        with depth maps if there are some; it holds one split. ``"minari"``: recorded episodes
        (:func:`tactile_envs.record`) for offline reinforcement learning. ``"oxt"``: Open-X-Tactile, the Zarr
        of FTP-1, with the same frames as pixels. ``"replay"``: the same frames as pixels in the Zarr group
        that Diffusion Policy reads; they need much space. ``"fota"``: the tars of T3, with poses in mm.
        ``"anytouch"``: images and list files of AnyTouch 2.
    frame : str
        Which frame of a clip a touch shows, as for :func:`realtouch.clips_to_images`; ``"lerobot"``,
        ``"oxt"`` and ``"replay"`` take all.
    difference : "grey" or "absolute", optional
        Of ``"png"`` and ``"jpeg"``: write what differs from the background, as :func:`realtouch.difference`
        gives it: from the median of the clip, or of the images of the round.

    Returns
    -------
    Manifest
        What the folder holds now. Damaged rounds are left out and listed in it. LeRobot numbers episodes
        without gaps, so for this format a damaged round ends the export.

    Raises
    ------
    InputError
        The source or an option cannot be used, or the folder to write holds the source.
    IntegrityError
        A file of the source cannot be read, or every round is damaged.
    HubError
        The source is on the Hub and cannot be fetched.
    SpecMismatchError
        The folder holds a data set of another specification.
    StorageError
        The folder cannot be written. What was finished stays.
    """
    return conversion.write_conversion(source, out, _plan_of_layout(layout, frame, difference), **job)


def plan_export(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    layout: ExportLayout,
    frame: str | None,
    difference: touch_rows.Difference | None,
    rows: catalog.RowFilter,
) -> store.BuildPlan:
    """Plan what :func:`export` would write; InputError, too, for a ``frame`` of single images."""
    plan = _plan_of_layout(layout, frame or "contact_end", difference)
    build = conversion.plan_build(source, out, plan, rows)
    if frame is not None and build.spec["options"].get("frame") is None:
        raise errors.InputError("has no effect on single images", next="leave it out", field="clip_frame")
    return build


def _plan_of_layout(layout: str, frame: str, difference: touch_rows.Difference | None) -> conversion.Plan:
    if layout not in EXPORTS:
        raise errors.InputError(f"there is no layout {layout!r}; expected {', '.join(EXPORTS)}")
    if difference not in (None, "grey", "absolute"):
        raise errors.InputError(
            f"no difference {difference!r} that a picture can show; expected grey or absolute"
        )
    options: JsonDict = {"layout": layout}
    if difference is not None:
        if layout not in IMAGE_SUFFIX:
            raise errors.InputError(
                f"has no effect on {layout}; expected {' or '.join(IMAGE_SUFFIX)}", field="difference"
            )
        options["difference"] = difference
    method = contact.require_method(frame)

    def planned(opened: loading.Source, rows: catalog.RowFilter) -> conversion.Conversion:
        made: conversion.Conversion = EXPORTS[layout](
            opened, conversion.chosen_rows(opened, rows), method, options
        )
        return made

    return planned


@dataclass(frozen=True)
class Episodes:
    """Step of the export: a round becomes the frames of its episodes, numbered within each episode.

    ``split`` is the only split, ``size`` the size of all images (height, width), ``number`` the type of
    poses. With ``has_actions``, rounds are episodes of a policy: a frame is a touch and the action after it,
    so the last touch is left out. ``depth_of`` encodes the depth maps of a round, which must have that size;
    without it, they are left out.
    """

    split: str
    are_clips: bool
    fps: int
    size: tuple[int, int]
    names: tuple[str, ...]
    extras: tuple[ExtraColumn, ...]
    number: pa.DataType
    has_actions: bool = False
    depth_of: Callable[[stored_round.StoredRound, tuple[int, int]], pa.Array] | None = None

    @classmethod
    def of(
        cls, source: loading.Source, choices: conversion.Choices, what: str, number: pa.DataType
    ) -> Episodes:
        """Read the size of the first image of a split; all images must have this size.

        Raises InputError for several splits, which the format ``what`` cannot hold, and for a split without
        touches.
        """
        split, *others = choices
        if others:
            raise errors.InputError(
                f"{source.name!r} has the splits {', '.join(choices)}; a {what} holds one",
                next=f"add --split {split}",
            )
        row = next(
            filter(stored_round.StoredRound.touch_total, stored_round.stored_rows(source.shards[split])), None
        )
        if row is None:
            raise errors.InputError(
                f"{source.name!r} has no touches in split {split!r}", next="choose another split"
            )
        are_clips = source.kind == "seq"
        fps = 1
        if are_clips:
            clip = media.TouchClip(row, 0)
            fps = max(1, round(clip.fps))
            size = clip.size
        else:
            size = media.SensorImages(row).size()
        has_actions = not are_clips and are_episodes(source.schema)
        extras = extra_columns_of(source.shards[split])
        return cls(split, are_clips, fps, size, source.class_names, extras, number, has_actions)

    @property
    def own_names(self) -> dict[str, str]:
        """Name of each column of frames in the data set; where two have one, the last one counts."""
        further = {extra.name: extra.own_name for extra in self.extras}  # the action of a policy, too
        return further | {name: own for name, own in OUR_NAMES.items() if name not in further}

    @property
    def names_of_clips(self) -> list[str]:
        """Names in the data set of the further columns with an entry for each touch."""
        return [
            extra.own_name for extra in self.extras if extra.stored.startswith(schema.EXTRA_PREFIX["touch"])
        ]

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the columns that the source can fill, and those of the index of episodes."""
        sources = {
            "id": (pa.string(), ("id",)),
            "round_id": (pa.string(), ("id",)),
            "touch": (pa.int64(), ("sensor_video",)),
            IMAGE: (MEDIA_TYPE, ("sensor_video", "sensor_image")),
            STATE: (pa.list_(self.number, 7), tuple(_POSES.values())),
            ACTION: (pa.list_(self.number, 2), ("pos_in_cell",)),
            TIME: (pa.float64(), ("time_stamp_rel_seq",)),
            CONTACT: (pa.bool_(), ("touch_start_time_rel",)),
            "label": (pa.int64(), ("id",)),
            "object_id": (pa.int64(), ("object_id",)),
            "timestamp": (pa.float32(), ("id",)),
            "frame_index": (pa.int64(), ("id",)),
        }
        if self.depth_of is not None:
            sources[DEPTH] = (MEDIA_TYPE, (media.DEPTH,))
        if self.has_actions:
            del sources[ACTION]
        extras = [pa.field(extra.name, extra.data_type) for extra in self.extras]
        return pa.schema([*conversion.schema_of(source, sources), *extras])

    def apply(
        self, row: stored_round.StoredRound, choice: conversion.RowChoice, split: str
    ) -> conversion.Made:
        """Return all frames of a round."""
        schema = self.schema(row.group.table.schema)
        of_row: dict[str, object] = {"round_id": row.name(), "label": row.label_value(self.names)}
        if row.has("object_id"):
            of_row["object_id"] = row.integer("object_id")
        tables = [schema.empty_table()]
        read = self._clips if self.are_clips else self._round
        for touch, images, columns in read(row):
            count = len(images)
            start = f"{row.name()}_{touch or 0:03d}"
            for number, image in enumerate(images):
                self._require_size(row, number if touch is None else touch, image)
            columns |= {name: [value] * count for name, value in (*of_row.items(), ("touch", touch))}
            columns |= {extra.name: extra.of_frames(row, touch, count) for extra in self.extras}
            columns["id"] = names = [f"{start}_{frame:04d}" for frame in range(count)]
            columns[IMAGE] = media.image_column(pa.array(images, pa.binary()), names)
            columns["frame_index"] = np.arange(count)
            columns["timestamp"] = (np.arange(count) / self.fps).astype(np.float32)
            tables.append(conversion.table_of_columns(schema, columns))
        return pa.concat_tables(tables), {}

    def _round(self, row: stored_round.StoredRound) -> Iterator[_Episode]:
        """Yield all touches of a round of single images as one episode; a round without touches has none."""
        row.entries_of("sensor_image")
        images = media.SensorImages(row)
        columns = dict[str, pa.Array]()
        if len(images) <= self.has_actions:
            return
        if row.has_poses:
            columns[STATE] = self._states(row.poses())
        if row.has("pos_in_cell") and not self.has_actions:
            columns[ACTION] = self._vectors(row.intended_positions())
        if self.depth_of is not None and row.has(media.DEPTH):
            columns[DEPTH] = self.depth_of(row, self.size)
        count = len(images) - self.has_actions
        columns = {name: values.slice(0, count) for name, values in columns.items()}
        yield None, list(map(images.encoded, range(count))), columns

    def _clips(self, row: stored_round.StoredRound) -> Iterator[_Episode]:
        """Yield each clip of a round as an episode."""
        for touch in range(row.touch_total()):
            clip = media.TouchClip(row, touch)
            columns = dict[str, object]()
            times_s = row.stamps_s(touch)
            frames = np.arange(len(clip))
            if row.has_poses:
                columns[STATE] = self._states(row.pose_sequences(touch)[0])
            if row.has("pos_in_cell"):
                columns[ACTION] = self._vectors(row.intended_positions()[np.full(len(clip), touch)])
            if times_s is not None:
                columns[TIME] = times_s[0]
            if row.has("touch_start_time_rel"):
                window = clip.contact_window
                columns[CONTACT] = (frames >= window.start) & (frames < window.stop)
            yield touch, list(map(clip.encoded, range(len(clip)))), columns

    def _require_size(self, row: stored_round.StoredRound, touch: int, image: bytes | memoryview) -> None:
        with row.naming(row.media_column, touch):
            height, width = EncodedImage(image).intact_size()
        if (height, width) != self.size:
            raise errors.InputError(
                f"{row.path!r}, row {row.number}, touch {touch}: an image of {width} x {height} pixels; "
                f"expected {self.size[1]} x {self.size[0]} as in the first touch: episodes have images of "
                "one size",
                next="make them alike with `realtouch resize`",
            )

    def _states(self, pose: poses.Poses) -> pa.Array:
        return self._vectors(np.hstack([pose.position_m, pose.quaternion]))

    def _vectors(self, values: AnyArray) -> pa.Array:
        flat = np.ascontiguousarray(values, self.number.to_pandas_dtype()).reshape(-1)
        return pa.FixedSizeListArray.from_arrays(pa.array(flat), values.shape[1])


@dataclass(frozen=True)
class EpisodeNumbers:
    """Numbers of the first episode and frame of each shard, and the total numbers at the end."""

    starts: Sequence[Sequence[int]] = field(repr=False)

    @classmethod
    def of(
        cls,
        source: loading.Source,
        step: Episodes,
        chosen: Sequence[conversion.RowChoice],
        rows_per_shard: int,
    ) -> EpisodeNumbers:
        """Read the lengths of all rows; InputError for clips whose lengths are not stated."""
        counts = _episode_lengths(source, step)[[choice.row for choice in chosen]]
        ends = np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(counts, axis=0)])
        return cls(ends[[*range(0, len(chosen), rows_per_shard), len(chosen)]].tolist())

    def of_shard(
        self, shard: store.ShardName, counts: Sequence[int], skipped: Sequence[store.Skipped]
    ) -> Sequence[int]:
        """Return the numbers of the first episode and frame of a shard with ``counts`` of both.

        Raises IntegrityError if the shard lacks rounds, or if its counts differ from the planned ones.
        """
        if skipped:
            raise errors.IntegrityError(
                f"{skipped[0].message}; episodes are numbered without gaps, so no episode can be left out; "
                "nothing of this file was written",
                next="leave the round out first (`tactile select`)",
            )
        start, end = self.starts[shard.index : shard.index + 2]
        if np.subtract(end, start).tolist() != counts:
            episodes, frames = counts
            raise errors.IntegrityError(
                f"{shard}: {episodes:,} episodes of {frames:,} frames in all, other than "
                "'video_length_frames' stated when the export was planned; nothing of this file was written",
                next="run `tactile verify` on the source",
            )
        return start


def _episode_lengths(source: loading.Source, step: Episodes) -> Int64:
    """Return the number of episodes and of frames of each row, shape (n, 2)."""
    if not step.are_clips:
        counts = np.maximum(datasets.dataset_of(source.shards[step.split]).touch_counts - step.has_actions, 0)
        return np.column_stack([counts > 0, counts]).astype(np.int64)
    totals = []
    for shard in source.shards[step.split]:
        if "video_length_frames" not in shard.types:
            raise errors.InputError(f"{shard.path!r} has no column 'video_length_frames'")
        lengths = shard.read(columns=["video_length_frames"]).column(0).to_pylist()
        totals += [(len(of_row), sum(of_row)) for of_row in lengths]
    return np.array(totals, np.int64).reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class ExtraColumn:
    """A further column: its stored name, and its name and type as a column of frames."""

    stored: str
    name: str
    data_type: pa.DataType

    @property
    def own_name(self) -> str:
        """Its name in the data set, without prefix."""
        return self.stored.partition(".")[2]

    def of_frames(self, row: stored_round.StoredRound, touch: int | None, count: int) -> pa.Array:
        """Return the values of an episode: of all touches of a round, or of the frames of one clip.

        A missing value is NaN or an empty text. Raises IntegrityError for fewer values than frames, and for
        vectors of another length.
        """
        values = row.extra_entries(self.stored)
        if touch is not None and self.stored.startswith(schema.EXTRA_PREFIX["frame"]):
            values = row.extra_of_frames(self.stored, values, touch, count)
        elif touch is not None:
            values = values.take(pa.array([touch] * count))
        else:
            values = values.slice(0, count)
        with row.naming(self.stored, touch):
            return self._packed(values)

    def _packed(self, values: pa.Array) -> pa.Array:
        """Return numbers, texts or vectors of the type; ValueError for vectors of another length."""
        width = getattr(self.data_type, "list_size", 1)
        leaf = self.data_type
        if width > 1:
            leaf = leaf.value_type
        if read.list_depth(values.type)[0]:
            known = values.drop_null()
            lengths_found = pc.list_value_length(known).unique().sort().to_pylist()
            if lengths_found not in ([], [width]):
                lengths = " and of ".join(map(str, lengths_found))
                raise ValueError(f"vectors of {lengths} values; expected {width}, as in the first touch")
            positions = np.full((len(values), width), -1)
            positions[values.is_valid().to_numpy(zero_copy_only=False)] = np.arange(
                len(known) * width
            ).reshape(-1, width)
            values = known.flatten().take(pa.array(positions.ravel(), mask=positions.ravel() < 0))
        try:
            flat = values.cast(leaf)
        except pa.ArrowInvalid as error:  # float64 does not hold them
            raise ValueError(
                "integers of 2**53 or more, some missing; expected all, or smaller ones"
            ) from error
        if flat.null_count:
            flat = flat.fill_null("" if pa.types.is_string(leaf) else np.nan)
        return pa.FixedSizeListArray.from_arrays(flat, width) if width > 1 else flat


def are_episodes(schema: pa.Schema) -> bool:
    """Return whether touches are episodes of a policy, as :func:`tactile_envs.record` stores them."""
    return read.column_types(schema).keys() >= {f"extra.{name}" for name in _OF_EPISODES}


def extra_columns_of(shards: Sequence[read.Shard]) -> tuple[ExtraColumn, ...]:
    """Return the further columns of a split, except those without any value.

    Their values are read to find the length of vectors, and whether values are missing.
    """
    types = read.column_types(shards[0].schema)
    names = {f"{FEATURE}{name}" for name in _TAKEN}
    is_of_policy = are_episodes(shards[0].schema)
    columns = []
    for name, stored in schema.extra_columns(types).items():
        entry, (width, has_gaps) = schema.extra_type(stored, types[stored]), _widths(shards, stored)
        depth, leaf = read.list_depth(entry)
        if has_gaps and not (pa.types.is_floating(leaf) or pa.types.is_string(leaf)):
            leaf = pa.float64()  # NaN stands for a missing value
        feature = f"{FEATURE}{name.replace('/', '_')}"
        if is_of_policy:
            feature = _OF_POLICIES.get(stored, feature)
        while feature in names:
            feature = f"{feature}_"
        names.add(feature)
        if not depth:
            width = 1
        if width > 1:  # readers of LeRobotDatasets take vectors of length 1 for numbers
            leaf = pa.list_(leaf, width)
        if width:
            columns.append(ExtraColumn(stored, feature, leaf))
    return tuple(columns)


def _widths(shards: Iterable[read.Shard], stored: str) -> tuple[int, bool]:
    """Return the length of the first vector of a column, or 0, and whether values are missing."""
    width, has_gaps = 0, False
    for block in read.ShardedTable(tuple(shards)).blocks([stored]):
        column = block.nested(stored)
        has_gaps = has_gaps or column.nulls > 0
        last = column.levels[-1]
        lengths = [last] if isinstance(last, int) else np.diff(last)
        width = width or int(next(filter(None, lengths), 0))
    return width, has_gaps
