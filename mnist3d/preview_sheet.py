"""Contact sheets: many digits at one scale, class by class."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mnist3d.dataset import MeshRecord
from tactile_toolkit.mesh.mesh import MM_PER_M, Mesh
from tactile_toolkit.pictures.relief import relief_of
from tactile_toolkit.pictures.sheets import ScaleBar, Sheet, Tile, in_rows, sheet, with_scale_bar
from tactile_toolkit.pictures.writing import Drawing
from tactile_toolkit.wording import counted

__all__ = ["draw_sheet"]

_TILE_PX = 132


def draw_sheet(records: Sequence[MeshRecord], per_row: int, title: str, names: Sequence[str]) -> Drawing:
    """Draw digits from above at one scale, in a row (or some) for each class.

    Parameters
    ----------
    records : sequence of MeshRecord
        Digits; those of a class one after another.
    per_row : int
        Most digits in a row.
    title : str
        Heading.
    names : sequence of str
        Name of each class.
    """
    meshes = [Mesh(record.vertices_m, record.faces) for record in records]
    labels = [record.label for record in records]
    px_per_mm = _TILE_PX / (MM_PER_M * max(float(np.ptp(mesh.vertices_m[:, :2], 0).max()) for mesh in meshes))
    tiles = [
        Tile(relief_of(mesh, px_per_mm), f"{record.id}") for mesh, record in zip(meshes, records, strict=True)
    ]
    groups = [
        (
            names[label] if label < len(names) else str(label),
            [tile for tile, each in zip(tiles, labels, strict=True) if each == label],
        )
        for label in dict.fromkeys(labels)
    ]
    columns, cells, row_labels = in_rows(groups, per_row)
    words = (f"{counted(len(records), 'digits')} from above, at one scale; the id of each below it",)
    # The empty line at the foot is the room of the scale bar.
    drawn = sheet(cells, Sheet(columns, title, words, ("",), row_labels, gap_px=12))
    return Drawing(with_scale_bar(drawn, px_per_mm, ScaleBar.fitting(4 * _TILE_PX, px_per_mm)))
