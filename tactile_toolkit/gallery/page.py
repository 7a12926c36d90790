"""The text files of a site: the page, its index of items, one file of content per item, the viewer's library.

Pages opened from a file system may not fetch files; scripts they may load. So data is written as scripts that
call a function of the page.
"""

from __future__ import annotations

import html
import json
import re
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib import metadata, resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tactile_toolkit.errors import InputError
from tactile_toolkit.gallery.items import SPLIT, Facet, Gallery, Item
from tactile_toolkit.versions import toolkit_version

__all__ = [
    "ASSETS",
    "IndexBuilder",
    "ViewerLibrary",
    "asset",
    "content_script",
    "index_script",
    "natural_order",
    "page",
    "script_json",
    "viewer_library",
]

_SCRIPTS = ("state.js", "filters.js", "grid.js", "viewer.js", "film.js", "dialog.js", "page.js")

ASSETS = ("page.css", "theme.js", *_SCRIPTS)
"""Our own files of the page, as they lie in the folder ``assets`` beside this module."""


def asset(name: str) -> str:
    """Read one of our own files of the page."""
    return (resources.files("tactile_toolkit.gallery") / "assets" / name).read_text(encoding="utf-8")


def page(title: str) -> str:
    """Return the page itself."""
    scripts = "\n".join(f'<script src="assets/{name}" defer></script>' for name in _SCRIPTS)
    filled = asset("page.html").replace("<!-- scripts -->", scripts)
    return filled.replace("{{title}}", html.escape(title))


def index_script(index: Mapping[str, Any]) -> str:
    """Return the script that gives the page its items."""
    return f"gallery.start({script_json(index)});\n"


def content_script(number: int, content: Mapping[str, Any]) -> str:
    """Return the script that gives the page what one item holds."""
    return f"gallery.receive({number},{script_json(content)});\n"


def script_json(value: Any) -> str:
    """Write JSON that is harmless in a script and in a page: no ``<``, ``>`` or ``&``, ASCII only."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@dataclass
class IndexBuilder:
    """Collects items one after another, keeping of each only what the page filters and sorts by."""

    gallery: Gallery
    _ids: list[str] = field(default_factory=list)
    _titles: list[str] = field(default_factory=list)
    _facets: dict[str, list[tuple[str, ...]]] = field(init=False)
    _measures: dict[str, list[float | None]] = field(init=False)

    def __post_init__(self) -> None:
        self._facets = {facet.name: [] for facet in self.gallery.facets}
        self._measures = {measure.name: [] for measure in self.gallery.measures}

    def add(self, item: Item) -> int:
        """Take an item and return its number on the page."""
        self._ids.append(item.id)
        self._titles.append(item.title)
        for name, values in self._facets.items():
            values.append(tuple(item.facets.get(name, ())))
        for measure in self.gallery.measures:
            value = item.measures.get(measure.name)
            # NaN stands for "not measured" in reports, and JSON has no NaN.
            if value is not None and value == value:
                value = round(float(value), measure.decimals)
                value = int(value) if measure.decimals == 0 else value
            else:
                value = None
            self._measures[measure.name].append(value)
        return len(self._ids) - 1

    def __len__(self) -> int:
        return len(self._ids)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values: columns, one entry per item."""
        return {
            "kind": self.gallery.kind,
            "title": self.gallery.title,
            "nouns": list(self.gallery.nouns),
            "version": toolkit_version(),
            "ids": self._ids,
            "titles": self._titles,
            "facets": [self._facet_column(facet) for facet in self.gallery.facets],
            "measures": [
                {
                    "title": measure.title,
                    "unit": measure.unit,
                    "decimals": measure.decimals,
                    "values": self._measures[measure.name],
                }
                for measure in self.gallery.measures
            ],
        }

    def _facet_column(self, facet: Facet) -> dict[str, Any]:
        rows = self._facets[facet.name]
        order = self.gallery.splits if facet.name == SPLIT else facet.values
        found = {value for row in rows for value in row}
        known = [value for value in order if value in found]
        values = known + natural_order(found.difference(known))
        index = {value: number for number, value in enumerate(values)}
        return {
            "title": facet.title,
            "values": values,
            "rows": [[index[value] for value in row] for row in rows],
        }


def natural_order(values: Iterable[str]) -> list[str]:
    """Sort texts so that numbers in them count as numbers: ``["2", "10", "a"]``; each once."""

    def key(text: str) -> tuple[list[tuple[int, float, str]], str]:
        parts = re.findall(r"\d+|\D+", text)
        return [(0, float(part), "") if part.isdecimal() else (1, 0.0, part) for part in parts], text

    return sorted(set(values), key=key)


# trimesh carries three.js in the template of its own notebook viewer, joined with that viewer's controls.
# Only the library itself is taken: one line of minified code below a comment that names its authors and
# licence.
_TEMPLATE = "resources/templates/viewer.zip"
_LIBRARY = re.compile(
    r"(?P<notice>/\*\*\n \* @license\n(?: \*[^\n]*\n)*? \*/)\n(?P<code>!function[^\n]*\.THREE=[^\n]*)\n"
)
_RELEASE = re.compile(r'const \w+="(\d{2,3})"')
_LICENSE_FILE = re.compile(r"(?:^|/)LICEN[CS]E[^/]*$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class ViewerLibrary:
    """A JavaScript library, the notice of its authors in front, and what must be said about it."""

    name: str  # with its release
    origin: str  # package that it was taken from, with its version
    code: str
    license_text: str


def viewer_library() -> ViewerLibrary:
    """Take three.js out of the installed trimesh.

    InputError where that does not carry it as known releases do, or not under the MIT licence.
    """
    distribution = metadata.distribution("trimesh")
    origin = f"trimesh {distribution.version}"
    absent = InputError(
        f"the installed {origin} carries no three.js with its licence where releases 4.9 to 5.2 do "
        f"({_TEMPLATE}); next: pip install 'trimesh>=4.9,<=5.2.0'"
    )
    # Found without importing trimesh, which takes two seconds and has no part in this.
    spec = find_spec("trimesh")
    if spec is None or spec.origin is None:
        raise absent
    try:
        with zipfile.ZipFile(Path(spec.origin).parent / _TEMPLATE) as archive:
            template = archive.read("viewer.html.template").decode()
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise absent from error
    found = _LIBRARY.search(template)
    if found is None or "SPDX-License-Identifier: MIT" not in found["notice"]:
        raise absent
    licences = (str(file.read_text()) for file in distribution.files or [] if _LICENSE_FILE.search(str(file)))
    terms = next((text for text in licences if "Permission is hereby granted, free of charge" in text), None)
    if terms is None:
        raise absent
    release = _RELEASE.search(found["code"])
    name = f"three.js r{release[1]}" if release else "three.js"
    text = (
        f"{name}, in assets/three.js, was taken out of the Python package {origin} when this page was\n"
        f"built. Its notice:\n\n{found['notice']}\n\n"
        f"The MIT licence, as the package {origin} states it:\n\n{terms.strip()}\n"
    )
    return ViewerLibrary(name, origin, f"{found['notice']}\n{found['code']}\n", text)
