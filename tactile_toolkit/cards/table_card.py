"""Cards of copies of data sets of meshes: tables for other libraries, merged sets, some of the rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice

import numpy as np

from tactile_toolkit import mesh, pictures, read, store
from tactile_toolkit.array_types import Floating, Integers
from tactile_toolkit.cards.card import Card, rows_to_draw, tiles_png
from tactile_toolkit.cards.card_tables import ColumnWords
from tactile_toolkit.cards.folder_facts import FolderSummary
from tactile_toolkit.kind import DatasetKind, is_export

_TABLE_COLUMNS: dict[str, ColumnWords] = {
    "label_name": ("", "name of the class"),
    **{name: ("m", f"extent along {name[5]}") for name in mesh.SIZES},
    f"{mesh.MESH}": ("GLB file, m, frame below", "the solid, its vertices and faces in their order"),
}
_SHOWN = 10
_TILE_PX = 120


def write_table_card(
    folder: store.DataFolder,
    manifest: store.Manifest,
    kind: DatasetKind,
    title: str,
    columns: Mapping[str, ColumnWords],
    licence: str,
    **terms: str,
) -> None:
    """Write the card of a copy of a data set of meshes; IntegrityError for a damaged one.

    A copy consists of tables for other libraries, merged sets, or some of the rows. ``columns`` and ``title``
    are those of its source. ``terms`` are ``licence_text``, ``citation_text`` and ``bibtex`` of the template,
    the last one that of the paper by default.
    """
    command, picture, template = manifest.spec["operation"], "objects.png", "mesh_copy.md"
    if is_export(manifest):
        command, picture, template = "export --format flat", "tables.png", "mesh_tables.md"
        title, columns = f"{title} as tables", {**columns, **_TABLE_COLUMNS}
    sources = manifest.spec["source"].items()
    rows = ", ".join(f"{split}: {sum(file['rows'] for file in files):,}" for split, files in sources)
    Card(
        template=template,
        title=title,
        columns=columns,
        picture=(picture, _table_sheet, f"The first {kind.nouns}, seen from above"),
        licence=licence,
        tags=["tactile", "active-perception", "3d", "mesh"],
        made=[
            ("command", f"`{kind.command} {command}`"),
            ("source", f"{kind.nouns} {rows}; `manifest.json` names and fingerprints each file"),
        ],
        spec=manifest.spec["options"],
        values={**terms, "package": kind.package},
    ).write(folder, manifest, kind)


def _table_sheet(facts: FolderSummary) -> bytes | None:
    """Draw the first objects as PNG; None without rows."""
    tiles = []
    for vertices_m, faces in islice(_surfaces(facts), _SHOWN):
        pitch_m = max(float(np.ptp(vertices_m, axis=0)[:2].max()) / _TILE_PX, 1e-6)
        tiles.append(pictures.Tile(pictures.relief(vertices_m, faces, pitch_m)))
    return tiles_png(tiles, 5)


def _surfaces(facts: FolderSummary) -> Iterator[tuple[Floating, Integers]]:
    """Yield the stored surfaces: in columns of a mesh, or in GLB files."""
    if mesh.VERTICES in read.column_names(facts.schema):
        for row in rows_to_draw(facts, [mesh.VERTICES, mesh.FACES]):
            yield row.array(mesh.VERTICES), row.array(mesh.FACES)
        return
    for row in rows_to_draw(facts, [f"{mesh.MESH}.bytes"]):
        solid = mesh.unpack_mesh(row.value(f"{mesh.MESH}.bytes"), ".glb")
        yield solid.vertices_m, solid.faces
