"""The ink of any picture, drawn on a sheet of the size that the solid is to have."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, TypeAlias

import numpy as np
from PIL import Image
from scipy import ndimage

from mnist3d import compiled_loops
from mnist3d.digit_options import LARGEST_HALF_THICKNESS_PX, SolidSize, SolidSpec
from mnist3d.ink import binarisation, grey_levels, pages, photographs
from mnist3d.ink.grey_levels import MAX_DRAWN
from mnist3d.solid import lattice
from mnist3d.sources import picture_files
from tactile_toolkit import store
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.value_types import AnyArray, Bool, Int32, JsonObject, UInt8
from tactile_toolkit.wording import with_count

PictureLike: TypeAlias = "str | os.PathLike[str] | Image.Image | AnyArray"
"""A file, an image of Pillow, or an array of shape (H, W), (H, W, 3) or (H, W, 4)."""

THRESHOLDS = ("auto", "local", "global")
"""Whether the light of a picture is evened out; ``"auto"`` decides for each."""

LARGEST_SHEET_PX = 1000
"""Longer side of the sheet on which large pictures are drawn again."""

LARGEST_LATTICE_MM = 1.0
"""Largest distance of the nodes of the lattice of a drawing; digits of a data set have about as much."""

_FINEST_SHEET_PX = 4000
# Specks of drawings: at least what a nozzle of 0.4 mm prints in two lines, at most those of digits. The dot
# of an i, as large as the stroke is wide, stays.
_MIN_SPECK_MM2, _SPECK_PER_STROKE = 0.64, 0.5
# Paper around the ink of a drawing that is cut out, as a share of its longer side.
_AROUND = 0.05
# Nodes of the lattice across a stroke, so that it is smooth.
_NODES_PER_STROKE = 4.0
# Vertices of the surface of a drawing before those in even parts are removed, which are most of them.
_MAX_VERTICES = 80_000

NO_CHANGES: JsonObject = MappingProxyType({})
"""The parameters of a specification as they are."""


class SizedInk(NamedTuple):
    """Clean ink on a sheet, the specification for pixels of the sheet, and notes on changes."""

    mask: Bool
    spec: SolidSpec
    notes: tuple[str, ...]
    is_drawing: bool = False
    """Whether the solid is made to be printed, on a flat underside, rather than as a digit of a data set."""
    size: SolidSize = SolidSize()
    """The size that the solid is to have; its pixels have it within some tenths of a millimetre."""


def sized_ink(
    picture: PictureLike,
    spec: SolidSpec | None,
    size: SolidSize,
    *,
    changes: JsonObject = NO_CHANGES,
    which: str = "auto",
    threshold: str = "auto",
    page: int = 0,
) -> SizedInk:
    """Return the ink of a picture on the sheet that becomes the solid; see :func:`mnist3d.solidify`.

    Without a ``spec``, arrays of grey levels get the published one, and other pictures keep smaller specks
    and get as many vertices as their strokes need. ``changes`` replaces parameters of the specification.
    """
    for name, value, known in (("ink", which, binarisation.INKS), ("threshold", threshold, THRESHOLDS)):
        if value not in known:
            raise InputError(f"is {value!r}; expected one of {', '.join(known)}", field=name)
    asked = replace(spec or SolidSpec(), **changes)
    notes = list[str]()
    levels, level = _levels(picture, asked, which, threshold, page, notes)
    sheet, pitch_mm = _on_sheet(levels, level, asked, size)
    if sheet is not levels:
        level = None  # the threshold of the picture does not fit resampled levels
    quantum_mm = min(asked.vertex_quantum_mm, pitch_mm / 10)
    fitted = replace(asked, pixel_pitch_mm=pitch_mm, vertex_quantum_mm=quantum_mm)
    binarisation.require_large(sheet, fitted)
    is_grey = isinstance(picture, np.ndarray) and picture.ndim == 2
    if spec is not None or is_grey:
        return SizedInk(
            binarisation.cleaned_ink(sheet, fitted, level, MAX_DRAWN), fitted, tuple(notes), size=size
        )
    before = binarisation.ink_of_levels(sheet, fitted.threshold, MAX_DRAWN)
    fitted = for_strokes(before, fitted)
    mask = binarisation.cleaned_ink(sheet, fitted, most_ink=MAX_DRAWN)
    if "target_vertices" not in changes:
        fitted = replace(fitted, lattice_pitch_mm=_lattice_pitch_mm(mask, fitted))
    drawn = binarisation.ink_of_levels(levels, fitted.threshold, MAX_DRAWN)
    count = int(_labels(drawn).max()) - len(np.unique(_labels(before)[mask & before]))
    if pages.is_ruled(drawn):
        notes.append("lines run across the picture, as on ruled paper; --threshold local leaves them out")
    if count > 0:
        notes.append(f"left out {with_count(count, 'specks')} of ink below {fitted.min_speck_mm2:.2g} mm²")
    return SizedInk(mask, fitted, tuple(notes), True, size)


def _levels(
    picture: PictureLike, spec: SolidSpec, which: str, threshold: str, page: int, notes: list[str]
) -> tuple[UInt8, float | None]:
    """Return levels with dark ink, and their threshold if it is known; add notes on what was left out."""
    if isinstance(picture, (str, os.PathLike)):
        return _levels_of_file(store.expanded(os.fspath(picture)), which, threshold, page, notes), None
    image = picture if isinstance(picture, Image.Image) else _image_of(np.asarray(picture))
    if image is not None:
        upright = picture_files.upright_levels(image)
        levels = picture_files.picture_levels(
            upright, which, threshold, "the picture", whole=True, notes=notes
        )
        return levels, None
    array = np.asarray(picture)
    if threshold == "local":
        return photographs.even_out(grey_levels.as_levels(array), which, whole=True, notes=notes), None
    if threshold == "global" and which == "auto":
        return grey_levels.dark_on_light(array, which)
    return binarisation.ink_levels(array, spec.threshold, which, whole=True)


def _levels_of_file(path: Path, which: str, threshold: str, page: int, notes: list[str]) -> UInt8:
    numbers = picture_files.pages_of(path)
    if page not in numbers:
        raise InputError(
            f"{path} has no page {page}; it has {with_count(len(numbers), 'pages')}, counted from 0",
            next="give the number of one of them",
        )
    levels = picture_files.read_picture(path, which, threshold, page, whole=True, notes=notes)
    width, height = picture_files.size_of_page(path, page)
    if max(width, height) > max(levels.shape):
        now = f"{levels.shape[1]:,} x {levels.shape[0]:,}"
        notes.append(f"the picture of {width:,} x {height:,} pixels was reduced to {now}")
    return levels


def _image_of(array: AnyArray) -> Image.Image | None:
    """Return an array of colours, RGB or RGBA, as an image; None for an array of grey levels."""
    if array.ndim != 3:
        return None
    if array.shape[2] not in (3, 4) or array.dtype.kind not in "buif":
        raise ItemError(
            "bad-shape",
            f"the picture has shape {array.shape} of {array.dtype}; expected (H, W), (H, W, 3) or (H, W, 4) "
            "of numbers",
            next="give grey levels, RGB or RGBA",
        )
    flat = grey_levels.as_levels(np.ascontiguousarray(array.reshape(len(array), -1)))
    return Image.fromarray(flat.reshape(array.shape))


def _on_sheet(levels: UInt8, level: float | None, spec: SolidSpec, size: SolidSize) -> tuple[UInt8, float]:
    """Draw a picture again on a sheet; return it, and the side of its pixels in mm."""
    longest = max(levels.shape)
    if size.pixel_mm is not None:
        return _fitted(levels, longest * size.pixel_mm, spec, smallest=longest)
    if size.height_mm is None and size.width_mm is None:
        return _fitted(levels, grey_levels.SIDE_PX * spec.pixel_pitch_mm, spec)
    # The size is that of the ink, without paper.
    threshold = level if spec.threshold is None else spec.threshold
    mask = _without_specks(binarisation.ink_of_levels(levels, threshold, MAX_DRAWN))
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    around = 1 + math.ceil(_AROUND * max(np.ptp(rows), np.ptp(columns)))
    spans = [slice(max(0, line[0] - around), line[-1] + 1 + around) for line in (rows, columns)]
    cut = levels[spans[0], spans[1]]
    if size.height_mm is not None:
        scale_mm = size.height_mm / (np.ptp(rows) + 1)
    else:
        scale_mm = float(size.width_mm or 0) / (np.ptp(columns) + 1)
    return _fitted(cut, max(cut.shape) * scale_mm, spec)


def _fitted(
    levels: UInt8, long_mm: float, spec: SolidSpec, smallest: int = grey_levels.SIDE_PX
) -> tuple[UInt8, float]:
    """Fit levels into a sheet whose side is ``long_mm``, with as many pixels as picture and solid need."""
    half_mm = spec.half_thickness_mm
    side = min(max(max(levels.shape), smallest), LARGEST_SHEET_PX)
    # Half the thickness is 1 to 100 pixels.
    finest = int(long_mm / half_mm * LARGEST_HALF_THICKNESS_PX)
    coarsest = math.ceil(long_mm / half_mm)
    side = max(min(side, finest), coarsest)
    if side > _FINEST_SHEET_PX:
        raise InputError(
            f"the solid would be {long_mm:,.0f} mm long and {2 * half_mm:g} mm thick; expected a length of "
            f"at most {_FINEST_SHEET_PX * half_mm:,.0f} mm at this thickness",
            next="make it smaller (height_mm, width_mm, pixel_mm) or thicker",
        )
    if side == max(levels.shape):
        return levels, long_mm / side
    return grey_levels.fit(levels, side), long_mm / side


def _without_specks(mask: Bool) -> Bool:
    """Leave out pieces that are much smaller than the largest, which would change the size of a drawing."""
    labels = _labels(mask)
    areas = np.bincount(labels.ravel())
    areas[0] = 0
    return np.asarray((areas >= _AROUND**2 * areas.max())[labels])


def for_strokes(mask: Bool, spec: SolidSpec) -> SolidSpec:
    """Keep specks and pinholes that belong to thin strokes."""
    stroke_mm = spec.pixel_pitch_mm * binarisation.thinnest_stroke_px(_without_specks(mask))
    speck_mm2 = min(max((_SPECK_PER_STROKE * stroke_mm) ** 2, _MIN_SPECK_MM2), spec.min_speck_mm2)
    share = speck_mm2 / max(spec.min_speck_mm2, _MIN_SPECK_MM2)
    return replace(spec, min_speck_mm2=speck_mm2, min_pinhole_mm2=share * spec.min_pinhole_mm2)


def _lattice_pitch_mm(mask: Bool, spec: SolidSpec) -> float:
    """Return the distance of the nodes of a lattice that fits into memory and on which strokes are smooth."""
    distance = compiled_loops.signed_distance_px(mask, math.ceil(spec.half_thickness_px), 1.0)
    least_px = lattice.pitch_of_budget_px(distance, spec, _MAX_VERTICES)
    pitch_px = max(binarisation.thinnest_stroke_px(mask) / _NODES_PER_STROKE, least_px)
    return float(min(LARGEST_LATTICE_MM, spec.pixel_pitch_mm * pitch_px))


def _labels(mask: Bool) -> Int32:
    return np.asarray(ndimage.label(mask, np.ones((3, 3)))[0])
