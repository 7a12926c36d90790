"""Lists of images of Sparsh as touches: pickles are read by their opcodes and never executed."""

from __future__ import annotations

import pickletools
from collections.abc import Iterator
from typing import IO

from realtouch.import_columns import ImportColumns
from realtouch.importing.found_touches import FoundTouches
from realtouch.importing.source_files import open_source, read_tables, source_of, visible_files
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
    """Yield the images of the pickles of one split as touches, with the fields of the tables next to them."""
    split = home.address().rstrip("/").rpartition("/")[2]
    files = home.sizes()
    pickles = visible_files(home, ".pkl")
    if not pickles:
        raise InputError(f"{home.address()!r} holds no pickles (*.pkl)")
    tables, found = [], list[tuple[str, str, int, int]]()
    for path in pickles:
        stem = path.rpartition(".")[0]
        beside = (home, f"{stem}.csv") if table is None else source_of(table)
        with open_source(home, path) as stream:
            places = list(places_of_images(stream, path))
        found += [(f"{stem}_{count:06d}", path, *place) for count, place in enumerate(places)]
        if table is not None or beside[1] in files:
            rows = read_tables([beside], columns).rows
            if rows != len(places):  # else they would be of other images
                raise InputError(
                    f"{beside[1]!r} has {rows:,} lines; expected {len(places):,}, one for each image of "
                    f"{path!r}"
                )
            tables.append(beside)
    said = {}
    if tables:
        lines = read_tables(tables, columns)
        if lines.rows != len(found):
            problem = "has tables of some of its pickles alone; expected one for each, or none"
            raise InputError(f"{home.address()!r} {problem}")
        said = {**lines.columns}
    names, paths, starts, sizes = zip(*found, strict=True)
    said = {"split": column_types.repeated(split, len(names)), **said}
    yield FoundTouches.of(names, home.address(), paths, said, start=starts, size=sizes)
