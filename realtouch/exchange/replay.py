"""The replay buffer of Diffusion Policy: a Zarr group, zipped, of frames one after another.

Facts of the format (Zarr version 2, which opens a path that ends in ``.zip``): ``data`` has arrays of equal
length along time, ``meta/episode_ends`` the number of the frame behind each episode; images are pixels. What
the buffer is made of stays in ``data``: a row a frame, its image as it was stored. Writing needs no package;
buffers of others, whose compressors are many, are read by Zarr itself. ``.zgroup`` and ``.zarray`` are JSON;
a chunk is a file named by its number along each axis.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import IO, Any, Self

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from realtouch.columns import stored_rows
from realtouch.contact import ContactMethod
from realtouch.convert.plan import Choices, Conversion, Source
from realtouch.exchange.episodes import ACTION, IMAGE, STATE, TIME, Episodes, only_split
from realtouch.exchange.items import Item, decoded
from realtouch.spec import POSE_COLUMNS, POSITION_COLUMNS, ImportColumns
from tactile_toolkit.errors import InputError, needs_extra
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest
from tactile_toolkit.store.parquet import is_unchanged
from tactile_toolkit.touch.jpeg import encode_image

_FOLDER = "replay"
_FILE = f"{_FOLDER}/touches.zarr.zip"
_PIXELS = "data/tactile"
_ARRAYS = {STATE: "state", ACTION: "action", TIME: "time_s", "label": "label", "object_id": "object_id"}
_CHUNK_BYTES = 2 << 20
_IN_MEMORY_BYTES = 64 << 20


def plan(source: Source, choices: Choices, method: ContactMethod, options: Mapping[str, Any]) -> Conversion:
    """Plan a replay buffer; reads footers and one header. InputError for several splits."""
    step = Episodes.of(source, only_split(source, choices, "replay buffer"))
    options = {**options, "image_size": [step.size[1], step.size[0]]}
    write = _WriteBuffer(step.size)
    return Conversion(source, "export", options, step, choices, extra_dirs=(_FOLDER,), write_files=write)


def _copy(source: IO[bytes], target: IO[bytes]) -> None:
    source.seek(0)
    shutil.copyfileobj(source, target)


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
            if not is_unchanged(folder, _FILE, digest):
                folder.write(_FILE, lambda stream: _copy(made, stream))
        return {_FILE: digest}

    def _write(self, stream: IO[bytes], shards: Sequence[Shard]) -> None:
        names = [name for name in _ARRAYS if name in shards[0].types]
        table = pa.concat_tables([shard.read(columns=[*names, "frame_index"]) for shard in shards])
        starts = np.flatnonzero(table["frame_index"].to_numpy() == 0)
        arrays = {f"data/{_ARRAYS[name]}": _numbers(table[name]) for name in names}
        arrays["meta/episode_ends"] = np.append(starts[1:], len(table)).astype("<i8")
        shape = (len(table), *self.size, 3)
        length = max(1, _CHUNK_BYTES // (3 * self.size[0] * self.size[1]))
        with ZarrWriter(stream, ("data", "meta")) as group:
            for path, values in arrays.items():
                group.describe(path, values.shape, values.shape, values.dtype.str)
                group.chunk(path, 0, values)
            group.describe(_PIXELS, shape, (length, *shape[1:]), "|u1")
            chunk = np.zeros((length, *shape[1:]), np.uint8)
            for number, image in enumerate(_images(shards)):
                decoded(image["bytes"], image["path"], chunk[number % length])
                if (number + 1) % length == 0 or number + 1 == len(table):
                    chunk[number % length + 1 :] = 0  # as a chunk is filled behind the end
                    group.chunk(_PIXELS, number // length, chunk)


def _images(shards: Sequence[Shard]) -> Any:
    """Yield the stored image of each frame, and its name."""
    yield from (row.group.table[IMAGE][row.index].as_py() for row in stored_rows(shards, [IMAGE]))


def _numbers(column: pa.ChunkedArray) -> NDArray[Any]:
    """Return a column of numbers, or of lists of equal length, as an array, little end first."""
    values = column.combine_chunks()
    is_list = pa.types.is_fixed_size_list(values.type)
    found: NDArray[Any] = (values.flatten() if is_list else values).to_numpy()
    found = found.astype(found.dtype.newbyteorder("<"))
    return found.reshape(len(values), -1) if is_list else found


def items(home: DataFolder, columns: ImportColumns, table: str | None) -> Iterator[Item]:
    """Yield a touch for each frame of the buffer; an episode is a round, other arrays are its fields."""
    path = path_of_group(home)
    data, ends = _arrays(path)
    pixels = _PIXELS.rpartition("/")[2] if columns.image in (None, "file") else str(columns.image)
    if pixels not in data or data[pixels].ndim != 4:
        raise InputError(
            f"{path!r} has no array of pictures {pixels!r}; found {', '.join(data)}",
            next="name it with --image-column",
        )
    fields = {name: array[:] for name, array in data.items() if name != pixels and array.ndim < 3}
    size = int(np.prod(data[pixels].shape[1:]))
    start = 0
    for episode, end in enumerate(ends):
        for number in range(start, int(end)):
            values = {name: array[number].tolist() for name, array in fields.items()}
            for name, names in (("state", POSE_COLUMNS), ("action", POSITION_COLUMNS)):
                if np.shape(values.get(name, ())) == (len(names),):
                    values |= dict(zip(names, values.pop(name), strict=True))
            name = f"episode-{episode:06d}"
            values.setdefault("round_id", name)
            yield Item(f"{name}_{number - start:06d}.png", f"{path}#{pixels}", number, size, values)
        start = int(end)


def contents(items: Iterable[Item]) -> Iterator[bytes | Exception]:
    """Yield the pixels of each frame as PNG, in order; a chunk of the array is unpacked once."""
    name, last, chunk = "", -1, np.zeros(0, np.uint8)
    array: Any = None
    for item in items:
        if item.path != name:
            name, last = item.path, -1
            path, _, pixels = name.rpartition("#")
            array = _arrays(path)[0][pixels]
        length = array.chunks[0]
        if item.start // length != last:
            last = item.start // length
            chunk = array[last * length : (last + 1) * length]
        yield encode_image(np.ascontiguousarray(chunk[item.start % length]), "png")


def _arrays(path: str) -> tuple[dict[str, Any], Any]:
    """Open the arrays of a buffer and read the ends of its episodes."""
    try:
        group = open_group(path)
        data = {name: array for name, array in group["data"].arrays() if array.shape}
        return data, group["meta/episode_ends"][:]
    except (KeyError, ValueError, OSError) as error:
        raise InputError(f"{path!r} is not a replay buffer of Zarr 2 ({error})") from error


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
