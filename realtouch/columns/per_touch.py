"""Columns of a stored round with one entry per touch, as numpy views, checked where they are read.

T is the number of touches of the round.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from realtouch.integrity.damage import damaged, missing_column
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.nested import NestedColumn, nested_column

__all__ = [
    "column_of",
    "intended_position",
    "intended_positions",
    "media_count",
    "per_touch",
    "plain_value",
    "require_count",
    "stored_value",
    "touch_count",
    "touch_total",
    "value_of",
    "vector_of",
    "vectors",
]

_POSITIONS = ("gel_pose_cell_frame.position", "gel_pose_cell_frame_seq.position")


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
    """Return T: the number of intended positions, or else of images or clips, or of poses read alone."""
    for name in ("pos_in_cell", "sensor_image", "sensor_video", *_POSITIONS):
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


def vector_of(row: Row, name: str, touch: int, width: int) -> NDArray[np.floating]:
    """Return the vector of one touch, shape (width,), a view; looks at no other touch.

    Raises
    ------
    IntegrityError
        It has not ``width`` values.
    IndexError
        There is no such touch.
    """
    column = column_of(row, name)
    first, last = column.inside(0, row.index, row.index + 1)
    require_count(row, name, last - first)
    if not -(last - first) <= touch < last - first:
        message = f"touch {touch} is out of range for {last - first} touches"
        raise IndexError(message)
    place = (first if touch >= 0 else last) + touch
    values = column.flat(1, place, place + 1)
    if len(values) != width:
        raise damaged(row, name, f"{len(values)} values; expected {width}", touch)
    return values


def intended_positions(row: Row) -> NDArray[np.floating]:
    """Return where each touch was meant to be, shape (T, 2), metres, cell frame, a view.

    Raises
    ------
    IntegrityError
        There are not T positions, or one is missing or not finite; names the touch.
    """
    positions = vectors(row, "pos_in_cell", 2)
    # One sum tells of any value that is not finite, and costs a tenth of looking at each.
    if not np.isfinite(positions.sum()):
        for touch in np.flatnonzero(~np.isfinite(positions).all(axis=1)).tolist():
            raise _no_position(row, touch, positions[touch])
    return positions


def intended_position(row: Row, touch: int) -> NDArray[np.floating]:
    """Return where one touch was meant to be, shape (2,); see :func:`intended_positions`."""
    position = vector_of(row, "pos_in_cell", touch, 2)
    if not np.isfinite(position.sum()):
        raise _no_position(row, touch, position)
    return position


def _no_position(row: Row, touch: int, found: NDArray[np.floating]) -> Exception:
    return damaged(row, "pos_in_cell", f"a position {found}; expected metres", touch)


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


def plain_value(row: Row, name: str) -> Any:
    """Return a field as numpy's scalar or Python's object.

    Raises
    ------
    InputError
        The data set has no such column.
    IntegrityError
        No value is stored, or text that is no Unicode.
    """
    try:
        value = row.value(name)
    except KeyError as error:
        raise missing_column(row, name) from error
    except _unreadable():  # one such value spoils the column of its whole block
        value = stored_value(row, name)
    if value is None:
        raise damaged(row, name, "no value is stored")
    return value


def stored_value(row: Row, name: str) -> Any:
    """Return a field of any type as Python's objects, looking at no other row.

    Raises
    ------
    IntegrityError
        Text that is no Unicode is stored.
    """
    try:
        return row.group.arrow(name)[row.index].as_py()
    except _unreadable() as error:
        raise damaged(row, name, f"a value that cannot be read ({error})") from error


def _unreadable() -> tuple[type[Exception], ...]:
    # Asked for only when something was raised: the import costs nothing where all is well.
    import pyarrow as pa

    return (ValueError, pa.ArrowException)
