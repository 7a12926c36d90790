"""Files of a data set folder that belong to the toolkit; no other file is ever removed or replaced."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import PurePosixPath

from tactile_toolkit.kind import kinds
from tactile_toolkit.store.download_record import RECORD_FILE
from tactile_toolkit.store.files import DRAFT
from tactile_toolkit.store.manifest import MANIFEST_FILE
from tactile_toolkit.store.pending import is_pending
from tactile_toolkit.store.shards import DATA_FOLDER, ShardName

CARD_FILE = "README.md"
"""The data card."""

_USUAL = ("reports/*.parquet", "previews/*.png", CARD_FILE, RECORD_FILE, MANIFEST_FILE)


def extra_files() -> list[str]:
    """Return the patterns of files that any kind of data set has next to its rows."""
    return [pattern for kind in kinds() for pattern in kind.extra_files]


def is_ours(path: str, further: Iterable[str]) -> bool:
    """Return whether a path is that of a file of a data set; ``further`` are patterns of its kind."""
    place = PurePosixPath(path)
    if is_pending(path) or (len(place.parts) > 1 and re.match(DRAFT, place.name)):
        return True
    if str(place.parent) == DATA_FOLDER:
        return ShardName.parse(place.name) is not None
    # `match` compares from the right; the depth must agree, too.
    return any(
        place.match(pattern) and len(place.parts) == pattern.count("/") + 1 for pattern in (*_USUAL, *further)
    )
