"""A stored round: positions and times of its touches, poses of the gel, and metadata."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from realtouch import contact, schema, stored_columns
from realtouch.poses import Poses, PoseSequences, bad_pose, rigid_transform
from tactile_toolkit import read
from tactile_toolkit.array_types import AnyArray, Float64, Floating, Int64
from tactile_toolkit.json_types import JsonDict, JsonValue
from tactile_toolkit.touch import MEDIA_COLUMN, PRESS_DEPTH_M, Kind

if TYPE_CHECKING:
    from realtouch.pose import Pose

_NO_TIME = "no time is stored; expected a duration or float seconds"
_SECOND = np.timedelta64(1, "s")
_CONTACT_START, _CONTACT_END = "touch_start_time_rel", "touch_end_time_rel"
_POSE, _POSE_SEQUENCE = schema.POSE_COLUMN["single"], schema.POSE_COLUMN["seq"]
# Columns with an entry for each touch; pictures come last, as they take much memory.
_COUNTING = ("pos_in_cell", "video_length_frames", f"{_POSE}.position", *MEDIA_COLUMN.values())


class StoredRound(stored_columns.StoredColumns):
    """A stored round; T is the number of its touches, N_i the number of frames of touch i."""

    __slots__ = ()

    def intended_positions(self, touch: int | None = None) -> Floating:
        """Return the intended position of each touch, shape (T, 2), or of one touch, (1, 2), as a view.

        Metres, cell frame. Raises IntegrityError, which names the touch, for a position that is missing or
        not finite.
        """
        positions = self.vectors("pos_in_cell", 2, touch)
        # The sum is finite only if all values are, and is ten times as fast to check.
        if not np.isfinite(positions.sum()):
            finite = np.asarray(np.isfinite(positions).all(axis=1))
            self.require_each("pos_in_cell", finite, touch, "a position {}; expected metres", positions)
        return positions

    def frame_times(self) -> tuple[NDArray[np.timedelta64], ...]:
        """Return the time stamps of the frames of each touch: T arrays of ``timedelta64``, shapes (N_i,)."""
        return tuple(_as_timedelta(times) for times in self.cut("time_stamp_rel_seq", 0))

    def stamps_s(self, touch: int | None = None) -> list[Float64] | None:
        """Return the time stamps of each touch, or of ``touch``: shapes (N_i,), float64, seconds.

        None if the data set stores none. Raises IntegrityError for stamps that are missing or run backwards.
        """
        if not self.has("time_stamp_rel_seq"):
            return None
        found = [as_seconds(times) for times in self.cut("time_stamp_rel_seq", 0, touch)]
        if touch is None:
            # All at once; touch by touch only to find the wrong one.
            joined = np.concatenate([np.zeros(0), *found])
            falls = np.flatnonzero(joined[1:] < joined[:-1]) + 1
            if np.isfinite(joined).all() and np.isin(falls, np.cumsum(list(map(len, found)))).all():
                return found
        for number, times in enumerate(found, touch or 0):
            # A comparison with NaN is false, so this finds missing times too.
            if not (times[1:] >= times[:-1]).all() or (len(times) and not math.isfinite(times[0])):
                raise self.damaged("time_stamp_rel_seq", "times that are missing or run backwards", number)
        return found

    def touch_durations(self, name: str) -> NDArray[np.timedelta64]:
        """Return one time per touch, shape (T,), ``timedelta64``; IntegrityError for a missing time."""
        times = _as_timedelta(self.per_touch(name))
        self.require_each(name, ~np.isnat(times), None, _NO_TIME)
        return times

    def times_of_touches(self, touch: int | None = None) -> tuple[Float64, Float64]:
        """Return the times of first and last contact of all touches, (T,), or of ``touch``, (1,), seconds.

        Raises IntegrityError when a time is missing, or the end lies before the start.
        """
        start_s, end_s = (as_seconds(self.per_touch(name, touch)) for name in (_CONTACT_START, _CONTACT_END))

        problem = "contact from {} s to {} s; expected an end not before the start"
        self.require_each(_CONTACT_START, ~np.isnan(start_s), touch, problem, start_s, end_s)
        # The comparison is false for NaN, a missing end.
        self.require_each(_CONTACT_END, start_s <= end_s, touch, problem, start_s, end_s)
        return start_s, end_s

    def stored_clip(self, touch: int) -> memoryview:
        """Return the bytes of one clip, without a copy; IntegrityError if no bytes are stored."""
        column = self.group.nested("sensor_video")
        start, stop = column.inside(0, self.index, self.index + 1)
        blob: memoryview | None = column.values[start + touch] if touch < stop - start else None
        if blob is None or len(blob) == 0:
            raise self.damaged("sensor_video", "no bytes are stored; expected an AVI", touch)
        return blob

    def poses(self, touch: int | None = None) -> Poses:
        """Return the pose of the gel in each touch of a ``single`` round, T poses, or that of ``touch``.

        Raises IntegrityError, which names the touch, for a position or quaternion that is missing, not finite
        or of length zero.
        """
        positions = self.vectors(f"{_POSE}.position", 3, touch)
        quaternions = self.vectors(f"{_POSE}.quaternion", 4, touch)
        wrong = bad_pose(positions, quaternions)
        if wrong is not None:
            raise self.damaged(_POSE, wrong[1], (touch or 0) + wrong[0])
        return Poses(positions, quaternions)

    def pose_sequences(self, touch: int | None = None) -> PoseSequences:
        """Return the pose of the gel in each frame of each touch of a ``seq`` round, or of one; no padding.

        Raises IntegrityError as :meth:`poses` does, and if a touch has fewer poses than frames.
        """
        positions = self.cut(f"{_POSE_SEQUENCE}.position", 3, touch)
        quaternions = self.cut(f"{_POSE_SEQUENCE}.quaternion", 4, touch)
        # Checked all at once; touch by touch only to find the wrong one.
        if positions and bad_pose(np.concatenate(positions), np.concatenate(quaternions)) is not None:
            for number, each in enumerate(zip(positions, quaternions, strict=True), touch or 0):
                wrong = bad_pose(*each)
                if wrong is not None:
                    raise self.damaged(_POSE_SEQUENCE, f"frame {wrong[0]}: {wrong[1]}", number)
        return PoseSequences(positions, quaternions)

    def contact_z_m(self, kind: Kind, touch: int | None = None) -> Float64:
        """Return the height of the gel at the deepest press of each touch, shape (T,), or of ``touch``, (1,).

        Metres, cell frame; of a ``single`` round, that is the height of its one pose per touch. Raises
        IntegrityError, which names the touch, for a height that is missing or not finite.
        """
        name = f"{schema.POSE_COLUMN[kind]}.position"
        if kind == "single":
            heights = self.vectors(name, 3, touch)[:, 2].astype(np.float64)
        else:
            # A clip without frames has no height: infinity is refused below.
            heights = np.array([each[:, 2].min(initial=np.inf) for each in self.cut(name, 3, touch)])
        finite = np.isfinite(heights)
        self.require_each(name, finite, touch, "a gel height of {}; expected metres", heights)
        return heights

    def stored_plate_z_m(self) -> float:
        """Return the stored height of the plate in a round, metres, cell frame; NaN without one."""
        if not self.has(contact.PLATE_COLUMN) or self.value(contact.PLATE_COLUMN) is None:
            return math.nan
        return float(self.value(contact.PLATE_COLUMN))

    def rendered_plate_z_m(self) -> float:
        """Return the height of the plate in a rendered round; sets of a GelSight Mini need not store it."""
        stored_m = self.stored_plate_z_m()
        if math.isnan(stored_m):
            return PRESS_DEPTH_M
        return stored_m

    def plate_z_m(self) -> float:
        """Return the known or stored height of the plate in a round, metres, cell frame; NaN without one."""
        if contact.ContactHeight.of(self.group.names).plate == "known":
            return self.rendered_plate_z_m()
        return self.stored_plate_z_m()

    def name(self) -> str:
        """Return the id as text; raises IntegrityError as :meth:`integer` does."""
        value = self.plain_value("id")
        return value if isinstance(value, str) else str(self.integer("id"))

    def label_value(self, names: Sequence[str] | None = None) -> int:
        """Return the class, -1 if it is unknown, as in `datasets`, or if the data set has no labels.

        Raises IntegrityError if ``names`` are given and the class is not one of them.
        """
        if not self.has("label") or self.plain_value("label") == -1:
            return -1
        label = self.integer("label")
        if names is not None and label >= len(names):
            raise self.damaged(
                "label", f"the value is {label}; expected less than {len(names)}, the number of named classes"
            )
        return label

    def has_info(self) -> bool:
        """Return whether a round has metadata."""
        return self.has("info") or any(name.startswith("info.") for name in self.group.names)

    def read_info(self) -> JsonDict:
        """Read the metadata of a round; InputError when the data set does not store it.

        Raises IntegrityError for an invalid pose, or for a name of both a value and a group of values.
        """
        if not self.has_info():
            raise self.missing_column("info")
        return nested_info(self)

    def __reduce__(self) -> tuple[object, ...]:
        return (_unpickled, super().__reduce__())


def _as_timedelta(values: AnyArray) -> NDArray[np.timedelta64]:
    """Return times as ``timedelta64``: numbers count seconds and are rounded to nanoseconds."""
    if values.dtype.kind == "m":
        return values
    # Durations arrive as seconds in floats, too.
    nanoseconds = np.round(np.asarray(values, np.float64) * 1e9)
    unknown = ~np.isfinite(nanoseconds)
    # The integer that NaN becomes differs between processors.
    times = np.where(unknown, 0, nanoseconds).astype(np.int64).astype("timedelta64[ns]")
    times[unknown] = np.timedelta64("NaT", "ns")
    return times


def as_seconds(values: AnyArray) -> Float64:
    """Return times (an array, or one of its values) in seconds, float64; unknown ones are NaN."""
    if values.dtype.kind == "m":
        seconds: Float64 = values / _SECOND
        return seconds
    return np.asarray(values, np.float64)


def _unpickled(make: Callable[..., read.Row], arguments: tuple[object, ...]) -> StoredRound:
    row = make(*arguments)
    return StoredRound(row.group, row.index)


def stored_rows(
    shards: Iterable[read.RowSource], columns: Sequence[str] | None = None
) -> Iterator[StoredRound]:
    """Yield the rows of files, with all columns or the named ones; one block is in memory at a time."""
    return rows_of(read.all_blocks(shards, columns))


def rows_of(blocks: Iterable[read.RowGroup]) -> Iterator[StoredRound]:
    """Yield the rows of some blocks."""
    return (StoredRound(block, row) for block in blocks for row in range(len(block.table)))


def stored_touch_counts(source: read.RowSource, *groups: int) -> Int64:
    """Return the numbers of touches of some row groups, or of all, shape (rows,).

    If the type of the column fixes the number, no row is read.
    """
    types, chosen = read.column_types(source.schema), groups or range(len(source.group_starts) - 1)
    name = next(name for name in _COUNTING if name in types)
    if pa.types.is_fixed_size_list(types[name]):
        rows = sum(source.group_starts[index + 1] - source.group_starts[index] for index in chosen)
        return np.full(rows, types[name].list_size, np.int64)
    column = name
    if name in MEDIA_COLUMN.values() and isinstance(source, read.Shard):
        # The names of pictures are counted: pictures fill the memory.
        leaf = f"{name}.list.element.path"
        if any(chunk.path_in_schema == leaf for chunk in source.column_chunks()):
            column = leaf
    blocks = (block for index in chosen for block in source.blocks(index, [column]))
    counts = [pc.fill_null(pc.list_value_length(block.arrow(name)), 0) for block in blocks]
    return np.concatenate([each.to_numpy() for each in counts] or [np.zeros(0)]).astype(np.int64)


def nested_info(row: stored_columns.StoredColumns) -> JsonDict:
    """Read the metadata of a round that has some.

    Raises IntegrityError for an invalid pose, or for a name of both a value and a group of values.
    """
    nested: JsonDict = {}
    for name in row.group.names:
        if not name.startswith("info."):
            continue
        # The published sets store the struct `info` as flat columns with dotted names.
        *outer, last = name.split(".")[1:]
        group: JsonValue = nested
        for part in outer:
            if isinstance(group, dict):
                group = group.setdefault(part, {})
        if not isinstance(group, dict) or last in group:
            raise row.damaged(name, "the name of a value and of a group of values; expected one of them")
        group[last] = row.stored_value(name)
    return {key: _with_poses(row, value, f"info.{key}") for key, value in nested.items()}


def _with_poses(row: stored_columns.StoredColumns, value: JsonValue, name: str) -> JsonValue:
    """Replace groups of a position and a quaternion by poses."""
    if not isinstance(value, dict):
        return value
    if value.keys() == {"position", "quaternion"}:
        return _pose(row, value, name)
    return {key: _with_poses(row, each, f"{name}.{key}") for key, each in value.items()}


def _pose(row: stored_columns.StoredColumns, values: JsonDict, name: str) -> Pose | Poses:
    """Make the pose, or the poses if there is one per touch."""
    try:
        position = np.asarray(values["position"], np.float64)
        quaternion = np.asarray(values["quaternion"], np.float64)
    except (TypeError, ValueError) as error:
        raise row.damaged(
            name, "values that are not numbers, or vectors of several lengths; expected a pose's numbers"
        ) from error
    outer = position.shape[:-1]
    if len(outer) > 1 or position.shape != (*outer, 3) or quaternion.shape != (*outer, 4):
        raise row.damaged(
            name,
            f"position {position.shape} and quaternion {quaternion.shape}; "
            "expected (3,) and (4,), or (n, 3) and (n, 4)",
        )
    wrong = bad_pose(position.reshape(-1, 3), quaternion.reshape(-1, 4))
    if wrong is not None:  # one invalid pose makes the metadata of the round unreadable
        raise row.damaged(name, f"pose {wrong[0]}: {wrong[1]}" if outer else wrong[1])
    return Poses(position, quaternion) if outer else rigid_transform(position, quaternion)
