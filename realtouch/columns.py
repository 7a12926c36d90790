"""Columns of a stored round with one entry per touch, and its metadata, checked where they are read.

T is the number of touches of the round.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from realtouch.damage import damaged, missing_column
from realtouch.poses import Poses, bad_pose, rigid_transform
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.read.columns import NestedColumn
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard
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
_UNREADABLE = (ValueError, pa.ArrowException)


def stored_rows(shards: Iterable[Shard], columns: Sequence[str] | None = None) -> Iterator[Row]:
    """Yield all rows of some files, with all columns or those named; a block of them is in memory."""
    for shard in shards:
        for index in range(shard.metadata.num_row_groups):
            for group in shard.blocks(index, columns):
                yield from (Row(group, row) for row in range(len(group.table)))


def column_of(row: Row, name: str) -> NestedColumn:
    """Return the column of a row; InputError when the data set has no column of that name."""
    try:
        return row.group.nested(name)
    except KeyError as error:
        raise missing_column(row, name) from error


def touch_total(row: Row) -> int:
    """Return T: the number of intended positions, or else of images or clips, or of poses read alone."""
    # Once for a block of rows: this is asked for each touch.
    starts = row.group.once("starts of touches", lambda: column_of(row, _counted(row)).levels[0])
    return starts if isinstance(starts, int) else int(starts[row.index + 1] - starts[row.index])


def _counted(row: Row) -> str:
    return next(filter(row.has, _COUNTED), _COUNTED[0])


def entries_of(row: Row, name: str, touch: int | None = None) -> tuple[NestedColumn, int, int]:
    """Return a column and the range of its entries that are the round's, or one touch's.

    Raises IntegrityError unless there are T, IndexError when it has no such touch.
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
    # One sum shows any value that is not finite, and costs a tenth of looking at each.
    if not np.isfinite(positions.sum()):
        wrong = int(np.argmin(np.isfinite(positions).all(axis=1)))
        if not np.isfinite(positions[wrong]).all():
            problem = f"a position {positions[wrong]}; expected metres"
            raise damaged(row, "pos_in_cell", problem, (touch or 0) + wrong)
    return positions


def readable(
    row: Row, read: Callable[[Row, int | None], NDArray[Any]], shape: tuple[int, ...] = ()
) -> NDArray[np.float64]:
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


def plain_value(row: Row, name: str) -> Any:
    """Return a field as numpy's scalar or Python's object.

    Raises InputError when the data set has no such column, IntegrityError when no value is stored, or text
    that is not Unicode.
    """
    try:
        value = row.value(name)
    except KeyError as error:
        raise missing_column(row, name) from error
    except _UNREADABLE:  # one such value spoils the column of its whole block
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


def label_value(row: Row, names: Sequence[str] | None) -> int:
    """Return the class of a row; IntegrityError where it is not one of the classes, if those are named."""
    label = int_value(row, "label")
    if names is not None and label >= len(names):
        limit = f"expected less than {len(names)}, the number of named classes"
        raise damaged(row, "label", f"the value is {label}; {limit}")
    return label


def stored_value(row: Row, name: str) -> Any:
    """Return a field of any type as Python's objects, looking at no other row.

    Raises IntegrityError for text that is not Unicode.
    """
    try:
        return row.group.arrow(name)[row.index].as_py()
    except _UNREADABLE as error:
        raise damaged(row, name, f"a value that cannot be read ({error})") from error


def has_info(row: Row) -> bool:
    """Return whether a round has metadata."""
    return row.has("info") or any(name.startswith("info.") for name in row.group.names)


def read_info(row: Row) -> dict[str, Any]:
    """Read the metadata of a round; InputError when the data set does not store it.

    Raises IntegrityError for a pose that is not one, or one name for a value and for a group of values.
    """
    if not has_info(row):
        raise missing_column(row, "info")
    nested: dict[str, Any] = {}
    for name in row.group.names:
        if not name.startswith("info."):
            continue
        # The published sets store the struct `info` as flat columns with dotted names.
        *outer, last = name.split(".")[1:]
        group: Any = nested
        for part in outer:
            if isinstance(group, dict):
                group = group.setdefault(part, {})
        if not isinstance(group, dict) or last in group:
            raise damaged(row, name, "the name of a value and of a group of values; expected one of them")
        group[last] = stored_value(row, name)
    return {key: _with_poses(row, value, f"info.{key}") for key, value in nested.items()}


def _with_poses(row: Row, value: Any, name: str) -> Any:
    """Put poses in place of groups of a position and a quaternion."""
    if not isinstance(value, dict):
        return value
    if value.keys() == {"position", "quaternion"}:
        return _pose(row, value, name)
    return {key: _with_poses(row, each, f"{name}.{key}") for key, each in value.items()}


def _pose(row: Row, values: dict[str, Any], name: str) -> Any:
    """Make the pose, or the poses where there is one per touch."""
    try:
        position = np.asarray(values["position"], np.float64)
        quaternion = np.asarray(values["quaternion"], np.float64)
    except (TypeError, ValueError) as error:
        problem = "values that are not numbers, or vectors of several lengths; expected a pose's numbers"
        raise damaged(row, name, problem) from error
    outer = position.shape[:-1]
    if len(outer) > 1 or position.shape != (*outer, 3) or quaternion.shape != (*outer, 4):
        found = f"position {position.shape} and quaternion {quaternion.shape}"
        raise damaged(row, name, f"{found}; expected (3,) and (4,), or (n, 3) and (n, 4)")
    wrong = bad_pose(position.reshape(-1, 3), quaternion.reshape(-1, 4))
    if wrong is not None:  # the metadata of a round are one thing: none of it can be given
        raise damaged(row, name, f"pose {wrong[0]}: {wrong[1]}" if outer else wrong[1])
    return Poses(position, quaternion) if outer else rigid_transform(position, quaternion)
