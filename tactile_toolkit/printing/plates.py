"""Build plates in a folder: a 3MF file and a map of each, and a table of which object lies where.

A map is a picture by which printed objects are found.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
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
from tactile_toolkit.pictures.sheets import draw_text, png_bytes, text_size
from tactile_toolkit.printing.objects import (
    CHANGED,
    Failure,
    Made,
    Product,
    Progress,
    content_of,
    export,
    local_folder,
    place_on_plate,
    require_same_solid,
)
from tactile_toolkit.printing.packing import Layout, Outline, Placed, cells_touched
from tactile_toolkit.printing.simulator import body_of, pack_mjcf
from tactile_toolkit.printing.spec import PlateSpec
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
    unknown = _unknown_files(layout, local_folder(out))
    # The table first: it says most clearly whether these are the plates of another export.
    export([_table_product(tuple(_rows(layout)), unknown)], out, overwrite=overwrite, dry_run=True)
    made = export(_products(layout), out, overwrite=overwrite, dry_run=dry_run, on_progress=on_progress)
    written = {plate.file for plate in made.files}
    rows = tuple(row for row in _rows(layout) if row["file"] in written)
    if not dry_run:
        # Last: what it lists is there and was checked.
        export([_table_product(rows, unknown)], out, overwrite=True)
    return PlateExport(made.files, layout.least_plates, rows, (*layout.failures, *made.failed), unknown)


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
    items = [
        BuildItem(each.item.name, place_on_plate(each.item.load(), layout.scale), each.offset_mm)
        for each in plate
    ]
    content = _packed(items, layout)
    share = round(layout.shares[number - 1], 4)
    return Made(
        {picture: _map_of(layout, number), solid: content},
        partial(PlateFile, solid, picture, len(plate), share, len(content)),
        partial(_check_plate, content, items, layout),
    )


def _packed(items: Sequence[BuildItem], layout: Layout) -> bytes:
    """Write a plate as 3MF, or as a scene: where things lie on the plate, they lie on the ground."""
    if layout.physics is None:
        return write_build(items)
    bodies = [body_of(item.name, item.mesh, layout.physics) for item in items]
    places_m = [(item.offset_mm[0] / MM_PER_M, item.offset_mm[1] / MM_PER_M) for item in items]
    return pack_mjcf(list(zip(bodies, places_m, strict=True)), "plate", floor=True)


def _map_of(layout: Layout, number: int) -> bytes:
    plate = layout.plates[number - 1]
    title = f"plate {number} of {len(layout.plates)}: {counted(len(plate), 'objects')}, {layout.spec.text}"
    labels = sorted({placed.item.label for other in layout.plates for placed in other})
    counts = Counter(placed.item.id for other in layout.plates for placed in other)
    shared = {identity for identity, count in counts.items() if count > 1}
    return draw_map(plate, layout.spec, title, labels, shared)


def _check_plate(content: bytes, items: Sequence[BuildItem], layout: Layout) -> None:
    """Raise ItemError where a plate does not hold these objects as the same solids, within its margins."""
    meant = {
        each.name: Mesh(each.mesh.vertices_m + np.divide(each.offset_mm, MM_PER_M), each.mesh.faces)
        for each in items
    }
    found = meant
    if layout.physics is None:
        found = {each.name: each.mesh for each in read_build(content)}
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


# --- maps ----------------------------------------------------------------------------------------------

_PAPER, _PLATE, _GRID, _INK = "#ffffff", "#f4f2ec", "#e0dcd2", "#222222"
_MARGIN = "#b9b3a3"
# One per class; the words on the map, not the colours, distinguish objects.
_FILLS = (
    *("#9ecae1", "#fdbe85", "#a1d99b", "#fc9f97", "#cbb8dd"),
    *("#d8b49c", "#f5b9d6", "#c4c9cf", "#d9dc8c", "#9fdde2"),
)
_COARSE_FROM_MM = 50
_LEAST_TICK_PX = 20
_TICKS_MM = (1, 2, 5, 10, 20, 50, 100, 200, 500)
_TICKS_A_NUMBER = 5
_TITLE_PX, _SMALL_PX = 20, 15
_WORDS_PX = (14, 12, 10, 8)
# What words may take on an object that is narrower.
_SLACK_PX = 30
_FIELD_MM = 1.5
_SPOT_MM = 0.5
_MOST_SPOTS = 600

_LONGER_SIDE_PX = 1_200
_LEAST_PX_PER_MM = 4.0
_LONGEST_SIDE_PX = 4_000
_SUPERSAMPLING = 2  # drawn so many times larger: PIL's own lines have no smooth edges
_MARGIN_PX = 60
_LINE_HEIGHT = 1.25


def draw_map(
    plate: Sequence[Placed], spec: PlateSpec, title: str, labels: Sequence[str], shared: Collection[int] = ()
) -> bytes:
    """Draw a plate from above, a PNG file with the front edge at the bottom, as the printer is looked at.

    ``labels`` are all classes, which choose the colours. Where several objects of the export have an id in
    common, one of ``shared``, words name the split too. What belongs to one object of several parts stands on
    a white field of its own. The same input always gives the same bytes.
    """
    import manifold3d

    sheet = _Sheet(spec.sides_mm, title)
    _draw_plate(sheet, spec)
    whole = manifold3d.CrossSection.square(spec.sides_mm)
    for placed in plate:
        if placed.outline.parts > 1:
            # What only it stands on: its hull and a little of the gap around it.
            hull = placed.outline.footprint().grown(min(spec.gap_mm / 2, _FIELD_MM))
            sheet.area((hull.translate((placed.x_mm, placed.y_mm)) ^ whole).to_polygons(), _PAPER)
    for placed in plate:
        rings = placed.outline.section.translate((placed.x_mm, placed.y_mm)).to_polygons()
        sheet.area(rings, _FILLS[labels.index(placed.item.label) % len(_FILLS)])
    _name_objects(sheet, plate, spec, shared)
    return sheet.png()


class _Sheet:
    """A drawing in millimetres, y upwards, below its title; words are in pixels of the finished picture."""

    def __init__(self, sides_mm: tuple[float, float], title: str) -> None:
        from PIL import Image, ImageDraw

        longer_mm = max(sides_mm)
        # More pixels for a larger plate, so that words keep their room.
        longer_px = min(max(_LONGER_SIDE_PX, _LEAST_PX_PER_MM * longer_mm), _LONGEST_SIDE_PX)
        self.px_per_mm = longer_px / longer_mm
        """Of the finished picture."""
        self._scale = self.px_per_mm * _SUPERSAMPLING
        width, depth = (round(side * self._scale) for side in sides_mm)
        words = round(text_size(title, _TITLE_PX * _SUPERSAMPLING)[0])
        margin = _MARGIN_PX * _SUPERSAMPLING
        left = max(margin, (words - width) // 2 + 10 * _SUPERSAMPLING)
        self._front_left = np.array([left, margin + sides_mm[1] * self._scale])
        self.picture = Image.new("RGB", (width + 2 * left, depth + 2 * margin), _PAPER)
        self.draw = ImageDraw.Draw(self.picture)
        self.text((sides_mm[0] / 2, sides_mm[1]), title, _TITLE_PX, anchor="md", shift_px=(0, -14))

    def points(self, *places_mm: Any) -> list[tuple[float, ...]]:
        """Return where points of the plate, each x and y, lie in the picture."""
        places = self._front_left + np.array(places_mm, float) * (self._scale, -self._scale)
        return list(map(tuple, places.tolist()))

    def line(self, *places_mm: Any, colour: str, width: int = 1) -> None:
        """Draw a line, thin by default."""
        self.draw.line(self.points(*places_mm), fill=colour, width=width * _SUPERSAMPLING)

    def area(self, rings_mm: Sequence[NDArray[np.float64]], fill: str) -> None:
        """Fill what rings enclose, of which those that are turned the other way round are holes."""
        import manifold3d

        corners = self.points(*np.concatenate(rings_mm))
        # What lies in a hole stays visible.
        for triangle in manifold3d.triangulate([*rings_mm]).tolist():
            self.draw.polygon([corners[corner] for corner in triangle], fill=fill)
        for ring in rings_mm:
            self.line(*ring, ring[0], colour=_INK)

    def text(
        self,
        place_mm: tuple[float, float],
        line: str,
        size_px: float,
        anchor: str = "mm",
        shift_px: tuple[float, float] = (0, 0),
        halo_px: int = 0,
    ) -> None:
        """Write a line at a point."""
        ((x, y),) = self.points(place_mm)
        at = (x + shift_px[0] * _SUPERSAMPLING, y + shift_px[1] * _SUPERSAMPLING)
        size, halo = round(size_px * _SUPERSAMPLING), halo_px * _SUPERSAMPLING
        draw_text(self.draw, at, line, size, anchor=anchor, halo_px=halo)

    def png(self) -> bytes:
        """Return the finished picture."""
        return png_bytes(np.asarray(self.picture.reduce(_SUPERSAMPLING)))


def _draw_plate(sheet: _Sheet, spec: PlateSpec) -> None:
    width_mm, depth_mm = spec.sides_mm
    # A round distance between ticks that leaves room between them.
    longer_mm = max(width_mm, depth_mm)
    least_mm = max(10 if longer_mm >= _COARSE_FROM_MM else 1, _LEAST_TICK_PX / sheet.px_per_mm)
    step_mm = next(step for step in _TICKS_MM if step >= least_mm)
    sheet.draw.rectangle(sheet.points((0, depth_mm), (width_mm, 0)), fill=_PLATE)
    for x_mm in range(0, int(width_mm) + 1, step_mm):
        sheet.line((x_mm, 0), (x_mm, depth_mm), colour=_GRID)
        if x_mm % (_TICKS_A_NUMBER * step_mm) == 0:
            sheet.text((x_mm, 0), str(x_mm) if x_mm else "0 mm", _SMALL_PX, "ma", (0, 8))
    for y_mm in range(0, int(depth_mm) + 1, step_mm):
        sheet.line((0, y_mm), (width_mm, y_mm), colour=_GRID)
        if y_mm % (_TICKS_A_NUMBER * step_mm) == 0 and y_mm:
            sheet.text((0, y_mm), str(y_mm), _SMALL_PX, "rm", (-8, 0))
    for inset_mm, colour, width in ((spec.margin_mm, _MARGIN, 1), (0.0, _INK, 2)):
        right_mm, back_mm = width_mm - inset_mm, depth_mm - inset_mm
        front = ((inset_mm, inset_mm), (right_mm, inset_mm))
        sheet.line(*front, (right_mm, back_mm), (inset_mm, back_mm), front[0], colour=colour, width=width)
    sheet.text((width_mm / 2, 0), "front", _SMALL_PX, "ma", (0, 30))


def _name_objects(sheet: _Sheet, plate: Sequence[Placed], spec: PlateSpec, shared: Collection[int]) -> None:
    """Write on each object what it is, unless no size is left at which that could be read."""
    taken: list[NDArray[np.float64]] = []
    left_out = 0
    for placed in plate:
        item = placed.item
        middle_mm = np.add(_widest_spot(placed.outline), (placed.x_mm, placed.y_mm))
        split = [item.split] if item.split and item.id in shared else []
        lines = [item.label, str(item.id), *split] if item.label else [item.name]
        # The largest size at which words are hardly wider than their object and on no others.
        room_mm = np.maximum(placed.outline.size_mm, _SLACK_PX / sheet.px_per_mm)
        for size_px in _WORDS_PX:
            step_px = _LINE_HEIGHT * size_px
            width_px = max(text_size(line, round(size_px * _SUPERSAMPLING))[0] for line in lines)
            sides_mm = np.array([width_px / _SUPERSAMPLING, len(lines) * step_px]) / sheet.px_per_mm
            box = np.array([middle_mm - sides_mm / 2, middle_mm + sides_mm / 2])
            is_free = all((box[1] < other[0]).any() or (box[0] > other[1]).any() for other in taken)
            if is_free and (sides_mm <= room_mm).all():
                taken.append(box)
                for number, line in enumerate(lines):
                    shift_px = (0, (number - (len(lines) - 1) / 2) * step_px)
                    sheet.text(tuple(middle_mm), line, size_px, shift_px=shift_px, halo_px=2)
                break
        else:
            left_out += 1
    if left_out:
        words = f"{left_out:,} without words, for want of space: plates.csv lists them"
        sheet.text((spec.width_mm / 2, 0), words, _SMALL_PX, "ma", (0, 44))


def _widest_spot(outline: Outline) -> tuple[float, float]:
    """Find where an outline has most room for words, mm."""
    from scipy import ndimage

    width_mm, depth_mm = outline.size_mm
    spot_mm = max(_SPOT_MM, max(outline.size_mm) / _MOST_SPOTS)
    shape = (math.ceil(depth_mm / spot_mm), math.ceil(width_mm / spot_mm))
    cells = cells_touched([ring / spot_mm for ring in outline.rings], shape)
    room = ndimage.distance_transform_edt(np.pad(cells, 1))
    row, column = np.unravel_index(int(room.argmax()), room.shape)
    return (float(column) - 0.5) * spot_mm, (float(row) - 0.5) * spot_mm
