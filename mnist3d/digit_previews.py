"""Previews of digits, single meshes and the steps from an image to a solid; the gallery of digits."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from os import fspath
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from PIL import Image

from mnist3d import digit_generation, digit_options, digit_records
from mnist3d.ink import binarisation, grey_levels
from mnist3d.kind import KIND
from mnist3d.solid import algorithm
from mnist3d.solid.lattice import Lattice
from mnist3d.sources import digit_source, picture_files
from tactile_toolkit import catalog, gallery, mesh, pictures, read, store
from tactile_toolkit.arithmetic import inverse_affine
from tactile_toolkit.errors import InputError, ItemError
from tactile_toolkit.mesh import MM_PER_M
from tactile_toolkit.places import Name, Place, open_place
from tactile_toolkit.value_types import AnyArray, Bool, JsonDict, JsonObject, UInt8

_SHOWN = (*digit_records.DigitRow.with_role("facet"), *mesh.PrintReport.with_role("facet", "measure"))

CLAY = (224, 166, 72)
"""Colour of objects in oblique views."""

_PANEL_PX = 380
_MARGIN_PX = 12
_LIGHTEST = (214, 230, 241)
_DARKEST = (8, 64, 112)
_SAMPLING = 2
# Factor by which the distance of layers is enlarged in the picture of the stack.
_SPREAD = 4.0


def plan_previews(name: Name | Place, spec: digit_options.DigitPreviewSpec) -> pictures.PicturePlan:
    """Plan the pictures of a data set, a mesh file or an image of a digit; nothing is drawn yet.

    Kinds are sheet and steps. Raises InputError as :meth:`~tactile_toolkit.pictures.ChosenRows.of`
    does and if a file cannot be read, and IntegrityError if the data set is damaged or unfinished.
    """
    if not isinstance(name, Place) and is_picture_or_mesh(fspath(name)):
        return _plan_file(fspath(name), spec)
    chosen = pictures.ChosenRows.of(KIND, name, spec, "tactile preview")
    mesh.refuse_unit(spec.unit, chosen.place.name)
    plans = {
        "sheet": partial(chosen.plan_sheets, spec.per_class),
        "steps": partial(_plan_steps, chosen, spec),
    }
    return pictures.PicturePlan.of_kinds(spec.kinds, plans)


def is_picture_or_mesh(name: str) -> bool:
    """Return whether a name is the path of a local picture or mesh file rather than a data set."""
    path = store.local_path(name)
    if path is None or not path.is_file():
        return False
    return path.suffix.lower() in (*mesh.MeshFile.FORMATS, *picture_files.ENDINGS)


def _plan_file(name: str, spec: digit_options.DigitPreviewSpec) -> pictures.PicturePlan:
    """Plan the pictures of a single file; InputError for options that need a data set."""
    path = store.expanded(name)
    kind = "sheet" if path.suffix.lower() in mesh.MeshFile.FORMATS else "steps"
    rows = {"split": spec.split, "ids": spec.ids, "labels": spec.labels, "limit": spec.limit}
    rows["kinds"] = [word for word in spec.kinds if word not in (kind, "all")]
    for option, value in rows.items():
        if value:
            raise InputError(
                f"needs a data set, and {name!r} is a single file", next="leave it out", field=option
            )
    stem = pictures.PictureTask.stem_of(name)
    if kind == "sheet":
        part = mesh.read_mesh(path, unit=spec.unit)
        drawings = [(f"{stem}-sheet.png", partial(pictures.draw_mesh, part, path.name))]
    else:
        mesh.refuse_unit(spec.unit, name)
        drawings = _plan_pages(path, stem)
    return pictures.PicturePlan(tuple(pictures.PictureTask(file, path.name, draw) for file, draw in drawings))


def _plan_pages(path: Path, stem: str) -> list[tuple[str, partial[UInt8]]]:
    """Read the pages of a picture, one digit each; return file names and functions that draw the steps."""
    pages = picture_files.pages_of(path)
    drawings = []
    for number, page in enumerate(pages, 1):
        file = f"{stem}-steps.png"
        title = path.name
        if len(pages) > 1:
            file = f"{stem}-{number}-steps.png"
            title = f"{path.name}, page {number}"
        # Fitted into 500 px, as by the sources; the default specification is for that size.
        pixels = grey_levels.fit(picture_files.read_picture(path, page=page, whole=True))
        drawings.append((file, partial(draw_steps, pixels, digit_options.SolidSpec(), title)))
    return drawings


def _plan_steps(
    chosen: pictures.ChosenRows, spec: digit_options.DigitPreviewSpec
) -> list[pictures.PictureTask]:
    """Plan the steps of the digits with given ids, or of the first digit."""
    made_by = chosen.place.made_by
    set_name = chosen.place.name
    if "source" not in made_by:
        raise InputError(
            f"{set_name!r} does not name the source of its images", next="draw --draw sheet only"
        )
    with catalog.specification_read(set_name):
        files = {"images": spec.images, "writer_info": spec.writer_info}
        options = {option: str(path) for option, path in files.items() if path is not None}
        source = digit_generation.source_again(made_by["source"], **options)
        solid_spec = digit_options.SolidSpec(**made_by["solid"])

    def draw(number: int, title: str) -> UInt8:
        return draw_steps(source.image(number).pixels, solid_spec, title)

    drawings = []
    for split, digits in chosen.splits.items():
        for digit in digits if spec.ids else digits[:1]:
            file = f"{chosen.stem}-{split}-{digit.id}-steps.png"
            title = f"{digit.caption(digits.label_names)}, id {digit.id} ({chosen.stem}, {split})"
            drawing = partial(draw, digit.id, title.capitalize())
            drawings.append(pictures.PictureTask(file, f"digit {digit.id}, step by step", drawing))
    return drawings if spec.ids else drawings[:1]


def plan_gallery(name: Name | Place, chosen: catalog.RowFilter = catalog.RowFilter.ALL) -> gallery.Gallery:
    """Plan a gallery of digits; see :meth:`~tactile_toolkit.gallery.Gallery.of_solids`."""
    # The report of the data set, if it has one, is read instead of inspecting meshes again.
    opened = open_place(name)
    folder = opened.folder
    has_report = folder is not None and folder.exists(digit_records.REPORT_FILE)

    def reports(rows: digit_records.DigitDataset, split: str) -> list[JsonObject | None]:
        if folder is None or not has_report:
            return [None] * len(rows)
        report = read.Shard(folder.address(digit_records.REPORT_FILE)).read()
        of_rows = pc.and_(pc.equal(report["split"], split), pc.is_in(report["id"], pa.array(rows.ids)))
        by_id = {row["id"]: row for row in report.filter(of_rows).to_pylist()}
        return [by_id.get(number) for number in rows.ids.tolist()]

    return gallery.Gallery.of_solids(
        KIND, opened, chosen, title="3D digits", columns=_SHOWN, facts=_facts, known=reports
    )


def _facts(record: digit_records.DigitRecord, report: JsonObject | None) -> JsonDict:
    if report is None:
        inspected = mesh.PrintReport.of(mesh.Mesh(record.vertices_m, record.faces))
        problem = [] if inspected.problem is None else [inspected.problem]
        report = {**inspected.to_row(), "warnings": [*problem, *inspected.warnings]}
    return {**report, "writer": None if record.writer == digit_source.NO_WRITER else record.writer}


def draw_steps(pixels: AnyArray, spec: digit_options.SolidSpec, title: str) -> UInt8:
    """Draw how an image, shape (H, W), 0 for ink and 255 for paper, becomes the solid that a data set stores.

    Raises ItemError, with the title of the picture, where the image is not a usable digit.
    """
    try:
        mask = binarisation.binarise(pixels, spec, ink="dark")
        steps = algorithm.solid_steps(mask, spec)
    except ItemError as error:
        raise ItemError(error.reason, f"{title}: {error}") from error
    window = _window(mask)
    lattice = steps.lattice
    solid = steps.mesh
    layers = _layers_px(lattice, steps.upper_half > 0, window)
    upper = algorithm.scale(steps.surface, mask.shape, spec)
    px_per_mm = _PANEL_PX / (max(layers[0].shape) * spec.pixel_pitch_mm)
    size_px = (_PANEL_PX, _PANEL_PX)
    views = [
        pictures.View.OBLIQUE.draw([(part, CLAY)], size_px, px_per_mm * MM_PER_M) for part in (upper, solid)
    ]
    pitch_px = lattice.pitch_px
    triangles = len(solid.faces)
    decimated = ", decimated" if triangles != 2 * len(upper.faces) else ""
    tiles = (
        pictures.Tile(_square(np.asarray(pixels)[window].astype(np.uint8)), "1  image"),
        pictures.Tile(
            _square(np.where(mask[window], 0, 255).astype(np.uint8)), "2  ink, binarised and cleaned"
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


def _stack_view(
    layers: Sequence[Bool], pitch_px: float, spec: digit_options.SolidSpec, px_per_mm: float
) -> UInt8:
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
            visible = mask.transform((side, side), Image.Transform.AFFINE, data, Image.Resampling.BILINEAR)
            picture.paste(colour, mask=visible)
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
