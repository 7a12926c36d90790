"""Recorded episodes as Minari datasets, which offline reinforcement learning reads, one for each split.

Facts of the format (Minari 0.5): ``NAMESPACE/NAME-v0/data/main_data.hdf5`` has a group for each episode of T
steps, with T + 1 observations, T actions, rewards, terminations and truncations; encoded images are rows of
bytes; ``metadata.json`` beside it has the spaces.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from itertools import pairwise
from typing import IO, TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from PIL import Image

from realtouch import contact, touch_options
from realtouch.convert import conversion
from realtouch.formats import exports, touch_rows
from realtouch.touches import loading
from tactile_toolkit import errors, read, store
from tactile_toolkit.value_types import AnyArray, JsonDict

if TYPE_CHECKING:
    import h5py

_FOLDER = "minari"
_NAMESPACE = "tactile"
_VERSION = "0.5.0"  # the first that stores encoded images
_POSE = list(touch_options.POSE_COLUMNS)


def plan_minari(
    source: loading.Source,
    choices: conversion.Choices,
    method: contact.ContactMethod,
    options: Mapping[str, object],
) -> conversion.Conversion:
    """Plan Minari datasets; InputError if the touches are not those of recorded episodes."""
    with errors.needs_extra("Minari datasets", "h5py", "hdf5"):
        import_module("h5py")
    if not exports.are_episodes(source.schema):
        raise errors.InputError(
            f"{source.name!r} holds no recorded episodes; Minari datasets hold episodes of a policy",
            next="record episodes with `tactile-envs record`, or choose another --format",
        )
    return touch_rows.TouchFormat((_FOLDER,), write_files=_write_datasets).plan(
        source, choices, method, options
    )


def _write_datasets(folder: store.DataFolder, manifest: store.Manifest) -> dict[str, str]:
    """Write a dataset for each split; return the checksum of each file by its path."""
    checksums = {}
    for split in manifest.splits:
        home = f"{_FOLDER}/{_NAMESPACE}/{split}-v0/data"
        records = [record for record in manifest.shards_of(split) if record.rows]
        shards = [read.Shard(folder.address(record.shard.data_path)) for record in records]
        path = f"{home}/main_data.hdf5"
        metadata, checksums[path] = conversion.write_stream(folder, path, partial(_write_episodes, shards))
        metadata["dataset_id"] = f"{_NAMESPACE}/{split}-v0"
        content = json.dumps(metadata).encode()
        checksums |= conversion.write_changed(folder, {f"{home}/metadata.json": content})
    return checksums


def _write_episodes(shards: Sequence[read.Shard], stream: IO[bytes]) -> JsonDict:
    """Write the episodes of a split as HDF5; return the metadata."""
    import h5py  # the extra hdf5

    metadata: JsonDict = {"data_format": "hdf5", "jpeg_encoding": True, "minari_version": _VERSION}
    steps = count = 0
    with h5py.File(stream, "w") as file:
        for episode in _episodes(shards):
            if not count:
                metadata |= _spaces(episode)
            group = file.create_group(f"episode_{count}")
            group.attrs["id"] = count
            group.attrs["total_steps"] = len(episode) - 1
            _write_episode(group, episode)
            steps += len(episode) - 1
            count += 1
    return metadata | {"total_episodes": count, "total_steps": steps}


def _episodes(shards: Sequence[read.Shard]) -> Iterator[pa.Table]:
    """Yield the touches of each episode that has a step; a shard has whole episodes."""
    for shard in shards:
        touches = shard.read()
        firsts = [*np.flatnonzero(touches["touch"].to_numpy() == 0).tolist(), len(touches)]
        for first, end in pairwise(firsts):
            if end - first > 1:
                yield touches.slice(first, end - first)


def _write_episode(group: h5py.Group, episode: pa.Table) -> None:
    import h5py  # the extra hdf5

    steps = len(episode) - 1
    observations = group.create_group("observations")
    images = observations.create_dataset("sensor_img", (steps + 1,), h5py.vlen_dtype(np.uint8))
    for number, image in enumerate(episode["image"].to_pylist()):
        images[number] = np.frombuffer(image["bytes"], np.uint8)
    observations["gel_pose"] = _poses(episode)
    for name in ("action", "prediction"):
        group[f"actions/{name}"] = _vectors(episode[name])[:steps]
    group["rewards"] = episode["reward"].to_numpy()[:steps]
    terminated = np.asarray(episode["terminated"].combine_chunks())[:steps]
    group["terminations"] = terminated
    group["truncations"] = (np.arange(steps) == steps - 1) & ~terminated
    group["infos/target"] = _vectors(episode["target"])


def _poses(episode: pa.Table) -> AnyArray:
    return np.column_stack([episode[name].to_numpy() for name in _POSE])


def _vectors(column: pa.ChunkedArray) -> AnyArray:
    """Return numbers (n,), or lists of equal length (n, k)."""
    values = column.combine_chunks()
    if not read.list_depth(values.type)[0]:
        return np.asarray(values)
    return np.asarray(values.flatten()).reshape(len(values), -1)


def _spaces(episode: pa.Table) -> dict[str, str]:
    """Return the spaces of observations and actions, as Minari writes them."""
    with Image.open(io.BytesIO(episode["image"][0].as_py()["bytes"])) as image:
        pixels = np.asarray(image)
    observations = {
        "sensor_img": _box(np.zeros_like(pixels), np.full_like(pixels, 255)),
        "gel_pose": _unbounded(_poses(episode)[0]),
    }
    actions = {name: _unbounded(_vectors(episode[name])[0]) for name in ("action", "prediction")}
    named = {"observation_space": observations, "action_space": actions}
    return {name: json.dumps({"type": "Dict", "subspaces": space}) for name, space in named.items()}


def _unbounded(values: AnyArray) -> dict[str, Any]:
    return _box(np.full_like(values, -np.inf), np.full_like(values, np.inf))


def _box(low: AnyArray, high: AnyArray) -> dict[str, Any]:
    ends = {"low": low.tolist(), "high": high.tolist()}
    return {"type": "Box", "dtype": str(low.dtype), "shape": list(low.shape), **ends}
