"""Copies of data sets: several merged into one, or one divided into several."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import accumulate, chain, count, zip_longest
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import pyarrow as pa

from tactile_toolkit import catalog, errors, mesh, places, read, run, store, wording
from tactile_toolkit.kind import EXPORT, MERGE, SELECT, SPLIT, DatasetKind, kinds
from tactile_toolkit.mesh import records
from tactile_toolkit.read import schemas
from tactile_toolkit.store.manifest import VIEWER_FOLDER, ShardRecord
from tactile_toolkit.value_types import Int64, JsonDict, JsonObject

_LARGEST_ID = (1 << 63) - 1
_ROWS_PER_FILE = 1000
# 100 digits are 12 MB unpacked. Level 9 makes their files 8 % smaller and takes three times as long.
_STYLE = store.ParquetStyle(100, compression_level=3, encodings=((f"{records.MESH}.bytes", "PLAIN"),))
# Made once and read by many users; at level 9 the meshes of digits are a fifth larger.
_VIEWER_STYLE = replace(_STYLE, compression_level=19)
# Shards in memory at a time; compression at level 19 takes about 100 MB more for each.
_MAX_AT_ONCE = 8


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

    Raises InputError for data sets of another kind, with other columns or classes, or with a file in common.
    """
    opened = list(map(places.open_place, names))
    for place in opened[1:]:
        if opened[0].kind and place.kind and opened[0].kind.package != place.kind.package:
            raise errors.InputError(
                f"{opened[0].name!r} holds {opened[0].kind.content} and {place.name!r} holds "
                f"{place.kind.content}; expected data sets of one kind",
                next="merge those of each kind on their own",
            )
    sources = [_open_source(kind, place, MERGE) for place in opened]
    _refuse_common_files(sources)
    schema = _common_schema(sources)
    options: JsonDict = {}
    ids: dict[str, list[int | str]] = {}
    if "id" in schema.names:
        ids, pairs = new_ids([source.table.files for source in sources])
        if pairs:
            options["renumbered"] = [
                {"source": catalog.short_name(sources[index].name), "ids": list(map(list, changed))}
                for index, changed in pairs.items()
            ]
    titles = [""] * len(sources)
    if source_column is not None:
        require_new_column(source_column, schema)
        titles = source_names([source.name for source in sources])
        options |= {"source_column": source_column, "sources": titles}
    changes = {
        shard.path: RowChanges(ids.get(shard.path), source_column or "", title)
        for title, source in zip(titles, sources, strict=True)
        for shard in source.table.files
        if source_column is not None or shard.path in ids
    }
    return _build(kind, sources, None, MERGE, options, out, run, changes)


def divide(
    kind: DatasetKind,
    name: places.Name | places.Place,
    fractions: Sequence[float],
    seed: int,
    chosen: JsonObject,
    *,
    same_objects: bool = False,
) -> tuple[list[dict[str, Int64]], str]:
    """Divide the rows of a data set; return for each part their positions by split, in order.

    Either at random by ``fractions`` of each split, which depends only on the seed and the objects; or,
    without fractions, into the rows that :func:`~tactile_toolkit.catalog.choose_rows` takes for ``chosen``,
    and all others. All rows of an object are in one part; with ``same_objects``, rows are divided without
    regard to their objects. Also returns what happened to objects: ``"whole"``, ``"divided"`` or, if those of
    some rows are not known, ``"unknown"``.

    Raises InputError if ``chosen`` would divide the rows of an object.
    """
    place = places.open_place(name).require(kind, "tactile split").require_complete()
    datasets = {split: kind.load(place, split) for split in place.splits}
    objects_of = {split: _objects_of(kind, split, rows, same_objects) for split, rows in datasets.items()}
    objects = "divided" if same_objects else "whole"
    if not same_objects and any(isinstance(key, tuple) for keys in objects_of.values() for key in keys):
        objects = "unknown"
    if not fractions:
        taken = _chosen_rows(place, datasets, chosen)
        left = {split: np.setdiff1d(np.arange(len(datasets[split])), rows) for split, rows in taken.items()}
        _require_whole_objects(kind, objects_of, taken, left)
        return [taken, left], objects
    parts: list[dict[str, Int64]] = [{} for _ in fractions]
    part_of: dict[object, int] = {}
    for split, keys in objects_of.items():
        # An object that another split has, too, is in the same part there.
        part_of |= drawn_parts(Counter(key for key in keys if key not in part_of), fractions, seed)
        numbers = np.array([part_of[key] for key in keys], np.int64)
        for number, part in enumerate(parts):
            part[split] = np.flatnonzero(numbers == number)
    return parts, objects


