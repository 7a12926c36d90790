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
from numpy.typing import NDArray

from tactile_toolkit.errors import ItemError
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.mesh.solid_check import require_solid
from tactile_toolkit.mesh.threemf import BuildItem, read_build, write_build
from tactile_toolkit.printing.objects import (
    CHANGED,
    OFF_PLATE,
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
from tactile_toolkit.printing.simulator import body_of, pack_mjcf
from tactile_toolkit.wording import counted

TABLE_FILE = "plates.csv"

_EDGE_TOLERANCE_MM = 1e-3  # 3MF is written with nine digits, and no printer knows a micrometre


@dataclass(frozen=True, slots=True)
class PlateFile:
    """A plate: its file (3MF, or MJCF) and PNG map, its objects and which share of it they need.

    ``bytes`` is the size of that file; ``state`` is ``"planned"``, ``"written"``, or ``"kept"`` where the
    very same file was there already.
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

    Every object of a 3MF file has to come back as the same solid under the same name, inside the plate; each
    file is read back from disk before it gets its name. Files that are there already with the very same bytes
    are kept. With ``overwrite``, the plates of another export are replaced, and those that this one has not
    are removed: what the table of that export lists, and no other files.

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
    plates = tuple(product.make().record("planned") for product in _products(layout))
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
    (solid, picture), plate = _names(layout)[number - 1], layout.plates[number - 1]
    items = [_item(placed, layout) for placed in plate]
    content = _packed(items, layout)
    share = round(layout.shares[number - 1], 4)
    return Made(
        {picture: _map_of(layout, number), solid: content},
        partial(PlateFile, solid, picture, len(plate), share, len(content)),
        partial(_check_plate, content, items, layout),
    )


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
            body_of(item.name, _mesh(item.vertices_mm, item.faces), layout.physics),
            (item.offset_mm[0] / MM_PER_M, item.offset_mm[1] / MM_PER_M),
        )
        for item in items
    ]
    return pack_mjcf(bodies, "plate", floor=True)


def _map_of(layout: Layout, number: int) -> bytes:
    plate = layout.plates[number - 1]
    title = f"plate {number} of {len(layout.plates)}: {counted(len(plate), 'objects')}, {layout.spec.text}"
    labels = sorted({placed.item.label for other in layout.plates for placed in other})
    counts = Counter(placed.item.id for other in layout.plates for placed in other)
    shared = {identity for identity, count in counts.items() if count > 1}
    return draw_map(plate, layout.spec, title, labels, shared)


def _check_plate(content: bytes, items: Sequence[BuildItem], layout: Layout) -> None:
    """Raise ItemError where a plate does not hold these objects as the same solids, within its margins."""
    meant = {each.name: _mesh(each.vertices_mm + each.offset_mm, each.faces) for each in items}
    found = meant
    if layout.physics is None:
        found = {each.name: _mesh(each.vertices_mm, each.faces) for each in read_build(content)}
    if found.keys() != meant.keys():
        raise ItemError(CHANGED, f"it names {len(found)} objects; {len(meant)} others were written")
    edge_mm = layout.spec.margin_mm - _EDGE_TOLERANCE_MM
    for name, mesh in found.items():
        try:
            require_same_solid(mesh, meant[name], require_solid(meant[name]))
        except ItemError as error:
            raise ItemError(error.reason, f"{name}: {error}") from error
        low, high = mesh.bounds_m * MM_PER_M
        outside = (low[:2] < edge_mm).any() or (high[:2] > np.subtract(layout.spec.sides_mm, edge_mm)).any()
        if outside or low[2] < -_EDGE_TOLERANCE_MM:
            raise ItemError(OFF_PLATE, f"{name} reaches beyond the plate or its margin")


def _mesh(vertices_mm: NDArray[np.float64], faces: NDArray[np.int32]) -> Mesh:
    return Mesh(vertices_mm / MM_PER_M, faces)


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
