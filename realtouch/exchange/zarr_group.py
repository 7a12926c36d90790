"""Groups of Zarr version 2: written into a zip without any package, opened by Zarr itself.

Facts of the format: ``.zgroup`` and ``.zarray`` are JSON; a chunk is a file named by its number along each
axis.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Sequence
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from tactile_toolkit.errors import InputError, needs_extra
from tactile_toolkit.store.folder import DataFolder

_LEVEL = 1


class ZarrWriter(zipfile.ZipFile):
    """A zip of arrays whose chunks follow each other along the first axis; equal arrays give equal bytes."""

    def __init__(self, stream: IO[bytes], groups: Sequence[str]) -> None:
        super().__init__(stream, "w")
        for path in ("", *(f"{name}/" for name in groups)):
            self._add(f"{path}.zgroup", json.dumps({"zarr_format": 2}).encode())

    def __enter__(self) -> Self:
        return self

    def describe(self, path: str, shape: Sequence[int], chunks: Sequence[int], dtype: str) -> None:
        """Write what Zarr states of an array."""
        stated = {
            "zarr_format": 2,
            "shape": list(shape),
            "chunks": list(chunks),
            "dtype": dtype,
            "order": "C",
        }
        stated |= {"compressor": {"id": "zlib", "level": _LEVEL}, "fill_value": 0, "filters": None}
        self._add(f"{path}/.zarray", json.dumps(stated, indent=4).encode())

    def chunk(self, path: str, number: int, values: NDArray[Any]) -> None:
        """Write a chunk, which holds the other axes completely."""
        name = ".".join([str(number), *"0" * (values.ndim - 1)])
        self._add(f"{path}/{name}", zlib.compress(np.ascontiguousarray(values).tobytes(), _LEVEL))

    def _add(self, path: str, content: bytes) -> None:
        self.writestr(zipfile.ZipInfo(path), content)  # without a time of writing


def path_of_group(home: DataFolder) -> str:
    """Return the group that a folder is, or the only one that it holds."""
    if home.exists(".zgroup") or home.address().endswith(".zip"):
        return home.address()
    found = [name for name in home.names() if name.endswith((".zarr", ".zarr.zip"))]
    if len(found) != 1:
        raise InputError(f"{home.address()!r} should hold one Zarr group; found {', '.join(found) or 'none'}")
    return home.address(found[0])


def open_group(path: str) -> Any:
    """Open a group, in a zip or not, with the package; raises what it raises."""
    with needs_extra("importing a replay buffer", "zarr", "zarr"):
        import zarr
    place: Any = zarr.storage.ZipStore(path, mode="r") if path.endswith(".zip") else path
    return zarr.open_group(place, mode="r", zarr_format=2)
