"""The streams of all recordings of a source: those that the user named, and tables beside their files."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cache
from pathlib import PurePosixPath

from realtouch.alignment_options import Alignment
from realtouch.import_columns import ImportColumns
from realtouch.importing.fields import times_s
from realtouch.importing.found_touches import source_of
from realtouch.importing.recordings import Recording
from realtouch.importing.stream_tables import Stream, open_stream, tables_by_stem
from realtouch.importing.streams import StreamReport, with_streams
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, ItemError

_NO_STREAM = "; if the table is no stream of this recording, give it another name"


class Aligner:
    """Aligns streams with recordings.

    Parameters
    ----------
    named : sequence of str
        Paths of tables that are streams of every recording.
    how : Alignment or None
        None stands for the defaults.
    columns : ImportColumns
        Its column of times is that of the recordings and streams that have it.
    no_streams : collection of str
        Paths of tables that are used in another way, though they may lie beside a recording.

    Attributes
    ----------
    reports : list of StreamReport
        How the streams fit, in the order of recordings; complete when all were aligned.

    Raises
    ------
    InputError
        A table that was named cannot be read.
    """

    def __init__(
        self,
        named: Sequence[str],
        how: Alignment | None,
        columns: ImportColumns,
        no_streams: Collection[str] = (),
    ) -> None:
        self.reports: list[StreamReport] = []
        self._how, self._columns = how or Alignment(), columns
        self._named = [open_stream(*source_of(path), columns) for path in named]
        self._no_streams = {_address(path) for path in (*named, *no_streams)}
        self._beside = cache(_tables_in)

    def aligned(self, recording: Recording) -> Recording:
        """Return a recording with the columns of its streams, and with the times that a column states.

        Tables beside it that do not fit are its problem. InputError: a stream that was named does not fit.
        """
        if recording.problem is not None:
            return recording
        try:
            recording = self._timed(recording)
            beside = self._streams_beside(recording)
            found, reports = with_streams(recording, beside, self._how, self._columns)
        except ItemError as error:
            return replace(recording, problem=error)
        except InputError as error:
            return replace(recording, problem=ItemError("stream", f"{error.message}{_NO_STREAM}"))
        found, of_named = with_streams(found, self._named, self._how, self._columns)
        self.reports += [*reports, *of_named]
        return found

    def _timed(self, recording: Recording) -> Recording:
        time = self._columns.time
        if not time or time not in recording.per_frame:
            return recording
        return replace(recording, time_s=times_s(recording.per_frame[time], self._columns))

    def _streams_beside(self, recording: Recording) -> list[Stream]:
        path = PurePosixPath(recording.path)
        folder = "" if str(path.parent) == "." else str(path.parent)
        home = store.open_folder(recording.home)
        tables = self._beside(recording.home, folder).get(path.stem, ())
        names = (f"{folder}/{name}".lstrip("/") for name in tables)
        return [
            open_stream(home, name, self._columns, path.stem)
            for name in names
            if name != recording.path and _address(home.address(name)) not in self._no_streams
        ]


def _address(path: str) -> str:
    home, name = source_of(path)
    return home.address(name)


def _tables_in(home: str, folder: str) -> dict[str, list[str]]:
    return tables_by_stem(store.open_folder(home).entries(folder))
