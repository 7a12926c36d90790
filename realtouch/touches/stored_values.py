"""Values of all stored touches of a table, read from a few small columns and kept with the table."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from realtouch import contact
from realtouch.touches import schema, stored_round
from tactile_toolkit import errors, read, touch, wording
from tactile_toolkit.value_types import Float64, Int64

# Columns with an entry for each touch; pictures come last, as they take much memory.
_COUNTING = (
    "pos_in_cell",
    "video_length_frames",
    f"{schema.POSE_COLUMN['single']}.position",
    *schema.MEDIA_COLUMN.values(),
)


def touch_counts(source: read.RowSource, *groups: int) -> Int64:
    """Return the numbers of touches of some row groups, or of all, shape (rows,).

    If the type of the column fixes the number, no row is read.
    """
    types = read.column_types(source.schema)
    chosen = groups or range(len(source.group_starts) - 1)
    name = next(name for name in _COUNTING if name in types)
    if pa.types.is_fixed_size_list(types[name]):
        rows = sum(source.group_starts[index + 1] - source.group_starts[index] for index in chosen)
        return np.full(rows, types[name].list_size, np.int64)
    column = name
    if name in schema.MEDIA_COLUMN.values() and isinstance(source, read.Shard):
        # The names of pictures are counted: pictures fill the memory.
        leaf = f"{name}.list.element.path"
        if any(chunk.path_in_schema == leaf for chunk in source.column_chunks()):
            column = leaf
    blocks = (block for index in chosen for block in source.blocks(index, [column]))
    counts = [pc.fill_null(pc.list_value_length(block.arrow(name)), 0) for block in blocks]
    return np.concatenate([of_block.to_numpy() for of_block in counts] or [np.zeros(0)]).astype(np.int64)


def starts(table: read.ShardedTable) -> Int64:
    """Return the number of the first touch of each stored row, shape (stored rows + 1,), int64."""
    counts = table.per_shard("touches", lambda source: [touch_counts(source)])
    return np.concatenate([[0], np.cumsum(counts)])


def heights_m(table: read.ShardedTable, recalibrate_z: bool) -> Float64:
    """Read the height of every stored touch; see :func:`realtouch.contact.contact_heights_m`.

    Shape (touches of all stored rows,), metres above the plate, NaN where it cannot be read. Where the height
    of the plate is known, it is always taken.
    """

    def known(row: stored_round.StoredRound, source: schema.ContactSource) -> Float64:
        z_m = row.readable(row.contact_z_m)
        is_known = source.heights is not None and source.heights.plate == "known"
        return contact.contact_heights_m(z_m, recalibrate_z or is_known, row.plate_z_m(source.heights))

    counting = [touch.HeightRule.PLATE_COLUMN, "pos_in_cell", "video_length_frames"]
    return _per_touch(table, f"heights {recalibrate_z}", counting, schema.POSITION_COLUMNS, known)


def positions_m(table: read.ShardedTable) -> Float64:
    """Read the intended position of every stored touch; NaN if it cannot be read.

    Shape (touches of all stored rows, 2), metres, cell frame; reads that column only.
    """

    def known(row: stored_round.StoredRound, _source: schema.ContactSource) -> Float64:
        return row.readable(row.intended_positions, (2,))

    return _per_touch(table, "positions", (), ["pos_in_cell"], known, (2,))


def stated_contact(table: read.ShardedTable) -> Float64:
    """Read the column of contact of every stored touch: 1, 0, or NaN where it cannot be read.

    Shape (touches of all stored rows,).
    """

    def known(row: stored_round.StoredRound, _source: schema.ContactSource) -> Float64:
        return row.readable(row.stated_contact)

    return _per_touch(table, "contact", (), [schema.CONTACT_COLUMN], known)


def _per_touch(
    table: read.ShardedTable,
    key: str,
    counting: Sequence[str],
    columns: Sequence[str],
    known: Callable[[stored_round.StoredRound, schema.ContactSource], Float64],
    shape: tuple[int, ...] = (),
) -> Float64:
    """Join the values of the touches of each stored row; reads a few columns.

    Values follow from any one of ``columns``; they are NaN in files without one. ``counting`` are read, too.
    """

    def of_source(source: read.RowSource) -> list[Float64]:
        types = read.column_types(source.schema)
        if not types.keys() & set(columns):
            return [np.full((int(touch_counts(source).sum()), *shape), np.nan)]
        contact_source = schema.ContactSource.of(types)
        rows = stored_round.stored_rows([source], [*counting, *columns])
        return [known(row, contact_source) for row in rows]

    values = table.per_shard(key, of_source)
    expected = int(starts(table)[-1])
    if len(values) != expected:
        raise errors.IntegrityError(
            f"{wording.with_count(len(values), 'poses')} of touches for {expected:,} touches; "
            "expected one each",
            next="run `tactile verify`, which names the rounds",
        )
    return values
