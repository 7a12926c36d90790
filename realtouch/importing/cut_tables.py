"""Touches of recordings as a table states them: from when to when, and what else is said of each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePosixPath

import numpy as np

from realtouch.import_columns import ImportColumns
from realtouch.importing.fields import shown, times_s
from realtouch.importing.found_touches import FoundTouches
from realtouch.importing.recordings import CUTS, Clip, Recording
from realtouch.importing.source_files import path_of, read_table, require_columns, source_of
from tactile_toolkit import column_types
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.units import PER_SECOND
from tactile_toolkit.wording import did_you_mean

RECORDING_COLUMNS = ("recording", "file")
_FRAME = "start_frame"


class CutTable:
    """A table of touches: a line for each, which is used once.

    Raises
    ------
    InputError
        There is no table at ``path``, or it does not say when touches start and end.
    """

    def __init__(self, path: str, columns: ImportColumns) -> None:
        home, name = source_of(path)
        if not home.exists(name):
            raise InputError(
                f"no cut {path!r}{did_you_mean(path, CUTS)}; expected {', '.join(CUTS)} or a path of a table"
            )
        self._place = home.address(name)
        self._lines = read_table(home, name, columns, RECORDING_COLUMNS)
        names, time_unit = self._lines.names, columns.time_unit
        known = [_FRAME, *(f"start_{unit}" for unit in PER_SECOND), *(["start"] if time_unit else [])]
        starts = [each for each in known if each in names]
        if len(starts) != 1:
            found = " and ".join(starts) or ", ".join(map(str, names)) or "none"
            raise InputError(
                f"{self._place!r} should say once when touches start and end; found columns {found}",
                next="name the columns start_s and end_s (or _ms, _us, _ns), or start_frame and end_frame",
            )
        (self._start,) = starts
        self._end = self._start.replace("start", "end")
        self._recording = next((each for each in RECORDING_COLUMNS if each in names), None)
        self._columns = list(filter(None, (self._start, self._end, self._recording)))
        require_columns(names, self._columns, self._place)
        self._unit = ImportColumns(time=self._start, time_unit=time_unit if self._start == "start" else None)
        self._used: dict[int, str] = {}
        self._meant = [""] * self._lines.rows
        if self._recording is not None:
            self._meant = list(map(path_of, self._lines.texts(self._recording)))
        self._named: dict[str, list[int]] = {}
        for number, meant in enumerate(self._meant):
            self._named.setdefault(meant, []).append(number)

    def touches_of(self, recording: Recording) -> FoundTouches:
        """Return the touches of a recording in the order of the table.

        What cannot be cut is that touch's problem. InputError: the table does not say which of several
        recordings is meant, or means both.
        """
        clips = []
        for count, number in enumerate(self._lines_of(recording)):
            other = self._used.setdefault(number, recording.name)
            if other != recording.name:
                raise InputError(
                    f"{self._place!r}: row {number + 1:,} could mean {other!r} or {recording.name!r}",
                    next=f"write whole paths below the source, in a column {RECORDING_COLUMNS[0]!r}",
                )
            name = f"{recording.name}_{count:03d}"
            try:
                start, stop = self._interval(recording, number)
            except ItemError as error:
                clips.append(recording.unusable(error, name))
                continue
            values = self._lines.values(number)
            said = {key: value for key, value in values.items() if key not in self._columns}
            clips.append(Clip(start, stop, name, said=said))
        if not clips:
            clips = [recording.unusable(ItemError("cut", f"no line of {self._place!r} names it"))]
        return recording.clips(clips)

    def unused(self) -> FoundTouches:
        """Return the lines of recordings that were not found, each with this problem."""
        rows = [number for number in range(self._lines.rows) if number not in self._used]
        problems = {}
        for place, number in enumerate(rows):
            meant = shown(self._meant[number]) or "no recording"
            problems[place] = ItemError("recording", f"names {meant!r}; expected a recording of the source")
        names = [f"row {number + 1} of the cuts" for number in rows]
        return FoundTouches.of(names, self._place, "", {}, problems=problems)

    def _lines_of(self, recording: Recording) -> Sequence[int]:
        """Return the numbers of the lines of a recording; all, if no column names recordings."""
        if self._recording is None:
            return range(self._lines.rows)
        path = PurePosixPath(recording.path)
        whole = recording.path.removesuffix(path.suffix)
        names = {recording.name, recording.path, path.name, whole, path.stem} - {""}
        return sorted(number for name in names for number in self._named.get(name, ()))

    def _interval(self, recording: Recording, number: int) -> tuple[int, int]:
        """Return the first picture of a touch, and the one behind its last; ItemError if there is none."""
        problem = recording.problem or self._lines.problem(number)
        if problem is not None:
            raise problem
        times = recording.time_s
        if self._start == _FRAME:
            times = np.arange(recording.frames, dtype=np.float64)
        if times is None:
            raise ItemError("times", "the recording has no times", next="state start_frame and end_frame")
        ends = [self._lines.columns[name].slice(number, 1) for name in (self._start, self._end)]
        first, last = times_s(column_types.joined(ends), self._unit).tolist()
        start, stop = int(times.searchsorted(first)), int(times.searchsorted(last, side="right"))
        tolerance = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        if start >= stop or first < times[0] - tolerance or last > times[-1] + tolerance:
            raise ItemError(
                "interval",
                f"{self._start} is {first:g}, {self._end} {last:g}; expected pictures of the recording, "
                f"which lasts from {times[0]:g} to {times[-1]:g}",
            )
        return start, stop
