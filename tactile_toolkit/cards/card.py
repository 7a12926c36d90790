"""Data cards: the README of a data set folder, filled from the data set at hand, and the picture it shows."""

from __future__ import annotations

import fnmatch
import io
import re
import reprlib
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from itertools import islice
from posixpath import normpath
from string import Template
from typing import Any

import numpy as np

from tactile_toolkit import pictures, read, store
from tactile_toolkit.cards.facts import FolderFacts, card_head, folder_facts, head_text
from tactile_toolkit.errors import ToolkitError
from tactile_toolkit.kind import DatasetKind, is_export
from tactile_toolkit.mesh import FACES, MESH, SIZES, VERTICES, unpack_mesh
from tactile_toolkit.shown_text import markdown_code, markdown_text, printable, printable_json

CARD_FILE = "README.md"
PREVIEW_FOLDER = "previews"
Column = tuple[str, str]
"""Shape, unit and frame of a column, and its meaning."""

MESH_TASKS = {
    "task_categories": ["robotics", "reinforcement-learning"],
    "task_ids": ["task-planning"],
}
"""What meshes are for, in words of the Hub."""

_TABLE_COLUMNS: dict[str, Column] = {
    "label_name": ("", "name of the class"),
    **{name: ("m", f"extent along {name[5]}") for name in SIZES},
    f"{MESH}": ("GLB file, m, frame below", "the solid, its vertices and faces in their order"),
}
_SHOWN = 10
_TILE_PX = 120

_UNKNOWN: Column = ("", "a column of this copy; not in the published schema")
# Templates have "FOLDER" there: a folder has no name by which others could load it.
_LOADED_NAME = re.compile(r'datasets\.load_dataset\("(?P<name>[^"]+)"')


@dataclass(frozen=True, kw_only=True)
class Card:
    """What a card says that does not follow from folder and manifest alone.

    Attributes
    ----------
    template : str
        File of ``data_cards``.
    title : str
        Name of the data set.
    columns : mapping
        Shape, unit and frame of each column, and its meaning.
    picture : tuple
        File name, what draws it from the facts as PNG (None where there are no rows to draw), and caption.
    licence : str
        The Hub's word for it.
    tags : sequence of str
        For the page of the Hub.
    nouns : str
        What rows are called; as of the kind by default.
    tasks : mapping
        Further fields of the YAML head.
    figures : mapping
        Further columns of the table of splits: a value for each split.
    made : sequence of (str, str)
        Further lines on how it was made.
    limits : sequence of str
        What the data are not good for, or lack.
    spec : mapping or None
        What is shown of the specification; all of it by default.
    values : mapping
        What fills the template's other placeholders.
    """

    template: str
    title: str
    columns: Mapping[str, Column]
    picture: tuple[str, Callable[[FolderFacts], bytes | None], str]
    licence: str
    tags: Sequence[str]
    nouns: str = ""
    tasks: Mapping[str, Any] = field(default_factory=lambda: MESH_TASKS)
    figures: Mapping[str, Sequence[object]] = field(default_factory=dict)
    made: Sequence[tuple[str, str]] = ()
    limits: Sequence[str] = ()
    spec: Any = None
    values: Mapping[str, str] = field(default_factory=dict)

    def write(
        self,
        folder: store.DataFolder,
        manifest: store.Manifest | None,
        kind: DatasetKind,
        facts: FolderFacts | None = None,
    ) -> None:
        """Write ``README.md`` and its picture; what is as it should be is left alone.

        A copy of a published set has no manifest. ``facts`` are those of the folder, where they are known.
        Raises IntegrityError for a damaged shard.
        """
        facts = facts or folder_facts(folder, manifest)
        name, draw, caption = self.picture
        values = {
            "title": markdown_text(self.title),
            "noun": kind.noun,
            "nouns": kind.nouns,
            "rows": f"{facts.rows:,}",
            "first_split": facts.splits[0].split,
            "picture": "There is nothing to draw.",
            "bibtex": bibtex("tactile_mnist"),
            "split_table": split_table(facts, self.nouns or kind.nouns, self.figures),
            "field_table": field_table(facts, self.columns),
            "limits": "\n".join(f"- {line}" for line in self.limits),
        }
        if manifest is not None:
            spec = f"```json\n{printable_json(self.spec or manifest.spec)}\n```"
            reasons = manifest.skipped_reasons().items()
            listed = ", ".join(f"{count:,} {markdown_text(reason)}" for reason, count in reasons)
            skipped = f"{listed}; `manifest.json` names each" if listed else "none"
            by = f"tactile-toolkit {manifest.toolkit_version} (schema {manifest.schema_version})"
            made = markdown_table(("", ""), [("made by", by), *self.made, ("left out", skipped)])
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
        body = printable(render_card(self.template, {**values, **self.values}), keep="\n")
        text = head_text(card_head(facts, **head)) + "\n" + body
        _write_changed(folder, CARD_FILE, text.encode())


