"""FoTa as touches: the samples of the tars of one split."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from realtouch.exchange.webdataset_import import find_webdataset
from realtouch.import_columns import ImportColumns
from realtouch.importing.found_touches import FoundTouches
from realtouch.touch_options import FOTA_POSE_COLUMNS, POSE_COLUMNS
from tactile_toolkit import column_types, store


def find_fota(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[FoundTouches]:
    """Yield the samples of each tar of one split; the folder's name is that of the split."""
    split = home.address().rstrip("/").rpartition("/")[2]
    for touches in find_webdataset(home, columns, table):
        if {*touches.names} >= {*POSE_COLUMNS, *FOTA_POSE_COLUMNS}:  # of our exports: one pose, in two units
            touches = replace(touches, said=touches.said.drop_columns(list(FOTA_POSE_COLUMNS)))
        if "split" not in touches.names:
            touches = touches.with_said({"split": column_types.repeated(split, len(touches))})
        yield touches
