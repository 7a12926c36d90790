"""The formats of others: which module plans an export to each, and which reads what is imported from it.

A format is one module, which knows no other. An export is a function of source, rows, frame of a clip and
options, and gives a conversion; an import is one of folder, columns and table, and yields items.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from tactile_toolkit.errors import InputError
from tactile_toolkit.kind import lazy

__all__ = ["EXPORTS", "IMPORTS", "format_of"]

EXPORTS: dict[str, Callable[..., Any]] = {
    "flat": lazy("realtouch.exchange.rows:rows_conversion"),
    "webdataset": lazy("realtouch.exchange.webdataset:tar_conversion"),
    "lerobot": lazy("realtouch.exchange.lerobot:lerobot_conversion"),
    "fota": lazy("realtouch.exchange.fota:fota_conversion"),
    "sparsh": lazy("realtouch.exchange.sparsh:sparsh_conversion"),
    "anytouch": lazy("realtouch.exchange.anytouch:anytouch_conversion"),
}

IMPORTS: dict[str, Callable[..., Any]] = {
    "folder": lazy("realtouch.exchange.folder:items_of_table"),
    "webdataset": lazy("realtouch.exchange.tars:items_of_tars"),
    "fota": lazy("realtouch.exchange.fota:items_of_fota"),
    "sparsh": lazy("realtouch.exchange.sparsh:items_of_pickles"),
    "anytouch": lazy("realtouch.exchange.anytouch:items_of_lists"),
}


def format_of(formats: Mapping[str, Callable[..., Any]], name: str) -> Callable[..., Any]:
    """Return the function of a format; InputError where there is none of that name."""
    if name not in formats:
        message = f"there is no layout {name!r}; expected {', '.join(formats)}"
        raise InputError(message)
    return formats[name]
