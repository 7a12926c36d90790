"""Streams of other rates, such as poses and forces, aligned to the times of the pictures of a recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from realtouch.alignment_options import Alignment
from realtouch.exchange.recordings import Recording
from realtouch.exchange.stream_columns import aligned_values, values_of
from realtouch.exchange.stream_tables import Stream
from realtouch.touch_options import ImportColumns
from tactile_toolkit.alignment import Neighbours
from tactile_toolkit.array_types import AnyArray, Float64
from tactile_toolkit.errors import InputError

_PER_MS = 1e-3


@dataclass(frozen=True, slots=True)
class StreamReport:
    """How a stream fits to a recording, as a row of a table; None where a row of the stream is a picture.

    Attributes
    ----------
    recording, stream : str
        Their names.
    time_column : str
        Column of the times of the stream; empty if a row is a picture.
    columns : tuple of str
        Names that the columns have in the recording.
    samples, duplicates : int
        Number of rows, and of those with the time of the row before, which were left out.
    missing : int
        Number of pictures without a value.
    rate_hz : float or None
        Median rate of the samples.
    first_offset_s, last_offset_s : float or None
        How much later the first sample is than the first picture, and the last than the last, seconds.
    largest_gap_s : float or None
        Longest time between two samples, seconds.
    """

    recording: str
    stream: str
    time_column: str
    columns: tuple[str, ...]
    samples: int
    duplicates: int
    missing: int = 0
    rate_hz: float | None = None
    first_offset_s: float | None = None
    last_offset_s: float | None = None
    largest_gap_s: float | None = None

    def row(self) -> tuple[str, ...]:
        """Return the texts of a row below :data:`STREAM_HEADER`."""
        numbers = (self.rate_hz, self.first_offset_s, self.last_offset_s, self.largest_gap_s)
        texts = ("" if number is None else f"{number:.4g}" for number in numbers)
        counts = (f"{count:,}" for count in (self.samples, self.duplicates, self.missing))
        return (self.recording, self.stream, *counts, *texts, ", ".join(self.columns))


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
    reports = []
    for stream in streams:
        if recording.time_s is None or stream.time_s is None:
            recording, found, report = _by_row(recording, stream, how)
        else:
            found, report = _by_time(recording, stream, recording.time_s, stream.time_s, how, columns)
        added = dict(recording.per_frame)
        for name, values in found.items():
            while name in added or name in recording.values:
                name = f"{stream.name}.{name}"
            added[name] = values
        columns_added = tuple(name for name in added if name not in recording.per_frame)
        recording = replace(recording, per_frame=added)
        reports.append(replace(report, columns=columns_added))
    return recording, reports


def _report(recording: Recording, stream: Stream) -> StreamReport:
    samples = stream.rows - stream.duplicates
    return StreamReport(recording.name, stream.name, stream.time_column, (), samples, stream.duplicates)


def _by_row(
    recording: Recording, stream: Stream, how: Alignment
) -> tuple[Recording, dict[str, AnyArray], StreamReport]:
    """Take a row for each picture; the recording has the times of the stream, if it had none."""
    if stream.rows != recording.frames:
        which = "the table" if stream.time_s is None else "the recording"
        raise InputError(
            f"{stream.place!r} has {stream.rows:,} rows, the recording {recording.name!r} "
            f"{recording.frames:,} pictures; expected as many, as {which} has no times",
            next="name the column of times (`--map time=COLUMN`), or give a row for each picture",
        )
    table = stream.table.rows(np.arange(stream.rows))
    if stream.time_s is not None:
        table = table.drop_columns([stream.time_column])
        recording = replace(recording, time_s=stream.times_of_rows() + how.time_offset_s)
    found = {name: values_of(table.column(name), stream.where(name)).plain() for name in table.schema.names}
    return recording, found, _report(recording, stream)


def _by_time(
    recording: Recording,
    stream: Stream,
    time_s: Float64,
    stream_s: Float64,
    how: Alignment,
    columns: ImportColumns,
) -> tuple[dict[str, AnyArray], StreamReport]:
    """Align a stream to the times of the pictures, both in seconds."""
    sample_s, is_linear = stream_s + how.time_offset_s, how.method == "linear"
    if sample_s[0] > time_s[-1] or time_s[0] > sample_s[-1]:
        raise InputError(
            f"{stream.place!r} lasts from {sample_s[0]:.3f} to {sample_s[-1]:.3f} s, the recording "
            f"{recording.name!r} from {time_s[0]:.3f} to {time_s[-1]:.3f} s; expected a common time",
            next="add --time-offset-s with the seconds to add to the times of the stream",
        )
    steps = np.diff(sample_s) if len(sample_s) > 1 else np.zeros(1)
    around = Neighbours.of(time_s, sample_s, how.max_gap_ms * _PER_MS)
    if around.missing.all():
        raise InputError(
            f"{stream.place!r}: no picture of {recording.name!r} gets a value; there are {len(sample_s):,} "
            f"samples, about {np.median(steps):g} s apart, and the longest gap is {how.max_gap_ms:g} ms",
            next=f"check the unit of {stream.time_column!r} (`--time-unit`), or add a larger --max-gap-ms",
        )
    samples = around.samples(is_linear)
    around, table = around.among(samples), stream.read(samples)
    values = {name: values_of(table.column(name), stream.where(name)) for name in table.schema.names}
    pose = columns.found_in({*values, *recording.per_frame, *recording.values}).pose or ()
    report = replace(
        _report(recording, stream),
        missing=int(around.missing.sum()),
        rate_hz=float(1 / np.median(steps)) if steps.any() else None,
        first_offset_s=float(sample_s[0] - time_s[0]),
        last_offset_s=float(sample_s[-1] - time_s[-1]),
        largest_gap_s=float(steps.max()),
    )
    return aligned_values(values, around, is_linear, pose), report
