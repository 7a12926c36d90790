"""Schema versions of data set folders: the only place that distinguishes them.

1   Parquet pages end at 1 MiB and have no index; a split of synthetic touches has few shards.
2   Pages have an index; where it was measured to help (``benchmarks/shared_chunks.py``), they end so that a
    changed row changes few bytes of a file. Small sets of synthetic touches have some shards for each worker.

A folder keeps the version in which it was begun: it is continued and finished with the bytes of that version.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.store.parquet import ParquetStyle

SCHEMA_VERSION = 2
"""Version of the folders that are begun now."""
_FIRST = 1


def require_known_version(version: int, where: str) -> None:
    """Raise IntegrityError for a manifest of a later version than this toolkit knows."""
    if version > SCHEMA_VERSION:
        raise IntegrityError(
            f"{where!r} has schema version {version}, this toolkit reads up to {SCHEMA_VERSION}",
            next="install a newer tactile-toolkit",
        )


def version_in_identity(version: int) -> tuple[int, ...]:
    """Return what a version adds to the identity of a data set; records of the first lack it."""
    return () if version == _FIRST else (version,)


def plan_in_version(plan: Any, version: int) -> Any:
    """Return the BuildPlan by which a data set of a version is continued."""
    if version == plan.schema_version:
        return plan
    former = plan.former or plan
    return replace(former, style=first_style(former.style), schema_version=version, former=None)


def first_style(style: ParquetStyle) -> ParquetStyle:
    """Return a style with the pages of the first version."""
    return replace(style, values_per_page=None, chunks_by_content=False, page_index=False)
