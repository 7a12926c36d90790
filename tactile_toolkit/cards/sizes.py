"""How large the rows of Parquet files are unpacked, told from footers and short strings alone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from tactile_toolkit.read.parquet import Shard

__all__ = ["unpacked_bytes"]

_OFFSET_BYTES = 4


def unpacked_bytes(shards: Iterable[Shard]) -> int:
    """Return the size of rows in Arrow's memory, which `datasets` calls ``num_bytes``.

    Parameters
    ----------
    shards : iterable of Shard
        Files of one split.

    Returns
    -------
    int
        Within some bytes per row group for numbers and text; pictures and clips count as they lie in the file
        uncompressed, which is more by their page headers; offsets of inner lists are left out.

    Raises
    ------
    IntegrityError
        When a file cannot be read.
    """
    return sum(_shard_bytes(shard) for shard in shards)


def _shard_bytes(shard: Shard) -> int:
    metadata = shard.metadata
    leaves = [leaf for field in shard.schema for leaf in _leaf_types(field.type)]
    groups = [metadata.row_group(index) for index in range(metadata.num_row_groups)]
    numbers = sum(_group_bytes(group, leaves) for group in groups)
    offsets = sum(_offset_bytes(shard.schema, group.num_rows) for group in groups)
    return int(numbers + offsets + _text_bytes(shard, leaves))


def _leaf_types(data_type: Any) -> Iterator[Any]:
    """Yield the innermost types in the order of Parquet's columns."""
    if data_type.num_fields == 0:
        yield data_type
    for index in range(data_type.num_fields):
        yield from _leaf_types(data_type.field(index).type)


def _group_bytes(group: Any, leaves: list[Any]) -> int:
    chunks = [group.column(index) for index in range(group.num_columns)]
    return sum(_chunk_bytes(chunk, leaf) for chunk, leaf in zip(chunks, leaves, strict=True))


def _chunk_bytes(chunk: Any, leaf: Any) -> int:
    if _is_text(leaf):
        return 0  # counted by reading: a dictionary hides its size from the footer
    if _is_binary(leaf):
        return int(chunk.total_uncompressed_size)
    # A bit for each value says whether it is there: readers of columns that may be null keep it.
    return int(chunk.num_values * (leaf.bit_width + 1) // 8)


def _offset_bytes(schema: Any, rows: int) -> int:
    import pyarrow as pa

    lists = [field for field in schema if pa.types.is_list(field.type)]
    return len(lists) * _OFFSET_BYTES * (rows + 1)


def _text_bytes(shard: Shard, leaves: list[Any]) -> int:
    """Read columns of text, which are short, except the names of pictures beside their bytes."""
    paths = [shard.metadata.schema.column(index).path for index in range(len(leaves))]
    blobs = {path.rpartition(".")[0] for path, leaf in zip(paths, leaves, strict=True) if _is_binary(leaf)}
    texts = [
        path
        for path, leaf in zip(paths, leaves, strict=True)
        if _is_text(leaf) and path.rpartition(".")[0] not in blobs
    ]
    read = shard.read(columns=texts) if texts else None
    return 0 if read is None else sum(int(_text_only_bytes(column)) for column in read.columns)


def _text_only_bytes(column: Any) -> int:
    import pyarrow as pa

    chunks = [chunk for chunk in column.chunks if len(chunk)]
    total = 0
    for chunk in chunks:
        inner = chunk
        while not pa.types.is_string(inner.type) and not pa.types.is_large_string(inner.type):
            inner = inner.flatten()[0] if pa.types.is_struct(inner.type) else inner.flatten()
        total += int(inner.nbytes)
    return total


def _is_text(leaf: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_string(leaf) or pa.types.is_large_string(leaf))


def _is_binary(leaf: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_binary(leaf) or pa.types.is_large_binary(leaf))
