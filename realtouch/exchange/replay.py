"""The replay buffer of Diffusion Policy: a Zarr group, zipped, of frames one after another.

Facts of the format (Zarr version 2, which opens a path that ends in ``.zip``): ``data`` has arrays of equal
length along time, ``meta/episode_ends`` the number of the frame behind each episode; images are pixels. What
the buffer is made of stays in ``data``: a row a frame, its image as it was stored.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import IO, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from realtouch.contact import ContactMethod
from realtouch.convert.plan import Conversion, RowChoice, Source
from realtouch.exchange.episodes import ACTION, IMAGE, STATE, TIME, Episodes, only_split
from realtouch.exchange.rows import decoded
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import is_unchanged

_FOLDER = "replay"
_FILE = f"{_FOLDER}/touches.zarr.zip"
_PIXELS = "data/tactile"
_ARRAYS = {STATE: "state", ACTION: "action", TIME: "time_s", "label": "label", "object_id": "object_id"}
_CHUNK_BYTES = 2 << 20
_LEVEL = 1
_IN_MEMORY_BYTES = 64 << 20


def plan(
    source: Source,
    choices: Mapping[str, Sequence[RowChoice]],
    method: ContactMethod,
    options: Mapping[str, Any],
) -> Conversion:
    """Plan a replay buffer; reads footers and one header. InputError for several splits."""
    step = Episodes.of(source, only_split(source, choices, "replay buffer"))
    options = {**options, "image_size": [step.size[1], step.size[0]]}
    write = _WriteBuffer(step.size)
    return Conversion(source, "export", options, step, choices, extra_dirs=(_FOLDER,), write_files=write)


@dataclass(frozen=True)
class _WriteBuffer:
    """Writes the group, once the frames of all shards are there."""

    size: tuple[int, int]

    def __call__(self, folder: DataFolder, manifest: Manifest) -> dict[str, str]:
        """Return the checksum of the file by its path; one that is as it should be is left alone."""
        shards = [Shard(folder.address(record.shard.data_path)) for record in manifest.shards if record.rows]
        with tempfile.SpooledTemporaryFile(_IN_MEMORY_BYTES) as made:
            self._write(made, shards)
            made.seek(0)
            digest = hashlib.file_digest(made, "sha256").hexdigest()
            if not is_unchanged(folder, _FILE, digest, reads=True):
                made.seek(0)
                with folder.writing(_FILE) as stream:
                    shutil.copyfileobj(made, stream)
        return {_FILE: digest}

    def _write(self, stream: IO[bytes], shards: Sequence[Shard]) -> None:
        names = [name for name in _ARRAYS if name in shards[0].types]
        table = pa.concat_tables([shard.read(columns=[*names, "frame_index"]) for shard in shards])
        starts = np.flatnonzero(table["frame_index"].to_numpy() == 0)
        arrays = {f"data/{_ARRAYS[name]}": _numbers(table[name]) for name in names}
        arrays["meta/episode_ends"] = np.append(starts[1:], len(table)).astype("<i8")
        shape = (len(table), *self.size, 3)
        length = max(1, _CHUNK_BYTES // (3 * self.size[0] * self.size[1]))
        with zipfile.ZipFile(stream, "w") as group:

            def write(path: str, content: bytes) -> None:
                group.writestr(zipfile.ZipInfo(path), content)  # of no time: equal frames give equal bytes

            for path in (".zgroup", "data/.zgroup", "meta/.zgroup"):
                write(path, json.dumps({"zarr_format": 2}).encode())
            for path, values in arrays.items():
                write(f"{path}/.zarray", _description(values.shape, values.shape, values.dtype.str))
                write(f"{path}/{'.'.join('0' * values.ndim)}", zlib.compress(values.tobytes(), _LEVEL))
            write(f"{_PIXELS}/.zarray", _description(shape, (length, *shape[1:]), "|u1"))
            chunk = np.zeros((length, *shape[1:]), np.uint8)
            for number, image in enumerate(_images(shards)):
                decoded(image["bytes"], image["path"], chunk[number % length])
                if (number + 1) % length == 0 or number + 1 == len(table):
                    chunk[number % length + 1 :] = 0  # as a chunk is filled behind the end
                    write(f"{_PIXELS}/{number // length}.0.0.0", zlib.compress(chunk.tobytes(), _LEVEL))


def _images(shards: Sequence[Shard]) -> Any:
    """Yield the stored image of each frame, and its name."""
    for shard in shards:
        for index in range(shard.metadata.num_row_groups):
            for group in shard.blocks(index, [IMAGE]):
                yield from (image.as_py() for image in group.table[IMAGE])


def _numbers(column: pa.ChunkedArray) -> NDArray[Any]:
    """Return a column of numbers, or of lists of equal length, as an array, little end first."""
    values = column.combine_chunks()
    is_list = pa.types.is_fixed_size_list(values.type)
    found: NDArray[Any] = (values.flatten() if is_list else values).to_numpy()
    found = found.astype(found.dtype.newbyteorder("<"))
    return found.reshape(len(values), -1) if is_list else found


def _description(shape: Sequence[int], chunks: Sequence[int], dtype: str) -> bytes:
    """Return what Zarr states of an array."""
    stated = {"zarr_format": 2, "shape": list(shape), "chunks": list(chunks), "dtype": dtype, "order": "C"}
    stated |= {"compressor": {"id": "zlib", "level": _LEVEL}, "fill_value": 0, "filters": None}
    return json.dumps(stated, indent=4).encode()
