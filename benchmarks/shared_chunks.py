"""Share of a data set that the Hub already stores if it stores one that differs in 1 % of the rows.

    python benchmarks/shared_chunks.py digits touches

The Hub's storage cuts files by content (a rolling gear hash, 64 KiB on average) and keeps equal chunks once.
The shards of each folder are written with pages of a fixed size, and in the style of their kind: unchanged,
with 1 % of the rows replaced, and with these removed. The script prints the share of the bytes of each
changed set that lie in chunks of the unchanged one.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numba
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from mnist3d.digit_records import PARQUET_STYLE
from tactile_sim import TouchPlan, TouchSetSpec
from tactile_sim.sets.generation import TouchGenerator
from tactile_toolkit.store import DataFolder, ParquetStyle, open_folder, read_manifest

# Any 256 random numbers give chunks of the same mean size; those of the Hub are different.
GEAR = np.random.default_rng(0).integers(0, 1 << 64, 256, dtype=np.uint64)
MASK = np.uint64(0xFFFF << 48)
LEAST_BYTES, MAX_BYTES = 8 << 10, 128 << 10


@numba.njit
def cuts(content: NDArray[np.uint8], gear: NDArray[np.uint64], mask: np.uint64) -> list[int]:
    """Return where chunks end."""
    ends, start, rolling = [0], 0, np.uint64(0)
    for index in range(len(content)):
        rolling = (rolling << np.uint64(1)) + gear[content[index]]
        size = index + 1 - start
        if size >= MAX_BYTES or (size >= LEAST_BYTES and rolling & mask == 0):
            start, rolling = index + 1, np.uint64(0)
            ends.append(start)
    if start < len(content):
        ends.append(len(content))
    return ends


def chunks(files: list[bytes]) -> Iterator[tuple[bytes, int]]:
    """Yield digest and size of each chunk."""
    for content in files:
        # numba's annotations have no arguments.
        ends = cuts(np.frombuffer(content, np.uint8), GEAR, MASK)  # type: ignore[call-arg]
        for start, end in pairwise(ends):
            yield hashlib.sha256(content[start:end]).digest(), end - start


def shared(first: list[bytes], second: list[bytes]) -> float:
    """Return the share of the second's bytes that lie in chunks of the first."""
    known = {digest for digest, _ in chunks(first)}
    return sum(size for digest, size in chunks(second) if digest in known) / sum(map(len, second))


def style_of(folder: DataFolder) -> ParquetStyle:
    """Return the style in which such a set is stored."""
    manifest = read_manifest(folder)
    assert manifest is not None
    if manifest.kind == "mnist3d":
        return PARQUET_STYLE
    options = manifest.spec["options"]
    spec = TouchSetSpec(tuple(options["size_px"]), plan=TouchPlan(touches=options["plan"]["touches"]))
    return TouchGenerator(spec, {}, {}).layout().style


def changed(tables: list[pa.Table]) -> tuple[list[pa.Table], list[pa.Table], list[pa.Table]]:
    """Return shards, the same with 1 % of their rows replaced by some of the last, and with these removed."""
    rows = sum(map(len, tables))
    few = max(1, rows // 100)
    spare, tables = tables[-1].slice(0, few), [*tables[:-1], tables[-1].slice(few)]
    chosen = np.random.default_rng(1).choice(rows - few, few, replace=False)
    replaced, removed, start, used = [], [], 0, 0
    for table in tables:
        inside = np.sort(chosen[(chosen >= start) & (chosen < start + len(table))]) - start
        order = np.arange(len(table))
        order[inside] = len(table) + used + np.arange(len(inside))
        replaced.append(pa.concat_tables([table, spare]).combine_chunks().take(pa.array(order)))
        removed.append(table.take(pa.array(np.delete(np.arange(len(table)), inside))))
        start, used = start + len(table), used + len(inside)
    return tables, replaced, removed


def main() -> None:
    for name in sys.argv[1:]:
        paths = sorted(Path(name, "data").glob("*.parquet"))
        sets = changed([pq.read_table(path).combine_chunks() for path in paths])
        print(f"{name}: {sum(map(len, sets[0])):,} rows in {len(paths):,} shards")
        stored = style_of(open_folder(name))
        plain = replace(stored, values_per_page=None, chunks_by_content=False, page_index=False)
        for pages, style in (("plain", plain), ("ours", stored)):
            first, *changed_sets = ([style.encode(table) for table in tables] for tables in sets)
            shares = " ".join(f"{shared(first, second):6.1%}" for second in changed_sets)
            print(f"  {pages:6} {sum(map(len, first)):>12,} bytes; replaced, removed: {shares}")


if __name__ == "__main__":
    main()
