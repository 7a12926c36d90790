"""Tables with a row for each touch, as `datasets`, pandas and polars read them: the rows are the format.

Files of other programs have the picture in a column of bytes, or of ``bytes`` and ``path`` as `datasets`
stores it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from realtouch import importing
from realtouch.formats import foreign_parquet, touch_rows
from tactile_toolkit import errors, store, touch
from tactile_toolkit.columns import column_types

plan_flat = touch_rows.TouchFormat().plan


_ENDING = ".parquet"
_SPLIT = "split"
# Columns of our exports. Those of the order repeat the ids and the order of the rows.
_OURS = {"id", "round_id", "label_name", "touch", "frame"}
_ORDER_COLUMNS = ("id", "touch", "frame")


def find_flat(
    home: store.DataFolder, columns: importing.ImportColumns, table: str | None
) -> Iterator[importing.FoundTouches]:
    """Yield a touch for each row of each file, in their order; the split is that of the file's name."""
    home, paths = importing.files_to_read(
        home, "Parquet files; expected a row for each touch in them", _parquet
    )
    for path in paths:
        try:
            parquet = foreign_parquet.ForeignParquet(home, path)
        except errors.ItemError as error:
            raise errors.InputError(f"{home.address(path)!r}: {error.what}") from error
        column = _picture_column(parquet, columns.image_name)
        yield _touches(home, path, parquet, column)


def _parquet(home: store.DataFolder) -> list[str]:
    return sorted(path for path in home.walk() if path.endswith(_ENDING) and not store.is_hidden(path))


def _picture_column(parquet: foreign_parquet.ForeignParquet, name: str) -> str:
    """Return the column of pictures: the named or the only one; InputError if there is no such column."""
    for stored in touch.MEDIA_COLUMN.values():
        # In a data set of touches, it is a list with an entry for each touch.
        if stored in parquet.types and not foreign_parquet.is_picture(parquet.types[stored]):
            raise errors.InputError(
                f"{parquet.place!r} has the column {stored!r} of a data set of touches, "
                "which needs no import",
                next="open the data set by its folder, as with `realtouch info`",
            )
    known = [column for column, data_type in parquet.types.items() if foreign_parquet.is_picture(data_type)]
    return importing.chosen_pictures(known, name, parquet.place, "columns of pictures", parquet.types)


def _touches(
    home: store.DataFolder, path: str, parquet: foreign_parquet.ForeignParquet, column: str
) -> importing.FoundTouches:
    names = [name for name, data_type in parquet.types.items() if not foreign_parquet.is_picture(data_type)]
    size, stem = parquet.picture_bytes(column), path.removesuffix(_ENDING)
    shard = store.ShardName.parse(path.rpartition("/")[2])
    left_out = _ORDER_COLUMNS if {*names} >= _OURS else ()
    said = parquet.columns([name for name in names if name not in left_out])
    if shard is not None and _SPLIT not in names:
        said = {_SPLIT: column_types.repeated(shard.split, len(parquet)), **said}
    # The name of the file of each picture, without its folder.
    files = [importing.path_of(name or "").rpartition("/")[2] for name in parquet.picture_names(column)]
    return importing.FoundTouches.of(
        [name or f"{stem}_{number:06d}" for number, name in enumerate(files)],
        home.address(),
        path,
        said,
        part=column,
        start=np.arange(len(parquet)),
        size=size,
    )
