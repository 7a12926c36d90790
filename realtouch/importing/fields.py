"""Fields of a source as columns of a data set, in its units; wrong values are refused with a reason."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from realtouch.importing import import_options, source_files, source_touches
from realtouch.touches.poses import bad_pose
from tactile_toolkit import errors, wording
from tactile_toolkit.columns import column_types, units
from tactile_toolkit.value_types import Float64, Int64

UNKNOWN = ("-1", "-1.0")
"""Numbers of an unknown class, as in `datasets`."""
Fields = Mapping[str, pa.Array]
"""Columns by name, each with an entry for every touch or picture."""
_WHOLE = re.compile(r"^(0|[1-9][0-9]*)(?:\.0+)?\Z")
_LONGEST_SHOWN = 80  # characters of a value in a message
_LONGEST_INTEGER = 18  # digits

# The cell is 0.12 m wide. A position over 0.12 m outside of it, or over 0.36 m high, is in another unit.
_FARTHEST_M = (0.18, 0.18, 0.36)
_MAX_TURN = 4 * np.pi  # radians; a longer rotation vector is in degrees
_MAX_TILT = 1e-6  # of a frame that can transform x and y without the height
_INSTANTS = (pa.timestamp("ns", "UTC"), pa.timestamp("ns"))

_RIGID_TOLERANCE = 1e-3  # of lengths of axes and of the last row
_SEPARATORS = re.compile(r"[\[\](){},;]")  # of the numbers of a matrix
_NUMPY_MARK = b"\x93NUMPY"


def shown(text: object) -> str:
    """Return the beginning of a value, for a message."""
    return str(text)[:_LONGEST_SHOWN]


def integer_text(text: str) -> str:
    """Return ``"3"`` for ``"3.0"``, as programs write integers in a column with missing values."""
    if text.isdecimal() or "." not in text:  # the usual case, decided fast
        return text
    return _WHOLE.sub(r"\1", text)


def labels_of(
    touches: source_touches.SourceTouches, column: str | None, names: Sequence[str]
) -> tuple[Int64, dict[int, errors.ItemError]]:
    """Return the class number of each touch, -1 if it is unknown, and the problems by index."""
    numbers = {name: number for number, name in reversed([*enumerate(names)])}
    problems = _nested_labels(touches.value(column or source_files.NUMBERED))
    labels = np.full(len(touches), -1)
    if not numbers:
        return labels, problems
    number_of: dict[str, int | None] = dict.fromkeys(UNKNOWN, -1)
    stated = zip(touches.texts(column), touches.texts(source_files.NUMBERED), strict=True)
    for index, (name, digits) in enumerate(stated):
        label = name or digits
        if label not in number_of:
            number_of[label] = numbers.get(label, numbers.get(integer_text(label)))
        number = number_of[label]
        if number is None:
            problems[index] = errors.ItemError("label", f"the label {shown(label)!r}; expected a class")
        else:
            labels[index] = number
    return labels, problems


def _nested_labels(column: pa.Array | None) -> dict[int, errors.ItemError]:
    """Return a problem for each label that is a JSON list or object."""
    values = [] if column is None else column_types.values_of(column)
    return {
        index: errors.ItemError("label", f"the label {shown(value)}; expected a name or a number")
        for index, value in enumerate(values)
        if isinstance(value, (dict, list))
    }


def objects_of(
    touches: source_touches.SourceTouches, column: str | None
) -> tuple[Int64, dict[int, errors.ItemError]]:
    """Return the object id of each touch, 0 without such a column, and the problems by index."""
    object_ids = np.zeros(len(touches), np.int64)
    problems = dict[int, errors.ItemError]()
    if not column:
        return object_ids, problems
    for index, text in enumerate(map(integer_text, touches.texts(column))):
        if text.isdecimal() and text.isascii() and len(text) <= _LONGEST_INTEGER:
            object_ids[index] = int(text)
        else:
            problems[index] = errors.ItemError("object", f"the object {shown(text)!r}; expected an integer")
    return object_ids, problems


def each_of(
    read: Callable[[Fields, import_options.ImportColumns], Float64],
    fields: Fields,
    columns: import_options.ImportColumns,
    rows: Int64,
    shape: tuple[int, ...] = (),
) -> tuple[Float64, dict[int, errors.ItemError]]:
    """Read the values of some touches or pictures at once, or in smaller parts where some are wrong.

    Returns an array with an entry of the ``shape`` for every touch or picture of the fields, NaN where
    nothing was read, and the problems by index.
    """
    problems: dict[int, errors.ItemError] = {}
    values = np.full((max(map(len, fields.values())), *shape), np.nan)
    parts = [rows] if len(rows) else []
    while parts:
        part = parts.pop()
        some = {name: column.take(pa.array(part)) for name, column in fields.items()}
        try:
            values[part] = read(some, columns)
        except errors.ItemError as error:
            if len(part) == 1:
                problems[int(part[0])] = error
            else:
                parts += np.array_split(part, 2)[::-1]
    return values, dict(sorted(problems.items()))


def stated_positions(fields: Fields, columns: import_options.ImportColumns) -> Float64:
    """Return intended positions, x and y in metres, cell frame, shape (n, 2).

    Raises ItemError for other values, and InputError for a tilted frame, as x and y then depend on the
    height.
    """
    position_m = _numbers(fields, columns, columns.position or (), (2,), "position")
    if columns.frame is not None:
        turn, shift = _frame(columns)
        if np.abs(turn[:2, 2]).max() > _MAX_TILT:
            raise errors.InputError(
                "the frame tilts, so that x and y in the cell depend on the height in the source",
                next="leave out the positions: --map position=",
            )
        position_m = position_m @ turn[:2, :2].T + shift[:2]
    _require_metres(position_m, "position")
    return position_m


def poses(fields: Fields, columns: import_options.ImportColumns) -> Float64:
    """Return poses in the cell frame, shape (n, 7): position in metres, quaternion x, y, z, w.

    Raises ItemError for other values.
    """
    numbers = _numbers(fields, columns, columns.pose or (), columns.pose_sizes, "pose")
    read = {6: _of_angles, 7: _of_quaternions}.get(numbers.shape[1], _of_matrices)
    position_m, turns = read(numbers, columns)
    wrong = bad_pose(position_m, turns)
    if wrong is not None:
        raise errors.ItemError("pose", wrong[1])
    if columns.frame is not None:
        turn, shift = _frame(columns)
        position_m = position_m @ turn.T + shift
        turns = (Rotation.from_matrix(turn) * Rotation.from_quat(turns)).as_quat()
    _require_metres(position_m, "pose")
    return np.hstack([position_m, turns])


def times_s(values: pa.Array, name: str, time_unit: str | None) -> Float64:
    """Return times in seconds, shape (n,); points in time count from 1970, UTC.

    The ``name`` of the column states the unit of numbers, or ``time_unit`` does; else they are seconds.
    Raises ItemError for values that are neither finite numbers nor points in time.
    """
    seconds = _instants_s(values)
    divisor = 1.0
    if seconds is None:
        divisor = units.Quantity.TIME.divisor(name, time_unit)
        try:
            seconds = column_types.floats_of(values)
        except (ValueError, OverflowError):
            seconds = np.empty(0)
    if seconds.ndim == 2 and seconds.shape[1] == 1:
        seconds = seconds[:, 0]
    is_flat = seconds.shape == (len(values),)
    if not is_flat or not np.isfinite(seconds).all():
        wrong = int(np.isfinite(seconds).argmin()) if is_flat else 0
        raise errors.ItemError(
            "time",
            f"the times {shown(values.slice(wrong, 4).to_pylist())} from number {wrong + 1:,} on; "
            "expected finite numbers, or points in time",
        )
    return seconds / divisor


def _instants_s(values: pa.Array) -> Float64 | None:
    """Return points in time, also those in text, and durations in seconds; None for other values."""
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


def _of_quaternions(numbers: Float64, columns: import_options.ImportColumns) -> tuple[Float64, Float64]:
    """Return positions and quaternions x, y, z, w of poses of seven numbers."""
    order = [3 + columns.order.index(axis) for axis in "xyzw"]
    return numbers[:, :3], numbers[:, order]


def _of_angles(numbers: Float64, columns: import_options.ImportColumns) -> tuple[Float64, Float64]:
    """Return positions and quaternions of poses with Euler angles or rotation vectors in radians."""
    position, angles = numbers[:, :3], numbers[:, 3:]
    if columns.euler is not None:
        return position, Rotation.from_euler(columns.euler, angles).as_quat()
    if columns.angle_unit is None and np.abs(angles).max(initial=0) > _MAX_TURN:
        raise errors.ItemError(
            "pose",
            f"the rotation vector {shown(angles[0])} has more than two turns in radians; expected radians "
            "(--angle-unit states another unit)",
        )
    return position, Rotation.from_rotvec(angles).as_quat()


def read_frame(path: str | os.PathLike[str]) -> import_options.Matrix:
    """Read a rigid transform, 4 x 4 numbers, from a file of text, CSV, JSON or NPY.

    Raises InputError if the file cannot be read or holds no rigid transform.
    """
    content = import_options.content_of(path)
    values: object = content
    if not content.startswith(_NUMPY_MARK):
        words = _SEPARATORS.sub(" ", content.decode("utf-8-sig", errors="replace")).split()
        values = [words[start : start + 4] for start in range(0, len(words), 4)]
    return rigid_frame(values, repr(os.fspath(path)))


def rigid_frame(values: object, source: str) -> import_options.Matrix:
    """Return a 4 x 4 matrix, or the content of an NPY file with one, as tuples.

    Raises InputError if it is not a rigid transform.
    """
    try:
        if isinstance(values, bytes):
            values = np.load(io.BytesIO(values), allow_pickle=False)
        matrix = np.array(values, np.float64)
    except (TypeError, ValueError, OverflowError, EOFError, OSError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4):
        raise errors.InputError(f"the frame {source} is no matrix of numbers; expected 4 x 4 numbers")
    if not np.isfinite(matrix).all() or not _are_rigid(matrix[None]):
        raise errors.InputError(
            f"the frame {source} is no rigid transform; expected a rotation of determinant 1, a translation, "
            "and the last row 0 0 0 1"
        )
    return tuple(map(tuple, matrix.tolist()))


def _are_rigid(matrices: Float64) -> bool:
    """Return whether matrices, shape (n, 3 or 4, 4), all rotate and shift, and do nothing else."""
    turns = matrices[:, :3, :3]
    is_unit = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(initial=0) <= _RIGID_TOLERANCE
    is_last = np.abs(matrices[:, 3:] - np.array([0, 0, 0, 1])).max(initial=0) <= _RIGID_TOLERANCE
    return bool(is_unit and is_last and (np.linalg.det(turns) > 0).all())


def _of_matrices(numbers: Float64, _columns: import_options.ImportColumns) -> tuple[Float64, Float64]:
    """Return positions and quaternions of matrices, (n, 12) or (n, 16); ItemError if one is not rigid."""
    matrices = numbers.reshape(len(numbers), -1, 4)
    if not _are_rigid(matrices):
        raise errors.ItemError(
            "pose",
            f"the matrix {shown(numbers[0].tolist())} is no rigid transform; expected, row by row, "
            "a rotation of determinant 1 with a translation, and a last row 0 0 0 1",
        )
    return matrices[:, :3, 3], Rotation.from_matrix(matrices[:, :3, :3]).as_quat()


def _frame(columns: import_options.ImportColumns) -> tuple[Float64, Float64]:
    """Return rotation and translation, in metres, from the frame of the source to the cell frame."""
    matrix = np.array(columns.frame)
    per_metre = columns.divisors((), 2)[0]
    return Rotation.from_matrix(matrix[:3, :3]).as_matrix(), matrix[:3, 3] / per_metre


def _require_metres(position_m: Float64, reason: str) -> None:
    is_far = (np.abs(position_m) > _FARTHEST_M[: position_m.shape[1]]).any(axis=1)
    if is_far.any():
        raise errors.ItemError(
            reason,
            f"the position {shown(tuple(position_m[is_far.argmax()].tolist()))}, in metres, lies farther "
            "outside of the cell than it is wide; expected metres in the cell frame (--length-unit states "
            "another unit, --transform another frame)",
        )


def _numbers(
    fields: Fields,
    columns: import_options.ImportColumns,
    names: tuple[str, ...],
    sizes: tuple[int, ...],
    reason: str,
) -> Float64:
    """Return the numbers of columns, or of one column of lists, shape (n, size), in metres and radians."""
    stated = [fields[name] for name in names]
    try:
        parts = [column_types.floats_of(column) for column in stated]
        numbers = np.hstack([part.reshape(len(part), -1) for part in parts])
    except (ValueError, OverflowError):
        numbers = np.empty((0, 0))
    if numbers.shape[1] not in sizes or not np.isfinite(numbers).all():
        first = [column[0].as_py() for column in stated if len(column)] or ["nothing"]
        example = first[0] if len(first) == 1 else first
        expected = f"{sizes[0]} finite numbers"
        if len(sizes) > 1:
            counts = wording.alternatives(list(map(str, sizes[1:])))
            expected += f", or {counts} of a matrix (6 with --euler or --rotvec)"
        raise errors.ItemError(reason, f"{shown(example)}; expected {expected}")
    return numbers / columns.divisors(names, numbers.shape[1])
