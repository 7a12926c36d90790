"""Copies of data sets: several merged into one, or one divided into several."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import accumulate, chain, pairwise
from typing import Unpack

import numpy as np
import pyarrow as pa

from tactile_toolkit import catalog, places, read, store
from tactile_toolkit.array_types import Int64
from tactile_toolkit.errors import InputError
from tactile_toolkit.exchange import merge_changes
from tactile_toolkit.exchange.merge_changes import RowChanges
from tactile_toolkit.json_types import JsonDict, JsonObject
from tactile_toolkit.kind import MERGE, SELECT, SPLIT, DatasetKind, kinds


def _copy_file(
    source: read.Shard, changes: RowChanges | None, _shard: store.ShardName, _rows: range
) -> store.ShardContent:
    """Return a shard with its changes; without any, byte for byte. IntegrityError for a wrong checksum."""
    with source.stored() as stream:
        content = stream.read()
        table = store.open_checked(io.BytesIO(content)).read(use_threads=False)
    if changes is not None:
        return store.ShardContent(changes.apply(table))
    return store.ShardContent(table, encoded=content)


def _take_rows(source: read.Shard, _shard: store.ShardName, rows: Int64) -> store.ShardContent:
    """Return some rows of a shard, by their positions in order."""
    groups = enumerate(_in_parts(rows, source.group_starts))
    tables = [source.read(groups=[index]).take(rows) for index, rows in groups]
    return store.ShardContent(pa.concat_tables(tables).combine_chunks())


def _in_parts(rows: Int64, starts: Sequence[int]) -> list[Int64]:
    """Divide row numbers, in order, by the parts that hold them, and count from the start of each.

    ``starts`` ends with the number of all rows.
    """
    parts = np.split(rows, np.searchsorted(rows, starts[1:-1]))
    return [part - start for part, start in zip(parts, starts, strict=False)]


@dataclass(frozen=True)
class _Source:
    """A data set; ``spec`` is the specification by which its rows were first made, if it is known."""

    name: str
    spec: JsonObject | None
    is_imported: bool
    shards: Mapping[str, tuple[read.Shard, ...]]
    unfinished: str = ""

    @property
    def table(self) -> read.ShardedTable:
        return read.ShardedTable(sum(self.shards.values(), ()))


def _open_source(kind: DatasetKind, name: places.Name | places.Place, command: str) -> _Source:
    place = places.open_place(name).require(kind, command).require_complete()
    manifest = place.manifest
    shards = {split: place.shards(split, kind=kind) for split in place.splits}
    if manifest is None:
        return _Source(place.name, None, False, shards)
    options = manifest.spec.get("options") or {}
    is_imported = manifest.spec.get("operation") == "import" or options.get("touches") == "imported"
    spec = manifest.spec.get("source_spec", manifest.spec)
    return _Source(place.name, spec, is_imported, shards, place.unfinished)


def merge_sets(
    kind: DatasetKind,
    names: Sequence[places.Name | places.Place],
    out: str,
    *,
    source_column: str | None = None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Merge data sets; shards without changes are copied byte for byte.

    The first row with an id keeps it; rows with the same id get new ones, which the specification lists.
    ``source_column`` is a new column with the name of the data set that each row is from. ``run`` are fields
    of ``store.RunOptions``.

    Raises InputError for data sets of another kind, or with other columns or classes.
    """
    sources = [_open_source(kind, name, MERGE) for name in names]
    schema = _common_schema(sources)
    options: JsonDict = {}
    ids: dict[str, list[int | str]] = {}
    if "id" in schema.names:
        ids, pairs = merge_changes.new_ids([source.table.files for source in sources])
        if pairs:
            options["renumbered"] = [
                {"source": catalog.short_name(sources[index].name), "ids": list(map(list, changed))}
                for index, changed in pairs.items()
            ]
    titles = [""] * len(sources)
    if source_column is not None:
        merge_changes.require_new_column(source_column, schema)
        titles = merge_changes.source_names([source.name for source in sources])
        options |= {"source_column": source_column, "sources": titles}
    changes = {
        shard.path: RowChanges(ids.get(shard.path), source_column or "", title)
        for title, source in zip(titles, sources, strict=True)
        for shard in source.table.files
        if source_column is not None or shard.path in ids
    }
    return _build(kind, sources, None, MERGE, options, out, run, changes)


def _common_schema(sources: Sequence[_Source]) -> pa.Schema:
    """Return the schema of all rows; InputError, which names the first difference, if there are several."""
    (name, schema), *others = [
        (f"{split} of {source.name!r}", shards[0].schema)
        for source in sources
        for split, shards in source.shards.items()
    ]
    for other, found in others:
        differs = merge_changes.schema_difference(schema, found, (name, other))
        if differs:
            raise InputError(f"{differs}; expected data sets made alike")
    return schema


