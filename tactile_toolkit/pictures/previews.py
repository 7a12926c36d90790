"""Previews of data sets of meshes: sheets of chosen rows, class by class."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Generic, TypeVar

import numpy as np

from tactile_toolkit import catalog, places, read
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.kind import DatasetKind
from tactile_toolkit.pictures.picture_files import PlannedPicture, file_stem
from tactile_toolkit.pictures.sheets import Tile, bar_length_mm, in_rows, sheet, with_scale_bar
from tactile_toolkit.wording import with_count

D = TypeVar("D", bound=read.AnyRecords)


class MeshPreviews(Generic[D]):
    """A data set to draw: its splits with the chosen rows, and its specification.

    Raises InputError if a split or id does not exist, a split is empty, or the data have another kind.
    """

    def __init__(
        self, kind: DatasetKind, name: places.Name | places.Place, spec: catalog.PreviewSpec
    ) -> None:
        place = places.open_place(name).require(kind, "preview")
        self.name, self.item_noun, self.stem = place.name, kind.nouns, file_stem(place.name)
        self.unfinished = place.unfinished
        among = spec.given()
        datasets: dict[str, D] = catalog.open_splits(place, among.pop("split"), kind.load, kind.nouns)
        if spec.ids:
            among["per_class"] = None
        self.chosen = catalog.choose_rows(datasets.items(), **among)
        self.made_by = place.made_by

    def plan_sheets(self, draw: Callable[[D, str], UInt8]) -> list[PlannedPicture]:
        """Plan a sheet for each split; ``draw`` takes the rows, sorted by class, and the heading."""
        planned = []
        for split, dataset, found in self.chosen:
            rows = dataset[found[np.argsort(dataset.labels[found], kind="stable")]]
            if len(rows):
                what = f"{with_count(len(rows), self.item_noun)} of {split} from above"
                heading = f"{self.stem}: {split}"
                if self.unfinished:
                    heading = f"{heading} (unfinished, {self.unfinished})"
                drawing = partial(draw, rows, heading)
                planned.append(PlannedPicture(f"{self.stem}-{split}-sheet.png", what, drawing))
        return planned


def draw_by_class(
    tiles: Sequence[tuple[str, Tile]], per_row: int, title: str, words: str, px_per_mm: float
) -> UInt8:
    """Draw pictures at one scale, each given with its class, in one or more rows for each class."""
    groups: dict[str, list[Tile]] = {}
    for name, tile in tiles:
        groups.setdefault(name, []).append(tile)
    columns, cells, row_labels = in_rows(list(groups.items()), per_row)
    drawn = sheet(cells, columns, title, (words,), row_labels, gap_px=12, bar_room=True)
    widest = max(tile.pixels.shape[1] for _, tile in tiles)
    return with_scale_bar(drawn, px_per_mm, bar_length_mm(4 * widest, px_per_mm))
