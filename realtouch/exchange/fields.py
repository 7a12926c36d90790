"""What the fields of a source say of a touch, in our units; each is refused with the reason."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from realtouch.poses import bad_pose
from realtouch.touch_options import ImportColumns
from tactile_toolkit.errors import ItemError

NUMBERED = "label"
"""The field of our own exports that numbers the classes."""

UNKNOWN = ("-1", "-1.0")
"""The number of a class that is not known, as `datasets` has it."""

_NUMBER = re.compile(r"^(0|[1-9][0-9]*)(?:\.0+)?\Z")
_DECIMAL_COMMA = re.compile(r"\s*[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?\s*")
_LONGEST_SHOWN = 80  # letters of a value that a message repeats
_LONGEST_INTEGER = 18  # digits
# The cell is 0.12 m wide. What lies farther from it than that, or three times as high, is in another unit.
_FARTHEST_M = (0.18, 0.18, 0.36)


def text_of(values: Mapping[str, object], name: str | None) -> str:
    """Return a value as text; empty for null, NaN, lists and objects of JSON."""
    value = values.get(name) if name else None
    if value is None or value != value or isinstance(value, (list, dict)):
        return ""
    return str(value).strip()


def shown(text: object) -> str:
    """Return the beginning of a value, for a message."""
    return str(text)[:_LONGEST_SHOWN]


def integer_text(text: str) -> str:
    """Return ``"3"`` for ``"3.0"``: programs write integers so in a column with gaps."""
    return _NUMBER.sub(r"\1", text)


def label_of(values: Mapping[str, object], column: str | None, names: Sequence[str]) -> int:
    """Return the number of the class, -1 if it is unknown; ItemError if it is not a class."""
    if isinstance(values.get(column or NUMBERED), (list, dict)):
        raise ItemError(
            "label", f"the label {shown(values[column or NUMBERED])}; expected a name or a number"
        )
    label = text_of(values, column) or text_of(values, NUMBERED)
    if not names or label in UNKNOWN:
        return -1
    for text in (label, integer_text(label)):
        if text in names:
            return names.index(text)
    raise ItemError("label", f"the label {shown(label)!r}; expected a class")


def object_of(values: Mapping[str, object], column: str | None) -> int:
    """Return the number of the object, 0 without a column of them; ItemError for anything else."""
    if not column:
        return 0
    text = integer_text(text_of(values, column))
    if not (text.isdecimal() and text.isascii() and len(text) <= _LONGEST_INTEGER):
        raise ItemError("object", f"the object {shown(text)!r}; expected an integer")
    return int(text)


def position_of(values: Mapping[str, object], columns: ImportColumns) -> tuple[float, ...]:
    """Return the intended position, x and y in metres, or nothing; ItemError for anything else."""
    position = _numbers(values, columns, columns.position, 2, "position")
    _require_metres(position, "position")
    return position


def pose_of(values: Mapping[str, object], columns: ImportColumns) -> tuple[float, ...]:
    """Return position in metres and quaternion x, y, z, w, or nothing; ItemError if it is not a pose."""
    pose = _numbers(values, columns, columns.pose, 7, "pose")
    if not pose:
        return ()
    if columns.order == "wxyz":
        pose = (*pose[:3], *pose[4:], pose[3])
    wrong = bad_pose(np.array([pose[:3]]), np.array([pose[3:]]))
    if wrong is not None:
        raise ItemError("pose", wrong[1])
    _require_metres(pose[:3], "pose")
    return pose


def _require_metres(place: tuple[float, ...], reason: str) -> None:
    if any(abs(each) > most for each, most in zip(place, _FARTHEST_M, strict=False)):
        raise ItemError(
            reason,
            f"the position {shown(place)}, in metres, lies farther outside of the cell than it is wide; "
            "expected metres in the cell frame (--length-unit states another unit)",
        )


def _numbers(
    values: Mapping[str, object],
    columns: ImportColumns,
    names: tuple[str, ...] | None,
    count: int,
    reason: str,
) -> tuple[float, ...]:
    """Return the numbers of some columns, or of one that holds all of them, lengths in metres."""
    if not names:
        return ()
    found: Any = [values.get(name) for name in names]
    if len(names) == 1:
        found = found[0]
        if isinstance(found, str):
            found = found.replace(",", " ").strip("[]() ").split()
    numbers: tuple[float, ...] = ()
    with suppress(TypeError, ValueError, OverflowError):
        numbers = tuple(map(_number, found))
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise ItemError(reason, f"{shown(found)}; expected {count} finite numbers")
    divisors = columns.per_metre(names, count)
    return tuple(number / each for number, each in zip(numbers, divisors, strict=True))


def _number(value: Any) -> float:
    """Return a number; a comma inside is the decimal mark, as spreadsheets of some countries write it."""
    if isinstance(value, str):
        if "_" in value:  # which Python passes over
            raise ValueError
        if _DECIMAL_COMMA.fullmatch(value):
            value = value.replace(",", ".")
    return float(value)
