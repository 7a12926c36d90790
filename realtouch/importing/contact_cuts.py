"""Touches of a recording, found by its pictures: the gel at rest, score of every picture, runs, clips.

A picture shows contact by the rule of :func:`realtouch.contacts_by_image`, against the gel at rest, also
where the light changes slowly.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import median_filter

from realtouch import avi, contact_picture
from realtouch.importing import recordings, source_files
from tactile_toolkit import errors, pictures, touch, wording
from tactile_toolkit.array_types import Bool, Float64, Int64, UInt8

JOIN_S = 0.2
"""Runs of pictures with contact are one touch if they are at most so far apart, seconds."""

JOIN_PICTURES = 5
"""The same without times, pictures."""

MIN_PICTURES = 3
"""Fewer pictures with contact are no touch."""

MIN_MARGIN = 12
"""Least number of pictures before and after a contact, as far as its neighbours leave so many."""

_SPREAD = 48
_SPREAD_BYTES = 64 << 20
_MIN_SPREAD = 5
_MIN_AT_REST = 3
_LEVELS_TOGETHER = 9  # of neighbours in time, whose median is the level of the light
_DARK = 16  # levels of pixels whose ratio is mostly noise
_PIXEL_STEP = 2
_TILE_PX = 108
_GAP_PX = 8
_TILES_PER_ROW = 10
_MAX_TILES = 60
_WIDTH_PX = _TILES_PER_ROW * (_TILE_PX + _GAP_PX) - _GAP_PX
_STRIP_PX = 72
_GREY, _CLIP, _CONTACT = (238, 240, 242), (198, 222, 240), pictures.ACCENTS[1]
_CURVE, _LIMIT = pictures.ACCENTS[0], pictures.ACCENTS[3]


@dataclass(frozen=True, slots=True)
class ContactRun:
    """A touch: numbers of the pictures of its clip, of its first and last contact, and of the best."""

    start: int
    stop: int
    first: int
    last: int
    best: int


@dataclass(frozen=True, slots=True, eq=False)
class ContactRuns:
    """The touches of a recording, in order, and how they were found.

    Attributes
    ----------
    area_px : ndarray of int64, shape (frames,)
        Changed pixels of each picture; 0 if it cannot be read.
    runs : tuple of ContactRun
    too_short : int
        Number of runs with fewer pictures than a touch has.
    unreadable : int
        Number of pictures that cannot be read, or are of another size.
    """

    area_px: Int64 = field(repr=False)
    runs: tuple[ContactRun, ...]
    too_short: int
    unreadable: int


def pictures_of(
    recording: recordings.Recording, parts: Iterable[range], contents: source_files.ReadContents
) -> Iterator[UInt8 | None]:
    """Yield some pictures of a recording, shape (H, W, 3), in order; None for one that cannot be read."""
    places = (recording.place(part.start, part.stop) for part in parts)
    for content in contents(places):
        try:
            yield None if isinstance(content, errors.ItemError) else touch.decode_image(content)
        except ValueError:
            yield None


class GelAtRest:
    """The background of each picture of a recording, within the window of the rule.

    It is the median of some pictures spread over the recording, then of those of them that show no contact
    against that first median: it is right where every pixel is at rest in more than half of them. It follows
    slow changes of the light: each channel is scaled by its level, measured in these pictures, whose running
    median touches do not change. The spread pictures are in memory, cropped.

    Raises ItemError if no picture can be read.
    """

    def __init__(
        self,
        recording: recordings.Recording,
        contents: source_files.ReadContents,
        rule: contact_picture.ContactRule,
    ) -> None:
        spread = np.unique(np.linspace(0, recording.frames - 1, _SPREAD).round().astype(np.int64)).tolist()
        self.shape: tuple[int, ...] = ()
        found: dict[int, UInt8] = {}
        step = 1
        seen = pictures_of(recording, (range(number, number + 1) for number in spread), contents)
        for index, (number, picture) in enumerate(zip(spread, seen, strict=False)):
            if picture is not None and not self.shape:
                self.shape, self.window = picture.shape, rule.window(*picture.shape[:2])
                step = -(-_SPREAD // max(_MIN_SPREAD, _SPREAD_BYTES // picture[self.window].nbytes))
            cropped = self.seen_of(picture)
            if cropped is not None and (index % step == 0 or not found):
                found[number] = cropped.copy()
        if not found:
            raise errors.ItemError("image", f"none of {len(spread):,} pictures of the recording can be read")
        self._numbers, pictures = list(found), np.stack(list(found.values()))
        self._base = contact_picture.median_in_memory(pictures)
        self._levels = self._levels_of(pictures)
        whole = replace(rule, crop=1.0)
        scores = (
            contact_picture.contact_score(*each, whole)
            for each in zip(pictures, map(self.at, found), strict=True)
        )
        at_rest = ~np.array(list(map(rule.holds, scores)))
        if at_rest.sum() >= _MIN_AT_REST:
            alike = np.rint(pictures[at_rest] / np.float32(self._levels[at_rest, np.newaxis, np.newaxis]))
            self._base = contact_picture.median_in_memory(np.minimum(alike, 255).astype(np.uint8))
            self._levels = self._levels_of(pictures)

    def seen_of(self, picture: UInt8 | None) -> UInt8 | None:
        """Return the window of a picture; None for one that cannot be read or is of another size."""
        if picture is None or picture.shape != self.shape:
            return None
        return picture[self.window]

    def at(self, number: int) -> UInt8:
        """Return the background of a picture by its number."""
        levels = np.array([np.interp(number, self._numbers, each) for each in self._levels.T], np.float32)
        found: UInt8 = np.minimum(np.rint(self._base * levels), 255).astype(np.uint8)
        return found

    def _levels_of(self, pictures: UInt8) -> Float64:
        """Return how bright each channel of n pictures is against the background, (n, 3), smooth in time."""
        levels = np.ones((len(pictures), 3))
        parts, base = (each[..., ::_PIXEL_STEP, ::_PIXEL_STEP, :] for each in (pictures, self._base))
        for channel in range(3):
            bright = base[..., channel] >= _DARK
            if bright.any():
                ratios = parts[:, bright, channel] / base[bright, channel].astype(np.float32)
                levels[:, channel] = np.median(ratios, axis=1)
        smooth: Float64 = median_filter(levels, (_LEVELS_TOGETHER, 1), mode="nearest")
        return smooth


def find_contacts(
    recording: recordings.Recording, contents: source_files.ReadContents, rule: contact_picture.ContactRule
) -> ContactRuns:
    """Find the touches of a recording; ItemError if it has none, or if no picture can be read."""
    area_px, change = np.zeros((2, recording.frames), np.int64)
    holds, unreadable = np.zeros(recording.frames, bool), 0
    background = GelAtRest(recording, contents, rule)
    alone = replace(rule, crop=1.0)
    numbers = range(recording.frames)
    for number, picture in zip(numbers, pictures_of(recording, [numbers], contents), strict=False):
        seen = background.seen_of(picture)
        if seen is None:
            unreadable += 1
            continue
        score = contact_picture.contact_score(seen, background.at(number), alone)
        area_px[number], change[number], holds[number] = score.area_px, score.total_change, rule.holds(score)
    starts, stops = _joined(holds, recording.time_s)
    counts = [int(holds[start:stop].sum()) for start, stop in zip(starts, stops, strict=True)]
    long = np.array(counts, np.int64) >= MIN_PICTURES
    runs = tuple(_with_margins(starts[long], stops[long], change))
    if not runs:
        raise errors.ItemError(
            "contact",
            f"no touch in {recording.frames:,} pictures: none of {MIN_PICTURES} pictures or more in which "
            f"{rule.min_area_px:,} pixels differ by more than {rule.min_change} levels from the gel at rest",
            next="take it whole (`--cut whole`), or state its touches by a table (`--cut TABLE`)",
        )
    return ContactRuns(area_px, runs, int(np.sum(~long)), unreadable)


def _joined(holds: Bool, time_s: Float64 | None) -> tuple[Int64, Int64]:
    """Return the starts and stops of runs of pictures with contact, close ones joined."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]])))
    starts, stops = edges[::2], edges[1::2]
    if not len(starts):
        return starts, stops
    if time_s is None:
        is_far = starts[1:] - stops[:-1] > JOIN_PICTURES
    else:
        is_far = time_s[starts[1:]] - time_s[stops[:-1] - 1] > JOIN_S
    return starts[np.append(True, is_far)], stops[np.append(is_far, True)]


