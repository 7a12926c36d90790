"""Folders of images: with a table of their fields, with a folder for each class, or images alone."""

from __future__ import annotations

from collections.abc import Iterator

import pyarrow as pa

from realtouch import importing
from tactile_toolkit import errors, store
from tactile_toolkit.columns import tables

_IMAGES = tuple(f".{ending}" for ending in importing.IMAGE_ENDINGS)
_SPLITS = {"train", "val", "valid", "validation", "test"}
_MAX_IMAGES = 1_000_000


def find_folder(
    home: store.DataFolder, columns: importing.ImportColumns, table: str | None
) -> Iterator[importing.FoundTouches]:
    """Yield a touch for each row of the table; the touch of a missing file has a problem.

    Without a table, each image is a touch; see :func:`_labelled`.
    """
    if columns.image is None:
        raise errors.InputError("no column names the images", next="add --map image=COLUMN")
    if table is not None:
        folder, found = importing.source_of(table)
    else:
        folder, named = home, importing.visible_files(home, tables.ENDINGS)
        if not named and not columns.image_name:
            images = _images(home)
            if images:
                yield _labelled(home, images)
                return
        if len(named) != 1:
            raise errors.InputError(
                f"{home.address()!r} should be a folder with one table; found {', '.join(named) or 'none'}",
                next="name it with --table",
            )
        found = named[0]
    lines = importing.read_table(folder, found, columns, [columns.image])
    wanted = [columns.image, *columns.found_in(lines.columns).names()]
    importing.require_columns(lines.columns, wanted, folder.address(found))
    paths = list(map(importing.path_of, lines.texts(columns.image)))
    duplicates = importing.duplicates_of(paths, importing.FILE_OF_TABLE)
    yield importing.image_files(home, paths, lines.columns, duplicates)


def _images(home: store.DataFolder) -> list[str]:
    """List the visible images in a folder and its sub-folders, in natural order; InputError for too many."""
    found: list[str] = []
    for path in home.walk():
        if path.lower().endswith(_IMAGES) and not store.is_hidden(path):
            found.append(path)
        if len(found) > _MAX_IMAGES:
            raise errors.InputError(
                f"{home.address()!r} holds more than {_MAX_IMAGES:,} images; expected fewer"
            )
    return sorted(found, key=importing.natural_order)


def _labelled(home: store.DataFolder, paths: list[str]) -> importing.FoundTouches:
    """Return the touches of images; the folder of an image may name its class.

    If all outer folders are called ``train``, ``val``, ``test`` and so on, they are splits, and the folders
    in them are classes. Other outer folders are classes if there are several.
    """
    folders = [path.split("/")[:-1] for path in paths]
    is_split = all(folders) and {names[0] for names in folders} <= _SPLITS
    inner = [names[is_split:] for names in folders]
    has_classes = is_split or len({names[0] for names in inner if names}) > 1
    said = {}
    if is_split:
        said["split"] = pa.array([names[0] for names in folders])
    if has_classes and any(inner):
        # An image in a folder whose name is not Unicode has a problem; here only the text matters.
        labels = [names[0].encode(errors="replace").decode() if names else None for names in inner]
        said["label"] = pa.array(labels, pa.string())
    return importing.image_files(home, paths, said)
