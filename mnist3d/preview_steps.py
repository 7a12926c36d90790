"""The steps from an image to the stored mesh, side by side: ink, eroded layers, stack, surface, solid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mnist3d.lattice import Lattice, Mirrored
from mnist3d.solid import binarise, solidify
from mnist3d.surface import Surface, scale
from tactile_toolkit.arithmetic import inverse_affine
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh.mesh import MM_PER_M
from tactile_toolkit.pictures.render import OBLIQUE, Body, Picture3d, box_downsample, draw_bodies
from tactile_toolkit.pictures.sheets import Sheet, Tile, sheet, with_scale_bar
from tactile_toolkit.pictures.writing import Pixels

if TYPE_CHECKING:
    from mnist3d.sources import DigitSource
    from mnist3d.spec import SolidSpec


CLAY = (224, 166, 72)
"""Colour of objects in oblique views."""

_PANEL_PX = 380
_MARGIN_PX = 12
_LIGHTEST, _DARKEST = (214, 230, 241), (8, 64, 112)
_SAMPLING = 2
_SPREAD = 4.0
"""How many times their distance the layers of the stack are drawn apart."""

# Who wrote a digit shows in no picture, and the column of writers is not asked for here: that part of the
# fingerprint may differ.
_WRITERS = "writers_sha256"


def draw_steps(pixels: NDArray[Any], spec: SolidSpec, title: str) -> Pixels:
    """Draw how an image, (H, W), 0 ink and 255 paper, becomes the solid that a data set stores.

    ItemError, which names the picture by its title, where the image is not a usable digit.
    """
    steps: list[tuple[Lattice, Mirrored, Surface]] = []
    try:
        ink = binarise(pixels, spec, ink="dark")
        solid = solidify(pixels, spec, ink="dark", on_surface=lambda *found: steps.append(found))
    except ItemError as error:
        raise ItemError(error.reason, f"{title}: {error}") from error
    window = _window(ink)
    ((lattice, volume, surface),) = steps
    layers = _layers_px(lattice, volume.upper > 0, window)
    # Without its rim it is not known as a half, and stays one.
    upper = scale(replace(surface, rim=surface.rim[:0]), (ink.shape[0], ink.shape[1]), spec)
    px_per_mm = _PANEL_PX / (max(layers[0].shape) * spec.pixel_pitch_mm)
    views = [
        draw_bodies(Picture3d((Body(mesh, CLAY),), (_PANEL_PX, _PANEL_PX), px_per_mm * MM_PER_M))
        for mesh in (upper, solid)
    ]
    pitch_px, triangles = lattice.pitch_px, len(solid.faces)
    decimated = ", decimated" if triangles != 2 * len(upper.faces) else ""
    tiles = (
        Tile(_square(np.asarray(pixels)[window].astype(np.uint8)), "1  image"),
        Tile(_square(np.where(ink[window], 0, 255).astype(np.uint8)), "2  ink, binarised and cleaned"),
        Tile(_square(layer_map(layers)), f"3  eroded: {len(layers)} layers of a lattice"),
        Tile(_stack_view(layers, pitch_px, spec, px_per_mm), "4  stack of the upper half, drawn apart"),
        Tile(views[0], f"5  marching cubes, upper half: {len(upper.faces):,} triangles"),
        Tile(
            with_scale_bar(views[1], px_per_mm),
            f"6  smoothed, mirrored, scaled{decimated}: {triangles:,} triangles",
        ),
    )
    words = (
        f"the nodes of the lattice are {pitch_px:.2f} px of {spec.pixel_pitch_mm:g} mm apart, closer where "
        "something is narrow; the surface passes between them",
    )
    return sheet(tiles, Sheet(3, title, words))


def _layers_px(
    lattice: Lattice, inside: NDArray[np.bool_], window: tuple[slice, slice]
) -> list[NDArray[np.bool_]]:
    """Return the layers that are not empty, each pixel of a window as the node that is nearest to it."""
    nodes_px = (lattice.rows_px, lattice.columns_px)
    rows, columns = (
        np.abs(np.arange(span.start, span.stop)[:, None] - corner - nodes).argmin(axis=1)
        for span, corner, nodes in zip(window, lattice.corner_px, nodes_px, strict=True)
    )
    layers = np.moveaxis(inside[np.ix_(rows, columns)], 2, 0)
    return [layer for layer in layers if layer.any()]


def layer_map(layers: Sequence[NDArray[np.bool_]]) -> NDArray[np.uint8]:
    """Draw layers one on top of the other, the higher the darker: shape (H, W, 3)."""
    picture = np.full((*layers[0].shape, 3), 255, np.uint8)
    for number, layer in enumerate(layers):
        picture[layer] = _tint(number / max(1, len(layers) - 1))
    return picture


def source_option(described: dict[str, Any], images: Path | None, writer_info: Path | None) -> DigitSource:
    """Return the source from which a data set was made, by its fingerprint in the manifest.

    ``images`` and ``writer_info`` say where its files are now; the synthetic source needs none. InputError
    where they are needed and not given, or are others than those the data set was made from.
    """
    source = _rebuilt_source(described, images, writer_info)
    found = {key: value for key, value in source.fingerprint().items() if key != _WRITERS}
    wanted = {key: value for key, value in described.items() if key != _WRITERS}
    if found != wanted:
        differs = next(key for key in {**wanted, **found} if found.get(key) != wanted.get(key))
        raise InputError(
            f"--images {str(images)!r} holds other images than the data set was made from: {differs} is "
            f"{found.get(differs)!r}, expected {wanted.get(differs)!r}"
        )
    return source


def _rebuilt_source(described: dict[str, Any], images: Path | None, writer_info: Path | None) -> DigitSource:
    name = str(described.get("name"))
    if name == "synthetic":
        from mnist3d.sources.synthetic import SyntheticSource

        return SyntheticSource(int(described["seed"]), int(described["count"]))
    if images is None or (name == "hwdplus" and writer_info is None):
        option = "--images PATH" if images is None else "--writer-info FILE"
        raise InputError(
            f"the steps need the images of source {name!r}", next=f"give {option}, or a picture of a digit"
        )
    if name == "hwdplus":
        from mnist3d.sources.hwdplus import HwdPlusSource

        return HwdPlusSource(str(images), str(writer_info))
    if name == "mnist":
        from mnist3d.sources.mnist import MnistSource

        source, parts = MnistSource(str(images)), list(described.get("parts") or [])
        # The folder may hold both parts where the set was made from one; then the training digits come first.
        found: Any = source.fingerprint()["parts"]
        if len(found) > len(parts) == 1 and parts[0] in found:
            return MnistSource(str(images), ("train", "test")[found.index(parts[0])])
        return source
    if name == "folder":
        from mnist3d.sources.folder import FolderSource

        return FolderSource(str(images), ink=str(described.get("ink", "auto")))
    raise InputError(
        f"the data set was made from source {name!r}, which is not known", next="give a picture of a digit"
    )


def _window(mask: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the square around the ink, with a margin; cut at the edges of the image."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    half = (max(np.ptp(rows), np.ptp(columns)) + 1) // 2 + _MARGIN_PX
    spans = []
    for inked, side in ((rows, mask.shape[0]), (columns, mask.shape[1])):
        middle = (int(inked[0]) + int(inked[-1]) + 1) // 2
        spans.append(slice(max(0, middle - half), min(side, middle + half)))
    return spans[0], spans[1]


def _stack_view(
    layers: Sequence[NDArray[np.bool_]], pitch_px: float, spec: SolidSpec, px_per_mm: float
) -> NDArray[np.uint8]:
    """Draw the stack obliquely, its layers apart."""
    from PIL import Image

    side = _PANEL_PX * _SAMPLING
    picture = Image.new("RGB", (side, side), (255, 255, 255))
    px = px_per_mm * spec.pixel_pitch_mm * _SAMPLING
    for number, layer in enumerate(layers):
        z, share = (number - (len(layers) - 1) / 2) * pitch_px, number / max(1, len(layers) - 1)
        mask = Image.fromarray(layer.astype(np.uint8) * 255)
        for drop_px, colour in ((_SAMPLING, (70, 80, 92)), (0, _tint(share))):
            data = _back_to_layer(layer.shape, side, px, _SPREAD * z, drop_px)
            seen = mask.transform((side, side), Image.Transform.AFFINE, data, Image.Resampling.BILINEAR)
            picture.paste(colour, mask=seen)
    return box_downsample(np.asarray(picture), _SAMPLING)


def _back_to_layer(
    shape: tuple[int, ...], side_px: int, px: float, height: float, drop_px: int
) -> tuple[float, ...]:
    """Return the map from pixels of the view to those of a layer, as Pillow takes it."""
    right, up, _ = OBLIQUE.axes
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


def _square(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture in the size of a panel, its pixels kept square, on paper."""
    from PIL import Image

    picture = Image.fromarray(pixels).convert("RGB")
    factor = _PANEL_PX / max(picture.size)
    size = (max(1, round(picture.width * factor)), max(1, round(picture.height * factor)))
    fitted = picture.resize(size, Image.Resampling.LANCZOS if factor < 1 else Image.Resampling.BICUBIC)
    canvas = Image.new("RGB", (_PANEL_PX, _PANEL_PX), (255, 255, 255))
    canvas.paste(fitted, ((_PANEL_PX - size[0]) // 2, (_PANEL_PX - size[1]) // 2))
    return np.asarray(canvas)
