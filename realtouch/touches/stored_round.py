"""A stored round: its columns are checked where they are read.

T is the number of touches of the round, N_i the number of frames of touch i: the stated length of its clip,
to which entries per frame are cut. What is wrong with a value is a :class:`realtouch.touches.damage.Damage`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from realtouch.touches import schema
from realtouch.touches.damage import Damage, DamagedRoundError
from realtouch.touches.poses import Poses, PoseSequences, bad_pose, pose_of
from realtouch.video import avi
from tactile_toolkit import errors, read, touch, wording
from tactile_toolkit.value_types import AnyArray, Bool, Float64, Floating, Int64, JsonDict, JsonValue

_NO_TIME = "no time is stored; expected a duration or float seconds"
_CONTACT_START = "touch_start_time_rel"
_CONTACT_END = "touch_end_time_rel"
_POSE = schema.POSE_COLUMN["single"]
_POSE_SEQUENCE = schema.POSE_COLUMN["seq"]

# The first of these that exists gives the number of touches; the last ones only if no other column was read.
_COUNTED = (
    "pos_in_cell",
    "sensor_image",
    "sensor_video",
    "gel_pose_cell_frame.position",
    "gel_pose_cell_frame_seq.position",
    schema.CONTACT_COLUMN,
)
_IMPORT_STEPS = {
    column: f"import it again with --map {name}=COLUMN, if the source has it"
    for column, name in {
        "pos_in_cell": "position",
        "object_id": "object",
        **dict.fromkeys(schema.POSE_COLUMN.values(), "pose"),
    }.items()
}
_UNREADABLE = (ValueError, pa.ArrowException)
_TOO_LONG = f"a clip of {{:,}} frames; expected an integer of 0 to {avi.MAX_CLIP_FRAMES:,}"


class StoredRound(read.Row):
    """A stored round, which reads its columns: each is checked where it is read."""

    __slots__ = ()

    @property
    def kind(self) -> schema.Kind:
        """Whether it has clips or images."""
        return "seq" if self.has(schema.MEDIA_COLUMN["seq"]) else "single"

    @property
    def media_column(self) -> str:
        """Column of its clips or images."""
        return schema.MEDIA_COLUMN[self.kind]

    @property
    def has_poses(self) -> bool:
        """Whether it has poses of the gel."""
        return schema.has_poses(self.group.names)

    @property
    def contact_source(self) -> schema.ContactSource:
        """How contact of its touches is known."""
        return schema.ContactSource.of(read.column_types(self.group.table.schema))

    def stated_contact(self, touch: int | None = None) -> Bool:
        """Return the column of contact, shape (T,), or of ``touch``, (1,), bool."""
        entries = self.extra_entries(schema.CONTACT_COLUMN).cast(pa.bool_())
        stated: Bool = pc.fill_null(entries, False).to_numpy(zero_copy_only=False)
        return stated if touch is None else stated[touch : touch + 1]

    def damaged(self, field: str, problem: str, touch: int | None = None) -> DamagedRoundError:
        """Return the error for a field that cannot be used."""
        return DamagedRoundError(Damage(self.path, self.number, touch, field, problem))

    @contextmanager
    def naming(self, field: str, touch: int | None = None, prefix: str = "") -> Iterator[None]:
        """Turn a ValueError into damage of a field."""
        try:
            yield
        except ValueError as error:
            raise self.damaged(field, f"{prefix}{error}", touch) from error

    def missing_column(self, field: str) -> errors.InputError:
        """Return the error for a requested column that the data set does not have."""
        step = "use a data set that has it, such as the `seq` or the `single` form of the same touches"
        if touch.HeightRule.of(self.group.names) is None:  # only published sets have several forms
            step = _IMPORT_STEPS.get(field.partition(".")[0], "use a data set that has it")
        return errors.InputError(f"{self.path!r} has no column {field!r}", next=step)

    def column_of(self, name: str) -> read.NestedColumn:
        """Return the column of a row; InputError when the data set has no column of that name."""
        try:
            return self.group.nested(name)
        except KeyError as error:
            raise self.missing_column(name) from error

    def touch_total(self) -> int:
        """Return T: the number of intended positions, else of images or clips, else of poses."""
        # Cached for a block of rows, as it is used for each touch.
        name = next(filter(self.has, _COUNTED), _COUNTED[0])
        starts = self.group.once("starts of touches", lambda: self.column_of(name).levels[0])
        if isinstance(starts, int):
            return starts
        return int(starts[self.index + 1] - starts[self.index])

    def entries_of(self, name: str, touch: int | None = None) -> tuple[read.NestedColumn, int, int]:
        """Return a column and the range of its entries that belong to the round, or to one touch.

        Raises IntegrityError unless the round has T entries, IndexError if it has no such touch.
        """
        column = self.column_of(name)
        start, stop = column.inside(0, self.index, self.index + 1)
        expected = self.touch_total()
        if stop - start != expected:
            raise self.damaged(name, f"{stop - start} touches; expected {expected} as in 'pos_in_cell'")
        if touch is None:
            return column, start, stop
        if not -expected <= touch < expected:
            raise IndexError(f"touch {touch} is out of range for {wording.with_count(expected, 'touches')}")
        first = start + touch % expected
        return column, first, first + 1

    def require_touches(self) -> None:
        """Refuse a round whose columns differ in their number of touches; IntegrityError, with the column."""
        for name in schema.per_touch_columns(self.group.names):
            self.entries_of(name)

    def require_each(self, name: str, good: Bool, touch: int | None, problem: str, *values: AnyArray) -> None:
        """Raise IntegrityError for the first entry of touches that is not good.

        ``touch`` is the number of the first entry; the value ``found`` there is put into ``problem``.
        """
        if not good.all():
            wrong = int(np.argmin(good))
            raise self.damaged(
                name, problem.format(*(column[wrong] for column in values)), (touch or 0) + wrong
            )

    def per_touch(self, name: str, touch: int | None = None) -> AnyArray:
        """Return one value per touch, (T,), or that of ``touch``, (1,); IntegrityError unless there are T."""
        column, start, stop = self.entries_of(name, touch)
        values: AnyArray = column.values[start:stop]
        return values

    def vectors(self, name: str, width: int, touch: int | None = None) -> Floating:
        """Return one vector per touch, shape (T, width), or that of ``touch``, (1, width), a view.

        Raises IntegrityError for other numbers of values.
        """
        column, start, stop = self.entries_of(name, touch)
        values = column.flat(1, start, stop)
        touches = stop - start
        if len(values) != touches * width:
            problem = (
                f"{wording.with_count(len(values), 'values')} for {touches} touches; expected {width} each"
            )
            if touch is not None:
                problem = f"{wording.with_count(len(values), 'values')}; expected {width}"
            raise self.damaged(name, problem, touch)
        return values.reshape(touches, width)

    def readable(self, read: Callable[[int | None], AnyArray], shape: tuple[int, ...] = ()) -> Float64:
        """Read a value of all touches, shape (T, ...), float64; NaN for damaged touches."""
        try:
            return read(None).astype(np.float64)
        except errors.IntegrityError:
            # Touch by touch only if something is damaged; all at once is many times as fast.
            known = np.full((self.touch_total(), *shape), np.nan)
        for number in range(len(known)):
            with suppress(errors.IntegrityError):
                known[number] = read(number)[0]
        return known

    def clip_lengths(self) -> Int64:
        """Return the number of frames of each clip, shape (T,).

        Raises IntegrityError for lengths that are missing, negative or beyond the limit.
        """
        values = self.per_touch("video_length_frames")
        # False for NaN, which stands for a missing one.
        possible = (values >= 0) & (values <= avi.MAX_CLIP_FRAMES) & (values == np.trunc(values))
        self.require_each("video_length_frames", possible, None, _TOO_LONG, values)
        return values.astype(np.int64, copy=False)

    def clip_length(self, touch: int) -> int:
        """Return the number of frames of one clip; raises as :func:`clip_lengths`."""
        column, index, _ = self.entries_of("video_length_frames", touch)
        frames = column.values[index]
        if not (0 <= frames <= avi.MAX_CLIP_FRAMES and int(frames) == frames):
            raise self.damaged("video_length_frames", _TOO_LONG.format(frames), touch)
        return int(frames)

    def cut(self, name: str, width: int, touch: int | None = None) -> tuple[AnyArray, ...]:
        """Return a sequence per touch, or that of ``touch``, cut to the length of its clip, (N_i, width).

        A width of 0 means scalars, and shapes (N_i,). Raises IntegrityError when there are not T sequences,
        one is too short, or entries are not ``width`` values each.
        """
        if touch is not None:
            return (self._cut_touch(name, touch, width),)
        lengths = self.clip_lengths()
        column, first, last = self.entries_of(name)
        padded = column.padded(first, last, width)
        # Published clips are padded to the longest of their round: one view, cut T times.
        if padded is not None and padded.shape[1] >= lengths.max(initial=0):
            return tuple(values[:length] for values, length in zip(padded, lengths.tolist(), strict=True))
        return tuple(self._cut_touch(name, number, width) for number in range(last - first))

    def _cut_touch(self, name: str, touch: int, width: int) -> AnyArray:
        # Counted for a single touch as well; else missing values would be read from the next round.
        column, first, _ = self.entries_of(name)
        start, stop = column.inside(1, first + touch, first + touch + 1)
        count = self.clip_length(touch)
        if count > stop - start:
            raise self.damaged(name, f"{stop - start} frames; expected at least {count}", touch)
        values = column.flat(2, start, start + count) if width else column.values[start : start + count]
        if len(values) != count * max(width, 1):
            raise self.damaged(
                name,
                f"{wording.with_count(len(values), 'values')} for {count} frames; expected "
                f"{max(width, 1)} each",
                touch,
            )
        return values.reshape(count, width) if width else values

    def extra_entries(self, name: str) -> pa.Array:
        """Return the T entries of a further column, by its stored name; IntegrityError unless there are T."""
        self.entries_of(name)
        entries = self.group.arrow(name)[self.index].values
        if entries is None:  # a list of fixed length hides a null
            raise self.damaged(name, "no values are stored")
        return entries

    def extra_of_frames(self, name: str, entries: pa.Array, touch: int, count: int) -> pa.Array:
        """Return what a further column, given its entries, has for the first frames of a clip.

        Values that are missing for the whole clip are null. Raises IntegrityError for fewer than ``count``.
        """
        frames = entries[touch].values
        if frames is None:
            return pa.nulls(count, entries.type.value_type)
        if len(frames) < count:
            count_text = wording.with_count(len(frames), "frames")
            raise self.damaged(name, f"{count_text}; expected at least {count}", touch)
        return frames.slice(0, count)

    def extra_values(self, name: str) -> AnyArray | tuple[AnyArray, ...]:
        """Return a further column by its own name; see :class:`realtouch.touches.schema.Extras`.

        Raises InputError, which is a KeyError too, without such a column, IntegrityError if it is damaged.
        """
        known = schema.extra_columns(self.group.names)
        if name not in known:
            raise schema.UnknownExtraError(name, self.path, known)
        stored = known[name]
        values = self.extra_entries(known[name])
        if not stored.startswith(schema.EXTRA_PREFIX["frame"]):
            with self.naming(stored):
                return schema.array_with_gaps(values)
        arrays = []
        for number, length in enumerate(self.clip_lengths().tolist()):
            frames = self.extra_of_frames(stored, values, number, length)
            with self.naming(stored, number):
                arrays.append(schema.array_with_gaps(frames))
        return tuple(arrays)

    def plain_value(self, name: str) -> JsonValue:
        """Return a field as numpy's scalar or Python's object.

        Raises InputError when the data set has no such column, IntegrityError when no value is stored, or
        text that is not Unicode.
        """
        try:
            value = self.value(name)
        except KeyError as error:
            raise self.missing_column(name) from error
        except _UNREADABLE:  # one such value spoils the column of its whole block
            value = self.stored_value(name)
        if value is None:
            raise self.damaged(name, "no value is stored")
        return value

    def stored_value(self, name: str) -> JsonValue:
        """Return a field of any type as Python's objects, without reading other rows.

        Raises IntegrityError for text that is not Unicode.
        """
        try:
            return self.group.arrow(name)[self.index].as_py()
        except _UNREADABLE as error:
            raise self.damaged(name, f"a value that cannot be read ({error})") from error

    def integer(self, name: str) -> int:
        """Return a field as an int from 0 to below 2**63; IntegrityError for others, else as plain_value."""
        value = self.plain_value(name)
        if not isinstance(value, np.signedinteger):
            value = self.stored_value(name)  # a null next to it made numpy's column inexact
        number = read.whole_number(value)
        if number is None or number < 0:
            problem = "no value is stored" if value is None else f"the value is {value}"
            raise self.damaged(name, f"{problem}; expected an integer of 0 or more, below 2**63")
        return number

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

    def stamps_s(self, touch: int | None = None) -> list[Float64] | None:
        """Return the time stamps of each touch, or of ``touch``: shapes (N_i,), float64, seconds.

        None if the data set stores none. Raises IntegrityError for stamps that are missing or run backwards.
        """
        if not self.has("time_stamp_rel_seq"):
            return None
        stamps = [schema.as_seconds(times) for times in self.cut("time_stamp_rel_seq", 0, touch)]
        if touch is None:
            # All at once; touch by touch only to find the wrong one.
            joined = np.concatenate([np.zeros(0), *stamps])
            falls = np.flatnonzero(joined[1:] < joined[:-1]) + 1
            if np.isfinite(joined).all() and np.isin(falls, np.cumsum(list(map(len, stamps)))).all():
                return stamps
        for number, times in enumerate(stamps, touch or 0):
            # A comparison with NaN is false, so this finds missing times too.
            if not (times[1:] >= times[:-1]).all() or (len(times) and not math.isfinite(times[0])):
                raise self.damaged("time_stamp_rel_seq", "times that are missing or run backwards", number)
        return stamps

    def touch_durations(self, name: str) -> NDArray[np.timedelta64]:
        """Return one time per touch, shape (T,), ``timedelta64``; IntegrityError for a missing time."""
        times = schema.as_timedelta(self.per_touch(name))
        self.require_each(name, ~np.isnat(times), None, _NO_TIME)
        return times

    def times_of_touches(self, touch: int | None = None) -> tuple[Float64, Float64]:
        """Return the times of first and last contact of all touches, (T,), or of ``touch``, (1,), seconds.

        Raises IntegrityError when a time is missing, or the end lies before the start.
        """
        start_s, end_s = (
            schema.as_seconds(self.per_touch(name, touch)) for name in (_CONTACT_START, _CONTACT_END)
        )

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

        Raises IntegrityError, which names the touch, for a position or quaternion that is missing or not
        finite, and for a quaternion whose length is not one.
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
            for number, poses in enumerate(zip(positions, quaternions, strict=True), touch or 0):
                wrong = bad_pose(*poses)
                if wrong is not None:
                    raise self.damaged(_POSE_SEQUENCE, f"frame {wrong[0]}: {wrong[1]}", number)
        return PoseSequences(positions, quaternions)

    def contact_z_m(self, touch: int | None = None) -> Float64:
        """Return the height of the gel at the deepest press of each touch, shape (T,), or of ``touch``, (1,).

        Metres, cell frame; of a round of images, that is the height of its one pose per touch. Raises
        IntegrityError, which names the touch, for a height that is missing or not finite.
        """
        name, of_images = schema.POSITION_COLUMNS
        if self.has(name) or self.kind == "seq":
            # A clip without frames has no height: infinity is refused below.
            heights = np.array(
                [position_m[:, 2].min(initial=np.inf) for position_m in self.cut(name, 3, touch)]
            )
        else:
            name = of_images
            heights = self.vectors(name, 3, touch)[:, 2].astype(np.float64)
        finite = np.isfinite(heights)
        self.require_each(name, finite, touch, "a gel height of {}; expected metres", heights)
        return heights

    def plate_z_m(self, rule: touch.HeightRule | None) -> float:
        """Return the height of the plate in a round, metres, cell frame; NaN where it is not known.

        Rendered sets of a GelSight Mini need not store it.
        """
        column = touch.HeightRule.PLATE_COLUMN
        stored_m = math.nan
        if self.has(column) and self.value(column) is not None:
            stored_m = float(self.value(column))  # NaN if it is null
        if math.isnan(stored_m) and rule is not None and rule.plate == "known":
            return touch.PRESS_DEPTH_M
        return stored_m

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
        nested: JsonDict = {}
        for name in filter(lambda name: name.startswith("info."), self.group.names):
            # The published sets store the struct `info` as flat columns with dotted names.
            *outer, last = name.split(".")[1:]
            group: JsonValue = nested
            for part in outer:
                if isinstance(group, dict):
                    group = group.setdefault(part, {})
            if not isinstance(group, dict) or last in group:
                raise self.damaged(name, "the name of a value and of a group of values; expected one of them")
            group[last] = self.stored_value(name)
        return {key: self._with_poses(value, f"info.{key}") for key, value in nested.items()}

    def _with_poses(self, value: JsonValue, name: str) -> JsonValue:
        """Replace groups of a position and a quaternion by poses."""
        if not isinstance(value, dict):
            return value
        if value.keys() == {"position", "quaternion"}:
            with self.naming(name):
                return pose_of(value["position"], value["quaternion"])
        return {key: self._with_poses(inner, f"{name}.{key}") for key, inner in value.items()}


def stored_rows(
    shards: Iterable[read.RowSource], columns: Sequence[str] | None = None
) -> Iterator[StoredRound]:
    """Yield the rows of files, with all columns or the named ones; one block is in memory at a time."""
    return rows_of(read.ShardedTable(tuple(shards)).blocks(columns))


def rows_of(blocks: Iterable[read.RowGroup]) -> Iterator[StoredRound]:
    """Yield the rows of some blocks."""
    return (StoredRound(block, row) for block in blocks for row in range(len(block.table)))
