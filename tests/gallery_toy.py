"""A tiny gallery, to test the pages without any package of data sets."""

from __future__ import annotations

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa

from tactile_toolkit.gallery import Gallery, GalleryItem
from tactile_toolkit.gallery.site import packed_mesh
from tactile_toolkit.rows import Column

_OWN = "document.title='owned'"
HOSTILE = f"""<script>{_OWN}</script>"><img src=x onerror="{_OWN}">'`${{1}}&amp;\u2028"""
CORNERS_M = np.array([[0, 0, 0], [0.03, 0, 0], [0, 0.02, 0], [0, 0, 0.01]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
# No toy has a hat: a field without values is not a filter.
COLUMNS = (
    Column(pa.string(), name="label", role="facet", title="Class"),
    Column(pa.string(), name="parity", role="facet", title="Parity", values=("odd", "even")),
    Column(pa.string(), name="writer", role="facet", title="Writer"),
    Column(pa.string(), name="hats", role="facet", title="Hats"),
    Column(pa.float64(), "mm³", name="volume", role="measure", title="Volume", decimals=1),
    Column(pa.float64(), name="unknown", role="measure", title="Never measured"),
)


@dataclass(frozen=True)
class ToyTask:
    """Makes items ``start`` to ``stop - 1``. ``alive`` is a file that is created when the task begins."""

    start: int
    stop: int
    hostile: bool = False
    pause_s: float = 0.0
    alive: str | None = None
    die: bool = False
    error: Exception | None = None
    bulk_bytes: int = 0

    @property
    def size(self) -> int:
        return self.stop - self.start

    def make(self) -> list[GalleryItem]:
        if self.alive is not None:
            Path(self.alive).touch()
        if self.error is not None:
            raise self.error
        if self.die:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(self.pause_s)
        return [self._item(number) for number in range(self.start, self.stop)]

    def _item(self, number: int) -> GalleryItem:
        evil = HOSTILE if self.hostile else ""
        shade = np.full((12, 12), 255, np.uint8)
        shade[3:9, 3:9] = 40 + number % 160
        return GalleryItem(
            id=f"{number}{evil}",
            title=f"toy {number % 10}{evil}",
            values={
                "label": f"{number % 10}{evil}",
                "parity": "even" if number % 2 == 0 else "odd",
                "writer": number % 31,
                "volume": (number * 37 % 1000) / 10 if number % 7 else None,
            },
            thumbnail=GalleryItem.thumbnail_of(shade),
            content={
                "notes": [(f"Note{evil}", f"of {number}{evil}")],
                "mesh": packed_mesh(CORNERS_M * (1 + number % 3), FACES),
            },
            media={"bulk.bin": bytes(self.bulk_bytes)} if self.bulk_bytes else {},
        )


def toy_gallery(count: int = 20, portion: int = 8, **options: object) -> Gallery:
    """Return a gallery of ``count`` items, made by tasks of ``portion`` items."""
    starts = range(0, count, portion)
    tasks = tuple(ToyTask(start, min(start + portion, count), **options) for start in starts)  # type: ignore[arg-type]
    title = f"Toys {HOSTILE}" if options.get("hostile") else "Toys"
    return Gallery("toy", title, ("toy", "toys"), COLUMNS, tasks, {"train": count})
