"""Touches as episodes: all frames of a clip, or all single images of a round, for robot-learning formats.

Readers of such formats find episodes by their position. So no episode may be missing, and frames are counted
before they are read. Further columns of touches become columns of frames; vectors in a column have one
length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from realtouch import convert
from realtouch.touches import datasets, media, poses, schema, stored_round
from realtouch.touches.schema import POSE_COLUMN
from tactile_toolkit import errors, read, store
from tactile_toolkit.array_types import AnyArray, Int64
from tactile_toolkit.touch import MEDIA_TYPE, intact_size

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

FEATURE = "observation."
"""Prefix of the names of further columns, as columns of frames."""

# Columns and arrays of the formats themselves.
_TAKEN = (
    *("images.tactile", "images.depth", "state", "action"),
    *("tactile", "label", "object_id", "gel_pose", "pos_in_cell", "in_contact", "time_s"),
    *("timestamps", "right_wrist_pose", "camera_main_rgb", "sub_task_instruction"),
)


@dataclass(frozen=True)
class Episodes:
    """Step of the export: a round becomes the frames of its episodes, numbered within each episode.

    ``split`` is the only split, ``size`` the size of all images (height, width), ``number`` the type of
    poses. ``depth_of`` encodes the depth maps of a round, which must have that size; without it, they are
    left out.
    """

    split: str
    are_clips: bool
    fps: int
    size: tuple[int, int]
    names: tuple[str, ...]
    extras: tuple[ExtraColumn, ...]
    number: pa.DataType
    depth_of: Callable[[stored_round.StoredRound, tuple[int, int]], pa.Array] | None = None

    @classmethod
    def of(cls, source: convert.Source, choices: convert.Choices, what: str, number: pa.DataType) -> Episodes:
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
        extras = extra_columns_of(source.shards[split])
        return cls(split, are_clips, fps, size, source.class_names, extras, number)

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the columns that the source can fill, and those of the index of episodes."""
        wanted = {
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
            wanted[DEPTH] = (MEDIA_TYPE, (media.DEPTH,))
        extras = [pa.field(each.name, each.data_type) for each in self.extras]
        return pa.schema([*convert.schema_of(source, wanted), *extras])

    def apply(self, row: stored_round.StoredRound, choice: convert.RowChoice, split: str) -> convert.Made:
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
            columns |= {each.name: each.of_frames(row, touch, count) for each in self.extras}
            columns["id"] = names = [f"{start}_{frame:04d}" for frame in range(count)]
            columns[IMAGE] = media.image_column(images, names)
            columns["frame_index"] = np.arange(count)
            columns["timestamp"] = (np.arange(count) / self.fps).astype(np.float32)
            tables.append(convert.table_of_columns(schema, columns))
        return pa.concat_tables(tables), {}

    def _round(self, row: stored_round.StoredRound) -> Iterator[_Episode]:
        """Yield all touches of a round of single images as one episode; a round without touches has none."""
        row.entries_of("sensor_image")
        images = media.SensorImages(row)
        columns = dict[str, object]()
        if not len(images):
            return
        if row.has_poses:
            columns[STATE] = self._states(row.poses())
        if row.has("pos_in_cell"):
            columns[ACTION] = self._vectors(row.intended_positions())
        if self.depth_of is not None and row.has(media.DEPTH):
            columns[DEPTH] = self.depth_of(row, self.size)
        yield None, list(map(images.encoded, range(len(images)))), columns

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
            height, width = intact_size(image)
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
        cls, source: convert.Source, step: Episodes, chosen: Sequence[convert.RowChoice], rows_per_shard: int
    ) -> EpisodeNumbers:
        """Read the lengths of all rows; InputError for clips whose lengths are not stated."""
        counts = _episode_lengths(source, step)[[each.row for each in chosen]]
        ends = np.concatenate([np.zeros((1, 2), np.int64), np.cumsum(counts, axis=0)])
        return cls(ends[[*range(0, len(chosen), rows_per_shard), len(chosen)]].tolist())

    def of_shard(
        self, shard: store.ShardName, found: Sequence[int], skipped: Sequence[store.Skipped]
    ) -> Sequence[int]:
        """Return the numbers of the first episode and frame of a shard with ``found`` episodes and frames.

        Raises IntegrityError if the shard lacks rounds, or if its counts differ from the planned ones.
        """
        if skipped:
            raise errors.IntegrityError(
                f"{skipped[0].message}; episodes are numbered without gaps, so no episode can be left out; "
                "nothing of this file was written",
                next="leave the round out first (`realtouch select`)",
            )
        start, end = self.starts[shard.index : shard.index + 2]
        if np.subtract(end, start).tolist() != found:
            episodes, frames = found
            raise errors.IntegrityError(
                f"{shard}: {episodes:,} episodes of {frames:,} frames in all, other than "
                "'video_length_frames' stated when the export was planned; nothing of this file was written",
                next="run `realtouch verify` on the source",
            )
        return start


