"""Data cards: the README of a data set folder, filled from the data, and its picture."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from itertools import islice
from string import Template

from tactile_toolkit import mesh, pictures, read, shown_text, store
from tactile_toolkit.cards import card_tables, owner_words, yaml_head
from tactile_toolkit.cards.folder_facts import FolderSummary, folder_summary
from tactile_toolkit.json_types import JsonDict, JsonObject, JsonValue
from tactile_toolkit.kind import DatasetKind

PREVIEW_FOLDER = "previews"
MESH_TASKS = {
    "task_categories": ["robotics", "reinforcement-learning"],
    "task_ids": ["task-planning"],
}
"""Tasks of meshes, in terms of the Hub."""

_MAX_ENTRIES = 100  # of a list of the specification
# Rows mix the classes: 200 of digits lack a class with a chance of 1 in 10^8.
_ROWS_READ, _MAX_DRAWN, _COLUMNS = 200, 12, 6
_PICTURE_PX, _MAX_TILE_PX = 780, 480

# Templates have "FOLDER" there, because others cannot load a folder by name.
_LOADED_NAME = re.compile(r'datasets\.load_dataset\("(?P<name>[^"]+)"')


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
    picture : tuple
        File name, function that draws it as PNG from the summary (None without rows), and caption.
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
    """

    template: str
    title: str
    columns: Mapping[str, card_tables.ColumnWords]
    picture: tuple[str, Callable[[FolderSummary], bytes | None], str]
    licence: str
    tags: Sequence[str]
    nouns: str = ""
    tasks: JsonObject = field(default_factory=lambda: MESH_TASKS)
    figures: Mapping[str, Sequence[object]] = field(default_factory=dict)
    made: Sequence[tuple[str, str]] = ()
    limits: Sequence[str] = ()
    spec: JsonValue = None
    values: Mapping[str, str] = field(default_factory=dict)

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
        facts = facts or folder_summary(folder, manifest)
        name, draw, caption = self.picture
        values = {
            "title": shown_text.markdown_text(self.title),
            "noun": kind.noun,
            "nouns": kind.nouns,
            "rows": f"{facts.rows:,}",
            "first_split": facts.splits[0].split,
            "picture": "There is nothing to draw.",
            "bibtex": bibtex("tactile_mnist"),
            "split_table": card_tables.split_table(facts, self.nouns or kind.nouns, self.figures),
            "field_table": card_tables.field_table(facts, {**self.columns, **_source_column(manifest)}),
            "limits": "\n".join(f"- {line}" for line in self.limits),
        }
        if manifest is not None:
            spec = f"```json\n{shown_text.printable_json(_shortened(self.spec or manifest.spec))}\n```"
            reasons = manifest.skipped_reasons().items()
            listed = ", ".join(f"{count:,} {shown_text.markdown_text(reason)}" for reason, count in reasons)
            skipped = f"{listed}; `manifest.json` names each" if listed else "none"
            by = f"tactile-toolkit {manifest.toolkit_version} (schema {manifest.schema_version})"
            made = card_tables.markdown_table(("", ""), [("made by", by), *self.made, ("left out", skipped)])
            values |= {
                "spec": spec,
                "made": f"{made}\n\n{spec}",
                "skipped": skipped,
                "version": manifest.toolkit_version,
                "schema_version": str(manifest.schema_version),
            }
        content = draw(facts)
        if content is not None:
            path = f"{PREVIEW_FOLDER}/{name}"
            values["picture"] = f"![{caption}]({path})\n\n*{caption}*"
            _write_changed(folder, path, content)
        head = {"license": self.licence, "pretty_name": self.title, **self.tasks, "tags": list(self.tags)}
        body = shown_text.printable(render_card(self.template, {**values, **self.values}), keep="\n")
        head, body = owner_words.with_owner(head, body, owner_words.read_owner(folder))
        text = yaml_head.head_text(yaml_head.card_head(facts, **head)) + "\n" + body
        _write_changed(folder, yaml_head.CARD_FILE, text.encode())


def _source_column(manifest: store.Manifest | None) -> dict[str, card_tables.ColumnWords]:
    """Return the meaning of the column that `merge --source-column` adds, by its name."""
    options = (manifest and manifest.spec.get("options")) or {}
    if "source_column" not in options:
        return {}
    return {str(options["source_column"]): ("", "name of the merged data set that the row is from")}


def _shortened(values: JsonValue) -> JsonValue:
    """Return JSON values whose long lists end with the number of further entries."""
    if isinstance(values, Mapping):
        return {name: _shortened(each) for name, each in values.items()}
    if not isinstance(values, list):
        return values
    shown = [_shortened(each) for each in values[:_MAX_ENTRIES]]
    further = len(values) - len(shown)
    if further:
        shown.append(f"{further:,} more in manifest.json")
    return shown


def draw_solids(
    facts: FolderSummary,
    record: type[pictures.DrawnSolid] = pictures.DrawnSolid,
    columns: Sequence[str] = (mesh.VERTICES, mesh.FACES),
) -> bytes | None:
    """Draw the first solids of each class as PNG, class by class; None without rows.

    ``record`` draws a row, of which it needs ``columns``.
    """
    by_class: dict[int, list[pictures.DrawnSolid]] = {}
    for row in islice(rows_to_draw(facts, ["label", *columns]), _ROWS_READ):
        by_class.setdefault(row.integer("label"), []).append(record(row))
    if not by_class:
        return None
    per_class = max(1, _MAX_DRAWN // len(by_class))
    solids = [solid for label in sorted(by_class) for solid in by_class[label][:per_class]][:_MAX_DRAWN]
    across = min(len(solids), _COLUMNS)
    tile_px = min(_PICTURE_PX // across, _MAX_TILE_PX)
    return pictures.png_bytes(pictures.solid_sheet(solids, tile_px, across))


def card_words(file: str) -> JsonDict:
    """Read a file of ``data_cards`` with texts for its templates."""
    return tomllib.loads(files("data_cards").joinpath(file).read_text(encoding="utf-8"))


def _write_changed(folder: store.DataFolder, path: str, content: bytes) -> None:
    if not folder.exists(path) or folder.read_bytes(path) != content:
        folder.write_bytes(path, content)


def render_card(template: str, values: Mapping[str, str]) -> str:
    """Fill a template of ``data_cards``; KeyError for a placeholder without a value."""
    text = files("data_cards").joinpath(template).read_text(encoding="utf-8")
    return Template(text).substitute(values)


def with_repo_name(card: str, name: str) -> str:
    """Return a card whose code loads the data set by another name, of a folder or repository."""
    found = _LOADED_NAME.search(card)
    return card if found is None else card.replace(f'"{found["name"]}"', f'"{name}"')


def rows_to_draw(facts: FolderSummary, columns: Sequence[str]) -> Iterator[read.Row]:
    """Yield the rows of the first split with rows, reading given columns block by block."""
    shards = next((split.shards for split in facts.splits if split.rows), ())
    for block in read.all_blocks(shards, list(columns)):
        yield from (read.Row(block, index) for index in range(len(block.table)))


def bibtex(*names: str) -> str:
    """Return entries of ``data_cards``, such as ``"tactile_mnist"``, as a BibTeX block in Markdown."""
    entries = (files("data_cards").joinpath(f"{name}.bib").read_text(encoding="utf-8") for name in names)
    return "```bibtex\n" + "\n".join(entries) + "```"
