"""What the files and rounds of one data set have in common: kind, names of classes, touches per round."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from realtouch.damage import Damage, unreadable_file
from tactile_toolkit.catalog.locate import folder_named
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.read.source import manifest_beside
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.touch.schema import MEDIA_COLUMN, Kind, kind_of, require_types


class TouchFiles:
    """Files of one data set: each is taken only when it can be read and agrees with those before it.

    ``kind`` and ``stated_names``, those of the classes, are those of the first file that states any.
    """

    kind: Kind

    def __init__(self, where: str) -> None:
        self.where = where
        self.shards: list[Shard] = []
        self.stated_names: tuple[str, ...] | None = None

    def add(self, shard: Shard) -> None:
        """Take a file.

        Raises InputError when it is not one of touches, IntegrityError when it is damaged, a column has a
        wrong type, or it holds something else than those before it.
        """
        kind = kind_of(shard.schema, shard.path if self.shards else self.where)
        require_types(shard)
        if self.shards and kind != self.kind:
            raise IntegrityError(
                f"{shard.path!r}, field {MEDIA_COLUMN[self.kind]!r}: the column is not there; expected it as "
                f"in {self.shards[0].path!r}",
                next="open files of one data set together",
            )
        names, expected = shard.class_names, self.stated_names
        if names is not None and expected is not None and names != expected:
            raise IntegrityError(
                f"{shard.path!r}, field 'label': the classes are named {_listed(names)}; expected "
                f"{_listed(expected)} as in the files before it",
                next="open them apart, or make them again",
            )
        self.shards.append(shard)
        self.kind = kind
        self.stated_names = names if expected is None else expected

    def add_undamaged(self, shards: Iterable[Shard], *, at_least_one: bool) -> list[Damage]:
        """Take those that can be taken; return what is wrong with the others.

        Raises what is wrong with the first one when it is InputError, or, for ``at_least_one``, when none is
        left: those are not files of touches.
        """
        damage: list[Damage] = []
        first_error = None
        for shard in shards:
            try:
                self.add(shard)
            except IntegrityError as error:
                first_error = first_error or error
                damage.append(unreadable_file(shard.path, error))
            except InputError as error:
                if not self.shards:
                    raise
                damage.append(Damage(shard.path, None, None, "", str(error).partition("; next: ")[0]))
        if at_least_one and not self.shards and first_error is not None:
            raise first_error
        return damage


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")


def stated_class_names(shards: Iterable[Shard]) -> tuple[str, ...] | None:
    """Return the names of the classes as the first file that states any does; None where none does."""
    for shard in shards:
        if shard.class_names is not None:
            return shard.class_names
    return None


def usual_touch_count(shards: Sequence[Shard]) -> int | None:
    """Return the T that every round of a data set must have: that of more than half of its readable rounds.

    None where rounds may differ: no T is that of more than half, or the set has a manifest. Then rounds are
    as they were made, whose checksums are known: of imported or chosen touches, or of a set of such.
    """
    if shards and manifest_beside(shards[0]) is not None:
        return None
    counts: Counter[int] = Counter()
    for shard in shards:
        for index in range(shard.metadata.num_row_groups):
            with suppress(IntegrityError):
                counts.update(stored_touch_counts(shard, index).tolist())
    usual, rounds = counts.most_common(1)[0] if counts else (0, 0)
    return usual if 2 * rounds > counts.total() else None


def folder_meant(place: str | Sequence[str]) -> DataFolder | None:
    """Return the folder that is meant, local or in an object store; None when there is no such folder."""
    return folder_named(place) if isinstance(place, str) else None


def stored_touch_counts(shard: Shard, index: int) -> NDArray[np.int64]:
    """Return T of every row of a row group, shape (rows,), int64; reads nothing where the schema fixes it."""
    import pyarrow as pa

    name = next(name for name in ("pos_in_cell", *MEDIA_COLUMN.values()) if name in shard.types)
    data_type = shard.types[name]
    if pa.types.is_fixed_size_list(data_type):
        return np.full(shard.metadata.row_group(index).num_rows, data_type.list_size, np.int64)
    counts = [group.nested(name).lengths(0) for group in shard.blocks(index, [name])]
    return np.concatenate(counts or [np.zeros(0, np.int64)])
