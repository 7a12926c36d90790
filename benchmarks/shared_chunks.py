"""How much of a data set the Hub has already where 1 % of its rows differ: pages cut by content, and not.

    python benchmarks/shared_chunks.py digits touches

The Hub's storage cuts files by content (a rolling gear hash, 64 KiB on average) and keeps equal chunks once.
Each folder given is written with the row groups that it has: as it is, and with 1 % of its rows replaced by
others or removed. Printed is the share of the second set's bytes that lie in chunks of the first.
"""

from __future__ import annotations

import hashlib
import io
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

# Any 256 random numbers cut alike; these are not those of the Hub.
GEAR = np.random.default_rng(0).integers(0, 1 << 64, 256, dtype=np.uint64)
MASK = np.uint64(0xFFFF << 48)
LEAST_BYTES, MOST_BYTES = 8 << 10, 128 << 10
WAYS: dict[str, dict[str, Any]] = {
    "as stored": {},
    "by content": {"use_content_defined_chunking": True, "write_page_index": True},
    "by content, 64-256 KiB": {
        "use_content_defined_chunking": {"min_chunk_size": 64 << 10, "max_chunk_size": 256 << 10},
        "write_page_index": True,
    },
}


@numba.njit
def cuts(content: NDArray[np.uint8], gear: NDArray[np.uint64], mask: np.uint64) -> list[int]:
    """Return where chunks end."""
    ends, start, rolling = [0], 0, np.uint64(0)
    for index in range(len(content)):
        rolling = (rolling << np.uint64(1)) + gear[content[index]]
        size = index + 1 - start
        if size >= MOST_BYTES or (size >= LEAST_BYTES and rolling & mask == 0):
            start, rolling = index + 1, np.uint64(0)
            ends.append(start)
    if start < len(content):
        ends.append(len(content))
    return ends


def chunks(files: list[bytes]) -> Iterator[tuple[bytes, int]]:
    """Yield digest and size of each chunk."""
    for content in files:
        ends = cuts(np.frombuffer(content, np.uint8), GEAR, MASK)
        for start, end in pairwise(ends):
            yield hashlib.sha256(content[start:end]).digest(), end - start


def shared(first: list[bytes], second: list[bytes]) -> float:
    """Return the share of the second's bytes that lie in chunks of the first."""
    known = {digest for digest, _ in chunks(first)}
    return sum(size for digest, size in chunks(second) if digest in known) / sum(map(len, second))


def encode(table: pa.Table, like: pq.FileMetaData, way: dict[str, Any]) -> list[bytes]:
    """Write a table as files of the rows, row groups and encodings of another, ours but for checksums."""
    group = like.row_group(0)
    columns = [group.column(index) for index in range(group.num_columns)]
    special = {"PLAIN", "BYTE_STREAM_SPLIT", "DELTA_BINARY_PACKED"}
    kinds = {each.path_in_schema: next(iter(special & {*each.encodings}), None) for each in columns}
    plain = {each.path_in_schema for each in columns if each.has_dictionary_page}
    encodings = {path: kind for path, kind in kinds.items() if kind and path not in plain}
    files = []
    for start in range(0, len(table), like.num_rows):
        stream = io.BytesIO()
        pq.write_table(
            table.slice(start, like.num_rows),
            stream,
            row_group_size=group.num_rows,
            compression="zstd",
            compression_level=3,
            use_dictionary=[path for path in kinds if path not in encodings],
            column_encoding=encodings or None,
            **way,
        )
        files.append(stream.getvalue())
    return files


def main() -> None:
    for folder in sys.argv[1:]:
        paths = sorted(Path(folder, "data").glob("*.parquet"))
        like = pq.read_metadata(paths[0])
        table = pa.concat_tables([pq.read_table(path) for path in paths]).combine_chunks()
        few = max(1, len(table) // 100)
        rows = np.arange(len(table) - few)  # the last are what others are replaced by
        chosen = np.random.default_rng(1).choice(rows, few, replace=False)
        replaced = rows.copy()
        replaced[chosen] = len(rows) + np.arange(few)
        print(f"{folder}: {len(table):,} rows, {like.row_group(0).num_rows:,} in a row group")
        for name, way in WAYS.items():
            first, *others = (
                encode(table.take(pa.array(each)), like, way)
                for each in (rows, replaced, np.delete(rows, chosen))
            )
            shares = " ".join(f"{shared(first, other):6.1%}" for other in others)
            print(f"  {name:22} {sum(map(len, first)):>12,} bytes; replaced, removed: {shares}")


if __name__ == "__main__":
    main()
