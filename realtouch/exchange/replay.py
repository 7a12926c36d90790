"""The replay buffer of Diffusion Policy: a Zarr group, zipped, of frames one after another.

Facts of the format (Zarr version 2, which opens a path that ends in ``.zip``): ``data`` has arrays of equal
length along time, ``meta/episode_ends`` the number of the frame behind each episode; images are pixels. What
the buffer is made of stays in ``data``: a row a frame, its image as it was stored. Ids of rounds and names of
classes, for which the format has no place, are attributes of ``meta``; they mark the buffer as ours, so that
its ``state`` is known to be a pose.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import IO, ClassVar

import numpy as np
import pyarrow as pa

from realtouch.contact import ContactMethod
from realtouch.convert.conversion import Choices, Conversion, Source
from realtouch.exchange.episode_extras import ExtraColumn
from realtouch.exchange.episodes import ACTION, IMAGE, STATE, TIME, Episodes, only_split
from realtouch.exchange.stored_images import StoredImage, decoded
from realtouch.exchange.zarr_arrays import ZarrWriter
from realtouch.stored_round import stored_rows
from realtouch.touch import touch_id
from tactile_toolkit import read, store
from tactile_toolkit.array_types import AnyArray, Int64

_FOLDER = "replay"
PIXELS = "data/tactile"
ENDS, ATTRIBUTES = "meta/episode_ends", "meta/.zattrs"
IDS, CLASSES = "round_ids", "class_names"  # attributes of ``meta`` in what is written here
_PICTURE = {IMAGE, f"{IMAGE}.bytes", f"{IMAGE}.path"}
_ARRAYS = {STATE: "state", ACTION: "action", TIME: "time_s", "label": "label", "object_id": "object_id"}
CHUNK_BYTES = 2 << 20
_IN_MEMORY_BYTES = 64 << 20


def plan_replay(
    source: Source, choices: Choices, method: ContactMethod, options: Mapping[str, object]
) -> Conversion:
    """Plan a replay buffer; reads footers and one header. InputError for several splits."""
    step = Episodes.of(source, only_split(source, choices, "replay buffer"))
    options = {**options, "image_size": [step.size[1], step.size[0]]}
    write = _WriteBuffer(step.size, step.names, step.extras)
    return Conversion(source, "export", options, step, choices, extra_dirs=(_FOLDER,), write_files=write)


def _copy(source: IO[bytes], target: IO[bytes]) -> None:
    source.seek(0)
    shutil.copyfileobj(source, target)


@dataclass(frozen=True)
class WriteGroup(ABC):
    """Writes a zipped group of all frames, once those of all shards are there."""

    size: tuple[int, int]
    names: tuple[str, ...]
    extras: tuple[ExtraColumn, ...]
    file: ClassVar[str]
    pictures: ClassVar[str]
    sensors: ClassVar[tuple[int, ...]] = ()  # length of the axis of sensors, where there is one

    def __call__(self, folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
        """Return the checksum of the file by its path; an unchanged file is not written again."""
        shards = [
            read.Shard(folder.address(record.shard.data_path)) for record in manifest.shards if record.rows
        ]
        with tempfile.SpooledTemporaryFile(_IN_MEMORY_BYTES) as made:
            self._write(made, shards)
            made.seek(0)
            digest = hashlib.file_digest(made, "sha256").hexdigest()
            if not store.is_unchanged(folder, self.file, digest):
                folder.write(self.file, lambda stream: _copy(made, stream))
        return {self.file: digest}

    @abstractmethod
    def add_columns(self, group: ZarrWriter, table: pa.Table, starts: Int64) -> None:
        """Add all arrays but the pictures; ``table`` has a row a frame, ``starts`` those of episodes."""

    def _write(self, stream: IO[bytes], shards: Sequence[read.Shard]) -> None:
        table = pa.concat_tables(
            [shard.read(columns=[name for name in shard.types if name not in _PICTURE]) for shard in shards]
        )
        starts = np.flatnonzero(table["frame_index"].to_numpy() == 0)
        shape = (len(table), *self.sensors, *self.size, 3)
        length = max(1, CHUNK_BYTES // (3 * self.size[0] * self.size[1]))
        with ZarrWriter(stream, ("data", "meta")) as group:
            self.add_columns(group, table, starts)
            group.describe(self.pictures, shape, (length, *shape[1:]), "|u1")
            chunk = np.zeros((length, *self.size, 3), np.uint8)
            for number, image in enumerate(_images(shards)):
                decoded(image["bytes"], image["path"], chunk[number % length])
                if (number + 1) % length == 0 or number + 1 == len(table):
                    chunk[number % length + 1 :] = 0  # as a chunk is filled behind the end
                    group.chunk(self.pictures, number // length, chunk.reshape(length, *shape[1:]))


@dataclass(frozen=True)
class _WriteBuffer(WriteGroup):
    """Writes a replay buffer."""

    file = f"{_FOLDER}/touches.zarr.zip"
    pictures = PIXELS

    def add_columns(self, group: ZarrWriter, table: pa.Table, starts: Int64) -> None:
        """Add poses, positions, times and labels, each as one chunk."""
        group.add_json(ATTRIBUTES, {IDS: episode_ids(table.take(starts)), CLASSES: self.names})
        arrays = {
            f"data/{array}": numbers(table[name].combine_chunks())
            for name, array in _ARRAYS.items()
            if name in table.schema.names
        }
        arrays[ENDS] = ends_of(table, starts)
        arrays |= {f"data/{each.array}": numbers(table[each.name].combine_chunks()) for each in self.extras}
        for path, values in arrays.items():
            group.describe(path, values.shape, values.shape, values.dtype.str, fill_of(values))
            group.chunk(path, 0, values)


def ends_of(table: pa.Table, starts: Int64) -> AnyArray:
    """Return the number of the frame behind each episode."""
    return np.append(starts[1:], len(table)).astype("<i8")


def episode_ids(firsts: pa.Table) -> list[str]:
    """Return the ids of the rounds that episodes are, or of the touches whose clips they are."""
    names: list[str] = firsts["round_id"].to_pylist()
    if "touch" not in firsts.schema.names:
        return names
    return [touch_id(*each) for each in zip(names, firsts["touch"].to_pylist(), strict=True)]


def _images(shards: Sequence[read.Shard]) -> Iterator[StoredImage]:
    """Yield the stored image of each frame, and its name."""
    yield from (row.group.table[IMAGE][row.index].as_py() for row in stored_rows(shards, [IMAGE]))


def fill_of(values: AnyArray) -> object:
    """Return the value of what no chunk holds."""
    return "" if values.dtype.kind == "U" else 0


def numbers(values: pa.Array) -> AnyArray:
    """Return numbers, texts, or lists of equal length, as an array, little end first; empty for no text."""
    if pa.types.is_fixed_size_list(values.type):
        return numbers(values.flatten()).reshape(len(values), -1)
    if pa.types.is_string(values.type):
        return np.array([text or "" for text in values.to_pylist()], "<U")
    found: AnyArray = values.to_numpy(zero_copy_only=False)
    return found.astype(found.dtype.newbyteorder("<"))
