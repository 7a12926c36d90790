"""Which pictures of digits are drawn: contact sheets, single meshes, and the steps of an image."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from os import fspath
from pathlib import Path

import numpy as np

from mnist3d import ink, solid
from mnist3d.digit_dataset import DigitDataset, DigitRecord
from mnist3d.digit_preview_spec import DigitPreviewSpec
from mnist3d.kind import KIND
from mnist3d.solid_spec import SolidSpec
from mnist3d.sources.picture_files import ENDINGS, pages_of
from mnist3d.sources.picture_levels import read_picture
from mnist3d.sources.source_choice import source_again
from tactile_toolkit import catalog, pictures, store
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh import FORMATS, MM_PER_M, Mesh, check_manifold, read_mesh, refuse_unit
from tactile_toolkit.places import Name, Place
from tactile_toolkit.wording import class_name, with_count

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
    if store.is_remote(name):
        return False
    path = store.expanded(name)
    return path.suffix.lower() in (*FORMATS, *ENDINGS) and path.is_file()


def _draw_pages(path: Path) -> list[Callable[[], UInt8]]:
    """Read the pages of a picture; each is a digit."""
    pages = pages_of(path)
    titles = [f"{path.name}, page {number}" for number in range(1, len(pages) + 1)]
    # As the sources do: the numbers of the default specification are for sheets of 500 px.
    return [
        partial(
            solid.draw_steps, pixels=ink.fit(read_picture(path, page=page)), spec=SolidSpec(), title=title
        )
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
    opened: pictures.MeshPreviews[DigitDataset] = pictures.MeshPreviews(KIND, name, spec)
    refuse_unit(spec.unit if isinstance(spec, DigitPreviewSpec) else None, opened.name)
    names = opened.chosen[0][1].label_names

    def sheet_of(rows: DigitDataset, title: str) -> UInt8:
        return draw_sheet(list(rows), spec.per_class, title, names)

    def plan_steps() -> list[pictures.PlannedPicture]:
        if "source" not in opened.made_by:
            raise InputError(f"{opened.name!r} does not name the source of its images")
        given = spec if isinstance(spec, DigitPreviewSpec) else DigitPreviewSpec()
        files = {"images": given.images, "writer_info": given.writer_info}
        with catalog.specification_read(opened.name):
            places = {option: None if path is None else str(path) for option, path in files.items()}
            source = source_again(opened.made_by["source"], **places)
            solid_spec = SolidSpec.from_dict(opened.made_by["solid"])

        def draw(number: int, title: str) -> UInt8:
            return solid.draw_steps(source.image(number).pixels, solid_spec, title)

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


def draw_sheet(records: Sequence[DigitRecord], per_row: int, title: str, names: Sequence[str]) -> UInt8:
    """Draw digits from above at one scale; ``names`` are those of the classes."""
    meshes = [Mesh(record.vertices_m, record.faces) for record in records]
    px_per_mm = _TILE_PX / (MM_PER_M * max(float(np.ptp(mesh.vertices_m[:, :2], 0).max()) for mesh in meshes))
    tiles = [
        (class_name(names, record.label), pictures.Tile(pictures.relief_of(mesh, px_per_mm), f"{record.id}"))
        for mesh, record in zip(meshes, records, strict=True)
    ]
    words = f"{with_count(len(records), 'digits')} from above, at one scale; the id of each below it"
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
