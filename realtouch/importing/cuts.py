"""Recordings of a source cut into touches, in one of the ways of ``--cut``, with pictures of the cuts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from realtouch.contact_picture import ContactRule
from realtouch.importing.contact_cuts import find_contacts
from realtouch.importing.cut_pictures import draw_cuts
from realtouch.importing.cut_tables import CutTable
from realtouch.importing.found_touches import FoundTouch, ReadContents
from realtouch.importing.recordings import CUTS, Recording, touches_of
from tactile_toolkit.errors import ItemError

MOST_PICTURES = 64
"""Pictures of cuts that are drawn; of more recordings, those of the first ones."""


class Cutter:
    """Cuts the recordings of a source into touches.

    Parameters
    ----------
    cut : str
        One of :data:`CUTS`, or the path of a table of touches.
    contents : callable
        Reads the pictures of touches, as the format of the source has them.
    time_unit : "s", "ms", "us" or "ns", optional
        Unit of the columns ``start`` and ``end`` of a table, which do not state theirs.

    Attributes
    ----------
    pictures : dict
        Pictures of the cuts found by contact, as PNG, by the name of the recording with ``-`` for ``/``;
        complete when all touches were taken.
    too_short : int
        Number of contacts that were too short to be a touch.

    Raises
    ------
    InputError
        ``cut`` is neither one of those names nor a table of touches.
    """

    def __init__(self, cut: str, contents: ReadContents, time_unit: str | None = None) -> None:
        self.pictures: dict[str, bytes] = {}
        self.too_short = 0
        self._cut, self._contents, self._rule = cut, contents, ContactRule()
        self._table = None
        if cut not in CUTS:
            self._table = CutTable(cut, time_unit)

    def touches(self, found: Iterable[FoundTouch | Recording]) -> Iterator[FoundTouch]:
        """Yield the touches of a source in order; those that are no part of a recording as they are.

        What cannot be cut is yielded once, with its problem. Raises InputError for a table that does not say
        which of several recordings is meant.
        """
        for each in found:
            if isinstance(each, FoundTouch):
                yield each
            else:
                yield from self._touches_of(each.checked())
        if self._table is not None:
            yield from self._table.unused()

    def _touches_of(self, recording: Recording) -> Iterator[FoundTouch]:
        if self._table is not None:
            yield from self._table.touches_of(recording)
        elif recording.problem is None and self._cut == "contact":
            yield from self._by_contact(recording)
        else:
            yield from touches_of(recording, self._cut)

    def _by_contact(self, recording: Recording) -> Iterator[FoundTouch]:
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
            yield recording.bounded(run.start, run.stop, name, (run.first - run.start, run.last - run.start))
