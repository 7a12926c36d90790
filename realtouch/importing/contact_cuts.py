"""Touches of a recording, found by its pictures: background, score of every picture, runs, clips.

A picture shows contact by the rule of :func:`realtouch.contacts_by_image`, against the gel at rest
(:class:`GelAtRest`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from realtouch.avi import MAX_CLIP_FRAMES
from realtouch.contact_picture import ContactRule, contact_score
from realtouch.importing.found_touches import ReadContents
from realtouch.importing.gel_at_rest import GelAtRest, pictures_of
from realtouch.importing.recordings import Recording
from tactile_toolkit.array_types import Bool, Float64, Int64
from tactile_toolkit.errors import ItemError

JOIN_S = 0.2
"""Runs of pictures with contact are one touch if they are at most so far apart, seconds."""

JOIN_PICTURES = 5
"""The same without times, pictures."""

MIN_PICTURES = 3
"""Fewer pictures with contact are no touch."""

MIN_MARGIN = 12
"""Least number of pictures before and after a contact, as far as its neighbours leave so many."""


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


def find_contacts(recording: Recording, contents: ReadContents, rule: ContactRule) -> ContactRuns:
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
        score = contact_score(seen, background.at(number), alone)
        area_px[number], change[number], holds[number] = score.area_px, score.total_change, rule.holds(score)
    starts, stops = _joined(holds, recording.time_s)
    counts = [int(holds[start:stop].sum()) for start, stop in zip(starts, stops, strict=True)]
    long = np.array(counts, np.int64) >= MIN_PICTURES
    runs = tuple(_with_margins(starts[long], stops[long], change))
    if not runs:
        raise ItemError(
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
        margin = min(max(stop - start, MIN_MARGIN), max(0, MAX_CLIP_FRAMES - (stop - start)) // 2)
        best = start + int(np.argmax(change[start:stop]))
        yield ContactRun(
            max(start - margin, limits[number]), min(stop + margin, limits[number + 1]), start, stop - 1, best
        )
