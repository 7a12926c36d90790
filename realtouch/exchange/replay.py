"""The replay buffer of Diffusion Policy: a Zarr group, zipped, of frames one after another.

Facts of the format (Zarr version 2, which opens a path that ends in ``.zip``): ``data`` has arrays of equal
length along time, ``meta/episode_ends`` the number of the frame behind each episode; images are pixels. What
the buffer is made of stays in ``data``: a row a frame, its image as it was stored. Ids of rounds and names of
classes, for which the format has no place, are attributes of ``meta``; they mark the buffer as ours, so that
its ``state`` is known to be a pose.
"""

from __future__ import annotations

import hashlib
import math
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import IO, Any

import numpy as np
import pyarrow as pa

from realtouch.contact import ContactMethod
from realtouch.convert.conversion import Choices, Conversion, Source
from realtouch.exchange.episodes import ACTION, IMAGE, STATE, TIME, Episodes, only_split
from realtouch.exchange.fields import NUMBERED
from realtouch.exchange.found_touches import FoundTouch, source_of
from realtouch.exchange.picture_arrays import PictureArray
from realtouch.exchange.stored_images import decoded
from realtouch.exchange.zarr_arrays import ZarrArray, ZarrGroup, ZarrWriter
from realtouch.stored_round import stored_rows
from realtouch.touch import touch_id
from realtouch.touch_options import POSE_COLUMNS, POSITION_COLUMNS, ImportColumns
from tactile_toolkit import read, store
from tactile_toolkit.array_types import AnyArray
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.touch import encode_image

_FOLDER = "replay"
_FILE = f"{_FOLDER}/touches.zarr.zip"
_PIXELS = "data/tactile"
_ENDS, _ATTRIBUTES = "meta/episode_ends", "meta/.zattrs"
_IDS, _CLASSES = "round_ids", "class_names"  # attributes of ``meta`` in what is written here
_ARRAYS = {STATE: "state", ACTION: "action", TIME: "time_s", "label": "label", "object_id": "object_id"}
_OUR_ARRAYS = {"state": POSE_COLUMNS, "action": POSITION_COLUMNS}
_ENDINGS = (".zarr", ".zarr.zip")
_ENDS_SHOWN = 8
_CHUNK_BYTES = 2 << 20
_IN_MEMORY_BYTES = 64 << 20


def plan_replay(
    source: Source, choices: Choices, method: ContactMethod, options: Mapping[str, Any]
) -> Conversion:
    """Plan a replay buffer; reads footers and one header. InputError for several splits."""
    step = Episodes.of(source, only_split(source, choices, "replay buffer"))
    options = {**options, "image_size": [step.size[1], step.size[0]]}
    write = _WriteBuffer(step.size, step.names)
    return Conversion(source, "export", options, step, choices, extra_dirs=(_FOLDER,), write_files=write)


def _copy(source: IO[bytes], target: IO[bytes]) -> None:
    source.seek(0)
    shutil.copyfileobj(source, target)


