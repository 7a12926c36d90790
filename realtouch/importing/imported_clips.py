"""Clips of an import: pictures of a recording as an AVI, with their times and the moments of contact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from realtouch import contact
from realtouch.importing import found_touches, import_columns
from realtouch.touches import stored_images
from realtouch.video import avi
from tactile_toolkit.array_types import Float64, Int64, UInt8
from tactile_toolkit.errors import ItemError
from tactile_toolkit.touch import decode_image, is_jpeg

FRAMES_PER_SECOND = 25.0
"""Frame rate of clips whose times are not known."""

_RATES = (1e-3, 1e4)  # pictures a second that the header of an AVI can state
_LONGEST_S = 1e6
_MAX_OF_MEDIAN = 64  # pictures
_MEDIAN_BYTES = 64 << 20  # of these pictures; if they are large, there are fewer
_SCORED_AT_ONCE = 4  # pictures that fit into the cache of a processor


@dataclass(frozen=True, slots=True)
class ImportedClip:
    """A clip as it is stored; times are in microseconds from its first picture.

    ``notes`` say how times, encoding and contact were chosen where the source does not state them.
    """

    video: bytes
    time_us: Int64
    contact: tuple[int, int]
    notes: tuple[str, ...]


def clip_of(
    touches: found_touches.FoundTouches,
    row: int,
    pictures: Sequence[bytes],
    size: tuple[int, int],
    columns: import_columns.ImportColumns,
) -> ImportedClip:
    """Return a clip of pictures that are intact and of one size (height, width).

    Unless the source states the contact, it lasts from the first to the last picture that shows contact by
    :class:`ContactRule`, with the median of the clip as background. Raises ItemError for a damaged picture
    and for times that cannot be used.
    """
    notes, time_s = [], clip_times_s(touches, row, columns)
    if time_s is None:
        time_s = np.arange(len(pictures)) / FRAMES_PER_SECOND
        notes.append(f"times of {FRAMES_PER_SECOND:g} pictures a second, as none are known")
    if not all(map(is_jpeg, pictures)):
        notes.append("pictures encoded as JPEG")
    step_s = float(np.median(np.diff(time_s))) if len(pictures) > 1 else 0.0
    fps = min(max(1 / step_s, _RATES[0]), _RATES[1]) if step_s > 0 else FRAMES_PER_SECOND
    jpegs, contact = list(map(stored_images.as_jpeg, pictures)), touches.where["contact"][row].as_py()
    if contact is None:  # from the pictures as they are stored, so that a copy gives the same
        contact, is_found = contact_by_pictures(jpegs, size)
        notes.append("contact found by the pictures" if is_found else "no contact found: the best picture")
    height, width = size
    video = avi.write_avi(jpegs, width, height, fps)
    time_us = np.round(time_s * 1e6).astype(np.int64)
    return ImportedClip(video, time_us, (contact[0], contact[1]), tuple(notes))


def clip_times_s(
    touches: found_touches.FoundTouches, row: int, columns: import_columns.ImportColumns
) -> Float64 | None:
    """Return the time of each picture from the first one, seconds, shape (frames,); None if not known.

    The times are finite and do not decrease: the recording was checked. Raises ItemError if they last longer
    than a clip may, or if the column of times is named and has none for this touch.
    """
    stated = touches.where["time_s"][row].values
    if stated is None:
        if columns.time:
            raise ItemError("time", f"no {columns.time!r} for each picture; expected the time of each")
        return None
    time_s: Float64 = stated.to_numpy()
    from_first = time_s - time_s[:1]
    if from_first.max(initial=0.0) > _LONGEST_S:
        raise ItemError(
            "time", f"the clip lasts {from_first[-1]:g} s; expected seconds (--time-unit states another unit)"
        )
    return from_first


def contact_by_pictures(
    pictures: Sequence[bytes], size: tuple[int, int], rule: contact.ContactRule | None = None
) -> tuple[tuple[int, int], bool]:
    """Return the first and last picture that show contact, and True; else the best picture twice, and False.

    The background is the median of the clip: of at most 64 pictures, spread evenly over the clip, so that a
    long clip takes little time and memory. Raises ItemError for a damaged picture.
    """
    rule = rule or contact.ContactRule()
    rows, columns = rule.window(*size)
    uncropped = replace(rule, crop=1.0)
    height, width = rows.stop - rows.start, columns.stop - columns.start
    of_median = min(_MAX_OF_MEDIAN, max(1, _MEDIAN_BYTES // (3 * height * width)))

    def decoded(some: Sequence[bytes]) -> UInt8:
        made = np.empty((len(some), height, width, 3), np.uint8)
        for number, each in enumerate(some):
            made[number] = decode_image(each)[rows, columns]  # a view would keep the whole picture
        return made

    try:
        base = contact.median_in_memory(decoded(pictures[:: -(-len(pictures) // of_median)]))
        scores = [
            contact.contact_score(decoded(pictures[start : start + _SCORED_AT_ONCE]), base, uncropped)
            for start in range(0, len(pictures), _SCORED_AT_ONCE)
        ]
    except ValueError as error:
        raise ItemError("image", str(error)) from error
    in_contact = np.flatnonzero(np.concatenate([rule.holds(score) for score in scores]))
    if len(in_contact):
        return (int(in_contact[0]), int(in_contact[-1])), True
    best = int(np.concatenate([score.total_change for score in scores]).argmax())
    return (best, best), False
