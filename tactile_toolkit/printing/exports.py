"""Exports: one file for each object, or build plates with maps and a table."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias, TypedDict, Unpack

import numpy as np

from tactile_toolkit import catalog, places
from tactile_toolkit.errors import ItemError
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.mesh import MM_PER_M, Mesh, MeshFile
from tactile_toolkit.mesh.solid_check import require_solid
from tactile_toolkit.mesh.threemf import BuildItem, read_build, write_build
from tactile_toolkit.printing.calibration_plate import WrittenPlate, export_calibration_plate
from tactile_toolkit.printing.file_export import (
    CHANGED,
    FailedExport,
    FileExport,
    Made,
    PrintObject,
    Product,
    Progress,
    content_of,
    objects_of,
    require_same_solid,
)
from tactile_toolkit.printing.plate_layouts import PlateLayout, arrange, draw_map
from tactile_toolkit.printing.print_options import ExportOptions
from tactile_toolkit.printing.simulator import body_of, model_files, pack_mjcf
from tactile_toolkit.store.addresses import local_folder_path
from tactile_toolkit.value_types import JsonDict
from tactile_toolkit.wording import bytes_text, with_count

# Meshes that a file for simulators refers to; other files next to them are never replaced.
_MESHES = ("visual", "part-[0-9][0-9]", "part-[0-9][0-9][0-9]")

TABLE_FILE = "plates.csv"

_ROWS_SHOWN = 20  # more files are not listed

OFF_PLATE = "off-plate"
"""Problem of a plate; the others are those of files."""

_COLUMNS = (
    *("plate", "file", "name", "split", "label", "id"),
    *("x_mm", "y_mm", "width_mm", "depth_mm", "height_mm", "volume_mm3"),
)

_EDGE_TOLERANCE_MM = 1e-3  # 3MF is written with nine digits, and no printer resolves a micrometre


@dataclass(frozen=True, slots=True)
class ExportReport:
    """What an export did: values for JSON, objects that failed, and a table and a line for people.

    ``removed`` are the plates of an earlier export that are not part of this one.
    """

    document: JsonDict
    failed: tuple[FailedExport, ...]
    line: str
    header: tuple[str, ...] = ()
    rows: tuple[tuple[object, ...], ...] = ()
    removed: tuple[str, ...] = ()


ShowProgress: TypeAlias = Callable[[str, str], AbstractContextManager[Progress]]
"""Shows a stage of an export, and what it counts."""


class FileJob(TypedDict, total=False):
    """How files are written: as of :func:`export_files`."""

    overwrite: bool
    dry_run: bool
    workers: int


def export(
    place: places.Place,
    kind: DatasetKind,
    chosen: catalog.RowFilter,
    out: str,
    options: ExportOptions,
    progress: ShowProgress,
    **job: Unpack[FileJob],
) -> ExportReport:
    """Write chosen meshes of a data set as files for printers and simulators.

    Raises as :func:`export_files` and
    :func:`write_plates`.
    """
    plate = options.plates
    objects = objects_of(chosen.open(place, kind), options.base_mm)
    ending = options.file_format
    overwrite = job.get("overwrite", False)
    dry_run = job.get("dry_run", False)
    doing = "checking" if dry_run else "writing"
    if options.calibration_plate:
        plates = export_calibration_plate(objects, out, ending or "3mf", overwrite=overwrite, dry_run=dry_run)
        return _report_of_calibration(plates, out)
    if plate is not None:
        # Plates in MJCF are bodies that lie on a floor; 3MF has neither density nor friction.
        on_floor = options.physics if ending == "mjcf" else None
        with progress("measuring", "objects") as update:
            layout = arrange(objects, plate, options.scale, on_floor, update)
        with progress(doing, "plates") as update:
            made = write_plates(layout, out, overwrite=overwrite, dry_run=dry_run, on_progress=update)
        return _report_of_plates(made, f"{plate.text} to {out}", dry_run)
    with progress(doing, "files") as update:
        files = export_files(objects, out, options, on_progress=update, **job)
    return _report_of_files(files, out, f"{ending or 'stl'} files", dry_run)


def _report_of_calibration(made: FileExport[WrittenPlate], out: str) -> ExportReport:
    lines = []
    for plate in made.files:
        size = " x ".join(f"{side:g}" for side in plate.size_mm)
        features = ", ".join(plate.features)
        lines.append(f"{plate.state}: {', '.join(plate.files)} in {out}; {size} mm, with {features}")
    return ExportReport(asdict(made), made.failed, "\n".join(lines))


def _report_of_files(made: FileExport[WrittenFile], out: str, what: str, dry_run: bool) -> ExportReport:
    rows = [
        (
            file.file,
            " x ".join(f"{side:.1f}" for side in file.size_mm),
            f"{file.volume_mm3:,.0f}",
            file.bytes,
            file.state,
        )
        for file in made.files
        if len(made.files) <= _ROWS_SHOWN
    ]
    kept = _kept(made)
    size = bytes_text(sum(file.bytes for file in made.files))
    line = f"{with_count(len(made.files), 'files')} in {out} ({size}), each read back as a solid{kept}"
    if dry_run:
        count = with_count(len(made.files), what)
        line = f"would write {count} to {out} ({size}){kept}; nothing was written"
    header = ("file", "size mm", "volume mm³", "bytes", "")
    return ExportReport(asdict(made), made.failed, line, header, tuple(rows))


def _report_of_plates(made: PlateExport, plates_text: str, dry_run: bool) -> ExportReport:
    document = asdict(made)
    rows = [
        (plate.file, plate.objects, f"{plate.share:.0%}", bytes_text(plate.bytes)) for plate in made.files
    ]
    placed = with_count(len(made.objects), "objects")
    plates = with_count(len(made.files), "plates")
    line = (
        f"wrote {placed} on {plates} of {plates_text}{_kept(made)}; {TABLE_FILE} lists where each object lies"
    )
    if dry_run:
        line = f"would write {placed} on {plates} of {plates_text}{_kept(made)}; nothing was written"
    return ExportReport(
        {"plates": document.pop("files"), **document},
        made.failed,
        line,
        ("plate", "objects", "share of the plate", "size"),
        tuple(rows),
        made.removed,
    )


def _kept(made: FileExport[Any]) -> str:
    count = sum(file.state == "kept" for file in made.files)
    if not count:
        return ""
    return f"; {count:,} unchanged"


@dataclass(frozen=True, slots=True)
class WrittenFile:
    """A file with the solid of an object, and its sizes; ``state`` is as in :class:`Made`."""

    name: str
    file: str
    split: str
    label: str
    id: int
    width_mm: float
    depth_mm: float
    height_mm: float
    volume_mm3: float
    bytes: int
    state: str

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Width, depth and height."""
        return self.width_mm, self.depth_mm, self.height_mm


