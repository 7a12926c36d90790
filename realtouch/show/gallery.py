"""Real touches as a gallery: rounds with all their touches, clips frame by frame."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.info import has_info
from realtouch.contact import MIN_CONTACT_HEIGHT_M
from realtouch.dataset import TouchDataset
from realtouch.media.clips import TouchClip
from realtouch.names import repository_of
from realtouch.opening import load
from realtouch.rounds import TouchRound, TouchSeqRound
from realtouch.touches import Touch
from tactile_toolkit.catalog.choose import Choice, chosen_rows, portions, short_name, splits_to_show
from tactile_toolkit.errors import InputError
from tactile_toolkit.gallery.items import Facet, Gallery, Item, Measure
from tactile_toolkit.gallery.pictures import thumbnail
from tactile_toolkit.mesh.mesh import MM_PER_M
from tactile_toolkit.touch.jpeg import Pixels, encode_image, resized

__all__ = [
    "DEFAULT_TOUCHES",
    "FRAMES_PER_FILM",
    "Film",
    "RoundChoice",
    "TileSheet",
    "film_of",
    "plan_gallery",
    "sheet_of",
]

FRAMES_PER_FILM = 24
"""Frames shown of a clip, evenly spaced; of the published 58 to 90 every third or so."""

_TILE_WIDTH_PX = 160
_COLUMNS = 8
_FILM_COLUMNS = 6
_QUALITY = 80


@dataclass(frozen=True, slots=True)
class TileSheet:
    """Pictures of one size in rows, without gaps.

    Attributes
    ----------
    jpeg : bytes
        The sheet.
    tile_px : tuple of int
        Width and height of a tile.
    columns : int
        Tiles in a row.
    """

    jpeg: bytes = field(repr=False)
    tile_px: tuple[int, int]
    columns: int


@dataclass(frozen=True, slots=True)
class Film:
    """Some frames of a clip as a sheet of tiles.

    Attributes
    ----------
    name : str
        End of its file name.
    jpeg : bytes
        The sheet.
    columns : int
        Tiles in a row.
    numbers : tuple of int
        Which frames of the clip.
    times_s : tuple of float
        Their time stamps, seconds.
    window : tuple of int
        First and last tile that show registered contact.
    """

    name: str
    jpeg: bytes = field(repr=False)
    columns: int
    numbers: tuple[int, ...]
    times_s: tuple[float, ...]
    window: tuple[int, int]

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values for the page, without the sheet."""
        first, last = self.window
        return {
            "name": self.name,
            "columns": self.columns,
            "frames": len(self.numbers),
            "numbers": list(self.numbers),
            "times_s": list(self.times_s),
            "first": first,
            "last": last,
        }


