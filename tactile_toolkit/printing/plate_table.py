"""The table that says which object lies where."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.printing.layout import Placed

__all__ = ["COLUMNS", "TABLE_FILE", "plates_before", "table_csv", "table_row"]

TABLE_FILE = "plates.csv"
_PLATE_FILE = re.compile(r"plate-\d{2,}\.3mf", re.ASCII)

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


def plates_before(folder: Path) -> list[str]:
    """List the plates and maps of the export whose table is in the folder; names alone tell nothing.

    Raises
    ------
    IntegrityError
        The table is there and cannot be read.
    """
    try:
        with (folder / TABLE_FILE).open(newline="", encoding="utf-8") as stream:
            listed = {str(row.get("file")) for row in csv.DictReader(stream)}
    except (FileNotFoundError, UnicodeDecodeError, csv.Error):
        return []
    except OSError as error:
        message = f"cannot read {str(folder / TABLE_FILE)!r}: {error.strerror or error}"
        raise IntegrityError(message) from error
    solids = [name for name in listed if _PLATE_FILE.fullmatch(name)]
    names = {name for solid in solids for name in (solid, Path(solid).with_suffix(".png").name)}
    return sorted(name for name in names if (folder / name).exists())
