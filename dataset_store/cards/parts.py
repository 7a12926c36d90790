"""Parts that the cards of all kinds share: tables, lists, ranges, pictures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from dataset_store.cards.facts import FolderFacts

__all__ = [
    "Column",
    "column_type_text",
    "field_table",
    "json_block",
    "markdown_table",
    "megabytes",
    "picture",
]

Column = tuple[str, str]
"""Shape, unit and frame of a column, and its meaning."""

_UNKNOWN: Column = ("", "a column of this copy; the published schema has none of this name")


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Lay out a table in Markdown; a bar inside a cell stays part of its text."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(
        "| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def field_table(facts: FolderFacts, known: Mapping[str, Column], families: Mapping[str, Column]) -> str:
    """Lay out the columns of a folder: name, type as stored, shape and unit, meaning.

    Parameters
    ----------
    facts : FolderFacts
        The folder; only columns that it has are listed, and all of them.
    known : mapping of str to Column
        What is known of each column by its name.
    families : mapping of str to Column
        What is known of columns by the beginning of their names.
    """
    rows = []
    for entry in _flat(facts.features):
        name = entry["name"]
        family = next((told for start, told in families.items() if name.startswith(start)), _UNKNOWN)
        rows.append((f"`{name}`", column_type_text(entry), *known.get(name, family)))
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
        return "struct of " + ", ".join(field["name"] for field in entry)
    if "list" in entry:
        inner = column_type_text(entry["list"])
        if "length" not in entry:
            return f"list of {inner}"
        return f"{inner}[{entry['length']}]" if " " not in inner else f"({inner})[{entry['length']}]"
    dtype = entry["dtype"]
    if isinstance(dtype, dict):
        return "ClassLabel: " + ", ".join(dtype["class_label"]["names"].values())
    return str(dtype)


def json_block(values: Any) -> str:
    """Lay out JSON values as a block of code."""
    return "```json\n" + json.dumps(values, indent=2, ensure_ascii=False) + "\n```"


def megabytes(size: int) -> str:
    """Write a size for a table: ``"12.30 MB"``; little ones in kB, so that none reads as nothing."""
    return f"{size / 1e6:,.2f} MB" if size >= 1e5 else f"{size / 1e3:,.1f} kB"


def picture(path: str | None, caption: str) -> str:
    """Show a picture of the folder; a sentence where there are no rows to draw."""
    return "There are no rows to draw." if path is None else f"![{caption}]({path})\n\n*{caption}*"
