"""Running conversions: planned from footers, each shard made from its own rows, block by block.

An interrupted conversion continues where it stopped. The same source and options give byte-identical Parquet
for any number of workers; see ``tactile_toolkit.store``.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, chain
from os import PathLike, fspath
from typing import Unpack

import pyarrow as pa

from realtouch import kind, stored_round, touch_card
from realtouch.convert.conversion import Conversion, Pack, RowChoice, Source, Step, files_of, require_limit
from realtouch.schema import flat_schema, origin_of
from tactile_toolkit import catalog, errors, places, read, store, touch

# Unpacked rows that a worker may hold.
_SHARD_BYTES = 256 << 20
# A touch read at random unpacks its whole row group.
_GROUP_BYTES = 32 << 20
_PAGE_BYTES = 256 << 10  # images of a round do not compress better in larger pages
_MAX_ROWS_PER_SHARD = 64


@dataclass(frozen=True, eq=False)
class _ConvertRows:
    """Makes shards of a conversion; picklable.

    ``shards`` are the files of the source with the rows, ``start`` is the number of their first row.
    """

    shards: Sequence[read.Shard]
    start: int
    step: Step
    schema: pa.Schema
    pack: Pack | None

    def __call__(self, shard: store.ShardName, choices: Sequence[RowChoice]) -> store.ShardContent:
        """Convert rows; damaged ones are left out and listed."""
        tables, skipped = [self.schema.empty_table()], []
        files: dict[str, bytes] = {}
        for choice, row in self._rows(choices):
            try:
                if choice.is_repeated:
                    raise row.damaged(
                        "id",
                        f"{row.value('id')!r} is also the id of an earlier round of split {shard.split!r}; "
                        "expected unique ids",
                    )
                # Checked for all steps: those that copy a column do not read it.
                row.require_touches()
                made, beside = self.step.apply(row, choice, shard.split)
                # Cast: Arrow names the items of lists in several ways, and a file has one schema.
                tables.append(made.cast(self.schema))
                files |= beside
            except errors.IntegrityError as error:
                message = str(error)
                for each in self.shards:  # as the manifest names them: their folder may be private
                    message = message.replace(each.path, each.path.rpartition("/")[2])
                skipped.append(store.Skipped(choice.row, store.Skipped.DAMAGED, message))
        kept = pa.concat_tables(tables)
        if self.pack is not None:
            kept, packed = self.pack(shard, kept, skipped)
            files |= packed
        # Arrow's own allocator takes many times as long for hundreds of megabytes.
        whole = kept.combine_chunks(memory_pool=pa.system_memory_pool())
        return store.ShardContent(whole, tuple(skipped), files=files)

    def _rows(self, choices: Sequence[RowChoice]) -> Iterator[tuple[RowChoice, stored_round.StoredRound]]:
        """Read the blocks that hold chosen rows, one at a time, in order."""
        # Row groups without a chosen row are not read at all.
        wanted = {choice.row: choice for choice in choices}
        first, last = min(wanted), max(wanted)
        start = self.start
        for shard in self.shards:
            for index, group_start in enumerate(shard.group_starts[:-1]):
                if start + shard.group_starts[index + 1] <= first or start + group_start > last:
                    continue
                for group in shard.blocks(index):
                    for position in range(len(group.table)):
                        number = start + group.first_row + position
                        if number in wanted:
                            yield wanted[number], stored_round.StoredRound(group, position)
            start += len(shard)


def plan_conversion(conversion: Conversion) -> store.BuildPlan:
    """Divide rows into shards; reads footers only. InputError if nothing is left to convert."""
    source, step = conversion.source, conversion.step
    names = source.class_names
    schema = touch.with_features(step.schema(flat_schema(source.schema)), names)
    row_bytes = source.row_bytes()
    per_shard = conversion.rows_per_shard or max(1, min(_MAX_ROWS_PER_SHARD, _SHARD_BYTES // row_bytes))
    per_group = conversion.rows_per_group or max(1, min(per_shard, _GROUP_BYTES // row_bytes))
    tasks = []
    for split, choices in conversion.choices.items():
        shards = source.shards[split]
        starts = [0, *accumulate(map(len, shards))]
        size = per_shard
        if conversion.rows_per_shard is None:  # a large split gets shards as large as a worker can hold
            most = max(per_shard, _SHARD_BYTES // row_bytes)
            size = min(store.rows_per_shard(len(choices), per_shard), most)
        chunks = [choices[start : start + size] for start in range(0, len(choices), size)]
        for index, chunk in enumerate(chunks):
            first, last = (bisect_right(starts, chunk[end].row) - 1 for end in (0, -1))
            work = _ConvertRows(shards[first : last + 1], starts[first], step, schema, conversion.pack)
            tasks.append(store.ShardTask(store.ShardName(split, index, len(chunks)), chunk, work))
    if not tasks:
        raise errors.InputError(
            f"nothing is left of {source.name!r} after {conversion.operation!r}", next="choose fewer filters"
        )
    spec = {
        "operation": conversion.operation,
        "options": dict(conversion.options),
        "rows_per_shard": per_shard,
        "source": source.fingerprint(),
    }
    # JPEG does not compress again, and a dictionary or statistics of pictures would only take space.
    encodings: tuple[tuple[str, str], ...] = ()
    per_page = None
    if conversion.pack is None:
        lists = [f"{name}.list.element" for name in touch.MEDIA_COLUMN.values() if name in schema.names]
        single = [name for name in schema.names if schema.field(name).type == touch.MEDIA_TYPE]
        encodings = tuple((f"{name}.bytes", "PLAIN") for name in [*lists, *single])
        if lists:
            per_page = max(1, _PAGE_BYTES // source.media_bytes())
    return store.BuildPlan(
        kind.KIND.name,
        spec,
        tuple(source.shards),
        tuple(tasks),
        store.ParquetStyle(per_group, compression_level=3, encodings=encodings, values_per_page=per_page),
        extra_dirs=conversion.extra_dirs,
        files_of=files_of,
        libraries=("numpy", "pillow", "pyarrow", "simplejpeg"),
        write_files=conversion.write_files,
    )


class JobOptions(store.RunKeywords, total=False):
    """Options of all conversions; see :func:`realtouch.clips_to_images`."""

    split: str | None
    limit: int | None


def write_conversion(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    plan: Callable[[Source, int | None], Conversion],
    *,
    split: str | None = None,
    limit: int | None = None,
    **run: Unpack[store.RunKeywords],
) -> store.Manifest:
    """Write a conversion as a data set folder with a card; an interrupted one continues where it stopped.

    ``plan`` is a function of the source and the greatest number of rounds of each split.
    """
    opened, folder = Source.open(source, split=split), store.open_folder(fspath(out))
    conversion = plan(opened, require_limit(limit))
    catalog.refuse_source(folder, opened.name, chain.from_iterable(opened.shards.values()))
    origin = origin_of(opened.schema, opened.manifest())
    # Recorded here, as pictures do not show whether touches were imported or rendered; rounds do.
    if opened.unfinished:
        conversion = replace(conversion, options={**conversion.options, "unfinished": opened.unfinished})
    if origin == "imported" or (origin == "synthetic" and conversion.operation in ("frames", "export")):
        conversion = replace(conversion, options={**conversion.options, "touches": origin})
    return store.build(folder, plan_conversion(conversion), write_card=touch_card.write_card, **run)
