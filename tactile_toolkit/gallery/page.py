"""The page of a gallery: its own files, and the index of its items.

Pages opened from a file system may not fetch files, but they may load scripts. Data are therefore written as
scripts that call a function of the page.
"""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from importlib import resources

from tactile_toolkit import __version__, parsed_text
from tactile_toolkit.gallery.items import Gallery, GalleryItem
from tactile_toolkit.rows import Column

NONE, UNKNOWN = "none", "unknown"
"""Values of a facet for items without a value, and for items with an unknown value."""

FOLDER_MARK = "{{files}}"
"""Placeholder in the page for the name of the folder of its files."""

_SCRIPTS = ("state.js", "filters.js", "grid.js", "viewer.js", "film.js", "dialog.js", "page.js")

ASSETS = ("page.css", "theme.js", *_SCRIPTS)
"""Own files of the page, in the folder ``assets`` next to this module."""

THREE = "three.js"
"""The library that draws meshes; its licence file states version and digest."""


def asset(name: str) -> str:
    """Read a file of the page."""
    return (resources.files("tactile_toolkit.gallery") / "assets" / name).read_text(encoding="utf-8")


def page(title: str) -> str:
    """Return the page, with a placeholder for the folder of its files."""
    scripts = "\n".join(f'<script src="{FOLDER_MARK}/assets/{name}" defer></script>' for name in _SCRIPTS)
    filled = asset("page.html").replace("<!-- scripts -->", scripts)
    return filled.replace("{{title}}", html.escape(title))


def script_json(value: object) -> str:
    """Write JSON that is safe in scripts and pages: ASCII without ``<``, ``>`` and ``&``."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def index_of(gallery: Gallery, items: Sequence[GalleryItem]) -> dict[str, object]:
    """Return the columns by which the page filters and sorts, as JSON values with one entry for each item."""
    return {
        "kind": gallery.kind,
        "title": gallery.title,
        "nouns": list(gallery.nouns),
        "version": __version__,
        "ids": [item.id for item in items],
        "titles": [item.title for item in items],
        "facets": [_facet(each, items) for each in gallery.columns if each.role == "facet"],
        "measures": [_measure(each, items) for each in gallery.columns if each.role == "measure"],
    }


def _facet(column: Column, items: Sequence[GalleryItem]) -> dict[str, object]:
    rows = [_words(item.values[column.name]) if column.name in item.values else () for item in items]
    found = {value for row in rows for value in row}
    known = [value for value in column.values if value in found]
    values = known + sorted(found.difference(known), key=parsed_text.natural_key)
    numbers = {value: number for number, value in enumerate(values)}
    chosen = [[numbers[value] for value in row] for row in rows]
    return {"title": column.title, "values": values, "rows": chosen}


def _words(value: object) -> tuple[str, ...]:
    if isinstance(value, (list, tuple)):
        return tuple(map(str, value)) or (NONE,)
    return (UNKNOWN if value is None else str(value),)


def _measure(column: Column, items: Sequence[GalleryItem]) -> dict[str, object]:
    values = [_rounded(item.values.get(column.name), column.decimals) for item in items]
    return {"title": column.title, "unit": column.unit, "decimals": column.decimals, "values": values}


def _rounded(value: float | None, decimals: int) -> float | None:
    # NaN means "not measured" in reports; JSON has no NaN.
    if value is None or value != value:
        return None
    return round(float(value), decimals or None)
