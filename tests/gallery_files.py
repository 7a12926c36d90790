"""Content of the scripts of a gallery: the index of its page, and single items."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

__all__ = ["column", "content_of", "files_of", "index_of"]


def files_of(site: Path) -> Path:
    """Return the folder that the page of a site names."""
    named = set(re.findall(r"files-[0-9a-f]{16}", (site / "index.html").read_text()))
    assert len(named) == 1
    return site / named.pop()


def index_of(site: Path) -> dict[str, Any]:
    text = (files_of(site) / "items.js").read_text()
    index: dict[str, Any] = json.loads(text.removeprefix("gallery.start(").removesuffix(");\n"))
    return index


def column(index: dict[str, Any], title: str) -> list[list[str]]:
    """Return the values that a facet has for each item."""
    facet = next(facet for facet in index["facets"] if facet["title"] == title)
    return [[facet["values"][value] for value in row] for row in facet["rows"]]


def content_of(site: Path, number: int) -> dict[str, Any]:
    text = (files_of(site) / "items" / f"{number:06d}.js").read_text()
    content: dict[str, Any] = json.loads(text.partition(",")[2].removesuffix(");\n"))
    return content
