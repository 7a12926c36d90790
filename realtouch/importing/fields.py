"""What the fields of a source say of touches and pictures, in our units; each is refused with the reason."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, cast

import numpy as np

from realtouch.import_columns import ImportColumns, expected_counts
from realtouch.poses import bad_pose
from tactile_toolkit.arithmetic import are_rigid
from tactile_toolkit.array_types import AnyArray, Float64
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.units import TIME

NUMBERED = "label"
"""The field of our own exports that numbers the classes."""

UNKNOWN = ("-1", "-1.0")
"""The number of a class that is not known, as `datasets` has it."""

Fields = Mapping[str, Sequence[object] | AnyArray]
"""Columns by their names, each with an entry for every touch or picture."""

_NUMBER = re.compile(r"^(0|[1-9][0-9]*)(?:\.0+)?\Z")
_DECIMAL_COMMA = re.compile(r"\s*[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?\s*")
_LIST = re.compile(r"[\[\](),;]")
_LONGEST_SHOWN = 80  # letters of a value that a message repeats
_LONGEST_INTEGER = 18  # digits
# The cell is 0.12 m wide. What lies farther from it than that, or three times as high, is in another unit.
_FARTHEST_M = (0.18, 0.18, 0.36)
_MOST_TURN = 4 * np.pi  # of a rotation vector; a longer one is in degrees
_NO_TILT = 1e-6  # of a frame by which x and y alone can be transformed


def text_of(values: Mapping[str, object], name: str | None) -> str:
    """Return a value as text; empty for null, NaN, lists and objects of JSON."""
    value = values.get(name) if name else None
    if value is None or isinstance(value, (list, dict, np.ndarray)) or value != value:
        return ""
    return str(value).strip()


def shown(text: object) -> str:
    """Return the beginning of a value, for a message."""
    return str(text)[:_LONGEST_SHOWN]


def integer_text(text: str) -> str:
    """Return ``"3"`` for ``"3.0"``: programs write integers so in a column with gaps."""
    if text.isdecimal() or "." not in text:  # most of them
        return text
    return _NUMBER.sub(r"\1", text)


def label_of(values: Mapping[str, object], column: str | None, numbers: Mapping[str, int]) -> int:
    """Return the number of the class, -1 if it is unknown; ItemError if it is not a class.

    ``numbers`` are those of the classes by name.
    """
    stated = values.get(column or NUMBERED)
    if isinstance(stated, (list, dict)):
        raise ItemError("label", f"the label {shown(stated)}; expected a name or a number")
    label = text_of(values, column) or text_of(values, NUMBERED)
    if not numbers or label in UNKNOWN:
        return -1
    number = numbers.get(label, numbers.get(integer_text(label)))
    if number is None:
        raise ItemError("label", f"the label {shown(label)!r}; expected a class")
    return number


def object_of(values: Mapping[str, object], column: str | None) -> int:
    """Return the number of the object, 0 without a column of them; ItemError for anything else."""
    if not column:
        return 0
    text = integer_text(text_of(values, column))
    if not (text.isdecimal() and text.isascii() and len(text) <= _LONGEST_INTEGER):
        raise ItemError("object", f"the object {shown(text)!r}; expected an integer")
    return int(text)


def each_of(
    read: Callable[[Fields, ImportColumns], Float64], values: Fields, columns: ImportColumns, count: int
) -> tuple[Float64 | None, dict[int, ItemError]]:
    """Read all touches or pictures at once, or one by one where some are wrong.

    Returns an array with an entry for each, and what is wrong with those that cannot be used; without a
    single one that can, there is no array.
    """
    try:
        return read(values, columns), {}
    except ItemError:
        pass
    problems: dict[int, ItemError] = {}
    found: Float64 | None = None
    for number in range(count):
        try:
            (each,) = read({name: column[number : number + 1] for name, column in values.items()}, columns)
        except ItemError as error:
            problems[number] = error
        else:
            if found is None:
                found = np.full((count, *np.shape(each)), np.nan)
            found[number] = each
    return found, problems


def positions(values: Fields, columns: ImportColumns) -> Float64:
    """Return intended positions, x and y in metres, cell frame, shape (n, 2).

    Raises ItemError for anything else; InputError for a frame that makes them depend on a height.
    """
    place = _numbers(values, columns, columns.position or (), (2,), "position")
    if columns.frame is not None:
        turn, shift = _frame(columns)
        if np.abs(turn[:2, 2]).max() > _NO_TILT:
            raise InputError(
                "the frame tilts, so that an x and y of the source is no x and y of the cell",
                next="leave out the positions: --map position=",
            )
        place = place @ turn[:2, :2].T + shift[:2]
    _require_metres(place, "position")
    return place


def poses(values: Fields, columns: ImportColumns) -> Float64:
    """Return poses in the cell frame, shape (n, 7): position in metres, quaternion x, y, z, w.

    Raises ItemError for anything else.
    """
    numbers = _numbers(values, columns, columns.pose or (), columns.pose_sizes, "pose")
    read = {6: _turned, 7: _ordered}.get(numbers.shape[1], _of_matrices)
    place, turns = read(numbers, columns)
    wrong = bad_pose(place, turns)
    if wrong is not None:
        raise ItemError("pose", wrong[1])
    if columns.frame is not None:
        from scipy.spatial.transform import Rotation

        turn, shift = _frame(columns)
        place = place @ turn.T + shift
        turns = (Rotation.from_matrix(turn) * Rotation.from_quat(turns)).as_quat()
    _require_metres(place, "pose")
    return np.hstack([place, turns])


def times_s(values: Sequence[object] | AnyArray, columns: ImportColumns) -> Float64:
    """Return times in seconds, shape (n,); ItemError for anything but finite numbers or points in time."""
    found = np.asarray(values)
    if found.dtype.kind in "mM":
        unit = np.datetime_data(found.dtype)[0]
        if np.isnat(found).any() or unit == "generic":
            raise ItemError("time", "a time is missing; expected one for each picture")
        return found.astype(f"{found.dtype.kind}8[ns]").astype(np.int64) / 1e9
    try:
        times = _floats(values)
    except (TypeError, ValueError, OverflowError):
        times = np.empty(0)
    if times.ndim == 2 and times.shape[1] == 1:
        times = times[:, 0]
    if times.shape != (len(values),) or not np.isfinite(times).all():
        wrong = int(np.isfinite(times).argmin()) if times.shape == (len(values),) else 0
        what = f"the times {shown(list(values[wrong : wrong + 4]))} from number {wrong + 1:,} on"
        raise ItemError("time", f"{what}; expected finite numbers")
    return times / TIME.divisor(columns.time or "", columns.time_unit)


def _ordered(numbers: Float64, columns: ImportColumns) -> tuple[Float64, Float64]:
    """Return positions, and quaternions x, y, z, w, of poses of seven numbers."""
    order = [3 + columns.order.index(axis) for axis in "xyzw"]
    return numbers[:, :3], numbers[:, order]


def _turned(numbers: Float64, columns: ImportColumns) -> tuple[Float64, Float64]:
    """Return the same of six numbers, with Euler angles or rotation vectors in radians."""
    from scipy.spatial.transform import Rotation

    place, angles = numbers[:, :3], numbers[:, 3:]
    if columns.euler is not None:
        return place, Rotation.from_euler(columns.euler, angles).as_quat()
    if columns.angle_unit is None and np.abs(angles).max(initial=0) > _MOST_TURN:
        raise ItemError(
            "pose",
            f"the rotation vector {shown(angles[0])}, in radians, turns more than twice; expected radians "
            "(--angle-unit states another unit)",
        )
    return place, Rotation.from_rotvec(angles).as_quat()


def _of_matrices(numbers: Float64, _columns: ImportColumns) -> tuple[Float64, Float64]:
    """Return the same of matrices, shape (n, 12) or (n, 16); ItemError if one is not rigid."""
    from scipy.spatial.transform import Rotation

    matrices = numbers.reshape(len(numbers), -1, 4)
    if not are_rigid(matrices):
        raise ItemError(
            "pose",
            f"the matrix {shown(numbers[0].tolist())} is no rigid transform; expected, row by row, "
            "a rotation of determinant 1 with a translation, and a last row 0 0 0 1",
        )
    return matrices[:, :3, 3], Rotation.from_matrix(matrices[:, :3, :3]).as_quat()


def _frame(columns: ImportColumns) -> tuple[Float64, Float64]:
    """Return rotation and shift, in metres, from the frame of the source to that of the cell."""
    from scipy.spatial.transform import Rotation

    matrix = np.array(columns.frame)
    per_metre = columns.divisors((), 2)[0]
    return Rotation.from_matrix(matrix[:3, :3]).as_matrix(), matrix[:3, 3] / per_metre


def _require_metres(places: Float64, reason: str) -> None:
    is_far = (np.abs(places) > _FARTHEST_M[: places.shape[1]]).any(axis=1)
    if is_far.any():
        raise ItemError(
            reason,
            f"the position {shown(tuple(places[is_far.argmax()].tolist()))}, in metres, lies farther outside "
            "of the cell than it is wide; expected metres in the cell frame (--length-unit states another "
            "unit, --frame another frame)",
        )


def _numbers(
    values: Fields, columns: ImportColumns, names: tuple[str, ...], sizes: tuple[int, ...], reason: str
) -> Float64:
    """Return the numbers of some columns, or of one with all, shape (n, size), in metres and radians."""
    found: Any = [values[name] for name in names]
    try:
        if len(names) == 1:
            found = _words(found[0])
            numbers = _floats(found)
        else:
            if len(names) not in sizes:  # vectors, which tables have as text
                found = list(map(_words, found))
            numbers = np.hstack([_floats(each).reshape(len(each), -1) for each in found])
    except (TypeError, ValueError, OverflowError):
        numbers = np.empty((0, 0))
    is_nested = numbers.ndim == 3 and numbers.shape[1:] in ((3, 4), (4, 4))
    if is_nested:
        numbers = numbers.reshape(len(numbers), -1)
    if numbers.ndim != 2 or numbers.shape[1] not in sizes or not np.isfinite(numbers).all():
        first = found[0] if len(names) == 1 else [each[0] for each in found]
        expected = f"{sizes[0]} finite numbers"
        if len(sizes) > 1:
            expected += f", or {expected_counts(sizes[1:])} of a matrix (--euler and --rotvec are of 6)"
        raise ItemError(reason, f"{shown(first)}; expected {expected}")
    return numbers / columns.divisors(names, numbers.shape[1])


def _words(values: Sequence[object] | AnyArray) -> Any:
    """Return values with lists in place of texts that hold several numbers."""
    if isinstance(values, np.ndarray):
        return values
    return [_LIST.sub(" ", value).split() if isinstance(value, str) else value for value in values]


def _floats(values: Sequence[object] | AnyArray) -> Float64:
    """Return numbers, or lists of numbers, as an array, shape (n, ...)."""
    if isinstance(values, np.ndarray) and values.dtype.kind in "iuf":
        return values.astype(np.float64)
    if {float, int}.issuperset(map(type, values)):
        return np.array(values, np.float64)
    with suppress(TypeError, ValueError):  # of one number of a table each
        text = "".join(cast(Sequence[str], values))
        if "_" not in text and "," not in text:
            return np.array(list(map(float, values)))
    return np.array(list(map(_number, values)), np.float64)


def _number(value: Any) -> Any:
    """Return a number or a list of numbers; ValueError or TypeError for anything else.

    A comma inside a number is the decimal mark, as spreadsheets of some countries write it.
    """
    if isinstance(value, str):
        return number_of(value)
    if isinstance(value, (list, tuple, np.ndarray)):
        return list(map(_number, value))
    return float(value)


def number_of(text: str) -> float:
    """Return the number that a text is; ValueError for anything else."""
    if "_" in text:  # which Python passes over
        raise ValueError
    if _DECIMAL_COMMA.fullmatch(text):
        text = text.replace(",", ".")
    return float(text)