def _episode_lengths(source: convert.Source, step: Episodes) -> Int64:
    """Return the number of episodes and of frames of each row, shape (n, 2)."""
    if not step.are_clips:
        counts = datasets.dataset_of(source.shards[step.split]).touch_counts
        return np.column_stack([counts > 0, counts]).astype(np.int64)
    found = []
    for shard in source.shards[step.split]:
        if "video_length_frames" not in shard.types:
            raise errors.InputError(f"{shard.path!r} has no column 'video_length_frames'")
        lengths = shard.read(columns=["video_length_frames"]).column(0).to_pylist()
        found += [(len(each), sum(each)) for each in lengths]
    return np.array(found, np.int64).reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class ExtraColumn:
    """A further column: its stored name, and its name and type as a column of frames."""

    stored: str
    name: str
    data_type: pa.DataType

    @property
    def is_per_frame(self) -> bool:
        """Whether it has an entry for each frame, not for each touch."""
        return self.stored.startswith(schema.EXTRA_PREFIX["frame"])

    def of_frames(self, row: stored_round.StoredRound, touch: int | None, count: int) -> pa.Array:
        """Return the values of an episode: of all touches of a round, or of the frames of one clip.

        A missing value is NaN or an empty text. Raises IntegrityError for fewer values than frames, and for
        vectors of another length.
        """
        values = row.extra_entries(self.stored)
        if touch is not None and self.is_per_frame:
            values = row.extra_of_frames(self.stored, values, touch, count)
        elif touch is not None:
            values = values.take(pa.array([touch] * count))
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
            found = pc.list_value_length(known).unique().sort().to_pylist()
            if found not in ([], [width]):
                lengths = " and of ".join(map(str, found))
                raise ValueError(f"vectors of {lengths} values; expected {width}, as in the first touch")
            places = np.full((len(values), width), -1)
            places[values.is_valid().to_numpy(zero_copy_only=False)] = np.arange(len(known) * width).reshape(
                -1, width
            )
            values = known.flatten().take(pa.array(places.ravel(), mask=places.ravel() < 0))
        try:
            flat = values.cast(leaf)
        except pa.ArrowInvalid as error:  # float64 does not hold them
            raise ValueError(
                "integers of 2**53 or more, some missing; expected all, or smaller ones"
            ) from error
        if flat.null_count:
            flat = flat.fill_null("" if pa.types.is_string(leaf) else np.nan)
        return pa.FixedSizeListArray.from_arrays(flat, width) if width > 1 else flat


def extra_columns_of(shards: Sequence[read.Shard]) -> tuple[ExtraColumn, ...]:
    """Return the further columns of a split, except those without any value.

    Their values are read to find the length of vectors, and whether values are missing.
    """
    types = read.column_types(shards[0].schema)
    names = {f"{FEATURE}{name}" for name in _TAKEN}
    found = []
    for name, stored in schema.extra_columns(types).items():
        entry, (width, has_gaps) = schema.extra_type(stored, types[stored]), _widths(shards, stored)
        depth, leaf = read.list_depth(entry)
        if has_gaps and not (pa.types.is_floating(leaf) or pa.types.is_string(leaf)):
            leaf = pa.float64()  # NaN stands for a missing value
        feature = f"{FEATURE}{name.replace('/', '_')}"
        while feature in names:
            feature = f"{feature}_"
        names.add(feature)
        if not depth:
            width = 1
        if width > 1:  # readers of LeRobotDatasets take vectors of length 1 for numbers
            leaf = pa.list_(leaf, width)
        if width:
            found.append(ExtraColumn(stored, feature, leaf))
    return tuple(found)


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