def _objects_of(kind: DatasetKind, split: str, rows: Any, same_objects: bool) -> list[object]:
    """Return the object of each row; a row whose object is not known, or need not be, is one of its own."""
    if same_objects:
        return [(split, number) for number in range(len(rows))]
    objects = rows.object_ids.tolist()
    if not kind.has_touches:
        return list(objects)
    return [(split, number) if key == -1 else key for number, key in enumerate(objects)]


def drawn_parts(rows_of: Mapping[object, int], fractions: Sequence[float], seed: int) -> dict[object, int]:
    """Draw the part of each object, from 0; objects that are in none get the number of parts."""
    objects = list(rows_of)
    # Doubles of this generator are the same in every version of numpy; shuffles may differ.
    order = np.random.Generator(np.random.PCG64(seed)).random(len(objects)).argsort(kind="stable")
    rows = np.array(list(rows_of.values()), np.int64)[order]
    ends = np.searchsorted(rows.cumsum() - rows / 2, np.cumsum(fractions) * rows.sum())
    steps = np.arange(len(fractions))
    if len(objects) >= len(fractions):  # then no part is empty
        ends = np.maximum.accumulate(np.maximum(ends - steps, 1)) + steps
        ends = np.minimum(ends, len(objects) - steps[::-1])
    parts = np.searchsorted(ends, np.arange(len(objects)), side="right")
    return {objects[index]: part for index, part in zip(order.tolist(), parts.tolist(), strict=True)}


def _chosen_rows(place: places.Place, datasets: Mapping[str, Any], chosen: JsonObject) -> dict[str, Int64]:
    """Return the positions of the rows of each split that filters choose; InputError if there are none."""
    filters = dict(chosen)
    only = filters.pop("split", None)
    if only not in (None, *datasets):
        raise places.unknown_split(only, tuple(datasets), place.name)
    among = [item for item in datasets.items() if only in (None, item[0])]
    taken = {split: rows for split, _, rows in catalog.choose_rows(among, **filters)}
    return dict.fromkeys(datasets, np.zeros(0, np.int64)) | taken


def _require_whole_objects(
    kind: DatasetKind, objects_of: Mapping[str, Sequence[object]], *parts: Mapping[str, Int64]
) -> None:
    """Refuse two parts with rows of the same object (InputError)."""
    first, second = (
        {objects_of[split][row] for split, rows in part.items() for row in rows.tolist()} for part in parts
    )
    shared = sorted(first & second)
    if shared:
        raise errors.InputError(
            f"both parts would have {kind.nouns} of {wording.with_count(len(shared), 'objects')}, the first "
            f"with id {shared[0]}, so that a model could be tested on what it has learned",
            next="choose whole objects, or add --same-objects (same_objects=True) to divide them",
        )


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


def plan_parts(
    kind: DatasetKind,
    name: places.Name | places.Place,
    out: str,
    fractions: Sequence[float],
    seed: int,
    chosen: JsonObject,
    *,
    same_objects: bool = False,
) -> list[tuple[str, Callable[..., store.Manifest]]]:
    """Divide a data set as :func:`divide` does; return the folder of each part and what writes it.

    Folders are ``part-1``, ``part-2`` and so on in ``out``. The functions take those of ``RunOptions``. The
    option ``objects`` of their manifests says whether objects are whole, divided or unknown.
    """
    options = chosen or {"fractions": fractions, "seed": seed}
    parts, objects = divide(kind, name, fractions, seed, chosen, same_objects=same_objects)
    plans: list[tuple[str, Callable[..., store.Manifest]]] = []
    for number, rows in enumerate(parts, 1):
        folder = f"{out.rstrip('/')}/part-{number}"
        of_part = {**options, "objects": objects, "part": number}
        plans.append((folder, partial(write_part, kind, name, rows, of_part, folder)))
    return plans


