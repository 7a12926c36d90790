"""Damage of stored touches."""

from __future__ import annotations

import re
from dataclasses import dataclass

from tactile_toolkit import errors, read

_NEXT = "run `tactile verify` to list everything that is wrong, then download or convert again"
_FIELD = re.compile(r"field '([^']+)': (.*)")


@dataclass(frozen=True, slots=True)
class Damage:
    """Damage of a file, round or touch.

    Attributes
    ----------
    file : str
        Parquet file.
    row : int or None
        Row in that file, the first one if the problem names several; None if the whole file is meant.
    touch : int or None
        Touch of the round; None if the whole round is meant.
    field : str
        Column; empty if no single column is meant.
    problem : str
        What was found, and what was expected.
    """

    file: str
    row: int | None
    touch: int | None
    field: str
    problem: str

    def __str__(self) -> str:
        named: dict[str, object] = {"row": self.row, "touch": self.touch}
        if self.field:
            named["field"] = repr(self.field)
        parts = [f"{name} {value}" for name, value in named.items() if value is not None]
        return f"{', '.join([repr(self.file), *parts])}: {self.problem}"


class DamagedRoundError(errors.IntegrityError):
    """An :class:`IntegrityError` that carries its :class:`Damage`; internal, catch ``IntegrityError``."""

    def __init__(self, damage: Damage) -> None:
        super().__init__(damage, next=_NEXT)
        self.damage = damage

    def __reduce__(self) -> tuple[object, ...]:
        return (DamagedRoundError, (self.damage,))


def unreadable_file(path: str, error: errors.ToolkitError) -> Damage:
    """Return the damage of an entire file, from the error that opening it raised."""
    words = _cause(path, error)
    named = _FIELD.match(words)
    if named is None:
        return Damage(path, None, None, "", words)
    return Damage(path, None, None, named[1], named[2])


def unreadable_rows(shard: read.Shard, index: int, error: errors.IntegrityError) -> Damage:
    """Return the damage of a row group, from the error that reading it raised; ``row`` is its first row."""
    first = shard.group_starts[index]
    last = shard.group_starts[index + 1] - 1
    rows = f"rows {first} to {last} cannot be read" if last > first else "cannot be read"
    cause = " ".join(str(error.__cause__ or _cause(shard.path, error)).split())
    return Damage(shard.path, first, None, "", f"{rows} ({cause}); expected a whole Parquet file")


def _cause(path: str, error: errors.ToolkitError) -> str:
    """Return the message of an error without file and next step, which a list states once."""
    words = " ".join(error.what.split())
    return words.removeprefix(repr(path)).lstrip(",: ")
