"""A folder of images: with a table of what is known of them, in a folder for each class, or images alone."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

from realtouch.import_columns import ImportColumns
from realtouch.importing.found_touches import (
    IMAGE_ENDINGS,
    FoundTouch,
    found_file,
    natural_order,
    path_of,
    read_table,
    require_columns,
    source_of,
    visible_files,
)
from tactile_toolkit import store
from tactile_toolkit.column_tables import COLUMN_TABLE_ENDINGS
from tactile_toolkit.errors import InputError, ItemError

_IMAGES = tuple(f".{ending}" for ending in IMAGE_ENDINGS)
_SPLITS = {"train", "val", "valid", "validation", "test"}
_MOST_IMAGES = 1_000_000


def find_folder(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[FoundTouch]:
    """Yield a touch for each line of the table; a missing file is the touch's problem.

    Without a table, each image is a touch; see :func:`_labelled`.
    """
    if columns.image is None:
        raise InputError("no column names the images", next="add --map image=COLUMN")
    if table is not None:
        folder, found = source_of(table)
    else:
        folder, tables = home, visible_files(home, COLUMN_TABLE_ENDINGS)
        images = [] if tables or columns.image_name else _images(home)
        if images:
            yield from _labelled(home, images)
            return
        if len(tables) != 1:
            raise InputError(
                f"{home.address()!r} should be a folder with one table; found {', '.join(tables) or 'none'}",
                next="name it with --table",
            )
        found = tables[0]
    names, lines = read_table(folder, found)
    require_columns(names, [columns.image, *columns.found_in(names).names()], folder.address(found))
    seen: dict[str, int] = {}
    sizes = cache(home.sizes)  # of a store, one look at each folder
    known = set[str]()
    with store.without_collecting():
        for number, values in enumerate(lines):
            name = path_of(str(values[columns.image] or ""))
            first = seen.setdefault(name, number)
            problem = None
            if first != number:
                problem = ItemError("duplicate", f"the same file as in row {first} of the table")
            elif None in values:
                problem = ItemError("columns", "the line has more values than the table has columns")
            yield found_file(home, name, values, sizes, problem, known)


def _images(home: store.DataFolder) -> list[str]:
    """List the visible images in a folder and below it, in natural order; InputError for too many."""
    found: list[str] = []
    for path in home.walk():
        if path.lower().endswith(_IMAGES) and not store.is_hidden(path):
            found.append(path)
        if len(found) > _MOST_IMAGES:
            raise InputError(f"{home.address()!r} holds more than {_MOST_IMAGES:,} images; expected fewer")
    return sorted(found, key=natural_order)


def _labelled(home: store.DataFolder, paths: list[str]) -> Iterator[FoundTouch]:
    """Yield the touches of images, whose folders name their classes.

    Outer folders that are all called ``train``, ``val``, ``test`` and so on are splits, and those in them are
    classes. Other outer folders are classes if there are several.
    """
    folders = [path.split("/")[:-1] for path in paths]
    is_split = {names[0] if names else "" for names in folders} <= _SPLITS
    inner = [names[is_split:] for names in folders]
    has_classes = is_split or len({names[0] for names in inner if names}) > 1
    sizes = cache(home.sizes)
    for path, names, below in zip(paths, folders, inner, strict=True):
        values: dict[str, object] = {}
        if is_split:
            values["split"] = names[0]
        if has_classes and below:
            values["label"] = below[0]
        yield found_file(home, path, values, sizes)
