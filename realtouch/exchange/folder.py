"""A folder of images with a CSV table of what is known of them."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from functools import cache

from realtouch.exchange.items import HERE, ImportColumns, Item, Reason, require_columns, size_below
from tactile_toolkit.errors import InputError, IntegrityError, ItemError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.names import problem_of_name

_MOST_COLUMNS = 1_000
_MOST_UNUSABLE = 100_000
"""Lines of a table that name no image: of a few bytes each, they would take gigabytes to list."""


def items_of_table(home: DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Item]:
    """Yield a touch for each line of the table; of a file that cannot be found, why."""
    if columns.image is None:
        raise InputError("no column names the images", next="add --image-column NAME")
    found = _table_name(home, table)
    path = home.address(found)
    try:
        text = home.read_bytes(found).decode("utf-8-sig")
    except (IntegrityError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path!r} cannot be read as UTF-8 text ({error}); expected a table with commas"
        ) from error
    lines = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    seen: dict[str, int] = {}
    sizes = cache(home.sizes)  # of a store, one look at each folder
    try:
        names = list(lines.fieldnames or ())
        if len(names) > _MOST_COLUMNS:
            raise InputError(f"{path!r} has {len(names):,} columns; expected at most {_MOST_COLUMNS:,}")
        require_columns(names, [columns.image, *columns.found_in(names).names()], path)
        unusable = 0
        for number, values in enumerate(lines):
            name = HERE.sub("", str(values[columns.image] or ""))
            problem, size = None, 0
            try:
                size = size_below(home, name, sizes)
                if seen.setdefault(name, number) != number:
                    words = f"the same file as in row {seen[name]} of the table"
                    raise ItemError(Reason.duplicate, words)
                if None in values:
                    words = "the line has more values than the table has columns"
                    raise ItemError(Reason.columns, words)
            except ItemError as error:
                problem = error
                unusable += 1
                if unusable > max(_MOST_UNUSABLE, number // 2):
                    raise InputError(
                        f"{path!r}: {unusable:,} of the first {number + 1:,} lines cannot be used, the last "
                        f"as {error.message}; expected a line for each image",
                        next="check --image-column",
                    ) from error
            yield Item(number, name, f"{home.address()}/{name}", 0, size, dict(values), problem)
    except csv.Error as error:
        # Of a line that was not read it counts none; a quote that never ends reaches over all that follow.
        raise InputError(
            f"{path!r}, line {lines.line_num + 1}: {error}; expected a table with commas"
        ) from error


def _table_name(home: DataFolder, table: str | None) -> str:
    if table is not None:
        if problem_of_name(table) or not home.exists(table):
            raise InputError(f"there is no table {table!r} in {home.address()!r}")
        return table
    found = [name for name in home.sizes() if name.endswith(".csv") and not name.startswith(".")]
    if len(found) != 1:
        raise InputError(
            f"{home.address()!r} should be a folder with one CSV file; found {', '.join(found) or 'none'}; "
            "next: name it with --table"
        )
    return found[0]
