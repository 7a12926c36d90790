"""Small pictures of a data set beside its card, under ``previews/``."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from tactile_toolkit.store.folder import DataFolder

if TYPE_CHECKING:
    from PIL.Image import Image

__all__ = ["PREVIEW_FOLDER", "png_bytes", "tile_sheet", "write_previews"]

PREVIEW_FOLDER = "previews"

_GAP_PX = 8
_PAPER = (255, 255, 255)


def tile_sheet(tiles: Sequence[Image], columns: int) -> Image:
    """Lay pictures out in rows on white paper, each in the middle of a cell as large as the largest.

    Parameters
    ----------
    tiles : sequence of PIL.Image
        At least one.
    columns : int
        Pictures in a row.
    """
    from PIL import Image as Pictures

    columns = min(columns, len(tiles))
    width, height = (max(tile.size[axis] for tile in tiles) + _GAP_PX for axis in (0, 1))
    rows = -(-len(tiles) // columns)
    sheet = Pictures.new("RGB", (columns * width + _GAP_PX, rows * height + _GAP_PX), _PAPER)
    for place, tile in enumerate(tiles):
        row, column = divmod(place, columns)
        x = _GAP_PX + column * width + (width - _GAP_PX - tile.size[0]) // 2
        y = _GAP_PX + row * height + (height - _GAP_PX - tile.size[1]) // 2
        sheet.paste(tile, (x, y))
    return sheet


def png_bytes(picture: Image) -> bytes:
    """Encode a picture as PNG; equal pixels give equal bytes."""
    stream = io.BytesIO()
    picture.save(stream, format="PNG", compress_level=9)
    return stream.getvalue()


def write_previews(folder: DataFolder, pictures: Mapping[str, bytes]) -> None:
    """Write pictures under ``previews/``; those that are there already are left alone.

    Parameters
    ----------
    folder : DataFolder
        Data set folder.
    pictures : mapping of str to bytes
        PNG by path inside the folder.

    Raises
    ------
    StorageError
        When the folder cannot be written.
    """
    folder.remove_stale_files(PREVIEW_FOLDER)
    for path, content in pictures.items():
        if not folder.exists(path) or folder.read_bytes(path) != content:
            folder.write_bytes(path, content)
