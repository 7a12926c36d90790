"""Pictures of cuts: the changed area over time, with each touch marked, and its best frame in small."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from realtouch.contact_picture import ContactRule
from realtouch.exchange.contact_cuts import ContactRun, ContactRuns
from realtouch.exchange.found_touches import ReadContents
from realtouch.exchange.gel_at_rest import pictures_of
from realtouch.exchange.recordings import Recording
from tactile_toolkit import pictures
from tactile_toolkit.array_types import Float64, UInt8
from tactile_toolkit.touch import resized
from tactile_toolkit.wording import with_count

_WIDTH_PX = 1160
_STRIP_PX = 72
_STRIP_STEP_PX = 112
_TEXT_PX = 12
_TOUCHES_PER_STRIP = 20
_MOST_STRIPS = 8
_TILE_PX = 108
_TILES_PER_ROW = 10
_MOST_TILES = 60
_LABEL_PX = 26  # least distance of two numbers
_GREY, _CLIP, _CONTACT = (238, 240, 242), (198, 222, 240), pictures.ACCENTS[1]
_CURVE, _LIMIT = pictures.ACCENTS[0], pictures.ACCENTS[3]


def draw_cuts(recording: Recording, found: ContactRuns, contents: ReadContents, rule: ContactRule) -> bytes:
    """Draw the cuts of a recording as PNG; of many touches, some spread over all have a small picture."""
    shown = np.unique(np.linspace(0, len(found.runs) - 1, _MOST_TILES).round().astype(int)).tolist()
    best = [found.runs[number].best for number in shown]
    seen = pictures_of(recording, [range(frame, frame + 1) for frame in best], contents)
    tiles = [
        pictures.Tile(_small(picture), f"{number:03d}: {_moment(recording, frame)}")
        for number, frame, picture in zip(shown, best, seen, strict=True)
        if picture is not None
    ]
    words = [
        f"{with_count(len(found.runs), 'touches')} in {with_count(recording.frames, 'pictures')}: "
        f"{rule.min_area_px} changed pixels or more (red line), by {rule.min_intensity:g} levels on average",
        "height: square root of the changed pixels; orange: contact; blue: margin of the clip; "
        f"{found.too_short:,} too short, {with_count(found.unreadable, 'unreadable pictures')}",
    ]
    if len(shown) < len(found.runs):
        words.append(f"pictures of {len(shown)} touches, spread over all")
    parts = [
        pictures.sheet([pictures.Tile(_strips(recording, found, rule))], 1, recording.name, words),
        pictures.sheet(tiles, _TILES_PER_ROW),
    ]
    width = max(part.shape[1] for part in parts)
    canvas = np.full((sum(part.shape[0] for part in parts), width, 3), pictures.PAPER, np.uint8)
    top = 0
    for part in parts:
        canvas[top : top + part.shape[0], : part.shape[1]] = part
        top += part.shape[0]
    return pictures.png_bytes(canvas)


def _small(picture: UInt8) -> UInt8:
    height, width = picture.shape[:2]
    scale = _TILE_PX / max(height, width)
    return resized(picture, max(1, round(scale * width)), max(1, round(scale * height)))


def _moment(recording: Recording, frame: int) -> str:
    """Return when a picture was taken, or its number."""
    if recording.time_s is None:
        return f"#{frame:,}"
    return f"{recording.time_s[frame] - recording.time_s[0]:.1f} s"


def _strips(recording: Recording, found: ContactRuns, rule: ContactRule) -> UInt8:
    """Draw the changed area over all pictures, in one strip or several below each other."""
    count = min(_MOST_STRIPS, -(-len(found.runs) // _TOUCHES_PER_STRIP), recording.frames)
    ends = np.linspace(0, recording.frames, count + 1).round().astype(int).tolist()
    image = Image.new("RGB", (_WIDTH_PX, count * _STRIP_STEP_PX), pictures.PAPER)
    pen = ImageDraw.Draw(image)
    heights = np.sqrt(found.area_px / max(1, int(found.area_px.max())))
    limit = (rule.min_area_px / max(1, int(found.area_px.max()))) ** 0.5
    for number in range(count):
        start, stop = ends[number], ends[number + 1]
        top = number * _STRIP_STEP_PX + 2 * _TEXT_PX
        _draw_strip(pen, top, start, stop, found.runs, heights)
        y = top + round((1 - min(1.0, limit)) * (_STRIP_PX - 1))
        pen.line((0, y, _WIDTH_PX - 1, y), _LIMIT)
        below = top + _STRIP_PX + 2
        pictures.draw_text(pen, (0, below), _moment(recording, start), _TEXT_PX)
        pictures.draw_text(pen, (_WIDTH_PX - 1, below), _moment(recording, stop - 1), _TEXT_PX, anchor="ra")
    return np.asarray(image)


def _draw_strip(
    pen: ImageDraw.ImageDraw, top: int, start: int, stop: int, runs: Sequence[ContactRun], heights: Float64
) -> None:
    """Draw the pictures from ``start`` to ``stop``, with the runs among them."""
    bottom = top + _STRIP_PX - 1

    def column(frame: int) -> int:
        return min(_WIDTH_PX, max(0, (frame - start) * _WIDTH_PX // (stop - start)))

    pen.rectangle((0, top, _WIDTH_PX - 1, bottom), _GREY)
    last_label = -_LABEL_PX
    for number, run in enumerate(runs):
        if run.stop <= start or run.start >= stop:
            continue
        for first, end, colour in ((run.start, run.stop, _CLIP), (run.first, run.last + 1, _CONTACT)):
            pen.rectangle((column(first), top, max(column(first), column(end) - 1), bottom), colour)
        middle = min(_WIDTH_PX - _LABEL_PX // 2, max(_LABEL_PX // 2, column((run.first + run.last + 1) // 2)))
        if start <= run.best < stop and middle - last_label >= _LABEL_PX:
            pictures.draw_text(pen, (middle, top - 2), f"{number:03d}", _TEXT_PX, anchor="mb")
            last_label = middle
    # Each column shows the largest of its pictures, of which there may be many, or a part of one.
    edges = start + np.arange(_WIDTH_PX) * (stop - start) // _WIDTH_PX
    tallest = np.maximum.reduceat(heights[:stop], edges)
    for x, height in enumerate(tallest.tolist()):
        if height > 0:
            pen.line((x, bottom - round(height * (_STRIP_PX - 1)), x, bottom), _CURVE)