def write_table_card(
    folder: store.DataFolder,
    manifest: store.Manifest,
    kind: DatasetKind,
    title: str,
    columns: Mapping[str, Column],
    licence: str,
    **terms: str,
) -> None:
    """Write the card of a copy of a data set of meshes; IntegrityError for a damaged one.

    A copy has tables for other libraries, several sets as one, or some of the rows. ``columns`` are those of
    the data set that it was made of, ``title`` is its name. ``terms`` fill ``licence_text``,
    ``citation_text`` and ``bibtex`` of the template, the last that of the paper by default.
    """
    has_tables = is_export(manifest)
    command = "export --format flat" if has_tables else manifest.spec["operation"]
    sources = manifest.spec["source"].items()
    rows = ", ".join(f"{split}: {sum(file['rows'] for file in files):,}" for split, files in sources)
    Card(
        template="mesh_tables.md" if has_tables else "mesh_copy.md",
        title=f"{title} as tables" if has_tables else title,
        columns={**columns, **(_TABLE_COLUMNS if has_tables else {})},
        picture=(
            "tables.png" if has_tables else "objects.png",
            _table_sheet,
            f"The first {kind.nouns}, seen from above",
        ),
        licence=licence,
        tags=["tactile", "active-perception", "3d", "mesh"],
        made=[
            ("command", f"`{kind.command} {command}`"),
            ("source", f"{kind.nouns} {rows}; `manifest.json` names and fingerprints each file"),
        ],
        spec=manifest.spec["options"],
        values={**terms, "package": kind.package},
    ).write(folder, manifest, kind)


def _table_sheet(facts: FolderFacts) -> bytes | None:
    """Draw the first objects as PNG; None without rows."""
    tiles, file = [], f"{MESH}.bytes"  # of tables, whose meshes are GLB files
    is_glb = VERTICES not in read.column_names(facts.schema)
    for row in islice(rows_to_draw(facts, [file] if is_glb else [VERTICES, FACES]), _SHOWN):
        if is_glb:
            mesh = unpack_mesh(row.value(file), ".glb")
            vertices_m, faces = mesh.vertices_m, mesh.faces
        else:
            vertices_m, faces = row.array(VERTICES), row.array(FACES)
        pitch_m = max(float(np.ptp(vertices_m, axis=0)[:2].max()) / _TILE_PX, 1e-6)
        tiles.append(pictures.Tile(pictures.relief(vertices_m, faces, pitch_m)))
    return tiles_png(tiles, 5)


def tiles_png(tiles: Sequence[pictures.Tile], columns: int) -> bytes | None:
    """Lay pictures out for a card, as PNG; None without any."""
    return pictures.png_bytes(pictures.sheet(tiles, columns, margin_px=8)) if tiles else None


def card_words(file: str) -> dict[str, Any]:
    """Read a file of ``data_cards`` with words that fill its templates."""
    return tomllib.loads(files("data_cards").joinpath(file).read_text(encoding="utf-8"))


def split_table(facts: FolderFacts, nouns: str, figures: Mapping[str, Sequence[object]]) -> str:
    """Lay out the splits: how many rows, any further ``figures`` of each, and sizes of files."""
    rows = [
        (s.split, f"{s.rows:,}", *more, len(s.paths), megabytes(s.file_bytes), megabytes(s.unpacked_bytes))
        for s, *more in zip(facts.splits, *figures.values(), strict=True)
    ]
    return markdown_table(("split", nouns, *figures, "shards", "Parquet", "unpacked"), rows)


def _write_changed(folder: store.DataFolder, path: str, content: bytes) -> None:
    if not folder.exists(path) or folder.read_bytes(path) != content:
        folder.write_bytes(path, content)


def render_card(template: str, values: Mapping[str, str]) -> str:
    """Fill a template of ``data_cards``; KeyError where a placeholder has no value: no gap in a card."""
    text = files("data_cards").joinpath(template).read_text(encoding="utf-8")
    return Template(text).substitute(values)


