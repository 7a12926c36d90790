"""A clip as a film strip: some frames in order, the window of contact marked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dataset_store.counting import counted
from dataset_store.pictures.lettering import ACCENTS, INK, MUTED, PAPER, draw_text
from dataset_store.pictures.sheets import Sheet, Tile, sheet
from dataset_store.pictures.writing import Drawing
from realtouch.clips import TouchClip
from realtouch.resizing import resized

__all__ = ["IN_CONTACT", "draw_strip", "frames_shown", "timeline"]

IN_CONTACT = ACCENTS[3]
"""Colour of the frame around pictures between the first and the last registered contact."""

_STRIP_COLUMNS = 8
_MOST_FRAMES = 24
_STRIP_TILE_PX = 168
_BAR_PX = 34
_GAP_PX = 2
_TRACK = (224, 228, 232)


def frames_shown(count: int, contact: slice, most: int = _MOST_FRAMES) -> tuple[int, ...]:
    """Choose frames of a clip: every frame of contact and one on each side, the others at equal steps.

    Parameters
    ----------
    count : int
        Frames of the clip.
    contact : slice
        Frames of contact.
    most : int
        How many to choose at most.

    Returns
    -------
    tuple of int
        In order. Where contact alone has too many frames, all are chosen at equal steps.
    """
    near = range(max(contact.start - 1, 0), min(contact.stop + 1, count))
    left = [frame for frame in range(count) if frame not in near]
    room = most - len(near)
    if room < 2:
        return tuple(np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist())
    places: list[int] = np.linspace(0, len(left) - 1, min(len(left), room)).round().astype(int).tolist()
    return tuple(sorted({*near, *(left[place] for place in places)}))


def draw_strip(clip: TouchClip, title: str) -> Drawing:
    """Draw a clip as a film strip with a bar of time below it.

    Parameters
    ----------
    clip : TouchClip
        The clip.
    title : str
        Heading.

    Raises
    ------
    IntegrityError
        A frame or a time is damaged.
    """
    contact, times_s = clip.contact_window, clip.timestamps_s
    shown = frames_shown(len(clip), contact)
    height, width = clip.size
    tile_px = (_STRIP_TILE_PX, max(1, round(_STRIP_TILE_PX * height / width)))
    tiles = [
        Tile(
            resized(clip[frame], *tile_px),
            f"{frame}: {times_s[frame]:.2f} s",
            IN_CONTACT if contact.start <= frame < contact.stop else PAPER,
        )
        for frame in shown
    ]
    words = (
        f"{len(shown)} of {counted(len(clip), 'frames')}, with their times; framed: contact, frames "
        f"{contact.start} to {contact.stop - 1}",
    )
    strip = sheet(tiles, Sheet(_STRIP_COLUMNS, title, words))
    bar = timeline(len(clip), contact, shown, strip.shape[1])
    return Drawing(np.concatenate([strip, bar]))


def timeline(count: int, contact: slice, shown: tuple[int, ...], width_px: int) -> NDArray[np.uint8]:
    """Draw a bar with a cell for each frame: contact in colour, a tick at each frame that is shown.

    Returns
    -------
    ndarray of uint8, shape (height, width_px, 3)
    """
    from PIL import Image, ImageDraw

    margin, top = 16, 4
    picture = Image.new("RGB", (width_px, _BAR_PX + 26), PAPER)
    pen = ImageDraw.Draw(picture)
    step = (width_px - 2 * margin) / count
    # Of many frames there is no room for gaps between the cells; those of contact come last, above others.
    gap = _GAP_PX if step > 2 * _GAP_PX else 0
    for frame in sorted(range(count), key=lambda frame: contact.start <= frame < contact.stop):
        left = margin + frame * step
        box = (left, top, max(left, left + step - max(gap, 1)), top + 16)
        pen.rectangle(box, fill=IN_CONTACT if contact.start <= frame < contact.stop else _TRACK)
    for frame in shown:
        middle = margin + (frame + 0.5) * step - 1
        pen.line((middle, top + 20, middle, top + 26), fill=INK, width=2)
    for frame, anchor in ((0, "la"), (count - 1, "ra")):
        x = margin if frame == 0 else width_px - margin
        draw_text(pen, (x, top + 30), f"frame {frame}", 14, MUTED, anchor)
    return np.asarray(picture)
