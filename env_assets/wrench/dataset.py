"""A wrench as a data set of one row: its columns, records, generator and card."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pyarrow as pa
from manifold3d import CrossSection, JoinType, triangulate

from env_assets.wrench.kind import CHAMFER_MM, JAW_ANGLE_DEG, KIND, WrenchSpec
from mnist3d import digit_checks
from tactile_toolkit import cards, gallery, generation, mesh, pictures, places, rows, store
from tactile_toolkit.arithmetic import cosine_sine
from tactile_toolkit.value_types import Float64, Int64, JsonDict

# Sides of a full circle: 0.02 mm from round at 60 mm across, less than a printer can show.
_SEGMENTS = 96
# Corners that deviate less than this from a straight line are dropped.
_TIDY_MM = 1e-3


class WrenchRecord(pictures.DrawnSolid):
    """One wrench.

    Frame of the mesh: origin on the axis of the handle, halfway along the length, x along the handle towards
    the first jaw, z up, lowest point at z = 0; metres.
    """

    __slots__ = ()

    @property
    def opening_mm(self) -> float:
        """Width across flats of the first jaw, millimetres."""
        return float(self.row.required("opening_mm"))

    @property
    def second_opening_mm(self) -> float:
        """Width across flats of the second jaw, millimetres."""
        return float(self.row.required("second_opening_mm"))

    def __repr__(self) -> str:
        return f"WrenchRecord(id={self.id}, {self.opening_mm:g} mm, {len(self.faces):,} faces)"

    def caption(self, label_names: Sequence[str] = ()) -> str:
        """Return the width of the first jaw."""
        return f"wrench, {self.opening_mm:g} mm"


class WrenchDataset(mesh.SolidDataset[WrenchRecord]):
    """A lazy sequence of :class:`WrenchRecord`."""

    record_class = WrenchRecord
    things = "wrenches"


load = places.loader(KIND, WrenchDataset, WrenchRecord)


def check_content(
    source: places.Place,
    split: str | None,
    limit: int | None,
    workers: int,
    *,
    on_progress: Callable[[int, int], None],
) -> digit_checks.CheckedMeshes:
    """Check that each wrench is a solid that prints well, as :func:`mnist3d.digit_checks.check_content`."""
    return digit_checks.check_meshes(source, KIND, split, limit, workers, mesh.PrintProfile(), on_progress)


class WrenchRow(mesh.MeshRow):
    """One wrench; columns in mm and degrees are values of its specification."""

    id: int = rows.column(pa.int64(), "", "0")
    label: int = rows.column(pa.int64(), "", "the one class")
    volume_m3: float = rows.column(pa.float64(), "m³", "enclosed volume")
    opening_mm: float = rows.column(
        pa.float64(), "mm", "width across flats of the nut that the first jaw takes"
    )
    second_opening_mm: float = rows.column(pa.float64(), "mm", "the same of the second jaw")
    length_mm: float = rows.column(
        pa.float64(), "mm", "between the outermost points of the circles of both ends"
    )
    thickness_mm: float = rows.column(pa.float64(), "mm", "height")
    jaw_angle_deg: float = rows.column(pa.float64(), "degrees", "between handle and jaws")


def wrench_schema(_manifest: object = None) -> pa.Schema:
    """Return the Arrow schema of the shard."""
    return WrenchRow.schema(KIND.class_names)


@dataclass(frozen=True)
class WrenchGenerator(generation.RowGenerator):
    """Makes the row of a wrench."""

    spec: WrenchSpec
    kind = KIND

    def items(self) -> Mapping[str, range]:
        """Return one item, in the split of the published wrench."""
        return {"train": range(1)}

    def layout(self) -> generation.StorageLayout:
        """Return the storage layout of the row."""
        style = store.ParquetStyle(rows_per_group=32, compression="zstd", compression_level=9)
        return generation.StorageLayout(style, libraries=("manifold3d", "numpy", "pillow", "pyarrow"))

    def schema(self, split: str) -> pa.Schema:
        """Return the Arrow schema of the shard."""
        return wrench_schema()

    def make(self, split: str, items: Sequence[int]) -> list[WrenchRow]:
        """Make the row."""
        wrench = wrench_mesh(self.spec)
        lengths = self.spec.lengths()
        return [
            WrenchRow(
                id=0,
                label=0,
                vertices_m=wrench.vertices_m,
                faces=wrench.faces,
                volume_m3=wrench.volume_m3,
                **{name: lengths[name] for name in WrenchRow.__annotations__ if name in lengths},
            )
        ]


def write_wrench(spec: WrenchSpec, out: str, *, overwrite: bool = False) -> store.Manifest:
    """Write a data set of one wrench.

    Parameters
    ----------
    spec : WrenchSpec
        Sizes of its nuts.
    out : str
        Folder to write; a folder that holds the same wrench stays as it is.
    overwrite : bool
        Replace another data set of this toolkit in the folder.

    Returns
    -------
    Manifest
        Manifest of the folder.

    Raises
    ------
    InputError
        The folder holds something else.
    SpecMismatchError
        The folder holds another wrench.
    StorageError
        The folder cannot be written.

    Notes
    -----
    Equal specifications give byte-identical Parquet.
    """
    return WrenchGenerator(spec).generate(out, overwrite=overwrite)


def default_set(seed: int, per_class: int | None) -> generation.DefaultSet:
    """Return the default wrench, which has neither a seed nor classes."""
    return generation.DefaultSet(WrenchGenerator(WrenchSpec()))


def wrench_facts(spec: WrenchSpec, report: mesh.PrintReport) -> JsonDict:
    """Return lengths, solid and printability of a wrench as JSON values."""
    return {
        "spec": spec.lengths(),
        "size_mm": [round(side, 3) for side in report.size_mm],
        **{name: round(getattr(report, name), 3) for name in ("volume_mm3", "mass_g", "thinnest_wall_mm")},
        "vertices": report.vertices,
        "faces": report.faces,
        "warnings": list(report.warnings),
    }


def write_card(folder: store.DataFolder, manifest: store.Manifest) -> None:
    """Write ``README.md`` of the folder of a wrench and its picture."""
    columns = WrenchRow.meanings()
    title = "Open-end wrench"
    if manifest.is_copy:
        terms = {
            "licence_text": "MIT, as the toolkit.",
            "citation_text": "The task: Schneider et al. 2025.",
        }
        cards.Card.of_copy(manifest, KIND, title, columns, "mit", **terms).write(folder, manifest, KIND)
        return
    spec = WrenchSpec(**manifest.spec)
    report = mesh.PrintReport.of(wrench_mesh(spec))
    cards.Card(
        template=KIND.card_template,
        title=title,
        columns=columns,
        picture=("wrench.png", "The wrench from above, the first jaw on the right"),
        licence="mit",
        tags=["tactile", "active-perception", "3d", "mesh", "pose-estimation", "3d-printing"],
        values={
            **{name: f"{value:g}" for name, value in spec.lengths().items()},
            "openings": f"{spec.opening_mm:g} mm and {spec.second_opening_mm:g} mm",
            # Measured on the solid: jaws cut away the outermost points, to which the specified length refers.
            "length_mm": f"{report.size_mm[0]:.1f}",
            "size_mm": " x ".join(f"{side:.1f}" for side in report.size_mm),
            "volume_mm3": f"{report.volume_mm3:,.0f}",
            "mass_g": f"{report.mass_g:.1f}",
            "thinnest_wall_mm": f"{report.thinnest_wall_mm:.1f}",
            "warnings": ", ".join(report.warnings) or "none",
        },
    ).write(folder, manifest, KIND)


def wrench_mesh(spec: WrenchSpec) -> mesh.Mesh:
    """Make the solid of a wrench.

    Parameters
    ----------
    spec : WrenchSpec
        Sizes of its nuts.

    Returns
    -------
    Mesh
        Float32 metres. Frame: origin on the axis of the handle, halfway along the length; x along the handle
        towards the first jaw, z up, the wrench lying on z = 0. A published environment that estimates poses
        takes origin and x axis of this frame as the pose.
    """
    return _chamfered_plate(_outline(spec), spec.lengths()["thickness_mm"])


def _outline(spec: WrenchSpec) -> list[Float64]:
    """Draw a wrench: closed lines in millimetres, shapes (n, 2), the material on their left."""
    lengths = spec.lengths()
    length_mm, handle_mm = lengths["length_mm"], lengths["handle_mm"]
    first_mm = (length_mm - lengths["head_mm"]) / 2
    second_mm = (lengths["second_head_mm"] - length_mm) / 2
    body = CrossSection.square((first_mm - second_mm, handle_mm)).translate((second_mm, -handle_mm / 2))
    for centre_mm, diameter_mm in ((first_mm, lengths["head_mm"]), (second_mm, lengths["second_head_mm"])):
        body += CrossSection.circle(diameter_mm / 2, _SEGMENTS).translate((centre_mm, 0.0))
    # Growing and shrinking it again rounds inner corners with the radius.
    body = _grown(_grown(body, lengths["fillet_mm"]), -lengths["fillet_mm"])
    jaws = ((first_mm, spec.opening_mm, 0.0), (second_mm, spec.second_opening_mm, 180.0))
    for centre_mm, opening_mm, turned_deg in jaws:
        jaw = _jaw(opening_mm, spec.clearance_mm, length_mm).rotate(turned_deg + JAW_ANGLE_DEG)
        body -= jaw.translate((centre_mm, 0.0))
    # Tips of jaws are rounded as wide as the chamfer needs; no jaw gets shorter than the sides of its nut.
    tidy = _opened(body, 2.0 * CHAMFER_MM).simplify(_TIDY_MM)
    return [np.asarray(line, np.float64) for line in tidy.to_polygons()]


def _jaw(opening_mm: float, clearance_mm: float, length_mm: float) -> CrossSection:
    """Return the space that a nut needs: its hexagon, and the opening of the jaw along x."""
    width_mm = opening_mm + clearance_mm
    # Not by numpy's cosine, which processors round differently: the bytes are the same on all.
    corners = width_mm / math.sqrt(3) * np.array([cosine_sine(math.tau * side / 6) for side in range(6)])
    channel = CrossSection.square((length_mm, width_mm)).translate((0.0, -width_mm / 2))
    # A round root breaks less easily than a sharp one, and a printer rounds it anyway.
    return _opened(CrossSection([corners]) + channel, 0.1 * opening_mm)


def _opened(shape: CrossSection, radius_mm: float) -> CrossSection:
    """Round outer corners with a radius."""
    return _grown(_grown(shape, -radius_mm), radius_mm)


def _grown(shape: CrossSection, by_mm: float) -> CrossSection:
    return shape.offset(by_mm, JoinType.Round, 2.0, _SEGMENTS)


def _chamfered_plate(outline: Sequence[Float64], thickness_mm: float) -> mesh.Mesh:
    """Make a plate that lies on z = 0, its edges cut at 45 degrees above and below; float32 metres."""
    # As many corners as the outline, so that levels are joined corner by corner: offsets of manifold3d add
    # and drop some.
    inner = [_moved_in(line) for line in outline]
    levels = (
        (inner, 0.0),
        (outline, CHAMFER_MM),
        (outline, thickness_mm - CHAMFER_MM),
        (inner, thickness_mm),
    )
    vertices_mm = np.concatenate(
        [np.insert(np.concatenate(lines), 2, z_mm, axis=1) for lines, z_mm in levels]
    )
    # Bottom, top and sides.
    top = np.asarray(triangulate(inner), np.int64)
    above = (len(levels) - 1) * sum(map(len, inner))
    faces = [top[:, ::-1], top + above, *_sides(outline, len(levels))]
    return mesh.Mesh((vertices_mm / mesh.MM_PER_M).astype(np.float32), np.concatenate(faces).astype(np.int32))


def _moved_in(line: Float64) -> Float64:
    """Move every side of a closed line to its left by the chamfer; corners keep their number."""
    along = np.roll(line, -1, axis=0) - line
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    left = np.stack([-along[:, 1], along[:, 0]], axis=1)
    before = np.roll(left, 1, axis=0)
    corners = (before + left) / (1.0 + (before * left).sum(axis=1, keepdims=True))
    return np.asarray(line + CHAMFER_MM * corners)


def _sides(lines: Sequence[Float64], levels: int) -> list[Int64]:
    """Return the triangles between levels, two for each side of each line."""
    per_level = sum(map(len, lines))
    triangles = []
    start = 0
    for line in lines:
        corners = start + np.arange(len(line))
        following = np.roll(corners, -1)
        for level in range(levels - 1):
            low = level * per_level
            high = (level + 1) * per_level
            triangles.append(np.stack([corners + low, following + low, following + high], axis=1))
            triangles.append(np.stack([corners + low, following + high, corners + high], axis=1))
        start += len(line)
    return triangles


_SHOWN = [mesh.PrintReport.columns()[name] for name in ("volume_mm3", "vertices", "faces")]
plan_gallery = partial(gallery.Gallery.of_solids, KIND, title="Wrenches", columns=_SHOWN)
