"""Which files of a data set folder are the toolkit's: nothing else in it is ever removed or replaced."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import PurePosixPath

from tactile_toolkit.kind import kinds
from tactile_toolkit.store.files import DRAFT
from tactile_toolkit.store.folder import NEXT_FOLDER, PENDING_FOLDER, TEMPORARY, DataFolder
from tactile_toolkit.store.manifest import MANIFEST_FILE
from tactile_toolkit.store.origin import RECORD_FILE
from tactile_toolkit.store.shards import DATA_FOLDER, ShardName

PROMOTION_FILE = f"{NEXT_FOLDER}/.promotion.json"
"""Lists the files of the former data set that the next one does not have."""

# Earlier checkouts wrote a croissant.json.
_USUAL = ("reports/*.parquet", "previews/*.png", "README.md", "croissant.json", RECORD_FILE, MANIFEST_FILE)
_SHARD = r"\w+-[0-9]{5,12}-of-[0-9]{5,12}"

is_pending = re.compile(
    rf"{PENDING_FOLDER}/(?:{TEMPORARY}|{_SHARD}[.]json|report-{_SHARD}[.]parquet)"
).fullmatch
"""Matches the path of a record, of report rows or of a temporary file of a run."""


def extra_files() -> list[str]:
    """Return the patterns of files that some kind of data set has next to its rows."""
    return [pattern for kind in kinds() for pattern in kind.extra_files]


def is_ours(path: str, further: Iterable[str]) -> bool:
    """Return whether a file of a data set can have such a path; ``further`` are patterns of its kind."""
    place = PurePosixPath(path)
    if is_pending(path) or (len(place.parts) > 1 and re.match(DRAFT, place.name)):
        return True
    if str(place.parent) == DATA_FOLDER:
        return ShardName.parse(place.name) is not None
    # Not from the right end alone, as `match` compares.
    return any(
        place.match(pattern) and len(place.parts) == pattern.count("/") + 1 for pattern in (*_USUAL, *further)
    )


def remove_next(folder: DataFolder) -> None:
    """Remove the data set that was to take the place of the one in a folder."""
    if folder.exists(NEXT_FOLDER):
        every = extra_files()
        folder.remove_tree(
            NEXT_FOLDER,
            lambda path: path == PROMOTION_FILE or is_ours(path.removeprefix(f"{NEXT_FOLDER}/"), every),
        )
