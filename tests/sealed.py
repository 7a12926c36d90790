"""Manifests and records with changed values and correct digests, as a program would write them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tactile_toolkit.store.manifest import seal


def sealed(values: Any) -> str:
    """Return the text of a document with given values."""
    fields = values
    if isinstance(values, dict):
        fields = {name: value for name, value in values.items() if name != "sha256_of_all_below"}
    return seal(json.dumps(fields, indent=1))


def edit(file: Path, change: Callable[[Any], object]) -> None:
    """Change the values of a sealed file."""
    values = json.loads(file.read_text(encoding="utf-8"))
    change(values)
    file.write_text(sealed(values), encoding="utf-8")
