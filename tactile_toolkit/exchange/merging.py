"""Merging: rows of several data sets with the columns of all, each with its source and its licence."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, count
from typing import Unpack

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from tactile_toolkit import cards, errors, places, read, store, touch
from tactile_toolkit.columns import column_types, units
from tactile_toolkit.exchange import copies
from tactile_toolkit.kind import MERGE, DatasetKind
from tactile_toolkit.value_types import JsonDict

_LARGEST_ID = (1 << 63) - 1
_NS_PER_S = 1e9


def merge_sets(
    kind: DatasetKind, names: Sequence[places.Name | places.Place], out: str, **run: Unpack[store.RunKeywords]
) -> store.Manifest:
    """Merge data sets of one kind; a column that a data set lacks is null in its rows.

    Columns of one name and of the same name in another unit are one: lists of fixed length become lists, and
    values are converted to the unit of the first data set. Classes are joined by name. The columns
    ``source`` (``source_set`` for digits, whose ``source`` is the handwriting), ``source_id`` and ``licence``
    state the data set of each row, its id there, and the licence; rows that state them already keep them. The
    first row with an id keeps it, later ones get new ids. ``run`` are fields of ``store.RunOptions``.

    Raises InputError for data sets of another kind, with a file in common, or with a column whose types have
    no common one.
    """
    opened = list(map(places.open_place, names))
    for place in opened[1:]:
        if opened[0].kind and place.kind and opened[0].kind.package != place.kind.package:
            raise errors.InputError(
                f"{opened[0].name!r} holds {opened[0].kind.content} and {place.name!r} holds "
                f"{place.kind.content}; expected data sets of one kind",
                next="merge those of each kind on their own",
            )
    sources = [copies.open_source(kind, place, MERGE) for place in opened]
    _refuse_common_files(sources)
    titles = source_names([source.name for source in sources])
    licences = list(map(cards.licence_of, opened))
    own_names = [set(shards[0].schema.names) for source in sources for shards in source.shards.values()]
    has_own = any(cards.SOURCE_NAMES[-1] in names and not cards.source_column(names) for names in own_names)
    union = Union(cards.SOURCE_NAMES[not has_own])
    for title, source in zip(titles, sources, strict=True):
        union.add(kind, title, source)
    shards = [shard for source in sources for shard in source.table.files]
    ids: dict[str, list[int | str]] = {}
    options: JsonDict = {"sources": dict(zip(titles, licences, strict=True))}
    if "id" in union.types:
        old = [_ids_of(shard, pa.types.is_string(union.types["id"])) for shard in shards]
        new = unique_ids(old)
        ids = dict(zip((shard.path for shard in shards), new, strict=True))
        changed = sum(pair[0] != pair[1] for pair in zip(chain(*old), chain(*new), strict=True))
        if changed:
            options["new_ids"] = changed
    schema = union.schema()
    parts: dict[str, list[copies.Part]] = {}
    for title, licence, source in zip(titles, licences, sources, strict=True):
        for split, files in source.shards.items():
            renamed, labels = union.changes[title, split]
            for shard in files:
                make = _MergedShard(shard, schema, renamed, labels, ids.get(shard.path), title, licence)
                parts.setdefault(split, []).append((range(len(shard)), make))
    return copies.build_copy(kind, sources, parts, MERGE, options, out, run)


def _refuse_common_files(sources: Sequence[copies.Source]) -> None:
    """Refuse to merge a file with itself (InputError), whose rows would all occur twice."""
    owners: dict[tuple[object, ...], str] = {}
    for source in sources:
        for shard in source.table.files:
            if shard.identity in owners:
                names = f"{owners[shard.identity]!r} and {source.name!r}"
                raise errors.InputError(
                    f"a data set is given twice: {names} have a file in common", next="name each once"
                )
            owners[shard.identity] = source.name


class Union:
    """The columns and classes of several data sets.

    ``source_column`` is the name of the column that states the data set of a row.

    Attributes
    ----------
    types : dict of str to DataType
        Type of each column, by its name without structs.
    changes : dict
        For a data set and a split: of each column, its name in the source and the factor of its values; and
        the new number of each class, the last for a label of -1.
    """

    def __init__(self, source_column: str) -> None:
        self.source_columns = (source_column, cards.SOURCE_ID, cards.LICENCE)
        self.types: dict[str, pa.DataType] = {}
        self.changes: dict[tuple[str, str], tuple[dict[str, tuple[str, float]], tuple[int, ...]]] = {}
        self._classes: dict[str, int] = {}
        self._has_gaps = False

    def add(self, kind: DatasetKind, title: str, source: copies.Source) -> None:
        """Add the splits of a data set."""
        for split, shards in source.shards.items():
            schema = shards[0].schema
            taken = {cards.SOURCE_ID, cards.LICENCE} & set(schema.names)
            if taken and not cards.source_column(schema.names):
                raise errors.InputError(
                    f"{source.name!r} has a column {taken.pop()!r}, which states the source of merged rows",
                    next="rename the column",
                )
            names = read.class_names(schema, kind.class_names) or ()
            if kind.has_touches and read.class_names(schema, None) is None:
                names = touch.CLASS_NAMES
            if "label" not in schema.names:
                names = ()
            numbers = [self._classes.setdefault(name, len(self._classes)) for name in names]
            self.changes[title, split] = (
                self._add_columns(shards[0].flat_schema, source.name),
                (*numbers, -1),
            )

    def _add_columns(self, schema: pa.Schema, name: str) -> dict[str, tuple[str, float]]:
        """Add columns; return the name of each in the source, and the factor of its values, by new name."""
        renamed: dict[str, tuple[str, float]] = {}
        is_first = not self.types
        own_source = cards.source_column(schema.names)
        stated: dict[str, str] = {}
        if own_source:
            stated = dict(zip((own_source, cards.SOURCE_ID, cards.LICENCE), self.source_columns, strict=True))
        for column in schema:
            if column.name in stated:
                renamed[stated[column.name]] = (column.name, 1.0)
                continue
            new_name, factor = column.name, 1.0
            if column.name not in self.types and pa.types.is_floating(read.list_depth(column.type)[1]):
                # In their order, which is the same in all processes; of several, the last one.
                for known in (name for name in self.types if name not in schema.names):
                    new_factor = units.conversion_factor(column.name, known)
                    if new_factor is not None:
                        new_name, factor = known, new_factor
            renamed[new_name] = (column.name, factor)
            known_type = self.types.get(new_name)
            try:
                self.types[new_name] = common_type(known_type or column.type, column.type, new_name == "id")
            except pa.ArrowException as error:
                raise errors.InputError(
                    f"the column {new_name!r} is {column.type} in {name!r} and {known_type} in the data sets "
                    "before it; expected types that one type can hold",
                    next="import one of them again with another name for the column",
                ) from error
            self._has_gaps |= known_type is None and not is_first
        self._has_gaps |= not self.types.keys() <= renamed.keys()
        return renamed

    def schema(self) -> pa.Schema:
        """Return the schema of the merged rows."""
        types = {**self.types, **dict.fromkeys(self.source_columns, pa.string())}
        merged = touch.with_features(pa.schema(types), tuple(self._classes))
        if self._has_gaps:  # each file states those that its rows lack
            merged = read.with_absent(merged, ())
        return merged


def common_type(first: pa.DataType, second: pa.DataType, is_text: bool = False) -> pa.DataType:
    """Return the type that holds values of both; ArrowException if there is none.

    Numbers count seconds beside durations. A value beside lists is a list of one. With ``is_text``, numbers
    beside texts become texts.
    """
    first_depth, first_leaf = read.list_depth(first)
    second_depth, second_leaf = read.list_depth(second)
    if abs(first_depth - second_depth) == 1:
        shallow, deep = (first, second) if first_depth < second_depth else (second, first)
        return common_type(pa.list_(shallow), deep)
    tests = pa.types
    leaves = (first_leaf, second_leaf)
    leaf = None
    if any(map(tests.is_duration, leaves)) and any(map(tests.is_floating, leaves)):
        leaf = pa.duration("ns")
    elif any(map(tests.is_boolean, leaves)) and any(map(tests.is_integer, leaves)):
        leaf = next(filter(tests.is_integer, leaves))
    elif is_text and any(map(tests.is_string, leaves)):
        leaf = pa.string()
    if leaf is not None and first_depth == second_depth:
        for _ in range(first_depth):
            leaf = pa.list_(leaf)
        return leaf
    both = [pa.schema([("", data_type)]) for data_type in (first, second)]
    return pa.unify_schemas(both, promote_options="permissive").field(0).type


@dataclass(frozen=True)
class _MergedShard:
    """Makes the rows of a shard with the columns of all data sets; picklable.

    The last columns of ``schema`` state the source. ``columns`` and ``labels`` are those of
    :attr:`Union.changes`, ``ids`` the new ids.
    """

    shard: read.Shard
    schema: pa.Schema
    columns: Mapping[str, tuple[str, float]]
    labels: tuple[int, ...]
    ids: Sequence[int | str] | None = field(repr=False)
    source: str
    licence: str

    def __call__(self, _shard: store.ShardName, _rows: range) -> store.ShardContent:
        """Read the shard and convert it; IntegrityError for a wrong checksum."""
        with self.shard.stored() as stream:
            table = store.open_checked(io.BytesIO(stream.read())).read(use_threads=False)
        rows = read.RowGroup(read.supported_table(table.combine_chunks()), self.shard.path)
        present = read.column_names(rows.table.schema)
        arrays: dict[str, pa.Array] = {}
        for name, (own_name, factor) in self.columns.items():
            if own_name in present:
                arrays[name] = _converted(rows.arrow(own_name), self.schema.field(name).type, factor)
        names = self.schema.names[-3:]
        if names[0] not in arrays:
            old = rows.arrow("id").cast(pa.string()) if "id" in present else pa.nulls(len(table), pa.string())
            stated = (pa.repeat(self.source, len(table)), old, pa.repeat(self.licence, len(table)))
            arrays |= dict(zip(names, stated, strict=True))
        if self.ids is not None:
            arrays["id"] = pa.array(self.ids, self.schema.field("id").type)
        if "label" in arrays and self.labels[:-1] != tuple(range(len(self.labels) - 1)):
            arrays["label"] = self._new_labels(rows, arrays["label"])
        absent = {column.name: column.type for column in self.schema if column.name not in arrays}
        arrays |= {name: pa.nulls(len(table), data_type) for name, data_type in absent.items()}
        schema = self.schema
        if read.absent_columns(schema) is not None:
            schema = read.with_absent(schema, absent)
        return store.ShardContent(pa.table([arrays[name] for name in schema.names], schema=schema))

    def _new_labels(self, rows: read.RowGroup, labels: pa.Array) -> pa.Array:
        numbers = pc.fill_null(labels, -1).to_numpy(zero_copy_only=False)
        is_known = (numbers >= -1) & (numbers < len(self.labels) - 1)
        if not is_known.all():
            row = int(np.argmin(is_known))
            raise rows.damaged(
                "label", row, f"the value is {numbers[row]}", f"less than {len(self.labels) - 1}, the classes"
            )
        changed = np.array(self.labels, np.int64)[numbers.astype(np.int64)]
        return pa.array(changed, labels.type, mask=labels.is_null().to_numpy(zero_copy_only=False))


def _converted(array: pa.Array, data_type: pa.DataType, factor: float) -> pa.Array:
    """Return values with another type, multiplied by a factor; see :func:`common_type`."""
    if read.list_depth(array.type)[0] < read.list_depth(data_type)[0]:
        offsets = np.arange(len(array) + 1, dtype=np.int32)
        array = pa.ListArray.from_arrays(pa.array(offsets), array)
    leaf = read.list_depth(array.type)[1]
    if factor != 1:
        array = _on_leaves(array, lambda values: pc.multiply(values.cast(pa.float64()), factor))
    if pa.types.is_floating(leaf) and pa.types.is_duration(read.list_depth(data_type)[1]):
        array = _on_leaves(array, _as_nanoseconds)
    return array if array.type == data_type else array.cast(data_type)


def _as_nanoseconds(seconds: pa.Array) -> pa.Array:
    known = pc.if_else(pc.is_finite(seconds), seconds, None).cast(pa.float64())
    return pc.round(pc.multiply(known, _NS_PER_S)).cast(pa.int64()).cast(pa.duration("ns"))


def _on_leaves(array: pa.Array, change: Callable[[pa.Array], pa.Array]) -> pa.Array:
    if not read.list_depth(array.type)[0]:
        return change(array)
    entries = _on_leaves(array.flatten(), change)
    return column_types.lists_of(entries, pc.list_value_length(array))


def _ids_of(shard: read.Shard, are_texts: bool) -> list[int | str]:
    if "id" not in shard.schema.names:
        return [f"row-{row}" if are_texts else row for row in range(len(shard))]
    values = read.ShardedTable((shard,)).column("id").tolist()
    ids = [value if isinstance(value, str) else read.whole_number(value) for value in values]
    known = [value for value in ids if value is not None]
    if len(known) < len(ids):
        raise errors.InputError(f"an id of {shard.path!r} is missing; expected an id in each row")
    return list(map(str, known)) if are_texts else known


def unique_ids(shards: Iterable[Sequence[int | str]]) -> list[list[int | str]]:
    """Return ids of all rows of some shards; the first row with an id keeps it.

    New ids are numbers after the largest one, or texts that end with ``_2``, ``_3`` and so on. Raises
    InputError if no number is left.
    """
    stored = list(shards)
    taken = set(chain.from_iterable(stored))
    largest = max((value for value in taken if isinstance(value, int)), default=0)
    numbers = count(largest + 1)
    known = set[int | str]()
    unique: list[list[int | str]] = []
    for ids in stored:
        unique.append([])
        for old in ids:
            new = old
            if old in known:
                texts = (f"{old}_{number}" for number in count(2))
                candidates = texts if isinstance(old, str) else numbers
                new = next(value for value in candidates if value not in taken)
                taken.add(new)
            known.add(new)
            unique[-1].append(new)
    if next(numbers) > _LARGEST_ID:
        raise errors.InputError(f"no number is left for new ids: the largest is {largest}")
    return unique


def source_names(names: Sequence[str]) -> list[str]:
    """Return names of data sets without their parent folders, as far as they differ then."""
    parts = [_parts_of(name) for name in names]
    for length in range(1, max(map(len, parts), default=0) + 1):
        short = ["/".join(steps[-length:]) for steps in parts]
        if len(set(short)) == len(short):
            return short
    return list(names)


def _parts_of(name: str) -> list[str]:
    path = store.local_path(name)
    whole = name if path is None else path.absolute().as_posix()
    return [part for part in whole.split("/") if part]
