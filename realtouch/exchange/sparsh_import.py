"""Lists of images of Sparsh as touches: pickles are read by their opcodes and never executed."""

from __future__ import annotations

import pickletools
from collections.abc import Iterator
from typing import IO

from realtouch.import_columns import ImportColumns
from realtouch.importing.found_touches import FoundTouches
from realtouch.importing.source_files import open_source, read_table, source_of, visible_files
from tactile_toolkit import column_types, store
from tactile_toolkit.errors import InputError

# No image is smaller; a million empty ones would take long to check.
_LEAST_IMAGE_BYTES = 24
# How many bytes of an opcode come before the content.
_HEADER_BYTES = {"SHORT_BINBYTES": 2, "BINBYTES": 5, "BINBYTES8": 9}
_OF_LISTS = frozenset(
    ["PROTO", "FRAME", "EMPTY_LIST", "MARK", "MEMOIZE", "BINPUT", "LONG_BINPUT", "APPEND", "APPENDS", "STOP"]
)


def places_of_images(stream: IO[bytes], name: str) -> Iterator[tuple[int, int]]:
    """Yield place and size of each image in a pickled list; executes nothing of it."""
    lists = 0
    try:
        for opcode, content, position in pickletools.genops(stream):
            lists += opcode.name == "EMPTY_LIST"
            if opcode.name in _HEADER_BYTES and content is not None and position is not None:
                if len(content) < _LEAST_IMAGE_BYTES:
                    raise InputError(
                        f"{name!r} holds {len(content)} bytes at {position:,}; expected an encoded image"
                    )
                yield position + _HEADER_BYTES[opcode.name], len(content)
            elif opcode.name not in _OF_LISTS or lists > 1:
                raise InputError(
                    f"{name!r} holds something else than a list of encoded images ({opcode.name})",
                    next="write one list of `bytes` with pickle protocol 3 or higher",
                )
    except (ValueError, OverflowError, MemoryError) as error:
        raise InputError(f"{name!r} is not an intact pickle", next="fetch it again") from error
    if stream.read(1):
        raise InputError(f"{name!r} holds more than one pickle; expected one list of encoded images")


def find_sparsh(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[FoundTouches]:
    """Yield the images of each pickle of one split as touches, with the fields of the table next to it."""
    split = home.address().rstrip("/").rpartition("/")[2]
    files = home.sizes()
    names = visible_files(home, ".pkl")
    if not names:
        raise InputError(f"{home.address()!r} holds no pickles (*.pkl)")
    for name in names:
        stem = name.rpartition(".")[0]
        folder, beside = (home, f"{stem}.csv") if table is None else source_of(table)
        with open_source(home, name) as stream:
            places = list(places_of_images(stream, name))
        said = {"split": column_types.repeated(split, len(places))}
        if table is not None or beside in files:
            lines = read_table(folder, beside, columns)
            if lines.rows != len(places):  # else they would be of other images
                raise InputError(
                    f"{beside!r} has {lines.rows:,} lines; expected {len(places):,}, one for each image of "
                    f"{name!r}"
                )
            said |= lines.columns
        called = [f"{stem}_{count:06d}" for count in range(len(places))]
        starts, sizes = [place[0] for place in places], [place[1] for place in places]
        yield FoundTouches.of(called, home.address(), name, said, start=starts, size=sizes)
