"""Properties of Parquet files that the store determines without reading them again."""

from __future__ import annotations

import hashlib
import io
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tactile_toolkit.store.parquet import (
    ParquetStyle,
    open_checked,
    stream_parquet,
)

MEDIA = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
PLACEMENT = pa.struct([("shape", pa.string()), ("x_m", pa.float64())])
SCHEMA = pa.schema(
    [
        ("id", pa.int64()),
        ("mesh.vertices", pa.list_(pa.list_(pa.float32(), 3))),
        ("name", pa.string()),
        ("info", pa.struct([("notes", pa.string()), ("used", pa.bool_())])),
        ("placements", pa.list_(PLACEMENT)),
        ("images", pa.list_(pa.field("frame", MEDIA))),
        ("words", pa.large_list(pa.string())),
    ]
)


def table(rows: int) -> pa.Table:
    values = [
        {
            "id": row,
            "mesh.vertices": [[row, 1, 2]] * (row % 4),
            "name": None if row % 3 == 0 else "digit" * (row % 5),
            "info": {"notes": "ä" * row, "used": row % 2 == 0},
            "placements": [{"shape": "box", "x_m": 0.5}] * (row % 3),
            "images": [{"bytes": bytes(row), "path": f"{row}.jpg"}],
            "words": None if row % 7 == 0 else ["a", None, "bc"],
        }
        for row in range(rows)
    ]
    return pa.Table.from_pylist(values, schema=SCHEMA)


def test_columns_of_any_nesting_have_the_requested_encoding() -> None:
    """The names of nested columns follow from the schema, as Parquet spells them."""
    encodings = (
        ("mesh.vertices.list.element.list.element", "BYTE_STREAM_SPLIT"),
        ("placements.list.element.x_m", "PLAIN"),
        ("images.list.element.bytes", "PLAIN"),
        ("info.notes", "DELTA_BYTE_ARRAY"),
    )
    content = ParquetStyle(rows_per_group=50, encodings=encodings).encode(table(23))
    group = pq.ParquetFile(io.BytesIO(content)).metadata.row_group(0)
    columns = {group.column(index).path_in_schema: group.column(index) for index in range(group.num_columns)}
    for path, encoding in encodings:
        assert encoding in columns[path].encodings
        assert not columns[path].has_dictionary_page
        assert not columns[path].is_stats_set
    others = set(columns) - {path for path, _ in encodings}
    assert {path for path in others if columns[path].has_dictionary_page} == others - {"info.used"}
    assert all(columns[path].is_stats_set for path in others)


@pytest.mark.parametrize("sizes", [[7], [3], [1, 1, 1], [2, 5, 0, 1, 9], [0, 4], [0]])
def test_tables_one_after_another_are_the_bytes_of_all_at_once(sizes):
    tables = [table(size) for size in sizes]
    stream = io.BytesIO()
    checksum = stream_parquet(stream, iter(tables), ParquetStyle(rows_per_group=3))
    whole = ParquetStyle(rows_per_group=3).encode(pa.concat_tables(tables))
    assert (stream.getvalue(), checksum) == (whole, hashlib.sha256(whole).hexdigest())


def test_of_tables_one_after_another_no_more_than_a_row_group_is_held():
    written = io.BytesIO()
    sizes = []

    def tables():
        for _ in range(6):
            yield table(3)
            sizes.append(len(written.getvalue()))

    stream_parquet(written, tables(), ParquetStyle(rows_per_group=3))
    assert sizes[0] < sizes[2] < sizes[4] < len(written.getvalue())


@pytest.mark.parametrize("size", [1_000, 200_000])
def test_a_changed_footer_of_any_length_is_found(size):
    notes = pa.schema([("id", pa.int64())], metadata={"notes": "a" * size})
    content = ParquetStyle(rows_per_group=3).encode(pa.table({"id": [1]}, schema=notes))
    assert open_checked(io.BytesIO(content)).schema_arrow.metadata == {b"notes": b"a" * size}
    changed = content.replace(b"aaaa", b"abaa", 1)  # which Parquet itself ignores
    with pytest.raises(pa.ArrowInvalid, match="the footer does not match its checksum"):
        open_checked(io.BytesIO(changed))


def test_a_changed_row_leaves_the_pages_after_it_as_they_were():
    """Pages end at rows, not at sizes; inside a page, a change alters all following bytes of zstd."""
    rng = np.random.default_rng(0)

    def image() -> bytes:
        return rng.integers(0, 4, int(rng.integers(9_000, 13_000)), np.uint8).tobytes()

    rows = [[image() for _ in range(4)] for _ in range(40)]
    others = [*rows[:5], [image()] * 4, *rows[6:]]
    style = ParquetStyle(40, encodings=(("images.list.element", "PLAIN"),), values_per_page=4)

    def stored(table: list, style: ParquetStyle) -> bytes:
        content = style.encode(pa.table({"images": pa.array(table, pa.list_(pa.binary()))}))
        assert pq.read_table(io.BytesIO(content))["images"].to_pylist() == table
        return content

    def is_shared(style: ParquetStyle) -> bool:
        first = stored(rows, style)
        return first[len(first) // 4 : len(first) * 9 // 10] in stored(others, style)

    assert is_shared(style)
    assert not is_shared(replace(style, values_per_page=None))