def sheet_of(images: Sequence[Pixels], columns: int = _COLUMNS) -> TileSheet:
    """Lay pictures out in rows without gaps.

    Parameters
    ----------
    images : sequence of ndarray, shapes (H, W, 3), uint8
        RGB; tiles have the proportions of the first and are at most 160 pixels wide.
    columns : int
        Tiles in a row.
    """
    height, width = images[0].shape[:2]
    tile_width = min(width, _TILE_WIDTH_PX)
    tile_height = max(1, round(tile_width * height / width))
    columns = min(columns, len(images))
    rows = -(-len(images) // columns)
    sheet = np.zeros((rows * tile_height, columns * tile_width, 3), np.uint8)
    for place, image in enumerate(images):
        row, column = divmod(place, columns)
        y, x = row * tile_height, column * tile_width
        sheet[y : y + tile_height, x : x + tile_width] = resized(image, tile_width, tile_height)
    return TileSheet(encode_image(sheet, "jpeg", _QUALITY), (tile_width, tile_height), columns)


def film_of(clip: TouchClip, name: str) -> Film:
    """Choose frames of a clip, evenly spaced and with both ends of the contact, and lay them out."""
    window = clip.contact_window
    spaced = np.linspace(0, len(clip) - 1, min(len(clip), FRAMES_PER_FILM)).round().astype(int)
    numbers = np.unique([*spaced, window.start, window.stop - 1])
    times_s = clip.timestamps_s[numbers]
    sheet = sheet_of(list(clip.frames(numbers)), _FILM_COLUMNS)
    return Film(
        name=name,
        jpeg=sheet.jpeg,
        columns=sheet.columns,
        numbers=tuple(numbers.tolist()),
        times_s=tuple(round(float(time), 3) for time in times_s),
        window=(int(np.searchsorted(numbers, window.start)), int(np.searchsorted(numbers, window.stop - 1))),
    )


DEFAULT_TOUCHES = 64
"""Touches shown of a round: of 256 every fourth, about 4 MB of clips."""

_SHARES = ("all touches", "more than half", "half or fewer", "none", "unknown")
_FACETS = (
    Facet("label", "Class"),
    Facet("split", "Split"),
    Facet("contact", "Touches with contact", _SHARES),
    Facet("gel", "Gel"),
    Facet("object", "Object"),
)
_MEASURES = (
    Measure("touches", "Touches"),
    Measure("in_contact", "With contact"),
    Measure("highest_mm", "Highest contact", "mm", 1),
)


@dataclass(frozen=True, slots=True)
class RoundChoice(Choice):
    """Which rounds of a data set to show, and which of their touches.

    Attributes
    ----------
    touches : int
        At most so many touches of each round, evenly spaced.
    revision : str or None
        Branch, tag or commit of a Hub repository.
    """

    touches: int = DEFAULT_TOUCHES
    revision: str | None = None

    def __post_init__(self) -> None:
        """Refuse a gallery of rounds without touches."""
        if self.touches < 1:
            message = f"--touches is {self.touches}; expected 1 or more"
            raise InputError(message)


@dataclass(frozen=True)
class _RoundTask:
    """Makes the item of one round.

    Attributes
    ----------
    dataset : TouchDataset
        The round alone.
    split : str
        Its split.
    touches : int
        Most touches shown.
    heights_m : ndarray of float64 or None
        Height of each touch of the round above the plate; None where the data set has no poses.
    """

    dataset: TouchDataset[Any]
    split: str
    touches: int
    heights_m: NDArray[np.float64] | None = field(repr=False)

    @property
    def size(self) -> int:
        return len(self.dataset)

    def make(self) -> list[Item]:
        names = self.dataset.label_names
        return [_item(record, self.split, names, self.touches, self.heights_m) for record in self.dataset]


def plan_gallery(choice: RoundChoice) -> Gallery:
    """Say what a gallery of rounds shows; reads labels and poses, no image and no clip.

    Raises
    ------
    InputError
        No such data set or split, or it is none of touches.
    IntegrityError
        The data set is damaged or unfinished.
    HubError
        The repository cannot be reached or does not exist.
    """
    tasks, splits = [], {}
    for split in splits_to_show(repository_of(choice.name), choice.split, choice.revision):
        dataset = load(choice.name, split, revision=choice.revision)
        rows = chosen_rows(dataset.labels, choice.limit, choice.per_class)
        splits[split] = len(rows)
        shown = dataset[rows]
        heights = _heights_m(shown)
        for portion in portions(np.arange(len(rows)), 1):
            known = None if heights is None else heights[int(portion[0])]
            tasks.append(_RoundTask(shown[portion], split, choice.touches, known))
    title = f"Real touches · {short_name(choice.name)}"
    return Gallery("realtouch", title, ("round", "rounds"), _FACETS, _MEASURES, tuple(tasks), splits)


def _heights_m(dataset: TouchDataset[Any]) -> list[NDArray[np.float64]] | None:
    """Return the heights of all touches, round by round; None where the data set has no poses."""
    if not len(dataset):
        return []
    try:
        heights = dataset.touches().heights_m()
    except InputError:
        return None
    return np.split(heights, np.cumsum(dataset.touch_counts)[:-1])


def _item(
    record: TouchRound,
    split: str,
    names: tuple[str, ...],
    most: int,
    heights_m: NDArray[np.float64] | None,
) -> Item:
    count = record.touch_count
    chosen = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist()
    touches = [Touch(record, number) for number in chosen]
    stills = sheet_of([touch.image for touch in touches])
    media = {"stills.jpg": stills.jpeg}
    listed = []
    for touch in touches:
        entry = _touch_entry(touch, heights_m)
        if isinstance(record, TouchSeqRound):
            film = film_of(touch.clip, f"{touch.touch_index:03d}.jpg")
            media[film.name] = film.jpeg
            entry["film"] = film.to_dict()
        listed.append(entry)
    label = names[record.label] if 0 <= record.label < len(names) else str(record.label)
    met = None if heights_m is None else heights_m >= MIN_CONTACT_HEIGHT_M
    return Item(
        id=record.id,
        title=f"class {label}, object {record.object_id}",
        facets={
            "label": (label,),
            "split": (split,),
            "contact": (_share(met),),
            "gel": (_gel(_info(record)),),
            "object": (str(record.object_id),),
        },
        measures={
            "touches": count,
            "in_contact": None if met is None else int(met.sum()),
            "highest_mm": None if heights_m is None else _millimetres(float(np.fmax.reduce(heights_m))),
        },
        thumbnail=thumbnail(_cover(touches, heights_m)),
        content={
            "notes": _notes(record, len(touches)),
            "touches": {"tile": list(stills.tile_px), "columns": stills.columns, "list": listed},
        },
        media=media,
    )


def _touch_entry(touch: Touch, heights_m: NDArray[np.float64] | None) -> dict[str, Any]:
    height_m = math.nan if heights_m is None else float(heights_m[touch.touch_index])
    height_mm = _millimetres(height_m)
    return {
        "number": touch.touch_index,
        "contact": None if height_mm is None else height_m >= MIN_CONTACT_HEIGHT_M,
        "height_mm": None if height_mm is None else round(height_mm, 2),
        "film": None,
    }


def _millimetres(height_m: float) -> float | None:
    """Return a height for the page; None where it is not known, as of a touch with a damaged pose."""
    return None if math.isnan(height_m) else height_m * MM_PER_M


def _cover(touches: list[Touch], heights_m: NDArray[np.float64] | None) -> NDArray[np.uint8]:
    """Choose the picture of a round: its highest touch, which shows the object best; else its first."""
    if heights_m is None:
        return touches[0].image
    known = np.nan_to_num(heights_m, nan=-np.inf)
    return max(touches, key=lambda touch: known[touch.touch_index]).image


def _share(met: NDArray[np.bool_] | None) -> str:
    if met is None:
        return "unknown"
    if met.all() or not met.any():
        return "all touches" if met.any() else "none"
    return "more than half" if met.mean() > 0.5 else "half or fewer"


def _info(record: TouchRound) -> Mapping[str, Any]:
    """Return the metadata of a round; nothing where the data set stores none."""
    return record.info if has_info(record._row) else {}


def _gel(info: Mapping[str, Any]) -> str:
    gel = info.get("gel_id")
    return "unknown" if gel is None else str(gel)


def _notes(record: TouchRound, shown: int) -> list[tuple[str, str]]:
    """Say how many touches are shown, and what is stored about the round in plain words."""
    notes = [("Touches shown", f"{shown} of {record.touch_count}")]
    words = _info(record).get("notes")
    return [*notes, ("Notes", str(words))] if words else notes
