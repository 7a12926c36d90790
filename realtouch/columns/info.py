"""The metadata of a stored round: columns named ``info.*``, unflattened."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.per_touch import stored_value
from realtouch.damage import damaged, missing_column
from realtouch.poses import Poses, bad_pose, rigid_transform
from tactile_toolkit.read.dataset import Row

_POSE = ("position", "quaternion")


class Info(Mapping[str, Any]):
    """A mapping that cannot be written to; pickles and copies, other than Python's own."""

    __slots__ = ("_values",)

    def __init__(self, values: Mapping[str, Any]) -> None:
        self._values = dict(values)

    def __getitem__(self, name: str) -> Any:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __or__(self, other: Mapping[str, Any]) -> dict[str, Any]:
        return self._values | dict(other)

    def copy(self) -> dict[str, Any]:
        """Return a copy that can be written to."""
        return dict(self._values)

    def __repr__(self) -> str:
        return f"Info({self._values!r})"


def has_info(row: Row) -> bool:
    """Return whether a round has metadata."""
    return row.has("info") or any(name.startswith("info.") for name in row.group.names)


def read_info(row: Row) -> Info:
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
    return Info(_with_poses(row, nested, "info"))


def _with_poses(row: Row, values: dict[str, Any], name: str) -> Any:
    """Put poses in place of groups of a position and a quaternion."""
    if values.keys() == set(_POSE):
        return _pose(row, values, name)
    return {
        key: _with_poses(row, value, f"{name}.{key}") if isinstance(value, dict) else value
        for key, value in values.items()
    }


def _pose(row: Row, values: dict[str, Any], name: str) -> Any:
    """Make the pose, or the poses where there is one per touch."""
    position, quaternion = (_numbers(row, values[part], f"{name}.{part}") for part in _POSE)
    one = position.shape == (3,) and quaternion.shape == (4,)
    count = len(position) if position.ndim else 0
    if not one and (position.shape != (count, 3) or quaternion.shape != (count, 4)):
        problem = (
            f"position {position.shape} and quaternion {quaternion.shape}; expected (3,) and (4,), or (n, 3) "
            "and (n, 4)"
        )
        raise damaged(row, name, problem)
    wrong = bad_pose(position.reshape(-1, 3), quaternion.reshape(-1, 4))
    if wrong is not None:  # the metadata of a round are one thing: none of it can be given
        raise damaged(row, name, wrong[1] if one else f"pose {wrong[0]}: {wrong[1]}")
    return rigid_transform(position, quaternion) if one else Poses(position, quaternion)


def _numbers(row: Row, values: Any, name: str) -> NDArray[np.float64]:
    try:
        return np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        problem = "values that are not numbers, or vectors of several lengths; expected a pose's numbers"
        raise damaged(row, name, problem) from error
