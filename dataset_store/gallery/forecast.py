"""What a gallery would take, before it is made."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

from dataset_store.gallery.index import IndexBuilder
from dataset_store.gallery.items import Gallery
from dataset_store.gallery.site import (
    MOST_BYTES,
    fixed_files,
    item_files,
    marker,
    require_place,
    require_size,
)
from dataset_store.gallery.texts import index_script

__all__ = ["SiteForecast", "forecast_site"]

_SAMPLED_TASKS = 3


@dataclass(frozen=True, slots=True)
class SiteForecast:
    """What a run would make.

    Attributes
    ----------
    items : int
        How many items are shown.
    files, bytes : int
        What the site would hold; from a sample, and exact where the sample is everything.
    seconds : float
        Time, from the same sample.
    sampled : int
        How many items were made for the estimate.
    fits : bool
        Whether a site of that size is made; larger ones are refused.
    splits : dict of str to int
        Items of each split.
    """

    items: int
    files: int
    bytes: int
    seconds: float
    sampled: int
    fits: bool
    splits: dict[str, int]

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


def forecast_site(gallery: Gallery, out: str, workers: int, *, overwrite: bool = False) -> SiteForecast:
    """Make a few items of a gallery, write nothing, and tell what all would take.

    Raises
    ------
    InputError
        As :func:`dataset_store.gallery.site.build_site`.
    """
    require_place(out, overwrite=overwrite)
    require_size(gallery)
    fixed = fixed_files(gallery)
    index = IndexBuilder(gallery)
    files = size = 0
    start_s = time.monotonic()
    for task in _spread(gallery.tasks):
        for item in task.make():
            made = item_files(index.add(item), item)
            files += len(made)
            size += sum(map(len, made.values()))
    elapsed_s = time.monotonic() - start_s
    share = gallery.size / len(index)
    size += len(index_script(index.to_dict()))
    total = round(size * share) + sum(map(len, fixed.values())) + len(marker(gallery))
    return SiteForecast(
        items=gallery.size,
        files=round(files * share) + len(fixed) + 2,  # the index of items and the marker
        bytes=total,
        seconds=elapsed_s * share / max(1, min(workers, len(gallery.tasks))),
        sampled=len(index),
        fits=total <= MOST_BYTES,
        splits=dict(gallery.splits),
    )


def _spread(tasks: tuple[Any, ...]) -> list[Any]:
    """Choose some tasks, evenly from first to last."""
    if len(tasks) <= _SAMPLED_TASKS:
        return list(tasks)
    return [tasks[place * (len(tasks) - 1) // (_SAMPLED_TASKS - 1)] for place in range(_SAMPLED_TASKS)]
