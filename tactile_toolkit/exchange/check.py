"""Everything that can be wrong with a folder, before it goes to others."""

from __future__ import annotations

from collections.abc import Iterable

from tactile_toolkit.cards.checks import check_card
from tactile_toolkit.catalog.kinds import require_manifest
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.store.folder import DataFolder
from tactile_toolkit.store.shards import Finding
from tactile_toolkit.store.verify import verify

__all__ = ["check_folder"]


def check_folder(kind: DatasetKind, folder: DataFolder) -> Iterable[Finding]:
    """List what is wrong with a folder of a kind: files, rows, columns, ids, pictures, card."""
    if kind.check is not None:
        found: Iterable[Finding] = kind.check(folder)
        return found
    require_manifest(kind, folder)
    return verify(folder, None if kind.schema is None else kind.schema(), check_card=check_card).findings
