"""Columns of a stored round with one entry per touch, as numpy views, checked where they are read.

T is the number of touches of the round.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dataset_store.records import Row
from realtouch.damage import damaged, missing_column
from realtouch.nested import NestedColumn, nested_column

__all__ = [
    "column_of",
    "media_count",
    "per_touch",
    "require_count",
    "touch_count",
    "touch_total",
    "value_of",
    "vectors",
]


def column_of(row: Row, name: str) -> NestedColumn:
    """Return the column of a row.

    Raises
    ------
    InputError
        The data set has no such column.
    """
    try:
        return nested_column(row.group, name)
    except KeyError as error:
        raise missing_column(row, name) from error


def touch_count(row: Row, name: str) -> int:
    """Return for how many touches a row holds values of a column."""
    start, stop = column_of(row, name).inside(0, row.index, row.index + 1)
    return stop - start


def media_count(row: Row, name: str) -> int:
    """Return for how many touches a row holds images or clips.

    Raises
    ------
    IntegrityError
        There are not T of them.
    """
    count = touch_count(row, name)
    require_count(row, name, count)
    return count


def touch_total(row: Row) -> int:
    """Return T: the number of intended positions, or else of images or clips."""
    for name in ("pos_in_cell", "sensor_image", "sensor_video"):
        if row.has(name):
            return touch_count(row, name)
    raise missing_column(row, "pos_in_cell")


def per_touch(row: Row, name: str) -> NDArray[Any]:
    """Return one value per touch, shape (T,).

    Raises
    ------
    IntegrityError
        There are not T values.
    """
    values = column_of(row, name).flat(0, row.index, row.index + 1)
    require_count(row, name, len(values))
    return values


def value_of(row: Row, name: str, touch: int) -> Any:
    """Return one value of a column with one per touch, without looking at the others."""
    column = column_of(row, name)
    start, stop = column.inside(0, row.index, row.index + 1)
    if not touch < stop - start:
        require_count(row, name, stop - start)
    return column.values[start + touch]


def vectors(row: Row, name: str, width: int) -> NDArray[np.floating]:
    """Return one vector per touch, shape (T, width), a view.

    Raises
    ------
    IntegrityError
        There are not T vectors of ``width`` values.
    """
    values = column_of(row, name).flat(0, row.index, row.index + 1)
    touches = touch_count(row, name)
    require_count(row, name, touches)
    if len(values) != touches * width:
        problem = f"{len(values)} values for {touches} touches; expected {width} each"
        raise damaged(row, name, problem)
    return values.reshape(touches, width)


def require_count(row: Row, name: str, found: int) -> None:
    """Hold the number of entries of a column against T.

    Raises
    ------
    IntegrityError
        They differ.
    """
    expected = touch_total(row)
    if found != expected:
        raise damaged(row, name, f"{found} touches; expected {expected} as in 'pos_in_cell'")
