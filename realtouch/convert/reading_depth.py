"""Depth from the images of a sensor that was calibrated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from os import PathLike, fspath
from typing import Protocol, Unpack

import numpy as np
import pyarrow as pa

from realtouch import depth_maps, schema, sensor_images, stored_images, stored_round
from realtouch.convert import conversion, shard_tasks
from tactile_toolkit import errors, kind, places, store, touch
from tactile_toolkit.array_types import Float32, UInt8
from tactile_toolkit.json_types import JsonDict

DEEPEST, MEAN_ERROR = "extra.depth_max_m", "extra.depth_error_m"
"""Columns with a number for each touch: its deepest point, and the mean of the expected error, metres."""

_BATCH = 8  # images of 320 x 240 pixels take 5 MB as numbers

_load_sensor = kind.lazy("tactile_sim.press.sensors:SensorModel.load")


class DepthAndError(Protocol):
    """Depth of some images, (N, H, W), float32, metres, and its expected error."""

    depth_m: Float32
    error_m: Float32


class DepthReader(Protocol):
    """Reader of depth from images (N, H, W, 3), uint8, such as :class:`tactile_sim.SensorModel`."""

    def read_depth(self, images: UInt8, *, fast: bool = False) -> DepthAndError:
        """Return how far each point of the gel is pressed in."""
        ...

    def to_dict(self) -> JsonDict:
        """Return JSON values that identify the reader by its content."""
        ...


def add_depth(
    source: places.Name | places.Place,
    out: str | PathLike[str],
    sensor: str | PathLike[str],
    *,
    fast: bool = False,
    **job: Unpack[shard_tasks.JobOptions],
) -> store.Manifest:
    """Add depth maps to a data set of images, as a calibrated sensor reads them.

    Each touch gains ``depth_m`` and ``depth_error_m``, maps in metres in the size of its image, stored in
    whole micrometres; ``extra["depth_max_m"]`` and ``extra["depth_error_m"]`` are its deepest point and the
    mean of the expected error. Everything else is copied.

    Parameters
    ----------
    source, out, split, limit, workers, overwrite, on_progress
        As for :func:`clips_to_images`; the source holds single images.
    sensor : str or path
        Folder that ``tactile-sim calibrate`` wrote.
    fast : bool
        Read ten times as fast, with an error about twice as large.

    Returns
    -------
    Manifest

    Raises
    ------
    InputError
        The source holds clips, the folder no calibrated sensor, or as :func:`clips_to_images`.
    IntegrityError, SpecMismatchError, StorageError
        As :func:`clips_to_images`.
    """
    folder = fspath(sensor)
    reader = _reader(folder)

    def plan(opened: conversion.Source, limit: int | None) -> conversion.Conversion:
        if opened.kind != "single":
            raise errors.InputError(
                f"{opened.name!r} holds clips; expected a data set of single images",
                next="run `realtouch clips-to-images` first, which chooses a frame of each clip",
            )
        options = {"sensor": reader.to_dict(), "fast": fast, "limit": limit}
        return conversion.Conversion(
            opened, "depth", options, AddDepth(folder, fast), conversion.first_rows(opened, limit)
        )

    return shard_tasks.write_conversion(source, out, plan, **job)


@lru_cache(maxsize=1)
def _reader(folder: str) -> DepthReader:
    found: DepthReader = _load_sensor(folder)
    return found


@dataclass(frozen=True)
class AddDepth:
    """Step of ``depth``: the columns of a round, and depth maps. ``sensor`` is a folder."""

    sensor: str
    fast: bool

    def schema(self, source: pa.Schema) -> pa.Schema:
        """Return the schema of the source with columns of depth, which replace others of the same name."""
        count = getattr(schema.column_type(source, "sensor_image"), "list_size", -1)
        added = {
            depth_maps.DEPTH: touch.MEDIA_TYPE,
            depth_maps.DEPTH_ERROR: touch.MEDIA_TYPE,
            DEEPEST: pa.float32(),
            MEAN_ERROR: pa.float32(),
        }
        kept = [field for field in source if field.name not in added]
        return pa.schema([*kept, *(pa.field(name, pa.list_(each, count)) for name, each in added.items())])

    def apply(
        self, row: stored_round.StoredRound, choice: conversion.RowChoice, split: str
    ) -> conversion.Made:
        """Read the depth of each image of a row; the images are copied."""
        flat, images = schema.flat_row(row), sensor_images.SensorImages(row)
        maps: dict[str, list[bytes]] = {depth_maps.DEPTH: [], depth_maps.DEPTH_ERROR: []}
        numbers: dict[str, list[float]] = {DEEPEST: [], MEAN_ERROR: []}
        for start in range(0, len(images), _BATCH):
            found = _reader(self.sensor).read_depth(
                images.batch(slice(start, start + _BATCH)), fast=self.fast
            )
            for depth_m, error_m in zip(found.depth_m, found.error_m, strict=True):
                maps[depth_maps.DEPTH].append(depth_maps.encode_map(depth_m))
                maps[depth_maps.DEPTH_ERROR].append(depth_maps.encode_map(error_m))
                numbers[DEEPEST].append(float(depth_m.max()))
                numbers[MEAN_ERROR].append(float(error_m.mean(dtype=np.float64)))
        made = {name: stored_images.numbered_media(blobs, depth_maps.SUFFIX) for name, blobs in maps.items()}
        made |= {name: pa.array(values, pa.float32()) for name, values in numbers.items()}
        return schema.row_with(flat, made, self.schema(flat.schema)), {}
