"""Damage of stored touches: what is wrong, where, and how errors and lists state it."""

from __future__ import annotations

import re
from dataclasses import dataclass

from tactile_toolkit import read
from tactile_toolkit.errors import IntegrityError, ToolkitError

_NEXT = "run `realtouch verify` to list everything that is wrong, then download or convert again"
_FIELD = re.compile(r"field '([^']+)': (.*)")


@dataclass(frozen=True, slots=True)
class Damage:
    """One thing that is wrong with a stored round.

    Attributes
    ----------
    file : str
        Parquet file.
    row : int or None
        Row in that file, the first one where the problem names several; None when all of the file is meant.
    touch : int or None
        Touch of the round; None when all of the round is meant.
    field : str
        Column; empty when no single one is meant.
    problem : str
        What was found, and what was expected.
    """

    file: str
    row: int | None
    touch: int | None
    field: str
    problem: str

    def __str__(self) -> str:
        named = {"row": self.row, "touch": self.touch, "field": self.field and repr(self.field)}
        parts = [f"{name} {value}" for name, value in named.items() if value not in (None, "")]
        return f"{', '.join([repr(self.file), *parts])}: {self.problem}"


class DamagedRoundError(IntegrityError):
    """An :class:`IntegrityError` that carries its :class:`Damage`; internal, catch ``IntegrityError``."""

    def __init__(self, damage: Damage) -> None:
        super().__init__(damage, next=_NEXT)
        self.damage = damage

    def __reduce__(self) -> tuple[object, ...]:
        return (DamagedRoundError, (self.damage,))


def unreadable_file(path: str, error: ToolkitError) -> Damage:
    """Return the damage of an entire file, from the error that opening it raised."""
    words = _cause(path, error)
    named = _FIELD.match(words)
    if named is None:
        return Damage(path, None, None, "", words)
    return Damage(path, None, None, named[1], named[2])


def unreadable_rows(shard: read.Shard, index: int, error: IntegrityError) -> Damage:
    """Return the damage of a row group, from the error that reading it raised; ``row`` is its first row."""
    first, last = shard.group_starts[index], shard.group_starts[index + 1] - 1
    rows = "cannot be read"
    if last > first:
        rows = f"rows {first} to {last} cannot be read"
    found = " ".join(str(error.__cause__ or _cause(shard.path, error)).split())
    return Damage(shard.path, first, None, "", f"{rows} ({found}); expected a whole Parquet file")


def _cause(path: str, error: ToolkitError) -> str:
    """Return what an error says, without the file and the next step, which a list names once for all."""
    words = " ".join(error.what.split())
    return words.removeprefix(repr(path)).lstrip(",: ")
