"""Data cards: the README of a data set folder, filled from the data set at hand."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from string import Template

from dataset_store.storage import DataFolder

__all__ = ["CARD_FILE", "FOLDER_NAME", "addressed", "placeholders", "render_card", "write_card_text"]

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
