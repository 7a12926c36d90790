"""Values of the fields of a source, in the units of this toolkit; a wrong one is refused with a reason."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

import numpy as np
import pyarrow as pa

from realtouch.importing import found_touches, import_columns, source_files
from realtouch.poses import bad_pose
from tactile_toolkit import arithmetic, column_types, errors, spatial, units
from tactile_toolkit.array_types import Float64, Int64

UNKNOWN = ("-1", "-1.0")
"""The number of a class that is not known, as `datasets` has it."""

Fields = Mapping[str, pa.Array]
"""Columns by their names, each with an entry for every touch or picture."""

_WHOLE = re.compile(r"^(0|[1-9][0-9]*)(?:\.0+)?\Z")
_LONGEST_SHOWN = 80  # letters of a value that a message repeats
_LONGEST_INTEGER = 18  # digits
# The cell is 0.12 m wide. What lies farther from it than that, or three times as high, is in another unit.
_FARTHEST_M = (0.18, 0.18, 0.36)
_MAX_TURN = 4 * np.pi  # of a rotation vector; a longer one is in degrees
_NO_TILT = 1e-6  # of a frame by which x and y alone can be transformed
_INSTANTS = (pa.timestamp("ns", "UTC"), pa.timestamp("ns"))


def shown(text: object) -> str:
    """Return the beginning of a value, for a message."""
    return str(text)[:_LONGEST_SHOWN]


def integer_text(text: str) -> str:
    """Return ``"3"`` for ``"3.0"``: programs write integers so in a column with gaps."""
    if text.isdecimal() or "." not in text:  # most of them
        return text
    return _WHOLE.sub(r"\1", text)


def labels_of(
    touches: found_touches.FoundTouches, column: str | None, names: Sequence[str]
) -> tuple[Int64, dict[int, errors.ItemError]]:
    """Return the class number of each touch, -1 if it is unknown, and the problems by place."""
    numbers = {name: number for number, name in reversed([*enumerate(names)])}
    problems = _no_names(touches.value(column or source_files.NUMBERED))
    found = np.full(len(touches), -1)
    if not numbers:
        return found, problems
    seen: dict[str, int | None] = dict.fromkeys(UNKNOWN, -1)
    for place, pair in enumerate(
        zip(touches.texts(column), touches.texts(source_files.NUMBERED), strict=True)
    ):
        label = pair[0] or pair[1]
        if label not in seen:
            seen[label] = numbers.get(label, numbers.get(integer_text(label)))
        number = seen[label]
        if number is None:
            problems[place] = errors.ItemError("label", f"the label {shown(label)!r}; expected a class")
        else:
            found[place] = number
    return found, problems


def _no_names(column: pa.Array | None) -> dict[int, errors.ItemError]:
    """Return the labels that are lists or objects of JSON."""
    if column is None or column_types.is_leaf(column.type):
        return {}
    values = column_types.values_of(column)
    return {
        place: errors.ItemError("label", f"the label {shown(value)}; expected a name or a number")
        for place, value in enumerate(values)
        if isinstance(value, (dict, list))
    }


def objects_of(
    touches: found_touches.FoundTouches, column: str | None
) -> tuple[Int64, dict[int, errors.ItemError]]:
    """Return the object id of each touch, 0 without such a column, and the problems by place."""
    found, problems = np.zeros(len(touches), np.int64), dict[int, errors.ItemError]()
    for place, text in enumerate(map(integer_text, touches.texts(column)) if column else ()):
        if text.isdecimal() and text.isascii() and len(text) <= _LONGEST_INTEGER:
            found[place] = int(text)
        else:
            problems[place] = errors.ItemError("object", f"the object {shown(text)!r}; expected an integer")
    return found, problems


def each_of(
    read: Callable[[Fields, import_columns.ImportColumns], Float64],
    fields: Fields,
    columns: import_columns.ImportColumns,
    rows: Int64,
) -> tuple[Float64 | None, dict[int, errors.ItemError]]:
    """Read some touches or pictures at once, or one by one where some are wrong.

    Returns an array with an entry for each row, NaN for those that are not read, and what is wrong with those
    that cannot be used; without a single one that can, there is no array.
    """
    problems: dict[int, errors.ItemError] = {}
    found: Float64 | None = None
    parts = [rows]
    while parts:
        part = parts.pop()
        try:
            some = read({name: column.take(pa.array(part)) for name, column in fields.items()}, columns)
        except errors.ItemError as error:
            if len(part) == 1:
                problems[int(part[0])] = error
            else:
                parts += np.array_split(part, 2)[::-1] if len(part) else []
            continue
        if found is None:
            count = max(map(len, fields.values()))
            found = np.full((count, *some.shape[1:]), np.nan)
        found[part] = some
    return found, dict(sorted(problems.items()))


def stated_positions(fields: Fields, columns: import_columns.ImportColumns) -> Float64:
    """Return intended positions, x and y in metres, cell frame, shape (n, 2).

    Raises ItemError for anything else; InputError for a frame that makes them depend on a height.
    """
    place = _numbers(fields, columns, columns.position or (), (2,), "position")
    if columns.frame is not None:
        turn, shift = _frame(columns)
        if np.abs(turn[:2, 2]).max() > _NO_TILT:
            raise errors.InputError(
                "the frame tilts, so that an x and y of the source is no x and y of the cell",
                next="leave out the positions: --map position=",
            )
        place = place @ turn[:2, :2].T + shift[:2]
    _require_metres(place, "position")
    return place


def poses(fields: Fields, columns: import_columns.ImportColumns) -> Float64:
    """Return poses in the cell frame, shape (n, 7): position in metres, quaternion x, y, z, w.

    Raises ItemError for anything else.
    """
    numbers = _numbers(fields, columns, columns.pose or (), columns.pose_sizes, "pose")
    read = {6: _turned, 7: _ordered}.get(numbers.shape[1], _of_matrices)
    place, turns = read(numbers, columns)
    wrong = bad_pose(place, turns)
    if wrong is not None:
        raise errors.ItemError("pose", wrong[1])
    if columns.frame is not None:
        turn, shift = _frame(columns)
        place = place @ turn.T + shift
        turns = (spatial.Rotation.from_matrix(turn) * spatial.Rotation.from_quat(turns)).as_quat()
    _require_metres(place, "pose")
    return np.hstack([place, turns])


def times_s(values: pa.Array, columns: import_columns.ImportColumns) -> Float64:
    """Return times in seconds, shape (n,); ItemError for anything but finite numbers or points in time.

    Points in time count from 1970, UTC.
    """
    found, divisor = _instants_s(values), 1.0
    if found is None:
        divisor = units.TIME.divisor(columns.time or "", columns.time_unit)
        try:
            found = column_types.floats_of(values)
        except (ValueError, OverflowError):
            found = np.empty(0)
    if found.ndim == 2 and found.shape[1] == 1:
        found = found[:, 0]
    is_flat = found.shape == (len(values),)
    if not is_flat or not np.isfinite(found).all():
        wrong = int(np.isfinite(found).argmin()) if is_flat else 0
        raise errors.ItemError(
            "time",
            f"the times {shown(values.slice(wrong, 4).to_pylist())} from number {wrong + 1:,} on; "
            "expected finite numbers, or points in time",
        )
    return found / divisor


def _instants_s(values: pa.Array) -> Float64 | None:
    """Return points in time, also as text, in seconds; None for anything else."""
    if pa.types.is_string(values.type):
        for kind in _INSTANTS:
            with suppress(pa.ArrowException):
                values = values.cast(kind)
                break
    if not pa.types.is_temporal(values.type):
        return None
    kind = pa.timestamp("ns", getattr(values.type, "tz", None))
    if pa.types.is_duration(values.type):
        kind = pa.duration("ns")
    with suppress(pa.ArrowException):
        ticks = values.cast(kind).cast(pa.int64())
        return np.asarray(column_types.floats_of(ticks)) / 1e9
    return None


def _ordered(numbers: Float64, columns: import_columns.ImportColumns) -> tuple[Float64, Float64]:
    """Return positions, and quaternions x, y, z, w, of poses of seven numbers."""
    order = [3 + columns.order.index(axis) for axis in "xyzw"]
    return numbers[:, :3], numbers[:, order]


def _turned(numbers: Float64, columns: import_columns.ImportColumns) -> tuple[Float64, Float64]:
    """Return the same of six numbers, with Euler angles or rotation vectors in radians."""
    place, angles = numbers[:, :3], numbers[:, 3:]
    if columns.euler is not None:
        return place, spatial.Rotation.from_euler(columns.euler, angles).as_quat()
    if columns.angle_unit is None and np.abs(angles).max(initial=0) > _MAX_TURN:
        raise errors.ItemError(
            "pose",
            f"the rotation vector {shown(angles[0])}, in radians, turns more than twice; expected radians "
            "(--angle-unit states another unit)",
        )
    return place, spatial.Rotation.from_rotvec(angles).as_quat()


def _of_matrices(numbers: Float64, _columns: import_columns.ImportColumns) -> tuple[Float64, Float64]:
    """Return the same of matrices, shape (n, 12) or (n, 16); ItemError if one is not rigid."""
    matrices = numbers.reshape(len(numbers), -1, 4)
    if not arithmetic.are_rigid(matrices):
        raise errors.ItemError(
            "pose",
            f"the matrix {shown(numbers[0].tolist())} is no rigid transform; expected, row by row, "
            "a rotation of determinant 1 with a translation, and a last row 0 0 0 1",
        )
    return matrices[:, :3, 3], spatial.Rotation.from_matrix(matrices[:, :3, :3]).as_quat()


def _frame(columns: import_columns.ImportColumns) -> tuple[Float64, Float64]:
    """Return rotation and shift, in metres, from the frame of the source to that of the cell."""
    matrix = np.array(columns.frame)
    per_metre = columns.divisors((), 2)[0]
    return spatial.Rotation.from_matrix(matrix[:3, :3]).as_matrix(), matrix[:3, 3] / per_metre


def _require_metres(places: Float64, reason: str) -> None:
    is_far = (np.abs(places) > _FARTHEST_M[: places.shape[1]]).any(axis=1)
    if is_far.any():
        raise errors.ItemError(
            reason,
            f"the position {shown(tuple(places[is_far.argmax()].tolist()))}, in metres, lies farther outside "
            "of the cell than it is wide; expected metres in the cell frame (--length-unit states another "
            "unit, --frame another frame)",
        )


def _numbers(
    fields: Fields,
    columns: import_columns.ImportColumns,
    names: tuple[str, ...],
    sizes: tuple[int, ...],
    reason: str,
) -> Float64:
    """Return the numbers of some columns, or of one with all, shape (n, size), in metres and radians."""
    found = [fields[name] for name in names]
    try:
        parts = [column_types.floats_of(each) for each in found]
        numbers = np.hstack([part.reshape(len(part), -1) for part in parts])
    except (ValueError, OverflowError):
        numbers = np.empty((0, 0))
    if numbers.shape[1] not in sizes or not np.isfinite(numbers).all():
        first = [each[0].as_py() for each in found] if len(found[0]) else ["nothing"]
        expected = f"{sizes[0]} finite numbers"
        if len(sizes) > 1:
            counts = import_columns.expected_counts(sizes[1:])
            expected += f", or {counts} of a matrix (--euler and --rotvec are of 6)"
        raise errors.ItemError(
            reason, f"{shown(first[0] if len(first) == 1 else first)}; expected {expected}"
        )
    return numbers / columns.divisors(names, numbers.shape[1])
