"""Sections of a session: one round, or several short ones in a row, looked at once.

Everything that several sections are compared by is kept: a digest and a colour pattern of each touch, and the
bare gel. Pictures are not.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import xxhash

from realtouch.contact_picture import median_in_memory
from realtouch.faults import motion, seen
from realtouch.faults.rules import MAX_ONE_VALUE, MIN_CHANGE, WHOLE_ROUND, Fault, Spot
from realtouch.picture_views import evenly_spaced
from realtouch.poses import Poses
from realtouch.schema import POSE_COLUMN
from realtouch.sensor_images import SensorImages
from realtouch.stored_round import StoredRound
from realtouch.touch_clips import TouchClip
from realtouch.touch_options import CheckLimits
from tactile_toolkit.array_types import Float32, Float64
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.touch import MEDIA_COLUMN, decode_image

GEL_PICTURES = 32
"""Pictures of a section whose median is its bare gel; less than half of them have contact at a place."""

_FIRST_FRAMES = 8  # of a clip, before the contact


class PlacedRow(NamedTuple):
    """A stored round, its split and its number in it."""

    split: str
    number: int
    stored: StoredRound


@dataclass(frozen=True, eq=False)
class RoundSeen:
    """What is known of a round: its place, name, object and gel, and the number of its touches."""

    split: str
    number: int
    name: str
    touches: int
    object_id: int | None
    gel: object


@dataclass(eq=False)
class Section:
    """What was seen of some rounds.

    ``spots``, ``digests`` and ``patterns`` have an entry for each touch with a picture. ``gel``, shape
    (12, 16, 3), are the averages of the bare gel.
    """

    rounds: list[RoundSeen] = field(default_factory=list)
    faults: list[Fault] = field(default_factory=list)
    spots: list[Spot] = field(default_factory=list)
    digests: list[bytes] = field(default_factory=list)
    patterns: list[Float32] = field(default_factory=list)
    gel: Float32 | None = None
    markers: int | None = None
    decoded: int = 0


@dataclass(frozen=True, eq=False)
class _Seen:
    """The pictures of a touch that were looked at: their cells, and encoded ones, as bare as there are."""

    spots: list[Spot]
    cells: list[Float32]
    one_value: list[float]
    digest: bytes
    bare: Sequence[memoryview]

    def with_content(self) -> list[int]:
        """Return which of the pictures are neither black nor without content."""
        return [index for index, value in enumerate(self.one_value) if value <= MAX_ONE_VALUE]


def look_at(rows: Sequence[PlacedRow], limits: CheckLimits, frames: int, *, is_rendered: bool) -> Section:
    """Look at rounds of which at most ``frames`` pictures of each clip are decoded, evenly spaced.

    Pictures that are rendered may be equal or without content, as those of the bare plate: they are
    duplicates only if the gel is at the same place, too.
    """
    section = Section()
    pictures: list[_Seen] = []
    for row in rows:
        spot = Spot(row.split, row.number, WHOLE_ROUND)
        try:
            section.rounds.append(_describe(row))
            touches = row.stored.touch_total()
        except IntegrityError:
            section.faults.append(Fault("unreadable-touches", spot, 0.0))
            continue
        if not touches:
            section.faults.append(Fault("empty-pictures", spot, 1.0))
        look = partial(_look_at_touch, section, row, limits=limits, frames=frames, is_rendered=is_rendered)
        found = list(map(look, range(touches)))
        readable = [each for each in found if each is not None]
        _compare_touches(section, row, readable, limits)
        pictures += readable
    if not is_rendered:  # nothing lights them
        _check_sequence(section, pictures, limits)
        _look_at_gel(section, pictures)
    return section


def _describe(row: PlacedRow) -> RoundSeen:
    stored = row.stored
    gel = stored.stored_value("info.gel_id") if "info.gel_id" in stored.group.names else None
    object_id = stored.integer("object_id") if stored.has("object_id") else None
    name = stored.name() if stored.has("id") else str(row.number)
    return RoundSeen(row.split, row.number, name, stored.touch_total(), object_id, gel)


def _look_at_touch(
    section: Section, row: PlacedRow, touch: int, *, limits: CheckLimits, frames: int, is_rendered: bool
) -> _Seen | None:
    """Look at the pictures of one touch; None if none can be read."""
    spot = Spot(row.split, row.number, touch)
    stored = row.stored
    if not _has_bytes(stored, touch):
        section.faults.append(Fault("empty-pictures", spot, 1.0))
        return None
    look: Callable[..., _Seen] = _look_at_image
    if stored.kind == "seq":
        look = partial(_look_at_clip, section, limits=limits, frames=frames)
    place = b""
    try:
        found = look(stored, spot)
        if is_rendered and _has_poses(stored):  # the bare plate looks the same everywhere
            place = stored.vectors(f"{POSE_COLUMN[stored.kind]}.position", 3, touch).tobytes()
    except (IntegrityError, ValueError):
        section.faults.append(Fault("unreadable-touches", spot, 0.0))
        return None
    section.decoded += len(found.cells)
    empty = [index for index, value in enumerate(found.one_value) if value > MAX_ONE_VALUE]
    if empty and not is_rendered:
        value = max(found.one_value)
        section.faults.append(Fault("empty-pictures", found.spots[empty[0]], value))
    else:
        section.spots.append(spot)
        section.digests.append(found.digest + place)
        section.patterns.append(seen.colour_pattern(np.median(found.cells, axis=0)))
    return found


def _has_bytes(stored: StoredRound, touch: int) -> bool:
    column = stored.group.nested(MEDIA_COLUMN[stored.kind])
    start, stop = column.inside(0, stored.index, stored.index + 1)
    return touch < stop - start and bool(len(column.values[start + touch] or b""))


def _has_poses(stored: StoredRound) -> bool:
    return stored.has_poses and stored.has(f"{POSE_COLUMN[stored.kind]}.quaternion")


def _look_at_image(stored: StoredRound, spot: Spot) -> _Seen:
    encoded = SensorImages(stored).encoded(spot.touch)
    cells = seen.cells_of(encoded)
    one_value = [seen.share_of_one_value(encoded, cells)]
    return _Seen([spot], [cells], one_value, xxhash.xxh3_128_digest(encoded), [encoded])


def _look_at_clip(
    section: Section, stored: StoredRound, spot: Spot, limits: CheckLimits, frames: int
) -> _Seen:
    """Look at a clip: the bytes of all of its frames, and some decoded."""
    clip = TouchClip(stored, spot.touch)
    encoded = [clip.encoded(frame) for frame in range(len(clip))]
    digests = list(map(xxhash.xxh3_128_digest, encoded))
    chosen = evenly_spaced(len(clip), frames)
    cells = [seen.cells_of(encoded[frame]) for frame in chosen]
    one_value = [
        seen.share_of_one_value(encoded[frame], each) for frame, each in zip(chosen, cells, strict=True)
    ]
    spots = [spot._replace(frame=frame) for frame in chosen]
    time_s = motion.clip_times_s(stored, spot.touch)
    section.faults += motion.time_faults(spot, time_s, limits)
    poses = None
    if _has_poses(stored):
        poses = stored.pose_sequences(spot.touch)[0]
        section.faults += motion.clip_jumps(spot, poses, limits)
        section.faults += _still_poses(spots, chosen, cells, poses)
    if max(one_value) <= MAX_ONE_VALUE:  # else they are equal because they are empty
        same = [one == other for one, other in pairwise(digests)]
        all_spots = [spot._replace(frame=frame) for frame in range(len(clip))]
        section.faults += _frozen(all_spots, same, poses, limits)
    return _Seen(spots, cells, one_value, xxhash.xxh3_128_digest(b"".join(digests)), encoded[:_FIRST_FRAMES])


def _frozen(
    spots: Sequence[Spot], same: Sequence[bool], poses: Poses | None, limits: CheckLimits
) -> Iterator[Fault]:
    """Yield runs of equal pictures, and how far the gel moves meanwhile."""
    for start, length in seen.runs_of(same, limits.frozen):
        first = spots[start]
        # A clip is named once, by the last of its frozen frames.
        repeats = list({spot.touch: spot for spot in spots[start + 1 : start + length]}.values())
        yield from (Fault("frozen-frames", spot, length, first) for spot in repeats)
        moved = motion.moved_mm(poses, start, length) if poses is not None else 0.0
        if moved >= limits.motion_mm:
            yield from (Fault("moving-poses", spot, moved, first) for spot in repeats)


def _still_poses(
    spots: Sequence[Spot], numbers: Sequence[int], cells: Sequence[Float32], poses: Poses
) -> Iterator[Fault]:
    """Yield the runs of equal poses over which pictures change; ``numbers`` are those of their poses."""
    for start, length in motion.still_runs(poses):
        inside = [index for index, number in enumerate(numbers) if start <= number < start + length]
        if len(inside) < 2:
            continue
        parts = np.stack([cells[index] for index in inside])
        # An even step of brightness is not a contact.
        parts = parts - np.median(parts, axis=(1, 2), keepdims=True)
        if np.ptp(parts, axis=0).max() >= MIN_CHANGE:
            shown = inside[int(np.argmax(np.abs(parts - parts[0]).max(axis=(1, 2, 3))))]
            concerned = {spots[index].touch: spots[index] for index in (*inside, shown)}
            yield from (Fault("still-poses", spot, length, spots[inside[0]]) for spot in concerned.values())


def _compare_touches(section: Section, row: PlacedRow, found: Sequence[_Seen], limits: CheckLimits) -> None:
    """Compare the poses of the touches of a round, and those of images with the images."""
    stored, spots = row.stored, [each.spots[0]._replace(frame=0) for each in found]
    poses = None
    if found and _has_poses(stored):
        try:
            poses, position_m = _poses_of_touches(stored, [spot.touch for spot in spots])
            section.faults += motion.far_touches(spots, position_m, limits)
        except IntegrityError:
            whole = Spot(row.split, row.number, WHOLE_ROUND)
            section.faults.append(Fault("unreadable-touches", whole, 0.0))
    if stored.kind == "seq":
        return
    if poses is not None:
        cells = [each.cells[0] for each in found]
        section.faults += _still_poses(spots, range(len(spots)), cells, poses)
    digest_of = dict(zip(section.spots, section.digests, strict=True))
    digests = [digest_of.get(spot, b"") for spot in spots]
    same = [one == other != b"" for one, other in pairwise(digests)]
    section.faults += _frozen(spots, same, poses, limits)


def _poses_of_touches(stored: StoredRound, touches: Sequence[int]) -> tuple[Poses | None, Float64]:
    """Return the poses of images, and where each touch was, shape (T, 3), metres: the middle of its clip."""
    if stored.kind == "single":
        poses = stored.poses()[touches]
        return poses, np.asarray(poses.position_m, np.float64)
    clips = [stored.pose_sequences(touch)[0].position_m for touch in touches]
    return None, np.array([np.median(each, axis=0) for each in clips], np.float64)


def _check_sequence(section: Section, pictures: Sequence[_Seen], limits: CheckLimits) -> None:
    """Find steps of the brightness from picture to picture of a section."""
    cells: list[Float32] = []
    spots: list[Spot] = []
    for each in pictures:
        # Those without content are reported already.
        full = each.with_content()
        cells += [each.cells[index] for index in full]
        spots += [each.spots[index] for index in full]
    if cells:
        for index, step in seen.outlying_steps(np.stack(cells), limits.exposure):
            section.faults.append(Fault("exposure-jumps", spots[index], step, spots[index - 1]))


def _look_at_gel(section: Section, pictures: Sequence[_Seen]) -> None:
    """Add the bare gel: the median of the images, or of the first frames of the clips."""
    pictures = [each for each in pictures if each.one_value[0] <= MAX_ONE_VALUE]
    if not pictures:
        return
    section.gel = np.median([each.cells[0] for each in pictures], axis=0).astype(np.float32)
    decoded: list[Any] = []
    each_of = max(1, GEL_PICTURES // len(pictures))
    bare = [encoded for each in pictures for encoded in each.bare[:each_of]]
    for index in evenly_spaced(len(bare), GEL_PICTURES):
        pixels = decode_image(bare[index])
        if not decoded or pixels.shape == decoded[0].shape:
            decoded.append(pixels)
    section.decoded += len(decoded)
    section.markers = seen.count_markers(median_in_memory(np.stack(decoded)))
