"""Statistics of the features of a LeRobotDataset, for each episode and for all frames.

LeRobot normalises the inputs of a policy with them. It combines the statistics of episodes when data sets are
split or merged. Sums are exact, so the results do not depend on the processor.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Sequence

import numpy as np
import pyarrow as pa
from PIL import Image

from realtouch.formats.episodes import DEPTH
from realtouch.touches import schema
from realtouch.touches.media import decoded
from tactile_toolkit import read, touch
from tactile_toolkit.array_types import Float64, Int64
from tactile_toolkit.json_types import JsonDict

# Number of images of an episode that are decoded for its statistics.
_IMAGE_SAMPLES = 8
_LEVELS = 256
_IN_MEMORY_BYTES = 64 << 20
_QUANTILES = {f"q{round(100 * share):02d}": share for share in (0.01, 0.10, 0.50, 0.90, 0.99)}
_NAMES = ("min", "max", "mean", "std", "count", *_QUANTILES)


def columns_of_episodes(frames: pa.Table, starts: list[int], lengths: list[int]) -> dict[str, pa.Array]:
    """Return the statistics of each feature in each episode, as columns ``stats/FEATURE/STATISTIC``."""
    columns = {}
    for name in _counted(frames.schema):
        whole = frames.column(name).combine_chunks()
        data_type = pa.list_(pa.float64())
        found = [_episode(name, whole.slice(*part)) for part in zip(starts, lengths, strict=True)]
        if whole.type == touch.MEDIA_TYPE:
            data_type = pa.list_(pa.list_(data_type))
        types = {**dict.fromkeys(_NAMES, data_type), "count": pa.list_(pa.int64())}
        for statistic, stored in types.items():
            columns[f"stats/{name}/{statistic}"] = pa.array([each[statistic] for each in found], stored)
    return columns


def _episode(name: str, values: pa.Array) -> dict[str, object]:
    """Return the statistics of a feature in an episode; for images, those of a sample of them."""
    if values.type != touch.MEDIA_TYPE:
        numbers = _flat_rows(values)
        found = [_statistics(*np.unique(column, return_counts=True)) for column in numbers.T]
        return {**_transposed(found), "count": [len(values)]}
    seen = np.unique(np.linspace(0, len(values) - 1, _IMAGE_SAMPLES).round().astype(int)).tolist()
    images = [values[number].as_py() for number in seen]
    if name == DEPTH:
        channels = [_counted_depths(image["bytes"] for image in images)]
    else:
        counts = np.zeros((3, _LEVELS), np.int64)
        for image in images:
            pixels = Image.fromarray(decoded(image["bytes"], image["path"]))
            counts += np.reshape(pixels.histogram(), (3, _LEVELS))
        # Colours are scaled to 1.
        channels = [(np.flatnonzero(each) / (_LEVELS - 1), each[each > 0]) for each in counts]
    found = [_statistics(*each) for each in channels]
    return {
        **{key: [[[each]] for each in column] for key, column in _transposed(found).items()},
        "count": [len(seen)],
    }


def _transposed(found: Sequence[dict[str, float]]) -> dict[str, list[float]]:
    return {name: [each[name] for each in found] for name in found[0]}


def _statistics(values: Float64, counts: Int64) -> dict[str, float]:
    """Return the statistics of sorted values, given how often each occurs; zeros if there are no values.

    NaN is a missing value and does not count.
    """
    if not (math.isfinite(values[0]) and math.isfinite(values[-1])):
        is_known = np.isfinite(values)
        values, counts = values[is_known], counts[is_known]
    if not len(values):
        return dict.fromkeys((name for name in _NAMES if name != "count"), 0.0)
    total = int(counts.sum())
    below = np.cumsum(counts)
    mean = math.fsum(values * counts) / total
    spread = math.sqrt(math.fsum(counts * (values - mean) ** 2) / total)
    found = {"min": values[0], "max": values[-1], "mean": mean, "std": spread}
    for name, share in _QUANTILES.items():
        rank = share * (total - 1)
        ends = np.searchsorted(below, [math.floor(rank), math.ceil(rank)], side="right")
        found[name] = values[ends[0]] + (values[ends[1]] - values[ends[0]]) * (rank % 1)
    return {name: float(value) for name, value in found.items()}


def statistics_of_all(episodes: Sequence[read.Shard], frames: Sequence[read.Shard]) -> dict[str, object]:
    """Return the statistics of all frames; those of images are combined from episodes, as LeRobot does.

    Only a few numbers of each frame are in memory at a time; one if there are many frames.
    """
    found: JsonDict = {}
    total = sum(map(len, frames))
    for name in _counted(frames[0].schema):
        data_type = frames[0].schema.field(name).type
        if data_type == touch.MEDIA_TYPE:
            found[name] = _combined(episodes, name)
            continue
        width = getattr(data_type, "list_size", 1)
        columns = []
        step = max(1, _IN_MEMORY_BYTES // (8 * total))
        for start in range(0, width, step):
            parts = [_flat_rows(shard.column(name))[:, start : start + step] for shard in frames]
            for column in np.concatenate(parts).T:
                columns.append(_statistics(*np.unique(column, return_counts=True)))
        found[name] = {**_transposed(columns), "count": [total]}
    return found


def _counted(frames: pa.Schema) -> list[str]:
    """Return the features that have statistics: numbers and images, but not texts."""
    return [each.name for each in frames if not pa.types.is_string(read.list_depth(each.type)[1])]


def _combined(episodes: Sequence[read.Shard], name: str) -> dict[str, object]:
    """Return the statistics of the images of all episodes, weighted by their counts."""
    columns = [f"stats/{name}/{statistic}" for statistic in _NAMES]
    table = pa.concat_tables([shard.read(columns=columns) for shard in episodes])
    parts = {each: _flat_rows(table[f"stats/{name}/{each}"]) for each in _NAMES}
    weights = parts.pop("count")[:, 0]
    total = int(weights.sum())

    def weighted_mean(values: Float64) -> Float64:
        return np.array([math.fsum(column * weights) / total for column in values.T])

    found = {each: weighted_mean(values) for each, values in parts.items()}
    variance = weighted_mean(parts["std"] ** 2 + (parts["mean"] - found["mean"]) ** 2)
    found |= {"min": parts["min"].min(axis=0), "max": parts["max"].max(axis=0), "std": np.sqrt(variance)}
    return {**{each: values.reshape(-1, 1, 1).tolist() for each, values in found.items()}, "count": [total]}


def _flat_rows(values: pa.Array | pa.ChunkedArray) -> Float64:
    """Return lists of equal length and any depth as an array with a row for each."""
    if isinstance(values, pa.ChunkedArray):
        values = values.combine_chunks()
    rows = schema.array_with_gaps(values)
    return rows.reshape(len(rows), -1).astype(np.float64, copy=False)


def _counted_depths(files: Iterable[bytes]) -> tuple[Float64, Int64]:
    """Return the sorted values of some maps, and how often each occurs."""
    maps = [np.asarray(Image.open(io.BytesIO(each), formats=["TIFF"]), np.float64) for each in files]
    values, counts = np.unique(np.concatenate(maps), return_counts=True)
    return values, counts
