"""Data cards: the README of a data set folder, filled from the data, and its picture."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from itertools import islice
from string import Template

import numpy as np

from tactile_toolkit import catalog, mesh, pictures, store, touch, wording
from tactile_toolkit.cards import licences, owner, yaml_head
from tactile_toolkit.cards.yaml_head import FolderSummary
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.kind import DatasetKind, is_export
from tactile_toolkit.mesh import records
from tactile_toolkit.mesh.files import unpack_mesh
from tactile_toolkit.pictures import solid_views
from tactile_toolkit.value_types import Float32, Int32, JsonDict, JsonObject, JsonValue
from tactile_toolkit.wording import markdown_code, markdown_text

PREVIEW_FOLDER = "previews"
MESH_TASKS = {
    "task_categories": ["robotics", "reinforcement-learning"],
    "task_ids": ["task-planning"],
}
"""Tasks of meshes, in terms of the Hub."""
_MAX_ENTRIES = 100  # of a list of the specification
# Rows mix the classes: 200 of digits lack a class with a chance of 1 in 10^8.
_ROWS_READ = 200
_MAX_DRAWN = 12
_COLUMNS = 6
_PICTURE_PX = 780
_MAX_TILE_PX = 480
# Templates have "FOLDER" there: `datasets` loads a folder by its path, a repository by its name.
_LOADED_NAME = re.compile(r'datasets\.load_dataset\("(?P<name>[^"]+)"')
_UNKNOWN = ("", "a column of this copy; not in the published schema")
_SOURCE_WORDS = ("", "name of the merged data set that the row is from")
_MERGED_WORDS = {
    licences.SOURCE_ID: ("", "id of the row there"),
    licences.LICENCE: ("", "licence of that data set"),
}
_TABLE_COLUMNS: dict[str, tuple[str, str]] = {
    "label_name": ("", "name of the class"),
    **{name: ("m", f"extent along {name[5]}") for name in records.SIZES},
    records.MESH: ("GLB file, m, frame below", "the solid, its vertices and faces in their order"),
}
_GLB = f"{records.MESH}.bytes"


@dataclass(frozen=True, kw_only=True)
class Card:
    """Content of a card that does not follow from folder and manifest.

    Attributes
    ----------
    template : str
        File of ``data_cards``.
    title : str
        Name of the data set.
    columns : mapping
        Shape, unit and frame of each column, and its meaning, by name.
    picture : (str, str)
        File name and caption of the picture.
    licence : str
        Identifier of the licence on the Hub.
    tags : sequence of str
        Tags of the page on the Hub.
    nouns : str
        Noun for rows; that of the kind by default.
    tasks : mapping
        Further fields of the YAML head.
    figures : mapping
        Further columns of the table of splits: a value for each split.
    made : sequence of (str, str)
        Further lines on how it was made.
    limits : sequence of str
        Known limits of the data.
    spec : mapping or None
        Displayed part of the specification; all by default.
    values : mapping
        Values of further placeholders of the template.
    cited : sequence of str
        Entries of ``data_cards`` to cite, such as ``"tactile_mnist"``.
    drawn : callable or type
        Draws the picture as PNG from the summary, None without rows; or the class of the solids of which the
        first are drawn.
    """

    template: str
    title: str
    columns: Mapping[str, tuple[str, str]]
    picture: tuple[str, str]
    licence: str
    tags: Sequence[str]
    nouns: str = ""
    tasks: JsonObject = field(default_factory=lambda: MESH_TASKS)
    figures: Mapping[str, Sequence[object]] = field(default_factory=dict)
    made: Sequence[tuple[str, str]] = ()
    limits: Sequence[str] = ()
    spec: JsonValue = None
    values: Mapping[str, str] = field(default_factory=dict)
    cited: Sequence[str] = ("tactile_mnist",)
    drawn: Callable[[FolderSummary], bytes | None] | type[pictures.DrawnSolid] = pictures.DrawnSolid

    @staticmethod
    def words(file: str) -> JsonDict:
        """Read a file of ``data_cards`` with texts for its templates."""
        return tomllib.loads(files("data_cards").joinpath(file).read_text(encoding="utf-8"))

    @staticmethod
    def filled(template: str, values: Mapping[str, str]) -> str:
        """Fill a template of ``data_cards``; KeyError for a placeholder without a value."""
        text = files("data_cards").joinpath(template).read_text(encoding="utf-8")
        return Template(text).substitute(values)

    @classmethod
    def of_copy(
        cls,
        manifest: store.Manifest,
        kind: DatasetKind,
        title: str,
        columns: Mapping[str, tuple[str, str]],
        licence: str,
        cited: Sequence[str] = ("tactile_mnist",),
        **terms: str,
    ) -> Card:
        """Return the card of a copy of a data set of meshes.

        A copy is an export to tables for other libraries, a merged set, or a selection of rows. ``columns``
        and ``title`` are those of its source. ``terms`` are ``licence_text`` and ``citation_text`` of the
        template.
        """
        command = kind.command_of(manifest)
        picture = "objects.png"
        template = "mesh_copy.md"
        if is_export(manifest):
            command = f"{command} --format flat"
            picture = "tables.png"
            template = "mesh_tables.md"
            title = f"{title} as tables"
            columns = {**columns, **_TABLE_COLUMNS}
        sources = manifest.spec["source"].items()
        rows = ", ".join(f"{split}: {sum(file['rows'] for file in files):,}" for split, files in sources)
        return cls(
            template=template,
            title=title,
            columns=columns,
            picture=(picture, f"The first {kind.nouns}, seen from above"),
            drawn=_PackedSolid if is_export(manifest) else pictures.DrawnSolid,
            licence=licence,
            tags=["tactile", "active-perception", "3d", "mesh"],
            made=[
                ("command", f"`{command}`"),
                ("source", f"{kind.nouns} {rows}; `manifest.json` names and fingerprints each file"),
            ],
            spec=manifest.spec["options"],
            values={**terms, "package": kind.package},
            cited=cited,
        )

    def write(
        self,
        folder: store.DataFolder,
        manifest: store.Manifest | None,
        kind: DatasetKind,
        facts: FolderSummary | None = None,
    ) -> None:
        """Write ``README.md`` and its picture; unchanged files are not rewritten.

        A copy of a published set has no manifest. ``facts`` is the summary of the folder, if known.
        Raises IntegrityError for a damaged shard.
        """
        facts = facts or FolderSummary.of(folder, manifest)
        name, caption = self.picture
        source_column = licences.source_column(facts.schema.names)
        source_words = {source_column: _SOURCE_WORDS, **_MERGED_WORDS} if source_column else {}
        values = {
            "title": wording.markdown_text(self.title),
            "noun": kind.noun,
            "nouns": kind.nouns,
            "rows": f"{facts.rows:,}",
            "first_split": facts.splits[0].split,
            "picture": "There is nothing to draw.",
            "bibtex": _bibtex(self.cited),
            "split_table": split_table(facts, self.nouns or kind.nouns, self.figures),
            "field_table": field_table(facts, {**self.columns, **source_words}),
            "limits": "\n".join(f"- {line}" for line in self.limits),
        }
        if manifest is not None:
            values |= self._origin(manifest)
        if isinstance(self.drawn, type):
            content = _draw_solids(facts, self.drawn)
        else:
            content = self.drawn(facts)
        if content is not None:
            path = f"{PREVIEW_FOLDER}/{name}"
            values["picture"] = f"![{caption}]({path})\n\n*{caption}*"
            _write_changed(folder, path, content)
        head = {"license": self.licence, "pretty_name": self.title, **self.tasks, "tags": list(self.tags)}
        terms = {}
        stated = ((manifest and manifest.spec.get("options")) or {}).get(licences.LICENCE, self.licence)
        if stated != self.licence:
            head["license"] = stated
            terms["licence_text"] = f"{wording.markdown_text(stated)}, as the card of the source states."
        sources = licences.rows_by_source(facts)
        if sources:
            head["license"] = licences.strictest([source.licence for source in sources])
            terms["licence_text"] = licences.licence_text(sources)
        body = wording.printable(self.filled(self.template, {**values, **self.values, **terms}), keep="\n")
        words = owner.read_owner(yaml_head.stored_head(folder), folder.address())
        head, body = owner.with_owner(head, body, words, **terms)
        text = yaml_head.head_text(yaml_head.card_head(facts, **head)) + "\n" + body
        _write_changed(folder, store.CARD_FILE, text.encode())

    def _origin(self, manifest: store.Manifest) -> dict[str, str]:
        """Return what the card states about how the data set was made."""
        spec = f"```json\n{wording.printable_json(_shortened(self.spec or manifest.spec))}\n```"
        reasons = manifest.skipped_reasons().items()
        listed = ", ".join(f"{count:,} {wording.markdown_text(reason)}" for reason, count in reasons)
        skipped = f"{listed}; `manifest.json` names each" if listed else "none"
        by = f"tactile-toolkit {manifest.toolkit_version} (schema {manifest.schema_version})"
        made = markdown_table(("", ""), [("made by", by), *self.made, ("left out", skipped)])
        return {
            "spec": spec,
            "made": f"{made}\n\n{spec}",
            "skipped": skipped,
            "version": manifest.toolkit_version,
            "schema_version": str(manifest.schema_version),
        }


def rewrite_card(
    kind: DatasetKind, folder: store.DataFolder, manifest: store.Manifest | None, words: owner.OwnerWords
) -> list[str]:
    """Write the card of a finished folder again; return its path and those of its pictures.

    Texts of the owner in the card are kept unless ``words`` replaces them. Raises InputError if those in the
    card cannot be used, IntegrityError if the data are damaged.
    """
    with catalog.specification_read(folder.address()):
        if words.license:
            sources = licences.rows_by_source(FolderSummary.of(folder, manifest))
            licences.require_strictest(words.license, sources)
        if words.given():
            head = yaml_head.stored_head(folder)
            stated = {**owner.read_owner(head, folder.address()).given(), **words.given()}
            card = yaml_head.head_text({owner.KEY: stated})
            if head:
                stored = folder.read_bytes(store.CARD_FILE).decode("utf-8", errors="replace")
                card = yaml_head.with_head(stored, lambda head: head.update({owner.KEY: stated}))
            folder.write_bytes(store.CARD_FILE, card.encode())
        kind.write_card(folder, manifest)
    findings = yaml_head.check_card(folder)
    if findings:
        raise IntegrityError(f"{findings[0].file} of {folder.address()!r}: {findings[0].problem}")
    names = [name for name in folder.names(PREVIEW_FOLDER) if name.endswith(".png")]
    return [store.CARD_FILE, *(f"{PREVIEW_FOLDER}/{name}" for name in names)]


class _PackedSolid(pictures.DrawnSolid):
    """A solid in a GLB file."""

    __slots__ = ()
    drawn_columns = (_GLB,)

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
        return self._once("surface", lambda: unpack_mesh(self.row.value(_GLB), ".glb"))


def _shortened(values: JsonValue) -> JsonValue:
    """Return JSON values whose long lists end with the number of further entries."""
    if isinstance(values, Mapping):
        return {name: _shortened(value) for name, value in values.items()}
    if not isinstance(values, list):
        return values
    shown = [_shortened(value) for value in values[:_MAX_ENTRIES]]
    further = len(values) - len(shown)
    if further:
        shown.append(f"{further:,} more in manifest.json")
    return shown


def _draw_solids(facts: FolderSummary, record: type[pictures.DrawnSolid]) -> bytes | None:
    """Draw the first solids of each class as PNG, class by class; None without rows."""
    by_class: dict[int, list[pictures.DrawnSolid]] = {}
    for row in islice(facts.first_rows(["label", *record.drawn_columns]), _ROWS_READ):
        by_class.setdefault(row.integer("label"), []).append(record(row))
    if not by_class:
        return None
    per_class = max(1, _MAX_DRAWN // len(by_class))
    solids = [solid for label in sorted(by_class) for solid in by_class[label][:per_class]][:_MAX_DRAWN]
    across = min(len(solids), _COLUMNS)
    tile_px = min(_PICTURE_PX // across, _MAX_TILE_PX)
    return touch.encode_image(solid_views.solid_sheet(solids, tile_px, across), "png")


def _write_changed(folder: store.DataFolder, path: str, content: bytes) -> None:
    if not folder.exists(path) or folder.read_bytes(path) != content:
        folder.write_bytes(path, content)


def with_repo_name(card: str, name: str) -> str:
    """Return a card whose code loads the data set by another name, of a folder or repository."""
    match = _LOADED_NAME.search(card)
    return card if match is None else card.replace(f'"{match["name"]}"', f'"{name}"')


def _bibtex(names: Sequence[str]) -> str:
    """Return entries of ``data_cards`` as a BibTeX block in Markdown; empty without entries."""
    if not names:
        return ""
    entries = (files("data_cards").joinpath(f"{name}.bib").read_text(encoding="utf-8") for name in names)
    return "```bibtex\n" + "\n".join(entries) + "```"


def split_table(facts: FolderSummary, nouns: str, figures: Mapping[str, Sequence[object]]) -> str:
    """Return a table of splits: rows, further ``figures`` of each, and file sizes."""
    rows = [
        (s.split, f"{s.rows:,}", *more, len(s.paths), megabytes(s.file_bytes), megabytes(s.unpacked_bytes))
        for s, *more in zip(facts.splits, *figures.values(), strict=True)
    ]
    return markdown_table(("split", nouns, *figures, "shards", "Parquet", "unpacked"), rows)


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table in Markdown; bars inside cells are escaped."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(
        "| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def field_table(facts: FolderSummary, known: Mapping[str, tuple[str, str]]) -> str:
    """Return a table of the columns of a folder: name, stored type, shape and unit, meaning.

    ``known`` is by name; a name that ends with a dot stands for all fields of a struct.
    """
    rows = []
    for entry in _flat(facts.features):
        name = entry["name"]
        column = known.get(name) or known.get(f"{name.partition('.')[0]}.", _UNKNOWN)
        rows.append((markdown_code(name), column_type_text(entry), *column))
    return markdown_table(("column", "type", "shape, unit, frame", "meaning"), rows)


def _flat(features: Sequence[JsonObject], above: str = "") -> list[JsonDict]:
    """List columns by dotted name, including fields of structs."""
    flat = []
    for entry in features:
        name = f"{above}{entry['name']}"
        flat += _flat(entry["struct"], f"{name}.") if "struct" in entry else [{**entry, "name": name}]
    return flat


def column_type_text(entry: JsonValue) -> str:
    """Return the type of a column as text, such as ``list of float32[3]``."""
    if isinstance(entry, str):
        return entry
    if isinstance(entry, list):
        return "struct of " + ", ".join(markdown_text(field["name"]) for field in entry)
    if "list" in entry:
        inner = column_type_text(entry["list"])
        if "length" not in entry:
            return f"list of {inner}"
        if " " in inner:
            inner = f"({inner})"
        return f"{inner}[{entry['length']}]"
    dtype = entry["dtype"]
    if isinstance(dtype, dict):
        return "ClassLabel: " + ", ".join(map(markdown_text, dtype["class_label"]["names"].values()))
    return str(dtype)


def megabytes(size: int) -> str:
    """Return a size as text: ``"12.30 MB"``, or in kB if it is small."""
    if size < 1e5:
        return f"{size / 1e3:,.1f} kB"
    return f"{size / 1e6:,.2f} MB"
