"""Changes of rows by a merge: new ids for duplicates, and a column with the name of the source."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count, zip_longest

import numpy as np
import pyarrow as pa

from tactile_toolkit import read, store
from tactile_toolkit.errors import InputError
from tactile_toolkit.read.columns import whole_numbers

_LARGEST_ID = (1 << 63) - 1


@dataclass(frozen=True)
class RowChanges:
    """Changes of the rows of one shard.

    ``ids`` are the new ids of all its rows; None leaves them. ``column`` is the name of a new column, in
    which each row has the text ``source``; an empty name adds none.
    """

    ids: Sequence[int | str] | None = field(default=None, repr=False)
    column: str = ""
    source: str = ""

    def apply(self, table: pa.Table) -> pa.Table:
        """Return the changed rows."""
        if self.ids is not None:
            place = table.schema.get_field_index("id")
            stored = table.schema.field(place)
            table = table.set_column(place, stored, pa.array(self.ids).cast(stored.type))
        if not self.column:
            return table
        values = pa.array([self.source] * len(table), pa.string())
        features = read.stored_features(table.schema, self.source)
        metadata = dict(table.schema.metadata or {})
        if features:
            added = {**features, self.column: {"dtype": "string", "_type": "Value"}}
            metadata |= {name.encode(): text.encode() for name, text in read.feature_metadata(added).items()}
        return table.append_column(self.column, values).replace_schema_metadata(metadata)


def new_ids(
    sources: Sequence[Sequence[read.Shard]],
) -> tuple[dict[str, list[int | str]], dict[int, list[tuple[int | str, int | str]]]]:
    """Find ids for rows whose id occurs before; the first row with an id keeps it.

    New ids are numbers after the largest one, or texts that end with ``_2``, ``_3`` and so on. Returns the
    ids of all rows of each shard with such rows, by the path of the shard; and the old and the new ids of
    each source, by its position. InputError: an id is missing, or no number is left.
    """
    stored = [(index, shard.path, _ids_of(shard)) for index, shards in enumerate(sources) for shard in shards]
    taken = {value for _, _, ids in stored for value in ids}
    largest = max((value for value in taken if isinstance(value, int)), default=0)
    numbers = count(largest + 1)
    known = set[int | str]()
    changed: dict[str, list[int | str]] = {}
    pairs: dict[int, list[tuple[int | str, int | str]]] = {}
    for index, path, ids in stored:
        for row, old in enumerate(ids):
            if old in known:
                texts = (f"{old}_{number}" for number in count(2))
                candidates = texts if isinstance(old, str) else numbers
                ids[row] = next(value for value in candidates if value not in taken)
                taken.add(ids[row])
                pairs.setdefault(index, []).append((old, ids[row]))
                changed[path] = ids
            known.add(ids[row])
    if next(numbers) > _LARGEST_ID:
        raise InputError(f"no number is left for new ids: the largest is {largest}")
    return changed, pairs


def _ids_of(shard: read.Shard) -> list[int | str]:
    values = read.ShardedTable((shard,)).column("id")
    if values.dtype.kind in "iuf" and whole_numbers(values).all():
        values = values.astype(np.int64)
    ids: list[int | str] = values.tolist()
    if not all(isinstance(value, (int, str)) for value in ids):
        raise InputError(f"an id of {shard.path!r} is missing; expected an id in each row")
    return ids


def source_names(names: Sequence[str]) -> list[str]:
    """Return names of data sets without their parent folders, as far as they differ then.

    InputError: a data set is named twice.
    """
    if len(set(names)) < len(names):
        raise InputError(f"a data set is given twice: {', '.join(names)}", next="name each once")
    parts = [_parts_of(name) for name in names]
    for length in range(1, max(map(len, parts), default=0) + 1):
        short = ["/".join(each[-length:]) for each in parts]
        if len(set(short)) == len(short):
            return short
    return list(names)


def _parts_of(name: str) -> list[str]:
    place = name
    if not store.is_remote(name):
        place = store.expanded(store.normalize_uri(name)).absolute().as_posix()
    return [part for part in place.split("/") if part]


def require_new_column(name: str, schema: pa.Schema) -> None:
    """Refuse a name of the new column that rows have, or that names a field of a struct (InputError)."""
    known = {*schema.names, *(each.partition(".")[0] for each in schema.names)}
    if not name.strip() or "." in name or not name.isprintable() or name in known:
        raise InputError(
            f"--source-column is {name!r}; expected the name of a new column, without dots "
            f"(the rows have {', '.join(schema.names)})"
        )


def schema_difference(one: pa.Schema, other: pa.Schema, names: tuple[str, str]) -> str:
    """Describe how rows of two data sets differ: the first column, class or metadata; empty if alike."""
    first, second = names
    types = [read.column_types(schema) for schema in (one, other)]
    for column in dict.fromkeys([*types[0], *types[1]]):
        here, there = (each.get(column) for each in types)
        if here is None or there is None:
            has, lacks = (second, first) if here is None else (first, second)
            return f"{has} has the column {column!r}, which {lacks} lacks"
        if here != there:
            return f"the column {column!r} is {here} in {first} and {there} in {second}"
    if one.names != other.names:
        return f"the columns of {first} are in another order than those of {second}"
    classes = [read.class_names(schema, ()) for schema in (one, other)]
    if classes[0] != classes[1]:
        pairs = enumerate(zip_longest(*classes))
        number, (here, there) = next((place, pair) for place, pair in pairs if pair[0] != pair[1])
        found, other_found = ("missing" if each is None else repr(each) for each in (here, there))
        return f"class {number} is {found} in {first} and {other_found} in {second}"
    features = [read.stored_features(schema, name) for schema, name in zip((one, other), names, strict=True)]
    for column in one.names:
        if features[0].get(column) != features[1].get(column):
            return f"the column {column!r} has other metadata of `datasets` in {first} than in {second}"
    if not one.equals(other, check_metadata=True):
        return f"the metadata of {first} are not those of {second}"
    return ""
