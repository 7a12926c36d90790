"""Zips of Zarr 2, written: equal arrays give equal bytes, for any number of workers.

The package zarr writes into zips, too, with the time of day in each entry.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from typing import IO, Any

import numpy as np

from tactile_toolkit.array_types import AnyArray

CHUNK_BYTES = 2 << 20
_LEVEL = 1


def rows_of_chunk(row_bytes: int) -> int:
    """Return how many rows a chunk holds."""
    return max(1, CHUNK_BYTES // row_bytes)


class ZarrWriter(zipfile.ZipFile):
    """A zip of arrays, whose chunks follow each other along the first axis."""

    def __init__(self, stream: IO[bytes]) -> None:
        super().__init__(stream, "w")
        for path in (".zgroup", "data/.zgroup", "meta/.zgroup"):
            self.add_json(path, {"zarr_format": 2})

    def add_json(self, path: str, stated: Mapping[str, object], indent: int | None = None) -> None:
        """Write a file of JSON."""
        self._add(path, json.dumps(stated, indent=indent).encode())

    def add_array(self, path: str, values: AnyArray) -> None:
        """Write an array; where it is a zero that is repeated, without any chunk."""
        rows = max(1, min(len(values), rows_of_chunk(values[:1].nbytes)))
        starts = range(0, len(values) if any(values.strides) else 0, rows)
        blocks = (values[start : start + rows] for start in starts)
        self.add_blocks(path, values.shape, values.dtype, rows, blocks)

    def add_blocks(
        self, path: str, shape: Sequence[int], dtype: np.dtype[Any], rows: int, blocks: Iterable[AnyArray]
    ) -> None:
        """Write an array that is made block by block, each a chunk of so many rows; the last has fewer."""
        stated = {
            "zarr_format": 2,
            "shape": list(shape),
            "chunks": [rows, *shape[1:]],
            "dtype": dtype.str,
            "order": "C",
            "compressor": {"id": "zlib", "level": _LEVEL},
            "fill_value": "" if dtype.kind == "U" else 0,
            "filters": None,
        }
        self.add_json(f"{path}/.zarray", stated, indent=4)
        for number, block in enumerate(blocks):
            content = block.tobytes().ljust(rows * block[:1].nbytes, b"\0")  # zeros follow the last row
            name = ".".join([str(number), *"0" * (len(shape) - 1)])
            self._add(f"{path}/{name}", zlib.compress(content, _LEVEL))

    def _add(self, path: str, content: bytes) -> None:
        self.writestr(zipfile.ZipInfo(path), content)  # without a time of writing
