"""Sections of a session: one round, or several short ones in a row, each checked in one pass.

A section keeps what other sections are compared with: a digest and a colour pattern of each touch, and the
bare gel. It keeps no pictures.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import NamedTuple

import numpy as np
import xxhash

from realtouch import (
    contact_picture,
    media,
    picture_views,
    schema,
    stored_round,
    touch_options,
)
from realtouch.faults import rules, seen, strips
from realtouch.poses import Poses
from tactile_toolkit.array_types import Float32, Float64
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.touch import MEDIA_COLUMN, decode_image

GEL_PICTURES = 32
"""Pictures of a section whose median shows its bare gel; at each pixel, fewer than half have contact."""

_FIRST_FRAMES = 8  # of a clip, before the contact
_MIN_BARE = 5  # pictures whose median shows the gel and not a touched object
_TIMES = "time_stamp_rel_seq"


class PlacedRow(NamedTuple):
    """A stored round, its split and its row number in the split."""

    split: str
    number: int
    stored: stored_round.StoredRound


class RoundSeen(NamedTuple):
    """Facts about a round: its place, name, object and gel, and the number of its touches."""

    spot: rules.Spot
    name: str
    touches: int
    object_id: int | None
    gel: object


class TouchSeen(NamedTuple):
    """A touch with content: a digest of its stored pictures, and their colour pattern, shape (48,)."""

    spot: rules.Spot
    digest: bytes
    pattern: Float32


@dataclass(eq=False)
class Section:
    """Results of checking some rounds; ``gel``, shape (12, 16, 3), are averages of the bare gel, levels."""

    rounds: list[RoundSeen] = field(default_factory=list)
    faults: list[rules.Fault] = field(default_factory=list)
    touches: list[TouchSeen] = field(default_factory=list)
    gel: Float32 | None = None
    markers: int | None = None
    decoded: int = 0


def check_section(
    rows: Sequence[PlacedRow], limits: touch_options.CheckLimits, frames: int, *, is_rendered: bool
) -> Section:
    """Check rounds; of each clip, at most ``frames`` evenly spaced pictures are decoded.

    Rendered pictures may be equal or without content, as those of the bare plate: they are duplicates only if
    the gel is also at the same place.
    """
    section = Section()
    pictures: list[strips.Picture] = []
    for row in rows:
        at = rules.Spot(row.split, row.number, rules.WHOLE_ROUND)
        try:
            section.rounds.append(_describe(row.stored, at))
            present = _with_bytes(row.stored, at, section)
        except IntegrityError:
            section.faults.append(rules.Fault("unreadable-touches", at, 0.0))
            continue
        parts = [present] if row.stored.kind == "single" else [[spot] for spot in present]
        for part in filter(None, parts):
            strip = _strip(section, row.stored, part, frames, is_rendered=is_rendered)
            for rule in strips.STRIP_RULES:
                section.faults += rule(strip, limits)
            section.touches += _touches(strip)
            pictures += strip.seen.values()
    if pictures and not is_rendered:  # no light that could change
        steps = seen.outlying_steps(np.stack([each.cells for each in pictures]), limits.exposure)
        section.faults += [rules.Fault("exposure-jumps", pictures[index].spot, step) for index, step in steps]
        _add_bare_gel(section, pictures)
    return section


def _describe(stored: stored_round.StoredRound, at: rules.Spot) -> RoundSeen:
    gel: object = None
    object_id, name = None, str(at.row)
    if "info.gel_id" in stored.group.names:
        gel = stored.stored_value("info.gel_id")
    if stored.has("object_id"):
        object_id = stored.integer("object_id")
    if stored.has("id"):
        name = stored.name()
    return RoundSeen(at, name, stored.touch_total(), object_id, gel)


def _with_bytes(stored: stored_round.StoredRound, at: rules.Spot, section: Section) -> list[rules.Spot]:
    """Return the touches of a round with stored pictures; the others are added to the faults."""
    column = stored.group.nested(MEDIA_COLUMN[stored.kind])
    start, stop = column.inside(0, stored.index, stored.index + 1)
    stored_bytes = [column.values[index] for index in range(start, stop)]
    spots = [at._replace(touch=touch) for touch in range(stored.touch_total())]
    present = [spot for spot, content in zip(spots, stored_bytes, strict=False) if len(content or b"")]
    empty = sorted({*spots}.difference(present))
    if not spots:
        empty = [at]
    section.faults += [rules.Fault("empty-pictures", spot, 1.0) for spot in empty]
    return present


def _strip(
    section: Section,
    stored: stored_round.StoredRound,
    touches: Sequence[rules.Spot],
    frames: int,
    *,
    is_rendered: bool,
) -> strips.Strip:
    """Read the images of a round, or the frames of one touch; add unreadable ones to the faults."""
    encoded: list[memoryview] = []
    poses, time_s, spots, at = None, np.zeros(0), touches, touches[0]
    try:
        if stored.kind == "seq":
            clip = media.TouchClip(stored, at.touch)
            encoded = [clip.encoded(frame) for frame in range(len(clip))]
            spots = [at._replace(frame=frame) for frame in range(len(clip))]
        else:
            at, frames = at._replace(touch=rules.WHOLE_ROUND), len(touches)
            encoded = list(map(media.SensorImages(stored).encoded, (spot.touch for spot in touches)))
        poses, time_s = _motion(stored, touches)
    except IntegrityError:
        section.faults.append(rules.Fault("unreadable-touches", at, 0.0))
    digests = list(map(xxhash.xxh3_128_digest, encoded))
    pictures: dict[int, strips.Picture] = {}
    empty: dict[int, rules.Fault] = {}
    for number in picture_views.evenly_spaced(len(encoded), frames):
        spot, picture = spots[number], encoded[number]
        try:
            cells = seen.cells_of(picture)
            share = seen.share_of_one_value(picture, cells)
        except ValueError:
            section.faults.append(rules.Fault("unreadable-touches", spot, 0.0))
            continue
        section.decoded += 1
        if share > rules.MAX_ONE_VALUE and not is_rendered:
            empty[spot.touch] = rules.Fault("empty-pictures", spot, share)
            digests = [b"" if each == digests[number] else each for each in digests]
        else:
            pictures[number] = strips.Picture(spot, cells, picture)
    section.faults += empty.values()
    if is_rendered and poses is not None:  # the bare plate looks the same everywhere
        digests = [digest + poses.position_m[number].tobytes() for number, digest in enumerate(digests)]
    return strips.Strip(at, spots, digests, pictures, poses, time_s)


def _motion(stored: stored_round.StoredRound, touches: Sequence[rules.Spot]) -> tuple[Poses | None, Float64]:
    """Return the poses of the pictures of some touches, if any, and the times of frames, seconds."""
    is_clip, time_s, poses = stored.kind == "seq", np.zeros(0), None
    if is_clip and stored.has(_TIMES):
        time_s = stored_round.as_seconds(stored.cut(_TIMES, 0, touches[0].touch)[0])
    if stored.has_poses and stored.has(f"{schema.POSE_COLUMN[stored.kind]}.quaternion"):
        if is_clip:
            return stored.pose_sequences(touches[0].touch)[0], time_s
        poses = stored.poses()[[spot.touch for spot in touches]]
    return poses, time_s


def _touches(strip: strips.Strip) -> Iterator[TouchSeen]:
    """Yield the touches of a strip, all pictures of which have content."""
    numbers = range(len(strip.spots))
    for _, group in groupby(numbers, key=lambda number: strip.spots[number].touch):
        of_touch = list(group)
        cells = [strip.seen[number].cells for number in of_touch if number in strip.seen]
        if cells and all(strip.digests[number] for number in of_touch):
            digest = xxhash.xxh3_128_digest(b"".join(strip.digests[number] for number in of_touch))
            spot = strip.spots[of_touch[0]]._replace(frame=0)
            yield TouchSeen(spot, digest, seen.colour_pattern(np.median(cells, axis=0)))


def _add_bare_gel(section: Section, pictures: Sequence[strips.Picture]) -> None:
    """Add the bare gel: the median of the images, or of the first frames of the clips."""
    by_touch = [list(group) for _, group in groupby(pictures, key=lambda each: each.spot[:3])]
    section.gel = np.median([touch[0].cells for touch in by_touch], axis=0).astype(np.float32)
    each_of = min(_FIRST_FRAMES, max(1, GEL_PICTURES // len(by_touch)))
    bare = [each.encoded for touch in by_touch for each in touch[:each_of]]
    decoded = [decode_image(bare[index]) for index in picture_views.evenly_spaced(len(bare), GEL_PICTURES)]
    same = [each for each in decoded if each.shape == decoded[0].shape]
    section.decoded += len(decoded)
    if len(same) >= _MIN_BARE:
        section.markers = seen.count_markers(contact_picture.median_in_memory(np.stack(same)))
