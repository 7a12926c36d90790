"""The table that says which object lies where."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from typing import Any

from dataset_store.printing.layout import Placed

__all__ = ["COLUMNS", "table_csv", "table_row"]

COLUMNS = (
    "plate",
    "file",
    "name",
    "split",
    "label",
    "id",
    "x_mm",
    "y_mm",
    "width_mm",
    "depth_mm",
    "height_mm",
    "volume_mm3",
    "tag_x_mm",
    "tag_y_mm",
    "tag_width_mm",
    "tag_depth_mm",
)
"""``x_mm`` and ``y_mm``: lower left corner of the bounding box, from the front left corner of the plate."""


def table_row(plate: int, file: str, placed: Placed) -> dict[str, Any]:
    """Return one row; what a plate without tags lacks is None.

    Parameters
    ----------
    plate : int
        Number of the plate, from 1.
    file : str
        Its 3MF file.
    placed : Placed
        The object.
    """
    item, tag = placed.item, placed.tag
    beside = (None,) * 4 if tag is None else (tag.x_mm, tag.y_mm, tag.width_mm, tag.depth_mm)
    values = (
        *(plate, file, item.name, item.split, item.label, item.id, placed.x_mm, placed.y_mm),
        *(*placed.outline.size_mm, placed.height_mm, placed.volume_mm3, *beside),
    )
    return {
        name: round(value, 3) if isinstance(value, float) else value
        for name, value in zip(COLUMNS, values, strict=True)
    }


def table_csv(rows: Iterable[dict[str, Any]]) -> bytes:
    """Pack rows into a CSV file with a header."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()
