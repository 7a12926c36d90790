"""What the files and rounds of one data set have in common: kind, names of classes, touches per round."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from realtouch.integrity.damage import Damage, unreadable_file
from tactile_toolkit.errors import InputError, IntegrityError
from tactile_toolkit.read.columns import stored_class_names
from tactile_toolkit.read.nested import nested_column
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import read_manifest
from tactile_toolkit.touch.schema import CLASS_NAMES, MEDIA_COLUMN, column_type, kind_of, require_types

__all__ = [
    "class_names_of",
    "local_folder",
    "require_alike",
    "sort_out",
    "stated_class_names",
    "stored_touch_counts",
    "usual_touch_count",
]


def require_alike(shards: Iterable[Shard], where: str) -> None:
    """Check that files can be read, and belong to one data set.

    Raises
    ------
    InputError
        They are no data set of touches.
    IntegrityError
        A file is damaged, a column has a wrong type, or a file holds something else than those before it.
    """
    seen: list[Shard] = []
    for shard in shards:
        kind_of(shard.schema, shard.path if seen else where)
        _require_like(shard, seen)
        seen.append(shard)


def sort_out(shards: Iterable[Shard], where: str) -> tuple[tuple[Shard, ...], list[Damage]]:
    """Part files that can be read and belong to one data set from the others, as :func:`require_alike` does.

    Returns
    -------
    readable : tuple of Shard
        Those that can.
    damage : list of Damage
        What is wrong with each of the others.

    Raises
    ------
    InputError
        The first one that can be read at all is no file of touches.
    """
    readable: list[Shard] = []
    damage: list[Damage] = []
    for shard in shards:
        try:
            kind_of(shard.schema, shard.path if readable else where)
            _require_like(shard, readable)
            readable.append(shard)
        except IntegrityError as error:
            damage.append(unreadable_file(shard.path, error))
        except InputError as error:
            if not readable:
                raise
            damage.append(Damage(shard.path, None, None, "", str(error).partition("; next: ")[0]))
    return tuple(readable), damage


def _require_like(shard: Shard, seen: Sequence[Shard]) -> None:
    require_types(shard.schema, shard.path)
    if shard.rows not in (None, shard.metadata.num_rows):
        message = (
            f"{shard.path!r}: {shard.metadata.num_rows} rows; expected {shard.rows} by the manifest; next: "
            "download or convert the data set again"
        )
        raise IntegrityError(message)
    if not seen:
        return
    first = seen[0]
    media = MEDIA_COLUMN[kind_of(first.schema, first.path)]
    if column_type(shard.schema, media) is None:
        message = (
            f"{shard.path!r}, field {media!r}: the column is not there; expected it as in {first.path!r}; "
            "next: open files of one data set together"
        )
        raise IntegrityError(message)
    names, expected = stated_class_names((shard,)), stated_class_names(seen)
    if names is not None and expected is not None and names != expected:
        message = (
            f"{shard.path!r}, field 'label': the classes are named {_listed(names)}; expected "
            f"{_listed(expected)} as in the files before it; next: open them apart, or make them again"
        )
        raise IntegrityError(message)


def stated_class_names(shards: Iterable[Shard]) -> tuple[str, ...] | None:
    """Return the names of the classes as the first file that states any does; None where none does."""
    stated = (stored_class_names(shard.schema, shard.path) for shard in shards)
    return next((names for names in stated if names is not None), None)


def class_names_of(shards: Iterable[Shard]) -> tuple[str, ...]:
    """Return the names of the classes of some files; the ten digits where they state none."""
    names = stated_class_names(shards)
    return CLASS_NAMES if names is None else names


def usual_touch_count(shards: Iterable[Shard], place: str | Sequence[str]) -> int | None:
    """Return the T that every round of a data set must have: that of more than half of its rounds.

    Parameters
    ----------
    shards : iterable of Shard
        The files; what cannot be read of them does not count.
    place : str, or sequence of them
        Where they are, as it was given.

    Returns
    -------
    int or None
        None where rounds are meant to differ: no T is that of more than half, or the folder was made by
        choosing touches.
    """
    folder = local_folder(place)
    if folder is not None:
        manifest = read_manifest(folder)
        if manifest is not None and manifest.spec.get("options", {}).get("contact"):
            return None
    counts = Counter(count for shard in shards for count in _readable_counts(shard))
    usual, rounds = counts.most_common(1)[0] if counts else (0, 0)
    return usual if 2 * rounds > counts.total() else None


def local_folder(place: str | Sequence[str]) -> DataFolder | None:
    """Return the folder on this machine that is meant; None when it is none."""
    try:
        return DataFolder(place) if isinstance(place, str) and Path(place).is_dir() else None
    except OSError:  # too long a name
        return None


def _readable_counts(shard: Shard) -> list[int]:
    counts: list[int] = []
    for index in range(shard.metadata.num_row_groups):
        with suppress(IntegrityError):
            counts += stored_touch_counts(shard, index).tolist()
    return counts


def stored_touch_counts(shard: Shard, index: int) -> NDArray[np.int64]:
    """Return T of every row of a row group, shape (rows,), int64; reads nothing where the schema fixes it."""
    import pyarrow as pa

    known = ("pos_in_cell", *MEDIA_COLUMN.values())
    name = next(name for name in known if column_type(shard.schema, name) is not None)
    data_type = column_type(shard.schema, name)
    if pa.types.is_fixed_size_list(data_type):
        return np.full(shard.metadata.row_group(index).num_rows, data_type.list_size, np.int64)
    counts = [nested_column(group, name).lengths(0) for group in shard.blocks(index, [name])]
    return np.concatenate(counts or [np.zeros(0, np.int64)])


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
