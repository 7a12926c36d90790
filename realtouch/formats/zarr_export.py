"""Touches as zipped Zarr groups with a row for each frame: replay buffers, and Open-X-Tactile of FTP-1.

Facts of the formats (Zarr version 2, which opens a path that ends in ``.zip``): ``data`` has arrays of equal
length along time; ``meta/episode_ends`` has the number of the first frame after each episode; images are
pixels. The rows from which the group is made stay in the folder ``data`` of the export, with images as they
were stored. The formats have no place for ids of rounds and names of classes: they are in ``meta`` and mark
the group as an export of this toolkit, whose poses are then known.

Replay buffers of Diffusion Policy have the arrays ``tactile``, ``state`` and ``action``. In Open-X-Tactile, a
tactile group is four arrays: data (T, N, H, W, 3), area (T, N), sensor (T,) and type (T,). Poses are x, y, z
in metres and a rotation vector. The loader of that format needs the pictures of a camera, and a state:
stand-ins take their places. Exact poses, intended positions, labels and all further columns, for which it has
no place, are in further arrays.
"""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import IO

import numpy as np
import pyarrow as pa

from realtouch import contact
from realtouch.convert import conversion
from realtouch.formats import exports, zarr_recordings
from realtouch.touches import loading, media, poses, schema, stored_round
from tactile_toolkit import read, store, touch
from tactile_toolkit.value_types import AnyArray, UInt8

CHUNK_BYTES = 2 << 20
_LEVEL = 1
_PICTURE = {exports.IMAGE, f"{exports.IMAGE}.bytes", f"{exports.IMAGE}.path"}
AddArrays = Callable[[exports.Episodes, pa.Table, dict[str, AnyArray]], Mapping[str, object]]
"""Adds arrays to those of ``data``, given a table of the frames; returns attributes of ``meta``."""

_TACTILE = "right_tactile_{}_{}"  # what an array holds, family of the sensor
_CAMERA, _POSE = "camera_main_rgb", "right_wrist_pose"
_INSTRUCTION, _TIMES = "sub_task_instruction", "timestamps"
_PICTURE_TYPE = "image"
_KNOWN_SENSORS = {touch.GELSIGHT_MINI: "GelSightMini"}
_STAND_INS = "what_stands_for"
_BLACK = "black pictures: there was no camera"
_OF_GEL = "the pose of the gel in the frame of the cell"
_NO_POSE = "zeros: no pose is known"
_DECIMALS = 12  # of rotation vectors: their last bits depend on the processor; the exact pose is not rounded


