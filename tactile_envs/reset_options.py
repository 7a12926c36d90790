"""Options of a reset: which objects, where they lie, and where the first touches go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.errors import InputError

Rows = slice | Int64
"""Numbers of environments, or a slice of them."""

EVERY = slice(None)
"""All environments."""

_NUMBERS, _POSES, _PLACES = "datapoint_idx", "initial_object_pose", "initial_sensor_target_pose"
_RESET_MASK = "reset_mask"
_OPTIONS = (_NUMBERS, _POSES, _PLACES, _RESET_MASK)


@dataclass(frozen=True)
class ResetOptions:
    """Options of a reset, one value for each environment; None if it is drawn.

    ``rows`` are the environments that begin an episode; ``numbers`` are those of the meshes, ``poses``
    position (x, y), metres, and turn, radians, of the objects, ``places`` the positions (x, y) of the first
    touches, metres.
    """

    rows: Rows
    numbers: list[int | None]
    poses: list[Float64 | None]
    places: list[Float64 | None]

    @classmethod
    def of(cls, options: Mapping[str, Any], num_envs: int) -> Self:
        """Check options; InputError for unknown ones, and values that cannot be used."""
        _require_options(options)
        numbers = [None if each is None else int(each) for each in _given(options, _NUMBERS, num_envs)]
        return cls(
            _rows(options, num_envs),
            numbers,
            _points(options, _POSES, num_envs, 3),
            _points(options, _PLACES, num_envs, 2),
        )

    @classmethod
    def drawn(cls, num_envs: int) -> Self:
        """Return the options of episodes of which everything is drawn."""
        return cls.of({}, num_envs)


def _require_options(options: Mapping[str, Any]) -> None:
    """Refuse options of a reset that are unknown (InputError)."""
    if unknown := [name for name in options if name not in _OPTIONS]:
        raise InputError(f"option {unknown[0]!r} is unknown; expected {', '.join(_OPTIONS)}")


def _rows(options: Mapping[str, Any], num_envs: int) -> Rows:
    """Return the environments that a mask names; all of them without one."""
    mask = options.get(_RESET_MASK)
    if mask is None:
        return EVERY
    found = np.asarray(mask)
    if found.dtype != np.bool_ or found.shape != (num_envs,) or not found.any():
        raise InputError(
            f"option {_RESET_MASK!r} is {mask!r}; expected {num_envs} times True or False, and True once at "
            "least"
        )
    if found.all():
        return EVERY
    return np.flatnonzero(found)


def _given(options: Mapping[str, Any], name: str, num_envs: int) -> Sequence[Any]:
    given = list(options.get(name, [None] * num_envs))
    if len(given) != num_envs:
        raise InputError(f"option {name!r} has {len(given)} entries; expected {num_envs}")
    return given


def _points(options: Mapping[str, Any], name: str, num_envs: int, count: int) -> list[Float64 | None]:
    """Return the first ``count`` numbers that are given for each environment, or None."""
    found: list[Float64 | None] = [None] * num_envs
    for i, given in enumerate(_given(options, name, num_envs)):
        if given is not None:
            numbers = np.asarray(given, np.float64).reshape(-1)[:count]
            if len(numbers) < count or not np.isfinite(numbers).all():
                raise InputError(f"option {name!r} has {given!r}; expected {count} numbers")
            found[i] = numbers
    return found
