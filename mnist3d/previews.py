"""Pictures of digits: contact sheets, single objects, steps, class counts, distributions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mnist3d.columns import REPORT_FILE
from mnist3d.dataset import MeshDataset, MeshRecord
from mnist3d.kind import KIND
from mnist3d.preview_steps import CLAY, draw_steps, source_option
from mnist3d.spec import SolidSpec
from tactile_toolkit.catalog.kinds import specification_read
from tactile_toolkit.errors import InputError
from tactile_toolkit.mesh.files import FORMATS, read_mesh
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.mesh.solid_check import check_manifold
from tactile_toolkit.pictures.plots import Spread, plot_spreads, require_plots
from tactile_toolkit.pictures.previews import (
    MeshPreviews,
    PreviewSpec,
    class_bars,
    draw_by_class,
    draw_two_views,
)
from tactile_toolkit.pictures.render import TOP, Body, Picture3d, fitting_scale, relief_of
from tactile_toolkit.pictures.sheets import Tile, with_scale_bar
from tactile_toolkit.pictures.writing import (
    PicturePlan,
    Pixels,
    PlannedPicture,
    chosen_kinds,
    file_stem,
    plan_kinds,
)
from tactile_toolkit.store.address import is_remote
from tactile_toolkit.store.files import expanded
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.reports import read_report
from tactile_toolkit.wording import class_name, counted

if TYPE_CHECKING:
    from collections.abc import Callable


_KINDS = ("sheet", "object", "steps", "histogram", "distributions")
_IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
_TILE_PX = 132
_PANEL_PX = (560, 520)
_FILLED = 0.9


@dataclass(frozen=True, slots=True)
class DigitPreviewSpec(PreviewSpec):
    """Which pictures of digits to draw; the steps need the files that the images came from."""

    images: Path | None = None
    writer_info: Path | None = None


def plan_previews(name: str, spec: PreviewSpec) -> PicturePlan:
    """Decide which pictures of a data set, a mesh file or an image of a digit to draw; draws none.

    Kinds are sheet, object, steps, histogram and distributions. InputError as
    :class:`~tactile_toolkit.pictures.previews.MeshPreviews`, and where a file cannot be read;
    MissingExtraError where a plot is asked for by name without matplotlib; IntegrityError where the data set
    is damaged or unfinished.
    """
    if is_remote(name):
        return _plan_set(name, spec)
    path = expanded(name)
    if not path.exists():
        raise InputError(
            f"{name!r} does not exist; expected a data set folder, a Parquet file or a mesh file"
        )
    ending = path.suffix.lower()
    if path.is_dir() or ending == ".parquet":
        return _plan_set(name, spec)
    if ending in FORMATS:
        mesh = read_mesh(path)
        return _plan_file("object", name, spec, partial(draw_object, mesh=mesh, title=path.name))
    if ending in _IMAGES:
        from mnist3d.sources.canvas import fit
        from mnist3d.sources.folder import read_picture

        # As the sources do: the numbers of the default specification are for sheets of 500 px.
        pixels = fit(read_picture(path))
        draw = partial(draw_steps, pixels=pixels, spec=SolidSpec(), title=path.name)
        return _plan_file("steps", name, spec, draw)
    known = ", ".join((".parquet", *FORMATS, *_IMAGES))
    found = f"ends in {ending!r}" if ending else "has no ending"
    raise InputError(f"{name!r} {found}; expected a folder, or a file ending in one of {known}")


def _plan_file(kind: str, name: str, spec: PreviewSpec, draw: Callable[[], Pixels]) -> PicturePlan:
    """Plan the one picture that a single file allows; InputError where others were asked for by name."""
    others = [each for each in chosen_kinds(spec.kinds, _KINDS, (kind,)) if each != kind]
    if others and "all" not in spec.kinds:
        raise InputError(
            f"--kind {others[0]} needs a data set, and {name!r} is a single file", next=f"give --kind {kind}"
        )
    for option, value in (("--split", spec.split), ("--ids", spec.ids)):
        if value:
            raise InputError(
                f"{option} chooses from a data set, and {name!r} is a single file", next="leave it out"
            )
    return PicturePlan((PlannedPicture(f"{file_stem(name)}-{kind}.png", Path(name).name, draw),))


def _plan_set(name: str, spec: PreviewSpec) -> PicturePlan:
    opened: MeshPreviews[MeshDataset] = MeshPreviews(KIND, name, spec)
    plans = {
        "sheet": lambda: opened.plan_sheets(
            lambda rows, title: draw_sheet(list(rows), spec.per_class, title, rows.label_names)
        ),
        "object": lambda: [
            PlannedPicture(
                f"{opened.stem}-{split}-{record.id}-object.png",
                f"digit {record.id} from above and obliquely",
                partial(
                    draw_object,
                    mesh=Mesh(record.vertices_m, record.faces),
                    title=_heading(opened, split, record),
                ),
            )
            for split, record in opened.records
        ],
        "steps": lambda: _plan_steps(opened),
        "histogram": lambda: opened.plan_histogram(
            lambda: [class_bars(split, rows, "digits", "class") for split, rows in opened.datasets.items()]
        ),
        "distributions": lambda: [_plan_distributions(opened)],
    }
    usual = ("object",) if spec.ids else ("sheet", "histogram", "distributions")
    return plan_kinds(spec.kinds, plans, usual)


def _plan_steps(opened: MeshPreviews[MeshDataset]) -> list[PlannedPicture]:
    if "source" not in opened.made_by:
        raise InputError(
            f"{opened.name!r} does not name the source of its images", next="give a picture of a digit"
        )
    given = opened.spec if isinstance(opened.spec, DigitPreviewSpec) else DigitPreviewSpec()
    with specification_read(opened.name):
        source = source_option(dict(opened.made_by["source"]), given.images, given.writer_info)
        solid = SolidSpec.from_dict(dict(opened.made_by["solid"]))
    return [
        PlannedPicture(
            f"{opened.stem}-{split}-{record.id}-steps.png",
            f"digit {record.id}, step by step",
            partial(
                draw_steps,
                pixels=source.image(record.id).pixels,
                spec=solid,
                title=_heading(opened, split, record),
            ),
        )
        for split, record in opened.records
    ]


def _plan_distributions(opened: MeshPreviews[MeshDataset]) -> PlannedPicture:
    require_plots("the picture of distributions")
    folder = DataFolder(opened.name)
    if not folder.exists(REPORT_FILE):
        raise InputError(
            f"distributions need {REPORT_FILE}, which {folder.address()!r} does not hold",
            next="give the folder of a data set made by `mnist3d generate`",
        )
    with specification_read(opened.name):
        least_wall_mm = opened.made_by.get("print_profile", {}).get("min_wall_mm")
    return PlannedPicture(
        f"{opened.stem}-distributions.png",
        "height, volume, vertices and thinnest wall",
        lambda: draw_distributions(
            report_rows(folder, tuple(opened.datasets)),
            least_wall_mm,
            f"{opened.stem}: measures of the digits",
        ),
    )


def _heading(opened: MeshPreviews[MeshDataset], split: str, record: MeshRecord) -> str:
    label = class_name(next(iter(opened.datasets.values())).label_names, record.label)
    return f"Digit {label}, id {record.id} ({opened.stem}, {split})"


def draw_sheet(records: Sequence[MeshRecord], per_row: int, title: str, names: Sequence[str]) -> Pixels:
    """Draw digits from above at one scale; ``names`` are those of the classes."""
    meshes = [Mesh(record.vertices_m, record.faces) for record in records]
    px_per_mm = _TILE_PX / (MM_PER_M * max(float(np.ptp(mesh.vertices_m[:, :2], 0).max()) for mesh in meshes))
    tiles = [
        (class_name(names, record.label), Tile(relief_of(mesh, px_per_mm), f"{record.id}"))
        for mesh, record in zip(meshes, records, strict=True)
    ]
    words = f"{counted(len(records), 'digits')} from above, at one scale; the id of each below it"
    return draw_by_class(tiles, per_row, title, words, px_per_mm)


def draw_object(mesh: Mesh, title: str) -> Pixels:
    """Draw a mesh from above and obliquely at one scale, with scale bars and its measures."""
    bodies = (Body(mesh, CLAY),)
    inner_px = (round(_PANEL_PX[0] * _FILLED), round(_PANEL_PX[1] * _FILLED))
    px_per_m = min(fitting_scale(bodies, inner_px, TOP), fitting_scale(bodies, inner_px))
    px_per_mm = px_per_m / MM_PER_M
    relief = relief_of(mesh, px_per_mm)
    canvas = np.full((_PANEL_PX[1], _PANEL_PX[0]), 255, np.uint8)
    top, left = ((room - size) // 2 for room, size in zip(canvas.shape, relief.shape, strict=True))
    canvas[top : top + relief.shape[0], left : left + relief.shape[1]] = relief
    above = Tile(with_scale_bar(canvas, px_per_mm), "shaded relief, from above")
    oblique = Picture3d(bodies, _PANEL_PX, px_per_m)
    return draw_two_views(above, oblique, title, object_facts(mesh))


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


def report_rows(folder: DataFolder, splits: Sequence[str]) -> dict[str, Any]:
    """Read what is drawn of some splits of the report of printability, as Arrow tables by split."""
    import pyarrow.compute as pc

    columns = ["split", "id", "size_z_mm", "volume_mm3", "vertices", "thinnest_wall_mm"]
    report = read_report(folder, REPORT_FILE, columns)
    return {split: report.filter(pc.equal(report["split"], split)) for split in splits}


def draw_distributions(tables: dict[str, Any], least_wall_mm: float | None, title: str) -> Pixels:
    """Draw how height, volume, number of vertices and thinnest wall spread over each split.

    A line marks the wall below which the print profile warns.
    """

    def spread(heading: str, unit: str, column: str, **more: Any) -> Spread:
        groups = [
            (split, np.asarray(table[column].to_numpy())) for split, table in tables.items() if len(table)
        ]
        return Spread(heading, unit, tuple(groups), "digits", **more)

    limit = None if least_wall_mm is None else (least_wall_mm, f"warned of below {least_wall_mm:g} mm")
    panels = (
        spread("Height", "mm", "size_z_mm"),
        spread("Volume", "mm³", "volume_mm3"),
        spread("Vertices", "", "vertices"),
        spread("Thinnest wall", "mm", "thinnest_wall_mm", limit=limit),
    )
    return plot_spreads(panels, title)
