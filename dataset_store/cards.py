"""Data cards: the README of a data set folder, filled from the data set at hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from string import Template
from typing import Any

from dataset_store.manifest import Manifest
from dataset_store.shards import DATA_FOLDER
from dataset_store.storage import DataFolder

__all__ = ["CARD_FILE", "front_matter", "markdown_table", "render_card", "write_card_text"]

CARD_FILE = "README.md"

_SIZE_CATEGORIES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))


def front_matter(manifest: Manifest, **fields: Any) -> str:
    """Return the YAML head that lets ``datasets.load_dataset(folder)`` find the splits.

    Parameters
    ----------
    manifest : Manifest
        Gives the splits and the size category.
    **fields
        Further fields, such as ``license`` and ``tags``.
    """
    import yaml

    rows = sum(entry["rows"] for entry in manifest.split_table().values())
    category = next((name for limit, name in _SIZE_CATEGORIES if rows < limit), "n>1M")
    data_files = [{"split": split, "path": f"{DATA_FOLDER}/{split}-*"} for split in manifest.splits]
    content = {
        **fields,
        "size_categories": [category],
        "configs": [{"config_name": "default", "data_files": data_files}],
    }
    return "---\n" + yaml.safe_dump(content, sort_keys=False, allow_unicode=True) + "---\n"


def render_card(template: str, values: Mapping[str, str]) -> str:
    """Fill a template of ``data_cards``; a placeholder without a value is an error, not a gap in the card."""
    text = files("data_cards").joinpath(template).read_text(encoding="utf-8")
    return Template(text).substitute(values)


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Lay out a table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def write_card_text(folder: DataFolder, text: str) -> None:
    """Write the card unless it already reads so."""
    content = text.encode()
    if not folder.exists(CARD_FILE) or folder.read_bytes(CARD_FILE) != content:
        folder.write_bytes(CARD_FILE, content)
