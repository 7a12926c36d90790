"""Sections of a session: one round, or several short ones in a row, each checked in one pass.

A strip is a sequence of pictures with poses and times: the images of a round, or the frames of a clip. A
section keeps what other sections are compared with: a digest and a colour pattern of each touch, and the bare
gel. It keeps no pictures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np
import xxhash
from numpy.typing import NDArray

from realtouch import contact, touch_options
from realtouch.checks import rules
from realtouch.checks.rules import spans_of
from realtouch.touches import media, schema, stored_round
from realtouch.touches.poses import Poses
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.touch import decode_image
from tactile_toolkit.value_types import Float32, Float64

GEL_PICTURES = 32
"""Pictures of a section whose median shows its bare gel; at each pixel, fewer than half have contact."""
_FIRST_FRAMES = 8  # of a clip, before the contact
_MIN_BARE = 5  # pictures whose median shows the gel and not a touched object
_TIMES = "time_stamp_rel_seq"

_MIN_STEPS = 4  # fewer have no usual step
_SAME_M, _SAME_QUATERNION = 1e-7, 1e-6  # a robot at rest measures noise beyond these
_FAR = 10.0  # touches of a round are about this many times farther apart than frames


class PlacedRow(NamedTuple):
    """A stored round, its split and its row number in the split."""

    split: str
    number: int
    stored: stored_round.StoredRound


class RoundFacts(NamedTuple):
    """Facts about a round: its place, name, object and gel, and the number of its touches."""

    spot: rules.Spot
    name: str
    touches: int
    object_id: int | None
    gel: object


class TouchFacts(NamedTuple):
    """A touch with content: a digest of its stored pictures, and their colour pattern, shape (48,).

    ``grey``, shape (192,), is the brightness of the cells of a picture, float16, levels; None if rendered.
    """

    spot: rules.Spot
    digest: bytes
    pattern: Float32
    grey: NDArray[np.float16] | None


@dataclass(eq=False)
class Section:
    """Results of checking some rounds; ``gel``, shape (12, 16, 3), are averages of the bare gel, levels."""

    rounds: list[RoundFacts] = field(default_factory=list)
    faults: list[rules.Fault] = field(default_factory=list)
    touches: list[TouchFacts] = field(default_factory=list)
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
    pictures: list[Picture] = []
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
            for rule in STRIP_RULES:
                section.faults += rule(strip, limits)
            section.touches += _touches(strip, is_rendered=is_rendered)
            pictures += strip.pictures.values()
    if pictures and not is_rendered:  # no light that could change
        steps = rules.outlying_steps(np.stack([picture.cells for picture in pictures]), limits.exposure)
        section.faults += [rules.Fault("exposure-jumps", pictures[index].spot, step) for index, step in steps]
        _add_bare_gel(section, pictures)
    return section


def _describe(stored: stored_round.StoredRound, at: rules.Spot) -> RoundFacts:
    gel: object = None
    object_id = None
    name = str(at.row)
    if "info.gel_id" in stored.group.names:
        gel = stored.stored_value("info.gel_id")
    if stored.has("object_id"):
        object_id = stored.integer("object_id")
    if stored.has("id"):
        name = stored.name()
    return RoundFacts(at, name, stored.touch_total(), object_id, gel)


def _with_bytes(stored: stored_round.StoredRound, at: rules.Spot, section: Section) -> list[rules.Spot]:
    """Return the touches of a round with stored pictures; the others are added to the faults."""
    column = stored.group.nested(stored.media_column)
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
) -> Strip:
    """Read the images of a round, or the frames of one touch; add unreadable ones to the faults."""
    encoded: list[memoryview] = []
    poses = None
    time_s = file_time_s = np.zeros(0)
    spots = touches
    at = touches[0]
    try:
        if stored.kind == "seq":
            clip = media.TouchClip(stored, at.touch)
            encoded = [clip.encoded(frame) for frame in range(len(clip))]
            file_time_s = clip.media_times_s
            spots = [at._replace(frame=frame) for frame in range(len(clip))]
        else:
            at = at._replace(touch=rules.WHOLE_ROUND)
            frames = len(touches)
            encoded = list(map(media.SensorImages(stored).encoded, (spot.touch for spot in touches)))
        poses, time_s = _motion(stored, touches)
    except IntegrityError:
        section.faults.append(rules.Fault("unreadable-touches", at, 0.0))
    digests = list(map(xxhash.xxh3_128_digest, encoded))
    pictures: dict[int, Picture] = {}
    empty: dict[int, rules.Fault] = {}
    for number in media.evenly_spaced(len(encoded), frames):
        spot, picture = spots[number], encoded[number]
        try:
            cells = rules.cells_of(picture)
            share = rules.share_of_one_value(picture, cells)
        except ValueError:
            section.faults.append(rules.Fault("unreadable-touches", spot, 0.0))
            continue
        section.decoded += 1
        if share > rules.MAX_ONE_VALUE and not is_rendered:
            empty[spot.touch] = rules.Fault("empty-pictures", spot, share)
            digests = [b"" if digest == digests[number] else digest for digest in digests]
        else:
            pictures[number] = Picture(spot, cells, picture)
    section.faults += empty.values()
    if is_rendered and poses is not None:  # the bare plate looks the same everywhere
        digests = [digest + poses.position_m[number].tobytes() for number, digest in enumerate(digests)]
    return Strip(at, spots, digests, pictures, poses, time_s, file_time_s)


def _motion(stored: stored_round.StoredRound, touches: Sequence[rules.Spot]) -> tuple[Poses | None, Float64]:
    """Return the poses of the pictures of some touches, if any, and the times of frames, seconds."""
    is_clip = stored.kind == "seq"
    time_s = np.zeros(0)
    poses = None
    if is_clip and stored.has(_TIMES):
        time_s = schema.as_seconds(stored.cut(_TIMES, 0, touches[0].touch)[0])
    if stored.has_poses and stored.has(f"{schema.POSE_COLUMN[stored.kind]}.quaternion"):
        if is_clip:
            return stored.pose_sequences(touches[0].touch)[0], time_s
        poses = stored.poses()[[spot.touch for spot in touches]]
    return poses, time_s


def _touches(strip: Strip, *, is_rendered: bool) -> Iterator[TouchFacts]:
    """Yield the touches of a strip, all pictures of which have content."""
    numbers = range(len(strip.spots))
    for _, group in groupby(numbers, key=lambda number: strip.spots[number].touch):
        of_touch = list(group)
        cells = [strip.pictures[number].cells for number in of_touch if number in strip.pictures]
        if cells and all(strip.digests[number] for number in of_touch):
            digest = xxhash.xxh3_128_digest(b"".join(strip.digests[number] for number in of_touch))
            spot = strip.spots[of_touch[0]]._replace(frame=0)
            grey = None
            if not is_rendered:
                decoded = [number for number in of_touch if number in strip.pictures]
                picture = strip.pictures[decoded[len(decoded) // 2]]
                grey = rules.brightness_of(picture.encoded).astype(np.float16)
            yield TouchFacts(spot, digest, rules.colour_pattern(np.median(cells, axis=0)), grey)


def _add_bare_gel(section: Section, pictures: Sequence[Picture]) -> None:
    """Add the bare gel: the median of the images, or of the first frames of the clips."""
    by_touch = [list(group) for _, group in groupby(pictures, key=lambda picture: picture.spot[:3])]
    section.gel = np.median([touch[0].cells for touch in by_touch], axis=0).astype(np.float32)
    each_of = min(_FIRST_FRAMES, max(1, GEL_PICTURES // len(by_touch)))
    bare = [picture.encoded for touch in by_touch for picture in touch[:each_of]]
    decoded = [decode_image(bare[index]) for index in media.evenly_spaced(len(bare), GEL_PICTURES)]
    same = [pixels for pixels in decoded if pixels.shape == decoded[0].shape]
    section.decoded += len(decoded)
    if len(same) >= _MIN_BARE:
        section.markers = rules.count_markers(contact.median_in_memory(np.stack(same)))


class Picture(NamedTuple):
    """A picture with content that was decoded to the averages of its cells, shape (12, 16, 3)."""

    spot: rules.Spot
    cells: Float32
    encoded: memoryview


@dataclass(frozen=True, eq=False)
class Strip:
    """The images of a round, or the frames of a clip.

    ``at`` stands for all of them; ``spots``, ``digests`` and ``poses`` have an entry for each picture, whose
    digest is empty if it has no content. ``pictures`` are by their numbers. ``time_s`` are the times of
    frames, NaN where missing, and ``file_time_s`` those that the file states; both are empty for images.
    """

    at: rules.Spot
    spots: Sequence[rules.Spot]
    digests: Sequence[bytes]
    pictures: Mapping[int, Picture]
    poses: Poses | None
    time_s: Float64
    file_time_s: Float64


def frozen(strip: Strip, limits: touch_options.CheckLimits) -> Iterator[rules.Fault]:
    """Yield runs of equal pictures, and the motion of the gel during them."""
    same = [digest == next_digest != b"" for digest, next_digest in pairwise(strip.digests)]
    for start, length in spans_of(same, limits.frozen):
        # A clip is named once, by the last of its frozen frames.
        repeats = {spot.touch: spot for spot in strip.spots[start + 1 : start + length]}.values()
        yield from (rules.Fault("frozen-frames", spot, length) for spot in repeats)
        if strip.poses is None:
            continue
        moved_mm = 1e3 * float(np.linalg.norm(np.ptp(strip.poses.position_m[start : start + length], axis=0)))
        if moved_mm >= limits.motion_mm:
            yield from (rules.Fault("moving-poses", spot, moved_mm) for spot in repeats)


def still(strip: Strip, limits: touch_options.CheckLimits) -> Iterator[rules.Fault]:
    """Yield the runs of equal poses over which pictures change."""
    if strip.poses is None:
        return
    moved = np.abs(np.diff(strip.poses.position_m, axis=0)).max(axis=1, initial=0)
    turned = np.abs(np.diff(strip.poses.quaternion, axis=0)).max(axis=1, initial=0)
    for start, length in spans_of((moved <= _SAME_M) & (turned <= _SAME_QUATERNION), rules.MIN_STILL):
        inside = [picture for number, picture in strip.pictures.items() if start <= number < start + length]
        if len(inside) < 2:
            continue
        cells = np.stack([picture.cells for picture in inside])
        # An even step of brightness is not a contact.
        cells -= np.median(cells, axis=(1, 2), keepdims=True)
        if np.ptp(cells, axis=0).max() >= rules.MIN_CHANGE:
            concerned = {picture.spot.touch: picture.spot for picture in inside}
            yield from (rules.Fault("still-poses", spot, length) for spot in concerned.values())


def wrong_times(strip: Strip, limits: touch_options.CheckLimits) -> Iterator[rules.Fault]:
    """Yield times that are missing or decrease, or otherwise the longest gap between them."""
    steps = np.diff(strip.time_s)
    if not np.isfinite(strip.time_s).all() or (steps < 0).any():
        known = np.where(np.isfinite(steps), steps, 0.0)
        frame = int(known.argmin()) + 1 if len(steps) else 0
        yield rules.Fault("times-run-back", strip.at._replace(frame=frame), -float(known.min(initial=0.0)))
        return
    usual = float(np.median(steps)) if len(steps) >= _MIN_STEPS else 0.0
    if usual > 0 and steps.max() >= limits.gap * usual:
        after = strip.at._replace(frame=int(steps.argmax()) + 1)
        yield rules.Fault("dropped-frames", after, float(steps.max()) / usual)


def two_clocks(strip: Strip, limits: touch_options.CheckLimits) -> Iterator[rules.Fault]:
    """Yield a clip whose time stamps are those of another rate than its file states."""
    if min(len(strip.time_s), len(strip.file_time_s)) <= _MIN_STEPS:
        return
    step_s, file_step_s = (np.median(np.diff(times)) for times in (strip.time_s, strip.file_time_s))
    difference = abs(float(step_s / file_step_s) - 1)
    if difference > rules.MAX_CLOCK_DIFFERENCE:
        yield rules.Fault("two-clocks", strip.at, difference)


def jumps(strip: Strip, limits: touch_options.CheckLimits) -> Iterator[rules.Fault]:
    """Yield the worst step of the poses of a clip, or the images that are far away from all others."""
    if strip.poses is None or len(strip.spots) <= _MIN_STEPS:
        return
    position_mm = 1e3 * strip.poses.position_m
    if strip.at.touch == rules.WHOLE_ROUND:
        far_mm = np.linalg.norm(position_mm - np.median(position_mm, axis=0), axis=1)
        limit = max(_FAR * limits.jump_mm, rules.JUMP_FACTOR * float(np.median(far_mm)))
        for number in np.flatnonzero(far_mm > limit).tolist():
            yield rules.Fault("pose-jumps", strip.spots[number], float(far_mm[number]) / limit)
        return
    quaternion = strip.poses.quaternion / np.linalg.norm(strip.poses.quaternion, axis=1, keepdims=True)
    # A quaternion and its negative are one rotation.
    cosine = np.abs((quaternion[1:] * quaternion[:-1]).sum(axis=1)).clip(0, 1)
    turned_deg = np.degrees(2 * np.arccos(cosine))
    moved_mm = np.linalg.norm(np.diff(position_mm, axis=0), axis=1)
    for steps, least in ((moved_mm, limits.jump_mm), (turned_deg, rules.MIN_TURN_DEG)):
        limit = max(least, rules.JUMP_FACTOR * float(np.percentile(steps, 90)))
        if steps.max() > limit:
            yield rules.Fault("pose-jumps", strip.spots[int(steps.argmax()) + 1], float(steps.max()) / limit)
            return


STRIP_RULES: tuple[Callable[[Strip, touch_options.CheckLimits], Iterator[rules.Fault]], ...] = (
    frozen,
    still,
    wrong_times,
    two_clocks,
    jumps,
)
"""Rules for a single strip."""
