"""Recordings of a source cut into touches, in one of the ways of ``--cut``, with pictures of the cuts."""

from __future__ import annotations

from collections.abc import Iterator

from realtouch.contact_picture import ContactRule
from realtouch.import_columns import ImportColumns
from realtouch.importing.contact_cuts import find_contacts
from realtouch.importing.cut_pictures import draw_cuts
from realtouch.importing.cut_tables import CutTable
from realtouch.importing.found_touches import FoundTouches
from realtouch.importing.recordings import CUTS, Clip, Recording, touches_of
from realtouch.importing.source_files import ReadContents
from tactile_toolkit.errors import ItemError

MOST_PICTURES = 64
"""Pictures of cuts that are drawn; of more recordings, those of the first ones."""


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
    too_short : int
        Number of contacts that were too short to be a touch.
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
        contents: ReadContents,
        columns: ImportColumns | None = None,
        default: str = "frames",
    ) -> None:
        self.pictures: dict[str, bytes] = {}
        self.too_short, self.done = 0, ""
        self._cut, self._contents, self._default, self._rule = cut, contents, default, ContactRule()
        self._table = None
        if cut is not None and cut not in CUTS:
            self._table = CutTable(cut, columns or ImportColumns())

    def cut(self, recording: Recording) -> FoundTouches:
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
        return touches_of(recording, self.done)

    def unused(self) -> list[FoundTouches]:
        """Return what a table says of recordings that were not found, each with this problem."""
        return [] if self._table is None else [self._table.unused()]

    def _by_contact(self, recording: Recording) -> Iterator[Clip]:
        try:
            found = find_contacts(recording, self._contents, self._rule)
        except ItemError as error:
            yield recording.unusable(error)
            return
        self.too_short += found.too_short
        if len(self.pictures) < MOST_PICTURES:
            name = recording.name.replace("/", "-")
            self.pictures[name] = draw_cuts(recording, found, self._contents, self._rule)
        for number, run in enumerate(found.runs):
            name = f"{recording.name}_{number:03d}"
            yield Clip(run.start, run.stop, name, (run.first - run.start, run.last - run.start))
