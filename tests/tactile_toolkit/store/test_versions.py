"""Folders of the first schema version are opened, verified, continued and finished in its bytes."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.parquet import ParquetStyle, encode_parquet


def test_later_versions_are_refused(tmp_path):
    folder = DataFolder(str(tmp_path))
    make(folder)
    file = tmp_path / "manifest.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"schema_version": 3}))
    with pytest.raises(IntegrityError, match="schema version 3, this toolkit reads up to 2; next: install"):
        make(folder)


def test_a_changed_row_leaves_the_pages_after_it_as_they_were():
    """Pages end with rows, whatever their bytes; in a page, zstd makes others of all that follow."""
    rng = np.random.default_rng(0)

    def image() -> bytes:
        return rng.integers(0, 4, int(rng.integers(9_000, 13_000)), np.uint8).tobytes()

    rows = [[image() for _ in range(4)] for _ in range(40)]
    others = [*rows[:5], [image()] * 4, *rows[6:]]
    style = ParquetStyle(40, encodings=(("images.list.element", "PLAIN"),), values_per_page=4)

    def stored(table: list, style: ParquetStyle) -> bytes:
        content = encode_parquet(pa.table({"images": pa.array(table, pa.list_(pa.binary()))}), style)
        assert pq.read_table(io.BytesIO(content))["images"].to_pylist() == table
        return content

    def is_shared(style: ParquetStyle) -> bool:
        first = stored(rows, style)
        return first[len(first) // 4 : len(first) * 9 // 10] in stored(others, style)

    assert is_shared(style)
    assert not is_shared(replace(style, values_per_page=None))