def select_rows(
    kind: DatasetKind,
    name: places.Name | places.Place,
    chosen: JsonObject,
    out: str,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Write the rows that :func:`~tactile_toolkit.catalog.choose_rows` takes for ``chosen`` as a data set."""
    place = places.open_place(name).require(kind, "tactile select").require_complete()
    rows = _chosen_rows(place, {split: kind.load(place, split) for split in place.splits}, chosen)
    options = {option: value for option, value in chosen.items() if value is not None}
    return _build(kind, [_open_source(kind, place, SELECT)], rows, SELECT, options, out, run)


def plan_tables(
    kind: DatasetKind, place: places.Place, chosen: catalog.RowFilter, out: str
) -> store.BuildPlan:
    """Plan Parquet files of chosen rows, which other libraries read.

    Raises InputError if no row is chosen, or ``out`` is in the source or holds something else.
    """
    filters = chosen.given()
    datasets = catalog.open_splits(place, filters.pop("split"), kind.load, kind.nouns)
    tasks = []
    shards = {}
    for split, rows, indices in catalog.choose_rows(datasets.items(), **filters):
        shards[split] = rows.files
        starts = range(0, len(indices), _ROWS_PER_FILE)
        for index, start in enumerate(starts):
            part = rows[indices[start : start + _ROWS_PER_FILE]]
            tasks.append(store.ShardTask(store.ShardName(split, index, len(starts)), part, _flat_rows))
    options = {
        "layout": "flat",
        "ids": ",".join(map(catalog.id_text, chosen.ids or ())) or None,
        "labels": ",".join(chosen.labels or ()) or None,
        "limit": chosen.limit,
    }
    if chosen.per_class is not None:
        options["per_class"] = chosen.per_class
    options |= unfinished_counts([place])
    every = (shard.path for files in shards.values() for shard in files)
    store.open_folder(out).refuse_source(place.name, every)
    return copy_plan(kind, EXPORT, options, shards, place.made_by or None, tasks, _STYLE, "trimesh")


def viewer_tables(folder: store.DataFolder, manifest: store.Manifest, out: Path) -> dict[str, str]:
    """Write a file for each shard that the Hub's page shows; return their digests by path in ``out``.

    They hold each row with its mesh as a GLB file, as a second configuration of the repository. They repeat
    the shards, so they are made for an upload only; loaders and downloads ignore them. Raises InputError if
    the rows have no mesh.
    """
    (out / VIEWER_FOLDER).mkdir()

    def make(record: ShardRecord) -> tuple[str, str]:
        shard = read.Shard(folder.address(record.shard.data_path), record.rows)
        if not {mesh.VERTICES, mesh.FACES} <= set(read.column_names(shard.schema)):
            raise errors.InputError(
                f"shows meshes in 3D, and {folder.address()!r} holds none (the Hub shows images and "
                "clips without it); nothing was sent",
                next="leave --viewer out",
                field="viewer",
            )
        rows = mesh.SolidDataset[mesh.SolidRecord](
            read.ShardedTable((shard,)), label_names=read.class_names(shard.schema, ())
        )
        content = store.encode_parquet(records.flat_table(rows), _VIEWER_STYLE)
        path = f"{VIEWER_FOLDER}/{record.shard}.parquet"
        (out / path).write_bytes(content)
        return path, store.sha256_hex(content)

    return dict(run.in_threads(make, manifest.shards, min(run.usable_cores(), _MAX_AT_ONCE)))


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
    place = places.open_place(name).require(kind, f"tactile {command}").require_complete()
    manifest = place.manifest
    shards = {split: place.shards(split, kind=kind) for split in place.splits}
    if manifest is None:
        return _Source(place.name, None, False, shards)
    options = manifest.spec.get("options") or {}
    is_imported = manifest.spec.get("operation") == "import" or options.get("touches") == "imported"
    spec = manifest.spec.get("source_spec", manifest.spec)
    return _Source(place.name, spec, is_imported, shards, place.unfinished)


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


def _refuse_common_files(sources: Sequence[_Source]) -> None:
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


def _common_schema(sources: Sequence[_Source]) -> pa.Schema:
    """Return the schema of all rows; InputError, which names the first difference, if there are several."""
    (name, schema), *others = [
        (f"{split} of {source.name!r}", shards[0].schema)
        for source in sources
        for split, shards in source.shards.items()
    ]
    for other_name, other_schema in others:
        differs = schema_difference(schema, other_schema, (name, other_name))
        if differs:
            raise errors.InputError(f"{differs}; expected data sets made alike")
    return schema


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
    folder = store.open_folder(out)
    tasks = []
    shards_of = {}
    for source in sources:
        folder.refuse_source(source.name, (file.path for file in source.table.files))
    for split in dict.fromkeys(split for source in sources for split in source.shards):
        shards = shards_of[split] = [shard for source in sources for shard in source.shards.get(split, ())]
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
        raise errors.InputError(f"no row is left for {out!r}", next="choose a larger part")
    options = {**options, **unfinished_counts(sources)}
    specs = [source.spec for source in sources]
    if any(source.is_imported for source in sources):
        options = {**options, "touches": "imported"}  # the terms of their source apply
    # Data sets that were made in different ways have no common specification.
    source_spec = specs[0] if all(spec == specs[0] for spec in specs) else None
    # Kinds of one package have the same columns, as all touches do.
    made = next(
        (installed for installed in kinds() if installed.name == installed.package == kind.package), kind
    )
    style = _style([*shards, *chain.from_iterable(shards_of.values())])
    plan = copy_plan(made, operation, options, shards_of, source_spec, tasks, style)
    return store.build(folder, plan, write_card=made.write_card, **run)


def unfinished_counts(sources: Iterable[_Source | places.Place]) -> dict[str, str]:
    """Return, for the specification of a copy, how much of each unfinished source was finished."""
    counts = [source.unfinished for source in sources if source.unfinished]
    if counts:
        return {"unfinished": ", ".join(counts)}
    return {}


def copy_plan(
    kind: DatasetKind,
    operation: str,
    options: JsonObject,
    shards: Mapping[str, Sequence[read.Shard]],
    source_spec: JsonObject | None,
    tasks: Sequence[store.ShardTask],
    style: store.ParquetStyle,
    *libraries: str,
) -> store.BuildPlan:
    """Plan a copy; ``shards`` are its sources by split."""
    spec = {
        "operation": operation,
        "options": options,
        "source": {split: [shard.fingerprint() for shard in files] for split, files in shards.items()},
        "source_spec": source_spec,
    }
    libraries = ("numpy", "pyarrow", *libraries)
    return store.BuildPlan(kind.name, spec, tuple(shards), tuple(tasks), style, libraries=libraries)


def _style(shards: Iterable[read.Shard]) -> store.ParquetStyle:
    """Return the style of the first shard with rows: its row groups, and columns without a dictionary."""
    footers = (shard.metadata for shard in shards)
    groups = (footer.row_group(index) for footer in footers for index in range(footer.num_row_groups))
    group = next((group for group in groups if group.num_rows), None)
    if group is None:
        return store.ParquetStyle(1)
    columns = [group.column(index) for index in range(group.num_columns)]
    encodings = [
        (column.path_in_schema, next(name for name in column.encodings if name != "RLE"))
        for column in columns
        if not column.has_dictionary_page
    ]
    return store.ParquetStyle(group.num_rows, encodings=tuple(encodings))


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
            column_index = table.schema.get_field_index("id")
            stored = table.schema.field(column_index)
            table = table.set_column(column_index, stored, pa.array(self.ids).cast(stored.type))
        if not self.column:
            return table
        values = pa.array([self.source] * len(table), pa.string())
        features = schemas.stored_features(table.schema, self.source)
        metadata = dict(table.schema.metadata or {})
        if features:
            added = {**features, self.column: {"dtype": "string", "_type": "Value"}}
            metadata |= {
                name.encode(): text.encode() for name, text in schemas.feature_metadata(added).items()
            }
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
        raise errors.InputError(f"no number is left for new ids: the largest is {largest}")
    return changed, pairs


def _ids_of(shard: read.Shard) -> list[int | str]:
    values = read.ShardedTable((shard,)).column("id").tolist()
    ids = [value if isinstance(value, str) else read.whole_number(value) for value in values]
    known = [value for value in ids if value is not None]
    if len(known) < len(ids):
        raise errors.InputError(f"an id of {shard.path!r} is missing; expected an id in each row")
    return known


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


def require_new_column(name: str, schema: pa.Schema) -> None:
    """Refuse a name of the new column that rows have, or that names a field of a struct (InputError)."""
    known = {*schema.names, *(column.partition(".")[0] for column in schema.names)}
    if not name.strip() or "." in name or not name.isprintable() or name in known:
        raise errors.InputError(
            f"is {name!r}; expected the name of a new column, without dots "
            f"(the rows have {', '.join(schema.names)})",
            field="source_column",
        )


def schema_difference(first_schema: pa.Schema, second_schema: pa.Schema, names: tuple[str, str]) -> str:
    """Describe how rows of two data sets differ: the first column, class or metadata; empty if alike."""
    first, second = names
    types = [read.column_types(schema) for schema in (first_schema, second_schema)]
    for column in dict.fromkeys([*types[0], *types[1]]):
        here, there = (type_of.get(column) for type_of in types)
        if here is None or there is None:
            has, lacks = (second, first) if here is None else (first, second)
            return f"{has} has the column {column!r}, which {lacks} lacks"
        if here != there:
            return f"the column {column!r} is {here} in {first} and {there} in {second}"
    if first_schema.names != second_schema.names:
        return f"the columns of {first} are in another order than those of {second}"
    classes = [read.class_names(schema, ()) for schema in (first_schema, second_schema)]
    if classes[0] != classes[1]:
        pairs = enumerate(zip_longest(*classes))
        number, (here, there) = next((label, pair) for label, pair in pairs if pair[0] != pair[1])
        here_text, there_text = (
            "missing" if class_name is None else repr(class_name) for class_name in (here, there)
        )
        return f"class {number} is {here_text} in {first} and {there_text} in {second}"
    features = [
        schemas.stored_features(schema, name)
        for schema, name in zip((first_schema, second_schema), names, strict=True)
    ]
    for column in first_schema.names:
        if features[0].get(column) != features[1].get(column):
            return f"the column {column!r} has other metadata of `datasets` in {first} than in {second}"
    if not first_schema.equals(second_schema, check_metadata=True):
        return f"the metadata of {first} are not those of {second}"
    return ""


def _flat_rows(_shard: store.ShardName, rows: Any) -> store.ShardContent:
    return store.ShardContent(records.flat_table(rows))
