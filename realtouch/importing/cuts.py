"""Recordings of a source cut into touches, in one of the ways of ``--cut``, with pictures of the cuts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import PurePosixPath

import numpy as np

from realtouch.contact_picture import ContactRule
from realtouch.importing import contact_cuts, fields, found_touches, import_columns, recordings, source_files
from tactile_toolkit import column_types, errors, units, wording

RECORDING_COLUMNS = ("recording", "file")
_FRAME = "start_frame"


MAX_PICTURES = 64
"""Pictures of cuts that are drawn; of more recordings, those of the first ones."""


class CutTable:
    """A table of touches: a line for each, which is used once.

    Raises
    ------
    InputError
        There is no table at ``path``, or it does not say when touches start and end.
    """

    def __init__(self, path: str, columns: import_columns.ImportColumns) -> None:
        home, name = source_files.source_of(path)
        if not home.exists(name):
            raise errors.InputError(
                f"no cut {path!r}{wording.did_you_mean(path, recordings.CUTS)}; expected "
                f"{', '.join(recordings.CUTS)} or a path of a table"
            )
        self._place = home.address(name)
        self._lines = source_files.read_table(home, name, columns, RECORDING_COLUMNS)
        names, time_unit = self._lines.names, columns.time_unit
        known = [_FRAME, *(f"start_{unit}" for unit in units.PER_SECOND), *(["start"] if time_unit else [])]
        starts = [each for each in known if each in names]
        if len(starts) != 1:
            found = " and ".join(starts) or ", ".join(map(str, names)) or "none"
            raise errors.InputError(
                f"{self._place!r} should say once when touches start and end; found columns {found}",
                next="name the columns start_s and end_s (or _ms, _us, _ns), or start_frame and end_frame",
            )
        (self._start,) = starts
        self._end = self._start.replace("start", "end")
        self._recording = next((each for each in RECORDING_COLUMNS if each in names), None)
        self._columns = list(filter(None, (self._start, self._end, self._recording)))
        source_files.require_columns(names, self._columns, self._place)
        self._unit = import_columns.ImportColumns(
            time=self._start, time_unit=time_unit if self._start == "start" else None
        )
        self._used: dict[int, str] = {}
        self._meant = [""] * self._lines.rows
        if self._recording is not None:
            self._meant = list(map(source_files.path_of, self._lines.texts(self._recording)))
        self._named: dict[str, list[int]] = {}
        for number, meant in enumerate(self._meant):
            self._named.setdefault(meant, []).append(number)

    def touches_of(self, recording: recordings.Recording) -> found_touches.FoundTouches:
        """Return the touches of a recording in the order of the table.

        What cannot be cut is that touch's problem. InputError: the table does not say which of several
        recordings is meant, or means both.
        """
        clips = []
        for count, number in enumerate(self._lines_of(recording)):
            other = self._used.setdefault(number, recording.name)
            if other != recording.name:
                raise errors.InputError(
                    f"{self._place!r}: row {number + 1:,} could mean {other!r} or {recording.name!r}",
                    next=f"write whole paths below the source, in a column {RECORDING_COLUMNS[0]!r}",
                )
            name = f"{recording.name}_{count:03d}"
            try:
                start, stop = self._interval(recording, number)
            except errors.ItemError as error:
                clips.append(recording.unusable(error, name))
                continue
            values = self._lines.values(number)
            said = {key: value for key, value in values.items() if key not in self._columns}
            clips.append(recordings.Clip(start, stop, name, said=said))
        if not clips:
            clips = [recording.unusable(errors.ItemError("cut", f"no line of {self._place!r} names it"))]
        return recording.clips(clips)

    def unused(self) -> found_touches.FoundTouches:
        """Return the lines of recordings that were not found, each with this problem."""
        rows = [number for number in range(self._lines.rows) if number not in self._used]
        problems = {}
        for place, number in enumerate(rows):
            meant = fields.shown(self._meant[number]) or "no recording"
            problems[place] = errors.ItemError(
                "recording", f"names {meant!r}; expected a recording of the source"
            )
        names = [f"row {number + 1} of the cuts" for number in rows]
        return found_touches.FoundTouches.of(names, self._place, "", {}, problems=problems)

    def _lines_of(self, recording: recordings.Recording) -> Sequence[int]:
        """Return the numbers of the lines of a recording; all, if no column names recordings."""
        if self._recording is None:
            return range(self._lines.rows)
        path = PurePosixPath(recording.path)
        whole = recording.path.removesuffix(path.suffix)
        names = {recording.name, recording.path, path.name, whole, path.stem} - {""}
        return sorted(number for name in names for number in self._named.get(name, ()))

    def _interval(self, recording: recordings.Recording, number: int) -> tuple[int, int]:
        """Return the first picture of a touch, and the one after its last, or raise ItemError."""
        problem = recording.problem or self._lines.problems.get(number)
        if problem is not None:
            raise problem
        times = recording.time_s
        if self._start == _FRAME:
            times = np.arange(recording.frames, dtype=np.float64)
        if times is None:
            raise errors.ItemError(
                "times", "the recording has no times", next="state start_frame and end_frame"
            )
        ends = [self._lines.columns[name].slice(number, 1) for name in (self._start, self._end)]
        first, last = fields.times_s(column_types.joined(ends), self._unit).tolist()
        start, stop = int(times.searchsorted(first)), int(times.searchsorted(last, side="right"))
        tolerance = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        if start >= stop or first < times[0] - tolerance or last > times[-1] + tolerance:
            raise errors.ItemError(
                "interval",
                f"{self._start} is {first:g}, {self._end} {last:g}; expected pictures of the recording, "
                f"which lasts from {times[0]:g} to {times[-1]:g}",
            )
        return start, stop


class Cutter:
    """Cuts the recordings of a source into touches.

    Parameters
    ----------
    cut : str or None
        One of :data:`CUTS`, or the path of a table of touches; None stands for what each recording states.
    contents : callable
        Reads the pictures of touches, as the format of the source has them.
    columns : ImportColumns, optional
        Its unit of time is that of the columns ``start`` and ``end`` of a table, which do not state theirs.
    default : str
        One of the first two of :data:`CUTS`, for recordings that state nothing.

    Attributes
    ----------
    pictures : dict
        Pictures of the cuts found by contact, as PNG, by the name of the recording with ``-`` for ``/``;
        complete when all touches were taken.
    done : str
        How the last recording was cut, "table" by a table; empty without one.

    Raises
    ------
    InputError
        ``cut`` is neither one of those names nor a table of touches.
    """

    def __init__(
        self,
        cut: str | None,
        contents: source_files.ReadContents,
        columns: import_columns.ImportColumns | None = None,
        default: str = "frames",
    ) -> None:
        self.pictures: dict[str, bytes] = {}
        self.done = ""
        self._cut, self._contents, self._default, self._rule = cut, contents, default, ContactRule()
        self._table = None
        if cut is not None and cut not in recordings.CUTS:
            self._table = CutTable(cut, columns or import_columns.ImportColumns())

    def cut(self, recording: recordings.Recording) -> found_touches.FoundTouches:
        """Return the touches of a recording in order; what cannot be cut is one touch, with its problem.

        Raises InputError for a table that does not say which of several recordings is meant.
        """
        recording = recording.checked()
        if self._table is not None:
            self.done = "table"  # what a set says of itself does not depend on paths
            return self._table.touches_of(recording)
        self.done = self._cut or recording.cut or self._default
        if recording.problem is None and self.done == "contact":
            return recording.clips(list(self._by_contact(recording)))
        return recordings.touches_of(recording, self.done)

    def unused(self) -> list[found_touches.FoundTouches]:
        """Return what a table says of recordings that were not found, each with this problem."""
        return [] if self._table is None else [self._table.unused()]

    def _by_contact(self, recording: recordings.Recording) -> Iterator[recordings.Clip]:
        try:
            found = contact_cuts.find_contacts(recording, self._contents, self._rule)
        except errors.ItemError as error:
            yield recording.unusable(error)
            return
        if len(self.pictures) < MAX_PICTURES:
            name = recording.name.replace("/", "-")
            self.pictures[name] = contact_cuts.draw_cuts(recording, found, self._contents, self._rule)
        for number, run in enumerate(found.runs):
            name = f"{recording.name}_{number:03d}"
            yield recordings.Clip(run.start, run.stop, name, (run.first - run.start, run.last - run.start))
