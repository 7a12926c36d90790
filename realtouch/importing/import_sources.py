"""Sources of an import: recognised, read, and cut into touches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from realtouch.alignment_options import Alignment
from realtouch.import_columns import ImportColumns
from realtouch.importing.aligner import Aligner
from realtouch.importing.cuts import Cutter
from realtouch.importing.found_touches import IMPORTS, FoundTouch, require_columns
from realtouch.importing.import_shards import version_of
from realtouch.importing.imported_clips import said_of_whole
from realtouch.importing.recognised import Recognised, recognised
from realtouch.importing.recordings import CUTS, Recording, touches_of
from realtouch.importing.streams import StreamReport
from realtouch.touch_options import require_layout
from tactile_toolkit import store
from tactile_toolkit.errors import InputError

_SPLIT_FOLDERS = ("fota", "sparsh")  # formats of which a folder holds one split, and is named so


@dataclass(frozen=True, slots=True)
class Reading:
    """How a source is read; see :func:`realtouch.import_touches`."""

    layout: str | None = None
    columns: ImportColumns | None = None
    table: str | None = None
    streams: tuple[str, ...] = ()
    alignment: Alignment | None = None
    cut: str | None = None


@dataclass(frozen=True, slots=True)
class FoundSource:
    """The touches of a source.

    ``recognised_by`` is the file by which the format was recognised; empty if it was given. ``cut`` is how
    recordings were cut; empty if the source holds none. ``pictures`` show the cuts: PNG by name. ``streams``
    say how streams of other rates fit to the recordings. ``left_out`` names what recordings have besides what
    was read. ``versions`` are those of files that hold several
    pictures, by folder and path, when they were found.
    """

    home: store.DataFolder
    layout: str
    recognised_by: str
    items: Sequence[FoundTouch]
    columns: ImportColumns
    cut: str = ""
    pictures: Mapping[str, bytes] = field(default_factory=dict)
    streams: Sequence[StreamReport] = ()
    left_out: Sequence[str] = ()
    versions: Mapping[tuple[str, str], tuple[object, ...] | None] = field(default_factory=dict)


def find_source(place: str, reading: Reading) -> FoundSource:
    """Recognise a source and find its touches; InputError if it cannot be used."""
    home, columns = store.open_folder(place), reading.columns or ImportColumns()
    format_ = Recognised(reading.layout or "", "")
    if reading.layout is not None:
        require_layout(reading.layout, IMPORTS)
    if not home.exists():
        found = f"{home.address()!r} does not exist"
        raise InputError(f"{found}; expected a folder or file of recordings", next="check the name")
    if reading.layout is None:
        format_ = recognised(place)
    layout = format_.layout
    every, cuts = _found(home, layout, columns, reading.table), _Cuts(reading, layout)
    items = [item.checked(number) for number, item in enumerate(cuts.touches(every))]
    if not items:
        raise InputError(f"{home.address()!r} holds nothing to import; expected pictures")
    cuts.require_recordings(home)
    # The time may be that of a stream, of which only what was aligned is left.
    missing = set(replace(columns, time=None).names())
    for item in items:
        if not missing:
            break
        missing.difference_update(item.values, item.per_frame)
    if missing and any(item.problem is None for item in items):
        names = dict.fromkeys(name for item in items for name in (*item.values, *item.per_frame) if name)
        require_columns(list(names), sorted(missing), home.address())
    completed = columns.found_in(_known(items), rotvec=IMPORTS[layout].rotvec)
    items = [said_of_whole(item, completed) for item in items]
    of_cuts = (cuts.done, cuts.pictures, cuts.aligner.reports, tuple(cuts.left_out), cuts.versions)
    return FoundSource(home, layout, format_.by, items, completed, *of_cuts)


def _found(
    home: store.DataFolder, layout: str, columns: ImportColumns, table: str | None
) -> Iterator[FoundTouch | Recording]:
    """Find what a folder holds, or the splits of an export of this toolkit."""
    folders = [home]
    if layout in home.entries():
        folders = [store.open_folder(home.address(layout))]
    found = {name: size for name, size in folders[0].entries().items() if not store.is_hidden(name)}
    splits = [name for name, size in found.items() if size is None]
    if layout in _SPLIT_FOLDERS and len(splits) == len(found) > 0:
        folders = [store.open_folder(folders[0].address(split)) for split in splits]
    for folder in folders:
        yield from IMPORTS[layout].find(folder, columns, table)


def _known(items: Iterable[FoundTouch]) -> set[str]:
    """Return the names of what is said of any touch."""
    known: set[str] = set()
    for item in items:
        for name in item.values.keys() - known:  # few, as most touches have the same
            if name and item.values[name] not in (None, ""):
                known.add(name)
        known.update(item.per_frame)
    return known


class _Cuts:
    """Cuts recordings as the user says, or each as its source or format states.

    ``done`` is how that was done; empty for a source without recordings. ``pictures`` show it: PNG by name.
    ``left_out`` are the keys of what recordings have besides what was read.
    ``versions`` are noted before any picture is looked at, as a file may be replaced later.
    """

    def __init__(self, reading: Reading, layout: str) -> None:
        self.done = ""
        self.pictures: Mapping[str, bytes] = {}
        self.left_out: dict[str, None] = {}
        self.versions: dict[tuple[str, str], tuple[object, ...] | None] = {}
        self._last: tuple[str, str] | None = None
        self._wanted, self._format = reading.cut, IMPORTS[layout]
        self._columns = reading.columns or ImportColumns()
        others = [path for path in (reading.table, reading.cut) if path is not None and path not in CUTS]
        self.aligner = Aligner(reading.streams, reading.alignment, self._columns, others)

    def touches(self, found: Iterable[FoundTouch | Recording]) -> Iterator[FoundTouch]:
        """Yield the touches of a source."""
        if self._wanted is not None:
            cutter = Cutter(self._wanted, self._format.contents, self._columns.time_unit)
            self.pictures = cutter.pictures
            yield from cutter.touches(map(self._noted, found))
            return
        for each in map(self._noted, found):
            if isinstance(each, Recording):
                yield from touches_of(each.checked(), each.cut or self._format.cut)
            else:
                yield each

    def _noted(self, found: FoundTouch | Recording) -> FoundTouch | Recording:
        """Return what was found, a recording with its streams."""
        file, is_recording = (found.home, found.path), isinstance(found, Recording)
        if found.problem is None and (is_recording or file == self._last) and file not in self.versions:
            self.versions[file] = version_of(file)
        self._last = file
        if not isinstance(found, Recording):
            return found
        self.done = self._wanted or found.cut or self._format.cut
        self.left_out |= dict.fromkeys(found.left_out)
        if self.done not in CUTS:
            self.done = "table"  # what a set says of itself does not depend on paths
        return self.aligner.aligned(found)

    def require_recordings(self, home: store.DataFolder) -> None:
        """Refuse to cut a source of single pictures (InputError)."""
        if self._wanted is not None and not self.done:
            found = f"{home.address()!r} holds single pictures"
            raise InputError(f"{found}; --cut applies to recordings", next="leave out --cut")
