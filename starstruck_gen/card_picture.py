"""The picture of a data set of scenes that its card shows: the first scenes from above."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import TYPE_CHECKING

from starstruck_gen.placement import Placement
from starstruck_gen.scene import Scene
from tactile_toolkit.cards.pictures import PREVIEW_FOLDER, png_bytes, tile_sheet

if TYPE_CHECKING:
    from tactile_toolkit.cards.facts import FolderFacts, SplitFacts

__all__ = ["PREVIEW_FILE", "scene_sheet"]

PREVIEW_FILE = f"{PREVIEW_FOLDER}/scenes.png"

_SCENES = 12
_COLUMNS = 6
_TILE_PX = 140


def scene_sheet(facts: FolderFacts, cell_m: tuple[float, float]) -> bytes | None:
    """Draw the first scenes of the first split that has any.

    Parameters
    ----------
    facts : FolderFacts
        The folder.
    cell_m : tuple of float
        Size of the cell along x and y, metres; the longer side becomes 140 pixels.

    Returns
    -------
    bytes or None
        PNG; None where the folder has no rows.
    """
    split = next((split for split in facts.splits if split.rows), None)
    if split is None:
        return None
    px_per_mm = _TILE_PX / (1e3 * max(cell_m))
    tiles = [scene.draw(cell_m, px_per_mm) for scene in islice(_scenes(split), _SCENES)]
    return png_bytes(tile_sheet(tiles, _COLUMNS))


def _scenes(split: SplitFacts) -> Iterator[Scene]:
    for shard in split.shards:
        for index in range(shard.metadata.num_row_groups):
            for group in shard.blocks(index, ["star_count", "placements"]):
                # As Python objects: numpy's way of lists of structs imports pandas, which takes a second.
                for row in group.table.slice(0, _SCENES).to_pylist():
                    placements = tuple(Placement(**entry) for entry in row["placements"])
                    yield Scene(row["star_count"], placements, attempts=(), restarts=0)
