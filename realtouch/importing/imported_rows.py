"""Rows of an import: touches of whole rounds as Arrow columns in the published schema."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from realtouch.importing import found_touches, import_columns, imported_clips
from realtouch.importing.extra_columns import extra_arrays, extra_types
from realtouch.touches import schema as stored_schema
from realtouch.touches.schema import POSE_COLUMN
from realtouch.touches.stored_images import media_array
from tactile_toolkit.array_types import AnyArray, Float64, Int64
from tactile_toolkit.columns import column_types
from tactile_toolkit.touch import MEDIA_COLUMN, MEDIA_TYPE, Kind, with_features

_TIME = pa.duration("us")
_POSE_PARTS = {"position": slice(0, 3), "quaternion": slice(3, 7)}


@dataclass(frozen=True, eq=False)
class StoredTouches:
    """Touches of whole rounds as they are stored, an entry for each touch.

    ``positions`` has the shape (n, 2), ``poses`` (n, 7), or (all pictures, 7) for clips; NaN stands for a
    missing value. ``media`` holds images or videos. ``clips`` is empty for single images.
    """

    touches: found_touches.FoundTouches
    labels: Int64
    objects: Int64
    positions: Float64
    poses: Float64
    media: Sequence[bytes]
    clips: Sequence[imported_clips.ImportedClip]


def touch_schema(
    columns: import_columns.ImportColumns, names: Sequence[str], touches: found_touches.FoundTouches
) -> pa.Schema:
    """Return the schema of imported rounds, of clips or of single images, with the columns that are known."""
    kind: Kind = "seq" if touches.has_clips else "single"
    known: dict[str, pa.DataType] = {}
    if columns.position:
        known["pos_in_cell"] = pa.list_(pa.float64(), 2)
    if columns.pose:
        for part, numbers in _POSE_PARTS.items():
            pose = pa.list_(pa.float64(), numbers.stop - numbers.start)
            known[f"{POSE_COLUMN[kind]}.{part}"] = pa.list_(pose) if kind == "seq" else pose
    if kind == "seq":
        known |= {
            "video_length_frames": pa.int64(),
            "time_stamp_rel_seq": pa.list_(_TIME),
            "touch_start_time_rel": _TIME,
            "touch_end_time_rel": _TIME,
        }
    known[MEDIA_COLUMN[kind]] = MEDIA_TYPE
    known |= extra_types(touches, columns)
    of_round = [("id", pa.string()), ("label", pa.int64())]
    if columns.object_id:
        of_round.append(("object_id", pa.int64()))
    of_touches = [(name, pa.list_(data_type)) for name, data_type in known.items()]
    return with_features(pa.schema([*of_round, *of_touches]), names)


def extras_in(schema: pa.Schema) -> dict[str, pa.DataType]:
    """Return the type of the value of a touch in each extra column of a schema."""
    return {
        name: schema.field(name).type.value_type
        for name in stored_schema.extra_columns(schema.names).values()
    }


def table_of_touches(
    stored: StoredTouches, columns: import_columns.ImportColumns, schema: pa.Schema
) -> pa.Table:
    """Return touches of whole rounds, one round after the other, as rows."""
    rounds = found_touches.one_chunk(stored.touches.where["round"])
    codes = rounds.dictionary_encode().indices.to_numpy()
    starts = np.flatnonzero(np.diff(codes, prepend=-1))
    made: dict[str, pa.Array] = {
        "id": rounds.take(pa.array(starts)),
        "label": pa.array(stored.labels[starts]),
        "object_id": pa.array(stored.objects[starts]),
    }
    of_touches = _media_and_poses(stored, schema)
    extras = extras_in(schema)
    of_touches |= dict(zip(extras, extra_arrays(stored.touches, columns, extras), strict=True))
    offsets = pa.array([*starts.tolist(), len(codes)], pa.int32())
    for name, values in of_touches.items():
        if name in schema.names:
            made[name] = pa.ListArray.from_arrays(offsets, values, type=schema.field(name).type)
    return pa.table([made[name] for name in schema.names], schema=schema)


def _media_and_poses(stored: StoredTouches, schema: pa.Schema) -> dict[str, pa.Array]:
    """Return the columns with an entry for each touch, except the extra ones."""
    kind: Kind = "seq" if MEDIA_COLUMN["seq"] in schema.names else "single"
    paths = [name.rpartition("/")[2] for name in stored.touches.where["name"].to_pylist()]
    made: dict[str, pa.Array] = {}
    if kind == "seq":
        paths = [f"{path}.avi" for path in paths]
        made |= _clip_times(stored.clips)
    made[MEDIA_COLUMN[kind]] = media_array(stored.media, paths)
    made["pos_in_cell"] = _vectors(stored.positions, 2)
    for part, numbers in _POSE_PARTS.items():
        name = f"{POSE_COLUMN[kind]}.{part}"
        made[name] = _vectors(stored.poses[:, numbers], numbers.stop - numbers.start)
        if kind == "seq":
            made[name] = column_types.lists_of(made[name], [len(clip.time_us) for clip in stored.clips])
    return made


def _clip_times(clips: Sequence[imported_clips.ImportedClip]) -> Mapping[str, pa.Array]:
    """Return the columns of times of clips, an entry for each clip."""
    time_us = np.concatenate([np.empty(0, np.int64), *(clip.time_us for clip in clips)])
    lengths = [len(clip.time_us) for clip in clips]
    moments = np.array([clip.time_us[list(clip.contact)] for clip in clips], np.int64).reshape(-1, 2)
    return {
        "video_length_frames": pa.array(lengths, pa.int64()),
        "time_stamp_rel_seq": column_types.lists_of(_times(time_us), lengths),
        "touch_start_time_rel": _times(moments[:, 0]),
        "touch_end_time_rel": _times(moments[:, 1]),
    }


def _times(time_us: AnyArray) -> pa.Array:
    return pa.array(np.ascontiguousarray(time_us).astype("timedelta64[us]"), _TIME)


def _vectors(rows: Float64, width: int) -> pa.Array:
    return pa.FixedSizeListArray.from_arrays(pa.array(rows.reshape(-1)), width)
