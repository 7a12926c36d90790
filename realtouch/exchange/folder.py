"""A folder of images with a CSV table of what is known of them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from realtouch.exchange.found_touches import FoundTouch, path_of, read_table, require_columns, source_of
from realtouch.touch_options import ImportColumns
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.text_tables import TABLE_ENDINGS


def items(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[FoundTouch]:
    """Yield a touch for each line of the table; of a file that cannot be found, why."""
    if columns.image is None:
        raise InputError("no column names the images", next="add --image-column NAME")
    folder, found = source_of(table) if table is not None else (home, _table_name(home))
    names, lines = read_table(folder, found)
    require_columns(names, [columns.image, *columns.found_in(names).names()], folder.address(found))
    seen: dict[str, int] = {}
    sizes = cache(home.sizes)  # of a store, one look at each folder
    for number, values in enumerate(lines):
        name = path_of(str(values[columns.image] or ""))
        problem, size = None, 0
        try:
            size = store.size_inside(home, name, sizes)
            if seen.setdefault(name, number) != number:
                raise ItemError("duplicate", f"the same file as in row {seen[name]} of the table")
            if None in values:
                raise ItemError("columns", "the line has more values than the table has columns")
        except ItemError as error:
            problem = error
        yield FoundTouch(name, home.address(), name, 0, size, values, problem)


def _table_name(home: store.DataFolder) -> str:
    files = home.sizes()
    found = [name for name in files if name.lower().endswith(TABLE_ENDINGS) and not store.is_hidden(name)]
    if len(found) != 1:
        raise InputError(
            f"{home.address()!r} should be a folder with one CSV file; found {', '.join(found) or 'none'}",
            next="name it with --table",
        )
    return found[0]