def divide(
    kind: DatasetKind,
    name: places.Name | places.Place,
    fractions: Sequence[float],
    seed: int,
    chosen: JsonObject,
) -> list[dict[str, Int64]]:
    """Divide the rows of a data set; return for each part their positions by split, in order.

    Either at random by ``fractions`` of each split, which depends only on the seed and the number of rows;
    or, without fractions, into the rows that :func:`~tactile_toolkit.catalog.choose_rows` takes for
    ``chosen``, and all others.
    """
    place = places.open_place(name).require(kind, SPLIT).require_complete()
    datasets = {split: kind.load(place, split) for split in place.splits}
    if not fractions:
        among = dict(chosen)
        only = among.pop("split", None)
        if only not in (None, *datasets):
            raise places.unknown_split(only, tuple(datasets), place.name)
        some = catalog.choose_rows([each for each in datasets.items() if only in (None, each[0])], **among)
        taken = dict.fromkeys(datasets, np.zeros(0, np.int64)) | {split: rows for split, _, rows in some}
        return [taken, {each: np.setdiff1d(np.arange(len(datasets[each])), taken[each]) for each in taken}]
    parts: list[dict[str, Int64]] = [{} for _ in fractions]
    for split, rows in datasets.items():
        # Doubles of this generator are the same in every version of numpy; shuffles may differ.
        order = np.random.Generator(np.random.PCG64(seed)).random(len(rows)).argsort(kind="stable")
        ends = [round(share * len(rows)) for share in accumulate(fractions, initial=0.0)]
        for part, (start, stop) in zip(parts, pairwise(ends), strict=True):
            part[split] = np.sort(order[start:stop])
    return parts


def write_part(
    kind: DatasetKind,
    name: places.Name | places.Place,
    rows: Mapping[str, Int64],
    options: JsonObject,
    out: str,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Write rows of a data set as a data set of the same kind; ``options`` are JSON values that name them."""
    return _build(kind, [_open_source(kind, name, SPLIT)], rows, SPLIT, options, out, run)


def select_rows(
    kind: DatasetKind,
    name: places.Name | places.Place,
    chosen: JsonObject,
    out: str,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Write the rows that :func:`~tactile_toolkit.catalog.choose_rows` takes for ``chosen`` as a data set."""
    rows, _ = divide(kind, name, (), 0, chosen)
    given = {each: value for each, value in chosen.items() if value is not None}
    return _build(kind, [_open_source(kind, name, SELECT)], rows, SELECT, given, out, run)


def _build(
    kind: DatasetKind,
    sources: Sequence[_Source],
    rows: Mapping[str, Int64] | None,
    operation: str,
    options: JsonObject,
    out: str,
    run: store.RunKeywords,
    changes: Mapping[str, RowChanges] | None = None,
) -> store.Manifest:
    folder, tasks, found = store.open_folder(out), [], {}
    for source in sources:
        catalog.refuse_source(folder, source.name, source.table.files)
    for split in dict.fromkeys(split for source in sources for split in source.shards):
        shards = found[split] = [shard for source in sources for shard in source.shards.get(split, ())]
        parts: list[tuple[pa.Table, pa.Schema]] = [
            (range(len(shard)), partial(_copy_file, shard, (changes or {}).get(shard.path)))
            for shard in shards
        ]
        if rows is not None:
            held = _in_parts(rows[split], list(accumulate(map(len, shards), initial=0)))
            taken = zip(held, shards, strict=True)
            parts = [(part, partial(_take_rows, shard)) for part, shard in taken if len(part)]
        tasks += [
            store.ShardTask(store.ShardName(split, index, len(parts)), *part)
            for index, part in enumerate(parts)
        ]
    if not tasks:
        raise InputError(f"no row is left for {out!r}", next="choose a larger part")
    options = {**options, **unfinished_counts(sources)}
    specs = [source.spec for source in sources]
    if any(source.is_imported for source in sources):
        options = {**options, "touches": "imported"}  # the terms of their source apply
    # Data sets that were made in different ways have no common specification.
    source_spec = specs[0] if all(spec == specs[0] for spec in specs) else None
    # Kinds of one package have the same columns, as all touches do.
    made = next((each for each in kinds() if each.name == each.package == kind.package), kind)
    style = _style([*shards, *chain.from_iterable(found.values())])
    plan = copy_plan(made, operation, options, found, source_spec, tasks, style)
    return store.build(folder, plan, write_card=made.write_card, **run)


def unfinished_counts(sources: Iterable[_Source | places.Place]) -> dict[str, str]:
    """Return, for the specification of a copy, how much of each unfinished source was finished."""
    counts = [each.unfinished for each in sources if each.unfinished]
    if counts:
        return {"unfinished": ", ".join(counts)}
    return {}


def copy_plan(
    kind: DatasetKind,
    operation: str,
    options: JsonObject,
    shards: Mapping[str, Sequence[read.Shard]],
    source_spec: JsonObject | None,
    tasks: Sequence[store.AnyTask],
    style: store.ParquetStyle,
    *libraries: str,
) -> store.BuildPlan:
    """Plan a copy; ``shards`` are its sources by split."""
    spec = {
        "operation": operation,
        "options": options,
        "source": {split: [each.fingerprint() for each in found] for split, found in shards.items()},
        "source_spec": source_spec,
    }
    libraries = ("numpy", "pyarrow", *libraries)
    return store.BuildPlan(kind.name, spec, tuple(shards), tuple(tasks), style, libraries=libraries)


def _style(shards: Iterable[read.Shard]) -> store.ParquetStyle:
    """Return the style of the first shard with rows: its row groups, and columns without a dictionary."""
    footers = (shard.metadata for shard in shards)
    groups = (footer.row_group(index) for footer in footers for index in range(footer.num_row_groups))
    group = next((each for each in groups if each.num_rows), None)
    if group is None:
        return store.ParquetStyle(1)
    columns = [group.column(index) for index in range(group.num_columns)]
    encodings = [
        (each.path_in_schema, next(name for name in each.encodings if name != "RLE"))
        for each in columns
        if not each.has_dictionary_page
    ]
    return store.ParquetStyle(group.num_rows, encodings=tuple(encodings))
