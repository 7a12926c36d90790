"""Zipped groups of Zarr with a row a frame: the replay buffer of Diffusion Policy, and what is like it.

Facts of the format (Zarr version 2, which opens a path that ends in ``.zip``): ``data`` has arrays of equal
length along time, ``meta/episode_ends`` the number of the frame behind each episode; images are pixels. What
the group is made of stays in the folder ``data`` of the export: a row a frame, its image as it was stored.
Ids of rounds and names of classes, for which the format has no place, lie in ``meta``; they mark the group
as ours, so that its ``state`` is known to be a pose.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import IO

import numpy as np
import pyarrow as pa

from realtouch.contact import ContactMethod
from realtouch.convert.conversion import Choices, Conversion, Source
from realtouch.exchange.episode_extras import FEATURE
from realtouch.exchange.episodes import ACTION, CONTACT, IMAGE, STATE, TIME, Episodes, only_split
from realtouch.exchange.zarr_arrays import ZarrWriter
from realtouch.schema import EXTRA_PREFIX
from realtouch.stored_images import decoded
from realtouch.stored_round import stored_rows
from tactile_toolkit import read, store
from tactile_toolkit.array_types import AnyArray

ENDS, ATTRIBUTES = "meta/episode_ends", "meta/.zattrs"
ROUND, TOUCH = "round_id", "touch"
"""Arrays of ``meta`` with an entry an episode; the second, if episodes are clips."""

CLASSES, COLUMNS, PER_CLIP = "class_names", "columns", "columns_of_clips"
"""Attributes of ``meta``: classes, columns of the data set by array, those that concern whole clips."""

OUR_NAMES = {
    **{STATE: "gel_pose", ACTION: "pos_in_cell", TIME: "time_s", CONTACT: CONTACT},
    **{name: name for name in ("label", "object_id")},
}
"""Names of columns of frames, as :data:`COLUMNS` states them."""

CHUNK_BYTES = 2 << 20
_PICTURE = {IMAGE, f"{IMAGE}.bytes", f"{IMAGE}.path"}
_IN_MEMORY_BYTES = 64 << 20

AddArrays = Callable[[Episodes, pa.Table, dict[str, AnyArray]], Mapping[str, object]]
"""Adds arrays of ``data`` to those of columns, given a row a frame; returns attributes of ``meta``."""


@dataclass(frozen=True)
class GroupFormat:
    """A format of groups: its name and folder, its arrays, and the type of poses.

    ``pictures`` is an array of ``data``, ``sensors`` the length of its axis of sensors, where there is one.
    ``arrays`` are names for columns of frames, ``add`` makes all further arrays.
    """

    name: str
    folder: str
    pictures: str
    arrays: Mapping[str, str]
    add: AddArrays = lambda _step, _table, _arrays: {}
    sensors: tuple[int, ...] = ()
    number: pa.DataType = pa.float32()  # noqa: RUF009 - a constant

    def plan(
        self, source: Source, choices: Choices, method: ContactMethod, options: Mapping[str, object]
    ) -> Conversion:
        """Plan a group; reads footers and one header. InputError for several splits."""
        step = Episodes.of(source, only_split(source, choices, self.name))
        step = replace(step, number=self.number)
        options = {**options, "image_size": [step.size[1], step.size[0]]}
        write = _WriteGroup(self, step)
        return Conversion(
            source, "export", options, step, choices, extra_dirs=(self.folder,), write_files=write
        )


@dataclass(frozen=True)
class _WriteGroup:
    """Writes a zipped group of all frames, once those of all shards are there."""

    form: GroupFormat
    step: Episodes

    def __call__(self, folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
        """Return the checksum of the file by its path; an unchanged file is not written again."""
        shards = [
            read.Shard(folder.address(record.shard.data_path)) for record in manifest.shards if record.rows
        ]
        path = f"{self.form.folder}/touches.zarr.zip"
        with tempfile.SpooledTemporaryFile(_IN_MEMORY_BYTES) as made:
            self._write(made, shards)
            made.seek(0)
            digest = hashlib.file_digest(made, "sha256").hexdigest()
            if not store.is_unchanged(folder, path, digest):
                folder.write(path, lambda stream: _copy(made, stream))
        return {path: digest}

    def _write(self, stream: IO[bytes], shards: Sequence[read.Shard]) -> None:
        table = pa.concat_tables(
            [shard.read(columns=[name for name in shard.types if name not in _PICTURE]) for shard in shards]
        )
        with ZarrWriter(stream) as group:
            for path, values in self._arrays(group, table).items():
                length = max(1, min(len(values), CHUNK_BYTES // values[:1].nbytes))
                group.describe(path, values.shape, length, values.dtype)
                if any(values.strides):  # else all are zeros, for which no chunk stands
                    for number in range(-(-len(values) // length)):
                        group.chunk(path, number, length, values[number * length : (number + 1) * length])
            self._add_pictures(group, len(table), shards)

    def _arrays(self, group: ZarrWriter, table: pa.Table) -> dict[str, AnyArray]:
        """Return all arrays but the pictures, and add what is said of them."""
        columns = {name: table[name].combine_chunks() for name in table.schema.names}
        known = {name: array for name, array in self.form.arrays.items() if name in columns}
        kept = {array: OUR_NAMES[name] for name, array in known.items()}
        of_clips = []
        for extra in self.step.extras:
            known[extra.name] = array = extra.name.removeprefix(FEATURE)
            kept[array] = own_name = extra.stored.partition(".")[2]
            of_clips += [own_name] * extra.stored.startswith(EXTRA_PREFIX["touch"])
        arrays = {array: _numbers(columns[name]) for name, array in known.items()}
        stated = self.form.add(self.step, table, arrays)
        group.add_json(ATTRIBUTES, {CLASSES: self.step.names, COLUMNS: kept, PER_CLIP: of_clips, **stated})
        starts = np.flatnonzero(table["frame_index"].to_numpy() == 0)
        of_meta = {name: _numbers(columns[name].take(starts)) for name in (ROUND, TOUCH) if name in columns}
        found = {f"data/{name}": values for name, values in arrays.items()}
        found |= {f"meta/{name}": values for name, values in of_meta.items()}
        return {**found, ENDS: np.append(starts[1:], len(table)).astype("<i8")}

    def _add_pictures(self, group: ZarrWriter, count: int, shards: Sequence[read.Shard]) -> None:
        path, size = f"data/{self.form.pictures}", (*self.form.sensors, *self.step.size, 3)
        length = max(1, CHUNK_BYTES // (3 * self.step.size[0] * self.step.size[1]))
        group.describe(path, (count, *size), length, np.dtype("|u1"))
        chunk = np.zeros((length, *self.step.size, 3), np.uint8)
        for number, row in enumerate(stored_rows(shards, [IMAGE])):
            image = row.group.table[IMAGE][row.index].as_py()
            at = number % length
            decoded(image["bytes"], image["path"], chunk[at])
            if at + 1 == length or number + 1 == count:
                group.chunk(path, number // length, length, chunk[: at + 1].reshape(-1, *size))


def _copy(source: IO[bytes], target: IO[bytes]) -> None:
    source.seek(0)
    shutil.copyfileobj(source, target)


def _numbers(values: pa.Array) -> AnyArray:
    """Return numbers, texts, or lists of equal length, as an array, little end first; empty for no text."""
    if pa.types.is_fixed_size_list(values.type):
        return _numbers(values.flatten()).reshape(len(values), -1)
    if pa.types.is_string(values.type):
        return np.array([text or "" for text in values.to_pylist()], "<U")
    found: AnyArray = values.to_numpy(zero_copy_only=False)
    return found.astype(found.dtype.newbyteorder("<"))


PIXELS = "tactile"
plan_replay = GroupFormat(
    "replay buffer", "replay", PIXELS, {**OUR_NAMES, STATE: "state", ACTION: "action"}
).plan
