"""The numbers in a card of touches, and its picture.

What is damaged is left out of them, never a reason to stop: naming damage is the work of ``verify``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np

from dataset_store.cards.facts import FolderFacts, SplitFacts
from dataset_store.cards.pictures import PREVIEW_FOLDER
from dataset_store.errors import ToolkitError
from dataset_store.records import Row
from dataset_store.storage import DataFolder
from realtouch.jpeg import Pixels, decode_image, encode_image
from realtouch.opening import dataset_of
from realtouch.pictures import contact_sheet
from realtouch.rounds import TouchRound, TouchSeqRound, TouchSingleRound
from realtouch.schema import Kind
from realtouch.touches import Touch

__all__ = ["PREVIEW_FILE", "SplitFigures", "index_sheet", "picture_size", "split_figures", "touch_sheet"]

PREVIEW_FILE = f"{PREVIEW_FOLDER}/touches.png"

_TILES = 16
_TILE_WIDTH = 96
_ROUNDS_SEEN = 4

T = TypeVar("T")


@dataclass(frozen=True)
class SplitFigures:
    """One split in numbers; None where the data do not say.

    Attributes
    ----------
    touches : int or None
        Touches of all rounds.
    per_round : tuple of int or None
        Least and most touches of a round.
    objects : int or None
        Different objects.
    contact_share : float or None
        Share of touches that met an object.
    """

    touches: int | None
    per_round: tuple[int, int] | None
    objects: int | None
    contact_share: float | None


def split_figures(split: SplitFacts, kind: Kind) -> SplitFigures:
    """Count one split; reads small columns, no image or clip."""
    if not split.rows:
        return SplitFigures(0, None, 0, None)
    dataset = dataset_of(split.shards, kind)
    counts = _or_none(lambda: dataset.touch_counts)
    return SplitFigures(
        None if counts is None else int(counts.sum()),
        None if counts is None else (int(counts.min()), int(counts.max())),
        _or_none(lambda: len(np.unique(dataset.column("object_id")))),
        _or_none(lambda: len(dataset.touches().with_contact()) / max(len(dataset.touches()), 1)),
    )


def picture_size(facts: FolderFacts, kind: Kind) -> tuple[int, int] | None:
    """Return width and height of the first image or frame that can be read, pixels."""
    sizes = (_or_none(partial(_size, record)) for record in _first_rounds(facts, kind))
    return next((size for size in sizes if size is not None), None)


def touch_sheet(facts: FolderFacts, kind: Kind) -> bytes | None:
    """Draw up to 16 touches of the first round that can be read, as PNG; of clips, the end of contact."""
    for record in _first_rounds(facts, kind):
        images = [image for image in map(_image, _spread(record)) if image is not None]
        if images:
            return encode_image(contact_sheet(images, tile_width=_TILE_WIDTH), "png")
    return None


def index_sheet(facts: FolderFacts, folder: DataFolder) -> bytes | None:
    """Draw the first 16 pictures that an index of plain files names, as PNG."""
    shard = next((shard for split in facts.splits for shard in split.shards if len(shard)), None)
    names = [] if shard is None else shard.read(columns=["file"]).column(0).to_pylist()[:_TILES]
    images = [_or_none(partial(_stored, folder, name)) for name in names]
    whole = [image for image in images if image is not None]
    return encode_image(contact_sheet(whole, tile_width=_TILE_WIDTH), "png") if whole else None


def _stored(folder: DataFolder, name: str) -> Pixels:
    return decode_image(folder.read_bytes(name))


def _first_rounds(facts: FolderFacts, kind: Kind) -> Iterator[TouchSeqRound | TouchSingleRound]:
    """Yield the first rounds, decoding the blocks they lie in and keeping none in the cache."""
    home = TouchSingleRound if kind == "single" else TouchSeqRound
    shard = next((shard for split in facts.splits for shard in split.shards if len(shard)), None)
    if shard is None:
        return
    for count, group in enumerate(shard.blocks(0)):
        if count == _ROUNDS_SEEN:
            return
        yield home(Row(group, 0))


def _spread(record: TouchRound) -> list[Touch]:
    count = _or_none(lambda: record.touch_count) or 0
    chosen = np.unique(np.linspace(0, max(count - 1, 0), min(count, _TILES)).round().astype(int))
    return [Touch(record, int(touch)) for touch in chosen]


def _image(touch: Touch) -> Pixels | None:
    return _or_none(lambda: touch.image)


def _size(record: TouchSeqRound | TouchSingleRound) -> tuple[int, int]:
    if isinstance(record, TouchSeqRound):
        height, width = record.sensor_video[0].size
    else:
        height, width = record.sensor_image.size(0)
    return width, height


def _or_none(ask: Callable[[], T]) -> T | None:
    """Return what can be read; None where the data do not have it, or are damaged there."""
    try:
        return ask()
    except (ToolkitError, KeyError, ValueError):
        return None