def _made_file(item: PrintObject, options: ExportOptions) -> Made[WrittenFile]:
    """Make the file of an object; a model for simulators has meshes beside it."""
    solid = item.on_plate(options.scale)
    ending = options.ending

    def record(volume_mm3: float, size: int, state: str) -> WrittenFile:
        sides_mm = (np.ptp(solid.bounds_m, axis=0) * MM_PER_M).tolist()
        width_mm, depth_mm, height_mm = (round(side_mm, 3) for side_mm in sides_mm)
        return WrittenFile(
            name=item.name,
            file=f"{item.name}{ending}",
            split=item.split,
            label=item.label,
            id=item.id,
            width_mm=width_mm,
            depth_mm=depth_mm,
            height_mm=height_mm,
            volume_mm3=round(volume_mm3, 3),
            bytes=size,
            state=state,
        )

    if ending in MeshFile.FORMATS:
        return Made.of_solid(item.name, ending, solid, record)
    volume_mm3 = require_solid(solid).volume_mm3
    files = model_files(item.name, solid, ending, options.physics)
    return Made(files, partial(record, volume_mm3, sum(map(len, files.values()))))


def _product(item: PrintObject, options: ExportOptions) -> Product[WrittenFile]:
    paths = (f"{item.name}{options.ending}", *(f"{item.name}/{part}.obj" for part in _MESHES))
    return Product(item.name, paths, partial(_made_file, item, options))


