"""The formats of others: what plans an export to each, and what reads an import from it.

A format is one module, which knows no other. An export is planned of source, rows, frame of a clip and
options; an import reads a folder, columns and a table, and yields items.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from operator import attrgetter
from typing import Any

from tactile_toolkit.errors import InputError

EXPORTS = {
    "flat": "rows:FORMAT.plan",
    "webdataset": "webdataset:FORMAT.plan",
    "lerobot": "lerobot:plan",
    "replay": "replay:plan",
    "fota": "fota:FORMAT.plan",
    "sparsh": "sparsh:FORMAT.plan",
    "anytouch": "anytouch:FORMAT.plan",
}

IMPORTS = {
    "folder": "folder:items_of_table",
    "webdataset": "tars:items_of_tars",
    "fota": "fota:items_of_fota",
    "sparsh": "sparsh:items_of_pickles",
    "anytouch": "anytouch:items_of_lists",
}


def format_of(formats: Mapping[str, str], name: str) -> Any:
    """Return the function of a format; InputError where there is none of that name."""
    if name not in formats:
        raise InputError(f"there is no layout {name!r}; expected {', '.join(formats)}")
    module, _, function = formats[name].partition(":")
    return attrgetter(function)(import_module(f"realtouch.exchange.{module}"))
