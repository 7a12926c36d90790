"""Streams of other rates, such as poses and forces, aligned to the times of the pictures of a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from realtouch.alignment_options import Alignment
from realtouch.import_columns import ImportColumns
from realtouch.importing.recordings import Recording
from realtouch.importing.stream_tables import Stream
from tactile_toolkit.alignment import Neighbours
from tactile_toolkit.array_types import AnyArray, Float64
from tactile_toolkit.errors import InputError

StreamReport = tuple[str, ...]
"""How a stream fits to a recording, a row below :data:`STREAM_HEADER`."""

_PER_MS = 1e-3
_QUATERNION = 4
_WITH_QUATERNION = (4, 7)  # numbers of a rotation, and of a pose, that end in a quaternion
_NO_CLOCK: StreamReport = ("0", "0", "", "", "", "")  # of a stream with a row for each picture


def with_streams(
    recording: Recording, streams: Sequence[Stream], how: Alignment, columns: ImportColumns
) -> tuple[Recording, list[StreamReport]]:
    """Add the columns of streams to what is said of each picture.

    Parameters
    ----------
    recording : Recording
        With the times of its pictures. Without, a stream must have a row for each picture, and its times, if
        it has any, are taken as those of the pictures.
    streams : sequence of Stream
        A column whose name is taken gets that of its stream before it: ``force.seq``.
    how : Alignment
        Method, longest gap, and offset of the clocks.
    columns : ImportColumns
        Of these, the pose is not interpolated as other numbers are: its quaternion is on the turn between two
        samples, and a pose with another rotation is that of the nearest sample.

    Raises
    ------
    InputError
        Clocks without a common time, rows that are not as many as pictures, or no picture gets a value.
    """
    reports: list[StreamReport] = []
    for stream in streams:
        if recording.time_s is None or stream.time_s is None:
            found, facts = _by_row(recording, stream), _NO_CLOCK
            if stream.time_s is not None:
                recording = replace(recording, time_s=stream.time_s + how.time_offset_s)
        else:
            sample_s = stream.time_s + how.time_offset_s
            found, facts = _by_time(recording, stream, recording.time_s, sample_s, how, columns)
        added = dict(recording.per_frame)
        for name, values in found.items():
            while name in added or name in recording.values:
                name = f"{stream.name}.{name}"
            added[name] = values
        names = ", ".join(name for name in added if name not in recording.per_frame)
        recording = replace(recording, per_frame=added)
        reports.append((recording.name, stream.name, f"{stream.rows:,}", *facts, names))
    return recording, reports


def _by_row(recording: Recording, stream: Stream) -> dict[str, AnyArray]:
    """Take a row for each picture."""
    if stream.rows != recording.frames:
        which = "the table" if stream.time_s is None else "the recording"
        raise InputError(
            f"{stream.place!r} has {stream.rows:,} rows, the recording {recording.name!r} "
            f"{recording.frames:,} pictures; expected as many, as {which} has no times",
            next="name the column of times (`--map time=COLUMN`), or give a row for each picture",
        )
    return _arrays(stream.table.rows(np.arange(stream.rows)), stream)


def _by_time(
    recording: Recording,
    stream: Stream,
    time_s: Float64,
    sample_s: Float64,
    how: Alignment,
    columns: ImportColumns,
) -> tuple[dict[str, AnyArray], StreamReport]:
    """Align a stream to the times of the pictures, both in seconds."""
    if sample_s[0] > time_s[-1] or time_s[0] > sample_s[-1]:
        raise InputError(
            f"{stream.place!r} lasts from {sample_s[0]:.3f} to {sample_s[-1]:.3f} s, the recording "
            f"{recording.name!r} from {time_s[0]:.3f} to {time_s[-1]:.3f} s; expected a common time",
            next="add --time-offset-s with the seconds to add to the times of the stream",
        )
    steps, max_gap_s = np.diff(sample_s), how.max_gap_ms * _PER_MS
    around = Neighbours.of(time_s, sample_s, max_gap_s)
    step_s = float(np.median(steps[steps > 0], overwrite_input=True)) if steps.any() else np.inf
    if around.missing.all():
        raise InputError(
            f"{stream.place!r}: no picture of {recording.name!r} gets a value; there are {stream.rows:,} "
            f"samples, about {step_s:g} s apart, and the longest gap is {how.max_gap_ms:g} ms",
            next=f"check the unit of {stream.time_column!r} (`--time-unit`), or add a larger --max-gap-ms",
        )
    used = np.unique([around.before, around.after])
    around, samples = Neighbours.of(time_s, sample_s[used], max_gap_s), stream.table.rows(used)
    found = _arrays(samples.take(pa.array(around.nearest, mask=around.missing)), stream)
    if how.method == "linear":
        pose = columns.found_in({*found, *recording.per_frame, *recording.values}).pose or ()
        found |= _between(_arrays(samples, stream), around, pose)
    clocks = (1 / step_s, sample_s[0] - time_s[0], sample_s[-1] - time_s[-1], steps.max(initial=0.0))
    counts = (f"{np.sum(steps == 0):,}", f"{around.missing.sum():,}")
    return found, (*counts, *(f"{number:.4g}" for number in clocks))


def _between(samples: Mapping[str, AnyArray], around: Neighbours, pose: Sequence[str]) -> dict[str, AnyArray]:
    """Return columns of floats on a line between samples, and a pose with its quaternion on the turn."""
    found = {
        name: around.interpolated(values)
        for name, values in samples.items()
        if values.dtype.kind == "f" and name not in pose
    }
    if pose and samples.keys() >= {*pose}:
        whole = np.column_stack([samples[name] for name in pose])
        if whole.shape[1] in _WITH_QUATERNION and whole.dtype.kind in "fiu":
            numbers = around.interpolated(whole)
            numbers[:, -_QUATERNION:] = around.turned(whole[:, -_QUATERNION:].astype(np.float64))
            found |= zip(pose, [numbers] if len(pose) == 1 else numbers.T, strict=True)
    for values in found.values():
        values[around.missing] = np.nan
    return found


def _arrays(table: pa.Table, stream: Stream) -> dict[str, AnyArray]:
    """Return the columns of a stream as numpy has them, without its times; see :func:`_array`."""
    names = [name for name in table.column_names if name != stream.time_column]
    return {name: _array(table.column(name), f"{stream.place!r}: the column {name!r}") for name in names}


def _array(column: pa.ChunkedArray, what: str) -> AnyArray:
    """Return a column as an array; InputError, which begins with ``what``, for bytes and objects.

    Numbers and switches keep their type; times and days become text; lists of one length become vectors. A
    missing value is NaN, or None if it is not a float.
    """
    kind = column.type
    if pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind):
        return _vectors(column, what)
    if pa.types.is_nested(kind) or pa.types.is_binary(kind) or pa.types.is_large_binary(kind):
        raise InputError(
            f"{what} holds values of the type {kind}; expected numbers, text or lists of numbers"
        )
    if pa.types.is_decimal(kind) or pa.types.is_null(kind):
        column = column.cast(pa.float64())
    elif pa.types.is_temporal(kind):
        column = column.cast(pa.string())
    if column.null_count and not pa.types.is_floating(column.type):
        return np.array(column.to_pylist(), object)
    found: AnyArray = column.to_numpy()
    return found


def _vectors(column: pa.ChunkedArray, what: str) -> AnyArray:
    """Return lists of numbers as an array, (m, k)."""
    present = column.drop_null()
    lengths = pc.list_value_length(present).unique().sort().to_pylist()
    inside: AnyArray = pc.list_flatten(present).to_numpy()
    if len(lengths) != 1 or inside.dtype.kind not in "iufb":
        found = f"lists of {', '.join(map(str, lengths[:8]))} values of the type {column.type.value_type}"
        raise InputError(f"{what} holds {found}; expected lists of one number of numbers")
    rows = inside.reshape(-1, *lengths)
    if not column.null_count:
        return rows
    vectors: AnyArray = np.full(
        (len(column), *lengths), None, rows.dtype if rows.dtype.kind == "f" else object
    )
    vectors[column.is_valid().to_numpy()] = rows
    return vectors