def export_files(
    objects: Sequence[PrintObject],
    out: str,
    options: ExportOptions,
    *,
    overwrite: bool = False,
    dry_run: bool = False,
    workers: int = 1,
    on_progress: Progress = lambda _done, _total: None,
) -> FileExport[WrittenFile]:
    """Write one file for each object, without rotation, with its lowest point at z = 0.

    A file gets its name when it holds the same solid and reads back as it was written. Existing files with
    the same bytes are kept, so an interrupted export continues. Objects that are not solids are listed in the
    result.

    Parameters
    ----------
    objects : sequence of PrintObject
        What to write.
    out : str
        Folder of the files.
    options : ExportOptions
        Format and scale, and the material of models for simulators.
    overwrite : bool
        Replace files with other content, and remove those of objects that fail.
    dry_run : bool
        Make and check the files without writing them.
    workers : int
        Number of processes.
    on_progress : callable
        Called with the numbers of finished and of all objects.

    Returns
    -------
    FileExport
        Written, kept and failed files.

    Raises
    ------
    InputError
        Other files are in the way; nothing was written.
    StorageError
        The folder cannot be written; finished files are kept.
    """
    products = [_product(item, options) for item in objects]
    return FileExport.of(
        products, out, overwrite=overwrite, dry_run=dry_run, workers=workers, on_progress=on_progress
    )


@dataclass(frozen=True, slots=True)
class PlateFile:
    """A plate: its file (3MF or MJCF), its PNG map, the number of objects, and the fraction that they take.

    ``bytes`` is the size of the file; ``state`` is as in :class:`~tactile_toolkit.printing.file_export.Made`.
    """

    file: str
    map: str
    objects: int
    share: float
    bytes: int
    state: str


@dataclass(frozen=True, slots=True)
class PlateExport(FileExport[PlateFile]):
    """Result of an export of plates: the plates and the rows of the table.

    ``failed`` are objects that were left out and plates that could not be written. ``removed`` are files of
    an earlier export that this one does not have.
    """

    objects: tuple[dict[str, object], ...]
    removed: tuple[str, ...] = ()


def write_plates(
    layout: PlateLayout,
    out: str,
    *,
    overwrite: bool = False,
    dry_run: bool = False,
    on_progress: Progress = lambda _done, _total: None,
) -> PlateExport:
    """Write the plates of a layout into a folder, which is created if needed.

    Each object of a 3MF file must be read back as the same solid with the same name, inside the plate, before
    the file gets its name. Existing files with the same bytes are kept. With ``overwrite``, the plates of
    another export are replaced, and further plates listed in its table are removed, but no other files. A
    ``dry_run`` makes and checks the plates without writing.

    Raises InputError, before anything is written, where the folder holds plates of another export, and
    StorageError where the folder cannot be written; finished files are kept.
    """
    unknown = _unknown_files(layout, local_folder_path(out))
    # The table first, because it shows whether the folder holds another export.
    FileExport.of([_table_product(tuple(_rows(layout)), unknown)], out, overwrite=overwrite, dry_run=True)
    plates = [
        Product(solid, (solid, picture), partial(_made_plate, layout, number))
        for number, (solid, picture) in enumerate(_names(layout), 1)
    ]
    made = FileExport.of(plates, out, overwrite=overwrite, dry_run=dry_run, on_progress=on_progress)
    written = {plate.file for plate in made.files}
    rows = tuple(row for row in _rows(layout) if row["file"] in written)
    if not dry_run:
        # Last, so that it lists only files that exist and were checked.
        FileExport.of([_table_product(rows, unknown)], out, overwrite=True)
    return PlateExport(made.files, (*layout.failures, *made.failed), rows, unknown)


def _names(layout: PlateLayout) -> list[tuple[str, str]]:
    """Return the file names of each plate: solids and map."""
    ending = "3mf" if layout.physics is None else "xml"
    plates = [f"plate-{number:02d}" for number in range(1, len(layout.plates) + 1)]
    return [(f"{plate}.{ending}", f"{plate}.png") for plate in plates]


