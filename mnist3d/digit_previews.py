"""Pictures of digits: contact sheets, single meshes, and the steps from an image to a solid."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from os import fspath
from pathlib import Path

import numpy as np

from mnist3d import digit_generation, digit_options, digit_records, ink, solid
from mnist3d.digit_options import SolidSpec
from mnist3d.kind import KIND
from mnist3d.sources import picture_files
from tactile_toolkit import catalog, mesh, pictures, store
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import InputError
from tactile_toolkit.places import Name, Place
from tactile_toolkit.wording import class_name, with_count

_TILE_PX = 132
_VIEW_PX = 520


def plan_previews(name: Name | Place, spec: digit_options.DigitPreviewSpec) -> pictures.PicturePlan:
    """Plan the pictures of a data set, a mesh file or an image of a digit; nothing is drawn yet.

    Kinds are sheet and steps. Raises InputError as :class:`~tactile_toolkit.pictures.MeshPreviews` does and
    if a file cannot be read, and IntegrityError if the data set is damaged or unfinished.
    """
    if not isinstance(name, Place) and is_picture_or_mesh(fspath(name)):
        return _plan_file(fspath(name), spec)
    opened: pictures.MeshPreviews[digit_records.DigitDataset] = pictures.MeshPreviews(KIND, name, spec)
    mesh.refuse_unit(spec.unit, opened.name)
    names = opened.chosen[0][1].label_names

    def sheet_of(rows: digit_records.DigitDataset, title: str) -> UInt8:
        return draw_digit_sheet(list(rows), spec.per_class, title, names)

    plans = {
        "sheet": lambda: opened.plan_sheets(sheet_of),
        "steps": lambda: _plan_steps(opened, names, spec),
    }
    return pictures.plan_kinds(spec.kinds, plans)


def is_picture_or_mesh(name: str) -> bool:
    """Return whether a name is the path of a local picture or mesh file rather than a data set."""
    if store.is_remote(name):
        return False
    path = store.expanded(name)
    return path.suffix.lower() in (*mesh.FORMATS, *picture_files.ENDINGS) and path.is_file()


def _plan_file(name: str, spec: digit_options.DigitPreviewSpec) -> pictures.PicturePlan:
    """Plan the pictures of a single file; InputError for options that need a data set."""
    path = store.expanded(name)
    kind = "sheet" if path.suffix.lower() in mesh.FORMATS else "steps"
    rows = {"--split": spec.split, "--ids": spec.ids, "--labels": spec.labels, "--limit": spec.limit}
    asked = [f"--kind {each}" for each in spec.kinds if each not in (kind, "all")]
    asked += [option for option, value in rows.items() if value]
    if asked:
        raise InputError(f"{asked[0]} needs a data set, and {name!r} is a single file", next="leave it out")
    stem = pictures.file_stem(name)
    if kind == "sheet":
        part = mesh.read_mesh(path, unit=spec.unit)
        drawings = [(f"{stem}-sheet.png", partial(draw_mesh, part, path.name))]
    else:
        mesh.refuse_unit(spec.unit, name)
        drawings = _plan_pages(path, stem)
    return pictures.PicturePlan(
        tuple(pictures.PlannedPicture(file, path.name, draw) for file, draw in drawings)
    )


def _plan_pages(path: Path, stem: str) -> list[tuple[str, partial[UInt8]]]:
    """Read the pages of a picture, one digit each; return file names and functions that draw the steps."""
    pages, drawings = picture_files.pages_of(path), []
    for number, page in enumerate(pages, 1):
        file, title = f"{stem}-steps.png", path.name
        if len(pages) > 1:
            file, title = f"{stem}-{number}-steps.png", f"{path.name}, page {number}"
        # Fitted into 500 px, as by the sources; the default specification is for that size.
        pixels = ink.fit(picture_files.read_picture(path, page=page, whole=True))
        drawings.append((file, partial(solid.draw_steps, pixels, SolidSpec(), title)))
    return drawings


def _plan_steps(
    opened: pictures.MeshPreviews[digit_records.DigitDataset],
    names: Sequence[str],
    spec: digit_options.DigitPreviewSpec,
) -> list[pictures.PlannedPicture]:
    """Plan the steps of the digits with given ids, or of the first digit."""
    if "source" not in opened.made_by:
        raise InputError(
            f"{opened.name!r} does not name the source of its images", next="draw --kind sheet only"
        )
    with catalog.specification_read(opened.name):
        files = {"images": spec.images, "writer_info": spec.writer_info}
        given = {option: str(path) for option, path in files.items() if path is not None}
        source = digit_generation.source_again(opened.made_by["source"], **given)
        solid_spec = SolidSpec(**opened.made_by["solid"])

    def draw(number: int, title: str) -> UInt8:
        return solid.draw_steps(source.image(number).pixels, solid_spec, title)

    found = [(split, rows[row]) for split, rows, places in opened.chosen for row in places.tolist()]
    if not spec.ids:
        found = found[:1]
    planned = []
    for split, record in found:
        file = f"{opened.stem}-{split}-{record.id}-steps.png"
        title = f"Digit {class_name(names, record.label)}, id {record.id} ({opened.stem}, {split})"
        drawing = partial(draw, record.id, title)
        planned.append(pictures.PlannedPicture(file, f"digit {record.id}, step by step", drawing))
    return planned


def draw_digit_sheet(
    records: Sequence[digit_records.DigitRecord], per_row: int, title: str, names: Sequence[str]
) -> UInt8:
    """Draw digits from above at one scale; ``names`` are the names of the classes."""
    solids = [mesh.Mesh(record.vertices_m, record.faces) for record in records]
    widest_m = max(float(np.ptp(each.vertices_m[:, :2], axis=0).max()) for each in solids)
    px_per_mm = _TILE_PX / (mesh.MM_PER_M * widest_m)
    tiles = [
        (class_name(names, record.label), pictures.Tile(pictures.relief_of(each, px_per_mm), f"{record.id}"))
        for each, record in zip(solids, records, strict=True)
    ]
    words = f"{with_count(len(records), 'digits')} from above, at one scale; the id of each below it"
    return pictures.draw_by_class(tiles, per_row, title, words, px_per_mm)


def draw_mesh(part: mesh.Mesh, title: str) -> UInt8:
    """Draw a mesh from above, with a scale bar and its measures."""
    widest_m = float(np.ptp(part.vertices_m[:, :2], axis=0).max())
    px_per_mm = _VIEW_PX / max(mesh.MM_PER_M * widest_m, 1e-6)
    tile = pictures.Tile(pictures.relief_of(part, px_per_mm))
    drawn = pictures.sheet([tile], 1, title, object_facts(part), bar_room=True)
    return pictures.with_scale_bar(drawn, px_per_mm)


def object_facts(part: mesh.Mesh) -> tuple[str, ...]:
    """Return the measures of a mesh as text, and the reason if it is not a solid."""
    x_mm, y_mm, z_mm = (np.ptp(part.vertices_m, axis=0) * mesh.MM_PER_M).tolist()
    size = f"{x_mm:.1f} x {y_mm:.1f} x {z_mm:.1f} mm"
    parts = f"{len(part.vertices_m):,} vertices, {len(part.faces):,} triangles"
    found = mesh.check_manifold(part)
    if found.problem is not None:
        return f"{size}; {parts}", f"not a solid: {found.detail}"
    bodies = "one body" if found.bodies == 1 else f"{found.bodies} bodies"
    return (f"{size}; volume {found.volume_mm3:,.0f} mm³; {parts}; {bodies}",)
