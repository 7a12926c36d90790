"""Files of arrays (.npz): equal arrays give equal bytes, and sizes are checked before anything is read."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tactile_toolkit import cache, store
from tactile_toolkit.array_types import AnyArray


def npz_bytes(arrays: Mapping[str, AnyArray], comment: bytes = b"") -> bytes:
    """Return the bytes of a file of arrays; equal arrays give equal bytes."""
    buffer = io.BytesIO()
    # Stored, not deflated: floats do not compress, and zlib differs between machines.
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))  # the same time in each file
            with archive.open(entry, "w") as stream:
                np.lib.format.write_array(stream, np.ascontiguousarray(array), allow_pickle=False)
        archive.comment = comment
    return buffer.getvalue()


def read_npz(path: Path) -> tuple[dict[str, AnyArray], bytes]:
    """Read the arrays and the comment of a file; numpy and zipfile raise many kinds of errors for others."""
    with store.open_regular(path) as stream, zipfile.ZipFile(stream) as archive:
        cache.require_unpackable(sum(entry.file_size for entry in archive.infolist()), repr(str(path)))
        comment = archive.comment
        stream.seek(0)
        with np.load(stream, allow_pickle=False) as stored:
            return dict(stored), comment
