"""The data card of a wrench."""

from __future__ import annotations

from env_assets.wrench.facts import WrenchFacts, wrench_facts
from env_assets.wrench.spec import WrenchSpec
from tactile_toolkit.cards.card import (
    TACTILE_MNIST,
    Column,
    bibtex,
    field_table,
    json_block,
    markdown_table,
    megabytes,
    picture,
    render_card,
    write_card_text,
)
from tactile_toolkit.cards.facts import FolderFacts, recorded_facts
from tactile_toolkit.cards.head import card_head, head_text
from tactile_toolkit.cards.pictures import PREVIEW_FOLDER, png_bytes, write_previews
from tactile_toolkit.mesh.columns import FACES, VERTICES
from tactile_toolkit.mesh.mesh import Mesh
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest

__all__ = ["write_card"]

_PREVIEW_FILE = f"{PREVIEW_FOLDER}/wrench.png"
_PITCH_M = 0.0002

_COLUMNS: dict[str, Column] = {
    "id": ("", "0"),
    "label": ("", "the one class"),
    VERTICES: ("V x 3, m, frame below", "corner positions"),
    FACES: ("F x 3", "triangles: rows of the corners, counter-clockwise seen from outside"),
    "volume_m3": ("m³", "enclosed volume"),
    "opening_mm": ("mm", "width across flats of the nut that the first jaw takes"),
    "second_opening_mm": ("mm", "the same of the second jaw; 0 where that end is plain"),
    "length_mm": ("mm", "between the outermost points of the circles of both ends"),
    "thickness_mm": ("mm", "height"),
    "jaw_angle_deg": ("degrees", "between handle and jaws"),
}


def write_card(folder: DataFolder, manifest: Manifest) -> None:
    """Write ``README.md`` of the folder of a wrench and the picture that it shows.

    Raises
    ------
    StorageError
        When the folder cannot be written.
    """
    wrench, facts = wrench_facts(WrenchSpec(**manifest.spec)), recorded_facts(folder, manifest)
    write_previews(folder, {_PREVIEW_FILE: _drawn(wrench.mesh)})
    head = card_head(
        facts,
        license="mit",
        pretty_name="Open-end wrench",
        task_categories=["robotics", "reinforcement-learning"],
        task_ids=["task-planning"],
        tags=["tactile", "active-perception", "3d", "mesh", "pose-estimation", "3d-printing"],
    )
    body = render_card("wrench.md", _values(wrench, manifest, facts))
    write_card_text(folder, head_text(head) + "\n" + body)


def _values(wrench: WrenchFacts, manifest: Manifest, facts: FolderFacts) -> dict[str, str]:
    spec, report = wrench.spec, wrench.report
    return {
        "picture": picture(_PREVIEW_FILE, "The wrench from above, the first jaw on the right"),
        "version": manifest.toolkit_version,
        "schema_version": str(manifest.schema_version),
        "openings": _openings(spec),
        "clearance_mm": f"{spec.clearance_mm:g}",
        "jaw_angle_deg": f"{spec.jaw_angle_deg:g}",
        # Of the solid: jaws cut away the outermost points between which the specified length is measured.
        "length_mm": f"{report.size_mm[0]:.1f}",
        "thickness_mm": f"{spec.thickness_mm:g}",
        "chamfer_mm": f"{spec.chamfer_mm:g}",
        "spec": json_block(manifest.spec),
        "split_table": _split_table(facts),
        "field_table": field_table(facts, _COLUMNS, {}),
        "size_mm": " x ".join(f"{side:.1f}" for side in report.size_mm),
        "volume_mm3": f"{report.volume_mm3:,.0f}",
        "mass_g": f"{report.mass_g:.1f}",
        "thinnest_wall_mm": f"{report.thinnest_wall_mm:.1f}",
        "warnings": ", ".join(report.warnings) or "none",
        "split": facts.splits[0].split,
        "bibtex": bibtex(TACTILE_MNIST),
    }


def _openings(spec: WrenchSpec) -> str:
    first = f"{spec.opening_mm:g} mm"
    return (
        f"{first} and {spec.second_opening_mm:g} mm" if spec.second_opening_mm else f"{first}, one end plain"
    )


def _split_table(facts: FolderFacts) -> str:
    header = ("split", "meshes", "shards", "Parquet", "unpacked")
    rows = [
        (s.split, s.rows, len(s.shards), megabytes(s.file_bytes), megabytes(s.unpacked_bytes))
        for s in facts.splits
    ]
    return markdown_table(header, rows)


def _drawn(mesh: Mesh) -> bytes:
    from PIL import Image

    from tactile_toolkit.pictures.relief import relief

    return png_bytes(Image.fromarray(relief(mesh.vertices_m, mesh.faces, _PITCH_M)))
