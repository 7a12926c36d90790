"""Clips of an import: pictures of a recording as an AVI, with times, poses and the moments of contact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from realtouch.avi import MAX_CLIP_FRAMES, write_avi
from realtouch.contact_picture import ContactRule, contact_score, median_in_memory
from realtouch.import_columns import ImportColumns
from realtouch.importing.fields import NUMBERED, Fields, each_of, poses, positions, times_s
from realtouch.importing.found_touches import FoundTouch
from realtouch.stored_images import as_jpeg
from tactile_toolkit.array_types import Float64, Int64, UInt8
from tactile_toolkit.errors import ItemError
from tactile_toolkit.touch import decode_image, is_jpeg

FRAMES_PER_SECOND = 25.0
"""Rate of clips of which no times are known."""

_RATES = (1e-3, 1e4)  # what the header of an AVI can state
_LONGEST_S = 1e6
_MOST_OF_MEDIAN = 64  # pictures
_BATCH_BYTES = 64 << 20  # of large ones fewer
_SCORED_AT_ONCE = 4  # more do not stay in the cache of a processor
_SAME_M = 1e-9


@dataclass(frozen=True, slots=True)
class ImportedClip:
    """A clip as it is stored: times in microseconds from its first picture, poses of shape (frames, 7).

    ``notes`` say how it was made, where that does not follow from the source.
    """

    video: bytes
    time_us: Int64
    contact: tuple[int, int]
    notes: tuple[str, ...]


def too_long(item: FoundTouch) -> ItemError | None:
    """Return what is wrong with a clip of more pictures than clips may have."""
    if item.frames <= MAX_CLIP_FRAMES:
        return None
    problem = (
        f"a clip of {item.frames:,} pictures; the limit is {MAX_CLIP_FRAMES:,} (--cut makes shorter ones)"
    )
    return ItemError("clip", problem)


def said_of_whole(item: FoundTouch, columns: ImportColumns) -> FoundTouch:
    """Return a clip whose label, round, object and split, where each picture has them, are those of the clip.

    It has a problem if they differ between its pictures.
    """
    names = {columns.label, columns.round, columns.object_id, columns.split, NUMBERED}
    of_pictures = [name for name in names if name in item.per_frame and name not in item.values]
    if not of_pictures:
        return item
    values, problem = dict(item.values), item.problem
    for name in sorted(map(str, of_pictures)):
        several = item.per_frame[name].tolist()
        values[name] = several[0] if several else None
        if any(value != several[0] for value in several) and name != NUMBERED:
            found = f"{name!r} differs between the pictures of the clip"
            problem = problem or ItemError(
                "frames", f"{found}; expected one value (--cut frames has one each)"
            )
    return replace(item, values=values, problem=problem)


def clip_of(
    item: FoundTouch, pictures: Sequence[bytes], size: tuple[int, int], columns: ImportColumns
) -> ImportedClip:
    """Return a clip of pictures that are intact and of one size (height, width).

    Contact lasts from the first to the last picture that shows it by :class:`ContactRule`, unless that is
    known; the background is the median of the clip. Raises ItemError.
    """
    notes = []
    time_s = clip_times_s(item, columns)
    if time_s is None:
        time_s = np.arange(item.frames) / FRAMES_PER_SECOND
        notes.append(f"times of {FRAMES_PER_SECOND:g} pictures a second, as none are known")
    if not all(map(is_jpeg, pictures)):
        notes.append("pictures encoded as JPEG")
    step_s = float(np.median(np.diff(time_s))) if item.frames > 1 else 0.0
    fps = min(max(1 / step_s, _RATES[0]), _RATES[1]) if step_s > 0 else FRAMES_PER_SECOND
    jpegs, contact = list(map(as_jpeg, pictures)), item.contact
    if contact is None:  # by the pictures that are stored, so that a copy has the same
        contact, is_found = contact_by_pictures(jpegs, size)
        notes.append("contact found by the pictures" if is_found else "no contact found: the best picture")
    height, width = size
    video = write_avi(jpegs, width, height, fps)
    return ImportedClip(video, np.round(time_s * 1e6).astype(np.int64), contact, tuple(notes))


def clip_times_s(item: FoundTouch, columns: ImportColumns) -> Float64 | None:
    """Return the time of each picture from the first one, seconds, shape (frames,); None if none are known.

    Raises ItemError for times that run back, or last longer than any clip does.
    """
    time_s = item.time_s
    if columns.time and columns.time in item.per_frame:
        time_s = times_s(item.per_frame[columns.time], columns)
    if time_s is None:
        if columns.time:
            raise ItemError("time", f"no {columns.time!r} for each picture; expected the time of each")
        return None
    if len(time_s) != item.frames:
        raise ItemError("time", f"{len(time_s):,} times of {item.frames:,} pictures; expected one for each")
    from_first = time_s - time_s[:1]
    steps = np.diff(from_first)
    if not np.isfinite(from_first).all() or (steps < 0).any():
        raise ItemError(
            "time", f"time runs back at picture {int((steps < 0).argmax()) + 1}; expected times that rise"
        )
    if item.frames and from_first[-1] > _LONGEST_S:
        problem = f"a clip of {from_first[-1]:g} s; expected seconds (--time-unit states another unit)"
        raise ItemError("time", problem)
    return from_first


def clip_poses(item: FoundTouch, columns: ImportColumns) -> Float64:
    """Return the pose at each picture, shape (frames, 7); ItemError, with the picture, for what is none."""
    fields, count = _of_clip(item, columns.pose or ())
    found, problems = each_of(poses, fields, columns, count)
    return np.repeat(_only(found, problems, count), item.frames // count, axis=0)


def clip_position(item: FoundTouch, columns: ImportColumns) -> Float64:
    """Return the intended position, shape (2,); ItemError unless it is the same for all pictures."""
    fields, count = _of_clip(item, columns.position or ())
    found, problems = each_of(positions, fields, columns, count)
    place = _only(found, problems, count)
    if np.ptp(place, axis=0).max() > _SAME_M:
        problem = "it differs between the pictures of the clip; expected one (--map position= leaves it out)"
        raise ItemError("position", problem)
    first: Float64 = place[0]
    return first


def _only(found: Float64 | None, problems: dict[int, ItemError], count: int) -> Float64:
    """Return what was read of all pictures; ItemError for the first that cannot be used."""
    for number, error in problems.items():
        where = f"picture {number}: " if count > 1 else ""
        raise ItemError(error.reason, f"{where}{error.message}")
    assert found is not None
    return found


def _of_clip(item: FoundTouch, names: Sequence[str]) -> tuple[Fields, int]:
    """Return columns with an entry for each picture, or for the clip if none has more; and their length."""
    count = item.frames if any(name in item.per_frame for name in names) else 1
    fields: dict[str, Sequence[object]] = {}
    for name in names:
        values: Sequence[object] = item.per_frame.get(name, [item.values.get(name)] * count)  # type: ignore[assignment]
        if len(values) != count:
            raise ItemError(
                "frames", f"{len(values):,} of {name!r} for {count:,} pictures; expected one for each"
            )
        fields[name] = values
    return fields, count


def contact_by_pictures(
    pictures: Sequence[bytes], size: tuple[int, int], rule: ContactRule | None = None
) -> tuple[tuple[int, int], bool]:
    """Return the first and last picture that show contact, and True; else the best picture, and False.

    The background is the median of the clip: of 64 of its pictures at most, spread evenly over all of it, so
    that a long clip takes little time and memory. Raises ItemError for a damaged picture.
    """
    rule = rule or ContactRule()
    rows, columns = rule.window(*size)
    whole = replace(rule, crop=1.0)
    height, width = rows.stop - rows.start, columns.stop - columns.start
    most = min(_MOST_OF_MEDIAN, max(1, _BATCH_BYTES // (3 * height * width)))

    def decoded(some: Sequence[bytes]) -> UInt8:
        made = np.empty((len(some), height, width, 3), np.uint8)
        for number, each in enumerate(some):
            made[number] = decode_image(each)[rows, columns]  # a view would keep the whole picture
        return made

    try:
        base = median_in_memory(decoded(pictures[:: -(-len(pictures) // most)]))
        scores = [
            contact_score(decoded(pictures[start : start + _SCORED_AT_ONCE]), base, whole)
            for start in range(0, len(pictures), _SCORED_AT_ONCE)
        ]
    except ValueError as error:
        raise ItemError("image", str(error)) from error
    held = np.flatnonzero(np.concatenate([rule.holds(score) for score in scores]))
    if len(held):
        return (int(held[0]), int(held[-1])), True
    best = int(np.concatenate([score.total_change for score in scores]).argmax())
    return (best, best), False
