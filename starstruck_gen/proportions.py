"""Kinds of shapes: their proportions, and the outline that follows from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

from tactile_toolkit.array_types import Float64
from tactile_toolkit.builtin_values import to_builtin_number
from tactile_toolkit.errors import InputError

Outline = tuple[Float64, ...]
"""Rings of corners, each of shape (n, 2): the outer one counter-clockwise, holes clockwise."""

_LARGEST = 1e6  # where a kind declares no range

KINDS: dict[str, type[Proportions]] = {}
"""Kinds of shapes by name: those of the toolkit, and those that users register."""


def within(published: float, least: float, most: float) -> Any:
    """Declare a number with its default and the range it must keep to."""
    return field(default=published, metadata={"least": least, "most": most})


@dataclass(frozen=True, slots=True)
class Proportions:
    """Proportions of a kind of shape, without its size. The defaults are those of the kind.

    Raises
    ------
    InputError
        When a number is outside its range; the message names shape, field, what was found and expected.
    """

    name: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for entry in fields(self):
            kind: Any = type(entry.default)
            least, most = entry.metadata.get("least", -_LARGEST), entry.metadata.get("most", _LARGEST)
            value = to_builtin_number(getattr(self, entry.name), float)
            if not (isinstance(value, float) and least <= value <= most and kind(value) == value):
                raise InputError(
                    f"{entry.name} of shape {self.name!r} is {getattr(self, entry.name)!r}; expected "
                    f"{'an integer from ' if kind is int else ''}{least:g} to {most:g}"
                )
            # Whole and plain numbers have one spelling, so that equal proportions have equal JSON and keys.
            object.__setattr__(self, entry.name, kind(value))

    def rings(self) -> Outline:
        """Return the rings of the outline, read-only; unit: the circumscribed radius."""
        raise NotImplementedError

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the class, so that a worker that never heard of the kind knows it from then on."""
        return (_unpickled, (type(self), self.to_dict()))

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Proportions:
        """Rebuild proportions from :meth:`to_dict`; what is missing takes its default.

        Raises
        ------
        InputError
            Unknown field, or a value that cannot be used.
        """
        known = [entry.name for entry in fields(cls)]
        unknown = [name for name in values if name not in known]
        if unknown:
            expected = f"one of {', '.join(known)}" if known else "none"
            raise InputError(f"unknown proportion {unknown[0]!r} of shape {cls.name!r}; expected {expected}")
        return cls(**values)


def _unpickled(kind: type[Proportions], values: dict[str, Any]) -> Proportions:
    # Unchecked: the process that pickled it has registered, and so checked, the kind.
    if kind.name:
        KINDS.setdefault(kind.name, kind)
    return kind(**values)
