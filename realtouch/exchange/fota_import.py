"""FoTa as touches: the samples of the tars of one split."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from realtouch.exchange.webdataset_import import find_webdataset
from realtouch.import_columns import ImportColumns
from realtouch.importing.found_touches import FoundTouch
from realtouch.touch_options import FOTA_POSE_COLUMNS, POSE_COLUMNS
from tactile_toolkit import store


def find_fota(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[FoundTouch]:
    """Yield a touch for each sample of the tars of one split; the folder's name is that of the split."""
    split = home.address().rstrip("/").rpartition("/")[2]
    for item in find_webdataset(home, columns, table):
        values: dict[str, object] = {"split": split, **item.values}
        if values.keys() >= {*POSE_COLUMNS, *FOTA_POSE_COLUMNS}:  # of our exports: one pose, in two units
            values = {name: value for name, value in values.items() if name not in FOTA_POSE_COLUMNS}
        yield replace(item, values=values)
