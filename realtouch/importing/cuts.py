"""Cut the recordings of a source into touches as ``--cut`` says, and draw the cuts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import PurePosixPath

import numpy as np

from realtouch.contact import ContactRule
from realtouch.importing import contact_cuts, fields, import_columns, source_files, source_touches
from tactile_toolkit import errors, wording
from tactile_toolkit.columns import column_types, units

RECORDING_COLUMNS = ("recording", "file")
_FRAME = "start_frame"


MAX_PICTURES = 64
"""Maximum number of recordings whose cuts are drawn; the first ones are."""


class CutTable:
    """A table with a row for each touch; a row belongs to one recording.

    Raises
    ------
    InputError
        There is no table at ``path``, or it does not say when touches start and end.
    """

    def __init__(self, path: str, columns: import_columns.ImportColumns) -> None:
        home, name = source_files.source_of(path)
        if not home.exists(name):
            raise errors.InputError(
                f"no cut {path!r}{wording.did_you_mean(path, source_touches.CUTS)}; expected "
                f"{', '.join(source_touches.CUTS)} or the path of a table"
            )
        self._place = home.address(name)
        self._table = source_files.read_table(home, name, columns, RECORDING_COLUMNS)
        names = [*self._table.columns]
        known = [_FRAME, *(f"start_{unit}" for unit in units.PER_SECOND)]
        if columns.time_unit:
            known.append("start")
        starts = [each for each in known if each in names]
        if len(starts) != 1:
            found = " and ".join(starts) or ", ".join(map(str, names)) or "none"
            raise errors.InputError(
                f"{self._place!r} needs one column for the start of touches and one for the end; "
                f"found columns {found}",
                next="name the columns start_s and end_s (or _ms, _us, _ns), or start_frame and end_frame",
            )
        (self._start_column,) = starts
        self._end_column = self._start_column.replace("start", "end")
        self._recording_column = next((each for each in RECORDING_COLUMNS if each in names), None)
        self._own_columns = list(filter(None, (self._start_column, self._end_column, self._recording_column)))
        source_files.require_columns(names, self._own_columns, self._place)
        # Another name than "start" states the unit.
        self._time_unit = columns.time_unit if self._start_column == "start" else None
        self._recording_of_row: dict[int, str] = {}
        self._stated_recordings = [""] * self._table.rows
        if self._recording_column is not None:
            self._stated_recordings = [
                source_files.path_of(text) for text in self._table.texts(self._recording_column)
            ]
        self._rows_that_state: dict[str, list[int]] = {}
        for row, stated in enumerate(self._stated_recordings):
            self._rows_that_state.setdefault(stated, []).append(row)

    def touches_of(self, recording: source_touches.Recording) -> source_touches.FoundTouches:
        """Return the touches of a recording in the order of the table.

        A touch that cannot be cut has a problem. Raises InputError if a row fits several recordings.
        """
        clips = []
        for count, row in enumerate(self._rows_of(recording)):
            other = self._recording_of_row.setdefault(row, recording.name)
            if other != recording.name:
                raise errors.InputError(
                    f"{self._place!r}: row {row + 1:,} could mean {other!r} or {recording.name!r}",
                    next=f"write whole paths below the source, in a column {RECORDING_COLUMNS[0]!r}",
                )
            name = f"{recording.name}_{count:03d}"
            try:
                start, stop = self._interval(recording, row)
            except errors.ItemError as error:
                clips.append(recording.unusable(error, name))
                continue
            values = self._table.values(row)
            said = {key: value for key, value in values.items() if key not in self._own_columns}
            clips.append(source_touches.Clip(start, stop, name, said=said))
        if not clips:
            problem = errors.ItemError("cut", f"no row of {self._place!r} names this recording")
            clips = [recording.unusable(problem)]
        return recording.clips(clips)

    def unused(self) -> source_touches.FoundTouches:
        """Return the rows whose recording was not found, each with this problem."""
        rows = [row for row in range(self._table.rows) if row not in self._recording_of_row]
        problems = {}
        for index, row in enumerate(rows):
            stated = fields.shown(self._stated_recordings[row])
            problems[index] = errors.ItemError(
                "recording", f"names {stated!r}; expected a recording of the source"
            )
        names = [f"row {row + 1} of the cuts" for row in rows]
        return source_touches.FoundTouches.of(names, self._place, "", {}, problems=problems)

    def _rows_of(self, recording: source_touches.Recording) -> Sequence[int]:
        """Return the rows of a recording; all rows if no column names recordings."""
        if self._recording_column is None:
            return range(self._table.rows)
        path = PurePosixPath(recording.path)
        without_ending = recording.path.removesuffix(path.suffix)
        names = {recording.name, recording.path, path.name, without_ending, path.stem} - {""}
        return sorted(row for name in names for row in self._rows_that_state.get(name, ()))

    def _interval(self, recording: source_touches.Recording, row: int) -> tuple[int, int]:
        """Return the number of the first picture of a touch and of the one after its last.

        Raises ItemError if the row or the recording cannot be used.
        """
        problem = recording.problem
        if problem is not None:
            raise problem
        times = recording.time_s
        if self._start_column == _FRAME:
            times = np.arange(recording.frames, dtype=np.float64)
        if times is None:
            raise errors.ItemError(
                "times", "the recording has no times", next="state start_frame and end_frame"
            )
        ends = [self._table.columns[name].slice(row, 1) for name in (self._start_column, self._end_column)]
        first, last = fields.times_s(column_types.joined(ends), self._start_column, self._time_unit).tolist()
        start = int(times.searchsorted(first))
        stop = int(times.searchsorted(last, side="right"))
        tolerance = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
        if start >= stop or first < times[0] - tolerance or last > times[-1] + tolerance:
            raise errors.ItemError(
                "interval",
                f"{self._start_column} is {first:g}, {self._end_column} {last:g}; expected pictures of the "
                f"recording, which lasts from {times[0]:g} to {times[-1]:g}",
            )
        return start, stop


class Cutter:
    """Cuts the recordings of a source into touches.

    Parameters
    ----------
    cut : str or None
        One of :data:`CUTS`, or the path of a table of touches; None cuts each recording as it states itself.
    contents : callable
        Reads the pictures of touches in the format of the source.
    columns : ImportColumns, optional
        Its unit of time applies to the columns ``start`` and ``end`` of a table, whose names state none.
    default : str
        One of the first two of :data:`CUTS`, for recordings that state no cut.

    Attributes
    ----------
    pictures : dict
        Drawings of the cuts found by contact, as PNG, by the name of the recording with ``-`` for ``/``;
        complete after the last recording.
    done : str
        How the last recording was cut: one of :data:`CUTS`, or "table"; empty before the first recording.

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
        if cut is not None and cut not in source_touches.CUTS:
            self._table = CutTable(cut, columns or import_columns.ImportColumns())

    def cut(self, recording: source_touches.Recording) -> source_touches.FoundTouches:
        """Return the touches of a recording in order; a recording that cannot be cut is one touch.

        That touch has the problem. Raises InputError if a row of a table fits several recordings.
        """
        recording = recording.checked()
        if self._table is not None:
            self.done = "table"  # not its path: paths are not recorded in a data set
            return self._table.touches_of(recording)
        self.done = self._cut or recording.cut or self._default
        if recording.problem is None and self.done == "contact":
            return recording.clips(list(self._by_contact(recording)))
        return source_touches.touches_of(recording, self.done)

    def unused(self) -> list[source_touches.FoundTouches]:
        """Return the rows of a table whose recordings were not found, each with this problem."""
        return [] if self._table is None else [self._table.unused()]

    def _by_contact(self, recording: source_touches.Recording) -> Iterator[source_touches.Clip]:
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
            yield source_touches.Clip(
                run.start, run.stop, name, (run.first - run.start, run.last - run.start)
            )
