"""Touches as a gallery: rounds with all their touches, clips frame by frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import pyarrow as pa

from realtouch import kind, touch_previews
from realtouch.touches import datasets, media, rounds
from realtouch.touches.rounds import Touch
from realtouch.touches.schema import origin_of
from tactile_toolkit import catalog, checked_fields, gallery, mesh, pictures, places, wording
from tactile_toolkit.rows import Column
from tactile_toolkit.touch import encode_image, resized
from tactile_toolkit.value_types import AnyArray, Bool, Float64, JsonDict, UInt8

FRAMES_PER_FILM = 24
"""Frames shown of a clip, evenly spaced; of the published 58 to 90 every third or so."""

_TILE_WIDTH_PX = 160
_FILM_COLUMNS = 6
# A round of clips shows 1,536 frames.
_QUALITY = 80
DEFAULT_TOUCHES = 64
"""Touches shown of a round: of 256 every fourth, about 4 MB of clips."""

# For a round: greatest number of touches to show, height of each touch and whether it has contact, if known.
_Known: TypeAlias = "tuple[int, Float64 | None, Bool | None]"

_MAX_TEXTS = 8
_LONGEST_NOTE = 200  # texts shown of a further column, and characters of each

_SHARES = ("all touches", "more than half", "half or fewer", "none", "unknown")
_SHOWN = (
    Column(pa.string(), name="label", role="facet", title="Class"),
    Column(pa.string(), name="contact", role="facet", title="Touches with contact", values=_SHARES),
    Column(pa.string(), name="gel", role="facet", title="Gel"),
    Column(pa.int64(), name="object", role="facet", title="Object"),
    Column(pa.int64(), name="touches", role="measure", title="Touches"),
    Column(pa.int64(), name="in_contact", role="measure", title="With contact"),
    Column(pa.float64(), "mm", name="highest_mm", role="measure", title="Highest contact", decimals=1),
)


def plan_gallery(
    name: places.Name | places.Place,
    chosen: catalog.RowFilter = catalog.RowFilter.ALL,
    *,
    touches: int = DEFAULT_TOUCHES,
) -> gallery.Gallery:
    """Plan a gallery of rounds; reads labels and poses, no image and no clip.

    At most ``touches`` of each round, evenly spaced.

    InputError: no such data set or split, or one that does not hold touches. IntegrityError: it is damaged or
    unfinished. HubError: the repository cannot be reached or does not exist.
    """
    touches = checked_fields.checked_integer(touches, "touches", 1)

    def known(rows: datasets.AnyDataset, _split: str) -> list[_Known]:
        if not len(rows):
            return []
        sources = rows.contact_sources()
        if not all(source.is_stored for source in sources):  # all pictures would be decoded
            return [(touches, None, None)] * len(rows)
        starts = np.cumsum(rows.touch_counts)[:-1]
        heights_m: list[Float64] | list[None] = [None] * len(rows)
        if all(source.heights for source in sources):
            heights_m = np.split(rows.touches().heights_m(), starts)
        contact = np.split(rows.touches().in_contact(), starts)
        return [(touches, *of_round) for of_round in zip(heights_m, contact, strict=True)]

    split = chosen.only_split
    data_set = places.open_place(name).require(kind.KIND, "tactile gallery").require_complete(split)
    schema = data_set.shards(split or data_set.splits[0])[0].schema
    title = f"{origin_of(schema, data_set.manifest)} touches".capitalize()
    rows = pictures.ChosenRows.of(kind.KIND, data_set, chosen, "tactile gallery")
    return gallery.Gallery.of_rows(rows, title, _SHOWN, _item, 1, known)


def _item(
    record: rounds.TouchRound,
    split: str,
    names: tuple[str, ...],
    known: _Known,
) -> gallery.GalleryItem:
    """Show a round."""
    most, heights_m, contact = known
    touches = [Touch(record, number) for number in media.evenly_spaced(record.touch_count, most)]
    views = [touch_previews.force_views(touch) for touch in touches]
    stills, columns, tile_px = sheet_of([np.hstack(of_touch) for of_touch in views], views=len(views[0]))
    images = {"stills.jpg": stills}
    listed = []
    for touch in touches:
        entry: JsonDict = dict.fromkeys(("number", "contact", "height_mm", "film"))
        entry["number"] = touch.touch_index
        if contact is not None:
            entry["contact"] = bool(contact[touch.touch_index])
        if heights_m is not None:
            entry["height_mm"] = round(float(heights_m[touch.touch_index]) * mesh.MM_PER_M, 2)
        if isinstance(record, rounds.TouchSeqRound):
            name = f"{touch.touch_index:03d}.jpg"
            images[name], entry["film"] = film_of(touch.clip, name)
        listed.append(entry)
    label = wording.class_name(names, record.label) if record.label >= 0 else None
    title = [f"class {label}" if label else "touches"]
    # The highest touch shows the object best.
    cover = touches[0]
    if heights_m is not None:
        heights = np.nan_to_num(heights_m, nan=-np.inf)
        cover = max(touches, key=lambda touch: heights[touch.touch_index])
    info = record.info if record.row.has_info() else {}
    gel = info.get("gel_id")
    touched = ""
    if record.row.has("object_id"):
        touched = f"{record.object_id}"
        title.append(f"object {touched}")
    notes = [("Touches shown", f"{len(touches)} of {record.touch_count}")]
    if info.get("notes"):
        notes.append(("Notes", str(info["notes"])))
    notes += [(name, _extra_text(record.extra[name])) for name in record.extra]
    return gallery.GalleryItem(
        id=record.id,
        title=", ".join(title),
        values={
            "label": label,
            "contact": _share(contact),
            "gel": gel,
            "object": touched or None,
            "touches": record.touch_count,
            "in_contact": None if contact is None else int(contact.sum()),
            "highest_mm": None if heights_m is None else _millimetres(float(np.fmax.reduce(heights_m))),
        },
        thumbnail=gallery.GalleryItem.thumbnail_of(cover.image),
        content={"notes": notes, "touches": {"tile": list(tile_px), "columns": columns, "list": listed}},
        media=images,
    )


def _extra_text(values: AnyArray | tuple[AnyArray, ...]) -> str:
    """Return the range of the numbers of a further column, or the number of distinct texts."""
    parts = values if isinstance(values, tuple) else (values,)
    flat = np.concatenate([np.ravel(part) for part in parts] or [np.zeros(0)])
    if flat.dtype.kind in "iuf":
        known = flat[~np.isnan(flat)]
        return f"{known.min():g} to {known.max():g}" if len(known) else "missing"
    texts = list(dict.fromkeys(str(value) for value in flat.tolist() if value is not None))
    return wording.shortened(", ".join(texts[:_MAX_TEXTS]), _LONGEST_NOTE) or "missing"


def _millimetres(height_m: float) -> float | None:
    """Return a height for the page; None if it is unknown, for example because a pose is damaged."""
    return None if math.isnan(height_m) else height_m * mesh.MM_PER_M


def _share(contact: Bool | None) -> str:
    if contact is None:
        return "unknown"
    if not contact.any():
        return "none"
    if contact.all():
        return "all touches"
    return "more than half" if contact.mean() > 0.5 else "half or fewer"


def sheet_of(
    images: Sequence[UInt8], columns: int = 8, *, views: int = 1
) -> tuple[bytes, int, tuple[int, int]]:
    """Lay pictures, (H, W, 3), out in rows without gaps: a JPEG, its columns, width and height of a tile.

    Tiles have the proportions of the first picture, and each of the ``views`` side by side in it is at most
    160 pixels wide.
    """
    height, width = images[0].shape[:2]
    tile_width = min(width, _TILE_WIDTH_PX * views)
    tile_height = max(1, round(tile_width * height / width))
    columns = min(columns, len(images))
    tiles = [resized(image, tile_width, tile_height) for image in images]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[start : start + columns]) for start in range(0, len(tiles), columns)]
    return encode_image(np.vstack(rows), "jpeg", _QUALITY), columns, (tile_width, tile_height)


def film_of(clip: media.TouchClip, name: str) -> tuple[bytes, JsonDict]:
    """Choose frames of a clip, evenly spaced and with both ends of the contact: a JPEG of tiles, JSON values.

    The values are the frames and times (seconds) that are shown, and the first and last tile in contact.
    """
    window = clip.contact_window
    # Both ends of the contact are always included, because they are of most interest.
    numbers = np.unique([*media.evenly_spaced(len(clip), FRAMES_PER_FILM), window.start, window.stop - 1])
    jpeg, columns, _ = sheet_of(list(clip.frames(numbers)), _FILM_COLUMNS)
    return jpeg, {
        "name": name,
        "columns": columns,
        "frames": len(numbers),
        "numbers": numbers.tolist(),
        "times_s": [round(float(time), 3) for time in clip.timestamps_s[numbers]],
        "first": int(np.searchsorted(numbers, window.start)),
        "last": int(np.searchsorted(numbers, window.stop - 1)),
    }
