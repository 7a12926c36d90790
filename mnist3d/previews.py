"""Pictures of digits: contact sheets, and the steps from an image to a solid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from os import fspath
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mnist3d.kind import KIND
from mnist3d.lattice import Lattice, Mirrored
from mnist3d.loader import MeshDataset, MeshRecord
from mnist3d.make import source_again
from mnist3d.solid import binarise, solidify
from mnist3d.spec import DigitPreviewSpec, SolidSpec
from mnist3d.surface import Surface, scale
from tactile_toolkit import catalog, pictures, store
from tactile_toolkit.arithmetic import inverse_affine
from tactile_toolkit.array_types import AnyArray, Bool, UInt8
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh import FORMATS, MM_PER_M, Mesh, check_manifold, read_mesh, refuse_unit
from tactile_toolkit.places import Name, Place
from tactile_toolkit.wording import class_name, counted

if TYPE_CHECKING:
    from collections.abc import Callable


CLAY = (224, 166, 72)
"""Colour of objects in oblique views."""

_PANEL_PX = 380
_MARGIN_PX = 12
_LIGHTEST, _DARKEST = (214, 230, 241), (8, 64, 112)
_SAMPLING = 2
# How many times their distance the layers of the stack are drawn apart.
_SPREAD = 4.0
_TILE_PX = 132
_VIEW_PX = 520


def plan_previews(name: Name | Place, spec: catalog.PreviewSpec) -> pictures.PicturePlan:
    """Decide which pictures of a data set, a mesh file or an image of a digit to draw; draws none.

    Kinds are sheet and steps. InputError as
    :class:`~tactile_toolkit.pictures.previews.MeshPreviews`, and where a file cannot be read; IntegrityError
    where the data set is damaged or unfinished.
    """
    unit = spec.unit if isinstance(spec, DigitPreviewSpec) else None
    if isinstance(name, Place) or not is_picture_or_mesh(fspath(name)):
        refuse_unit(unit, name.name if isinstance(name, Place) else fspath(name))
        return _plan_set(name, spec)
    name = fspath(name)
    path = store.expanded(name)
    ending = path.suffix.lower()
    unit = spec.unit if isinstance(spec, DigitPreviewSpec) else None
    if ending in FORMATS:
        mesh = read_mesh(path, unit=unit)
        return _plan_file("sheet", name, spec, partial(draw_mesh, mesh=mesh, title=path.name))
    refuse_unit(unit, name)
    return _plan_file("steps", name, spec, *_draw_pages(path))


def is_picture_or_mesh(name: str) -> bool:
    """Return whether a name is that of a single picture or mesh on this machine, and of no data set."""
    from mnist3d.sources.pictures import ENDINGS

    if store.is_remote(name):
        return False
    path = store.expanded(name)
    return path.suffix.lower() in (*FORMATS, *ENDINGS) and path.is_file()


def _draw_pages(path: Path) -> list[Callable[[], UInt8]]:
    """Read the pages of a picture; each is a digit."""
    from mnist3d.sources.canvas import fit
    from mnist3d.sources.pictures import pages_of, read_picture

    pages = pages_of(path)
    titles = [f"{path.name}, page {number}" for number in range(1, len(pages) + 1)]
    # As the sources do: the numbers of the default specification are for sheets of 500 px.
    return [
        partial(draw_steps, pixels=fit(read_picture(path, page=page)), spec=SolidSpec(), title=title)
        for page, title in zip(pages, titles if len(pages) > 1 else [path.name], strict=True)
    ]


def _plan_file(
    kind: str, name: str, spec: catalog.PreviewSpec, *draws: Callable[[], UInt8]
) -> pictures.PicturePlan:
    """Plan the pictures that a single file allows; InputError where anything else was asked for."""
    asked = [f"--kind {each}" for each in spec.kinds if each not in (kind, "all")]
    given = {
        "--split": spec.split,
        "--ids": spec.ids,
        "--labels": spec.labels,
        "--limit": spec.limit,
    }
    asked += [option for option, value in given.items() if value]
    if asked:
        raise InputError(f"{asked[0]} needs a data set, and {name!r} is a single file", next="leave it out")
    stems = [f"{pictures.file_stem(name)}-{number}" for number in range(1, len(draws) + 1)]
    planned = zip(stems if len(draws) > 1 else [pictures.file_stem(name)], draws, strict=True)
    return pictures.PicturePlan(
        tuple(pictures.PlannedPicture(f"{stem}-{kind}.png", Path(name).name, draw) for stem, draw in planned)
    )


def _plan_set(name: Name | Place, spec: catalog.PreviewSpec) -> pictures.PicturePlan:
    opened: pictures.MeshPreviews[MeshDataset] = pictures.MeshPreviews(KIND, name, spec)
    refuse_unit(spec.unit if isinstance(spec, DigitPreviewSpec) else None, opened.name)
    names = opened.chosen[0][1].label_names

    def sheet_of(rows: MeshDataset, title: str) -> UInt8:
        return draw_sheet(list(rows), spec.per_class, title, names)

    def plan_steps() -> list[pictures.PlannedPicture]:
        if "source" not in opened.made_by:
            raise InputError(f"{opened.name!r} does not name the source of its images")
        given = spec if isinstance(spec, DigitPreviewSpec) else DigitPreviewSpec()
        files = {"images": given.images, "writer_info": given.writer_info}
        with catalog.specification_read(opened.name):
            places = {option: None if path is None else str(path) for option, path in files.items()}
            source = source_again(opened.made_by["source"], **places)
            solid = SolidSpec.from_dict(opened.made_by["solid"])

        def draw(number: int, title: str) -> UInt8:
            return draw_steps(source.image(number).pixels, solid, title)

        # Digits whose ids were asked for, or else the first.
        found = [(split, rows[row]) for split, rows, places in opened.chosen for row in places.tolist()]
        planned = []
        for split, record in found if spec.ids else found[:1]:
            title = f"Digit {class_name(names, record.label)}, id {record.id} ({opened.stem}, {split})"
            planned.append(
                pictures.PlannedPicture(
                    f"{opened.stem}-{split}-{record.id}-steps.png",
                    f"digit {record.id}, step by step",
                    partial(draw, record.id, title),
                )
            )
        return planned

    return pictures.plan_kinds(
        spec.kinds, {"sheet": lambda: opened.plan_sheets(sheet_of), "steps": plan_steps}
    )


def draw_sheet(records: Sequence[MeshRecord], per_row: int, title: str, names: Sequence[str]) -> UInt8:
    """Draw digits from above at one scale; ``names`` are those of the classes."""
    meshes = [Mesh(record.vertices_m, record.faces) for record in records]
    px_per_mm = _TILE_PX / (MM_PER_M * max(float(np.ptp(mesh.vertices_m[:, :2], 0).max()) for mesh in meshes))
    tiles = [
        (class_name(names, record.label), pictures.Tile(pictures.relief_of(mesh, px_per_mm), f"{record.id}"))
        for mesh, record in zip(meshes, records, strict=True)
    ]
    words = f"{counted(len(records), 'digits')} from above, at one scale; the id of each below it"
    return pictures.draw_by_class(tiles, per_row, title, words, px_per_mm)


def draw_mesh(mesh: Mesh, title: str) -> UInt8:
    """Draw a mesh from above, with a scale bar and its measures."""
    px_per_mm = _VIEW_PX / max(MM_PER_M * float(np.ptp(mesh.vertices_m[:, :2], axis=0).max()), 1e-6)
    drawn = pictures.sheet(
        [pictures.Tile(pictures.relief_of(mesh, px_per_mm))], 1, title, object_facts(mesh), bar_room=True
    )
    return pictures.with_scale_bar(drawn, px_per_mm)


def object_facts(mesh: Mesh) -> tuple[str, ...]:
    """Return the measures of a mesh in words, and what keeps it from being a solid."""
    x_mm, y_mm, z_mm = (np.ptp(mesh.vertices_m, axis=0) * MM_PER_M).tolist()
    size = f"{x_mm:.1f} x {y_mm:.1f} x {z_mm:.1f} mm"
    parts = f"{len(mesh.vertices_m):,} vertices, {len(mesh.faces):,} triangles"
    found = check_manifold(mesh)
    if found.problem is not None:
        return f"{size}; {parts}", f"not a solid: {found.detail}"
    bodies = "one body" if found.bodies == 1 else f"{found.bodies} bodies"
    return (f"{size}; volume {found.volume_mm3:,.0f} mm³; {parts}; {bodies}",)


def draw_steps(pixels: AnyArray, spec: SolidSpec, title: str) -> UInt8:
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
        pictures.draw_bodies((pictures.Body(mesh, CLAY),), (_PANEL_PX, _PANEL_PX), px_per_mm * MM_PER_M)
        for mesh in (upper, solid)
    ]
    pitch_px, triangles = lattice.pitch_px, len(solid.faces)
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
            pictures.with_scale_bar(views[1], px_per_mm),
            f"6  smoothed, mirrored, scaled{decimated}: {triangles:,} triangles",
        ),
    )
    words = (
        f"the nodes of the lattice are {pitch_px:.2f} px of {spec.pixel_pitch_mm:g} mm apart, closer where "
        "something is narrow; the surface passes between them",
    )
    return pictures.sheet(tiles, 3, title, words)


def _layers_px(lattice: Lattice, inside: Bool, window: tuple[slice, slice]) -> list[Bool]:
    """Return the layers that are not empty, each pixel of a window as the node that is nearest to it."""
    nodes_px = (lattice.rows_px, lattice.columns_px)
    rows, columns = (
        np.abs(np.arange(span.start, span.stop)[:, None] - corner - nodes).argmin(axis=1)
        for span, corner, nodes in zip(window, lattice.corner_px, nodes_px, strict=True)
    )
    layers = np.moveaxis(inside[np.ix_(rows, columns)], 2, 0)
    return [layer for layer in layers if layer.any()]


def layer_map(layers: Sequence[Bool]) -> UInt8:
    """Draw layers one on top of the other, the higher the darker: shape (H, W, 3)."""
    picture = np.full((*layers[0].shape, 3), 255, np.uint8)
    for number, layer in enumerate(layers):
        picture[layer] = _tint(number / max(1, len(layers) - 1))
    return picture


def _window(mask: Bool) -> tuple[slice, slice]:
    """Return the square around the ink, with a margin; cut at the edges of the image."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    half = (max(np.ptp(rows), np.ptp(columns)) + 1) // 2 + _MARGIN_PX
    spans = []
    for inked, side in ((rows, mask.shape[0]), (columns, mask.shape[1])):
        middle = (int(inked[0]) + int(inked[-1]) + 1) // 2
        spans.append(slice(max(0, middle - half), min(side, middle + half)))
    return spans[0], spans[1]


def _stack_view(layers: Sequence[Bool], pitch_px: float, spec: SolidSpec, px_per_mm: float) -> UInt8:
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
    return pictures.box_downsample(np.asarray(picture), _SAMPLING)


def _back_to_layer(
    shape: tuple[int, ...], side_px: int, px: float, height: float, drop_px: int
) -> tuple[float, ...]:
    """Return the map from pixels of the view to those of a layer, as Pillow takes it."""
    right, up, _ = pictures.OBLIQUE.axes
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
    """Return a picture in the size of a panel, its pixels kept square, on paper."""
    from PIL import Image

    picture = Image.fromarray(pixels).convert("RGB")
    factor = _PANEL_PX / max(picture.size)
    size = (max(1, round(picture.width * factor)), max(1, round(picture.height * factor)))
    fitted = picture.resize(size, Image.Resampling.LANCZOS if factor < 1 else Image.Resampling.BICUBIC)
    canvas = Image.new("RGB", (_PANEL_PX, _PANEL_PX), (255, 255, 255))
    canvas.paste(fitted, ((_PANEL_PX - size[0]) // 2, (_PANEL_PX - size[1]) // 2))
    return np.asarray(canvas)
