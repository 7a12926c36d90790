"""Where something is wrong: file, row, touch and field, in the same words everywhere."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from tactile_toolkit.errors import InputError, IntegrityError, ToolkitError
from tactile_toolkit.read.dataset import Row
from tactile_toolkit.read.parquet import Shard

_NEXT = "next: run `realtouch verify` to list everything that is wrong, then download or convert again"


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
        parts = [repr(self.file)]
        parts += [f"row {self.row}"] if self.row is not None else []
        parts += [f"touch {self.touch}"] if self.touch is not None else []
        parts += [f"field {self.field!r}"] if self.field else []
        return f"{', '.join(parts)}: {self.problem}"


class DamagedRoundError(IntegrityError):
    """An :class:`IntegrityError` that carries its :class:`Damage`; internal, catch ``IntegrityError``."""

    def __init__(self, damage: Damage) -> None:
        super().__init__(f"{damage}; {_NEXT}")
        self.damage = damage

    def __reduce__(self) -> tuple[object, ...]:
        return (DamagedRoundError, (self.damage,))


def damaged(row: Row, field: str, problem: str, touch: int | None = None) -> DamagedRoundError:
    """Return the error for a field of a row that cannot be used."""
    return DamagedRoundError(Damage(row.path, row.number, touch, field, problem))


@contextmanager
def naming(row: Row, field: str, touch: int | None = None, where: str = "") -> Iterator[None]:
    """Turn a ValueError into damage of a field of a row."""
    try:
        yield
    except ValueError as error:
        raise damaged(row, field, f"{where}{error}", touch) from error


def missing_column(row: Row, field: str) -> InputError:
    """Return the error for a column that was asked for and that the data set does not have."""
    return InputError(
        f"{row.path!r} has no column {field!r}",
        next="use a data set that has it, such as the `seq` or the `single` form of the same touches",
    )


def unreadable_file(path: str, error: ToolkitError) -> Damage:
    """Return the damage of an entire file, from the error that opening it raised."""
    words = _cause(path, error)
    named = re.fullmatch(r"field '([^']+)': (.*)", words)
    return Damage(path, None, None, *(named.groups() if named else ("", words)))


def unreadable_rows(shard: Shard, index: int, error: IntegrityError) -> Damage:
    """Return the damage of a row group, from the error that reading it raised; ``row`` is its first row."""
    first, stop = shard.group_starts[index], shard.group_starts[index + 1]
    rows = f"rows {first} to {stop - 1} cannot be read" if stop - first > 1 else "cannot be read"
    found = _cause(shard.path, error) if error.__cause__ is None else " ".join(str(error.__cause__).split())
    return Damage(shard.path, first, None, "", f"{rows} ({found}); expected a whole Parquet file")


def _cause(path: str, error: ToolkitError) -> str:
    """Return what an error says, without the file and the next step, which a list names once for all."""
    words = " ".join(str(error).split()).partition("; next: ")[0]
    return words.removeprefix(repr(path)).lstrip(",: ")
