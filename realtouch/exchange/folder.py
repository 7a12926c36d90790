"""A folder of images with a CSV table of what is known of them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from realtouch.exchange.items import HERE, Item, read_table, require_columns, size_below
from realtouch.spec import ImportColumns
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.names import problem_of_name


def items(home: DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Item]:
    """Yield a touch for each line of the table; of a file that cannot be found, why."""
    if columns.image is None:
        raise InputError("no column names the images", next="add --image-column NAME")
    found = _table_name(home, table)
    names, lines = read_table(home, found)
    require_columns(names, [columns.image, *columns.found_in(names).names()], home.address(found))
    seen: dict[str, int] = {}
    sizes = cache(home.sizes)  # of a store, one look at each folder
    for number, values in enumerate(lines):
        name = HERE.sub("", str(values[columns.image] or ""))
        problem, size = None, 0
        try:
            size = size_below(home, name, sizes)
            if seen.setdefault(name, number) != number:
                raise ItemError("duplicate", f"the same file as in row {seen[name]} of the table")
            if None in values:
                raise ItemError("columns", "the line has more values than the table has columns")
        except ItemError as error:
            problem = error
        yield Item(name, f"{home.address()}/{name}", 0, size, values, problem)


def _table_name(home: DataFolder, table: str | None) -> str:
    if table is not None:
        if problem_of_name(table) or not home.exists(table):
            raise InputError(f"{home.address()!r} has no table {table!r}")
        return table
    found = [name for name in home.sizes() if name.endswith(".csv") and not name.startswith(".")]
    if len(found) != 1:
        raise InputError(
            f"{home.address()!r} should be a folder with one CSV file; found {', '.join(found) or 'none'}",
            next="name it with --table",
        )
    return found[0]