def _made_plate(layout: PlateLayout, number: int) -> Made[PlateFile]:
    (solid, picture) = _names(layout)[number - 1]
    plate = layout.plates[number - 1]
    items = [
        BuildItem(placed.item.name, placed.item.on_plate(layout.scale), placed.offset_mm) for placed in plate
    ]
    if layout.physics is None:
        content = write_build(items)
    else:
        # A scene: positions on the plate are positions on the ground.
        places_m = [(placed.offset_mm[0] / MM_PER_M, placed.offset_mm[1] / MM_PER_M) for placed in items]
        bodies = [body_of(placed.name, placed.mesh, layout.physics) for placed in items]
        content = pack_mjcf(list(zip(bodies, places_m, strict=True)), "plate", floor=True)
    share = round(layout.shares[number - 1], 4)
    return Made(
        {picture: draw_map(layout, number), solid: content},
        partial(PlateFile, solid, picture, len(plate), share, len(content)),
        partial(_check_plate, content, items, layout),
    )


def _check_plate(content: bytes, items: Sequence[BuildItem], layout: PlateLayout) -> None:
    """Raise ItemError unless a plate holds these objects as the same solids, within its margins."""
    meant = {
        item.name: Mesh(item.mesh.vertices_m + np.divide(item.offset_mm, MM_PER_M), item.mesh.faces)
        for item in items
    }
    meshes = meant
    if layout.physics is None:
        meshes = {item.name: item.mesh for item in read_build(content).items}
    if meshes.keys() != meant.keys():
        raise ItemError(
            CHANGED, f"it names {with_count(len(meshes), 'objects')}; {len(meant)} others were written"
        )
    edge_mm = layout.spec.margin_mm - _EDGE_TOLERANCE_MM
    for name, mesh in meshes.items():
        try:
            require_same_solid(mesh, meant[name], require_solid(meant[name]))
        except ItemError as error:
            raise ItemError(error.reason, f"{name}: {error}") from error
        low, high = mesh.bounds_m * MM_PER_M
        in_corner = (mesh.vertices_mm[:, :2] < layout.spec.corner_mm).all(axis=1).any()
        outside = (
            in_corner
            or (low[:2] < edge_mm).any()
            or (high[:2] > np.subtract(layout.spec.sides_mm, edge_mm)).any()
        )
        if outside or low[2] < -_EDGE_TOLERANCE_MM:
            raise ItemError(OFF_PLATE, f"{name} reaches beyond the plate or its margin, or into its corner")


def _rows(layout: PlateLayout) -> Iterator[dict[str, object]]:
    """Yield the rows of the table; x and y are the lower left corner of the bounding box."""
    for number, (plate, (solid, _)) in enumerate(zip(layout.plates, _names(layout), strict=True), 1):
        for placed in plate:
            item = placed.item
            named = (number, solid, item.name, item.split, item.label, item.id)
            sizes_mm = (*placed.outline.size_mm, placed.height_mm)
            measured = (placed.x_mm, placed.y_mm, *sizes_mm, placed.volume_mm3)
            values = (*named, *(round(value, 3) for value in measured))
            yield dict(zip(_COLUMNS, values, strict=True))


def _table_product(rows: Sequence[dict[str, object]], unknown: Sequence[str]) -> Product[str]:
    """Return the table as a product; ``unknown`` are plates that it does not list, which are removed."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _no_formula(value) for name, value in row.items()} for row in rows)
    made = Made({TABLE_FILE: text.getvalue().encode()}, str)
    return Product(TABLE_FILE, (TABLE_FILE, *unknown), lambda: made)


def _no_formula(value: object) -> object:
    """Quote text that a spreadsheet would run as a formula."""
    is_formula = isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r"))
    return f"'{value}" if is_formula else value


def _unknown_files(layout: PlateLayout, folder: Path) -> tuple[str, ...]:
    """List plates and maps of an earlier export in the folder that this layout does not have."""
    # Only those in its table: other files with such names may belong to the user.
    table = (content_of(folder / TABLE_FILE) or b"").decode(errors="replace")
    listed = re.findall(r"^\d+,(plate-\d{2,})\.(3mf|xml),", table, re.ASCII | re.MULTILINE)
    before = {f"{plate}.{suffix}" for plate, ending in listed for suffix in (ending, "png")}
    ours = {name for names in _names(layout) for name in names}
    return tuple(sorted(name for name in before - ours if (folder / name).exists()))
