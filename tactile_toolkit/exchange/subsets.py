"""Data sets made of others of the same kind: several as one, or one as several."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from tactile_toolkit.catalog.choose import choose_rows
from tactile_toolkit.catalog.locate import find_shards, splits_of
from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import MERGE, SPLIT, DatasetKind, kinds
from tactile_toolkit.read.parquet import Shard, ShardedTable
from tactile_toolkit.read.source import file_fingerprint, manifest_beside, refuse_source
from tactile_toolkit.run.processes import runner_for
from tactile_toolkit.store.build import build
from tactile_toolkit.store.folder import DataFolder, split_uri
from tactile_toolkit.store.job import BuildPlan, ShardContent
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import ParquetStyle, named_damage, open_checked, open_parquet
from tactile_toolkit.store.shards import ShardName

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class _TakeRows:
    """Picklable: a shard of another data set as it is, or some of its rows, by their positions in order."""

    shard: ShardName
    source: Shard = field(repr=False)
    rows: NDArray[np.int64] | None = field(repr=False)

    @property
    def size(self) -> int:
        """How many rows it has."""
        return len(self.source) if self.rows is None else len(self.rows)

    def make(self) -> ShardContent:
        """Read them; IntegrityError where a page or the footer does not match its checksum."""
        import pyarrow as pa

        folder, name = split_uri(self.source.path)
        if self.rows is None:
            content = folder.read_bytes(name)
            with named_damage(self.source.path):
                table = open_checked(io.BytesIO(content)).read(use_threads=False)
            return ShardContent(table, encoded=content)
        parquet, tables = open_parquet(folder, name), []
        for index, (start, stop) in enumerate(pairwise(self.source.group_starts)):
            chosen = self.rows[(self.rows >= start) & (self.rows < stop)] - start
            with named_damage(self.source.path):
                tables.append(parquet.read_row_group(index, use_threads=False).take(chosen))
        return ShardContent(pa.concat_tables(tables).combine_chunks())


@dataclass(frozen=True)
class _Source:
    """A data set; ``spec`` is that of the data set that its rows were first made for, where it is known."""

    name: str
    spec: Mapping[str, Any] | None
    is_imported: bool
    shards: Mapping[str, tuple[Shard, ...]]

    @property
    def table(self) -> ShardedTable:
        return ShardedTable(tuple(shard for shards in self.shards.values() for shard in shards))


def _related_kinds(kind: DatasetKind) -> list[DatasetKind]:
    """List the kinds whose rows have the same columns: synthetic touches are opened as all touches are."""
    return [each for each in kinds() if each.package == kind.package]


def _open_source(kind: DatasetKind, name: str) -> _Source:
    shards = {split: find_shards(name, split) for split in splits_of(name)}
    manifest = manifest_beside(next(iter(shards.values()))[0])
    if manifest is None:
        return _Source(name, None, False, shards)
    if manifest.kind not in [each.name for each in _related_kinds(kind)]:
        kind.refuse_other(manifest, name)
    if manifest.spec.get("operation") in ("export", "frames", "pairs"):
        raise InputError(
            f"{name!r} was made by `{manifest.spec['operation']}` for other programs; expected {kind.nouns}",
            next="give the data set that it was made of",
        )
    options = manifest.spec.get("options") or {}
    is_imported = manifest.spec.get("operation") == "import" or options.get("touches") == "imported"
    return _Source(name, manifest.spec.get("source_spec", manifest.spec), is_imported, shards)


def merge_sets(kind: DatasetKind, names: Sequence[str], out: str, **run: Any) -> Manifest:
    """Make one data set of several, whose shards are copied byte for byte; ``run`` are options of ``build``.

    Raises InputError where they are of another kind, have other columns or classes, or an id in common.
    """
    sources = [_open_source(kind, name) for name in names]
    schemas = [shards[0].schema for source in sources for shards in source.shards.values()]
    if not all(schema.equals(schemas[0], check_metadata=True) for schema in schemas):
        raise InputError(
            f"{', '.join(names)} have different columns or classes; expected data sets made alike"
        )
    if "id" in schemas[0].names:
        ids = np.concatenate([source.table.column("id") for source in sources])
        values, counts = np.unique(ids, return_counts=True)
        if (counts > 1).any():
            raise InputError(
                f"id {values[counts > 1][0]} stands twice in {', '.join(names)} ({(counts > 1).sum():,} such "
                "ids); expected each once",
                next="`split` with --ids takes rows out of a data set",
            )
    return _build(kind, sources, None, MERGE, {}, out, run)


def divide(
    kind: DatasetKind, name: str, fractions: Sequence[float], seed: int, chosen: Mapping[str, Any]
) -> list[dict[str, NDArray[np.int64]]]:
    """Divide the rows of a data set; return for each part their positions by split, in order.

    At random by ``fractions`` of each split, which follows from the seed and the number of rows alone; or,
    without fractions, into the rows that :func:`~tactile_toolkit.catalog.choose.choose_rows` takes for
    ``chosen``, and all others.
    """
    datasets = {split: kind.load(name, split) for split in splits_of(name)}
    if not fractions:
        among = {"split": None, **chosen}
        only = among.pop("split")
        some = choose_rows([(only, datasets[only])] if only in datasets else datasets.items(), **among)
        first = {split: np.zeros(0, np.int64) for split in datasets} | {
            split: rows for split, _, rows in some
        }
        return [first, {each: np.setdiff1d(np.arange(len(datasets[each])), first[each]) for each in first}]
    parts: list[dict[str, NDArray[np.int64]]] = [{} for _ in fractions]
    for split, rows in datasets.items():
        # Doubles of this generator are the same in every version of numpy; shuffles need not be.
        order = np.random.Generator(np.random.PCG64(seed)).random(len(rows)).argsort(kind="stable")
        ends = [round(share * len(rows)) for share in accumulate(fractions, initial=0.0)]
        for part, (start, stop) in zip(parts, pairwise(ends), strict=True):
            part[split] = np.sort(order[start:stop])
    return parts


def write_part(
    kind: DatasetKind,
    name: str,
    rows: Mapping[str, NDArray[np.int64]],
    options: Mapping[str, Any],
    out: str,
    **run: Any,
) -> Manifest:
    """Write rows of a data set as one of the same kind; ``options`` are JSON values that say which."""
    return _build(kind, [_open_source(kind, name)], rows, SPLIT, options, out, run)


def _build(
    kind: DatasetKind,
    sources: Sequence[_Source],
    rows: Mapping[str, NDArray[np.int64]] | None,
    operation: str,
    options: Mapping[str, Any],
    out: str,
    run: dict[str, Any],
) -> Manifest:
    folder, tasks, fingerprints = DataFolder(out), [], {}
    for source in sources:
        refuse_source(folder, source.name, source.table.shards)
    for split in dict.fromkeys(split for source in sources for split in source.shards):
        shards = [shard for source in sources for shard in source.shards.get(split, ())]
        fingerprints[split] = list(map(file_fingerprint, shards))
        parts: list[tuple[Shard, Any]] = [(shard, None) for shard in shards]
        if rows is not None:
            starts = list(accumulate(map(len, shards), initial=0))
            cuts = pairwise(np.searchsorted(rows[split], starts).tolist())
            held = [rows[split][low:high] - start for start, (low, high) in zip(starts, cuts, strict=False)]
            parts = [(shard, part) for shard, part in zip(shards, held, strict=True) if len(part)]
        tasks += [_TakeRows(ShardName(split, index, len(parts)), *part) for index, part in enumerate(parts)]
    if not tasks:
        raise InputError(f"no row is left for {out!r}", next="choose a larger part")
    specs = [source.spec for source in sources]
    if any(source.is_imported for source in sources):
        options = {**options, "touches": "imported"}  # whose terms are those of their source
    spec = {
        "operation": operation,
        "options": options,
        "source": fingerprints,
        # Several that were made in different ways have none in common.
        "source_spec": specs[0] if all(spec == specs[0] for spec in specs) else None,
    }
    made = next((each for each in _related_kinds(kind) if each.name == each.package), kind)
    libraries = ("numpy", "pyarrow")
    plan = BuildPlan(
        made.name, spec, tuple(fingerprints), tuple(tasks), _style(shards[0]), libraries=libraries
    )
    return build(folder, plan, runner_for(run.pop("workers", 1)), write_card=made.write_card, **run)


def _style(shard: Shard) -> ParquetStyle:
    """Return the layout of a shard, but for its compression: row groups, and columns without a dictionary."""
    group = shard.metadata.row_group(0)
    columns = [group.column(index) for index in range(group.num_columns)]
    encodings = [
        (each.path_in_schema, next(name for name in each.encodings if name != "RLE"))
        for each in columns
        if not each.has_dictionary_page
    ]
    return ParquetStyle(group.num_rows, encodings=tuple(encodings))
