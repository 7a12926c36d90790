"""The card of copies of data sets of meshes: tables for other libraries, several sets as one, some rows."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from tactile_toolkit.cards.card import Card, Column, first_rows
from tactile_toolkit.cards.facts import FolderFacts, folder_facts
from tactile_toolkit.kind import DatasetKind, is_export
from tactile_toolkit.mesh.columns import FACES, MESH, SIZES, VERTICES
from tactile_toolkit.pictures.render import relief
from tactile_toolkit.pictures.sheets import Sheet, Tile, sheet
from tactile_toolkit.pictures.writing import png_bytes
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.manifest import Manifest

_COLUMNS: dict[str, Column] = {
    "label_name": ("", "name of the class"),
    **{name: ("m", f"extent along {name[5]}") for name in SIZES},
    f"{MESH}": ("GLB file, m, frame below", "the solid, its vertices and faces in their order"),
}
_SHOWN = 10
_TILE_PX = 120


@dataclass(frozen=True, slots=True)
class Terms:
    """What a card says of whose the data are: the Hub's word for the licence, and sentences."""

    licence: str
    licence_text: str
    citation_text: str
    bibtex: str

    def values(self) -> dict[str, str]:
        """Return what fills the placeholders of a template."""
        return {
            "licence_text": self.licence_text,
            "citation_text": self.citation_text,
            "bibtex": self.bibtex,
        }


def write_table_card(
    folder: DataFolder,
    manifest: Manifest,
    kind: DatasetKind,
    title: str,
    columns: Mapping[str, Column],
    terms: Terms,
) -> None:
    """Write ``README.md``, its picture and ``croissant.json`` of a copy; IntegrityError for a damaged one.

    ``columns`` are those of the data set that it was made of, ``title`` is its name.
    """
    facts, source = folder_facts(folder, manifest), manifest.spec["source"]
    command, template, name = manifest.spec["operation"], "mesh_copy.md", "objects.png"
    further: Mapping[str, Column] = {}
    if is_export(manifest):
        command, template, name, further = "export --format flat", "mesh_tables.md", "tables.png", _COLUMNS
    rows = ", ".join(f"{split}: {sum(file['rows'] for file in files):,}" for split, files in source.items())
    Card(
        template=template,
        title=f"{title} as tables" if further else title,
        columns={**columns, **further},
        picture=(
            name,
            _sheet(facts, is_glb=bool(further)),
            f"The first {kind.nouns}, seen from above",
        ),
        licence=terms.licence,
        tags=["tactile", "active-perception", "3d", "mesh"],
        made=[
            ("command", f"`{kind.command} {command}`"),
            ("source", f"{kind.nouns} {rows}; `manifest.json` names and fingerprints each file"),
        ],
        spec=manifest.spec["options"],
        values={**terms.values(), "package": kind.package},
    ).write(folder, facts, manifest, kind)


def _sheet(facts: FolderFacts, *, is_glb: bool) -> bytes | None:
    """Draw the first objects as PNG; None without rows."""
    import trimesh

    tiles = []
    for row in islice(first_rows(facts, [f"{MESH}.bytes"] if is_glb else [VERTICES, FACES]), _SHOWN):
        if is_glb:
            mesh: Any = trimesh.load_mesh(io.BytesIO(row.value(f"{MESH}.bytes")), file_type="glb")
            vertices_m, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        else:
            vertices_m, faces = row.array(VERTICES), row.array(FACES)
        pitch_m = max(float(np.ptp(vertices_m, axis=0)[:2].max()) / _TILE_PX, 1e-6)
        tiles.append(Tile(relief(vertices_m, faces, pitch_m)))
    return png_bytes(sheet(tiles, Sheet(5, margin_px=8))) if tiles else None
