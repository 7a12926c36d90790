"""A folder of images with a table of what is known of them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from realtouch.exchange.found_touches import (
    FoundTouch,
    found_file,
    path_of,
    read_table,
    require_columns,
    source_of,
    visible_files,
)
from realtouch.touch_options import ImportColumns
from tactile_toolkit import store
from tactile_toolkit.column_tables import COLUMN_TABLE_ENDINGS
from tactile_toolkit.errors import InputError, ItemError


def find_folder(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[FoundTouch]:
    """Yield a touch for each line of the table; a missing file is the touch's problem."""
    if columns.image is None:
        raise InputError("no column names the images", next="add --map image=COLUMN")
    folder, found = home, ""
    if table is None:
        found = _table_name(home)
    else:
        folder, found = source_of(table)
    names, lines = read_table(folder, found)
    require_columns(names, [columns.image, *columns.found_in(names).names()], folder.address(found))
    seen: dict[str, int] = {}
    sizes = cache(home.sizes)  # of a store, one look at each folder
    known = set[str]()
    for number, values in enumerate(lines):
        name = path_of(str(values[columns.image] or ""))
        first = seen.setdefault(name, number)
        problem = None
        if first != number:
            problem = ItemError("duplicate", f"the same file as in row {first} of the table")
        elif None in values:
            problem = ItemError("columns", "the line has more values than the table has columns")
        yield found_file(home, name, values, sizes, problem, known)


def _table_name(home: store.DataFolder) -> str:
    found = visible_files(home, COLUMN_TABLE_ENDINGS)
    if len(found) != 1:
        raise InputError(
            f"{home.address()!r} should be a folder with one table (CSV, TSV, JSON lines or Parquet); found "
            f"{', '.join(found) or 'none'}",
            next="name it with --table",
        )
    return found[0]