def rows_of_chunk(row_bytes: int) -> int:
    """Return the number of rows of a chunk."""
    return max(1, CHUNK_BYTES // row_bytes)


class ZarrWriter(zipfile.ZipFile):
    """A zip of arrays; chunks divide an array along its first axis."""

    def __init__(self, stream: IO[bytes]) -> None:
        super().__init__(stream, "w")
        for path in (".zgroup", "data/.zgroup", "meta/.zgroup"):
            self.add_json(path, {"zarr_format": 2})

    def add_json(self, path: str, stated: Mapping[str, object], indent: int | None = None) -> None:
        """Write a JSON file."""
        self._add(path, json.dumps(stated, indent=indent).encode())

    def add_array(self, path: str, values: AnyArray) -> None:
        """Write an array; a broadcast zero has no chunks, as zero is the fill value."""
        rows = max(1, min(len(values), rows_of_chunk(values[:1].nbytes)))
        starts = range(0, len(values), rows)
        if not any(values.strides):
            starts = range(0)
        blocks = (values[start : start + rows] for start in starts)
        self.add_blocks(path, values.shape, values.dtype, rows, blocks)

    def add_blocks(
        self,
        path: str,
        shape: Sequence[int],
        dtype: np.dtype[np.generic],
        rows: int,
        blocks: Iterable[AnyArray],
    ) -> None:
        """Write an array block by block; a block is a chunk of ``rows`` rows, the last may have fewer."""
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
            content = block.tobytes().ljust(rows * block[:1].nbytes, b"\0")  # zeros fill the last chunk
            name = ".".join([str(number), *"0" * (len(shape) - 1)])
            self._add(f"{path}/{name}", zlib.compress(content, _LEVEL))

    def _add(self, path: str, content: bytes) -> None:
        self.writestr(zipfile.ZipInfo(path), content)  # without a time of writing


@dataclass(frozen=True)
class GroupFormat:
    """A format of groups: its name and folder, its arrays, and the type of poses.

    ``pictures`` is the array of pictures in ``data``; ``sensors`` is the length of its axis of sensors, if it
    has one. ``arrays`` names the arrays of columns of frames; ``add`` makes all further arrays.
    """

    name: str
    folder: str
    pictures: str
    arrays: Mapping[str, str]
    add: AddArrays = lambda _step, _table, _arrays: {}
    sensors: tuple[int, ...] = ()
    number: pa.DataType = pa.float32()  # noqa: RUF009 - a constant

    def plan(
        self,
        source: loading.Source,
        choices: conversion.Choices,
        method: contact.ContactMethod,
        options: Mapping[str, object],
    ) -> conversion.Conversion:
        """Plan a group; reads footers and the header of one image. InputError for several splits."""
        step = exports.Episodes.of(source, choices, self.name, self.number)
        options = {**options, "image_size": [step.size[1], step.size[0]]}
        write = partial(self._write_group, step)
        return conversion.Conversion(
            source, "export", options, step, choices, extra_dirs=(self.folder,), write_files=write
        )

    def _write_group(
        self, step: exports.Episodes, folder: store.DataFolder, manifest: store.Manifest
    ) -> dict[str, str]:
        """Write the frames of all shards as a zipped group; return the checksum of the file by its path."""
        shards = [
            read.Shard(folder.address(record.shard.data_path)) for record in manifest.shards if record.rows
        ]
        path = f"{self.folder}/touches.zarr.zip"
        _, digest = conversion.write_stream(folder, path, partial(self._write, step, shards))
        return {path: digest}

    def _write(self, step: exports.Episodes, shards: Sequence[read.Shard], stream: IO[bytes]) -> None:
        table = pa.concat_tables(
            [shard.read(columns=[name for name in shard.types if name not in _PICTURE]) for shard in shards]
        )
        arrays, attributes = self._arrays(step, table)
        path = f"data/{self.pictures}"
        size = step.size
        rows = rows_of_chunk(3 * size[0] * size[1])
        shape = (len(table), *self.sensors, *size, 3)
        with ZarrWriter(stream) as group:
            group.add_json(zarr_recordings.ATTRIBUTES, attributes)
            for name, values in arrays.items():
                group.add_array(name, values)
            blocks = (block.reshape(-1, *shape[1:]) for block in _pictures(size, rows, shards))
            group.add_blocks(path, shape, np.dtype("|u1"), rows, blocks)

    def _arrays(
        self, step: exports.Episodes, table: pa.Table
    ) -> tuple[dict[str, AnyArray], dict[str, object]]:
        """Return all arrays except the pictures, and the attributes of ``meta``, which describe them."""
        columns = {name: table[name].combine_chunks() for name in table.schema.names}
        own_names = step.own_names
        known = {extra.name: extra.name.removeprefix(exports.FEATURE) for extra in step.extras}
        known = {name: array for name, array in {**self.arrays, **known}.items() if name in columns}
        arrays = {array: _numbers(columns[name]) for name, array in known.items()}
        stated = self.add(step, table, arrays)
        starts = np.flatnonzero(table["frame_index"].to_numpy() == 0)
        by_path = {f"data/{name}": values for name, values in arrays.items()}
        for name in (zarr_recordings.ROUND, zarr_recordings.TOUCH):
            if name in columns:
                by_path[f"meta/{name}"] = _numbers(columns[name].take(starts))
        by_path[zarr_recordings.ENDS] = np.append(starts[1:], len(table)).astype("<i8")
        return by_path, {
            zarr_recordings.CLASSES: step.names,
            zarr_recordings.COLUMNS: {known[name]: own for name, own in own_names.items() if name in known},
            zarr_recordings.PER_CLIP: step.names_of_clips,
            **stated,
        }


def _pictures(size: tuple[int, int], rows: int, shards: Sequence[read.Shard]) -> Iterator[UInt8]:
    """Yield the pixels of all frames in blocks of ``rows`` frames; all blocks use the same memory."""
    block = np.empty((rows, *size, 3), np.uint8)
    at = 0
    for row in stored_round.stored_rows(shards, [exports.IMAGE]):
        image = row.group.table[exports.IMAGE][row.index].as_py()
        media.decoded(image["bytes"], image["path"], block[at])
        at = (at + 1) % rows
        if not at:
            yield block
    if at:
        yield block[:at]


def _numbers(values: pa.Array) -> AnyArray:
    """Return numbers, texts or lists of equal length as a little-endian array; a missing text is empty."""
    if pa.types.is_fixed_size_list(values.type):
        return _numbers(values.flatten()).reshape(len(values), -1)
    if pa.types.is_string(values.type):
        return np.array([text or "" for text in values.to_pylist()], "<U")
    numbers: AnyArray = values.to_numpy(zero_copy_only=False)
    return numbers.astype(numbers.dtype.newbyteorder("<"))


plan_replay = GroupFormat(
    name="replay buffer",
    folder="replay",
    pictures=zarr_recordings.PIXELS,
    arrays={**exports.OUR_NAMES, exports.STATE: "state", exports.ACTION: "action"},
).plan


def _add_arrays(
    sensor: str, step: exports.Episodes, table: pa.Table, arrays: dict[str, AnyArray]
) -> Mapping[str, object]:
    """Add the arrays of the format that follow from columns, and stand-ins; return what stands for what."""
    count = len(table)
    exact = arrays.get(exports.OUR_NAMES[exports.STATE])
    pose = np.broadcast_to(0.0, (count, 6))
    meaning_of_pose = _NO_POSE
    if exact is not None:
        turns = poses.Poses(exact[:, :3], exact[:, 3:]).rotvec.round(_DECIMALS)
        pose = np.hstack([exact[:, :3], turns])
        meaning_of_pose = _OF_GEL
    tasks = [*(f"touch an object of class {name}" for name in step.names), "touch an object"]
    arrays.setdefault(_TIMES, np.divide(table["frame_index"].to_numpy(), step.fps))
    family = touch.sensor_family(sensor)
    arrays |= {
        _POSE: pose,
        _CAMERA: np.broadcast_to(np.uint8(0), (count, *step.size, 3)),
        _INSTRUCTION: np.array(tasks, "<U")[arrays["label"]],  # -1 is the last
        _TACTILE.format("area", family): np.broadcast_to(np.int64(0), (count, 1)),
        _TACTILE.format("sensor", family): np.full(count, _KNOWN_SENSORS.get(sensor, sensor)),
        _TACTILE.format("type", family): np.full(count, _PICTURE_TYPE),
    }
    return {_STAND_INS: {_CAMERA: _BLACK, _POSE: meaning_of_pose}}


def plan_oxt(
    source: loading.Source,
    choices: conversion.Choices,
    method: contact.ContactMethod,
    options: Mapping[str, object],
) -> conversion.Conversion:
    """Plan a group of Open-X-Tactile, whose arrays are named for the sensor; raises as other groups."""
    sensor = schema.sensor_of(source.schema, source.manifest()) or "unknown"
    group = GroupFormat(
        name="group of Open-X-Tactile",
        folder="oxt",
        pictures=_TACTILE.format("data", touch.sensor_family(sensor)),
        arrays={**exports.OUR_NAMES, exports.TIME: _TIMES},
        add=partial(_add_arrays, sensor),
        sensors=(1,),
        number=pa.float64(),
    )
    return group.plan(source, choices, method, options)
