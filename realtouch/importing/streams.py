"""Streams of other rates, such as poses and forces, aligned to the times of the pictures of recordings."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import PurePosixPath

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from realtouch.importing import fields, import_options, source_files, source_touches
from realtouch.importing.import_options import Alignment
from tactile_toolkit import errors, store
from tactile_toolkit.columns import column_types, tables, units
from tactile_toolkit.value_types import Bool, Float64, Floating, Int64

TIME_NAMES = ("time", "times", "timestamp", "timestamps", "time_stamp", "t", "stamp")
"""Names of the column of times, with or without a unit such as in ``time_ms``, unless one is named."""

TIME_TOLERANCE_S = 1e-6
"""Gaps longer than the limit by at most this much are not too long, seconds: rounding of decimal times."""

_NO_TURN = (0.0, 0.0, 0.0, 1.0)
_JOINTS = "._"  # between the name of a recording and that of a stream


StreamReport = tuple[str, ...]
"""How a stream fits a recording: a row below :data:`STREAM_HEADER`."""

_PER_MS = 1e-3
_QUATERNION = 4
_ROTATIONS = ("orientation", "rotation", "quaternion", "quat")
_WITH_QUATERNION = (4, 7)  # numbers of a rotation, and of a pose, with a quaternion at the end
_NO_CLOCK: StreamReport = ("0", "0", "", "", "", "")  # of a stream with a row for each picture
_NO_STREAM = "; if the table is not a stream of this recording, give it another name"
_FLOATS = (pa.float64(), pa.list_(pa.float64()))
_NUMBERS = (pa.float64(), pa.int64())


def open_stream(
    folder: store.DataFolder, name: str, columns: import_options.ImportColumns, stem: str = ""
) -> source_touches.Stream:
    """Read the times of a table.

    Parameters
    ----------
    folder, name
        Folder of the table and its path in it; the format follows from its ending.
    columns : ImportColumns
        ``time`` names the column of times; an empty text says that a row is a picture. If the table has no
        such column, it is the only one with a name of :data:`TIME_NAMES`. ``time_unit`` is the unit if the
        name of the column does not end in one; by default seconds, but integers need a stated unit.
    stem : str, optional
        Beginning of the file name that is not part of the name of the stream.

    Raises
    ------
    InputError
        The table cannot be read, has no rows, several columns of times, or times that are missing, run
        backwards or have no known unit.
    """
    table = tables.Table.of(folder, name)
    address = table.path
    rows, column, values = table.scan(partial(_time_column, columns.time, address))
    if not rows:
        raise errors.InputError(f"{address!r} has no rows; expected a row for each sample")
    whole = PurePosixPath(name).stem
    shown = whole.removeprefix(stem).lstrip(_JOINTS) or whole
    if not column:
        return source_touches.Stream(shown, address, table.rows, rows)
    time_s = _seconds(values, column, columns.time_unit, address)
    return source_touches.Stream(shown, address, table.rows, rows, column, time_s)


def _time_column(time: str | None, address: str, names: Sequence[str]) -> str:
    if time is not None and (not time or time in names):
        return time
    # The name may end in a unit of time only: a column `t_mm` does not hold times.
    endings = ["", *(f"_{unit}" for unit in units.Quantity.TIME.per_unit)]
    known = {f"{base}{ending}" for base in TIME_NAMES for ending in endings}
    candidates = [name for name in names if name.lower() in known]
    if len(candidates) > 1:
        raise errors.InputError(
            f"{address!r} has several columns of times: {', '.join(candidates)}",
            next="name one: `--map time=COLUMN`",
        )
    return candidates[0] if candidates else ""


def _seconds(values: pa.Array, column: str, time_unit: str | None, address: str) -> Float64:
    """Return times in seconds, not decreasing; those with a date count from 1970, UTC."""
    what = f"{address!r}: the times {column!r}"
    stated = units.Quantity.stated_unit(column)
    if pa.types.is_integer(values.type) and not (stated or time_unit):
        raise errors.InputError(
            f"{what} are integers, whose unit is not known",
            next=f"add --time-unit {', '.join(units.Quantity.TIME.per_unit)}, or end the name of the column "
            "in the unit",
        )
    try:
        time_s = fields.times_s(values, column, None if stated else time_unit)
    except errors.ItemError as error:
        raise errors.InputError(f"{what}: {error.what}") from error
    back = np.flatnonzero(np.diff(time_s) < 0)
    if len(back):
        row = int(back[0])
        raise errors.InputError(
            f"{address!r}: the time runs backwards, from {time_s[row]:.6f} s in row {row + 1:,} to "
            f"{time_s[row + 1]:.6f} s in row {row + 2:,}; expected times that do not decrease",
            next="sort the rows, or divide the table where the clock was set",
        )
    return time_s


def tables_by_stem(names: Iterable[str]) -> dict[str, list[str]]:
    """Return the tables that belong to each other file of a folder, by the name of that file without ending.

    ``take1.csv``, ``take1.force.csv`` and ``take1_force.csv`` belong to ``take1.mp4``. If the names of
    several files fit, a table belongs to the longest one, such as ``take1_force.mp4``.
    """
    visible = [name for name in names if not store.is_hidden(name)]
    table_names = [name for name in visible if name.lower().endswith(tables.Table.ENDINGS)]
    stems = {PurePosixPath(name).stem for name in {*visible} - {*table_names}}
    by_stem: dict[str, list[str]] = {}
    for name in sorted(table_names):
        whole = PurePosixPath(name).stem
        fitting = [end for end in range(len(whole), 0, -1) if whole[end:][:1] in _JOINTS]
        owner = next((whole[:end] for end in fitting if whole[:end] in stems), None)
        if owner is not None:
            by_stem.setdefault(owner, []).append(name)
    return by_stem


class Aligner:
    """Aligns streams with the recordings of a source: tables that are named, and tables beside a recording.

    Parameters
    ----------
    named : sequence of str
        Paths of tables that are streams of every recording.
    how : Alignment or None
        None stands for the defaults.
    columns : ImportColumns
        ``time`` is the column of times of the recordings and streams that have it. ``pose`` is interpolated
        as a rotation; see :func:`with_streams`.
    no_streams : collection of str
        Paths of tables that are not streams even if they lie beside a recording.

    Attributes
    ----------
    reports : list of StreamReport
        How the streams fit, in the order of recordings; complete after the last recording.
    times : set of str
        Columns of times that were used.
    tables : set of str
        Addresses of the tables that were read.

    Raises
    ------
    InputError
        A table that was named cannot be read.
    """

    def __init__(
        self,
        named: Sequence[str],
        how: Alignment | None,
        columns: import_options.ImportColumns,
        no_streams: Collection[str] = (),
    ) -> None:
        self.reports: list[StreamReport] = []
        self._how, self._columns = how or Alignment(), columns
        self._named = [open_stream(*source_files.source_of(path), columns) for path in named]
        self.times = {stream.time_column for stream in self._named}
        self.tables = {stream.address for stream in self._named}
        self._no_streams = {source_files.address_of(path) for path in (*named, *no_streams)}
        self._opened = cache(store.open_folder)
        self._beside = cache(self._tables_beside)

    def aligned(self, recording: source_touches.Recording) -> source_touches.Recording:
        """Return a recording with the columns of its streams, and with the times that a column states.

        A stream of its own file that does not fit is left out. If a table beside the recording does not fit,
        the recording has a problem. Raises InputError if a stream that was named does not fit.
        """
        if recording.problem is not None:
            return recording
        for stream in sorted(recording.streams, key=lambda stream: stream.rows != recording.frames):
            if stream.time_column:  # a table
                if source_files.address_of(stream.address) in self._no_streams:
                    continue
                self.tables.add(stream.address)
            try:
                recording, reports = with_streams(recording, [stream], self._how, self._columns)
                self.reports += reports
            except errors.InputError as error:
                left_out = f"{stream.name}: {error.message}"
                recording = replace(recording, left_out=(*recording.left_out, left_out))
        try:
            recording = self._timed(recording)
            beside = self._streams_beside(recording)
            self.times |= {stream.time_column for stream in beside}
            self.tables |= {stream.address for stream in beside}
            aligned, reports = with_streams(recording, beside, self._how, self._columns)
        except errors.ItemError as error:
            return replace(recording, problem=error)
        except errors.InputError as error:
            return replace(recording, problem=errors.ItemError("stream", f"{error.message}{_NO_STREAM}"))
        aligned, of_named = with_streams(aligned, self._named, self._how, self._columns, are_beside=False)
        self.reports += [*reports, *of_named]
        return aligned

    def aligned_images(self, touches: source_touches.SourceTouches) -> source_touches.SourceTouches:
        """Return images with the columns of the streams that were named; an image without a time has none.

        Raises InputError if a stream does not fit, or if no image has a time.
        """
        if not self._named:
            return touches
        values = touches.value(source_touches.TIME_S)
        time_s = np.empty(0)
        if values is not None and pa.types.is_floating(values.type):
            time_s = values.to_numpy(zero_copy_only=False)
        rows = np.flatnonzero(np.isfinite(time_s))
        if not len(rows):
            raise errors.InputError(
                "is aligned by the times of the pictures, and they have none",
                next="name the column of their times: --map time=COLUMN",
                field="streams",
            )
        order = rows[np.argsort(time_s[rows], kind="stable")]
        table = touches.per_touch.take(pa.array(order))
        per_frame = {name: source_touches.one_chunk(table[name]) for name in table.column_names}
        pictures = source_touches.Recording("pictures", "", "", "", 0, len(order), 0, per_frame=per_frame)
        aligned, reports = with_streams(
            replace(pictures, time_s=time_s[order]), self._named, self._how, self._columns
        )
        self.reports += reports
        positions = np.full(len(touches), -1)
        positions[order] = np.arange(len(order))
        entries = pa.array(positions, mask=positions < 0)
        return touches.with_fields(
            {
                name: column.take(entries)
                for name, column in aligned.per_frame.items()
                if name not in per_frame
            }
        )

    def _timed(self, recording: source_touches.Recording) -> source_touches.Recording:
        name = self._columns.time
        if not name or name not in recording.per_frame:
            return recording
        time_s = fields.times_s(recording.per_frame[name], name, self._columns.time_unit)
        return replace(recording, time_s=time_s, is_at_stated_rate=False)

    def _streams_beside(self, recording: source_touches.Recording) -> list[source_touches.Stream]:
        folder, _, name = recording.path.rpartition("/")
        stem = PurePosixPath(name).stem
        return [
            open_stream(self._opened(recording.home), path, self._columns, stem)
            for path in self._beside(recording.home, folder).get(stem, ())
            if path != recording.path
        ]

    def _tables_beside(self, home: str, folder: str) -> dict[str, list[str]]:
        """Return the paths of the streams of each recording of a folder, by its name without ending."""
        files = self._opened(home)
        by_stem = {}
        for stem, names in tables_by_stem(files.entries(folder)).items():
            paths = [f"{folder}/{name}".lstrip("/") for name in names]
            if self._no_streams:
                paths = [
                    path
                    for path in paths
                    if source_files.address_of(files.address(path)) not in self._no_streams
                ]
            by_stem[stem] = paths
        return by_stem


def with_streams(
    recording: source_touches.Recording,
    streams: Sequence[source_touches.Stream],
    how: Alignment,
    columns: import_options.ImportColumns,
    *,
    are_beside: bool = True,
) -> tuple[source_touches.Recording, list[StreamReport]]:
    """Add the columns of streams to the fields of each picture.

    Parameters
    ----------
    recording : Recording
        If it has no times, a stream needs a row for each picture, and its times, if it has any, become those
        of the pictures. So it is if its times follow from a stated rate, and a stream has as many rows as it
        has pictures: cameras often deliver another rate than files state.
    streams : sequence of Stream
        A column whose name is taken gets the name of its stream as a prefix: ``force.seq``.
    how : Alignment
        Method, longest gap, and offset of the clocks.
    columns : ImportColumns
        ``pose`` is not interpolated number by number: a quaternion lies on the rotation between two samples,
        and a pose with another kind of rotation is that of the nearest sample.
    are_beside : bool
        Whether the streams were recorded with this video alone: then they last as long. So do others unless
        an offset of their clock is given.

    Raises
    ------
    InputError
        The clocks have no common time or other durations, the rows are not as many as the pictures, or no
        picture gets a value.
    """
    reports: list[StreamReport] = []
    # Those that have the times of the pictures come first.
    for stream in sorted(streams, key=lambda stream: stream.rows != recording.frames):
        has_row_for_each = recording.is_at_stated_rate and stream.rows == recording.frames
        if recording.time_s is None or stream.time_s is None or has_row_for_each:
            columns_added = _by_row(recording, stream)
            facts = _NO_CLOCK
            if stream.time_s is not None:
                time_s = stream.time_s + how.time_offset_s
                recording = replace(recording, time_s=time_s, is_at_stated_rate=False)
        else:
            sample_s = stream.time_s + how.time_offset_s
            columns_added, facts = _by_time(recording, stream, recording.time_s, sample_s, how, columns)
            has_duration = recording.is_at_stated_rate and min(recording.frames, stream.rows) > 1
            if has_duration and (are_beside or not how.time_offset_s):
                durations_s = (float(np.ptp(recording.time_s)), float(np.ptp(sample_s)))
                _require_same_duration(recording, stream, *durations_s, how)
        added = dict(recording.per_frame)
        for name, values in columns_added.items():
            while name in added or name in recording.values:
                name = f"{stream.name}.{name}"
            added[name] = values
        names = ", ".join(name for name in added if name not in recording.per_frame)
        recording = replace(recording, per_frame=added)
        reports.append((recording.name, stream.name, f"{stream.rows:,}", *facts, names))
    return recording, reports


def _require_same_duration(
    recording: source_touches.Recording,
    stream: source_touches.Stream,
    video_s: float,
    stream_s: float,
    how: Alignment,
) -> None:
    """Raise InputError if a stream lasts longer or shorter than its video at the rate that the file states.

    One of both clocks is wrong then, unless the stream was recorded for longer than the video.
    """
    if abs(stream_s - video_s) <= max(how.duration_tolerance * video_s, how.max_gap_ms * _PER_MS):
        return
    rate = (recording.frames - 1) / video_s
    raise errors.InputError(
        f"{stream.address!r} lasts {stream_s:.2f} s, the {recording.frames:,} pictures of "
        f"{recording.name!r} {video_s:.2f} s at the {rate:.4g} pictures a second that the file states; "
        "expected equal durations",
        next="if the camera had another rate, give a table with the time of each picture, a row each; if the "
        f"rate is right, add --duration-tolerance {abs(stream_s / video_s - 1) + 0.01:.2f}",
    )


def _by_row(recording: source_touches.Recording, stream: source_touches.Stream) -> dict[str, pa.Array]:
    """Take a row for each picture."""
    if stream.rows != recording.frames:
        which = "the table" if stream.time_s is None else "the recording"
        raise errors.InputError(
            f"{stream.address!r} has {stream.rows:,} rows, the recording {recording.name!r} "
            f"{recording.frames:,} pictures; expected equal numbers, as {which} has no times",
            next="name the column of times (`--map time=COLUMN`), or give a row for each picture",
        )
    return _columns(stream.read(np.arange(stream.rows)), stream)


def _by_time(
    recording: source_touches.Recording,
    stream: source_touches.Stream,
    time_s: Float64,
    sample_s: Float64,
    how: Alignment,
    columns: import_options.ImportColumns,
) -> tuple[dict[str, pa.Array], StreamReport]:
    """Align a stream to the times of the pictures, both in seconds."""
    if sample_s[0] > time_s[-1] or time_s[0] > sample_s[-1]:
        raise errors.InputError(
            f"{stream.address!r} lasts from {sample_s[0]:.3f} to {sample_s[-1]:.3f} s, the recording "
            f"{recording.name!r} from {time_s[0]:.3f} to {time_s[-1]:.3f} s; expected a common time",
            next="add --time-offset-s with the seconds to add to the times of the stream",
        )
    steps = np.diff(sample_s)
    max_gap_s = how.max_gap_ms * _PER_MS
    around = Neighbours.of(time_s, sample_s, max_gap_s)
    step_s = float(np.median(steps[steps > 0], overwrite_input=True)) if steps.any() else np.inf
    if around.missing.all():
        raise errors.InputError(
            f"{stream.address!r}: no picture of {recording.name!r} gets a value; there are {stream.rows:,} "
            f"samples, about {step_s:g} s apart, and the longest gap is {how.max_gap_ms:g} ms",
            next=f"check the unit of {stream.time_column!r} (`--time-unit`), or add a larger --max-gap-ms",
        )
    used = np.unique([around.before, around.after])
    around = Neighbours.of(time_s, sample_s[used], max_gap_s)
    samples = _columns(stream.read(used), stream)
    nearest = pa.array(around.nearest, mask=around.missing)
    values = {name: column.take(nearest) for name, column in samples.items()}
    if how.method == "linear":
        pose = columns.found_in({*values, *recording.per_frame, *recording.values}).pose or ()
        values |= _between(samples, around, pose)
    clocks = (1 / step_s, sample_s[0] - time_s[0], sample_s[-1] - time_s[-1], steps.max(initial=0.0))
    counts = (f"{np.sum(steps == 0):,}", f"{around.missing.sum():,}")
    return values, (*counts, *(f"{number:.4g}" for number in clocks))


def _between(samples: Mapping[str, pa.Array], around: Neighbours, pose: Sequence[str]) -> dict[str, pa.Array]:
    """Return columns of floats interpolated between samples, and a pose with an interpolated rotation.

    Columns whose names state a unit of angles are interpolated on the shorter way around the circle, and
    those of four numbers whose names end in :data:`_ROTATIONS` as quaternions.
    """
    numbers = {name: column_types.floats_of(column) for name, column in samples.items() if _is_number(column)}
    interpolated = {}
    for name in [name for name in numbers if name not in pose and samples[name].type in _FLOATS]:
        unit = units.Quantity.stated_unit(name)
        interpolated[name] = around.interpolated(numbers[name])
        per_radian = units.Quantity.ANGLE.per_unit
        if unit in per_radian:
            interpolated[name] = around.on_circle(numbers[name], math.tau * per_radian[unit])
        elif numbers[name].shape[1:] == (_QUATERNION,) and name.endswith(_ROTATIONS):
            interpolated[name] = around.turned(numbers[name])
    if pose and numbers.keys() >= {*pose}:
        whole = np.column_stack([numbers[name] for name in pose])
        if whole.shape[1] in _WITH_QUATERNION:
            between = around.interpolated(whole)
            between[:, -_QUATERNION:] = around.turned(whole[:, -_QUATERNION:])
            ends = np.cumsum([numbers[name].size // len(whole) for name in pose])
            parts = zip(pose, np.split(between, ends[:-1], axis=1), strict=True)
            interpolated |= {name: part.reshape(-1, *numbers[name].shape[1:]) for name, part in parts}
    return {name: _with_gaps(values, around) for name, values in interpolated.items()}


def _is_number(column: pa.Array) -> bool:
    if pa.types.is_list(column.type):
        return column.type.value_type in _NUMBERS and bool(column_types.lengths_of(column))
    return column.type in _NUMBERS


def _with_gaps(values: Float64, around: Neighbours) -> pa.Array:
    """Return interpolated values, null where a picture has no value."""
    column = column_types.column_of(np.ascontiguousarray(values))
    numbers = np.arange(len(values))
    return column.take(pa.array(numbers, mask=around.missing))


def _columns(samples: dict[str, pa.Array], stream: source_touches.Stream) -> dict[str, pa.Array]:
    """Return the columns of a stream without its times; InputError for objects, bytes and uneven lists."""
    samples.pop(stream.time_column, None)
    for name, column in samples.items():
        lengths = column_types.lengths_of(column)
        if column.type == column_types.UNTYPED or len(lengths) > 1:
            what = f"lists of {', '.join(map(str, lengths[:8]))} values" if lengths else "values of no type"
            raise errors.InputError(
                f"{stream.address!r}: the column {name!r} holds {what}; expected numbers, text, or "
                "lists of numbers, all of one length"
            )
    return samples


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """The samples around each of n times.

    Attributes
    ----------
    nearest : ndarray of int64, shape (n,)
        Number of the nearest sample, the earlier of two equally near.
    before, after : ndarray of int64, shape (n,)
        The last sample at or before a time and the first at or after it; before the first sample and after
        the last one, both are that sample. If samples have the same time, it is the first of them.
    share : ndarray of float64, shape (n,)
        Where a time lies from ``before`` (0) to ``after`` (1).
    missing : ndarray of bool, shape (n,)
        Whether the nearest sample is too far away, or both are too far apart.
    """

    nearest: Int64
    before: Int64
    after: Int64
    share: Float64
    missing: Bool

    @classmethod
    def of(cls, time_s: Float64, sample_s: Float64, max_gap_s: float) -> Neighbours:
        """Find the samples around times.

        Parameters
        ----------
        time_s : ndarray of float64, shape (n,)
            Times, seconds.
        sample_s : ndarray of float64, shape (m,), m >= 1
            Times of the samples, seconds of the same clock, not decreasing.
        max_gap_s : float
            A time has no value if its nearest sample is farther away than this, or if it lies between two
            samples that are farther apart, seconds.
        """
        after = np.searchsorted(sample_s, time_s).clip(max=len(sample_s) - 1)
        last = (np.searchsorted(sample_s, time_s, side="right") - 1).clip(min=0)
        before = np.searchsorted(sample_s, sample_s[last])
        since = np.abs(time_s - sample_s[before])
        until = np.abs(sample_s[after] - time_s)
        gap = sample_s[after] - sample_s[before]
        share = np.divide(since, gap, out=np.zeros(len(gap)), where=gap > 0)
        longest = max_gap_s + TIME_TOLERANCE_S
        missing = (np.minimum(since, until) > longest) | (gap > longest)
        return cls(np.where(since <= until, before, after), before, after, share, missing)

    def interpolated(self, values: Floating) -> Float64:
        """Return values, shape (m, ...), on a straight line between two samples, shape (n, ...)."""
        first, second = (
            values[numbers].astype(np.float64, copy=False) for numbers in (self.before, self.after)
        )
        share = self.share.reshape(-1, *[1] * (values.ndim - 1))
        with np.errstate(invalid="ignore", over="ignore"):  # the source checks its samples
            return np.where(share == 0, first, first + (second - first) * share)

    def on_circle(self, angles: Floating, turn: float) -> Float64:
        """Return angles, shape (m, ...), on the shorter way around the circle, shape (n, ...).

        ``turn`` is a full turn in their unit. Samples within one turn from 0, or from half a turn before it,
        as most devices state angles, give values within that turn; others may count turns.
        """
        first, second = (
            angles[numbers].astype(np.float64, copy=False) for numbers in (self.before, self.after)
        )
        share = self.share.reshape(-1, *[1] * (angles.ndim - 1))
        with np.errstate(invalid="ignore"):
            between = first + ((second - first + turn / 2) % turn - turn / 2) * share
            for start in (0.0, -turn / 2):
                inside = np.nan_to_num(angles, nan=start)
                if inside.min() >= start and inside.max() <= start + turn:
                    between = (between - start) % turn + start
                    break
            return np.where(share == 0, first, between)

    def turned(self, quaternions: Floating) -> Float64:
        """Return quaternions, shape (m, 4), on the shorter turn from one to the next, shape (n, 4).

        The angular velocity is constant (slerp); the real part may come first or last. Lengths other than one
        are interpolated, so that a check of lengths still fails.
        """
        lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
        lengths[lengths == 0] = np.nan  # no rotation
        turns = Rotation.from_quat(np.where(np.isfinite(lengths), quaternions, _NO_TURN))
        rotvecs = (turns[self.before].inv() * turns[self.after]).as_rotvec() * self.share[:, np.newaxis]
        between: Float64 = (turns[self.before] * Rotation.from_rotvec(rotvecs)).as_quat()
        return between * self.interpolated(lengths)
