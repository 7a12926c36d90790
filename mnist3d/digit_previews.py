"""Previews of digits, single meshes and the steps from an image to a solid; the gallery of digits."""

from __future__ import annotations

from functools import partial
from os import fspath
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from mnist3d import digit_generation, digit_options, digit_records, ink, solid, sources
from mnist3d.digit_options import SolidSpec
from mnist3d.kind import KIND
from mnist3d.sources import picture_files
from tactile_toolkit import catalog, gallery, mesh, pictures, store
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import InputError
from tactile_toolkit.json_types import JsonDict, JsonObject
from tactile_toolkit.places import Name, Place, open_place

_SHOWN = (*digit_records.DigitRow.with_role("facet"), *mesh.PrintReport.with_role("facet", "measure"))


def plan_previews(name: Name | Place, spec: digit_options.DigitPreviewSpec) -> pictures.PicturePlan:
    """Plan the pictures of a data set, a mesh file or an image of a digit; nothing is drawn yet.

    Kinds are sheet and steps. Raises InputError as :meth:`~tactile_toolkit.pictures.ChosenRows.of`
    does and if a file cannot be read, and IntegrityError if the data set is damaged or unfinished.
    """
    if not isinstance(name, Place) and is_picture_or_mesh(fspath(name)):
        return _plan_file(fspath(name), spec)
    chosen = pictures.ChosenRows.of(KIND, name, spec, "preview")
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
    rows = {"--split": spec.split, "--ids": spec.ids, "--labels": spec.labels, "--limit": spec.limit}
    asked = [f"--kind {each}" for each in spec.kinds if each not in (kind, "all")]
    asked += [option for option, value in rows.items() if value]
    if asked:
        raise InputError(f"{asked[0]} needs a data set, and {name!r} is a single file", next="leave it out")
    stem = pictures.PlannedPicture.stem_of(name)
    if kind == "sheet":
        part = mesh.read_mesh(path, unit=spec.unit)
        drawings = [(f"{stem}-sheet.png", partial(pictures.draw_mesh, part, path.name))]
    else:
        mesh.refuse_unit(spec.unit, name)
        drawings = _plan_pages(path, stem)
    return pictures.PicturePlan(
        tuple(pictures.PlannedPicture(file, path.name, draw) for file, draw in drawings)
    )


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
        pixels = ink.fit(picture_files.read_picture(path, page=page, whole=True))
        drawings.append((file, partial(solid.draw_steps, pixels, SolidSpec(), title)))
    return drawings


def _plan_steps(
    chosen: pictures.ChosenRows, spec: digit_options.DigitPreviewSpec
) -> list[pictures.PlannedPicture]:
    """Plan the steps of the digits with given ids, or of the first digit."""
    made_by = chosen.place.made_by
    set_name = chosen.place.name
    if "source" not in made_by:
        raise InputError(
            f"{set_name!r} does not name the source of its images", next="draw --kind sheet only"
        )
    with catalog.specification_read(set_name):
        files = {"images": spec.images, "writer_info": spec.writer_info}
        options = {option: str(path) for option, path in files.items() if path is not None}
        source = digit_generation.source_again(made_by["source"], **options)
        solid_spec = SolidSpec(**made_by["solid"])

    def draw(number: int, title: str) -> UInt8:
        return solid.draw_steps(source.image(number).pixels, solid_spec, title)

    planned = []
    for split, digits in chosen.splits.items():
        for digit in digits if spec.ids else digits[:1]:
            file = f"{chosen.stem}-{split}-{digit.id}-steps.png"
            title = f"{digit.caption(digits.label_names)}, id {digit.id} ({chosen.stem}, {split})"
            drawing = partial(draw, digit.id, title.capitalize())
            planned.append(pictures.PlannedPicture(file, f"digit {digit.id}, step by step", drawing))
    return planned if spec.ids else planned[:1]


def plan_gallery(name: Name | Place, chosen: catalog.RowFilter = catalog.RowFilter.ALL) -> gallery.Gallery:
    """Plan a gallery of digits; see :meth:`~tactile_toolkit.gallery.Gallery.of_rows`."""
    # The report of the data set, if it has one, is read instead of inspecting meshes again.
    place = open_place(name)
    folder = place.folder
    has_report = folder is not None and folder.exists(digit_records.REPORT_FILE)

    def reports(rows: digit_records.DigitDataset, split: str) -> list[JsonObject | None]:
        if folder is None or not has_report:
            return [None] * len(rows)
        report = store.read_report(folder, digit_records.REPORT_FILE)
        of_rows = pc.and_(pc.equal(report["split"], split), pc.is_in(report["id"], pa.array(rows.ids)))
        by_id = {row["id"]: row for row in report.filter(of_rows).to_pylist()}
        return [by_id.get(number) for number in rows.ids.tolist()]

    return gallery.Gallery.of_solids(
        KIND, place, chosen, title="3D digits", columns=_SHOWN, facts=_facts, known=reports
    )


def _facts(record: digit_records.DigitRecord, report: JsonObject | None) -> JsonDict:
    if report is None:
        inspected = mesh.inspect(mesh.Mesh(record.vertices_m, record.faces))
        problem = [] if inspected.problem is None else [inspected.problem]
        report = {**inspected.to_row(), "warnings": [*problem, *inspected.warnings]}
    return {**report, "writer": None if record.writer == sources.NO_WRITER else record.writer}
