"""The text files of a site: the page, its index of items, one file of content per item, the viewer's library.

Pages opened from a file system may not fetch files; scripts they may load. So data is written as scripts that
call a function of the page.
"""

from __future__ import annotations

import html
import json
import re
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from importlib import metadata, resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from tactile_toolkit import toolkit_version
from tactile_toolkit.errors import InputError
from tactile_toolkit.gallery.items import SPLIT, Gallery, Item

_SCRIPTS = ("state.js", "filters.js", "grid.js", "viewer.js", "film.js", "dialog.js", "page.js")

ASSETS = ("page.css", "theme.js", *_SCRIPTS)
"""Our own files of the page, as they lie in the folder ``assets`` next to this module."""


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


def index_of(gallery: Gallery, items: Sequence[Item]) -> dict[str, Any]:
    """Return what the page filters and sorts items by, as JSON values: columns, one entry per item."""
    facets = []
    for facet in gallery.facets:
        rows = [tuple(item.facets.get(facet.name, ())) for item in items]
        found = {value for row in rows for value in row}
        known = [
            value for value in (gallery.splits if facet.name == SPLIT else facet.values) if value in found
        ]
        values = known + natural_order(found.difference(known))
        numbers = {value: number for number, value in enumerate(values)}
        chosen = [[numbers[value] for value in row] for row in rows]
        facets.append({"title": facet.title, "values": values, "rows": chosen})
    return {
        "kind": gallery.kind,
        "title": gallery.title,
        "nouns": list(gallery.nouns),
        "version": toolkit_version(),
        "ids": [item.id for item in items],
        "titles": [item.title for item in items],
        "facets": facets,
        "measures": [
            {
                "title": measure.title,
                "unit": measure.unit,
                "decimals": measure.decimals,
                "values": [_rounded(item.measures.get(measure.name), measure.decimals) for item in items],
            }
            for measure in gallery.measures
        ],
    }


def _rounded(value: float | None, decimals: int) -> float | None:
    # NaN stands for "not measured" in reports, and JSON has no NaN.
    if value is None or value != value:
        return None
    return round(float(value), decimals or None)


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


def viewer_library() -> tuple[str, str]:
    """Take three.js out of the installed trimesh: its code, and the text of its licence.

    InputError where that does not carry it as known releases do, or not under the MIT licence.
    """
    distribution = metadata.distribution("trimesh")
    origin = f"trimesh {distribution.version}"
    # Found without importing trimesh, which takes two seconds and has no part in this.
    spec = find_spec("trimesh")
    try:
        with zipfile.ZipFile(Path(spec.origin if spec and spec.origin else "").parent / _TEMPLATE) as archive:
            found = _LIBRARY.search(archive.read("viewer.html.template").decode())
    except (OSError, KeyError, zipfile.BadZipFile):
        found = None
    licences = (str(file.read_text()) for file in distribution.files or [] if _LICENSE_FILE.search(str(file)))
    terms = next((text for text in licences if "Permission is hereby granted, free of charge" in text), None)
    if found is None or terms is None or "SPDX-License-Identifier: MIT" not in found["notice"]:
        raise InputError(
            f"the installed {origin} carries no three.js with its licence where releases 4.9 to 5.2 do "
            f"({_TEMPLATE})",
            next="pip install 'trimesh>=4.9,<=5.2.0'",
        )
    release = _RELEASE.search(found["code"])
    name = f"three.js r{release[1]}" if release else "three.js"
    text = (
        f"{name}, in assets/three.js, was taken out of the Python package {origin} when this page was\n"
        f"built. Its notice:\n\n{found['notice']}\n\n"
        f"The MIT licence, as the package {origin} states it:\n\n{terms.strip()}\n"
    )
    return f"{found['notice']}\n{found['code']}\n", text
