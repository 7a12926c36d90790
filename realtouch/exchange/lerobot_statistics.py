"""Statistics of the features of a LeRobotDataset: least, greatest, mean, spread, count and quantiles.

Sums are exact, so that every processor rounds alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from realtouch.exchange.images import decoded
from tactile_toolkit.read.parquet import Shard
from tactile_toolkit.touch.schema import MEDIA_TYPE

_IMAGES_SEEN = 8
"""Images of an episode that are decoded for its statistics."""

_LEVELS = 256
_QUANTILES = {f"q{round(100 * share):02d}": share for share in (0.01, 0.10, 0.50, 0.90, 0.99)}
_NAMES = ("min", "max", "mean", "std", "count", *_QUANTILES)


def columns_of_episodes(frames: pa.Table, starts: list[int], lengths: list[int]) -> dict[str, pa.Array]:
    """Return the statistics of each feature in each episode, as columns ``stats/FEATURE/STATISTIC``."""
    columns = {}
    for name in frames.column_names:
        whole = frames.column(name).combine_chunks()
        found = [_episode(whole.slice(*part)) for part in zip(starts, lengths, strict=True)]
        flat = pa.list_(pa.float64())
        data_type = pa.list_(pa.list_(flat)) if whole.type == MEDIA_TYPE else flat
        for statistic in _NAMES:
            values = [each[statistic] for each in found]
            stored = pa.list_(pa.int64()) if statistic == "count" else data_type
            columns[f"stats/{name}/{statistic}"] = pa.array(values, stored)
    return columns


def _episode(values: pa.Array) -> dict[str, Any]:
    """Return the statistics of a feature in an episode; of images those of some, in shares of full colour."""
    if values.type != MEDIA_TYPE:
        numbers = _flat_rows(values)
        found = [_statistics(*np.unique(column, return_counts=True)) for column in numbers.T]
        return {**{name: [each[name] for each in found] for name in found[0]}, "count": [len(values)]}
    from PIL import Image

    seen = np.unique(np.linspace(0, len(values) - 1, _IMAGES_SEEN).round().astype(int)).tolist()
    counts = np.zeros((3, _LEVELS), np.int64)
    for number in seen:
        image = values[number].as_py()
        pixels = Image.fromarray(decoded(image["bytes"], image["path"]))
        counts += np.reshape(pixels.histogram(), (3, _LEVELS))
    found = [_statistics(np.flatnonzero(each) / (_LEVELS - 1), each[each > 0]) for each in counts]
    return {**{name: [[[each[name]]] for each in found] for name in found[0]}, "count": [len(seen)]}


def _statistics(values: NDArray[np.float64], counts: NDArray[np.int64]) -> dict[str, float]:
    """Return the statistics of rising values that occur so many times."""
    total, below = int(counts.sum()), np.cumsum(counts)
    mean = math.fsum(values * counts) / total
    spread = math.sqrt(math.fsum(counts * (values - mean) ** 2) / total)
    found = {"min": values[0], "max": values[-1], "mean": mean, "std": spread}
    for name, share in _QUANTILES.items():
        rank = share * (total - 1)
        ends = np.searchsorted(below, [math.floor(rank), math.ceil(rank)], side="right")
        found[name] = values[ends[0]] + (values[ends[1]] - values[ends[0]]) * (rank % 1)
    return {name: float(value) for name, value in found.items()}


def statistics_of_all(episodes: Sequence[Shard], frames: Sequence[Shard]) -> dict[str, Any]:
    """Return the statistics of all frames; of images put together from the episodes, as LeRobot does.

    One number of each frame is in memory at a time: 8 bytes a frame.
    """
    found: dict[str, Any] = {}
    for each in frames[0].schema:
        if each.type == MEDIA_TYPE:
            found[each.name] = _put_together(episodes, each.name)
            continue
        columns = []
        for number in range(getattr(each.type, "list_size", 1)):
            parts = [_flat_rows(shard.read(columns=[each.name]).column(0))[:, number] for shard in frames]
            columns.append(_statistics(*np.unique(np.concatenate(parts), return_counts=True)))
        numbers = {name: [column[name] for column in columns] for name in columns[0]}
        found[each.name] = {**numbers, "count": [sum(map(len, frames))]}
    return found


def _put_together(episodes: Sequence[Shard], name: str) -> dict[str, Any]:
    """Put the statistics of the images of all episodes together, weighed by their counts."""
    columns = [f"stats/{name}/{statistic}" for statistic in _NAMES]
    table = pa.concat_tables([shard.read(columns=columns) for shard in episodes])
    parts = {each: _flat_rows(table[f"stats/{name}/{each}"]) for each in _NAMES}
    weights = parts.pop("count")[:, 0]
    total = int(weights.sum())

    def weighed(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array([math.fsum(column * weights) / total for column in values.T])

    found = {each: weighed(values) for each, values in parts.items()}
    square = weighed(parts["std"] ** 2 + (parts["mean"] - found["mean"]) ** 2)
    found |= {"min": parts["min"].min(axis=0), "max": parts["max"].max(axis=0), "std": np.sqrt(square)}
    return {**{each: values.reshape(-1, 1, 1).tolist() for each, values in found.items()}, "count": [total]}


def _flat_rows(values: pa.Array | pa.ChunkedArray) -> NDArray[np.float64]:
    """Return lists of equal length, of whatever depth, as an array of a row for each."""
    if isinstance(values, pa.ChunkedArray):
        values = values.combine_chunks()
    count = len(values)
    while pa.types.is_list(values.type) or pa.types.is_fixed_size_list(values.type):
        values = values.flatten()
    flat: NDArray[np.float64] = values.to_numpy().reshape(count, -1)
    return flat.astype(np.float64, copy=False)