@dataclass(frozen=True)
class _WriteBuffer:
    """Writes the group, once the frames of all shards are there."""

    size: tuple[int, int]
    names: tuple[str, ...]

    def __call__(self, folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
        """Return the checksum of the file by its path; an unchanged file is not written again."""
        shards = [
            read.Shard(folder.address(record.shard.data_path)) for record in manifest.shards if record.rows
        ]
        with tempfile.SpooledTemporaryFile(_IN_MEMORY_BYTES) as made:
            self._write(made, shards)
            made.seek(0)
            digest = hashlib.file_digest(made, "sha256").hexdigest()
            if not store.is_unchanged(folder, _FILE, digest):
                folder.write(_FILE, lambda stream: _copy(made, stream))
        return {_FILE: digest}

    def _write(self, stream: IO[bytes], shards: Sequence[read.Shard]) -> None:
        names = [name for name in _ARRAYS if name in shards[0].types]
        more = [name for name in ("round_id", "touch", "frame_index") if name in shards[0].types]
        table = pa.concat_tables([shard.read(columns=[*names, *more]) for shard in shards])
        starts = np.flatnonzero(table["frame_index"].to_numpy() == 0)
        arrays = {f"data/{_ARRAYS[name]}": _numbers(table[name].combine_chunks()) for name in names}
        arrays[_ENDS] = np.append(starts[1:], len(table)).astype("<i8")
        shape = (len(table), *self.size, 3)
        length = max(1, _CHUNK_BYTES // (3 * self.size[0] * self.size[1]))
        with ZarrWriter(stream, ("data", "meta")) as group:
            group.add_json(_ATTRIBUTES, {_IDS: _episode_ids(table.take(starts)), _CLASSES: self.names})
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


def _episode_ids(firsts: pa.Table) -> list[str]:
    """Return the ids of the rounds that episodes are, or of the touches whose clips they are."""
    names: list[str] = firsts["round_id"].to_pylist()
    if "touch" not in firsts.schema.names:
        return names
    return [touch_id(*each) for each in zip(names, firsts["touch"].to_pylist(), strict=True)]


def describe_conversion(items: Sequence[FoundTouch]) -> str:
    """Return what is done to the pictures of a buffer; empty where they are taken as they are."""
    return _pictures(items[0]).described()


def _pictures(item: FoundTouch) -> PictureArray:
    """Open the pictures that an item is one of."""
    divisor, _, name = item.part.partition(" ")
    return PictureArray(ZarrGroup(store.open_folder(item.home), item.path).array(name), float(divisor))


def _images(shards: Sequence[read.Shard]) -> Any:
    """Yield the stored image of each frame, and its name."""
    yield from (row.group.table[IMAGE][row.index].as_py() for row in stored_rows(shards, [IMAGE]))


def _numbers(values: pa.Array) -> AnyArray:
    """Return numbers, or lists of equal length, as an array, little end first."""
    if pa.types.is_fixed_size_list(values.type):
        return _numbers(values.flatten()).reshape(len(values), -1)
    found: AnyArray = values.to_numpy()
    return found.astype(found.dtype.newbyteorder("<"))


def find_replay(home: store.DataFolder, columns: ImportColumns, table: str | None) -> Iterator[FoundTouch]:
    """Yield a touch for each frame of the buffer; an episode is a round, other arrays are its fields.

    Only arrays that a column names are read. What an array of others means does not follow from its shape.
    """
    home, path = _group_in(home)
    group = ZarrGroup(home, path)
    names = group.arrays("data")
    if not names:
        raise InputError(
            f"{group.place!r} has no arrays in its group 'data'; expected a replay buffer",
            next="give the group itself; a zip holds what is inside of the group's folder",
        )
    name = columns.image_name or _PIXELS.rpartition("/")[2]
    if name not in names:
        raise InputError(
            f"{group.place!r} has no array of pictures {name!r}; found {', '.join(names) or 'none'}",
            next="name it with --image-column",
        )
    pictures = PictureArray.of(group.array(f"data/{name}"))
    ends, stated = _episode_ends(group.array(_ENDS), len(pictures)), group.json(_ATTRIBUTES)
    ids, class_names = ([str(each) for each in stated.get(key) or ()] for key in (_IDS, _CLASSES))
    is_ours = len(ids) == len(ends)
    stems = [f"episode-{episode:06d}" for episode in range(len(ends))]
    wanted = {*columns.found_in(names).names(), NUMBERED}
    if is_ours:
        wanted.update(_OUR_ARRAYS)
    else:
        ids = stems
    others = dict.fromkeys((each for each in names if each != name), "not read")
    fields = {each: _rows(group.array(f"data/{each}"), len(pictures)) for each in others if each in wanted}
    part, size = f"{pictures.divisor!r} data/{name}", math.prod(pictures.shape[1:])
    for stem, round_id, (start, end) in zip(stems, ids, pairwise([0, *ends]), strict=True):
        for number in range(start, end):
            values = {**others, **{field: array[number].tolist() for field, array in fields.items()}}
            if is_ours:
                _name_ours(values, class_names)
            values.setdefault("round_id", round_id)
            frame = f"{stem}_{number - start:06d}.png"
            yield FoundTouch(frame, home.address(), path, number, size, values, part=part)


def _name_ours(values: dict[str, Any], class_names: Sequence[str]) -> None:
    """Give the fields of a buffer that this toolkit wrote the names that they have in its tables."""
    for name, names in _OUR_ARRAYS.items():
        values |= dict(zip(names, np.ravel(values.pop(name, ())).tolist(), strict=False))
    label = values.get(NUMBERED)
    if isinstance(label, int) and 0 <= label < len(class_names):
        values[f"{NUMBERED}_name"] = class_names[label]


def _episode_ends(array: ZarrArray, frames: int) -> list[int]:
    """Return the number of the frame behind each episode; InputError unless they rise to all frames."""
    ends: list[int] = []
    if len(array.shape) == 1 and array.dtype.kind in "iu" and array.shape[0] <= frames:
        ends = array.rows(0, array.shape[0]).tolist()
    if not ends or ends[-1] != frames or any(end <= start for start, end in pairwise([0, *ends])):
        found = f"{array.dtype} {array.shape}: {', '.join(map(str, ends[:_ENDS_SHOWN]))}"
        expected = f"integers that rise to {frames:,}, the number of frames"
        raise array.group.refused(array.path, f"episodes end at {found}; expected {expected}")
    return ends


def _rows(array: ZarrArray, frames: int) -> AnyArray:
    """Read what is known of each frame; InputError for another number of rows, or tables in it."""
    if array.shape[:1] != (frames,) or len(array.shape) > 2:
        expected = f"{frames:,} rows of numbers, as frames"
        raise array.group.refused(array.path, f"an array {array.shape}; expected {expected}")
    rows = array.rows(0, frames)
    return rows[:, 0] if rows.shape[1:] == (1,) else rows


def encoded_frames(items: Iterable[FoundTouch]) -> Iterator[bytes | ItemError]:
    """Yield the pixels of each frame as PNG, in order; a chunk of the array is unpacked once."""
    shown, last, chunk = ("", "", ""), -1, np.zeros(0, np.uint8)
    pictures: Any = None
    for item in items:
        if shown != (item.home, item.path, item.part):
            shown, last, pictures = (item.home, item.path, item.part), -1, _pictures(item)
        length = pictures.array.chunks[0]
        if item.start // length != last:
            last = item.start // length
            chunk = pictures.pixels(last * length, min((last + 1) * length, len(pictures)))
        yield encode_image(chunk[item.start % length], "png")


def _group_in(home: store.DataFolder) -> tuple[store.DataFolder, str]:
    """Return where the group lies that a folder or zip is, or the only one that it holds."""
    if home.address().lower().endswith(".zip"):
        return source_of(home.address())
    if home.exists(".zgroup") or home.exists("zarr.json"):
        return home, ""
    names = [name for name in home.names() if name.lower().endswith(_ENDINGS) and not store.is_hidden(name)]
    if len(names) != 1:
        raise InputError(f"{home.address()!r} should hold one Zarr group; found {', '.join(names) or 'none'}")
    return home, names[0]
