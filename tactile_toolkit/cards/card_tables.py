"""Tables of data cards, in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypeAlias

from tactile_toolkit.cards.folder_facts import FolderSummary
from tactile_toolkit.json_types import JsonDict, JsonObject, JsonValue
from tactile_toolkit.shown_text import markdown_code, markdown_text

ColumnWords: TypeAlias = tuple[str, str]
"""Shape, unit and frame of a column, and its meaning."""

_UNKNOWN: ColumnWords = ("", "a column of this copy; not in the published schema")


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


def field_table(facts: FolderSummary, known: Mapping[str, ColumnWords]) -> str:
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


def between(least: int, most: int) -> str:
    """Return a range of counts as text: ``"3 to 5"``, or one count."""
    return " to ".join(f"{count:,}" for count in dict.fromkeys((least, most)))
