"""Where something is wrong: file, row, touch and field, in the same words everywhere."""

from __future__ import annotations

from dataclasses import dataclass

from dataset_store.errors import InputError, IntegrityError
from dataset_store.records import Row

__all__ = ["Damage", "damaged", "missing_column"]

_NEXT = "next: run `realtouch verify` to list everything that is wrong, then download or convert again"


@dataclass(frozen=True, slots=True)
class Damage:
    """One thing that is wrong with a stored round.

    Attributes
    ----------
    file : str
        Parquet file.
    row : int or None
        Row in that file; None when the whole file is meant.
    touch : int or None
        Touch of the round; None when the whole round is meant.
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


def missing_column(row: Row, field: str) -> InputError:
    """Return the error for a column that was asked for and that the data set does not have."""
    there = ", ".join(row.group.names)
    return InputError(
        f"{row.path!r} has no column {field!r} (it has {there}); next: use a data set that has it, such as "
        "the `seq` or the `single` form of the same touches"
    )
