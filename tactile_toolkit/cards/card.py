"""Data cards: the README of a data set folder, filled from the data set at hand."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from string import Template
from typing import Any

from tactile_toolkit.cards.facts import FolderFacts
from tactile_toolkit.store.folder import DataFolder

__all__ = [
    "CARD_FILE",
    "Column",
    "FOLDER_NAME",
    "HWD_PLUS",
    "MNIST",
    "TACTILE_MNIST",
    "addressed",
    "bibtex",
    "column_type_text",
    "field_table",
    "json_block",
    "markdown_table",
    "megabytes",
    "picture",
    "placeholders",
    "render_card",
    "write_card_text",
]

CARD_FILE = "README.md"
FOLDER_NAME = "FOLDER"
"""Stands for the data set in lines that load it, as long as it is a folder and has no name on the Hub."""

_LOADED_NAME = re.compile(r'datasets\.load_dataset\("(?P<name>[^"]+)"')


def render_card(template: str, values: Mapping[str, str]) -> str:
    """Fill a template of ``data_cards``.

    Raises
    ------
    KeyError
        When a placeholder has no value: never a gap in the card.
    """
    text = files("data_cards").joinpath(template).read_text(encoding="utf-8")
    return Template(text).substitute(values)


@cache
def placeholders() -> frozenset[str]:
    """Return the names of what is filled in, over all templates of ``data_cards``."""
    templates = (entry for entry in files("data_cards").iterdir() if entry.name.endswith(".md"))
    texts = (entry.read_text(encoding="utf-8") for entry in templates)
    return frozenset(name for text in texts for name in Template(text).get_identifiers())


def addressed(card: str, name: str) -> str:
    """Return a card whose lines of code load the data set by another name.

    Parameters
    ----------
    card : str
        Text of a card.
    name : str
        Folder or repository (``USER/NAME``) that takes the place of the one in the card.
    """
    found = _LOADED_NAME.search(card)
    return card if found is None else card.replace(f'"{found["name"]}"', f'"{name}"')


def write_card_text(folder: DataFolder, text: str) -> None:
    """Write the card unless it already reads so."""
    content = text.encode()
    if not folder.exists(CARD_FILE) or folder.read_bytes(CARD_FILE) != content:
        folder.write_bytes(CARD_FILE, content)


TACTILE_MNIST = """\
@article{schneider2025tactilemnist,
  title  = {Tactile {MNIST}: Benchmarking Active Tactile Perception},
  author = {Schneider, Tim and Duret, Guillaume and de Farias, Cristiana and Calandra, Roberto and
            Chen, Liming and Peters, Jan},
  year   = {2025}
}"""
"""The paper: algorithm, splits, scenes and touches."""

HWD_PLUS = """\
@article{beaulac2022hwdplus,
  title   = {Introducing a New High-Resolution Handwritten Digits Data Set with Writer Characteristics},
  author  = {Beaulac, C{\\'e}dric and Rosenthal, Jeffrey S.},
  journal = {SN Computer Science},
  year    = {2022},
  doi     = {10.1007/s42979-022-01494-2}
}"""
"""The handwriting of the published digits."""

MNIST = """\
@article{lecun1998gradient,
  title   = {Gradient-Based Learning Applied to Document Recognition},
  author  = {LeCun, Yann and Bottou, L{\\'e}on and Bengio, Yoshua and Haffner, Patrick},
  journal = {Proceedings of the IEEE},
  volume  = {86},
  number  = {11},
  pages   = {2278--2324},
  year    = {1998},
  doi     = {10.1109/5.726791}
}"""
"""The handwriting of MNIST."""


def bibtex(*entries: str) -> str:
    """Lay out entries as one block of BibTeX in Markdown."""
    return "```bibtex\n" + "\n\n".join(entries) + "\n```"


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
