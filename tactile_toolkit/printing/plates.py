"""Build plates in a folder: a 3MF file and a map of each, and a table of which object lies where.

A map is a picture by which printed objects are found.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tactile_toolkit import pictures, store
from tactile_toolkit.array_types import Float64
from tactile_toolkit.errors import ItemError
from tactile_toolkit.mesh import MM_PER_M, BuildItem, Mesh, read_build, require_solid, write_build
from tactile_toolkit.printing.objects import (
    CHANGED,
    FileExport,
    Made,
    Product,
    Progress,
    content_of,
    export,
    place_on_plate,
    require_same_solid,
)
from tactile_toolkit.printing.packing import Layout, Outline, cells_touched
from tactile_toolkit.printing.simulator import body_of, pack_mjcf
from tactile_toolkit.wording import counted

TABLE_FILE = "plates.csv"
OFF_PLATE = "off-plate"
"""What is wrong with a plate beyond what is with a file."""

_EDGE_TOLERANCE_MM = 1e-3  # 3MF is written with nine digits, and no printer knows a micrometre


@dataclass(frozen=True, slots=True)
class PlateFile:
    """A plate: its file (3MF, or MJCF) and PNG map, its objects and which share of it they need.

    ``bytes`` is the size of that file; ``state`` is that of :class:`~tactile_toolkit.printing.objects.Made`.
    """

    file: str
    map: str
    objects: int
    share: float
    bytes: int
    state: str


@dataclass(frozen=True, slots=True)
class PlateExport(FileExport[PlateFile]):
    """What lies on which plate: the plates, the least number of them for these, the rows of the table.

    ``failed`` are objects that were left out and plates that could not be written; ``removed``, files of the
    export that was here before, which this one has not.
    """

    least_plates: int
    objects: tuple[dict[str, Any], ...]
    removed: tuple[str, ...] = ()


def write_plates(
    layout: Layout,
    out: str,
    *,
    overwrite: bool = False,
    dry_run: bool = False,
    on_progress: Progress = lambda _done, _total: None,
) -> PlateExport:
    """Write the plates of a layout into a folder, which is made where it is not there.

    Every object of a 3MF file has to come back as the same solid under the same name, inside the plate; each
    file is read back from disk before it gets its name. Files that are there already with the very same bytes
    are kept. With ``overwrite``, the plates of another export are replaced, and those that this one has not
    are removed: what the table of that export lists, and no other files. A ``dry_run`` makes and checks the
    same plates and changes nothing.

    Raises InputError where plates of another export stand in the folder, before anything is written, and
    StorageError where the folder cannot be written; finished files stay.
    """
    unknown = _unknown_files(layout, store.local_folder(out))
    # The table first: it says most clearly whether these are the plates of another export.
    export([_table_product(tuple(_rows(layout)), unknown)], out, overwrite=overwrite, dry_run=True)
    plates = [
        Product(solid, (solid, picture), partial(_made, layout, number))
        for number, (solid, picture) in enumerate(_names(layout), 1)
    ]
    made = export(plates, out, overwrite=overwrite, dry_run=dry_run, on_progress=on_progress)
    written = {plate.file for plate in made.files}
    rows = tuple(row for row in _rows(layout) if row["file"] in written)
    if not dry_run:
        # Last: what it lists is there and was checked.
        export([_table_product(rows, unknown)], out, overwrite=True)
    return PlateExport(made.files, (*layout.failures, *made.failed), layout.least_plates, rows, unknown)


def _names(layout: Layout) -> list[tuple[str, str]]:
    """Return the files of each plate: its solids and its map."""
    ending = "3mf" if layout.physics is None else "xml"
    plates = [f"plate-{number:02d}" for number in range(1, len(layout.plates) + 1)]
    return [(f"{plate}.{ending}", f"{plate}.png") for plate in plates]


def _made(layout: Layout, number: int) -> Made[PlateFile]:
    (solid, picture), plate = _names(layout)[number - 1], layout.plates[number - 1]
    items = [
        BuildItem(each.item.name, place_on_plate(each.item.load(), layout.scale), each.offset_mm)
        for each in plate
    ]
    if layout.physics is None:
        content = write_build(items)
    else:
        # A scene: where things lie on the plate, they lie on the ground.
        places_m = [(each.offset_mm[0] / MM_PER_M, each.offset_mm[1] / MM_PER_M) for each in items]
        bodies = [body_of(each.name, each.mesh, layout.physics) for each in items]
        content = pack_mjcf(list(zip(bodies, places_m, strict=True)), "plate", floor=True)
    share = round(layout.shares[number - 1], 4)
    return Made(
        {picture: draw_map(layout, number), solid: content},
        partial(PlateFile, solid, picture, len(plate), share, len(content)),
        partial(_check_plate, content, items, layout),
    )


def _check_plate(content: bytes, items: Sequence[BuildItem], layout: Layout) -> None:
    """Raise ItemError where a plate does not hold these objects as the same solids, within its margins."""
    meant = {
        each.name: Mesh(each.mesh.vertices_m + np.divide(each.offset_mm, MM_PER_M), each.mesh.faces)
        for each in items
    }
    found = meant
    if layout.physics is None:
        found = {each.name: each.mesh for each in read_build(content).items}
    if found.keys() != meant.keys():
        raise ItemError(CHANGED, f"it names {len(found)} objects; {len(meant)} others were written")
    edge_mm = layout.spec.margin_mm - _EDGE_TOLERANCE_MM
    for name, mesh in found.items():
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
    writer.writerows({name: _no_formula(value) for name, value in row.items()} for row in rows)
    made = Made({TABLE_FILE: text.getvalue().encode()}, str)
    return Product(TABLE_FILE, (TABLE_FILE, *unknown), lambda: made)


def _no_formula(value: Any) -> Any:
    """Return what a spreadsheet shows as text, where it would run a formula."""
    is_formula = isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r"))
    return f"'{value}" if is_formula else value


def _unknown_files(layout: Layout, folder: Path) -> tuple[str, ...]:
    """Name plates and maps of the export whose table is in the folder that this layout has not."""
    # Files that only have such a name may be any user's.
    table = (content_of(folder / TABLE_FILE) or b"").decode(errors="replace")
    listed = re.findall(r"^\d+,(plate-\d{2,})\.(3mf|xml),", table, re.ASCII | re.MULTILINE)
    before = {f"{plate}.{each}" for plate, ending in listed for each in (ending, "png")}
    ours = {name for names in _names(layout) for name in names}
    return tuple(sorted(name for name in before - ours if (folder / name).exists()))


# --- maps ----------------------------------------------------------------------------------------------

_PLATE, _GRID, _MARGIN, _OUTLINE = "#f4f2ec", "#e0dcd2", "#b9b3a3", "#222222"
# One per class; the words on the map, not the colours, distinguish objects.
_FILLS = (
    *("#9ecae1", "#fdbe85", "#a1d99b", "#fc9f97", "#cbb8dd"),
    *("#d8b49c", "#f5b9d6", "#c4c9cf", "#d9dc8c", "#9fdde2"),
)
# A map is drawn twice as large as it will be, as PIL's own lines have no smooth edges; these are its lengths.
_FINER = 2
_LONGER_SIDE_PX, _LONGEST_SIDE_PX, _LEAST_PX_PER_MM = 2_400, 8_000, 8.0
_EDGE_PX, _TITLE_PX, _NUMBER_PX, _WORD_PX, _LINE_PX = 120, 40, 30, 24, 30
_LINES_TO_A_BAR = 3  # of the grid, along a scale bar as pictures have
_SPOT_PX = 6


def draw_map(layout: Layout, number: int) -> bytes:
    """Draw a plate from above, a PNG file with the front edge at the bottom, as the printer is looked at.

    Classes choose the colours. Where several objects of the export have an id in common, words name the split
    too; words that would cover others are left out and counted. What belongs to one object of several parts
    has a line around it. The same input always gives the same bytes.
    """
    import manifold3d
    from PIL import Image, ImageDraw

    spec, plate = layout.spec, layout.plates[number - 1]
    title = f"plate {number} of {len(layout.plates)}: {counted(len(plate), 'objects')}, {spec.text}"
    every = [placed.item for other in layout.plates for placed in other]
    labels, ids = sorted({item.label for item in every}), Counter(item.id for item in every)
    longer_mm, (width_mm, depth_mm) = max(spec.sides_mm), spec.sides_mm
    # More pixels for a larger plate, so that words keep their room.
    longer_px = min(max(_LONGER_SIDE_PX, _LEAST_PX_PER_MM * longer_mm), _LONGEST_SIDE_PX)
    scale = longer_px / longer_mm
    width_px, depth_px = (round(side * scale) for side in spec.sides_mm)
    sheet_px = max(width_px, round(pictures.text_size(title, _TITLE_PX)[0])) + 2 * _EDGE_PX
    picture = Image.new("RGB", (sheet_px, depth_px + 2 * _EDGE_PX), pictures.PAPER)
    pen = ImageDraw.Draw(picture)

    def places(points_mm: Any) -> list[tuple[float, ...]]:
        """Return where points of the plate, x and y upwards, lie in the picture."""
        found = np.add(np.multiply(points_mm, (scale, -scale)), (_EDGE_PX, _EDGE_PX + depth_px))
        return list(map(tuple, found.tolist()))

    def frame(inset_mm: float, colour: str, width: int, fill: str | None = None) -> None:
        corners = ((inset_mm, depth_mm - inset_mm), (width_mm - inset_mm, inset_mm))
        pen.rectangle(places(corners), fill, colour, width)

    frame(0, _OUTLINE, 0, _PLATE)
    step_mm = pictures.bar_length_mm(round(longer_px / _LINES_TO_A_BAR), scale)
    for axis, anchor, aside_px in ((0, "ma", (0, 16)), (1, "rm", (-16, 0))):
        for at_mm in np.arange(0, spec.sides_mm[axis] + 1e-6, step_mm).tolist():
            ends_mm = np.zeros((2, 2))
            ends_mm[:, axis], ends_mm[1, 1 - axis] = at_mm, spec.sides_mm[1 - axis]
            pen.line(places(ends_mm), _GRID, 2)
            x, y = np.add(places(ends_mm)[0], aside_px).tolist()
            pictures.draw_text(pen, (x, y), f"{at_mm:g}", _NUMBER_PX, anchor=anchor)
    frame(spec.margin_mm, _MARGIN, 2)
    if any(spec.corner_mm):
        pen.rectangle(places(((0, spec.corner_mm[1]), (spec.corner_mm[0], 0))), _MARGIN, _OUTLINE, 2)
    frame(0, _OUTLINE, 4)
    for placed in plate:
        # The hull around several parts is their object's own.
        hull, rings = (
            [np.asarray(ring) for ring in each.section.translate((placed.x_mm, placed.y_mm)).to_polygons()]
            for each in (placed.outline.footprint(), placed.outline)
        )
        corners, fill = places(np.concatenate(rings)), _FILLS[labels.index(placed.item.label) % len(_FILLS)]
        # What lies in a hole stays visible.
        for triangle in manifold3d.triangulate(rings).tolist():
            pen.polygon([corners[corner] for corner in triangle], fill)
        for ring in (*hull, *rings):
            pen.line(places([*ring, ring[0]]), _OUTLINE, 2)
    taken = list[Float64]()
    for placed in plate:
        item = placed.item
        split = [item.split] if item.split and ids[item.id] > 1 else []
        lines = [item.label, str(item.id), *split] if item.label else [item.name]
        spot_mm = np.add(_widest_spot(placed.outline, _SPOT_PX / scale), (placed.x_mm, placed.y_mm))
        middle = np.array(places([spot_mm])[0])
        sides_px = max(pictures.text_size(line, _WORD_PX)[0] for line in lines), len(lines) * _LINE_PX
        box = np.array([middle - np.divide(sides_px, 2), middle + np.divide(sides_px, 2)])
        if all((box[1] < other[0]).any() or (box[0] > other[1]).any() for other in taken):
            taken.append(box)
            for row, line in enumerate(lines):
                at_px = (float(middle[0]), float(box[0, 1]) + (row + 0.5) * _LINE_PX)
                pictures.draw_text(pen, at_px, line, _WORD_PX, anchor="mm", halo_px=4)
    left_out = f"; {len(plate) - len(taken):,} without words, for want of space: plates.csv lists them"
    words = f"front; numbers are mm{left_out if len(taken) < len(plate) else ''}"
    pictures.draw_text(pen, (_EDGE_PX, depth_px + 2 * _EDGE_PX - 20), words, _NUMBER_PX, anchor="ls")
    pictures.draw_text(pen, (_EDGE_PX, _EDGE_PX - 28), title, _TITLE_PX, anchor="ls")
    return pictures.png_bytes(np.asarray(picture.reduce(_FINER)))


def _widest_spot(outline: Outline, cell_mm: float) -> tuple[float, float]:
    """Find where an outline has most room for words, mm."""
    from scipy import ndimage

    columns, rows = (math.ceil(side / cell_mm) for side in outline.size_mm)
    cells = cells_touched([ring / cell_mm for ring in outline.rings], (rows, columns))
    room = ndimage.distance_transform_edt(np.pad(cells, 1))
    row, column = np.unravel_index(int(room.argmax()), room.shape)
    return (float(column) - 0.5) * cell_mm, (float(row) - 0.5) * cell_mm
