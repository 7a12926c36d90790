"""The cache folder of the toolkit."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["CACHE_VARIABLE", "cache_folder"]

CACHE_VARIABLE = "TACTILE_TOOLKIT_CACHE"
"""Environment variable that names the folder of unpacked row groups."""


def cache_folder() -> Path:
    """Return the folder of unpacked row groups: ``$TACTILE_TOOLKIT_CACHE`` or the user's cache folder."""
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        return Path(named).expanduser()
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "tactile-toolkit"
