"""Copies of data sets: several merged into one, or one divided into several."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Any, TypeAlias, Unpack

import numpy as np
import pyarrow as pa

from tactile_toolkit import cards, catalog, errors, mesh, places, read, run, store, touch, wording
from tactile_toolkit.kind import EXPORT, SELECT, SPLIT, DatasetKind
from tactile_toolkit.mesh import records
from tactile_toolkit.places import split_files
from tactile_toolkit.store.manifest import VIEWER_FOLDER, ShardRecord
from tactile_toolkit.value_types import Int64, JsonObject

_ROWS_PER_FILE = 1000
Part: TypeAlias = tuple[Any, Callable[..., store.ShardContent]]
"""The items of a shard of a copy, and what makes the shard of them."""
# 100 digits are 12 MB unpacked. Level 9 makes their files 8 % smaller and takes three times as long.
_STYLE = store.ParquetStyle(100, compression_level=3, encodings=((f"{records.MESH}.bytes", "PLAIN"),))
# Made once and read by many users; at level 9 the meshes of digits are a fifth larger.
_VIEWER_STYLE = replace(_STYLE, compression_level=19)
# Shards in memory at a time; compression at level 19 takes about 100 MB more for each.
_MAX_AT_ONCE = 8


def divide(
    kind: DatasetKind,
    name: places.Name | places.Place,
    fractions: Sequence[float],
    seed: int,
    chosen: catalog.RowFilter = catalog.RowFilter.ALL,
    *,
    same_objects: bool = False,
) -> tuple[list[dict[str, Int64]], str]:
    """Divide the rows of a data set; return for each part their positions by split, in order.

    Either at random by ``fractions`` of each split, which depends only on the seed and the objects; or,
    without fractions, into the rows that are ``chosen``, and all others. All rows of an object are in one
    part; with ``same_objects``, rows are divided without regard to their objects. Also returns what happened
    to objects: ``"whole"``, ``"divided"`` or, if those of some rows are not known, ``"unknown"``.

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


def _chosen_rows(
    place: places.Place, datasets: Mapping[str, Any], chosen: catalog.RowFilter
) -> dict[str, Int64]:
    """Return the positions of the rows of each split that filters choose; InputError if there are none."""
    only = chosen.only_split
    if only is not None and only not in datasets:
        raise split_files.unknown_split(only, tuple(datasets), place.name)
    among = [item for item in datasets.items() if only in (None, item[0])]
    taken = {split: rows for split, _, rows in chosen.choose(among)}
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
    source = open_source(kind, name, SPLIT)
    return build_copy(kind, [source], _parts_of(source, rows), SPLIT, options, out, run)


def plan_parts(
    kind: DatasetKind,
    name: places.Name | places.Place,
    out: str,
    fractions: Sequence[float],
    seed: int,
    chosen: catalog.RowFilter,
    *,
    same_objects: bool = False,
) -> list[tuple[str, Callable[..., store.Manifest]]]:
    """Divide a data set as :func:`divide` does; return the folder of each part and what writes it.

    Folders are ``part-1``, ``part-2`` and so on in ``out``. The functions take those of ``RunOptions``. The
    option ``objects`` of their manifests says whether objects are whole, divided or unknown.
    """
    options = chosen.given() or {"fractions": fractions, "seed": seed}
    parts, objects = divide(kind, name, fractions, seed, chosen, same_objects=same_objects)
    plans: list[tuple[str, Callable[..., store.Manifest]]] = []
    for number, rows in enumerate(parts, 1):
        if not sum(map(len, rows.values())):
            raise errors.InputError(
                f"no object is left for part {number}",
                next="choose other parts, or add --same-objects (same_objects=True) to divide objects, too",
            )
        folder = f"{out.rstrip('/')}/part-{number}"
        of_part = {**options, "objects": objects, "part": number}
        plans.append((folder, partial(write_part, kind, name, rows, of_part, folder)))
    return plans


