"""The text files of a site: the page, its index of items, and one file of content per item.

Pages opened from a file system may not fetch files; scripts they may load. So data is written as scripts that
call a function of the page.
"""

from __future__ import annotations

import html
import json
from collections.abc import Mapping
from importlib import resources
from typing import Any

__all__ = ["ASSETS", "asset", "content_script", "index_script", "page", "script_json"]

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
