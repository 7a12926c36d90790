"""The data card of a wrench, and what a wrench is like before or after it is written."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from env_assets.wrench.kind import KIND
from env_assets.wrench.solid import wrench_mesh
from env_assets.wrench.spec import WrenchSpec

if TYPE_CHECKING:
    from tactile_toolkit.mesh.mesh import Mesh
    from tactile_toolkit.mesh.printability import PrintReport
    from tactile_toolkit.store.folder import DataFolder
    from tactile_toolkit.store.manifest import Manifest

__all__ = ["COLUMNS", "WrenchFacts", "wrench_facts", "write_card"]

_PITCH_M = 0.0002
"""Side of a pixel of the picture: the usual wrench of 157.5 mm is 790 pixels long."""
COLUMNS = {
    "id": ("", "0"),
    "label": ("", "the one class"),
    "volume_m3": ("m³", "enclosed volume"),
    "opening_mm": ("mm", "width across flats of the nut that the first jaw takes"),
    "second_opening_mm": ("mm", "the same of the second jaw; 0 where that end is plain"),
    "length_mm": ("mm", "between the outermost points of the circles of both ends"),
    "thickness_mm": ("mm", "height"),
    "jaw_angle_deg": ("degrees", "between handle and jaws"),
}


@dataclass(frozen=True, slots=True, eq=False)
class WrenchFacts:
    """A wrench: its lengths, its solid, and what a printer needs to know about it."""

    spec: WrenchSpec
    mesh: Mesh
    report: PrintReport

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        report = self.report
        return {
            "spec": asdict(self.spec),
            "size_mm": [round(side, 3) for side in report.size_mm],
            "volume_mm3": round(report.volume_mm3, 3),
            "mass_g": round(report.mass_g, 3),
            "thinnest_wall_mm": round(report.thinnest_wall_mm, 3),
            "vertices": report.vertices,
            "faces": report.faces,
            "warnings": list(report.warnings),
        }


def wrench_facts(spec: WrenchSpec) -> WrenchFacts:
    """Make a wrench and inspect it; InputError as :func:`env_assets.wrench_mesh`."""
    from tactile_toolkit.mesh.printability import inspect

    mesh = wrench_mesh(spec)
    return WrenchFacts(spec, mesh, inspect(mesh))


def write_card(folder: DataFolder, manifest: Manifest) -> None:
    """Write ``README.md`` of the folder of a wrench and the picture that it shows."""
    from tactile_toolkit.cards.card import (
        MESH_COLUMNS,
        MESH_TASKS,
        bibtex,
        field_table,
        json_block,
        markdown_table,
        megabytes,
        write_card_files,
    )
    from tactile_toolkit.cards.facts import folder_facts
    from tactile_toolkit.cards.table_card import Terms, write_table_card
    from tactile_toolkit.kind import is_export
    from tactile_toolkit.pictures.relief import relief
    from tactile_toolkit.pictures.writing import png_bytes

    if is_export(manifest):
        text = "The task: Schneider et al. 2025."
        terms = Terms("mit", "MIT, as the toolkit.", text, bibtex("tactile_mnist"))
        write_table_card(folder, manifest, KIND, "Open-end wrench", COLUMNS, terms)
        return
    wrench, facts = wrench_facts(WrenchSpec(**manifest.spec)), folder_facts(folder, manifest)
    spec, report = wrench.spec, wrench.report
    second = f" and {spec.second_opening_mm:g} mm" if spec.second_opening_mm else ", one end plain"
    sizes = [
        (s.split, s.rows, len(s.shards), megabytes(s.file_bytes), megabytes(s.unpacked_bytes))
        for s in facts.splits
    ]
    values = {
        "openings": f"{spec.opening_mm:g} mm{second}",
        "clearance_mm": f"{spec.clearance_mm:g}",
        "jaw_angle_deg": f"{spec.jaw_angle_deg:g}",
        # Of the solid: jaws cut away the outermost points between which the specified length is measured.
        "length_mm": f"{report.size_mm[0]:.1f}",
        "thickness_mm": f"{spec.thickness_mm:g}",
        "chamfer_mm": f"{spec.chamfer_mm:g}",
        "spec": json_block(manifest.spec),
        "split_table": markdown_table(("split", "meshes", "shards", "Parquet", "unpacked"), sizes),
        "field_table": field_table(facts, {**COLUMNS, **MESH_COLUMNS}),
        "size_mm": " x ".join(f"{side:.1f}" for side in report.size_mm),
        "volume_mm3": f"{report.volume_mm3:,.0f}",
        "mass_g": f"{report.mass_g:.1f}",
        "thinnest_wall_mm": f"{report.thinnest_wall_mm:.1f}",
        "warnings": ", ".join(report.warnings) or "none",
        "split": facts.splits[0].split,
    }
    drawn = png_bytes(relief(wrench.mesh.vertices_m, wrench.mesh.faces, _PITCH_M))
    write_card_files(
        folder,
        facts,
        manifest,
        KIND.card_template,
        values,
        ("wrench.png", drawn, "The wrench from above, the first jaw on the right"),
        license="mit",
        pretty_name="Open-end wrench",
        **MESH_TASKS,
        tags=["tactile", "active-perception", "3d", "mesh", "pose-estimation", "3d-printing"],
    )
