"""Pictures of cuts: the changed area over time, with each touch marked, and its best frame in small."""

from __future__ import annotations

import numpy as np

from realtouch.contact_picture import ContactRule
from realtouch.importing.contact_cuts import ContactRuns, pictures_of
from realtouch.importing.recordings import Recording
from realtouch.importing.source_files import ReadContents
from tactile_toolkit import pictures
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.touch import resized
from tactile_toolkit.wording import with_count

_TILE_PX = 108
_GAP_PX = 8
_TILES_PER_ROW = 10
_MOST_TILES = 60
_WIDTH_PX = _TILES_PER_ROW * (_TILE_PX + _GAP_PX) - _GAP_PX
_STRIP_PX = 72
_GREY, _CLIP, _CONTACT = (238, 240, 242), (198, 222, 240), pictures.ACCENTS[1]
_CURVE, _LIMIT = pictures.ACCENTS[0], pictures.ACCENTS[3]


def draw_cuts(recording: Recording, found: ContactRuns, contents: ReadContents, rule: ContactRule) -> bytes:
    """Draw the cuts of a recording as PNG; of many touches, the first have a small picture."""
    best = [run.best for run in found.runs[:_MOST_TILES]]
    seen = pictures_of(recording, [range(frame, frame + 1) for frame in best], contents)
    tiles = [
        pictures.Tile(_small(picture), f"{number:03d}: #{frame:,}")
        for number, (frame, picture) in enumerate(zip(best, seen, strict=True))
        if picture is not None
    ]
    words = [
        f"{with_count(len(found.runs), 'touches')} in {with_count(recording.frames, 'pictures')}: "
        f"{rule.min_area_px} changed pixels or more (red line), by {rule.min_intensity:g} levels on average",
        "height: square root of the changed pixels; orange: contact; blue: margin of the clip; "
        f"{found.too_short:,} too short, {with_count(found.unreadable, 'unreadable pictures')}",
    ]
    strip = pictures.sheet([pictures.Tile(_strip(found, rule))], 1, recording.name, words)
    small = pictures.sheet(tiles, _TILES_PER_ROW, gap_px=_GAP_PX)
    width = max(strip.shape[1], small.shape[1])
    parts = [
        np.pad(part, ((0, 0), (0, width - part.shape[1]), (0, 0)), "edge")  # which is paper
        for part in (strip, small)
    ]
    return pictures.png_bytes(np.vstack(parts))


def _small(picture: UInt8) -> UInt8:
    height, width = picture.shape[:2]
    scale = _TILE_PX / max(height, width)
    return resized(picture, max(1, round(scale * width)), max(1, round(scale * height)))


def _strip(found: ContactRuns, rule: ContactRule) -> UInt8:
    """Draw the changed area over all pictures; a column shows the largest of its pictures."""
    frames, colours = len(found.area_px), np.full((_WIDTH_PX, 3), _GREY, np.uint8)
    clips = [(run.start, run.stop - 1, _CLIP) for run in found.runs]
    for first, last, colour in [*clips, *((run.first, run.last, _CONTACT) for run in found.runs)]:
        colours[first * _WIDTH_PX // frames : last * _WIDTH_PX // frames + 1] = colour
    edges = np.arange(_WIDTH_PX) * frames // _WIDTH_PX
    heights = np.sqrt([*np.maximum.reduceat(found.area_px, edges), rule.min_area_px])
    *heights, limit = (heights / heights.max() * (_STRIP_PX - 1)).round()
    above = np.arange(_STRIP_PX)[::-1, np.newaxis]
    strip = np.repeat(colours[np.newaxis], _STRIP_PX, axis=0)
    strip[(above <= heights) & (np.array(heights) > 0)] = _CURVE
    strip[above[:, 0] == limit] = _LIMIT
    return strip
