"""Episodes: every frame of each clip, or of single images the touches of each round, numbered without gaps.

Readers of such formats find episodes by their position, so that none may be missing, and frames are counted
before they are read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from realtouch.convert.conversion import Choices, Made, RowChoice, Source, schema_of, table_of_columns
from realtouch.exchange.episode_extras import ExtraColumn, extra_columns_of
from realtouch.poses import Poses
from realtouch.schema import POSE_COLUMN
from realtouch.sensor_images import SensorImages
from realtouch.stored_images import image_column, require_intact
from realtouch.stored_round import StoredRound, stored_rows
from realtouch.touch_clips import TouchClip
from tactile_toolkit import read
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.errors import InputError
from tactile_toolkit.touch import CLASS_NAMES, MEDIA_COLUMN, MEDIA_TYPE

IMAGE, STATE, ACTION, TIME = "observation.images.tactile", "observation.state", "action", "time_s"
CONTACT = "in_contact"
"""Column that marks the frames from the first to the last contact of a clip."""
_POSES = {kind: f"{name}.position" for kind, name in POSE_COLUMN.items()}


def only_split(source: Source, choices: Choices, what: str) -> str:
    """Return the only split of an export; InputError if there are several."""
    if len(choices) > 1:
        raise InputError(
            f"{source.name!r} has the splits {', '.join(choices)}; a {what} holds one",
            next=f"add --split {next(iter(choices))}",
        )
    return next(iter(choices))


@dataclass(frozen=True)
class Episodes:
    """Step of the export: the frames of the episodes of a row, numbered within each.

    With ``number`` float64, poses keep their precision.
    """

    fps: int
    size: tuple[int, int]
    names: tuple[str, ...]
    extras: tuple[ExtraColumn, ...] = ()
    number: pa.DataType = field(default_factory=pa.float32)

    @classmethod
    def of(cls, source: Source, split: str) -> Episodes:
        """Read the size of the first image of a split; all images must have it."""
        names = read.class_names(source.schema, CLASS_NAMES)
        row = next(filter(StoredRound.touch_total, stored_rows(source.shards[split])), None)
        if row is None:
            raise InputError(
                f"{source.name!r} has no touches in split {split!r}", next="choose another split"
            )
        extras = extra_columns_of(source.shards[split])
        if row.has(MEDIA_COLUMN["single"]):
            return cls(1, SensorImages(row).size(0), names, extras)
        clip = TouchClip(row, 0)
        return cls(max(1, round(clip.fps)), clip.size, names, extras)

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
        extras = [pa.field(each.name, each.data_type) for each in self.extras]
        return pa.schema([*schema_of(source, wanted), *extras])

    def apply(self, row: StoredRound, choice: RowChoice, split: str) -> Made:
        """Return all frames of a row."""
        name, schema = row.name(), self.schema(row.group.table.schema)
        tables, label = [schema.empty_table()], row.label_value(self.names)
        object_id = row.integer("object_id") if row.has("object_id") else 0
        for touch, touches, images, columns in self._episodes(row):
            for number, image in zip(touches, images, strict=True):
                self._require_size(row, number, image)
            count, start = len(images), f"{name}_{touch or 0:03d}"
            if row.has("pos_in_cell"):
                columns[ACTION] = self._vectors(row.intended_positions()[touches])
            image_names = [f"{start}_{frame:04d}" for frame in range(count)]
            columns |= {
                "id": image_names,
                "round_id": [name] * count,
                "touch": [touch] * count,
                IMAGE: image_column(images, image_names),
                "label": np.full(count, label),
                "object_id": np.full(count, object_id),
                "timestamp": (np.arange(count) / self.fps).astype(np.float32),
                "frame_index": np.arange(count),
                **{each.name: each.of_frames(row, touch, count) for each in self.extras},
            }
            tables.append(table_of_columns(schema, columns))
        return pa.concat_tables(tables), {}

    def _episodes(
        self, row: StoredRound
    ) -> Iterator[tuple[int | None, list[int], list[memoryview], dict[str, object]]]:
        """Yield each episode: its touch (None: all of the round), those of its images, images, columns."""
        if row.has("sensor_image"):
            row.entries_of("sensor_image")
            images = SensorImages(row)
            touches = list(range(len(images)))
            states = {STATE: self._states(row.poses())} if touches and row.has(_POSES["single"]) else {}
            if touches:
                yield None, touches, list(map(images.encoded, touches)), {**states}
            return
        for touch in range(row.touch_total()):
            clip, columns, times_s = TouchClip(row, touch), dict[str, object](), row.stamps_s(touch)
            if row.has(_POSES["seq"]):
                columns[STATE] = self._states(row.pose_sequences(touch)[0])
            if times_s is not None:
                columns[TIME] = times_s[0]
            if row.has("touch_start_time_rel"):
                frames, window = np.arange(len(clip)), clip.contact_window
                columns[CONTACT] = (frames >= window.start) & (frames < window.stop)
            yield touch, [touch] * len(clip), list(map(clip.encoded, range(len(clip)))), columns

    def _require_size(self, row: StoredRound, touch: int, image: bytes | memoryview) -> None:
        with row.naming(MEDIA_COLUMN[row.kind], touch):
            height, width = require_intact(image)
        if (height, width) != self.size:
            raise InputError(
                f"{row.path!r}, row {row.number}, touch {touch}: an image of {width} x {height} pixels; "
                f"expected {self.size[1]} x {self.size[0]} as in the first touch: episodes have images of "
                "one size",
                next="make them alike with `realtouch resize`",
            )

    def _states(self, pose: Poses) -> pa.Array:
        return self._vectors(np.hstack([pose.position_m, pose.quaternion]))

    def _vectors(self, values: AnyArray) -> pa.Array:
        flat = np.ascontiguousarray(values, self.number.to_pandas_dtype()).reshape(-1)
        return pa.FixedSizeListArray.from_arrays(pa.array(flat), values.shape[1])
