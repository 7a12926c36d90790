"""Pictures of real touches: a round as a grid or on a map of the cell, a clip as a strip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.poses import contact_z_m, plate_z_m
from realtouch.contact import contact_heights_m
from realtouch.media.clips import TouchClip
from realtouch.media.sheets import evenly_spaced, fitted
from realtouch.opening import load
from realtouch.rounds import TouchRound, TouchSeqRound
from realtouch.show.overlay import cell_map, overlay, placed_touches
from realtouch.touch import Touch
from tactile_toolkit.errors import InputError
from tactile_toolkit.pictures.sheets import (
    ACCENTS,
    INK,
    MUTED,
    PAPER,
    Sheet,
    Tile,
    draw_text,
    sheet,
    with_scale_bar,
)
from tactile_toolkit.pictures.writing import (
    PicturePlan,
    Pixels,
    PlannedPicture,
    file_stem,
    plan_kinds,
)
from tactile_toolkit.touch.contact import ContactHeight, height_text
from tactile_toolkit.touch.schema import POSE_COLUMN, Kind
from tactile_toolkit.wording import counted

CONTACT = ACCENTS[0]
"""Colour of the frame around touches in which the gel stopped on an object."""

IN_CONTACT = ACCENTS[3]
"""Colour of the frame around pictures between the first and the last registered contact."""

_COLUMNS = 8
_TILE_PX = 160
_PX_PER_MM = 7.0
_MOST_FRAMES = 24
_STRIP_TILE_PX = 168
_BAR_PX = 34
_GAP_PX = 2
_TRACK = (224, 228, 232)


@dataclass(frozen=True, slots=True)
class TouchPreviewSpec:
    """Which pictures of touches to draw; the grid where no kind is asked for."""

    kinds: tuple[str, ...] = ()
    split: str | None = None  # the only one
    round_number: int = 0  # which round of the split, from 0
    touches: int = 32  # of a grid, evenly spaced over the round
    touch: int = 0  # which touch of the round is drawn as a strip, from 0
    revision: str | None = None  # branch, tag or commit of a Hub repository


def plan_previews(name: str, spec: TouchPreviewSpec) -> PicturePlan:
    """Decide which pictures to draw of whatever :func:`realtouch.load` opens; draws none.

    Kinds are grid, overlay and strip. InputError: no such data set, split, round, touch or kind, nothing in
    it, or a strip of a set without clips. IntegrityError and HubError as :func:`realtouch.load`.
    """
    dataset = load(name, spec.split, revision=spec.revision)
    split = spec.split or "-".join(dataset.splits)
    if not len(dataset):
        raise InputError(f"split {split!r} of {name!r} holds no round", next="choose another split")
    number = spec.round_number
    if not 0 <= number < len(dataset):
        raise InputError(f"--round is {number}; split {split!r} has rounds 0 to {len(dataset) - 1}")
    record = dataset[number]
    stem = "-".join(filter(None, (file_stem(name), split)))

    def planned(kind: str, what: str, draw: Callable[[], Pixels]) -> list[PlannedPicture]:
        return [PlannedPicture(f"{stem}-round-{number}-{kind}.png", what, draw)]

    def strip() -> list[PlannedPicture]:
        if not isinstance(record, TouchSeqRound):
            raise InputError(
                "a film strip needs clips, and this data set holds images", next="give a seq set"
            )
        touch, clips = spec.touch, record.sensor_video
        if not 0 <= touch < len(clips):
            raise InputError(f"--touch is {touch}; round {number} has touches 0 to {len(clips) - 1}")
        title = f"{_title(record)}, touch {touch}"
        what = f"the clip of touch {touch} of {record!r}"
        return planned(f"touch-{touch}-strip", what, lambda: draw_strip(clips[touch], title))

    on_map = f"all touches of {record!r} at their positions"
    plans = {
        "grid": lambda: planned("grid", f"touches of {record!r}", lambda: draw_grid(record, spec.touches)),
        "overlay": lambda: planned("overlay", on_map, lambda: draw_overlay(record)),
        "strip": strip,
    }
    return plan_kinds(spec.kinds, plans, ("grid",))


def frames_shown(count: int, contact: slice, most: int = _MOST_FRAMES) -> tuple[int, ...]:
    """Choose frames of a clip: every frame of contact and one on each side, the others at equal steps.

    Where contact alone has too many frames, all are chosen at equal steps.
    """
    near = range(max(contact.start - 1, 0), min(contact.stop + 1, count))
    left = [frame for frame in range(count) if frame not in near]
    room = most - len(near)
    if room < 2:
        return tuple(evenly_spaced(count, most))
    return tuple(sorted({*near, *(left[index] for index in evenly_spaced(len(left), room))}))


def draw_strip(clip: TouchClip, title: str) -> Pixels:
    """Draw a clip as a film strip with a bar of time below it."""
    contact, times_s = clip.contact_window, clip.timestamps_s
    shown = frames_shown(len(clip), contact)
    tiles = [
        Tile(
            fitted(clip[frame], _STRIP_TILE_PX),
            f"{frame}: {times_s[frame]:.2f} s",
            IN_CONTACT if contact.start <= frame < contact.stop else PAPER,
        )
        for frame in shown
    ]
    words = (
        f"{len(shown)} of {counted(len(clip), 'frames')}, with their times; framed: contact, frames "
        f"{contact.start} to {contact.stop - 1}",
    )
    strip = sheet(tiles, Sheet(_COLUMNS, title, words))
    bar = timeline(len(clip), contact, shown, strip.shape[1])
    return np.concatenate([strip, bar])


def timeline(count: int, contact: slice, shown: tuple[int, ...], width_px: int) -> NDArray[np.uint8]:
    """Draw a bar with a cell for each frame: contact in colour, a tick at each frame that is shown."""
    from PIL import Image, ImageDraw

    margin, top = 16, 4
    picture = Image.new("RGB", (width_px, _BAR_PX + 26), PAPER)
    pen = ImageDraw.Draw(picture)
    step = (width_px - 2 * margin) / count
    # Of many frames there is no room for gaps between the cells; those of contact come last, above others.
    gap = _GAP_PX if step > 2 * _GAP_PX else 0
    for frame in sorted(range(count), key=lambda frame: contact.start <= frame < contact.stop):
        left = margin + frame * step
        box = (left, top, max(left, left + step - max(gap, 1)), top + 16)
        pen.rectangle(box, fill=IN_CONTACT if contact.start <= frame < contact.stop else _TRACK)
    for frame in shown:
        middle = margin + (frame + 0.5) * step - 1
        pen.line((middle, top + 20, middle, top + 26), fill=INK, width=2)
    for frame, anchor in ((0, "la"), (count - 1, "ra")):
        x = margin if frame == 0 else width_px - margin
        draw_text(pen, (x, top + 30), f"frame {frame}", 14, MUTED, anchor)
    return np.asarray(picture)


def draw_grid(record: TouchRound, most: int) -> Pixels:
    """Draw touches of a round, evenly spaced, with their numbers; those that met an object are framed."""
    kind: Kind = "seq" if isinstance(record, TouchSeqRound) else "single"
    heights_m = None
    if record._row.has(f"{POSE_COLUMN[kind]}.position"):
        rule = ContactHeight.of(record._row.group.names)
        heights_m = contact_heights_m(contact_z_m(record._row, kind), plate_z_m=plate_z_m(record._row))
    tiles = []
    for touch in evenly_spaced(record.touch_count, most):
        caption, frame = f"{touch}", None
        if heights_m is not None:
            caption = f"{touch}: {heights_m[touch] * 1e3:.1f} mm"
            frame = CONTACT if heights_m[touch] >= rule.min_height_m else PAPER
        tiles.append(Tile(fitted(Touch(record, touch).image, _TILE_PX), caption, frame))
    words = [f"{len(tiles)} of {_touches_in_words(record)}"]
    if heights_m is not None:
        words += [f"framed: {height_text(rule.min_height_m)}; its height next to the number"]
    return sheet(tiles, Sheet(_COLUMNS, _title(record), ("; ".join(words),)))


def draw_overlay(record: TouchRound) -> Pixels:
    """Draw all touches of a round at their positions on a map of the cell."""
    touches = placed_touches(record, range(record.touch_count))
    cell = cell_map(touches, _PX_PER_MM)
    pixels = with_scale_bar(overlay(touches, cell), _PX_PER_MM)
    x_mm, y_mm = (side / _PX_PER_MM for side in cell.size_px)
    words = (
        f"{_touches_in_words(record)} at their positions",
        f"{x_mm:.0f} x {y_mm:.0f} mm around the middle of the cell, x right, y up",
    )
    return sheet([Tile(pixels, frame=(205, 210, 215))], Sheet(1, _title(record), words))


def _touches_in_words(record: TouchRound) -> str:
    of_object = f" of object {record.object_id}" if record._row.has("object_id") else ""
    return f"{counted(record.touch_count, 'touches')}{of_object}"


def _title(record: TouchRound) -> str:
    return f"Round {record.id}, label {record.label}"