def _with_margins(starts: Int64, stops: Int64, change: Int64) -> Iterator[ContactRun]:
    """Yield runs as clips: as much before and after as the contact is long, up to half way to the next."""
    middles = (stops[:-1] + starts[1:]) // 2
    limits = [0, *middles.tolist(), len(change)]
    for number, (start, stop) in enumerate(zip(starts.tolist(), stops.tolist(), strict=True)):
        margin = min(max(stop - start, MIN_MARGIN), max(0, avi.MAX_CLIP_FRAMES - (stop - start)) // 2)
        best = start + int(np.argmax(change[start:stop]))
        yield ContactRun(
            max(start - margin, limits[number]), min(stop + margin, limits[number + 1]), start, stop - 1, best
        )


def draw_cuts(
    recording: recordings.Recording,
    found: ContactRuns,
    contents: source_files.ReadContents,
    rule: contact_picture.ContactRule,
) -> bytes:
    """Draw the cuts of a recording as PNG; of many touches, the first have a small picture."""
    best = [run.best for run in found.runs[:_MAX_TILES]]
    seen = pictures_of(recording, [range(frame, frame + 1) for frame in best], contents)
    tiles = [
        pictures.Tile(_small(picture), f"{number:03d}: #{frame:,}")
        for number, (frame, picture) in enumerate(zip(best, seen, strict=True))
        if picture is not None
    ]
    touches, frames = wording.with_count(len(found.runs), "touches"), f"{recording.frames:,} pictures"
    words = [
        f"{touches} in {frames}: "
        f"{rule.min_area_px} changed pixels or more (red line), by {rule.min_intensity:g} levels on average",
        "height: square root of the changed pixels; orange: contact; blue: margin of the clip; "
        f"{found.too_short:,} too short, {wording.with_count(found.unreadable, 'unreadable pictures')}",
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
    return touch.resized(picture, max(1, round(scale * width)), max(1, round(scale * height)))


def _strip(found: ContactRuns, rule: contact_picture.ContactRule) -> UInt8:
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