def with_repo_name(card: str, name: str) -> str:
    """Return a card whose lines of code load the data set by another name: a folder or repository."""
    found = _LOADED_NAME.search(card)
    return card if found is None else card.replace(f'"{found["name"]}"', f'"{name}"')


def rows_to_draw(facts: FolderFacts, columns: Sequence[str]) -> Iterator[read.Row]:
    """Yield the rows of the first split that has any, reading some columns block by block."""
    split = next((split for split in facts.splits if split.rows), None)
    for block in read.all_blocks(() if split is None else split.shards, list(columns)):
        yield from (read.Row(block, index) for index in range(len(block.table)))


def bibtex(*names: str) -> str:
    """Lay out entries of ``data_cards``, such as ``"tactile_mnist"``, as one block of BibTeX in Markdown."""
    entries = (files("data_cards").joinpath(f"{name}.bib").read_text(encoding="utf-8") for name in names)
    return "```bibtex\n" + "\n".join(entries) + "```"


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Lay out a table in Markdown; a bar inside a cell stays part of its text."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(
        "| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def field_table(facts: FolderFacts, known: Mapping[str, Column]) -> str:
    """Lay out the columns of a folder: name, type as stored, shape and unit, meaning.

    Only columns that it has are listed, and all of them. ``known`` is by name; a name that ends with a dot
    stands for all fields of a struct.
    """
    rows = []
    for entry in _flat(facts.features):
        name = entry["name"]
        column = known.get(name) or known.get(f"{name.partition('.')[0]}.", _UNKNOWN)
        rows.append((markdown_code(name), column_type_text(entry), *column))
    return markdown_table(("column", "type", "shape, unit, frame", "meaning"), rows)


def _flat(features: Sequence[Mapping[str, Any]], above: str = "") -> list[dict[str, Any]]:
    """List columns by dotted name, those inside structs too."""
    flat = []
    for entry in features:
        name = f"{above}{entry['name']}"
        flat += _flat(entry["struct"], f"{name}.") if "struct" in entry else [{**entry, "name": name}]
    return flat


def column_type_text(entry: Any) -> str:
    """Write the type of a column for people, such as ``list of float32[3]``."""
    if isinstance(entry, str):
        return entry
    if isinstance(entry, list):
        return "struct of " + ", ".join(markdown_text(field["name"]) for field in entry)
    if "list" in entry:
        inner = column_type_text(entry["list"])
        if "length" not in entry:
            return f"list of {inner}"
        return f"{inner}[{entry['length']}]" if " " not in inner else f"({inner})[{entry['length']}]"
    dtype = entry["dtype"]
    if isinstance(dtype, dict):
        return "ClassLabel: " + ", ".join(map(markdown_text, dtype["class_label"]["names"].values()))
    return str(dtype)


def megabytes(size: int) -> str:
    """Write a size for a table: ``"12.30 MB"``; little ones in kB, so that none reads as nothing."""
    return f"{size / 1e6:,.2f} MB" if size >= 1e5 else f"{size / 1e3:,.1f} kB"


def between(least: int, most: int) -> str:
    """Write a range of counts: ``"3 to 5"``, or the one count."""
    return f"{most:,}" if least == most else f"{least:,} to {most:,}"


_GAPS = re.compile(r"more information needed|\[optional\]|\bTODO\b", re.IGNORECASE)
_PICTURE = re.compile(r"!\[[^\]]*\]\((?P<path>[^)\s]+)\)")
_MOST_SHOWN = 300
# YAML gives values of any type in any place.
_UNREADABLE = (ValueError, TypeError, KeyError, AttributeError, RecursionError)
_REQUIRED = ("license", "pretty_name", "task_categories", "tags")