def select_rows(
    kind: DatasetKind,
    name: places.Name | places.Place,
    chosen: catalog.RowFilter,
    out: str,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Write chosen rows of a data set as a data set of the same kind."""
    place = places.open_place(name).require(kind, "tactile select").require_complete()
    rows = _chosen_rows(place, {split: kind.load(place, split) for split in place.splits}, chosen)
    source = open_source(kind, place, SELECT)
    return build_copy(kind, [source], _parts_of(source, rows), SELECT, chosen.given(), out, run)


def plan_tables(
    kind: DatasetKind, place: places.Place, chosen: catalog.RowFilter, out: str
) -> store.BuildPlan:
    """Plan Parquet files of chosen rows, which other libraries read.

    Raises InputError if no row is chosen, or ``out`` is in the source or holds something else.
    """
    tasks = []
    shards = {}
    for split, rows, indices in chosen.open(place, kind):
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
    options |= cards.inherited_options([place])
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
        content = _VIEWER_STYLE.encode(records.flat_table(rows))
        path = f"{VIEWER_FOLDER}/{record.shard}.parquet"
        (out / path).write_bytes(content)
        return path, hashlib.sha256(content).hexdigest()

    return dict(run.in_threads(make, manifest.shards, min(run.usable_cores(), _MAX_AT_ONCE)))


@dataclass(frozen=True)
class Source:
    """A data set; ``spec`` is the specification by which its rows were first made, if it is known."""

    place: places.Place
    spec: JsonObject | None
    is_imported: bool
    shards: Mapping[str, tuple[read.Shard, ...]]
    sensor: str | None = None

    @property
    def name(self) -> str:
        """Name of the data set, as the user gave it."""
        return self.place.name

    @property
    def table(self) -> read.ShardedTable:
        """The rows of all splits."""
        return read.ShardedTable(sum(self.shards.values(), ()))


def open_source(kind: DatasetKind, name: places.Name | places.Place, command: str) -> Source:
    """Open a data set of a kind for a copy by a command."""
    place = places.open_place(name).require(kind, f"tactile {command}").require_complete()
    manifest = place.manifest
    shards = {split: place.shards(split, kind=kind) for split in place.splits}
    if manifest is None:
        return Source(place, None, False, shards)
    options = manifest.spec.get("options") or {}
    is_imported = manifest.spec.get("operation") == "import" or options.get("touches") == "imported"
    return Source(place, manifest.made_by or None, is_imported, shards, manifest.sensor)


def _take_rows(source: read.Shard, _shard: store.ShardName, rows: Int64) -> store.ShardContent:
    """Return some rows of a shard, by their positions in order."""
    groups = enumerate(_in_parts(rows, source.group_starts))
    tables = [source.read(groups=[index]).take(rows) for index, rows in groups]
    return store.ShardContent(pa.concat_tables(tables).combine_chunks())


def _parts_of(source: Source, rows: Mapping[str, Int64]) -> dict[str, list[Part]]:
    """Return the parts of a copy of some rows of a source; a split without rows is left out."""
    parts: dict[str, list[Part]] = {}
    for split, shards in source.shards.items():
        inside = _in_parts(rows[split], list(accumulate(map(len, shards), initial=0)))
        pairs = zip(inside, shards, strict=True)
        parts[split] = [(held, partial(_take_rows, shard)) for held, shard in pairs if len(held)]
    return parts


def _in_parts(rows: Int64, starts: Sequence[int]) -> list[Int64]:
    """Divide row numbers, in order, by the parts that hold them, and count from the start of each.

    ``starts`` ends with the number of all rows.
    """
    parts = np.split(rows, np.searchsorted(rows, starts[1:-1]))
    return [part - start for part, start in zip(parts, starts, strict=False)]


def build_copy(
    kind: DatasetKind,
    sources: Sequence[Source],
    parts: Mapping[str, Sequence[Part]],
    operation: str,
    options: JsonObject,
    out: str,
    run: store.RunKeywords,
) -> store.Manifest:
    """Write a copy of data sets; ``parts`` are the items of its shards in each split, and what makes them."""
    folder = store.open_folder(out)
    for source in sources:
        folder.refuse_source(source.name, (file.path for file in source.table.files))
    tasks = [
        store.ShardTask(store.ShardName(split, index, len(of_split)), *part)
        for split, of_split in parts.items()
        for index, part in enumerate(of_split)
    ]
    if not tasks:
        raise errors.InputError(f"no row is left for {out!r}", next="choose a larger part")
    options = {**options, **cards.inherited_options(source.place for source in sources)}
    specs = [source.spec for source in sources]
    if any(source.is_imported for source in sources):
        options = {**options, "touches": "imported"}  # the terms of their source apply
    # Data sets that were made in different ways have no common specification.
    source_spec = specs[0] if all(spec == specs[0] for spec in specs) else None
    if source_spec is None and any(source.sensor for source in sources):
        unstated = [source.is_imported for source in sources if not source.sensor]
        sensors = {source.sensor for source in sources if source.sensor}
        sensors |= {"unknown" if is_imported else touch.GELSIGHT_MINI for is_imported in unstated}
        options = {**options, "sensor": {"name": ", ".join(sorted(sensors))}}
    # Kinds of one package have the same columns, as all touches do.
    made = DatasetKind.named(kind.package) or kind
    splits = dict.fromkeys(split for source in sources for split in source.shards)
    shards_of = {
        split: [shard for source in sources for shard in source.shards.get(split, ())] for split in splits
    }
    plan = copy_plan(made, operation, options, shards_of, source_spec, tasks, _style(sources))
    return store.build(folder, plan, write_card=made.write_card, **run)


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


def _style(sources: Sequence[Source]) -> store.ParquetStyle:
    """Return row groups as in the source with the smallest ones, and the columns without a dictionary.

    The first shard with rows of each source tells.
    """
    rows: list[int] = []
    encodings: dict[str, str] = {}
    for source in sources:
        footers = (shard.metadata for shard in source.table.files)
        groups = (footer.row_group(index) for footer in footers for index in range(footer.num_row_groups))
        group = next((group for group in groups if group.num_rows), None)
        if group is not None:
            rows.append(group.num_rows)
            columns = (group.column(index) for index in range(group.num_columns))
            encodings |= {
                column.path_in_schema: next(name for name in column.encodings if name != "RLE")
                for column in columns
                if not column.has_dictionary_page
            }
    return store.ParquetStyle(min(rows, default=1), encodings=tuple(encodings.items()))


def _flat_rows(_shard: store.ShardName, rows: Any) -> store.ShardContent:
    return store.ShardContent(records.flat_table(rows))
