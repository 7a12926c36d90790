"""Sources of an import: recognised, read, and cut into touches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain

from realtouch.alignment_options import Alignment
from realtouch.exchange.exporting import require_layout
from realtouch.exchange.found_touches import IMPORTS, FoundTouch
from realtouch.exchange.recognised import Recognised, recognised
from realtouch.exchange.recordings import Recording, touches_of
from realtouch.touch_options import ImportColumns
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
    recordings were cut; empty if the source holds none. ``pictures`` show the cuts: PNG by name.
    """

    home: store.DataFolder
    layout: str
    recognised_by: str
    items: Sequence[FoundTouch]
    columns: ImportColumns
    cut: str = ""
    pictures: Mapping[str, bytes] = field(default_factory=dict)


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
    every = _found(home, layout, columns, reading.table)
    touches = chain.from_iterable(_touches(each, reading.cut, IMPORTS[layout].cut) for each in every)
    items = [item.checked(number) for number, item in enumerate(touches)]
    if not items:
        raise InputError(f"{home.address()!r} holds nothing to import; expected pictures")
    known = dict.fromkeys(chain.from_iterable(map(_known, items)))
    return FoundSource(home, layout, format_.by, items, columns.found_in(known))


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


def _known(item: FoundTouch) -> Iterable[str]:
    """Return the names of what is said of a touch."""
    return [
        *(name for name, value in item.values.items() if name and value not in (None, "")),
        *item.per_frame,
    ]


def _touches(found: FoundTouch | Recording, cut: str | None, default: str) -> Iterable[FoundTouch]:
    if isinstance(found, Recording):
        return touches_of(found, cut or found.cut or default)
    return [found]