def check_card(folder: store.DataFolder) -> list[store.Finding]:
    """List all in the card of a finished folder that manifest, Parquet files or pictures contradict."""
    import yaml
    from huggingface_hub import DatasetCard

    if not folder.exists(CARD_FILE):
        return [store.Finding(CARD_FILE, "is missing; next: write it with the command `card`")]
    text = folder.read_bytes(CARD_FILE).decode("utf-8", errors="replace")
    try:
        head = DatasetCard(text).data.to_dict()  # type: ignore[no-untyped-call]
        facts = folder_facts(folder)
        problems = [f"its head has no {name!r}" for name in _REQUIRED if not head.get(name)]
        problems += _contradictions(head, facts)
        gaps = dict.fromkeys(match[0] for match in _GAPS.finditer(text))
        problems += [f"reads {gap!r}; expected every gap filled" for gap in gaps]
    except ToolkitError as error:
        return [store.Finding(CARD_FILE, f"cannot be compared with the data: {error}")]
    except (*_UNREADABLE, yaml.YAMLError) as error:
        first_line = next(iter(str(error).splitlines()), type(error).__name__)
        return [store.Finding(CARD_FILE, f"its YAML head cannot be read: {first_line}")]
    return [*(store.Finding(CARD_FILE, problem) for problem in problems), *_check_pictures(folder, text)]


def _contradictions(head: Mapping[str, Any], facts: FolderFacts) -> Iterator[str]:
    """Yield every file, number or column in the head that the folder contradicts."""
    if not isinstance(head.get("dataset_info"), dict):
        yield "its head has no 'dataset_info'; next: write the card again with the command `card`"
        return
    held = [path for split in facts.splits for path in split.paths]
    held += [path for paths in facts.viewer.values() for path in paths]
    stated, expected = _claims(head, held), _claims(card_head(facts), held)
    for claim in {**expected, **stated}:
        if stated.get(claim) != expected.get(claim):
            found = _abridged(stated[claim]) if claim in stated else "missing"
            wanted = _abridged(expected[claim]) if claim in expected else "none"
            yield f"{' '.join(claim)} is {found}, expected {wanted}"
    for split in () if facts.recorded else facts.splits:
        for shard, path in zip(split.shards, split.paths, strict=True):
            if not shard.schema.equals(facts.schema):
                yield f"columns of {path} differ from those of {facts.splits[0].paths[0]}"


def _claims(head: Mapping[str, Any], held: Sequence[str]) -> dict[tuple[str, ...], Any]:
    """Return what a head says, by what it says it of; of files those ``held`` that its patterns find."""
    info, categories = head["dataset_info"], head.get("size_categories")
    # Not the sizes in memory: they are estimates where a manifest does not state them.
    claims: dict[tuple[str, ...], Any] = {("its", "'download_size'"): info.get("download_size")}
    claims["its", "'size_categories'"] = [categories] if isinstance(categories, str) else categories
    for config in head.get("configs") or ():
        for entry in config["data_files"]:
            patterns = [entry["path"]] if isinstance(entry["path"], str) else list(entry["path"])
            files = sorted({path for pattern in patterns for path in fnmatch.filter(held, str(pattern))})
            named = f"{_abridged(entry['split'])} in configuration {_abridged(config['config_name'])}"
            claims["files of split", named] = {"count": len(files), "files": files}
    for split in info.get("splits") or ():
        claims["num_examples of split", _abridged(split["name"])] = split.get("num_examples")
    for column in info.get("features") or ():
        described = {key: value for key, value in column.items() if key != "name"}
        claims["column", _abridged(column["name"])] = described
    return claims


def _abridged(value: Any) -> str:
    """Return the beginning of a value's repr."""
    # A head of a few lines may name its own parts so often that all of it would fill any memory.
    short = reprlib.Repr()
    short.maxstring = short.maxother = _MOST_SHOWN
    return short.repr(value)[:_MOST_SHOWN]


def pictures_in(text: str) -> list[str]:
    """Return the paths of the pictures that a card shows, but for those elsewhere or in the card itself."""
    paths = dict.fromkeys(match["path"] for match in _PICTURE.finditer(text))
    return [path for path in paths if "://" not in path and not path.startswith("data:")]


def _check_pictures(folder: store.DataFolder, text: str) -> Iterator[store.Finding]:
    """Yield pictures of the card that are missing or damaged."""
    for path in pictures_in(text):
        problem = store.problem_of_name(normpath(path))
        if problem:
            yield store.Finding(CARD_FILE, f"shows the picture {path!r}, which {problem}")
        elif not folder.exists(path):
            yield store.Finding(path, f"is missing; {CARD_FILE} shows it")
        elif not _is_picture(folder.read_bytes(path)):
            yield store.Finding(
                path, "is not an intact picture; next: write it again with the command `card`"
            )


def _is_picture(content: bytes) -> bool:
    from PIL import Image

    try:
        with Image.open(io.BytesIO(content)) as picture:
            picture.verify()  # reads every chunk and compares its checksum
    except (OSError, SyntaxError, ValueError):
        return False
    return True
