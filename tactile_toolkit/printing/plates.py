"""Build plates in a folder: a 3MF file and a map of each, and one table that says which object lies where."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tactile_toolkit.errors import ItemError
from tactile_toolkit.mesh.files import BROKEN_FILE
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.mesh.threemf import BuildItem, Part, read_build, write_build
from tactile_toolkit.printing.checked import (
    CHANGED,
    OFF_PLATE,
    UNREADABLE,
    Failure,
    existing,
    holds,
    prepare,
    refuse_others,
    remove,
    require_same_solid,
    require_solid,
    settle,
)
from tactile_toolkit.printing.layout import Layout, Placed
from tactile_toolkit.printing.objects import standing
from tactile_toolkit.printing.plate_map import draw_map
from tactile_toolkit.printing.plate_spec import PlateSpec
from tactile_toolkit.printing.plate_table import TABLE_FILE, plates_before, table_csv, table_row
from tactile_toolkit.printing.tags import tag_mesh
from tactile_toolkit.wording import counted

__all__ = ["TABLE_FILE", "PlateExport", "PlateFile", "forecast_plates", "write_plates"]

_SAMPLED = 4
_EDGE_TOLERANCE_MM = 1e-3


@dataclass(frozen=True, slots=True)
class PlateFile:
    """A plate.

    Attributes
    ----------
    file, map : str
        Its 3MF file and its PNG map.
    objects : int
        How many lie on it.
    share : float
        Share of the plate that they need.
    bytes : int
        Size of the 3MF file; about, where it is only planned.
    state : str
        ``"written"``, ``"kept"`` where the very same file was there already, or ``"planned"``.
    """

    file: str
    map: str
    objects: int
    share: float
    bytes: int
    state: str

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            **{"file": self.file, "map": self.map, "objects": self.objects, "share": round(self.share, 4)},
            **{"bytes": self.bytes, "state": self.state},
        }


@dataclass(frozen=True, slots=True)
class PlateExport:
    """What lies on which plate.

    Attributes
    ----------
    plates : tuple of PlateFile
        One per plate.
    rows : tuple of dict
        Rows of the table, see :data:`tactile_toolkit.printing.plate_table.COLUMNS`.
    least_plates : int
        No packing needs fewer.
    failures : tuple of Failure
        Objects that were left out, and plates that could not be written.
    removed : tuple of str
        Plates and maps of the export that was here before, which this one has not.
    """

    plates: tuple[PlateFile, ...]
    rows: tuple[dict[str, Any], ...]
    least_plates: int
    failures: tuple[Failure, ...]
    removed: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "plates": [plate.to_dict() for plate in self.plates],
            "least_plates": self.least_plates,
            "objects": list(self.rows),
            "failed": [failure.to_dict() for failure in self.failures],
            "removed": list(self.removed),
        }


def write_plates(
    layout: Layout,
    out: str,
    *,
    overwrite: bool = False,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> PlateExport:
    """Write the plates of a layout.

    Each 3MF file is read back from disk: every object and tag has to be the same solid under the same name,
    and inside the plate, before the file gets its name. Files that are there already with the very same
    bytes are kept. The table is written last.

    Parameters
    ----------
    layout : Layout
        What lies where.
    out : str
        Folder; made where it is not there.
    overwrite : bool
        Replace the plates of another export, and remove those of its plates that this one has not: what the
        table of that export lists, and no other files.
    on_progress : callable
        Told plates done and in all.

    Returns
    -------
    PlateExport

    Raises
    ------
    InputError
        Plates of another export stand in the folder: nothing was written.
    StorageError
        The folder cannot be written; finished files stay.
    """
    folder = prepare(out)
    strangers = _strangers(layout, folder)
    if not overwrite:
        refuse_others(out, [*strangers, *_differing(layout, folder)])
    remove(folder / name for name in strangers)
    plates, failures = [], list(layout.failures)
    for number in range(1, len(layout.plates) + 1):
        try:
            plates.append(_write_plate(layout, number, folder))
        except ItemError as error:
            # What an earlier export left under these names would pass for this plate.
            remove((folder / _solid_file(number), folder / _map_file(number)))
            failures.append(Failure(_solid_file(number), error.reason, str(error)))
        on_progress(number, len(layout.plates))
    written = {plate.file for plate in plates}
    rows = tuple(row for row in _rows(layout) if row["file"] in written)
    settle(folder / TABLE_FILE, table_csv(rows), _unchecked)
    return PlateExport(tuple(plates), rows, layout.least_plates, tuple(failures), tuple(strangers))


def forecast_plates(layout: Layout, out: str | None = None, *, overwrite: bool = False) -> PlateExport:
    """Say what :func:`write_plates` would write.

    Parameters
    ----------
    layout, out, overwrite
        As there; without ``out``, no files are in the way.

    Raises
    ------
    InputError
        Plates of another export stand in the folder.
    """
    folder = None if out is None else existing(out)
    strangers = [] if folder is None else _strangers(layout, folder)
    if out is not None and folder is not None and not overwrite:
        refuse_others(out, [*strangers, *_differing(layout, folder)])
    sample = [placed for plate in layout.plates for placed in plate][:_SAMPLED]
    each = sum(len(write_build([_item(placed, layout)])) for placed in sample) / max(len(sample), 1)
    plates = tuple(
        PlateFile(
            _solid_file(number), _map_file(number), len(plate), share, round(each * len(plate)), "planned"
        )
        for number, (plate, share) in enumerate(zip(layout.plates, layout.shares, strict=True), 1)
    )
    rows = tuple(_rows(layout))
    return PlateExport(plates, rows, layout.least_plates, layout.failures, tuple(strangers))


def _write_plate(layout: Layout, number: int, folder: Path) -> PlateFile:
    plate = layout.plates[number - 1]
    items = [_item(placed, layout) for placed in plate]
    content = write_build(items)
    check = partial(_check_plate, items=items, spec=layout.spec)
    state = settle(folder / _solid_file(number), content, check)
    settle(folder / _map_file(number), _map_of(layout, number), _unchecked)
    share = layout.shares[number - 1]
    return PlateFile(_solid_file(number), _map_file(number), len(plate), share, len(content), state)


def _item(placed: Placed, layout: Layout) -> BuildItem:
    mesh = standing(placed.item.load(), layout.scale)
    parts = [_part(placed.item.name, mesh)]
    if placed.tag is not None:
        x_mm, y_mm, _ = placed.offset_mm
        parts.append(
            _part(
                f"{placed.item.name} tag",
                tag_mesh(placed.tag.text),
                (placed.tag.x_mm - x_mm, placed.tag.y_mm - y_mm),
            )
        )
    return BuildItem(placed.item.name, tuple(parts), placed.offset_mm)


def _part(name: str, mesh: Mesh, moved_mm: tuple[float, float] = (0.0, 0.0)) -> Part:
    return Part(name, np.asarray(mesh.vertices_m, np.float64) * MM_PER_M + (*moved_mm, 0.0), mesh.faces)


def _map_of(layout: Layout, number: int) -> bytes:
    plate = layout.plates[number - 1]
    objects = counted(len(plate), "objects")
    title = f"plate {number} of {len(layout.plates)}: {objects}, {layout.spec.text}"
    labels = sorted({placed.item.label for other in layout.plates for placed in other})
    counts = Counter(placed.item.id for other in layout.plates for placed in other)
    shared = {number for number, count in counts.items() if count > 1}
    return draw_map(plate, layout.spec, title, labels, shared)


def _check_plate(path: Path, items: Sequence[BuildItem], spec: PlateSpec) -> None:
    try:
        found = read_build(path.read_bytes())
    except BROKEN_FILE as error:
        message = f"it is no readable 3MF file ({error})"
        raise ItemError(UNREADABLE, message) from error
    if [item.name for item in found] != [item.name for item in items]:
        message = f"it names {len(found)} objects; {len(items)} others were written"
        raise ItemError(CHANGED, message)
    for back, meant in zip(found, items, strict=True):
        for part, written in zip(back.parts, meant.parts, strict=True):
            _check_part(part, written, meant.offset_mm, spec)


def _check_part(found: Part, written: Part, offset_mm: tuple[float, float, float], spec: PlateSpec) -> None:
    if found.name != written.name:
        message = f"{found.name!r} was written as {written.name!r}"
        raise ItemError(CHANGED, message)
    meant = _mesh(written, offset_mm)
    back = _mesh(found)
    try:
        require_same_solid(back, meant, require_solid(meant))
    except ItemError as error:
        message = f"{written.name}: {error}"
        raise ItemError(error.reason, message) from error
    low, high = back.bounds_m * MM_PER_M
    sides_mm = (spec.width_mm, spec.depth_mm)
    if (low < -_EDGE_TOLERANCE_MM).any() or (high[:2] > np.add(sides_mm, _EDGE_TOLERANCE_MM)).any():
        message = f"{written.name} reaches beyond the plate"
        raise ItemError(OFF_PLATE, message)


def _mesh(part: Part, offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    return Mesh((part.vertices_mm + offset_mm) / MM_PER_M, part.faces)


def _rows(layout: Layout) -> Iterator[dict[str, Any]]:
    for number, plate in enumerate(layout.plates, 1):
        yield from (table_row(number, _solid_file(number), placed) for placed in plate)


def _differing(layout: Layout, folder: Path) -> Iterator[str]:
    """Name the files that stand where this layout writes other bytes."""
    for number, plate in enumerate(layout.plates, 1):
        solid, picture = folder / _solid_file(number), folder / _map_file(number)
        if solid.exists() and not holds(solid, write_build([_item(placed, layout) for placed in plate])):
            yield solid.name
        if picture.exists() and not holds(picture, _map_of(layout, number)):
            yield picture.name
    table = folder / TABLE_FILE
    if table.exists() and not holds(table, table_csv(_rows(layout))):
        yield table.name


def _strangers(layout: Layout, folder: Path) -> list[str]:
    return [name for name in plates_before(folder) if name not in _names(layout)]


def _names(layout: Layout) -> set[str]:
    numbers = range(1, len(layout.plates) + 1)
    return {name for number in numbers for name in (_solid_file(number), _map_file(number))}


def _solid_file(number: int) -> str:
    return f"plate-{number:02d}.3mf"


def _map_file(number: int) -> str:
    return f"plate-{number:02d}.png"


def _unchecked(_path: Path) -> None:
    """Pictures and tables hold no solid."""
