"""Moved to :mod:`tactile_toolkit.read.columns`; goes with its last importer."""

from __future__ import annotations

from typing import Any

from tactile_toolkit.read.columns import BytesColumn, NestedColumn, list_depth

__all__ = ["BytesColumn", "NestedColumn", "list_depth", "nested_column"]


def nested_column(group: Any, name: str) -> NestedColumn:
    """Return a column of nested lists."""
    column: NestedColumn = group.nested(name)
    return column
