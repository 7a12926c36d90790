"""The picture that the card of a data set of digits shows: one digit of each class in relief."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import TYPE_CHECKING

from mnist3d.rows import CLASS_NAMES
from tactile_toolkit.cards.pictures import PREVIEW_FOLDER, png_bytes, tile_sheet
from tactile_toolkit.mesh.columns import FACES, VERTICES
from tactile_toolkit.pictures.relief import relief
from tactile_toolkit.read.dataset import Row

if TYPE_CHECKING:
    from PIL.Image import Image

    from tactile_toolkit.cards.facts import FolderFacts, SplitFacts

__all__ = ["PREVIEW_FILE", "digit_sheet"]

PREVIEW_FILE = f"{PREVIEW_FOLDER}/digits.png"

_PITCH_M = 0.0004
_COLUMNS = 5
_ROWS_SEEN = 200


def digit_sheet(facts: FolderFacts) -> bytes | None:
    """Draw the first digit of each class in the first rows of the first split that has any.

    Parameters
    ----------
    facts : FolderFacts
        The folder.

    Returns
    -------
    bytes or None
        PNG at 0.4 mm per pixel; None where the folder has no rows.
    """
    split = next((split for split in facts.splits if split.rows), None)
    if split is None:
        return None
    first: dict[int, Row] = {}
    for label, row in islice(_rows(split), _ROWS_SEEN):
        first.setdefault(label, row)
        if len(first) == len(CLASS_NAMES):
            break
    return png_bytes(tile_sheet([_drawn(first[label]) for label in sorted(first)], _COLUMNS))


def _rows(split: SplitFacts) -> Iterator[tuple[int, Row]]:
    for shard in split.shards:
        for index in range(shard.metadata.num_row_groups):
            for group in shard.blocks(index, ["label", VERTICES, FACES]):
                for place, label in enumerate(group.table["label"].to_pylist()):
                    yield label, Row(group, place)


def _drawn(row: Row) -> Image:
    from PIL import Image as Pictures

    return Pictures.fromarray(relief(row.array(VERTICES), row.array(FACES), _PITCH_M))
