"""Columns of a stored round with one entry per touch, as numpy views, checked where they are read.

T is the number of touches of the round.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realtouch.damage import damaged, missing_column
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read.columns import NestedColumn
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.sequence import checked_index
from tactile_toolkit.touch.schema import PER_TOUCH_COLUMNS

# The first of these that is there says how many touches a round has; poses only where they were read alone.
_COUNTED = (
    "pos_in_cell",
    "sensor_image",
    "sensor_video",
    "gel_pose_cell_frame.position",
    "gel_pose_cell_frame_seq.position",
)
_INT_LIMIT = 1 << 63


def column_of(row: Row, name: str) -> NestedColumn:
    """Return the column of a row; InputError when the data set has no column of that name."""
    try:
        return row.group.nested(name)
    except KeyError as error:
        raise missing_column(row, name) from error


def touch_total(row: Row) -> int:
    """Return T: the number of intended positions, or else of images or clips, or of poses read alone."""
    # Once for a block of rows: this is asked for each touch.
    starts = row.group.once("starts of touches", lambda: _touch_starts(row))
    return starts if isinstance(starts, int) else int(starts[row.index + 1] - starts[row.index])


def _touch_starts(row: Row) -> NDArray[Any] | int:
    for name in _COUNTED:
        if row.has(name):
            return row.group.nested(name).levels[0]
    raise missing_column(row, _COUNTED[0])


def entries_of(row: Row, name: str, touch: int | None = None) -> tuple[NestedColumn, int, int]:
    """Return a column and the range of its entries that are the round's, or one touch's.

    Raises IntegrityError unless there are T, IndexError when there is no such touch.
    """
    column = column_of(row, name)
    start, stop = column.inside(0, row.index, row.index + 1)
    expected = touch_total(row)
    if stop - start != expected:
        raise damaged(row, name, f"{stop - start} touches; expected {expected} as in 'pos_in_cell'")
    if touch is None:
        return column, start, stop
    first = start + checked_index(touch, expected, "touch", "touches")
    return column, first, first + 1


def require_touches(row: Row) -> None:
    """Refuse a round whose columns differ in their number of touches; IntegrityError, with the column."""
    for name in PER_TOUCH_COLUMNS:
        if row.has(name):
            entries_of(row, name)


def per_touch(row: Row, name: str, touch: int | None = None) -> NDArray[Any]:
    """Return one value per touch, shape (T,), or one alone, (1,); IntegrityError unless there are T."""
    column, start, stop = entries_of(row, name, touch)
    values: NDArray[Any] = column.values[start:stop]
    return values


def vectors(row: Row, name: str, width: int, touch: int | None = None) -> NDArray[np.floating]:
    """Return one vector per touch, shape (T, width), or that of one alone, (1, width), a view.

    Raises IntegrityError for other numbers of values.
    """
    column, start, stop = entries_of(row, name, touch)
    values = column.flat(1, start, stop)
    touches = stop - start
    if len(values) != touches * width:
        problem = f"{len(values)} values for {touches} touches; expected {width} each"
        if touch is not None:
            problem = f"{len(values)} values; expected {width}"
        raise damaged(row, name, problem, touch)
    return values.reshape(touches, width)


def intended_positions(row: Row, touch: int | None = None) -> NDArray[np.floating]:
    """Return where each touch was meant to be, shape (T, 2), or one alone, (1, 2), a view.

    Metres, cell frame. Raises IntegrityError, which names the touch, for a position that is missing or not
    finite.
    """
    positions = vectors(row, "pos_in_cell", 2, touch)
    # One sum tells of any value that is not finite, and costs a tenth of looking at each.
    if not np.isfinite(positions.sum()):
        wrong = int(np.argmin(np.isfinite(positions).all(axis=1)))
        if not np.isfinite(positions[wrong]).all():
            problem = f"a position {positions[wrong]}; expected metres"
            raise damaged(row, "pos_in_cell", problem, (touch or 0) + wrong)
    return positions


def intended_position(row: Row, touch: int) -> NDArray[np.floating]:
    """Return where one touch was meant to be, shape (2,); see :func:`intended_positions`."""
    position: NDArray[np.floating] = intended_positions(row, touch)[0]
    return position


def readable(row: Row, read: Callable[[Row, int | None], NDArray[Any]], *shape: int) -> NDArray[np.float64]:
    """Return what is read of all touches, shape (T, ...), float64; NaN for touches where it is damaged."""
    try:
        return read(row, None).astype(np.float64)
    except IntegrityError:
        # One by one only where something is damaged: all at once is many times as fast.
        known = np.full((touch_total(row), *shape), np.nan)
    for touch in range(len(known)):
        with suppress(IntegrityError):
            known[touch] = read(row, touch)[0]
    return known


def known_positions(row: Row) -> NDArray[np.float64]:
    """Return what :func:`intended_positions` does, float64; NaN where a position cannot be read."""
    return readable(row, intended_positions, 2)


def plain_value(row: Row, name: str) -> Any:
    """Return a field as numpy's scalar or Python's object.

    Raises InputError when the data set has no such column, IntegrityError when no value is stored, or text
    that is not Unicode.
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


def int_value(row: Row, name: str) -> int:
    """Return a field as an int from 0 to below 2**63; IntegrityError for any other, else as plain_value."""
    value = plain_value(row, name)
    if isinstance(value, float) and np.isfinite(value):  # a null next to it made numpy's column inexact
        value = stored_value(row, name)
    # Files of others store integers as floats, and missing ones as NaN.
    if not np.isfinite(value) or int(value) != value or not 0 <= value < _INT_LIMIT:
        raise damaged(row, name, f"the value is {value}; expected an integer of 0 or more, below 2**63")
    return int(value)


def stored_value(row: Row, name: str) -> Any:
    """Return a field of any type as Python's objects, looking at no other row.

    Raises IntegrityError for text that is not Unicode.
    """
    try:
        return row.group.arrow(name)[row.index].as_py()
    except _unreadable() as error:
        raise damaged(row, name, f"a value that cannot be read ({error})") from error


def _unreadable() -> tuple[type[Exception], ...]:
    # Asked for only when something was raised: the import costs nothing where all is well.
    import pyarrow as pa

    return (ValueError, pa.ArrowException)
