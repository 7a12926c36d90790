"""Records that draw themselves, and their views in notebooks."""

from __future__ import annotations

import base64
import html
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
from PIL import Image

from tactile_toolkit import touch
from tactile_toolkit.array_types import UInt8
from tactile_toolkit.errors import IntegrityError
from tactile_toolkit.pictures.sheets import fitted

# Width of the picture of a record in a notebook, alone and among others.
_VIEW_PX = 300
_TILE_PX = 120
_TILE_STYLE = "margin:0;text-align:center;font-size:smaller"


class Drawn(ABC):
    """Base class of records that draw themselves; views, sheets, cards and galleries follow from it."""

    __slots__ = ()

    @abstractmethod
    def caption(self, label_names: Sequence[str] = ()) -> str:
        """Return what the record shows, in a few words; ``label_names`` are the names of the classes."""

    @property
    def tile_caption(self) -> str:
        """Text below a small picture among others."""
        return self.caption()

    @property
    def details(self) -> str:
        """Text below a large picture."""
        return self.caption()

    @abstractmethod
    def picture(self, width_px: float) -> UInt8:
        """Draw the record, (H, W) or (H, W, 3); the longer side of what it shows is ``width_px`` long."""

    def _repr_html_(self) -> str:
        """Show the record in a notebook."""
        return figure_html(self.picture(_VIEW_PX), self.details)

    def tile_html(self) -> str:
        """Return HTML of a small picture with a caption, for notebooks."""
        return figure_html(self.picture(_TILE_PX), self.tile_caption, small=True)

    @staticmethod
    def grid_html(
        title: str, words: Sequence[str], pictures: Sequence[tuple[str, Callable[[], UInt8]]]
    ) -> str:
        """Return HTML for notebooks of small pictures with captions; damaged ones are counted."""
        tiles = []
        for caption, read in pictures:
            with suppress(IntegrityError):
                tiles.append(figure_html(fitted(read(), _TILE_PX), caption, small=True))
        if len(tiles) < len(pictures):
            words = [*words, f"{len(pictures) - len(tiles)} of {len(pictures)} pictures cannot be shown"]
        grid = f'<div style="display:flex;flex-wrap:wrap;gap:4px">{"".join(tiles)}</div>'
        return f"<div><b>{html.escape(title)}</b>: {', '.join(words)}{grid}</div>"


def png_bytes(pixels: UInt8) -> bytes:
    """Encode a picture as PNG, without metadata; equal pixels give equal bytes."""
    return touch.encode_png(Image.fromarray(np.ascontiguousarray(pixels)))


def figure_html(pixels: UInt8, caption: str, *, small: bool = False) -> str:
    """Return HTML for notebooks of a picture and its caption, which is plain text."""
    source = base64.b64encode(png_bytes(pixels)).decode("ascii")
    style = ""
    if small:
        style = f' style="{_TILE_STYLE}"'
    return (
        f'<figure{style}><img src="data:image/png;base64,{source}">'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )
