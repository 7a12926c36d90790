"""Build plates in a folder: a 3MF file and a map of each, and a table of which object lies where."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tactile_toolkit.errors import ItemError
from tactile_toolkit.mesh.files import BROKEN_FILE
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.mesh.solid_check import require_solid
from tactile_toolkit.mesh.threemf import BuildItem, read_build, write_build
from tactile_toolkit.printing.objects import (
    CHANGED,
    OFF_PLATE,
    UNREADABLE,
    Failure,
    Made,
    Product,
    Progress,
    content_of,
    export,
    local_folder,
    place_on_plate,
    require_free,
    require_same_solid,
)
from tactile_toolkit.printing.packing import Layout, Placed
from tactile_toolkit.printing.plate_map import draw_map
from tactile_toolkit.printing.simulator import body_of, pack_mjcf, read_mjcf
from tactile_toolkit.printing.spec import PlateSpec
from tactile_toolkit.wording import counted

TABLE_FILE = "plates.csv"
# Objects that a forecast packs to estimate the size of all.
_SAMPLED = 4

_EDGE_TOLERANCE_MM = 1e-3  # 3MF is written with nine digits, and no printer knows a micrometre


@dataclass(frozen=True, slots=True)
class PlateFile:
    """A plate: its file (3MF, or MJCF) and PNG map, its objects and which share of it they need.

    ``bytes`` is the size of that file, about, where ``state`` is ``"planned"``; ``"written"`` and
    ``"kept"``, where the very same file was there already, are the others.
    """

    file: str
    map: str
    objects: int
    share: float
    bytes: int
    state: str


@dataclass(frozen=True, slots=True)
class PlateExport:
    """What lies on which plate: the plates, the least number of them for these, and the rows of the table.

    ``failed`` are objects that were left out and plates that could not be written; ``removed``, files of the
    export that was here before, which this one has not.
    """

    plates: tuple[PlateFile, ...]
    least_plates: int
    objects: tuple[dict[str, Any], ...]
    failed: tuple[Failure, ...]
    removed: tuple[str, ...] = ()


def write_plates(
    layout: Layout,
    out: str,
    *,
    overwrite: bool = False,
    on_progress: Progress = lambda _done, _total: None,
) -> PlateExport:
    """Write the plates of a layout into a folder, which is made where it is not there.

    Each 3MF file is read back from disk: every object has to be the same solid under the same name, and
    inside the plate, before the file gets its name. Files that are there already with the very same bytes are
    kept. With ``overwrite``, the plates of another export are replaced, and those that this one has not are
    removed: what the table of that export lists, and no other files.

    Raises InputError where plates of another export stand in the folder, before anything is written, and
    StorageError where the folder cannot be written; finished files stay.
    """
    unknown = _unknown_files(layout, local_folder(out))
    if not overwrite:
        require_free([_table_product(tuple(_rows(layout)), unknown)], out)
    plates, failures = export(_products(layout), out, overwrite=overwrite, on_progress=on_progress)
    written = {plate.file for plate in plates}
    rows = tuple(row for row in _rows(layout) if row["file"] in written)
    # Last: what it lists is there and was checked.
    export([_table_product(rows, unknown)], out, overwrite=True)
    return PlateExport(tuple(plates), layout.least_plates, rows, (*layout.failures, *failures), unknown)


def forecast_plates(layout: Layout, out: str, *, overwrite: bool = False) -> PlateExport:
    """Forecast what :func:`write_plates` would write.

    Raises InputError where plates of another export stand in the folder.
    """
    rows, unknown = tuple(_rows(layout)), _unknown_files(layout, local_folder(out))
    if not overwrite:
        require_free(_products(layout), out)
        require_free([_table_product(rows, unknown)], out)
    sample = [placed for plate in layout.plates for placed in plate][:_SAMPLED]
    each = sum(len(_packed([_item(placed, layout)], layout)) for placed in sample) / max(len(sample), 1)
    plates = tuple(
        _plate_file(layout, number, round(each * len(plate)), "planned")
        for number, plate in enumerate(layout.plates, 1)
    )
    return PlateExport(plates, layout.least_plates, rows, layout.failures, unknown)


def _products(layout: Layout) -> list[Product[PlateFile]]:
    return [
        Product(solid, (solid, picture), partial(_made, layout, number))
        for number, (solid, picture) in enumerate(_names(layout), 1)
    ]


def _names(layout: Layout) -> list[tuple[str, str]]:
    """Return the files of each plate: its solids and its map."""
    ending = "3mf" if layout.physics is None else "xml"
    plates = [f"plate-{number:02d}" for number in range(1, len(layout.plates) + 1)]
    return [(f"{plate}.{ending}", f"{plate}.png") for plate in plates]


def _made(layout: Layout, number: int) -> Made[PlateFile]:
    solid, picture = _names(layout)[number - 1]
    items = [_item(placed, layout) for placed in layout.plates[number - 1]]
    content = _packed(items, layout)
    return Made(
        {picture: _map_of(layout, number), solid: content},
        partial(_plate_file, layout, number, len(content)),
        partial(_check_plate, items=items, spec=layout.spec),
    )


def _plate_file(layout: Layout, number: int, size_bytes: int, state: str) -> PlateFile:
    names, share = _names(layout)[number - 1], round(layout.shares[number - 1], 4)
    return PlateFile(*names, len(layout.plates[number - 1]), share, size_bytes, state)


def _item(placed: Placed, layout: Layout) -> BuildItem:
    mesh = place_on_plate(placed.item.load(), layout.scale)
    # Adding zero writes -0 as 0, as plates always had it: the bytes of an export stay those of the last one.
    return BuildItem(placed.item.name, mesh.vertices_mm + 0.0, mesh.faces, placed.offset_mm)


def _packed(items: Sequence[BuildItem], layout: Layout) -> bytes:
    """Write a plate as 3MF, or as a scene: where things lie on the plate, they lie on the ground."""
    if layout.physics is None:
        return write_build(items)
    bodies = [
        (
            body_of(item.name, Mesh(item.vertices_mm / MM_PER_M, item.faces), layout.physics),
            (item.offset_mm[0] / MM_PER_M, item.offset_mm[1] / MM_PER_M),
        )
        for item in items
    ]
    return pack_mjcf(bodies, "plate", floor=True)


def _unpacked(content: bytes) -> list[BuildItem]:
    if content.startswith(b"PK"):
        return read_build(content)
    return [BuildItem(name, mesh.vertices_mm, mesh.faces) for name, mesh in read_mjcf(content).items()]


def _map_of(layout: Layout, number: int) -> bytes:
    plate = layout.plates[number - 1]
    title = f"plate {number} of {len(layout.plates)}: {counted(len(plate), 'objects')}, {layout.spec.text}"
    labels = sorted({placed.item.label for other in layout.plates for placed in other})
    counts = Counter(placed.item.id for other in layout.plates for placed in other)
    shared = {identity for identity, count in counts.items() if count > 1}
    return draw_map(plate, layout.spec, title, labels, shared)


def _check_plate(path: Path, items: Sequence[BuildItem], spec: PlateSpec) -> None:
    try:
        found = _unpacked(path.read_bytes())
    except BROKEN_FILE as error:
        raise ItemError(
            UNREADABLE, f"it is not a readable {path.suffix[1:].upper()} file ({error})"
        ) from error
    if [item.name for item in found] != [item.name for item in items]:
        raise ItemError(CHANGED, f"it names {len(found)} objects; {len(items)} others were written")
    for back_item, item in zip(found, items, strict=True):
        meant = Mesh((item.vertices_mm + item.offset_mm) / MM_PER_M, item.faces)
        back = Mesh(back_item.vertices_mm / MM_PER_M, back_item.faces)
        try:
            require_same_solid(back, meant, require_solid(meant))
        except ItemError as error:
            raise ItemError(error.reason, f"{item.name}: {error}") from error
        low, high = back.bounds_m * MM_PER_M
        edge_mm = spec.margin_mm - _EDGE_TOLERANCE_MM
        outside = (low[:2] < edge_mm).any() or (high[:2] > np.subtract(spec.sides_mm, edge_mm)).any()
        if outside or low[2] < -_EDGE_TOLERANCE_MM:
            raise ItemError(OFF_PLATE, f"{item.name} reaches beyond the plate or its margin")


_COLUMNS = (
    *("plate", "file", "name", "split", "label", "id"),
    *("x_mm", "y_mm", "width_mm", "depth_mm", "height_mm", "volume_mm3"),
)


def _rows(layout: Layout) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table; x and y are the lower left corner of the bounding box on the plate."""
    for number, (plate, (solid, _)) in enumerate(zip(layout.plates, _names(layout), strict=True), 1):
        for placed in plate:
            item = placed.item
            named = (number, solid, item.name, item.split, item.label, item.id)
            sizes_mm = (*placed.outline.size_mm, placed.height_mm)
            measured = (placed.x_mm, placed.y_mm, *sizes_mm, placed.volume_mm3)
            values = (*named, *(round(value, 3) for value in measured))
            yield dict(zip(_COLUMNS, values, strict=True))


def _table_product(rows: Sequence[dict[str, Any]], unknown: Sequence[str]) -> Product[str]:
    """Return the table as a product, which plates that it does not list are not to stand next to."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    made = Made({TABLE_FILE: text.getvalue().encode()}, str)
    return Product(TABLE_FILE, (TABLE_FILE, *unknown), lambda: made)


def _unknown_files(layout: Layout, folder: Path) -> tuple[str, ...]:
    """Name plates and maps of the export whose table is in the folder that this layout has not."""
    # Files that only have such a name may be any user's.
    table = (content_of(folder / TABLE_FILE) or b"").decode(errors="replace")
    listed = re.findall(r"^\d+,(plate-\d{2,})\.(3mf|xml),", table, re.ASCII | re.MULTILINE)
    before = {f"{plate}.{each}" for plate, ending in listed for each in (ending, "png")}
    ours = {name for names in _names(layout) for name in names}
    return tuple(sorted(name for name in before - ours if (folder / name).exists()))
