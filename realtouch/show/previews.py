"""Pictures of real touches: a round as a grid or on a map of the cell, a clip as a strip, the gel's drift."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from realtouch.columns.poses import contact_z_m, plate_z_m
from realtouch.contact import MIN_CONTACT_HEIGHT_M, contact_heights_m
from realtouch.dataset import TouchDataset
from realtouch.media.clips import TouchClip
from realtouch.opening import load
from realtouch.rounds import TouchRound, TouchSeqRound
from realtouch.show.overlay import cell_map, overlay, placed_touches
from realtouch.touches import Touch
from tactile_toolkit.errors import InputError
from tactile_toolkit.pictures.lettering import ACCENTS, INK, MUTED, PAPER, draw_text
from tactile_toolkit.pictures.plots import Points, plot_points, require_plots
from tactile_toolkit.pictures.render import Studio
from tactile_toolkit.pictures.sheets import Sheet, Tile, sheet, with_scale_bar
from tactile_toolkit.pictures.writing import (
    Drawing,
    PicturePlan,
    PlannedPicture,
    chosen_kinds,
    file_stem,
    plan_kinds,
)
from tactile_toolkit.touch.jpeg import resized
from tactile_toolkit.touch.schema import Kind, column_type
from tactile_toolkit.wording import counted

__all__ = [
    "CONTACT",
    "IN_CONTACT",
    "KINDS",
    "PreviewSpec",
    "draw_drift",
    "draw_grid",
    "draw_overlay",
    "draw_strip",
    "frames_shown",
    "gel_drift",
    "plan_previews",
    "timeline",
]

IN_CONTACT = ACCENTS[3]
"""Colour of the frame around pictures between the first and the last registered contact."""

_STRIP_COLUMNS = 8
_MOST_FRAMES = 24
_STRIP_TILE_PX = 168
_BAR_PX = 34
_GAP_PX = 2
_TRACK = (224, 228, 232)


def frames_shown(count: int, contact: slice, most: int = _MOST_FRAMES) -> tuple[int, ...]:
    """Choose frames of a clip: every frame of contact and one on each side, the others at equal steps.

    Parameters
    ----------
    count : int
        Frames of the clip.
    contact : slice
        Frames of contact.
    most : int
        How many to choose at most.

    Returns
    -------
    tuple of int
        In order. Where contact alone has too many frames, all are chosen at equal steps.
    """
    near = range(max(contact.start - 1, 0), min(contact.stop + 1, count))
    left = [frame for frame in range(count) if frame not in near]
    room = most - len(near)
    if room < 2:
        return tuple(np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist())
    places: list[int] = np.linspace(0, len(left) - 1, min(len(left), room)).round().astype(int).tolist()
    return tuple(sorted({*near, *(left[place] for place in places)}))


def draw_strip(clip: TouchClip, title: str) -> Drawing:
    """Draw a clip as a film strip with a bar of time below it.

    Parameters
    ----------
    clip : TouchClip
        The clip.
    title : str
        Heading.

    Raises
    ------
    IntegrityError
        A frame or a time is damaged.
    """
    contact, times_s = clip.contact_window, clip.timestamps_s
    shown = frames_shown(len(clip), contact)
    height, width = clip.size
    tile_px = (_STRIP_TILE_PX, max(1, round(_STRIP_TILE_PX * height / width)))
    tiles = [
        Tile(
            resized(clip[frame], *tile_px),
            f"{frame}: {times_s[frame]:.2f} s",
            IN_CONTACT if contact.start <= frame < contact.stop else PAPER,
        )
        for frame in shown
    ]
    words = (
        f"{len(shown)} of {counted(len(clip), 'frames')}, with their times; framed: contact, frames "
        f"{contact.start} to {contact.stop - 1}",
    )
    strip = sheet(tiles, Sheet(_STRIP_COLUMNS, title, words))
    bar = timeline(len(clip), contact, shown, strip.shape[1])
    return Drawing(np.concatenate([strip, bar]))


def timeline(count: int, contact: slice, shown: tuple[int, ...], width_px: int) -> NDArray[np.uint8]:
    """Draw a bar with a cell for each frame: contact in colour, a tick at each frame that is shown.

    Returns
    -------
    ndarray of uint8, shape (height, width_px, 3)
    """
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


KINDS = ("grid", "overlay", "strip", "drift")
CONTACT = ACCENTS[0]
"""Colour of the frame around touches in which the gel stopped on an object."""

_COLUMNS = 8
_TILE_PX = 160
_PX_PER_MM = 7.0


@dataclass(frozen=True, slots=True)
class PreviewSpec:
    """What to draw.

    Attributes
    ----------
    kinds : tuple of str
        Some of :data:`KINDS`, or ``"all"``; the grid when empty.
    round_number : int
        Which round of the split, from 0.
    touches : int
        Touches of a grid, evenly spaced over the round.
    touch : int
        Which touch of the round is drawn as a strip, from 0.
    """

    kinds: tuple[str, ...] = ()
    round_number: int = 0
    touches: int = 32
    touch: int = 0


def plan_previews(name: str, split: str, spec: PreviewSpec, *, revision: str | None = None) -> PicturePlan:
    """Decide which pictures of a data set of touches to draw; draws none.

    Parameters
    ----------
    name : str
        Whatever :func:`realtouch.load` opens.
    split : str
        Which split.
    spec : PreviewSpec
        What to draw.
    revision : str, optional
        Branch, tag or commit of a Hub repository.

    Returns
    -------
    PicturePlan

    Raises
    ------
    InputError
        No such place, split, round, touch or kind; an empty set; a strip of a set without clips.
    MissingExtraError
        The plot was asked for by name and matplotlib is not installed.
    IntegrityError, HubError
        As :func:`realtouch.load`.
    """
    dataset = load(name, split, revision=revision)
    if not len(dataset):
        message = f"split {split!r} of {name!r} holds no round; next: choose another split"
        raise InputError(message)
    if not 0 <= spec.round_number < len(dataset):
        message = f"--round is {spec.round_number}; split {split!r} has rounds 0 to {len(dataset) - 1}"
        raise InputError(message)
    kinds, by_name = chosen_kinds(spec.kinds, KINDS, ("grid",))
    stem = f"{file_stem(name)}-{split}"
    return plan_kinds(kinds, by_name, lambda kind: [_PLANS[kind](dataset, stem, spec)])


def draw_grid(record: TouchRound, most: int) -> Drawing:
    """Draw touches of a round with their numbers; those that met an object are framed.

    Parameters
    ----------
    record : TouchRound
        The round.
    most : int
        How many touches, evenly spaced.
    """
    heights_m = _heights_m(record)
    tiles = [_tile(record, touch, heights_m) for touch in _evenly(record.touch_count, most)]
    words = [f"{len(tiles)} of {counted(record.touch_count, 'touches')} of object {record.object_id}"]
    if heights_m is not None:
        mm = MIN_CONTACT_HEIGHT_M * 1e3
        words += [
            f"framed: the gel stopped {mm:g} mm or more above the deepest touch; its height beside the number"
        ]
    return Drawing(sheet(tiles, Sheet(_COLUMNS, _title(record), ("; ".join(words),))))


def draw_overlay(record: TouchRound) -> Drawing:
    """Draw all touches of a round at their positions on a map of the cell."""
    touches = placed_touches(record, range(record.touch_count))
    cell = cell_map(touches, _PX_PER_MM)
    pixels = with_scale_bar(overlay(touches, cell), _PX_PER_MM)
    x_mm, y_mm = (side / _PX_PER_MM for side in cell.size_px)
    words = (
        f"{counted(len(touches), 'touches')} of object {record.object_id} at their positions",
        f"{x_mm:.0f} x {y_mm:.0f} mm around the middle of the cell, x right, y up",
    )
    return Drawing(sheet([Tile(pixels, frame=(205, 210, 215))], Sheet(1, _title(record), words)))


def gel_drift(dataset: TouchDataset[Any]) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """Return the height of the plate in each round, and the gel it was made with; opens no picture.

    Returns
    -------
    z_m : ndarray of float64, shape (len(dataset),)
        Metres, cell frame: that of the deepest touch, or as `realtouch select` stored it before it took
        touches out.
    gels : tuple of str
        ``info.gel_id`` of each round; empty words where the data set does not say.

    Raises
    ------
    InputError
        The data set stores no poses.
    """
    _require_poses(dataset)
    z_m, starts = dataset.contact_z_m()
    rows = dataset.row_numbers
    deepest = np.array([np.fmin.reduce(z_m[starts[row] : starts[row + 1]], initial=np.inf) for row in rows])
    stored = dataset.plates_z_m()[rows]
    return np.where(np.isnan(stored), deepest, stored), _gels(dataset)


def _require_poses(dataset: TouchDataset[Any]) -> None:
    suffix = "" if dataset.kind == "single" else "_seq"
    if column_type(dataset._tables[0].schema, f"gel_pose_cell_frame{suffix}.position") is None:
        message = "the drift of the gel needs its poses, which this data set does not store"
        raise InputError(message)


def draw_drift(dataset: TouchDataset[Any], title: str) -> Drawing:
    """Draw the height of the deepest touch of every round, in the colours of the gels."""
    z_m, gels = gel_drift(dataset)
    z_mm = z_m * 1e3
    rounds = counted(len(z_mm), "rounds")
    spread = f"{rounds}; from {z_mm.min():.2f} to {z_mm.max():.2f} mm, median {np.median(z_mm):.2f} mm"
    points = Points(title, "round", "deepest touch, z in mm", np.arange(len(z_mm)), z_mm, gels)
    return Drawing(plot_points(points, spread))


def _plan_grid(dataset: TouchDataset[Any], stem: str, spec: PreviewSpec) -> PlannedPicture:
    record = dataset[spec.round_number]
    what = f"touches of {record!r}"
    return PlannedPicture(
        f"{stem}-round-{spec.round_number}-grid.png", what, partial(_grid, record, spec.touches)
    )


def _plan_overlay(dataset: TouchDataset[Any], stem: str, spec: PreviewSpec) -> PlannedPicture:
    record = dataset[spec.round_number]
    what = f"all touches of {record!r} at their positions"
    return PlannedPicture(f"{stem}-round-{spec.round_number}-overlay.png", what, partial(_overlay, record))


def _plan_strip(dataset: TouchDataset[Any], stem: str, spec: PreviewSpec) -> PlannedPicture:
    record = dataset[spec.round_number]
    if not isinstance(record, TouchSeqRound):
        message = "a film strip needs clips, and this data set holds images; next: give a seq set"
        raise InputError(message)
    if not 0 <= spec.touch < record.touch_count:
        message = (
            f"--touch is {spec.touch}; round {spec.round_number} has touches 0 to {record.touch_count - 1}"
        )
        raise InputError(message)
    name = f"{stem}-round-{spec.round_number}-touch-{spec.touch}-strip.png"
    what = f"the clip of touch {spec.touch} of {record!r}"
    return PlannedPicture(name, what, partial(_strip, record, spec.touch))


def _plan_drift(dataset: TouchDataset[Any], stem: str, spec: PreviewSpec) -> PlannedPicture:
    _require_poses(dataset)
    require_plots("the picture of the gel's drift")
    what = f"drift of the gel over {counted(len(dataset), 'rounds')}"
    return PlannedPicture(f"{stem}-drift.png", what, partial(_drift, dataset, f"{stem}: drift of the gel"))


_PLANS = {"grid": _plan_grid, "overlay": _plan_overlay, "strip": _plan_strip, "drift": _plan_drift}


def _grid(record: TouchRound, most: int, _: Studio) -> Drawing:
    return draw_grid(record, most)


def _overlay(record: TouchRound, _: Studio) -> Drawing:
    return draw_overlay(record)


def _strip(record: TouchSeqRound, touch: int, _: Studio) -> Drawing:
    return draw_strip(record.sensor_video[touch], f"{_title(record)}, touch {touch}")


def _drift(dataset: TouchDataset[Any], title: str, _: Studio) -> Drawing:
    return draw_drift(dataset, title)


def _tile(record: TouchRound, touch: int, heights_m: NDArray[np.float64] | None) -> Tile:
    picture = Touch(record, touch).image
    tile = resized(picture, _TILE_PX, max(1, round(_TILE_PX * picture.shape[0] / picture.shape[1])))
    if heights_m is None:
        return Tile(tile, f"{touch}")
    met = heights_m[touch] >= MIN_CONTACT_HEIGHT_M
    return Tile(tile, f"{touch}: {heights_m[touch] * 1e3:.1f} mm", CONTACT if met else PAPER)


def _heights_m(record: TouchRound) -> NDArray[np.float64] | None:
    """Return how high above the deepest touch the gel stopped, shape (T,); None without poses."""
    kind: Kind = "seq" if isinstance(record, TouchSeqRound) else "single"
    name = "gel_pose_cell_frame_seq" if kind == "seq" else "gel_pose_cell_frame"
    if not record._row.has(f"{name}.position"):
        return None
    return contact_heights_m(contact_z_m(record._row, kind), plate_z_m=plate_z_m(record._row))


def _gels(dataset: TouchDataset[Any]) -> tuple[str, ...]:
    if column_type(dataset._tables[0].schema, "info.gel_id") is None:
        return ("",) * len(dataset)
    by_row = {row: _gel(record.info["gel_id"]) for row, record in dataset.light_rounds()}
    return tuple(by_row[row] for row in dataset.row_numbers.tolist())


def _gel(number: Any) -> str:
    return "unknown gel" if number is None else f"gel {number}"


def _evenly(count: int, most: int) -> Sequence[int]:
    chosen: list[int] = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist()
    return chosen


def _title(record: TouchRound) -> str:
    return f"Round {record.id}, label {record.label}"
