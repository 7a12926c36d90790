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


_PITCH_M = 0.0002
"""Side of a pixel of the picture: the usual wrench of 157.5 mm is 790 pixels long."""


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
    from env_assets.wrench.columns import WrenchRow
    from tactile_toolkit.cards.card import Card, write_table_card
    from tactile_toolkit.cards.facts import folder_facts
    from tactile_toolkit.kind import is_copy
    from tactile_toolkit.pictures.render import relief
    from tactile_toolkit.pictures.writing import png_bytes
    from tactile_toolkit.rows import meanings

    columns, title = meanings(WrenchRow), "Open-end wrench"
    if is_copy(manifest):
        terms = {
            "licence_text": "MIT, as the toolkit.",
            "citation_text": "The task: Schneider et al. 2025.",
        }
        write_table_card(folder, manifest, KIND, title, columns, "mit", **terms)
        return
    wrench, facts = wrench_facts(WrenchSpec(**manifest.spec)), folder_facts(folder, manifest)
    spec, report = wrench.spec, wrench.report
    second = f" and {spec.second_opening_mm:g} mm" if spec.second_opening_mm else ", one end plain"
    drawn = png_bytes(relief(wrench.mesh.vertices_m, wrench.mesh.faces, _PITCH_M))
    Card(
        template=KIND.card_template,
        title=title,
        columns=columns,
        picture=("wrench.png", drawn, "The wrench from above, the first jaw on the right"),
        licence="mit",
        tags=["tactile", "active-perception", "3d", "mesh", "pose-estimation", "3d-printing"],
        values={
            **{name: f"{value:g}" for name, value in asdict(spec).items()},
            "openings": f"{spec.opening_mm:g} mm{second}",
            # Of the solid: jaws cut away the outermost points between which the specified length is measured.
            "length_mm": f"{report.size_mm[0]:.1f}",
            "size_mm": " x ".join(f"{side:.1f}" for side in report.size_mm),
            "volume_mm3": f"{report.volume_mm3:,.0f}",
            "mass_g": f"{report.mass_g:.1f}",
            "thinnest_wall_mm": f"{report.thinnest_wall_mm:.1f}",
            "warnings": ", ".join(report.warnings) or "none",
        },
    ).write(folder, facts, manifest, KIND)
