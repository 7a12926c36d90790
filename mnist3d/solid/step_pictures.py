"""Pictures of the steps from an image to a solid."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

from mnist3d.digit_options import SolidSpec
from mnist3d.ink.binarisation import binarise
from mnist3d.solid import algorithm
from mnist3d.solid.lattice import Lattice
from tactile_toolkit import pictures
from tactile_toolkit.arithmetic import inverse_affine
from tactile_toolkit.array_types import AnyArray, Bool, UInt8
from tactile_toolkit.errors import ItemError
from tactile_toolkit.mesh import MM_PER_M

CLAY = (224, 166, 72)
"""Colour of objects in oblique views."""

_PANEL_PX = 380
_MARGIN_PX = 12
_LIGHTEST = (214, 230, 241)
_DARKEST = (8, 64, 112)
_SAMPLING = 2
# Factor by which the distance of layers is enlarged in the picture of the stack.
_SPREAD = 4.0


def draw_steps(pixels: AnyArray, spec: SolidSpec, title: str) -> UInt8:
    """Draw how an image, shape (H, W), 0 for ink and 255 for paper, becomes the solid that a data set stores.

    Raises ItemError, with the title of the picture, where the image is not a usable digit.
    """
    try:
        ink = binarise(pixels, spec, ink="dark")
        steps = algorithm.solid_steps(ink, spec)
    except ItemError as error:
        raise ItemError(error.reason, f"{title}: {error}") from error
    window = _window(ink)
    lattice = steps.lattice
    solid = steps.mesh
    layers = _layers_px(lattice, steps.upper_half > 0, window)
    upper = algorithm.scale(steps.surface, ink.shape, spec)
    px_per_mm = _PANEL_PX / (max(layers[0].shape) * spec.pixel_pitch_mm)
    bodies = [pictures.DrawnBody(mesh, CLAY) for mesh in (upper, solid)]
    size_px = (_PANEL_PX, _PANEL_PX)
    views = [pictures.View.OBLIQUE.draw([body], size_px, px_per_mm * MM_PER_M) for body in bodies]
    pitch_px = lattice.pitch_px
    triangles = len(solid.faces)
    decimated = ", decimated" if triangles != 2 * len(upper.faces) else ""
    tiles = (
        pictures.Tile(_square(np.asarray(pixels)[window].astype(np.uint8)), "1  image"),
        pictures.Tile(
            _square(np.where(ink[window], 0, 255).astype(np.uint8)), "2  ink, binarised and cleaned"
        ),
        pictures.Tile(_square(layer_map(layers)), f"3  eroded: {len(layers)} layers of a lattice"),
        pictures.Tile(
            _stack_view(layers, pitch_px, spec, px_per_mm), "4  stack of the upper half, drawn apart"
        ),
        pictures.Tile(views[0], f"5  marching cubes, upper half: {len(upper.faces):,} triangles"),
        pictures.Tile(
            views[1], f"6  smoothed, mirrored, scaled{decimated}: {triangles:,} triangles"
        ).with_scale_bar(px_per_mm),
    )
    words = (
        f"the nodes of the lattice are {pitch_px:.2f} px of {spec.pixel_pitch_mm:g} mm apart, closer where "
        "something is narrow; the surface passes between them",
    )
    return pictures.sheet(tiles, 3, title, words)


def _layers_px(lattice: Lattice, inside: Bool, window: tuple[slice, slice]) -> list[Bool]:
    """Return the layers that are not empty; each pixel of a window shows its nearest node."""
    nodes_px = (lattice.rows_px, lattice.columns_px)
    rows, columns = (
        np.abs(np.arange(span.start, span.stop)[:, None] - corner - nodes).argmin(axis=1)
        for span, corner, nodes in zip(window, lattice.corner_px, nodes_px, strict=True)
    )
    layers = np.moveaxis(inside[np.ix_(rows, columns)], 2, 0)
    return [layer for layer in layers if layer.any()]


def layer_map(layers: Sequence[Bool]) -> UInt8:
    """Draw layers on top of one another, higher ones darker: shape (H, W, 3)."""
    picture = np.full((*layers[0].shape, 3), 255, np.uint8)
    for number, layer in enumerate(layers):
        picture[layer] = _tint(number / max(1, len(layers) - 1))
    return picture


def _window(mask: Bool) -> tuple[slice, slice]:
    """Return the square around the ink, with a margin, cut at the edges of the image."""
    rows = np.flatnonzero(mask.any(axis=1))
    columns = np.flatnonzero(mask.any(axis=0))
    half = (max(np.ptp(rows), np.ptp(columns)) + 1) // 2 + _MARGIN_PX
    spans = []
    for inked, side in ((rows, mask.shape[0]), (columns, mask.shape[1])):
        middle = (int(inked[0]) + int(inked[-1]) + 1) // 2
        spans.append(slice(max(0, middle - half), min(side, middle + half)))
    return spans[0], spans[1]


def _stack_view(layers: Sequence[Bool], pitch_px: float, spec: SolidSpec, px_per_mm: float) -> UInt8:
    """Draw the stack in an oblique view, its layers apart."""
    side = _PANEL_PX * _SAMPLING
    picture = Image.new("RGB", (side, side), (255, 255, 255))
    px = px_per_mm * spec.pixel_pitch_mm * _SAMPLING
    for number, layer in enumerate(layers):
        z = (number - (len(layers) - 1) / 2) * pitch_px
        share = number / max(1, len(layers) - 1)
        mask = Image.fromarray(layer.astype(np.uint8) * 255)
        for drop_px, colour in ((_SAMPLING, (70, 80, 92)), (0, _tint(share))):
            data = _back_to_layer(layer.shape, side, px, _SPREAD * z, drop_px)
            seen = mask.transform((side, side), Image.Transform.AFFINE, data, Image.Resampling.BILINEAR)
            picture.paste(colour, mask=seen)
    return np.asarray(picture.reduce(_SAMPLING))


def _back_to_layer(
    shape: tuple[int, ...], side_px: int, px: float, height: float, drop_px: int
) -> tuple[float, ...]:
    """Return the affine map from pixels of the view to those of a layer, for Pillow."""
    right, up, _ = pictures.View.OBLIQUE.axes
    # Rows of a layer grow along -y, those of the picture along -up.
    to_view = px * np.array([[right[0], -right[1]], [-up[0], up[1]]])
    middle = np.array([side_px / 2, side_px / 2 - px * up[2] * height + drop_px])
    return inverse_affine(to_view, middle, np.array([shape[1] / 2, shape[0] / 2]))


def _tint(share: float) -> tuple[int, int, int]:
    """Return the colour of a height: 0 at the mid-plane, 1 at the top."""
    red, green, blue = (
        round(low + share * (high - low)) for low, high in zip(_LIGHTEST, _DARKEST, strict=True)
    )
    return red, green, blue


def _square(pixels: UInt8) -> UInt8:
    """Return a picture fitted into a square panel, on white."""
    picture = Image.fromarray(pixels).convert("RGB")
    factor = _PANEL_PX / max(picture.size)
    size = (max(1, round(picture.width * factor)), max(1, round(picture.height * factor)))
    fitted = picture.resize(size, Image.Resampling.LANCZOS if factor < 1 else Image.Resampling.BICUBIC)
    canvas = Image.new("RGB", (_PANEL_PX, _PANEL_PX), (255, 255, 255))
    canvas.paste(fitted, ((_PANEL_PX - size[0]) // 2, (_PANEL_PX - size[1]) // 2))
    return np.asarray(canvas)
