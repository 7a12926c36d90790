"""A wrench as a data set of one row: its columns, records, generator and card."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from env_assets.wrench import kind, shape
from env_assets.wrench.kind import KIND
from tactile_toolkit import cards, generation, mesh, pictures, places, rows, store
from tactile_toolkit.json_types import JsonDict
from tactile_toolkit.kind import is_copy
from tactile_toolkit.mesh import MeshRow, PrintReport, inspect, write_mesh


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


load = places.loader(KIND, WrenchDataset, mesh.RecordStream[WrenchRecord])


@rows.row
class WrenchRow(MeshRow):
    """One wrench; columns in mm and degrees are lengths of its specification."""

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

    spec: kind.WrenchSpec
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
        wrench = shape.wrench_mesh(self.spec)
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


def write_wrench(
    spec: kind.WrenchSpec, out: str, *, mesh_file: str | Path | None = None, overwrite: bool = False
) -> store.Manifest:
    """Write a data set of one wrench.

    Parameters
    ----------
    spec : WrenchSpec
        Sizes of its nuts.
    out : str
        Folder to write; a folder that holds the same wrench stays as it is.
    mesh_file : path, optional
        Also write only the mesh, for a printer: a file with one of the endings of
        :data:`tactile_toolkit.mesh.MeshFile.FORMATS`.
    overwrite : bool
        Replace another data set of this toolkit in the folder.

    Returns
    -------
    Manifest
        Manifest of the folder.

    Raises
    ------
    InputError
        The folder holds something else, or the ending of the file is unknown.
    SpecMismatchError
        The folder holds another wrench.
    StorageError
        The folder or the file cannot be written.

    Notes
    -----
    Equal specifications give byte-identical Parquet.
    """
    if mesh_file is not None:  # before the folder, so that a refusal leaves nothing behind
        write_mesh(store.expanded(mesh_file), shape.wrench_mesh(spec))
    return WrenchGenerator(spec).generate(out, overwrite=overwrite)


def wrench_recipe(seed: int, per_class: int | None) -> generation.Recipe:
    """Return the recipe of the default wrench, which has neither a seed nor classes."""
    return generation.Recipe(WrenchGenerator(kind.WrenchSpec()))


def wrench_facts(spec: kind.WrenchSpec, report: PrintReport) -> JsonDict:
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
    if is_copy(manifest):
        terms = {
            "licence_text": "MIT, as the toolkit.",
            "citation_text": "The task: Schneider et al. 2025.",
        }
        cards.Card.of_copy(manifest, KIND, title, columns, "mit", **terms).write(folder, manifest, KIND)
        return
    spec = kind.WrenchSpec(**manifest.spec)
    report = inspect(shape.wrench_mesh(spec))
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
