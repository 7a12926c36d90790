"""Cards of copies of data sets of meshes: tables for other libraries, merged sets, some of the rows."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tactile_toolkit import mesh, pictures, read, store
from tactile_toolkit.array_types import Float32, Int32
from tactile_toolkit.cards.card import Card, draw_solids
from tactile_toolkit.cards.card_tables import ColumnWords
from tactile_toolkit.cards.folder_facts import FolderSummary
from tactile_toolkit.kind import DatasetKind, is_export

_TABLE_COLUMNS: dict[str, ColumnWords] = {
    "label_name": ("", "name of the class"),
    **{name: ("m", f"extent along {name[5]}") for name in mesh.SIZES},
    f"{mesh.MESH}": ("GLB file, m, frame below", "the solid, its vertices and faces in their order"),
}
_GLB = f"{mesh.MESH}.bytes"


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
        picture=(picture, _draw_tables, f"The first {kind.nouns}, seen from above"),
        licence=licence,
        tags=["tactile", "active-perception", "3d", "mesh"],
        made=[
            ("command", f"`{kind.command} {command}`"),
            ("source", f"{kind.nouns} {rows}; `manifest.json` names and fingerprints each file"),
        ],
        spec=manifest.spec["options"],
        values={**terms, "package": kind.package},
    ).write(folder, manifest, kind)


def _draw_tables(facts: FolderSummary) -> bytes | None:
    """Draw the first solids of tables as PNG: in columns of a mesh, or in GLB files."""
    if mesh.VERTICES in read.column_names(facts.schema):
        return draw_solids(facts)
    return draw_solids(facts, _PackedSolid, [_GLB])


class _PackedSolid(pictures.DrawnSolid):
    """A solid in a GLB file."""

    __slots__ = ()

    @property
    def vertices_m(self) -> Float32:
        """Vertices, shape (V, 3), metres."""
        return np.asarray(self._unpacked.vertices_m, np.float32)

    @property
    def faces(self) -> Int32:
        """Triangles, shape (F, 3)."""
        return np.asarray(self._unpacked.faces, np.int32)

    @property
    def _unpacked(self) -> mesh.Mesh:
        return self._once("surface", lambda: mesh.unpack_mesh(self.row.value(_GLB), ".glb"))
