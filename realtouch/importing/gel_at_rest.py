"""The gel at rest in a recording in which it is touched, also where the light changes slowly."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from realtouch.contact_picture import ContactRule, contact_score, median_in_memory
from realtouch.importing.found_touches import ReadContents
from realtouch.importing.recordings import Recording
from tactile_toolkit.array_types import Float64, UInt8
from tactile_toolkit.errors import ItemError
from tactile_toolkit.touch import decode_image

_SPREAD = 48
_SPREAD_BYTES = 64 << 20
_LEAST_SPREAD = 5
_LEAST_AT_REST = 3
_LEVELS_TOGETHER = 9  # of neighbours in time, whose median is the level of the light
_DARK = 16  # levels of pixels whose ratio is mostly noise
_PIXEL_STEP = 2


def pictures_of(
    recording: Recording, parts: Iterable[range], contents: ReadContents
) -> Iterator[UInt8 | None]:
    """Yield some pictures of a recording, shape (H, W, 3), in order; None for one that cannot be read."""
    clips = (recording.clip(part.start, part.stop, recording.name) for part in parts)
    for content in contents(clips):
        try:
            yield None if isinstance(content, ItemError) else decode_image(content)
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

    def __init__(self, recording: Recording, contents: ReadContents, rule: ContactRule) -> None:
        spread = np.unique(np.linspace(0, recording.frames - 1, _SPREAD).round().astype(np.int64)).tolist()
        self.shape: tuple[int, ...] = ()
        found: dict[int, UInt8] = {}
        step = 1
        seen = pictures_of(recording, (range(number, number + 1) for number in spread), contents)
        for index, (number, picture) in enumerate(zip(spread, seen, strict=False)):
            if picture is not None and not self.shape:
                self.shape, self.window = picture.shape, rule.window(*picture.shape[:2])
                step = -(-_SPREAD // max(_LEAST_SPREAD, _SPREAD_BYTES // picture[self.window].nbytes))
            cropped = self.seen_of(picture)
            if cropped is not None and (index % step == 0 or not found):
                found[number] = cropped.copy()
        if not found:
            raise ItemError("image", f"none of {len(spread):,} pictures of the recording can be read")
        self._numbers, pictures = list(found), np.stack(list(found.values()))
        self._base = median_in_memory(pictures)
        self._levels = self._levels_of(pictures)
        whole = replace(rule, crop=1.0)
        scores = (contact_score(*each, whole) for each in zip(pictures, map(self.at, found), strict=True))
        at_rest = ~np.array(list(map(rule.holds, scores)))
        if at_rest.sum() >= _LEAST_AT_REST:
            alike = np.rint(pictures[at_rest] / np.float32(self._levels[at_rest, np.newaxis, np.newaxis]))
            self._base = median_in_memory(np.minimum(alike, 255).astype(np.uint8))
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
