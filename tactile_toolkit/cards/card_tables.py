"""Tables of data cards, in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

from tactile_toolkit.cards.folder_summary import FolderSummary
from tactile_toolkit.shown_text import markdown_code, markdown_text

ColumnWords: TypeAlias = tuple[str, str]
"""Shape, unit and frame of a column, and its meaning."""

_UNKNOWN: ColumnWords = ("", "a column of this copy; not in the published schema")


def split_table(facts: FolderSummary, nouns: str, figures: Mapping[str, Sequence[object]]) -> str:
    """Lay out the splits: how many rows, any further ``figures`` of each, and sizes of files."""
    rows = [
        (s.split, f"{s.rows:,}", *more, len(s.paths), megabytes(s.file_bytes), megabytes(s.unpacked_bytes))
        for s, *more in zip(facts.splits, *figures.values(), strict=True)
    ]
    return markdown_table(("split", nouns, *figures, "shards", "Parquet", "unpacked"), rows)


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Lay out a table in Markdown; a bar inside a cell stays part of its text."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(
        "| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def field_table(facts: FolderSummary, known: Mapping[str, ColumnWords]) -> str:
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
